"""The boats of the benchmarks in the library: numbers of one boat to its zig-zag, ready for JAX."""

import concurrent.futures
import os
from collections.abc import Callable

from benchmarks import boats

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.parameters import file_parameters, replace, spread_over_places
from diffsea.simulation.control import ControlAllocation
from diffsea.simulation.integrate import SimulationState, advance, begin, history_lengths
from diffsea.simulation.manoeuvres import zigzag
from diffsea.simulation.switching import Carry, run_stages
from diffsea.types import Scalar, State, as_inputs
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import build


Row = Float[Array, "13"]  # as `boats.PARAMETERS`
# Last x, y, psi, u, v and r; s, of switches, NaN for none.
End = tuple[Float[Array, "6"], Float[Array, "execute"]]
LANES = 64
SIDES = ("port", "starboard")


def _begins() -> Callable[[Row], tuple[Vessel, SimulationState, Scalar]]:
    """What gives one boat straight ahead at its steady speed, and its throttle (N of both)."""
    vessel = build(boats.document())
    places, arrays = file_parameters(vessel), as_inputs(vessel)
    lengths = history_lengths(vessel, boats.STEP)

    def begun(row: Row) -> tuple[Vessel, SimulationState, Scalar]:
        named = dict(zip(boats.PARAMETERS, row, strict=True))
        thrust, lag, speed = (named.pop(name) for name in ("thrust", "time_constant", "speed"))
        changed = spread_over_places(places, named | {f"{s}.time_constant": lag for s in SIDES})
        boat, zero = replace(arrays, changed), jnp.zeros_like(speed)
        still = State(zero, zero, zero, speed, zero, zero)
        motion = begin(boat, still, dict.fromkeys(SIDES, thrust), lengths)
        return boat, motion, len(SIDES) * thrust

    return begun


def zigzags() -> Callable[[Row], Carry]:
    """What runs one boat's zig-zag of a minute, switches located inside their steps."""
    begun = _begins()

    def run(row: Row) -> Carry:
        boat, motion, throttle = begun(row)
        stages = zigzag(boats.ANGLE, boats.CHECK, boats.EXECUTES)
        carry, _ = run_stages(
            boat, stages, motion, throttle, boat.environment, 0.0, boats.STEP, boats.SECONDS
        )
        return carry

    return run


def zigzag_ends() -> Callable[[Row], End]:
    """The same, of which only the last state and the switches are kept."""
    run = zigzags()

    def end(row: Row) -> End:
        carry = run(row)
        return _numbers(carry.motion.state), carry.switch_times

    return end


def sampled_zigzag_ends() -> Callable[[Row], End]:
    """The same by the library's step alone, each switch at the first sample beyond its heading."""
    begun = _begins()

    def end(row: Row) -> End:
        boat, motion, throttle = begun(row)
        allocation = ControlAllocation(boat)

        def step(carry: tuple, t: Scalar) -> tuple[tuple, None]:
            motion, side, count, times = carry
            orders = allocation.orders(throttle, side * boats.ANGLE)
            motion = advance(boat, motion, orders, boat.environment, t, boats.STEP)
            passed = side * motion.state.psi >= boats.CHECK
            here = passed & (jnp.arange(boats.EXECUTES) == count)
            times = jnp.where(here, t + boats.STEP, times)
            return (motion, jnp.where(passed, -side, side), count + passed, times), None

        none = jnp.full(boats.EXECUTES, jnp.nan)
        carry = (motion, jnp.ones_like(throttle), jnp.zeros((), int), none)
        (motion, _, _, times), _ = jax.lax.scan(step, carry, boats.STEP * jnp.arange(boats.STEPS))
        return _numbers(motion.state), times

    return end


def _numbers(state: State) -> Float[Array, "6"]:
    return jnp.stack([state.x, state.y, state.psi, state.u, state.v, state.r])


def in_blocks(end: Callable[[Row], End], rows: boats.Rows) -> Callable[[], boats.Ends]:
    """What runs many boats, in blocks of lanes by a thread for every core."""
    program = jax.jit(jax.vmap(end))
    blocks = jnp.split(jnp.asarray(rows.T), rows.shape[1] // LANES)

    def run() -> boats.Ends:
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            found = pool.map(lambda block: jax.block_until_ready(program(block)), blocks)
            last, times = zip(*found, strict=True)
        return np.concatenate(last).T, np.concatenate(times)

    return run
