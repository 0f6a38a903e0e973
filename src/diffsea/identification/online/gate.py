"""Only estimates that stood the test of time reach a controller.

A fault is found some time after it began, and by then the estimate has followed it. So an
estimate waits for `quarantine` seconds, and only if trust never fell to the alarm level in
between is it handed on. At an alarm the gate closes: what waits is thrown away and the
controller keeps what it has (the prior mean, where nothing was handed on yet). The gate opens
again after trust has been above a higher level for as long (hysteresis in level and time).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.identification.online.trust import ALARM
from diffsea.types import Scalar


REOPEN = 0.75  # trust half way between the alarm and the usual level
_SLOTS = 8  # estimates that wait at a time


class Gate(eqx.Module):
    """How long an estimate waits, s, and the levels of trust that close and open."""

    quarantine: Scalar
    close: Scalar = ALARM
    reopen: Scalar = REOPEN


class Passage(eqx.Module):
    """What has passed the gate by one instant."""

    handed: Float[Array, "parameter"]  # coordinates for the controller
    open: Bool[Array, ""]
    good: Scalar  # s for which trust has been above the level that opens
    clock: Scalar  # s since the last estimate began to wait
    waiting: Float[Array, "slot parameter"]  # the oldest first
    filled: Scalar  # how many of them are estimates


def shut(parameters: int) -> Passage:
    """A closed gate that has handed on the prior mean, coordinates of zero."""
    zero = jnp.zeros(())
    return Passage(
        jnp.zeros(parameters), jnp.asarray(False), zero, zero, jnp.zeros((_SLOTS, parameters)), zero
    )


def passed(
    gate: Gate, passage: Passage, estimate: Float[Array, "parameter"], trust: Scalar, dt: Scalar
) -> Passage:
    """What has passed after one more step of `dt` s. Pure, for `jit` and `lax.scan`."""
    good = jnp.where(trust >= gate.reopen, passage.good + dt, 0.0)
    # A trust that is not a number fails both comparisons.
    sound = trust > gate.close
    opened = jnp.where(passage.open, sound, good >= gate.quarantine)
    waits = sound & (passage.open | (good > 0))
    clock = jnp.where(waits, passage.clock + dt, 0.0)
    due = waits & ((clock >= gate.quarantine / _SLOTS) | (passage.filled == 0))
    oldest = passage.waiting[0]
    ripe = due & (passage.filled >= _SLOTS) & opened
    return Passage(
        jnp.where(ripe, oldest, passage.handed),
        opened,
        good,
        jnp.where(due, 0.0, clock),
        jnp.where(due, jnp.concatenate([passage.waiting[1:], estimate[None]]), passage.waiting),
        jnp.where(waits, jnp.minimum(passage.filled + due, _SLOTS), 0.0),
    )
