# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
"""Missions: path errors against the oracle and closed forms, weather, sensors, limits."""

import copy
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import tomli_w
from tests.oracle.simulator import Simulator
from tests.runs import state_of

from diffsea import Environment, Trajectory, UserError, run_controlled
from diffsea.missions import mission_of, run, scores
from diffsea.missions.performance import tracking_errors
from diffsea.missions.record import Flow, Weather
from diffsea.missions.running import setup
from diffsea.missions.scores import approaches
from diffsea.missions.surroundings import weather_series
from diffsea.scales import HARD_OVER
from diffsea.simulation.control import ConstantHeading, LineOfSight, autopilot


pytestmark = pytest.mark.compiles


PERIOD, SECONDS, THROTTLE = 0.2, 60.0, 160.0
SHIP = {
    "format": 1,
    "name": "boat",
    "hull": {
        "length": 4.9, "beam": 2.4, "draught": 0.2, "mass": 180.0, "I_z": 446.0,
        "X_udot": -12.0, "Y_vdot": -90.0, "N_rdot": -120.0, "X_u": -60.0, "X_uu": -20.0,
        "Y_v": -200.0, "N_r": -500.0, "N_v": -30.0, "Y_r": 20.0,
    },
    "thruster": [
        {"name": side, "x": -2.3, "y": y, "max_force": 250.0, "min_force": -180.0}
        for side, y in (("port", -1.03), ("starboard", 1.03))
    ],
}  # fmt: skip
LOOKAHEAD, RADIUS = 10.0, 4.0
PATH = ((0.0, 0.0), (40.0, 0.0), (60.0, 30.0))
LAW = {"gain": 1.5, "rate_gain": 2.0, "integral_gain": 0.1, "largest_angle": 0.5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("missions")
    (folder / "boat.toml").write_text(tomli_w.dumps(SHIP))
    return folder


def document(**more):
    """A mission by line of sight at a fixed throttle."""
    return {
        "vessel": {"file": "boat.toml"},
        "period": PERIOD,
        "time_step": 0.05,
        "seconds": SECONDS,
        "controller": {
            "kind": "line-of-sight", "throttle": THROTTLE, "lookahead": LOOKAHEAD,
            "radius": RADIUS, "heading": {"law": "pid", **LAW},
        },
        "waypoint": [{"x": x, "y": y} for x, y in PATH],
        "start": {"x": 0.0, "y": 5.0, "psi": 0.3, "u": 1.0},
    } | more  # fmt: skip


def steered_by_hand(speed):
    """The oracle under the same law written out: rows of (x, y) at the controller's period."""
    sim = Simulator(SHIP, state=(0.0, 5.0, 0.3, 1.0, 0.0, 0.0))
    points, leg, integral, rows = np.array(PATH), 0, 0.0, []
    scale = SHIP["hull"]["length"] / speed
    for k in range(round(SECONDS / PERIOD) + 1):
        x, y, psi, _, _, r = sim.state
        rows.append((x, y))
        course, along, cross, length = on_leg(points, leg, x, y)
        if length - along <= 0 or math.hypot(length - along, cross) < RADIUS:
            leg += 1
            if leg == len(points) - 1:
                break
            course, along, cross, length = on_leg(points, leg, x, y)
        off = math.remainder(course - math.atan(cross / LOOKAHEAD) - psi, 2 * math.pi)
        wanted = LAW["gain"] * off - LAW["rate_gain"] * scale * r
        wanted += LAW["integral_gain"] * integral
        angle = min(max(wanted, -LAW["largest_angle"]), LAW["largest_angle"])
        integral += off * PERIOD / scale if angle == wanted else 0.0
        share = angle / HARD_OVER
        sim.order({"port": THROTTLE / 2 * (1 + share), "starboard": THROTTLE / 2 * (1 - share)})
        sim.run((k + 1) * PERIOD)
    return np.array(rows)


def on_leg(points, number, x, y):
    start, end = points[number], points[number + 1]
    course = math.atan2(end[1] - start[1], end[0] - start[0])
    north, east = x - start[0], y - start[1]
    along = math.cos(course) * north + math.sin(course) * east
    cross = math.cos(course) * east - math.sin(course) * north
    return course, along, cross, math.hypot(*(end - start))


def segment_distance(points, x, y):
    """Distance from the whole polyline, by sampling it finely."""
    pieces = [np.linspace(a, b, 20001) for a, b in zip(points[:-1], points[1:], strict=True)]
    line = np.concatenate(pieces)
    return np.array([np.hypot(*(line - at).T).min() for at in np.column_stack([x, y])])


def test_the_path_error_is_that_of_the_oracle_under_the_same_law(folder):
    found = run(mission_of(document(), folder))
    told = scores(found)
    speed = found.setup.controller.inner.steering.heading.time_scale
    by_hand = steered_by_hand(SHIP["hull"]["length"] / float(speed))
    assert told["outcome"] == "completed" and len(by_hand) == len(found.true.t)
    np.testing.assert_allclose(np.column_stack([found.true.x, found.true.y]), by_hand, atol=2e-5)
    off = segment_distance(np.array(PATH), *by_hand.T)
    assert told["path_error"]["rms"] == pytest.approx(np.sqrt(np.mean(off**2)), abs=1e-4)
    assert told["path_error"]["largest"] == pytest.approx(off.max(), abs=1e-4)
    assert told["time"] == pytest.approx(PERIOD * (len(by_hand) - 1))


def path_offsets(mission, motion):
    return np.asarray(tracking_errors(mission, motion)["path"])


def along(x, y):
    t = np.arange(len(x), dtype=float)
    still = dict.fromkeys(("psi", "u", "v", "r"), 0.0 * t)
    empty = {"commanded": {}, "executed": {}, "extra": {}}
    return Trajectory(t, np.asarray(x), np.asarray(y), **still, **empty, valid=t >= 0)


def path_mission(folder, points):
    return mission_of(document(waypoint=[{"x": x, "y": y} for x, y in points]), folder)


def test_offsets_are_positive_to_starboard_and_corners_count_from_the_nearer_leg(folder):
    mission = path_mission(folder, PATH[:2])
    np.testing.assert_allclose(
        np.asarray(tracking_errors(mission, along([0.0, 10.0, 20.0], [2.0, 0.0, -3.0]))["path"]),
        [2, 0, -3],
        atol=1e-12,
    )
    corner = path_mission(folder, [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0)])
    # On, cut by 2 m on both sides of the corner, past it, and 1 m to port of the second leg.
    x, y = [10.0, 38.0, 38.0, 45.0, 41.0], [0.0, 1.0, 3.0, 1.0, 20.0]
    np.testing.assert_allclose(path_offsets(corner, along(x, y)), [0, 1, 2, -5, -1], atol=1e-12)


def test_waypoints_are_reached_within_the_radius_in_order_and_may_be_late(folder):
    points = [
        {"x": 0.0, "y": 0.0},
        {"x": 20.0, "y": 0.0, "time": 8.0},
        {"x": 20.0, "y": 20.0, "time": 15.0},
    ]
    mission = mission_of(document(waypoint=points), folder)
    x = [*np.arange(0.0, 20.0, 2.0), *[20.0] * 5]
    y = [*[0.0] * 10, 0.0, 2.0, 4.0, 6.0, 8.0]
    first, second, third = approaches(mission, along(x, y))
    assert first["reached"] and first["time"] == 0 and "time_error" not in first
    assert second["reached"] and second["time"] == 9 and second["time_error"] == 1
    assert second["closest_approach"] == 0
    assert not third["reached"] and third["closest_approach"] == 12 and third["time"] == 14


def test_a_place_that_is_passed_twice_is_reached_a_second_time(folder):
    mission = path_mission(folder, [(0.0, 0.0), (20.0, 0.0), (0.0, 0.5)])
    there = np.arange(0.0, 21.0, 2.0)
    x = np.concatenate([there, there[::-1]])
    assert [one["time"] for one in approaches(mission, along(x, 0 * x))] == [0.0, 9.0, 20.0]


# -- weather


def test_a_flow_goes_by_straight_lines_of_its_components_and_holds_at_its_ends():
    flow = Flow((10.0, 20.0), (1.0, 2.0), (0.0, math.pi / 2))
    series = weather_series(Weather(current=flow), boat_vessel(), 31, 1.0, 0)
    north, east = (np.asarray(part) for part in (series.current_north, series.current_east))
    np.testing.assert_allclose(north[[0, 10, 15, 20, 30]], [1, 1, 0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(east[[0, 10, 15, 20, 30]], [0, 0, 1, 2, 2], atol=1e-12)
    assert float(series(jnp.asarray(15.9)).current_east) == pytest.approx(1.0)
    assert series(jnp.asarray(15.0)).wind_north == 0.0


def test_a_wind_comes_from_its_direction_and_its_gusts_have_their_size_and_memory():
    wind = Flow((0.0,), (8.0,), (0.0,))
    weather = Weather(wind=wind, gusts=1.5, gust_time=5.0)
    series = weather_series(weather, boat_vessel(), 40000, 0.5, 3)
    north, east = np.asarray(series.wind_north), np.asarray(series.wind_east)
    assert north.mean() == pytest.approx(-8.0, abs=0.2) and east.mean() == pytest.approx(0, abs=0.2)
    for gust in (north + 8.0, east):
        assert gust.std() == pytest.approx(1.5, rel=0.05)
        after = np.corrcoef(gust[:-10], gust[10:])[0, 1]
        assert after == pytest.approx(math.exp(-1.0), abs=0.05)
    again = weather_series(weather, boat_vessel(), 40000, 0.5, 4)
    assert not np.allclose(again.wind_north, north)


def boat_vessel():
    from diffsea.vessel.files import build

    return build(SHIP)


def test_water_that_is_a_function_of_time_acts_as_the_same_water_stated_once():
    vessel, start = boat_vessel(), state_of(u=1.0)
    pilot = autopilot(vessel, 1.0, ConstantHeading())
    water = Environment(current_east=jnp.asarray(0.3))
    steady = run_controlled(vessel, pilot, start, 20.0, 0.2, 0.1, water).trajectory
    told = run_controlled(vessel, pilot, start, 20.0, 0.2, 0.1, lambda t: water).trajectory
    np.testing.assert_array_equal(steady.y, told.y)
    turns = lambda t: Environment(current_east=jnp.where(t < 10.0, 0.3, 0.0))
    later = run_controlled(vessel, pilot, start, 20.0, 0.2, 0.1, turns).trajectory
    np.testing.assert_allclose(later.y[:51], steady.y[:51], atol=1e-12)
    assert abs(float(later.y[-1] - steady.y[-1])) > 0.5


# -- sensors, limits, model


def test_sensors_show_noise_of_their_size_and_the_controller_acts_on_what_they_show(folder):
    noise = {"position": 0.5, "heading": 0.02, "velocity": 0.1, "yaw_rate": 0.01}
    found = run(mission_of(document(sensors=noise, seed=5), folder))
    sizes = {"x": 0.5, "y": 0.5, "psi": 0.02, "u": 0.1, "v": 0.1, "r": 0.01}
    for channel, size in sizes.items():
        off = getattr(found.recorded, channel) - getattr(found.true, channel)
        low, high = scipy.stats.chi2.ppf([1e-4, 1 - 1e-4], len(off))
        assert low < np.sum(off**2) / size**2 < high
    assert np.ptp(np.diff(found.true.commanded["port"])) > 5.0
    again = run(mission_of(document(sensors=noise, seed=5), folder))
    other = run(mission_of(document(sensors=noise, seed=6), folder))
    np.testing.assert_array_equal(again.true.x, found.true.x)
    assert not np.allclose(other.true.y[:100], found.true.y[:100])


def test_sensors_are_late_and_off_as_stated(folder):
    errors = {"delay": 0.6, "heading_offset": 0.05, "gyro_bias": -0.01}
    found = run(mission_of(document(sensors=errors), folder))
    true, seen = found.true, found.recorded
    np.testing.assert_allclose(seen.x[3:], true.x[:-3], atol=1e-12)
    np.testing.assert_allclose(seen.x[:3], true.x[0])
    np.testing.assert_allclose(seen.psi[3:], true.psi[:-3] + 0.05, atol=1e-12)
    np.testing.assert_allclose(seen.r[3:], true.r[:-3] - 0.01, atol=1e-12)


def test_the_vessel_s_compass_may_be_knocked_on_the_way(folder):
    """As its file says, 0.2 rad from 10.1 s on: the reading after that shows half of it."""
    knocked = (folder / "boat.toml").read_text() + (
        '\n[[effect]]\nname = "heading-offset"\nangle = 0.2\ntime = 10.1\n'
    )
    (folder / "knocked.toml").write_text(knocked)
    found = run(mission_of(document(vessel={"file": "knocked.toml"}), folder))
    off = found.recorded.psi - found.true.psi
    assert PERIOD == 0.2
    after = found.true.t > 10.1
    np.testing.assert_allclose(off[after][1:], 0.2, atol=1e-12)
    assert off[after][0] == pytest.approx(0.1)
    np.testing.assert_allclose(off[~after], 0.0, atol=1e-12)


def test_orders_stay_within_the_limits_and_the_numbers_count_them(folder):
    given = document()
    given["controller"]["limits"] = {"port": [60.0, 90.0]}
    found = run(mission_of(given, folder))
    told, orders = scores(found)["orders"], found.true.commanded["port"]
    assert orders.min() == 60.0 and orders.max() == 90.0
    at = (orders == 60.0) | (orders == 90.0)
    assert told["port"]["at_limit"] == pytest.approx(at.mean())
    assert told["port"]["limit_events"] == at[0] + np.sum(np.diff(at.astype(int)) == 1)
    assert (told["port"]["lower"], told["port"]["upper"]) == (60.0, 90.0)
    assert (told["starboard"]["lower"], told["starboard"]["upper"]) == (-180.0, 250.0)
    rate = np.abs(np.diff(orders)).max() / PERIOD
    assert told["port"]["largest_rate"] == pytest.approx(rate)


def test_the_controller_believes_in_its_model_and_the_numbers_say_where_it_differs(folder):
    given = document(model={"file": "boat.toml", "parameters": {"X_u": -30.0}})
    del given["controller"]["throttle"]
    given["controller"] |= {"speed": 1.2, "speed_law": {"gain": 0.0, "integral_gain": 0.0}}
    found = run(mission_of(given, folder))
    # Half of the thrust that holds 1.2 m/s in the model, as long as nothing is steered.
    believed = 30.0 * 1.2 + 20.0 * 1.2**2
    orders = found.true.commanded
    np.testing.assert_allclose((orders["port"] + orders["starboard"])[:-1], believed, rtol=1e-6)
    assert scores(found)["model_differs"] == {"X_u": {"vessel": -60.0, "model": -30.0}}
    for vessel, drag in ((found.setup.controller.inner.allocation.vessel, -30.0),
                         (found.setup.vessel, -60.0)):  # fmt: skip
        assert float(vessel.forces["damping"].derivatives["X_u"]) == drag


def test_a_vessel_that_is_turned_further_from_its_path_went_the_wrong_way(folder):
    # In its model the thrusters have changed places: it steers to starboard for port.
    swapped = copy.deepcopy(SHIP)
    for thruster in swapped["thruster"]:
        thruster["y"] *= -1
    (folder / "swapped.toml").write_text(tomli_w.dumps(swapped))
    right = scores(run(mission_of(document(), folder)))["wrong_way"]
    wrong = scores(run(mission_of(document(model={"file": "swapped.toml"}), folder)))["wrong_way"]
    assert right == {"events": 0, "seconds": 0}
    assert wrong["events"] >= 1 and wrong["seconds"] > 5 * math.sqrt(4.9 / 9.81)


# -- timed steps


def test_timed_orders_hold_from_their_time_and_are_run_as_the_oracle_runs_them(folder):
    steps = [
        {"time": 0.0, "orders": {"port": 60.0, "starboard": 50.0}},
        {"time": 10.0, "orders": {"port": 20.0}},
    ]
    given = {"vessel": {"file": "boat.toml"}, "seconds": 30.0, "period": 0.2, "time_step": 0.05,
             "controller": {"kind": "orders"}, "step": steps}  # fmt: skip
    found = run(mission_of(given, folder))
    assert found.true.commanded["port"][49] == 60.0 and found.true.commanded["port"][50] == 20.0
    assert np.all(found.true.commanded["starboard"] == 50.0)
    sim = Simulator(SHIP, command={"port": 60.0, "starboard": 50.0})
    sim.run(10.0)
    sim.order({"port": 20.0})
    sim.run(30.0)
    end = [getattr(found.true, channel)[-1] for channel in ("x", "y", "psi")]
    np.testing.assert_allclose(end, sim.state[:3], atol=1e-5)
    assert scores(found)["outcome"] == "completed" and found.true.t[-1] == 30.0


def test_courses_and_speeds_are_followed_by_the_clock(folder):
    steps = [
        {"time": 0.0, "heading": 0.0, "speed": 1.2},
        {"time": 40.0, "heading": 1.0, "speed": 0.8},
    ]
    controller = {"kind": "course", "heading": {"integral_gain": 0.0}}
    given = {"vessel": {"file": "boat.toml"}, "seconds": 200.0, "controller": controller}
    given["step"] = steps
    found = run(mission_of(given, folder))
    t, true, told = found.true.t, found.true, scores(found)
    before = np.searchsorted(t, 39.9)
    assert true.psi[before] == pytest.approx(0.0, abs=1e-3)
    assert true.u[before] == pytest.approx(1.2, abs=1e-3)
    assert true.psi[-1] == pytest.approx(1.0, abs=0.01) and true.u[-1] == pytest.approx(
        0.8, abs=0.01
    )
    assert told["heading_error"]["largest"] == pytest.approx(1.0, abs=0.03)
    asked = np.where(t < 40.0 - 1e-9, 1.2, 0.8)
    assert told["speed_error"]["rms"] == pytest.approx(np.sqrt(np.mean((true.u - asked) ** 2)))


def test_a_path_that_is_not_finished_is_given_up_after_its_time(folder):
    told = scores(run(mission_of(document(seconds=10.0), folder)))
    assert told["outcome"] == "time-limit" and told["time"] == pytest.approx(10.0)
    assert told["outcome_message"] == "the time was up before the end of the path was reached"


# -- other controllers


def test_pursuit_and_track_keeping_reach_their_waypoints(folder):
    for kind in ("pursuit", "track-keeping"):
        given = document(controller={"kind": kind, "speed": 1.2, "radius": RADIUS}, seconds=120.0)
        del given["start"]
        told = scores(run(mission_of(given, folder)))
        assert told["outcome"] == "completed", kind
        assert told["waypoints"][-1]["closest_approach"] < RADIUS + 0.5


def test_a_track_keeper_knows_the_weather_of_its_model_where_it_is_asked_to(folder):
    kept = {"kind": "track-keeping", "speed": 1.2, "radius": RADIUS, "feedforward": True}
    keeper = setup(mission_of(document(controller=kept), folder)).controller.inner
    assert keeper.feedforward
    del kept["feedforward"]
    assert not setup(mission_of(document(controller=kept), folder)).controller.inner.feedforward
    with pytest.raises(UserError, match="feedforward = 1 is neither true nor false"):
        mission_of(document(controller=kept | {"feedforward": 1}), folder)


def test_a_setup_is_what_the_mission_states(folder):
    made = setup(mission_of(document(), folder))
    assert made.times[:3] == (SECONDS, PERIOD, 0.05)
    guidance = made.controller.inner.steering.guidance
    assert isinstance(guidance, LineOfSight)
    assert (float(guidance.lookahead), float(guidance.radius)) == (LOOKAHEAD, RADIUS)
    plain = copy.deepcopy(document())
    del plain["start"], plain["seconds"]
    start = setup(mission_of(plain, folder)).start
    assert float(start.psi) == 0.0 and float(start.u) > 0
