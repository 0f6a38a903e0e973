"""How heavy the tails of one-step errors are, and what that makes of a prediction's likelihood.

On real vessels a few events, a wave or an angle that turns the long way, miss by many of the
standard deviations that a filter states. Under a normal density those few rows are nearly all that
a comparison of two models says, and two halves of a recording contradict each other.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.special import betaln
from scipy.stats import t

from diffsea.identification.filter.kalman import FilterRun


FEWEST_ERRORS = 30  # of a channel, from which tails are estimated
MOST_DEGREES = 200.0  # of freedom: more are as good as a normal density
LARGEST_SCALE = 20.0  # of whitened errors, and its inverse the smallest


class ErrorTails(NamedTuple):
    """Student's t of each channel's whitened innovations, about zero."""

    degrees: Float[np.ndarray, "6"]  # of freedom; infinite: a normal density
    scale: Float[np.ndarray, "6"]

    def deviance(self, run: FilterRun) -> Float[np.ndarray, "row"]:
        """-2 log likelihood of each row of a filter's run; NaN where it diverged."""
        white, used = np.asarray(run.white), np.asarray(run.gains.used)
        with np.errstate(invalid="ignore"):
            density = t.logpdf(white, self.degrees, scale=self.scale)
            values = np.log(np.asarray(run.variance)) - 2 * density
        return np.where(used, values, 0.0).sum(1)


def error_tails(run: FilterRun) -> ErrorTails:
    """The tails of a run's innovations, channel by channel, by maximum likelihood.

    Student's t of unknown degrees of freedom and scale (Lange, Little and Taylor 1989).
    """
    white, used = np.asarray(run.white), np.asarray(run.gains.used)
    found = [_fit_tails(white[:, k], used[:, k]) for k in range(white.shape[1])]
    return ErrorTails(*np.array(found).T)


def _fit_tails(
    white: Float[np.ndarray, "row"], used: Bool[np.ndarray, "row"]
) -> tuple[float, float]:
    """Degrees of freedom and scale of one channel; a unit normal where it has few errors."""
    errors = white[used & np.isfinite(white)]
    if len(errors) < FEWEST_ERRORS:
        return np.inf, 1.0
    squares = errors**2

    def cost(logs: Float[np.ndarray, "2"]) -> float:
        degrees, scale = np.exp(logs)
        room = np.log(scale) + 0.5 * np.log(degrees) + betaln(0.5, 0.5 * degrees)
        tail = 0.5 * (degrees + 1) * np.log1p(squares / (degrees * scale**2))
        return float(tail.mean() + room)

    reach = np.log(LARGEST_SCALE)
    bounds = [(0.0, np.log(MOST_DEGREES)), (-reach, reach)]
    degrees, scale = np.exp(minimize(cost, (np.log(5.0), 0.0), bounds=bounds).x)
    return (float(degrees) if degrees < 0.99 * MOST_DEGREES else np.inf), float(scale)
