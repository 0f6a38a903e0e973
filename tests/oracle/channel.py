"""How an actuator answers its orders, in closed form between orders.

Chain: order -> delay -> bias -> dead band -> limits -> backlash -> lag and slew rate.

    bias          c + b
    dead band     0 inside |c| <= w, c - sign(c) w outside
    limits        clip to [low, high]; `limit` clips to +-limit
    backlash      play: y = clip(y before, c - w, c + w); at the start y = c
    lag           n' = (c - n) / T, |n'| <= R; closed form, as c is held between orders

All in the unit of the order. Only the lag and the play have a memory, so that it makes no
difference that the delay comes last here. Before the first order the actuator rests at the
value ordered first.
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


class Channel:
    """One actuator's channel; `data` has the keys of the chain, each optional.

    `low` and `high` are limits of the order, besides those that the kinds of actuators have.
    """

    def __init__(self, data: dict, low: float = -math.inf, high: float = math.inf):
        self.name = data["name"]
        self.time_constant = data.get("time_constant", 0.0)
        self.rate = data.get("rate_limit") or math.inf
        self.delay, self.deadband = data.get("delay", 0.0), data.get("deadband", 0.0)
        self.bias, self.play = data.get("bias", 0.0), data.get("backlash", 0.0)
        limit = data.get("limit", math.inf)
        self.lowest, self.highest = max(low, -limit), min(high, limit)
        self.segments: list[Segment] = []
        self.starts: list[float] = []

    def shape(self, order: float) -> float:
        """The order after bias, dead band and limits."""
        value = order + self.bias
        value = math.copysign(max(abs(value) - self.deadband, 0.0), value)
        return min(max(value, self.lowest), self.highest)

    def order(self, t: float, value: float) -> None:
        """Hold `value` from time t on; it acts from t + delay. Orders come in order of time."""
        target = self.shape(value)
        if not self.segments:
            segment = Segment(-math.inf, target, target, 0.0, math.inf)
        else:
            last, start = self.segments[-1], t + self.delay
            target = min(max(last.target, target - self.play), target + self.play)
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
