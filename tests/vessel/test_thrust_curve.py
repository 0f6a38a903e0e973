"""Thrusters ordered in other units than newtons: the law by hand, and what gives orders."""

import copy
import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.oracle.actuators import acting
from tests.paths import DATA

from diffsea import EFFECTS, Environment, State, UserError, named
from diffsea.identification.coordinates import expansion_points
from diffsea.parameters import replace
from diffsea.simulation.actuation import executed_by
from diffsea.simulation.control import ControlAllocation, full_throttle, throttle_for
from diffsea.simulation.control.waypoints import dynamic_pd
from diffsea.simulation.replay import replay as predict_run
from diffsea.trajectory import Trajectory
from diffsea.vessel.files import build, dump, read_vessel, updated_document


HULL = {
    "length": 5.0, "beam": 2.0, "draught": 0.3, "mass": 200.0, "I_z": 400.0,
    "X_udot": -10.0, "Y_vdot": -120.0, "N_rdot": -200.0, "X_u": -50.0, "Y_v": -200.0, "N_r": -800.0,
}  # fmt: skip
CURVE = {"deadband": 0.1, "exponent": 1.6, "astern_ratio": 0.4, "full_thrust": 80.0}
SCALES = {"percent": (0, 100, -100), "normalised": (0, 1, -1), "us": (1500, 1900, 1100)}


def document(**table):
    sides = (("port", -0.8), ("starboard", 0.8))
    return {
        "hull": HULL,
        "thruster": [{"name": n, "x": -2.0, "y": y, **copy.deepcopy(table)} for n, y in sides],
    }


def surge(vessel, order, u=0.0):
    """Thrust of both thrusters ahead (N), each at an order."""
    state = State(*(np.asarray(value, float) for value in (0.0, 0.0, 0.0, u, 0.0, 0.0)))
    executed = dict.fromkeys(vessel.channels, order)
    parts = vessel.breakdown(state, executed, Environment(), 0.0)
    return float(sum(parts[name].X for name in vessel.actuators))


def law(share, deadband, exponent, astern_ratio, full_thrust):
    """The thrust of one thruster (N) by cases."""
    size = min(abs(share), 1.0)
    if size <= deadband:
        return 0.0
    push = full_thrust * ((size - deadband) / (1 - deadband)) ** exponent
    return push if share > 0 else -astern_ratio * push


@pytest.mark.parametrize("unit", SCALES)
@pytest.mark.parametrize("turned", [False, True])
def test_thrust_follows_the_curve_about_neutral_and_full_order_is_full_thrust(unit, turned):
    vessel = build(document(unit=unit, reversed=turned, thrust_curve=CURVE))
    neutral, ahead, _ = SCALES[unit]
    assert vessel.units == {"port": unit, "starboard": unit}
    for share in (-1.7, -1.0, -0.6, -0.11, -0.05, 0.0, 0.05, 0.11, 0.6, 1.0, 1.7):
        order = neutral + (-1 if turned else 1) * share * (ahead - neutral)
        assert surge(vessel, order) == pytest.approx(2 * law(share, **CURVE), abs=1e-9), share
        servo = vessel.servos["port"]
        limited = neutral + (-1 if turned else 1) * np.clip(share, -1, 1) * (ahead - neutral)
        assert float(servo.target(order)) == pytest.approx(limited)


def test_a_scale_of_orders_need_not_be_even():
    scale = {"neutral": 1480, "full_ahead": 1900, "full_astern": 1200}
    vessel = build(document(unit="us", thrust_curve=CURVE, **scale))
    assert surge(vessel, 1480 + 0.5 * 420) == pytest.approx(2 * law(0.5, **CURVE))
    assert surge(vessel, 1480 - 0.5 * 280) == pytest.approx(2 * law(-0.5, **CURVE))
    turned = build(document(unit="us", thrust_curve=CURVE, reversed=True, **scale))
    assert surge(turned, 1480 + 0.5 * 280) == pytest.approx(2 * law(-0.5, **CURVE))
    assert (turned.servos["port"].lower, turned.servos["port"].upper) == (1060, 1760)


def test_forces_still_limit_what_is_ordered():
    vessel = build(document(unit="percent", thrust_curve=CURVE, max_force=30, min_force=-10))
    ends = [float(vessel.servos["port"].target(order)) for order in (-100.0, 100.0)]
    np.testing.assert_allclose([surge(vessel, end) for end in ends], [-20.0, 60.0], rtol=1e-9)


def test_limits_alone_say_a_straight_line():
    vessel = build(document(unit="normalised", max_force=250.0, min_force=-180.0))
    found = [surge(vessel, order) for order in (-1.0, -0.5, 0.0, 0.2, 1.0)]
    np.testing.assert_allclose(found, [-360.0, -180.0, 0.0, 100.0, 500.0], rtol=1e-12)


def test_revolutions_per_minute_are_sixty_per_second():
    curve = {"c": -0.8, "d": 0.5}
    minutes = build(document(unit="rpm", curve=curve, max_force=60.0, max_speed=900.0))
    seconds = build(document(unit="rev/s", curve=curve, max_force=60.0, max_speed=15.0))
    without = build(document(curve=curve, max_force=60.0, max_speed=15.0))
    assert [v.servos["port"].upper for v in (minutes, seconds)] == [900.0, 15.0]
    for speed in (-7.0, 0.0, 11.0):
        X = 2 * (-0.8 * 1.5 * speed + 0.5 * abs(speed) * speed)
        for vessel, order in ((minutes, 60 * speed), (seconds, speed), (without, speed)):
            assert surge(vessel, order, u=1.5) == pytest.approx(X, abs=1e-9)
    throttle = float(throttle_for(seconds, 1.5))
    assert float(throttle_for(minutes, 1.5)) == pytest.approx(throttle, rel=1e-9)
    assert float(full_throttle(minutes)) == pytest.approx(float(full_throttle(seconds)))


@pytest.mark.parametrize("turned", [False, True])
def test_control_allocation_orders_the_thrust_that_is_wanted(turned):
    vessel = build(document(unit="us", reversed=turned, thrust_curve=CURVE))
    allocation = ControlAllocation(vessel)
    for thrust in (-40.0, -3.0, 0.0, 1e-3, 25.0, 120.0):
        orders = allocation.orders(thrust, 0.0)
        assert orders["port"] == orders["starboard"]
        assert surge(vessel, orders["port"]) == pytest.approx(thrust, abs=1e-9)
    assert float(allocation.orders(0.0, 0.0)["port"]) == 1500.0
    assert float(full_throttle(vessel)) == pytest.approx(160.0)
    assert float(throttle_for(vessel, 1.2)) == pytest.approx(50.0 * 1.2)
    # Angle over 35 deg is the difference of the thrusts over their sum, positive to starboard.
    pair = vessel.thrusts_at_rest
    orders = allocation.orders(60.0, np.radians(17.5))
    port, starboard = (float(pair[name](orders[name])) for name in ("port", "starboard"))
    assert (port - starboard) / (port + starboard) == pytest.approx(0.5)
    assert port + starboard == pytest.approx(60.0)


def test_the_pd_law_of_pairs_counts_its_orders_from_neutral():
    gains = {"K_p": 40.0, "K_d": 0.0, "T_f": 1.0, "base_min": 80.0, "base_max": 200.0}
    gains |= {"near": 5.0, "far": 20.0, "radius": 2.0, "largest": 400.0}
    zero = np.zeros(())
    state = State(zero, zero, zero + 0.2, zero, zero, zero)

    points = np.array([[50.0, 0.0]])

    def orders(**table):
        law = dynamic_pd(build(document(thrust_curve=CURVE, **table)), points, **gains)
        made = law.step(law.init(), state, zero, 0.1)[1]
        return np.array([float(made["port"]), float(made["starboard"])])

    even = orders(unit="us", neutral=0, full_ahead=400, full_astern=-400)
    assert even[0] != even[1]
    np.testing.assert_allclose(orders(unit="us"), 1500 + even)
    np.testing.assert_allclose(orders(unit="us", reversed=True), 1500 - even)


def test_a_dead_band_of_the_servo_is_about_neutral():
    vessel = build(document(unit="us", max_force=50.0, deadband=30.0, time_constant=0.4))
    servo = vessel.servos["port"]
    found = [float(servo.target(order)) for order in (1480.0, 1500.0, 1531.0, 1440.0)]
    np.testing.assert_allclose(found, [1500.0, 1500.0, 1501.0, 1470.0])


def test_numbers_of_the_curve_are_parameters_and_go_back_into_the_file(tmp_path):
    given = document(unit="us", reversed=True, thrust_curve=CURVE, full_ahead=1850)
    vessel = build(given)
    names = {name.removeprefix("port.") for name in named(vessel) if name.startswith("port.")}
    curve = {f"thrust_curve.{key}" for key in CURVE}
    assert curve | {"neutral", "full_ahead", "full_astern"} <= names
    moved = {"port.thrust_curve.exponent": 2.0, "port.thrust_curve.deadband": 0.2,
             "port.full_ahead": 1900.0, "port.neutral": 1490.0}  # fmt: skip
    changed = updated_document(given, moved, [])
    (tmp_path / "vessel.toml").write_text(dump(changed))
    again = read_vessel(tmp_path / "vessel.toml").vessel
    both = named(again), named(replace(vessel, moved))
    for name in both[0]:  # limits of orders are the file's
        if not name.endswith((".lower", ".upper")):
            assert both[0][name] == both[1][name], name
    expected = law(-0.5, **CURVE | {"exponent": 2.0, "deadband": 0.2})
    assert float(again.thrusts_at_rest["port"](1490.0 + 0.5 * 390.0)) == pytest.approx(expected)
    assert given["thruster"][0]["thrust_curve"] == CURVE
    speed = document(curve={"c": -0.1, "d": 0.5})
    assert updated_document(speed, {"port.curve.1": 0.6}, [])["thruster"][0]["curve"]["d"] == 0.6


def test_thrust_has_derivatives_by_every_number_of_its_curve():
    vessel = build(document(unit="us", thrust_curve=CURVE))
    names = ["port.neutral", "port.full_ahead", "port.full_astern"]
    names += [f"port.thrust_curve.{key}" for key in CURVE]

    def thrust(values, order):
        return replace(vessel, values).thrusts_at_rest["port"](order)

    at = {name: float(named(vessel)[name]) for name in names}
    for order in (1700.0, 1260.0):
        slopes = jax.grad(thrust)(at, order)
        for name, value in at.items():
            h = 1e-6 * max(value, 1.0)
            up, down = (float(thrust(at | {name: value + d}, order)) for d in (h, -h))
            assert float(slopes[name]) == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-7)
    assert all(np.isfinite(s) for s in jax.grad(thrust)(at, 1500.0).values())


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"unit": "pct"}, r"unknown unit = 'pct'.*'port'?|unknown unit"),
        ({"unit": "percent"}, "how much thrust full order makes; give full_thrust"),
        ({"unit": "N", "thrust_curve": CURVE}, r"needs full_ahead \(N\)"),
        ({"unit": "us", "max_force": 5.0, "full_ahead": 1100}, "reversed = true"),
        ({"unit": "us", "max_force": 5.0, "curve": {"c": 0, "d": 1}}, "rev/s or rpm, not in us"),
        ({"curve": {"c": 0, "d": 1}, "thrust_curve": CURVE}, "not both"),
        ({"unit": "rpm"}, "curve = {c = .., d = ..}"),
        ({"unit": "us", "thrust_curve": {"full_thrust": -1.0}}, "full_thrust = -1 must be pos"),
        ({"unit": "us", "thrust_curve": CURVE | {"deadband": 1.2}}, "deadband = 1.2 is a share"),
        ({"unit": "us", "thrust_curve": CURVE | {"exponent": 0.0}}, "exponent = 0 must be pos"),
        ({"unit": "us", "thrust_curve": CURVE | {"exponnt": 1.0}}, "mean 'exponent'"),
        ({"unit": "us", "thrust_curve": 3.0}, "thrust_curve is a table"),
        ({"unit": "us", "max_force": 5.0, "reversed": "yes"}, "neither true nor false"),
        ({"full_ahead": 20.0}, "belong to a thrust_curve"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_with_what_to_do(table, message):
    with pytest.raises(UserError, match=message) as error:
        build(document(**table))
    assert "[[thruster]] 'port'" in str(error.value)


@pytest.mark.skipif(not (DATA / "kingfisher_nps_2017").exists(), reason="recordings are absent")
def test_the_bollard_curve_of_kingfisher_is_within_the_law():
    table = DATA / "kingfisher_nps_2017" / "tcurve.csv"
    rows = list(csv.reader(table.read_text().splitlines()))[1:]
    order, measured = np.array(rows, float).T
    keys = ("deadband", "exponent", "astern_ratio", "full_thrust")
    ahead = 0.7  # full thrust is reached here and stays, as the table shows

    def miss(values):
        curve = dict(zip(keys, values, strict=True))
        return np.array([law(s / ahead, **curve) for s in order]) - measured

    fitted = least_squares(miss, [0.1, 1.0, 0.3, 20.0], bounds=([0, 0.2, 0, 1], [0.9, 5, 2, 99]))
    curve = dict(zip(keys, map(float, fitted.x), strict=True))
    scale = {"full_ahead": ahead, "full_astern": -ahead}
    vessel = build(document(unit="normalised", thrust_curve=curve, **scale))
    found = np.array([surge(vessel, s) / 2 for s in order])
    np.testing.assert_allclose(found - measured, fitted.fun, atol=1e-9)
    # The last four orders ahead, all beyond full thrust, scatter by 0.45 N.
    scatter = np.std(measured[:4], ddof=1)
    assert np.sqrt(np.mean((found - measured) ** 2)) < 2 * scatter


# Azimuth thrusters


def azimuth(**table):
    thruster = {"name": "pod", "x": -1.5, "y": 0.4, **table}
    return build({"hull": HULL, "azimuth_thruster": [thruster]})


@pytest.mark.parametrize("unit", ["rpm", "rev/s"])
def test_an_azimuth_thruster_takes_shaft_speeds(unit):
    d, per_second, angle, u, v, r = 0.5, {"rpm": 60.0, "rev/s": 1.0}[unit], 0.7, 1.5, -0.2, 0.1
    vessel = azimuth(unit=unit, curve={"c": -0.8, "d": d})
    assert vessel.units == {"pod.force": unit, "pod.angle": "rad"}
    state = State(*(np.asarray(value, float) for value in (0, 0, 0, u, v, r)))
    pod = vessel.actuators["pod"]
    made = pod.force({"pod.force": 6.0 * per_second, "pod.angle": angle}, state, {})
    way = np.array([np.cos(angle), np.sin(angle)])
    advance = way @ (u - 0.4 * r, v - 1.5 * r)
    X, Y = (-0.8 * advance * 6.0 + d * 36.0) * way
    np.testing.assert_allclose(made.stacked, [X, Y, -1.5 * Y - 0.4 * X], rtol=1e-12)
    still = azimuth(unit=unit, curve={"d": d}).thrusts_at_rest["pod.force"]
    assert float(still(6.0 * per_second)) == pytest.approx(18.0)


def turns(vessel, first, then, seconds=3.0, step=0.05):
    """Executed angle (rad) after an order that comes a step after the first one."""
    t = step * np.arange(round(seconds / step))
    return t, executed_by(vessel.servos["pod.angle"], t, np.where(t < step, first, then))


@pytest.mark.parametrize("stages", [{"angle_rate_limit": 0.4}, {"angle_time_constant": 0.5},
                                    {"angle_rate_limit": 0.4, "angle_time_constant": 0.3},
                                    {"angle_rate_limit": 0.4, "delay": 0.12}])  # fmt: skip
@pytest.mark.parametrize("first", [175.0, -175.0])
def test_an_angle_turns_the_short_way(stages, first):
    orders = np.radians([first, -first])
    _, executed = turns(azimuth(**stages), *orders)
    way = np.sign(first) * np.degrees(executed) - 175.0
    assert way.max() <= 10.0 + 1e-9 and way.min() > -1e-9 and way[-1] > 9.9
    assert np.all(np.diff(way) > -1e-9)


def test_a_slewing_angle_takes_as_long_as_the_short_way_is():
    t, executed = turns(azimuth(angle_rate_limit=0.4), *np.radians([150.0, -130.0]))
    expected = np.radians(150) + 0.4 * np.clip(t - 0.05, 0.0, np.radians(80) / 0.4)
    np.testing.assert_allclose(executed, expected, atol=1e-9)


def test_limits_of_an_angle_are_not_turned_through():
    narrow = azimuth(angle_rate_limit=2.0, max_angle=2.9, min_angle=-2.9)
    _, executed = turns(narrow, 2.8, -2.8, seconds=4.0)
    assert np.all(np.diff(executed) < 1e-9) and executed[-1] == pytest.approx(-2.8)
    whole = azimuth(angle_rate_limit=2.0, max_angle=3.1416, min_angle=-3.1416)
    assert turns(whole, 2.8, -2.8)[1].min() > 2.7


def test_recorded_angles_count_their_turns_and_wrapped_ones_move_the_vessel_alike():
    t = 0.1 * np.arange(200)
    angle = 0.05 * np.arange(200) - 4.0
    wrapped = np.mod(angle + np.pi, 2 * np.pi) - np.pi
    zero = np.zeros(t.size)

    def predicted(orders, executed):
        more = {} if executed is None else {"pod.angle": executed}
        run = Trajectory(t, *(zero,) * 6, commanded={"pod.force": zero + 30.0, "pod.angle": orders},
                         executed=more, extra={}, valid=np.ones(t.size, bool))  # fmt: skip
        return predict_run(azimuth(angle_time_constant=0.6), run)

    for executed in (None, (angle, wrapped)):
        one, other = (
            predicted(o, None if executed is None else executed[k])
            for k, o in enumerate((angle, wrapped))
        )
        for channel in ("x", "y", "psi", "r"):
            np.testing.assert_allclose(
                getattr(one, channel), getattr(other, channel), atol=1e-9, err_msg=channel
            )


# The effect


OFF = {"deadband": 20.0, "exponent": 1.4, "astern_ratio": 0.5, "limit": 260.0}


@pytest.mark.parametrize("turned", [False, True])
def test_a_thrust_unlike_its_curve_is_stated_from_neutral_in_the_unit_of_the_orders(turned):
    table = document(unit="us", reversed=turned, thrust_curve=CURVE)
    off = build(table | {"effect": [{"name": "thrust-curve", "actuators": ["port"], **OFF}]})
    for above in (-390.0, -150.0, -10.0, 0.0, 15.0, 90.0, 255.0, 400.0):
        order = 1500 + (-above if turned else above)
        parts = off.breakdown(
            State(*(np.zeros(()),) * 6), {"port": order, "starboard": order}, Environment(), 0.0
        )
        stated = law(above / 400, **CURVE)
        assert float(parts["starboard"].X) == pytest.approx(stated, abs=1e-9)
        other = law(acting(above, 400.0, **OFF) / 400, **CURVE)
        assert float(parts["port"].X) == pytest.approx(other, abs=1e-9)


def test_parameters_of_the_effect_are_those_of_its_coordinates():
    effect, vessel = EFFECTS["thrust-curve"], build(document(max_force=250.0))
    back = effect.decode(vessel, np.array(effect.encode(vessel, OFF | {"limit": 110.0})))
    assert {k: pytest.approx(float(v)) for k, v in back.items()} == OFF | {"limit": 110.0}
    none = effect.decode(vessel, np.zeros(4))
    assert none["exponent"] == none["astern_ratio"] == 1 and none["deadband"] == 0
    assert float(none["limit"]) > 1.5 * 250  # more than is ever ordered


@pytest.mark.parametrize(
    ("keys", "message"),
    [({"exponent": 0.0}, "exponent = 0 must be positive"), ({"deadband": -1.0}, "deadband = -1"),
     ({"width": 3.0}, "unknown key 'width'"), ({"actuators": ["prt"]}, "mean 'port'")],
)  # fmt: skip
def test_an_impossible_effect_is_refused(keys, message):
    with pytest.raises(UserError, match=message):
        build(document(max_force=250.0) | {"effect": [{"name": "thrust-curve", **keys}]})


@pytest.mark.parametrize("name", ["thrust-curve", "thrust-curve:law"])
def test_a_curve_has_neither_dead_band_nor_loss_below_zero(name):
    """There a fit finds no change any more, and the estimate keeps the error of its coordinate."""
    vessel, effect = read_vessel("blueboat").vessel, EFFECTS[name]

    def thrust(amount, place):
        at = jnp.zeros(len(effect.coordinates)).at[1].set(0.4).at[place].set(amount)
        port = effect.apply(vessel, at).propulsors["port"]
        return port.thrust_at_rest(port.servos["port"].acting(33.0))

    for place in (0, 3):
        below, absent = thrust(-0.3, place), thrust(0.0, place)
        assert below == absent and jax.grad(thrust)(-0.3, place) == 0
        assert jax.grad(thrust)(0.0, place) < 0  # and at zero what is possible tells its direction
    at = jnp.zeros(len(effect.coordinates)).at[0].set(-0.3)
    told = lambda at: effect.decode(vessel, at)["deadband"]
    assert told(at) == 0 and jax.grad(told)(at)[0] == 1


@pytest.mark.parametrize(("name", "number"), [("thrust-curve", 7), ("thrust-curve:law", 8)])
def test_laws_that_act_together_are_tried_together(name, number):
    """In all combinations but none of them, measured by the first that is there."""
    points = expansion_points(EFFECTS[name], read_vessel("blueboat").vessel, [(0.0, 60.0)])
    tried = [point for point in points if point.secant]
    assert len({point.at for point in tried}) == len(tried) == number
    for point in tried:
        (index,) = point.directions
        assert point.at[index] != 0 and not any(point.at[:index])
