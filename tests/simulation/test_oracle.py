# pyright: reportArgumentType=false
"""The reference simulator against closed forms."""

import csv
import math
from typing import cast

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from tests.oracle import hull as H
from tests.oracle import make_recordings as R
from tests.oracle import sensors as S
from tests.oracle import trials as T
from tests.oracle.actuators import Thruster
from tests.oracle.simulator import Simulator, load, simulate
from tests.paths import ORACLE


HERE = ORACLE
USV, BOAT = load(HERE / "usv.toml"), load(HERE / "boat.toml")
SHIP = load(HERE / "ship.toml")
BARE = {"mass": 10.0, "I_z": 4.0, "length": 2.0, "beam": 0.5, "draught": 0.2}
PAIR = [{"name": "p", "x": -1.0, "y": -0.4}, {"name": "s", "x": -1.0, "y": 0.4}]


def vessel(thrusters=(), **hull):
    return {"hull": BARE | hull, "thruster": list(thrusters)}


# hull


def test_surge_decays_as_the_closed_form():
    """m u' = X_u u + X_uu u^2: u = a u0 e / (a + b u0 (1 - e)), e = exp(-a t)."""
    sim = simulate(
        vessel(X_u=-3.0, X_uu=-7.0, X_udot=-2.0), [(0, 0)], 20.0, state=(0, 0, 0.3, 2.0, 0, 0)
    )
    t = np.linspace(0, 20, 41)
    a, b = 3.0 / 12.0, 7.0 / 12.0
    e = np.exp(-a * t)
    out = sim.at(t)
    np.testing.assert_allclose(out["u"], a * 2 * e / (a + b * 2 * (1 - e)), atol=1e-10)
    distance = np.log1p(b * 2 * (1 - e) / a) / b
    np.testing.assert_allclose(out["x"], distance * math.cos(0.3), atol=1e-9)
    np.testing.assert_allclose(out["y"], distance * math.sin(0.3), atol=1e-9)


def test_steady_speed_is_the_root_of_the_drag_parabola():
    speed = (-52 + math.sqrt(52**2 + 4 * 72 * 250)) / (2 * 72)
    assert T.steady_speed(USV, 250.0) == pytest.approx(speed, abs=1e-12)
    assert T.thrust_for_speed(USV, speed) == pytest.approx(250.0, abs=1e-9)
    end = simulate(USV, [(0, 125)], 60.0).at([60.0])
    assert end["u"][0] == pytest.approx(speed, abs=1e-9)


def test_yaw_spins_up_as_tanh():
    """I r' = Q - k r^2 under a pure couple: r = sqrt(Q/k) tanh(sqrt(Q k) t / I)."""
    sim = simulate(vessel(PAIR, N_rr=-0.5, N_rdot=-1.0), [(0, {"p": 3.0, "s": -3.0})], 10.0)
    t = np.linspace(0, 10, 21)
    Q, k = 2.4, 0.5
    np.testing.assert_allclose(
        sim.at(t)["r"], math.sqrt(Q / k) * np.tanh(math.sqrt(Q * k) * t / 5), atol=1e-10
    )
    assert abs(sim.at(t)["u"]).max() < 1e-12


SYMMETRIC = dict(x_G=0.15, X_udot=-1.0, Y_vdot=-8.0, Y_rdot=-0.7, N_vdot=-0.7, N_rdot=-2.0)


def test_energy_and_impulse_are_conserved_without_damping():
    """In the earth's frame the impulse R (p_x, p_y) and p_n + N p_E - E p_N stay constant."""
    sim = simulate(vessel(**SYMMETRIC), [(0, 0)], 30.0, state=(1, 2, 0.4, 1.0, 0.5, 0.6))
    kept = []
    for N, E, psi, u, v, r in sim.states(np.linspace(0, 30, 31)).T:
        px, py, pn = H.impulse(sim.M, u, v, r)
        pN = px * math.cos(psi) - py * math.sin(psi)
        pE = px * math.sin(psi) + py * math.cos(psi)
        kept.append((pN, pE, pn + N * pE - E * pN, H.kinetic_energy(sim.M, u, v, r)))
    kept = np.array(kept)
    np.testing.assert_allclose(kept, np.broadcast_to(kept[0], kept.shape), atol=1e-9)


def test_rigid_body_keeps_its_centre_of_gravity_on_a_line():
    sim = simulate(vessel(x_G=0.3), [(0, 0)], 20.0, state=(0, 0, 0, 1.0, 0.2, 0.5))
    out = sim.at(np.linspace(0, 20, 21))
    north = out["x"] + 0.3 * np.cos(out["psi"])
    east = out["y"] + 0.3 * np.sin(out["psi"])
    np.testing.assert_allclose(north, 0.3 + 1.0 * out["t"], atol=1e-9)
    np.testing.assert_allclose(east, (0.2 + 0.3 * 0.5) * out["t"], atol=1e-9)
    np.testing.assert_allclose(out["r"], 0.5, atol=1e-11)


def test_momentum_force_is_fossens_and_does_no_work():
    """C_RB and C_A written out, with a = (Y_rdot + N_vdot) / 2."""
    h, (u, v, r) = BOAT["hull"], (1.3, -0.4, 0.7)
    m, x_g, a = h["mass"], h["x_G"], 0.5 * (h["Y_rdot"] + h["N_vdot"])
    rigid = [[0, 0, -m * (x_g * r + v)], [0, 0, m * u], [m * (x_g * r + v), -m * u, 0]]
    lateral, ahead = h["Y_vdot"] * v + a * r, h["X_udot"] * u
    added = [[0, 0, lateral], [0, 0, -ahead], [-lateral, ahead, 0]]
    nu = np.array([u, v, r])
    force = H.momentum_force(H.inertia(h), u, v, r)
    np.testing.assert_allclose(force, -(np.array(rigid) + added) @ nu, atol=1e-13)
    assert abs(np.dot(force, nu)) < 1e-13


def test_inertia_is_solved_with_both_off_diagonals():
    M = H.inertia(BOAT["hull"])
    assert M[1][2] == pytest.approx(18 * 0.03 + 0.3) and M[2][1] == pytest.approx(18 * 0.03 + 0.5)
    assert (
        M[2][2] == pytest.approx(1.6 + 18 * 0.03**2 + 0.9) and M[0][0] == 19.2 and M[1][1] == 27.0
    )
    rates = H.solve_inertia(M, 1.0, 2.0, 3.0)
    np.testing.assert_allclose(np.array(M) @ rates, [1, 2, 3], atol=1e-13)


PRODUCTS = {
    "X_u": lambda u, v, r: u, "X_uu": lambda u, v, r: abs(u) * u, "X_uuu": lambda u, v, r: u**3,
    "X_vv": lambda u, v, r: v * v, "X_vr": lambda u, v, r: v * r, "X_rr": lambda u, v, r: r * r,
    "X_vvvv": lambda u, v, r: v**4, "Y_v": lambda u, v, r: v,
    "Y_vv": lambda u, v, r: abs(v) * v,
    "Y_vr": lambda u, v, r: abs(v) * r, "Y_rv": lambda u, v, r: abs(r) * v,
    "Y_rr": lambda u, v, r: abs(r) * r, "Y_ur": lambda u, v, r: u * r,
    "Y_uv": lambda u, v, r: u * v,
    "Y_vvv": lambda u, v, r: v**3, "Y_vvr": lambda u, v, r: v * v * r,
    "Y_vrr": lambda u, v, r: v * r * r, "N_vv": lambda u, v, r: abs(v) * v,
    "N_rr": lambda u, v, r: abs(r) * r, "N_vr": lambda u, v, r: abs(v) * r,
    "N_ur": lambda u, v, r: u * r, "N_rrr": lambda u, v, r: r**3,
}  # fmt: skip


@pytest.mark.parametrize("name", PRODUCTS)
def test_derivative_names(name):
    terms = H.damping_terms({name: 2.5, "X_udot": -1.0, "mass": 3.0})
    for nu in ((1.2, -0.3, 0.7), (-1.2, 0.3, -0.7), (0.5, -0.4, -0.2)):
        expected = [0.0, 0.0, 0.0]
        expected["XYN".index(name[0])] = 2.5 * PRODUCTS[name](*nu)
        np.testing.assert_allclose(H.damping(terms, *nu), expected, atol=1e-14)


@pytest.mark.parametrize(
    "v, r", [(0.5, 0.1), (-0.3, 0.9), (0.2, -0.9), (0.0, 0.4), (0.4, 0.0), (0.9, 0.9), (0, 0)]
)
def test_crossflow_against_quadrature(v, r):
    hull = BARE | {"length": 1.8, "water_density": 1000.0}
    points = [-v / r] if r and abs(v / r) < 0.9 else None
    y = quad(lambda x: abs(v + x * r) * (v + x * r), -0.9, 0.9, points=points, epsabs=1e-13)[0]
    n = quad(lambda x: x * abs(v + x * r) * (v + x * r), -0.9, 0.9, points=points, epsabs=1e-13)[0]
    expected = (-0.5 * 1000 * 1.1 * 0.2 * y, -0.5 * 1000 * 1.1 * 0.2 * n)
    np.testing.assert_allclose(H.crossflow(hull, 1.1, v, r), expected, atol=1e-10)


# environment


def test_current_is_a_moving_frame():
    flow = {"current": {"speed": 0.4, "direction": 2.0}, "crossflow-drag": {"cd": 0.8}}
    drift = 0.4 * np.array([math.cos(2.0), math.sin(2.0)])
    psi, steps = 0.7, [(0, 3), (5, {"port": 6}), (12, {"port": 0})]
    body = np.array([[math.cos(psi), math.sin(psi)], [-math.sin(psi), math.cos(psi)]]) @ drift
    still = simulate(BOAT, steps, 30.0, {"crossflow-drag": {"cd": 0.8}}, (0, 0, psi, 0.5, 0, 0))
    moving = simulate(BOAT, steps, 30.0, flow, (0, 0, psi, 0.5 + body[0], body[1], 0))
    t = np.linspace(0, 30, 61)
    a, b = still.at(t), moving.at(t)
    np.testing.assert_allclose(b["x"] - drift[0] * t, a["x"], atol=1e-9)
    np.testing.assert_allclose(b["y"] - drift[1] * t, a["y"], atol=1e-9)
    np.testing.assert_allclose(b["psi"], a["psi"], atol=1e-9)
    cos, sin = np.cos(a["psi"]), np.sin(a["psi"])
    north = [cos * o["u"] - sin * o["v"] for o in (a, b)]
    east = [sin * o["u"] + cos * o["v"] for o in (a, b)]
    np.testing.assert_allclose(north[1] - north[0], drift[0], atol=1e-9)
    np.testing.assert_allclose(east[1] - east[0], drift[1], atol=1e-9)


def test_wind_on_the_bow_balances_drag():
    """X_uu u^2 = 1/2 rho C A (V - |u|)^2: u = -V q / (1 + q), q^2 = air over water factor."""
    wind = {
        "wind": {"speed": 8.0, "direction": 0.6, "C_X": 0.9, "frontal_area": 0.7, "still_air": 1}
    }
    sim = simulate(vessel(X_uu=-20.0), [(0, 0)], 400.0, wind, (0, 0, 0.6, 0, 0, 0))
    q = math.sqrt(0.5 * 1.225 * 0.9 * 0.7 / 20.0)
    assert sim.at([400.0])["u"][0] == pytest.approx(-8 * q / (1 + q), abs=1e-8)


def test_wind_components_and_defaults():
    """From 45 deg on the starboard bow: astern and to port; C_N > 0 turns to port."""
    sim = Simulator(vessel(), {"wind": {"speed": 6.0, "direction": 0.25 * math.pi, "still_air": 1}})
    X, Y, N = sim.forces(0.0, 0.0, 0.0, 0.0, 0.0, [])
    a = 6 / math.sqrt(2)
    assert X == pytest.approx(-0.5 * 1.225 * 0.7 * 0.5 * 0.2 * 6 * a)
    assert Y == pytest.approx(-0.5 * 1.225 * 0.85 * 2.0 * 0.2 * 6 * a)
    assert N == pytest.approx(-0.5 * 1.225 * 0.1 * 2.0 * 0.2 * 2.0 * 2 * a * a)
    X, Y, N = sim.forces(0.0, 0.0, -a, -a, 0.0, [])  # drifting with the air
    assert max(abs(X), abs(Y), abs(N)) < 1e-12


def test_wind_leaves_the_drag_of_still_air_to_the_hull():
    calm = Simulator(vessel(), {"wind": {"speed": 0.0, "direction": 0.3}})
    assert calm.forces(0.0, 0.4, 1.3, -0.4, 0.2, []) == pytest.approx((0.0, 0.0, 0.0))
    wind = {"speed": 6.0, "direction": 0.3}
    beyond, whole = (Simulator(vessel(), {"wind": wind | {"still_air": s}}) for s in (0, 1))
    X, Y, N = (
        w - b
        for w, b in zip(
            *(s.forces(0.0, 0.4, 1.3, -0.4, 0.2, []) for s in (whole, beyond)), strict=True
        )
    )
    speed = math.hypot(1.3, 0.4)
    assert X == pytest.approx(-0.5 * 1.225 * 0.7 * 0.5 * 0.2 * speed * 1.3)
    assert Y == pytest.approx(0.5 * 1.225 * 0.85 * 2.0 * 0.2 * speed * 0.4)
    assert N == pytest.approx(0.5 * 1.225 * 0.1 * 2.0 * 0.2 * 2.0 * 2 * 1.3 * 0.4)


def test_wind_acts_on_the_velocity_over_ground():
    both = {
        "wind": {"speed": 2.0, "direction": math.pi, "still_air": 1},
        "current": {"speed": 2.0, "direction": 0.0},
    }
    sim = simulate(vessel(X_u=-1.0, Y_v=-1.0, N_r=-1.0), [(0, 0)], 5.0, both, (0, 0, 0.3, 0, 0, 0))
    out = simulate(vessel(X_u=-1.0, Y_v=-1.0, N_r=-1.0), [(0, 0)], 5.0, both,
                   (0, 0, 0.3, 2 * math.cos(0.3), -2 * math.sin(0.3), 0)).at([5.0])  # fmt: skip
    assert abs(out["u_r"][0]) < 1e-10 and abs(out["v_r"][0]) < 1e-10
    assert abs(sim.at([5.0])["u_r"][0]) > 0.1


def test_wave_force_moves_a_free_mass_as_integrated_twice():
    """m x'' = b + A sin(w t + p); a force through the origin leaves the heading at 0."""
    wave = {
        "wave-force": {
            "bias": 2.0,
            "amplitude": 5.0,
            "frequency": 0.3,
            "phase": 0.4,
            "direction": 0.9,
        }
    }
    out = simulate(vessel(), [(0, 0)], 9.0, wave).at([9.0])
    w = 2 * math.pi * 0.3
    s = (
        2 * 81 / 2 + 5 * (math.cos(0.4) * 9 / w - (math.sin(9 * w + 0.4) - math.sin(0.4)) / w**2)
    ) / 10
    assert out["x"][0] == pytest.approx(s * math.cos(0.9), abs=1e-9)
    assert out["y"][0] == pytest.approx(s * math.sin(0.9), abs=1e-9)


def test_effects_on_the_hull_add_derivatives():
    extra = {
        "quadratic-damping": {"X_uu": -5.0, "N_rr": -1.0},
        "sway-yaw-coupling": {"Y_r": 3.0, "N_v": 2.0},
    }
    merged = {
        **USV,
        "hull": USV["hull"] | {"X_uu": -77.0, "N_rr": -601.0, "Y_r": 3.0, "N_v": 2.0},
    }
    steps = [(0, 80), (4, {"port": 150})]
    a = simulate(USV, steps, 10.0, extra).at([10.0])
    b = simulate(merged, steps, 10.0).at([10.0])
    assert a["psi"][0] == b["psi"][0] != simulate(USV, steps, 10.0).at([10.0])["psi"][0]
    assert USV["hull"]["X_uu"] == -72.0
    with pytest.raises(ValueError, match="does not have"):
        Simulator(USV, {"sea-monster": {"size": 1.0}})


# actuators


def realised(orders, t, **data):
    thruster = Thruster({"name": "a", **data})
    for when, value in orders:
        thruster.order(when, value)
    return np.array([thruster.segment(q)(q) for q in np.atleast_1d(t)])


def test_lag_delay_and_dead_band():
    t = np.linspace(0, 6, 25)
    lag = realised([(0, 0), (1.0, 10.0)], t, time_constant=0.8, delay=0.5, deadband=2.0)
    np.testing.assert_allclose(
        lag, np.where(t < 1.5, 0, 8 * (1 - np.exp(-(t - 1.5) / 0.8))), atol=1e-13
    )
    assert (
        realised([(0, 1.5)], 0.0, deadband=2.0) == 0
        and realised([(0, -5)], 0.0, deadband=2.0) == -3
    )


def test_rate_limit_alone_and_with_a_lag():
    t = np.linspace(0, 8, 33)
    orders = [(0, 0.0), (1, 10.0), (2, -3.0)]
    ramp = realised(orders, t, rate_limit=4.0)
    expected = np.where(t < 1, 0, np.where(t < 2, 4 * (t - 1), np.maximum(-3, 4 - 4 * (t - 2))))
    np.testing.assert_allclose(ramp, expected, atol=1e-13)
    both = realised(orders, t, rate_limit=4.0, time_constant=0.5)

    def rate(q, n):
        c = 0 if q < 1 else 10 if q < 2 else -3
        return np.clip((c - n) / 0.5, -4, 4)

    state, found = [0.0], []
    for a, b in zip(t, t[1:], strict=False):
        found.append(state[-1])
        middle = solve_ivp(
            lambda q, n, b=b: rate(min(q, b - 1e-9), n),
            (a, b),
            [state[-1]],
            rtol=1e-11,
            atol=1e-12,
        )
        state.append(middle.y[0, -1])
    np.testing.assert_allclose(both, state, atol=1e-7)


def test_delayed_lagging_thrust_moves_a_free_mass():
    """m u' = 2 F (1 - exp(-s / T)), s = t - t_order - delay, integrated once."""
    slow = {"thrust-lag": {"time_constant": 0.6}, "thrust-delay": {"delay": 0.35}}
    sim = simulate(vessel(PAIR), [(0, 0), (1, 4.0)], 5.0, slow)
    t = np.linspace(0, 5, 51)
    s = np.maximum(t - 1.35, 0)
    out = sim.at(t)
    np.testing.assert_allclose(out["u"], 0.8 * (s - 0.6 * (1 - np.exp(-s / 0.6))), atol=1e-10)
    np.testing.assert_allclose(out["exec_p"], 4 * (1 - np.exp(-s / 0.6)), atol=1e-12)
    np.testing.assert_array_equal(out["cmd_s"], np.where(t >= 1, 4.0, 0.0))


def test_ends_of_ramps_are_breaks():
    thruster = Thruster({"name": "a", "delay": 0.5, "rate_limit": 4.0, "time_constant": 0.5})
    thruster.order(0.0, 0.0)
    thruster.order(1.0, 10.0)
    assert thruster.next_break(0.0, 1e-9) == 1.5
    assert thruster.next_break(1.5, 1e-9) == 1.5 + 2.0  # 8 of 10 at 4 a second, 2 = R T by the lag


def test_thrust_pushes_at_its_place_within_its_limits():
    data = {"name": "a", "x": -1.0, "y": 0.4, "angle": 0.3, "max_force": 8.0, "min_force": -5.0}
    thruster = Thruster(data)
    fx, fy, n = thruster.push(20.0, 0.0, 0.0)
    assert (fx, fy) == pytest.approx((8 * math.cos(0.3), 8 * math.sin(0.3)))
    assert n == pytest.approx(-1.0 * fy - 0.4 * fx)
    assert thruster.thrust(-9.0, 0, 0) == -5.0
    curve = Thruster({"name": "a", "y": 0.4, "curve": {"c": -0.2, "d": 0.05}})
    assert curve.thrust(-10.0, 1.5, 0.5) == pytest.approx(
        -0.2 * (1.5 - 0.4 * 0.5) * -10 - 0.05 * 100
    )


def test_effects_on_thrusters():
    ratio = Simulator(USV, {"thrust-asymmetry": {"ratio": 0.1}}).model.thrusters
    assert [t.thrust(100, 0, 0) for t in ratio] == pytest.approx([90, 110])
    turned = Simulator(USV, {"thruster-misalignment": {"angle": 0.2}}).model.thrusters
    assert turned[0].push(100, 0, 0)[1] == pytest.approx(100 * math.sin(0.2))
    slow = Simulator(BOAT, {"thrust-lag": {"time_constant": 0.5}, "thrust-delay": {"delay": 0.3}})
    assert slow.model.thrusters[0].time_constant == 0.75
    assert slow.model.thrusters[0].delay == pytest.approx(0.4)
    step = simulate(
        vessel(PAIR, X_udot=0.0),
        [(0, 5)],
        4.0,
        {"thrust-change": {"time": 1.5, "factor": -0.4}},
    )
    assert step.at([4.0])["u"][0] == pytest.approx((1.5 + 2.5 * 0.6) * 10 / 10, abs=1e-10)


# changes at a time


def test_speed_after_a_change_of_drag():
    """m u' = T - k u^2: towards sqrt(T / k) by tanh, k from one value to another at 6 s."""
    change = {"drag-change": {"time": 6.0, "factor": 0.8}}
    sim = simulate(vessel(PAIR, X_uu=-5.0), [(0, 4.0)], 40.0, change)
    before, after = math.sqrt(8 / 5), math.sqrt(8 / 9)
    early, late = np.linspace(0, 6, 13), np.linspace(6, 40, 18)
    expected = before * np.tanh(math.sqrt(8 * 5) * early / 10)
    np.testing.assert_allclose(sim.at(early)["u"], expected, atol=1e-10)
    rise = np.arctanh(after / expected[-1]) + math.sqrt(8 * 9) * (late - 6) / 10  # u > after: coth
    np.testing.assert_allclose(sim.at(late)["u"], after / np.tanh(rise), atol=1e-10)


def test_a_change_of_drag_takes_the_cross_flow_and_leaves_the_rest():
    more = {"crossflow-drag": {"cd": 0.9}, "drag-change": {"time": -1.0, "factor": 0.5}}
    push = {"wave-force": {"bias": 3.0, "direction": 1.0}}
    h = USV["hull"]
    Y, N = H.crossflow(h, 0.9, -0.3, 0.2)
    sim = Simulator(USV, more | push, (0, 0, 0, 1.1, -0.3, 0.2))
    rhs, _ = sim.piece(0.1)
    found = np.array(sim.M) @ rhs(0.0, sim.state)[3:]
    damping = np.array([
        h["X_u"] * 1.1 + h["X_uu"] * 1.21, h["Y_v"] * -0.3 + Y,
        h["N_r"] * 0.2 + h["N_rr"] * 0.04 + N,
    ])  # fmt: skip
    wave = 3 * np.array([math.cos(1.0), math.sin(1.0), 0])
    np.testing.assert_allclose(
        found, 1.5 * damping + wave + H.momentum_force(sim.M, 1.1, -0.3, 0.2), atol=1e-12
    )


def test_acceleration_after_a_change_of_mass():
    """u' = T / m, then T / (m + dm); the velocity does not jump."""
    lost = {"mass-change": {"time": 1.5, "mass": -4.0}}
    sim = simulate(vessel(PAIR, X_udot=-2.0), [(0, 4.0)], 4.0, lost)
    t = np.linspace(0, 4, 17)
    expected = 8 * (np.minimum(t, 1.5) / 12 + np.maximum(t - 1.5, 0) / 8)
    np.testing.assert_allclose(sim.at(t)["u"], expected, atol=1e-10)


def test_a_softened_change_approaches_the_sudden_one():
    """m u' = T (1 + f s(t)), s logistic: the integral of s is w log(1 + exp((t - t_c) / w))."""
    change = {"thrust-change": {"time": 1.5, "factor": -0.4}}
    sim = simulate(vessel(PAIR), [(0, 5)], 4.0, change, soften=0.1)
    t = np.linspace(0, 4, 33)
    share = 0.1 * (np.logaddexp(0, (t - 1.5) / 0.1) - np.logaddexp(0, -15))
    np.testing.assert_allclose(sim.at(t)["u"], t - 0.4 * share, atol=1e-10)


@pytest.mark.parametrize("x", [0.0, -0.8])
def test_a_load_makes_the_composite_body(x):
    """m + dm, (x_G m + x dm) / (m + dm), and I_z by Steiner."""
    h, dm = BARE | {"x_G": 0.3, "Y_rdot": -0.5}, 6.0
    x_g = (0.3 * 10 + x * dm) / 16
    I_z = 4.0 + 10 * (0.3 - x_g) ** 2 + dm * (x - x_g) ** 2
    body = h | {"mass": 16.0, "x_G": x_g, "I_z": I_z}
    np.testing.assert_allclose(H.loaded(H.inertia(h), [(dm, x)]), H.inertia(body), atol=1e-14)
    a = simulate({"hull": h}, [(0, 0)], 6.0, {"mass-change": {"time": -1, "mass": dm, "x": x}},
                 (0, 0, 0, 1, 0.3, 0.5))  # fmt: skip
    b = simulate({"hull": body}, [(0, 0)], 6.0, state=(0, 0, 0, 1, 0.3, 0.5))
    np.testing.assert_allclose(a.states([6.0]), b.states([6.0]), atol=1e-11)


def test_changes_of_thrust_take_propellers_and_not_rudders():
    def push(factor):
        change = {"thrust-change": {"time": -1.0, "factor": factor}}
        sim = Simulator(SHIP, change, (0, 0, 0, 1.1, 0.1, 0.02), {"propeller": 10, "rudder": 0.2})
        return np.array(sim.M) @ sim.piece(0.1)[0](0.0, sim.state)[3:]

    propeller = Simulator(SHIP).model.actuators[0]
    X, Y, N = propeller.push(10, 1.1, 0.02, 0.1)
    np.testing.assert_allclose(push(-0.3) - push(0.0), [-0.3 * X, 0, 0], atol=1e-9)


# hull effects


def test_shallow_water_grows_masses_and_drag():
    """Depth 4/3 draught: (1 - q)^-1 = 4, by halves and quarters of the exponent 2, sqrt 2."""
    hull = USV["hull"] | {"Y_rdot": -7.0, "N_vdot": -9.0}
    craft = {"hull": hull, "thruster": USV["thruster"]}
    env = {"crossflow-drag": {"cd": 0.9}}
    deep, shallow = (
        Simulator(craft, env | extra)
        for extra in ({}, {"shallow-water": {"depth": 4 / 3 * hull["draught"]}})
    )
    for key in ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot"):
        assert shallow.model.hull[key] == pytest.approx(2 * hull[key]), key
    assert shallow.M[1][2] - deep.M[1][2] == pytest.approx(7.0)
    state = (0.0, 0.4, 1.2, -0.3, 0.2)
    segments = [t.segment(0.0) for t in deep.model.actuators]
    found = shallow.forces(*state, segments)
    np.testing.assert_allclose(
        found, np.array(deep.forces(*state, segments)) * [math.sqrt(2), 4, 4], rtol=1e-13
    )
    with pytest.raises(ValueError, match="deeper than the draught"):
        Simulator(USV, {"shallow-water": {"depth": 0.15}})


def test_the_munk_moment_is_that_of_other_added_masses():
    """A larger Y_vdot - X_udot, in the moment of the momentum alone."""
    munk = Simulator(USV, {"munk-moment": {"Y_vdot - X_udot": 40.0}})
    plain = Simulator(USV)
    segments = [t.segment(0.0) for t in plain.model.actuators]
    state = (0.0, 0.4, 1.2, -0.3, 0.2)
    X, Y, N = np.subtract(munk.forces(*state, segments), plain.forces(*state, segments))
    other = H.inertia(USV["hull"] | {"Y_vdot": -120.0 + 40.0})
    expected = H.momentum_force(other, *state[2:])[2] - H.momentum_force(plain.M, *state[2:])[2]
    assert (X, Y) == (0, 0) and N == pytest.approx(expected) and N == pytest.approx(40 * 1.2 * -0.3)


def test_a_rolling_vessel_is_pushed_by_its_heel():
    """phi = a sin(w t): I r' = N_phi phi, m v' = Y_phi phi, each integrated once."""
    t = np.linspace(0, 7, 29)
    wave = 0.1 * (1 - np.cos(2.0 * t)) / 2.0
    for keys, channel, inertia in (
        ({"Y_phi": -9.0}, "v", 10.0),
        ({"N_phi": 3.0}, "r", 4.0),
    ):
        sim = simulate(vessel(), [(0, 0)], 7.0, {"roll-coupling": keys},
                       heel=lambda q: 0.1 * math.sin(2.0 * q))  # fmt: skip
        expected = next(iter(keys.values())) * wave / inertia
        np.testing.assert_allclose(sim.at(t)[channel], expected, atol=1e-11)
        np.testing.assert_allclose(sim.at(t)["phi"], 0.1 * np.sin(2 * t))
    with pytest.raises(ValueError, match="needs the heel"):
        simulate(vessel(), [(0, 0)], 1.0, {"roll-coupling": {"Y_phi": 1.0}})


def test_lift_like_damping_and_inertia_that_couples():
    values = {"Y_ur": 3.0, "N_ur": -5.0, "Y_uv": -7.0, "N_uv": 2.0}
    sim = Simulator(vessel(), {"speed-dependent-damping": values})
    found = sim.forces(0.0, 0.0, 1.2, -0.3, 0.2, [])
    expected = (0.0, 1.2 * (3 * 0.2 - 7 * -0.3), 1.2 * (-5 * 0.2 + 2 * -0.3))
    np.testing.assert_allclose(found, expected, atol=1e-14)
    coupling = {"Y_rdot": -2.0, "N_vdot": -3.0, "x_G": 0.1}
    M = Simulator(vessel(x_G=0.2), {"added-mass-coupling": coupling}).M
    np.testing.assert_allclose(M[1][2], 10 * 0.3 + 2)
    np.testing.assert_allclose(M[2][1:], [10 * 0.3 + 3, 4 + 10 * 0.09])


# channels


def test_play_on_a_triangle_wave():
    """Half width w: at rest for 2 w of the order after each turn, else w behind it."""
    times = np.linspace(0, 4, 401)
    wave = np.interp(times, [0, 1, 3, 4], [0, 5, -5, 0])
    y = realised(zip(times, wave, strict=True), times, backlash=0.8)
    # On the flanks: w behind.
    for start, end, side in ((0.16, 1.0, -1), (1.32, 3.0, 1), (3.32, 4.0, -1)):
        flank = (times > start + 1e-9) & (times <= end)
        np.testing.assert_allclose(y[flank], wave[flank] + 0.8 * side, atol=1e-12)
    # Held from the turn until the order has come back by 2 w.
    for start, end, value in ((0, 0.16, 0), (1.0, 1.32, 4.2), (3.0, 3.32, -4.2)):
        held = (times >= start) & (times <= end + 1e-9)
        np.testing.assert_allclose(y[held], value, atol=1e-12)


def test_travel_time_of_a_slewed_step():
    slew = {"rate-limit": {"rate_limit": 0.05, "actuators": ["rudder"]}}
    sim = simulate(SHIP, [(0, {"propeller": 10.0}), (2, {"rudder": 0.4})], 12.0, slew)
    out = sim.at([2.0, 5.0, 9.999, 10.001])
    np.testing.assert_allclose(out["exec_rudder"], [0, 0.15, 0.39995, 0.4], atol=1e-12)
    np.testing.assert_array_equal(out["exec_propeller"], 10.0)
    assert math.isinf(Simulator(SHIP, slew).model.actuators[0].rate)


def test_bias_comes_before_the_dead_band_and_limits_before_the_play():
    chain = {"bias": 0.5, "deadband": 0.3, "limit": 2.0, "backlash": 0.25, "delay": 0.5}
    orders = [(0, 1.0), (1, 1.1), (2, 9.0), (3, 1.9), (4, -0.7)]
    found = realised(orders, [0.0, 1.6, 2.4, 2.6, 3.6, 4.6], **chain)
    np.testing.assert_allclose(found, [1.2, 1.2, 1.2, 1.75, 1.75, 0.25])


def test_effects_reach_the_chosen_channels():
    one = {"actuator-bias": {"bias": 5.0, "actuators": ["port"]}}
    assert [t.bias for t in Simulator(USV, one).model.actuators] == [5.0, 0.0]
    clip = {"thrust-saturation": {"limit": 60.0}}
    assert simulate(USV, [(0, 100)], 1.0, clip).at([0.5])["exec_port"][0] == 60.0
    own = USV | {"effect": [{"name": "thrust-saturation", "limit": 40.0}]}
    assert simulate(own, [(0, -100)], 1.0, clip).at([0.5])["exec_port"][0] == -40.0
    trim = {"actuator-bias": {"bias": 0.03, "actuators": ["rudder"]}}
    trimmed = simulate(SHIP, [(0, {"propeller": 10.0})], 5.0, trim)
    ordered = simulate(SHIP, [(0, {"propeller": 10.0, "rudder": 0.03})], 5.0)
    np.testing.assert_array_equal(trimmed.states([5.0]), ordered.states([5.0]))
    with pytest.raises(ValueError, match="no such actuators"):
        Simulator(USV, {"backlash": {"width": 1.0, "actuators": ["rudder"]}})


# propeller and rudder


def test_a_propeller_is_its_open_water_diagram():
    p = SHIP["propeller"][0]
    propeller = Simulator(SHIP).model.actuators[0]
    n, u = 11.0, 1.2
    J = (1 - 0.4) * u / (n * p["diameter"])
    K_T = np.polyval(p["k_T"][::-1], J)
    X, Y, N = propeller.push(n, u, 0.0)
    assert pytest.approx((1 - 0.2) * K_T * 1000 * n**2 * p["diameter"] ** 4) == X
    assert (Y, N) == (0, 0)
    bollard = propeller.push(-8.0, 0.0, 0.0)[0]
    assert bollard == pytest.approx(-0.8 * 0.7 * 0.29 * 1000 * 64 * 0.22**4)
    # The wake falls with drift at the propeller, which a turn about it does not make.
    beta = math.atan(0.3)
    turn = math.hypot(1.0, 0.3) * beta / 3.3
    assert propeller.inflow(1.0, 0.3, turn) == pytest.approx(0.6)
    assert propeller.inflow(1.0, -0.3, 0.0) == pytest.approx(1 - 0.4 * math.exp(-4 * beta**2))


def test_a_rudder_is_the_mmg_methods():
    """Yasukawa and Yoshimura's eq. 25 in J and K_T(J); yaw by a turn to starboard at +."""
    r = SHIP["rudder"][0]
    rudder = Simulator(SHIP).model.actuators[1]
    n, delta, u = 10.0, 0.3, 1.1
    J = 0.6 * u / (n * 0.22)
    K_T = np.polyval([-0.14, -0.27, 0.29], J)
    eta = 0.22 / 0.34
    jet = eta * (1 + 0.5 * (math.sqrt(1 + 8 * K_T / (math.pi * J**2)) - 1)) ** 2 + (1 - eta)
    speed = 1.1 * 0.6 * u * math.sqrt(jet)
    F = 0.5 * 1000 * r["area"] * 2.75 * speed**2 * math.sin(delta)
    X, Y, N = rudder.push(delta, u, 0.0, 0.0, {"propeller": n})
    assert pytest.approx(-0.62 * F * math.sin(delta)) == X
    assert pytest.approx(-1.3 * F * math.cos(delta)) == Y
    assert pytest.approx((3.5 + 0.3 * 3.2) * F * math.cos(delta)) == N and N > 0


@pytest.mark.parametrize("side, gamma", [(1, 0.6), (-1, 0.45)])
def test_a_rudder_in_the_cross_flow_feels_none_at_the_straightened_angle(side, gamma):
    rudder = Simulator(SHIP).model.actuators[1]
    u, v = 1.1, -0.2 * side  # drift to port: flow from starboard, beta_R > 0
    weak = {"kappa": 0.0, "epsilon": 1.0}
    rudder.data |= weak
    u_p = rudder.propeller.inflow(u, v, 0.0)
    cross = math.hypot(u, v) * gamma * math.atan(0.2 * side / 1.1)
    neutral = math.atan(cross / u_p)
    assert abs(rudder.push(neutral, u, 0.0, v, {"propeller": 9.0})[1]) < 1e-10
    # No cross-flow at all where the rudder moves along its own plane: beta = l_R r / U.
    turn = math.hypot(u, v) * math.atan(0.2 * side / 1.1) / -5.0
    assert abs(rudder.push(0.0, u, turn, v, {"propeller": 9.0})[1]) < 1e-10


def test_side_force_and_interaction():
    side = {"Y_ahead": 0.02, "N_ahead": -0.01, "Y_astern": 0.1, "N_astern": 0.05}
    propeller = Simulator(SHIP, {"propeller-side-force": side}).model.actuators[0]
    X, Y, N = propeller.push(9.0, 0.5, 0.0)
    assert X > 0 and (Y, N) == pytest.approx((0.02 * X, -0.01 * 7.0 * X))
    X, Y, N = propeller.push(-9.0, 0.5, 0.0)
    assert X < 0 and (Y, N) == pytest.approx((-0.1 * X, -0.05 * 7.0 * X))
    whole = {"a_H": 0.0, "x_H": -2.0, "gamma_R": 1.0}
    rudder = Simulator(SHIP, {"rudder-interaction": whole}).model.actuators[1]
    _, Y, N = rudder.push(0.2, 1.1, 0.03, 0.1, {"propeller": 9.0})
    assert N == pytest.approx(-3.5 * Y)
    for v in (0.1, -0.1):  # the flow unstraightened, to both sides
        angle = math.atan2(v, 1.0)
        u_p = rudder.propeller.inflow(1.0, v, 0.0)
        rudder.data |= {"kappa": 0.0, "epsilon": 1.0}
        neutral = -math.atan(math.hypot(1.0, v) * angle / u_p)
        assert abs(rudder.push(neutral, 1.0, 0.0, v, {"propeller": 0.0})[1]) < 1e-10


def test_a_ship_turns_to_the_side_of_its_rudder():
    for side in (1, -1):
        sim = simulate(SHIP, [(0, {"propeller": 11.0}), (5, {"rudder": 0.5 * side})], 120.0,
                       state=(0, 0, 0, 1.1, 0, 0))  # fmt: skip
        end = sim.at([120.0])
        assert 0.02 < side * end["r"][0] < 0.1 and side * end["v"][0] < 0 and 0.2 < end["u"][0] < 1


# integration and events


def test_whole_model_against_matrices_and_another_solver():
    """The boat under a held order, from matrices written out, by Radau."""
    h = BOAT["hull"]
    M = np.array(H.inertia(h))
    a = 0.5 * (h["Y_rdot"] + h["N_vdot"])

    def rate(t, s):
        _, _, psi, u, v, r = s
        m11, lateral = M[0, 0] * u, M[1, 1] * v + (h["mass"] * h["x_G"] - a) * r
        C = np.array([[0, 0, -lateral], [0, 0, m11], [lateral, -m11, 0]])
        D = [
            h["X_u"] * u + h["X_uu"] * abs(u) * u + h["X_vr"] * v * r,
            h["Y_v"] * v + h["Y_vv"] * abs(v) * v + h["Y_r"] * r + h["Y_uv"] * u * v,
            h["N_v"] * v
            + h["N_r"] * r
            + h["N_rr"] * abs(r) * r
            + h["N_uv"] * u * v
            + h["N_ur"] * u * r,
        ]
        tau = [7.7, 0.0, 0.25 * (5.7 - 2.0)]
        nu_dot = np.linalg.solve(M, np.array(tau) + D - C @ [u, v, r])
        c, q = math.cos(psi), math.sin(psi)
        return [u * c - v * q, u * q + v * c, r, *nu_dot]

    other = solve_ivp(
        rate, (0, 12), [0, 0, 0, 0.2, 0.1, -0.3], method="Radau", rtol=1e-10, atol=1e-12
    )
    sim = simulate(
        BOAT, [(0, {"port": 6.0, "starboard": 2.3})], 12.0, state=(0, 0, 0, 0.2, 0.1, -0.3)
    )
    np.testing.assert_allclose(sim.states([12.0])[:, 0], other.y[:, -1], atol=2e-8)


def test_result_does_not_depend_on_tolerance_or_restarts():
    env = {"crossflow-drag": {"cd": 1.0}, "wind": {"speed": 4.0, "direction": 1.0}}
    steps = [(0, 4), (3, {"port": 9}), (9, {"port": -5, "starboard": 8}), (15, 0)]
    a = simulate(BOAT, steps, 25.0, env)
    b = simulate(BOAT, steps, 25.0, env, rtol=1e-13, atol=1e-14, max_step=0.05)
    np.testing.assert_allclose(a.states([25.0]), b.states([25.0]), atol=1e-9)
    np.testing.assert_allclose(a.states([7.77]), b.states([7.77]), atol=1e-9)


def test_zigzag_switches_where_the_closed_form_says():
    """Yaw alone, I r' = +-Q - k r: exponentials in time, joined by root finding."""
    ship = vessel(PAIR, X_u=-1e-9, N_r=-3.0)
    trial = T.zigzag(
        ship, 10.0, math.radians(20), math.radians(15), executes=4, speed=0.0, side="port"
    )
    k, Q, target = 3.0 / 4.0, 10 * 20 / 35 * 0.4 / 4.0, math.radians(15)
    psi, r, t, switches, overshoots = 0.0, 0.0, 0.0, [0.0], []

    def heading(s, q):
        return psi + q / k * s + (r - q / k) * (1 - math.exp(-k * s)) / k

    sign = -1.0
    for _ in range(3):
        q = sign * Q
        root = brentq(lambda s, q=q, sign=sign: heading(s, q) - sign * target, 1e-9, 60, xtol=1e-15)
        ahead = cast(float, root)
        psi, r, t = heading(ahead, q), q / k + (r - q / k) * math.exp(-k * ahead), t + ahead
        switches.append(t)
        sign, q = -sign, -q
        stop = math.log((q / k - r) / (q / k)) / k
        overshoots.append(abs(heading(stop, q)) - target)
    tenth = trial.metrics["time_to_10_deg"]
    psi, r = 0.0, 0.0
    assert heading(tenth, -Q) == pytest.approx(-math.radians(10), abs=1e-11)
    np.testing.assert_allclose(trial.switches, switches, atol=1e-10)
    np.testing.assert_allclose(trial.overshoots, overshoots, atol=1e-11)


@pytest.mark.parametrize("craft, total", [(USV, 250.0), (BOAT, 14.0)])
def test_turning_circle_ends_in_the_balance_of_forces(craft, total):
    right = T.circle(craft, total, turns=3.0, heading0=0.5)
    u, v, r = T.steady_turn(craft, total, math.radians(35))
    assert right.metrics["steady_turning_diameter"] == pytest.approx(
        2 * math.hypot(u, v) / r, rel=1e-6
    )
    assert 0 < right.metrics["transfer"] < right.metrics["tactical_diameter"]
    end = right.sim.at([right.switches[0]])
    assert end["psi"][0] - 0.5 == pytest.approx(math.pi / 2, abs=1e-11)
    left = T.circle(craft, total, turns=3.0, side="port")
    for name, value in right.metrics.items():
        assert left.metrics[name] == pytest.approx(value, abs=1e-8), name


def test_track_length_of_a_straight_run_and_peak_rate():
    sim = simulate(vessel(X_u=-3.0), [(0, 0)], 5.0, state=(0, 0, 0.3, 2.0, 0, 0))
    assert T.track_length(sim, 5.0) == pytest.approx(20 / 3 * (1 - math.exp(-1.5)), abs=1e-9)
    spin = simulate(vessel(N_r=-3.0), [(0, 0)], 5.0, state=(0, 0, 0, 0, 0, -0.7))
    assert T.peak_yaw_rate(spin) == pytest.approx(0.7, abs=1e-9)


# sensors and recordings


def test_sensor_effects_on_a_known_motion():
    """A free body turning at 0.5 rad/s on the spot and drifting north at 1 m/s."""
    env = {
        "lever-arm": {"x": 0.3, "y": -0.2}, "sensor-latency": {"delay": 0.4, "channels": ["x"]},
        "heading-offset": {"angle": 0.1}, "gyro-bias": {"bias": 0.02},
    }  # fmt: skip
    sim = simulate(vessel(), [(0, 0)], 5.0, env, (0, 0, 0, 1.0, 0, 0.5))
    t = np.arange(0, 5.01, 0.2)
    out = S.record(sim, t, wrapped=False)
    np.testing.assert_allclose(out["psi"], 0.5 * t + 0.1, atol=1e-10)
    np.testing.assert_allclose(out["r"], 0.52, atol=1e-10)
    late = t - 0.4
    x = late + 0.3 * np.cos(0.5 * late) + 0.2 * np.sin(0.5 * late)
    np.testing.assert_allclose(out["x"][2:], x[2:], atol=1e-9)
    assert np.isnan(out["x"][:2]).all()
    np.testing.assert_allclose(out["y"], 0.3 * np.sin(0.5 * t) - 0.2 * np.cos(0.5 * t), atol=1e-9)
    np.testing.assert_allclose(out["u"], np.cos(0.5 * t), atol=1e-9)
    assert S.wrap(np.array([3.5, -3.5, 0.2])) == pytest.approx(
        [3.5 - 2 * math.pi, 2 * math.pi - 3.5, 0.2]
    )


def test_a_drifting_clock_shows_the_past():
    """Steady motion at 1 m/s: stamped t, the state at t - (offset + rate t)."""
    drift = {"clock-drift": {"offset": 0.3, "rate": 0.02}}
    late = {"sensor-latency": {"delay": 0.5, "channels": ["y"]}}
    steps = [(0, 0), (1, {"p": 3.0, "s": -3.0})]
    sim = simulate(vessel(PAIR), steps, 5.0, drift | late, (0, 0, 0, 1.0, 0, 0.4))
    t = np.arange(0, 5.01, 0.25)
    shown = t - 0.3 - 0.02 * t
    out = S.record(sim, t, wrapped=False)
    here = simulate(vessel(PAIR), steps, 5.0, None, (0, 0, 0, 1.0, 0, 0.4))
    for channel in S.CHANNELS:
        back = shown - (0.5 if channel == "y" else 0)
        assert np.array_equal(np.isnan(out[channel]), back < 0), channel
        expected = here.at(back[back >= 0])[channel]
        np.testing.assert_allclose(out[channel][back >= 0], expected, atol=1e-9)
    np.testing.assert_array_equal(out["cmd_p"], np.where(t >= 1, 3.0, 0.0))
    early = {"clock-drift": {"offset": -0.3}}
    out = S.record(simulate(vessel(PAIR), steps, 5.0, early, (0, 0, 0, 1.0, 0, 0)), t)
    assert np.isnan(out["x"][-2:]).all() and out["x"][0] == pytest.approx(0.3)


def test_a_roll_has_its_period_and_spread():
    phi = S.roll(np.random.default_rng(2), 0.0, 8000.0, 3.0)(np.arange(0, 8000, 0.05))
    assert np.std(phi) == pytest.approx(math.radians(3), rel=0.05)
    crossings = np.sum((phi[1:] > 0) & (phi[:-1] <= 0))
    assert crossings * 3.0 == pytest.approx(8000, rel=0.02)


def test_hard_iron_has_the_period_of_the_heading():
    iron = {"hard-iron": {"amplitude": 0.1, "phase": 0.7}}
    sim = simulate(vessel(), [(0, 0)], 12.0, iron, (0, 0, 0.7, 0, 0, math.pi / 6))
    shown = S.record(sim, np.array([0.0, 3.0, 6.0, 9.0]), wrapped=False)["psi"]
    quarters = 0.7 + np.array([0, 0.5, 1.0, 1.5]) * math.pi
    np.testing.assert_allclose(shown - quarters, [0, 0.1, 0, -0.1], atol=1e-9)


def test_noise_resolution_and_rates():
    sim = simulate(vessel(), [(0, 0)], 400.0, state=(0, 0, 0, 0, 0, 0))
    t = np.arange(4000) / 10
    sensors = {"u": S.Sensor(0.1, 0.05), "x": S.Sensor(0.0, 0.0, 4)}
    out = S.record(sim, t, sensors, np.random.default_rng(3))
    assert np.std(out["u"]) == pytest.approx(math.hypot(0.1, 0.05 / math.sqrt(12)), rel=0.05)
    np.testing.assert_allclose(out["u"] / 0.05, np.round(out["u"] / 0.05), atol=1e-9)
    assert np.isfinite(out["x"]).sum() == 1000 and np.isfinite(out["x"][::4]).all()


def test_gusts_have_their_variance_and_memory():
    a = S.gust(np.random.default_rng(5), 0.0, 20000.0, std=(0.3, 0.2, 0.1), tau=(5.0, 2.0, 3.0))
    t = np.arange(0, 20000, 0.5)
    series = a(t)
    np.testing.assert_allclose(series.std(0), [0.3, 0.2, 0.1], rtol=0.05)
    lagged = [np.corrcoef(series[:-4, i], series[4:, i])[0, 1] for i in range(3)]
    np.testing.assert_allclose(lagged, np.exp(-2.0 / np.array([5.0, 2.0, 3.0])), atol=0.05)
    push = simulate(vessel(), [(0, 0)], 3.0, gust=lambda t: (0.5, 0.0, 0.0))
    assert push.at([3.0])["x"][0] == pytest.approx(0.5 * 0.5 * 9, abs=1e-10)


def test_recordings_are_seeded_and_conceal_the_truth(tmp_path):
    truth = tmp_path / "truth.json"
    options = [
        "--vessel",
        str(HERE / "boat.toml"),
        "--seconds",
        "12",
        "--runs",
        "zigzag-fast",
        "spin",
    ]
    effect = ["--effect", "sensor-latency", "delay=0.4", "channels=x,y"]
    R.main([str(tmp_path / "a"), *options, "--seed", "4", "--truth", str(truth)])
    R.main([str(tmp_path / "b"), *options, "--seed", "4", *effect])
    R.main([str(tmp_path / "c"), *options, "--seed", "5"])
    files = sorted(p.name for p in (tmp_path / "a").iterdir())
    assert files == ["spin.csv", "zigzag-fast.csv"] and truth.exists()
    texts = [(tmp_path / d / "zigzag-fast.csv").read_text() for d in "abc"]
    a, b, c = (list(csv.DictReader(text.splitlines())) for text in texts)
    assert list(a[0]) == ["t", "x", "y", "psi", "u", "v", "r", "cmd_port", "cmd_starboard"]
    assert len(a) == 61 and [row["psi"] for row in a] == [row["psi"] for row in b]
    assert b[0]["x"] == b[1]["x"] == "" != b[2]["x"] and a[0]["x"] != ""
    assert [row["psi"] for row in a] != [row["psi"] for row in c]
    assert len({row["cmd_port"] for row in a}) == 3  # straight, one side, the other


def test_perturbed_hull_differs_by_the_stated_share():
    true = R.perturbed(BOAT, R.stream(7, "hull"))["hull"]
    change = {k: abs(true[k] / v - 1) for k, v in BOAT["hull"].items()}
    assert all(0.15 <= change[k] <= 0.25 for k in change if H.DERIVATIVE.match(k))
    assert all(0.0375 <= change[k] <= 0.0625 for k in R.MASSES)
    assert all(change[k] == 0 for k in ("length", "beam", "draught", "x_G"))


CATALOGUE = {
    "heading-offset": ["angle=0.1"],
    "hard-iron": ["amplitude=0.1", "phase=0.3"],
    "gyro-bias": ["bias=0.01"],
    "sensor-latency": ["delay=0.5", "channels=x,y"],
    "lever-arm": ["x=1", "y=0.5"],
    "clock-drift": ["rate=0.01", "offset=0.2"],
    "current": ["speed=0.3", "direction=1"],
    "wind": ["speed=6", "direction=1"],
    "wave-force": ["bias=20", "amplitude=30", "frequency=0.2", "phase=0.5", "direction=1"],
    "shallow-water": ["depth=0.5"],
    "thrust-lag": ["time_constant=0.8"],
    "thrust-delay": ["delay=0.6"],
    "rate-limit": ["rate_limit=30"],
    "actuator-response": ["delay=0.6", "time_constant=0.8"],
    "deadband": ["width=12"],
    "backlash": ["width=12"],
    "thrust-saturation": ["limit=50", "actuators=port"],
    "actuator-bias": ["bias=9", "actuators=starboard"],
    "thrust-asymmetry": ["ratio=0.1"],
    "thruster-misalignment": ["angle=0.1"],
    "thrust-loss-with-speed": ["slope=0.1"],
    "thrust-loss-in-turns": ["slope=0.5"],
    "thrust-change": ["time=6", "factor=-0.3"],
    "propeller-side-force": ["Y_ahead=0.05", "N_ahead=0.02", "Y_astern=0.1", "N_astern=0.05"],
    "rudder-interaction": ["a_H=0.1", "x_H=-3", "gamma_R=0.9"],
    "quadratic-damping": ["X_uu=-30", "Y_vv=-90", "N_rr=-300"],
    "crossflow-drag": ["cd=1"],
    "sway-yaw-coupling": ["Y_r=60", "N_v=40"],
    "speed-dependent-damping": ["Y_ur=50", "N_ur=-100", "Y_uv=-60", "N_uv=30"],
    "added-mass-coupling": ["Y_rdot=-30", "N_vdot=-30", "x_G=0.1"],
    "munk-moment": ["Y_vdot - X_udot=60"],
    "mass-change": ["time=6", "mass=50"],
    "drag-change": ["time=6", "factor=0.5"],
    "roll-coupling": ["Y_phi=200", "N_phi=300"],
}  # fmt: skip


@pytest.fixture(scope="module")
def plain_recordings(tmp_path_factory):
    return {vessel: rows_of(tmp_path_factory.mktemp(vessel), vessel) for vessel in ("usv", "ship")}


def rows_of(folder, vessel, effect=()):
    """The rows of two runs of 20 s with an effect."""
    options = ["--vessel", str(HERE / f"{vessel}.toml"), "--seed", "3", "--seconds", "20"]
    options += ["--runs", "random-steps", "speed-steps"]
    R.main([str(folder), *options, *(["--effect", *effect] if effect else [])])
    return [list(csv.DictReader(p.read_text().splitlines())) for p in sorted(folder.iterdir())]


@pytest.mark.proof
@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_recordings_have_any_effect_of_the_catalogue(name, plain_recordings, tmp_path):
    vessel = "ship" if name.startswith(("propeller", "rudder")) else "usv"
    found = rows_of(tmp_path, vessel, [name, *CATALOGUE[name]])
    for run, plain in zip(found, plain_recordings[vessel], strict=True):
        assert len(run) == 101 and ("phi" in run[0]) == (name == "roll-coupling")
        assert [row["cmd_" + x] for row in run for x in orders_of(vessel)] == [
            row["cmd_" + x] for row in plain for x in orders_of(vessel)
        ]
    motion = [[[row[c] for c in S.CHANNELS] for row in run] for run in found]
    assert motion != [[[row[c] for c in S.CHANNELS] for row in run]
                      for run in plain_recordings[vessel]]  # fmt: skip


def orders_of(vessel):
    return ("port", "starboard") if vessel == "usv" else ("propeller", "rudder")
