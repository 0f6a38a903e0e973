"""Turning motion, by the moving average of yaw rate (after Gavrilin and Steen 2017).

They mark what exceeds 0.2 deg/s in a moving average over 30 s and merge what is less than
90 s apart, for one ferry. Here these three follow from how fast the vessel turns.
"""

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from diffsea.campaign.holds import white_noise
from diffsea.campaign.settings import Settings


_FASTEST = 0.995  # quantile of the averaged yaw rate that stands for the fastest turn
_SIGNIFICANT = 4.0  # standard deviations of noise that turning exceeds

Samples = Float[np.ndarray, "time"]


def own_window(t: Samples, r: Samples) -> float:
    """Time (s) in which the vessel turns by 90 deg at the fastest rate of the recording.

    At least ten time steps, at most a fifth of the recording.
    """
    step = float(np.median(np.diff(t)))
    rates = np.abs(_average(ndimage.median_filter(r, 5, mode="nearest"), 5))
    fastest = max(float(np.quantile(rates, _FASTEST)), 1e-12)
    return float(np.clip(math.pi / 2 / fastest, 10 * step, max((t[-1] - t[0]) / 5, 10 * step)))


def turning_motions(
    t: Samples,
    psi: Samples,
    r: Samples,
    counts: Bool[np.ndarray, "time"],
    window: float,
    settings: Settings,
) -> list[tuple[int, int]]:
    """First and last rows of every turning motion.

    Yaw rate averaged over a part of the window exceeds a part of the fastest rate, and four
    standard deviations of its own noise; pieces nearer than the window are merged, and those
    stay in which the heading changes by `settings.least_turn`. Only rows that count do: a vessel
    that drifts turns too.
    """
    turning = turning_rows(t, r, window, settings) & counts
    pieces: list[tuple[int, int]] = []
    numbers, number = ndimage.label(turning)
    for (rows,) in ndimage.find_objects(numbers, number):
        if pieces and t[rows.start] - t[pieces[-1][1]] < settings.merging * window:
            pieces[-1] = (pieces[-1][0], rows.stop - 1)
        else:
            pieces.append((rows.start, rows.stop - 1))
    return [
        (first, last)
        for first, last in pieces
        if np.ptp(psi[first : last + 1]) >= settings.least_turn
    ]


def turning_rows(
    t: Samples, r: Samples, window: float, settings: Settings
) -> Bool[np.ndarray, "time"]:
    """Where yaw rate, averaged over a part of the window, is that of turning."""
    count = max(1, round(settings.averaging * window / float(np.median(np.diff(t)))))
    noise = white_noise(r) / math.sqrt(count)
    return np.abs(_average(r, count)) > max(turning_rate(window, settings), _SIGNIFICANT * noise)


def turning_rate(window: float, settings: Settings) -> float:
    """Yaw rate (rad/s) above which a vessel of this window is turning."""
    return settings.turning_share * math.pi / 2 / window


def _average(values: Samples, count: int) -> Samples:
    return ndimage.uniform_filter1d(values, count, mode="nearest")
