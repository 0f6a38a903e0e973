"""From recordings to names and a verdict: fit, screen, add and take away, say what is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from diffsea.budget import current_budget
from diffsea.diagnosis.bootstrap import LEAST_DRAWS, NO_BOOTSTRAP, Bootstrap, bootstrap
from diffsea.diagnosis.decision import AcceptedEffect
from diffsea.diagnosis.elimination import (
    ask_again,
    ask_when_again,
    withdraw_outdone,
    withdraw_worsening,
)
from diffsea.diagnosis.first_hypotheses import (
    FirstHypothesis,
    audited_effects,
    certain_effects,
    judge_first,
    names_found,
)
from diffsea.diagnosis.localisation import UnexplainedForce, model_unexplained_force
from diffsea.diagnosis.screening import Screening, candidate_effects, locate_by_noise_of, screen
from diffsea.diagnosis.selection import (
    ALPHA,
    FULL_EFFORT,
    NO_DEADLINE,
    Deadline,
    Effort,
    Search,
    forward_search,
)
from diffsea.errors import UserError
from diffsea.identification.coordinates import free_by_default
from diffsea.identification.data.dataset import DatasetShape
from diffsea.identification.estimates import Estimate, FitOutcome
from diffsea.identification.filter.correlated_errors import independent_sampling
from diffsea.identification.fit import Start, compile_programs, estimate, estimate_surely
from diffsea.identification.holdout import Split, split_data, thinned
from diffsea.identification.multistart import multistart
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.problem import Problem, make_problem
from diffsea.identification.reference import Reference, reference_of
from diffsea.identification.sufficiency import Shortfall, shortfalls
from diffsea.parameters import Parameter
from diffsea.progress import Progress, Remark, no_progress
from diffsea.recordings import Finding
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import spoken_name


STARTS = 4  # of the nominal fit, besides its first: the prior mean again, with the noise held
FIRST_ROUNDS = 20  # of the nominal fit, after which its noise is looked at


@dataclass(frozen=True, kw_only=True)
class Diagnosis(Search):
    """Everything found: the end of the search, the verdict, and what is left."""

    verdict: str  # "consistent", "explained", "ambiguous", "unexplained" or "insufficient"
    split: Split
    location: Screening  # unnamed forces in the nominal model, measured by the final noise
    unexplained_p_value: float  # family-wise, of what no accepted effect explains
    unexplained: UnexplainedForce | None = None  # a model of what is left, if significant
    bootstrap: Bootstrap = NO_BOOTSTRAP
    shortfalls: tuple[Shortfall, ...] = ()  # why the data do not tell, where nothing is missing


@one_blas_thread
def diagnose(
    vessel: Vessel,
    recordings: list[Trajectory],
    test: list[Trajectory] | None = None,
    per_run: bool = False,
    free: tuple[str, ...] | None = None,
    progress: Progress = no_progress,
    draws: int = 0,
    findings: Sequence[Finding] = (),
    deadline: Deadline = NO_DEADLINE,
    priors: Mapping[str, Parameter] | None = None,
    effort: Effort = FULL_EFFORT,
    reference: Sequence[Trajectory] = (),
) -> Diagnosis:
    """Find, name and model what the vessel's model lacks.

    Arguments:
        vessel: the nominal model.
        recordings: what to explain.
        test: held-out recordings; the last part of each recording where there are none.
        per_run: whether wind and current differ from run to run.
        free: parameters that may move; `free_by_default` if None.
        draws: data sets to simulate and refit for the chance of what is seen; 0: to first order.
        findings: what an audit found in the recordings; held-out ones count, too.
        deadline: after which what was found until then is reported as it is.
        priors: of parameters that have one other than `default_priors`.
        effort: how far the search goes.
        reference: recordings of the vessel as she was before what is searched: what they tell of
            her parameters is known beforehand.

    Raises:
        UserError: recordings that do not fit the vessel, or are too short to hold anything out;
            too few draws to show one per cent.
    """
    if draws and draws < LEAST_DRAWS:
        raise UserError(
            f"{draws} bootstrap draws cannot show one per cent: take {LEAST_DRAWS} or more"
        )
    free = free_by_default(vessel) if free is None else free
    test = test or []
    whole = [*recordings, *test]
    effects = candidate_effects(vessel, whole, per_run, names_found(findings))

    def problem_of(runs: list[Trajectory], least: DatasetShape) -> Problem:
        return make_problem(vessel, runs, free, effects, per_run, priors, least=least)

    data = split_data(problem_of, recordings, test, per_run)
    progress("fitting the vessel file to the recordings")
    compile_programs(data.train, screened=True)
    if reference:
        progress("fitting it to the recordings of reference first")
        earlier = problem_of(list(reference), data.train.dataset.shape)
        data = data.beside(reference_fit(earlier, free, progress))
    rough = estimate(data.train, free, rounds=FIRST_ROUNDS)
    if seldom := sparse_sampling(data.train, rough):
        often = ", ".join(f"{name} every {number}" for name, number in seldom.items())
        progress(f"neighbouring samples err alike; used are of {often}")
        data = data.thinned(seldom)
    nominal = estimate_surely(data.train, free, Start.of_other_data(rough), progress=progress)
    progress("asking which causes could explain what is left")
    screening = screen(data.train, nominal)
    if screening.p_value < ALPHA:
        better = nominal_elsewhere(data.train, nominal, progress)
        if better is not nominal:
            nominal, screening = better, screen(data.train, better)
    null = bootstrap(data.train, nominal, draws, progress) if draws else NO_BOOTSTRAP
    runs = len(recordings) + len(test)
    layout = data.train.layout
    first = audited_effects(vessel, layout, findings, runs) + certain_effects(layout)
    begun = judge_all_first(data, nominal, screening, first, progress, deadline)
    return explain(data, begun, null, progress, deadline, effort)


def sparse_sampling(problem: Problem, rough: Estimate) -> Mapping[str, int]:
    """One in how many samples of a channel err independently, where fewer than all do."""
    length = float(problem.base.rigid_body.length)
    return independent_sampling(rough.filter_run(problem), problem.dataset, length)


def reference_fit(problem: Problem, free: tuple[str, ...], progress: Progress) -> Reference:
    """What recordings of a reference period tell of the vessel's parameters."""
    rough = estimate(problem, free, rounds=FIRST_ROUNDS)
    problem = thinned(problem, sparse_sampling(problem, rough))
    fitted = estimate_surely(problem, free, Start.of_other_data(rough), progress=progress)
    if fitted.outcome not in (FitOutcome.CONVERGED, FitOutcome.BOUNDED):
        progress(Remark(f"of the recordings of reference, {fitted.outcome.sentence}"))
    return reference_of(problem, fitted)


def nominal_elsewhere(problem: Problem, nominal: Estimate, progress: Progress) -> Estimate:
    """A better fit of the nominal model, where other starts lead to one; else itself.

    What a fit takes for gusts because it ended in the wrong place would be named as physics.
    """
    if current_budget().skips("a look for a better fit from other starts"):
        return nominal
    objective = Innovations(problem, keeps_samples=True)
    return multistart(objective, nominal.free, STARTS, progress=progress, known=nominal)[0]


def judge_all_first(
    data: Split,
    nominal: Estimate,
    screening: Screening,
    first: Sequence[FirstHypothesis],
    progress: Progress,
    deadline: Deadline = NO_DEADLINE,
) -> Search:
    """Where the search begins: the nominal model with what the recordings tell by themselves."""
    now = Search(nominal, screening, nominal, screening)
    for one in first:
        told = "the audit found" if one.is_audited else "recorded is"
        work = f"whether the model agrees that {told} {spoken_name(one.effect)}"
        if deadline.is_over:
            current_budget().note(work)
            return replace(now, complete=False)
        progress(f"{told} {spoken_name(one.effect)}: does the model agree?")
        accepted = judge_first(data, now.final, now.final_screening, one)
        if current_budget().skips(work):
            return replace(now, complete=False)  # its fits were cut short
        if accepted is None:
            continue
        progress(f"found: {spoken_name(one.effect)}")
        final = accepted.hypothesis.estimate
        now = replace(
            now,
            final=final,
            final_screening=screen(data.train, final),
            effects=(*now.effects, accepted),
            first=(*now.first, one),
        )
    return now


def explain(
    data: Split,
    begun: Search,
    null: Bootstrap,
    progress: Progress,
    deadline: Deadline = NO_DEADLINE,
    effort: Effort = FULL_EFFORT,
) -> Diagnosis:
    """Name, model and locate what a nominal model that was fitted and screened lacks."""
    found = forward_search(data, begun, null, progress, deadline, effort)
    left = current_budget()
    if found.searched[:-1] and deadline.is_over:
        left.note("asking again for the effects")
        found, asked = replace(found, complete=False), ()
    else:
        # All effects but the last are asked for again, beside those that came after them.
        found = ask_when_again(data, found, progress)
        asked = found.searched[:-1]
    kept, changed = ask_again(data, found, asked, progress)
    if changed:
        kept = replace(kept, final_screening=screen(data.train, kept.final))
    final = withdraw_worsening(data, withdraw_outdone(data, kept, null, progress), progress)
    p_value = unexplained_p_value(kept, final, null)
    short = shortfalls(data, final.final) if p_value >= ALPHA else ()
    verdict = verdict_on(final.effects, p_value, short)
    unexplained, location = None, final.nominal_screening
    if verdict == "unexplained" and not left.skips("a model of what is left"):
        progress("describing what has no name")
        unexplained = model_unexplained_force(data, final.final)
    if final.effects and not left.skips("locating the mismatch by the final noise"):
        progress("finding where model and recordings differ")
        location = locate_by_noise_of(final.final, data.train, final.nominal)
    return Diagnosis(
        **vars(replace(final, complete=final.complete and not left.left_out)),
        verdict=verdict,
        split=data,
        location=location,
        unexplained_p_value=p_value,
        unexplained=unexplained,
        bootstrap=null,
        shortfalls=short if verdict == "insufficient" else (),
    )


def unexplained_p_value(kept: Search, final: Search, null: Bootstrap) -> float:
    """Family-wise p-value of what no accepted effect explains, before or after withdrawals.

    What stands out to any candidate counts, where no name could be given to it or where there was
    no time to ask.
    """
    left = min(null.of_located(one.final_screening.located_p_value) for one in (kept, final))
    nameless = not final.searched and final.short_list.has_something_nameless
    if nameless or not final.complete:
        left = min(left, null.of_strongest(final.final_screening.p_value))
    return left


def verdict_on(
    accepted: tuple[AcceptedEffect, ...], unexplained: float, short: Sequence[Shortfall] = ()
) -> str:
    """The verdict, from what was accepted, the p-value of what it does not explain, and what the
    model still owes on runs held out: names that leave these wrong do not explain the mismatch."""
    if unexplained < ALPHA:
        return "unexplained"
    if not accepted:
        return "insufficient" if short else "consistent"
    if any(one.rivals for one in accepted):
        return "ambiguous"
    return "unexplained" if {Shortfall.MISFIT, Shortfall.MOTION} & set(short) else "explained"
