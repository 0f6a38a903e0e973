# pyright: reportArgumentType=false
"""Runs of ship and control system in changing weather, one or a batch of them."""

from typing import Any

from experiments.unberthing.harbour_plants import AbstractPlant, Air
from experiments.unberthing.harbour_route import place
from experiments.unberthing.harbour_ship import PERIOD, Weather
from experiments.unberthing.unberthing_system import ControlSystem

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea import State
from diffsea.types import Scalar


class Log(eqx.Module):
    """One run, a row per period."""

    t: Float[Array, "time"]
    state: State  # true, not as measured
    blades: Float[Array, "time 4"]
    step: Float[Array, "time"]
    cross: Float[Array, "time"]  # m, true cross-track error of the step
    Y_d: Float[Array, "time"]  # m to starboard of the target line
    speeds: Float[Array, "time 2"]  # v and r as filtered
    side_force: Float[Array, "time"]  # N to starboard that the thrusters' orders stand for
    model: Float[Array, "time 2 6"]  # the linear model used
    gain: Float[Array, "time 3 4"]
    trust: Float[Array, "time"]


def started(u: Scalar, x: Scalar = 0.0, y: Scalar = 0.0) -> State:
    """A ship heading north at `u` m/s."""
    return State(*(jnp.asarray(value, float) for value in (x, y, 0.0, u, 0.0, 0.0)))


def run(plant: AbstractPlant, control: ControlSystem, weather: Weather, start: State) -> Log:
    """One run; pure, for jit and vmap. Rows after the last step have `step` above it."""

    def body(carry: tuple, row: tuple) -> tuple[tuple, Log]:
        motion, memory = carry
        number, air = row
        t, true = number * PERIOD, plant.state(motion)
        memory, _ = control.step(memory, _measured(true, air.noise), t, PERIOD)
        flow = Air(air.current_north, air.current_east, air.wind_north, air.wind_east)
        after = plant.advance(motion, memory.blades, flow, t)
        at = place(memory.step, true)
        log = Log(
            t, true, memory.blades, memory.step, at.cross, at.Y_d, memory.speeds,
            plant.side_force(motion, memory.blades), memory.advice.model.rows, memory.gain,
            memory.advice.trust,
        )  # fmt: skip
        over = control.is_finished(memory)
        motion = jax.tree.map(lambda a, b: jnp.where(over, a, b), motion, after)
        return (motion, memory), log

    carry = plant.begin(start), control.init()
    numbers = jnp.arange(weather.current_north.shape[0], dtype=float)
    return jax.lax.scan(body, carry, (numbers, weather))[1]


@eqx.filter_jit
def run_all(plants: AbstractPlant, control: ControlSystem, weathers: Weather, starts: State) -> Log:
    """A batch of ships, each in its own weather, all under the same control."""
    some = eqx.if_array(0)
    return eqx.filter_vmap(run, in_axes=(some, None, some, some))(plants, control, weathers, starts)


def stacked(members: list) -> Any:
    """Ships or weathers as one batch."""
    return jax.tree.map(
        lambda *leaves: jnp.stack([jnp.asarray(x, float) for x in leaves]), *members
    )


def _measured(state: State, noise: Float[Array, "6"]) -> State:
    return State(*(value + noise[k] for k, value in enumerate(jax.tree.leaves(state))))
