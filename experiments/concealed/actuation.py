"""From orders to realised actuation: dead time by a buffer, bias, dead band, limits, play by a
state, then first-order lag under a hard slew limit, in closed form between orders."""

import bisect
import math

from .model import Channel


class Servo:
    """One channel in time. `order` must be called with growing times."""

    def __init__(self, channel: Channel, first: float):
        self.channel = channel
        self.play = self._shape(first)  # the play's output before the first order
        # Pieces of the realised signal: (start, value at start, target).
        self.starts = [-math.inf]
        self.pieces = [(-math.inf, self.play, self.play)]

    def _shape(self, order: float) -> float:
        """Order after bias, dead band and limits."""
        c = self.channel
        n = order + c.bias
        n = n - math.copysign(min(abs(n), c.deadband), n)
        return min(max(n, c.low), c.high)

    def order(self, t: float, value: float) -> None:
        """The order `value` is given at t; it reaches the actuator `delay` later."""
        w = self.channel.backlash
        n = self._shape(value)
        self.play = min(max(self.play, n - w), n + w)
        start = t + self.channel.delay
        before = self.value(start)
        if self.play == self.pieces[-1][2]:
            return
        self.starts.append(start)
        self.pieces.append((start, before, self.play))

    def value(self, t: float) -> float:
        """Realised actuation at t."""
        start, value, target = self.pieces[bisect.bisect_right(self.starts, t) - 1]
        gap = target - value
        if gap == 0.0 or start == -math.inf:
            return target
        lag, rate = self.channel.lag, self.channel.rate
        if lag == 0.0 and rate == math.inf:
            return target
        slewing = max(0.0, abs(gap) / rate - lag)  # s during which the slew limit holds
        dt = t - start
        if dt < slewing:
            return value + math.copysign(rate * dt, gap)
        if lag == 0.0:
            return target
        left = min(abs(gap), rate * lag)
        return target - math.copysign(left * math.exp(-(dt - slewing) / lag), gap)

    def kinks(self, after: float, before: float) -> list[float]:
        """Times in the open interval at which the realised signal jumps or has a kink."""
        found = []
        lag, rate = self.channel.lag, self.channel.rate
        first = max(bisect.bisect_right(self.starts, after) - 1, 0)
        for start, value, target in self.pieces[first:]:
            slewing = max(0.0, abs(target - value) / rate - lag) if start > -math.inf else 0.0
            found += [start, start + slewing]
        return [t for t in found if after + 1e-9 < t < before - 1e-9]
