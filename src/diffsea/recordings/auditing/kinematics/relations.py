"""Heading against yaw rate, and position against velocity: comparisons by kinematics alone.

    psi_m(t) = (1 + k) int r_m + b t + A sin psi + B cos psi + L(t) (D sin psi + E cos psi)
    p_m(t)   = (1 + k) int R(psi_m - a - s - A sin psi - B cos psi) nu_m + c t + R(psi) l

with r, nu, psi and p each possibly late, by a constant or a growing delay, L the motors' load as an
estimator of the heading follows it, and s a step. Every
cause is tested with the others present; which of them are there, `selection.select_causes` decides,
and `disagreements` what they mean.
"""

import functools

import numpy as np
from jaxtyping import Float, Inexact
from scipy import ndimage

from diffsea.recordings.auditing.kinematics.comparison import (
    Cause,
    KinematicComparison,
    Parameters,
)
from diffsea.recordings.auditing.kinematics.motor_field import MotorField
from diffsea.recordings.auditing.kinematics.noise import Levels
from diffsea.recordings.motion import MeasuredMotion, knots, refine
from diffsea.series import integrate
from diffsea.trajectory import Samples


_LONGEST_DELAY = 6.0  # s, the longest latency looked for
_STARTS = tuple(sign * late for late in (0.7, 1.4, 2.8, 5.0) for sign in (1, -1))  # s
_FASTEST_DRIFT = 0.1  # s/s, of a clock
_TURN_PER_STEP = 0.03  # rad, of the clock that integrals are taken on
_FEWEST_WINDOWS = 15  # that a comparison needs
_MARGIN = 2.0  # s, at both ends, for delays to reach into
# A heading error periodic in heading is told from a scale of the yaw rate only over a wide
# range of headings (rad); velocities tell it from an offset sooner.
_IRON_RANGE = 2.0
_IRON_RANGE_BY_VELOCITY = 0.5
_LARGEST_IRON = 0.6  # rad
IRON, OF_MOTORS = ("sine", "cosine"), ("motor_sine", "motor_cosine")  # parameters

_NEIGHBOURS = 9  # changes of heading from row to row, among which a jump stands out
_JUMP = 6.0  # times the median change, beyond which heading may have jumped
_SMALLEST_JUMP = np.radians(1.0)

_SMALLEST_SCALE = 0.005  # a sensor is hardly calibrated better
# Parameters of delays, with the channels that are late by each.
DELAYS = {"p_delay": ("x", "y"), "nu_delay": ("u", "v"), "psi_delay": ("psi",)}


def heading_comparison(
    motion: MeasuredMotion, level: float, field: MotorField | None = None
) -> KinematicComparison | None:
    """Measured heading against integrated yaw rate; None where too little is known.

    Parameters: `gain`, `bias` (rad/s), `delay` (s) and its `rate` (s/s) of the yaw rate, and the
    amplitudes `sine` and `cosine` (rad) of a heading error, `motor_sine` and `motor_cosine` of
    what the motors' `field` makes of it. `level` is how improbable by chance a cause must be.
    """
    index, linked = knots(motion, ("psi", "r"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    turned, course = fine.turned, fine.steady_heading
    delay, drift = _smallest_delay(motion)
    causes = (
        Cause("gain", ("gain",), _SMALLEST_SCALE, gain=True),
        Cause("bias", ("bias",), 5e-4),
        Cause("delay", ("delay",), delay, starts=_STARTS),
        Cause("rate", ("rate",), drift, beside=("delay",)),
    )
    if np.ptp(course) > _IRON_RANGE:
        causes += (Cause("iron", IRON, np.radians(1.0)),)
    if field is not None:
        causes += (Cause("motors", OF_MOTORS, np.radians(1.0)),)
        on_fine = functools.partial(np.interp, fine.t, motion.t)
        field = field._replace(sine=on_fine(field.sine), cosine=on_fine(field.cosine))
    ranges = {"gain": (1e-3, 0.9), "bias": (1e-4, 1.0)}
    ranges["delay"], ranges["rate"] = _delay_ranges(motion)
    coarse = integrate(motion.t, motion.values["r"])
    unresolved = float(np.std(coarse - np.interp(motion.t, fine.t, turned)))
    return KinematicComparison(
        motion.t[index],
        motion.values["psi"][None, index],
        functools.partial(_predicted_heading, fine, course, field, motion.t[index]),
        linked,
        causes,
        ranges | dict.fromkeys(IRON + OF_MOTORS, (1e-3, _LARGEST_IRON)),
        doubt=0.02,
        floor=max(np.radians(0.1), unresolved),
        walk=_random_walk(motion, "r"),
        middle=float(fine.t.mean()),
        level=level,
    )


def _predicted_heading(
    fine: MeasuredMotion,
    course: Samples,
    field: MotorField | None,
    at: Float[np.ndarray, "knot"],
    theta: Parameters,
) -> Levels:
    """Heading (rad) at the knots (s) from yaw rate; `course` is one without noise of its own."""
    t = fine.t
    late = theta["delay"] + theta["rate"] * (t - t.mean())
    psi = (1 + theta["gain"]) * integrate(t, np.interp(t + late, t, fine.values["r"]))
    psi = psi + theta["bias"] * t
    psi = psi + theta["sine"] * np.sin(course) + theta["cosine"] * np.cos(course)
    if field is not None:
        psi = psi + field.deviation(theta["motor_sine"], theta["motor_cosine"])
    return np.interp(at, t, psi)[None]


def velocity_comparison(
    motion: MeasuredMotion,
    level: float,
    iron: bool = True,
    psi_late: bool = False,
    jump: float | None = None,
) -> KinematicComparison | None:
    """Measured position against integrated velocity; None where too little is known.

    `jump` is when (s) the heading may have been knocked or reset, None where it runs on. `iron`
    says whether a heading error that is periodic in heading is a candidate: not
    where yaw rate has already answered that. `psi_late` says whether heading was found late
    against yaw rate.

    Parameters: `gain` of the velocity, `angle` (rad) that heading reads too much, and `step` (rad)
    what it reads more since the jump, current `north`
    and `east` (m/s), arm `lever_x` and `lever_y` (m), heading error `sine` and `cosine` (rad), and
    `delay` (s) and its `rate` (s/s) of each of `p` (position), `nu` (velocity) and `psi`.
    """
    index, linked = knots(motion, ("x", "y", "psi", "u", "v"), _MARGIN)
    if np.sum(linked) < _FEWEST_WINDOWS:
        return None
    fine = refine(motion, _TURN_PER_STEP)
    ranges = {"gain": (1e-3, 0.95), "angle": (1e-3, 3.2), "step": (1e-3, 3.2)}
    ranges |= dict.fromkeys(("north", "east"), (1e-3, 1e3))
    ranges |= dict.fromkeys(("sine", "cosine"), (1e-3, _LARGEST_IRON))
    ranges |= dict.fromkeys(("lever_x", "lever_y"), (1e-2, 1e3))
    delay, rate = _delay_ranges(motion)
    ranges |= dict.fromkeys(DELAYS, delay)
    ranges |= dict.fromkeys(("p_rate", "nu_rate", "psi_rate"), rate)
    coarse, path = (integrate(each.t, each.earth_velocity) for each in (motion, fine))
    unresolved = float(np.std(coarse - np.interp(motion.t, fine.t, path)))
    return KinematicComparison(
        motion.t[index],
        np.stack([motion.values["x"], motion.values["y"]])[:, index],
        functools.partial(_predicted_position, fine, motion.t[index], jump),
        linked,
        _velocity_causes(motion, iron, psi_late, jump is not None),
        ranges,
        doubt=0.01,
        floor=max(0.02, unresolved),
        walk=max(_random_walk(motion, "u"), _random_walk(motion, "v")),
        middle=float(fine.t.mean()),
        level=level,
    )


def _predicted_position(
    fine: MeasuredMotion, at: Float[np.ndarray, "knot"], jump: float | None, theta: Parameters
) -> Levels:
    """Position (m) at the knots (s), north then east."""
    t, values = fine.t, fine.values
    past = t - t.mean()
    late = theta["nu_delay"] + theta["nu_rate"] * past
    flow = _advance(t, values["u"] + 1j * values["v"], late)
    psi = _advance(t, values["psi"], theta["psi_delay"] + theta["psi_rate"] * past)
    psi = psi if jump is None else psi - theta["step"] * (t > jump)
    psi = psi - theta["sine"] * np.sin(psi) - theta["cosine"] * np.cos(psi) - theta["angle"]
    turn = np.exp(1j * psi)
    velocity = (1 + theta["gain"]) * flow * turn + theta["north"] + 1j * theta["east"]
    place = integrate(t, velocity) + (theta["lever_x"] + 1j * theta["lever_y"]) * turn
    seen = at - theta["p_delay"] - theta["p_rate"] * (at - t.mean())
    place = np.interp(seen, t, place)
    return np.stack([place.real, place.imag])


def _advance(t: Samples, series: Inexact[np.ndarray, "time"], late: Samples) -> np.ndarray:
    """What the series, real or north + i east, will be `late` s later."""
    return np.interp(t + late, t, series) if np.any(late) else series


def heading_jump(motion: MeasuredMotion) -> float | None:
    """The time (s) of the reading of heading before its largest jump; None where it runs on.

    A jump is what it changes more than yaw rate says, and than it does just before and after. That
    it stays is for the comparison with positions to say.
    """
    if not motion.has("psi"):
        return None
    t, psi = motion.t, motion.values["psi"]
    turned = integrate(t, motion.values["r"]) if motion.has("r") else np.zeros_like(psi)
    change = np.diff(psi - turned)
    change = np.abs(change - ndimage.median_filter(change, _NEIGHBOURS))
    known = motion.known["psi"][1:] & motion.known["psi"][:-1]
    change[~(known & (np.diff(t) < 1.5 * motion.interval))] = 0.0
    row = int(np.argmax(change))
    usual = np.median(change[change > 0]) if np.any(change > 0) else 0.0
    return float(t[row]) if change[row] > max(_JUMP * usual, _SMALLEST_JUMP) else None


def _velocity_causes(
    motion: MeasuredMotion, iron: bool, psi_late: bool, jumps: bool
) -> tuple[Cause, ...]:
    """Why position and velocity may part.

    Sensors are late, never early, and two of the three are as much as kinematics can tell.
    Heading that leads means that position and velocity are late together; heading is late
    alone only if it is so against the yaw rate too.
    """
    values = motion.values
    speed = float(np.sqrt(np.mean(values["u"] ** 2 + values["v"] ** 2)))
    turning = float(np.sqrt(np.mean(np.gradient(values["psi"], motion.t) ** 2))) + 1e-9
    causes = [
        Cause("gain", ("gain",), _SMALLEST_SCALE, gain=True),
        Cause("angle", ("angle",), np.radians(1.0)),
        *([Cause("step", ("step",), _SMALLEST_JUMP)] if jumps else []),
        Cause("water", ("north", "east"), max(0.01, 0.02 * speed)),
        # Large ships turn slowly: what matters is the lever's velocity against the ship's.
        Cause("lever", ("lever_x", "lever_y"), max(0.15, 0.003 * speed / turning)),
    ]
    delay, drift = _smallest_delay(motion)
    likely = {"p": 1, "nu": 1, "psi": 1 if psi_late else -1}
    all_three = (frozenset(DELAYS),)
    for name, sign in likely.items():
        late, rate = f"{name}_delay", f"{name}_rate"
        two_rates = tuple(frozenset({rate, f"{n}_rate"}) for n in likely if n != name)
        causes += [
            Cause(late, (late,), delay, likely=sign, excludes=all_three, starts=_STARTS),
            Cause(rate, (rate,), drift, beside=(late,), excludes=two_rates),
        ]
    if iron and np.ptp(values["psi"]) > _IRON_RANGE_BY_VELOCITY:
        causes.append(Cause("iron", IRON, np.radians(1.5)))
    return tuple(causes)


def _smallest_delay(motion: MeasuredMotion) -> tuple[float, float]:
    """The delay (s) and drift (s/s) below which sampling and differencing do as much."""
    delay = max(0.1, 0.75 * motion.interval)
    return delay, max(1e-3, 2 * delay / motion.duration)


def _delay_ranges(motion: MeasuredMotion) -> tuple[tuple[float, float], tuple[float, float]]:
    """Step and bound of a delay (s), and of its rate (s/s)."""
    shift = max(0.25, motion.interval)
    return (shift, _LONGEST_DELAY), (shift / motion.duration, _FASTEST_DRIFT)


def _random_walk(motion: MeasuredMotion, channel: str) -> float:
    """Variance per second of the integral of a channel's white noise.

    From the median square of its second differences, so that manoeuvres do not count: that of
    normal deviates is 0.455, and their variance is six times that of the noise.
    """
    known = motion.known[channel]
    bend = np.diff(motion.values[channel], 2)[known[1:-1]]
    variance = np.median(bend**2) / (0.455 * 6) if bend.size else 0.0
    return float(variance * motion.interval)
