"""The kinds of coordinates that an effect has, and what a fit must know of each.

A coordinate is a number that a fit moves. Its kind says how wide its prior is, where it may lie,
and at which values an absent effect is tried: whoever lays out a fit, screens candidates or starts
refits asks the coordinate and needs to know no effect by name.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from diffsea.scales import time_scale
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


Bound = tuple[float, float]
TimeSpan = tuple[float, float]  # s, on the runs' clocks: start and end of what was recorded
ANY: Bound = (-math.inf, math.inf)
ALL_LOST_AT_MOST: Bound = (-1.0, math.inf)  # of a share that is added
PRIOR_SPREAD = 3.0  # prior scale in noticeable sizes: what is noticeable is a cautious guess
ONSET_SHARES = 12  # of the recorded time, between which a change is tried
SHARE_BESIDE_CHANGE = 0.05  # of the rows, before and after: less than between two onsets tried

OfVessel = float | Callable[[Vessel], Scalar]  # a number, or one that depends on the vessel


class Peaks(NamedTuple):
    """Where what a model leaves over stands out: at what frequencies, and when."""

    frequencies: Float[np.ndarray, "peak"] = np.zeros(0)  # Hz
    jumps: dict[str, Float[np.ndarray, "peak"]] = {}  # s on the runs' clocks, by motion channel
    before: float | None = None  # s: all was recorded after it, and something may have changed


NO_PEAKS = Peaks()


def value_on(number: OfVessel, vessel: Vessel) -> float:
    """A number that may depend on the vessel, on this one."""
    return float(number(vessel) if callable(number) else number)


@dataclasses.dataclass(frozen=True)
class Coordinate:
    """A number of an effect that a fit moves.

    `size` is how much of it would be noticeable on a vessel, in `unit`; a fit moves the multiple of
    it. No vessel lies beyond the `bounds`. Both may be functions of the vessel. The `key` is that
    of files, unless the effect has a parametrisation of its own.

    `is_amount`: it says how much of the effect there is, which is absent where all amounts are
    zero. Other coordinates say when, where or how, and do nothing then.
    """

    key: str
    unit: str
    size: OfVessel
    bounds: Bound | Callable[[Vessel], Bound] = ANY
    is_amount: ClassVar[bool] = False
    spread: ClassVar[float] = PRIOR_SPREAD

    def prior_spread(self, size: float, latest: float) -> float:
        """Scale of the prior in noticeable sizes, of runs whose clocks reach `latest` s."""
        return self.spread


@dataclasses.dataclass(frozen=True)
class Size(Coordinate):
    """How much of an effect there is: the motion has a derivative by it where it is zero.

    Its prior is a Student t. A `positive` one is never below zero. Where an effect far from zero
    looks nothing like its derivative there, `secants` are sizes (in noticeable ones) at which it is
    tried as well; without a `tangent` it has no derivative at zero and is tried at these alone. The
    effect's law holds up to `valid_to` noticeable sizes.
    """

    positive: bool = False
    secants: tuple[float, ...] = ()
    tangent: bool = True
    valid_to: float = math.inf
    is_amount: ClassVar[bool] = True


@dataclasses.dataclass(frozen=True)
class Coefficient(Coordinate):
    """A nuisance of which about as much is known as its size says: its prior is a normal one.

    Its `size` is one standard deviation. The effect is tried with it at zero and at each of
    `trials`, in standard deviations.
    """

    trials: tuple[float, ...] = ()
    spread: ClassVar[float] = 1.0


def vessel_time(vessel: Vessel) -> Scalar:
    """The time gravity takes over a ship's length, sqrt(L / g) in s."""
    return time_scale(vessel.rigid_body.length)


def onset_size(vessel: Vessel) -> Scalar:
    """Size of a time of change, s: with its prior, some hundred times sqrt(L / g)."""
    return 40 * vessel_time(vessel)


@dataclasses.dataclass(frozen=True)
class Onset(Coordinate):
    """The time (s, on the runs' clock) from which on an effect acts.

    It is scanned: data know nothing of it while the effect is absent, which is tried with several.
    """

    key: str = "time"
    unit: str = "s"
    size: OfVessel = onset_size

    def prior_spread(self, size: float, latest: float) -> float:
        """As wide as the runs are long: a change may happen at any time."""
        return max(PRIOR_SPREAD, latest / size)

    def scan(self, vessel: Vessel, spans: Sequence[TimeSpan], peaks: Peaks) -> list[float]:
        """Times (s) at which equal shares of all that was recorded in some spans have passed.

        And one before all of it, if something may have changed since.
        """
        recorded = sum(end - start for start, end in spans)
        times = [] if peaks.before is None else [peaks.before]
        for k in range(1, ONSET_SHARES):
            after, time = recorded * k / ONSET_SHARES, spans[-1][1]
            for start, end in spans:
                if after <= end - start:
                    time = start + after
                    break
                after -= end - start
            times.append(time)
        return times

    def spacing(self, tried: Sequence[float], size: float, resolution: float) -> float:
        """The median distance of neighbours, in noticeable sizes; zero for a single one."""
        return float(np.median(np.diff(np.sort(tried)))) if len(tried) > 1 else 0.0

    def lies_within(self, value: float, times: Float[np.ndarray, "row"]) -> bool:
        """Whether something changes amid the recorded times (s).

        A change with hardly anything before it, or after it, is a wrong parameter and no change.
        """
        share = float(np.mean(times < value))
        return SHARE_BESIDE_CHANGE < share < 1.0 - SHARE_BESIDE_CHANGE


@dataclasses.dataclass(frozen=True)
class Jump(Onset):
    """The time from which on readings of a motion channel are off: between one and the next.

    Where they are off by more than their noise, only that very moment will do: it is sought where
    readings surprise the model most, too.
    """

    channel: str = "psi"

    def scan(self, vessel: Vessel, spans: Sequence[TimeSpan], peaks: Peaks) -> list[float]:
        """Equal shares of what was recorded, and the moments at which the channel surprises."""
        return [*super().scan(vessel, spans, peaks), *peaks.jumps.get(self.channel, ())]


@dataclasses.dataclass(frozen=True)
class Frequency(Coordinate):
    """The frequency (Hz) of an effect that swings, counted from an `origin` of the vessel's own.

    It is scanned as an onset is, where the spectrum of what the model leaves over has peaks.
    """

    origin: OfVessel = 0.0

    def scan(self, vessel: Vessel, spans: Sequence[TimeSpan], peaks: Peaks) -> list[float]:
        """The frequencies (Hz) of peaks."""
        return list(peaks.frequencies - value_on(self.origin, vessel))

    def spacing(self, tried: Sequence[float], size: float, resolution: float) -> float:
        """The resolution (Hz) of a spectrum of the longest run, in noticeable sizes."""
        return resolution / size

    def lies_within(self, value: float, times: Float[np.ndarray, "row"]) -> bool:
        """Any frequency shows at any time."""
        return True


ScannedCoordinate = Onset | Frequency
