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


_NOISE_SHARE = 0.002  # of a channel's range: more white noise is smoothed
# Noise is smoothed over the time in which the vessel, turning fast, changes its heading by this:
# what a turn does in less is no noise, and a parabola follows it.
_WINDOW_HEADING = math.radians(5)
_WINDOW_LIMIT = 201  # rows
_BLOCK_ROWS = 10_000  # whose windows are held in memory at once
_RATE_ROWS = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97)  # windows of which one suits the noise


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

    Raises:
        UserError: there is neither heading nor yaw rate, or hardly a row, or a heading has to come
            from positions too large to calculate with.
    """
    run = _measured_rows(trajectory)
    t, sampled = run.t, run.motion
    motion = {name: interpolate_missing(t, values) for name, values in sampled.items()}
    steps: list[Derivation] = []

    def note(text: str) -> None:
        steps.append(Derivation("derived", text))

    if not _has_values(motion["psi"]):
        note("heading was not recorded: it is the integral of the yaw rate")
        turned = integrate(t, motion["r"])
        motion["psi"] = turned + 0.0
        # Of the start that velocities and positions agree on best.
        if _has_values(motion["x"]) and _has_values(motion["y"]):
            over_ground = _time_derivative(t, sampled["x"]) + 1j * _time_derivative(t, sampled["y"])
            body = np.ones(len(t), complex)
            if _has_values(motion["u"]) and _has_values(motion["v"]):
                body = motion["u"] + 1j * motion["v"]
            else:
                note("its start is the course: drift is neglected")
            start = np.angle(np.sum(over_ground * np.conj(body * np.exp(1j * turned))))
            if not np.isfinite(start):
                raise UserError(
                    f"{trajectory.name} has positions or velocities too large to calculate with; "
                    "leave these rows out"
                )
            motion["psi"] = turned + float(start)
    steps += _smooth_noise(t, sampled, motion)
    if not _has_values(motion["r"]):
        note("yaw rate was not recorded: it is the derivative of the heading")
        motion["r"] = _time_derivative(t, sampled["psi"])
    missing = [name for name in ("u", "v") if not _has_values(motion[name])]
    if missing:
        what = " and ".join(missing)
        velocity = {"u": motion["u"], "v": np.zeros_like(t)}
        if _has_values(motion["x"]) and _has_values(motion["y"]):
            north, east = _time_derivative(t, sampled["x"]), _time_derivative(t, sampled["y"])
            velocity = dict(zip("uv", to_body(north, east, motion["psi"]), strict=True))
            note(f"{what} not recorded: derived from the positions")
        else:
            note(f"{what} not recorded, nor positions to derive them from")
        motion |= {name: np.asarray(velocity[name]) for name in missing}
    return dataclasses.replace(run, **motion), steps


def _measured_rows(trajectory: Trajectory) -> Trajectory:
    """The rows between the first and last heading, gaps in their motion left as they are."""
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
    return run


def _has_values(values: Samples) -> bool:
    return bool(np.isfinite(values).any())


def _smooth_noise(
    t: Samples, sampled: dict[str, Samples], motion: dict[str, Samples]
) -> list[Derivation]:
    """Replace noisy channels of `motion`, in place, by parabolas over a fast turn by 5 deg.

    Noise is that of the samples: a line between two of them has none.
    """
    noisy = [name for name, values in sampled.items() if _is_noisy(values[np.isfinite(values)])]
    psi, lag = motion["psi"], max(1, len(t) // 50)
    duration = np.maximum(t[lag:] - t[:-lag], 1e-12)
    fast = np.quantile(np.abs(psi[lag:] - psi[:-lag]) / duration, 0.9)
    step = (t[-1] - t[0]) / (len(t) - 1)
    count = 2 * int(min(_WINDOW_HEADING / max(fast * step, 1e-12), _WINDOW_LIMIT) // 2) + 1
    if count < 5 or count > len(t) or not noisy:
        return []
    motion |= {name: _local_parabolas(t, motion[name], count).value for name in noisy}
    seconds = count * (t[-1] - t[0]) / (len(t) - 1)
    note = f"noise in {', '.join(noisy)} smoothed by parabolas over {seconds:.3g} s"
    return [Derivation("smoothed", note)]


def _is_noisy(samples: Samples) -> bool:
    return len(samples) >= 8 and noise_scale(samples) > _NOISE_SHARE * np.ptp(samples)


def _time_derivative(t: Samples, values: Samples) -> Samples:
    """Slope, in every row, of local parabolas over as many samples as predict one left out best.

    Differences of two samples would have the noise of both over one interval: of positions to
    0.1 m at 5 Hz, 0.7 m/s. Rows without a sample have no say: what was interpolated is predicted
    best by its two neighbours, noise and all.
    """
    rows, (t, values) = t, (one[np.isfinite(values)] for one in (t, values))
    counts = [count for count in _RATE_ROWS if count <= len(t)]
    if not counts or np.any(np.diff(t) <= 0):
        found = np.asarray(slopes(jnp.asarray(t), jnp.asarray(values)), float)
    else:
        fits = [_local_parabolas(t, values, count) for count in counts]
        missed = [np.sum(((values - fit.value) / (1 - fit.leverage)) ** 2) for fit in fits]
        found = fits[int(np.argmin(missed))].slope
    return found if len(t) == len(rows) else np.interp(rows, t, found)


class _LocalParabolas(NamedTuple):
    """Parabolas fitted to the rows around each row, at that row."""

    value: Samples
    slope: Samples  # per second
    leverage: Samples  # of the row's own sample in its value


def _local_parabolas(t: Samples, values: Samples, count: int) -> _LocalParabolas:
    """The parabola fitted to the `count` rows around each row, by its normal equations."""
    blocks = []
    for start in range(0, len(t), _BLOCK_ROWS):
        rows = np.arange(start, min(start + _BLOCK_ROWS, len(t)))
        first = np.clip(rows - count // 2, 0, len(t) - count)
        window = first[:, None] + np.arange(count)
        span = np.maximum(t[window[:, -1]] - t[window[:, 0]], 1e-12)
        offset = (t[window] - t[rows][:, None]) / span[:, None]
        basis = np.stack([np.ones_like(offset), offset, offset**2], axis=-1)
        normal = np.einsum("nki,nkj->nij", basis, basis) + 1e-12 * np.eye(3)
        moments = np.einsum("nki,nk->ni", basis, values[window])
        found = np.linalg.solve(normal, moments[..., None])[..., 0]
        # At the row itself the basis is (1, 0, 0).
        blocks.append((found[:, 0], found[:, 1] / span, np.linalg.inv(normal)[:, 0, 0]))
    return _LocalParabolas(*map(np.concatenate, zip(*blocks, strict=True)))
