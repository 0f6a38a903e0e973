"""Many designs through one trial, run in batches.

A design that diverges or is impossible spoils its own row and no other.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError, nearest_of
from diffsea.parameters import (
    PARAMETERS_LISTED,
    file_parameters,
    replace,
    spread_over_places,
)
from diffsea.progress import counted
from diffsea.simulation import planning
from diffsea.simulation.batches import batch_size, in_batches
from diffsea.simulation.control import ControlAllocation, throttle_for_thrust
from diffsea.simulation.designs import OF_THE_TRIAL, Designs
from diffsea.simulation.designs import grid as grid
from diffsea.simulation.designs import sample as sample
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.studies.sensitivity import Places
from diffsea.trajectory import Outcome
from diffsea.types import Scalar, as_inputs
from diffsea.vessel.base import Vessel


IMPOSSIBLE = "impossible"


class SweepResult(NamedTuple):
    """What a sweep found.

    `table` has one row per design: its parameters, the trial's numbers in SI units,
    `imo_<number>` verdicts and the `outcome`; nulls where the design failed.
    """

    table: pd.DataFrame
    steps_per_second: float  # of all vessels together


class _DesignResults(NamedTuple):
    numbers: Numbers
    outcome: Int[Array, "design"]
    possible: Bool[Array, "design"]
    steps: Int[Array, "design"]


def check_names(vessel: Vessel, names: Sequence[str]) -> None:
    """Raise `UserError` for a name that is neither a parameter of the vessel nor of the trial."""
    every = (*OF_THE_TRIAL, *file_parameters(vessel))
    for name in names:
        if name not in every:
            raise UserError(
                f"there is no parameter {name!r}{nearest_of(name, every, PARAMETERS_LISTED)}"
            )
    if set(OF_THE_TRIAL) <= set(names):
        raise UserError("sweep the approach speed or the thrust, not both")
    if "thrust" in names and not ControlAllocation(vessel).propelled:
        raise UserError(f"{vessel.name!r} has no propulsion to command")


def sweep(
    vessel: Vessel,
    plan: TrialPlan,
    designs: Designs,
    progress: Callable[[str], None] = lambda message: None,
) -> SweepResult:
    """Run a trial of every design.

    Designs that take much longer than the vessel as it is run again, to the plan's limit.

    Raises:
        UserError: a name that is neither a parameter of the vessel nor of the trial.
    """
    check_names(vessel, designs.names)
    return Sweeper(vessel, plan, len(designs.values)).run(designs, progress)


class Sweeper:
    """Runs a trial of designs, some after others, with programs that are compiled once."""

    def __init__(self, vessel: Vessel, plan: TrialPlan, at_once: int):
        """
        Arguments:
            at_once: how many designs come together at most.
        """
        self.vessel, self.plan = vessel, plan
        self._plans = shorter_plans(vessel, plan)
        self._at_once = at_once

    def run(
        self,
        designs: Designs,
        progress: Callable[[str], None] = lambda message: None,
        whole: bool = False,
    ) -> SweepResult:
        """What is found of some designs.

        Arguments:
            whole: keep columns without any number, as parts of a sweep have to.
        """
        known, values = file_parameters(self.vessel), np.asarray(designs.values, float)
        places = tuple((name, known.get(name, ())) for name in designs.names)
        first, *longer = self._plans
        run = functools.partial(_run_designs, self.vessel, at_once=self._at_once, progress=progress)
        found, steps, seconds = run(first, places, values)
        for following in longer:
            unfinished = np.isin(found.outcome, (Outcome.TIME_LIMIT, Outcome.APPROACH_UNSTEADY))
            left = found.possible & unfinished
            if not left.any():
                break
            progress(f"{counted(int(left.sum()), 'design')} not done in that time: run again")
            some, *more = run(following, places, values[left])
            for old, new in zip(jax.tree.leaves(found), jax.tree.leaves(some), strict=True):
                old[left] = new
            steps, seconds = steps + more[0], seconds + more[1]
        table = _results_table(self.vessel, self.plan, designs, found, whole)
        return SweepResult(table, steps / max(seconds, 1e-9))


def shorter_plans(vessel: Vessel, plan: TrialPlan) -> list[TrialPlan]:
    """The plan with time limits of half as much again as the vessel itself needs, and of six times.

    A batch runs for as long as it may, whenever its lanes end; last comes the plan itself. Where
    the vessel does not complete the trial, an eighth of the plan's limits comes first.
    """
    run, _ = planning.run_and_measure(vessel, plan)
    before, after, factors = plan.approach_seconds, plan.settings.seconds, (1 / 8,)
    if int(run.trajectory.outcome) == Outcome.COMPLETED:
        rows = np.asarray(run.trajectory.valid)
        before, factors = float(run.execute_time), (1.5, 6.0)
        after = float(np.max(np.asarray(run.trajectory.t)[rows])) - before
    plans = []
    for factor in factors:
        seconds = planning.round_up(factor * after)
        if seconds > 0.7 * plan.settings.seconds:  # timed stages end by the clock
            seconds = plan.settings.seconds
        approach = planning.round_up(factor * before) if before > 0 else plan.approach_seconds
        settings = dataclasses.replace(plan.settings, seconds=seconds)
        approach = min(approach, plan.approach_seconds)
        shorter = dataclasses.replace(plan, settings=settings, approach_seconds=approach)
        plans += [shorter] if shorter != plan else []
    return [*plans, plan]


def _run_designs(
    vessel: Vessel,
    plan: TrialPlan,
    places: Places,
    values: Float[np.ndarray, "design name"],
    at_once: int,
    progress: Callable[[str], None],
) -> tuple[_DesignResults, float, float]:
    """Run designs, of which so many come together at most, in batches side by side.

    Returns their results, and of the batches that were not compiled first the vessel-steps and
    the seconds that they took.
    """
    arrays = as_inputs(vessel)
    longest = plan.approach_seconds + plan.settings.seconds
    done = in_batches(
        lambda rows: _batched_trial(arrays, jnp.asarray(rows), plan, places),
        values,
        batch_size(at_once, round(longest / plan.settings.step)),
        progress,
        lambda found: int(found.steps.sum()),
    )
    return done.results, int(done.results.steps[done.timed].sum()), done.seconds


@eqx.filter_jit
def _batched_trial(
    vessel: Vessel, values: Float[Array, "design name"], plan: TrialPlan, places: Places
) -> _DesignResults:
    """Numbers and outcome of the trial of every design; each leaf has the designs first."""

    def run_one(row: Float[Array, "name"]) -> _DesignResults:
        chosen: dict[str, Scalar] = {name: row[k] for k, (name, _) in enumerate(places)}
        changed = replace(vessel, spread_over_places(dict(places), chosen))
        thrust = chosen.get("thrust")
        throttle = None if thrust is None else throttle_for_thrust(changed, thrust)
        done = planning.run_plan(changed, plan, chosen.get("speed"), throttle)
        numbers, run = planning.trial_numbers(plan, done), done.trajectory
        body = changed.rigid_body
        sizes = (body.mass, body.I_z, body.length, body.beam, body.draught, body.water_density)
        # As a vessel file's have to be.
        positive = jnp.all(jnp.stack([jnp.asarray(size, float) for size in sizes]) > 0)
        possible = positive & changed.has_inertia()
        return _DesignResults(numbers, jnp.asarray(run.outcome), possible, jnp.sum(run.valid))

    return jax.vmap(run_one)(values)


def _results_table(
    vessel: Vessel, plan: TrialPlan, designs: Designs, found: _DesignResults, whole: bool
) -> pd.DataFrame:
    """Parameters, numbers, verdicts and outcome of every design; nulls where it failed."""
    labels = [planning.outcome_label(Outcome(int(o))) for o in found.outcome]
    outcome = np.where(found.possible, np.array(labels, dtype=object), IMPOSSIBLE)
    failed = np.isin(outcome, (IMPOSSIBLE, "diverged", "approach-unsteady"))
    numbers = {name: np.where(failed, np.nan, column) for name, column in found.numbers.items()}
    if not whole:
        numbers = {name: column for name, column in numbers.items() if np.isfinite(column).any()}
    parameters = {name: designs.values[:, k] for k, name in enumerate(designs.names)}
    lengths = parameters.get("length", np.full(len(outcome), float(vessel.rigid_body.length)))
    verdicts = []
    for k, length in enumerate(lengths):
        row = {name: float(column[k]) for name, column in numbers.items() if np.isfinite(column[k])}
        verdicts.append(planning.trial_verdicts(plan, row, length))
    imo = {
        f"imo_{name}": [row[name]["verdict"] if name in row else None for row in verdicts]
        for name in sorted({name for row in verdicts for name in row})
    }
    return pd.DataFrame({**parameters, **numbers, **imo, "outcome": outcome})
