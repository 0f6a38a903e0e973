"""Channels that were made up between samples, or never measured at all.

A resampled heading that was interpolated through 360/0, a position drawn straight between fixes and
a channel that never changes look like measurements, and pass for faults of another kind: each shows
in its own numbers. They are looked for before channels are compared.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Bool, Int
from scipy import special

from diffsea.recordings.auditing.edits import Blank, Rewrap
from diffsea.recordings.auditing.finding import Finding, finding_of
from diffsea.recordings.motion import MeasuredMotion
from diffsea.series import integrate, median_interval, strictly_later, unwrap
from diffsea.statistics import robust_scale
from diffsea.trajectory import MOTION_CHANNELS, Samples, Trajectory


_BY_CHANCE = 1e-5  # probability below which a pattern is not one of chance
_FEWEST_SAMPLES = 30  # from which a channel is judged
_MOST_BETWEEN = 4  # interpolated values in one wrap
_OFF = 6.0  # usual steps from both ends of the wrap: normal deviates get there once in 1e9
_SMALLEST_OFF = np.radians(3.0)  # below, neither end is far enough to tell from noise of a compass
_STRAIGHT_SHARE = (
    0.4  # of bends that vanish, at least: every other one where each second row is made up
)
_ROUNDING = 2.0  # steps of rounding by which three values on a line may bend
_ROUND_OFF = 1e-6  # of a motion: variations below are those of arithmetic
_TURN = 2 * np.pi


def constant_findings(trajectory: Trajectory, motion: MeasuredMotion) -> list[Finding]:
    """Channels that have one value throughout, though by the others they cannot.

    A sensor that works has noise or motion of more than its last digit. What kinematics predict
    for the channel (heading from yaw rate, position from velocity, and the reverse), over windows
    of a twentieth of the run, must vary by more than rounding of all numbers explains; in a
    simulated run straight ahead it does not. Where positions are missing sway has yaw rate for its
    partner: a hull that turns sways.
    """
    run, found = trajectory.counted(), []
    for name, series in run.motion.items():
        values = series[np.isfinite(series)]
        if values.size < _FEWEST_SAMPLES or np.ptp(values) > 0 or not _should_vary(motion, name):
            continue
        words = {"level": values[0], "count": values.size}
        edit = Blank((name,), ((float(run.t[0]), float(run.t[-1])),))
        found.append(finding_of("constant", (name,), float(values[0]), 0.0, words, edit))
    return found


def _should_vary(motion: MeasuredMotion, channel: str) -> bool:
    """Whether the other channels predict that this one changes by more than rounding."""
    values, rows = motion.values, _window_edges(motion)
    seconds = np.diff(motion.t[rows])
    if channel in ("psi", "r") and motion.has("psi", "r"):
        partner = "r" if channel == "psi" else "psi"
        step = _rounding(values[partner])
        level = integrate(motion.t, values["r"]) if channel == "psi" else values["psi"]
        return _varies(np.diff(level[rows]), seconds, 2 * step + np.max(seconds) * step)
    if channel not in ("psi", "r") and motion.has("x", "y", "psi", "u", "v"):
        measured = ("u", "v") if channel in ("x", "y") else ("x", "y")
        step = max(_rounding(values[name]) for name in measured)
        if channel in ("x", "y"):
            moved = np.diff(integrate(motion.t, motion.earth_velocity)[rows])
        else:
            turn = np.exp(-1j * values["psi"])
            moved = np.diff(integrate(motion.t, np.gradient(motion.place, motion.t) * turn)[rows])
        part = np.real(moved) if channel in ("x", "u") else np.imag(moved)
        rounding = 2 * step + np.max(seconds) * step
        rounding += np.max(np.abs(moved)) * _rounding(values["psi"])
        return _varies(part, seconds, rounding)
    partner = {"x": "y", "y": "x", "u": "r", "v": "r", "psi": "v", "r": "v"}[channel]
    if not motion.has(partner):
        return False
    level = values[partner] if channel in ("x", "y") else integrate(motion.t, values[partner])
    step = _rounding(values[partner])
    return _varies(np.diff(level[rows]), seconds, 2 * step + np.max(seconds) * step)


def _window_edges(motion: MeasuredMotion) -> Int[np.ndarray, "edge"]:
    marks = np.linspace(motion.t[0], motion.t[-1], 21)
    return np.unique(np.searchsorted(motion.t, marks).clip(0, motion.t.size - 1))


def _rounding(series: Samples) -> float:
    """The step to which a series is rounded: the smallest difference of its values."""
    return float(np.min(np.diff(np.unique(series)), initial=np.ptp(series)))


def _varies(moved: np.ndarray, seconds: np.ndarray, rounding: float) -> bool:
    """Whether the changes over windows are not those of one rate, by more than rounding."""
    rate = np.sum(moved) / np.sum(seconds)
    size = np.max(np.abs(moved), initial=0.0)
    return bool(np.max(np.abs(moved - rate * seconds)) > rounding + _ROUND_OFF * size)


def wrap_findings(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Headings interpolated through 360/0: motion without them, and a finding if there are any.

    Some values lie, the long way round, between two that are neighbours across the wrap: far from
    both, by six times what heading usually changes from row to row.
    """
    if not motion.has("psi"):
        return motion, []
    psi, known = motion.values["psi"], motion.known["psi"]
    false = _interpolated_through_wrap(psi) & known
    if not np.any(false):
        return motion, []
    at = motion.t[false]
    gaps = np.where(false, np.nan, psi)
    whole = unwrap(np.where(false, np.nan, np.mod(gaps, _TURN)))
    kept = ~false
    shift = _TURN * np.round((psi[kept][0] - whole[kept][0]) / _TURN)
    bridged = np.interp(motion.t, motion.t[kept], whole[kept] + shift)
    spans = tuple(zip(at.tolist(), at.tolist(), strict=True))
    words = {"count": at.size, "start": at[0]}
    edit = Rewrap("psi", spans)
    found = finding_of("interpolated-wrap", ("psi",), float(at.size), 0.0, words, edit)
    return motion.with_channels(psi=bridged), [found]


def _interpolated_through_wrap(psi: Samples) -> Bool[np.ndarray, "time"]:
    """Which values of a heading (rad) lie the long way round between the ends of a wrap.

    Headings go from 0 to 360 deg or from -180 to 180: whichever explains more values.
    """
    usual = max(robust_scale(_short_way(np.diff(psi))), 1e-9)
    limit = max(_OFF * usual, _SMALLEST_OFF)
    ways = [_between_ends(np.mod(psi - lowest, _TURN), limit) for lowest in (0.0, -np.pi)]
    return max(ways, key=np.sum)


def _between_ends(wrapped: Samples, limit: float) -> Bool[np.ndarray, "time"]:
    """Which of the wrapped headings are farther than `limit` from both ends of a wrap."""
    false = np.zeros(wrapped.shape, dtype=bool)
    for count in range(1, _MOST_BETWEEN + 1):
        first, last = wrapped[: -count - 1], wrapped[count + 1 :]
        across = np.abs(last - first) > 0.75 * _TURN
        across &= np.abs(_short_way(last - first)) < (count + 1) * limit
        between = np.lib.stride_tricks.sliding_window_view(wrapped[1:-1], count)
        low, high = np.minimum(first, last)[:, None], np.maximum(first, last)[:, None]
        inside = np.all((between > low + limit) & (between < high - limit), axis=1)
        way = np.sign(last - first)[:, None]
        ordered = np.all(np.diff(between, axis=1) * way > 0, axis=1)
        for at in np.flatnonzero(across & inside & ordered):
            false[at + 1 : at + 1 + count] = True
    return false


def _short_way(angle: np.ndarray) -> np.ndarray:
    """The angle (rad) within half a turn of zero."""
    return np.mod(angle + np.pi, _TURN) - np.pi


@dataclasses.dataclass(frozen=True)
class _Fixes:
    """Rows at which a channel bends, and how far apart they usually are (rows)."""

    rows: Int[np.ndarray, "fix"]
    usual: int


def straight_findings(trajectory: Trajectory) -> list[Finding]:
    """Channels drawn straight from fix to fix at a regular rhythm.

    Between two fixes values lie on one line but for rounding, and the lines are mostly of one
    length. Bends at random places would be of one length as often as their number allows: the
    finding is made where that has a probability below 1e-5.
    """
    run = trajectory.counted()
    run = run.rows(strictly_later(run.t))
    fixes: dict[str, _Fixes] = {}
    for name in MOTION_CHANNELS:
        series = run.motion[name]
        if np.sum(np.isfinite(series)) == series.size and series.size >= 2 * _FEWEST_SAMPLES:
            found = _regular_fixes(run.t, series)
            fixes |= {name: found} if found else {}
    groups: dict[tuple[int, int], list[str]] = {}
    for name, found in fixes.items():
        groups.setdefault((found.usual, found.rows.size), []).append(name)
    return [_straight(run.t, tuple(names), fixes[names[0]]) for names in groups.values()]


def _regular_fixes(t: Samples, series: Samples) -> _Fixes | None:
    """The fixes of a channel that is straight between them; None where it is not."""
    levels = np.unique(series)
    rounding = float(np.min(np.diff(levels), initial=np.inf)) if levels.size > 1 else np.inf
    size = float(np.max(np.abs(series)))
    tolerance = _ROUNDING * rounding if rounding > 1e-9 * size else 1e-9 * size
    slopes = np.diff(series) / np.diff(t)
    bends = np.abs(np.diff(slopes)) * np.minimum(np.diff(t)[1:], np.diff(t)[:-1])
    straight = (bends <= tolerance) & (slopes[1:] != 0)
    rows = np.flatnonzero(bends > tolerance) + 1
    if np.mean(straight) < _STRAIGHT_SHARE or rows.size < 4:
        return None
    lengths = np.diff(rows)
    usual = int(np.bincount(lengths).argmax())
    alike = int(np.sum(np.abs(lengths - usual) <= usual // 8))
    share = rows.size / series.size
    # Bends at random: lengths are geometric, and the usual one is the likeliest of some around it.
    near = min(1.0, (2 * (usual // 8) + 1) * share * (1 - share) ** max(usual - 1 - usual // 8, 0))
    chance = special.bdtrc(alike - 1, lengths.size, near) * max(usual, 2)
    return (
        _Fixes(rows, usual)
        if usual > 1 and chance < _BY_CHANCE and alike > 0.5 * lengths.size
        else None
    )


def _straight(t: Samples, names: tuple[str, ...], fixes: _Fixes) -> Finding:
    """The finding on channels that have the same fixes."""
    intervals = np.diff(t[fixes.rows])
    interval = float(np.median(intervals))
    std = robust_scale(intervals - interval) / math.sqrt(intervals.size)
    made_up = np.ones(t.size, dtype=bool)
    made_up[[0, *fixes.rows, -1]] = False
    at = t[made_up].tolist()
    words = {"interval": interval, "rows": median_interval(t), "start": t[fixes.rows[0]]}
    edit = Blank(names, tuple(zip(at, at, strict=True)))
    by = {"interval": interval}
    return finding_of("interpolated-fixes", names, interval, std, words, edit, parameters=by)
