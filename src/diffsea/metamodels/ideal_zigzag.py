"""The ideal zig-zag of a metamodel: the trial as it should have been run."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from diffsea.metamodels.norrbin import Norrbin
from diffsea.trajectory import Series
from diffsea.types import Scalar


@dataclasses.dataclass(frozen=True)
class Zigzag:
    """The ideal zig-zag that a metamodel is asked for. Angles in rad.

    From straight running, at exactly the ordered angles, switched at exactly the heading.
    """

    angle: float = math.radians(10.0)
    heading: float = math.radians(10.0)
    side: float = 1.0  # first execute to starboard; -1 to port
    rate_limit: float = math.radians(5.0)  # rad/s, of the rudder
    seconds: float = 600.0
    step: float = 0.25  # s; the rudder's ramp is straight within each
    executes: int = 3


class IdealRun(eqx.Module):
    """An ideal zig-zag, a row per step. A run that is over goes on under its last order."""

    t: Series  # s from the first execute
    psi: Series  # rad
    r: Series  # rad/s
    delta: Series  # rad, executed
    overshoots: Float[Array, "overshoot"]  # rad, NaN where there was none
    switch_times: Float[Array, "overshoot"]  # s, of the second execute and on; NaN likewise


class _ZigzagState(eqx.Module):
    psi: Scalar
    r: Scalar
    delta: Scalar
    stage: Int[Array, ""]
    switch_times: Float[Array, "overshoot"]
    overshoots: Float[Array, "overshoot"]


def ideal_zigzag(model: Norrbin, wanted: Zigzag) -> IdealRun:
    """Run the ideal zig-zag. Pure: jit it, `vmap` it over models, differentiate it.

    Switches are located inside their steps, on the cubic through headings and yaw rates at both
    ends, and the step is done in two parts; peaks of heading are read off likewise.
    """
    zero, neutral = jnp.zeros(()), jnp.asarray(model.neutral, float)
    nothing = jnp.full(wanted.executes - 1, jnp.nan)
    start = _ZigzagState(zero, zero, neutral, jnp.zeros((), int), nothing, nothing)
    times = wanted.step * jnp.arange(math.ceil(wanted.seconds / wanted.step), dtype=float)
    last, rows = jax.lax.scan(lambda now, t: (_step(model, wanted, now, t), now), start, times)
    return IdealRun(times, rows.psi, rows.r, rows.delta, last.overshoots, last.switch_times)


def overshoots(model: Norrbin, wanted: Zigzag) -> Float[Array, "overshoot"]:
    """Overshoot angles (rad) of the ideal zig-zag; NaN for one that does not happen in time."""
    return ideal_zigzag(model, wanted).overshoots


def overshoots_with_std(
    model: Norrbin, covariance: Float[Array, "5 5"], wanted: Zigzag
) -> tuple[Float[Array, "overshoot"], Float[Array, "overshoot"]]:
    """Overshoots (rad) and their standard errors, from the coefficients' covariance."""
    theta = model.coefficients
    J = jax.jacfwd(lambda at: overshoots(Norrbin.of(at), wanted))(theta)
    return overshoots(model, wanted), jnp.sqrt(jnp.einsum("ij,jk,ik->i", J, covariance, J))


def _side(wanted: Zigzag, stage: Int[Array, ""]) -> Scalar:
    """Side of the order of a stage: 1 to starboard, -1 to port."""
    return wanted.side * (1 - 2 * (stage % 2)).astype(float)


def _advance(
    model: Norrbin, wanted: Zigzag, now: _ZigzagState, stage: Int[Array, ""], dt: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Heading, yaw rate and rudder `dt` s later under the order of a stage."""
    order = _side(wanted, jnp.minimum(stage, wanted.executes - 1)) * wanted.angle
    largest = wanted.rate_limit * dt
    delta = now.delta + jnp.clip(order - now.delta, -largest, largest)
    r = model.step(now.r, now.delta, delta, dt)
    # Simpson's rule with the slopes at both ends: of fourth order.
    curve = model.response(now.r, now.delta) - model.response(r, delta)
    return now.psi + 0.5 * dt * (now.r + r) + dt**2 / 12 * curve, r, delta


def _step(model: Norrbin, wanted: Zigzag, now: _ZigzagState, t: Scalar) -> _ZigzagState:
    """One step, in two parts where the heading reaches the one that switches the order."""
    dt, number = wanted.step, jnp.arange(wanted.executes - 1)
    psi, r, delta = _advance(model, wanted, now, now.stage, dt)
    sense = _side(wanted, now.stage)
    more = now.stage < wanted.executes - 1
    switches = more & (sense * psi >= wanted.heading) & (sense * now.psi < wanted.heading)
    # Where in the step: Newton's method on the cubic; the first part is empty without a switch.
    level = sense * wanted.heading
    s = (level - now.psi) / jnp.where(psi == now.psi, 1.0, psi - now.psi)
    for _ in range(6):
        value, slope = _hermite(now.psi, now.r * dt, psi, r * dt, s)
        s = jnp.clip(s - (value - level) / jnp.where(slope == 0, 1.0, slope), 0.0, 1.0)
    s = jnp.where(switches, s, 0.0)
    psi_s, r_s, delta_s = _advance(model, wanted, now, now.stage, s * dt)
    middle = _ZigzagState(psi_s, r_s, delta_s, now.stage, now.switch_times, now.overshoots)
    stage = now.stage + switches.astype(now.stage.dtype)
    psi, r, delta = _advance(model, wanted, middle, stage, (1 - s) * dt)
    times = jnp.where(switches & (number == now.stage), t + s * dt, now.switch_times)
    # The overshoot of the present order, where the heading turns back.
    dt, sense = (1 - s) * dt, _side(wanted, stage - 1)
    turns = (sense * r_s > 0) & (sense * r <= 0) & (number == stage - 1) & jnp.isnan(now.overshoots)
    s = jnp.clip(r_s / jnp.where(r_s == r, 1.0, r_s - r), 0.0, 1.0)
    peak, _ = _hermite(psi_s, r_s * dt, psi, r * dt, s)
    peaks = jnp.where(turns, sense * peak - wanted.heading, now.overshoots)
    return _ZigzagState(psi, r, delta, stage, times, peaks)


def _hermite(p0: Scalar, m0: Scalar, p1: Scalar, m1: Scalar, s: Scalar) -> tuple[Scalar, Scalar]:
    """Value and slope of the cubic with given ends and slopes there, at s from 0 to 1."""
    a, b = 2 * (p0 - p1) + m0 + m1, 3 * (p1 - p0) - 2 * m0 - m1
    return p0 + s * (m0 + s * (b + s * a)), m0 + s * (2 * b + 3 * s * a)
