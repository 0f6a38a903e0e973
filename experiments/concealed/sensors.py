"""What instruments make of a track: each its own rate, noise, resolution, outliers and gaps."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from .model import Sensing
from .simulate import CHANNELS, Track


GROUPS = {"position": ("x", "y"), "velocity": ("u", "v"), "compass": ("psi",), "gyro": ("r",),
          "roll": ("phi",)}  # fmt: skip


@dataclass(frozen=True)
class Instrument:
    """One instrument: a reading every `every` rows, noise `std`, resolution `quantum`."""

    every: int
    std: float
    quantum: float
    outliers: float = 0.001  # share of readings that are wrong by ten standard deviations
    gaps: float = 0.5  # expected number of gaps a run


def true_readings(track: Track, sensing: Sensing, t: np.ndarray) -> dict[str, np.ndarray]:
    """Noise-free readings at the stamps t, with the errors of `sensing`."""
    spline = CubicSpline(track.t, track.states)
    clock = sensing.clock_offset + sensing.clock_rate * t

    def at(channel: str) -> np.ndarray:
        when = t - clock - sensing.latency.get(channel, 0.0)
        if channel in ("x", "y"):
            for start, end, late in sensing.late_windows:
                when = when - late * ((t >= start) & (t < end))
        return spline(when)[:, CHANNELS.index(channel)]

    # The antenna's arm turns with the hull at the time of the position.
    psi_of_position = spline(t - clock - sensing.latency.get("x", 0.0))[:, 2]
    out = {c: at(c) for c in CHANNELS}
    a, b = sensing.lever
    out["x"] = out["x"] + np.cos(psi_of_position) * a - np.sin(psi_of_position) * b
    out["y"] = out["y"] + np.sin(psi_of_position) * a + np.cos(psi_of_position) * b
    psi = out["psi"]
    out["psi"] = psi + sensing.heading_offset
    out["psi"] += sensing.iron_amplitude * np.sin(psi - sensing.iron_phase)
    out["r"] = out["r"] + sensing.gyro_bias
    return out


def compass(sensing: Sensing, psi: float) -> float:
    """What the heading controller reads, without noise."""
    swing = sensing.iron_amplitude * math.sin(psi - sensing.iron_phase)
    return psi + sensing.heading_offset + swing


def record(
    track: Track,
    sensing: Sensing,
    instruments: dict[str, Instrument],
    rows: int,
    step: float,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """Columns of a recording: t, the channels measured (NaN where there is no reading)."""
    t = np.arange(rows) * step
    truth = true_readings(track, sensing, t)
    out: dict[str, np.ndarray] = {"t": t}
    for group, channels in GROUPS.items():
        instrument = instruments.get(group)
        if instrument is None:
            continue
        there = _there(instrument, rows, rng)
        wrong = rng.random(rows) < instrument.outliers
        for channel in channels:
            value = truth[channel] + instrument.std * rng.standard_normal(rows)
            value += wrong * 10.0 * instrument.std * rng.choice([-1.0, 1.0], rows)
            if channel == "psi":
                value = (value + math.pi) % (2.0 * math.pi) - math.pi
            value = np.round(value / instrument.quantum) * instrument.quantum
            out[channel] = np.where(there, value, np.nan)
    return out


def _there(instrument: Instrument, rows: int, rng: np.random.Generator) -> np.ndarray:
    """Rows with a reading: every n-th, less gaps of up to 2 % of the run."""
    there = np.arange(rows) % instrument.every == 0
    for _ in range(rng.poisson(instrument.gaps)):
        start = int(rng.integers(rows // 20, rows))
        there[start : start + int(rng.integers(2, max(3, rows // 50)))] = False
    there[0] = True
    return there
