"""Late sensors in a filter: the states that it has passed, and what is found of them since.

A recording whose clock is not that of the orders, moved to theirs.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.process_noise import matrix_vector
from diffsea.kinematics import to_earth
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import change_servos
from diffsea.vessel.servo import Servo


class StateHistory(eqx.Module):
    """The states of the rows before, from which late channels are read.

    An innovation of a late channel tells of that past: a state so long ago was wrong by what the
    present is found to be wrong by, less what its rate was wrong by for so long. All that has
    been found since is a line in time, and states are kept less that line.
    """

    states: Float[Array, "memory 6"]  # the latest first
    ages: Float[Array, "memory"]  # s
    level: Float[Array, "6"]  # of the line at time zero
    slope: Float[Array, "6"]  # per s

    @staticmethod
    def begun(x: Float[Array, "6"], memory: int) -> "StateHistory":
        """Before a run: on with its first velocities, a tenth of a second for each row."""
        ages = 0.1 * jnp.arange(1.0, memory + 1)
        north, east = to_earth(x[3], x[4], x[2])
        rate = jnp.stack([north, east, x[5], *(jnp.zeros(3))])
        return StateHistory(x - ages[:, None] * rate, ages, jnp.zeros(6), jnp.zeros(6))

    def corrected(self, step: Float[Array, "9"], psi: Scalar, t: Scalar) -> "StateHistory":
        """With what late channels have found at time `t`, as a step of the filter's state."""
        north, east = to_earth(step[3], step[4], psi)
        rate = jnp.stack([north, east, step[5], *step[6:]])
        level = self.level + step[:6] - t * rate
        return StateHistory(self.states, self.ages, level, self.slope + rate)

    def after(self, x: Float[Array, "6"], t: Scalar, dt: Scalar) -> "StateHistory":
        """With the state at time `t`, `dt` s later."""
        kept = x - self.level - t * self.slope
        states = jnp.concatenate([kept[None], self.states[:-1]])
        ages = jnp.concatenate([jnp.zeros(1), self.ages[:-1]]) + dt
        return StateHistory(states, ages, self.level, self.slope)

    def past(self, x: Float[Array, "6"], lag: Float[Array, "6"], t: Scalar) -> Float[Array, "6"]:
        """Each number of the state as it was `lag` s before `t`: linear between rows.

        Beyond the last row, and for negative lags, on with the slope there.
        """
        ages = jnp.concatenate([jnp.zeros(1), self.ages])[:, None]
        states = jnp.concatenate([(x - self.level - t * self.slope)[None], self.states])
        gap = jnp.where(ages[1:] - ages[:-1] > 1e-6, ages[1:] - ages[:-1], 1.0)
        share = (lag - ages[:-1]) / gap
        ends = np.arange(len(gap))[:, None]
        share = jnp.where((share < 0) & (ends > 0), 0.0, share)
        share = jnp.where((share >= 1) & (ends < len(gap) - 1), 1.0, share)
        return x - lag * self.slope + jnp.sum(share * (states[1:] - states[:-1]), axis=0)


def channel_latencies(vessel: Vessel) -> Float[Array, "6"]:
    """How late (s) each motion channel is."""
    lags = vessel.sensors.lags()
    return jnp.stack([jnp.asarray(lags[channel], float) for channel in MOTION_CHANNELS])


def shown_measurements(
    vessel: Vessel, x: Float[Array, "6"], row: dict, trail: StateHistory
) -> Float[Array, "6"]:
    """What the sensors should show in a state that was reached along a trail."""
    past = trail.past(x, channel_latencies(vessel), row["run_time"])
    return vessel.sensors.shown(dict(zip(MOTION_CHANNELS, past, strict=True)))


def relative_latencies(vessel: Vessel) -> Float[Array, "6"]:
    """How much each channel tells of the past and not of the present: one for the latest."""
    lag = jax.lax.stop_gradient(channel_latencies(vessel))
    latest = jnp.max(lag)
    return jnp.where(latest > 0, jnp.maximum(lag, 0.0) / jnp.where(latest > 0, latest, 1.0), 0.0)


def retrodict(
    z: Float[Array, "9"],
    trail: StateHistory,
    gain: Float[Array, "9 6"],
    nu: Float[Array, "6"],
    late: Float[Array, "6"],
    row: dict,
) -> tuple[Float[Array, "9"], StateHistory]:
    """State and trail after an innovation."""
    now = z + matrix_vector(gain, nu)
    trail = trail.corrected(matrix_vector(gain, late * nu), z[2], row["run_time"])
    return now, trail.after(now[:6], row["run_time"], row["dt"])


SIDE = 1e-7  # s, far below any row and far above what rounding does to times of 1e4 s


def align_to_order_clock(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel without an error of the clock, and the dataset with its rows when they truly were.

    A state stamped t is that of t - (offset + rate t) on the clock of the orders: the rows are
    moved there, however far the two clocks have parted. Orders within a row are met at their
    times, up to `servo.ORDERS_PER_STEP` of them.
    """
    clock = vessel.sensors.clock
    if clock is None:
        return vessel, dataset
    late = clock.late(dataset.run_time)
    t = dataset.t - late
    executed = {c: _between(t, dataset.t, held) for c, held in dataset.executed.items()}
    moved = dataclasses.replace(
        dataset,
        t=t,
        run_time=dataset.run_time - late,
        dt=dataset.dt * (1 - clock.rate),
        executed=executed,
    )
    right = dataclasses.replace(vessel.sensors, clock=None)
    vessel = change_servos(vessel, vessel.channels, _delayed)
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
