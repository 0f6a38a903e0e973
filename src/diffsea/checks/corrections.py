"""What an audit is certain of in the motion, taken off before answers are computed from it."""

from collections.abc import Sequence
from typing import NamedTuple

from diffsea.recordings import Finding
from diffsea.recordings.auditing.repair import hindrance
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


_KINDS = ("unit", "sign", "scale", "gyro-bias", "heading-offset", "sensor-latency")  # in this order
_OF_ANSWERS = frozenset({"r", "u"})  # channels from which turning, sides and speed are told


class CorrectedMotion(NamedTuple):
    """A run without what is certain to be wrong in it, and what to say about that."""

    run: Trajectory
    notes: tuple[str, ...]


def correct_motion(run: Trajectory, findings: Sequence[Finding]) -> CorrectedMotion:
    """The run with the certain offsets, scales, delays, units and signs of its motion put right.

    Those that are not certain stay in, and what rests on them is said.
    """
    notes = []
    of_motion = [one for one in findings if one.kind in _KINDS and one.channels]
    of_motion = [one for one in of_motion if set(one.channels) <= set(MOTION_CHANNELS)]
    for one in sorted(of_motion, key=lambda one: _KINDS.index(one.kind)):
        if not hindrance(one, findings):
            for edit in one.edits:
                run = edit.apply(run)
            notes.append(
                f"taken off before anything is told of the answer to orders: {one.message}"
            )
        elif _OF_ANSWERS & set(one.channels):
            notes.append(
                f"what is told of the answer to orders rests on {' and '.join(one.channels)}, and "
                f"that may not be sound: {one.message}"
            )
    return CorrectedMotion(run, tuple(notes))
