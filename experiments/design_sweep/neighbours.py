"""Derivatives of a design's numbers, and how far they predict its neighbours."""

import math
from typing import NamedTuple

from experiments.design_sweep.loading import KINDS, THRUST, loaded, plan, saturation
from experiments.design_sweep.sweeping import Swept

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea import TrialPlan, Vessel, replace, run_trial
from diffsea.metrics import turning_metrics, zigzag_metrics
from diffsea.parameters import file_parameters, spread_over_places
from diffsea.simulation import manoeuvres
from diffsea.simulation.control import speed_for, throttle_for_thrust
from diffsea.simulation.manoeuvres import Stages


QUANTITIES = ("tactical diameter", "advance", "overshoot 20/20", "approach speed")  # L, L, deg, m/s
CIRCLE, ZIGZAG = KINDS[0], KINDS[2]
LANES = 32
_PAST_HALF = math.radians(200)  # the circle may end a little after the tactical diameter


def both_trials() -> Stages:
    """The tables of the 35 deg circle and of the 20/20 zig-zag, one above the other.

    The circle has as many stages as the zig-zag, all alike, so that one program runs both.
    """
    count = 3
    ahead, angle = jnp.ones(count), jnp.full(count, math.radians(CIRCLE.angle))
    levels = _PAST_HALF * jnp.arange(1, count + 1) / count
    circle = Stages(angle, ahead, ahead, 0 * ahead, 0 * ahead, levels, by_speed=False)
    zigzag = manoeuvres.zigzag(math.radians(ZIGZAG.angle), math.radians(ZIGZAG.heading), count)
    return jax.tree.map(lambda a, b: jnp.stack([a, b]), circle, zigzag)


Places = tuple[tuple[str, tuple[str, ...]], ...]


def quantities(
    vessel: Vessel, trial: TrialPlan, places: Places, x: Float[Array, "2"]
) -> Float[Array, "quantity"]:
    """`QUANTITIES` of the design x = (ln thrust, ln mass); `trial` has times and step.

    `places` of the vessel's numbers as `designed` has them: the cross-flow drag keeps a
    draught of its own.
    """
    thrust, mass = jnp.exp(x[0]), jnp.exp(x[1])
    design = replace(vessel, spread_over_places(dict(places), loaded(vessel, mass)))
    throttle = throttle_for_thrust(design, thrust)

    def one(stages: Stages) -> tuple:
        run = run_trial(
            design, stages, None, throttle, trial.settings, approach_seconds=trial.approach_seconds
        )
        circle = turning_metrics(run.trajectory, run.execute_time, 1.0)
        switches = jnp.concatenate([jnp.reshape(run.execute_time, 1), run.switch_times[:-1]])
        zigzag = zigzag_metrics(run.trajectory, switches)
        return circle["tactical_diameter"], circle["advance"], zigzag["overshoot_1"]

    (diameter, _), (advance, _), (_, overshoot) = jax.vmap(one)(both_trials())
    length = vessel.rigid_body.length
    speed = speed_for(design, throttle)
    return jnp.stack([diameter / length, advance / length, jnp.degrees(overshoot), speed])


@eqx.filter_jit
def _with_slopes(
    vessel: Vessel, x: Float[Array, "lane 2"], kind: tuple[TrialPlan, Places]
) -> tuple:
    def one(at: Float[Array, "2"]) -> tuple:
        def along(direction: Float[Array, "2"]) -> tuple:
            return jax.jvp(lambda z: quantities(vessel, *kind, z), (at,), (direction,))

        value, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(2))
        return value, slopes.T

    return jax.vmap(one)(x)


def with_slopes(
    vessel: Vessel, x: Float[np.ndarray, "design 2"]
) -> tuple[Float[np.ndarray, "design quantity"], Float[np.ndarray, "design quantity 2"]]:
    """Quantities of designs, and their exact derivatives by ln thrust and ln mass."""
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    kind = plan(vessel, ZIGZAG), tuple(file_parameters(vessel).items())
    values, slopes = [], []
    for k in range(0, len(x), LANES):
        block = x[k : k + LANES]
        padded = np.pad(block, ((0, LANES - len(block)), (0, 0)), mode="edge")
        value, slope = _with_slopes(arrays, jnp.asarray(padded), kind)
        values.append(np.asarray(value)[: len(block)])
        slopes.append(np.asarray(slope)[: len(block)])
    return np.concatenate(values), np.concatenate(slopes)


class Predictions(NamedTuple):
    """First-order predictions of neighbours on the grid beside the sweep's own numbers."""

    step: Float[np.ndarray, "pair"]  # largest relative change of thrust and mass
    error: Float[np.ndarray, "pair quantity"]  # relative
    crosses: Bool[np.ndarray, "pair quantity"]  # a saturation of the thrusters lies between


def bases(found: Swept, each: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices (of masses, of thrusts) of designs spread over the map."""
    rows = np.linspace(0, found.mass.size - 1, each).round().astype(int)
    columns = np.linspace(0, found.thrust.size - 1, each).round().astype(int)
    pairs = np.meshgrid(rows, columns, indexing="ij")
    return pairs[0].ravel(), pairs[1].ravel()


def truth(found: Swept, vessel: Vessel) -> Float[np.ndarray, "mass thrust quantity"]:
    """The sweep's own `QUANTITIES`, as maps."""
    length = float(vessel.rigid_body.length)
    return np.stack(
        [
            found.column(CIRCLE, "tactical_diameter") / length,
            found.column(CIRCLE, "advance") / length,
            np.degrees(found.column(ZIGZAG, "overshoot_1")),
            found.column(CIRCLE, "approach_speed"),
        ],
        axis=-1,
    )


def predictions(
    found: Swept,
    vessel: Vessel,
    at: tuple[np.ndarray, np.ndarray],
    value: Float[np.ndarray, "base quantity"],
    slope: Float[np.ndarray, "base quantity 2"],
    offsets: list[tuple[int, int]],
) -> Predictions:
    """Predict the designs at index offsets (mass, thrust) from each base."""
    rows, columns = at
    maps, steps, errors, crosses = truth(found, vessel), [], [], []
    kinks = kinks_by_quantity(vessel)
    for down, along in offsets:
        i, j = rows + down, columns + along
        inside = (i >= 0) & (i < found.mass.size) & (j >= 0) & (j < found.thrust.size)
        i, j = i[inside], j[inside]
        here, there = found.thrust[columns[inside]], found.thrust[j]
        change = np.stack(
            [np.log(there / here), np.log(found.mass[i] / found.mass[rows[inside]])], axis=-1
        )
        guess = value[inside] + np.einsum("bqk,bk->bq", slope[inside], change)
        errors.append(guess / maps[i, j] - 1)
        steps.append(np.abs(change).max(axis=-1))
        low, high = np.minimum(here, there)[:, None], np.maximum(here, there)[:, None]
        crosses.append((low <= kinks) & (kinks <= high))
    return Predictions(np.concatenate(steps), np.concatenate(errors), np.concatenate(crosses))


def kinks_by_quantity(vessel: Vessel) -> Float[np.ndarray, "quantity"]:
    """Thrust (N) beyond which the trial of each quantity runs a thruster at its limit."""
    circle, zigzag = saturation(vessel, CIRCLE.angle), saturation(vessel, ZIGZAG.angle)
    return np.array([circle, circle, zigzag, 10 * THRUST[1]])


def power(step: np.ndarray, error: np.ndarray) -> float:
    """Power of the step with which errors grow: slope of their logarithms."""
    used = (error > 1e-9) & (step > 1e-3)
    return float(np.polyfit(np.log(step[used]), np.log(error[used]), 1)[0])


def quantities_ahead(
    found: Swept,
    vessel: Vessel,
    x: Float[np.ndarray, "base 2"],
    value: Float[np.ndarray, "base quantity"],
    slope: Float[np.ndarray, "base quantity 2"],
    factor: float,
) -> Float[np.ndarray, "base quantity"]:
    """Relative errors of predictions for more thrust; nan where that leaves the map.

    The truth is interpolated between grid points a third of a newton apart or so.
    """
    maps, thrust = truth(found, vessel), np.exp(x[:, 0]) * factor
    errors = np.full(value.shape, np.nan)
    for b in np.flatnonzero(thrust <= found.thrust[-1]):
        row = int(np.argmin(np.abs(found.mass - np.exp(x[b, 1]))))
        for q in range(value.shape[1]):
            true = np.interp(thrust[b], found.thrust, maps[row, :, q])
            errors[b, q] = (value[b, q] + slope[b, q, 0] * np.log(factor)) / true - 1
    return errors
