"""Which effects a diagnosis considers, and how closely it looks at their shapes.

Efficient scores of the whole catalogue and of unnamed forces against one estimate.
"""

import dataclasses

import numpy as np

from diffsea.diagnosis.jacobians import columns_at, look_columns, peaks
from diffsea.diagnosis.localisation import Cell, bin_columns, cells
from diffsea.diagnosis.score import Null, Projection, Score, joint_null
from diffsea.identification.estimates import Estimate
from diffsea.identification.expansion_points import ExpansionPoint, expansion_points
from diffsea.identification.fit import estimate
from diffsea.identification.problem import Problem
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.effects.coordinates import PRIOR_SPREAD


def candidates(
    vessel: Vessel, recordings: list[Trajectory], per_run: bool = False
) -> tuple[Effect, ...]:
    """Effects of the catalogue that this vessel could have and its model lacks.

    What recordings would have to show and do not (heel) leaves an effect out. So do coefficients
    of the vessel's own that come with an environment, where each run has its own.
    """

    def recorded(channel: str) -> bool:
        return all(
            channel in run.extra and bool(np.isfinite(np.asarray(run.extra[channel])).any())
            for run in recordings
        )

    return tuple(
        effect
        for effect in EFFECTS.values()
        if effect.possible(vessel)
        and (not effect.needs or recorded(effect.needs))
        and not (per_run and effect.per_run and effect.has_coefficients)
    )


def shape_spacings(
    effects: tuple[Effect, ...], vessel: Vessel, tried: list[ExpansionPoint], resolution: float
) -> dict[str, float]:
    """Distance between neighbouring onsets or frequencies to try for each effect, in prior sizes.

    `resolution` (Hz) is that of a frequency; the distance is zero where nothing is scanned.
    """
    out = {}
    for effect in effects:
        out[effect.name] = 0.0
        if effect.scanned is not None:
            place, scanned = effect.scanned
            values = [point.at[place] for point in tried if point.effect == effect.name]
            out[effect.name] = scanned.spacing(values, effect.sizes(vessel)[place], resolution)
    return out


def nearby(effect: Effect, look: ExpansionPoint, spacing: float) -> list[ExpansionPoint]:
    """Points at onsets or frequencies around one, three to each side."""
    if effect.scanned is None or spacing == 0:
        return []
    place, out = effect.scanned[0], []
    for step in (-3, -2, -1, 1, 2, 3):
        at = list(look.at)
        at[place] += step * spacing
        out.append(dataclasses.replace(look, at=tuple(at)))
    return out


SHORT_LIST = 6
CONFUSABLE = 0.5  # share of information mimicked from which a rival is always refitted
WORTH = 0.15  # share of the best first guess below which a refit is not worth its time
LEAST = 3  # refitted in any case
DECLARED = 0.2  # share of the best first guess from which a declared confusable is, too


@dataclasses.dataclass(frozen=True)
class Seen:
    """The best look at one candidate."""

    look: ExpansionPoint
    score: Score
    columns: np.ndarray  # efficient, by the moved coordinates
    expected: float  # first guess of twice the log evidence that a refit would give
    reach: float = 0.0  # how far a refit may move the shape, in prior sizes


@dataclasses.dataclass(frozen=True)
class Screening:
    """Scores of all candidates against one estimate, and where the mismatch is."""

    seen: dict[str, Seen]
    cells: tuple[Cell, ...]
    null: Null

    @property
    def p_value(self) -> float:
        """Family-wise p-value of the strongest test."""
        tests = [one.score.p_value for one in self.seen.values()]
        tests += [cell.p_value for cell in self.cells]
        return self.null.family_wise(min(tests)) if tests else 1.0

    @property
    def remainder(self) -> float:
        """Family-wise p-value of the strongest located force."""
        return self.null.family_wise(min((cell.p_value for cell in self.cells), default=1.0))


def locate(problem: Problem, fitted: Estimate, better: Estimate) -> Screening:
    """Where a model fails, measured by the noise of a better one.

    With noise of its own, gusts have grown until they hold what the model lacks: little stands
    out. The better model's innovations also say how they depend on one another in time.
    """
    run = np.asarray(problem.dataset.run)
    residual, nuisance = columns_at(problem, better.filter_run(problem).gains, better, better.free)
    correlation = Projection(residual, nuisance, run).correlation
    fitted = estimate(
        problem, fitted.free, fitted.coordinates, better.noise, rounds=3, fixed_noise=True
    )
    gains = fitted.filter_run(problem).gains
    residual, nuisance = columns_at(problem, gains, fitted, fitted.free)
    projection = Projection(residual, nuisance, run, correlation)
    bins, J = bin_columns(problem, gains, fitted)
    where = projection.efficient(J)
    located = cells(problem, bins, *projection.singles(where))
    tests = [slice(k, k + 1) for k in range(where.shape[1])]
    return Screening({}, located, joint_null(where.T @ where, tests))


def screen(problem: Problem, fitted: Estimate) -> Screening:
    """Score every candidate that is not in the model, and locate the mismatch."""
    gains = fitted.filter_run(problem).gains
    residual, nuisance = columns_at(problem, gains, fitted, fitted.free)
    projection = Projection(residual, nuisance, np.asarray(problem.dataset.run))
    frequencies, resolution = peaks(problem, fitted)
    tried = [
        look
        for effect in problem.layout.effects
        if effect.name not in fitted.free
        for look in expansion_points(effect, problem.base, problem.dataset.spans, frequencies)
    ]
    spacing = shape_spacings(problem.layout.effects, problem.base, tried, resolution)
    parts = [projection.efficient(J) for J in look_columns(problem, gains, fitted, tried)]
    bins, J = bin_columns(problem, gains, fitted)
    where = projection.efficient(J)
    located = cells(problem, bins, *projection.singles(where))
    told = [E[:, projection.told(E)] for E in parts]
    everything = np.concatenate([*told, where], axis=1)
    ends = np.cumsum([E.shape[1] for E in told] + [1] * where.shape[1])
    tests = [slice(int(a), int(b)) for a, b in zip([0, *ends[:-1]], ends, strict=True) if b > a]
    null = joint_null(everything.T @ everything, tests)
    best = _best(tried, parts, projection, {}, spacing)
    for finer in (4.0, 16.0):
        near = [
            look
            for effect in problem.layout.effects
            if effect.name in best and best[effect.name].expected > 0
            for look in nearby(effect, best[effect.name].look, spacing[effect.name] / finer)
        ]
        if not near:
            break
        parts = [projection.efficient(J) for J in look_columns(problem, gains, fitted, near)]
        best = _best(near, parts, projection, best, spacing)
    return Screening(best, located, null)


def _best(
    tried: list[ExpansionPoint],
    parts: list[np.ndarray],
    projection: Projection,
    before: dict[str, Seen],
    spacing: dict[str, float],
) -> dict[str, Seen]:
    """The look at each effect that promises most."""
    best = dict(before)
    for look, E in zip(tried, parts, strict=True):
        score = projection.score(E)
        one = Seen(look, score, E, _expected(score, E), spacing[look.effect])
        if look.effect not in best or one.expected > best[look.effect].expected:
            best[look.effect] = one
    return best


def _expected(score: Score, columns: np.ndarray) -> float:
    """Twice the log evidence that a refit would give were the model linear."""
    precision = (
        columns.T @ columns - np.eye(columns.shape[1]) / PRIOR_SPREAD**2
    )  # without the prior's
    information = PRIOR_SPREAD**2 * precision / score.inflation
    room = float(np.linalg.slogdet(np.eye(len(information)) + information)[1])
    return score.statistic - room


def mimicry(A: np.ndarray, B: np.ndarray) -> float:
    """Share of the efficient information of columns A that B reproduces, 0 to 1."""
    VA, VB, VAB = A.T @ A, B.T @ B, A.T @ B
    inner = VAB @ np.linalg.pinv(VB, rcond=1e-10, hermitian=True) @ VAB.T
    return float(np.trace(np.linalg.pinv(VA, rcond=1e-10, hermitian=True) @ inner) / len(VA))


def short_list(screening: Screening, declared: dict[str, tuple[str, ...]]) -> list[str]:
    """The strongest candidates, whatever can mimic the first three, and their declared doubles.

    `declared` gives the confusables of each effect by catalogue name.
    """
    seen = screening.seen
    ranked = sorted(seen, key=lambda n: -seen[n].expected)
    chosen = ranked[:SHORT_LIST]
    best = seen[ranked[0]].expected if ranked else 0.0
    for top in ranked[:3]:
        for other in ranked[SHORT_LIST:]:
            close = mimicry(seen[top].columns, seen[other].columns) > CONFUSABLE
            double = catalogue_name(other) in declared.get(top, ())
            double = double and seen[other].expected > DECLARED * best
            if (close or double) and seen[other].expected > 0 and other not in chosen:
                chosen.append(other)
    # A bent nominal fit ranks wrongly, but not by much: what promises little is left out.
    worth = {name for name in chosen if seen[name].expected > WORTH * best > 0}
    return [name for name in chosen if name in worth or name in ranked[:LEAST]]
