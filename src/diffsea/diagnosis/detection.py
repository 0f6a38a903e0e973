"""What the data could have shown: the smallest detectable size of every candidate.

An effect that was not found is absent only as far as these sizes say.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.screening import Candidate, Screening
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import Effect


DETECTABLE = 3.0  # standard errors that make a size detectable
PLAUSIBLE = 30.0  # prior sizes beyond which nothing is expected
NO_INFORMATION = 1e-12  # in standard errors of a prior size, squared and inverted


@dataclasses.dataclass(frozen=True)
class DetectionLimit:
    """The smallest size of an effect that would have shown."""

    effect: Effect
    limit: float | None  # of its stated parameter; None where no plausible size would have shown


def detection_limits(
    problem: Problem, screening: Screening, found: tuple[str, ...]
) -> list[DetectionLimit]:
    """The smallest detectable size of every candidate that was not found.

    Three standard errors of the effect's own parameter by the data alone, its other coefficients
    unknown, in the run that says most.
    """
    effects = {effect.name: effect for effect in problem.layout.effects}
    limits = []
    for name, candidate in screening.candidates.items():
        if name in found:
            continue
        effect, size = effects[name], len(candidate.point.directions)
        columns = candidate.columns[: problem.dataset.measured.size]  # not the prior's rows
        V = columns.T @ columns / candidate.score.inflation
        shown = [
            value
            for k in range(0, len(V) // size * size, size)
            if (value := _smallest_size(problem, effect, candidate, V[k : k + size, k : k + size]))
        ]
        limit = (max if effect.stated_inversely else min)(shown) if shown else None
        limits.append(DetectionLimit(effect, limit))
    return limits


def _smallest_size(
    problem: Problem, effect: Effect, candidate: Candidate, V: Float[np.ndarray, "moved moved"]
) -> float | None:
    """The parameter at three standard errors by the information `V`; None if implausible.

    Along each coordinate alone and along the worst direction, whichever says more of the
    parameter: a flow's speed has no coordinate of its own.
    """
    values, vectors = np.linalg.eigh(V)
    spread = DETECTABLE / np.sqrt(np.maximum(values, NO_INFORMATION))
    steps = [*np.diag(np.sqrt((vectors**2) @ spread**2)), spread[0] * vectors[:, 0]]
    sizes = np.array(effect.sizes(problem.base))
    named = []
    for step in steps:
        at = np.array(candidate.point.at, float)
        at[list(candidate.point.directions)] = step * (np.sign(step[np.abs(step).argmax()]) or 1.0)
        value = abs(float(effect.decode(problem.base, at * sizes)[effect.stated_key]))
        named.append((value, step))
    value, step = (min if effect.stated_inversely else max)(named, key=lambda pair: pair[0])
    return None if np.linalg.norm(step) > PLAUSIBLE else value
