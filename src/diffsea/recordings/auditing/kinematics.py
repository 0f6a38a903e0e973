"""Heading against yaw rate, and position against velocity: the two kinematic comparisons.

    psi_m(t) = (1 + k) int r_m + b t + A sin psi + B cos psi
    p_m(t)   = (1 + k) int R(psi_m - a - A sin psi - B cos psi) nu_m + c t + R(psi) l

with r, nu, psi and p each possibly late, by a constant or a growing delay. Every cause is
tested with the others present; which of them are there, `causes.select_causes` decides.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Inexact

from diffsea.recordings.auditing.causes import Cause, KinematicComparison, Levels, Parameters
from diffsea.recordings.motion import MeasuredMotion, knots, refine
from diffsea.series import integrate
from diffsea.trajectory import Samples


_LONGEST_DELAY = 6.0  # s, the longest latency looked for
_STARTS = tuple(sign * late for late in (0.7, 1.4, 2.8, 5.0) for sign in (1, -1))  # s
_FASTEST_DRIFT = 0.1  # s/s, of a clock
_TURN_PER_STEP = 0.03  # rad, of the clock that integrals are taken on
_FEWEST_WINDOWS = 15  # that a comparison needs
_MARGIN = 2.0  # s, at both ends, for delays to reach into
_MEMORY = 10.0  # s over which heading is averaged to lose its own noise
# A heading error periodic in heading is told from a scale of the yaw rate only over a wide
# range of headings (rad); velocities tell it from an offset sooner.
_IRON_RANGE = 2.0
_IRON_RANGE_BY_VELOCITY = 0.5
_LARGEST_IRON = 0.6  # rad


def heading_comparison(motion: MeasuredMotion, level: float) -> KinematicComparison | None:
    """Measured heading against integrated yaw rate; None where too little is known."""
    index, linked = knots(motion, ("psi", "r"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    turned = _integrated_yaw_rate(fine)
    # A heading without its own noise, which must not stand on both sides of the comparison, or
    # a compass error would explain it.
    course = turned + _moving_average(fine.values["psi"] - turned, int(_MEMORY / fine.interval))
    delay, drift = _smallest_delay(motion)
    causes = (
        Cause("gain", ("gain",), 0.03, gain=True),
        Cause("bias", ("bias",), 5e-4),
        Cause("delay", ("delay",), delay, starts=_STARTS),
        Cause("rate", ("rate",), drift, beside=("delay",)),
    )
    if np.ptp(course) > _IRON_RANGE:
        causes += (Cause("iron", ("sine", "cosine"), np.radians(1.0)),)
    shift = max(0.25, motion.interval)
    steps = {"gain": 1e-3, "bias": 1e-4, "delay": shift, "rate": shift / _duration(motion)}
    bounds = {"gain": 0.9, "bias": 1.0, "delay": _LONGEST_DELAY, "rate": _FASTEST_DRIFT}
    return KinematicComparison(
        motion.t[index],
        motion.values["psi"][None, index],
        PredictedHeading(fine.t, fine.values["r"], course, motion.t[index]),
        linked,
        causes,
        steps | {"sine": 1e-3, "cosine": 1e-3},
        bounds | {"sine": _LARGEST_IRON, "cosine": _LARGEST_IRON},
        doubt=0.02,
        floor=max(np.radians(0.1), _unresolved(motion, fine, _integrated_yaw_rate)),
        walk=_random_walk(motion, "r"),
        middle=float(fine.t.mean()),
        level=level,
    )


@dataclasses.dataclass(frozen=True)
class PredictedHeading:
    """Heading (rad) at the knots from yaw rate, by the parameters of `heading_comparison`.

    `course` is a heading without its own noise, for the error that is periodic in heading.
    """

    t: Samples
    r: Samples
    course: Samples
    knots: Float[np.ndarray, "knot"]  # s

    def __call__(self, theta: Parameters) -> Levels:
        t = self.t
        late = theta["delay"] + theta["rate"] * (t - t.mean())
        psi = (1 + theta["gain"]) * integrate(t, np.interp(t + late, t, self.r))
        psi = psi + theta["bias"] * t
        psi = psi + theta["sine"] * np.sin(self.course) + theta["cosine"] * np.cos(self.course)
        return np.interp(self.knots, t, psi)[None]


def velocity_comparison(
    motion: MeasuredMotion, level: float, iron: bool = True, psi_late: bool = False
) -> KinematicComparison | None:
    """Measured position against integrated velocity; None where too little is known.

    `iron` says whether a heading error that is periodic in heading is a candidate: not
    where yaw rate has already answered that. `psi_late` says whether heading was found late
    against yaw rate.
    """
    index, linked = knots(motion, ("x", "y", "psi", "u", "v"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    delays, drifts = ("p_delay", "nu_delay", "psi_delay"), ("p_rate", "nu_rate", "psi_rate")
    shift = max(0.25, motion.interval)
    steps = dict.fromkeys(("gain", "angle", "north", "east", "sine", "cosine"), 1e-3)
    steps |= {"lever_x": 1e-2, "lever_y": 1e-2}
    steps |= dict.fromkeys(delays, shift) | dict.fromkeys(drifts, shift / _duration(motion))
    bounds = dict.fromkeys(steps, 1e3) | {"gain": 0.95, "angle": 3.2}
    bounds |= dict.fromkeys(delays, _LONGEST_DELAY) | dict.fromkeys(drifts, _FASTEST_DRIFT)
    return KinematicComparison(
        motion.t[index],
        np.stack([motion.values["x"], motion.values["y"]])[:, index],
        PredictedPosition(fine.t, fine.values, motion.t[index]),
        linked,
        _velocity_causes(motion, iron, psi_late),
        steps,
        bounds | {"sine": _LARGEST_IRON, "cosine": _LARGEST_IRON},
        doubt=0.01,
        floor=max(0.02, _unresolved(motion, fine, _integrated_velocity)),
        walk=max(_random_walk(motion, "u"), _random_walk(motion, "v")),
        middle=float(fine.t.mean()),
        level=level,
    )


@dataclasses.dataclass(frozen=True)
class PredictedPosition:
    """Position (m) at the knots, north then east, by the parameters of `velocity_comparison`."""

    t: Samples
    values: dict[str, Samples]
    knots: Float[np.ndarray, "knot"]  # s

    def __call__(self, theta: Parameters) -> Levels:
        t = self.t
        past = t - t.mean()
        late = theta["nu_delay"] + theta["nu_rate"] * past
        flow = _advance(t, self.values["u"] + 1j * self.values["v"], late)
        psi = _advance(t, self.values["psi"], theta["psi_delay"] + theta["psi_rate"] * past)
        psi = psi - theta["sine"] * np.sin(psi) - theta["cosine"] * np.cos(psi) - theta["angle"]
        turn = np.exp(1j * psi)
        velocity = (1 + theta["gain"]) * flow * turn + theta["north"] + 1j * theta["east"]
        place = integrate(t, velocity) + (theta["lever_x"] + 1j * theta["lever_y"]) * turn
        seen = self.knots - theta["p_delay"] - theta["p_rate"] * (self.knots - t.mean())
        place = np.interp(seen, t, place)
        return np.stack([place.real, place.imag])


def _advance(t: Samples, series: Inexact[np.ndarray, "time"], late: Samples) -> np.ndarray:
    """What the series, real or north + i east, will be `late` s later."""
    return np.interp(t + late, t, series) if np.any(late) else series


def _velocity_causes(motion: MeasuredMotion, iron: bool, psi_late: bool) -> tuple[Cause, ...]:
    """Why position and velocity may part.

    Sensors are late, never early, and two of the three are as much as kinematics can tell.
    Heading that leads means that position and velocity are late together; heading is late
    alone only if it is so against the yaw rate too.
    """
    values = motion.values
    speed = float(np.sqrt(np.mean(values["u"] ** 2 + values["v"] ** 2)))
    turning = float(np.sqrt(np.mean(np.gradient(values["psi"], motion.t) ** 2))) + 1e-9
    causes = [
        Cause("gain", ("gain",), 0.02, gain=True),
        Cause("angle", ("angle",), np.radians(1.0)),
        Cause("water", ("north", "east"), max(0.01, 0.02 * speed)),
        # Large ships turn slowly: what matters is the lever's velocity against the ship's.
        Cause("lever", ("lever_x", "lever_y"), max(0.15, 0.003 * speed / turning)),
    ]
    delay, drift = _smallest_delay(motion)
    likely = {"p": 1, "nu": 1, "psi": 1 if psi_late else -1}
    all_three = (frozenset(f"{name}_delay" for name in likely),)
    for name, sign in likely.items():
        late, rate = f"{name}_delay", f"{name}_rate"
        two_rates = tuple(frozenset({rate, f"{n}_rate"}) for n in likely if n != name)
        causes += [
            Cause(late, (late,), delay, likely=sign, excludes=all_three, starts=_STARTS),
            Cause(rate, (rate,), drift, beside=(late,), excludes=two_rates),
        ]
    if iron and np.ptp(values["psi"]) > _IRON_RANGE_BY_VELOCITY:
        causes.append(Cause("iron", ("sine", "cosine"), np.radians(1.5)))
    return tuple(causes)


def _duration(motion: MeasuredMotion) -> float:
    return float(motion.t[-1] - motion.t[0])


def _smallest_delay(motion: MeasuredMotion) -> tuple[float, float]:
    """The delay (s) and drift (s/s) below which sampling and differencing do as much."""
    delay = max(0.1, 0.75 * motion.interval)
    return delay, max(1e-3, 2 * delay / _duration(motion))


def _moving_average(series: Samples, width: int) -> Samples:
    """Mean over about `width` samples, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    index = np.arange(series.size)
    first = (index - width // 2).clip(0)
    last = (index + width // 2 + 1).clip(None, series.size)
    return (total[last] - total[first]) / (last - first)


def _integrated_yaw_rate(motion: MeasuredMotion) -> Samples:
    return integrate(motion.t, motion.values["r"])


def _integrated_velocity(motion: MeasuredMotion) -> np.ndarray:
    """Way made good, north + i east (m)."""
    values = motion.values
    return integrate(motion.t, (values["u"] + 1j * values["v"]) * np.exp(1j * values["psi"]))


def _unresolved(
    motion: MeasuredMotion,
    fine: MeasuredMotion,
    integrated: Callable[[MeasuredMotion], np.ndarray],
) -> float:
    """How far (root mean square) an integral on the two clocks parts.

    What happens between the samples is known no better than that.
    """
    parting = integrated(motion) - np.interp(motion.t, fine.t, integrated(fine))
    return float(np.std(parting))


def _random_walk(motion: MeasuredMotion, channel: str) -> float:
    """Variance per second of the integral of a channel's white noise.

    From the median square of its second differences, so that manoeuvres do not count: that of
    normal deviates is 0.455, and their variance is six times that of the noise.
    """
    known = motion.known[channel]
    bend = np.diff(motion.values[channel], 2)[known[1:-1]]
    variance = np.median(bend**2) / (0.455 * 6) if bend.size else 0.0
    return float(variance * motion.interval)
