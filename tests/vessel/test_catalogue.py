# pyright: reportArgumentType=false
"""Vessel files: the ones that ship, what their numbers mean, and what a bad one is told."""

import copy
import tomllib
from typing import cast

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve
from tests.diagnosis.small import linear_estimate, still_problem
from tests.paths import ORACLE

from diffsea import (
    EFFECTS,
    Environment,
    State,
    UserError,
    named,
    read_vessel,
    replace,
    shipped_vessels,
)
from diffsea.identification.estimates import (
    effect_table,
    is_known,
    parameter_records,
    parameters_with_errors,
)
from diffsea.vessel.effects.actuators import largest_order
from diffsea.vessel.effects.environment import superstructure
from diffsea.vessel.files import build, dump, updated_document


NAMES = (
    "blueboat", "esso_osaka", "kvlcc2", "mariner", "marus_usv", "otter", "pytheas", "shioji_maru",
    "vrx_wamv", "wamv",
)  # fmt: skip
CALM = Environment()
PORT_TO_STARBOARD = {"port": "starboard", "starboard": "port"}

# A moderate order for each channel and a speed within each model's range, m/s.
ORDERS = {
    "blueboat": ({"port": 20.0, "starboard": 5.0}, 1.5),
    "esso_osaka": ({"propeller": 10.0, "rudder": 0.2}, 0.4),
    "kvlcc2": ({"propeller": 11.0, "rudder": 0.2}, 1.1),
    "mariner": ({"rudder": 0.2}, 7.0),
    "marus_usv": ({"port": 60.0, "starboard": 30.0}, 0.8),
    "otter": ({"port": 10.0, "starboard": 6.0}, 1.5),
    "pytheas": ({"thruster.force": 10.0, "thruster.angle": 0.3}, 0.7),
    "shioji_maru": ({"propeller": 2.0, "rudder": 0.2, "bow": 1e4, "stern": -1e4}, 3.0),
    "vrx_wamv": ({"port": 25.0, "starboard": 15.0}, 1.0),
    "wamv": ({"port": 300.0, "starboard": 100.0}, 1.5),
}


def moving(u, v=0.0, r=0.0, psi=0.0):
    return State(*(np.asarray(value, float) for value in (0.0, 0.0, psi, u, v, r)))


def accelerations(vessel, state, executed):
    return np.array([float(a) for a in vessel.acceleration(state, executed, CALM, 0.0)])


def force_of(vessel, part, state, executed):
    return np.asarray(vessel.breakdown(state, executed, CALM, 0.0)[part].stacked)


def total_force(vessel, state, executed):
    parts = vessel.breakdown(state, executed, CALM, 0.0).values()
    return np.sum([np.asarray(part.stacked) for part in parts], axis=0)


def steady_speed(vessel, executed, low=0.01, high=20.0):
    """Speed straight ahead at which the surge force vanishes."""
    found = brentq(lambda u: total_force(vessel, moving(u), executed)[0], low, high, xtol=1e-12)
    return cast(float, found)


def steady_turn(vessel, executed, start) -> np.ndarray:
    """u, v, r at which all forces are in balance."""
    found = fsolve(lambda motion: accelerations(vessel, moving(*motion), executed), start)
    return cast(np.ndarray, found)


# -- all shipped vessels ---------------------------------------------------------------------


def test_these_vessels_ship():
    assert tuple(shipped_vessels()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_vessel_says_where_its_numbers_come_from(name):
    file = read_vessel(name)
    assert file.vessel.name == name
    assert file.document["format"] == 1
    assert len(file.vessel.source) > 40


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_vessel_has_a_positive_definite_mass_matrix(name):
    mass = np.asarray(read_vessel(name).vessel.mass_matrix())
    assert np.linalg.eigvalsh(0.5 * (mass + mass.T)).min() > 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("motion", [(1.0, 0.0, 0.0), (1.0, 0.2, -0.3), (0.6, -0.3, 0.4)])
def test_a_shipped_vessel_accelerates_finitely(name, motion):
    vessel = read_vessel(name).vessel
    executed, speed = ORDERS[name]
    u, v, turn = motion
    state = moving(u * speed, v * speed, turn * speed / vessel.rigid_body.length)
    assert set(executed) == set(vessel.channels)
    assert np.all(np.isfinite(accelerations(vessel, state, executed)))


@pytest.mark.parametrize("name", [name for name in NAMES if name != "mariner"])
def test_a_shipped_vessel_stays_at_rest_without_orders(name):
    # A Taylor series about the approach speed (mariner) means nothing at rest.
    vessel = read_vessel(name).vessel
    idle = dict.fromkeys(vessel.channels, 0.0)
    np.testing.assert_allclose(accelerations(vessel, moving(0.0), idle), 0.0, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_vessel_turns_to_starboard_on_a_starboard_order(name):
    vessel = read_vessel(name).vessel
    executed, speed = ORDERS[name]
    assert accelerations(vessel, moving(speed), executed)[2] > 0


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_vessel_resists_turning(name):
    vessel = read_vessel(name).vessel
    _, speed = ORDERS[name]
    idle = dict.fromkeys(vessel.channels, 0.0)
    turn = 0.3 * speed / vessel.rigid_body.length
    straight = force_of(vessel, "damping", moving(speed), idle)
    turning = force_of(vessel, "damping", moving(speed, r=turn), idle)
    assert turning[2] < straight[2]


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_vessel_survives_writing_and_reading_back(name, tmp_path):
    file = read_vessel(name)
    path = tmp_path / "again.toml"
    path.write_text(dump(file.document), encoding="utf-8")
    again = read_vessel(path)
    assert again.document == file.document
    assert named(again.vessel) == named(file.vessel)


# -- mirror symmetry -------------------------------------------------------------------------


def mirrored(vessel, executed):
    """The orders of the mirrored run: sides swapped, rudder reversed."""
    swapped = {PORT_TO_STARBOARD.get(c, c): value for c, value in executed.items()}
    turned = ("rudder", "bow", "stern", "thruster.angle")
    return swapped | {c: -value for c, value in executed.items() if c in turned}


def symmetric(name):
    """The vessel with its published port-starboard differences taken out.

    Three sets have some: kvlcc2 and esso_osaka straighten the flow to the rudder unequally
    (gamma_R), and mariner has the side force of its single screw (Y_0, Y_u, Y_uu and the
    same of N).
    """
    vessel = read_vessel(name).vessel
    if name in ("kvlcc2", "esso_osaka"):
        return replace(vessel, {"rudder.gamma_R_port": 0.5, "rudder.gamma_R_starboard": 0.5})
    if name == "mariner":
        screw = ("Y_0", "Y_u", "Y_uu", "N_0", "N_u", "N_uu")
        return replace(vessel, dict.fromkeys(screw, 0.0))
    return vessel


def mirror_error(name, vessel):
    executed, speed = ORDERS[name]
    v, r = 0.2 * speed, -0.4 * speed / vessel.rigid_body.length
    one = total_force(vessel, moving(speed, v, r), executed)
    other = total_force(vessel, moving(speed, -v, -r), mirrored(vessel, executed))
    return np.abs(one * [1, -1, -1] - other).max() / np.abs(one).max()


@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_motion_makes_the_mirrored_force(name):
    assert mirror_error(name, symmetric(name)) < 1e-12


@pytest.mark.parametrize("name", ["esso_osaka", "kvlcc2", "mariner"])
def test_a_set_with_unequal_sides_is_not_mirrored(name):
    assert mirror_error(name, read_vessel(name).vessel) > 1e-4


# -- closed forms and published figures ------------------------------------------------------


@pytest.mark.parametrize(("thrust", "speed"), [(100.0, 0.5486), (500.0, 1.5226), (2000.0, 10 / 3)])
def test_wamv_settles_where_its_drag_equals_the_thrust(thrust, speed):
    # The root of 150 u^2 + 100 u = thrust.
    vessel = read_vessel("wamv").vessel
    found = steady_speed(vessel, {"port": thrust / 2, "starboard": thrust / 2})
    assert found == pytest.approx((-100 + np.sqrt(1e4 + 600 * thrust)) / 300, rel=1e-9)
    assert found == pytest.approx(speed, abs=5e-5)


def test_marus_usv_turns_as_its_published_circles_by_the_balance_of_forces():
    """Steady turn of all thrust on one side: surge, sway and yaw in balance, solved by scipy."""
    vessel, hull = read_vessel("marus_usv").vessel, read_vessel("marus_usv").document["hull"]
    thrust = -(hull["X_u"] * 0.8268 + hull["X_uu"] * 0.8268**2)
    executed = {"port": thrust, "starboard": 0.0}
    u, v, r = steady_turn(vessel, executed, [0.65, -0.2, 0.13])
    diameter = 2 * np.hypot(u, v) / r / hull["length"]
    assert diameter == pytest.approx(0.5 * (3.530 + 3.686), rel=0.02)
    # The tactical diameter is the smaller one, as published, so that it drifts by 13 deg or more.
    assert np.degrees(np.arctan2(-v, u)) > 13.0


def test_vrx_wamv_reaches_the_published_largest_speed_at_its_largest_order():
    # X_u u = 2 (c u n + d n^2) at 29.9 rev/s, 250 N; published 1.5 m/s.
    vessel, n = read_vessel("vrx_wamv").vessel, 29.9
    speed = steady_speed(vessel, {"port": n, "starboard": n})
    assert speed == pytest.approx(2 * 0.299914 * n**2 / (340 + 2 * 0.397956 * n), rel=1e-9)
    assert speed == pytest.approx(1.5, abs=0.05)


def test_wamv_has_the_published_yaw_inertia_about_the_origin():
    assert float(read_vessel("wamv").vessel.mass_matrix()[2, 2]) == pytest.approx(704.0, rel=1e-5)


def test_wamv_engines_turn_it_by_their_arm():
    vessel = read_vessel("wamv").vessel
    made = sum(
        force_of(vessel, side, moving(0.0), {"port": 300.0, "starboard": 100.0})
        for side in ("port", "starboard")
    )
    np.testing.assert_allclose(made, [400.0, 0.0, 1.027 * 200.0], rtol=1e-12)


def test_wamv_thrust_is_clamped():
    target = read_vessel("wamv").vessel.servos["port"].target
    assert (float(target(9000.0)), float(target(-9000.0))) == (2353.5, -1000.0)


def test_kvlcc2_holds_its_design_speed():
    # The thrust that balances the published resistance at 1.179 m/s, solved for the speed of
    # rotation by hand: rho D^4 (k0 n^2 + k1 n V + k2 V^2) (1 - t) = 1/2 rho L d U^2 R_0'.
    D, V = 0.216, 0.6 * 1.179 / 0.216
    needed = 0.5 * 7.0 * 0.46 * 1.179**2 * 0.022 / (0.78 * D**4)
    n = max(np.roots([0.2931, -0.2753 * V, -0.1385 * V**2 - needed]))
    assert n == pytest.approx(11.85, abs=0.01)
    found = steady_speed(read_vessel("kvlcc2").vessel, {"propeller": n, "rudder": 0.0})
    assert found == pytest.approx(1.179, rel=1e-6)


def test_mariner_is_steady_at_its_approach_speed():
    vessel = read_vessel("mariner").vessel
    found = steady_speed(vessel, {"rudder": 0.0}, 5.0, 9.0)
    assert found == pytest.approx(7.7175, rel=1e-9)


def test_otter_reaches_six_knots_at_full_thrust():
    vessel = read_vessel("otter").vessel
    full = {side: float(vessel.servos[side].upper) for side in ("port", "starboard")}
    assert steady_speed(vessel, full) == pytest.approx(6 * 0.5144, rel=2e-3)


def test_otter_cross_flow_drag_is_an_effect_on_top_of_the_hull():
    vessel = read_vessel("otter").vessel
    idle = {"port": 0.0, "starboard": 0.0}
    drag = force_of(vessel, "crossflow-drag", moving(0.0, 0.5), idle)
    expected = -0.5 * 1026 * 2.0 * 0.195 * 1.0 * 0.5**2
    np.testing.assert_allclose(drag, [0.0, expected, 0.0], rtol=1e-12)


def test_shioji_maru_has_the_regressions_it_names():
    hull = read_vessel("shioji_maru").document["hull"]
    L, B, d, rho, C_b = 54.0, 11.10, 3.33, 1025.0, 0.55
    assert (hull["length"], hull["beam"], hull["draught"]) == (L, B, d)
    k, q, unit = 2 * d / L, C_b * B / L, 0.5 * rho * L * d
    mass, volume = rho * L * B * d * C_b, L * B * d * C_b
    slender = 0.5 * rho * L**3 * np.pi * (d / L) ** 2
    expected = {
        "mass": mass,
        "X_udot": -2.7 * rho * volume ** (5 / 3) / L**2,
        "Y_vdot": -slender * (1 + 0.16 * C_b * B / d - 5.1 * (B / L) ** 2),
        "N_rdot": -slender * L**2 * (1 / 12 + 0.017 * C_b * B / d - 0.33 * B / L),
        "Y_uv": -unit * (0.5 * np.pi * k + 1.4 * q),
        "Y_ur": hull["mass"] - hull["X_udot"] - 1.5 * q * unit * L,
        "N_uv": -unit * L * k,
        "N_ur": unit * L**2 * (k**2 - 0.54 * k),
    }
    assert {name: hull[name] for name in expected} == pytest.approx(expected, rel=1e-3)


def test_shioji_maru_makes_eight_knots_within_its_published_blade_angles():
    # One (rev/s)^2 per degree of blade angle, and 8.7 degrees are the largest at that speed.
    speed = steady_speed(read_vessel("shioji_maru").vessel, IDLE_SHIOJI | {"propeller": 8.7**0.5})
    assert 8.0 < speed / 0.5144 < 10.0


IDLE_SHIOJI = {"propeller": 0.0, "rudder": 0.0, "bow": 0.0, "stern": 0.0}


def test_a_tunnel_thruster_pushes_less_ahead_and_by_its_effectiveness():
    document = copy.deepcopy(read_vessel("shioji_maru").document)
    document["tunnel_thruster"][0]["effectiveness"] = 0.8
    vessel, orders = build(document), IDLE_SHIOJI | {"bow": 1e4}
    np.testing.assert_allclose(
        force_of(vessel, "bow", moving(0.0), orders), [0.0, 8e3, 21.0 * 8e3], rtol=1e-12
    )
    np.testing.assert_allclose(
        force_of(vessel, "bow", moving(1.8), orders), [0.0, 4e3, 21.0 * 4e3], rtol=1e-12
    )


def test_blueboat_reaches_three_metres_per_second_at_full_thrust():
    full = {"port": 55.23, "starboard": 55.23}
    assert steady_speed(read_vessel("blueboat").vessel, full) == pytest.approx(3.06, abs=0.01)


def test_esso_osaka_makes_a_third_of_a_metre_per_second_at_ten_turns():
    found = steady_speed(
        read_vessel("esso_osaka").vessel, {"propeller": 10.0, "rudder": 0.0}, high=2.0
    )
    assert 0.34 < found < 0.40


def test_esso_osaka_turns_at_the_rate_its_model_did():
    # Free runs at 10 rev/s and 20 deg of rudder: 2.0 deg/s; steady motion from u, v, r forces.
    vessel = read_vessel("esso_osaka").vessel
    executed = {"propeller": 10.0, "rudder": 0.34}
    found = steady_turn(vessel, executed, [0.2, -0.05, 0.03])
    assert np.degrees(found[2]) == pytest.approx(2.0, rel=0.15)


def test_mariner_turns_on_the_published_radius():
    # 15 deg to port: a steady radius of 711 m (Fossen 2011, figure of the Mariner's circle).
    vessel = read_vessel("mariner").vessel
    executed = {"rudder": -np.radians(15)}
    u, v, r = steady_turn(vessel, executed, [6.0, 0.7, -0.01])
    assert np.hypot(u, v) / abs(r) == pytest.approx(711, abs=1)


# -- forces against independent arithmetic ---------------------------------------------------


@pytest.mark.parametrize(
    ("u", "v", "r"), [(1.1, 0.0, 0.0), (1.0, 0.15, -0.04), (0.8, -0.25, 0.07), (-0.3, 0.1, 0.02)]
)
def test_kvlcc2_hull_force_is_the_published_polynomial(u, v, r):
    L, d = 7.0, 0.46
    U = np.hypot(u, v)
    a, b = v / U, r * L / U
    X = -0.022 - 0.040 * a**2 + 0.002 * a * b + 0.011 * b**2 + 0.771 * a**4
    Y = (
        -0.315 * a + 0.083 * b - 1.607 * a**3
        + 0.379 * a**2 * b - 0.391 * a * b**2 + 0.008 * b**3
    )  # fmt: skip
    N = (
        -0.137 * a - 0.049 * b - 0.030 * a**3
        - 0.294 * a**2 * b + 0.055 * a * b**2 - 0.013 * b**3
    )  # fmt: skip
    expected = 500 * L * d * U**2 * np.array([X, Y, L * N])
    vessel = read_vessel("kvlcc2").vessel
    idle = {"propeller": 0.0, "rudder": 0.0}
    made = force_of(vessel, "damping", moving(u, v, r), idle)
    np.testing.assert_allclose(made, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("u", "v", "r", "delta"),
    [(1.1, 0.0, 0.0, 0.3), (0.9, -0.2, 0.06, 0.6), (1.0, 0.2, -0.05, -0.35)],
)
def test_kvlcc2_moves_by_the_published_equations(u, v, r, delta):
    # Yasukawa and Yoshimura write the motion with the centripetal terms on the left and
    # about the centre of gravity's lever; solved here as they stand.
    rho, L, d, n, D = 1000.0, 7.0, 0.46, 11.0, 0.216
    m, x_G = 3270.0, 0.25
    m_x, m_y = (prime * 0.5 * rho * L**2 * d for prime in (0.022, 0.223))
    J_z = 0.011 * 0.5 * rho * L**4 * d
    I_z = m * (0.25 * L) ** 2
    vessel = read_vessel("kvlcc2").vessel
    executed = {"propeller": n, "rudder": delta}
    hull = force_of(vessel, "damping", moving(u, v, r), executed)  # tested above

    U = np.hypot(u, v)
    beta = np.arctan(-v / u)
    w = 0.40 * np.exp(-4.0 * (beta + 0.48 * r * L / U) ** 2)
    J = (1 - w) * u / (n * D)
    K_T = 0.2931 - 0.2753 * J - 0.1385 * J**2
    thrust = rho * n**2 * D**4 * K_T
    race = 1 + 0.5 * (np.sqrt(1 + 8 * K_T / (np.pi * J**2)) - 1)
    eta = D / 0.345
    u_R = 1.09 * (1 - w) * u * np.sqrt(eta * race**2 + 1 - eta)
    inflow = U * (beta + 0.710 * r * L / U)  # U beta_R, l_R' = -0.710
    v_R = inflow * (0.395 if inflow < 0 else 0.640)
    F_N = 0.5 * rho * 0.0539 * 2.747 * (u_R**2 + v_R**2) * np.sin(delta - np.arctan2(v_R, u_R))
    X = hull[0] + 0.78 * thrust - (1 - 0.387) * F_N * np.sin(delta)
    Y = hull[1] - (1 + 0.312) * F_N * np.cos(delta)
    N = hull[2] - (-0.5 * L + 0.312 * -0.464 * L) * F_N * np.cos(delta)

    left = np.array(
        [
            [m + m_x, 0, 0],
            [0, m + m_y, x_G * m],
            [0, x_G * m, I_z + x_G**2 * m + J_z],
        ]
    )
    right = [
        X + (m + m_y) * v * r + x_G * m * r**2,
        Y - (m + m_x) * u * r,
        N - x_G * m * u * r,
    ]
    found = accelerations(vessel, moving(u, v, r), executed)
    np.testing.assert_allclose(found, np.linalg.solve(left, right), rtol=2e-6, atol=1e-9)


def published_mariner(u_total, v_total, r_total, delta):
    """Accelerations of the Mariner, from the set and the signs it is published with."""
    L, U0 = 160.93, 7.7175
    U = np.hypot(u_total, v_total)
    u, v, r, c = (u_total - U0) / U, v_total / U, r_total * L / U, -delta
    X = (
        -184 * u - 110 * u**2 - 215 * u**3 - 899 * v**2 + 18 * r**2 + 798 * r * v
        - 95 * c**2 - 190 * u * c**2 + 93 * v * c + 93 * u * v * c
    )  # fmt: skip
    Y = (
        -1160 * v - 499 * r - 8078 * v**3 + 15356 * v**2 * r - 1160 * v * u - 499 * r * u
        + 278 * c - 90 * c**3 + 556 * u * c + 278 * u**2 * c - 4 * v * c**2
        + 1190 * v**2 * c - 4 - 8 * u - 4 * u**2
    )  # fmt: skip
    N = (
        -264 * v - 166 * r + 1636 * v**3 - 5483 * v**2 * r - 264 * v * u - 166 * r * u
        - 139 * c + 45 * c**3 - 278 * u * c - 139 * u**2 * c + 13 * v * c**2
        - 489 * v**2 * c + 3 + 6 * u + 3 * u**2
    )  # fmt: skip
    m, I_z, x_G = 798.0, 39.2, -0.023
    mass = np.array(
        [
            [m + 42, 0, 0],
            [0, m + 748, m * x_G + 9.354],
            [0, m * x_G - 4.646, I_z + 43.8],
        ]
    )
    prime = np.linalg.solve(mass, [X, Y, N])
    return prime * [U**2 / L, U**2 / L, U**2 / L**2]


@pytest.mark.parametrize(
    ("u", "v", "r", "delta"),
    [
        (7.7175, 0.0, 0.0, 0.0),
        (7.7175, 0.0, 0.0, 0.35),
        (8.5, 0.2, 0.003, -0.1),
        (7.0, -0.5, 0.008, 0.35),
        (6.0, 0.7, -0.011, -0.6),
    ],
)
def test_mariner_moves_by_the_published_equations(u, v, r, delta):
    # The centripetal terms are split off with cos(beta) to second order: 1e-5 of them here.
    found = accelerations(read_vessel("mariner").vessel, moving(u, v, r), {"rudder": delta})
    scale = np.array([1e-2, 1e-2, 1e-4])  # m/s^2, m/s^2, rad/s^2: a moderate manoeuvre
    np.testing.assert_allclose(found / scale, published_mariner(u, v, r, delta) / scale, atol=5e-4)


def test_mariner_surge_terms_are_not_mirrored_in_the_speed_deviation():
    # X_uu is a Taylor term of the deviation from the approach speed, so u^2 and not |u| u.
    vessel = read_vessel("mariner").vessel
    L, U0, u = 160.93, 7.7175, 6.0
    p = (u - U0) / u
    expected = 0.5 * 1025 * L**2 * u**2 * (-184e-5 * p - 110e-5 * p**2 - 215e-5 * p**3)
    made = force_of(vessel, "damping", moving(u), {"rudder": 0.0})
    assert made[0] == pytest.approx(expected, rel=1e-9)


# -- files that cannot be used ---------------------------------------------------------------

GOOD = """
format = 1
name = "boat"
[hull]
length = 5.0
beam = 2.0
draught = 0.3
mass = 200.0
I_z = 400.0
X_udot = -10.0
Y_vdot = -120.0
N_rdot = -200.0
X_u = -50.0
Y_v = -200.0
N_r = -800.0
[[thruster]]
name = "port"
y = -1.0
max_force = 250.0
min_force = -180.0
[[thruster]]
name = "starboard"
y = 1.0
max_force = 250.0
min_force = -180.0
"""


def read_text(tmp_path, text):
    path = tmp_path / "boat.toml"
    path.write_text(text, encoding="utf-8")
    return read_vessel(path)


def test_the_good_file_of_these_tests_is_good(tmp_path):
    assert read_text(tmp_path, GOOD).vessel.channels == ("port", "starboard")


BAD = {
    "misspelt derivative": ("X_u = -50.0", "Xu = -50.0", r"unknown key 'Xu'.*mean 'X_u'"),
    "misspelt dimension": ("draught = 0.3", "draft = 0.3", r"'draft' in \[hull\].*'draught'"),
    "misspelt limit": ("max_force", "max_forse", r"'max_forse'.*'port'.*mean 'max_force'"),
    "misspelt table": ("[[thruster]]", "[[thrusters]]", r"'thrusters' in the file.*'thruster'"),
    "number as text": ("mass = 200.0", 'mass = "200 kg"', r"mass = '200 kg' is not a finite"),
    "NaN": ("X_u = -50.0", "X_u = nan", r"\[hull\]: X_u = nan is not a finite number"),
    "infinity": ("I_z = 400.0", "I_z = inf", r"I_z = inf is not a finite number"),
    "truth value": ("mass = 200.0", "mass = true", r"mass = True is not a finite number"),
    "negative mass": ("mass = 200.0", "mass = -200.0", r"mass = -200 must be positive"),
    "no length": ("length = 5.0", "", r"\[hull\]: length is missing"),
    "zero draught": ("draught = 0.3", "draught = 0", r"draught = 0 must be positive"),
    "added mass of the wrong sign": (
        "Y_vdot = -120.0", "Y_vdot = 250.0", r"not positive definite.*SNAME",
    ),
    "coupling too strong": (
        "X_udot = -10.0", "Y_rdot = 900.0\nN_vdot = 900.0", r"not positive definite",
    ),
    "limits swapped": (
        "max_force = 250.0", "max_force = -180.0", r"'port'.*lower limit -180 is not below",
    ),
    "two of one name": ('name = "starboard"', 'name = "port"', r"two actuators.*'port'"),
    "no hull": ("[hull]", "[hulls]", r"unknown key 'hulls'.*mean 'hull'"),
    "negative delay": ("y = 1.0", "y = 1.0\ndelay = -0.1", r"'starboard': delay = -0.1"),
    "no slew rate": ("y = 1.0", "y = 1.0\nrate_limit = 0", r"rate_limit must be positive"),
    "other format": ("format = 1", "format = 2", r"format = 2; this version reads format = 1"),
    "unfinished": ("[hull]", "[hull", r"not valid TOML"),
    "unknown scaling": ("[hull]", '[hull]\nnondimensional = "bis"', r'"mmg" or "abkowitz"'),
    "no reference speed": (
        "[hull]", '[hull]\nnondimensional = "abkowitz"', r"needs reference_speed",
    ),
    "unknown Coriolis terms": (
        "[hull]", '[hull]\nadded_mass_coriolis = "some"', r'"full", "no-munk" or "none"',
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_with_a_reason(case, tmp_path):
    old, new, message = BAD[case]
    assert old in GOOD
    with pytest.raises(UserError, match=message) as caught:
        read_text(tmp_path, GOOD.replace(old, new, 1 if case != "misspelt table" else -1))
    assert "boat.toml" in str(caught.value)


ADDED = {
    "unheard-of parameter": (
        '[[effect]]\nname = "current"\nfoo = 1.0', r"key 'foo'.*known are name, speed, direction"
    ),
    "unknown effect": ('[[effect]]\nname = "curent"\nspeed = 0.3', r"'curent'.*mean 'current'"),
    "misspelt parameter": (
        '[[effect]]\nname = "current"\nsped = 0.3', r"'sped' in .*'current'.*mean 'speed'",
    ),
    "effect's number as text": (
        '[[effect]]\nname = "current"\nspeed = "0.3"', r"speed = '0.3' is not a finite number",
    ),
    "rudder behind nothing": (
        '[[rudder]]\narea = 0.1\npropeller = "screw"', r"behind propeller 'screw'.*none",
    ),
    "rudder without area": ('[[rudder]]\nname = "rudder"', r"'rudder': area is missing"),
    "rudder derivative beside SI hull": (
        "[[rudder]]\nN_d = 1.0", r"rudder derivatives need \[hull\] nondimensional",
    ),
    "short polynomial": (
        "[[propeller]]\ndiameter = 0.2\nk_T = [0.3, -0.2]", r"k_T = \[k_0, k_1, k_2\]",
    ),
    "text in the polynomial": (
        '[[propeller]]\ndiameter = 0.2\nk_T = [0.3, "x", 0]', r"k_T.*'x' is not a finite number",
    ),
    "propeller without size": (
        "[[propeller]]\ndiameter = 0\nk_T = [0.3, -0.2, 0]", r"diameter = 0 must be positive",
    ),
    "rudder of negative area": ("[[rudder]]\narea = -0.1", r"area = -0.1 must be positive"),
    "a thrust curve that pushes backwards": (
        '[[thruster]]\nname = "third"\ncurve = { c = 0.0, d = -1.0 }', "d = -1 must be positive",
    ),
    "limits that get softer than soft": (
        '[[thruster]]\nname = "third"\nsharpness = -2.0', "sharpness = -2 is negative",
    ),
    "late channels that are no list": (
        '[[effect]]\nname = "sensor-latency"\ndelay = 0.1\nchannels = 5',
        "channels = 5 is not a list",
    ),
    "half a thrust curve": (
        '[[thruster]]\nname = "third"\ncurve = { d = 1.0 }', r"'third': curve = ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", ADDED)
def test_a_bad_part_is_refused_with_a_reason(case, tmp_path):
    text, message = ADDED[case]
    with pytest.raises(UserError, match=message):
        read_text(tmp_path, GOOD + text)


@pytest.mark.parametrize("kind", ["thruster", "effect"])
def test_a_table_in_single_brackets_is_refused(kind):
    document = dict(read_vessel("wamv").document) | {kind: {"name": "port"}}
    with pytest.raises(UserError, match=rf"\[\[{kind}\]\] with double brackets"):
        build(document)


def test_a_file_without_hull_is_refused():
    with pytest.raises(UserError, match=r"there is no \[hull\] table"):
        build({"format": 1, "name": "nothing"})


def test_a_misspelt_vessel_is_told_the_nearest_one():
    with pytest.raises(UserError, match="did you mean 'kvlcc2'"):
        read_vessel("kvlc2")


def test_a_folder_or_a_binary_file_is_not_a_vessel(tmp_path):
    with pytest.raises(UserError, match="is a folder"):
        read_vessel(tmp_path)
    binary = tmp_path / "boat.toml"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(UserError, match="not a text file"):
        read_vessel(binary)


# -- effects and limits --------------------------------------------------------------------


TWICE = {
    "current": ({"speed": 0.1, "direction": 0.5},) * 2 + ({"speed": 0.2, "direction": 0.5},),
    "crossflow-drag": ({"cd": 0.4}, {"cd": 0.6}, {"cd": 1.0}),
    "sway-yaw-coupling": ({"Y_r": -3.0}, {"Y_r": -1.0, "N_v": 2.0}, {"Y_r": -4.0, "N_v": 2.0}),
    "wave-force": ({"bias": 20.0}, {"bias": 30.0}, {"bias": 50.0}),
    "thrust-asymmetry": ({"ratio": 0.05}, {"ratio": 0.1}, {"ratio": 0.15}),
}


@pytest.mark.parametrize("name", TWICE)
def test_an_effect_given_twice_adds_up(name):
    first, second, both = ({"name": name} | values for values in TWICE[name])
    document = dict(read_vessel("wamv").document)
    vessels = [build(document | {"effect": effects}) for effects in ([first, second], [both])]
    state, executed = moving(1.2, 0.2, 0.1, 0.4), {"port": 200.0, "starboard": 150.0}
    rates = [v.rate(state, executed, v.environment, 0.0) for v in vessels]
    np.testing.assert_allclose(*([float(x) for x in vars(r).values()] for r in rates), rtol=1e-12)
    plain = build(document)
    assert rates[0] != plain.rate(state, executed, plain.environment, 0.0)


def test_limits_of_force_hold_for_thrusters_with_a_curve():
    text = '[[thruster]]\nname = "jet"\nmax_force = 50.0\nmin_force = -18.0\n'
    document = dict(read_vessel("wamv").document)
    jet = tomllib.loads(text + "curve = { c = -0.1, d = 0.5 }")["thruster"]
    vessel = build(document | {"thruster": jet})
    for order, force in ((1e3, 50.0), (-1e3, -18.0)):
        speed = vessel.servos["jet"].target(order)
        assert force_of(vessel, "jet", moving(0.0), {"jet": speed})[0] == pytest.approx(force)


# -- writing back ----------------------------------------------------------------------------


def test_what_a_fit_changes_is_written_and_the_rest_stays(tmp_path):
    file = read_text(tmp_path, GOOD)
    effects = [{"name": "current", "speed": 0.3, "direction": 1.2}]
    values = {"X_u": -61.5, "N_rr": -30.0, "port.max_force": 210.0}
    document = updated_document(file.document, values, effects)
    assert "N_rr" not in file.document["hull"]
    again = read_text(tmp_path, dump(document))
    assert again.document == document
    numbers = named(again.vessel)
    assert numbers["X_u"] == -61.5
    assert numbers["N_rr"] == -30.0
    assert float(again.vessel.servos["port"].upper) == 210.0
    assert float(again.vessel.servos["starboard"].upper) == 250.0
    flow = (again.vessel.environment.current_north, again.vessel.environment.current_east)
    np.testing.assert_allclose(np.asarray(flow), [0.3 * np.cos(1.2), 0.3 * np.sin(1.2)], rtol=1e-12)
    kept = {k: v for k, v in document["hull"].items() if k not in ("X_u", "N_rr")}
    assert kept == {k: v for k, v in file.document["hull"].items() if k != "X_u"}


def test_a_number_of_an_actuator_that_is_not_there_cannot_be_written():
    with pytest.raises(UserError, match="'third.max_force' cannot be written"):
        updated_document(read_vessel("wamv").document, {"third.max_force": 1.0}, [])


def test_a_fitted_file_says_what_was_fitted_and_where_the_rest_is_from():
    document = read_vessel("wamv").document | {"source": "a paper"}
    once = updated_document(document, {"X_u": -60.0}, [], "X_u fitted to 2 recordings")
    assert once["source"] == "X_u fitted to 2 recordings; all other numbers: a paper"
    twice = updated_document(once, {"N_r": -700.0}, [], "N_r fitted to 1 recordings")
    assert twice["source"] == "N_r fitted to 1 recordings; all other numbers: a paper"
    assert updated_document(document, {"X_u": -60.0}, [])["source"] == "a paper"


def test_channels_say_in_what_they_are_commanded():
    units = {name: read_vessel(name).vessel.units for name in NAMES}
    assert units["shioji_maru"] == {"propeller": "rev/s", "rudder": "rad", "bow": "N", "stern": "N"}
    assert units["pytheas"] == {"thruster.force": "N", "thruster.angle": "rad"}
    assert units["mariner"] == {"rudder": "rad"}
    assert set(units["otter"].values()) <= {"N", "rev/s"}


@pytest.mark.parametrize(("vessel", "unit"), [("kvlcc2", "rev/s"), ("pytheas", "N")])
def test_a_number_of_the_propulsion_is_reported_in_the_vessels_own_unit(vessel, unit):
    boat = read_vessel(vessel).vessel
    one, known = np.ones(1), 1e-6 * np.eye(1)
    found = parameters_with_errors(boat, EFFECTS["deadband:propulsion"], one, known)
    assert found["width"]["unit"] == unit
    rate = parameters_with_errors(boat, EFFECTS["rate-limit:propulsion"], one, known)
    assert rate["rate_limit"]["unit"] == f"{unit} per s"


@pytest.mark.parametrize(
    ("name", "parameter", "beyond"),
    [
        # 1 / (1.6449 std); draught 0.2 m over 1 - exp(-1.6449 std)
        ("rate-limit:propulsion", "rate_limit", 1 / 1.6448536),
        ("shallow-water", "depth", 0.2 / (1 - np.exp(-1.6448536))),
    ],
)
def test_what_is_endless_without_an_effect_has_no_error_where_it_is_not_seen(
    name, parameter, beyond
):
    boat = read_vessel(ORACLE / "usv.toml").vessel
    for value in (0.0, -0.5):
        found = parameters_with_errors(boat, EFFECTS[name], np.array([value]), np.eye(1))
        assert not is_known(found)
        assert found[parameter]["beyond"] == pytest.approx(beyond)
        seen = parameters_with_errors(boat, EFFECTS[name], np.array([2.0]), np.eye(1))
        assert is_known(seen) and "beyond" not in seen[parameter]
    problem = still_problem(name)
    told = parameter_records(problem, linear_estimate(size=problem.layout.size), name)
    assert [(entry[parameter]["value"], "beyond" in entry[parameter]) for entry in told] == [
        (None, True)
    ]
    of_lag = EFFECTS["thrust-lag:propulsion"]
    assert is_known(parameters_with_errors(boat, of_lag, np.array([0.0]), np.eye(1)))


def test_every_possible_effect_applies_to_a_tug_with_all_kinds_of_thruster():
    document = tomllib.loads((ORACLE / "usv.toml").read_text())
    document["tunnel_thruster"] = [{"name": "bow", "x": 1.5, "max_force": 40.0}]
    tug = build(document)
    orders = {"port": 100.0, "starboard": 60.0, "bow": 20.0}
    for effect in EFFECTS.values():
        if effect.possible(tug):
            other = effect.apply(tug, np.array(effect.sizes(tug)))
            assert np.isfinite(total_force(other, moving(1.0, 0.1, 0.05), orders)).all()
            assert set(other.servos) == set(tug.servos)


@pytest.mark.parametrize("name", ["wamv", "mariner", "shioji_maru", "blueboat", "pytheas"])
def test_what_a_fit_puts_just_beyond_the_possible_is_read_back_at_its_end(name):
    file, beyond = read_vessel(name), []
    for effect in EFFECTS.values():
        if effect.per_run or not effect.possible(file.vessel):
            continue
        sizes = np.array(effect.sizes(file.vessel))
        for k, (one, (least, _)) in enumerate(
            zip(effect.coordinates, effect.bounds(file.vessel), strict=True)
        ):
            if not np.isfinite(least) or getattr(one, "positive", False):
                continue  # what cannot be negative makes no table where it is
            at = np.where(np.arange(sizes.size) == k, least - 0.05 * sizes, sizes)
            numbers = effect.decode(file.vessel, at)
            records = {key: {"value": float(value)} for key, value in numbers.items()}
            table = effect_table(file.vessel, effect.name, records)
            build(file.document | {"effect": [table]})
            beyond.append((effect.name, one.key))
    assert beyond, name


@pytest.mark.parametrize("name", ["usv", "otter", "blueboat", "shioji_maru"])
def test_what_a_fit_found_acts_as_the_table_that_is_written_of_it(name):
    file = read_vessel(ORACLE / "usv.toml" if name == "usv" else name)
    vessel, forces, sensors = file.vessel, 0, 0
    orders = {c: 0.3 * float(largest_order(vessel, [c])) for c in vessel.channels}
    motion, rate, after = moving(1.0, 0.1, 0.05), moving(0.1, 0.02, 0.03), 1e4

    def seen(other):
        steps = np.asarray(other.sensors.steps(np.array([after]), 0.1))[0]
        shown = np.asarray(other.sensors.measure(motion, rate, moving(0, 0, 0), after))
        parts = other.breakdown(motion, orders, other.environment, after).values()
        return np.sum([np.asarray(part.stacked) for part in parts], axis=0), shown + steps

    plain = seen(vessel)
    for effect in EFFECTS.values():
        if not effect.possible(vessel):
            continue
        at = np.array(effect.sizes(vessel))
        found = seen(effect.apply(vessel, at))
        numbers = {k: float(v) for k, v in effect.decode(vessel, at).items()}
        table = effect_table(vessel, effect.name, {k: {"value": v} for k, v in numbers.items()})
        tables = [*file.document.get("effect", []), table]
        written = seen(build(file.document | {"effect": tables}))
        for mine, other in zip(found, written, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-9, err_msg=effect.name)
        forces += not np.allclose(found[0], plain[0], rtol=1e-6)
        sensors += not np.allclose(found[1], plain[1], rtol=1e-6)
    assert forces > 8 and sensors > 8


def test_wind_is_fossens_law_of_the_angle_of_attack():
    """Fossen 2021, eqs. 10.16 to 10.23, with gamma = -atan2(v_rw, u_rw), less that of still air."""
    wind = superstructure(read_vessel("otter").vessel)
    area, side, length = map(float, (wind.frontal_area, wind.lateral_area, wind.length))

    def law(u_rw, v_rw):
        angle, q = -np.arctan2(v_rw, u_rw), 0.5 * 1.225 * (u_rw**2 + v_rw**2)
        N = q * side * length * 0.1 * np.sin(2 * angle)
        return np.array([-q * area * 0.7 * np.cos(angle), q * side * 0.85 * np.sin(angle), N])

    rng = np.random.default_rng(2)
    for _ in range(20):
        u, v, north, east = rng.normal(size=4) * (1.0, 0.3, 6.0, 6.0)
        air = Environment(wind_north=north, wind_east=east)
        found = np.asarray(wind(moving(u, v), air, 0.0).stacked)
        np.testing.assert_allclose(
            found, law(u - north, v - east) - law(u, v), rtol=1e-5, atol=1e-6
        )


def test_a_wind_that_is_added_meets_the_superstructure_of_the_table_before():
    document = tomllib.loads((ORACLE / "usv.toml").read_text())
    hull = {"frontal_area": 1.6, "lateral_area": 3.2, "C_X": 0.7, "C_Y": 0.85, "C_N": 0.05}
    calm = {"name": "wind", "speed": 0.0, "direction": 0.0, **hull}
    breeze = {"name": "wind", "speed": 8.0, "direction": 1.0}
    orders = {"port": 100.0, "starboard": 60.0}

    def force(*tables):
        vessel = build({**document, "effect": list(tables)})
        parts = vessel.breakdown(moving(1.0, 0.1), orders, vessel.environment, 0.0).values()
        return np.sum([np.asarray(part.stacked) for part in parts], axis=0)

    np.testing.assert_allclose(force(calm, breeze), force(breeze | hull), rtol=1e-12)
    assert not np.allclose(force(calm, breeze), force(breeze), rtol=0.01)
