"""What these data could have shown: the smallest detectable size of every candidate."""

import numpy as np

from diffsea.diagnosis.screening import Screening, Seen
from diffsea.identification.found_effects import place_of
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import Effect, catalogue_name


ERRORS = 3.0  # standard errors that make a size detectable
PLAUSIBLE = 30.0  # prior sizes beyond which nothing is expected
_NOTHING = 1e-12  # information that is none
_INVERSE = ("rate_limit", "limit", "depth")  # parameters that are lower for larger effects
_NOT_A_SIZE = ("direction", "phase", "time", "frequency")


def detection_limits(problem: Problem, screening: Screening, found: tuple[str, ...]) -> list[dict]:
    """For every candidate that was not found, the smallest size that would have been.

    Three standard errors of the effect's own parameter by the data alone, its other coefficients
    unknown, in the run that says most; None where no plausible size would have shown.
    """
    effects = {effect.name: effect for effect in problem.layout.effects}
    return [
        _limit(problem, effects[name], seen)
        for name, seen in screening.seen.items()
        if name not in found
    ]


def _limit(problem: Problem, effect: Effect, seen: Seen) -> dict:
    size = len(seen.look.moved)
    columns = seen.columns[: problem.tape.measured.size]  # not the prior's rows
    copies = columns.shape[1] // size
    parameter = next(key for key in effect.units if key not in _NOT_A_SIZE)
    row: dict = {"name": catalogue_name(effect.name), **place_of(problem.base, effect.name)}
    row |= {"parameter": parameter, "unit": effect.units[parameter], "limit": None}
    V = columns.T @ columns / seen.score.inflation
    found = [
        shown
        for k in range(0, copies * size, size)
        if (shown := _shown(problem, effect, seen, V[k : k + size, k : k + size]))
    ]
    if not found:
        return row | {"note": "these runs would not have shown it at any plausible size"}
    row["limit"] = max(found) if parameter in _INVERSE else min(found)
    if parameter in _INVERSE:
        row["note"] = "anything lower would have shown"
    return row


def _shown(problem: Problem, effect: Effect, seen: Seen, V: np.ndarray) -> float | None:
    """The parameter at three standard errors by the information `V`; None if implausible.

    Along each coordinate alone and along the worst direction, whichever says more of the
    parameter: a flow's speed has no coordinate of its own.
    """
    values, vectors = np.linalg.eigh(V)
    spread = ERRORS / np.sqrt(np.maximum(values, _NOTHING))
    steps = [*np.diag(np.sqrt((vectors**2) @ spread**2)), spread[0] * vectors[:, 0]]
    parameter = next(key for key in effect.units if key not in _NOT_A_SIZE)
    sizes = np.array(effect.sizes(problem.base))
    named = []
    for step in steps:
        at = np.array(seen.look.at, float)
        at[list(seen.look.moved)] = step * (np.sign(step[np.abs(step).argmax()]) or 1.0)
        named.append((abs(float(effect.parameters(problem.base, at * sizes)[parameter])), step))
    value, step = (min if parameter in _INVERSE else max)(named, key=lambda pair: pair[0])
    return None if np.linalg.norm(step) > PLAUSIBLE else value
