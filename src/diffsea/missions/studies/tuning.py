"""Numbers of a mission tuned by derivatives through the closed loop, and judged on another path.

Derivatives are those of the sampled loop: where a sample decides something (a waypoint reached),
the decision has none. So the best of several starts is kept, and judged on a path that was not
tuned on.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.identification.least_squares import iterate_least_squares, value_and_jacobian
from diffsea.missions.numbers import full_names, mission_numbers, settled, with_numbers
from diffsea.missions.performance import NUMBERS, cost_residuals, performance
from diffsea.missions.record import Mission, TimedStep
from diffsea.missions.running import Timing, assemble, closed_loop, estimator_of
from diffsea.missions.studies.sweep import (
    common_timing,
    quicker,
    run_if_possible,
)
from diffsea.parameters import Parameter
from diffsea.progress import PartialProgress, Progress, no_progress
from diffsea.simulation.designs import Designs, LatinHypercube
from diffsea.types import Scalar


Ranges = Mapping[str, tuple[float, float]]
Coordinates = Float[Array, "number"]

STARTS = 3
STEPS = 12  # of each start
EFFORT = 1.0
_TOLERANCE = 1e-3  # of the coordinates, which run from end to end of a range in about eight
_EDGE = 1e-3  # of a range, that a start keeps from its ends
_JUDGED_TURN = 2 * math.pi / 3  # rad, of the path that judges: wind and current from elsewhere


class StartFound(NamedTuple):
    """A start of the tuning, and where it led; numbers by whole name, SI units."""

    start: dict[str, float]
    found: dict[str, float]
    cost_before: float
    cost: float
    steps: int


class JudgedPath(NamedTuple):
    """How a path went before and after: cost and performance by name."""

    name: str
    tuned_on: bool
    before: dict[str, float]
    after: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Tuning:
    """A mission with tuned numbers, all starts, and every path before and after."""

    mission: Mission
    ranges: Ranges
    before: dict[str, float]
    after: dict[str, float]
    starts: tuple[StartFound, ...]
    paths: tuple[JudgedPath, ...]
    effort: float


def tune(
    mission: Mission,
    ranges: Ranges,
    judges: Sequence[Mission] = (),
    starts: int = STARTS,
    effort: float = EFFORT,
    progress: Progress = no_progress,
) -> Tuning:
    """Tune numbers of a mission within ranges, on its path and on that path mirrored.

    The cost is the mean square of the path error in ship lengths (of the heading error in 10 deg
    and of the speed error in tenths), and `effort` times that of the changes of orders, see
    `performance.order_changes`. Each start goes down by Gauss-Newton steps with exact derivatives.

    Arguments:
        ranges: from and to (SI units) by name of a number of the mission.
        judges: missions that judge; the path turned by 120 deg, with another seed, if none.
        starts: the numbers as they stand, and others spread over the ranges.

    Raises:
        UserError: a name of no number of the mission or of one that judges, a range that is none,
            a mission without a task to judge by, or no start from which it can be run.
    """
    names = full_names(mission, list(ranges))
    ranges = dict(zip(names, ranges.values(), strict=True))
    for name, (low, high) in ranges.items():
        if not low < high:
            raise UserError(f"{name} is from {low:g} to {high:g}: give the lower number first")
    if mission.controller.kind == "orders":
        raise UserError("a mission of timed orders has no error to tune by")
    mission = settled(mission, names)
    own = {name: mission_numbers(mission)[name] for name in names}
    rows = [_inside(own, ranges)]
    if starts > 1:
        spread = LatinHypercube(ranges, starts - 1, mission.seed).all().values
        rows += [_inside(dict(zip(names, row, strict=True)), ranges) for row in spread.tolist()]
    ends = np.array([list(pair) for pair in ranges.values()]).T
    for judge in judges:
        full_names(judge, names)
    times = common_timing(mission, Designs(tuple(names), np.vstack([ends, list(own.values())])))
    if "controller.speed" not in names:  # else the slower ones would be cut off before they err
        times = quicker(times, run_if_possible(mission))
    trained = [mission, mirrored(mission)]
    found = _descend(trained, ranges, rows, times, effort, progress)
    best = min(found, key=lambda one: one.cost)
    if not math.isfinite(best.cost):
        raise UserError("no start could be run: narrow the ranges, or give a smaller time_step")
    turned_path = dataclasses.replace(turned(mission), seed=mission.seed + 1)
    judged = [settled(one, names) for one in judges] or [turned_path]
    paths = []
    for one in (*trained, *judged):
        numbers = [_judge(one, values, effort) for values in (own, best.found)]
        paths.append(JudgedPath(one.name, one in trained, *numbers))
    tuned = with_numbers(mission, best.found)
    return Tuning(tuned, ranges, own, best.found, tuple(found), tuple(paths), effort)


def _inside(values: dict[str, float], ranges: Ranges) -> dict[str, float]:
    """Values within their ranges, a little off the ends."""
    room = {name: _EDGE * (high - low) for name, (low, high) in ranges.items()}
    return {
        name: min(max(values[name], low + room[name]), high - room[name])
        for name, (low, high) in ranges.items()
    }


def _descend(
    missions: Sequence[Mission],
    ranges: Ranges,
    rows: Sequence[dict[str, float]],
    times: Timing,
    effort: float,
    progress: Progress,
) -> list[StartFound]:
    """Where every start leads."""
    middles = {name: 0.5 * (low + high) for name, (low, high) in ranges.items()}
    parameters = [
        Parameter(name, middles[name], lower=low, upper=high)
        for name, (low, high) in ranges.items()
    ]
    guards = [estimator_of(one, times) for one in missions]

    def decoded(at: Coordinates) -> dict[str, Scalar]:
        return {one.name: one.decode(at[k]) for k, one in enumerate(parameters)}

    def residuals(at: Coordinates) -> Float[Array, "residual"]:
        changed = [with_numbers(one, decoded(at)) for one in missions]
        with_guards = zip(changed, guards, strict=True)
        loops = [closed_loop(assemble(one, times, guard)) for one, guard in with_guards]
        each = zip(changed, loops, strict=True)
        parts = [cost_residuals(one, loop, effort) for one, loop in each]
        return jnp.concatenate(parts) / math.sqrt(len(missions))

    function = eqx.filter_jit(lambda at, _: value_and_jacobian(residuals, at))
    found = []
    for number, row in enumerate(rows):
        at = jnp.array([one.encode(row[one.name]) for one in parameters])
        first, cost, steps = math.nan, math.inf, 0
        for steps, step in enumerate(iterate_least_squares(function, at, None, STEPS, _TOLERANCE)):
            if step.accepted and math.isfinite(step.cost):
                at, cost = step.at, step.cost
            first = cost if math.isnan(first) else first
            told = f"start {number + 1} of {len(rows)}, step {steps + 1}: cost {cost:.4g}"
            share = (number + (steps + 1) / STEPS) / len(rows)
            progress(PartialProgress(told, share))
        values = {name: float(value) for name, value in decoded(at).items()}
        found.append(StartFound(row, values, first, cost, steps + 1))
    return found


def _judge(mission: Mission, values: Mapping[str, float], effort: float) -> dict[str, float]:
    """Cost and performance of a mission with some numbers; an infinite cost where it diverges."""
    changed = with_numbers(mission, values)
    names = [name for name in values if name == "controller.speed"]
    times = common_timing(changed, Designs(tuple(names), np.array([[values[n] for n in names]])))
    guard = estimator_of(changed, times)

    @eqx.filter_jit
    def judged() -> tuple[Scalar, dict[str, Scalar]]:
        loop = closed_loop(assemble(changed, times, guard))
        residuals = cost_residuals(changed, loop, effort)
        return jnp.sum(residuals**2), performance(changed, loop).numbers

    cost, numbers = judged()
    known = (name for name in NUMBERS if name in numbers)
    return {"cost": float(jnp.nan_to_num(cost, nan=jnp.inf))} | {
        name: float(numbers[name]) for name in known
    }


def mirrored(mission: Mission) -> Mission:
    """The mission with every turn to the other side, begun at the same place on the same course."""
    return _changed_path(mission, "mirrored", lambda along, across: (along, -across), flip=-1.0)


def turned(mission: Mission, angle: float = _JUDGED_TURN) -> Mission:
    """The mission with its whole path turned about its beginning by `angle` rad."""
    cos, sin = math.cos(angle), math.sin(angle)
    turn = lambda along, across: (cos * along - sin * across, sin * along + cos * across)
    return _changed_path(mission, "turned", turn, angle=angle)


def _changed_path(
    mission: Mission,
    what: str,
    change: Callable[[float, float], tuple[float, float]],
    flip: float = 1.0,
    angle: float = 0.0,
) -> Mission:
    """The mission with a path changed in the axes of its first leg or heading.

    Arguments:
        change: m along the first leg and to starboard of it, made of the same.
        flip: of turns and sideways velocities.
        angle: that headings turn by, rad.
    """
    start = dict(mission.start)
    points, steps = mission.waypoints, mission.steps
    if points:
        first, second = points[:2]
        course = math.atan2(second.y - first.y, second.x - first.x)
    else:
        course = steps[0].heading
    cos, sin = math.cos(course), math.sin(course)

    def moved(x: float, y: float, origin: tuple[float, float]) -> tuple[float, float]:
        north, east = x - origin[0], y - origin[1]
        along, across = change(cos * north + sin * east, cos * east - sin * north)
        return (
            origin[0] + cos * along - sin * across,
            origin[1] + sin * along + cos * across,
        )

    heading = lambda psi: course + angle + flip * (psi - course)
    posed = mission.controller.kind == "positioning"
    stated = points or (steps if posed else ())
    origin = (stated[0].x, stated[0].y) if stated else (start.get("x", 0.0), start.get("y", 0.0))
    places = [moved(one.x, one.y, origin) for one in points]

    def at(step: TimedStep) -> dict[str, float]:
        return dict(zip("xy", moved(step.x, step.y, origin), strict=True)) if posed else {}

    if "x" in start or "y" in start:
        start["x"], start["y"] = moved(start.get("x", origin[0]), start.get("y", origin[1]), origin)
    if "psi" in start:
        start["psi"] = heading(start["psi"])
    start |= {name: flip * start[name] for name in ("v", "r") if name in start}
    return dataclasses.replace(
        mission,
        name=f"{mission.name}, {what}",
        waypoints=tuple(
            dataclasses.replace(one, x=x, y=y) for one, (x, y) in zip(points, places, strict=True)
        ),
        steps=tuple(
            dataclasses.replace(one, heading=heading(one.heading), **at(one)) for one in steps
        ),
        start=start,
    )
