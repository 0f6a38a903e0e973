"""What these data could have shown: the smallest detectable size of every candidate."""

import numpy as np

from diffsea.diagnosis.screening import Screening, Seen
from diffsea.identification.found_effects import place_of
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import Effect, catalogue_name


ERRORS = 3.0  # standard errors that make a size detectable
PLAUSIBLE = 30.0  # prior sizes beyond which nothing is expected
_NOT_A_SIZE = ("direction", "phase", "time", "frequency")


def detection_limits(problem: Problem, screening: Screening, found: tuple[str, ...]) -> list[dict]:
    """For every candidate that was not found, the smallest size that would have been.

    Three standard errors along the direction in which the data say least, in the effect's own
    parameter; None where not even an implausible size would have shown.
    """
    effects = {effect.name: effect for effect in problem.layout.effects}
    return [
        _limit(problem, effects[name], seen)
        for name, seen in screening.seen.items()
        if name not in found
    ]


def _limit(problem: Problem, effect: Effect, seen: Seen) -> dict:
    size = len(seen.look.moved)
    copies = seen.columns.shape[1] // size
    V = seen.columns.T @ seen.columns / seen.score.inflation
    values, vectors = np.linalg.eigh(V)
    row: dict = {"name": catalogue_name(effect.name), **place_of(problem.base, effect.name)}
    parameter = next(key for key in effect.units if key not in _NOT_A_SIZE)
    row |= {"parameter": parameter, "unit": effect.units[parameter], "limit": None}
    if values[0] <= (ERRORS / PLAUSIBLE) ** 2:
        return row | {"note": "these runs would not have shown it at any plausible size"}
    worst = vectors[:, 0] * ERRORS / np.sqrt(values[0])
    at = np.array(seen.look.at, float)
    part = worst.reshape(copies, size)[np.abs(worst).argmax() // size]
    at[list(seen.look.moved)] = part * (np.sign(part[0]) or 1.0)
    physical = at * np.array(effect.sizes(problem.base))
    row["limit"] = abs(float(effect.parameters(problem.base, physical)[parameter]))
    if parameter in ("rate_limit", "limit", "depth"):
        row["note"] = "anything lower would have shown"
    return row
