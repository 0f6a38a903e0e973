"""Hypotheses of which columns are which motion channels, and what each is worth beforehand.

A hypothesis says that north, east, heading, u, v and yaw rate are such columns with such signs,
that heading has a quarter turn added, and whether velocities are along body or earth axes.
Its prior comes from names and conventions: north-east-down as it is, east-north-up, or
north-west-up, and what each departure from one of these costs. A whole record of mirrored
axes is as consistent as one that is not, so between those the prior alone decides, until
actuators or geographic positions speak. The log odds here are judgements, settled on disguised
runs of a simulated vessel and on published data sets.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diffsea.recordings.mapping_proposal.names import NAMED, Suggestion
from diffsea.trajectory import MOTION_CHANNELS, Samples


@dataclasses.dataclass(frozen=True)
class ColumnHypothesis:
    """One way to read the motion of a file.

    A channel is its column's number times its sign, and body axes are forward and starboard,
    earth axes north and east.

    Attributes:
        x: column of north, None where there is none, as of the other five channels.
        signs: of x and y.
        period: of the heading in the column's numbers, 360 or 2 pi.
        turn: sign of heading.
        quarter: quarter turns added to heading, clockwise, 0 to 3.
        speeds: signs of u and v.
        earth: whether u and v are columns of velocities north and east.
        spin: sign of yaw rate.
    """

    x: str | None = None
    y: str | None = None
    signs: tuple[int, int] = (1, 1)
    psi: str | None = None
    period: float = 2 * math.pi
    turn: int = 1
    quarter: int = 0
    u: str | None = None
    v: str | None = None
    speeds: tuple[int, int] = (1, 1)
    earth: bool = False
    r: str | None = None
    spin: int = 1

    @property
    def columns(self) -> dict[str, str | None]:
        """The columns by motion channel."""
        return {channel: getattr(self, channel) for channel in MOTION_CHANNELS}

    @property
    def explains_displacement(self) -> bool:
        """Whether it has positions, and velocities whose directions are known."""
        oriented = self.psi is not None or self.earth
        return self.x is not None and self.u is not None and oriented

    @property
    def starboard_sign(self) -> int:
        """The sign that decides which way a turn to starboard goes."""
        return self.spin if self.r is not None else self.turn

    @property
    def mirror_image(self) -> "ColumnHypothesis":
        """The reading of the same numbers with starboard and port exchanged (y, psi, v, r)."""
        return dataclasses.replace(
            self,
            signs=(self.signs[0], -self.signs[1]),
            turn=-self.turn,
            quarter=-self.quarter % 4,
            speeds=(self.speeds[0], -self.speeds[1]),
            spin=-self.spin,
        )


@dataclasses.dataclass(frozen=True)
class FrameConvention:
    """A frame that people use, by what `ColumnHypothesis` reads it through.

    Attributes:
        name: as a sentence says it.
        log_odds: how common it is against the first.
        swapped: whether x is east and y north.
        sway: sign of v along body axes.
    """

    name: str
    log_odds: float
    swapped: bool = False
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
    FrameConvention(
        "east and north, heading counter-clockwise, sway and rate not", -5.0, True, (1, 1), -1, 1
    ),
)
# Log odds against one departure from a convention; a forward speed is hardly ever negated.
_DEPARTURE = {"x": 5.0, "y": 4.0, "turn": 4.0, "quarter": 4.5, "u": 5.0, "v": 3.0, "spin": 3.5}
_OTHER_FRAME = {"ned": 4.0, "enu": 3.0}  # against another frame than the one that names state
_LOOSE_EARTH = 2.0  # against u and v as names of velocities along earth axes
_COMPASS = 4.0  # against a compass that is not clockwise from north
_COMPASS_WORDS = {"heading", "hdg", "compass", "kurs", "steuerkurs", "cap", "rumbo", "head"}
_WRAPPED_COMPASS = 1.5  # the same for a column that wraps from 360 to 0
# Against latitude as anything but north, or with another column than longitude: by definition.
_GEOGRAPHIC = 20.0
_DEGREES = 1.0  # against positions in degrees beside others in metres, which are easier to check
_NEGATED_NORTH = 4.0  # against the negative of what is called north or east
# Against a column that is called another quantity while one that is called this is unused: more
# than any relation between columns counts.
_OTHER_QUANTITY = 1e3
# The labels of columns that are of the quantity of a channel, in whatever axes.
QUANTITIES = {
    **dict.fromkeys(("x", "y"), ("x", "y", "north", "east", "lat", "lon")),
    "psi": ("psi",),
    **dict.fromkeys(("u", "v"), ("u", "v", "vx", "vy", "vn", "ve")),
    "r": ("r",),
}
_MOST_AGAINST_RATIO = 14.0  # log odds: a ratio of no two units may still have another reason
_SCALE_ERROR = 0.04  # standard deviation of the scale errors of sensors
STATED_UNIT = 0.97  # probability that a stated unit is right
# How often units are used where none is stated.
_UNIT_PROBABILITIES = {
    "x": {"m": 0.93, "km": 0.01, "ft": 0.02, "nmi": 0.01, "cm": 0.01, "mm": 0.02},
    "u": {"m/s": 0.8, "kn": 0.15, "km/h": 0.03, "ft/s": 0.02},
    "r": {"rad/s": 0.55, "deg/s": 0.4, "deg/min": 0.05},
}


class _ColumnOdds(NamedTuple):
    """What columns say of a hypothesis, whatever their signs.

    `names` are log odds under every convention; `present` are the channels, x to r, that have a
    column. `geographic` and `absolute` are whether x and y are called latitude and longitude, and
    north and east. `passed_over` are log odds against, and `compass` those if heading is mirrored
    or turned.
    """

    names: list[float]
    present: tuple[bool, ...]
    passed_over: float
    geographic: tuple[bool, bool]
    absolute: tuple[bool, bool]
    compass: float

    def against(self, h: ColumnHypothesis) -> float:
        """Log odds against the hypothesis by what it denies that is fixed by definition."""
        cost = self.passed_over
        for sign, is_fix, is_absolute in zip(h.signs, self.geographic, self.absolute, strict=True):
            if is_fix:
                cost += _GEOGRAPHIC if sign < 0 else _DEGREES
            if is_absolute and sign < 0:
                cost += _NEGATED_NORTH
        cost += _GEOGRAPHIC if self.geographic[0] != self.geographic[1] else 0.0
        return cost + (self.compass if (h.turn, h.quarter) != (1, 0) else 0.0)


@dataclasses.dataclass(frozen=True)
class HypothesisPrior:
    """Log odds of hypotheses before any number is looked at.

    Attributes:
        suggestions: what the names of columns suggest.
        wrapped: the columns that look like a compass by their range.
        varying: the columns that may be read as motion, as they change in some file.
    """

    suggestions: dict[str, Suggestion]
    wrapped: frozenset[str] = frozenset()
    varying: frozenset[str] = frozenset()
    _columns: dict[tuple, _ColumnOdds] = dataclasses.field(default_factory=dict, repr=False)
    _departures: dict[tuple, list[float]] = dataclasses.field(default_factory=dict, repr=False)

    def label(self, column: str | None, *labels: str) -> float:
        """Log odds of a column being one of some labels against being something else.

        Zero for no column.
        """
        if column is None:
            return 0.0
        weights = self.suggestions[column].weights
        return math.log(max(weights[label] for label in labels) / weights["other"])

    def named_for(self, channel: str) -> frozenset[str]:
        """The varying columns whose names say the quantity of a motion channel, orders left out."""
        return self._quantities[channel][0]

    def passes_over(self, columns: Sequence[str | None], others: frozenset[str]) -> float:
        """Log odds against columns, of x, y, psi, u, v and r, that are called something else.

        They count where a column that is called what the channel is is neither among them nor the
        `others`.
        """
        cost = 0.0
        for channel, column in zip(MOTION_CHANNELS, columns, strict=False):
            named, strangers = self._quantities[channel]
            if column in strangers:
                cost += _OTHER_QUANTITY * (not named <= others.union(columns))
        return cost

    @functools.cached_property
    def _quantities(self) -> dict[str, tuple[frozenset[str], frozenset[str]]]:
        """The columns called what a channel is, and those called something else, by channel."""
        found = {}
        for channel, labels in QUANTITIES.items():
            weights = {name: self.suggestions[name].weights for name in self.varying}
            says = {n for n, each in weights.items() if max(each[x] for x in labels) > NAMED}
            named = frozenset(name for name in says if not self.suggestions[name].ordered)
            strangers = {n for n, each in weights.items() if max(each.values()) > NAMED} - says
            found[channel] = named, frozenset(strangers if named else ())
        return found

    def unit_probabilities(self, channel: str, column: str | None) -> dict[str, float]:
        """Probability of every unit of a column read as x, u or r, from what its header says.

        No column has the unit `""`.
        """
        if column is None:
            return {"": 1.0}
        odds = dict(_UNIT_PROBABILITIES[channel])
        stated = self.suggestions[column].unit
        if stated in odds:
            odds = {unit: (1 - STATED_UNIT) * value for unit, value in odds.items()}
            odds[stated] += STATED_UNIT
        total = sum(odds.values())
        return {unit: value / total for unit, value in odds.items()}

    def log_odds(self, hypothesis: ColumnHypothesis) -> float:
        """Log odds of the hypothesis, under the convention that suits it best."""
        columns = self._of_columns(hypothesis)
        return max(self._by_convention(hypothesis, columns)) - columns.against(hypothesis)

    def convention(self, hypothesis: ColumnHypothesis) -> FrameConvention:
        """The convention under which the hypothesis is least unusual."""
        odds = self._by_convention(hypothesis, self._of_columns(hypothesis))
        return CONVENTIONS[odds.index(max(odds))]

    def _by_convention(self, h: ColumnHypothesis, columns: _ColumnOdds) -> list[float]:
        """Log odds of names and signs under every convention."""
        signs = (h.signs, h.turn, h.quarter, h.speeds, h.spin, h.earth, columns.present)
        departures = self._departures.get(signs)
        if departures is None:
            departures = self._departures[signs] = [_departures(h, each) for each in CONVENTIONS]
        return [a - b for a, b in zip(columns.names, departures, strict=True)]

    def _of_columns(self, h: ColumnHypothesis) -> _ColumnOdds:
        """What the columns of the hypothesis say, whatever their signs."""
        columns = (h.x, h.y, h.psi, h.u, h.v, h.r, h.earth)
        known = self._columns.get(columns)
        if known is None:
            known = self._columns[columns] = self._judge_columns(h)
        return known

    def _judge_columns(self, h: ColumnHypothesis) -> _ColumnOdds:
        columns = (h.x, h.y, h.psi, h.u, h.v, h.r)
        north, east = (
            self.suggestions[column].weights if column is not None else {} for column in (h.x, h.y)
        )
        compass = 0.0
        if h.psi is not None:
            named = _COMPASS_WORDS & set(self.suggestions[h.psi].words)
            compass = _COMPASS * bool(named) + _WRAPPED_COMPASS * (h.psi in self.wrapped)
        return _ColumnOdds(
            [self._names(h, each) for each in CONVENTIONS],
            tuple(column is not None for column in columns),
            self.passes_over(columns, frozenset()),
            (north.get("lat", 0.0) > NAMED, east.get("lon", 0.0) > NAMED),
            (north.get("north", 0.0) > NAMED, east.get("east", 0.0) > NAMED),
            compass,
        )

    def _names(self, h: ColumnHypothesis, convention: FrameConvention) -> float:
        """Log odds of the columns' names, and of the frames that they state, in a convention."""
        total = convention.log_odds
        frames = {self.suggestions[c].frame for c in (h.x, h.y, h.psi, h.u, h.v) if c}
        if "ned" in frames and convention is not NED:
            total -= _OTHER_FRAME["ned"]
        elif "enu" in frames and not convention.swapped:
            total -= _OTHER_FRAME["enu"]
        first, second = ("y", "x") if convention.swapped else ("x", "y")
        total += self.label(h.x, first, "north", "lat")
        total += self.label(h.y, second, "east", "lon")
        total += self.label(h.psi, "psi") + self.label(h.r, "r")
        if not h.earth:
            return total + (self.label(h.u, "u", "vx") + self.label(h.v, "v", "vy"))
        absolute = self.label(h.u, "vn", f"v{first}")
        absolute += self.label(h.v, "ve", f"v{second}")
        loose = self.label(h.u, "v" if convention.swapped else "u")
        loose += self.label(h.v, "u" if convention.swapped else "v")
        return total + max(absolute, loose - _LOOSE_EARTH)


def _departures(h: ColumnHypothesis, convention: FrameConvention) -> float:
    """Log odds against the signs of a hypothesis under a convention."""
    sway = convention.signs[1] if h.earth else convention.sway
    departs = {
        "x": h.x is not None and h.signs[0] != convention.signs[0],
        "y": h.y is not None and h.signs[1] != convention.signs[1],
        "turn": h.psi is not None and h.turn != convention.turn,
        "quarter": h.psi is not None and h.quarter != convention.quarter,
        "u": h.u is not None and h.speeds[0] != 1,
        "v": h.v is not None and h.speeds[1] != sway,
        "spin": h.r is not None and h.spin != convention.spin,
    }
    return sum(_DEPARTURE[name] for name, departing in departs.items() if departing)


def ratio_penalty(ratio: float, expected: float, error: float) -> float:
    """Log odds against a ratio that differs from that of two units.

    `error` is the relative standard error of the ratio. The tails are heavy (Student's t with
    four degrees of freedom): sensors have wrong scales, too. Zero for a ratio that is not
    positive or has no finite error.
    """
    if not ratio > 0 or not math.isfinite(error):
        return 0.0
    spread = math.hypot(_SCALE_ERROR, min(error, 2.0))
    penalty = 2.5 * math.log1p(0.25 * (math.log(ratio / expected) / spread) ** 2)
    return min(penalty, _MOST_AGAINST_RATIO)


def period_log_odds(values: Samples, stated: str) -> dict[float, float]:
    """Log odds of a column being an angle in degrees (period 360) or radians (2 pi).

    Jumps of one period settle it; else the range and the `stated` unit speak.
    """
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
    if stated in ("deg", "rad"):
        odds[360.0 if stated == "deg" else 2 * math.pi] += 4.0
    return odds
