"""What every stage does with the metamodel: identify, ask for the ideal trial, compare series."""

import dataclasses

from experiments.metamodels.ship import RUDDER_RATE

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.metamodels.fit import NorrbinFit, Trials, identify
from diffsea.metamodels.ideal_zigzag import Zigzag, ideal_zigzag, overshoots
from diffsea.metamodels.norrbin import Norrbin, in_degrees
from diffsea.metrics.repeats import fit_percent


SIDES = (1.0, -1.0)
STARBOARD = Zigzag(rate_limit=RUDDER_RATE, side=1.0)
PORT = Zigzag(rate_limit=RUDDER_RATE, side=-1.0)

identified = jax.jit(identify)


@jax.jit
def ideal_overshoots(model: Norrbin):
    """First and second overshoot (rad) of the ideal 10/10, (side, overshoot)."""
    return jnp.stack([overshoots(model, STARBOARD), overshoots(model, PORT)])


@jax.jit
def ideal_series(model: Norrbin):
    """The ideal 10/10 to port first."""
    return ideal_zigzag(model, PORT)


@jax.jit
def overshoots_at(model: Norrbin, heading):
    """Overshoots (rad) of the ideal zig-zag to port first, reversed at a heading (rad)."""
    return overshoots(model, dataclasses.replace(PORT, heading=heading))


@jax.jit
def simulated(model: Norrbin, first, delta, dt):
    """Yaw rates (rad/s) under recorded rudder angles."""
    return model.simulate(first, delta, dt)


def same_length(series, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Series of different lengths in one table, and which of its entries are known."""
    table = np.zeros((len(series), length))
    known = np.zeros(table.shape, bool)
    for row, values in enumerate(series):
        count = min(len(values), length)
        table[row, :count], table[row, count:] = values[:count], values[count - 1]
        known[row, :count] = True
    return table, known


def trials(delta, r, dt: float, length: int | None = None) -> Trials:
    """Trials from lists of rudder angles (rad) and yaw rates (rad/s) every `dt` s."""
    length = max(map(len, r)) if length is None else length
    table, known = same_length(r, length)
    angles, _ = same_length(delta, length)
    return Trials(jnp.asarray(dt), jnp.asarray(angles), jnp.asarray(table), jnp.asarray(known))


@jax.jit
def cross_validated(model: Norrbin, aside: Trials):
    """Fits (per cent) to trials put aside, only their first yaw rates adapted, and the series."""

    def one(delta, r, known):
        low = model.simulate(r[0], delta, aside.dt)
        slope = jax.jvp(lambda at: model.simulate(at, delta, aside.dt), (r[0],), (1.0,))[1]
        slope = jnp.where(known, slope, 0.0)
        first = r[0] + jnp.sum(slope * (r - low)) / jnp.sum(slope**2)
        predicted = model.simulate(first, delta, aside.dt)
        return fit_percent(r, predicted, known), predicted

    return jax.vmap(one)(aside.delta, aside.r, aside.known)


def told(fit: NorrbinFit) -> dict:
    """Coefficients as published (deg and deg/s), their standard errors, neutral angle."""
    std = Norrbin.of(jnp.sqrt(jnp.diag(fit.white)))
    return {
        "coefficients": {k: float(v) for k, v in in_degrees(fit.model).items()},
        "standard_errors": {k: float(v) for k, v in in_degrees(std).items()},
        "neutral_deg": float(np.degrees(fit.model.neutral)),
        "scatter_deg_s": float(np.degrees(fit.scatter)),
        "converged": bool(fit.converged),
    }
