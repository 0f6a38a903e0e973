"""From order to motion: what was commanded, what was executed, and does the motion agree?

The checks of Rezayan (2026, sect. 4.3), each with a verdict: the ratio of executed to
commanded steering, recorded against reconstructed yaw rate, time steps, and how much the
actuators were at work. What cannot be checked is said to be "not checked", never sound.
"""

import dataclasses
import math

import numpy as np

from diffsea.segments.segments import Segment
from diffsea.segments.signals import MEASURED, Signals, signals_of
from diffsea.segments.spans import SegmentSettings
from diffsea.series import integrate
from diffsea.statistics import noise_scale
from diffsea.trajectory import Samples, Trajectory
from diffsea.vessel.base import Vessel


SOUND, DOUBTFUL, UNCHECKED = "sound", "doubtful", "not checked"
_RATIO_ERROR = 0.1  # executed over commanded steering may differ from one by this, and scatter
_NEW_SHARE = 0.05  # of the rows with an order may be the first of one, to be left out
_SAME_YAW_RATE = 0.95  # correlation of recorded and reconstructed yaw rate
_YAW_RATE_ERROR = 0.2  # of its own size, rms; in any case three times its noise
_OFF_STEP = 0.5  # of the median time step, by which a step is off
_OFF_SHARE = 0.01  # of the steps may be off
_AT_LIMIT = 0.98  # of a limit counts as saturated
_SATURATED_SHARE = 0.1  # of the time an actuator may be at a limit
_MISSING_SHARE = 0.01  # of an actuator's samples may be missing


@dataclasses.dataclass(frozen=True)
class Check:
    """One check of a segment.

    Attributes:
        numbers: by name, in SI units and rad.
        verdict: `SOUND`, `DOUBTFUL` or `UNCHECKED`.
        why: what the verdict rests on, in words.
    """

    name: str
    numbers: dict[str, float]
    verdict: str
    why: str


def traceability(
    segment: Segment,
    run: Trajectory,
    vessel: Vessel | None = None,
    settings: SegmentSettings | None = None,
) -> list[Check]:
    """The checks of a segment of a recording, from its onset to its end.

    `actuation`, `yaw-rate`, `time-step`, and `duty-cycle of <channel>` for every actuator
    channel. A vessel gives the limits of actuators and reconstructs executed ones.

    Raises:
        UserError: the recording has neither heading nor yaw rate, or hardly a row.
    """
    return checks_of(signals_of(run, vessel), segment, vessel, settings)


def checks_of(
    signals: Signals,
    segment: Segment,
    vessel: Vessel | None,
    settings: SegmentSettings | None = None,
) -> list[Check]:
    """The checks of a segment of a recording whose signals are at hand."""
    settings = SegmentSettings() if settings is None else settings
    rows = signals.rows(segment.onset, segment.end)
    whole = signals.rows(segment.start, segment.end)
    channels = dict.fromkeys([*signals.run.executed, *signals.run.commanded])
    return [
        _check_actuation(signals, segment, rows, settings),
        _check_yaw_rate(signals, whole),
        _check_time_steps(signals.t[whole]),
        *(_check_duty_cycle(signals.run, name, rows, vessel, settings) for name in channels),
    ]


def _check_actuation(
    signals: Signals, segment: Segment, rows: slice, settings: SegmentSettings
) -> Check:
    """Ratio of executed to commanded steering while it is ordered, and how late it began."""
    if signals.commanded is None or signals.steer is None:
        missing = "steering" if signals.steer is None else "steering order"
        return Check("actuation", {}, UNCHECKED, f"no {missing} was recorded")
    commanded, executed = signals.commanded[rows], signals.steer[rows]
    numbers = {"commanded": _rms(commanded), "executed": _rms(executed)}
    numbers["delay"] = segment.onset - segment.ordered
    active = np.abs(commanded) > settings.order
    if np.sum(active) < 5:
        return Check("actuation", numbers, UNCHECKED, "hardly any steering was ordered")
    # In the row of a new order what it replaced is still being executed, however quick the gear.
    # Where such rows are many, they are too long for that to be no delay.
    changes = np.diff(signals.commanded, prepend=signals.commanded[0])[rows]
    new = active & (np.abs(changes) > settings.order)
    if np.sum(new) <= _NEW_SHARE * np.sum(active):
        active &= ~new
    ratio = executed[active] / commanded[active]
    mean, spread = float(np.mean(ratio)), float(np.std(ratio))
    numbers |= {"ratio": mean, "ratio_spread": spread}
    if signals.origin != MEASURED:
        why = f"executed steering is {signals.origin}, not measured, so the ratio proves nothing"
        return Check("actuation", numbers, UNCHECKED, why)
    faults = []
    if abs(mean - 1) > _RATIO_ERROR:
        faults.append(f"{mean:.2f} of the order is executed on average")
    if spread > _RATIO_ERROR:
        faults.append(f"the ratio scatters by {spread:.2f}: orders are reached late or not at all")
    why = "; ".join(faults) or f"{mean:.2f} of the order is executed, within {spread:.2f}"
    return Check("actuation", numbers, DOUBTFUL if faults else SOUND, why)


def _check_yaw_rate(signals: Signals, rows: slice) -> Check:
    """Recorded yaw rate, averaged over short spans, against the change of heading over them.

    The spans are so long that the noise of heading is no more than a twentieth of the yaw rate.
    """
    run = signals.run
    if not (run.has("psi") and run.has("r")):
        absent = "heading" if run.has("r") else "yaw rate"
        return Check("yaw-rate", {}, UNCHECKED, f"{absent} was not recorded")
    t, psi, r = signals.t[rows], signals.psi[rows], signals.r[rows]
    size = max(float(np.std(r)), 1e-12)
    needed = math.sqrt(2) * noise_scale(psi) / (0.05 * size * signals.interval)
    span = int(np.clip(math.ceil(needed), 2, max(2, len(psi) // 20)))
    if len(t) < 5 * span:
        return Check("yaw-rate", {}, UNCHECKED, "the segment is too short")
    duration = t[span:] - t[:-span]
    turned = integrate(t, r)
    recorded = (turned[span:] - turned[:-span]) / duration
    rebuilt = (psi[span:] - psi[:-span]) / duration
    noise = math.hypot(
        noise_scale(r) / math.sqrt(span),
        math.sqrt(2) * noise_scale(psi) / float(np.median(duration)),
    )
    size = float(np.std(rebuilt))
    alike = float(np.corrcoef(recorded, rebuilt)[0, 1]) if min(size, np.std(recorded)) > 0 else 0.0
    rms, bias = _rms(recorded - rebuilt), float(np.mean(recorded - rebuilt))
    numbers = {"correlation": alike, "rms": rms, "bias": bias, "noise": noise}
    allowed = max(_YAW_RATE_ERROR * size, 3 * noise)
    error = f"{math.degrees(rms):.3g}"
    if rms > allowed:
        limit = f"{math.degrees(allowed):.3g}"
        why = f"they differ by {error} deg/s where {limit} would do: look at the audit"
        return Check("yaw-rate", numbers, DOUBTFUL, why)
    if alike < _SAME_YAW_RATE and size > 5 * noise:
        why = f"they correlate by {alike:.3f} only: one may be late"
        return Check("yaw-rate", numbers, DOUBTFUL, why)
    why = f"correlation {alike:.3f}, difference {error} deg/s over {span} steps"
    return Check("yaw-rate", numbers, SOUND, why)


def _check_time_steps(t: Samples) -> Check:
    steps = np.diff(t)
    usual = float(np.median(steps))
    off = float(np.mean(np.abs(steps - usual) > _OFF_STEP * usual))
    numbers = {"median": usual, "worst": float(np.max(steps)), "share_off": off}
    if off > _OFF_SHARE or numbers["worst"] > 3 * usual:
        why = f"{off:.1%} of the steps are off, the worst is {numbers['worst']:.3g} s"
        return Check("time-step", numbers, DOUBTFUL, why)
    return Check("time-step", numbers, SOUND, f"{usual:.3g} s, {off:.1%} of the steps are off")


def _check_duty_cycle(
    run: Trajectory, channel: str, rows: slice, vessel: Vessel | None, settings: SegmentSettings
) -> Check:
    """How much an actuator is at work and at its limits; executed where it was measured."""
    measured = channel in run.executed
    kind = "executed" if measured else "commanded"
    series = np.asarray((run.executed if measured else run.commanded)[channel], float)
    known = np.isfinite(series[rows])
    title = f"duty-cycle of {channel}"
    if not known.any():
        return Check(title, {"missing": 1.0}, UNCHECKED, "no value in the segment")
    values = series[rows][known]
    servo = None if vessel is None else vessel.servos.get(channel)
    neutral = 0.0 if servo is None or servo.neutral is None else float(servo.neutral)
    series, values = series - neutral, values - neutral
    largest = max(float(np.nanmax(np.abs(series))), 1e-12)
    working = float(np.mean(np.abs(values) > settings.idle * largest))
    numbers = {"working": working, "missing": float(np.mean(~known))}
    if numbers["missing"] > _MISSING_SHARE:
        why = f"{numbers['missing']:.0%} of the {kind} values are missing"
        return Check(title, numbers, DOUBTFUL, why)
    if servo is None or servo.lower is None or servo.upper is None:
        why = f"{kind}; at work {working:.0%} of the time, its limits are not known"
        return Check(title, numbers, UNCHECKED, why)
    at_upper = values >= _AT_LIMIT * (float(servo.upper) - neutral)
    at_limit = at_upper | (values <= _AT_LIMIT * (float(servo.lower) - neutral))
    numbers["saturated"] = share = float(np.mean(at_limit))
    why = f"{kind}; at work {working:.0%}, at a limit {share:.0%} of the time"
    return Check(title, numbers, DOUBTFUL if share > _SATURATED_SHARE else SOUND, why)


def _rms(values: Samples) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan
