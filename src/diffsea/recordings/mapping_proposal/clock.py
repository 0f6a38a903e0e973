"""Which column is the time, in which unit; and the columns of a file on that clock."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pandas as pd

from diffsea.recordings.mapping_proposal.names import Suggestion
from diffsea.recordings.mapping_proposal.table_layout import TableLayout
from diffsea.recordings.mappings import UNITS
from diffsea.recordings.tables import read_table
from diffsea.series import bridge_gaps


_TIMES = ("s", "ms", "us", "ns", "min", "h")
# Sampling intervals of motion are about 0.1 s; so many decades from it are one standard
# deviation.
_USUAL_INTERVAL, _DECADES = 0.15, 0.75
_EVEN = 1e-3  # spread of the steps, relative to their mean, of a clock without jitter


@dataclasses.dataclass(frozen=True)
class TimeColumn:
    """The time column, or none. `units` has the probability of every unit it may be in.

    Without a column `step` is the sampling interval (s) if something tells it, else NaN, and
    `why` says what.
    """

    column: str | None
    sure: float
    units: dict[str, float]
    why: str
    step: float = math.nan


@dataclasses.dataclass(frozen=True)
class ColumnRecord:
    """The varying columns of one file at strictly increasing times (of the file's unit)."""

    t: np.ndarray
    columns: dict[str, np.ndarray]


def find_time_column(
    columns: dict[str, np.ndarray], suggestions: dict[str, Suggestion]
) -> TimeColumn | None:
    """The most likely time column, None where no column advances as time does."""
    scores = {}
    for place, (name, values) in enumerate(columns.items()):
        evenness = _evenness(values)
        if evenness is None:
            continue
        weights = suggestions[name].weights
        score = math.log(weights["t"] / max(weights["other"], 1e-3))
        score += 4.0 if evenness < _EVEN else 1.5 if evenness < 0.3 else 0.0
        score += 1.0 if place < 2 else 0.0
        score -= 4.0 * _counts_rows(values)
        scores[name] = score
    if not scores:
        return None
    best = max(scores, key=lambda name: scores[name])
    total = 1.0 + sum(math.exp(score) for score in scores.values())
    if scores[best] < 0:
        return None
    sure = math.exp(scores[best]) / total
    steps = np.diff(columns[best][np.isfinite(columns[best])])
    step = float(np.median(steps[steps > 0]))
    units = _unit_odds(suggestions[best].unit, step, float(np.nanmax(columns[best])))
    evenness = _evenness(columns[best])
    even = evenness is not None and evenness < _EVEN
    why = "it advances in equal steps" if even else "it always advances"
    return TimeColumn(best, sure, units, why)


def time_from_text_stamps(path: Path, layout: TableLayout) -> TimeColumn:
    """The clock of a file without a numeric time: from stamps of date and time, or unknown."""
    table, _ = read_table(path, layout.mapping if layout.text else None)
    for name in layout.names:
        if not name or name not in table.columns or pd.api.types.is_numeric_dtype(table[name]):
            continue
        stamps = pd.to_datetime(table[name], errors="coerce", format="mixed", utc=True)
        steps = np.diff(stamps.dropna().to_numpy(dtype="datetime64[ns]").astype(float)) * 1e-9
        if steps.size < 10 or np.any(steps <= 0) or stamps.isna().mean() > 0.01:
            continue
        step = (steps.sum()) / steps.size
        if np.max(np.abs(steps - step)) < 0.5 * step:
            why = f"the mean step of the stamps in {name!r}, which are text"
            return TimeColumn(None, 0.9, {"s": 1.0}, why, float(f"{step:.6g}"))
    return TimeColumn(None, 0.0, {"s": 1.0}, "no column advances as time does")


def columns_over_time(columns: dict[str, np.ndarray], clock: TimeColumn) -> ColumnRecord:
    """The columns on their clock, gaps interpolated; what never changes is left out."""
    first = next(iter(columns.values()))
    t = np.arange(first.size, dtype=float) if clock.column is None else columns[clock.column]
    ahead = np.isfinite(t)
    latest = np.maximum.accumulate(np.where(ahead, t, -np.inf))
    ahead[1:] &= t[1:] > latest[:-1]
    t = t[ahead]
    kept = {}
    for name, values in columns.items():
        series = values[ahead]
        finite = np.isfinite(series)
        varies = np.sum(finite) > 10 and np.ptp(series[finite]) > 1e-9 * np.max(
            np.abs(series[finite])
        )
        if name != clock.column and varies and np.mean(finite) > 0.02:
            kept[name] = bridge_gaps(t, series, np.inf)[0]
    return ColumnRecord(t, kept)


def _evenness(values: np.ndarray) -> float | None:
    """Spread of the steps over their mean; None where the column does not always advance."""
    finite = values[np.isfinite(values)]
    if finite.size < 10 or finite.size < 0.9 * values.size:
        return None
    steps = np.diff(finite)
    if np.any(steps < 0) or np.mean(steps > 0) < 0.5:
        return None
    usual = np.median(steps[steps > 0])
    return float(np.percentile(np.abs(steps - usual), 90) / usual)


def _counts_rows(values: np.ndarray) -> bool:
    return bool(values[0] in (0.0, 1.0) and np.all(np.diff(values) == 1.0))


def _unit_odds(stated: str, step: float, largest: float) -> dict[str, float]:
    """Probability of every unit of time, from what is stated, the step, and the epoch."""
    odds = {}
    for unit in _TIMES:
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
