"""Many designs through one trial: grids and samples of any parameters, run in batches.

A design that diverges or is impossible spoils its own row and no other.
"""

import concurrent.futures
import dataclasses
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import scipy.stats
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError, nearest
from diffsea.parameters import designed, replace, spread
from diffsea.simulation import planning
from diffsea.simulation.control import ControlAllocation, throttle_for_thrust
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.trajectory import Outcome
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


Places = tuple[tuple[str, tuple[str, ...]], ...]

OF_THE_TRIAL = ("speed", "thrust")  # m/s, N: swept like parameters, though they are no part of it
IMPOSSIBLE = "impossible"
_UNFINISHED = (Outcome.TIME_LIMIT, Outcome.APPROACH_UNSTEADY)
_MOST_DESIGNS = 1_000_000
_LANES = 64  # designs that run side by side; more of them leave the processor's cache


class Designs(NamedTuple):
    """Values of named parameters, one row per design."""

    names: tuple[str, ...]
    values: Float[np.ndarray, "design name"]


def grid(axes: Mapping[str, tuple[float, float, int]]) -> Designs:
    """All combinations of evenly spaced values: from, to and how many, by name."""
    _check_count(math.prod(number for *_, number in axes.values()))
    lines = [np.linspace(start, stop, number) for start, stop, number in axes.values()]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=-1)
    return Designs(tuple(axes), points)


def sample(axes: Mapping[str, tuple[float, float]], count: int, seed: int = 0) -> Designs:
    """A Latin hypercube: `count` random designs that cover every axis evenly."""
    _check_count(count)
    low, high = np.array(list(axes.values()), float).T
    cube = scipy.stats.qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed))
    points = cube.random(count)
    return Designs(tuple(axes), low + points * (high - low))


def _check_count(count: int) -> None:
    if count > _MOST_DESIGNS:
        raise UserError(f"{count} designs are too many; at most {_MOST_DESIGNS} are run at once")


def sweep(
    vessel: Vessel,
    plan: TrialPlan,
    designs: Designs,
    progress: Callable[[str], None] = lambda message: None,
) -> tuple[pd.DataFrame, float]:
    """Run a trial of every design.

    **Returns:** a table with one row per design (its parameters, the trial's numbers in SI
    units, `imo_<number>` verdicts and the `outcome`), and vessel-steps per second.

    Designs that take much longer than the vessel as it is run again, to the plan's limit.

    Raises:
        UserError: a name that is neither a parameter of the vessel nor of the trial.
    """
    places = _places(vessel, designs.names)
    values = np.asarray(designs.values, float)
    found, clock, left = None, _Clock(0, 0.0), np.ones(len(values), bool)
    for shorter in _shortened(vessel, plan):
        if found is not None:
            progress(f"{left.sum()} designs take longer; they run again")
        some, more = _run_all(vessel, shorter, places, values[left], progress)
        found = some if found is None else jax.tree.map(_put(left), found, some)
        clock = clock.joined(more)
        left = found.possible & np.isin(found.outcome, _UNFINISHED)
        if not left.any():
            break
    return _table(vessel, plan, designs, found), clock.rate


class _Found(NamedTuple):
    numbers: Numbers
    outcome: Int[Array, "design"]
    possible: Bool[Array, "design"]
    steps: Int[Array, "design"]


class _Clock(NamedTuple):
    steps: float
    seconds: float

    def joined(self, other: "_Clock") -> "_Clock":
        return _Clock(self.steps + other.steps, self.seconds + other.seconds)

    @property
    def rate(self) -> float:
        return self.steps / max(self.seconds, 1e-9)


def check_names(vessel: Vessel, names: Sequence[str]) -> None:
    """Raise `UserError` for a name that is neither a parameter of the vessel nor of the trial."""
    known = designed(vessel)
    for name in names:
        if name not in known and name not in OF_THE_TRIAL:
            every = (*OF_THE_TRIAL, *known)
            raise UserError(
                f"there is no parameter {name!r}{nearest(name, every)}; "
                f"choose among {', '.join(every)}"
            )
    if set(OF_THE_TRIAL) <= set(names):
        raise UserError("sweep the approach speed or the thrust, not both")
    if "thrust" in names and not ControlAllocation(vessel).propelled:
        raise UserError(f"{vessel.name!r} has no propulsion to command")


def _places(vessel: Vessel, names: Sequence[str]) -> Places:
    """Where each swept number stands in the vessel; nowhere for those of the trial."""
    check_names(vessel, names)
    known = designed(vessel)
    return tuple((name, known.get(name, ())) for name in names)


def _shortened(vessel: Vessel, plan: TrialPlan) -> list[TrialPlan]:
    """The plan with time limits of twice and of eight times what the vessel itself needs.

    A batch runs for as long as it may, whenever its lanes end; last comes the plan itself.
    """
    trial, _ = planning.run_and_measure(vessel, plan)
    run = trial.trajectory
    if int(run.outcome) != Outcome.COMPLETED:
        return [plan]
    before = float(trial.execute_time)
    after = float(np.max(np.asarray(run.t)[np.asarray(run.valid)])) - before
    plans = []
    for factor in (2.0, 8.0):
        seconds = planning.round_up(factor * after)
        if seconds > 0.7 * plan.settings.seconds:  # timed stages end by the clock
            seconds = plan.settings.seconds
        approach = planning.round_up(factor * before) if before > 0 else plan.approach_seconds
        shorter = dataclasses.replace(
            plan,
            settings=dataclasses.replace(plan.settings, seconds=seconds),
            approach_seconds=min(approach, plan.approach_seconds),
        )
        plans += [shorter] if shorter != plan else []
    return [*plans, plan]


def _run_all(
    vessel: Vessel,
    plan: TrialPlan,
    places: Places,
    values: Float[np.ndarray, "design name"],
    progress: Callable[[str], None],
) -> tuple[_Found, _Clock]:
    """Run all designs in blocks, one on every processor core at a time."""
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    lanes = min(_LANES, 1 << (len(values) - 1).bit_length())
    blocks = [values[k : k + lanes] for k in range(0, len(values), lanes)]
    steps = 0

    def run(block: np.ndarray) -> tuple[_Found, float]:
        padded = np.pad(block, ((0, lanes - len(block)), (0, 0)), mode="edge")
        began = time.perf_counter()
        found = jax.tree.map(np.asarray, _block(arrays, jnp.asarray(padded), (plan, places)))
        return jax.tree.map(lambda leaf: leaf[: len(block)], found), time.perf_counter() - began

    first, compiling = run(blocks[0])
    results, told, began = [first], time.perf_counter(), time.perf_counter()
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for found, _ in pool.map(run, blocks[1:]):
            results.append(found)
            steps += int(found.steps.sum())
            if time.perf_counter() - told > 2:
                told = time.perf_counter()
                done = min(len(values), len(results) * lanes)
                rate = steps / (told - began)
                progress(f"{done} of {len(values)} designs, {rate:.2g} vessel-steps/s")
    seconds = time.perf_counter() - began
    if len(blocks) == 1:  # nothing ran without being compiled first
        steps, seconds = int(first.steps.sum()), compiling
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *results)
    return whole, _Clock(steps, seconds)


@eqx.filter_jit
def _block(
    vessel: Vessel, values: Float[Array, "lane name"], trial: tuple[TrialPlan, Places]
) -> _Found:
    plan, places = trial

    def one(row: Float[Array, "name"]) -> _Found:
        chosen: dict[str, Scalar] = {name: row[k] for k, (name, _) in enumerate(places)}
        changed = replace(vessel, spread(dict(places), chosen))
        throttle = chosen.get("thrust")
        if throttle is not None:
            throttle = throttle_for_thrust(changed, throttle)
        done = planning.run_plan(changed, plan, chosen.get("speed"), throttle)
        run = done.trajectory
        return _Found(
            planning.trial_numbers(plan, done), run.outcome, _possible(changed), jnp.sum(run.valid)
        )

    return jax.vmap(one)(values)


def _possible(vessel: Vessel) -> Bool[Array, ""]:
    """Whether masses and dimensions are positive, as a vessel file's have to be."""
    body = vessel.rigid_body
    sizes = (body.mass, body.I_z, body.length, body.beam, body.draught, body.water_density)
    positive = jnp.all(jnp.stack([jnp.asarray(size, float) for size in sizes]) > 0)
    return positive & vessel.has_inertia()


def _put(rows: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function that puts new values into some rows."""

    def put(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        merged = old.copy()
        merged[rows] = new
        return merged

    return put


def _table(vessel: Vessel, plan: TrialPlan, designs: Designs, found: _Found) -> pd.DataFrame:
    """Parameters, numbers, verdicts and outcome of every design; nulls where it failed."""
    outcome = np.array(
        [planning.outcome_label(Outcome(int(o))) for o in found.outcome], dtype=object
    )
    outcome[~found.possible] = IMPOSSIBLE
    failed = np.isin(outcome, (IMPOSSIBLE, "diverged", "approach-unsteady"))
    numbers = {name: np.where(failed, np.nan, column) for name, column in found.numbers.items()}
    numbers = {name: column for name, column in numbers.items() if np.isfinite(column).any()}
    parameters = {name: designs.values[:, k] for k, name in enumerate(designs.names)}
    lengths = parameters.get("length", np.full(len(outcome), float(vessel.rigid_body.length)))
    verdicts = [
        _verdicts(plan, {name: float(column[k]) for name, column in numbers.items()}, lengths[k])
        for k in range(len(outcome))
    ]
    criteria = sorted({name for row in verdicts for name in row})
    return pd.DataFrame(
        {
            **parameters,
            **numbers,
            **{f"imo_{name}": [row.get(name) for row in verdicts] for name in criteria},
            "outcome": outcome,
        }
    )


def _verdicts(plan: TrialPlan, numbers: dict[str, float], length: float) -> dict[str, str]:
    found = {name: value for name, value in numbers.items() if math.isfinite(value)}
    return {name: v["verdict"] for name, v in planning.trial_verdicts(plan, found, length).items()}
