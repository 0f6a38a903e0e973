"""What a logger would have recorded: sensor effects, rates, noise, resolution, gusts, CSV.

Sensor effects, in this order:
    lever-arm (x, y)     position of the antenna: p + R(psi) (x, y); with u among its channels its
                         velocity, too: u - y r, v + x r
    clock-drift          the channels stamped t show the state at t - (offset + rate t); empty
                         where that is outside the run; orders keep their stamps
    sensor-latency       channels (default x, y) show the value `delay` before that
    heading-offset       psi + angle; with u among its channels (u, v) in axes so turned, too
    hard-iron            psi + amplitude sin(psi - phase)
    gyro-bias            r + bias; it and heading-offset after `time` alone, where that is given
Then noise, quantisation (rounding to multiples of a step) and decimation, per channel.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm


CHANNELS = ("x", "y", "psi", "u", "v", "r")
ROLL = "phi"  # recorded where the heel is given


@dataclass(frozen=True)
class Sensor:
    """One channel: standard deviation, resolution (its unit), a sample every `every` rows."""

    noise: float = 0.0
    step: float = 0.0
    every: int = 1


def suite(scale: float = 1.0, position_every: int = 1) -> dict[str, Sensor]:
    """Satellite position and velocity, compass, gyro; `scale` multiplies the noise."""
    position = Sensor(0.05 * scale, 1e-3, position_every)
    velocity = Sensor(0.02 * scale, 1e-3, position_every)
    compass = Sensor(math.radians(0.5) * scale, 1e-4)
    gyro = Sensor(math.radians(0.2) * scale, 1e-4)
    return dict(zip(CHANNELS, (position, position, compass, velocity, velocity, gyro), strict=True))


def gust(rng, start, end, std=(0.02, 0.02, 0.01), tau=(5.0, 5.0, 3.0), step=0.1):
    """Coloured accelerations (m/s^2, rad/s^2): exact Ornstein-Uhlenbeck samples, splined.

    a_{k+1} = a_k exp(-h/tau) + std sqrt(1 - exp(-2 h/tau)) xi, variance std^2, memory tau.
    """
    n = int(math.ceil((end - start) / step)) + 4
    decay = np.exp(-step / np.asarray(tau, float))
    xi = rng.standard_normal((n, 3)) * np.asarray(std, float)
    a = np.empty((n, 3))
    a[0] = xi[0]
    for k in range(1, n):
        a[k] = decay * a[k - 1] + np.sqrt(1 - decay**2) * xi[k]
    return CubicSpline(start - step + step * np.arange(n), a)


def roll(rng, start, end, period, degrees=3.0, damping=0.08, step=0.02):
    """Roll angle [rad] of a lightly damped oscillator under white noise, splined.

    phi'' + 2 z w phi' + w^2 phi = noise, sampled exactly at `step`; started in the
    stationary law, whose standard deviation of phi is `degrees`.
    """
    w, std = 2.0 * math.pi / period, math.radians(degrees)
    n = int(math.ceil((end - start) / step)) + 4
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * damping * w]])
    stationary = np.diag([std**2, (std * w) ** 2])
    onward = expm(A * step)
    spread = np.linalg.cholesky(stationary - onward @ stationary @ onward.T)
    s = np.empty((n, 2))
    s[0] = rng.standard_normal(2) * np.sqrt(np.diag(stationary))
    for k in range(1, n):
        s[k] = onward @ s[k - 1] + spread @ rng.standard_normal(2)
    return CubicSpline(start - step + step * np.arange(n), s[:, 0])


def true_channels(sim, times) -> dict[str, np.ndarray]:
    """The recorded channels before noise, with the sensor effects of the simulated model."""
    t = np.asarray(times, float)
    effects = sim.model.sensors
    clock = t.copy()
    for effect in effects:
        if effect["name"] == "clock-drift":
            clock -= effect.get("offset", 0.0) + effect.get("rate", 0.0) * t
    out = sim.at(t) | seen(sim, clock, effects)
    for effect in effects:
        if effect["name"] == "sensor-latency":
            past = seen(sim, clock - effect["delay"], effects)
            for channel in effect.get("channels", ["x", "y"]):
                out[channel] = past[channel]
    for effect in effects:
        acts = t > effect.get("time", -math.inf)
        if effect["name"] == "heading-offset":
            out["psi"] = out["psi"] + effect["angle"] * acts
            if "u" in effect.get("channels", ()):
                # A velocity is the same arrow, its components those in axes turned clockwise.
                arrow = (out["u"] + 1j * out["v"]) * np.exp(-1j * effect["angle"])
                out["u"], out["v"] = arrow.real, arrow.imag
        elif effect["name"] == "hard-iron":
            out["psi"] = out["psi"] + effect["amplitude"] * np.sin(out["psi"] - effect["phase"])
        elif effect["name"] == "gyro-bias":
            out["r"] = out["r"] + effect["bias"] * acts
    return out


def seen(sim, times, effects: list[dict]) -> dict:
    """Motion channels at the times, with the antenna's place; NaN outside the run."""
    known = (times >= sim.t0 - 1e-9) & (times <= sim.t + 1e-9)
    out = place(sim.at(np.clip(times, sim.t0, sim.t)), effects)
    return {c: np.where(known, out[c], np.nan) for c in CHANNELS}


def place(out: dict, effects: list[dict]) -> dict:
    """Positions moved to the antenna."""
    for effect in effects:
        if effect["name"] == "lever-arm":
            c, s = np.cos(out["psi"]), np.sin(out["psi"])
            out["x"] = out["x"] + c * effect["x"] - s * effect["y"]
            out["y"] = out["y"] + s * effect["x"] + c * effect["y"]
            if "u" in effect.get("channels", ()):
                out["u"] = out["u"] - effect["y"] * out["r"]
                out["v"] = out["v"] + effect["x"] * out["r"]
    return out


def wrap(angle):
    """To [-pi, pi)."""
    return (np.asarray(angle) + math.pi) % (2 * math.pi) - math.pi


def record(
    sim, times, sensors=None, rng=None, wrapped=True, executed=False
) -> dict[str, np.ndarray]:
    """t, the channels of `sensors` (default all, exact) and the orders; NaN is missing."""
    t = np.asarray(times, float)
    truth = true_channels(sim, t)
    if sensors is None:
        sensors = dict.fromkeys([c for c in (*CHANNELS, ROLL) if c in truth], Sensor())
    out = {"t": t}
    for channel, sensor in sensors.items():
        value = np.array(truth[channel], float)
        if sensor.noise:
            assert rng is not None
            value = value + sensor.noise * rng.standard_normal(len(t))
        if channel == "psi" and wrapped:
            value = wrap(value)
        if sensor.step:
            value = np.round(value / sensor.step) * sensor.step
        value[np.arange(len(t)) % sensor.every != 0] = np.nan
        out[channel] = value
    prefixes = ("cmd_", "exec_") if executed else ("cmd_",)
    return out | {k: v for k, v in truth.items() if k.startswith(prefixes)}


def write_csv(path, recording: dict[str, np.ndarray]) -> None:
    """One row per sample; a missing sample is an empty field."""
    names = list(recording)
    with Path(path).open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in zip(*recording.values(), strict=True):
            writer.writerow(["" if math.isnan(v) else f"{v:.10g}" for v in row])
