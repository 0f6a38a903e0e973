"""Equations (1) to (7) and the logic of appendix B in plain Python, apart from the library.

It has two uses. With `rotated=False` it is right, and checks the library. With `rotated=True`
equations (1) and (2) are taken at their word for positions: body velocities are integrated to
body "positions" x and y, which are then turned by the present heading.
"""

import dataclasses
from collections.abc import Callable
from math import atan2, cos, hypot, pi, sin

import numpy as np


@dataclasses.dataclass(frozen=True)
class Boat:
    """Table I, SI units; a positive lever is ahead of the mass centre."""

    thrust: float = 20.0
    lever: float = 0.4
    mass: float = 7.0
    D: float = (7.0 / 1000.0 / pi) ** 0.5
    full_angle: float = 0.47 * pi

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Mass plus added mass in surge, sway and yaw."""
        m, L, W = self.mass, 1.0, 0.55
        section = 1000.0 * pi * self.D**2
        added_yaw = (0.1 * m * W**2 + section * L**3) / 24
        return 1.03 * m, m + section * L / 2, m * (W**2 + L**2) / 12 + added_yaw


@dataclasses.dataclass(frozen=True)
class Trial:
    """Waypoint (m), its tolerance (m), and the disturbance (N, N, rad)."""

    waypoint: tuple[float, float] = (20.0, 0.0)
    tolerance: float = 2.5
    bias: float = 0.0
    swing: float = 0.0
    direction: float = 0.0


def logic(boat: Boat, trial: Trial, x: float, y: float, psi: float) -> tuple[float, float]:
    """Thrust (N) and angle (rad) of appendix B."""
    north, east = trial.waypoint[0] - x, trial.waypoint[1] - y
    distance, error = hypot(north, east), atan2(east, north) - psi
    while error > pi:
        error -= 2 * pi
    while error < -pi:
        error += 2 * pi
    if distance <= trial.tolerance:
        return 0.0, 0.0
    if abs(error) < pi / 2:
        return boat.thrust, boat.full_angle * error / (pi / 2)
    thrust = boat.thrust / 3 * distance / 10 if distance <= 10 else boat.thrust / 2
    return thrust, boat.full_angle * (1 if error > 0 else -1)


def run(
    boat: Boat, trial: Trial, seconds: float, step: float = 0.02, rotated: bool = False
) -> np.ndarray:
    """Rows of t, X, Y, z, x', y', z' from rest at the origin until the waypoint is reached."""
    m_x, m_y, I = boat.inertia

    def place(s: np.ndarray) -> tuple[float, float]:
        x, y, z = s[:3]
        return (x * cos(z) - y * sin(z), y * cos(z) + x * sin(z)) if rotated else (x, y)

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        z, u, v, r = s[2:]
        F, b = logic(boat, trial, *place(s), z)
        b = b if boat.lever > 0 else -b
        force = trial.swing * sin(0.4 * pi * t) + trial.bias
        k = trial.direction
        du = (F * cos(b) + force * cos(k - z) + m_y * v * r - 14 * u) / m_x
        dv = (F * sin(b) + force * sin(k - z) - m_x * u * r - 80 * v) / m_y
        dr = (boat.lever * F * sin(b) - (m_y - m_x) * u * v - 5 * r) / I
        moved = (u, v) if rotated else (u * cos(z) - v * sin(z), u * sin(z) + v * cos(z))
        return np.array([*moved, r, du, dv, dr])

    s, rows = np.zeros(6), []
    for count in range(round(seconds / step) + 1):
        t = count * step
        rows.append((t, *place(s), *s[2:]))
        if hypot(trial.waypoint[0] - rows[-1][1], trial.waypoint[1] - rows[-1][2]) <= (
            trial.tolerance
        ):
            break
        s = s + step * slope(rate, t, s, step)
    return np.array(rows)


def slope(rate: Callable, t: float, s: np.ndarray, h: float) -> np.ndarray:
    """Mean rate over a step of the classical Runge-Kutta method."""
    a = rate(t, s)
    b = rate(t + h / 2, s + h / 2 * a)
    c = rate(t + h / 2, s + h / 2 * b)
    d = rate(t + h, s + h * c)
    return (a + 2 * b + 2 * c + d) / 6
