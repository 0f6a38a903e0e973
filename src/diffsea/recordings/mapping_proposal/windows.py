"""Increments of columns over windows, and how well they follow one another.

Differencing multiplies noise; increments over windows against integrals over them do not.
A relation that explains all but a share q of the variance of n effective increments has a
log likelihood ratio of n/2 log(1/q) over none (per real component), less the cost of its
free coefficients (BIC).
"""

import dataclasses
import math

import numpy as np

from diffsea.recordings.mapping_proposal.clock import ColumnRecord
from diffsea.series import integrate


_WINDOWS = 60  # per file
_ALL = 240  # of all files together
_FINEST = 1e-6  # what rounding leaves at least of a relation's variance


@dataclasses.dataclass(frozen=True)
class ColumnWindows:
    """Windows of all files.

    `duration` (W,) of each, in the file's unit of time.
    """

    records: tuple[ColumnRecord, ...]
    edges: tuple[np.ndarray, ...]
    duration: np.ndarray
    _known: dict = dataclasses.field(default_factory=dict, repr=False)

    def of(self, what: str, *arguments) -> np.ndarray:
        """What a method gives for its arguments, computed once."""
        key = (what, *arguments)
        if key not in self._known:
            self._known[key] = getattr(self, what)(*arguments)
        return self._known[key]

    def increments(self, name: str, period: float = 0.0) -> np.ndarray:
        """Changes of a column over the windows (W,), as an angle where it has a period."""
        parts = []
        for record, edge in zip(self.records, self.edges, strict=True):
            parts.append(np.diff(_column(record, name, period)[edge]))
        return np.concatenate(parts)

    def integrals(self, name: str) -> np.ndarray:
        """Integrals of a column over the windows (W,)."""
        return self._integrals(lambda record: _column(record, name, 0.0))

    def turned(self, name: str, heading: str, period: float) -> np.ndarray:
        """Integrals (W,) of a column times exp(i heading)."""
        return self._integrals(
            lambda record: _column(record, name, 0.0) * _direction(record, heading, period)
        )

    def ends(self, name: str, heading: str, period: float) -> np.ndarray:
        """Changes (W,) of a column times exp(i heading)."""
        parts = []
        for record, edge in zip(self.records, self.edges, strict=True):
            flow = _smooth(_column(record, name, 0.0)) * _direction(record, heading, period)
            parts.append(np.diff(flow[edge]))
        return np.concatenate(parts)

    def directions(self, heading: str, period: float) -> np.ndarray:
        """Changes (W,) of exp(i heading)."""
        parts = []
        for record, edge in zip(self.records, self.edges, strict=True):
            parts.append(np.diff(_direction(record, heading, period)[edge]))
        return np.concatenate(parts)

    def courses(self, heading: str, period: float) -> np.ndarray:
        """Integrals (W,) of exp(i heading)."""
        return self._integrals(lambda record: _direction(record, heading, period))

    def swerves(self, name: str, heading: str, period: float) -> np.ndarray:
        """Integrals (W,) of a column times the rate of change of exp(i heading)."""
        return self._integrals(
            lambda record: (
                _column(record, name, 0.0)
                * np.gradient(_smooth(_direction(record, heading, period)), record.t)
            )
        )

    def _integrals(self, series) -> np.ndarray:
        parts = []
        for record, edge in zip(self.records, self.edges, strict=True):
            parts.append(np.diff(integrate(record.t, series(record))[edge]))
        return np.concatenate(parts)


def windows_of(records: tuple[ColumnRecord, ...]) -> ColumnWindows:
    """About sixty windows per file, of two samples at least, fewer where files are many."""
    count = max(8, min(_WINDOWS, _ALL // len(records)))
    edges = []
    for record in records:
        marks = np.linspace(record.t[0], record.t[-1], count + 1)
        edge = np.unique(np.searchsorted(record.t, marks).clip(0, record.t.size - 1))
        edges.append(edge if record.t.size > 2 * count else np.arange(0, record.t.size, 2))
    duration = np.concatenate([np.diff(r.t[e]) for r, e in zip(records, edges, strict=True)])
    return ColumnWindows(records, tuple(edges), duration)


def effective_size(rest: np.ndarray) -> float:
    """Effective number of independent residuals: n (1 - rho) / (1 + rho), rho at lag one."""
    power = float(np.sum(np.abs(rest) ** 2))
    if power <= 0 or rest.size < 4:
        return float(rest.size)
    rho = float(np.real(np.sum(rest[1:] * np.conj(rest[:-1]))) / power)
    rho = min(max(rho, 0.0), 0.95)
    return rest.size * (1 - rho) / (1 + rho)


@dataclasses.dataclass(frozen=True)
class IntegralRelation:
    """A regression of increments on an integral: `gain` per raw unit, log ratio, relative error."""

    gain: float
    evidence: float
    error: float


def relate_to_integral(
    increments: np.ndarray, integrals: np.ndarray, duration: np.ndarray
) -> IntegralRelation:
    """How well increments follow an integral, a constant drift allowed for."""
    count = increments.size

    def without_drift(series: np.ndarray) -> np.ndarray:
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


def _column(record: ColumnRecord, name: str, period: float) -> np.ndarray:
    values = record.columns[name]
    return np.unwrap(values, period=period) if period else values


def _direction(record: ColumnRecord, heading: str, period: float) -> np.ndarray:
    return np.exp(2j * np.pi / period * record.columns[heading])


def _smooth(series: np.ndarray) -> np.ndarray:
    """A moving average over five samples."""
    padded = np.concatenate([np.repeat(series[:1], 2), series, np.repeat(series[-1:], 2)])
    return np.convolve(padded, np.full(5, 0.2), mode="valid")
