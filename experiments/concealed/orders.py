"""Manoeuvres as policies: open loop, or closed on the measured heading.

A manoeuvre speaks of throttle a (-1 to 1) and turn b (-1 to 1, positive to starboard); `mix` of
a hull turns them into orders of its actuators. A policy gives, for row k, the orders and the row
at which it wants to be asked again.
"""

import math
from collections.abc import Callable

import numpy as np

from . import sensors
from .model import Sensing


Mix = Callable[[float, float], list[float]]


class Table:
    """Open loop: throttle and turn change at given rows."""

    def __init__(self, changes: list[tuple[int, float, float]], mix: Mix):
        self.rows = [c[0] for c in changes]
        self.orders = [mix(a, b) for _, a, b in changes]

    def __call__(self, k: int, look) -> tuple[list[float], int]:
        i = int(np.searchsorted(self.rows, k, side="right")) - 1
        again = self.rows[i + 1] if i + 1 < len(self.rows) else 10**9
        return self.orders[max(i, 0)], again


class Replay:
    """Orders as they were logged: an array (rows, channels)."""

    def __init__(self, orders: np.ndarray):
        self.orders = orders
        changed = np.any(np.diff(orders, axis=0) != 0, axis=1)
        self.rows = [0, *(np.flatnonzero(changed) + 1).tolist()]

    def __call__(self, k: int, look) -> tuple[list[float], int]:
        i = int(np.searchsorted(self.rows, k, side="right")) - 1
        again = self.rows[i + 1] if i + 1 < len(self.rows) else 10**9
        return self.orders[self.rows[max(i, 0)]].tolist(), again


class Steering:
    """Closed loop on the measured heading: a zig-zag, or a proportional-derivative autopilot."""

    def __init__(self, mix: Mix, sensing: Sensing, noise: float, every: int, rng):
        self.mix, self.sensing, self.every = mix, sensing, every
        self.noise = noise
        self.rng = rng

    def heading(self, look) -> tuple[float, float]:
        """Measured heading and yaw rate."""
        state = look()
        psi = sensors.compass(self.sensing, float(state[2]))
        return psi + self.noise * self.rng.standard_normal(), float(state[5])

    def _next(self, k: int) -> int:
        return (k // self.every + 1) * self.every


class Zigzag(Steering):
    """Turn b until the heading has changed by `switch`, then the other way."""

    def configure(self, stages: list[tuple[int, float, float, float]]) -> "Zigzag":
        """Stages (from row, throttle, turn, switch heading in rad); the first in the lead."""
        self.stages, self.side, self.base = stages, 1.0, None
        return self

    def __call__(self, k: int, look) -> tuple[list[float], int]:
        a, b, switch = [s[1:] for s in self.stages if s[0] <= k or s is self.stages[0]][-1]
        if k < 0:
            return self.mix(a, 0.0), 0
        psi, _ = self.heading(look)
        self.base = psi if self.base is None else self.base
        if self.side * (psi - self.base) > switch:
            self.side = -self.side
        return self.mix(a, self.side * b), self._next(k)


class Autopilot(Steering):
    """Keeps heading changes given by rows: b = gain (error - time r), limited."""

    def configure(self, stages, gain: float, time: float, limit: float) -> "Autopilot":
        """Stages (from row, throttle, heading change from the start in rad)."""
        self.stages, self.gain, self.time, self.limit = stages, gain, time, limit
        self.base = None
        return self

    def __call__(self, k: int, look) -> tuple[list[float], int]:
        a, aim = [s[1:] for s in self.stages if s[0] <= k or s is self.stages[0]][-1]
        if k < 0:
            return self.mix(a, 0.0), 0
        psi, r = self.heading(look)
        self.base = psi if self.base is None else self.base
        b = self.gain * (self.base + aim - psi - self.time * r)
        b = round(min(max(b, -self.limit), self.limit), 2)
        return self.mix(a, b), self._next(k)


def random_steps(rng, rows, hold, throttle, turn, mix) -> Table:
    """Steps of both orders at random times, about every `hold` rows."""
    k, changes = -(10**6), []
    nxt = 0
    while k < rows:
        changes.append((k, rng.uniform(*throttle), rng.uniform(-turn, turn)))
        k = nxt
        nxt = k + int(hold * rng.uniform(0.3, 1.7)) + 1
    changes[0] = (changes[0][0], changes[0][1], 0.0)
    return Table(changes, mix)


def circles(rng, rows, hull_like, mix) -> Table:
    """A circle to starboard, a straight, a tighter slower one to port."""
    fast, slow = rng.uniform(0.5, 0.75), rng.uniform(0.2, 0.35)
    tight, wide = rng.uniform(0.5, 0.8), rng.uniform(0.25, 0.4)
    share = [0.04, 0.42, 0.5, 0.9]
    starts = [int(s * rows) for s in share]
    side = rng.choice([-1.0, 1.0])
    return Table([(-(10**6), fast, 0.0), (starts[0], fast, side * wide), (starts[1], fast, 0.0),
                  (starts[2], slow, -side * tight), (starts[3], slow, 0.0)], mix)  # fmt: skip


def crash_and_coast(rng, rows, astern, mix) -> Table:
    """Sprint, coast with a small turn, sprint, crash stop, away again, in small steps."""
    top = rng.uniform(0.75, 0.95)
    b = rng.uniform(0.1, 0.3) * rng.choice([-1.0, 1.0])
    stages = [(0.02, top, 0.0), (0.2, 0.0, b), (0.36, 0.5 * top, -b), (0.46, top, 0.0),
              (0.58, -astern, 0.0), (0.70, 0.12, b), (0.78, 0.3, b), (0.86, 0.15, -b),
              (0.93, 0.6, 0.0)]  # fmt: skip
    return Table([(-(10**6), 0.3, 0.0), *((int(s * rows), a, b) for s, a, b in stages)], mix)


def straight(rng, rows, mix) -> Table:
    """One speed, no turn: a run that tells little."""
    return Table([(-(10**6), rng.uniform(0.35, 0.6), 0.0)], mix)


def full(rng: np.random.Generator, hull, sensing: Sensing) -> list:
    """Four training policies and two of other manoeuvres."""
    mix, rows, hold = hull.mix, hull.rows, hull.hold / hull.step
    zig = _zigzag(rng, hull, sensing)
    legs = np.cumsum(rng.choice([-1.0, 1.0], 5) * np.radians(rng.uniform(40.0, 110.0, 5)))
    marks = (np.arange(6) * rows // 6).tolist()
    aims = [0.0, *legs.tolist()]
    pilot = _steered(Autopilot, rng, hull, sensing).configure(
        [(m if m else -1, rng.uniform(0.25, 0.75), a) for m, a in zip(marks, aims, strict=True)],
        hull.gain, hull.lead_time, 0.6,
    )  # fmt: skip
    return [
        random_steps(rng, rows, hold, (0.1, 0.9), 0.6, mix),
        zig,
        circles(rng, rows, hull, mix),
        crash_and_coast(rng, rows, hull.astern, mix),
        pilot,
        random_steps(rng, rows, 1.5 * hold, (0.05, 0.5), 0.9, mix),
    ]


def uninformative(rng: np.random.Generator, hull, sensing: Sensing) -> list:
    """Straight runs at constant speed."""
    return [straight(rng, hull.rows, hull.mix) for _ in range(6)]


def standard(rng: np.random.Generator, hull, sensing: Sensing) -> list:
    """Zig-zags and circles alone, as trials have them; the last two are held out."""
    zig = lambda: _zigzag(rng, hull, sensing)
    circle = lambda: circles(rng, hull.rows, hull, hull.mix)
    return [zig(), circle(), zig(), circle(), zig(), circle()]


def alike(rng: np.random.Generator, hull, sensing: Sensing) -> list:
    """Six runs of one kind, as an owner has them who sailed one manoeuvre: causes have rivals."""
    mix, rows, hold = hull.mix, hull.rows, hull.hold / hull.step
    kinds = [
        lambda: _zigzag(rng, hull, sensing),
        lambda: circles(rng, rows, hull, mix),
        lambda: crash_and_coast(rng, rows, hull.astern, mix),
        lambda: random_steps(rng, rows, hold, (0.4, 0.6), 0.3, mix),
    ]
    sail = kinds[int(rng.integers(len(kinds)))]
    return [sail() for _ in range(6)]


# Of a stratum; others `full`.
RUN_SETS = {
    "uninformative": uninformative, "standard": standard, "alike": alike, "short": alike,
}  # fmt: skip


def _zigzag(rng: np.random.Generator, hull, sensing: Sensing) -> Zigzag:
    """Slow in the first half, fast in the second, each with an angle of its own."""
    angle = lambda: math.radians(rng.uniform(15.0, 35.0))
    return _steered(Zigzag, rng, hull, sensing).configure([
        (-1, rng.uniform(0.2, 0.4), rng.uniform(0.25, 0.5), angle()),
        (hull.rows // 2, rng.uniform(0.5, 0.8), rng.uniform(0.25, 0.5), angle()),
    ])  # fmt: skip


def _steered(kind, rng: np.random.Generator, hull, sensing: Sensing):
    every = max(1, round(hull.control / hull.step))
    return kind(hull.mix, sensing, hull.instruments["compass"].std, every, rng)
