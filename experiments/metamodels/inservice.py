"""From logs of service to trials: cleaning, turning motion, groups by place, little side wind."""

import dataclasses
import math

from experiments.metamodels.voyages import Log

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from diffsea.segments.free_motion import turning_motions
from diffsea.segments.places import by_place
from diffsea.segments.spans import SegmentSettings


INTERVAL = 1.0  # s, common to all channels
CUT_OFF = 0.05  # Hz, of the low-pass filter
WINDOW = 90.0  # s: averages over 30 s, pieces nearer than 90 s are one
# 0.2 deg/s is a fifth of the 90 deg per window that settings count in; any turn counts.
SETTINGS = SegmentSettings(window=WINDOW, averaging=1 / 3, merging=1.0, turning_share=0.2,
                    least_turn=math.radians(5.0))  # fmt: skip
MARGIN = 30.0  # s, kept before and after
PLAUSIBLE = {"u": (-5.0, 20.0), "v": (-5.0, 5.0), "r": (-0.05, 0.05), "rudder": (-0.7, 0.7)}


@dataclasses.dataclass(frozen=True)
class Piece:
    """One trial found in a log, on an even clock."""

    log: str
    t: np.ndarray
    channels: dict[str, np.ndarray]
    side_wind: float  # m/s, mean of the true wind's part abeam, without sign

    @property
    def place(self) -> tuple[float, float, float, float]:
        """Where it began and ended, m."""
        x, y = self.channels["x"], self.channels["y"]
        return float(x[0]), float(y[0]), float(x[-1]), float(y[-1])


def faulty(log: Log) -> str | None:
    """What makes a log useless: a channel that is stuck, or values no ship has."""
    for name, series in log.channels.items():
        if np.ptp(series) == 0:
            return f"{name} is constant"
        low, high = PLAUSIBLE.get(name, (-math.inf, math.inf))
        if np.mean((series < low) | (series > high)) > 0.01:
            return f"{name} is out of range"
    return None


def prepared(log: Log) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Every channel by a spline on the common clock, low-pass filtered without delay."""
    t = np.arange(math.ceil(log.t[0]), math.floor(log.t[-1]), INTERVAL)
    filter_ = butter(4, CUT_OFF, fs=1 / INTERVAL, output="sos")
    apparent = log.channels["wind_speed"], log.channels["wind_direction"]
    # Directions are filtered as components: they jump by a full turn.
    parts = {k: s for k, s in log.channels.items() if not k.startswith("wind")}
    parts |= {
        "ahead": apparent[0] * np.cos(apparent[1]),
        "abeam": apparent[0] * np.sin(apparent[1]),
    }
    even = {k: sosfiltfilt(filter_, CubicSpline(log.t, s)(t)) for k, s in parts.items()}
    return t, even


def pieces_in(log: Log) -> list[Piece]:
    """The turning motions of one log, each with a margin."""
    t, even = prepared(log)
    everywhere = np.ones(t.shape, bool)
    found = turning_motions(t, even["psi"], even["r"], everywhere, SETTINGS)
    margin = round(MARGIN / INTERVAL)
    pieces = []
    for first, last in found:
        if first - margin < 0 or last + margin >= len(t):
            continue  # cut off by the end of the file
        rows = slice(first - margin, last + margin + 1)
        kept = {k: s[rows] for k, s in even.items()}
        # Where the air comes from, seen from the ship, less her own way: the true wind abeam.
        side = float(np.mean(np.abs(kept["abeam"] - kept["v"])))
        pieces.append(Piece(log.name, t[rows] - t[first], kept, side))
    return pieces


@dataclasses.dataclass(frozen=True)
class Found:
    """What the search of all logs gave."""

    excluded: dict[str, str]
    pieces: list[Piece]
    labels: np.ndarray  # group of every piece, by size
    durations: np.ndarray  # s


def search(logs: list[Log]) -> Found:
    """Trials of all logs, grouped by place."""
    excluded = {log.name: why for log in logs if (why := faulty(log)) is not None}
    pieces = [p for log in logs if log.name not in excluded for p in pieces_in(log)]
    labels = by_place([p.place for p in pieces])
    return Found(excluded, pieces, labels, np.array([np.ptp(p.t) for p in pieces]))
