"""Where the fit of a model with other effects may begin: at a guess, or where others ended."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.screening import Candidate
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import Start
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import EFFECTS, Size


LARGEST_STEP = 3.0  # prior sizes that a one-step estimate may start a refit at


def first_guess(candidate: Candidate) -> Float[np.ndarray, "coordinate"]:
    """Coordinates of the effect, in every instance, from its one-step estimate.

    At most three prior sizes; those of a secant at its size, positive ones above zero.
    """
    point = candidate.point
    step = np.clip(candidate.score.step, -LARGEST_STEP, LARGEST_STEP)
    step = step.reshape(-1, len(point.directions))
    out = np.tile(np.array(point.at, float), (len(step), 1))
    out[:, list(point.directions)] = step
    if point.secant:
        out[:] = point.at
    for place, one in enumerate(EFFECTS[point.effect].coordinates):
        if isinstance(one, Size) and one.positive:
            out[:, place] = np.maximum(out[:, place], 0.1)
    return out.ravel()


def start_beside(
    problem: Problem, current: Estimate, one: Hypothesis
) -> Float[np.ndarray, "coordinate"]:
    """Coordinates of a current estimate with one effect more, where its own fit may start.

    As it was refitted, if that was on top of these very effects; else its coordinates alone, for
    what it was fitted together with may not be in the model any more.
    """
    if set(one.estimate.free) == {*current.free, one.effect}:
        return min(current, one.estimate, key=lambda fitted: fitted.deviance).coordinates
    out = np.array(current.coordinates, float)
    place = problem.layout.indices((one.effect,))
    out[place] = one.estimate.coordinates[place]
    return out


def start_as_part(problem: Problem, fitted: Estimate, part: str, whole: str) -> Start:
    """Where a model with a part of an effect ended, as one with the whole effect says it."""
    layout, out = problem.layout, np.array(fitted.coordinates, float)
    own = out[layout.indices((part,))] * np.array(EFFECTS[part].sizes(problem.base))
    numbers = {k: float(v) for k, v in EFFECTS[part].decode(problem.base, jnp.asarray(own)).items()}
    out[layout.indices((part,))] = 0.0
    sizes = np.array(EFFECTS[whole].sizes(problem.base))
    out[layout.indices((whole,))] = np.array(EFFECTS[whole].encode(problem.base, numbers)) / sizes
    return Start.beside(fitted, out)


def start_with_effects_of(
    problem: Problem, known: Estimate, other: Estimate, free: tuple[str, ...]
) -> Start:
    """Where one fit ended, with what is `free` and it lacked from another, and nothing else."""
    out = np.array(known.coordinates, float)
    lacking = problem.layout.indices(tuple(name for name in free if name not in known.free))
    needless = problem.layout.indices(tuple(name for name in known.free if name not in free))
    out[needless], out[lacking] = 0.0, other.coordinates[lacking]
    return Start.beside(known, out)
