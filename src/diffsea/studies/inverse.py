"""Inverse design: the parameters at which a trial has the numbers that are wanted.

Least squares by exact derivatives through the located switching, from the nearest designs of a
sweep and within its ranges.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.identification.least_squares import iterate_least_squares, value_and_jacobian
from diffsea.parameters import Parameter, file_parameters, replace, spread_over_places
from diffsea.progress import PartialProgress, Progress, no_progress
from diffsea.simulation import planning
from diffsea.simulation.control import throttle_for_thrust
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.studies.front import require_numbers
from diffsea.studies.sweep import check_names, shorter_plans
from diffsea.types import Scalar, as_inputs
from diffsea.vessel.base import Vessel


STARTS = 4
STEPS = 25  # of each start
MET = 1e-4  # of a wanted number: off by less it is met
APART = 0.2  # of the ranges, by which starts differ in one parameter at least
_TOLERANCE = 1e-6  # of the coordinates, which run from end to end of a range in about eight
_EDGE = 1e-3  # of a range, that a start keeps from its ends

Ranges = Mapping[str, tuple[float, float]]
Coordinates = Float[Array, "parameter"]


class FoundDesign(NamedTuple):
    """A design near the wanted numbers. SI units."""

    parameters: dict[str, float]
    numbers: dict[str, float]  # all of the trial
    off: float  # largest miss of a wanted number over the number itself; over one of zero, in SI
    steps: int

    def as_dict(self) -> dict[str, Any]:
        """Itself as it stands in sweep.json."""
        return {
            "parameters": self.parameters,
            "metrics": self.numbers,
            "off": self.off,
            "steps": self.steps,
        }


def designs_for(
    vessel: Vessel,
    plan: TrialPlan,
    ranges: Ranges,
    wanted: Mapping[str, float],
    swept: pd.DataFrame,
    progress: Progress = no_progress,
) -> list[FoundDesign]:
    """Designs within ranges whose trial has the wanted numbers, or comes nearest to them.

    Where fewer numbers are wanted than there are parameters, each start ends at a design of its
    own near it; where more, misses are shared out in proportion to the numbers.

    Arguments:
        ranges: from and to by parameter, `speed` or `thrust`.
        wanted: numbers of the trial by name, SI units.
        swept: designs of those ranges with their numbers, the nearest of which are the starts.

    **Returns:** the best first; designs that several starts lead to once.

    Raises:
        UserError: a name of no number of the trial, a range that is none, or no design that has
            all the wanted numbers to start from.
    """
    check_names(vessel, list(ranges))
    require_numbers(wanted, list(swept.select_dtypes("number")))
    for name, (low, high) in ranges.items():
        if not low < high:
            raise UserError(f"{name} is from {low:g} to {high:g}: give the lower number first")
    known = swept.dropna(subset=list(wanted))
    if known.empty:
        raise UserError(
            f"no design of the sweep has all of {', '.join(wanted)}: widen the ranges, or run more"
        )
    parameters = [
        Parameter(name, 0.5 * (low + high), lower=low, upper=high)
        for name, (low, high) in ranges.items()
    ]
    plans = shorter_plans(vessel, plan)
    roomy = plans[len(plans) // 2]  # of three the one with room for trials six times as long
    search = _search(as_inputs(vessel), roomy, parameters, wanted)
    rows, found = nearest_starts(known, ranges, wanted), []
    for number, row in enumerate(rows):
        progress(PartialProgress(f"start {number + 1} of {len(rows)}", number / len(rows)))
        found.append(search(row))
    found.sort(key=lambda one: one.off)
    return _distinct(found, ranges)


def found_sentence(wanted: Mapping[str, float], off: Sequence[float]) -> str:
    """How many designs have the wanted numbers, by what each is off, the best first."""
    words = ", ".join(f"{name} = {value:g}" for name, value in wanted.items())
    met = sum(miss <= MET for miss in off)
    if not met:
        return f"no design in these ranges has {words}: the nearest is off by {100 * off[0]:.2g} %"
    return f"{met} design{'s have' if met > 1 else ' has'} {words}"


def nearest_starts(
    swept: pd.DataFrame, ranges: Ranges, wanted: Mapping[str, float]
) -> list[dict[str, float]]:
    """The designs nearest to the wanted numbers, each apart from those before it."""
    misses = np.stack([(swept[n] - value) / _scale(value) for n, value in wanted.items()])
    widths = np.array([high - low for low, high in ranges.values()])
    values = swept[list(ranges)].to_numpy(float)
    chosen: list[int] = []
    for row in np.argsort((misses**2).sum(0), kind="stable"):
        away = [np.max(np.abs(values[row] - values[one]) / widths) for one in chosen]
        if all(distance >= APART for distance in away):
            chosen.append(int(row))
        if len(chosen) == STARTS:
            break
    return [dict(zip(ranges, values[row].tolist(), strict=True)) for row in chosen]


def _scale(wanted: float) -> float:
    """What a miss is told by: the number itself, or its unit where zero is wanted."""
    return abs(wanted) or 1.0


def _search(
    vessel: Vessel, plan: TrialPlan, parameters: list[Parameter], wanted: Mapping[str, float]
) -> Any:
    """A function that leads one start, by parameter, to a `FoundDesign`."""
    places = file_parameters(vessel)
    scales = jnp.array([_scale(value) for value in wanted.values()])

    def decoded(at: Coordinates) -> dict[str, Scalar]:
        return {one.name: one.decode(at[k]) for k, one in enumerate(parameters)}

    def numbers(at: Coordinates) -> Numbers:
        chosen = decoded(at)
        own = {name: value for name, value in chosen.items() if name in places}
        changed = replace(vessel, spread_over_places(places, own))
        thrust = chosen.get("thrust")
        throttle = None if thrust is None else throttle_for_thrust(changed, thrust)
        return planning.trial_numbers(
            plan, planning.run_plan(changed, plan, chosen.get("speed"), throttle)
        )

    def residuals(at: Coordinates) -> Float[Array, "wanted"]:
        found = numbers(at)
        missing = jnp.stack([found[name] - value for name, value in wanted.items()])
        return missing / scales

    function = eqx.filter_jit(lambda at, _: value_and_jacobian(residuals, at))
    every_number = eqx.filter_jit(numbers)

    def search(row: dict[str, float]) -> FoundDesign:
        at = jnp.array([_encoded(one, row[one.name]) for one in parameters])
        cost, steps = math.inf, 0
        for step in iterate_least_squares(function, at, None, STEPS, _TOLERANCE):
            steps += 1
            if step.accepted and math.isfinite(step.cost):
                at, cost = step.at, step.cost
            if cost < (MET / 100) ** 2:
                break
        found = {name: float(value) for name, value in every_number(at).items()}
        off = max(abs(found[name] - value) / _scale(value) for name, value in wanted.items())
        values = {name: float(value) for name, value in decoded(at).items()}
        shown = {name: value for name, value in found.items() if math.isfinite(value)}
        return FoundDesign(values, shown, off, steps)

    return search


def _encoded(parameter: Parameter, value: float) -> float:
    """The coordinate of a value, a little off the ends of its range."""
    room = _EDGE * (parameter.upper - parameter.lower)
    return parameter.encode(min(max(value, parameter.lower + room), parameter.upper - room))


def _distinct(found: list[FoundDesign], ranges: Ranges) -> list[FoundDesign]:
    """Designs that differ by a thousandth of a range."""
    kept: list[FoundDesign] = []
    for one in found:
        away = [
            max(
                abs(one.parameters[name] - other.parameters[name]) / (high - low)
                for name, (low, high) in ranges.items()
            )
            for other in kept
        ]
        if all(distance > _EDGE for distance in away):
            kept.append(one)
    return kept
