# pyright: reportArgumentType=false
"""Online estimators against textbook recursions in NumPy and runs of the independent simulator."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2
from tests.oracle import sensors
from tests.oracle.make_recordings import MASSES, gust_scale, perform, perturbed, stream
from tests.oracle.simulator import Simulator, load
from tests.paths import ORACLE

from diffsea import Parameter, State, Trajectory, UserError, named
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.online import trust
from diffsea.identification.online.ekf import ExtendedKalmanFilter, kalman_filter
from diffsea.identification.online.guarded import (
    Gate,
    GuardedEstimator,
    calibrate_limits,
    guard_estimator,
    run_least_squares,
    run_online,
)
from diffsea.identification.online.rls import recursive_least_squares
from diffsea.identification.online.trust import StepEvidence
from diffsea.parameters import hull_prior
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build
from diffsea.vessel.forces import SteadyForce


pytestmark = [pytest.mark.slow, pytest.mark.compiles]


HULL = ("X_u", "X_uu", "Y_v", "N_r", "N_rr")
SECONDS, RATE = 120.0, 5.0
T = np.arange(int(SECONDS * RATE) + 1) / RATE
STD = np.array([sensor.noise for sensor in sensors.suite().values()])
SEEDS = range(1, 7)

# Compiled once for all tests.
_guarded_step = eqx.filter_jit(GuardedEstimator.step)
_bare_step = eqx.filter_jit(ExtendedKalmanFilter.step)


@eqx.filter_jit
def _rls_scan(regression, running, rows):
    return jax.lax.scan(lambda now, row: regression.step(now, *row), running, rows)


@pytest.fixture(scope="module")
def document() -> dict:
    return load(str(ORACLE / "usv.toml"))


@pytest.fixture(scope="module")
def vessel(document):
    return build(document)


def _truth(document: dict, seed: int) -> dict:
    """The document with other derivatives; masses are the scale and stay."""
    true = perturbed(document, stream(seed, "hull"))
    true["hull"] |= {name: document["hull"][name] for name in MASSES if name in document["hull"]}
    return true


def _recorded(sim, seed: int, scale: float = 1.0, seconds: float = SECONDS) -> Trajectory:
    t = T[T <= seconds]
    suite = sensors.suite(scale)
    rec = sensors.record(sim, t, suite, stream(seed, "noise"))
    return Trajectory(
        t, **{c: np.asarray(rec[c]) for c in MOTION_CHANNELS},
        commanded={c: np.asarray(rec[f"cmd_{c}"]) for c in ("port", "starboard")},
        executed={}, extra={}, valid=np.ones(len(t), bool), name=f"run{seed}",
    )  # fmt: skip


def _noise(true: dict) -> Noise:
    """What the simulator's gusts and sensors are."""
    std = gust_scale(true)
    return Noise(
        *(jnp.log(jnp.asarray(x)) for x in (1e-3 * std, std, [5.0, 5.0, 3.0], STD, [1e-9]))
    )


@pytest.fixture(scope="module")
def sound(document, vessel) -> list[tuple]:
    """Manoeuvring runs of other vessels, and the filter along them."""
    out = []
    for seed in SEEDS:
        true = _truth(document, seed)
        name = ("random-fast", "zigzag-fast")[seed % 2]
        recording = _recorded(perform(true, name, seed, None, SECONDS, RATE), seed)
        run = run_online(vessel, recording, HULL, noise=_noise(true), drift=1e-3)
        out.append((true, recording, run))
    return out


def _off(run, true: dict) -> np.ndarray:
    """How many standard deviations the last estimates are off."""
    return np.array([(run.estimate[n][-1] - true["hull"][n]) / run.std[n][-1] for n in HULL])


# The extended Kalman filter.


def test_on_a_linear_vessel_it_is_the_kalman_filter(document):
    """Surge of a craft with linear drag, on an unknown steady force, straight north."""
    hull = {k: x for k, x in document["hull"].items() if k not in ("X_uu", "Y_v", "N_r", "N_rr")}
    swell = {"name": "wave-force", "bias": 0.0, "amplitude": 0.0, "frequency": 0.1}
    made = build(document | {"hull": hull, "effect": [swell]})
    force = next(name for name in named(made) if name.endswith("bias_north"))
    inertia, damping, g, scale = 180.0 + 12.0, 52.0, 0.02, 15.0
    noise = Noise(*(jnp.log(jnp.asarray(x)) for x in
                    ([g] * 3, [1e-9] * 3, [5.0] * 3, STD, [1e-9])))  # fmt: skip
    filter = kalman_filter(made, [Parameter(force, 0.0, scale)], noise, drift=0.01)
    belief = filter.init(State(0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    length = 4.9
    mean = np.array([0.0, 1.0, 0.0])
    P = np.diag([length**2, 0.25 * 9.81 * length, 1.0])
    rng = np.random.default_rng(0)
    for k in range(60):
        dt = 0.0 if k == 0 else (0.05, 0.1)[k % 2]
        thrust = 40 * math.sin(0.3 * k)
        A = np.array([[0, 1, 0, 0], [0, -damping / inertia, scale / inertia, 2 * thrust / inertia]])
        F = expm(np.vstack([A, np.zeros((2, 4))]) * dt)
        mean = (F @ [*mean, 1.0])[:3]
        P = F[:3, :3] @ P @ F[:3, :3].T + np.diag([0.0, g**2 * dt, 0.01**2 * dt])
        seen = [0, 1] if k % 3 == 0 else [1]
        z = mean[seen] + rng.normal(0, 0.1, len(seen))
        H, R = np.eye(3)[seen], np.diag(STD[[0, 3]][seen] ** 2)
        S = H @ P @ H.T + R
        nis = (z - mean[seen]) @ np.linalg.solve(S, z - mean[seen])
        K = P @ H.T @ np.linalg.inv(S)
        mean, P = mean + K @ (z - mean[seen]), P - K @ S @ K.T
        measurement = np.full(6, np.nan)
        measurement[np.array([0, 3])[seen]] = z
        orders = {c: jnp.asarray(thrust) for c in made.channels}
        belief, news = _bare_step(filter, belief, orders, jnp.asarray(measurement), jnp.asarray(dt))
        own = [0, 3, belief.mean.size - 1]
        np.testing.assert_allclose(np.asarray(belief.mean)[own], mean, atol=1e-7)
        np.testing.assert_allclose(
            np.asarray(belief.covariance)[np.ix_(own, own)], P, rtol=1e-5, atol=1e-9
        )
        assert float(news.nis) == pytest.approx(nis, rel=1e-5, abs=1e-7)
        assert int(news.used.sum()) == len(seen)


@pytest.mark.proof
def test_estimates_are_within_their_standard_deviations(sound):
    off = np.array([_off(run, true) for true, _, run in sound])
    assert np.abs(off).max() < 3.0
    # Too wide would pass that as well: together they are chi-squared, four pairs of five being
    # nearly one number each; the band is what two to five degrees of freedom per run allow.
    assert chi2.ppf(0.001, 2 * len(sound)) < (off**2).sum() < chi2.ppf(0.999, 5 * len(sound))


def test_estimates_leave_the_nominal_values(sound, document):
    for true, _, run in sound:
        for name in ("Y_v", "N_r"):
            wrong = abs(document["hull"][name] / true["hull"][name] - 1)
            assert abs(run.estimate[name][-1] / true["hull"][name] - 1) < 0.6 * wrong


def test_innovations_are_as_large_as_the_filter_thinks(sound):
    nis = sum(run.nis[25:].sum() for _, _, run in sound)
    degrees = sum(run.degrees[25:].sum() for _, _, run in sound)
    # The models' first errors are in it: the band of one in a thousand, widened by 1 %.
    low, high = chi2.ppf([0.0005, 0.9995], degrees)
    assert 0.99 * low < nis < 1.01 * high


def test_lost_samples_and_other_rates_cost_information_only(sound, vessel):
    true, recording, whole = sound[0]
    gone = np.random.default_rng(1).random(len(T)) < 0.3
    slow = np.arange(len(T)) % 5 != 0
    less = dataclasses.replace(
        recording,
        **{c: np.where(slow, np.nan, getattr(recording, c)) for c in ("x", "y", "u", "v")},
        **{c: np.where(gone, np.nan, getattr(recording, c)) for c in ("psi", "r")},
    )
    run = run_online(vessel, less, HULL, noise=_noise(true), drift=1e-3)
    assert np.abs(_off(run, true)).max() < 3.0
    assert all(run.std[n][-1] > whole.std[n][-1] for n in HULL)
    assert set(run.degrees) <= {0, 1, 2, 4, 5, 6}


def test_a_step_without_measurement_in_between_changes_nothing(vessel, document):
    filter = kalman_filter(vessel, HULL, _noise(document), drift=1e-3)
    belief = filter.init(State(0.0, 0.0, 0.4, 1.5, 0.1, 0.2))
    orders = {"port": jnp.asarray(120.0), "starboard": jnp.asarray(60.0)}
    nothing, advance = jnp.full(6, jnp.nan), _bare_step
    once, news = advance(filter, belief, orders, nothing, jnp.asarray(0.2))
    half = advance(filter, belief, orders, nothing, jnp.asarray(0.1))[0]
    twice = advance(filter, half, orders, nothing, jnp.asarray(0.1))[0]
    assert float(news.nis) == 0 and not news.used.any()
    np.testing.assert_allclose(once.mean, twice.mean, atol=1e-5)
    scale = np.sqrt(np.outer(*2 * [np.diag(once.covariance)])) + 1e-12
    np.testing.assert_allclose(once.covariance / scale, twice.covariance / scale, atol=2e-3)


def test_a_compass_that_was_knocked_is_read_less_what_it_shows_too_much(document, vessel):
    table = {"name": "heading-offset", "angle": 0.4, "time": 5.0}
    knocked = build(document | {"effect": [*document.get("effect", []), table]})
    orders = {"port": jnp.asarray(100.0), "starboard": jnp.asarray(80.0)}
    seen = jnp.array([0.0, 0.0, 0.1, 1.0, 0.0, 0.0])

    def after(boat, t, measured):
        filter = kalman_filter(boat, HULL, _noise(document))
        belief = filter.init(State(0.0, 0.0, 0.1, 1.0, 0.0, 0.0), t=t)
        return filter.update(belief, orders, measured)[0].mean

    shown = seen.at[2].add(0.4)
    np.testing.assert_allclose(after(knocked, 6.0, shown), after(vessel, 6.0, seen), atol=1e-12)
    np.testing.assert_allclose(after(knocked, 4.0, seen), after(vessel, 4.0, seen), atol=1e-12)


def test_a_lag_of_the_thrusters_is_estimated(document):
    lagged = [t | {"time_constant": 0.8} for t in document["thruster"]]
    guess = [t | {"time_constant": 0.5} for t in document["thruster"]]
    sim = perform(document | {"thruster": lagged}, "random-fast", 3, None, 60.0, RATE)
    free = ["port.time_constant", "starboard.time_constant"]
    priors = [hull_prior(n, 0.5) for n in free]
    filter = kalman_filter(build(document | {"thruster": guess}), priors, _noise(document))
    first = sim.at([0.0])
    belief = filter.init(
        State(*(float(first[c][0]) for c in MOTION_CHANNELS)),
        orders={c: float(first[f"cmd_{c}"][0]) for c in ("port", "starboard")},
    )
    recording = _recorded(sim, 3, seconds=60.0)
    motion = np.stack([getattr(recording, c) for c in MOTION_CHANNELS], -1)
    held = {c: np.append(x[:1], x[:-1]) for c, x in recording.commanded.items()}
    rows = jax.tree.map(jnp.asarray, (held, motion, np.diff(recording.t, prepend=0.0)))
    scan = jax.jit(lambda f, b, rows: jax.lax.scan(lambda b, row: f.step(b, *row), b, rows))
    belief, _ = scan(filter, belief, rows)
    std = np.sqrt(np.diag(belief.parameter_covariance)) * np.array(list(belief.values.values()))
    for value, deviation in zip(belief.values.values(), std, strict=True):
        assert abs(float(value) - 0.8) < 3 * deviation < 0.3


# Recursive least squares.


def test_without_noise_least_squares_finds_the_vessel(document, vessel):
    true = _truth(document, 2)
    sim = perform(true, "random-fast", 2, None, SECONDS, RATE, gusts=0.0)
    exact = sensors.record(sim, T, None, None, wrapped=False)
    recording = dataclasses.replace(
        _recorded(sim, 2), **{c: np.asarray(exact[c]) for c in MOTION_CHANNELS}
    )
    run = run_least_squares(vessel, recording, HULL, noise=(0.1, 0.1, 0.1))
    for name in HULL:
        assert run.estimate[name][-1] == pytest.approx(true["hull"][name], rel=0.02)


@pytest.mark.parametrize("memory", [math.inf, 40.0])
def test_recursion_equals_the_weighted_batch(memory, vessel, sound):
    """Stabilised forgetting: weights mu^age on the data, and on the prior all that is left."""
    recording = sound[1][1]
    regression = recursive_least_squares(vessel, HULL, memory=memory)
    running = regression.init(State(*(0.0 for _ in range(6))))
    motion = np.stack([getattr(recording, c) for c in MOTION_CHANNELS], -1)
    held = {c: np.append(x[:1], x[:-1]) for c, x in recording.commanded.items()}
    dt = np.diff(T, prepend=0.0)
    rows = jax.tree.map(jnp.asarray, (held, motion, dt))
    running, news = _rls_scan(regression, running, rows)
    age = dt.sum() - np.cumsum(dt)
    weight = np.exp(-age / memory)[:, None] * np.asarray(news.weight)
    root = np.sqrt(weight).reshape(-1)
    spreads = np.array([p.spread for p in regression.parameters])
    rows = np.asarray(news.regressor).reshape(-1, len(HULL)) * root[:, None]
    target = np.asarray(news.target).reshape(-1) * root
    stacked = np.vstack([rows, np.diag(1 / spreads)])
    batch = np.linalg.lstsq(stacked, np.append(target, np.zeros(len(HULL))), rcond=None)[0]
    assert (weight > 0).sum() > 1500
    np.testing.assert_allclose(running.coordinates, batch, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(
        running.parameter_covariance, np.linalg.inv(stacked.T @ stacked), rtol=1e-7
    )


def test_least_squares_is_within_its_standard_deviations(sound, vessel):
    off = np.array([
        _off(run_least_squares(vessel, recording, HULL), true) for true, recording, _ in sound
    ])  # fmt: skip
    assert np.abs(off).max() < 3.0
    assert np.sqrt(np.mean(off**2)) > 0.3


def test_what_is_not_excited_returns_to_the_prior_and_never_winds_up(document, vessel):
    true = _truth(document, 4)
    sim = perform(true, "zigzag-fast", 4, None, 60.0, RATE, gusts=0.0)
    sim.order({"port": 120.0, "starboard": 120.0})
    sim.run(SECONDS)
    run = run_least_squares(vessel, _recorded(sim, 4), HULL, memory=15.0)
    share = np.diagonal(run.steps.evidence.covariance, axis1=1, axis2=2) / 0.25
    yaw = HULL.index("N_r")
    assert (share < 1 + 1e-9).all()
    assert share[300, yaw] < 0.1 and share[-1, yaw] > 2 * share[300, yaw]


def test_parameters_that_are_not_linear_are_refused(vessel):
    with pytest.raises(UserError, match="not linear in 'current_north'"):
        recursive_least_squares(vessel, ["current_north"])
    moved = Parameter("x_G", 0.0, scale=0.1)
    with pytest.raises(UserError, match="not linear in 'x_G'"):
        recursive_least_squares(vessel, [moved])
    with pytest.raises(UserError, match="do not contain"):
        recursive_least_squares(vessel, [Parameter("sensors.gyro_bias", 0.0, 0.01)])


def test_bad_choices_are_told(vessel, document):
    noise = _noise(document)
    for free, message in (
        ((), "nothing to estimate"),
        (("N_rrr",), "no parameter 'N_rrr'"),
        (("N_r", "N_r"), "chosen twice"),
        (("sensors.gyro_bias",), "zero in the vessel"),
    ):
        with pytest.raises(UserError, match=message):
            kalman_filter(vessel, free, noise)
    with pytest.raises(UserError, match="drift"):
        kalman_filter(vessel, HULL, noise, drift={"N_rrr": 0.1})
    with pytest.raises(UserError, match="zero or more"):
        kalman_filter(vessel, HULL, noise, drift=-1.0)
    with pytest.raises(UserError, match="no such actuator"):
        kalman_filter(vessel, HULL, noise, measured=("rudder",))


# Trust and gate.


def _evidence(limits, white, coordinates=None, variance=0.01, change=None) -> StepEvidence:
    n = len(limits.parameters)
    zero = jnp.zeros(n)
    return StepEvidence(
        jnp.asarray(white), jnp.ones(6), zero if change is None else change, jnp.full(n, 1e-4),
        zero if coordinates is None else jnp.asarray(coordinates), variance * jnp.eye(n),
    )  # fmt: skip


@pytest.fixture(scope="module")
def limits(vessel):
    parameters = [hull_prior(n, float(named(vessel)[n])) for n in HULL]
    parameters = [dataclasses.replace(p, scale=p.std / p.spread, lower=-math.inf, upper=math.inf)
                  for p in parameters]  # fmt: skip
    return trust.trust_limits(vessel, parameters, MOTION_CHANNELS, 10.0, 600.0)


def test_false_alarms_come_as_seldom_as_asked_for(limits):
    """White noise for four hours: alarms of the innovations, counted once within a window."""
    runs, rows, dt = 20, 3800, 0.2
    limits = eqx.tree_at(lambda at: at.false_alarm_interval, limits, jnp.asarray(60.0))

    @jax.jit
    def quiet(key):
        white = jax.random.normal(key, (rows, 6))

        def body(memory, row):
            memory, verdict = trust.assess(limits, memory, _evidence(limits, row), dt)
            return memory, verdict.innovations

        return jax.lax.scan(body, limits.init(), white)[1]

    answers = np.array(jax.lax.map(quiet, jax.random.split(jax.random.key(0), runs)))[:, 200:]
    low = answers <= trust.ALARM_TRUST
    again = np.array([np.convolve(row, np.ones(50))[: row.size] for row in low]) > 0
    alarms = (again[:, 1:] & ~again[:, :-1]).sum()
    expected = runs * (rows - 200) * dt / 60.0
    assert 0.4 * expected < alarms < 1.6 * expected
    assert (answers < 1).mean() == pytest.approx(0.05, abs=0.02)


def test_each_question_has_its_own_reason(limits):
    zero, rng = jnp.zeros(5), np.random.default_rng(5)

    @jax.jit
    def judged(white, coordinates, variance, change):
        def body(memory, row):
            evidence = _evidence(limits, row, coordinates, variance, change)
            return trust.assess(limits, memory, evidence, 0.2)

        found = jax.lax.scan(body, limits.init(), white)[1]
        return jax.tree.map(lambda leaf: leaf[-1], found)

    def verdict(offset=0.0, scale=1.0, coordinates=zero, variance=0.01, change=zero):
        white = rng.normal(size=(300, 6)) * scale + offset
        return judged(white, jnp.asarray(coordinates, float), variance, jnp.asarray(change, float))

    sound = verdict()
    assert float(sound.value) > 0.75 and not trust.reasons(limits, sound)
    cases = (
        (verdict(offset=np.array([0, 0, 0, 0, 0, 0.8])), "innovation of yaw rate is biased"),
        (verdict(scale=1.6), "scatters too much"),
        (verdict(variance=0.24), "manoeuvre more"),
        (verdict(variance=0.6), "known less than beforehand"),
        (verdict(coordinates=[0, 0, 0, 0, 4.0]), "N_rr is 8.0 standard deviations"),
        (verdict(coordinates=[0, 0, 2.5, 0, 0]), "put energy"),
        (verdict(change=[0, 0.01, 0, 0, 0]), "X_uu has moved"),
    )
    for found, words in cases:
        assert float(found.value) <= 0.5
        assert words in trust.reasons(limits, found)[0]


def test_a_negative_mass_is_not_trusted(vessel):
    mass = Parameter("Y_vdot", -120.0, scale=120.0)
    limits = trust.trust_limits(vessel, [mass], MOTION_CHANNELS)
    found = trust.assess(limits, limits.init(), _evidence(limits, np.zeros(6), [2.6]), 0.2)[1]
    assert not found.inertia and float(found.bounds) == 0
    assert "mass matrix" in " ".join(trust.reasons(limits, found))


def test_a_disturbance_may_drive_the_vessel(vessel):
    # Only what resists must brake: an estimated wind or current pushes.
    vessel = dataclasses.replace(vessel, forces=vessel.forces | {"steady": SteadyForce()})
    push = Parameter("steady.north", 0.0, scale=500.0)
    limits = trust.trust_limits(vessel, [push], MOTION_CHANNELS)
    found = trust.assess(limits, limits.init(), _evidence(limits, np.zeros(6), [1.0]), 0.2)[1]
    assert found.drag and float(found.bounds) == 1


def test_a_steady_force_stays_in_the_earth(vessel):
    force = SteadyForce(north=3.0, east=4.0, moment=5.0)
    heading = dataclasses.replace(State(0.0, 0.0, 0.0, 1.0, 0.0, 0.0), psi=jnp.pi / 2)
    made = force(heading, vessel.environment, 0.0)
    np.testing.assert_allclose(made.stacked, [4.0, -3.0, 5.0], atol=1e-12)


def test_calibration_finds_the_scale_of_sound_innovations(limits):
    rng, rows = np.random.default_rng(2), 2000
    one = _evidence(limits, np.zeros(6))
    series = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (rows, *np.shape(leaf))), one)
    series = eqx.tree_at(lambda e: e.white, series, 2.0 * rng.normal(size=(rows, 6)))
    new = trust.calibrate(limits, [series], [np.full(rows, 0.2)])
    np.testing.assert_allclose(new.scale, 2.0, rtol=0.1)
    assert (np.asarray(new.width.bias) >= 1).all() and np.asarray(new.width.bias).max() < 2.5


def test_the_gate_opens_late_closes_at_once_and_forgets_what_waited():
    gate = Gate(jnp.asarray(8.0))
    passage = gate.init(1)
    log = []
    level = [0.9] * 30 + [0.6] * 5 + [0.4] + [0.7] * 20 + [0.9] * 30
    advance = jax.jit(Gate.step)
    for k, trusted in enumerate(level):
        passage = advance(gate, passage, jnp.array([float(k + 1)]), jnp.asarray(trusted), 1.0)
        log.append((float(passage.handed[0]), bool(passage.open)))
    handed, is_open = (np.array(column) for column in zip(*log, strict=True))
    assert not is_open[:7].any() and is_open[7:35].all()  # 0.6 does not close it
    # What is handed on is at least 8 s old, hardly older, and nothing from the last 8 s
    # before the alarm ever passes.
    waited = np.arange(1, len(level) + 1) - handed
    assert (waited[handed > 0] >= 8).all() and (waited[10:35] <= 10).all()
    assert not is_open[35:63].any() and is_open[63:].all()  # 0.7 does not open it
    after = handed[35:]
    assert (after[after <= 36] <= 28).all() and after[-1] > 64


def test_sound_runs_are_not_blocked(sound):
    for _, _, run in sound:
        assert (run.steps.trust.fault > trust.ALARM_TRUST).all()
        assert run.open[T > 90.0].all(), run.reasons(int(np.argmin(run.trust)))
        assert not run.steps.restarted.any()
        # Closed until the data have said something, then open for good.
        assert (
            np.diff(run.open.astype(int)).sum() == np.abs(np.diff(run.open.astype(int))).sum() == 1
        )


def test_a_changed_drag_reaches_the_controller(document, vessel):
    true = _truth(document, 3)
    effect = {"drag-change": {"time": 50.0, "factor": 0.5}}
    sim = perform(true, "random-fast", 3, effect, SECONDS, RATE)
    run = run_online(vessel, _recorded(sim, 3), HULL, noise=_noise(true), drift=1e-3)
    before, after = (run.handed["N_r"][k] / true["hull"]["N_r"] for k in (245, -1))
    assert before == pytest.approx(1.0, abs=0.15) and after == pytest.approx(1.5, abs=0.2)
    assert run.open[-1]


# In a closed loop.


def _loop(document, vessel, seed: int, fault: str, gated: bool, seconds: float = 80.0):
    """Course changes by an autopilot whose gains come from the estimates; fault from 60 s on.

    Returns the largest relative error of what the controller was given after the fault, and
    the share of that time in which the gate was open.
    """
    true = _truth(document, seed)
    rng = stream(seed, "loop")
    blow = sensors.gust(rng, 0.0, seconds, gust_scale(true))
    effects = {"thrust-asymmetry": {"ratio": 0.1}} if fault == "straight" else None
    sim = Simulator(true, effects, (0, 0, 0.3, 2.0, 0, 0), 100.0, gust=blow,
                    rtol=1e-6, atol=1e-8, max_step=0.5)  # fmt: skip
    filter = kalman_filter(vessel, HULL, _noise(true), drift=2e-3)
    settled = {"port": 100.0, "starboard": 100.0}
    belief = filter.init(State(0.0, 0.0, 0.3, 2.0, 0.0, 0.0), orders=settled)
    guard = guard_estimator(filter)
    now = guard.init(belief)
    inertia, worst, opened, frozen = float(vessel.mass_matrix()[2, 2]), 0.0, [], None
    held = {"port": 100.0, "starboard": 100.0}
    truth = np.array([true["hull"][n] for n in HULL])
    for k in range(int(seconds * RATE)):
        seen = sim.at([k / RATE])
        m = np.array([seen[c][0] for c in MOTION_CHANNELS]) + STD * rng.standard_normal(6)
        if k / RATE >= 60.0:
            frozen = m[2] if frozen is None else frozen
            m[2] = frozen if fault == "frozen heading" else m[2]
            m[5] += math.radians(3.0) if fault == "gyro bias" else 0.0
        row = (
            {c: jnp.asarray(x) for c, x in held.items()},
            jnp.asarray(m),
            jnp.asarray(0.2 * (k > 0)),
        )
        if gated:
            now, out = _guarded_step(guard, now, *row)
            given, is_open = out.handed, bool(out.open)
        else:
            belief, _ = _bare_step(filter, belief, *row)
            given, is_open = belief.coordinates, True
        values = np.array([float(p.decode(c)) for p, c in
                           zip(filter.parameters, np.asarray(given), strict=True)])  # fmt: skip
        if k / RATE >= 60.0:
            worst = max(worst, np.abs(values / truth - 1).max())
            opened.append(is_open)
        side = 0 if fault == "straight" else (1 if int(k / RATE / 12) % 2 else -1)
        error = 0.3 + math.radians(25.0) * side - m[2]
        yaw = dict(zip(HULL, values, strict=True))
        moment = (
            inertia * (0.49 * error - m[5]) - yaw["N_r"] * m[5] - yaw["N_rr"] * abs(m[5]) * m[5]
        )
        half = float(np.clip(moment / 2.06, -100, 100))
        held = {"port": 130 + half, "starboard": 130 - half}
        sim.order(held)
        sim.run((k + 1) / RATE)
    return worst, float(np.mean(opened))


@pytest.mark.proof
@pytest.mark.parametrize(("fault", "seeds"), [("frozen heading", (1, 2)), ("gyro bias", (1,))])
def test_a_bad_estimate_does_not_reach_the_controller(document, vessel, fault, seeds):
    for seed in seeds:
        nominal = max(
            abs(document["hull"][n] / _truth(document, seed)["hull"][n] - 1) for n in HULL
        )
        bare, _ = _loop(document, vessel, seed, fault, gated=False)
        given, opened = _loop(document, vessel, seed, fault, gated=True)
        assert given < max(0.4, 1.05 * nominal) and given < 0.6 * bare
        assert opened < 0.1


def test_without_a_fault_the_loop_runs_on_estimates(document, vessel):
    given, opened = _loop(document, vessel, 2, "none", gated=True)
    assert opened == 1.0 and given < 0.35


def test_a_straight_run_hands_on_nothing_that_it_does_not_tell(document, vessel):
    """Thrusters unlike one another push the yaw estimates about; the run says nothing of them."""
    nominal = max(abs(document["hull"][n] / _truth(document, 1)["hull"][n] - 1) for n in HULL)
    given, opened = _loop(document, vessel, 1, "straight", gated=True)
    assert opened == 0 and given == pytest.approx(nominal)


def test_calibrated_limits_come_from_runs(sound, vessel):
    runs = [run for _, _, run in sound]
    made = calibrate_limits(runs)
    assert (np.asarray(made.scale) < 1.2).all() and (np.asarray(made.width.moved) < 1.6).all()
    with pytest.raises(UserError, match="six windows"):
        calibrate_limits([])
