"""One mission with many values of its numbers, in batches: gains, models, weathers."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.missions.numbers import full_names, settled, with_numbers
from diffsea.missions.performance import NUMBERS, Performance, performance
from diffsea.missions.record import Mission
from diffsea.missions.running import (
    DivergedError,
    MissionRun,
    Timing,
    assemble,
    closed_loop,
    estimator_of,
    require_controllable,
    run,
    timing,
)
from diffsea.progress import Progress, counted, no_progress
from diffsea.simulation.batches import batch_size, in_batches
from diffsea.simulation.designs import Designs, DesignSpace
from diffsea.simulation.planning import outcome_label
from diffsea.trajectory import Outcome


MOST = 1_000_000  # designs


@dataclasses.dataclass(frozen=True)
class ClosedLoopSweep:
    """What was found of every design, a row each.

    `table` has the design's numbers by their whole names, the performance and the outcome; nulls
    where the run diverged. `as_it_stands` is the mission with its own numbers, None where that
    diverged.
    """

    mission: Mission
    table: pd.DataFrame
    as_it_stands: MissionRun | None
    steps_per_second: float


def closed_loop_sweep(
    mission: Mission, space: DesignSpace, progress: Progress = no_progress
) -> ClosedLoopSweep:
    """Run a mission with every design of a space, whose names are numbers of the mission.

    An estimator begins at the mission's own model, whatever the design.

    Raises:
        UserError: a name of no number, a speed beyond the vessel's reach at either end of its
            range, or a mission that cannot be run.
    """
    if space.count > MOST:
        raise UserError(f"{space.count} designs are too many; at most {MOST} are run at once")
    names = full_names(mission, space.names)
    mission = settled(mission, names)
    designs = Designs(tuple(names), space.rows(0, space.count).values)
    times, stands = common_timing(mission, designs), run_if_possible(mission)
    found, steps, seconds = _run_designs(mission, designs, quicker(times, stands), progress)
    late = found.outcome == Outcome.TIME_LIMIT
    if late.any() and mission.waypoints:
        progress(f"{counted(int(late.sum()), 'design')} not done in that time: run again")
        left = Designs(designs.names, designs.values[late])
        again, *more = _run_designs(mission, left, times, progress)
        for old, new in zip(jax.tree.leaves(found), jax.tree.leaves(again), strict=True):
            old[late] = new
        steps, seconds = steps + more[0], seconds + more[1]
    speed = steps / max(seconds, 1e-9)
    return ClosedLoopSweep(mission, _table(mission, designs, found), stands, speed)


def run_if_possible(mission: Mission) -> MissionRun | None:
    """The mission as it stands; None where it diverges."""
    try:
        return run(mission)
    except DivergedError:
        return None


def quicker(times: Timing, stands: MissionRun | None) -> Timing:
    """Half as long again as the mission takes as it stands: lanes run for as long as they may."""
    if stands is None or not stands.mission.waypoints:
        return times
    took = 1.5 * float(stands.true.t[-1])
    return times._replace(seconds=min(times.seconds, math.ceil(took / times.period) * times.period))


def common_timing(mission: Mission, designs: Designs) -> Timing:
    """Times that suit the slowest design; speeds are checked at both ends.

    Raises:
        UserError: a speed that the vessel does not reach.
    """
    slowest = mission
    if "controller.speed" in designs.names:
        speeds = designs.values[:, designs.names.index("controller.speed")]
        slowest, fastest = (
            with_numbers(mission, {"controller.speed": float(end)})
            for end in (speeds.min(), speeds.max())
        )
        if not speeds.min() > 0:
            raise UserError(
                f"controller.speed is {speeds.min():g} m/s at its lowest: not above zero"
            )
        require_controllable(fastest)
    require_controllable(slowest)
    return timing(slowest)


def _run_designs(
    mission: Mission, designs: Designs, times: Timing, progress: Progress
) -> tuple[Performance, int, float]:
    """What every design did; of those that were timed the vessel-steps, and the seconds."""
    parts = math.ceil(times.period / times.time_step - 1e-9)  # steps of a period
    guard = estimator_of(mission, times)

    def run_one(row: Float[Array, "name"]) -> Performance:
        changed = with_numbers(mission, dict(zip(designs.names, row, strict=True)))
        return performance(changed, closed_loop(assemble(changed, times, guard)))

    run_batch = eqx.filter_jit(lambda rows: jax.vmap(run_one)(rows))
    done = in_batches(
        lambda rows: run_batch(jnp.asarray(rows)),
        np.asarray(designs.values, float),
        batch_size(len(designs.values), times.rows * parts),
        progress,
        lambda found: int(found.rows.sum()) * parts,
        threads=1,  # gains of positioning and track keeping are found by LAPACK
    )
    return done.results, int(done.results.rows[done.timed].sum()) * parts, done.seconds


def _table(mission: Mission, designs: Designs, found: Performance) -> pd.DataFrame:
    outcomes = [Outcome(int(one)) for one in found.outcome]
    if mission.steps:  # which are run to the end of their time
        outcomes = [Outcome.COMPLETED if o is Outcome.TIME_LIMIT else o for o in outcomes]
    diverged = np.array([one is Outcome.DIVERGED for one in outcomes])
    given = dict(zip(designs.names, designs.values.T, strict=True))
    known = (name for name in NUMBERS if name in found.numbers)  # compiled, they are sorted
    numbers = {name: np.where(diverged, np.nan, found.numbers[name]) for name in known}
    return pd.DataFrame({**given, **numbers, "outcome": [outcome_label(one) for one in outcomes]})
