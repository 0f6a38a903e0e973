"""What recordings of a reference period tell of a vessel, beside the recordings after them."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, linear_estimate, still_problem, usv
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.diagnosis.refits import is_physical
from diffsea.diagnosis.score import ScoreTest, linearise_model
from diffsea.diagnosis.screening import Candidate
from diffsea.identification.coordinates import ExpansionPoint, expansion_points
from diffsea.identification.fit import estimate_surely
from diffsea.identification.problem import make_problem
from diffsea.identification.reference import Reference, reference_of
from diffsea.vessel.effects.coordinates import Peaks
from diffsea.vessel.files import build


FREE = ("X_u", "X_uu", "N_r", "N_rr")
FIRST, SECOND = (1, 2), (3,)


def problem_of(document, *runs, effects=()):
    return make_problem(build(document), list(runs), FREE, effects)


@pytest.fixture(scope="module")
def runs():
    made = {k: random_steps(DOCUMENT, k, 60.0, 0.2) for k in (*FIRST, *SECOND)}
    return {k: dataclasses.replace(run, name=f"run {k}") for k, run in made.items()}


@pytest.fixture(scope="module")
def wrong():
    """The vessel file with less drag than the vessel has."""
    document = {**DOCUMENT, "hull": dict(DOCUMENT["hull"])}
    document["hull"] |= {name: 0.7 * DOCUMENT["hull"][name] for name in FREE}
    return document


@pytest.mark.slow
def test_a_reference_and_what_came_after_give_what_both_give_together(runs, wrong):
    together = problem_of(wrong, *runs.values())
    joint = estimate_surely(together, FREE)
    before = problem_of(wrong, *(runs[k] for k in FIRST))
    known = reference_of(before, estimate_surely(before, FREE))
    after = problem_of(wrong, *(runs[k] for k in SECOND))
    alone = estimate_surely(after, FREE)
    both = estimate_surely(dataclasses.replace(after, further=known), FREE)
    assert (np.abs(both.coordinates - joint.coordinates) < 0.6 * joint.stds).all()
    assert (np.abs(alone.coordinates - joint.coordinates) > 1.5 * joint.stds).any()
    ratio = both.stds / joint.stds
    assert (ratio > 0.9).all() and (ratio < 1.3).all() and (alone.stds > 1.4 * joint.stds).all()


@pytest.mark.slow
def test_what_a_model_lacks_makes_the_reference_tell_less(runs, wrong):
    """A drag that doubles half way scatters the scores from part to part."""
    more = {"drag-change": {"time": 30.0, "factor": 1.0}}
    calm = problem_of(wrong, *(runs[k] for k in FIRST))
    fouled = problem_of(wrong, *(random_steps(DOCUMENT, k, 60.0, 0.2, more) for k in FIRST))

    def widening(problem):
        fitted = estimate_surely(problem, FREE)
        told = reference_of(problem, fitted).root
        return np.sqrt(np.diag(fitted.information) / np.diag(told.T @ told))

    assert widening(calm).max() < 1.4
    assert widening(fouled).max() > 1.8


def test_rows_of_a_reference_stand_after_those_of_the_prior():
    vessel = usv()
    problem = still_problem("mass-change")
    root = np.array([[2.0, 0.5], [0.0, 3.0]])
    known = Reference(np.array([0.1, -0.2]), root)
    problem = dataclasses.replace(problem, further=known)
    estimate = dataclasses.replace(
        linear_estimate(("X_u", "N_r"), size=problem.layout.size),
        coordinates=np.zeros(problem.layout.size), state=problem.start()[1],
    )  # fmt: skip
    residual, J = linearise_model(problem, estimate).by_name(("X_u", "N_r"))
    np.testing.assert_allclose(residual[-2:], root @ [-0.1, 0.2])
    np.testing.assert_allclose(J[-2:], root)
    (point, *_) = expansion_points(EFFECTS["mass-change"], vessel, problem.dataset.spans)
    (columns,) = linearise_model(problem, estimate).by_points([point])
    secant = dataclasses.replace(point, at=(1.0, *point.at[1:]), secant=True, directions=(0,))
    (tried,) = linearise_model(problem, estimate).by_points([secant])
    assert len(columns) == len(tried) == len(residual)
    assert not columns[-2:].any() and not tried[-2:].any()
    pulse = np.zeros((1, problem.dataset.t.size, 3))
    pulse[0, :, 0] = 1.0
    (pushed,) = linearise_model(problem, estimate).by_pulses(pulse).T
    assert len(pushed) == len(residual) and pushed.any() and not pushed[-2:].any()


def test_something_may_have_changed_since_a_reference_before_the_first_row():
    problem, vessel = still_problem("mass-change"), usv()
    effect = EFFECTS["mass-change"]
    assert problem.before is None
    since = dataclasses.replace(problem, further=Reference(np.zeros(2), np.eye(2)))
    assert since.before is not None and since.before < problem.dataset.spans[0][0]
    peaks = Peaks(before=since.before)
    tried = [p.at[1] for p in expansion_points(effect, vessel, since.dataset.spans, peaks)]
    without = [p.at[1] for p in expansion_points(effect, vessel, since.dataset.spans)]
    size = effect.sizes(vessel)[1]
    assert tried == [pytest.approx(since.before / size), *without]
    at = np.zeros(problem.layout.size)
    at[problem.layout.slices["mass-change"]] = 1.0, tried[0]
    fitted = dataclasses.replace(linear_estimate(size=problem.layout.size), coordinates=at)
    score, point = (
        ScoreTest(0.0, 1.0, np.zeros(1), 1.0),
        ExpansionPoint(effect.name, (0.0, tried[0]), (0,)),
    )
    seen = Candidate(point, score, np.ones((3, 1)), 0.0, reach=1.0)
    assert is_physical(since, fitted, seen) and not is_physical(problem, fitted, seen)
