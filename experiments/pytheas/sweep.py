# pyright: reportArgumentType=false
"""A map of 10^5 designs: which thrust for which mass reaches the waypoint, and when."""

import concurrent.futures
import os
import time
from typing import NamedTuple

from experiments.harness.reporting import table
from experiments.pytheas.approach import PERIOD, RANGE, Loop, start, step
from experiments.pytheas.boat import LEVER, boat, disturbed

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.simulation.control.waypoints import waypoint_logic
from diffsea.types import Scalar


LANES = 64  # designs side by side: more of them leave the processor's cache
SECONDS = 60.0


class Map(NamedTuple):
    """Axes of the sweep, and what was found at their crossings."""

    thrust: Float[np.ndarray, "thrust"]  # N
    mass: Float[np.ndarray, "mass"]  # kg
    closest: Float[np.ndarray, "thrust mass"]  # m, of the first attempt
    time: Float[np.ndarray, "thrust mass"]  # s, infinite where the waypoint is not reached
    rate: float  # vessel-steps per second, all cores, compiling left out


def grid(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Thrusts of 5 to 80 N and masses of 3 to 60 kg, in equal ratios."""
    return np.geomspace(5.0, 80.0, count), np.geomspace(3.0, 60.0, count)


def sweep(count: int, bias: float, direction: float, lever: float = LEVER) -> Map:
    """Run `count` x `count` designs in one disturbance, in blocks on every core."""
    thrust, mass = grid(count)
    # Neighbours end at similar times, and a block runs until its last lane ends.
    designs = np.stack([a.ravel() for a in np.meshgrid(thrust, mass, indexing="ij")], axis=-1)
    blocks = np.array_split(designs, -(-len(designs) // LANES))
    wide = [np.pad(b, ((0, LANES - len(b)), (0, 0)), mode="edge") for b in blocks]

    def run(block: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(np.asarray(part) for part in _block(block, bias, direction, lever))

    run(wide[0])  # compiles
    began = time.perf_counter()
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(run, wide))
    seconds = time.perf_counter() - began
    closest, reached, steps = (
        np.concatenate([part[: len(b)] for part, b in zip(parts, blocks, strict=True)])
        for parts in zip(*found, strict=True)
    )
    shape = (count, count)
    return Map(thrust, mass, closest.reshape(shape), reached.reshape(shape), steps.sum() / seconds)


@jax.jit
def _block(
    designs: Float[Array, "lane 2"], bias: Scalar, direction: Scalar, lever: Scalar
) -> tuple[Scalar, Scalar, Array]:
    """Closest approach (m), time (s) and steps run of a block of designs."""

    def prepared(design: Float[Array, "2"]) -> tuple:
        vessel = disturbed(boat(design[0], lever, design[1]), bias, direction)
        return vessel, waypoint_logic(vessel, [[RANGE, 0.0]], tolerance=0.0)

    vessels, logics = jax.vmap(prepared)(designs)
    loops = jax.vmap(start)(vessels, logics)
    last = round(SECONDS / PERIOD)

    def going(loops: Loop) -> Array:
        return jnp.isinf(loops.found.time) & (loops.found.missed == 0)

    def on(carry: tuple) -> Array:
        loops, number, _ = carry
        return (number < last) & jnp.any(going(loops))

    def body(carry: tuple) -> tuple:
        loops, number, steps = carry
        new = jax.vmap(step, in_axes=(0, 0, 0, None))(vessels, logics, loops, number)
        return new, number + 1, steps + going(loops)

    none = jnp.zeros(designs.shape[0])
    loops, _, steps = jax.lax.while_loop(on, body, (loops, jnp.zeros(()), none))
    return loops.found.closest, loops.found.time, steps


def record(maps: dict[str, Map], slower: np.ndarray) -> dict:
    """Size, speed and a coarse extract of the map."""
    first = next(iter(maps.values()))
    every = max(1, len(first.thrust) // 16)
    return {
        "designs": int(slower.size),
        "vessel_steps_per_second": {name: found.rate for name, found in maps.items()},
        "share_reached": {name: np.isfinite(found.time).mean() for name, found in maps.items()},
        "share_reached_in_both": float(np.isfinite(slower).mean()),
        "thrust": first.thrust[::every],
        "mass": first.mass[::every],
        "seconds_in_the_slower_direction": slower[::every, ::every],
    }


def summary(maps: dict[str, Map], slower: np.ndarray) -> str:
    """How many designs reach the waypoint, and how fast they were run."""
    rows = [
        (
            name,
            str(slower.size),
            f"{100 * np.isfinite(found.time).mean():.1f} %",
            f"{found.rate:.2g}",
        )
        for name, found in maps.items()
    ]
    rows.append(("both", str(slower.size), f"{100 * np.isfinite(slower).mean():.1f} %", ""))
    return table(("direction", "designs", "reach the waypoint", "vessel-steps per second"), rows)
