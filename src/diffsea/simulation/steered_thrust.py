"""Orders of a helm and a throttle for a vessel whose one thruster turns, such as an outboard.

No recording says whether its helm turns a rudder or the thruster itself: the vessel does.
"""

import dataclasses
from collections.abc import Iterable, Mapping

import jax.numpy as jnp

from diffsea.progress import Progress, Remark, no_progress
from diffsea.trajectory import Samples, Trajectory
from diffsea.vessel.actuators import AzimuthThruster
from diffsea.vessel.base import Vessel


HELM = "rudder"
THROTTLES = ("motor", "propeller", "thrust")


def with_thruster_orders(
    vessel: Vessel, recordings: Iterable[Trajectory], progress: Progress = no_progress
) -> list[Trajectory]:
    """Recordings whose helm and throttle are the angle and the thrust of a vessel's one thruster.

    A recording is left as it is for any other vessel, and where it has the thruster's own channels,
    no helm or not one throttle. Positive angles of a helm turn the vessel to starboard; the
    thruster's are clockwise from ahead, which aft of amidships turns her to port.
    """
    found, renamed = list[Trajectory](), list[str]()
    for run in recordings:
        names = _names(vessel, run)
        if names:
            renamed.append(run.name)
            groups = {"commanded": run.commanded, "executed": run.executed}
            run = dataclasses.replace(run, **{key: names.of(own) for key, own in groups.items()})
        found.append(run)
    if renamed:
        (name,) = vessel.actuators
        progress(Remark(f"helm and throttle are taken for those of {name} ({', '.join(renamed)})"))
    return found


@dataclasses.dataclass(frozen=True)
class _Names:
    """Channels of a thruster by those of a helm and a throttle, and the sign of its angle."""

    channels: Mapping[str, str]
    sign: float

    def of(self, group: Mapping[str, Samples]) -> dict[str, Samples]:
        """Orders, or what was executed, by the thruster's channels."""
        turned = {name: self.sign * one if name == HELM else one for name, one in group.items()}
        return {self.channels.get(name, name): one for name, one in turned.items()}


def _names(vessel: Vessel, recording: Trajectory) -> _Names | None:
    """How a recording's helm and throttle are called on a vessel; None where they are not."""
    recorded = {*recording.commanded, *recording.executed}
    throttles = [name for name in THROTTLES if name in recorded]
    match list(vessel.actuators.values()):
        case [AzimuthThruster() as thruster]:
            channels = {HELM: thruster.angle_channel}
        case _:
            return None
    if recorded & set(vessel.channels) or HELM not in recorded or len(throttles) != 1:
        return None
    channels |= {throttles[0]: thruster.force_channel}
    return _Names(channels, float(jnp.sign(thruster.x)))
