"""The audit: is a recording consistent with itself, before any physics is blamed?

Every label, unit, frame, sign and clock is a hypothesis, tested from kinematics alone:
heading is the integral of yaw rate, position that of velocity turned by heading, and
actuators act the way their names say. Faults are put right in passing, so that what comes
after is not misled by what was found before; the recording itself is never changed.
"""

import dataclasses

import numpy as np

from diffsea.recordings.auditing.actuators import actuation_findings, response_findings
from diffsea.recordings.auditing.causes import SIGNIFICANCE, Explanation, explain
from diffsea.recordings.auditing.channels import frozen, order_findings, outliers, rounding_findings
from diffsea.recordings.auditing.clocks import clock_findings
from diffsea.recordings.auditing.edits import Affine
from diffsea.recordings.auditing.finding import KINDS, Finding
from diffsea.recordings.auditing.frames import read_frames
from diffsea.recordings.auditing.kinematics import heading_comparison, velocity_comparison
from diffsea.recordings.auditing.wording import disagreement_findings
from diffsea.recordings.motion import MeasuredMotion, motion_of
from diffsea.runtime import one_blas_thread
from diffsea.series import integrate
from diffsea.trajectory import Trajectory


# What drifting inwards in turns must gain in deviance over drifting outwards.
_OUTWARDS = 10.0


@one_blas_thread
def audit(trajectory: Trajectory, level: float = SIGNIFICANCE) -> list[Finding]:
    """Everything that is wrong with one recording, as far as kinematics can tell.

    Each finding has a size, a standard error where it is a number, and a repair. An empty
    list means that nothing was found, not that nothing is wrong: what a run does not excite
    (a latency at constant speed, a compass error on one heading) it cannot show. `level` is how
    improbable by chance a latency, a bias or another number must be to be reported.
    """
    findings = clock_findings(trajectory) + rounding_findings(trajectory)
    findings += order_findings(trajectory)
    motion, wild = outliers(motion_of(trajectory))
    motion, mislabelled = read_frames(motion)
    motion, stuck = frozen(motion)
    findings += wild + mislabelled + stuck
    motion, disagreements = _disagreements(motion, level)
    findings += disagreements
    findings += actuation_findings(trajectory) + response_findings(trajectory, motion)
    findings.sort(key=lambda finding: KINDS.index(finding.kind))
    return [dataclasses.replace(finding, recording=trajectory.name) for finding in findings]


def _disagreements(motion: MeasuredMotion, level: float) -> tuple[MeasuredMotion, list[Finding]]:
    """What parts heading from yaw rate and position from velocity."""
    heading = _explained(heading_comparison(motion, level)) if motion.has("psi", "r") else None
    turned = heading.causes if heading else ()
    swung = False
    if heading and "iron" in turned:
        recorded = motion
        motion = _clearer(motion, _without_iron(motion.values["psi"], heading.theta))
        swung = motion is recorded
    velocity, reversed_sway = None, []
    if motion.has("x", "y", "psi", "u", "v"):
        late = "delay" in turned and heading is not None and heading.theta["delay"] < 0
        # A yaw rate that agrees with heading has cleared the compass already.
        doubtful = heading is None or "gain" in turned
        options = {"level": level, "iron": doubtful, "psi_late": late}
        velocity = _explained(velocity_comparison(motion, **options))
        motion, velocity, reversed_sway = _sway_sign(motion, velocity, options)
    findings = disagreement_findings(heading, velocity, swung) + reversed_sway
    if velocity and "angle" in velocity.causes:
        motion = motion.with_channels(psi=motion.values["psi"] - velocity.theta["angle"])
    return motion, findings


def _explained(comparison) -> Explanation | None:
    return None if comparison is None else explain(comparison)


def _clearer(motion: MeasuredMotion, psi: np.ndarray) -> MeasuredMotion:
    """The motion with another heading, if position and velocity then agree better.

    Velocities that were turned into body axes by the faulty heading agree with that one.
    """
    changed = motion.with_channels(psi=psi)
    if not motion.has("x", "y", "psi", "u", "v"):
        return changed
    return changed if _misfit(changed) < _misfit(motion) else motion


def _misfit(motion: MeasuredMotion) -> float:
    """Mean-square difference of displacement and integrated velocity over about 5 s."""
    values = motion.values
    flow = (values["u"] + 1j * values["v"]) * np.exp(1j * values["psi"])
    misfit = values["x"] + 1j * values["y"] - integrate(motion.t, flow)
    width = max(1, min(int(round(5.0 / motion.interval)), misfit.size // 4))
    return float(np.mean(np.abs(misfit[width:] - misfit[:-width]) ** 2))


def _sway_sign(
    motion: MeasuredMotion, velocity: Explanation | None, options: dict
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
    other = _explained(velocity_comparison(turned, **options))
    if other is None or other.deviance > velocity.deviance + _OUTWARDS:
        return motion, velocity, []
    gained = max(velocity.deviance - other.deviance, 0.0)
    finding = Finding(
        "axes",
        gained,
        2 * float(np.sqrt(gained)),
        "1",
        "v is positive to port, not to starboard: with the opposite sign position and velocity "
        "agree better (value: drop of the deviance), and the vessel drifts outwards in turns (or "
        "x, y and heading are those of an east-north-up frame)",
        "v = { ..., sign = -1 } in the mapping",
        ("v",),
        edits=(Affine(("v",), -1.0),),
    )
    return turned, other, [finding]


def _without_iron(psi: np.ndarray, theta: dict[str, float]) -> np.ndarray:
    return psi - theta["sine"] * np.sin(psi) - theta["cosine"] * np.cos(psi)
