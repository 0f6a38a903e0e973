"""What answers to orders are computed from: used spans on an even clock, and times that suit them.

Blocks and other times follow from the vessel's own, as long as she takes to turn by 90 deg at the
fastest rate recorded, and are at least those of a small boat.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffsea.checks.shares import OrderShares, orders_of
from diffsea.recordings.conditioning import resample
from diffsea.recordings.motion import motion_of
from diffsea.segments.free_motion import quarter_turn_window
from diffsea.trajectory import Samples, Trajectory


DRAWS = 400  # of a bootstrap
LEVEL = 0.9  # of the intervals
STAYED = 8.0  # s for which an order of a small boat has stood before she is steady
_FINEST = 0.05  # s, of the clock on which answers are compared
_CONSTANTS = 24  # time constants looked for


@dataclasses.dataclass(frozen=True)
class TimeScales:
    """Times (s) that suit a vessel.

    Attributes:
        interval: of the clock on which answers are compared.
        latest: the longest dead time looked for.
        slowest: the longest time constant looked for.
        stayed: for which an order has stood before speed or rate count as steady.
        block: of the bootstrap.
    """

    interval: float
    latest: float
    slowest: float
    stayed: float
    block: float

    @property
    def constants(self) -> Float[np.ndarray, "constant"]:
        """Time constants looked for."""
        return np.geomspace(2 * self.interval, self.slowest, _CONSTANTS)


def time_scales(runs: Sequence[Trajectory]) -> TimeScales:
    """The scales of runs of one vessel, by their fastest turning: the longest that any has."""
    each = [dataclasses.astuple(_time_scales_of(run)) for run in runs]
    return TimeScales(*map(max, zip(*each, strict=True)))


def _time_scales_of(run: Trajectory) -> TimeScales:
    motion, window = motion_of(run), 0.0
    if motion.has("r"):
        window = quarter_turn_window(motion.t, motion.values["r"])
    elif motion.has("psi"):
        window = quarter_turn_window(motion.t, np.gradient(motion.values["psi"], motion.t))
    return TimeScales(
        interval=max(motion.interval, _FINEST, window / 100),
        latest=max(4.0, 0.5 * window),
        slowest=max(20.0, 4 * window),
        stayed=max(STAYED, window),
        block=max(20.0, window),
    )


@dataclasses.dataclass(frozen=True)
class IntervalEstimate:
    """A number with its interval of `LEVEL`."""

    value: float
    low: float
    high: float
    unit: str

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json."""
        return {"value": self.value, "interval": [self.low, self.high], "unit": self.unit}


@dataclasses.dataclass(frozen=True)
class UsedSpan:
    """Orders and motion of one used span on an even clock; NaN where motion is not known."""

    orders: OrderShares
    speed: Samples
    rate: Samples


def used_span(run: Trajectory, scales: TimeScales) -> UsedSpan | None:
    """A span on an even clock; None without orders, or where it is too short."""
    run = run.counted()
    if orders_of(run) is None or run.t[-1] - run.t[0] < 2 * scales.stayed:
        return None
    even = resample(run, scales.interval)
    orders, motion = orders_of(even), motion_of(even)
    assert orders is not None
    unknown = np.full(motion.t.shape, np.nan)
    speed = rate = unknown
    if motion.has("u"):
        sway = motion.values["v"] if motion.has("v") else 0.0
        ahead = np.where(motion.values["u"] < 0, -1.0, 1.0)
        speed = np.where(motion.known["u"], ahead * np.hypot(motion.values["u"], sway), np.nan)
    elif motion.has("x", "y"):
        width = max(1, round(1.0 / scales.interval))
        pace = [np.gradient(motion.values[axis], motion.t) for axis in "xy"]
        smooth = [np.convolve(part, np.ones(width) / width, "same") for part in pace]
        speed = np.where(motion.known["x"], np.hypot(*smooth), np.nan)
    if motion.has("r"):
        rate = np.where(motion.known["r"], motion.values["r"], np.nan)
    elif motion.has("psi"):
        rate = np.where(motion.known["psi"], np.gradient(motion.values["psi"], motion.t), np.nan)
    return UsedSpan(orders, speed, rate)
