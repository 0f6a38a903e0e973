"""The scheme that most simulators use: the rudder is flipped at the first sample past the heading.

Its value tends to the right one with the step. Its derivative does not: how much later the
heading is reached does not enter, since the flip stays at its sample until it jumps to the next.
"""

import math

from experiments.overshoot_sensitivity.factors import Factor, scaled
from experiments.overshoot_sensitivity.trial_lanes import LANES, Bench

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import Environment, State, Vessel
from diffsea.simulation.control import ControlAllocation, throttle_for
from diffsea.simulation.integrate import advance, begin, history_lengths
from diffsea.types import Scalar


def first_overshoot(
    vessel: Vessel, speed: float, angle: float, step: float, seconds: float
) -> Scalar:
    """First overshoot (rad) of an `angle`/`angle` zig-zag (rad) from samples every `step` s."""
    zero, allocation = jnp.zeros(()), ControlAllocation(vessel)
    throttle = throttle_for(vessel, speed)
    lengths = history_lengths(vessel, step)
    start = State(zero, zero, zero, jnp.asarray(speed, float), zero, zero)
    motion = begin(vessel, start, allocation.orders(throttle, zero), lengths)

    def body(carry: tuple, k: Array) -> tuple:
        motion, flips = carry
        side = 1.0 - 2.0 * (flips % 2)
        orders = allocation.orders(throttle, side * angle)
        motion = advance(vessel, motion, orders, Environment(), k * step, step)
        past = side * motion.state.psi >= angle
        return (motion, flips + past), (motion.state.psi, flips + past)

    count = math.ceil(seconds / step)
    _, (psi, flips) = jax.lax.scan(body, (motion, 0), jnp.arange(count))
    return jnp.max(jnp.where(flips == 1, psi, -jnp.inf)) - angle


@eqx.filter_jit
def _program(
    vessel: Vessel, points: Array, directions: Array, kind: tuple[tuple[Factor, ...], tuple]
) -> tuple:
    chosen, settings = kind

    def one(x: Array) -> Scalar:
        return first_overshoot(scaled(vessel, chosen, x), *settings)

    return jax.vmap(lambda x, d: jax.jvp(one, (x,), (d,)))(points, directions)


def sampled(
    bench: Bench,
    angle: float,
    step: float,
    points: Float[np.ndarray, "lane factor"],
    directions: Float[np.ndarray, "lane factor"] | None = None,
) -> tuple[Float[np.ndarray, "lane"], Float[np.ndarray, "lane"]]:
    """First overshoot (rad) of each lane and its derivative, as the naive scheme has them."""
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), bench.vessel)
    passing = float(bench.vessel.rigid_body.length) / bench.case.speed  # s
    directions = np.zeros_like(points) if directions is None else directions
    kind = (bench.factors, (bench.case.speed, angle, step, 15.0 * passing))
    parts = []
    for k in range(0, len(points), LANES):  # all of one size, so that one program serves them
        block = (points[k : k + LANES], directions[k : k + LANES])
        spare = ((0, LANES - len(block[0])), (0, 0))
        padded = [jnp.asarray(np.pad(part, spare)) for part in block]
        found = _program(vessel, padded[0], padded[1], kind)
        parts.append([np.asarray(part)[: len(block[0])] for part in found])
    value, slope = (np.concatenate(part) for part in zip(*parts, strict=True))
    return value, slope


def signs_that_differ(
    wrong: Float[np.ndarray, "factor"], exact: Float[np.ndarray, "factor"], least: float = 0.01
) -> np.ndarray:
    """Indices of derivatives of the wrong sign, but for those that matter nowhere.

    `least` is the smallest size that counts, relative to the largest exact derivative.
    """
    small = least * np.max(np.abs(exact))
    return np.flatnonzero((np.sign(wrong) != np.sign(exact)) & (np.abs(exact) > small))
