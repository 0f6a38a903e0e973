"""Several starts on a cost of two wells, whose places and depths are known."""

import dataclasses

import numpy as np
import pytest

from diffsea.identification.estimates import Estimate, posterior_estimate
from diffsea.identification.multistart import multistart
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.parameters import Parameter
from diffsea.progress import no_progress


DEEP, SHALLOW = -2.0, 3.0  # coordinates of the wells
DEPTH = {DEEP: -50.0, SHALLOW: -10.0}


class TwoWells(AbstractObjective):
    """A cost of one parameter; a fit ends in the well on whose side of zero it begins."""

    def __init__(self, explored: list[float]):
        """`explored`: where the exploration of each start is to end."""
        self.explored, self.begun = explored, list[float]()
        self.parameters, self.effects = (Parameter("X_u", -1.0, unit="kg/s"),), ()
        self.problem, self.outliers, self.one_sample_in = None, {}, {}

    def fit(self, free, start=None, progress=no_progress) -> Estimate:
        begin = 1.0 if start is None else float(start[0])
        self.begun.append(begin)
        well = DEEP if begin < 0 else SHALLOW
        one = np.array([[100.0]])
        return posterior_estimate(
            free, np.array([well]), DEPTH[well], np.array([0]), np.ones(1), one
        )

    def explore(self, starts, free):
        ends = np.array(self.explored[: len(starts)])
        costs = [np.nan if np.isnan(end) else DEPTH[DEEP if end < 0 else SHALLOW] for end in ends]
        return ends[:, None], np.array(costs)

    def refit(self, fitted, free, start):
        raise AssertionError("nothing is refitted")

    cost = squares = residuals = refit


def ends_near(*wells: float) -> list[float]:
    """A little off each well, as an exploration ends."""
    return [well + 0.01 for well in wells]


def test_a_fit_in_the_wrong_place_is_replaced() -> None:
    objective = TwoWells(ends_near(SHALLOW, DEEP, DEEP, SHALLOW))
    known = objective.fit(("X_u",))
    found, agreement = multistart(objective, ("X_u",), 4, known=known)
    assert found.coordinates == DEEP and objective.begun == [1.0, DEEP + 0.01]
    assert agreement is not None and agreement.rival == 40.0
    assert agreement.sentence.startswith("2 of 5 starts")


def test_a_fit_that_is_the_best_is_kept_as_it_is() -> None:
    objective = TwoWells(ends_near(SHALLOW, DEEP, DEEP, SHALLOW))
    known = objective.fit(("X_u",), np.array([DEEP]))
    found, agreement = multistart(objective, ("X_u",), 4, known=known)
    assert found is known and objective.begun == [DEEP, SHALLOW + 0.01]
    assert agreement is not None and agreement.sentence.startswith("3 of 5 starts")
    assert agreement.rival == 40.0


@pytest.mark.parametrize("lost", [0, 1])
def test_nothing_is_fitted_where_all_starts_lead_to_one_place(lost: int) -> None:
    ends = ends_near(*[DEEP] * (4 - lost)) + [np.nan] * lost
    objective = TwoWells(ends)
    known = objective.fit(("X_u",), np.array([DEEP]))
    found, agreement = multistart(objective, ("X_u",), 4, known=known)
    assert found is known and len(objective.begun) == 1
    assert agreement is not None and agreement.rival is None
    assert (agreement.agreeing, agreement.starts) == (5 - lost, 5)


def test_without_a_known_fit_the_best_start_is_fitted_first() -> None:
    objective = TwoWells(ends_near(SHALLOW, DEEP, SHALLOW))
    found, agreement = multistart(objective, ("X_u",), 3)
    assert found.coordinates == DEEP and objective.begun == ends_near(DEEP, SHALLOW)
    assert agreement is not None and dataclasses.astuple(agreement) == (3, 1, 40.0)
