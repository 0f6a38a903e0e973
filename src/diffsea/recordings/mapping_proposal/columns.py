"""The columns of a file on their clock, and how their increments over windows are related.

Differencing multiplies noise; increments over windows against integrals over them do not.
A relation that explains all but a share q of the variance of n effective increments has a
log likelihood ratio of n/2 log(1/q) over none (per real component), less the cost of its
free coefficients (the Bayesian information criterion).
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Inexact

from diffsea.recordings.geodesy import local_position
from diffsea.recordings.mapping_proposal.names import NAMED, Suggestion
from diffsea.recordings.mappings import UNITS
from diffsea.series import bridge_gaps, integrate, strictly_later
from diffsea.trajectory import Samples


_TIME_UNITS = ("s", "ms", "us", "ns", "min", "h")
# Sampling intervals of motion are about 0.15 s; so many decades from it are one standard
# deviation.
_USUAL_INTERVAL, _DECADES = 0.15, 0.75
_EVEN_STEPS = 1e-3  # spread of the steps, relative to their mean, of a clock without jitter
_WIDEST_RUN = 2.0  # deg that a run may span: what moves farther is no position of one run
_WINDOWS_PER_FILE = 60  # as many as a relation of a few coefficients needs
_WINDOWS_OF_ALL = 240  # of all files together: bounds the time that a proposal takes
_FEWEST_WINDOWS = 4  # of a file, however short beside the others
_FINEST = 1e-6  # what rounding leaves at least of a relation's variance

Windowed = Float[np.ndarray, "window"]
# North and i times east; of real numbers where all is to the north.
ComplexWindowed = Inexact[np.ndarray, "window"]


@dataclasses.dataclass(frozen=True)
class TimeColumn:
    """The time column, or what is known of time without one.

    Attributes:
        column: its name, None where there is none.
        sure: probability that it is time, or that `step` is right.
        units: the probability of every unit it may be in.
        why: what tells it, in words.
        step: sampling interval (s) where there is no column and kinematics tell it, else NaN.
    """

    column: str | None
    sure: float
    units: dict[str, float]
    why: str
    step: float = math.nan


@dataclasses.dataclass(frozen=True)
class ColumnRecord:
    """The varying columns of one file at strictly increasing times (of the file's unit)."""

    t: Samples
    columns: dict[str, Samples]


NO_CLOCK = TimeColumn(None, 0.0, {"s": 1.0}, "no column advances as time does")


def find_time_column(
    columns: dict[str, Samples], suggestions: dict[str, Suggestion]
) -> TimeColumn | None:
    """The most likely time column, None where no column advances as time does.

    A column advances that never falls, rises in half of its rows at least, and has a tenth of
    its numbers missing at most.
    """
    scores, unevenness = {}, {}
    for place, (name, values) in enumerate(columns.items()):
        finite = values[np.isfinite(values)]
        steps = np.diff(finite)
        if finite.size < max(10, 0.9 * values.size):
            continue
        if np.any(steps < 0) or np.mean(steps > 0) < 0.5:
            continue
        usual = np.median(steps[steps > 0])
        spread = float(np.percentile(np.abs(steps - usual), 90) / usual)
        weights = suggestions[name].weights
        # Log odds, set by judgement: even steps and a first place speak for a clock, a count of
        # rows is none.
        score = math.log(weights["t"] / max(weights["other"], 1e-3))
        score += 4.0 if spread < _EVEN_STEPS else 1.5 if spread < 0.3 else 0.0
        score += 1.0 if place < 2 else 0.0
        score -= 4.0 * bool(values[0] in (0.0, 1.0) and np.all(np.diff(values) == 1.0))
        scores[name], unevenness[name] = score, spread
    best = max(scores, key=lambda name: scores[name], default=None)
    if best is None or scores[best] < 0:
        return None
    sure = math.exp(scores[best]) / (1.0 + sum(math.exp(score) for score in scores.values()))
    steps = np.diff(columns[best][np.isfinite(columns[best])])
    step = float(np.median(steps[steps > 0]))
    units = _time_units(suggestions[best].unit, step, float(np.nanmax(columns[best])))
    even = unevenness[best] < _EVEN_STEPS
    why = "it advances in equal steps" if even else "it always advances"
    return TimeColumn(best, sure, units, why)


def _time_units(stated: str, step: float, largest: float) -> dict[str, float]:
    """Probability of every unit of time, from what is stated, the step, and the epoch."""
    odds = {}
    for unit in _TIME_UNITS:
        factor = UNITS[unit][1]
        decades = math.log10(step * factor / _USUAL_INTERVAL) / _DECADES
        score = -0.5 * decades**2 - (3.0 if unit in ("min", "h") else 0.0)
        # Seconds since 1970 of any file of this century.
        score += 6.0 * (9e8 < largest * factor < 5e9)
        score += 6.0 * (unit == stated)
        odds[unit] = score
    top = max(odds.values())
    total = sum(math.exp(score - top) for score in odds.values())
    return {unit: math.exp(score - top) / total for unit, score in odds.items()}


def find_geographic(
    table: dict[str, Samples], suggestions: dict[str, Suggestion]
) -> tuple[str, str] | None:
    """Columns of latitude and longitude in degrees, if the file has them and they move."""
    found = []
    for label, limit in (("lat", 90.0), ("lon", 180.0)):
        named = [name for name in table if suggestions[name].weights[label] > NAMED]
        named = [n for n in named if 0 < np.nanmax(np.abs(table[n])) <= limit]
        named = [n for n in named if 0 < np.nanmax(table[n]) - np.nanmin(table[n]) < _WIDEST_RUN]
        if len(named) != 1:
            return None
        found += named
    return found[0], found[1]


def varies(values: Samples) -> bool:
    """Whether a column changes by more than rounding, and has enough numbers to tell."""
    finite = values[np.isfinite(values)]
    if finite.size <= 10 or finite.size <= 0.02 * values.size:
        return False
    return bool(np.ptp(finite) > 1e-9 * np.max(np.abs(finite)))


def columns_over_time(
    columns: dict[str, Samples],
    clock: TimeColumn,
    wanted: frozenset[str],
    place: tuple[str, str] | None = None,
    origin: tuple[float, float] | None = None,
) -> ColumnRecord:
    """The wanted columns on their clock, gaps interpolated; what has no number is left out.

    Columns of latitude and longitude (deg), named by `place`, become metres north and east of
    the `origin` (deg). Without a time column, rows are counted.
    """
    first = next(iter(columns.values()), np.empty(0))  # none in a table without a number
    t = np.arange(first.size, dtype=float) if clock.column is None else columns[clock.column]
    ahead = np.isfinite(t)
    ahead &= strictly_later(np.where(ahead, t, -np.inf))
    t = t[ahead]
    kept = {}
    for name, values in columns.items():
        series = values[ahead]
        if name in wanted and name != clock.column and np.sum(np.isfinite(series)) > 1:
            kept[name] = bridge_gaps(t, series, np.inf)[0]
    if place is not None and origin is not None and set(place) <= set(kept):
        latitude, longitude = (np.radians(kept[name]) for name in place)
        zero = float(np.radians(origin[0])), float(np.radians(origin[1]))
        north, east = local_position(latitude, longitude, zero)
        kept |= {place[0]: north, place[1]: east}
    return ColumnRecord(t, kept)


@dataclasses.dataclass(frozen=True)
class ColumnWindows:
    """Windows of all files, and what columns change or add up to over them.

    Numbers are those of the files. A heading is a column with the `period` of its numbers, and
    stands for exp(i heading).

    Attributes:
        edges: of each record, the rows between which its windows lie.
        duration: of each window, in the file's unit of time.
    """

    records: tuple[ColumnRecord, ...]
    edges: tuple[np.ndarray, ...]
    duration: Windowed
    _known: dict[tuple, np.ndarray] = dataclasses.field(default_factory=dict, repr=False)

    def of(self, what: str, *arguments: str | float | None) -> np.ndarray:
        """What the method of that name gives for its arguments, computed once."""
        key = (what, *arguments)
        if key not in self._known:
            self._known[key] = getattr(self, what)(*arguments)
        return self._known[key]

    def increments(self, name: str, period: float = 0.0) -> Windowed:
        """Changes of a column, unwrapped as an angle where it has a period."""

        def continuous(record: ColumnRecord) -> Samples:
            values = record.columns[name]
            return np.unwrap(values, period=period) if period else values

        return self._changes(continuous)

    def integrals(self, name: str) -> Windowed:
        """Integrals of a column."""
        return self._integrals(lambda record: record.columns[name])

    def turned(self, name: str, heading: str, period: float) -> ComplexWindowed:
        """Integrals of a column times exp(i heading)."""
        return self._integrals(lambda r: r.columns[name] * _direction(r, heading, period))

    def ends(self, name: str, heading: str, period: float) -> ComplexWindowed:
        """Changes of a column, smoothed, times exp(i heading)."""
        return self._changes(lambda r: _smooth(r.columns[name]) * _direction(r, heading, period))

    def directions(self, heading: str, period: float) -> ComplexWindowed:
        """Changes of exp(i heading)."""
        return self._changes(lambda record: _direction(record, heading, period))

    def courses(self, heading: str, period: float) -> ComplexWindowed:
        """Integrals of exp(i heading)."""
        return self._integrals(lambda record: _direction(record, heading, period))

    def swerves(self, name: str, heading: str, period: float) -> ComplexWindowed:
        """Integrals of a column times the rate of change of exp(i heading)."""
        return self._integrals(
            lambda r: r.columns[name] * np.gradient(_smooth(_direction(r, heading, period)), r.t)
        )

    def _changes(self, series: Callable[[ColumnRecord], np.ndarray]) -> np.ndarray:
        pairs = zip(self.records, self.edges, strict=True)
        return np.concatenate([np.diff(series(record)[edge]) for record, edge in pairs])

    def _integrals(self, series: Callable[[ColumnRecord], np.ndarray]) -> np.ndarray:
        return self._changes(lambda record: integrate(record.t, series(record)))


def _direction(record: ColumnRecord, heading: str, period: float) -> np.ndarray:
    return np.exp(2j * np.pi / period * record.columns[heading])


def _smooth(series: np.ndarray) -> np.ndarray:
    """A moving average over five samples."""
    padded = np.concatenate([np.repeat(series[:1], 2), series, np.repeat(series[-1:], 2)])
    return np.convolve(padded, np.full(5, 0.2), mode="valid")


def windows_of(records: tuple[ColumnRecord, ...]) -> ColumnWindows:
    """About sixty windows of a file, of two samples at least, fewer where files are many.

    Files share the windows by their lengths.
    """
    durations = np.array([record.t[-1] - record.t[0] for record in records])
    shares = _WINDOWS_OF_ALL * durations / np.sum(durations)
    edges = []
    for record, share in zip(records, shares, strict=True):
        count = max(_FEWEST_WINDOWS, min(_WINDOWS_PER_FILE, int(share)))
        marks = np.linspace(record.t[0], record.t[-1], count + 1)
        edge = np.unique(np.searchsorted(record.t, marks).clip(0, record.t.size - 1))
        edges.append(edge if record.t.size > 2 * count else np.arange(0, record.t.size, 2))
    duration = np.concatenate([np.diff(r.t[e]) for r, e in zip(records, edges, strict=True)])
    return ColumnWindows(records, tuple(edges), duration)


def effective_size(rest: np.ndarray) -> float:
    """Effective number of independent residuals: n (1 - rho) / (1 + rho), rho at lag one.

    The size of the mean of a first-order autoregressive series; rho is kept between 0 and 0.95.
    """
    power = float(np.sum(np.abs(rest) ** 2))
    if power <= 0 or rest.size < 4:
        return float(rest.size)
    rho = float(np.real(np.sum(rest[1:] * np.conj(rest[:-1]))) / power)
    rho = min(max(rho, 0.0), 0.95)
    return rest.size * (1 - rho) / (1 + rho)


@dataclasses.dataclass(frozen=True)
class IntegralRelation:
    """A regression of increments on an integral."""

    gain: float  # per raw unit
    evidence: float  # log likelihood ratio over no relation, zero at least
    error: float  # relative standard error of the gain


def relate_to_integral(
    increments: Windowed, integrals: Windowed, duration: Windowed
) -> IntegralRelation:
    """How well increments follow an integral, a constant drift allowed for.

    No relation is found in fewer than six windows, or in series that only drift.
    """
    count = increments.size

    def without_drift(series: Windowed) -> Windowed:
        return series - duration * (np.sum(series * duration) / np.sum(duration**2))

    left, right = without_drift(increments), without_drift(integrals)
    power, total = float(np.sum(right**2)), float(np.sum(left**2))
    if power <= 0 or total <= 0 or count < 6:
        return IntegralRelation(0.0, 0.0, math.inf)
    gain = float(np.sum(left * right) / power)
    rest = left - gain * right
    share = max(float(np.sum(rest**2)) / total, _FINEST)
    number = max(effective_size(rest), 4.0)
    evidence = 0.5 * number * math.log(1 / share) - math.log(count)
    error = math.sqrt(share / max(1 - share, 1e-9) / number)
    return IntegralRelation(gain, max(evidence, 0.0), error)
