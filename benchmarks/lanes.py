"""The boats of the benchmarks in the library: numbers of one boat to its zig-zag, ready for JAX."""

from collections.abc import Callable

from benchmarks import boats

import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.parameters import file_parameters, replace, spread_over_places
from diffsea.simulation.integrate import begin, history_lengths
from diffsea.simulation.manoeuvres import zigzag
from diffsea.simulation.switching import Carry, run_stages
from diffsea.types import State, as_inputs
from diffsea.vessel.files import build


Row = Float[Array, "13"]  # as `boats.PARAMETERS`


def zigzags() -> Callable[[Row], Carry]:
    """What runs one boat's zig-zag of a minute, from straight ahead at its steady speed."""
    vessel = build(boats.document())
    places, arrays = file_parameters(vessel), as_inputs(vessel)
    lengths = history_lengths(vessel, boats.STEP)
    sides = ("port", "starboard")

    def run(row: Row) -> Carry:
        named = dict(zip(boats.PARAMETERS, row, strict=True))
        thrust, lag, speed = (named.pop(name) for name in ("thrust", "time_constant", "speed"))
        changed = spread_over_places(places, named | {f"{s}.time_constant": lag for s in sides})
        boat, zero = replace(arrays, changed), jnp.zeros_like(speed)
        still = State(zero, zero, zero, speed, zero, zero)
        motion = begin(boat, still, dict.fromkeys(sides, thrust), lengths)
        stages = zigzag(boats.ANGLE, boats.CHECK, boats.EXECUTES)
        throttle = len(sides) * thrust  # of both together
        carry, _ = run_stages(
            boat, stages, motion, throttle, boat.environment, 0.0, boats.STEP, boats.SECONDS
        )
        return carry

    return run
