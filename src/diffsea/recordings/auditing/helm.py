"""What the helm says where no response does: zig-zags steered the wrong way, dead actuators.

A rudder that is reversed each time the heading has come round to a limit is a zig-zag, and then
it must go against the heading. An actuator that is moved a great deal and explains nothing is
dead.
"""

import numpy as np

from diffsea.recordings.auditing.edits import Affine
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.lags import largest_explained_share, response_to
from diffsea.recordings.motion import MeasuredMotion


_CERTAIN = 4.0  # standard errors
_ALIKE = 0.35  # spread of the headings at which a zig-zag's rudder is reversed
_NOTHING = 0.02  # share of the yaw rate's variance below which a rudder does nothing
_IDLE = 0.3  # effect of a thruster, relative to its partner's, below which it is dead
MIRRORED = (
    "; or the whole record has its axes mirrored (x east, y north, heading counter-clockwise)"
)


def zigzag_findings(motion: MeasuredMotion, channel: str, angle: np.ndarray) -> list[Finding]:
    """A zig-zag whose rudder goes with the heading instead of against it."""
    if not motion.has("psi"):
        return []
    at = reversals(angle)
    at = at[motion.known["psi"][at]]
    if at.size < 4:
        return []
    heading = motion.values["psi"][at] - np.mean(motion.values["psi"][at])
    if at.size % 2:
        heading = motion.values["psi"][at] - np.mean(motion.values["psi"][at[:-1]])
    reached = heading * np.sign(angle[at])  # negative where the rudder goes against the heading
    error = float(np.std(reached) / np.sqrt(at.size))
    alike = np.std(reached) < _ALIKE * np.mean(reached)
    if not alike or np.mean(reached) < _CERTAIN * error or np.min(reached) <= 0:
        return []
    return [
        Finding(
            "sign",
            float(np.mean(reached)),
            error,
            "rad",
            f"the {at.size} reversals of {channel} are those of a zig-zag of "
            f"{np.degrees(np.mean(reached)):.3g} deg, but go with the heading, not against it"
            + MIRRORED,
            f"{channel} = {{ ..., sign = -1 }} in the mapping",
            (channel,),
            edits=(Affine((channel,), -1.0),),
        )
    ]


def reversals(angle: np.ndarray) -> np.ndarray:
    """Where a rudder goes over to the other side, from amplitude to amplitude."""
    side = np.where(np.abs(angle) > 0.5 * np.max(np.abs(angle)), np.sign(angle), 0.0)
    held = side[np.maximum.accumulate(np.where(side != 0, np.arange(side.size), 0))]
    return np.flatnonzero(held[1:] * held[:-1] < 0) + 1


def dead_rudder(motion: MeasuredMotion, channel: str, angle: np.ndarray) -> list[Finding]:
    """A rudder that is put over again and again under way and explains nothing."""
    if not motion.has("u") or np.ptp(angle) < np.radians(16.0) or reversals(angle).size < 4:
        return []
    speed = np.abs(motion.values["u"])
    if np.median(speed) < 0.3 * np.max(speed):
        return []
    share = largest_explained_share(motion, "r", angle[None])
    if share > _NOTHING:
        return []
    return [
        Finding(
            "stuck",
            share,
            float(np.sqrt(share / motion.t.size)),
            "1",
            f"{channel} moves by {np.degrees(np.ptp(angle)):.3g} deg and explains "
            f"{100 * share:.2g} % of the yaw rate's variance: the rudder does not move, or this "
            "is another vessel's record",
            "nothing to repair: leave the channel out if it is not this vessel's",
            (channel,),
        )
    ]


def dead_thruster(
    motion: MeasuredMotion, names: tuple[str, str], port: np.ndarray, starboard: np.ndarray
) -> list[Finding]:
    """One of two thrusters without effect, while the other turns the vessel."""
    both = np.stack([port, starboard])
    spans = np.ptp(both, axis=1)
    if not np.min(spans) > 0.3 * np.max(spans):
        return []
    if abs(np.corrcoef(both)[0, 1]) > 0.7:
        return []
    effect = response_to(motion, "r", both, signs=False)
    strong = int(np.argmax(np.abs(effect.gains)))
    weak = 1 - strong
    # To port they turn the vessel one way, to starboard the other.
    share = -float(effect.gains[weak] / effect.gains[strong]) if effect.sound else 1.0
    error = float(effect.errors[weak] / abs(effect.gains[strong])) if effect.sound else np.inf
    if abs(share) > 3 * error or abs(share) + 3 * error > _IDLE:
        return []
    return [
        Finding(
            "stuck",
            share,
            error,
            "1",
            f"{names[weak]} turns the vessel {share:.2g} +- {error:.2g} times as much as "
            f"{names[strong]}: the thruster is dead",
            "nothing to repair: leave the channel out",
            (names[weak],),
        )
    ]
