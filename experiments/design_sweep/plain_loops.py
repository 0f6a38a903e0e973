"""The same 20/20 zig-zag as plain loops: floats of Python, and arrays of NumPy over designs.

Runge-Kutta steps of the library's length with the order reversed at the sample, which is less
work than locating it. The model is the Otter's: linear surge drag, strip-theory cross-flow drag,
linear and quadratic yaw damping, no Munk moment, thrusters with a lag.
"""

import math
import time

import numpy as np
from jaxtyping import Float


class Constants:
    """The Otter's numbers at a mass or at an array of masses (kg), from its file as a dict."""

    def __init__(self, document: dict):
        hull, thruster = document["hull"], document["thruster"][1]
        self.half, self.T = 0.5 * hull["length"], thruster["time_constant"]
        self.arm, self.d = thruster["y"], thruster["curve"]["d"]
        self.most = thruster["max_speed"]
        self.m, self.m11 = hull["mass"], hull["mass"] - hull["X_udot"]
        self.m22, self.m23 = hull["mass"] - hull["Y_vdot"], hull["mass"] * hull["x_G"]
        self.m33 = hull["I_z"] + hull["mass"] * hull["x_G"] ** 2 - hull["N_rdot"]
        self.X_u, self.N_r, self.N_rr = hull["X_u"], hull["N_r"], hull["N_rr"]
        cd = next(e["cd"] for e in document["effect"] if e["name"] == "crossflow-drag")
        self.strip = -0.5 * hull["water_density"] * cd * hull["draught"]
        self.munk = hull["Y_vdot"] - hull["X_udot"]


def rate(c: Constants, u, v, r, port, starboard, maths):
    """Accelerations (u, v, r) at thruster speeds in rev/s; `maths` is `math` or `numpy`."""
    size = abs if maths is math else np.abs
    a, b = v - r * c.half, v + r * c.half
    # int |w| w dx = [|w|^3 / 3 r], int x |w| w dx = [|w|^3 w / 4 r^2] - v / r of the former
    near = 1e-9
    rr = (r if abs(r) > near else near) if maths is math else np.where(size(r) > near, r, near)
    cubes = (size(b) ** 3 - size(a) ** 3) / 3
    fourths = (size(b) ** 3 * b - size(a) ** 3 * a) / 4
    sway, yaw = cubes / rr, (fourths - v * cubes) / rr**2
    tp, ts = c.d * size(port) * port, c.d * size(starboard) * starboard
    py = c.m22 * v + c.m23 * r
    X = tp + ts + c.X_u * u + r * py
    Y = c.strip * sway - r * c.m11 * u
    N = (
        c.arm * (tp - ts) + c.strip * yaw + c.N_r * r + c.N_rr * size(r) * r
        - u * py + v * c.m11 * u - c.munk * u * v
    )  # fmt: skip
    det = c.m22 * c.m33 - c.m23**2
    return X / c.m11, (c.m33 * Y - c.m23 * N) / det, (c.m22 * N - c.m23 * Y) / det


def one(
    c: Constants, thrust: float, step: float, heading: float, executes: int, limit: float
) -> tuple[float, int]:
    """First overshoot (rad) read from the samples, and the steps it took: plain Python."""
    n0 = math.sqrt(0.5 * thrust / c.d)
    u, v, r, psi = thrust / -c.X_u, 0.0, 0.0, 0.0
    share, middle, after = (
        heading / math.radians(35),
        math.exp(-0.5 * step / c.T),
        math.exp(-step / c.T),
    )
    port = starboard = n0
    side, flips, highest, steps = 1.0, 0, 0.0, 0
    while flips < executes and steps * step < limit:
        to_port = min(n0 * math.sqrt(1 + side * share), c.most)
        to_starboard = min(n0 * math.sqrt(1 - side * share), c.most)
        p = (port, to_port + (port - to_port) * middle, to_port + (port - to_port) * after)
        s = (
            starboard, to_starboard + (starboard - to_starboard) * middle,
            to_starboard + (starboard - to_starboard) * after,
        )  # fmt: skip
        h, q = 0.5 * step, step / 6
        a1, b1, c1 = rate(c, u, v, r, p[0], s[0], math)
        a2, b2, c2 = rate(c, u + h * a1, v + h * b1, r + h * c1, p[1], s[1], math)
        a3, b3, c3 = rate(c, u + h * a2, v + h * b2, r + h * c2, p[1], s[1], math)
        a4, b4, c4 = rate(c, u + step * a3, v + step * b3, r + step * c3, p[2], s[2], math)
        psi += q * (6 * r + step * (c1 + c2 + c3))  # Runge-Kutta on psi_dot = r
        u += q * (a1 + 2 * a2 + 2 * a3 + a4)
        v += q * (b1 + 2 * b2 + 2 * b3 + b4)
        r += q * (c1 + 2 * c2 + 2 * c3 + c4)
        port, starboard, steps = p[2], s[2], steps + 1
        if flips == 1:
            highest = max(highest, psi)
        if side * psi >= heading:
            side, flips = -side, flips + 1
    return highest - heading, steps


def together(
    c: Constants, thrust: Float[np.ndarray, "design"], step: float, heading: float, count: int
) -> Float[np.ndarray, "design"]:
    """First overshoots (rad) of many designs at once: NumPy, `count` steps of all of them."""
    n0 = np.sqrt(0.5 * thrust / c.d)
    u, v, r, psi = thrust / -c.X_u, np.zeros_like(n0), np.zeros_like(n0), np.zeros_like(n0)
    share, middle, after = (
        heading / math.radians(35),
        math.exp(-0.5 * step / c.T),
        math.exp(-step / c.T),
    )
    port, starboard, side = n0.copy(), n0.copy(), np.ones_like(n0)
    flips, highest = np.zeros(n0.shape, int), np.zeros_like(n0)
    for _ in range(count):
        to_port = np.minimum(n0 * np.sqrt(1 + side * share), c.most)
        to_starboard = np.minimum(n0 * np.sqrt(1 - side * share), c.most)
        p = (port, to_port + (port - to_port) * middle, to_port + (port - to_port) * after)
        s = (
            starboard, to_starboard + (starboard - to_starboard) * middle,
            to_starboard + (starboard - to_starboard) * after,
        )  # fmt: skip
        h, q = 0.5 * step, step / 6
        a1, b1, c1 = rate(c, u, v, r, p[0], s[0], np)
        a2, b2, c2 = rate(c, u + h * a1, v + h * b1, r + h * c1, p[1], s[1], np)
        a3, b3, c3 = rate(c, u + h * a2, v + h * b2, r + h * c2, p[1], s[1], np)
        a4, b4, c4 = rate(c, u + step * a3, v + step * b3, r + step * c3, p[2], s[2], np)
        psi = psi + q * (6 * r + step * (c1 + c2 + c3))
        u = u + q * (a1 + 2 * a2 + 2 * a3 + a4)
        v = v + q * (b1 + 2 * b2 + 2 * b3 + b4)
        r = r + q * (c1 + 2 * c2 + 2 * c3 + c4)
        port, starboard = p[2], s[2]
        highest = np.where(flips == 1, np.maximum(highest, psi), highest)
        past = side * psi >= heading
        side, flips = np.where(past, -side, side), flips + past
    return highest - heading


def timed(document, thrusts: list[float], masses: list[float], step: float, seconds: float) -> dict:
    """Vessel-steps per second of both loops; `document(mass)` gives a vessel file's content."""
    heading = math.radians(20)
    began, steps = time.perf_counter(), 0
    for thrust, mass in zip(thrusts, masses, strict=True):
        steps += one(Constants(document(mass)), thrust, step, heading, 3, seconds)[1]
    python = steps / (time.perf_counter() - began)
    lanes, count = 4096, 100
    began = time.perf_counter()
    constants = Constants(document(masses[0]))
    together(constants, np.linspace(min(thrusts), max(thrusts), lanes), step, heading, count)
    numpy = lanes * count / (time.perf_counter() - began)
    return {"python": python, "numpy": numpy}
