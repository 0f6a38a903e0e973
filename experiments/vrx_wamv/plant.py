"""The reference plant: the simulator's planar equations in plain numpy, nothing of the library.

A rigid body about the hull's origin, linear plus quadratic drag on each axis, two fixed engines
whose thrust follows its order at once within its limits. No added mass: the published set has
none, so inertia and Coriolis forces are the rigid body's alone.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np


# Thrust per square of speed, N s^2: k_T rho D^4 (2 pi)^2 with the simulator's k_T = 0.004422,
# rho = 1000 kg/m^3, D = 0.2 m, which takes the engine's order in N and turns the propeller at
# the speed that belongs to it, whatever the boat's speed. The paper's largest order, 250 N,
# then is 29.9 rev/s, and its spin is at 30 rev/s.
THRUST_PER_SPEED = 0.004422 * 1000.0 * 0.2**4 * (2 * math.pi) ** 2
CHANNELS = ("x", "y", "psi", "u", "v", "r")
STEP = 0.05  # s, of the Runge-Kutta scheme


@dataclasses.dataclass(frozen=True)
class Plant:
    """The numbers of the published description, SI units, about the hull's origin."""

    mass: float = 258.0  # kg, hull, engines and equipment
    x_G: float = -0.286  # m forward of the origin
    I_zz: float = 704.0  # kg m^2, about the origin
    surge: tuple[float, float] = (100.0, 150.0)  # N per m/s, N per (m/s)^2
    sway: tuple[float, float] = (100.0, 100.0)
    yaw: tuple[float, float] = (800.0, 800.0)  # N m per rad/s, N m per (rad/s)^2
    arm: float = 1.027  # m, engines off the centreline; 2.65 m aft, where they push ahead only
    max_force: float = 2353.5  # N
    min_force: float = -1000.0

    @property
    def at_rest(self) -> tuple:
        """The state lying still at the origin, heading north."""
        return (0.0,) * len(CHANNELS)

    def thrust(self, n: float) -> float:
        """Thrust (N) of an engine turning at `n` rev/s, within its limits."""
        return min(max(THRUST_PER_SPEED * abs(n) * n, self.min_force), self.max_force)

    def drag(self, u: float, v: float, r: float) -> tuple[float, float, float]:
        """Drag forces (N, N, N m) against the motion."""
        pairs = zip((self.surge, self.sway, self.yaw), (u, v, r), strict=True)
        X, Y, N = ((a + b * abs(w)) * w for (a, b), w in pairs)
        return X, Y, N

    def rate(self, state: tuple, port: float, starboard: float) -> tuple:
        """Time derivative of (x, y, psi, u, v, r) under thrusts in N."""
        _, _, psi, u, v, r = state
        m, moment = self.mass, self.mass * self.x_G
        drag = self.drag(u, v, r)
        X = port + starboard - drag[0] + m * r * v + moment * r * r
        Y = -drag[1] - m * u * r
        N = (port - starboard) * self.arm - drag[2] - moment * u * r
        det = m * self.I_zz - moment**2
        c, s = math.cos(psi), math.sin(psi)
        return (
            c * u - s * v, s * u + c * v, r,
            X / m, (self.I_zz * Y - moment * N) / det, (m * N - moment * Y) / det,
        )  # fmt: skip

    def advanced(self, state: tuple, port: float, starboard: float, dt: float) -> tuple:
        """The state `dt` s later with engines at constant speeds (rev/s): Runge-Kutta, order 4."""
        thrusts = self.thrust(port), self.thrust(starboard)
        parts = max(1, math.ceil(dt / STEP - 1e-9))
        h = dt / parts
        for _ in range(parts):
            k1 = self.rate(state, *thrusts)
            k2 = self.rate(_moved(state, k1, 0.5 * h), *thrusts)
            k3 = self.rate(_moved(state, k2, 0.5 * h), *thrusts)
            k4 = self.rate(_moved(state, k3, h), *thrusts)
            mean = tuple(
                (a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)
            )
            state = _moved(state, mean, h)
        return state

    def steady_speed(self, thrust: float) -> float:
        """Speed (m/s) straight ahead under a total thrust in N, in closed form."""
        return _positive_root(self.surge, thrust)


NEW = Plant()
# The values of the simulator's first release: drag of one power in sway and yaw. Mass
# properties and engines are kept, so that the two sets differ in drag only.
OLD = Plant(surge=(51.3, 72.4), sway=(40.0, 0.0), yaw=(400.0, 0.0))


def _moved(state: tuple, slope: tuple, h: float) -> tuple:
    return tuple(x + h * d for x, d in zip(state, slope, strict=True))


def _positive_root(drag: tuple[float, float], push: float) -> float:
    """The w > 0 with (a + b w) w = push."""
    a, b = drag
    return push / a if b == 0 else (-a + math.sqrt(a * a + 4 * b * push)) / (2 * b)


def speed_for(thrust: float) -> float:
    """Engine speed (rev/s) of a thrust in N."""
    return math.copysign(math.sqrt(abs(thrust) / THRUST_PER_SPEED), thrust)


class AnyPlant(Protocol):
    """A boat to be driven; its state begins with `CHANNELS` and may go on with what is hidden."""

    @property
    def at_rest(self) -> tuple: ...

    def advanced(self, state: tuple, port: float, starboard: float, dt: float) -> tuple: ...


def driven(
    plant: AnyPlant, orders: Callable[[float], tuple], seconds: float, dt: float
) -> dict[str, np.ndarray]:
    """A run from rest under orders (port, starboard) in rev/s that hold for `dt` s each.

    Arrays `t`, motion channels, `port` and `starboard`; the last orders hold no longer.
    """
    state = plant.at_rest
    rows, count = [], round(seconds / dt)
    for k in range(count + 1):
        port, starboard = map(float, orders(k * dt))
        rows.append((k * dt, *state[: len(CHANNELS)], port, starboard))
        state = plant.advanced(state, port, starboard, dt)
    names = ("t", *CHANNELS, "port", "starboard")
    return dict(zip(names, np.array(rows).T, strict=True))
