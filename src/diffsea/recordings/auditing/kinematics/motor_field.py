"""A compass that the current of the motors deflects, behind an estimator of the heading.

The magnetic field of a current is proportional to it, and the current of a motor nearly to its
thrust, whichever way it turns. The deflection changes with heading as that of any field fixed in
the hull does; a heading that is estimated from a compass and a gyro follows it slowly.
"""

from typing import NamedTuple

import numpy as np

from diffsea.channels import steers
from diffsea.pulses import are_pulses, neutral_pulse
from diffsea.recordings.auditing.responses import on_motion_clock
from diffsea.recordings.motion import MeasuredMotion
from diffsea.trajectory import Samples, Trajectory


TIME_CONSTANTS = np.geomspace(1.0, 32.0, 11)  # s, in which an estimator may follow a compass
_LEAST_REST = 0.2  # of the time, at less than half the largest load: else it is like the hull's own


class MotorField(NamedTuple):
    """What a field of one radian, abeam and ahead, does to the heading at a motion's times."""

    sine: Samples
    cosine: Samples
    time_constant: float  # s

    def deviation(self, sine: float, cosine: float) -> Samples:
        """How far (rad) the heading is off by a field of these components (rad)."""
        return sine * self.sine + cosine * self.cosine


def motor_field(trajectory: Trajectory, motion: MeasuredMotion) -> MotorField | None:
    """The field of the motors' load, followed as slowly as explains the heading best.

    By least squares of what heading gains on yaw rate, with a bias of the gyro beside. None where
    the motors seldom rest, or heading or yaw rate was not measured.
    """
    load = _motor_load(trajectory, motion) if motion.has("psi", "r") else None
    if load is None:
        return None
    t, course = motion.t, motion.steady_heading
    gained = motion.values["psi"] - motion.turned

    def misfit(field: MotorField) -> float:
        columns = np.stack([field.sine, field.cosine, t - t.mean(), np.ones_like(t)], axis=1)
        rest = gained - columns @ np.linalg.lstsq(columns, gained, rcond=None)[0]
        return float(np.sum(rest**2))

    return min((_followed(t, course, load, constant) for constant in TIME_CONSTANTS), key=misfit)


def _motor_load(trajectory: Trajectory, motion: MeasuredMotion) -> Samples | None:
    """The motors' mean thrust, whichever way, of its largest in the run; None if they seldom rest.

    Orders count where thrusts were not measured, both from their neutral.
    """
    loads = []
    for name, series in {**trajectory.commanded, **trajectory.executed}.items():
        if not steers(name):
            values = on_motion_clock(trajectory, motion, series)
            neutral = neutral_pulse(values) if are_pulses(values) else 0.0
            loads.append(np.where(values == 0, 0.0, np.abs(values - neutral)))
    if not loads:
        return None
    load = np.mean(loads, axis=0)
    rests = np.mean(load < 0.5 * load.max())
    return load / load.max() if _LEAST_REST <= rests < 1.0 else None


def _followed(t: Samples, course: Samples, load: Samples, time_constant: float) -> MotorField:
    """The field of a load on courses (rad); what was at first, had been so for long."""
    from scipy import signal  # slow to import, and for recordings with motors alone

    left = np.exp(-np.median(np.diff(t)) / time_constant)

    def followed(deflection: Samples) -> Samples:
        return signal.lfilter([1 - left], [1, -left], deflection, zi=[left * deflection[0]])[0]

    sine, cosine = followed(load * np.sin(course)), followed(load * np.cos(course))
    return MotorField(sine, cosine, float(time_constant))
