"""What every fit ends with: an estimate, its covariance, and how much of it is due to the data."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import norm

from diffsea.parameters import Parameter, meaning


Progress = Callable[[str], None]


class PartialProgress(str):
    """A progress message that tells how far a stage has come; a plain one begins a stage.

    Attributes:
        share: what is done of the stage, 0 to 1.
        stage: its name; the stage that was begun last if empty.
    """

    share: float
    stage: str

    def __new__(cls, message: str, share: float, stage: str = "") -> "PartialProgress":
        """A message for the person who waits, with the share that it stands for."""
        out = super().__new__(cls, message)
        out.share, out.stage = share, stage
        return out


LEVEL = 0.9  # of intervals


def no_progress(message: str) -> None:
    """Progress that nobody follows."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Where a fit ended. Coordinates are those of `priors.Parameter`, then of effects."""

    free: tuple[str, ...]
    coordinates: Float[np.ndarray, "coordinate"]
    deviance: float  # -2 log posterior, the priors of parameters and noise included
    index: Int[np.ndarray, "free"]  # which coordinates were free
    covariance: Float[np.ndarray, "free free"]
    information: Float[np.ndarray, "free free"]  # of the data alone
    precision: Float[np.ndarray, "free free"]  # of data and prior, misfits taken for white
    shrinkage: Float[np.ndarray, "free"]  # share that the data determine, 0 to 1
    inflation: float  # variance of the scores over the information, at least one
    noise: Any = None  # what the objective estimated besides: scales of noise, weights
    path: tuple[float, ...] = ()  # the cost after each round

    @property
    def stds(self) -> Float[np.ndarray, "free"]:
        """Standard errors of the free coordinates."""
        return np.sqrt(np.diag(self.covariance))


def posterior_estimate(
    free: tuple[str, ...],
    coordinates: np.ndarray,
    deviance: float,
    index: np.ndarray,
    spreads: np.ndarray,
    information: np.ndarray,
    coloured: np.ndarray | None = None,
    noise: Any = None,
    path: Sequence[float] = (),
) -> Estimate:
    """An estimate from the information of the data and the spreads of the priors.

    `coloured` is the variance of the score where misfits are not white (the middle of the
    sandwich): each standard error is the larger of the two.
    """
    precision = information + np.diag(1 / spreads[index] ** 2)
    plain = np.linalg.inv(precision)
    ratio = np.ones(len(index))
    if coloured is not None:
        middle = coloured + np.diag(1 / spreads[index] ** 2)
        ratio = np.maximum(np.diag(plain @ middle @ plain) / np.diag(plain), 1.0)
    widen = np.sqrt(ratio)
    shrinkage = np.clip(1 - np.diag(plain) / spreads[index] ** 2, 0.0, 1.0)
    return Estimate(
        free, coordinates, deviance, index, plain * np.outer(widen, widen), information,
        precision, shrinkage, float(np.mean(ratio)), noise, tuple(path),
    )  # fmt: skip


def normal_interval(parameter: Parameter, at: float, std: float) -> tuple[float, float]:
    """The central 90 % interval of a number whose coordinate is normal."""
    off = float(norm.ppf(0.5 + LEVEL / 2)) * std
    ends = sorted(float(parameter.decode(at + sign * off)) for sign in (-1.0, 1.0))
    return ends[0], ends[1]


def parameter_estimates(parameters: Sequence[Parameter], fitted: Estimate) -> list[dict]:
    """One row per fitted vessel parameter.

    `name`, `meaning`, `unit`, `start`, `value`, `std`, `interval` (90 %) and `determined`, the
    share of the estimate that is due to the data.
    """
    position = {int(k): n for n, k in enumerate(fitted.index)}
    rows = []
    for number, parameter in enumerate(parameters):
        if number not in position:
            continue
        n, at = position[number], float(fitted.coordinates[number])
        std = float(fitted.stds[n])
        rows.append(
            {
                "name": parameter.name,
                "meaning": meaning(parameter.name),
                "unit": parameter.unit,
                "start": parameter.value,
                "value": float(parameter.decode(at)),
                "std": parameter.slope(at) * std,
                "interval": list(normal_interval(parameter, at, std)),
                "determined": float(fitted.shrinkage[n]),
            }
        )
    return rows
