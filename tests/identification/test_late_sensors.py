# pyright: reportArgumentType=false
"""Late sensors in a filter against a Kalman filter of two states, on surge simulated exactly.

The vessel runs straight ahead with linear drag: u' = -c u + F / m + a + white gusts, with lasting
gusts a of a first-order Gauss-Markov process. Only u is seen, some rows late.
"""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps, varied

from diffsea import EFFECTS, Trajectory
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun, deviance, measurement_jacobian
from diffsea.identification.filter.latency import shown_samples
from diffsea.identification.fit import Start, estimate
from diffsea.identification.problem import Problem, make_problem
from diffsea.vessel.files import build


MASS, DRAG, LENGTH = 180.0 + 12.0, 52.0, 4.9  # kg with added mass, N s/m, m
C = DRAG / MASS
STEP = 0.2  # s, a row
LATE = EFFECTS["sensor-latency:velocity"]


class Gusty(NamedTuple):
    """Gusts on u and the noise of its sensor."""

    white: float = 0.05  # m/s per square root of a second
    lasting: float = 1e-9  # m/s^2
    memory: float = 3.0  # s
    sensor: float = 0.02  # m/s

    @property
    def noise(self) -> Noise:
        """The library's scales; those of channels that are not seen do not matter."""
        scales = [self.white, 0.1, 0.1, self.lasting, 0.1, 0.1, self.memory, 3.0, 3.0]
        return Noise.of(np.log([*scales, 1.0, 1.0, 1.0, self.sensor, 1.0, 1.0, 1e-9]))


def covariance(gusty: Gusty, damping: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition of (u, a) over a row and what gusts add, by Van Loan's matrix exponential."""
    A = np.array([[-damping, 1.0], [0.0, -1 / gusty.memory]])
    L = np.diag([gusty.white**2, 2 * gusty.lasting**2 / gusty.memory])
    block = expm(np.block([[-A, L], [np.zeros((2, 2)), A.T]]) * dt)
    F = block[2:, 2:].T
    return F, F @ block[:2, 2:]


def thrusts(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Thrust (N) in every row: another one every two seconds."""
    return np.repeat(rng.uniform(30.0, 400.0, rows // 10 + 1), 10)[:rows]


def surge(rng: np.random.Generator, push: np.ndarray, gusty: Gusty) -> np.ndarray:
    """u (m/s) at the start of every row, by exact steps from the steady speed."""
    F, Q = covariance(gusty, C, STEP)
    root = np.linalg.cholesky(Q + 1e-24 * np.eye(2))
    state = np.array([push[0] / DRAG, gusty.lasting * rng.normal()])
    out = np.empty(len(push))
    for k, force in enumerate(push):
        out[k] = state[0]
        pushed = (1 - math.exp(-C * STEP)) * force / DRAG
        state = F @ state + [pushed, 0.0] + root @ rng.normal(size=2)
    return out


def recorded(rng: np.random.Generator, rows: int, gusty: Gusty, late: int) -> tuple:
    """Thrusts and u as it is shown `late` rows late."""
    push = thrusts(rng, rows + late)
    shown = surge(rng, push, gusty)[:rows] + gusty.sensor * rng.normal(size=rows)
    return push[late:], shown


@pytest.fixture(scope="module")
def vessel(request):
    """The oracle's craft with linear drag alone ahead."""
    document = load(str(ORACLE / "usv.toml"))
    return build(varied(document, {"X_uu": None}))


def seen(push: np.ndarray, shown: np.ndarray) -> Trajectory:
    """A run of which nothing is measured but u."""
    t, nothing = STEP * np.arange(len(push)), np.full(len(push), np.nan)
    return Trajectory(
        t, nothing, nothing, nothing, shown, nothing, nothing,
        {"port": push / 2, "starboard": push / 2}, {}, {}, np.ones(len(push), bool),
    )  # fmt: skip


def run_at(problem: Problem, rows: float, gusty: Gusty):
    """The filter's run where u is so many rows late."""
    at = np.zeros(problem.layout.size)
    at[-1] = rows * STEP / problem.layout.sizes[0][0]
    return problem.run_filter(at, gusty.noise)


def kalman(push: np.ndarray, shown: np.ndarray, gusty: Gusty, rows: float) -> tuple:
    """Innovations and their variances by a filter of (u, a) whose sensor is `rows` rows late.

    Each sample is used at the next row, from as many rows before the run on as it is late; what is
    left of the delay times the acceleration since the last row, and knows nothing of that share of
    the gusts since. Before the run the first thrust acts.
    """
    whole, F, Q = int(rows), *covariance(gusty, 0.0, STEP)
    gain_a = F[0, 1] / 2  # half the speed that a gives goes before and half after the motion
    left = math.exp(-C * STEP)
    A = np.array([[left, (1 + left) * gain_a], [0.0, F[1, 1]]])
    state, P = np.array([shown[0], 0.0]), np.diag([0.25 * 9.81 * LENGTH, gusty.lasting**2])
    acceleration, out = 0.0, []
    for force, value in zip(np.concatenate([push[:1].repeat(whole), push]), shown, strict=False):
        nu = value - (state[0] - (rows - whole) * STEP * acceleration)
        cross = P[:, 0] - (rows - whole if out else 0.0) * Q[:, 0]
        s = cross[0] + gusty.sensor**2
        K = cross / s
        out.append((nu, s))
        P = P - np.outer(K, cross)
        state = state + K * nu
        before = state[0]
        u = left * (before + gain_a * state[1]) + (1 - left) * force / DRAG
        state = np.array([u + gain_a * state[1], F[1, 1] * state[1]])
        acceleration = (state[0] - before) / STEP
        P = A @ P @ A.T + Q
    return tuple(np.array(out).T)


def of_samples(problem: Problem, run: FilterRun, values: np.ndarray) -> np.ndarray:
    """Values of u at the rows where its samples are used, in the order of these."""
    return np.asarray(values)[np.asarray(run.gains.placement.source)[:, 3] >= 0, 3]


LASTING = Gusty(white=0.01, lasting=0.1)


@pytest.mark.parametrize("gusty", [Gusty(), LASTING], ids=["white gusts", "lasting gusts"])
@pytest.mark.parametrize("rows", [0.0, 1.5, 1.999, 2.001, 2.5])
def test_a_filter_of_two_states_has_the_same_innovations(vessel, rows, gusty):
    push, shown = recorded(np.random.default_rng(0), 240, gusty, 2)
    problem = problem_of(vessel, push, shown)
    run = run_at(problem, rows, gusty)
    nu, variance = kalman(push, shown, gusty, rows)
    np.testing.assert_allclose(of_samples(problem, run, run.innovation), nu, atol=1e-6)
    np.testing.assert_allclose(of_samples(problem, run, run.variance), variance, rtol=1e-6)


@pytest.mark.parametrize("gusty", [Gusty(), LASTING], ids=["white gusts", "lasting gusts"])
def test_two_rows_late_are_the_most_likely_where_it_was_two(vessel, gusty):
    push, shown = recorded(np.random.default_rng(3), 240, gusty, 2)
    problem = problem_of(vessel, push, shown)
    grid = np.round(np.arange(1.0, 3.01, 0.2), 1)
    values = [float(deviance(run_at(problem, rows, gusty))) for rows in grid]
    known = [expected_deviance(*kalman(push, shown, gusty, rows)) for rows in grid]
    assert grid[np.argmin(values)] == grid[np.argmin(known)] == 2.0
    np.testing.assert_allclose(np.subtract(values, min(values)), np.subtract(known, min(known)),
                               atol=1.0)  # fmt: skip
    worse = np.diff(values)
    assert (worse[grid[1:] <= 2.0] < -5).all() and (worse[grid[1:] > 2.0] > 5).all()


def expected_deviance(nu: np.ndarray, variance: np.ndarray) -> float:
    return float((nu**2 / variance + np.log(variance)).sum())


def problem_of(vessel, push: np.ndarray, shown: np.ndarray) -> Problem:
    return make_problem(vessel, [seen(push, shown)], ("X_u",), (LATE,))


def portmanteau(white: np.ndarray) -> tuple[float, float]:
    """Autocorrelation at lag one in its standard errors; p-value of Ljung and Box's first ten."""
    n, lags = len(white), np.arange(1, 11)
    rho = np.array([white[k:] @ white[:-k] for k in lags]) / (white @ white)
    statistic = n * (n + 2) * (rho**2 / (n - lags)).sum()
    return rho[0] * math.sqrt(n), float(stats.chi2.sf(statistic, len(lags)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_innovations_of_a_late_channel_are_white_at_the_truth_alone(vessel, seed):
    """2000 rows; a filter that takes them for one row more or less late leaves colour."""
    gusty = Gusty()
    push, shown = recorded(np.random.default_rng(seed), 2000, gusty, 2)
    problem = problem_of(vessel, push, shown)
    runs = {r: run_at(problem, r, gusty) for r in (1, 2, 3)}
    white = {r: of_samples(problem, run, run.white)[5:] for r, run in runs.items()}
    first, chance = portmanteau(white[2])
    assert abs(first) < 3 and chance > 0.01
    assert np.mean(white[2] ** 2) == pytest.approx(1.0, abs=0.15)
    for wrong in (1, 3):
        first, chance = portmanteau(white[wrong])
        assert first > 6 and chance < 1e-20


@pytest.mark.parametrize("late", [0.0, 0.2])
def test_what_is_shown_depends_on_the_present_as_its_derivative_says(late):
    boat = build(load(str(ORACLE / "usv.toml")))
    lags = {"latency_yaw_rate": late, "latency_heading": late, "latency_velocity": late / 2}
    boat = dataclasses.replace(boat, sensors=dataclasses.replace(boat.sensors, **lags))
    x, acceleration = jnp.array([3.0, 1.0, 0.7, 1.1, -0.2, 0.15]), jnp.array([0.1, 0.05, -0.02])
    moved = jnp.array([0.0, 0.1, -0.1, 0.05, 0.2, 0.1])
    shown = lambda at: np.asarray(shown_samples(boat, at, acceleration, moved))
    found = measurement_jacobian(boat, x, acceleration, moved)
    step = 1e-5
    slopes = [(shown(x.at[k].add(step)) - shown(x.at[k].add(-step))) / (2 * step) for k in range(6)]
    np.testing.assert_allclose(found[:, :6], np.stack(slopes, 1), atol=1e-9)


def test_a_channel_is_shown_where_it_was_on_a_turning_circle():
    """A steady turn, of which the past is known in closed form."""
    speed, rate, lag = 1.2, 0.3, 0.25
    boat = build(load(str(ORACLE / "usv.toml")))
    late = dataclasses.replace(boat.sensors, latency_position=lag, latency_heading=lag)
    boat = dataclasses.replace(boat, sensors=late)
    x = jnp.array([0.0, 0.0, 0.4, speed, 0.0, rate])
    found = np.asarray(shown_samples(boat, x, jnp.zeros(3), jnp.zeros(6)))
    before = 0.4 - rate * lag
    north = speed / rate * (math.sin(before) - math.sin(0.4))
    east = -speed / rate * (math.cos(before) - math.cos(0.4))
    np.testing.assert_allclose(found[:3], [north, east, before], atol=speed * rate**2 * lag**3 / 6)


@pytest.mark.parametrize("late", [0.0, 0.3, 0.77, 1.9, 30.0])
def test_every_sample_has_a_row_near_its_time_and_none_is_lost(vessel, late):
    """Two runs, the second with a gap: samples keep their order, their run and their part."""
    push, shown = recorded(np.random.default_rng(1), 120, Gusty(), 0)
    first, second = seen(push, shown), seen(push, shown)
    t = second.t + np.where(np.arange(120) >= 60, 40.0, 0.0)
    problem = make_problem(vessel, [first, dataclasses.replace(second, t=t)], ("X_u",), (LATE,))
    data = problem.dataset
    placement = run_at(problem, late / STEP, Gusty()).gains.placement
    source = np.asarray(placement.source)[:, 3]
    rows = np.flatnonzero(source >= 0)
    known = np.flatnonzero(np.asarray(data.known)[:, 3])
    np.testing.assert_array_equal(source[rows], known)
    part, time = np.asarray(data.part), np.asarray(data.t)
    np.testing.assert_array_equal(part[rows], part[source[rows]])
    assert min(np.bincount(part[np.asarray(data.dt) > 0])) > 60
    if late < 2:  # the lead-in reaches as far
        left = time[rows] - (time[source[rows]] - late)
        assert left.min() > -1e-9 and left.max() < STEP + 1e-9
    # The filter begins anew in every row of a part up to that of its first sample.
    restarts = np.asarray(placement.restarts)
    for k in range(3):
        own = np.flatnonzero(part == k)
        begin = rows[part[rows] == k][0]
        np.testing.assert_array_equal(restarts[own], own <= begin)


@pytest.mark.parametrize("late", [0.35, pytest.param(1.6, marks=pytest.mark.proof)])
def test_fixes_without_velocities_are_late_by_the_same_wherever_a_fit_begins(late):
    """Half and more than twice the time of the vessel; fixes five times a second, with noise."""
    document, effect = load(str(ORACLE / "usv.toml")), EFFECTS["sensor-latency:position"]
    rng, runs = np.random.default_rng(5), []
    for seed in (14, 15):
        run = random_steps(document, seed, 120.0, 0.1)
        known, gone = np.arange(run.t.size) % 2 == 1, np.full_like(run.t, np.nan)
        x, y = (
            np.where(known, np.interp(run.t - late, run.t, one), np.nan)
            + rng.normal(0, 0.03, run.t.size)
            for one in (run.x, run.y)
        )
        runs.append(dataclasses.replace(run, x=x, y=y, u=gone, v=gone).rows(run.t >= 3.0))
    wrong = document["hull"] | {"X_u": -35.0, "N_r": -650.0}
    free = ("X_u", "X_uu", "Y_v", "N_r", effect.name)
    problem = make_problem(build(document | {"hull": wrong}), runs, free[:-1], (effect,))
    size, found = problem.layout.sizes[0][0], []
    for begin in (0.1, 3.0):
        start = np.zeros(problem.layout.size)
        start[-1] = begin / size
        fitted = estimate(problem, free, Start(start))
        found.append((fitted.coordinates[-1] * size, fitted.stds[-1] * size))
    for value, std in found:
        assert abs(value - late) < 3 * std < 0.15
    assert found[0][0] == pytest.approx(found[1][0], abs=0.3 * found[0][1])
