# pyright: reportArgumentType=false
"""Headings that an estimator makes of a compass and a gyro, against the equation integrated.

The oracle's craft moves; an estimator's heading that the current of its motors deflects is
integrated by SciPy, and positions' velocities are turned into its axes.
"""

import dataclasses
import functools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE
from tests.runs import varied

import diffsea
from diffsea import EFFECTS, Trajectory, UserError
from diffsea.identification.data.dataset import make_dataset
from diffsea.identification.filter.corrections import as_shown, corrected
from diffsea.identification.filter.correlated_errors import thin_channels
from diffsea.identification.online.ekf import kalman_filter
from diffsea.missions.surroundings import instrumented
from diffsea.simulation.actuation import thrust_shares
from diffsea.simulation.replay import replay
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles


USV = load(ORACLE / "usv.toml")
FULL = {"ahead": 250.0, "astern": 180.0}  # N, of either motor
STEP, SECONDS = 0.1, 120.0
FIELD = {"amplitude": 0.2, "phase": -1.1, "time_constant": 6.0}
MOTORS = {**FIELD, "name": "hard-iron", "actuators": ["port", "starboard"]}
HULL = {**FIELD, "name": "hard-iron"}


def schedule(t):
    """Thrusts (N) to port and starboard: bursts ahead, astern and turning, with rests between."""
    rows = np.array(
        [(0, 0, 0), (10, 220, 220), (22, 0, 0), (34, 200, -40), (50, 0, 0), (60, -150, -150),
         (70, 0, 0), (80, -60, 230), (96, 120, 90), (110, 0, 0)], float
    )  # fmt: skip
    return rows[np.searchsorted(rows[:, 0], t + 1e-9, side="right") - 1, 1:]


def share(thrust):
    """Of full thrust, of one motor."""
    return thrust / FULL["ahead"] if thrust > 0 else -thrust / FULL["astern"]


@functools.cache
def true_run():
    """Times, true motion by channel, and thrusts."""
    t = np.arange(0.0, SECONDS, STEP)
    orders = [
        (begin, {"port": port, "starboard": starboard})
        for begin, (port, starboard) in ((s, schedule(s)) for s in np.arange(0.0, SECONDS, 2.0))
    ]
    sim = simulate(USV, orders, SECONDS, state=(3.0, -2.0, 0.7, 0.0, 0.0, 0.0))
    return t, sim.at(t), schedule(t)


@functools.cache
def error(of_motors=True):
    """The estimator's heading less the true one (rad) at every row, by its equation."""
    t, true, _ = true_run()
    heading = lambda at: np.interp(at, t, true["psi"])

    def rate(at, e):
        load = np.mean([share(one) for one in schedule(at)]) if of_motors else 1.0
        off = FIELD["amplitude"] * math.sin(heading(at) + e[0] - FIELD["phase"])
        return [(load * off - e[0]) / FIELD["time_constant"]]

    start = 0.0 if of_motors else steady(heading(0.0))
    return solve_ivp(rate, (0, t[-1]), [start], t_eval=t, max_step=0.02, rtol=1e-8).y[0]


def steady(psi):
    """Where an estimator that had been still for long begins."""
    e = 0.0
    for _ in range(50):
        e = FIELD["amplitude"] * math.sin(psi + e - FIELD["phase"])
    return e


def turned(motion, e):
    """What is shown of a motion where the heading is so much (rad) too great."""
    c, s = np.cos(e), np.sin(e)
    u, v = c * motion["u"] + s * motion["v"], c * motion["v"] - s * motion["u"]
    return {**motion, "psi": motion["psi"] + e, "u": u, "v": v}


def recorded(e=0.0, noise=0.0, seed=0):
    """The run with a heading that is off, and its noise as a share of a usual sensor's."""
    t, true, thrusts = true_run()
    rng, shown = np.random.default_rng(seed), turned(true, e)
    usual = {"x": 0.05, "y": 0.05, "psi": 0.005, "u": 0.02, "v": 0.02, "r": 0.003}
    shown = {c: shown[c] + noise * usual[c] * rng.standard_normal(t.size) for c in MOTION_CHANNELS}
    commanded = {"port": thrusts[:, 0], "starboard": thrusts[:, 1]}
    return Trajectory(t=t, **shown, commanded=commanded, executed={}, extra={}, valid=t >= 0)


def vessel_with(*tables):
    return build(varied(USV, effects=tables))


@pytest.mark.parametrize("table, of_motors", [(MOTORS, True), (HULL, False)])
def test_a_run_is_shown_as_its_estimator_would(table, of_motors):
    e = error(of_motors)
    assert np.ptp(e) > 0.15
    truth = recorded(e)
    shown = replay(vessel_with(table), truth)
    found = np.array([getattr(shown, c) for c in ("psi", "u", "v")])
    np.testing.assert_allclose(found, [truth.psi, truth.u, truth.v], atol=4e-3)
    plain = replay(vessel_with(), truth)
    assert np.max(np.abs(plain.psi - truth.psi)) > 0.1


@pytest.mark.parametrize("table, of_motors", [(MOTORS, True), (HULL, False)])
def test_what_an_estimator_makes_of_it_is_taken_off_before_the_filter(table, of_motors):
    vessel, shown = vessel_with(table), recorded(error(of_motors))
    dataset = make_dataset(vessel, [shown, shown])
    plain, without = corrected(vessel, dataset)
    truth = make_dataset(vessel_with(), [recorded(), recorded()]).measured
    known = np.asarray(dataset.known)
    np.testing.assert_allclose(
        np.asarray(without.measured)[known], np.asarray(truth)[known], atol=4e-3
    )
    assert plain.sensors.estimated_headings == ()
    back = as_shown(vessel, dataclasses.replace(dataset, measured=without.measured)).measured
    np.testing.assert_allclose(
        np.asarray(back)[known], np.asarray(dataset.measured)[known], atol=1e-9
    )


def test_a_late_first_heading_and_gaps_hold_the_heading_nearest_by():
    rows = np.arange(round(SECONDS / STEP))
    missing = (rows % 7 != 5) | (rows < 200)  # the first amid a burst
    seldom = lambda run: dataclasses.replace(run, psi=np.where(missing, np.nan, run.psi))
    vessel = vessel_with(MOTORS)
    dataset = make_dataset(vessel, [seldom(recorded(error()))])
    measured = np.asarray(corrected(vessel, dataset)[1].measured)
    known = np.asarray(dataset.known)[:, 2]
    truth = np.asarray(make_dataset(vessel_with(), [seldom(recorded())]).measured)
    assert 40 < known.sum() < 0.25 * known.size
    np.testing.assert_allclose(measured[known, 2], truth[known, 2], atol=7e-3)


def test_headings_that_are_no_measurements_any_more_are_read_all_the_same():
    """Of errors that follow one another one in so many is used; the estimator read every one."""
    vessel = vessel_with(MOTORS)
    dataset = make_dataset(vessel, [recorded(error())])
    thinned = thin_channels(dataset, {"psi": 8})
    assert np.asarray(thinned.known)[:, 2].sum() < 0.2 * np.asarray(dataset.known)[:, 2].sum()
    one, other = (corrected(vessel, data)[1].measured for data in (dataset, thinned))
    np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def test_without_any_heading_velocities_are_as_they_were_measured():
    shown = recorded(error())
    without = dataclasses.replace(shown, psi=np.full(shown.t.size, np.nan))
    dataset = make_dataset(vessel_with(MOTORS), [without, shown])
    found = np.asarray(corrected(vessel_with(MOTORS), dataset)[1].measured)
    first, given = np.asarray(dataset.run) == 0, np.asarray(dataset.measured)
    np.testing.assert_array_equal(found[first], given[first])
    assert np.abs(found - given)[~first].max() > 0.1  # the other run has one


@pytest.mark.slow
def test_a_fit_finds_field_and_time_constant_from_nothing():
    runs = [recorded(error(), 1.0, seed) for seed in (1, 2)]
    boat = diffsea.VesselFile(build(USV), USV, None)
    found = diffsea.fit(boat, runs, effects=["hard-iron:motors"], free=["X_u", "N_r"])
    (table,) = [t for t in found.fitted.document["effect"] if t["name"] == "hard-iron"]
    assert table["actuators"] == ["port", "starboard"]
    assert table["channels"] == ["psi", "u", "v"]
    assert table["amplitude"] == pytest.approx(FIELD["amplitude"], rel=0.05)
    assert math.remainder(table["phase"] - FIELD["phase"], 2 * math.pi) == pytest.approx(0, abs=0.1)
    assert table["time_constant"] == pytest.approx(FIELD["time_constant"], rel=0.1)


def thruster(**keys):
    own = {"name": "port", "x": -2.3, "y": -1.03, **keys}
    return build({**USV, "thruster": [own, {**own, "name": "starboard", "y": 1.03}]})


def test_the_share_of_full_thrust_is_that_of_its_own_direction():
    executed = {"port": jnp.array([125.0, -90.0, 0.0]), "starboard": jnp.array([250.0, -180.0, 5])}
    shares = thrust_shares(build(USV), executed)
    np.testing.assert_allclose(shares["port"], [0.5, 0.5, 0.0])
    np.testing.assert_allclose(shares["starboard"], [1.0, 1.0, 0.02])
    ahead = thrust_shares(thruster(max_force=200.0, min_force=0.0), executed)
    np.testing.assert_allclose(ahead["port"], [0.625, 0.45, 0.0])  # none astern: that ahead counts
    weight = 0.05 * 9.81 * 180.0
    np.testing.assert_allclose(
        thrust_shares(thruster(), executed)["port"], np.array([125, 90, 0]) / weight, rtol=1e-6
    )


@pytest.mark.parametrize(
    "keys, told",
    [
        ({}, "states no number"),
        ({"amplitude": 0.1, "time_constant": -1.0}, "time_constant = -1 s is negative"),
        ({"amplitude": 0.1, "channels": ["r"]}, "channels are"),
        ({"amplitude": 0.1, "channels": ["psi"], "time_constant": 2.0}, "turns the vel"),
        ({"amplitude": 0.1, "channels": ["psi"], "actuators": ["port"]}, "turns the vel"),
        ({"amplitude": 0.1, "actuators": ["bow"]}, "bow"),
        ({"amplitude": 0.1, "lag": 2.0}, "lag"),
    ],
)
def test_a_table_that_cannot_be_is_refused(keys, told):
    with pytest.raises(UserError, match=told):
        vessel_with({"name": "hard-iron", **keys})


def test_a_rudder_has_no_current_that_deflects_a_compass():
    ship = load(ORACLE / "ship.toml")
    rudder = ship["rudder"][0]["name"]
    with pytest.raises(UserError, match="no motor"):
        build(varied(ship, effects=[{**MOTORS, "actuators": [rudder]}]))


def test_a_ship_with_a_propeller_is_not_asked_for_an_estimated_heading():
    motors, iron = EFFECTS["hard-iron:motors"], EFFECTS["hard-iron:estimated"]
    twin, ship = build(USV), build(load(ORACLE / "ship.toml"))
    assert motors.possible(twin) and not motors.possible(ship)
    assert iron.usual(twin) and iron.possible(ship) and not iron.usual(ship)
    assert motors.place.in_file(twin)["actuators"] == ["port", "starboard"]


def test_the_three_ways_in_a_file_are_told_apart():
    compass = vessel_with({"name": "hard-iron", "amplitude": 0.1, "phase": 0.3}).sensors
    assert compass.estimated_headings == () and compass.hard_iron_sin != 0
    (own,) = vessel_with(HULL).sensors.estimated_headings
    assert own.motors == () and float(own.time_constant) == 6.0
    at_once = {"name": "hard-iron", "amplitude": 0.1, "channels": ["psi", "u", "v"]}
    (turning,) = vessel_with(at_once).sensors.estimated_headings
    assert turning.motors == () and float(turning.time_constant) == 0.0
    (driven,) = vessel_with({**MOTORS, "actuators": ["port"]}).sensors.estimated_headings
    assert driven.motors == ("port",)


def test_online_and_missions_say_that_they_have_no_estimator():
    with pytest.raises(UserError, match="hard-iron of an estimator"):
        kalman_filter(vessel_with(MOTORS), ["N_r"], None)
    with pytest.raises(UserError, match="hard-iron of an estimator"):
        instrumented(None, vessel_with(MOTORS), None, {}, 1, 0.1, 0)
