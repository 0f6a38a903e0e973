"""The search for effects on a craft with two causes concealed: a current and a gyro's bias.

A catalogue of four effects, two parameters and short runs keep it small.
"""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, STEADY, UNSTEADY, hypothesis, still_problem, usv
from tests.runs import random_steps

from diffsea import EFFECTS, Finding, Trajectory, audit
from diffsea.diagnosis import elimination, refits
from diffsea.diagnosis.bootstrap import NO_BOOTSTRAP, Bootstrap
from diffsea.diagnosis.decision import AcceptedEffect, ShortList, decide
from diffsea.diagnosis.elimination import ask_again, withdraw_outdone, withdraw_worsening
from diffsea.diagnosis.first_hypotheses import FirstHypothesis, audited_effects
from diffsea.diagnosis.record import summary
from diffsea.diagnosis.refits import judge_exchanged, make_hypothesis
from diffsea.diagnosis.score import linearise_model
from diffsea.diagnosis.screening import screen
from diffsea.diagnosis.selection import (
    Deadline,
    Effort,
    Search,
    find_pair,
    forward_search,
    resume_stalled_fit,
)
from diffsea.diagnosis.verdict import explain, judge_all_first
from diffsea.identification.fit import Start, estimate
from diffsea.identification.free_predictions import ChanceOfLoss, MotionChange, relative_losses
from diffsea.identification.holdout import exchanged_fit, split_data
from diffsea.identification.problem import make_problem
from diffsea.progress import no_progress
from diffsea.report.wording.caveats import incomplete_sentence


pytestmark = pytest.mark.slow


FREE = ("X_u", "N_r")
NAMES = ("gyro-bias", "current", "lever-arm", "wave-force")
BIAS = 0.03  # rad/s
CURRENT = {"current": {"speed": 0.4, "direction": 2.0}}


@pytest.fixture(scope="module")
def data():
    """One run to explain and one held out."""
    runs = [random_steps(DOCUMENT, seed, 60.0, 0.5, CURRENT) for seed in (7, 8)]
    runs = [dataclasses.replace(run, r=run.r + BIAS) for run in runs]
    effects = tuple(EFFECTS[name] for name in NAMES)

    def problem_of(recordings, least):
        return make_problem(usv(), recordings, FREE, effects, least=least)

    return split_data(problem_of, runs[:1], runs[1:], per_run=False)


@pytest.fixture(scope="module")
def nominal(data):
    return estimate(data.train, FREE)


@pytest.fixture(scope="module")
def screening(data, nominal):
    return screen(data.train, nominal)


def begun(nominal, screening) -> Search:
    """A search that has found nothing yet."""
    return Search(nominal, screening, nominal, screening)


@pytest.fixture(scope="module")
def found(data, nominal, screening):
    return forward_search(data, begun(nominal, screening), NO_BOOTSTRAP, no_progress)


def accepted_names(search) -> tuple[str, ...]:
    return tuple(one.name for one in search.effects)


def with_statistic(
    accepted: AcceptedEffect, statistic: float, gained: float | None = None
) -> AcceptedEffect:
    """The same effect, had its score test come out as that, and its fit gained as much."""
    one = accepted.hypothesis
    seen = dataclasses.replace(
        one.candidate, score=one.candidate.score._replace(statistic=statistic)
    )
    drop = one.inflation * (statistic if gained is None else gained)
    changed = dataclasses.replace(one, candidate=seen, deviance_drop=drop)
    return dataclasses.replace(accepted, hypothesis=changed)


def test_both_causes_are_found_one_after_the_other(data, found):
    assert set(accepted_names(found)) == {"gyro-bias", "current"}
    assert {one.effect for one in found.short_list.hypotheses} >= {"gyro-bias", "current"}
    first, second = found.effects
    assert first.hypothesis.estimate.free == (*FREE, first.name)
    assert found.final is second.hypothesis.estimate
    bias = data.train.layout.physical("gyro-bias", found.final.coordinates)[0]
    flow = data.train.layout.physical("current", found.final.coordinates)[0]
    assert bias == pytest.approx([BIAS], rel=0.15)
    assert flow == pytest.approx(0.4 * np.array([np.cos(2), np.sin(2)]), abs=0.04)
    assert found.final_screening.located_p_value > 0.01


def test_runs_that_change_places_judge_an_effect_by_all_of_them(data, nominal, found):
    one = found.effects[0].hypothesis
    both = judge_exchanged(data, nominal, one)
    assert both.exchanged is not None and both.exchanged.clear and both.gain is one.gain
    assert both.held_out_motion is one.motion and both.motion != one.motion
    before, after = (exchanged_fit(data, model) for model in (nominal, one.estimate))
    there = relative_losses(data.exchanged, before, after)[20.0]
    here = relative_losses(data, nominal, one.estimate)[20.0]
    ratio = np.concatenate([here.after, there.after]).mean()
    ratio /= np.concatenate([here.before, there.before]).mean()
    assert both.motion is not None and both.motion.ratio[20.0] == pytest.approx(ratio)


def test_a_screening_knows_how_sizes_scatter_between_eighths_of_a_run(data, nominal, screening):
    residual = linearise_model(data.train, nominal).projection(FREE).residual
    rows = len(data.train.dataset.run)
    eighths = np.array_split(data.train.dataset.rows_of_runs[0], 8)
    expected = {}
    for name, one in screening.candidates.items():
        root = np.linalg.qr(one.columns)[0]
        left = (residual - root @ (root.T @ residual))[: 6 * rows]
        by_row = (root[: 6 * rows] * left[:, None]).reshape(rows, 6, -1).sum(1)
        square = sum(np.square(by_row[part].sum(0)).sum() for part in eighths)
        expected[name] = max(1.0, square * 8 / 7 / root.shape[1])
    found = {name: one.scatter for name, one in screening.candidates.items()}
    assert found == pytest.approx(expected) and max(found.values()) > 1.0


def test_a_search_that_does_not_insist_names_one_cause_and_says_that_more_is_left(
    data, nominal, screening, found
):
    quick = Effort(effects=1, insists=False)
    ended = forward_search(data, begun(nominal, screening), NO_BOOTSTRAP, no_progress, effort=quick)
    assert accepted_names(ended) == accepted_names(found)[:1] and not ended.complete
    assert found.complete
    last = forward_search(data, ended, NO_BOOTSTRAP, no_progress, effort=Effort(2, insists=False))
    assert accepted_names(last) == accepted_names(found)


def claimed(kind, recording, **parameters) -> Finding:
    """A finding of an audit that may be wrong."""
    return Finding(kind, 0.1, 0.001, "", "", "", ("x", "y"), parameters, recording)


def test_what_the_audit_found_is_believed_first_where_the_model_agrees(data, nominal, screening):
    runs = list(data.recordings)
    false = [claimed("lever-arm", run.name, x=0.8, y=0.0) for run in runs]
    found = audited_effects(usv(), data.train.layout, [*audit(runs), *false], len(runs))
    assert {one.effect for one in found} == {"gyro-bias", "lever-arm"}
    now = judge_all_first(data, nominal, screening, found, no_progress)
    assert accepted_names(now) == now.audited == ("gyro-bias",) and not now.searched
    bias = data.train.layout.physical("gyro-bias", now.final.coordinates)[0]
    assert bias == pytest.approx([BIAS], rel=0.1)
    ended = forward_search(data, now, NO_BOOTSTRAP, no_progress)
    assert accepted_names(ended) == ("gyro-bias", "current")
    assert [one.name for one in ended.searched] == ["current"]


def test_what_the_audit_doubts_or_finds_in_few_runs_or_in_several_sizes_is_no_hypothesis(data):
    vessel, layout = usv(), data.train.layout
    arms = [
        claimed("lever-arm", name, x=x, y=0.1)
        for name, x in zip("abc", (0.8, 0.9, 0.7), strict=True)
    ]
    (arm,) = audited_effects(vessel, layout, arms, 3)
    assert layout.sizes[2] == EFFECTS["lever-arm"].sizes(vessel)
    np.testing.assert_allclose(arm.coordinates * layout.sizes[2], [0.8, 0.1])
    assert audited_effects(vessel, layout, arms, 7) == []
    apart = [
        claimed("lever-arm", name, x=x, y=0.1)
        for name, x in zip("abc", (0.8, -0.9, 0.3), strict=True)
    ]
    assert audited_effects(vessel, layout, apart, 3) == []
    doubtful = [dataclasses.replace(one, doubt="or late") for one in arms]
    assert audited_effects(vessel, layout, doubtful, 3) == []


def test_a_step_that_the_audit_found_at_one_time_in_most_runs_is_one_hypothesis():
    problem = still_problem("heading-offset", "heading-offset:step")
    effect, sizes = EFFECTS["heading-offset:step"], problem.layout.sizes[1]

    def found(*times):
        each = zip("abcd", times, strict=False)
        steps = [claimed("heading-offset", name, time=t, angle=0.3) for name, t in each]
        steps = [dataclasses.replace(one, channels=("psi",)) for one in steps]
        return audited_effects(usv(), problem.layout, steps, 4)

    (step,) = found(40.0, 40.1, 70.0)
    assert step.effect == effect.name
    np.testing.assert_allclose(step.coordinates * sizes, [0.3, 40.1])
    assert found(40.0, 55.0, 70.0) == []
    assert found(40.0) == []


def test_a_deviation_that_an_audit_finds_begins_a_diagnosis_with_its_size_and_phase():
    names = ("hard-iron", "hard-iron:estimated", "hard-iron:motors")
    problem, truth = still_problem(*names), {"amplitude": 0.15, "phase": 0.8}
    t, rng = np.arange(0, 120, 0.1), np.random.default_rng(4)
    psi = 0.3 + 0.12 * t
    shown = psi + truth["amplitude"] * np.sin(psi - truth["phase"])
    north, east = np.cumsum(0.1 * np.cos(psi)), np.cumsum(0.1 * np.sin(psi))

    def found(turned):
        e = shown - psi if turned else 0.0
        true = {"x": north, "y": east, "psi": shown, "u": np.cos(e), "v": -np.sin(e), "r": 0.12}
        run = {c: one + 0.003 * rng.standard_normal(t.size) for c, one in true.items()}
        recorded = Trajectory(t, **run, commanded={}, executed={}, extra={}, valid=t >= 0)
        return audited_effects(usv(), problem.layout, audit(recorded), 1)

    for turned, name in ((False, names[0]), (True, names[1])):
        (one,) = found(turned)
        assert one.effect == name
        sizes = problem.layout.sizes[names.index(name)]
        by = EFFECTS[name].decode(usv(), one.coordinates * sizes)
        assert {key: float(by[key]) for key in truth} == pytest.approx(truth, abs=0.06)


def test_a_search_whose_time_is_over_says_so(data, nominal, screening):
    over = Deadline(seconds=-1.0)
    fault = FirstHypothesis("gyro-bias", np.ones(1))
    begins = judge_all_first(data, nominal, screening, [fault], no_progress, over)
    assert not begins.complete and begins.effects == ()
    cut = forward_search(data, begun(nominal, screening), NO_BOOTSTRAP, no_progress, over)
    assert not cut.complete and cut.effects == () and cut.final is nominal
    record = summary(explain(data, cut, NO_BOOTSTRAP, no_progress, over), [])
    assert record["complete"] is False and record["verdict"] == "unexplained"
    assert "more may be missing" in incomplete_sentence(record)
    assert incomplete_sentence({"complete": True}) == ""


def test_what_simulated_data_show_as_often_is_not_named(data, nominal, screening):
    common = Bootstrap(np.linspace(0.0, 1e-30, 200), np.linspace(0.0, 1e-30, 200))
    record = summary(explain(data, begun(nominal, screening), common, no_progress), [])
    # The current passes for gusts, which are stronger than any: that is no agreement.
    assert (record["verdict"], record["effects"]) == ("insufficient", [])
    assert "gusts" in record["insufficient"]
    assert record["null"]["p_value"] < 1e-6
    assert record["null"]["bootstrap"] == {"draws": 200, "p_value": 1.0}
    assert record["remainder_p_value"] == 1.0


def test_an_effect_is_asked_for_again_with_the_constancy_that_it_has_by_now(data, found):
    first, second = found.effects
    doctored = dataclasses.replace(first.hypothesis, constancy=UNSTEADY)
    first = dataclasses.replace(first, hypothesis=doctored)
    search = dataclasses.replace(found, effects=(first, second))
    kept, changed = ask_again(data, search, (first,), no_progress)
    assert accepted_names(kept) == accepted_names(found) and not kept.dropped
    constancy = kept.effects[0].hypothesis.constancy
    assert constancy is not None and constancy.holds
    assert kept.effects[1] is second
    assert kept.final is found.final and not changed


def test_an_effect_is_asked_for_again_as_it_was_seen_last(data, found, monkeypatch):
    """Not as the short list has it that it came from: when it began may have been found since."""
    first, second = found.effects
    moved = dataclasses.replace(first.hypothesis.candidate, reach=7.0)
    hypothesis = dataclasses.replace(first.hypothesis, candidate=moved)
    first = dataclasses.replace(first, hypothesis=hypothesis)
    assert first.name in {one.effect for one in first.short_list.judged}
    asked = []
    fully = elimination.refit_fully
    monkeypatch.setattr(
        elimination, "refit_fully", lambda *given: asked.extend(given[-1]) or fully(*given)
    )
    search = dataclasses.replace(found, effects=(first, second))
    ask_again(data, search, (first,), no_progress)
    assert [one.candidate for one in asked if one.effect == first.name] == [moved]


def test_an_effect_that_others_make_needless_is_dropped(data, found):
    """A lever arm that was never there, accepted beside the two causes."""
    names = (*FREE, "lever-arm", *accepted_names(found))
    both = estimate(data.train, names, Start.of_other_data(found.final))
    lever = hypothesis("lever-arm", 50.0, STEADY)
    lever = dataclasses.replace(lever, estimate=both, without=found.nominal)
    needless = AcceptedEffect(lever, ShortList((lever,), 11.0))
    search = dataclasses.replace(found, effects=(needless, *found.effects), final=both)
    kept, changed = ask_again(data, search, (needless,), no_progress)
    assert changed and kept.dropped == ("lever-arm",)
    assert accepted_names(kept) == accepted_names(found)
    assert "lever-arm" not in kept.final.free


def test_what_was_found_beside_a_withdrawn_name_is_asked_for_without_it(data, found):
    """What is left stands out more than the first name did; the second is asked for again."""
    first, second = found.effects
    strongest = max(cell.z**2 for cell in found.final_screening.cells)
    weak = with_statistic(first, 1.1 * strongest)  # no more than by chance
    strong = with_statistic(second, 100 * strongest)
    strong = dataclasses.replace(
        strong, hypothesis=dataclasses.replace(strong.hypothesis, constancy=UNSTEADY)
    )
    search = dataclasses.replace(found, effects=(weak, strong))
    significant = Bootstrap(np.linspace(0.5, 1.0, 999), np.ones(999))
    final = withdraw_outdone(data, search, significant, no_progress)
    assert final.dropped[-1] == first.name and first.name not in accepted_names(final)
    assert first.name not in final.final.free
    asked = [one.hypothesis.constancy for one in final.effects]
    assert asked != [UNSTEADY] and set(final.dropped[:-1]) <= {second.name}
    assert final.final_screening is not found.final_screening
    assert {first.name} <= set(final.final_screening.candidates)


def test_a_name_whose_fit_gained_much_stands_whatever_its_score_at_zero(data, found):
    first, second = found.effects
    strongest = max(cell.z**2 for cell in found.final_screening.cells)
    slight = with_statistic(first, 0.0, gained=100 * strongest)
    strong = with_statistic(second, 100 * strongest)
    search = dataclasses.replace(found, effects=(slight, strong))
    significant = Bootstrap(np.linspace(0.5, 1.0, 999), np.ones(999))
    assert withdraw_outdone(data, search, significant, no_progress) is search


def test_a_cause_that_comes_out_worse_is_begun_again_at_the_model_without_it(
    data, found, monkeypatch
):
    """Fits that begin with any size of it get stuck."""
    nominal, place = found.nominal, data.train.layout.indices(("gyro-bias",))

    def stuck(problem, free, start, **more):
        assert np.array_equal(start.left_out, nominal.left_out)
        fitted = estimate(problem, free, start, **more)
        worse = dataclasses.replace(fitted, deviance=nominal.deviance + 50)
        return worse if np.any(start.coordinates[place]) else fitted

    monkeypatch.setattr(refits, "estimate", stuck)
    candidate = found.nominal_screening.candidates["gyro-bias"]
    got = refits.refit_at_fixed_noise(data.train, nominal, candidate)
    assert got.deviance_drop > 50


def test_names_stand_where_little_is_left(data, found):
    first, second = found.effects
    search = dataclasses.replace(found, effects=(with_statistic(first, 0.0), second))
    common = Bootstrap(np.zeros(200), np.zeros(200))
    assert withdraw_outdone(data, search, common, no_progress) is search


def test_names_that_make_the_motion_worse_together_are_withdrawn_from_the_last_on(
    data, found, monkeypatch
):
    """With the second the motion is predicted worse than with none, with the first alone not."""
    first, second = found.effects

    def change(split, before, after):
        assert before is found.nominal
        loss = MotionChange({20.0: 1.2}, {20.0: ChanceOfLoss(0.999, 0.999)})
        return loss if second.name in after.free else dataclasses.replace(loss, ratio={20.0: 1.0})

    assert withdraw_worsening(data, found, no_progress) is found  # in truth, both are there
    monkeypatch.setattr(elimination, "motion_change", change)
    final = withdraw_worsening(data, found, no_progress)
    assert accepted_names(final) == (first.name,) and final.dropped[-1] == second.name
    assert second.name not in final.final.free and first.name in final.final.free
    assert second.name in final.final_screening.candidates


@pytest.fixture(scope="module")
def alone(found):
    """A short list whose best, the bias, has not one size in all the data, but the current has.

    To first order the current does what the bias does, so that this bars it.
    """
    best, second, *_ = found.short_list.judged
    alike = dataclasses.replace(second.candidate, columns=best.candidate.columns)
    hypotheses = (
        dataclasses.replace(best, constancy=UNSTEADY),
        dataclasses.replace(second, constancy=STEADY, candidate=alike),
    )
    return dataclasses.replace(found.short_list, hypotheses=hypotheses)


def test_a_pair_is_named_where_both_leave_nothing(data, found, alone):
    assert decide(alone, None) is None
    pair = find_pair(data, alone, NO_BOOTSTRAP, no_progress)
    assert [one.name for one in pair] == ["current", "gyro-bias"]
    assert set(pair[1].hypothesis.estimate.free) == set(found.final.free)


def test_what_the_strongest_does_not_mimic_needs_no_pair(found, alone):
    best, barred = alone.hypotheses
    own = found.short_list.judged[1].candidate
    assert barred.effect == own.point.effect
    unlike = dataclasses.replace(barred, candidate=own)
    tried = dataclasses.replace(alone, hypotheses=(best, unlike))
    assert decide(tried, None) is unlike


def test_a_pair_that_leaves_something_is_not_named(data, alone):
    never = Bootstrap(np.ones(999), np.ones(999))
    assert find_pair(data, alone, never, no_progress) == ()


def test_a_pair_that_explains_less_than_one_effect_is_not_named(data, alone):
    best, second = alone.hypotheses
    low = dataclasses.replace(best.estimate, deviance=best.estimate.deviance - 1e6)
    better = dataclasses.replace(best, estimate=low)
    short_list = dataclasses.replace(alone, hypotheses=(better, second))
    assert find_pair(data, short_list, NO_BOOTSTRAP, no_progress) == ()


def test_a_name_is_not_had_for_the_progress_of_a_fit(data, nominal, found):
    """A nominal fit that had stopped early leaves the first effect more than its score promises."""
    best = found.effects[0].hypothesis
    assert resume_stalled_fit(data.train, nominal, best) is None
    early = dataclasses.replace(nominal, deviance=nominal.deviance + 1000.0)
    early_drop = early.deviance - best.estimate.deviance
    stalled = dataclasses.replace(best, deviance_drop=early_drop)
    better = resume_stalled_fit(data.train, early, stalled)
    assert better is not None and better.deviance == pytest.approx(nominal.deviance, abs=1.0)
    promised = with_statistic(AcceptedEffect(stalled, found.short_list), early_drop)
    assert resume_stalled_fit(data.train, early, promised.hypothesis) is None
    none_of_it = dataclasses.replace(stalled, candidate=promised.hypothesis.candidate, wald=1.0)
    assert resume_stalled_fit(data.train, early, none_of_it) is not None


def test_what_is_next_to_none_of_an_effect_may_as_well_be_zero(data, nominal, found):
    bias = next(one.hypothesis for one in found.effects if one.name == "gyro-bias")
    # At the noise of the better model the data would lose more than by a noise of its own.
    assert bias.wald > bias.deviance_drop > 100 and bias.zero_p_value < 1e-6
    place = data.train.layout.indices(("gyro-bias",))
    gone = np.array(bias.estimate.coordinates)
    gone[place] *= 0.01  # as if the fit had ended with next to none of it
    absent = dataclasses.replace(bias.estimate, coordinates=gone)
    none = make_hypothesis(data.train, nominal, absent, bias.candidate)
    assert none.wald == pytest.approx(1e-4 * bias.wald, rel=1e-6) and none.zero_p_value > 0.5
