"""Wind and waves: forces of the environment as functions f(t, psi, u, v, u_r, v_r, r).

u, v over ground, u_r, v_r through the water; the result is (X, Y, N) in body axes.
"""

from __future__ import annotations

import math


AIR_DENSITY = 1.225  # kg/m^3


def polar(size: float, direction: float) -> tuple[float, float]:
    """(north, east) of a vector towards `direction`."""
    return size * math.cos(direction), size * math.sin(direction)


def to_body(north: float, east: float, psi: float) -> tuple[float, float]:
    """R(psi)' (north, east): forward and starboard components."""
    c, s = math.cos(psi), math.sin(psi)
    return c * north + s * east, c * east - s * north


def wind_force(hull: dict, values: dict):
    L, B, T = hull["length"], hull["beam"], hull["draught"]
    front = values.get("frontal_area", B * T)
    side = values.get("lateral_area", L * T)
    q = 0.5 * values.get("air_density", AIR_DENSITY)
    kx = q * front * values.get("C_X", 0.7)
    ky = q * side * values.get("C_Y", 0.85)
    kn = q * side * L * values.get("C_N", 0.1)
    north, east = polar(-values["speed"], values["direction"])
    calm = 1.0 - values.get("still_air", 0.0)

    def force(t, psi, u, v, u_r, v_r, r):
        a, b = to_body(north, east, psi)
        a, b = a - u, b - v
        V, S = math.hypot(a, b), calm * math.hypot(u, v)
        Y = ky * (V * b + S * v)
        moment = -kn * 2 * (a * b - calm * u * v) + values.get("C_NY", 0.0) * q * side * L * (
            V * b + S * v
        )
        return kx * (V * a + S * u), Y, moment

    return force


def wave_force(values: dict):
    omega = 2 * math.pi * values.get("frequency", 0.0)
    phase, direction = values.get("phase", 0.0), values.get("direction", 0.0)
    bias, amplitude = values.get("bias", 0.0), values.get("amplitude", 0.0)

    def force(t, psi, u, v, u_r, v_r, r):
        F = bias + amplitude * math.sin(omega * t + phase)
        return F * math.cos(direction - psi), F * math.sin(direction - psi), 0.0

    return force
