"""Readings of columns as motion channels: which column, sign, quarter turn and axes.

A reading says that north, east, heading, u, v and yaw rate are such columns with such signs,
that heading has a quarter turn added, and whether velocities are along body or earth axes.
Its prior comes from names and conventions: north-east-down as it is, east-north-up, or
north-west-up, and what each departure from one of these costs. A whole record of mirrored
axes is as consistent as one that is not, so between those the prior alone decides, until
actuators or geographic positions speak.

Units: which are usual, which are stated, and what ratios of columns say of them.
"""

import dataclasses
import itertools
import math

import numpy as np

from diffsea.recordings.mapping_proposal.names import Suggestion


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """One way to read the motion of a file. Columns are names, None where there is none."""

    x: str | None = None
    y: str | None = None
    signs: tuple[int, int] = (1, 1)  # of x and y
    psi: str | None = None
    period: float = 2 * math.pi  # of the heading, in the column's numbers
    turn: int = 1  # sign of heading
    quarter: int = 0  # quarter turns added to it, clockwise
    u: str | None = None
    v: str | None = None
    speeds: tuple[int, int] = (1, 1)  # signs of u and v
    earth: bool = False
    r: str | None = None
    spin: int = 1  # sign of yaw rate

    def changed(self, **values) -> "Hypothesis":
        """This reading with some of it replaced."""
        return dataclasses.replace(self, **values)


@dataclasses.dataclass(frozen=True)
class FrameConvention:
    """Frames that people use; `odds` is the logarithm of how common against the first."""

    name: str
    odds: float
    swapped: bool = False  # x is east and y north
    signs: tuple[int, int] = (1, 1)
    turn: int = 1
    quarter: int = 0
    sway: int = 1
    spin: int = 1


NED = FrameConvention("north-east-down", 0.0)
CONVENTIONS = (
    NED,
    FrameConvention("east-north-up", -2.2, True, (1, 1), -1, 1, -1, -1),
    FrameConvention("positions east and north, compass heading", -2.5, True),
    FrameConvention("north-west-up", -3.5, False, (1, -1), -1, 0, -1, -1),
    FrameConvention("east and north, heading counter-clockwise, sway and rate not", -5.0, True,
               (1, 1), -1, 1),
)  # fmt: skip
# What one departure from a convention costs, in log odds.
_COSTS = {"x": 5.0, "y": 4.0, "turn": 4.0, "quarter": 4.5, "u": 5.0, "v": 3.0, "spin": 3.5}
_COMPASS = 4.0  # cost of reading a compass as anything but clockwise from north
# Cost of reading latitude as anything but north, or with another column than longitude.
_GEOGRAPHIC = 20.0
_COMPASS_WORDS = {"heading", "hdg", "compass", "kurs", "steuerkurs", "cap", "rumbo", "head"}


@dataclasses.dataclass(frozen=True)
class HypothesisPrior:
    """Log odds of readings before any number is looked at.

    `wrapped` has the columns that look like a compass by their range.
    """

    suggestions: dict[str, Suggestion]
    wrapped: frozenset[str] = frozenset()

    _known: dict = dataclasses.field(default_factory=dict, repr=False)

    def label(self, column: str | None, *labels: str) -> float:
        """Log odds of a column being one of some labels against being something else."""
        if column is None:
            return 0.0
        key = (column, labels)
        if key not in self._known:
            weights = self.suggestions[column].weights
            likely = max(weights[label] for label in labels)
            self._known[key] = math.log(likely / weights["other"])
        return self._known[key]

    def of(self, reading: Hypothesis) -> float:
        """Log odds of the reading, under the convention that suits it best."""
        return max(self._all(reading)) - self._contradictions(reading)

    def convention(self, reading: Hypothesis) -> FrameConvention:
        """The convention under which the reading is least unusual."""
        odds = self._all(reading)
        return CONVENTIONS[odds.index(max(odds))]

    def _all(self, reading: Hypothesis) -> list[float]:
        """Log odds of names and signs under every convention."""
        columns = (reading.x, reading.y, reading.psi, reading.u, reading.v, reading.r)
        named = (*columns, reading.earth)
        if named not in self._known:
            self._known[named] = [self._names(reading, each) for each in CONVENTIONS]
        signs = (
            reading.signs, reading.turn, reading.quarter, reading.speeds, reading.spin,
            reading.earth, *(column is None for column in columns),
        )  # fmt: skip
        if signs not in self._known:
            self._known[signs] = [self._signs(reading, each) for each in CONVENTIONS]
        return [a - b for a, b in zip(self._known[named], self._known[signs], strict=True)]

    def _names(self, reading: Hypothesis, convention: FrameConvention) -> float:
        first, second = ("y", "x") if convention.swapped else ("x", "y")
        total = convention.odds - self._frame_words(reading, convention)
        total += self.label(reading.x, first, "north", "lat")
        total += self.label(reading.y, second, "east", "lon")
        total += self.label(reading.psi, "psi") + self.label(reading.r, "r")
        return total + self._speeds(reading, first, second)

    def _signs(self, reading: Hypothesis, convention: FrameConvention) -> float:
        """What the departures from a convention cost."""
        departs = {
            "x": reading.x is not None and reading.signs[0] != convention.signs[0],
            "y": reading.y is not None and reading.signs[1] != convention.signs[1],
            "turn": reading.psi is not None and reading.turn != convention.turn,
            "quarter": reading.psi is not None and reading.quarter != convention.quarter,
            "u": reading.u is not None and reading.speeds[0] != 1,
            "v": reading.v is not None and reading.speeds[1] != self._sway(reading, convention),
            "spin": reading.r is not None and reading.spin != convention.spin,
        }
        return sum(_COSTS[name] for name, departing in departs.items() if departing)

    def _sway(self, reading: Hypothesis, convention: FrameConvention) -> int:
        if reading.earth:
            return convention.signs[1]
        return convention.sway

    def _speeds(self, reading: Hypothesis, first: str, second: str) -> float:
        if not reading.earth:
            return self.label(reading.u, "u", "vx") + self.label(reading.v, "v", "vy")
        absolute = self.label(reading.u, "vn", f"v{first}")
        absolute += self.label(reading.v, "ve", f"v{second}")
        loose = self.label(reading.u, *("u" if first == "x" else "v"))
        loose += self.label(reading.v, *("v" if first == "x" else "u"))
        return max(absolute, loose - 2.0)

    def _contradictions(self, reading: Hypothesis) -> float:
        """Costs of readings against what is fixed by definition."""
        cost = 0.0
        for column, sign, label in (
            (reading.x, reading.signs[0], "lat"),
            (reading.y, reading.signs[1], "lon"),
        ):
            if column is not None:
                weights = self.suggestions[column].weights
                # Positions in metres are easier to check than degrees, hence preferred.
                cost += (_GEOGRAPHIC if sign < 0 else 1.0) if weights[label] > 0.5 else 0.0
                absolute = "north" if label == "lat" else "east"
                cost += 4.0 if sign < 0 and weights[absolute] > 0.5 else 0.0
        fixes = [
            column is not None and self.suggestions[column].weights[label] > 0.5
            for column, label in ((reading.x, "lat"), (reading.y, "lon"))
        ]
        cost += _GEOGRAPHIC if fixes[0] != fixes[1] else 0.0
        if reading.psi is not None and (reading.turn, reading.quarter) != (1, 0):
            named = _COMPASS_WORDS & set(self.suggestions[reading.psi].words)
            cost += _COMPASS * bool(named) + 1.5 * (reading.psi in self.wrapped)
        return cost

    def _frame_words(self, reading: Hypothesis, convention: FrameConvention) -> float:
        columns = [c for c in (reading.x, reading.y, reading.psi, reading.u, reading.v) if c]
        frames = {self.suggestions[column].frame for column in columns} - {""}
        if "ned" in frames and convention is not NED:
            return 4.0
        if "enu" in frames and not convention.swapped:
            return 3.0
        return 0.0


def all_orientations() -> tuple[list[tuple[bool, int, int]], list[tuple[int, int]]]:
    """All (swapped, sign, sign) of a pair of columns, and all (turn, quarter) of a heading."""
    pairs = list(itertools.product((False, True), (1, -1), (1, -1)))
    return pairs, list(itertools.product((1, -1), range(4)))


def mirror_image(reading: Hypothesis) -> Hypothesis:
    """The reading of the same numbers with starboard and port exchanged (y, psi, v, r)."""
    return reading.changed(
        signs=(reading.signs[0], -reading.signs[1]),
        turn=-reading.turn,
        quarter=-reading.quarter % 4,
        speeds=(reading.speeds[0], -reading.speeds[1]),
        spin=-reading.spin,
    )


_CAP = 14.0  # the most that a ratio which is that of no units costs
_RATIO = 0.04  # standard deviation of scale errors
_STATED = 0.97  # probability that a stated unit is right
UNIT_PROBABILITIES = {
    "x": {"m": 0.93, "km": 0.01, "ft": 0.02, "nmi": 0.01, "cm": 0.01, "mm": 0.02},
    "u": {"m/s": 0.8, "kn": 0.15, "km/h": 0.03, "ft/s": 0.02},
    "r": {"rad/s": 0.55, "deg/s": 0.4, "deg/min": 0.05},
}  # fmt: skip
UNIT_PROBABILITIES |= {"y": UNIT_PROBABILITIES["x"], "v": UNIT_PROBABILITIES["u"]}


def unit_probabilities(prior: HypothesisPrior, channel: str, column: str) -> dict[str, float]:
    """Probability of every unit of a column, from what its header says."""
    odds = dict(UNIT_PROBABILITIES[channel])
    stated = prior.suggestions[column].unit
    if stated in odds:
        odds = {unit: (1 - _STATED) * value for unit, value in odds.items()}
        odds[stated] += _STATED
    total = sum(odds.values())
    return {unit: value / total for unit, value in odds.items()}


def ratio_penalty(ratio: float, expected: float, error: float) -> float:
    """Cost (log odds) of a ratio that differs from that of two units; never above a cap.

    `error` is the relative standard error of the ratio. The tails are heavy (Student's t with
    four degrees of freedom): sensors have wrong scales, too.
    """
    if not ratio > 0 or not math.isfinite(error):
        return 0.0
    spread = math.hypot(_RATIO, min(error, 2.0))
    return min(2.5 * math.log1p(0.25 * (math.log(ratio / expected) / spread) ** 2), _CAP)


def period_log_odds(values: np.ndarray, stated: str) -> dict[float, float]:
    """Log odds of a column being an angle in degrees (period 360) or radians (2 pi)."""
    finite = values[np.isfinite(values)]
    largest = float(np.max(np.abs(finite)))
    jumps = np.abs(np.diff(finite))
    if np.any((jumps > 300) & (jumps <= 360)) and largest <= 360.5:
        return {360.0: 0.0, 2 * math.pi: -12.0}
    if largest <= 2 * math.pi + 0.05 and np.any((jumps > 5.5) & (jumps <= 2 * math.pi + 0.05)):
        return {2 * math.pi: 0.0, 360.0: -12.0}
    odds = {2 * math.pi: -0.2, 360.0: -1.7}
    if largest > 4 * math.pi:
        odds = {2 * math.pi: -4.0, 360.0: -0.02}
    for unit, period in (("deg", 360.0), ("rad", 2 * math.pi)):
        if stated == unit:
            odds[period] += 4.0
    return odds
