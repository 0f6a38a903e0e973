"""Whether stated odds are those of being right: linear models with Gaussian noise, drawn from
their own priors, effects from Student's t. What is missing is nothing or one of three effects,
each as often.
"""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import candidate, still_problem

from diffsea import EFFECTS, Parameter
from diffsea.diagnosis.decision import AcceptedEffect, ShortList, rank_hypotheses
from diffsea.diagnosis.refits import make_hypothesis
from diffsea.identification.coordinates import TAIL_DEGREES, CoordinateLayout
from diffsea.identification.estimates import posterior_estimate


pytestmark = pytest.mark.slow


NAMES = ("gyro-bias", "heading-offset", "current")  # of one, one and two coordinates
PARAMETERS = (Parameter("a", 0.0, spread=0.5), Parameter("b", 0.0, spread=1.0))
PROBLEMS, VALUES = 1500, 40


@pytest.fixture(scope="module")
def problem():
    effects = tuple(EFFECTS[name] for name in NAMES)
    sizes = tuple((1.0,) * len(effect.coordinates) for effect in effects)
    layout = CoordinateLayout(PARAMETERS, effects, sizes, 1, False)
    return dataclasses.replace(still_problem(), layout=layout)


def fitted(problem, X: np.ndarray, y: np.ndarray, free: tuple[str, ...]):
    """The peak of the posterior of some coordinates, the noise of the data being one."""
    layout, index = problem.layout, np.array(problem.layout.indices(free))
    some, coordinates = X[:, index], np.zeros(problem.layout.size)
    for _ in range(30):  # a normal prior of the same slope, again and again
        precision = some.T @ some + np.diag(1 / layout.local_spreads(coordinates)[index] ** 2)
        better = np.linalg.solve(precision, some.T @ y)
        moved = np.abs(better - coordinates[index]).max()
        coordinates[index] = better
        if moved < 1e-6:
            break
    strains = np.asarray(layout.strains(coordinates, layout.spreads()))
    deviance = ((y - X @ coordinates) ** 2).sum() + (strains**2).sum()
    return posterior_estimate(
        free, coordinates, deviance, index, layout.local_spreads(coordinates), some.T @ some
    )


def drawn(problem, rng: np.random.Generator) -> tuple[dict[str, float], float, str]:
    """Evidence for each effect (twice the log of its odds against none), how far the best is
    ahead of the next best or none, and the truth.
    """
    spreads, own = problem.layout.spreads(), tuple(p.name for p in PARAMETERS)
    X = rng.normal(size=(VALUES, len(spreads))) * rng.uniform(0.02, 0.3)
    X[:, 3:] += X[:, 2:3]  # effects resemble one another
    truth = ("", *NAMES)[rng.integers(4)]
    index = problem.layout.indices((*own, truth))
    at = np.zeros(len(spreads))
    at[index] = rng.normal(size=len(index)) * spreads[index]
    effect = problem.layout.indices((truth,))
    heavy = (TAIL_DEGREES + len(effect)) / rng.chisquare(TAIL_DEGREES)
    at[effect] *= np.sqrt(heavy)
    y = X @ at + rng.normal(size=VALUES)
    current = fitted(problem, X, y, own)
    tried = []
    for name in NAMES:
        count = len(problem.layout.indices((name,)))
        seen = candidate(name, np.ones((3, count)))
        more = fitted(problem, X, y, (*own, name))
        tried.append(make_hypothesis(problem, current, more, seen))
    tried = rank_hypotheses(tried)
    evidence = {one.effect: one.evidence(one.inflation) for one in tried}
    return evidence, AcceptedEffect(tried[0], ShortList(tuple(tried), 0.0)).lead, truth


@pytest.fixture(scope="module")
def problems(problem):
    rng = np.random.default_rng(12)
    return [drawn(problem, rng) for _ in range(PROBLEMS)]


def assert_calibrated(stated: np.ndarray, right: np.ndarray) -> None:
    """As many right as stated within three errors, in each bin."""
    edges = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
    bins = np.digitize(stated, edges[1:-1])
    assert len(np.unique(bins)) >= 4
    for k in np.unique(bins):
        p = stated[bins == k]
        error = np.sqrt((p * (1 - p)).sum())
        assert abs(right[bins == k].sum() - p.sum()) < 3 * error + 0.5, edges[k : k + 2]


@pytest.mark.proof
def test_the_best_is_as_often_right_as_its_odds_against_the_next_say(problems):
    """Where the truth is the best effect or the next best, or none where none is that."""
    stated, right = [], []
    for evidence, ahead, truth in problems:
        best, second = sorted([*evidence, ""], key=lambda name: -evidence.get(name, 0.0))[:2]
        if best and truth in (best, second):
            stated.append(1 / (1 + np.exp(-0.5 * ahead)))
            right.append(truth == best)
    assert_calibrated(np.array(stated), np.array(right))


@pytest.mark.proof
@pytest.mark.parametrize("name", NAMES)
def test_an_effect_is_there_as_often_as_its_odds_against_none_say(problems, name):
    """Where it is there or nothing is."""
    either = [(evidence[name], truth) for evidence, _, truth in problems if truth in (name, "")]
    stated = np.array([1 / (1 + np.exp(-0.5 * value)) for value, _ in either])
    assert_calibrated(stated, np.array([truth == name for _, truth in either]))
