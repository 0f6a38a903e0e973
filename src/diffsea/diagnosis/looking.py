"""Derivatives of the whitened innovations by every look at every candidate."""

import numpy as np

from diffsea.diagnosis.columns import Columns, columns_of, residual_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.likelihood import Gains
from diffsea.identification.looks import Look
from diffsea.identification.problem import Problem


def look_columns(
    problem: Problem, gains: Gains, fitted: Estimate, looks: list[Look]
) -> list[Columns]:
    """Columns of each look, several looks to one run of the compiled program.

    A shape changes nothing while its effect is absent, so that looks at different effects
    share their residual. A finite size is looked at by the secant from its absence.
    """
    out: dict[int, Columns] = {}
    for batch in _batches(problem, looks):
        coordinates = np.array(fitted.coordinates, float)
        index: list[int] = []
        for number in batch:
            place = _places(problem, looks[number].effect)
            coordinates[place] = np.tile(looks[number].at, len(place) // len(looks[number].at))
            index += _moved(problem, looks[number])
        J = columns_of(problem, gains, coordinates, index)[1]
        position = 0
        for number in batch:
            size = len(_moved(problem, looks[number]))
            out[number] = J[:, position : position + size]
            position += size
    base = None
    for number, look in enumerate(looks):
        if not look.finite:
            continue
        if base is None:
            base = residual_at(problem, gains, np.asarray(fitted.coordinates))
        at = np.array(fitted.coordinates, float)
        at[_places(problem, look.effect)] = look.at
        change = residual_at(problem, gains, at) - base
        # The prior's own rows are those of a tangent.
        prior = np.zeros(problem.layout.size)
        prior[_moved(problem, look)] = 1 / problem.layout.spreads()[_moved(problem, look)]
        out[number] = np.concatenate([change / look.at[0], prior])[:, None]
    return [out[number] for number in range(len(looks))]


def _places(problem: Problem, effect: str) -> list[int]:
    return problem.layout.indices((effect,))


def _moved(problem: Problem, look: Look) -> list[int]:
    """Coordinates that a look differentiates by, in every copy of its effect."""
    places, size = _places(problem, look.effect), len(look.at)
    return [k for position, k in enumerate(places) if position % size in look.moved]


def _batches(problem: Problem, looks: list[Look]) -> list[list[int]]:
    """Looks packed into runs of the compiled program, no effect twice in one."""
    batches: list[tuple[list[int], set[str], int]] = []
    for number, look in enumerate(looks):
        if look.finite:
            continue
        width = len(_moved(problem, look))
        size = len(look.moved)
        for k, (members, effects, used) in enumerate(batches):
            total = sum(len(_moved(problem, looks[m])) for m in members) + width
            room = used + size <= problem.seeds and total <= problem.width
            if room and look.effect not in effects:
                batches[k] = ([*members, number], effects | {look.effect}, used + size)
                break
        else:
            batches.append(([number], {look.effect}, size))
    return [members for members, _, _ in batches]
