"""Data drawn from a fitted model, against closed forms of a linear vessel in coloured gusts."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from diffsea import Trajectory
from diffsea.identification.estimates import posterior_estimate
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.problem import make_problem
from diffsea.identification.resimulation import draw_process_noise, resimulate
from diffsea.vessel.files import build


STEP, ROWS = 0.2, 15000
MASSES, DRAGS = (22.0, 30.0, 12.0), (11.0, 18.0, 6.0)
WHITE, SLOW, MEMORY = (0.03, 0.02, 0.015), (0.03, 0.025, 0.02), (3.0, 2.0, 1.5)
SENSOR = (0.3, 0.2, 0.02, 0.03, 0.04, 0.01)
WALK = 0.05
DOCUMENT = {
    "format": 1, "name": "buoy", "source": "none",
    "hull": {"length": 2.0, "beam": 1.0, "draught": 0.2, "mass": 20.0, "I_z": 10.0, "x_G": 0.0,
             "X_udot": -2.0, "Y_vdot": -10.0, "N_rdot": -2.0,
             "X_u": -DRAGS[0], "Y_v": -DRAGS[1], "N_r": -DRAGS[2]},
    "thruster": [{"name": "screw", "x": -1.0, "y": 0.0, "max_force": 50.0, "min_force": -50.0}],
}  # fmt: skip


def at_rest(rows: int) -> Trajectory:
    """A run with no order, the gyro on every other row."""
    nothing = np.zeros(rows)
    r = np.where(np.arange(rows) % 2, np.nan, 0.0)
    return Trajectory(
        t=STEP * np.arange(rows), x=nothing, y=nothing, psi=nothing, u=nothing, v=nothing, r=r,
        commanded={"screw": nothing}, executed={}, valid=np.ones(rows, bool), extra={},
        name=f"rest {rows}",
    )  # fmt: skip


@pytest.fixture(scope="module")
def setting():
    problem = make_problem(build(DOCUMENT), [at_rest(ROWS), at_rest(200)], ("X_u",))
    log = lambda values: jnp.log(jnp.asarray(values))
    noise = Noise(log(WHITE), log(SLOW), log(MEMORY), log(SENSOR), log([WALK]))
    fitted = posterior_estimate(
        ("X_u",), np.zeros(1), 0.0, np.array([0]), np.ones(1), np.eye(1), state=noise
    )
    return problem, fitted


@pytest.fixture(scope="module")
def drawn(setting):
    problem, fitted = setting
    return resimulate(problem, fitted, np.random.default_rng(4))


def long_run(problem) -> np.ndarray:
    """Readings of the first run after it has forgotten its start."""
    dataset = problem.dataset
    rows = np.flatnonzero((np.asarray(dataset.run) == 0) & np.asarray(dataset.known)[:, 0])
    return np.asarray(dataset.measured)[rows[200:]]


def test_speeds_have_the_variance_of_a_damped_vessel_in_coloured_gusts(drawn):
    found = long_run(drawn)
    for k in range(3):
        a, tau = DRAGS[k] / MASSES[k], MEMORY[k]
        speed = WHITE[k] ** 2 / (2 * a) + SLOW[k] ** 2 * tau / (a * (a * tau + 1))
        rows = found[::2, 3 + k] if k == 2 else found[:, 3 + k]
        # Some thousand independent values: five per cent and less.
        assert np.var(rows) == pytest.approx(speed + SENSOR[3 + k] ** 2, rel=0.15)


def test_gusts_last_as_long_as_they_should(drawn):
    u = long_run(drawn)[:, 3]
    a, tau, lag = DRAGS[0] / MASSES[0], MEMORY[0], 20
    # A first-order lag driven by white and by exponentially correlated forces.
    white = WHITE[0] ** 2 / (2 * a)
    slow = SLOW[0] ** 2 * tau / (a * (a * tau + 1))
    fast, late = np.exp(-a * lag * STEP), np.exp(-lag * STEP / tau)
    kept = white * fast + slow * (fast - a * tau * late) / (1 - a * tau)
    assert np.mean(u[lag:] * u[:-lag]) == pytest.approx(kept, rel=0.25)


def test_what_gusts_add_to_speed_and_acceleration_goes_together(setting):
    problem, fitted = setting
    white, memory = jnp.log(jnp.full(3, 1e-3)), jnp.log(jnp.full(3, 0.3))
    quiet = dataclasses.replace(fitted.noise, gust=white, memory=memory)
    found = draw_process_noise(quiet, problem.dataset, np.random.default_rng(3))[: ROWS - 1]
    for k in range(3):
        # Covariance of (speed, acceleration) after a step by Van Loan's exponential (1978).
        A = np.array([[0.0, 1.0], [0.0, -1 / 0.3]])
        Q = np.diag([1e-6, 2 * SLOW[k] ** 2 / 0.3])
        block = expm(STEP * np.block([[-A, Q], [np.zeros((2, 2)), A.T]]))
        exact = block[2:, 2:].T @ block[:2, 2:]
        drawn = np.cov(found[:, [3 + k, 6 + k]].T)
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        assert np.max(np.abs(drawn - exact) / scale) < 0.04
    assert np.std(found[:, :2]) == pytest.approx(WALK * np.sqrt(STEP), rel=0.03)
    assert not found[:, 2].any()


def test_readings_have_their_own_noise(drawn):
    found = long_run(drawn)
    for k in range(3):  # two differences leave next to nothing of the motion
        rest = np.diff(found[:, k], 2)
        assert np.std(rest) == pytest.approx(np.sqrt(6) * SENSOR[k], rel=0.06)


def test_nothing_but_the_readings_is_new(setting, drawn):
    before, after = setting[0].dataset, drawn.dataset
    assert not np.array_equal(before.measured, after.measured)
    assert not np.any(np.asarray(after.measured)[~np.asarray(after.known)])
    for field in dataclasses.fields(before):
        if field.name in ("t", "dt", "known", "run", "starts", "first"):
            assert np.array_equal(getattr(before, field.name), getattr(after, field.name))


def test_every_draw_is_another_one(setting, drawn):
    problem, fitted = setting
    again = resimulate(problem, fitted, np.random.default_rng(4))
    other = resimulate(problem, fitted, np.random.default_rng(5))
    assert np.array_equal(again.dataset.measured, drawn.dataset.measured)
    known = np.asarray(other.dataset.known)
    same = np.asarray(other.dataset.measured) == np.asarray(drawn.dataset.measured)
    assert not np.any(same & known)


def test_runs_start_where_the_filter_found_them(setting):
    problem, fitted = setting
    rows = np.asarray(problem.dataset.starts)
    place = np.where(np.asarray(problem.dataset.run)[:, None] == 1, 70.0, -40.0)
    known = np.asarray(problem.dataset.known)[:, :1]
    measured = np.asarray(problem.dataset.measured) + known * place * np.eye(6)[0]
    first = np.asarray(problem.dataset.first) + place * np.eye(6)[0]
    moved = dataclasses.replace(
        problem.dataset, measured=jnp.asarray(measured), first=jnp.asarray(first)
    )
    made = resimulate(dataclasses.replace(problem, dataset=moved), fitted, np.random.default_rng(1))
    starts = np.asarray(made.dataset.measured)[rows][:, 0]
    assert starts[:2] == pytest.approx([-40.0, 70.0], abs=5 * SENSOR[0])


@pytest.mark.parametrize(
    "effect",
    [
        {"name": "heading-offset", "angle": 0.5, "time": 20.0},
        {"name": "gyro-bias", "bias": 0.3, "time": 20.0},
    ],
)
def test_what_a_sensor_shows_too_much_is_in_what_is_drawn(setting, effect):
    """As the filter that takes it off again expects: an error taken off twice would stand out."""
    _, fitted = setting
    problem = make_problem(build({**DOCUMENT, "effect": [effect]}), [at_rest(200)], ("X_u",))
    made = resimulate(problem, fitted, np.random.default_rng(6))
    assert np.abs(np.asarray(fitted.filter_run(made).white)).max() < 5.0
    plain = make_problem(build(DOCUMENT), [at_rest(200)], ("X_u",))
    plain = dataclasses.replace(plain, dataset=made.dataset)
    assert np.abs(np.asarray(fitted.filter_run(plain).white)).max() > 8.0
