"""A measured run made complete: gaps bridged, missing motion derived, noise smoothed.

The trial numbers need positions, heading, velocities and yaw rate in every row. What was
not measured is derived from what was, and each such step is told in a note.
"""

import dataclasses
import math
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.kinematics import to_body
from diffsea.metrics.crossings import slopes
from diffsea.series import integrate, interpolate_missing
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples, Trajectory


# White noise is smoothed where its deviation exceeds this part of the channel's range.
_NOISE = 0.002
# The window is the time in which the vessel, turning fast, changes its heading by this.
_WINDOW_HEADING = math.radians(5)
_WINDOW_ROWS = 201
_BLOCK = 10_000  # rows whose windows are held in memory at once
_RATE_ROWS = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97)  # of which one suits the noise


class Derivation(NamedTuple):
    """One step that a measured run was made complete by: missing motion derived, or smoothed."""

    kind: Literal["derived", "smoothed"]
    note: str


def prepare_recording(trajectory: Trajectory) -> tuple[Trajectory, list[Derivation]]:
    """The valid rows of a run with all motion filled in, and what that took.

    Missing samples are interpolated; heading is unwrapped, or the integral of the yaw rate
    where it was not measured; yaw rate and velocities come from differences where they
    were not. Channels with more white noise than 0.2 % of their range are replaced by
    local parabolas. Positions that were not measured stay NaN.

    Raises `UserError` where there is neither heading nor yaw rate, or hardly a row.
    """
    run = _measured_rows(trajectory)
    t, motion = run.t, dict(run.motion)
    notes: list[Derivation] = []
    _complete_heading(t, motion, notes)
    count = _window_rows(t, motion["psi"])
    _smooth(t, motion, [n for n in motion if _noisy(motion[n])], count, notes)
    if not _measures(motion["r"]):
        motion["r"] = _rate(t, motion["psi"])
        note = "yaw rate was not recorded: it is the derivative of the heading"
        notes.append(Derivation("derived", note))
    _complete_velocity(t, motion, notes)
    return dataclasses.replace(run, t=t, **motion), notes


def _measured_rows(trajectory: Trajectory) -> Trajectory:
    """The rows between the first and last heading, gaps in their motion interpolated."""
    if not (trajectory.has("psi") or trajectory.has("r")):
        raise UserError(
            f"{trajectory.name} has neither heading (psi) nor yaw rate (r): no number of a "
            "trial can be read off it; map one of them"
        )
    t = np.asarray(trajectory.t, float)
    heading = np.asarray(trajectory.psi if trajectory.has("psi") else trajectory.r, float)
    rows = np.flatnonzero(np.asarray(trajectory.valid, bool) & np.isfinite(t))
    rows = rows[t[rows] >= np.maximum.accumulate(t[rows])]
    measured = np.flatnonzero(np.isfinite(heading[rows]))
    rows = rows[measured[0] : measured[-1] + 1] if measured.size else rows[:0]
    if rows.size < 4 or t[rows[-1]] <= t[rows[0]]:
        raise UserError(f"{trajectory.name} has fewer than four rows with a heading or yaw rate")
    run = trajectory.rows(rows)
    finite = np.isfinite(run.psi)
    run.psi[finite] = np.unwrap(run.psi[finite])
    motion = {name: interpolate_missing(run.t, values) for name, values in run.motion.items()}
    return dataclasses.replace(run, **motion)


def _measures(values: Samples) -> bool:
    return bool(np.isfinite(values).any())


def _complete_heading(t: Samples, motion: dict[str, Samples], notes: list[Derivation]) -> None:
    if _measures(motion["psi"]):
        return
    turned = integrate(t, motion["r"])
    note = "heading was not recorded: it is the integral of the yaw rate"
    notes.append(Derivation("derived", note))
    motion["psi"] = turned + _first_heading(t, turned, motion, notes)


def _first_heading(
    t: Samples, turned: Samples, motion: dict[str, Samples], notes: list[Derivation]
) -> float:
    """Heading (rad) at the start that makes velocities and positions agree best."""
    if not (_measures(motion["x"]) and _measures(motion["y"])):
        return 0.0
    over_ground = _rate(t, motion["x"]) + 1j * _rate(t, motion["y"])
    body = np.ones(len(t), complex)
    if _measures(motion["u"]) and _measures(motion["v"]):
        body = motion["u"] + 1j * motion["v"]
    else:
        notes.append(Derivation("derived", "its start is the course: drift is neglected"))
    return float(np.angle(np.sum(over_ground * np.conj(body * np.exp(1j * turned)))))


def _complete_velocity(t: Samples, motion: dict[str, Samples], notes: list[Derivation]) -> None:
    missing = [name for name in ("u", "v") if not _measures(motion[name])]
    if not missing:
        return
    if _measures(motion["x"]) and _measures(motion["y"]):
        north, east = _rate(t, motion["x"]), _rate(t, motion["y"])
        derived = dict(zip("uv", to_body(north, east, motion["psi"]), strict=True))
        note = f"{' and '.join(missing)} not recorded: derived from the positions"
    else:
        derived = {"u": motion["u"], "v": np.zeros_like(t)}
        note = f"{' and '.join(missing)} not recorded, nor positions to derive them from"
    notes.append(Derivation("derived", note))
    motion.update({name: np.asarray(derived[name]) for name in missing})


def _rate(t: Samples, values: Samples) -> Samples:
    """Slope of local parabolas over as many rows as predict left-out samples best.

    Differences of two samples would have the noise of both over one interval: of positions to
    0.1 m at 5 Hz, 0.7 m/s.
    """
    counts = [count for count in _RATE_ROWS if count <= len(t)]
    if not counts or np.any(np.diff(t) <= 0):
        return np.asarray(slopes(jnp.asarray(t), jnp.asarray(values)), float)
    fits = [_parabolas(t, values, count) for count in counts]
    missed = [np.sum(((values - fit.value) / (1 - fit.leverage)) ** 2) for fit in fits]
    return fits[int(np.argmin(missed))].slope


def _noisy(values: Samples) -> bool:
    """Whether there is white noise worth smoothing."""
    if not _measures(values) or len(values) < 8:
        return False
    return noise_scale(values) > _NOISE * np.ptp(values)


def _window_rows(t: Samples, psi: Samples) -> int:
    """Odd number of rows in which a fast turn changes the heading by five degrees."""
    lag = max(1, len(t) // 50)
    duration = np.maximum(t[lag:] - t[:-lag], 1e-12)
    fast = np.quantile(np.abs(psi[lag:] - psi[:-lag]) / duration, 0.9)
    step = (t[-1] - t[0]) / (len(t) - 1)
    return 2 * int(min(_WINDOW_HEADING / max(fast * step, 1e-12), _WINDOW_ROWS) // 2) + 1


def _smooth(
    t: Samples, motion: dict[str, Samples], names: list[str], count: int, notes: list[Derivation]
) -> None:
    if count < 5 or count > len(t) or not names:
        return
    for name in names:
        motion[name] = _parabolas(t, motion[name], count).value
    seconds = count * (t[-1] - t[0]) / (len(t) - 1)
    note = f"noise in {', '.join(names)} smoothed by parabolas over {seconds:.3g} s"
    notes.append(Derivation("smoothed", note))


class _Parabolas(NamedTuple):
    """Parabolas fitted to the rows around each row, at that row."""

    value: Samples
    slope: Samples  # per second
    leverage: Samples  # of the row's own sample in its value


def _parabolas(t: Samples, values: Samples, count: int) -> _Parabolas:
    """The parabola fitted to the `count` rows around each row."""
    blocks = [
        _parabolas_at(np.arange(k, min(k + _BLOCK, len(t))), t, values, count)
        for k in range(0, len(t), _BLOCK)
    ]
    return _Parabolas(*map(np.concatenate, zip(*blocks, strict=True)))


def _parabolas_at(rows: np.ndarray, t: Samples, values: Samples, count: int) -> _Parabolas:
    first = np.clip(rows - count // 2, 0, len(t) - count)
    window = first[:, None] + np.arange(count)
    span = np.maximum(t[window[:, -1]] - t[window[:, 0]], 1e-12)
    offset = (t[window] - t[rows][:, None]) / span[:, None]
    basis = np.stack([np.ones_like(offset), offset, offset**2], axis=-1)
    normal = np.einsum("nki,nkj->nij", basis, basis) + 1e-12 * np.eye(3)
    moments = np.einsum("nki,nk->ni", basis, values[window])
    found = np.linalg.solve(normal, moments[..., None])[..., 0]
    # At the row itself the basis is (1, 0, 0).
    return _Parabolas(found[:, 0], found[:, 1] / span, np.linalg.inv(normal)[:, 0, 0])
