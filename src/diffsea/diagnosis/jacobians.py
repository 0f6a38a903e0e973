"""Derivatives of the whitened innovations by what a diagnosis tries.

Derivatives of the whitened innovations by every look at every candidate.

At which frequencies a wave train may be: peaks in the spectrum of the filter's latent force.
"""

import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import Estimate
from diffsea.identification.expansion_points import ExpansionPoint
from diffsea.identification.filter.kalman import Gains
from diffsea.identification.problem import Problem
from diffsea.identification.residual import innovations_at, linearise


Columns = Float[np.ndarray, "value column"]


def columns_at(
    problem: Problem, gains: Gains, fitted: Estimate, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "value"], Columns]:
    """Residual and Jacobian columns of some coordinates at an estimate.

    The rows of the prior are those of all coordinates, so that columns can be combined.
    """
    index = [k for name in names for k in problem.layout.indices((name,))]
    return columns_of(problem, gains, np.asarray(fitted.coordinates), index)


def columns_of(
    problem: Problem, gains: Gains, coordinates: np.ndarray, index: list[int]
) -> tuple[np.ndarray, Columns]:
    """Residual and Jacobian columns of some coordinates, by their positions."""
    residual, J = linearise(problem, gains, coordinates, index)
    keep = int(problem.dataset.measured.size) + problem.layout.size
    return residual[:keep], J[:keep]


def residual_at(problem: Problem, gains: Gains, coordinates: np.ndarray) -> np.ndarray:
    """Whitened innovations at some coordinates with these gains."""
    return innovations_at(problem, gains, coordinates)


def latent_acceleration(problem: Problem, fitted: Estimate) -> Float[np.ndarray, "row 3"]:
    """What the filter finds beside the model: lasting gusts and the rest (m/s^2, rad/s^2)."""
    run = fitted.filter_run(problem)
    return np.asarray(run.gust_impulse) / np.maximum(np.asarray(run.gains.gusts.half), 1e-12)


def push_columns(
    problem: Problem, gains: Gains, fitted: Estimate, push: Float[np.ndarray, "push row 3"]
) -> Columns:
    """Columns of histories of accelerations (m/s^2, m/s^2, rad/s^2), with rows of no prior."""
    values, parts = int(problem.dataset.measured.size), []
    for first in range(0, len(push), problem.directions):
        part = push[first : first + problem.directions]
        J = linearise(problem, gains, np.asarray(fitted.coordinates), (), part).jacobian
        parts.append(J[:values])
    J = np.concatenate(parts, axis=1)
    return np.concatenate([J, np.zeros((problem.layout.size, J.shape[1]))])


def look_columns(
    problem: Problem, gains: Gains, fitted: Estimate, looks: list[ExpansionPoint]
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
        if not look.secant:
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


def _moved(problem: Problem, look: ExpansionPoint) -> list[int]:
    """Coordinates that a look differentiates by, in every copy of its effect."""
    places, size = _places(problem, look.effect), len(look.at)
    return [k for position, k in enumerate(places) if position % size in look.directions]


def _batches(problem: Problem, looks: list[ExpansionPoint]) -> list[list[int]]:
    """Looks packed into runs of the compiled program, no effect twice in one."""
    batches: list[tuple[list[int], set[str], int]] = []
    for number, look in enumerate(looks):
        if look.secant:
            continue
        width = len(_moved(problem, look))
        size = len(look.directions)
        for k, (members, effects, used) in enumerate(batches):
            total = sum(len(_moved(problem, looks[m])) for m in members) + width
            room = used + size <= problem.directions and total <= problem.width
            if room and look.effect not in effects:
                batches[k] = ([*members, number], effects | {look.effect}, used + size)
                break
        else:
            batches.append(([number], {look.effect}, size))
    return [members for members, _, _ in batches]


PEAKS = 4
TOGETHER = 2.0  # times the longest run: clocks of runs that lie within it begin together
NEIGHBOURS = 40  # frequencies around one whose median is what gusts alone show


def peaks(problem: Problem, fitted: Estimate) -> tuple[Float[np.ndarray, "peak"], float]:
    """The most prominent frequencies (Hz) common to all runs, and the resolution of the data.

    Earth-fixed components of the lasting gusts that the filter finds, relative to the median of the
    spectrum around each frequency. Runs whose clocks begin together keep a common phase; of others,
    powers are added.
    """
    dataset = problem.dataset
    push = latent_acceleration(problem, fitted)
    psi = np.asarray(fitted.filter_run(problem).state)[:, 2]
    t, dt = np.asarray(dataset.run_time), np.asarray(dataset.dt)
    rows = np.asarray(dataset.known).any(1) & (dt > 0)
    force = (push[:, 0] + 1j * push[:, 1]) * np.exp(1j * psi)
    force, t, dt = force[rows], t[rows], dt[rows]
    run = np.asarray(dataset.run)[rows]
    inside = [run == number for number in np.unique(run)]
    longest = max(float(np.ptp(t[own])) for own in inside)
    if np.ptp(t) < TOGETHER * longest:
        inside = [np.ones(len(t), bool)]
    resolution = 0.5 / max(longest, 1e-9)
    grid = np.arange(4 * resolution, 0.25 / float(np.median(dt)), resolution)
    if len(grid) < 8 or not np.isfinite(force).all():
        return np.zeros(0), resolution
    force = force - force.mean()
    power = np.zeros(len(grid))
    for own in inside:
        wave = np.exp(-2j * np.pi * grid[:, None] * t[own]) * dt[own]
        # North and east are real and imaginary: the power of both is that at f and at -f.
        power += np.abs(wave @ force[own]) ** 2 + np.abs(wave.conj() @ force[own]) ** 2
    around = [
        np.median(power[max(0, k - NEIGHBOURS // 2) : k + NEIGHBOURS // 2 + 1])
        for k in range(len(grid))
    ]
    relative = power / np.maximum(around, 1e-300)
    inner = relative[1:-1]
    high = 1 + np.flatnonzero((inner >= relative[:-2]) & (inner >= relative[2:]))
    return grid[high[np.argsort(-relative[high])][:PEAKS]], resolution
