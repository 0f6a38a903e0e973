"""The reference simulator against closed forms."""

import csv
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.oracle import hull as H
from tests.oracle import make_recordings as R
from tests.oracle import sensors as S
from tests.oracle import trials as T
from tests.oracle.actuators import Thruster
from tests.oracle.simulator import Simulator, load, simulate


HERE = Path(__file__).parent / "oracle"
USV, BOAT = load(HERE / "usv.toml"), load(HERE / "boat.toml")
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
    """From 45 deg on the starboard bow: astern and to port; C_N > 0 turns to starboard."""
    sim = Simulator(vessel(), {"wind": {"speed": 6.0, "direction": 0.25 * math.pi, "still_air": 1}})
    X, Y, N = sim.forces(0.0, 0.0, 0.0, 0.0, 0.0, [])
    a = 6 / math.sqrt(2)
    assert X == pytest.approx(-0.5 * 1.225 * 0.7 * 0.5 * 0.2 * 6 * a)
    assert Y == pytest.approx(-0.5 * 1.225 * 0.85 * 2.0 * 0.2 * 6 * a)
    assert N == pytest.approx(0.5 * 1.225 * 0.1 * 2.0 * 0.2 * 2.0 * 2 * a * a)
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
    assert N == pytest.approx(-0.5 * 1.225 * 0.1 * 2.0 * 0.2 * 2.0 * 2 * 1.3 * 0.4)


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
        ahead = brentq(
            lambda s, q=q, sign=sign: heading(s, q) - sign * target, 1e-9, 60, xtol=1e-15
        )
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
    a, b, c = (list(csv.DictReader((tmp_path / d / "zigzag-fast.csv").open())) for d in "abc")
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
