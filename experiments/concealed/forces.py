"""Forces on the hull and of the actuators, written from the textbooks.

Hull: SNAME derivatives (Fossen 2021, ch. 6) or MMG primes (Yasukawa and Yoshimura 2015);
cross-flow drag by numerical strips; propeller and rudder by the MMG standard method; wind by
projected areas in the apparent wind. Each `..._force` returns a function to (X, Y, N).
"""

import math
from collections.abc import Callable

import numpy as np

from .model import AIR, Actuator, Model, density


STRIPS = 40


def hull_force(hull: dict) -> Callable:
    """Damping as a function of (u, v, r) through the water."""
    return _mmg(hull) if hull.get("nondimensional") == "mmg" else _dimensional(hull)


def _dimensional(h: dict) -> Callable:
    """Linear, modulus, cubic and speed-proportional terms, N and N m."""
    g = lambda name: h.get(name, 0.0)
    X_u, X_uu, X_uuu, X_vv, X_vr = g("X_u"), g("X_uu"), g("X_uuu"), g("X_vv"), g("X_vr")
    Y_v, Y_vv, Y_vvv, Y_uv = g("Y_v"), g("Y_vv"), g("Y_vvv"), g("Y_uv")
    Y_r, Y_rr, Y_ur = g("Y_r"), g("Y_rr"), g("Y_ur")
    N_v, N_vv, N_uv = g("N_v"), g("N_vv"), g("N_uv")
    N_r, N_rr, N_rrr, N_ur = g("N_r"), g("N_rr"), g("N_rrr"), g("N_ur")
    # Benign misfit: |u|^(p-1) in place of |u|, equal at the reference speed.
    power, speed = h.get("power", 2.0), h.get("power_speed", 1.0)

    def force(u: float, v: float, r: float) -> tuple[float, float, float]:
        a = abs(u) if power == 2.0 else speed * (abs(u) / speed) ** (power - 1.0)
        X = (X_u + X_uu * a + X_uuu * u * u) * u + X_vv * v * v + X_vr * v * r
        Y = (Y_v + Y_vv * abs(v) + Y_vvv * v * v + Y_uv * u) * v
        Y += (Y_r + Y_rr * abs(r) + Y_ur * u) * r
        N = (N_v + N_vv * abs(v) + N_uv * u) * v
        N += (N_r + N_rr * abs(r) + N_rrr * r * r + N_ur * u) * r
        return X, Y, N

    return force


def _mmg(h: dict) -> Callable:
    """Primes by 1/2 rho L d U^2 and 1/2 rho L^2 d U^2 with v' = v/U, r' = r L/U."""
    g = lambda name: h.get(name, 0.0)
    L, k = h["length"], 0.5 * density(h) * h["length"] * h["draught"]
    names = (
        "X_0 X_vv X_vr X_rr X_vvvv Y_v Y_r Y_vvv Y_vvr Y_vrr Y_rrr N_v N_r N_vvv N_vvr N_vrr N_rrr"
    )
    X0, Xvv, Xvr, Xrr, Xv4, Yv, Yr, Yv3, Yv2r, Yvr2, Yr3, Nv, Nr, Nv3, Nv2r, Nvr2, Nr3 = map(
        g, names.split()
    )
    power, speed = h.get("power", 2.0), h.get("power_speed", 1.0)

    def force(u: float, v: float, r: float) -> tuple[float, float, float]:
        U = math.hypot(u, v)
        if U < 1e-6:
            return 0.0, 0.0, 0.0
        a, b = v / U, r * L / U
        q = k * U * U
        resistance = X0 if power == 2.0 else X0 * (U / speed) ** (power - 2.0)
        X = resistance + Xvv * a * a + Xvr * a * b + Xrr * b * b + Xv4 * a**4
        Y = Yv * a + Yr * b + Yv3 * a**3 + Yv2r * a * a * b + Yvr2 * a * b * b + Yr3 * b**3
        N = Nv * a + Nr * b + Nv3 * a**3 + Nv2r * a * a * b + Nvr2 * a * b * b + Nr3 * b**3
        return q * X, q * Y, q * L * N

    return force


def strip_force(hull: dict, cd: float) -> Callable:
    """Cross-flow drag: sections with a coefficient of their own, fuller amidships, mean cd."""
    L = hull["length"]
    x = (np.arange(STRIPS) + 0.5) / STRIPS * L - 0.5 * L
    shape = 1.0 + 0.2 * np.cos(2.0 * math.pi * x / L)
    k = -0.5 * density(hull) * hull["draught"] * cd * shape / shape.mean() * (L / STRIPS)
    kx = k * x

    def force(v: float, r: float) -> tuple[float, float]:
        w = v + x * r
        q = w * np.abs(w)
        return float(k @ q), float(kx @ q)

    return force


def wind_force(
    hull: dict, air: tuple[float, float], coefficients: tuple[float, float, float]
) -> Callable:
    """Quadratic in the apparent wind, function of (psi, u, v) with u, v over ground.

    Areas beam x draught and length x draught; C_X and C_Y with a little of the third harmonic in
    the angle of attack, as measured curves have; N = C_N q A L sin 2 gamma with gamma from ahead.
    """
    front, side = hull["beam"] * hull["draught"], hull["length"] * hull["draught"]
    q = 0.5 * AIR
    C_X, C_Y, C_N = coefficients

    def force(psi: float, u: float, v: float) -> tuple[float, float, float]:
        c, s = math.cos(psi), math.sin(psi)
        a, b = c * air[0] + s * air[1] - u, c * air[1] - s * air[0] - v
        V2, g = a * a + b * b, math.atan2(b, a)
        X = q * front * V2 * (C_X * math.cos(g) + 0.03 * math.cos(3 * g))
        Y = q * side * V2 * (C_Y * math.sin(g) - 0.03 * math.sin(3 * g))
        return X, Y, q * side * hull["length"] * V2 * -C_N * math.sin(2 * g)

    return force


def thrust(a: Actuator, n: float, u: float, r: float) -> float:
    """Force of a thruster at the realised order n, N, before losses."""
    curve, data = a.data.get("curve"), a.data
    if curve:
        flow = u - data["y"] * r
        force = curve["c"] * flow * n + curve["d"] * abs(n) * n
    else:
        force = n
    top = data["max_force"] if force > 0 else -data.get("min_force", 0.0)
    if a.bend and top > 0:
        force *= 1.0 + 2.0 * a.bend * (1.0 - min(abs(force) / top, 1.0))
    return min(max(force, data.get("min_force", 0.0)), data["max_force"])


def propeller_thrust(data: dict, rho: float, n: float, u: float, v: float, r: float) -> float:
    """T = rho n^2 D^4 K_T(J), J = u (1 - w) / (n D), written without dividing by n."""
    D = data["diameter"]
    w = data.get("wake_fraction", 0.0)
    if data.get("wake_decay"):
        U = math.hypot(u, v)
        beta = math.atan2(-v, u) - data["x"] * r / max(U, 1e-9)
        w *= math.exp(-data["wake_decay"] * beta * beta)
    k = [*data["k_T"], 0.0, 0.0, 0.0][:3]
    ua = u * (1.0 - w)
    return rho * D * D * (k[0] * D * D * abs(n) * n + k[1] * D * ua * abs(n) + k[2] * ua * ua)


def rudder_force(model: Model, a: Actuator) -> Callable:
    """(X, Y, N) of the rudder from (angle, u, v, r, n) by the MMG standard method."""
    d, rho = a.data, density(model.hull)
    screw = next(p.data for p in model.actuators if p.kind == "propeller")
    D, k_T = screw["diameter"], [*screw["k_T"], 0.0, 0.0, 0.0][:3]
    w, eps, kappa = screw.get("wake_fraction", 0.0), d.get("epsilon", 1.0), d.get("kappa", 0.5)
    eta = min(D / d["height"], 1.0)
    t_R, a_H, x_H = d.get("t_R", 0.0), d.get("a_H", 0.0), d.get("x_H", 0.0)
    gamma, l_R = d.get("gamma_R", 1.0), d["l_R"]
    slope = 0.5 * rho * d["area"] * d["lift_slope"]

    def force(angle: float, u: float, v: float, r: float, n: float):
        ua = u * (1.0 - w)
        u_R = eps * ua
        if n > 0.0 and ua > 0.0:
            J = ua / (n * D)
            K = max(k_T[0] + k_T[1] * J + k_T[2] * J * J, 0.0)
            jet = math.sqrt(ua * ua + 8.0 * K * (n * D) ** 2 / math.pi)  # without dividing by J
            u_R = eps * math.hypot(
                math.sqrt(eta) * (ua + kappa * (jet - ua)), math.sqrt(1.0 - eta) * ua
            )
        v_R = -gamma * (v + l_R * r)
        attack = angle - math.atan2(v_R, u_R)
        normal = slope * (u_R * u_R + v_R * v_R) * math.sin(attack)
        c, s = math.cos(angle), math.sin(angle)
        X, Y = -(1.0 - t_R) * normal * s, -(1.0 + a_H) * normal * c
        return X, Y, -(d["x"] + a_H * x_H) * normal * c

    return force
