"""Heading against yaw rate, and position against velocity: the two kinematic comparisons.

    psi_m(t) = (1 + k) int r_m + b t + A sin psi + B cos psi
    p_m(t)   = (1 + k) int R(psi_m - a - A sin psi - B cos psi) nu_m + c t + R(psi) l

with r, nu, psi and p each possibly late, by a constant or a growing delay. Every cause is
tested with the others present; which of them are there, `increments.explain` decides.
"""

import numpy as np

from .increments import Cause, Comparison
from .motion import Motion, integral, knots


MAX_DELAY = 6.0  # s, the longest latency looked for
# A heading error periodic in heading is told from a scale only over a wide range, rad.
_IRON_RANGE = 2.0


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
        Cause("rate", ("rate",), max(1e-3, 2 * delay / duration), beside=("delay",)),
    )
    if np.ptp(course) > _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.0)),)
    steps = {"gain": 1e-3, "bias": 1e-4, "delay": max(0.25, motion.interval)}
    steps |= {"rate": steps["delay"] / duration, "sine": 1e-3, "cosine": 1e-3}
    bounds = dict(gain=0.9, bias=1.0, delay=MAX_DELAY, rate=0.1, sine=0.6, cosine=0.6)
    return Comparison(t[index], psi[None, index], predict, linked, causes, steps, bounds, 0.02)


def velocity_comparison(
    motion: Motion, iron: bool = True, psi_late: bool = False
) -> Comparison | None:
    """Measured position against integrated velocity; None where too little is known.

    `iron` says whether a heading error that is periodic in heading is a candidate: not
    where yaw rate has already answered that. `psi_late` says whether heading was found late
    against yaw rate.
    """
    index, linked = knots(motion, ("x", "y", "psi", "u", "v"), 2.0)
    if np.sum(linked) < 15:
        return None
    x, y, psi, u, v = (motion.values[name] for name in ("x", "y", "psi", "u", "v"))
    t, knot_times = _finer(motion), motion.t[index]
    psi, u, v = (np.interp(t, motion.t, series) for series in (psi, u, v))
    middle, duration = t.mean(), t[-1] - t[0]

    def predict(theta: dict[str, float]) -> np.ndarray:
        past = t - middle
        late = theta["nu_delay"] + theta["nu_rate"] * past
        surge = np.interp(t + late, t, u)
        sway = (1 + theta["sway"]) * np.interp(t + late, t, v)
        heading = np.interp(t + theta["psi_delay"] + theta["psi_rate"] * past, t, psi)
        heading = heading - theta["sine"] * np.sin(heading) - theta["cosine"] * np.cos(heading)
        cosine, sine = np.cos(heading - theta["angle"]), np.sin(heading - theta["angle"])
        north = (1 + theta["gain"]) * (surge * cosine - sway * sine) + theta["north"]
        east = (1 + theta["gain"]) * (surge * sine + sway * cosine) + theta["east"]
        lever_x = theta["lever_x"] * cosine - theta["lever_y"] * sine
        lever_y = theta["lever_x"] * sine + theta["lever_y"] * cosine
        levels = integral(t, np.stack([north, east])) + np.stack([lever_x, lever_y])
        seen = knot_times - theta["p_delay"] - theta["p_rate"] * (knot_times - middle)
        return np.stack([np.interp(seen, t, level) for level in levels])

    speed = float(np.sqrt(np.mean(u**2 + v**2)))
    turning = float(np.sqrt(np.mean(np.gradient(psi, t) ** 2))) + 1e-9
    lever = max(0.15, 0.003 * speed / turning)
    delay, drift = smallest_delay(motion), max(1e-3, 2 * smallest_delay(motion) / duration)
    causes = (
        Cause("gain", ("gain",), 0.02, gain=True),
        Cause("angle", ("angle",), np.radians(1.0)),
        Cause("water", ("north", "east"), max(0.01, 0.02 * speed)),
        Cause("lever", ("lever_x", "lever_y"), lever),
        # Less than a change of sign is the attenuation of a noisy, mostly small channel.
        Cause("sway", ("sway",), 1.4),
        *_delay_causes(delay, drift, psi_late),
    )
    if iron and np.ptp(psi) > 0.25 * _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.5)),)
    shift = max(0.25, motion.interval)
    steps = dict(gain=1e-3, angle=1e-3, north=1e-3, east=1e-3, lever_x=1e-2, lever_y=1e-2)
    delays, rates = ("p_delay", "nu_delay", "psi_delay"), ("p_rate", "nu_rate", "psi_rate")
    steps |= dict.fromkeys(delays, shift) | dict.fromkeys(rates, shift / duration)
    steps |= {"sine": 1e-3, "cosine": 1e-3, "sway": 1e-2}
    bounds = dict(gain=0.95, angle=3.2, north=20.0, east=20.0, lever_x=200.0, lever_y=200.0)
    bounds |= dict.fromkeys(delays, MAX_DELAY) | dict.fromkeys(rates, 0.1)
    bounds |= {"sine": 0.6, "cosine": 0.6, "sway": 4.0}
    return Comparison(
        knot_times, np.stack([x, y])[:, index], predict, linked, causes, steps, bounds, 0.01
    )


def _delay_causes(delay: float, drift: float, psi_late: bool) -> tuple[Cause, ...]:
    """Latencies and drifting clocks of position, velocity and heading.

    Sensors are late, never early, and two of the three are as much as kinematics can tell.
    Heading that leads means that position and velocity are late together; heading is late
    alone only if it is so against the yaw rate too.
    """
    likely = {"p": 1, "nu": 1, "psi": 1 if psi_late else -1}
    pairs = [("p", "nu"), ("p", "psi"), ("nu", "psi")]
    causes = []
    for name, sign in likely.items():
        late, rate = f"{name}_delay", f"{name}_rate"
        others = [{f"{other}_delay" for other in pair} for pair in pairs if name not in pair]
        groups = tuple(frozenset(other | {late}) for other in others)
        causes.append(Cause(late, (late,), delay, likely=sign, excludes=groups))
        rates = tuple(frozenset({rate, f"{other}_rate"}) for other in likely if other != name)
        causes.append(Cause(rate, (rate,), drift, beside=(late,), excludes=rates))
    return tuple(causes)


def _smoothed(motion: Motion, series: np.ndarray, seconds: float) -> np.ndarray:
    """Moving average over about `seconds`, by samples, shortened at the ends."""
    half = int(round(0.5 * seconds / motion.interval))
    total = np.concatenate([[0.0], np.cumsum(series)])
    index = np.arange(series.size)
    first, last = (index - half).clip(0), (index + half + 1).clip(None, series.size)
    return (total[last] - total[first]) / (last - first)


def _finer(motion: Motion) -> np.ndarray:
    """A time axis on which the heading turns by less than about 3 degrees per step.

    Velocity is rotated before it is integrated; with coarser steps the chord of the turn
    would pass for a lever arm.
    """
    turn = np.abs(np.diff(motion.values["psi"]))
    parts = int(np.clip(np.ceil(np.percentile(turn, 95) / 0.05), 1, 10))
    fractions = np.arange(parts) / parts
    fine = motion.t[:-1, None] + np.diff(motion.t)[:, None] * fractions
    return np.append(fine.ravel(), motion.t[-1])
