"""Chance by simulation: data sets drawn from the fitted model, each fitted and screened again.

`score.joint_null` has the distribution of the strongest test to first order. Here nothing is
linearised: its family-wise p-value is itself taken as the statistic, and compared with what it
comes to where nothing is missing (prepivoting, Beran 1988).
"""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from diffsea.budget import current_budget
from diffsea.diagnosis.screening import Screening, screen
from diffsea.errors import UserError
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import Start, estimate
from diffsea.identification.problem import Problem
from diffsea.identification.resimulation import resimulate
from diffsea.progress import PartialProgress, Progress, no_progress


LEAST_DRAWS = 100  # fewer cannot show less than one per cent
FAILED_SHARE = 0.1  # of the draws that may diverge; others are drawn for them
BOOTSTRAP_SEED = 11


@dataclasses.dataclass(frozen=True)
class Bootstrap:
    """First-order p-values where nothing is missing; without draws they stand as they are."""

    strongest: Float[np.ndarray, "draw"]  # of the strongest of all tests
    located: Float[np.ndarray, "draw"]  # of the strongest unnamed force

    @property
    def draws(self) -> int:
        """Data sets that were drawn."""
        return len(self.strongest)

    def of_strongest(self, p_value: float) -> float:
        """Chance that the strongest test shows so small a p-value, or a smaller one."""
        return _rank_share(self.strongest, p_value)

    def of_located(self, p_value: float) -> float:
        """The same for the strongest unnamed force."""
        return _rank_share(self.located, p_value)


NO_BOOTSTRAP = Bootstrap(np.zeros(0), np.zeros(0))


def _rank_share(drawn: Float[np.ndarray, "draw"], p_value: float) -> float:
    """Rank among the draws, itself counted (Davison and Hinkley 1997, section 4.2)."""
    if not len(drawn):
        return p_value
    return float(1 + np.sum(drawn <= p_value)) / (1 + len(drawn))


def bootstrap(
    problem: Problem, nominal: Estimate, draws: int, progress: Progress = no_progress
) -> Bootstrap:
    """Draw data sets from the nominal estimate, fit it to each anew, and screen.

    None at all where there is no time for all of them.

    Raises:
        UserError: more simulated runs diverge than a tenth of `draws`.
    """
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    screenings: list[Screening] = []
    data_sets = (resimulate(problem, nominal, rng) for _ in itertools.count())
    for number, drawn in enumerate(finite_draws(data_sets, draws)):
        if current_budget().skips("the bootstrap"):
            return NO_BOOTSTRAP
        message = f"simulating {number + 1} of {draws} data sets"
        progress(PartialProgress(message, number / draws, f"simulating {draws} data sets"))
        fitted = estimate(drawn, nominal.free, Start.of_other_data(nominal))
        screenings.append(screen(drawn, fitted))
    return Bootstrap(
        np.sort([one.p_value for one in screenings]),
        np.sort([one.located_p_value for one in screenings]),
    )


def finite_draws(data_sets: Iterable[Problem], draws: int) -> Iterator[Problem]:
    """As many of the simulated data sets as asked for, those whose runs diverge left out.

    Raises:
        UserError: more of them diverge than a tenth of `draws`.
    """
    found = failed = 0
    for drawn in data_sets:
        if np.isfinite(np.asarray(drawn.dataset.measured)).all():
            found += 1
            yield drawn
        else:
            failed += 1
        if found == draws:
            return
        if failed > FAILED_SHARE * draws:
            raise UserError(
                f"{failed} of {failed + found} runs simulated with the fitted model diverge, so it "
                "cannot say what chance does: leave --bootstrap out, or check the vessel file"
            )
