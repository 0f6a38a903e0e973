"""Whether an effect has one size in all the data: in halves and in eighths of each run.

A force that stands in for something else has another size wherever that other thing has.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from diffsea.diagnosis.score import (
    LEVEL,
    Columns,
    Projection,
    linearise_model,
)
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import EFFECTS


PARTS = (2, 8)  # of each run: what changes once, and what comes and goes
TOLERATED_SHARE = 0.25  # of what the effect explains: below it the law is good enough to be named
TOLERATED_OF_SENSORS = 0.1  # but for an estimator's heading: kinematics holds exactly


class Constancy(NamedTuple):
    """Outcome of the test that an effect's size is one."""

    statistic: float  # chi-squared under a constant size
    p_value: float
    share: float  # of the statistic of the effect itself
    tolerated: float = TOLERATED_SHARE
    degrees: int = 0  # of freedom
    same_in_runs: bool = False  # whether several runs, each as a whole, show one size

    @property
    def holds(self) -> bool:
        """Whether the size is constant, or differs by little against the effect itself."""
        return self.p_value > LEVEL / len(PARTS) or self.share < self.tolerated

    @property
    def scatter(self) -> float:
        """How far sizes in parts of the data are apart over what their errors say; at least one.

        The ratio of Birge (1932), by which errors are to be widened: a law that holds nearly
        gives each part of the data another size.
        """
        return max(1.0, self.statistic / self.degrees) ** 0.5 if self.degrees else 1.0


def constancy_test(problem: Problem, fitted: Estimate, effect: str, explained: float) -> Constancy:
    """Test one effect of a fitted model with a size for each half, and each eighth, of every run.

    Its coefficients and its time are the same in all parts, and of a law of hull or actuators the
    proportion of its amounts: where a part has but one order or manoeuvre, these would be bent anew
    until they fit whatever else is missing there. The components of a flow, or of a sensor's error,
    are asked one by one: else a force that turns with the vessel would pass for a wind. Of the two
    tests, the one that speaks more against one size. How the innovations depend on one another in
    time is taken from what is left with those sizes: with one size, what comes and goes would pass
    for coloured gusts.

    Arguments:
        effect: its name; one of those that `fitted` was fitted with.
        explained: the drop of the deviance by it.
    """
    residual, nuisance = linearise_model(problem, fitted).by_name(fitted.free)
    run = np.asarray(problem.dataset.run)
    owners = [name for name in fitted.free for _ in problem.layout.indices((name,))]
    J = nuisance[:, [owner == effect for owner in owners]]
    amounts = EFFECTS[effect].amounts
    sizes = J[:, np.tile(amounts, J.shape[1] // len(amounts))]
    if EFFECTS[effect].is_law:
        found = fitted.coordinates[problem.layout.indices((effect,))]
        sizes = (J @ found)[:, None]
    # All parts together are the effect but for its prior, which says nothing of constancy.
    own = np.array(J)
    own[: 6 * len(run)] = 0.0
    is_exact = EFFECTS[effect].family == "sensor" and not EFFECTS[effect].is_law
    tolerated = TOLERATED_OF_SENSORS if is_exact else TOLERATED_SHARE

    def in_parts(count: int) -> Constancy:
        parts = _columns_of_parts(problem, sizes, count)
        degrees = parts.shape[1] - sizes.shape[1]
        if degrees <= 0:
            return Constancy(0.0, 1.0, 0.0, tolerated)
        richer = Projection(residual, np.concatenate([nuisance, parts], axis=1), run)
        whole = np.concatenate([nuisance, own], axis=1)
        projection = Projection(residual, whole, run, richer.correlation)
        score = projection.test(projection.efficient(parts))
        p_value = float(stats.chi2.sf(score.statistic, degrees))
        excess = max(score.statistic - degrees, 0.0)
        share = excess * score.inflation / max(explained, 1e-9)
        return Constancy(score.statistic, p_value, share, tolerated, degrees)

    worst = min(map(in_parts, PARTS), key=lambda test: (test.holds, test.p_value))
    runs = in_parts(1)
    return worst._replace(same_in_runs=runs.degrees > 0 and runs.p_value > LEVEL)


def _columns_of_parts(
    problem: Problem, J: Columns, count: int
) -> Float[np.ndarray, "value part_column"]:
    """An effect's columns in each of `count` parts of every run, without those of the prior."""
    parts = []
    for part in problem.dataset.parts_of_runs(count):
        member = np.zeros(len(J))
        member[(6 * part[:, None] + np.arange(6)).ravel()] = 1.0
        parts.append(J * member[:, None])
    columns = np.concatenate(parts, axis=1)
    # A part without information has nothing to differ in.
    return columns[:, (columns**2).sum(0) > 1e-9 * (J**2).sum()]
