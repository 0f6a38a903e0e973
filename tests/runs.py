# pyright: reportArgumentType=false
"""Runs of the library from a chosen state, and vessel documents, for tests that compare them.

The approach is left out: the run starts at the execute, in a state that another simulator
can be started in too.
"""

import copy
import math

import jax
import jax.numpy as jnp
import numpy as np
from tests.oracle import sensors
from tests.oracle.simulator import simulate

from diffsea import Environment, State, Trajectory
from diffsea.simulation.control import ControlAllocation
from diffsea.simulation.integrate import SimulationState, advance, begin, history_lengths
from diffsea.simulation.manoeuvres import Stages
from diffsea.simulation.switching import run_stages
from diffsea.trajectory import MOTION_CHANNELS


CALM = Environment()


def random_steps(
    document, seed: int, seconds: float, step: float, effects=None, gust=None, noise: float = 1.0
) -> Trajectory:
    """A run of the oracle with random thrusts to both sides, as its sensors show it.

    `noise` multiplies theirs.
    """
    rng = np.random.default_rng(seed)
    thrust = lambda: dict(zip(("port", "starboard"), rng.uniform(30, 210, 2), strict=True))
    orders = [(t, thrust()) for t in np.arange(0, seconds, 4.0)]
    return ordered_run(document, orders, seconds, step, rng, effects, gust, noise)


def ordered_run(
    document, orders, seconds: float, step: float, rng, effects=None, gust=None, noise: float = 1.0
) -> Trajectory:
    """A run of the oracle with thrusts to both sides from some times on, as its sensors show it."""
    sim = simulate(document, orders, seconds, effects, gust=gust)
    t = np.arange(0.0, seconds, step)
    rec = sensors.record(sim, t, sensors.suite(noise), rng, wrapped=False)
    motion = {c: np.asarray(rec[c], float) for c in ("x", "y", "psi", "u", "v", "r")}
    commanded = {c: np.asarray(rec[f"cmd_{c}"], float) for c in ("port", "starboard")}
    return Trajectory(
        t, **motion, commanded=commanded, executed={}, extra={}, valid=np.ones(len(t), bool)
    )


def varied(document, hull=None, servo=None, effects=()):
    """A copy of a vessel's document; a hull key that is None is taken out.

    `servo` replaces every stage of the thrusters' response.
    """
    new = copy.deepcopy(document)
    new["hull"] = {k: x for k, x in (new["hull"] | (hull or {})).items() if x is not None}
    for thruster in new.get("thruster", []) if servo is not None else []:
        for stage in ("time_constant", "rate_limit", "delay", "deadband"):
            thruster.pop(stage, None)
        thruster.update(servo)
    new["effect"] = [*new.get("effect", []), *effects]
    return new


def state_of(x=0.0, y=0.0, psi=0.0, u=0.0, v=0.0, r=0.0):
    """A state of arrays."""
    return State(*(jnp.asarray(value, float) for value in (x, y, psi, u, v, r)))


def settled(vessel, state, throttle, step, longest=None):
    """A motion whose actuators have settled to a throttle, straight ahead."""
    lengths = history_lengths(vessel, step, longest=longest)
    return begin(vessel, state, ControlAllocation(vessel).orders(throttle, 0.0), lengths)


def executed(vessel, stages, state, throttle, environment, step, seconds, longest=None):
    """Carry and rows of a manoeuvre executed at time zero in a state.

    The first row is the state itself.
    """
    motion = settled(vessel, state, throttle, step, longest)
    carry, rows = run_stages(vessel, stages, motion, throttle, environment, 0.0, step, seconds)
    before = jax.tree.map(lambda column: jnp.zeros_like(column[:1]), rows)
    before = before.__class__(
        before.t,
        jax.tree.map(lambda value: jnp.asarray(value)[None], state),
        before.commanded,
        before.executed,
        before.stage,
        jnp.ones_like(before.accepted),
    )
    return carry, jax.tree.map(lambda *parts: jnp.concatenate(parts), before, rows)


def staged(*rows):
    """Stages of (angle rad, side of the heading that ends it or 0, heading rad or time s)."""
    angle, side, level = (jnp.array(column, float) for column in zip(*rows, strict=True))
    nothing = jnp.zeros(len(rows))
    timed = jnp.asarray(side == 0, float)
    return Stages(angle, nothing + 1, side, timed, nothing, level, False)


def staged_turn(angle):
    """A turn in three stages, so that the program of a zig-zag of three executes runs it."""
    side = math.copysign(1, angle)
    return staged(*((angle, side, math.radians(change)) for change in (90, 180, 540)))


run = jax.jit(executed, static_argnums=(5, 6, 7))


def trajectory(rows):
    """The rows as a trajectory, for the metrics."""
    motion = {channel: getattr(rows.state, channel) for channel in MOTION_CHANNELS}
    return Trajectory(rows.t, **motion, commanded={}, executed={}, extra={}, valid=rows.accepted)


def columns(rows, until=np.inf):
    """Times and motion of the accepted rows up to a time, as arrays."""
    kept = np.asarray(rows.accepted) & (np.asarray(rows.t) <= until)
    table = {c: np.asarray(getattr(rows.state, c))[kept] for c in MOTION_CHANNELS}
    return np.asarray(rows.t)[kept], table


def disagreement(found, truth):
    """Largest difference over the run and the channels, relative to each channel's range."""
    return max(
        np.max(np.abs(found[c] - truth[c])) / max(np.ptp(truth[c]), 1e-12) for c in MOTION_CHANNELS
    )


def replay(vessel, motion: SimulationState, orders, environment, step):
    """States after each step under given orders: arrays by channel, one order per step."""

    def body(carry, held):
        motion, t = carry
        motion = advance(vessel, motion, held, environment, t, step)
        return (motion, t + step), motion.state

    _, states = jax.lax.scan(body, (motion, jnp.zeros(())), orders)
    return states
