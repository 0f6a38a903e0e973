"""Screening: efficient scores of the whole catalogue and of unnamed forces against one estimate.

Every candidate is linearised at several expansion points (sizes, times of a change, frequencies of
a wave) and stands for the one that promises most. Screening never decides: it makes a short list,
and says by its joint null distribution whether anything is missing at all. An effect that was not
found is absent only as far as the smallest sizes that the data could have shown say.
"""

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Complex, Float, Int

from diffsea.diagnosis.constancy import PARTS
from diffsea.diagnosis.localisation import Cell, latent_acceleration, locate_forces
from diffsea.diagnosis.score import (
    Columns,
    NullDistribution,
    Projection,
    ScoreTest,
    joint_null,
    linearise_model,
)
from diffsea.identification.coordinates import ExpansionPoint, expansion_points
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import Start, estimate
from diffsea.identification.problem import Problem
from diffsea.identification.sufficiency import missing_channel
from diffsea.trajectory import MOTION_CHANNELS, Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.effects.coordinates import PRIOR_SPREAD, Jump, Peaks, Size, vessel_time


SHORT_LIST = 6  # of the strongest candidates, all refitted
LEADERS = 3  # strongest candidates whose confusables are refitted too
CONFUSABLE = 0.5  # share of information mimicked from which on a rival is always refitted
DECLARED = 0.2  # share of the best expected evidence from which on a declared confusable is, too
WORTHWHILE = 0.15  # share of the best expected evidence below which a refit is not worth its time
ALWAYS = 3  # candidates that are refitted however little they promise
SETTLED = 2.0  # sqrt(L / g) after a step of a sensor: until then the filter settles
SETTLING_ROWS = 3.0  # at least
REFINEMENTS = (4.0, 16.0)  # of the grid of onsets or frequencies around the best expansion point
PEAKS = 4  # of a spectrum, or of surprising readings, at which an effect is expanded
COMMON_CLOCK = 2.0  # times the longest run: clocks of runs that lie within it begin together
NEIGHBOURHOOD = 40  # frequencies around one whose median is what gusts alone show
DETECTABLE = 3.0  # standard errors that make a size detectable
PLAUSIBLE = 30.0  # prior sizes beyond which nothing is expected
NO_INFORMATION = 1e-12  # in standard errors of a prior size, squared and inverted


def candidate_effects(
    vessel: Vessel,
    recordings: list[Trajectory],
    per_run: bool = False,
    found: Collection[str] = (),
) -> tuple[Effect, ...]:
    """Effects of the catalogue that this vessel could have and its model lacks.

    What recordings would have to show and do not (heel, what actuators executed) leaves an effect
    out. So do coefficients of the vessel's own that come with an environment, where each run has
    its own.

    Arguments:
        found: names of those that an audit points at; they need not be usual for such a vessel.
    """

    return tuple(
        effect
        for effect in EFFECTS.values()
        if effect.possible(vessel)
        and (effect.usual(vessel) or effect.name in found)
        and not missing_channel(effect, vessel, recordings)
        and not (per_run and effect.per_run and effect.has_coefficients)
    )


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One effect of the catalogue at the expansion point that promises most."""

    point: ExpansionPoint
    score: ScoreTest
    columns: Columns  # efficient, by the coordinates that the point is differentiated by
    expected: float  # evidence that a refit would give, by `expected_evidence`
    reach: float = 0.0  # how far a refit may move an onset or frequency, in prior sizes
    scatter: float = 1.0  # variance of its size by its scatter between parts, over the information


@dataclasses.dataclass(frozen=True)
class Screening:
    """Score tests of all candidates and unnamed forces against one estimate."""

    candidates: dict[str, Candidate]
    cells: tuple[Cell, ...]
    null: NullDistribution

    @property
    def p_value(self) -> float:
        """Family-wise p-value of the strongest test."""
        tests = [one.score.p_value for one in self.candidates.values()]
        tests += [cell.p_value for cell in self.cells]
        return self.null.family_wise(min(tests)) if tests else 1.0

    @property
    def located_p_value(self) -> float:
        """Family-wise p-value of the strongest unnamed force."""
        return self.null.family_wise(min((cell.p_value for cell in self.cells), default=1.0))


def screen(problem: Problem, fitted: Estimate) -> Screening:
    """Test every candidate that is not in the model, and locate the mismatch.

    Candidates are tested at all their expansion points, then twice more closely around the best of
    each. The joint null is that of the first round and of the unnamed forces.

    Arguments:
        fitted: the estimate whose free parameters and effects are the nuisances.
    """
    model = linearise_model(problem, fitted)
    projection = model.projection(fitted.free)
    frequencies, resolution = wave_frequencies(problem, fitted)
    peaks = Peaks(frequencies, jumps(problem, fitted), problem.before)
    effects = [effect for effect in problem.layout.effects if effect.name not in fitted.free]
    best: dict[str, Candidate] = {}
    promise: dict[str, float] = {}  # by all readings, which tell best when something begins

    def test_points(points: list[ExpansionPoint]) -> list[Columns]:
        """Keep those that promise more than what was tried before; the columns of all."""
        columns = []
        for point, J in zip(points, model.by_points(points), strict=True):
            E, name = projection.efficient(J), point.effect
            at_all = expected_evidence(one_sided(point, projection.test(E)), E)
            E = lasting(problem, point, E)
            columns.append(E)
            if name not in best or at_all > promise[name]:
                score, promise[name] = one_sided(point, projection.test(E)), at_all
                best[name] = Candidate(point, score, E, expected_evidence(score, E), spacing[name])
        return columns

    points = [
        point
        for effect in effects
        for point in expansion_points(effect, problem.base, problem.dataset.spans, peaks)
    ]
    spacing = scan_spacings(effects, problem.base, points, resolution)
    columns = test_points(points)
    cells, unnamed = locate_forces(model, projection)
    for finer in REFINEMENTS:
        promising = [one.point for one in best.values() if one.expected > 0]
        around = [nearby_points(point, spacing[point.effect] / finer) for point in promising]
        test_points([point for several in around for point in several])
    parts = problem.dataset.parts_of_runs(max(PARTS))
    best = {
        name: dataclasses.replace(one, scatter=projection.scatter(one.columns, parts))
        for name, one in best.items()
    }
    return Screening(best, cells, _null_distribution(projection, columns, unnamed))


def lasting(problem: Problem, point: ExpansionPoint, E: Columns) -> Columns:
    """Efficient columns of a candidate; of a step of a sensor, without those of its moment.

    One reading that surprises, and those after it by which the filter settles, may be anything: a
    gust, a wild value. A step is what stays.
    """
    scanned = EFFECTS[point.effect].scanned
    if scanned is None or not isinstance(scanned[1], Jump):
        return E
    data, (place, _) = problem.dataset, scanned
    begins = point.at[place] * EFFECTS[point.effect].sizes(problem.base)[place]
    since = np.asarray(data.run_time) - begins
    usual = float(np.median(np.asarray(data.dt)))
    settling = max(SETTLED * float(vessel_time(problem.base)), SETTLING_ROWS * usual)
    moment = (since > 0) & (since <= settling)
    rows = np.concatenate([np.repeat(moment, 6), np.zeros(len(E) - 6 * len(moment), bool)])
    return np.where(rows[:, None], 0.0, E)


def one_sided(point: ExpansionPoint, score: ScoreTest) -> ScoreTest:
    """The test of a secant, which says nothing where data ask for its reverse and there is none.

    What a dead time of a second does, taken away, is no dead time of minus a second.
    """
    if not point.secant:
        return score
    place = point.directions[0]
    coordinate = EFFECTS[point.effect].coordinates[place]
    has_reverse = not (isinstance(coordinate, Size) and coordinate.positive)
    if has_reverse or score.step[0] * point.at[place] > 0:
        return score
    return ScoreTest(0.0, 1.0, np.zeros_like(score.step), score.inflation)


def locate_by_noise_of(better: Estimate, problem: Problem, fitted: Estimate) -> Screening:
    """Where a fitted model fails, measured by the noise of a better one; no candidates.

    With noise of its own, gusts have grown until they hold what the model lacks: little stands
    out. The better model's innovations also say how they depend on one another in time.
    """
    correlation = linearise_model(problem, better).projection(better.free).correlation
    start = Start(fitted.coordinates, better.noise, fitted.left_out)
    fitted = estimate(problem, fitted.free, start, rounds=6, fixed_noise=True)
    model = linearise_model(problem, fitted)
    projection = model.projection(fitted.free, correlation)
    cells, unnamed = locate_forces(model, projection)
    return Screening({}, cells, _null_distribution(projection, [], unnamed))


def _null_distribution(
    projection: Projection,
    candidates: list[Float[np.ndarray, "value _"]],
    unnamed: Float[np.ndarray, "value unnamed"],
) -> NullDistribution:
    """The joint null of candidates and unnamed forces, columns without information left out."""
    informative = [E[:, projection.is_informative(E)] for E in candidates]
    everything = np.concatenate([*informative, unnamed], axis=1)
    ends = np.cumsum([E.shape[1] for E in informative] + [1] * unnamed.shape[1])
    tests = [slice(int(a), int(b)) for a, b in zip([0, *ends[:-1]], ends, strict=True) if b > a]
    return joint_null(everything.T @ everything, tests)


def expected_evidence(score: ScoreTest, columns: Columns) -> float:
    """Twice the log evidence that a refit would give were the model linear.

    The statistic less `log det(1 + V)`, with V the information of the data in prior spreads.
    """
    prior = np.eye(columns.shape[1]) / PRIOR_SPREAD**2
    information = PRIOR_SPREAD**2 * (columns.T @ columns - prior) / score.inflation
    occam = float(np.linalg.slogdet(np.eye(len(information)) + information)[1])
    return score.statistic - occam


def scan_spacings(
    effects: Sequence[Effect], vessel: Vessel, points: list[ExpansionPoint], resolution: float
) -> dict[str, float]:
    """Distance between neighbouring onsets or frequencies tried for each effect, in prior sizes.

    `resolution` (Hz) is that of a frequency; the distance is zero where nothing is scanned.
    """
    out = {effect.name: 0.0 for effect in effects}
    for effect in effects:
        if effect.scanned is not None:
            place, scanned = effect.scanned
            values = [point.at[place] for point in points if point.effect == effect.name]
            out[effect.name] = scanned.spacing(values, effect.sizes(vessel)[place], resolution)
    return out


def nearby_points(point: ExpansionPoint, spacing: float) -> list[ExpansionPoint]:
    """Expansion points at onsets or frequencies around one, three to each side.

    Arguments:
        spacing: in prior sizes; zero where the effect has neither.
    """
    scanned = EFFECTS[point.effect].scanned
    if scanned is None or spacing == 0:
        return []
    place, out = scanned[0], []
    for step in (-3, -2, -1, 1, 2, 3):
        at = list(point.at)
        at[place] += step * spacing
        out.append(dataclasses.replace(point, at=tuple(at)))
    return out


def mimicry(A: Float[np.ndarray, "value a"], B: Float[np.ndarray, "value b"]) -> float:
    """Share of the efficient information of columns A that B reproduces, 0 to 1.

    The mean over A's columns of `V_A^-1 V_AB V_B^-1 V_BA`, with V the products of columns.
    """
    VA, VB, VAB = A.T @ A, B.T @ B, A.T @ B
    inner = VAB @ np.linalg.pinv(VB, rcond=1e-10, hermitian=True) @ VAB.T
    return float(np.trace(np.linalg.pinv(VA, rcond=1e-10, hermitian=True) @ inner) / len(VA))


def short_list(screening: Screening, declared: dict[str, tuple[str, ...]]) -> list[str]:
    """Names of the strongest candidates, and of what may be confused with the first three.

    `declared` gives the confusables of each effect by catalogue name.
    """
    candidates = screening.candidates
    ranked = sorted(candidates, key=lambda name: -candidates[name].expected)
    chosen = ranked[:SHORT_LIST]
    best = candidates[ranked[0]].expected if ranked else 0.0
    for leader in ranked[:LEADERS]:
        for other in ranked[SHORT_LIST:]:
            share = mimicry(candidates[leader].columns, candidates[other].columns)
            is_double = catalogue_name(other) in declared.get(leader, ())
            is_double = is_double and candidates[other].expected > DECLARED * best
            promises = candidates[other].expected > 0
            if (share > CONFUSABLE or is_double) and promises and other not in chosen:
                chosen.append(other)
    # A bent nominal fit ranks wrongly, but not by much: what promises little is left out.
    worth = {name for name in chosen if candidates[name].expected > WORTHWHILE * best > 0}
    return [name for name in chosen if name in worth or name in ranked[:ALWAYS]]


def wave_frequencies(problem: Problem, fitted: Estimate) -> tuple[Float[np.ndarray, "peak"], float]:
    """Frequencies (Hz) at which a wave train may be, and the resolution of the data.

    Peaks in the spectrum of the lasting gusts that the filter finds, in earth-fixed axes.
    """
    data = problem.dataset
    gusts = latent_acceleration(problem, fitted)
    psi = np.asarray(fitted.filter_run(problem).state)[:, 2]
    t, dt, run = np.asarray(data.run_time), np.asarray(data.dt), np.asarray(data.run)
    rows = problem.dataset.recorded_rows & (dt > 0)
    force = (gusts[:, 0] + 1j * gusts[:, 1]) * np.exp(1j * psi)
    return spectral_peaks(force[rows], t[rows], dt[rows], run[rows])


def jumps(problem: Problem, fitted: Estimate) -> dict[str, Float[np.ndarray, "peak"]]:
    """When (s on the runs' clocks) readings of heading and yaw rate surprise most, by channel.

    Each is the time of the reading before: something changed since.
    """
    data, found = problem.dataset, {}
    run = fitted.filter_run(problem)
    surprise = np.abs(np.asarray(run.innovation)) / np.sqrt(np.asarray(run.variance))
    before = np.roll(np.asarray(data.run_time), 1)
    surprise[np.asarray(data.starts)] = 0.0
    for channel in ("psi", "r"):
        values = surprise[:, MOTION_CHANNELS.index(channel)]
        strongest = np.argsort(-values)[:PEAKS]
        found[channel] = np.unique(before[strongest[values[strongest] > 0]])
    return found


def spectral_peaks(
    force: Complex[np.ndarray, "row"],
    t: Float[np.ndarray, "row"],
    dt: Float[np.ndarray, "row"],
    run: Int[np.ndarray, "row"],
) -> tuple[Float[np.ndarray, "peak"], float]:
    """The most prominent frequencies (Hz) common to all runs, and the resolution of the data.

    Relative to the median of the spectrum around each frequency. Runs whose clocks begin together
    keep a common phase; of others, powers are added.

    Arguments:
        force: to north and east, as real and imaginary parts.
        t: on the runs' clocks, s.
        dt: until the next row, s.
    """
    runs = [run == number for number in np.unique(run)]
    longest = max(float(np.ptp(t[own])) for own in runs)
    if np.ptp(t) < COMMON_CLOCK * longest:
        runs = [np.ones(len(t), bool)]
    resolution = 0.5 / max(longest, 1e-9)
    grid = np.arange(4 * resolution, 0.25 / float(np.median(dt)), resolution)
    if len(grid) < 8 or not np.isfinite(force).all():
        return np.zeros(0), resolution
    force = force - force.mean()
    power = np.zeros(len(grid))
    for own in runs:
        wave = np.exp(-2j * np.pi * grid[:, None] * t[own]) * dt[own]
        # North and east are real and imaginary: the power of both is that at f and at -f.
        power += np.abs(wave @ force[own]) ** 2 + np.abs(wave.conj() @ force[own]) ** 2
    half = NEIGHBOURHOOD // 2
    around = [np.median(power[max(0, k - half) : k + half + 1]) for k in range(len(grid))]
    relative = power / np.maximum(around, 1e-300)
    inner = relative[1:-1]
    high = 1 + np.flatnonzero((inner >= relative[:-2]) & (inner >= relative[2:]))
    return grid[high[np.argsort(-relative[high])][:PEAKS]], resolution


def detection_limits(
    problem: Problem, screening: Screening, found: tuple[str, ...]
) -> dict[str, float | None]:
    """The smallest size of every candidate that was not found that would have shown.

    Three standard errors of the effect's stated parameter by the data alone, its other coefficients
    unknown, in the run that says most; None where no plausible size would have shown. The errors
    are those by which sizes scatter between parts of the data, where that is more than noise says.
    """
    limits = {}
    for name, candidate in screening.candidates.items():
        if name in found:
            continue
        size = len(candidate.point.directions)
        columns = candidate.columns[: problem.dataset.measured.size]  # not the prior's rows
        V = columns.T @ columns / max(candidate.score.inflation, candidate.scatter)
        runs = [slice(k, k + size) for k in range(0, len(V) // size * size, size)]
        sizes = [_smallest_size(problem.base, candidate.point, V[own, own]) for own in runs]
        shown = [value for value in sizes if value]
        most = max if EFFECTS[name].stated_inversely else min
        limits[name] = most(shown) if shown else None
    return limits


def _smallest_size(
    vessel: Vessel, point: ExpansionPoint, V: Float[np.ndarray, "moved moved"]
) -> float | None:
    """The parameter at three standard errors by the information `V`; None if implausible.

    Along each coordinate alone and along the worst direction, whichever says more of the
    parameter: a flow's speed has no coordinate of its own.
    """
    effect = EFFECTS[point.effect]
    values, vectors = np.linalg.eigh(V)
    spread = DETECTABLE / np.sqrt(np.maximum(values, NO_INFORMATION))
    steps = [*np.diag(np.sqrt((vectors**2) @ spread**2)), spread[0] * vectors[:, 0]]
    sizes = np.array(effect.sizes(vessel))
    named = []
    for step in steps:
        at = np.array(point.at, float)
        at[list(point.directions)] = step * (np.sign(step[np.abs(step).argmax()]) or 1.0)
        value = abs(float(effect.decode(vessel, at * sizes)[effect.stated_key]))
        named.append((value, step))
    value, step = (min if effect.stated_inversely else max)(named, key=lambda pair: pair[0])
    return None if np.linalg.norm(step) > PLAUSIBLE else value
