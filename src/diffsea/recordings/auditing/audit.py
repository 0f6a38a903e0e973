"""The audit: is a recording consistent with itself, before any physics is blamed?

Every label, unit, frame, sign and clock is a hypothesis, tested from kinematics alone:
heading is the integral of yaw rate, position that of velocity turned by heading, and
actuators act the way their names say. Faults are put right in passing, so that what comes
after is not misled by what was found before; the recording itself is never changed.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from diffsea.recordings.auditing.actuators import actuation_findings, order_findings
from diffsea.recordings.auditing.axes import AxesEvidence
from diffsea.recordings.auditing.costs import cost
from diffsea.recordings.auditing.edits import Affine
from diffsea.recordings.auditing.finding import KINDS, Finding, finding_of
from diffsea.recordings.auditing.frames import read_frames
from diffsea.recordings.auditing.kinematics.disagreements import (
    HeadingSource,
    disagreement_findings,
)
from diffsea.recordings.auditing.kinematics.motor_field import MotorField, motor_field
from diffsea.recordings.auditing.kinematics.relations import (
    heading_comparison,
    heading_jump,
    velocity_comparison,
)
from diffsea.recordings.auditing.kinematics.selection import (
    SIGNIFICANCE,
    Explanation,
    select_causes,
)
from diffsea.recordings.auditing.responses import response_findings
from diffsea.recordings.auditing.samples.bursts import drop_bursts
from diffsea.recordings.auditing.samples.channels import (
    bridge_outliers,
    clock_findings,
    drop_frozen,
    rounding_findings,
)
from diffsea.recordings.auditing.samples.sampling import (
    constant_findings,
    straight_findings,
    wrap_findings,
)
from diffsea.recordings.motion import MeasuredMotion, motion_of
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import Samples, Trajectory


# What drifting inwards in turns must gain in deviance over drifting outwards.
_OUTWARDS = 10.0
_POSITION_AND_VELOCITY = ("x", "y", "psi", "u", "v")


@one_blas_thread
def audit(
    trajectory: Trajectory, level: float = SIGNIFICANCE, others: Sequence[AxesEvidence] = ()
) -> list[Finding]:
    """Everything that is wrong with one recording, as far as kinematics can tell.

    Each finding has a size, a standard error where it is a number, and a repair. An empty
    list means that nothing was found, not that nothing is wrong: what a run does not excite
    (a latency at constant speed, a compass error on one heading) it cannot show. `level` is how
    improbable by chance a latency, a bias or another number must be to be reported. `others` are
    what runs that were recorded alike tell of the axes of velocities; `audit_set` knows them.
    """
    found = clock_findings(trajectory) + rounding_findings(trajectory)
    found += order_findings(trajectory) + straight_findings(trajectory)
    motion, single = cleaned_motion(trajectory)
    motion, mislabelled = read_frames(motion, others)
    motion, frozen = drop_frozen(motion)
    motion, thrown = drop_bursts(motion)
    field = motor_field(trajectory, motion)
    motion, disagreements = _compare_channels(motion, level, field)
    found += single + mislabelled + frozen + thrown + disagreements
    orders = {name for one in found if one.kind == "order-not-motion" for name in one.channels}
    executed = actuation_findings(trajectory)
    # An order under the name of what was executed is no feedback that could be off.
    found += [f for f in executed if f.kind != "feedback-error" or not orders & {*f.channels}]
    found += response_findings(trajectory, motion)
    found.sort(key=lambda finding: KINDS.index(finding.kind))
    return [
        dataclasses.replace(one, recording=trajectory.name, cost=cost(one, trajectory))
        for one in found
    ]


def cleaned_motion(trajectory: Trajectory) -> tuple[MeasuredMotion, list[Finding]]:
    """Motion without values that no other channel is needed to doubt, and findings on those."""
    motion, wrapped = wrap_findings(motion_of(trajectory))
    motion, wild = bridge_outliers(motion)
    constant = constant_findings(trajectory, motion)
    motion = motion.without(name for fault in constant for name in fault.channels)
    return motion, wrapped + wild + constant


def _compare_channels(
    motion: MeasuredMotion, level: float, field: MotorField | None
) -> tuple[MeasuredMotion, list[Finding]]:
    """What parts heading from yaw rate and position from velocity; motion without it.

    `field` is what the motors may do to the heading.
    """
    heading = None
    if motion.has("psi", "r"):
        heading = select_causes(heading_comparison(motion, level, field))
    found_in_heading = heading.causes if heading else ()
    turned_velocities = False
    error = _compass_error(motion, heading, field)
    if error is not None:
        corrected = motion.with_channels(psi=motion.values["psi"] - error)
        # Velocities that were turned into body axes by the faulty heading agree with that one.
        if motion.has(*_POSITION_AND_VELOCITY):
            turned_velocities = not _position_misfit(corrected) < _position_misfit(motion)
        motion = motion if turned_velocities else corrected
    velocity, reversed_sway, jump = None, [], heading_jump(motion)
    if motion.has(*_POSITION_AND_VELOCITY):
        late = heading is not None and "delay" in found_in_heading and heading.theta["delay"] < 0
        # A yaw rate that agrees with heading has cleared the compass already.
        doubtful = heading is None or "gain" in found_in_heading

        def explain(motion: MeasuredMotion) -> Explanation | None:
            return select_causes(velocity_comparison(motion, level, doubtful, late, jump))

        velocity = explain(motion)
        motion, velocity, reversed_sway = _sway_sign(motion, velocity, explain)
    heard = HeadingSource(motion.t, field, turned_velocities)
    findings = disagreement_findings(heading, velocity, heard, jump) + reversed_sway
    if velocity and "angle" in velocity.causes:
        motion = motion.with_channels(psi=motion.values["psi"] - velocity.theta["angle"])
    if velocity and jump is not None and "step" in velocity.causes:
        error = velocity.theta["step"] * (motion.t > jump)
        motion = motion.with_channels(psi=motion.values["psi"] - error)
    return motion, findings


def _compass_error(
    motion: MeasuredMotion, heading: Explanation | None, field: MotorField | None
) -> Samples | None:
    """What the hull's and the motors' fields do to the heading (rad); None where neither does."""
    if heading is None or not {"iron", "motors"} & {*heading.causes}:
        return None
    psi, theta, error = motion.values["psi"], heading.theta, np.zeros(motion.t.size)
    if "iron" in heading.causes:
        error = error + theta["sine"] * np.sin(psi) + theta["cosine"] * np.cos(psi)
    if "motors" in heading.causes and field is not None:
        error = error + field.deviation(theta["motor_sine"], theta["motor_cosine"])
    return error


def _position_misfit(motion: MeasuredMotion) -> float:
    """Mean-square difference (m^2) of displacement and integrated velocity over about 5 s."""
    misfit = motion.path_misfit
    width = max(1, min(int(round(5.0 / motion.interval)), misfit.size // 4))
    return float(np.mean(np.abs(misfit[width:] - misfit[:-width]) ** 2))


def _sway_sign(
    motion: MeasuredMotion,
    velocity: Explanation | None,
    explain: Callable[[MeasuredMotion], Explanation | None],
) -> tuple[MeasuredMotion, Explanation | None, list[Finding]]:
    """Whether v is positive to port, where it goes with the turn and something is amiss.

    A vessel drifts outwards: v opposes r u. Sway is too small a part of the motion for its
    sign to show in the frames, and a wrong one looks much like a late heading.
    """
    values = motion.values
    inwards = np.gradient(values["psi"], motion.t) * values["u"]
    if velocity is None or not velocity.causes or np.mean(inwards * values["v"]) <= 0:
        return motion, velocity, []
    turned = motion.with_channels(v=-values["v"])
    other = explain(turned)
    if other is None or other.deviance > velocity.deviance + _OUTWARDS:
        return motion, velocity, []
    gained = max(velocity.deviance - other.deviance, 0.0)
    std = 2 * float(np.sqrt(gained))
    fault = finding_of("sway-to-port", ("v",), gained, std, {}, Affine(("v",), -1.0))
    return turned, other, [fault]
