"""Heading against yaw rate, and position against velocity: the two kinematic comparisons.

    psi_m(t) = (1 + k) int r_m + b t + A sin psi + B cos psi
    p_m(t)   = (1 + k) int R(psi_m - a - A sin psi - B cos psi) nu_m + c t + R(psi) l

with r, nu, psi and p each possibly late, by a constant or a growing delay. Every cause is
tested with the others present; which of them are there, `increments.explain` decides.
"""

import dataclasses

import numpy as np

from .increments import Cause, Comparison


MAX_DELAY = 6.0  # s, the longest latency looked for
_KNOTS = 400  # windows per comparison at most: enough for any standard error wanted here
# A heading error periodic in heading is told from a scale only over a wide range, rad.
_IRON_RANGE = 2.0


@dataclasses.dataclass(frozen=True)
class Motion:
    """Motion channels on one clock, with short gaps bridged and long ones marked.

    `known[channel]` is false in samples that lie in a long gap.
    """

    t: np.ndarray
    values: dict[str, np.ndarray]
    known: dict[str, np.ndarray]

    @property
    def interval(self) -> float:
        """Median sampling interval, s."""
        return float(np.median(np.diff(self.t)))

    def has(self, *channels: str) -> bool:
        """Whether all these channels have enough samples to work with."""
        return all(np.sum(self.known[channel]) >= 20 for channel in channels)

    def replaced(self, **values: np.ndarray) -> "Motion":
        """The same motion with some channels changed."""
        return dataclasses.replace(self, values=self.values | values)


def bridged(t: np.ndarray, series: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """The series with gaps interpolated, and which samples lie in no gap above `longest` s."""
    finite = np.isfinite(series)
    if np.sum(finite) < 2:
        return np.zeros_like(t), np.zeros(t.shape, dtype=bool)
    times = t[finite]
    after = np.searchsorted(times, t, side="left").clip(0, times.size - 1)
    before = (np.searchsorted(times, t, side="right") - 1).clip(0, times.size - 1)
    near = (times[after] - times[before] <= longest) & (t >= times[0]) & (t <= times[-1])
    return np.interp(t, times, series[finite]), near


def knots(motion: Motion, channels: tuple[str, ...], margin: float) -> tuple[np.ndarray, ...]:
    """Indices of the knots, and which windows between them are wholly known."""
    t = motion.t
    window = max(2 * motion.interval, (t[-1] - t[0]) / _KNOTS)
    margin = min(margin, 0.05 * (t[-1] - t[0]))
    marks = np.arange(t[0] + margin, t[-1] - margin, window)
    index = np.unique(np.searchsorted(t, marks).clip(0, t.size - 1))
    unknown = ~np.all([motion.known[channel] for channel in channels], axis=0)
    lost = np.concatenate([[0], np.cumsum(unknown)])
    linked = lost[index[1:] + 1] == lost[index[:-1]]
    return index, linked


def integral(t: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Cumulative trapezoidal integral along the last axis, starting at zero."""
    steps = 0.5 * (series[..., 1:] + series[..., :-1]) * np.diff(t)
    return np.concatenate([np.zeros((*series.shape[:-1], 1)), np.cumsum(steps, axis=-1)], -1)


def _smoothed(motion: Motion, series: np.ndarray, seconds: float) -> np.ndarray:
    """Moving average over about `seconds`, by samples, shortened at the ends."""
    half = int(round(0.5 * seconds / motion.interval))
    total = np.concatenate([[0.0], np.cumsum(series)])
    index = np.arange(series.size)
    first, last = (index - half).clip(0), (index + half + 1).clip(None, series.size)
    return (total[last] - total[first]) / (last - first)


def smallest_delay(motion: Motion) -> float:
    """Delays below this (s) are within what sampling and differencing do anyway."""
    return max(0.1, 0.75 * motion.interval)


def heading_comparison(motion: Motion) -> Comparison | None:
    """Measured heading against integrated yaw rate; None where too little is known."""
    index, linked = knots(motion, ("psi", "r"), 2.0)
    if np.sum(linked) < 15:
        return None
    t, psi, r = motion.t, motion.values["psi"], motion.values["r"]
    middle, duration = t.mean(), t[-1] - t[0]
    # Its noise must not stand on both sides, or a compass error would explain it.
    course = integral(t, r) + _smoothed(motion, psi - integral(t, r), 10.0)

    def predict(theta: dict[str, float]) -> np.ndarray:
        late = theta["delay"] + theta["rate"] * (t - middle)
        turned = (1 + theta["gain"]) * integral(t, np.interp(t + late, t, r))
        iron = theta["sine"] * np.sin(course) + theta["cosine"] * np.cos(course)
        return (turned + theta["bias"] * t + iron)[None, index]

    delay = smallest_delay(motion)
    causes = (
        Cause("gain", ("gain",), 0.03, gain=True),
        Cause("bias", ("bias",), 5e-4),
        Cause("delay", ("delay",), delay),
        Cause("rate", ("rate",), max(1e-3, 2 * delay / duration)),
    )
    if np.ptp(course) > _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.0)),)
    steps = {"gain": 1e-3, "bias": 1e-4, "delay": max(0.05, motion.interval)}
    steps |= {"rate": steps["delay"] / duration, "sine": 1e-3, "cosine": 1e-3}
    bounds = dict(gain=0.9, bias=1.0, delay=MAX_DELAY, rate=0.1, sine=0.6, cosine=0.6)
    return Comparison(t[index], psi[None, index], predict, linked, causes, steps, bounds)


def velocity_comparison(motion: Motion, iron: bool) -> Comparison | None:
    """Measured position against integrated velocity; None where too little is known.

    `iron` says whether a heading error that is periodic in heading is a candidate: not
    where yaw rate has already answered that.
    """
    index, linked = knots(motion, ("x", "y", "psi", "u", "v"), 2.0)
    if np.sum(linked) < 15:
        return None
    t = motion.t
    x, y, psi, u, v = (motion.values[name] for name in ("x", "y", "psi", "u", "v"))
    middle, duration = t.mean(), t[-1] - t[0]

    def predict(theta: dict[str, float]) -> np.ndarray:
        past = t - middle
        late = theta["nu_delay"] + theta["nu_rate"] * past
        surge, sway = np.interp(t + late, t, u), np.interp(t + late, t, v)
        heading = np.interp(t + theta["psi_delay"] + theta["psi_rate"] * past, t, psi)
        heading = heading - theta["sine"] * np.sin(heading) - theta["cosine"] * np.cos(heading)
        cosine, sine = np.cos(heading - theta["angle"]), np.sin(heading - theta["angle"])
        north = (1 + theta["gain"]) * (surge * cosine - sway * sine) + theta["north"]
        east = (1 + theta["gain"]) * (surge * sine + sway * cosine) + theta["east"]
        lever_x = theta["lever_x"] * cosine - theta["lever_y"] * sine
        lever_y = theta["lever_x"] * sine + theta["lever_y"] * cosine
        levels = integral(t, np.stack([north, east])) + np.stack([lever_x, lever_y])
        seen = t - theta["p_delay"] - theta["p_rate"] * past
        return np.stack([np.interp(seen[index], t, level) for level in levels])

    speed = float(np.sqrt(np.mean((u**2 + v**2)[motion.known["u"]])))
    delay, drift = smallest_delay(motion), max(1e-3, 2 * smallest_delay(motion) / duration)
    delays = frozenset({"p_delay", "nu_delay", "psi_delay"})
    rates = frozenset({"p_rate", "nu_rate", "psi_rate"})
    pairs = [frozenset(pair) for group in (delays, rates) for pair in _pairs(group)]
    causes = (
        Cause("gain", ("gain",), 0.02, gain=True),
        Cause("angle", ("angle",), np.radians(1.0)),
        Cause("water", ("north", "east"), max(0.01, 0.02 * speed)),
        Cause("lever", ("lever_x", "lever_y"), 0.1),
        *(Cause(name, (name,), delay, excludes=tuple(pairs[:3])) for name in sorted(delays)),
        *(Cause(name, (name,), drift, excludes=tuple(pairs[3:])) for name in sorted(rates)),
    )
    if iron and np.ptp(psi) > _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.5)),)
    shift = max(0.05, motion.interval)
    steps = dict(gain=1e-3, angle=1e-3, north=1e-3, east=1e-3, lever_x=1e-2, lever_y=1e-2)
    steps |= dict.fromkeys(sorted(delays), shift) | dict.fromkeys(sorted(rates), shift / duration)
    steps |= {"sine": 1e-3, "cosine": 1e-3}
    bounds = dict(gain=0.95, angle=3.2, north=20.0, east=20.0, lever_x=200.0, lever_y=200.0)
    bounds |= dict.fromkeys(delays, MAX_DELAY) | dict.fromkeys(rates, 0.1)
    bounds |= {"sine": 0.6, "cosine": 0.6}
    return Comparison(t[index], np.stack([x, y])[:, index], predict, linked, causes, steps, bounds)


def _pairs(names: frozenset[str]) -> list[set[str]]:
    first, second, third = sorted(names)
    return [{first, second}, {first, third}, {second, third}]
