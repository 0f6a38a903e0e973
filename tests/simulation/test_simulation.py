"""The simulator against an independent one, its own derivatives against differences, physics.

The reference is `tests/oracle`: DOP853 to 1e-11, restarted at every switch and kink.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle import trials as oracle
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE
from tests.runs import (
    CALM,
    columns,
    disagreement,
    executed,
    run,
    settled,
    state_of,
    trajectory,
    varied,
)

from diffsea import Environment, Outcome, State, Vessel, named, read_vessel, replace, run_trial
from diffsea.metrics import turning_metrics, zigzag_metrics
from diffsea.simulation.control import ControlAllocation, speed_for, throttle_for
from diffsea.simulation.integrate import advance
from diffsea.simulation.manoeuvres import turning_circle, zigzag
from diffsea.simulation.trials import TrialSettings
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles


USV, BOAT = load(ORACLE / "usv.toml"), load(ORACLE / "boat.toml")
# A modulus |r| r has a jump in its second derivative where the yaw rate changes sign, which
# costs any Runge-Kutta step its order; a cubic is as steep and smooth.
SMOOTH = varied(USV, {"N_rr": None, "N_rrr": -2000.0})
THRUST, SPEED = 200.0, 1.2  # N, m/s
ANGLE = math.radians(20)


# -- against the independent simulator ---------------------------------------------------


def test_a_zigzag_in_wind_and_current_agrees_with_the_independent_simulator():
    effects = [
        {"name": "current", "speed": 0.25, "direction": 0.7},
        {"name": "wind", "speed": 6.0, "direction": 2.1},
        {"name": "crossflow-drag", "cd": 0.9},
    ]
    document = varied(USV, {"N_rr": None}, effects=effects)
    reference = oracle.zigzag(document, THRUST, executes=5, speed=SPEED, heading0=0.3)
    vessel = build(document)
    state = state_of(psi=0.3, u=SPEED)
    stages = zigzag(ANGLE, ANGLE, 5)
    carry, rows = run(vessel, stages, state, THRUST, vessel.environment, 0.04, 45.0)
    np.testing.assert_allclose(carry.switch_times[:4], reference.switches[1:], rtol=1e-7)
    t, found = columns(rows, until=reference.sim.t)
    assert t[-1] > 25
    assert disagreement(found, reference.sim.at(t)) < 1e-6


# Stages that are all there, so that one program runs every case.
def servo(time_constant=0.0, rate_limit=1e9, delay=0.0):
    return {"time_constant": time_constant, "rate_limit": rate_limit, "delay": delay}


DELAYS = np.linspace(0.3, 0.4, 6)
CASES = {  # documents, and the least order in the step that a zig-zag must converge with
    "direct": ([varied(SMOOTH, servo={})], 3.8),
    "lag": ([varied(SMOOTH, servo=servo(0.7))], 3.8),
    "rate limit": ([varied(SMOOTH, servo=servo(0.0, 60.0))], 3.8),
    "delay, lag and rate limit": ([varied(SMOOTH, servo=servo(0.7, 60.0, 0.33))], 3.8),
    # A jump inside a step: third order, with a factor that depends on where it falls.
    "delay alone": ([varied(SMOOTH, servo=servo(delay=float(d))) for d in DELAYS], 2.7),
    # So does a kink in the second derivative of the yaw rate's drag.
    "modulus": ([varied(USV, {"N_rr": float(d)}) for d in np.linspace(-700, -500, 6)], 2.5),
}


@pytest.mark.proof
@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_zigzag_converges_through_its_events(case):
    documents, order = CASES[case]
    steps = np.array([0.1, 0.05, 0.025])
    errors = np.zeros((len(documents), len(steps), 2))
    for document, row in zip(documents, errors, strict=True):
        reference = oracle.zigzag(document, THRUST, executes=4, speed=SPEED)
        arguments = build(document), zigzag(ANGLE, ANGLE, 4), state_of(u=SPEED), THRUST, CALM
        for k, step in enumerate(steps):
            carry, rows = run(*arguments, step, 30.0, 0.6)
            t, found = columns(rows, until=reference.sim.t)
            times = np.asarray(carry.switch_times[:3]) - reference.switches[1:]
            row[k] = disagreement(found, reference.sim.at(t)), np.max(np.abs(times))
    size = np.sqrt(np.mean(errors**2, axis=0))
    slopes = np.polyfit(np.log(steps), np.log(size), 1)[0]
    assert np.all(slopes > order)
    assert size[-1, 0] < 2e-6


@pytest.mark.slow
def test_a_boat_with_every_actuator_stage_converges_to_the_independent_simulator():
    arguments = build(BOAT), zigzag(ANGLE, ANGLE, 4), state_of(u=0.8), 8.0, CALM
    reference = oracle.zigzag(BOAT, 8.0, executes=4, speed=0.8)
    errors = []
    for step in (0.08, 0.01):
        _, rows = run(*arguments, step, 20.0, 0.15)
        t, found = columns(rows, until=reference.sim.t)
        errors.append(disagreement(found, reference.sim.at(t)))
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] > 8**2.5  # |r| r and |v| v change sign: not the full order


# -- derivatives --------------------------------------------------------------------------


PARAMETERS = ("N_r", "mass", "X_udot", "Y_vdot", "port.x", "current_north", "current_east")
DRIFTING = varied(SMOOTH, effects=[{"name": "current", "speed": 0.25, "direction": 0.7}])
for thruster in DRIFTING["thruster"]:
    thruster["angle"] = 0.05  # else its place along the hull would not matter
LAGGING = varied(SMOOTH, servo={"time_constant": 0.7, "rate_limit": 60.0})


def moved(document, name, change):
    """The document with one parameter changed."""
    new = varied(document)
    if name.startswith("current"):
        (effect,) = new["effect"]
        north = effect["speed"] * math.cos(effect["direction"])
        east = effect["speed"] * math.sin(effect["direction"])
        flow = (north + change, east) if name.endswith("north") else (north, east + change)
        effect |= {"speed": math.hypot(*flow), "direction": math.atan2(flow[1], flow[0])}
    elif "." in name:
        new["thruster"][0][name.split(".")[1]] += change
    else:
        new["hull"][name] += change
    return new


def differences(document, metrics, names):
    """Differences of order four of the independent simulator's numbers by each parameter."""
    vessel, table = build(document), []
    for name in names:
        h = 4e-3 * max(abs(float(named(vessel)[name])), 0.1)
        by = {k: np.array(metrics(moved(document, name, k * h))) for k in (-2, -1, 1, 2)}
        table.append((8 * (by[1] - by[-1]) - (by[2] - by[-2])) / (12 * h))
    return np.stack(table, axis=1)


def by_parameters(metrics, vessel, names):
    """`metrics` as a function of the named parameters, and their values."""
    at = jnp.array([float(named(vessel)[name]) for name in names])
    return lambda values: metrics(replace(vessel, dict(zip(names, values, strict=True)))), at


def largest_error(found, truth, at, values):
    """Relative error of a Jacobian's entries; those under 1 % per 100 % count as 1 %."""
    scale = np.abs(values)[:, None] / np.maximum(np.abs(at), 0.1)
    return np.max(np.abs(found - truth) / np.maximum(np.abs(truth), 1e-2 * scale))


def oracle_zigzag(document):
    trial = oracle.zigzag(document, THRUST, executes=4, speed=SPEED)
    return [*trial.switches[1:4], *trial.overshoots[:2]]


def library_zigzag(vessel):
    stages = zigzag(ANGLE, ANGLE, 4)
    carry, rows = executed(
        vessel, stages, state_of(u=SPEED), THRUST, vessel.environment, 0.02, 26.0
    )
    executes = jnp.concatenate([jnp.zeros(1), carry.switch_times])
    numbers = zigzag_metrics(trajectory(rows), executes, psi0=0.0)
    overshoots = [numbers["overshoot_1"], numbers["overshoot_2"]]
    return jnp.stack([*carry.switch_times[:3], *overshoots])


def oracle_circle(document):
    trial = oracle.circle(document, THRUST, speed=SPEED, turns=0.6)
    names = ("advance", "transfer", "tactical_diameter")
    return [*(trial.metrics[name] for name in names), *trial.switches[:2]]


def library_circle(vessel):
    stages = turning_circle(math.radians(35), 1.2 * math.pi)
    _, rows = executed(vessel, stages, state_of(u=SPEED), THRUST, vessel.environment, 0.02, 24.0)
    numbers = turning_metrics(trajectory(rows), 0.0, 1.0, psi0=0.0)
    names = ("advance", "transfer", "tactical_diameter", "time_to_90", "time_to_180")
    return jnp.stack([numbers[name] for name in names])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("metrics", "reference"),
    [
        (library_zigzag, oracle_zigzag),
        pytest.param(library_circle, oracle_circle, marks=pytest.mark.proof),
    ],
)
def test_derivatives_of_trial_numbers_are_those_of_the_independent_simulator(metrics, reference):
    function, at = by_parameters(metrics, build(DRIFTING), PARAMETERS)
    truth = differences(DRIFTING, reference, PARAMETERS)
    values = np.array(reference(DRIFTING))
    np.testing.assert_allclose(jax.jit(function)(at), values, rtol=2e-6)
    forward = jax.jit(jax.jacfwd(function))(at)
    assert largest_error(forward, truth, at, values) < 1e-5


@pytest.mark.slow
def test_reverse_mode_gives_the_derivatives_of_forward_mode():
    function, at = by_parameters(library_zigzag, build(DRIFTING), PARAMETERS)
    weights = jnp.array([1.0, -2.0, 0.5, 30.0, -50.0])
    forward = weights @ jax.jit(jax.jacfwd(function))(at)
    reverse = jax.jit(jax.grad(lambda values: weights @ function(values)))(at)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)


@pytest.mark.slow
def test_an_event_on_the_boundary_of_a_step_keeps_its_derivatives():
    vessel, step, grid_time = build(LAGGING), 0.05, 3.4
    arguments = vessel, zigzag(ANGLE, 3.0, 2), state_of(u=SPEED), THRUST, CALM, step, 12.0
    t, motion = columns(run(*arguments)[1])
    boundary = motion["psi"][np.argmin(np.abs(t - grid_time))]
    names = ("N_r", "mass", "port.time_constant", "port.rate_limit")

    def numbers(vessel, heading):
        stages = zigzag(ANGLE, heading, 2)
        carry, rows = executed(vessel, stages, state_of(u=SPEED), THRUST, CALM, step, 12.0)
        executes = jnp.stack([0.0, carry.switch_times[0]])
        overshoot = zigzag_metrics(trajectory(rows), executes, psi0=0.0)["overshoot_1"]
        return jnp.stack([*carry.switch_times, overshoot])

    function, at = by_parameters(lambda v: lambda h: numbers(v, h), vessel, names)
    jacobian = jax.jit(jax.jacfwd(lambda values, heading: function(values)(heading)))

    def reference(document):
        trial = oracle.zigzag(document, THRUST, ANGLE, boundary, executes=3, speed=SPEED)
        return [*trial.switches[1:3], trial.overshoots[0]]

    truth, values = differences(LAGGING, reference, names), np.array(reference(LAGGING))
    # At the end of one step, and at the start of the next.
    for heading in (boundary, np.nextafter(boundary, 1.0)):
        assert abs(float(jax.jit(numbers)(vessel, heading)[0]) - grid_time) < 1e-14
        assert largest_error(jacobian(at, heading), truth, at, values) < 1e-5


@pytest.mark.slow
def test_derivatives_are_right_where_no_event_comes():
    names = ("N_r", "mass", "X_u")

    def metrics(vessel):
        stages = zigzag(ANGLE, 3.0, 3)
        carry, rows = executed(vessel, stages, state_of(u=SPEED), THRUST, CALM, 0.05, 4.0)
        end = jnp.sum(rows.accepted) - 1
        last = jnp.stack([getattr(rows.state, c)[end] for c in MOTION_CHANNELS])
        return jnp.where(jnp.all(jnp.isnan(carry.switch_times)), last, jnp.nan)

    def reference(document):
        command = oracle.twin(document, THRUST, ANGLE)
        run = simulate(document, [(0, command)], 4.0, state=(0, 0, 0, SPEED, 0, 0))
        return [run.at([4.0])[c][0] for c in MOTION_CHANNELS]

    function, at = by_parameters(metrics, build(SMOOTH), names)
    truth, values = differences(SMOOTH, reference, names), np.array(reference(SMOOTH))
    assert largest_error(jax.jit(jax.jacrev(function))(at), truth, at, values) < 1e-5


def flipped_at_the_sample(vessel, step, seconds):
    """First overshoot of a zig-zag whose order changes at the first sample past the angle."""
    allocation = ControlAllocation(vessel)
    motion = settled(vessel, state_of(u=SPEED), THRUST, step)

    def body(carry, _):
        motion, side = carry
        motion = advance(vessel, motion, allocation.orders(THRUST, side * ANGLE), CALM, 0.0, step)
        psi = motion.state.psi
        side = jnp.where(side * psi >= ANGLE, -side, side)
        return (motion, side), psi

    _, psi = jax.lax.scan(body, (motion, jnp.ones(())), length=round(seconds / step))
    return jnp.max(psi) - ANGLE


def located_in_the_step(vessel, step, seconds):
    stages = zigzag(ANGLE, ANGLE, 2)
    carry, rows = executed(vessel, stages, state_of(u=SPEED), THRUST, CALM, step, seconds)
    executes = jnp.stack([0.0, carry.switch_times[0]])
    return zigzag_metrics(trajectory(rows), executes, psi0=0.0)["overshoot_1"]


@pytest.mark.slow
def test_only_located_events_have_derivatives_that_converge():
    names = ("N_r", "N_rdot")
    truth = differences(
        USV, lambda d: oracle.zigzag(d, THRUST, executes=2, speed=SPEED).overshoots[:1], names
    )[0]
    slopes = {}
    for scheme in (located_in_the_step, flipped_at_the_sample):
        for step in (0.2, 0.02):
            metrics = functools.partial(scheme, step=step, seconds=6.0)
            function, at = by_parameters(metrics, build(USV), names)
            slopes[scheme, step] = jax.jit(jax.jacfwd(function))(at) / truth
    np.testing.assert_allclose(slopes[located_in_the_step, 0.2], 1, rtol=1e-2)
    np.testing.assert_allclose(slopes[located_in_the_step, 0.02], 1, rtol=1e-5)
    # The factor by which the naive scheme is wrong stays as the step goes to zero.
    naive = np.array([slopes[flipped_at_the_sample, step] for step in (0.2, 0.02)])
    assert np.all(np.abs(naive - 1) > 0.5)
    assert np.all(naive[:, 1] < 0)


# -- batches and outcomes ----------------------------------------------------------------


def same(found, expected, tolerance):
    """Whether two trees of numbers agree; NaN where the other is."""
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance)


@pytest.mark.slow
def test_a_batch_is_its_runs_and_a_diverging_one_spoils_only_itself():
    drag = jnp.array([-30.0, 4e4, -52.0, -90.0])
    vessel, stages = build(USV), zigzag(ANGLE, ANGLE, 3)

    def numbers(X_u):
        changed = replace(vessel, {"X_u": X_u})
        carry, rows = executed(changed, stages, state_of(u=SPEED), THRUST, CALM, 0.1, 20.0)
        return carry.diverged, carry.switch_times, rows

    single = jax.jit(numbers)
    together = jax.jit(jax.vmap(numbers))(drag)
    for k, X_u in enumerate(drag):
        ours = jax.tree.map(lambda leaf, k=k: leaf[k], together)
        alone = single(X_u)
        np.testing.assert_array_equal(ours[2].accepted, alone[2].accepted)
        same(ours, alone, 1e-12)
    diverged, _, rows = together
    np.testing.assert_array_equal(diverged, [False, True, False, False])
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(rows))
    assert np.sum(rows.accepted[1]) < 20 < np.sum(rows.accepted[0])


@pytest.mark.slow
def test_a_run_without_compilation_is_the_compiled_one():
    arguments = build(LAGGING), zigzag(ANGLE, 0.01, 2), state_of(u=0.8), 150.0, CALM, 0.4, 1.2
    carry, rows = run(*arguments)
    assert np.isfinite(carry.switch_times[0])
    with jax.disable_jit():
        plain, plain_rows = executed(*arguments)
    same((carry.switch_times, rows), (plain.switch_times, plain_rows), 1e-10)


@functools.partial(jax.jit, static_argnames="settings")
def trial_of(vessel, heading=ANGLE, settings=None, **options):
    settings = settings or TrialSettings(step=0.2, seconds=30.0)
    stages = zigzag(ANGLE, heading, 3)
    return run_trial(vessel, stages, settings=settings, approach_seconds=100.0, **options)


@pytest.mark.proof
@pytest.mark.slow
def test_diverging_runs_spoil_no_other_derivative():
    vessel = build(USV)

    def second_switch(values):
        changed = replace(vessel, {"X_u": values[0], "N_r": values[1]})
        return trial_of(changed, speed=SPEED).switch_times[1]

    def total(values):
        times = jax.vmap(second_switch)(values)
        return jnp.sum(jnp.where(jnp.isnan(times), 0.0, times))

    # The second diverges in the approach, the third after the execute.
    values = jnp.array([[-30.0, -900.0], [4e4, -900.0], [-52.0, 3e4]])
    slopes = jax.jit(jax.grad(total))(values)
    assert np.all(np.isfinite(slopes))
    assert np.all(slopes[0] != 0)
    assert np.all(slopes[1:] == 0)


@pytest.mark.slow
def test_the_outcome_says_how_a_trial_ended():
    vessel = build(USV)
    done = trial_of(vessel, speed=SPEED)
    assert Outcome(int(done.trajectory.outcome)) is Outcome.COMPLETED
    assert np.all(np.isfinite(done.switch_times))
    late = trial_of(vessel, heading=6.0, speed=SPEED)
    assert Outcome(int(late.trajectory.outcome)) is Outcome.TIME_LIMIT
    assert np.all(np.isnan(late.switch_times))
    assert np.max(late.trajectory.t) == pytest.approx(float(late.execute_time) + 30.0)
    wild = trial_of(replace(vessel, {"N_r": 3e4}), speed=SPEED)
    assert Outcome(int(wild.trajectory.outcome)) is Outcome.DIVERGED
    lost = trial_of(replace(vessel, {"X_u": 4e4}), speed=SPEED)
    assert Outcome(int(lost.trajectory.outcome)) is Outcome.DIVERGED
    assert not np.any(np.asarray(lost.trajectory.valid) & (np.asarray(lost.stage) >= 0))
    # 5 m/s is beyond what its thrusters can push: it never gets there.
    slow = trial_of(vessel, speed=5.0)
    assert Outcome(int(slow.trajectory.outcome)) is Outcome.APPROACH_UNSTEADY
    assert np.all(np.isnan(slow.switch_times))
    executing = np.asarray(slow.stage) >= 0
    assert not np.any(np.asarray(slow.trajectory.valid) & executing)
    for trial in (done, late, wild, lost, slow):
        kept = np.asarray(trial.trajectory.valid)
        motion = [np.asarray(getattr(trial.trajectory, c))[kept] for c in MOTION_CHANNELS]
        assert np.all(np.isfinite(motion))
        assert np.all(np.diff(np.asarray(trial.trajectory.t)[kept]) >= 0)


@pytest.mark.slow
def test_a_trial_with_delayed_actuators_can_be_compiled():
    document = varied(USV, servo={"delay": 0.33})
    settings = TrialSettings(step=0.1, seconds=12.0, longest_delay=0.5)
    trial = trial_of(build(document), settings=settings, speed=SPEED)
    total = oracle.thrust_for_speed(document, SPEED)
    reference = oracle.zigzag(document, total, executes=2, speed=SPEED)
    first = float(trial.switch_times[0] - trial.execute_time)
    assert first == pytest.approx(reference.switches[1], rel=1e-5)


# -- approach ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wamv", "kvlcc2", "otter"])
def test_throttle_and_speed_of_a_straight_run_are_inverse(name):
    vessel = read_vessel(name).vessel
    for speed in (0.5, 1.1):
        assert float(speed_for(vessel, throttle_for(vessel, speed))) == pytest.approx(speed)


@pytest.mark.slow
def test_the_approach_holds_its_speed_over_ground_in_wind_and_current():
    environment = Environment(0.2, -0.15, -3.0, 4.0)
    document = varied(USV, effects=[{"name": "wind", "speed": 0.0}])
    trial = trial_of(build(document), speed=SPEED, environment=environment)
    assert int(trial.trajectory.outcome) == Outcome.COMPLETED
    at = np.flatnonzero(np.asarray(trial.stage) == 0)[0]
    assert trial.trajectory.u[at] == pytest.approx(SPEED, rel=2e-3)
    assert abs(trial.trajectory.r[at]) < 1e-3
    assert abs(trial.trajectory.v[at]) > 0.01


def test_a_given_throttle_is_left_alone_in_a_current():
    trial = trial_of(build(USV), throttle=THRUST, environment=Environment(-0.3, 0.0))
    approach = np.asarray(trial.stage) == -1
    pushed = np.sum(list(trial.trajectory.commanded.values()), axis=0)[approach]
    np.testing.assert_allclose(pushed, THRUST, rtol=1e-12)
    at = np.flatnonzero(np.asarray(trial.stage) == 0)[0]
    still = float(speed_for(build(USV), THRUST))
    assert trial.trajectory.u[at] == pytest.approx(still - 0.3, rel=1e-2)


# -- physics ------------------------------------------------------------------------------


def glide(vessel, state, environment, steps, step):
    """States of a vessel under zero orders; `environment` holds throughout."""
    motion = settled(vessel, state, 0.0, step)
    orders = ControlAllocation(vessel).orders(0.0, 0.0)

    def body(motion, _):
        motion = advance(vessel, motion, orders, environment, 0.0, step)
        return motion, motion.state

    return jax.lax.scan(body, motion, length=steps)[1]


def energy(vessel: Vessel, states: State):
    nu = jnp.stack([states.u, states.v, states.r], axis=-1)
    return 0.5 * jnp.einsum("...i,ij,...j->...", nu, vessel.mass_matrix(), nu)


BARE = {"format": 1, "hull": {
    "length": 2.0, "beam": 0.6, "draught": 0.2, "mass": 60.0, "I_z": 18.0, "x_G": 0.12,
    "X_udot": -6.0, "Y_vdot": -45.0, "Y_rdot": 1.5, "N_vdot": 1.5, "N_rdot": -9.0,
}}  # fmt: skip


def test_energy_is_conserved_without_damping_or_thrust():
    vessel = build(BARE)
    states = jax.jit(lambda s: glide(vessel, s, CALM, 400, 0.01))(
        state_of(psi=0.4, u=1.5, v=-0.4, r=0.6)
    )
    total = energy(vessel, states)
    np.testing.assert_allclose(total, total[0], rtol=1e-8)
    assert np.ptp(states.u) > 0.1  # momentum goes round among the axes meanwhile


@pytest.mark.slow
@pytest.mark.parametrize("name", ["otter", "wamv", "blueboat", "usv", "strip"])
def test_damping_never_adds_energy(name):
    if name == "strip":
        vessel = build(varied(BARE, effects=[{"name": "crossflow-drag", "cd": 1.1}]))
    else:
        vessel = build(USV) if name == "usv" else read_vessel(name).vessel
    states = 2 * np.random.default_rng(5).standard_normal((200, 3))
    for u, v, r in states:
        parts = [f(state_of(u=u, v=v, r=r), CALM, 0.0) for f in vessel.forces.values()]
        power = sum(float(p.X) * u + float(p.Y) * v + float(p.N) * r for p in parts)
        assert power <= 0


def test_a_current_is_a_moving_frame():
    north, east = 0.35, -0.2
    document = varied(USV, effects=[{"name": "crossflow-drag", "cd": 0.8}], hull={"N_rr": None})
    vessel, stages, psi = build(document), zigzag(ANGLE, ANGLE, 3), 0.6
    ahead = north * math.cos(psi) + east * math.sin(psi)
    across = east * math.cos(psi) - north * math.sin(psi)
    flow = Environment(north, east)
    still = Environment(0.0, 0.0)
    starts = state_of(psi=psi, u=SPEED), state_of(psi=psi, u=SPEED + ahead, v=across)
    calm, calm_rows = run(vessel, stages, starts[0], THRUST, still, 0.1, 30.0)
    carried, rows = run(vessel, stages, starts[1], THRUST, flow, 0.1, 30.0)
    # Not exactly: the current turns in body axes within a step, and the step sees it turn.
    np.testing.assert_allclose(carried.switch_times, calm.switch_times, rtol=1e-6)
    t, motion = columns(rows)
    s, reference = columns(calm_rows)
    assert len(t) == len(s)
    np.testing.assert_allclose(motion["x"] - north * t, reference["x"], atol=3e-5)
    np.testing.assert_allclose(motion["y"] - east * t, reference["y"], atol=3e-5)
    np.testing.assert_allclose(motion["psi"], reference["psi"], atol=3e-6)


def symmetric(name):
    if name == "kvlcc2":  # its rudder feels the inflow from either side alike here
        return replace(read_vessel(name).vessel, {"rudder.gamma_R_starboard": 0.395}), 11.85, 1.179
    return build(USV), THRUST, SPEED


@pytest.mark.slow
@pytest.mark.parametrize("name", ["usv", "kvlcc2"])
def test_a_mirrored_manoeuvre_gives_the_mirrored_track(name):
    vessel, throttle, speed = symmetric(name)
    runs = [
        run(vessel, zigzag(side * ANGLE, ANGLE, 3), state_of(u=speed), throttle, CALM, 0.2, 60.0)
        for side in (1.0, -1.0)
    ]
    np.testing.assert_allclose(runs[0][0].switch_times, runs[1][0].switch_times, rtol=1e-12)
    (_, one), (_, other) = (columns(rows) for _, rows in runs)
    for channel in MOTION_CHANNELS:
        sign = 1.0 if channel in ("x", "u") else -1.0
        np.testing.assert_allclose(one[channel], sign * other[channel], atol=1e-11)
    assert np.ptp(one["psi"]) > ANGLE
