"""Chance by simulation: data sets drawn from the fitted model, each fitted and screened again.

`null` has the distribution of the strongest test to first order. Here nothing is linearised: its
family-wise p-value is itself taken as the statistic, and compared with what it comes to where
nothing is missing (prepivoting, Beran 1988).
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.screening import screen
from diffsea.errors import UserError
from diffsea.identification.estimates import Estimate, PartialProgress
from diffsea.identification.fit import estimate
from diffsea.identification.problem import Problem
from diffsea.identification.resimulation import resimulate


FEWEST = 100  # draws: fewer cannot show less than one per cent
FAILED = 0.1  # share of draws that may fail; others are drawn for them
SEED = 11


@dataclasses.dataclass(frozen=True)
class Bootstrap:
    """First-order p-values where nothing is missing; without draws they stand as they are."""

    strongest: Float[np.ndarray, "draw"]  # of the strongest of all tests
    located: Float[np.ndarray, "draw"]  # of the strongest located force

    @property
    def draws(self) -> int:
        """Data sets that were drawn."""
        return len(self.strongest)

    def of_strongest(self, p_value: float) -> float:
        """Chance that the strongest test shows so small a p-value, or a smaller one."""
        return _share(self.strongest, p_value)

    def of_located(self, p_value: float) -> float:
        """The same for the strongest located force."""
        return _share(self.located, p_value)


NONE = Bootstrap(np.zeros(0), np.zeros(0))


def _share(drawn: Float[np.ndarray, "draw"], p_value: float) -> float:
    """Rank among the draws, itself counted (Davison and Hinkley 1997, section 4.2)."""
    if not len(drawn):
        return p_value
    return float(1 + np.sum(drawn <= p_value)) / (1 + len(drawn))


def check(draws: int) -> None:
    """Raise UserError for fewer draws than can show one per cent."""
    if draws < FEWEST:
        raise UserError(f"{draws} bootstrap draws cannot show one per cent: take {FEWEST} or more")


def bootstrap(
    problem: Problem,
    nominal: Estimate,
    draws: int,
    progress: Callable[[str], None] = lambda message: None,
) -> Bootstrap:
    """Draw data sets from the nominal estimate, fit it to each anew, and screen.

    Raises:
        UserError: fewer than 100 draws; more simulated runs diverge than a tenth of `draws`.
    """
    check(draws)
    rng = np.random.default_rng(SEED)
    found: list[tuple[float, float]] = []
    failed = 0
    while len(found) < draws:
        message = f"simulating {len(found) + 1} of {draws} data sets"
        stage = f"simulating {draws} data sets"
        progress(PartialProgress(message, len(found) / draws, stage))
        made = resimulate(problem, nominal, rng)
        if not np.isfinite(np.asarray(made.dataset.measured)).all():
            failed += 1
            if failed > FAILED * draws:
                raise UserError(
                    f"{failed} of {failed + len(found)} runs simulated with the fitted model "
                    "diverge, so it cannot say what chance does: leave --bootstrap out, or check "
                    "the vessel file"
                )
            continue
        fitted = estimate(made, nominal.free, nominal.coordinates, nominal.noise)
        screening = screen(made, fitted)
        found.append((screening.p_value, screening.remainder))
    return Bootstrap(*(np.sort(column) for column in np.array(found).T))
