"""Many trials of one vessel side by side, each with its numbers and their derivatives.

One compiled program serves the exact derivatives, the finite differences and the global
analysis: a lane is a point, a direction and a trial.
"""

import concurrent.futures
import dataclasses
import math
import os
from collections.abc import Sequence
from typing import NamedTuple

from experiments.overshoot_sensitivity.factors import Factor, factors, scaled

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import Outcome, Vessel, read_vessel, run_trial
from diffsea.metrics import turning_metrics, zigzag_metrics
from diffsea.simulation.manoeuvres import Stages, zigzag
from diffsea.simulation.trials import TrialSettings


TRIALS = ("zigzag 10/10", "zigzag 20/20", "circle 35")
ZIGZAG_NUMBERS = ("overshoot_1", "overshoot_2", "peak_yaw_rate")
CIRCLE_NUMBERS = ("tactical_diameter",)
LANES = 64
EXECUTES = 3  # the second overshoot follows the third
APPROACH, LONGEST = 3.0, 30.0  # ship lengths at the approach speed
PAST_HALF = math.radians(200)  # the circle ends a little after the tactical diameter


@dataclasses.dataclass(frozen=True)
class Case:
    """A vessel of the catalogue, the speed at which it is tried (m/s), and the time step (s)."""

    name: str
    length: float  # m, for the time limits
    speed: float
    step: float
    circle: bool = True  # whether the turning circle is run too

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of the columns of results."""
        return ZIGZAG_NUMBERS + (CIRCLE_NUMBERS if self.circle else ())


class Found(NamedTuple):
    """Numbers of lanes in SI units, and their derivatives along the directions."""

    value: Float[np.ndarray, "lane number"]
    slope: Float[np.ndarray, "lane number"]
    completed: np.ndarray


class Bench:
    """One case with its factors and its compiled program."""

    def __init__(self, case: Case):
        self.case = case
        self.vessel = read_vessel(case.name).vessel
        self.factors = factors(self.vessel)
        self._arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), self.vessel)

    def run(
        self,
        points: Float[np.ndarray, "lane factor"],
        directions: Float[np.ndarray, "lane factor"] | None,
        trial: int,
    ) -> Found:
        """Run one of `TRIALS` at logarithms of factors; no directions mean no derivatives."""
        points = np.atleast_2d(points)
        directions = np.zeros_like(points) if directions is None else np.atleast_2d(directions)
        blocks = [
            (points[k : k + LANES], directions[k : k + LANES]) for k in range(0, len(points), LANES)
        ]
        first = self._block(*blocks[0], trial)  # compiles
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            others = list(pool.map(lambda block: self._block(*block, trial=trial), blocks[1:]))
        return Found(*(np.concatenate(part) for part in zip(first, *others, strict=True)))

    def _block(self, points: np.ndarray, directions: np.ndarray, trial: int) -> Found:
        spare = ((0, LANES - len(points)), (0, 0))
        found = _program(
            self._arrays,
            stages(trial),
            jnp.asarray(np.pad(points, spare)),
            jnp.asarray(np.pad(directions, spare)),
            (self.case, self.factors),
        )
        return Found(*(np.asarray(part)[: len(points)] for part in found))


def stages(trial: int) -> Stages:
    """The table of a trial. The circle has as many stages as the zig-zags, all alike."""
    if trial < 2:
        angle = math.radians((10.0, 20.0)[trial])
        return zigzag(angle, angle, EXECUTES)
    held = zigzag(math.radians(35.0), PAST_HALF, EXECUTES)
    levels = PAST_HALF * jnp.arange(1, EXECUTES + 1) / EXECUTES
    ones = jnp.ones(EXECUTES)
    return eqx.tree_at(
        lambda s: (s.angle, s.on_heading, s.level),
        held,
        (math.radians(35.0) * ones, ones, levels),
    )


@eqx.filter_jit
def _program(
    vessel: Vessel,
    table: Stages,
    points: Float[Array, "lane factor"],
    directions: Float[Array, "lane factor"],
    kind: tuple[Case, tuple[Factor, ...]],
) -> tuple:
    case, chosen = kind

    def one(x: Float[Array, "factor"]) -> tuple[Float[Array, "number"], Array]:
        return measured(case, scaled(vessel, chosen, x), table)

    def along(x: Array, direction: Array) -> tuple:
        value, slope, done = jax.jvp(one, (x,), (direction,), has_aux=True)
        return value, slope, done

    return jax.vmap(along)(points, directions)


def measured(case: Case, vessel: Vessel, table: Stages) -> tuple[Float[Array, "number"], Array]:
    """Numbers of one trial, `nan` for those of the other kind, and whether it was completed."""
    passing = case.length / case.speed  # s
    settings = TrialSettings(step=case.step, seconds=round(LONGEST * passing, 1))
    trial = run_trial(
        vessel, table, case.speed, settings=settings, approach_seconds=round(APPROACH * passing, 1)
    )
    run, done = trial.trajectory, trial.trajectory.outcome == Outcome.COMPLETED
    switches = jnp.concatenate([jnp.reshape(trial.execute_time, 1), trial.switch_times[:-1]])
    found = zigzag_metrics(run, switches)
    if case.circle:
        found = turning_metrics(run, trial.execute_time, 1.0) | found
    return jnp.stack([found[name] for name in case.numbers]), jnp.asarray(done)


def jacobian(bench: Bench, trial: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the vessel as it is, and d number / d ln factor, exact."""
    count = len(bench.factors)
    found = bench.run(np.zeros((count, count)), np.eye(count), trial)
    return found.value[0], found.slope


def labels(chosen: Sequence[Factor]) -> list[str]:
    """Names of factors."""
    return [factor.label for factor in chosen]
