"""Fixed thrusters with exact dead time, dead band, lag and rate limit under held orders.

Chain: order -> dead time -> dead band -> lag and rate limit -> curve -> clip -> efficiency.

    dead band     0 inside |c| <= b, c - sign(c) b outside
    lag           n' = (c - n) / T, |n'| <= R; closed form, as c is held between orders
    curve         thrust = c V n + d |n| n, n rev/s, V = u_r - y r the flow past the hull
    clip          thrust to [min_force, max_force]; with the key `saturate = "command"` of
                  the order before the lag instead (differs only beyond the limits)
    efficiency    1 - ratio to port (y < 0), 1 + ratio to starboard; losses with speed and turn

Before the first order the actuator rests at the value ordered first.
"""

from __future__ import annotations

import bisect
import math


class Segment:
    """n(t) from (start, value) towards a constant target."""

    def __init__(self, start, value, target, time_constant, rate):
        self.start, self.target = start, target
        self.gap = target - value
        self.T, self.R = time_constant, rate
        self.ramp = 0.0  # s of motion at the rate limit
        if rate < math.inf and self.gap:
            self.ramp = max(0.0, abs(self.gap) / rate - time_constant)

    def __call__(self, t: float) -> float:
        """Ramp at the limit while |gap| > R T, then exponential (or arrived, without a lag)."""
        dt = t - self.start
        if dt < self.ramp:
            return self.target - math.copysign(abs(self.gap) - self.R * dt, self.gap)
        if self.T == 0.0 or self.gap == 0.0:
            return self.target
        left = min(abs(self.gap), self.R * self.T)
        return self.target - math.copysign(left * math.exp(-(dt - self.ramp) / self.T), self.gap)

    def breakpoints(self) -> list[float]:
        return [self.start, self.start + self.ramp]


class Thruster:
    """One fixed thruster: pushes T (cos angle, sin angle) at (x, y), moment x F_y - y F_x."""

    def __init__(self, data: dict):
        self.name = data["name"]
        self.x, self.y = data.get("x", 0.0), data.get("y", 0.0)
        angle = data.get("angle", 0.0)
        self.cos, self.sin = math.cos(angle), math.sin(angle)
        self.high, self.low = data.get("max_force", math.inf), data.get("min_force", -math.inf)
        self.time_constant = data.get("time_constant", 0.0)
        self.rate = data.get("rate_limit") or math.inf
        self.delay, self.deadband = data.get("delay", 0.0), data.get("deadband", 0.0)
        self.curve = data.get("curve")
        self.clip_order = data.get("saturate", "force") == "command" and not self.curve
        self.gain = data.get("gain", 1.0)
        self.loss_speed, self.loss_turn = (
            data.get("loss_speed", 0.0),
            data.get("loss_turn", 0.0),
        )
        self.segments: list[Segment] = []
        self.starts: list[float] = []

    def shape(self, order: float) -> float:
        """The order after the dead band (and after the clip, if that is asked for)."""
        value = math.copysign(max(abs(order) - self.deadband, 0.0), order)
        return min(max(value, self.low), self.high) if self.clip_order else value

    def order(self, t: float, value: float) -> None:
        """Hold `value` from time t on; it acts from t + delay. Orders come in order of time."""
        target = self.shape(value)
        if not self.segments:
            segment = Segment(-math.inf, target, target, 0.0, math.inf)
        else:
            last, start = self.segments[-1], t + self.delay
            segment = Segment(start, last(start), target, self.time_constant, self.rate)
        self.segments.append(segment)
        self.starts.append(segment.start)

    def segment(self, t: float) -> Segment:
        """The segment in force just after t."""
        return self.segments[max(bisect.bisect_right(self.starts, t) - 1, 0)]

    def next_break(self, t: float, margin: float) -> float:
        """Next time after t at which the realised signal jumps or has a kink."""
        first = max(bisect.bisect_right(self.starts, t) - 1, 0)
        times = [b for s in self.segments[first:] for b in s.breakpoints() if b > t + margin]
        return min(times, default=math.inf)

    def raw(self, n: float, u: float, r: float) -> float:
        """Thrust before the clip [N]."""
        if self.curve is None:
            return n
        return self.curve["c"] * (u - self.y * r) * n + self.curve["d"] * abs(n) * n

    def thrust(self, n: float, u: float, r: float) -> float:
        """Thrust on the hull [N] for the actuator at n and relative surge u and yaw rate r."""
        loss = (1.0 - self.loss_speed * u) * (1.0 - self.loss_turn * abs(r))
        return self.gain * loss * min(max(self.raw(n, u, r), self.low), self.high)

    def push(self, n: float, u: float, r: float) -> tuple[float, float, float]:
        """(X, Y, N) about amidships."""
        T = self.thrust(n, u, r)
        fx, fy = T * self.cos, T * self.sin
        return fx, fy, self.x * fy - self.y * fx


def order_for_thrust(data: dict, T: float) -> float:
    """The order for thrust T [N]: T itself, or rev/s of T = d |n| n with a curve."""
    curve = data.get("curve")
    return math.copysign(math.sqrt(abs(T) / curve["d"]), T) if curve else T
