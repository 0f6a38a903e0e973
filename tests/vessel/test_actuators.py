"""The family of actuators: what every kind of a vessel file must do, in pairs on one hull."""

import jax
import numpy as np
import pytest

from diffsea import Environment, State, UserError
from diffsea.simulation.control import ControlAllocation
from diffsea.vessel.actuators import ACTUATORS
from diffsea.vessel.files import build


HULL = {
    "length": 5.0, "beam": 2.0, "draught": 0.3, "mass": 200.0, "I_z": 400.0,
    "X_udot": -10.0, "Y_vdot": -120.0, "N_rdot": -200.0, "X_u": -50.0, "Y_v": -200.0, "N_r": -800.0,
}  # fmt: skip

# What a table must have; each case stands twice, on either side of the centreline.
CASES = {
    "thruster": {"x": -2.0},
    "azimuth_thruster": {"x": -2.0},
    "tunnel_thruster": {"x": 1.5},
    "propeller": {"x": -2.0, "diameter": 0.3, "k_T": [0.4, -0.3, -0.1]},
    "rudder": {"area": 0.1},
}
VARIANTS = {
    **{kind: (kind, table) for kind, table in CASES.items()},
    "thruster with a curve": ("thruster", {"x": -2.0, "curve": {"c": -0.1, "d": 0.5}}),
    "thruster in rpm": ("thruster", {"x": -2.0, "unit": "rpm", "curve": {"c": -0.1, "d": 0.5}}),
    "thruster in per cent": ("thruster", {"x": -2.0, "unit": "percent", "max_force": 30.0}),
    "thruster in us": (
        "thruster",
        {
            "x": -2.0,
            "unit": "us",
            "reversed": True,
            "thrust_curve": {"full_thrust": 30.0, "exponent": 1.6, "deadband": 0.1},
        },
    ),
    "azimuth thruster ahead": ("azimuth_thruster", {"x": 2.0}),
    "azimuth thruster in rev/s": (
        "azimuth_thruster",
        {
            "x": -2.0,
            "unit": "rev/s",
            "curve": {"c": -0.1, "d": 0.5},
        },
    ),
}


def boat(variant, **more):
    kind, table = VARIANTS[variant]
    sides = [{"name": side, **table, **more} for side in ("port", "starboard")]
    for part, y in zip(sides, (-0.8, 0.8), strict=True):
        part |= {} if kind == "tunnel_thruster" else {"y": y}
    return build({"hull": HULL, kind: sides})


def forces(vessel, executed, u=0.0, v=0.0, r=0.0):
    """Surge force, sway force and yaw moment of all actuators together."""
    state = State(*(np.asarray(value, float) for value in (0.0, 0.0, 0.0, u, v, r)))
    parts = vessel.breakdown(state, executed, Environment(), 0.0)
    return np.sum([np.asarray(parts[name].stacked) for name in vessel.actuators], axis=0)


def test_every_kind_of_a_vessel_file_is_in_the_family():
    assert set(CASES) == set(ACTUATORS)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_throttle_drives_ahead_what_is_for_propulsion(variant):
    vessel = boat(variant)
    orders = ControlAllocation(vessel).orders(8.0, 0.0)
    assert tuple(orders) == vessel.channels
    X, Y, N = forces(vessel, orders)
    assert (X > 0) == bool(vessel.propulsors)
    np.testing.assert_allclose([Y, N], 0.0, atol=1e-12)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_throttle_in_newtons_is_the_thrust_of_all_together(variant):
    vessel = boat(variant)
    in_newtons = [p for p in vessel.propulsors.values() if p.bollard_coefficient is None]
    if in_newtons and len(in_newtons) == len(vessel.propulsors):
        orders = ControlAllocation(vessel).orders(8.0, 0.0)
        assert forces(vessel, orders)[0] == pytest.approx(8.0, rel=1e-12)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_positive_angle_turns_to_starboard_what_steers(variant):
    vessel = boat(variant)
    allocation = ControlAllocation(vessel)
    parts = vessel.actuators.values()
    steers = any(c.role == "steering" for part in parts for c in part.channels.values())
    differs = any(part.differential for part in parts)
    assert allocation.steerable == (steers or differs)
    N = {angle: forces(vessel, allocation.orders(8.0, angle), u=1.0)[2] for angle in (-0.2, 0.2)}
    if allocation.steerable:
        assert N[-0.2] < -0.1 < 0.1 < N[0.2]
    else:
        assert N[-0.2] == N[0.2]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_mirrored_motion_under_mirrored_orders_makes_the_mirrored_force(variant):
    vessel = boat(variant)
    allocation = ControlAllocation(vessel)
    one = forces(vessel, allocation.orders(8.0, 0.3), 1.2, 0.3, -0.2)
    other = forces(vessel, allocation.orders(8.0, -0.3), 1.2, -0.3, 0.2)
    np.testing.assert_allclose(other, one * [1, -1, -1], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("variant", VARIANTS)
def test_nothing_ordered_at_rest_makes_no_force_and_has_derivatives(variant):
    vessel = boat(variant)
    idle = {c: float(servo.neutral or 0.0) for c, servo in vessel.servos.items()}
    np.testing.assert_allclose(forces(vessel, idle), 0.0, atol=1e-9)

    def total(motion, executed):
        state = State(0.0, 0.0, 0.0, *motion)
        parts = vessel.breakdown(state, executed, Environment(), 0.0)
        return sum((parts[name].stacked for name in vessel.actuators), np.zeros(3))

    derivatives = jax.jacfwd(total, argnums=(0, 1))(np.zeros(3), idle)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(derivatives))


@pytest.mark.parametrize("variant", VARIANTS)
def test_stages_of_the_response_are_read_and_a_wrong_key_is_refused(variant):
    vessel = boat(variant, time_constant=0.7, delay=0.2)
    assert all(servo.delay == 0.2 for servo in vessel.servos.values())
    assert any(servo.time_constant == 0.7 for servo in vessel.servos.values())
    with pytest.raises(UserError, match=r"'time_constnat' in .*'port'.*mean 'time_constant'"):
        boat(variant, time_constnat=0.7)


def test_a_rudder_with_derivatives_turns_as_its_hull_is_scaled():
    hull = HULL | {"nondimensional": "mmg", "X_0": -0.02, "Y_v": -0.3, "N_r": -0.05}
    hull = {key: value for key, value in hull.items() if key != "X_u"}
    vessel = build({"hull": hull, "rudder": [{"name": "rudder", "N_d": 0.1, "Y_d": -0.2}]})
    X, Y, N = forces(vessel, {"rudder": 0.2}, u=2.0)
    unit = 0.5 * 1025.0 * 5.0 * 0.3 * 2.0**2 * 0.2
    np.testing.assert_allclose([X, Y, N], [0.0, -0.2 * unit, 0.1 * unit * 5.0], rtol=1e-9)
