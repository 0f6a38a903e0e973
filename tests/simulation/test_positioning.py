# pyright: reportArgumentType=false
"""Dynamic positioning: poses are come to and held, in currents, behind lags, with derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from tests.boats import square_boat_document

from diffsea import Environment, State, read_vessel, replace, run_controlled
from diffsea.errors import UserError
from diffsea.simulation.control import dynamic_positioning, effectors, require_positioning
from diffsea.simulation.control.effectors import (
    ChannelEffector,
    acceleration,
    orders_at_rest,
)
from diffsea.simulation.control.positioning import continuous_poses, reference
from diffsea.simulation.control.positioning_gains import Weights, positioning_gains
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles


SHIP = read_vessel("shioji_maru").vessel
PERIOD = 0.5


def square_boat(**engine):
    """A boat of 2 m with four fixed thrusters set at 45 degrees, one at each corner."""
    return build(square_boat_document(**engine))


def pulsed_boat(**engine):
    """The same with thrusters ordered in microseconds about 1500, two of them reversed."""
    boat = square_boat_document(**engine)
    for k, thruster in enumerate(boat["thruster"]):
        thruster |= {"unit": "us", "reversed": k % 2 == 1}
    return build(boat)


def driven(vessel, times, poses, seconds, start=None, plant=None, water=None, **options):
    control = dynamic_positioning(vessel, jnp.array(times), jnp.array(poses), PERIOD, **options)
    begin = State(*map(jnp.asarray, start or (*poses[0], 0.0, 0.0, 0.0)))
    run = run_controlled(plant or vessel, control, begin, seconds, PERIOD, environment=water)
    return jax.tree.map(np.asarray, run.trajectory)


def test_the_reference_is_the_hermite_spline_that_stands_still_at_every_pose():
    times = jnp.array([0.0, 40.0, 100.0])
    poses = jnp.array([[0.0, 0.0, 3.0], [10.0, -5.0, -3.0], [10.0, 20.0, -1.0]])
    smooth = continuous_poses(poses)
    assert float(smooth[1, 2]) == pytest.approx(2 * np.pi - 3.0)  # the short way
    spline = CubicHermiteSpline(np.asarray(times), np.asarray(smooth), np.zeros((3, 3)))
    for t in (-5.0, 0.0, 13.0, 40.0, 77.0, 100.0, 130.0):
        pose, rate = reference(times, smooth, jnp.asarray(t))
        inside = min(max(t, 0.0), 100.0)
        np.testing.assert_allclose(pose, spline(inside), atol=1e-9)
        np.testing.assert_allclose(rate, spline(inside, 1) if inside == t else 0.0, atol=1e-9)
    alone, rate = reference(times[:1], poses[:1], jnp.asarray(3.0))
    np.testing.assert_array_equal(alone, poses[0])
    assert not np.any(rate)


def test_half_of_an_effect_is_half_of_the_acceleration_whatever_the_curve():
    control = dynamic_positioning(SHIP, jnp.zeros(1), jnp.zeros((1, 3)), PERIOD)
    rest = dict.fromkeys(SHIP.channels, jnp.zeros(()))
    still = State(*map(jnp.asarray, (0.0,) * 6))
    effects = {one.channel: one for one in control.effectors if isinstance(one, ChannelEffector)}
    for channel, axis in (("propeller", 0), ("bow", 1), ("stern", 1)):

        def push(order, channel=channel, axis=axis):
            orders = rest | {channel: order}
            return float(SHIP.acceleration(still, orders, Environment(), jnp.zeros(()))[axis])

        effect = effects[channel]
        assert push(effect.order(0.5)) == pytest.approx(0.5 * push(effect.order(1.0)), rel=0.03)
    assert float(effects["propeller"].order(0.5)) > 0.6 * 4.5  # thrust by the square


@pytest.mark.parametrize("current", [(0.0, 0.0), (0.15, -0.1)])
def test_a_boat_comes_to_its_pose_and_stays_there_in_a_current(current):
    boat = square_boat(time_constant=0.3)
    water = Environment(*map(jnp.asarray, current))
    poses = [(0.0, 0.0, 0.0), (8.0, -5.0, 2.0)]
    run = driven(boat, (0.0, 60.0), poses, 200.0, plant=boat, water=water)
    assert np.hypot(run.x[-1] - 8.0, run.y[-1] + 5.0) < 0.02
    assert abs(run.psi[-1] - 2.0) < 0.005
    due = int(60.0 / PERIOD)
    assert np.hypot(run.x[due] - 8.0, run.y[due] + 5.0) < 0.6


def test_without_integrals_a_current_pushes_it_off():
    boat, water = square_boat(), Environment(jnp.asarray(0.0), jnp.asarray(0.2))
    poses = [(0.0, 0.0, 0.0)]
    off = [
        abs(driven(boat, (0.0,), poses, 150.0, water=water, integral_time=time).y[-1])
        for time in (None, 1e6)
    ]
    assert off[0] < 0.02 < 0.05 < off[1]


def test_what_the_models_own_current_asks_for_is_met_beforehand():
    water = Environment(jnp.asarray(0.0), jnp.asarray(0.2))
    boat = square_boat()
    knowing = dataclasses.replace(boat, environment=water)
    worst = [
        np.abs(driven(model, (0.0,), [(0.0, 0.0, 0.0)], 60.0, plant=boat, water=water).y).max()
        for model in (boat, knowing)
    ]
    assert worst[1] < 0.2 * worst[0]


def test_lags_and_delays_of_seconds_do_not_make_a_ship_swing(monkeypatch):
    """Her thrusters answer after 4 s and with a lag of 4 s: a gain without them swings her."""
    times, poses = (0.0, 300.0), [(0.0, 0.0, 0.0), (0.0, -40.0, 0.3)]
    run = driven(SHIP, times, poses, 700.0)
    late = run.t > 500.0
    assert np.ptp(np.degrees(run.psi[late])) < 1.0
    assert np.hypot(run.x[-1], run.y[-1] + 40.0) < 1.0

    monkeypatch.setattr(effectors, "_lag", lambda *_: jnp.asarray(0.1))
    hasty = dynamic_positioning(SHIP, jnp.array(times), jnp.array(poses), PERIOD)
    begin = State(*map(jnp.asarray, (0.0,) * 6))
    swung = run_controlled(SHIP, hasty, begin, 700.0, PERIOD).trajectory
    assert np.ptp(np.degrees(np.asarray(swung.psi)[late])) > 5.0


@pytest.mark.parametrize("speed", [3.0, 4.0])
def test_a_reference_that_moves_fast_is_followed_from_beside_it(speed):
    """Turned out of the reference's axes, its velocity would count a heading error twice."""
    seconds = 600.0
    times, poses = (-1500.0, 1500.0), [(0.0, 0.0, 0.0), (2000.0 * speed, 0.0, 0.0)]
    begin = continuous_poses(jnp.array(poses))
    pose, rate = reference(jnp.array(times), begin, jnp.zeros(()))
    start = (float(pose[0]), 2.0, 0.05, float(rate[0]), 0.0, 0.0)
    run = driven(SHIP, times, poses, seconds, start=start)
    late = run.t > 400.0
    assert np.abs(run.y[late]).max() < 0.05
    assert np.abs(run.psi[late]).max() < 0.005


def test_orders_about_a_neutral_and_reversed_ones_do_as_those_in_newtons():
    water, poses = Environment(jnp.asarray(0.0), jnp.asarray(0.15)), [(0.0, 0.0, 0.0)]
    plain, pulsed = (
        driven(boat, (0.0,), poses, 120.0, water=water) for boat in (square_boat(), pulsed_boat())
    )
    assert abs(pulsed.y[-1]) < 0.02
    np.testing.assert_allclose(pulsed.y, plain.y, atol=0.12)
    first = [orders[0] for orders in pulsed.commanded.values()]
    np.testing.assert_allclose(first, 1500.0, atol=40.0)
    require_positioning(pulsed_boat())


def azimuth_boat(angle=None, **engine):
    """A ferry of 2 m with an azimuth thruster at each end, which turn all the way round."""
    boat = square_boat_document()
    del boat["thruster"]
    angle = {"angle_time_constant": 0.3} | (angle or {})
    engine = {"max_force": 40.0, "min_force": 0.0} | engine
    boat["azimuth_thruster"] = [
        {"name": name, "x": x, **angle, **engine} for name, x in (("bow", 0.8), ("stern", -0.8))
    ]
    return build(boat)


TURNS = {
    "on and on": {},
    "half a turn to each side": {"min_angle": -np.pi, "max_angle": np.pi},
    "a turn to starboard": {"min_angle": 0.0, "max_angle": 2 * np.pi},
}


@pytest.mark.parametrize(
    ("turns", "current"),
    [("on and on", (0.0, 0.0)), *((turns, (0.15, -0.1)) for turns in TURNS)],
)
def test_a_ferry_with_azimuth_thrusters_comes_to_its_pose_and_stays_there(current, turns):
    boat = azimuth_boat(TURNS[turns], time_constant=0.3)
    water = Environment(*map(jnp.asarray, current))
    poses = [(0.0, 0.0, 0.0), (8.0, -5.0, 2.0)]
    run = driven(boat, (0.0, 60.0), poses, 200.0, plant=boat, water=water)
    assert np.hypot(run.x[-1] - 8.0, run.y[-1] + 5.0) < 0.03
    assert abs(run.psi[-1] - 2.0) < 0.01
    due = int(60.0 / PERIOD)
    assert np.hypot(run.x[due] - 8.0, run.y[due] + 5.0) < 0.6
    assert min(run.commanded[f"{name}.force"].min() for name in ("bow", "stern")) >= 0.0
    angle = run.commanded["bow.angle"]
    assert np.ptp(angle) > 1.0  # it pushes where it is asked to
    if turns == "on and on":  # the short way from each order to the next
        assert np.abs(np.diff(angle)).max() <= np.pi
    else:
        assert TURNS[turns]["min_angle"] <= angle.min() <= angle.max() <= TURNS[turns]["max_angle"]


DRIVES = {
    "ahead alone": {},
    "astern, too": {"min_force": -20.0},
    "stronger astern": {"min_force": -100.0},
    "reversed": {"unit": "N", "reversed": True},
    "pulses, reversed": {"unit": "us", "reversed": True, "min_force": -20.0},
}


@pytest.mark.parametrize("drive", DRIVES)
def test_an_azimuth_thruster_pushes_where_its_shares_point(drive):
    boat, zero = azimuth_boat(**DRIVES[drive]), jnp.zeros(())
    control = dynamic_positioning(boat, jnp.zeros(1), jnp.zeros((1, 3)), PERIOD)
    bow, rest = control.effectors[0], orders_at_rest(boat)
    mass = 150.0 + np.array([10.0, 60.0])
    for asked, done in (((0.3, -0.4), 0.5), ((-2.0, 0.0), 1.0), ((1.0, 1.0), 1.0)):
        orders = rest | bow.orders(jnp.array(asked), {"bow.angle": zero})
        push = np.asarray(acceleration(boat, jnp.zeros(3), orders))[:2] * mass
        wanted = 40.0 * done * np.array(asked) / np.hypot(*asked)
        np.testing.assert_allclose(push, wanted, atol=0.2)
        possible = np.asarray(bow.possible(jnp.array(asked)))
        np.testing.assert_allclose(possible, done * np.array(asked) / np.hypot(*asked))


def test_an_azimuth_thruster_is_not_turned_for_next_to_nothing():
    boat = azimuth_boat()
    control = dynamic_positioning(boat, jnp.zeros(1), jnp.zeros((1, 3)), PERIOD)
    bow, before = control.effectors[0], {"bow.angle": jnp.asarray(7.0)}
    for asked in ((0.0, 0.0), (0.02, 0.03), (-0.02, -0.01)):
        orders = bow.orders(jnp.array(asked), before)
        helps = max(0.0, asked[0] * np.cos(7.0) + asked[1] * np.sin(7.0))
        assert float(orders["bow.angle"]) == 7.0
        assert float(orders["bow.force"]) == pytest.approx(40.0 * helps, abs=1e-3)
    turned = bow.orders(jnp.array((-0.1, 0.0)), before)["bow.angle"]
    assert float(turned) == pytest.approx(3 * np.pi)  # half a turn, from one and a bit


def test_a_missions_limits_of_a_whole_turn_hold_within_the_thrusters_own():
    boat = azimuth_boat(TURNS["a turn to starboard"])
    wide = {"bow.angle": (jnp.asarray(-7.0), jnp.asarray(7.0))}
    control = dynamic_positioning(boat, jnp.zeros(1), jnp.zeros((1, 3)), PERIOD, limits=wide)
    bow = control.effectors[0]
    order = bow.orders(jnp.array((0.1, -0.1)), {"bow.angle": jnp.zeros(())})["bow.angle"]
    assert float(order) == pytest.approx(1.75 * np.pi)


def test_a_ferry_at_rest_has_derivatives():
    def force(mass):
        boat = replace(azimuth_boat(), {"mass": mass})
        control = dynamic_positioning(boat, jnp.zeros(1), jnp.zeros((1, 3)), PERIOD)
        state = State(*map(jnp.asarray, (0.0,) * 6))
        orders = control.step(control.init(), state, jnp.zeros(()), jnp.asarray(PERIOD))[1]
        return orders["bow.force"] + orders["bow.angle"]

    assert np.isfinite(float(jax.grad(force)(150.0)))


def test_narrower_limits_of_a_mission_are_known_and_wind_nothing_up():
    """Six newtons a thruster just bear the current: not knowing the limits winds integrals up."""
    boat, water = square_boat(), Environment(jnp.asarray(0.0), jnp.asarray(0.17))
    narrow = {channel: (-6.0, 6.0) for channel in boat.channels}
    run = driven(
        boat, (0.0,), [(0.0, -2.0, 0.0)], 240.0, start=(0.0,) * 6, water=water, limits=narrow
    )
    assert max(np.abs(orders).max() for orders in run.commanded.values()) <= 6.0 + 1e-9
    assert run.y.min() > -2.25
    assert abs(run.y[-1] + 2.0) < 0.05


def test_orders_have_derivatives_by_numbers_of_the_vessel():
    boat = square_boat()

    def order(mass):
        changed = replace(boat, {"mass": mass})
        control = dynamic_positioning(changed, jnp.zeros(1), jnp.zeros((1, 3)), PERIOD)
        state = State(*map(jnp.asarray, (0.5, 0.2, 0.1, 0.0, 0.0, 0.0)))
        orders = control.step(control.init(), state, jnp.zeros(()), jnp.asarray(PERIOD))[1]
        return orders["t0"]

    slope = float(jax.grad(order)(150.0))
    apart = float(order(150.5) - order(149.5))
    assert slope == pytest.approx(apart, rel=1e-3) and slope != 0.0


@pytest.mark.parametrize(
    ("times", "poses", "said"),
    [
        ([0.0, 0.0], [[0.0] * 3] * 2, "must increase"),
        ([5.0, 1.0], [[0.0] * 3] * 2, "must increase"),
        ([0.0, 1.0], [[0.0] * 3], r"shape \(1, 3\)"),
        ([], np.zeros((0, 3)), "for each of them a pose"),
    ],
)
def test_poses_that_do_not_go_with_their_times_are_refused(times, poses, said):
    with pytest.raises(UserError, match=said):
        dynamic_positioning(SHIP, jnp.array(times, float), jnp.array(poses, float), PERIOD)


def test_errors_have_derivatives_through_the_loop():
    boat = square_boat(time_constant=0.3)

    @jax.jit
    def error(position):
        control = dynamic_positioning(
            boat, jnp.array([0.0, 20.0]), jnp.array([(0.0, 0.0, 0.0), (3.0, 1.0, 0.4)]), PERIOD,
            position=position,
        )  # fmt: skip
        begin = State(*map(jnp.asarray, (0.0, 0.2, 0.0, 0.0, 0.0, 0.0)))
        run = run_controlled(boat, control, begin, 30.0, PERIOD).trajectory
        return jnp.mean((run.x - 3.0) ** 2 + (run.y - 1.0) ** 2)

    slope = float(jax.grad(error)(0.5))
    apart = float(error(0.5 + 1e-4) - error(0.5 - 1e-4)) / 2e-4
    assert slope == pytest.approx(apart, rel=1e-4) and slope != 0.0


@pytest.mark.parametrize("speed", [-0.8, 0.3, 1.7])
def test_gains_between_the_speeds_of_the_schedule_are_nearly_those_of_the_speed(speed):
    poses = jnp.array([(0.0, 0.0, 0.0), (200.0, 0.0, 0.0)])
    control = dynamic_positioning(SHIP, jnp.array([0.0, 200.0]), poses, PERIOD)
    low, high = float(control.gains.speeds[0]), float(control.gains.speeds[-1])
    assert low < -1.7 and high > 1.7  # the poses ask for 1.5 m/s
    L = float(SHIP.rigid_body.length)
    weights = Weights(
        jnp.asarray(0.25 * L), jnp.radians(10.0), jnp.asarray(25.0 * (L / 9.80665) ** 0.5)
    )
    exact = positioning_gains(
        SHIP, control.effectors, control.lags, weights, PERIOD, jnp.array([speed])
    )
    gain, allocation = control.gains.at(jnp.asarray(speed))
    for ours, theirs in ((gain, exact.gain[0]), (allocation, exact.allocation[0])):
        assert float(jnp.abs(ours - theirs).max()) < 0.03 * float(jnp.abs(theirs).max())
    beyond, _ = control.gains.at(jnp.asarray(100.0))
    np.testing.assert_allclose(beyond, control.gains.gain[-1])


def test_vessels_that_cannot_be_positioned_are_told_why():
    with pytest.raises(UserError, match="2 actuators cannot push it ahead, sideways and round"):
        require_positioning(read_vessel("otter").vessel)
    with pytest.raises(UserError, match="nothing pushes it sideways"):
        require_positioning(read_vessel("vrx_wamv").vessel)
    limited = {"max_angle": 0.6, "min_angle": -0.6}
    with pytest.raises(UserError, match="sideways.*azimuth thrusters that turn all the way round"):
        require_positioning(azimuth_boat(limited))
    with pytest.raises(UserError, match="nothing pushes it sideways"):
        require_positioning(azimuth_boat(), {"bow.angle": (-0.5, 0.5), "stern.angle": (-0.5, 0.5)})
    with pytest.raises(UserError, match="'propeller' of 'kvlcc2' has none"):
        require_positioning(read_vessel("kvlcc2").vessel)
    require_positioning(SHIP)
    require_positioning(square_boat())
    require_positioning(azimuth_boat())
