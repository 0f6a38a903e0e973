"""Trials of a ship that is a Norrbin model exactly: so that its coefficients have true values.

An autopilot turns her to either side while wind of each trial's own and gusts push her about.
"""

from experiments.metamodels.metamodel import trials
from experiments.metamodels.ship import RAD, SENSORS, SPEED

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea import Trajectory
from diffsea.metamodels.norrbin import Norrbin


TRUE = Norrbin(-5e-5, 0.022, 0.2, 120.0, 2.0e-3)
STEP, SECONDS, RECORDED = 1.0, 320.0, 4.0
WIND = 6.0  # m/s, standard deviation of each component
WIND_ANGLE = 0.5 * RAD  # rudder that 10 m/s from 45 deg asks for
GUST, GUST_TIME = 0.3 * RAD, 25.0  # rudder that gusts ask for, and how long they last, s


class _Now(eqx.Module):
    psi: jax.Array
    r: jax.Array
    delta: jax.Array
    gust: jax.Array


def _wanted(t, side):
    """Heading by the programme: out, across, and back."""
    return side * RAD * jnp.where(t < 80, 20.0, jnp.where(t < 180, -15.0, 0.0))


@jax.jit
def _sailed(side, wind, noise):
    def wind_moment(psi):
        ahead = wind[0] * jnp.cos(psi) + wind[1] * jnp.sin(psi) - SPEED
        abeam = wind[1] * jnp.cos(psi) - wind[0] * jnp.sin(psi)
        return WIND_ANGLE * TRUE.b * 2 * ahead * abeam / 100.0

    def body(now: _Now, inputs):
        t, kick = inputs
        order = 0.7 * (_wanted(t, side) - now.psi) - 15.0 * now.r + TRUE.neutral
        order = jnp.clip(order, -8 * RAD, 8 * RAD)
        delta = now.delta + jnp.clip(order - now.delta, -2.5 * RAD * STEP, 2.5 * RAD * STEP)
        pushed = eqx.tree_at(
            lambda m: m.a0, TRUE, TRUE.a0 - wind_moment(now.psi) - TRUE.b * GUST * now.gust
        )
        r = pushed.step(now.r, now.delta, delta, STEP)
        keep = jnp.exp(-STEP / GUST_TIME)
        gust = keep * now.gust + jnp.sqrt(1 - keep**2) * kick
        return _Now(now.psi + 0.5 * STEP * (now.r + r), r, delta, gust), (now.psi, now.r, now.delta)

    zero = jnp.zeros(())
    times = STEP * jnp.arange(round(SECONDS / STEP))
    start = _Now(zero, zero, jnp.asarray(TRUE.neutral), noise[0])
    return jax.lax.scan(body, start, (times, noise))[1]


def sail(seed: int, count: int) -> list[Trajectory]:
    """`count` trials as recordings, in half of them to starboard first."""
    draw = np.random.default_rng(seed)
    steps = round(SECONDS / STEP)
    side = jnp.where(jnp.arange(count) % 2 == 0, 1.0, -1.0)
    wind = jnp.asarray(WIND * draw.standard_normal((count, 2)))
    noise = jnp.asarray(draw.standard_normal((count, steps)))
    psi, r, delta = (np.asarray(a) for a in jax.vmap(_sailed)(side, wind, noise))
    every = round(RECORDED / STEP)
    t = RECORDED * np.arange(steps // every)
    # The rudder moves evenly within a step: the mean until the next row, of its trapezoids.
    middle = 0.5 * (delta + np.concatenate([delta[:, 1:], delta[:, -1:]], axis=1))
    held = middle.reshape(count, -1, every).mean(2)
    psi, r, now = (a[:, ::every] for a in (psi, r, delta))
    psi = psi + SENSORS.heading * draw.standard_normal(psi.shape)
    r = r + SENSORS.yaw_rate * draw.standard_normal(r.shape)
    nothing = np.full(t.shape, np.nan)
    return [
        Trajectory(
            t, nothing, nothing, psi[k], nothing, nothing, r[k], {"rudder": held[k]}, {},
            {"angle": now[k]}, np.ones(t.shape, bool), name=f"known {k}",
        )
        for k in range(count)
    ]  # fmt: skip


def set_of(runs: list[Trajectory]):
    """Recordings for least squares, with the angle at each row."""
    return trials([r.extra["angle"] for r in runs], [r.r for r in runs], RECORDED)
