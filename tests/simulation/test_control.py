# pyright: reportArgumentType=false
"""Laws, guidance, LQR and closed loops against closed forms, scipy and differences."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.signal
from tests.runs import state_of

from diffsea import Environment, Outcome, UserError, read_vessel, run_controlled
from diffsea.simulation import planning
from diffsea.simulation.control import (
    Autopilot,
    ConstantHeading,
    ControlAllocation,
    FilteredPD,
    FixedThrottle,
    HeadingHold,
    LineOfSight,
    Pursuit,
    SpeedHold,
    Steering,
    autopilot,
    discrete_lqr,
    discretise,
    full_throttle,
    riccati,
    speed_hold,
    steering_model,
    throttle_for,
    track_keeper,
)
from diffsea.vessel.files import build


LENGTH, SPEED = 4.9, 1.5
SHIP = {
    "format": 1,
    "name": "boat",
    "hull": {
        "length": LENGTH, "beam": 2.4, "draught": 0.2, "mass": 180.0, "I_z": 446.0,
        "X_udot": -12.0, "Y_vdot": -90.0, "N_rdot": -120.0, "X_u": -60.0, "X_uu": -20.0,
        "Y_v": -200.0, "N_r": -500.0, "N_v": -30.0, "Y_r": 20.0,
    },
    "thruster": [
        {"name": side, "x": -2.3, "y": y, "max_force": 250.0, "min_force": -180.0}
        for side, y in (("port", -1.03), ("starboard", 1.03))
    ],
}  # fmt: skip


@functools.cache
def boat():
    return build(SHIP)


@pytest.mark.parametrize("turned, left_alone", [(90, True), (-75, True), (45, False), (180, False)])
def test_a_thruster_that_pushes_across_is_left_alone(turned, left_alone):
    bow = {"name": "bow", "x": 2.0, "y": 0.1, "angle": np.radians(turned), "max_force": 40.0}
    vessel = build(SHIP | {"thruster": [*SHIP["thruster"], bow]})
    pair, all_of_them = ControlAllocation(boat()), ControlAllocation(vessel)
    orders = all_of_them.orders(200.0, 0.1)
    assert bool(orders["bow"] == 0) is left_alone
    share = 1.0 if left_alone else 2 / 3
    for channel, order in pair.orders(200.0, 0.1).items():
        np.testing.assert_allclose(orders[channel], share * order, rtol=1e-12)
    limit = 500.0 if left_alone else 120.0
    assert float(full_throttle(vessel)) == pytest.approx(limit)


def test_a_vessel_whose_thrusters_push_across_is_neither_driven_nor_steered():
    across = [part | {"angle": np.pi / 2} for part in SHIP["thruster"]]
    vessel = build(SHIP | {"thruster": across})
    allocation = ControlAllocation(vessel)
    assert not allocation.propelled and not allocation.steerable
    assert float(throttle_for(vessel, 1.0)) == 0.0


# -- laws ------------------------------------------------------------------------------


def test_a_speed_hold_stops_integrating_at_its_limit():
    law = SpeedHold(2.0, 100.0, 1.0, gain=4.0, integral_gain=1.0, largest=150.0)
    memory, throttle = law.step(law.init(), state_of(u=1.0), 0.1)
    assert float(throttle) == 150.0 and float(memory) == 0.0
    memory, throttle = law.step(law.init(), state_of(u=1.9), 0.1)
    assert float(throttle) == pytest.approx(100 * (1 + 4 * 0.05))
    assert float(memory) == pytest.approx(0.05 * 0.1)


def test_headings_are_taken_the_short_way_round():
    law = HeadingHold(1.0, gain=2.0, rate_gain=0.0, integral_gain=0.0)
    _, angle = law.step(law.init(), state_of(psi=np.radians(179)), np.radians(-179), 0.1)
    assert float(angle) == pytest.approx(2 * np.radians(2))
    pd = FilteredPD(gain=1.0, rate_gain=0.0)
    _, angle = pd.step(pd.init(), state_of(psi=np.radians(725)), 0.0, 0.1)
    assert float(angle) == pytest.approx(-np.radians(5))


def test_the_filtered_derivative_is_that_of_a_first_order_filter():
    """Of a ramp of the error: T d' + d = slope, sampled by backward Euler."""
    law = FilteredPD(gain=0.0, rate_gain=1.0, filter_time=0.5, largest_angle=10.0)
    period, slope = 0.1, 0.2
    memory, out = law.init(), []
    for k in range(30):
        memory, angle = law.step(memory, state_of(), slope * k * period, period)
        out.append(float(angle))
    shrink = 0.5 / 0.6
    expected = [slope * (1 - shrink**k) for k in range(30)]
    np.testing.assert_allclose(out, expected, atol=1e-12)


# -- guidance --------------------------------------------------------------------------


def test_line_of_sight_steers_for_a_point_ahead_on_the_leg():
    law = LineOfSight(jnp.array([[0.0, 0.0], [100.0, 100.0]]), lookahead=10.0, radius=2.0)
    # 5 m to starboard of a course of 45 deg.
    at = state_of(x=50 - 5 / np.sqrt(2), y=50 + 5 / np.sqrt(2))
    leg = law.leg(law.init()[0], at)
    assert float(leg.cross) == pytest.approx(5.0)
    assert float(leg.along) == pytest.approx(np.hypot(50, 50))
    _, wanted = law.step(law.init(), at, 0.1)
    assert float(wanted) == pytest.approx(np.pi / 4 - np.arctan(0.5))


def test_a_leg_ends_within_the_radius_or_abeam_and_the_path_with_the_last():
    law = LineOfSight(jnp.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]), 5.0, radius=1.0)
    memory, _ = law.step(law.init(), state_of(x=8.9), 0.1)
    assert int(memory[0]) == 0
    near, _ = law.step(law.init(), state_of(x=9.1), 0.1)
    abeam, _ = law.step(law.init(), state_of(x=10.1, y=4.0), 0.1)
    assert int(near[0]) == int(abeam[0]) == 1
    assert not law.is_finished(near)
    end, _ = law.step(near, state_of(x=10.0, y=9.5), 0.1)
    assert law.is_finished(end)


def test_pursuit_goes_on_to_the_next_waypoint():
    law = Pursuit(jnp.array([[10.0, 0.0], [10.0, 10.0]]), radius=1.0)
    memory, wanted = law.step(law.init(), state_of(), 0.1)
    assert int(memory) == 0 and float(wanted) == pytest.approx(0.0)
    memory, wanted = law.step(memory, state_of(x=9.5), 0.1)
    assert int(memory) == 1 and float(wanted) == pytest.approx(np.arctan2(10, 0.5))
    memory, _ = law.step(memory, state_of(x=10, y=10), 0.1)
    assert law.is_finished(memory)


def test_the_integral_of_line_of_sight_meets_a_current():
    """A current across the leg: no cross-track error is left, and the crab angle is right."""
    course = LineOfSight(jnp.array([[0.0, 0.0], [5000.0, 0.0]]), 12.0, 2.0, integral_gain=1.0)
    across = Environment(current_east=jnp.asarray(0.3))
    steering = Steering(course, HeadingHold(LENGTH / SPEED), speed_hold(boat(), SPEED))
    pilot = Autopilot(steering, ControlAllocation(boat()))
    run = run_controlled(boat(), pilot, state_of(u=SPEED), 800.0, 0.5, 0.25, across).trajectory
    assert abs(float(run.y[-1])) < 0.05
    velocity = np.arctan2(float(run.v[-1]), float(run.u[-1]))  # over ground, body axes
    assert float(run.psi[-1]) == pytest.approx(-velocity, abs=1e-3)
    assert float(run.psi[-1]) < -0.1


# -- linear-quadratic ------------------------------------------------------------------


def _system(seed, n=4, m=2):
    rng = np.random.default_rng(seed)
    Q = rng.normal(size=(n, n))
    R = rng.normal(size=(m, m))
    return (
        rng.normal(size=(n, n)) * 0.9, rng.normal(size=(n, m)), Q @ Q.T, R @ R.T + np.eye(m)
    )  # fmt: skip


def test_the_riccati_equation_is_solved_as_scipy_does():
    for seed in range(5):
        A, B, Q, R = _system(seed)
        expected = scipy.linalg.solve_discrete_are(A, B, Q, R)
        np.testing.assert_allclose(riccati(A, B, Q, R), expected, rtol=1e-7)
        gain = np.asarray(discrete_lqr(A, B, Q, R))
        assert np.max(np.abs(np.linalg.eigvals(A - B @ gain))) < 1


def test_the_gain_has_the_derivative_of_its_differences():
    A, B, Q, R = _system(3)
    direction = np.random.default_rng(9).normal(size=A.shape)
    _, slope = jax.jvp(lambda a: discrete_lqr(a, B, Q, R), (A,), (direction,))

    def gain(h):
        P = scipy.linalg.solve_discrete_are(A + h * direction, B, Q, R)
        return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ (A + h * direction))

    np.testing.assert_allclose(slope, (gain(1e-5) - gain(-1e-5)) / 2e-5, rtol=1e-5, atol=1e-7)


def test_discretisation_is_that_of_a_zero_order_hold():
    A, B, _, _ = _system(1)
    whole: Any = scipy.signal.cont2discrete((A, B, np.eye(4), np.zeros((4, 2))), 0.5)
    transition, inputs = discretise(jnp.asarray(A), jnp.asarray(B), 0.5)
    np.testing.assert_allclose(transition, whole[0], rtol=1e-10)
    np.testing.assert_allclose(inputs, whole[1], rtol=1e-10)


def test_the_steering_model_is_the_textbooks():
    """Linear derivatives, twin thrusters: M nu' = -N(U) nu + b (Fossen 2021, section 6.5)."""
    hull = SHIP["hull"]
    A, B = steering_model(boat(), SPEED)
    mass = np.diag([hull["mass"] - hull["Y_vdot"], hull["I_z"] - hull["N_rdot"]])
    surge, sway = hull["mass"] - hull["X_udot"], hull["mass"] - hull["Y_vdot"]
    damping = np.array(
        [[hull["Y_v"], hull["Y_r"] - surge * SPEED],
         [hull["N_v"] - (sway - surge) * SPEED, hull["N_r"]]]
    )  # fmt: skip
    np.testing.assert_allclose(A, np.linalg.solve(mass, damping), rtol=1e-9)
    thrust = float(throttle_for(boat(), SPEED))
    assert float(B[1, 0]) == pytest.approx(thrust * 1.03 / np.radians(35) / mass[1, 1])


# -- closed loops ----------------------------------------------------------------------


WAYPOINTS = jnp.array([[0.0, 0.0], [60.0, 0.0], [100.0, 40.0], [160.0, 40.0]])
CONTROLLERS = {
    "line of sight": lambda: autopilot(boat(), SPEED, LineOfSight(WAYPOINTS, 10.0, 5.0)),
    "pursuit": lambda: autopilot(boat(), SPEED, Pursuit(WAYPOINTS[1:], 5.0)),
    "track keeper": lambda: track_keeper(boat(), SPEED, WAYPOINTS, 0.5),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", CONTROLLERS)
def test_a_path_is_followed_to_its_end(kind):
    controller = CONTROLLERS[kind]()
    loop = jax.jit(lambda: run_controlled(boat(), controller, state_of(y=3.0), 400.0, 0.5, 0.25))()
    run = loop.trajectory
    assert Outcome(int(run.outcome)) is Outcome.COMPLETED
    valid = np.asarray(run.valid)
    last = np.flatnonzero(valid)[-1]
    assert np.hypot(run.x[last] - 160, run.y[last] - 40) < 5 + SPEED
    assert 100 < run.t[last] < 160
    straight = valid & (np.asarray(run.x) > 120) & (np.asarray(run.x) < 150)
    assert np.max(np.abs(np.asarray(run.y)[straight] - 40)) < (6.0 if kind == "pursuit" else 2.0)
    assert np.max(np.abs(np.asarray(run.u)[straight] - SPEED)) < 0.05
    assert np.all(np.asarray(run.x)[~valid] == np.asarray(run.x)[last + 1])


def test_a_closed_loop_agrees_with_scipy():
    """A heading step under a sampled PD law, the linear boat integrated by DOP853."""
    law = HeadingHold(1.0, gain=0.8, rate_gain=1.2, integral_gain=0.0)
    thrust = throttle_for(boat(), SPEED)
    pilot = Autopilot(
        Steering(ConstantHeading(0.5), law, FixedThrottle(thrust)), ControlAllocation(boat())
    )
    run = run_controlled(boat(), pilot, state_of(u=SPEED), 20.0, 0.5, 0.05).trajectory
    hull = SHIP["hull"]
    m11, m22 = hull["mass"] - hull["X_udot"], hull["mass"] - hull["Y_vdot"]
    m33 = hull["I_z"] - hull["N_rdot"]

    def slope(t, s, turn):
        _, _, psi, u, v, r = s
        X = m22 * v * r + hull["X_u"] * u + hull["X_uu"] * abs(u) * u + float(thrust)
        Y = -m11 * u * r + hull["Y_v"] * v + hull["Y_r"] * r
        N = (m11 - m22) * u * v + hull["N_v"] * v + hull["N_r"] * r + turn
        c, s_ = np.cos(psi), np.sin(psi)
        return [u * c - v * s_, u * s_ + v * c, r, X / m11, Y / m22, N / m33]

    state = np.array([0, 0, 0, SPEED, 0, 0], float)
    rows = [state]
    for _ in range(40):
        angle = np.clip(0.8 * (0.5 - state[2]) - 1.2 * state[5], -0.6, 0.6)
        turn = float(thrust) * angle / np.radians(35) * 1.03
        span = scipy.integrate.solve_ivp(
            slope, (0, 0.5), state, "DOP853", args=(turn,), rtol=1e-10, atol=1e-12
        )
        state = span.y[:, -1]
        rows.append(state)
    found = np.stack([run.x, run.y, run.psi, run.u, run.v, run.r], 1)
    np.testing.assert_allclose(found, np.array(rows), atol=1e-6)


@pytest.mark.slow
def test_a_closed_loop_is_differentiated():
    """The cross-track error against the heading law's gain and the mass, beside differences."""

    def error(gain, scale):
        vessel = boat()
        law = HeadingHold(LENGTH / SPEED, gain=gain)
        hold = speed_hold(vessel, SPEED)
        pilot = Autopilot(
            Steering(LineOfSight(WAYPOINTS, 10.0 * scale, 5.0), law, hold),
            ControlAllocation(vessel),
        )
        run = run_controlled(vessel, pilot, state_of(y=3.0, u=SPEED), 30.0, 0.5).trajectory
        return jnp.mean(run.y**2)

    error = jax.jit(error)
    slopes = jax.jit(jax.jacfwd(error, (0, 1)))(1.5, 1.0)
    h = 1e-5
    assert float(slopes[0]) == pytest.approx(
        float(error(1.5 + h, 1.0) - error(1.5 - h, 1.0)) / (2 * h), rel=1e-5
    )
    assert float(slopes[1]) == pytest.approx(
        float(error(1.5, 1 + h) - error(1.5, 1 - h)) / (2 * h), rel=1e-5
    )
    back = jax.grad(error, (0, 1))(1.5, 1.0)
    np.testing.assert_allclose(back, slopes, rtol=1e-8)


def test_a_run_that_diverges_says_so_and_stops():
    pilot = autopilot(build(SHIP | {"hull": SHIP["hull"] | {"X_u": 300.0, "X_uu": 0.0}}), SPEED)
    run = run_controlled(pilot.allocation.vessel, pilot, state_of(u=SPEED), 200.0, 0.5).trajectory
    assert Outcome(int(run.outcome)) is Outcome.DIVERGED
    assert np.all(np.isfinite(np.asarray(run.u)))


def test_bad_requests_are_refused():
    with pytest.raises(UserError, match="period above zero"):
        run_controlled(boat(), autopilot(boat(), SPEED), state_of(), 10.0, 0.0)
    rudderless = SHIP | {"thruster": [SHIP["thruster"][0] | {"y": 0.0}]}
    with pytest.raises(UserError, match="cannot be steered"):
        autopilot(build(rudderless), SPEED)


# -- in standard trials ----------------------------------------------------------------


@pytest.mark.proof
@pytest.mark.slow
def test_speed_is_kept_through_a_circle_where_that_is_asked_for():
    vessel, wanted = build(read_vessel("esso_osaka").document), 0.25
    slow, kept = (
        planning.run_and_measure(
            vessel, planning.plan_trial(vessel, "turning-circle", speed=wanted, keep_speed=keep)
        )[0]
        for keep in (False, True)
    )
    speeds = [float(np.asarray(run.trajectory.u)[np.asarray(run.trajectory.valid)][-1])
              for run in (slow, kept)]  # fmt: skip
    assert speeds[1] > 0.9 * wanted and speeds[0] < 0.6 * wanted
    with pytest.raises(UserError, match="keep the speed"):
        planning.plan_trial(vessel, "zigzag", thrust=3.0, keep_speed=True)
