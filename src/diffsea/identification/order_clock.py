"""A recording whose clock is not that of the orders, moved to theirs."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.identification.tape import Tape
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import on_channels
from diffsea.vessel.servo import Servo


SIDE = 1e-7  # s, far below any row and far above what rounding does to times of 1e4 s


def on_order_clock(vessel: Vessel, tape: Tape) -> tuple[Vessel, Tape]:
    """A vessel without an error of the clock, and the tape with its rows when they truly were.

    A state stamped t is that of t - (offset + rate t) on the clock of the orders: the rows are
    moved there, however far the two clocks have parted. Orders within a row are met at their
    times, up to `servo.SEGMENTS` of them.
    """
    clock = vessel.sensors.clock
    if clock is None:
        return vessel, tape
    late = clock.late(tape.run_time)
    t = tape.t - late
    executed = {c: _between(t, tape.t, held) for c, held in tape.executed.items()}
    moved = dataclasses.replace(
        tape, t=t, run_time=tape.run_time - late, dt=tape.dt * (1 - clock.rate), executed=executed
    )
    right = dataclasses.replace(vessel.sensors, clock=None)
    vessel = on_channels(vessel, vessel.channels, _delayed)
    return dataclasses.replace(vessel, sensors=right), moved


def _between(
    wanted: Float[Array, "row"], t: Float[Array, "row"], values: Float[Array, "row"]
) -> Float[Array, "row"]:
    """Values between rows; on a row, with the mean of both slopes."""
    either = (jnp.interp(wanted + side * SIDE, t, values) for side in (-1, 1))
    return 0.5 * sum(either)


def _delayed(servo: Servo, _: eqx.Module) -> Servo:
    """The servo with a delay, of zero where it has none: orders change within rows."""
    return servo if servo.delay is not None else dataclasses.replace(servo, delay=0.0)
