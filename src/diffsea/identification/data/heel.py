"""Heel as the motion before explains it, for forces that follow the heel.

Heel answers to turning, so a recorded heel tells of the yaw rate beside the gyro, and of gusts
that turn the vessel. A force in phase with it then seems to be there where none is. Taken
instead is what the recorded motion and earlier heel predict.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.signal import lfilter

from diffsea.series import hold_last
from diffsea.statistics import robust_scale
from diffsea.trajectory import Trajectory


LEAST_VALUES = 60  # recorded values of heel from which a roll motion can be estimated
ORDER = 2  # a roll motion is of second order
_LONG_REGRESSION = 12  # values of heel that stand for the noise before it is known
_LARGEST_ANGLE = 0.75 * np.pi  # free swing from one value to the next: beyond, two hardly tell it
_SOFT_SCALE = 3.0  # standard deviations beyond which a value counts less

_Row = Float[np.ndarray, "row"]


def predicted_heel(recording: Trajectory) -> _Row:
    """Mean heel (rad) from each valid row to the next, from what was recorded before.

    An ARMAX model of second order (Ljung 1999, System Identification, 4.2 and 10.2), driven by
    u r and v, fitted to the recorded heel by its prediction errors. Between values of heel it
    swings at its own frequency about what the inputs would hold it at. Zero without a recording;
    with few values the heel is held.
    """
    run = recording.counted()
    t, phi = run.t, run.extra.get("phi", np.full(len(run.t), np.nan))
    rows = np.flatnonzero(np.isfinite(phi))
    if not len(rows):
        return np.zeros(len(t))
    heel, scale = phi[rows], float(phi[rows].std())
    if len(rows) < LEAST_VALUES or scale == 0.0:
        return hold_last(phi)
    u, v, r = (np.nan_to_num(hold_last(one)) for one in (run.u, run.v, run.r))  # zero if unmeasured
    inputs = [_normalise(one[rows]) for one in (u * r, v) if one.any()]
    motion_model = _fit_roll_motion(heel / scale, inputs)
    step = np.append(np.diff(t[rows]), 1.0)
    at = np.maximum(np.searchsorted(rows, np.arange(len(t)), side="right") - 1, 0)
    row = np.append(np.diff(t), 0.0)
    begin, middle, end = (
        motion_model.at(at, np.clip((t + part * row - t[rows][at]) / step[at], 0.0, 1.0))
        for part in (0.0, 0.5, 1.0)
    )
    return scale * (begin + 4 * middle + end) / 6


@dataclasses.dataclass(frozen=True)
class _RollMotion:
    """Heel between its values: at each, at the next, and where the inputs would hold it."""

    now: _Row
    next: _Row
    held: _Row
    angle: float  # of a free swing from one value to the next, rad

    def at(self, value: np.ndarray, share: _Row) -> _Row:
        """At a share of the time from some of the values to their next."""
        angle = max(self.angle, 1e-6)
        before, after = (np.sin(angle * one) / np.sin(angle) for one in (1 - share, share))
        held = self.held[value]
        return held + before * (self.now[value] - held) + after * (self.next[value] - held)


def _normalise(values: _Row) -> _Row:
    size = float(values.std())
    return values / size if size > 0 else values


def _fit_roll_motion(heel: _Row, inputs: list[_Row]) -> _RollMotion:
    """Heel at each row, and at the next, from heel before the row and inputs up to it."""
    forced = [np.ones(len(heel)), *(_lag(one, k) for one in inputs for k in range(ORDER + 1))]
    past = [_lag(heel, k + 1) for k in range(ORDER)]

    def errors(at: np.ndarray) -> _Row:
        a, c, b = np.split(at, [ORDER, 2 * ORDER])
        driven = heel - sum(x * y for x, y in zip((*a, *b), (*past, *forced), strict=True))
        return np.asarray(lfilter([1.0], np.append(1.0, c), driven))

    start = _first_guess(heel, past, forced)
    first = errors(start)
    spread = max(robust_scale(first), 1e-6)
    soft = _SOFT_SCALE * spread
    found = least_squares(errors, start, loss="soft_l1", f_scale=soft, max_nfev=50).x
    if not _is_stable(found[ORDER : 2 * ORDER]):
        found = start
    error = errors(found)
    a, c, b = np.split(found, [ORDER, 2 * ORDER])
    now = heel - error
    late = _lag(heel, 1), _lag(error, 1)
    # The row's own heel and error are not known beforehand, nor are the next row's inputs.
    held = [forced[0], *(_lag(one, max(k - 1, 0)) for one in inputs for k in range(ORDER + 1))]
    driven = sum(x * y for x, y in zip(b, held, strict=True))
    ahead = a[0] * now + a[1] * late[0] + c[1] * late[1] + driven
    pole = np.roots([1.0, *-a])[0]
    if not np.iscomplex(pole):
        return _RollMotion(now, ahead, np.zeros(len(heel)), 0.0)
    angle = min(float(np.abs(np.angle(pole))), _LARGEST_ANGLE)
    return _RollMotion(now, ahead, driven / (1 - a.sum()), angle)


def _first_guess(heel: _Row, past: list[_Row], forced: list[_Row]) -> np.ndarray:
    """Linear regression on earlier errors, these from a long regression on earlier heel."""
    long = np.column_stack([*(_lag(heel, k + 1) for k in range(_LONG_REGRESSION)), *forced])
    error = heel - long @ np.linalg.lstsq(long, heel, rcond=None)[0]
    errors = [_lag(error, k + 1) for k in range(ORDER)]
    columns = np.column_stack([*past, *errors, *forced])
    found = np.linalg.lstsq(columns, heel, rcond=None)[0]
    if not _is_stable(found[ORDER : 2 * ORDER]):
        found[ORDER : 2 * ORDER] = 0.0
    return found


def _is_stable(c: np.ndarray) -> bool:
    return bool(np.all(np.abs(np.roots(np.append(1.0, c))) < 0.999))


def _lag(values: _Row, rows: int) -> _Row:
    """Values of so many rows before; the first where there is none."""
    return values if rows == 0 else np.concatenate([np.full(rows, values[0]), values[:-rows]])
