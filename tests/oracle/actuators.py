"""Fixed thrusters: the force that a realised order makes (`channel.py`: how it is realised).

curve         thrust = c V n + d |n| n, n rev/s, V = u_r - y r the flow past the hull
clip          thrust to [min_force, max_force]; with the key `saturate = "command"` of
              the order before the lag instead (differs only beyond the limits)
acts_as       the order n acts as n': with a limit L the p-norm of both, (n^-8 + L^-8)^(-1/8);
              less a dead band; N (n / N)^p with N the largest limit; times a ratio astern
efficiency    1 - ratio to port (y < 0), 1 + ratio to starboard; losses with speed and turn
"""

from __future__ import annotations

import math

from .channel import Channel


class Thruster(Channel):
    """One fixed thruster: pushes T (cos angle, sin angle) at (x, y), moment x F_y - y F_x."""

    def __init__(self, data: dict):
        self.high, self.low = data.get("max_force", math.inf), data.get("min_force", -math.inf)
        self.curve, self.acts_as = data.get("curve"), data.get("acts_as")
        clip_order = data.get("saturate", "force") == "command" and not self.curve
        super().__init__(data, *((self.low, self.high) if clip_order else ()))
        self.x, self.y = data.get("x", 0.0), data.get("y", 0.0)
        angle = data.get("angle", 0.0)
        self.cos, self.sin = math.cos(angle), math.sin(angle)
        self.gain = data.get("gain", 1.0)
        self.loss_speed, self.loss_turn = (
            data.get("loss_speed", 0.0),
            data.get("loss_turn", 0.0),
        )

    def raw(self, n: float, u: float, r: float) -> float:
        """Thrust before the clip [N]."""
        if self.acts_as:
            n = acting(n, max(self.high, -self.low), **self.acts_as)
        if self.curve is None:
            return n
        return self.curve["c"] * (u - self.y * r) * n + self.curve["d"] * abs(n) * n

    def thrust(self, n: float, u: float, r: float) -> float:
        """Thrust on the hull [N] for the actuator at n and relative surge u and yaw rate r."""
        loss = (1.0 - self.loss_speed * u) * (1.0 - self.loss_turn * abs(r))
        return self.gain * loss * min(max(self.raw(n, u, r), self.low), self.high)

    def push(self, n: float, u: float, r: float, v: float = 0.0, others=None):
        """(X, Y, N) about amidships."""
        T = self.thrust(n, u, r)
        fx, fy = T * self.cos, T * self.sin
        return fx, fy, self.x * fy - self.y * fx

    def kinks(self, n: float, u: float, r: float, v: float) -> list[float]:
        """Functions whose sign changes are kinks of the force."""
        T = self.raw(n, u, r)
        if self.acts_as:
            edge = self.acts_as.get("deadband", 0.0)
            return [n, n - edge, n + edge]
        return [n, T - self.high, T - self.low]


def acting(
    n: float,
    largest: float,
    deadband: float = 0.0,
    exponent: float = 1.0,
    astern_ratio: float = 1.0,
    limit: float = math.inf,
) -> float:
    """The order that a thruster acts by when it is ordered n."""
    if n == 0.0:
        return 0.0
    size = abs(n) if limit == math.inf else (abs(n) ** -8 + limit**-8) ** (-1 / 8)
    size = largest * (max(size - deadband, 0.0) / largest) ** exponent
    return size if n > 0 else -astern_ratio * size


def order_for_thrust(data: dict, T: float) -> float:
    """The order for thrust T [N]: T itself, or rev/s of T = d |n| n with a curve."""
    curve = data.get("curve")
    return math.copysign(math.sqrt(abs(T) / curve["d"]), T) if curve else T
