"""Wind and current of one run, from its first part."""

import dataclasses

import numpy as np

from diffsea.errors import UserError
from diffsea.identification.effect_records import parameter_records
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.identification.uncertainty.design import vessel_in_environment
from diffsea.recordings.conditioning import cut
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS


def environment_from(
    vessel: Vessel, recording: Trajectory, seconds: float
) -> tuple[Vessel, Trajectory, dict[str, dict]]:
    """The vessel in the environment of a run's first part, the rest of the run, and what it is.

    A current is estimated, and wind where the vessel has a superstructure for it, with all else
    of the vessel held fixed. Parameters by effect have value, standard error and unit.

    Raises:
        UserError: the run is not longer than that part, or the part has too few samples.
    """
    t = np.asarray(recording.t, float)
    split = float(t[0]) + seconds
    if not t[0] < split < t[-1]:
        raise UserError(
            f"{recording.name} lasts {t[-1] - t[0]:.4g} s: the environment cannot be estimated "
            f"from its first {seconds:g} s and the rest predicted; give fewer seconds"
        )
    names = ("current", "wind") if "wind" in vessel.forces else ("current",)
    effects = tuple(EFFECTS[name] for name in names)
    room = sum(len(effect.sizes(vessel)) for effect in effects)
    problem = make_problem(vessel, [cut(recording, float(t[0]), split)], (), effects, room=room)
    found = estimate(problem, names)
    there = vessel_in_environment(problem, found.coordinates)
    said = {name: parameter_records(problem, found, name)[0] for name in names}
    there = dataclasses.replace(there, name=vessel.name, source=vessel.source)
    return there, cut(recording, split, float(t[-1])), said
