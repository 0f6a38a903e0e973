"""Sobol indices: which share of a number's variance each parameter makes, alone and in all.

Where derivatives say what a parameter does at one point, these say what it does over its whole
range (Sobol 1993; estimators of Saltelli and others 2010, by SciPy).
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
import scipy.stats
from jaxtyping import Float

from diffsea.errors import UserError
from diffsea.progress import Progress, no_progress
from diffsea.simulation.designs import Designs
from diffsea.simulation.standard import TrialPlan
from diffsea.studies.sweep import Sweeper, check_names
from diffsea.vessel.base import Vessel


LEVEL = 0.9  # of intervals
_DRAWS = 300  # of the bootstrap
_CONSTANT = 1e-6  # of a number's size: spread that is rounding, and how steady an approach is


@dataclasses.dataclass(frozen=True)
class Index:
    """A share of variance with its interval of 90 %, by the bootstrap over designs."""

    value: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class SobolIndices:
    """Indices by number, then by parameter.

    Attributes:
        first: share that a parameter makes alone.
        total: share that it has a part in.
        left_out: numbers that some design of the ranges does not have.
        designs: how many were run.
    """

    first: dict[str, dict[str, Index]]
    total: dict[str, dict[str, Index]]
    left_out: tuple[str, ...]
    designs: int

    def as_dict(self) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
        """The content of sobol.json: number, parameter, `first` and `total`."""
        return {
            number: {
                name: {
                    "first": dataclasses.asdict(index),
                    "total": dataclasses.asdict(self.total[number][name]),
                }
                for name, index in row.items()
            }
            for number, row in self.first.items()
        }


def sobol_indices(
    vessel: Vessel,
    plan: TrialPlan,
    ranges: Mapping[str, tuple[float, float]],
    count: int,
    seed: int = 0,
    progress: Progress = no_progress,
) -> SobolIndices:
    """Sobol indices of a trial's numbers over ranges of parameters, all values alike likely.

    Arguments:
        ranges: from and to by name of a parameter, or of `speed` or `thrust`; SI units.
        count: a power of two; `count` (2 + parameters) designs are run.

    Raises:
        UserError: a name of no parameter, a range that is none, or a count that is no power of two.
    """
    names = tuple(ranges)
    check_names(vessel, names)
    if count < 2 or count & (count - 1):
        raise UserError(f"{count} is no power of two, as these estimators need: take 256 or 1024")
    for name, (low, high) in ranges.items():
        if not low < high:
            raise UserError(f"{name} is from {low:g} to {high:g}: give the lower number first")
    rng = np.random.default_rng(seed)
    unit = scipy.stats.qmc.Sobol(2 * len(names), rng=rng).random(count)
    first, second = unit[:, : len(names)], unit[:, len(names) :]
    crossed = np.repeat(first[None], len(names), axis=0)
    for k in range(len(names)):
        crossed[k, :, k] = second[:, k]
    low, high = np.array(list(ranges.values())).T
    rows = np.concatenate([first, second, *crossed]) * (high - low) + low
    numbers = _numbers(vessel, plan, Designs(names, rows), progress)
    found: dict[str, tuple[dict[str, Index], dict[str, Index]]] = {}
    left_out = []
    for number, values in numbers.items():
        if not np.isfinite(values).all():
            left_out.append(number)
        elif np.ptp(values) > _CONSTANT * np.abs(values).max():
            found[number] = _indices(names, values, count, rng)
    return SobolIndices(
        {number: parts[0] for number, parts in found.items()},
        {number: parts[1] for number, parts in found.items()},
        tuple(left_out),
        len(rows),
    )


def _numbers(
    vessel: Vessel, plan: TrialPlan, designs: Designs, progress: Progress
) -> dict[str, Float[np.ndarray, "design"]]:
    """The trial's numbers of every design."""
    table = Sweeper(vessel, plan, len(designs.values)).run(designs, progress).table
    chosen = table.select_dtypes("number").drop(columns=list(designs.names))
    return {str(name): chosen[name].to_numpy(float) for name in chosen}


def _indices(
    names: tuple[str, ...],
    values: Float[np.ndarray, "design"],
    count: int,
    rng: np.random.Generator,
) -> tuple[dict[str, Index], dict[str, Index]]:
    """First and total indices of one number; designs are those of both samples, then crossed."""
    blocks = values.reshape(2 + len(names), 1, count)
    given = {"f_A": blocks[0], "f_B": blocks[1], "f_AB": blocks[2:]}
    found = scipy.stats.sobol_indices(func=given, n=count, rng=rng)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = found.bootstrap(confidence_level=LEVEL, n_resamples=_DRAWS)
    out = []
    for kind in ("first_order", "total_order"):
        value, interval = getattr(found, kind), getattr(spread, kind).confidence_interval
        # A parameter that changes nothing has an index of zero in every draw, and no interval.
        ends = (np.where(np.isfinite(end), end, value) for end in (interval.low, interval.high))
        columns = (np.ravel(part) for part in (value, *ends))
        rows = zip(names, *columns, strict=True)
        out.append({name: Index(*map(float, row)) for name, *row in rows})
    return out[0], out[1]
