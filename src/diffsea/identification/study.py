"""Identification from start to end: what to free, fit, judge, and what to record next."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from diffsea.budget import current_budget
from diffsea.errors import UserError
from diffsea.identification.coordinates import free_by_default, negative_effects
from diffsea.identification.estimates import (
    Estimate,
    ParameterRecord,
    effect_table,
    is_known,
    parameter_estimates,
)
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.fit import compile_programs, noise_at, normalised_rms
from diffsea.identification.holdout import (
    HEAD_SHARE,
    HeldOut,
    Split,
    cut_recordings,
    held_out_coordinates,
    thinned,
)
from diffsea.identification.multistart import Agreement, effect_starts, multistart
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.objectives.joint import with_trial_numbers
from diffsea.identification.objectives.output_error import OutputError
from diffsea.identification.objectives.trial_numbers import (
    MeasuredTrial,
    TrialNumbers,
    acts_in_trials,
)
from diffsea.identification.problem import Problem, make_problem
from diffsea.identification.run_models import (
    Motion,
    RunModel,
    filtered_states,
    held_out_models,
)
from diffsea.identification.sufficiency import FitVerdict, missing_channel, sufficiency
from diffsea.identification.uncertainty.design import NextManoeuvre, next_manoeuvre
from diffsea.identification.uncertainty.identifiability import (
    Identifiability,
    asymmetric_parameters,
    identifiability,
    profile_interval,
)
from diffsea.identification.uncertainty.sides import SideRatio, differing_sides
from diffsea.identification.uncertainty.sources import Sources, sources
from diffsea.parameters import Parameter, check_names
from diffsea.progress import Progress, no_progress
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect, catalogue_name, find_effects
from diffsea.vessel.files import default_priors


OBJECTIVES = ("innovation", "free-run", "trial-numbers")
ANCHORS = ("mass", "thrust")
MORE_STARTS = 8  # where a fit from one leaves something missing
DETERMINED_SHARE = 0.9  # up to which a manoeuvre is looked for that would tell more
INERTIA = ("mass", "I_z")
# What fixes the common factor of mass, drag and thrust, by whether inertia and actuators are free.
ANCHORED = {
    (True, True): "mass and actuators are both free: motion alone fixes mass, drag and thrust only "
    "up to one common factor, which rests on the priors here",
    (True, False): "anchored by the thrust: actuators stay as in the vessel file, masses are "
    "fitted",
    (False, True): "anchored by the mass: mass and moment of inertia stay as in the vessel file",
    (False, False): "anchored by mass, moment of inertia and actuators, which stay as in the "
    "vessel file: motion alone fixes mass, drag and thrust only up to one common factor",
}


@dataclasses.dataclass(frozen=True)
class FitSettings:
    """How to identify.

    `anchor` says what fixes the common factor of mass, drag and thrust: the masses of the
    vessel file, or its thrusts, mass and moment of inertia then being free.
    """

    objective: str = "innovation"
    free: tuple[str, ...] | None = None
    anchor: str = "mass"
    priors: Mapping[str, Parameter | None] = dataclasses.field(default_factory=dict)
    starts: int | None = None  # None: one, and `MORE_STARTS` where that leaves something missing
    profiles: tuple[str, ...] | None = None  # None: the asymmetric ones
    effects: tuple[str, ...] = ()  # of the catalogue, estimated besides
    per_recording: bool = False  # whether wind and current are each recording's own
    seed: int = 0
    proposes: bool = True  # whether a manoeuvre is looked for that would tell more


@dataclasses.dataclass(frozen=True)
class Study:
    """Everything found."""

    vessel_name: str
    objective: AbstractObjective
    estimate: Estimate
    anchor: str  # a sentence
    identifiability: Identifiability
    agreement: Agreement | None  # None: a single start
    profiles: dict[str, tuple[float, float]]  # 90 % intervals, in the parameters' units
    next: NextManoeuvre | None  # None: the data leave nothing open, or trial numbers were fitted
    outliers: dict[str, int]  # left out of each motion channel
    sources: Sources | None = None  # where recordings and trial numbers were fitted together
    # Decimal logarithms of each effect's odds against none, where trial numbers alone were fitted.
    log10_odds: Mapping[str, float] = dataclasses.field(default_factory=dict)
    sides: tuple[SideRatio, ...] = ()  # pairs of thrusters that the fit found to differ

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The table of parameters as fit.json has it, and whether an interval is `profiled`.

        `interval` is that of the profile likelihood where there is one.
        """
        rows = []
        for one in parameter_estimates(self.objective.parameters, self.estimate):
            interval = self.profiles.get(one.name, one.interval)
            row = dataclasses.replace(one, interval=interval).as_dict()
            rows.append(row | {"profiled": one.name in self.profiles})
        return rows

    @property
    def side_records(self) -> list[dict[str, Any]]:
        """Pairs of thrusters that the fit found to differ, as fit.json has them."""
        return [one._asdict() for one in self.sides]

    @property
    def values(self) -> dict[str, float]:
        """Fitted values by name, in SI units."""
        return {row["name"]: row["value"] for row in self.rows}

    @property
    def effects(self) -> dict[str, list[dict[str, ParameterRecord]]]:
        """Parameters of each effect with standard errors, for each of its per-run instances."""
        return self.objective.effect_records(self.estimate)

    @property
    def effect_tables(self) -> list[dict]:
        """Tables for the vessel file of the effects seen that all recordings share."""
        return [
            effect_table(self.objective.base, name, instances[0])
            for name, instances in self.effects.items()
            if len(instances) == 1 and is_known(instances[0])
        ]

    @property
    def problem(self) -> Problem | None:
        """The recordings' problem; None for trial numbers."""
        return self.objective.problem

    @property
    def recorded(self) -> Problem:
        """The recordings' problem. Raises `UserError` where trial numbers were fitted."""
        problem = self.problem
        if problem is None:
            raise UserError("a fit to trial numbers has no recordings to judge")
        return problem

    def quality(self, test: Sequence[Trajectory] = ()) -> dict[str, float]:
        """Root-mean-square normalised misfit of what was fitted (`train`), and of runs held out.

        One at the noise level. The misfit of recordings is that of the filter's innovations; that
        of `trial_numbers` stands beside it where both were fitted.
        """
        if self.problem is None:
            cost, values = self.objective.squares(self.estimate)
            return {"train": math.sqrt(cost / values)}
        fitted = self._filtered
        found = {"train": normalised_rms(fitted.filter_run(self.problem))}
        if self.sources is not None:
            numbers = self.sources.trial_numbers
            found["trial_numbers"] = math.sqrt(numbers.cost / numbers.values)
        if test:
            data = self.split(test)
            coordinates = held_out_coordinates(data, fitted)
            found["test"] = normalised_rms(data.test.run_filter(coordinates, fitted.noise))
        return found

    def split(self, test: Sequence[Trajectory]) -> Split:
        """What was fitted and runs held out, as problems of one kind."""
        train = self.recorded
        layout = train.layout
        own = layout.per_run and any(e.per_run for e in layout.effects)
        priors = {p.name: p for p in layout.parameters}

        def problem_of(runs: list[Trajectory]) -> Problem:
            whole = make_problem(
                train.base, runs, tuple(priors), layout.effects, layout.per_run, priors
            )
            return thinned(whole, self.objective.one_sample_in)

        if not own:
            return Split(train, problem_of(list(test)), None, (), tuple(test))
        heads, tails = cut_recordings(test, HEAD_SHARE)
        head, rest = problem_of(heads), problem_of(tails)
        return Split(train, rest, head, (), tuple(tails), HeldOut.AFTER_HEAD)

    def held_out(self, test: Sequence[Trajectory]) -> tuple[list[Trajectory], list[RunModel]]:
        """Runs to judge predictions by, and the fitted vessel in the environment of each.

        Where each recording has its own, it is estimated on the first part of a run held out,
        and the rest is judged.
        """
        data = self.split(test)
        return list(data.held_out), held_out_models(data, self._filtered)

    def fitted_models(self, vessel: Vessel, recordings: Sequence[Trajectory]) -> list[RunModel]:
        """The fitted vessel in each run that was fitted; none of trial numbers alone."""
        if self.problem is None:
            return []
        fitted = self._filtered
        states = filtered_states(self.problem, fitted.coordinates, fitted.noise, recordings)
        return [RunModel(vessel, own) for own in states]

    def start_states(
        self, recordings: Sequence[Trajectory], test: Sequence[Trajectory]
    ) -> list[Motion]:
        """States in which the vessel file's predictions begin: held out runs, else those fitted."""
        if self.problem is None:
            return []
        data = self.split(test) if test else None
        problem, runs = (self.problem, recordings) if data is None else (data.test, data.held_out)
        return filtered_states(problem, problem.start()[0], self.noise, runs)

    @property
    def noise(self) -> Noise:
        """Noise of the filter."""
        return self._filtered.noise

    @functools.cached_property
    def _filtered(self) -> Estimate:
        """The estimate with noise of a filter."""
        return with_noise(self.estimate, self.recorded)

    def verdict(
        self, recordings: Sequence[Trajectory], test: Sequence[Trajectory] = ()
    ) -> FitVerdict:
        """Whether the model describes the runs held out, or what was fitted where there are none.

        Arguments:
            recordings: those that were fitted; none where trial numbers alone were.
        """
        one_start = self.agreement is None
        if self.problem is None or not test:
            return verdict_on_fitted(self.objective, self._filtered, recordings, one_start)
        found = sufficiency(self.split(test), self._filtered)
        numbers = None if self.sources is None else self.sources.p_value
        return FitVerdict(found, numbers, True, one_start)


def verdict_on_fitted(
    objective: AbstractObjective,
    fitted: Estimate,
    recordings: Sequence[Trajectory],
    one_start: bool = True,
) -> FitVerdict:
    """Whether a model describes what it was fitted to, nothing being held out.

    Arguments:
        fitted: with the noise of a filter, where there are recordings.
    """
    train = objective.problem
    if train is None:
        chance = float(chi2.sf(*objective.squares(fitted)))
        return FitVerdict(None, chance, False, one_start)
    judged = sufficiency(Split(train, train, None, (), tuple(recordings)), fitted)
    of_both = sources(objective, fitted)
    numbers = None if of_both is None else of_both.p_value
    return FitVerdict(judged, numbers, False, one_start)


def with_noise(fitted: Estimate, problem: Problem) -> Estimate:
    """The estimate, with the noise that a filter finds there where the objective has none."""
    if isinstance(fitted.state, Noise):
        return fitted
    return dataclasses.replace(fitted, state=noise_at(problem, fitted.coordinates))


@one_blas_thread
def identify(
    vessel: Vessel,
    data: Sequence[Trajectory | MeasuredTrial],
    settings: FitSettings = FitSettings(),
    progress: Progress = no_progress,
) -> Study:
    """Fit a vessel's parameters to recordings, to sheets of trial numbers, or to both together.

    Raises:
        UserError: an unknown parameter, objective or anchor, data that do not suit, or what
            `require_possible` refuses.
    """
    parameters = free_parameters(vessel, settings)
    objective = _objective(vessel, parameters, data, settings)
    problem, agreement = objective.problem, None
    names = tuple(one.name for one in (*parameters, *objective.effects))
    of_sheet = objective if isinstance(objective, TrialNumbers) else None
    besides = effect_starts(problem) if problem is not None else None
    besides = of_sheet.effect_starts() if of_sheet is not None else besides
    count = settings.starts or 1
    if count > 1 or (besides is not None and len(besides) > 1):
        fitted, agreement = multistart(objective, names, count, settings.seed, progress, besides)
    else:
        fitted = objective.fit(names, progress=progress)
        if settings.starts is None and _is_missing_something(objective, fitted, data):
            progress("something is missing: is there a better fit elsewhere?")
            known = fitted if np.isfinite(fitted.deviance) else None
            fitted, agreement = multistart(
                objective, names, MORE_STARTS, settings.seed, progress, besides, known
            )
    require_possible(problem, fitted)
    wanted = settings.profiles
    if wanted is None:
        wanted = asymmetric_parameters(objective, fitted)
        if wanted:
            many = f"{len(wanted)} interval{'s' if len(wanted) > 1 else ''}"
            progress(f"{many} by profile likelihood; --profile none leaves them out")
    profiles, left = {}, current_budget()
    for name in wanted:
        if not left.skips(f"the profile of {name}"):
            interval = profile_interval(objective, fitted, name, progress)
            if not left.skips(f"the profile of {name}"):  # else its fits were cut short
                profiles[name] = interval
    proposal = None  # a manoeuvre that would tell more, where the data leave something open
    is_open = problem is not None and not float(fitted.shrinkage.min()) > DETERMINED_SHARE
    asked = settings.proposes and is_open
    if problem is not None and asked and not left.skips("the manoeuvre to record next"):
        progress("looking for the manoeuvre that would tell most")
        proposal = next_manoeuvre(problem, with_noise(fitted, problem))
    heavy = any(name in INERTIA for name in names)
    pushing = any(name.split(".")[0] in vessel.actuators for name in names)
    return Study(
        vessel.name,
        objective,
        fitted,
        ANCHORED[heavy, pushing],
        identifiability(parameters, fitted),
        agreement,
        profiles,
        proposal,
        objective.outliers,
        sources(objective, fitted),
        {} if of_sheet is None else of_sheet.log10_odds(fitted, progress),
        () if problem is None else tuple(differing_sides(problem, fitted)),
    )


def _is_missing_something(
    objective: AbstractObjective, fitted: Estimate, data: Sequence[Trajectory | MeasuredTrial]
) -> bool:
    """Whether a fit diverges, or does not describe what it was fitted to."""
    if current_budget().skips("a look for a better fit from other starts"):
        return False
    if not np.isfinite(fitted.deviance):
        return True
    problem = objective.problem
    judged = fitted if problem is None else with_noise(fitted, problem)
    recordings = [one for one in data if isinstance(one, Trajectory)]
    return verdict_on_fitted(objective, judged, recordings).missing


def require_possible(problem: Problem | None, fitted: Estimate) -> None:
    """Refuse an estimate that no vessel can have; `problem` is None for trial numbers.

    Raises:
        UserError: the model diverges there, or an effect that cannot be negative is.
    """
    if not np.isfinite(fitted.deviance):
        raise UserError(
            "the model diverges on these data and no step of the fit mends it; check units and "
            "signs with `diffsea audit`, or start nearer (vessel file, --priors)"
        )
    if problem is not None and (absent := negative_effects(problem.layout, fitted.coordinates)):
        raise UserError(
            f"the data do not show {' or '.join(absent)}: the best fit makes it negative, which it "
            "cannot be; leave it out of --effects"
        )


def with_priors(
    vessel: Vessel,
    free: tuple[str, ...] | None,
    priors: Mapping[str, Parameter | None],
    anchor: str = "mass",
) -> tuple[Parameter, ...]:
    """The parameters to estimate.

    Arguments:
        free: their names; `free_by_default` and those with a prior if None.
        priors: of those that have one other than `default_priors`; None for what stays as it is.
        anchor: with "thrust" mass and moment of inertia are free by default.

    Raises:
        UserError: a name that the vessel does not have, or an unknown anchor.
    """
    if anchor not in ANCHORS:
        raise UserError(f"the anchor is one of {', '.join(ANCHORS)}, not {anchor!r}")
    known = default_priors(vessel) | dict(priors)
    if free is None:
        free = free_by_default(vessel) + (INERTIA if anchor == "thrust" else ())
        free += tuple(name for name, prior in priors.items() if prior is not None)
    check_names(vessel, free)
    chosen = (known[name] for name in dict.fromkeys(free))
    return tuple(one for one in chosen if one is not None)


def free_parameters(vessel: Vessel, settings: FitSettings) -> tuple[Parameter, ...]:
    """The free parameters with their priors."""
    left = with_priors(vessel, settings.free, settings.priors, settings.anchor)
    unfree = [name for name in settings.profiles or () if name not in [p.name for p in left]]
    if unfree:
        raise UserError(f"{', '.join(unfree)} cannot be profiled: only what is fitted can")
    if not left:
        raise UserError("nothing is free to be estimated; name parameters with --free")
    return left


def _objective(
    vessel: Vessel,
    parameters: tuple[Parameter, ...],
    data: Sequence[Trajectory | MeasuredTrial],
    settings: FitSettings,
) -> AbstractObjective:
    name = settings.objective
    if name not in OBJECTIVES:
        raise UserError(f"there is no objective {name!r}; choose one of {', '.join(OBJECTIVES)}")
    sheets = [one for one in data if isinstance(one, MeasuredTrial)]
    if (name == "trial-numbers") != (len(sheets) == len(data)):
        raise UserError(
            "the objective trial-numbers is fitted to sheets (TOML) alone, the others to "
            "recordings, with or without sheets besides; give the data that go with it"
        )
    if name == "trial-numbers":
        chosen = effects_to_estimate(vessel, settings.effects)
        for effect in chosen:
            if not acts_in_trials(effect):
                raise UserError(
                    f"{effect.name} belongs to recordings: trial numbers are those of the vessel, "
                    "whose hull or actuators an effect has to be of"
                )
        return TrialNumbers(vessel, parameters, sheets, chosen)
    recordings = [one for one in data if isinstance(one, Trajectory)]
    priors = {p.name: p for p in parameters}
    effects = effects_to_estimate(vessel, settings.effects)
    for effect in effects:
        if lacking := missing_channel(effect, vessel, recordings):
            raise UserError(
                f"{effect.name} cannot be estimated without the channel {lacking} in every "
                "recording; add it, map it, or leave the effect out"
            )
    shared = [effect.name for effect in effects if effect.per_run and effect.has_coefficients]
    if settings.per_recording and shared:
        raise UserError(
            f"{shared[0]} has coefficients that all recordings share, and each recording cannot "
            f"have its own: ask for {catalogue_name(shared[0])}, or for one environment of all"
        )
    problem = make_problem(
        vessel, recordings, tuple(priors), effects, settings.per_recording, priors
    )
    problem = with_trial_numbers(problem, sheets) if sheets else problem
    if name != "innovation":
        return OutputError(problem)
    compile_programs(problem)
    return Innovations(problem)


def effects_to_estimate(vessel: Vessel, names: Sequence[str]) -> tuple[Effect, ...]:
    """Effects of the catalogue by name; where none has that very name, all its variants.

    Raises:
        UserError: an unknown name, or an effect that the vessel cannot have.
    """
    found: list[Effect] = []
    for name in names:
        possible = [effect for effect in find_effects(name) if effect.possible(vessel)]
        if not possible:
            raise UserError(
                f"{vessel.name!r} cannot have {name} estimated: it has it, or lacks parts"
            )
        # An entry of all coefficients makes those of some, or of more, of no use beside it.
        found += [effect for effect in possible if effect.name == name] or possible
    return tuple(found)
