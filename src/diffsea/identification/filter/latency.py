"""Delayed sensors in a Kalman filter, clocks that are not those of the orders, and steps.

A delayed channel measures a past state. The filter keeps the states of the rows before, predicts
a delayed channel from them, and corrects them in retrodiction by what has been found since.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.covariance import matrix_vector
from diffsea.kinematics import to_earth
from diffsea.simulation.actuation import values_between_rows
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import change_servos


BEFORE_RUN_STEP = 0.1  # s from row to row of the history that is made up before a run


class StateHistory(eqx.Module):
    """States of the rows before, from which delayed channels are predicted.

    An innovation of a delayed channel corrects the present state by dx and its rate by dv. In
    retrodiction a state that is s seconds old is corrected by dx - s dv. The sum of all such
    corrections is linear in time, level + t slope; it is kept apart, and the states without it,
    so that no row of the history need be touched.
    """

    states: Float[Array, "memory 6"]  # the latest first, less the corrections
    ages: Float[Array, "memory"]  # s
    level: Float[Array, "6"]  # of the corrections at time zero
    slope: Float[Array, "6"]  # per s

    @staticmethod
    def before_run(x: Float[Array, "6"], memory: int) -> "StateHistory":
        """The history of a run's first state: straight ahead with its velocities."""
        ages = BEFORE_RUN_STEP * jnp.arange(1.0, memory + 1)
        north, east = to_earth(x[3], x[4], x[2])
        rate = jnp.stack([north, east, x[5], *(jnp.zeros(3))])
        return StateHistory(x - ages[:, None] * rate, ages, jnp.zeros(6), jnp.zeros(6))

    def retrodict(self, step: Float[Array, "9"], psi: Scalar, t: Scalar) -> "StateHistory":
        """Corrected by a step of the filter's state that delayed channels caused at time `t`."""
        north, east = to_earth(step[3], step[4], psi)
        rate = jnp.stack([north, east, step[5], *step[6:]])
        level = self.level + step[:6] - t * rate
        return StateHistory(self.states, self.ages, level, self.slope + rate)

    def append(self, x: Float[Array, "6"], t: Scalar, dt: Scalar) -> "StateHistory":
        """With the state at time `t`, as seen `dt` s later."""
        kept = x - self.level - t * self.slope
        states = jnp.concatenate([kept[None], self.states[:-1]])
        ages = jnp.concatenate([jnp.zeros(1), self.ages[:-1]]) + dt
        return StateHistory(states, ages, self.level, self.slope)

    def delayed_state(
        self, x: Float[Array, "6"], lag: Float[Array, "6"], t: Scalar
    ) -> Float[Array, "6"]:
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


def relative_latencies(vessel: Vessel) -> Float[Array, "6"]:
    """Latencies over the longest one, 0 to 1: how far a channel measures the past."""
    lag = jax.lax.stop_gradient(channel_latencies(vessel))
    latest = jnp.max(lag)
    return jnp.where(latest > 0, jnp.maximum(lag, 0.0) / jnp.where(latest > 0, latest, 1.0), 0.0)


def shown_measurements(
    vessel: Vessel, x: Float[Array, "6"], t: Scalar, history: StateHistory
) -> Float[Array, "6"]:
    """What the sensors should show at time `t` in a state with this history."""
    past = history.delayed_state(x, channel_latencies(vessel), t)
    return vessel.sensors.shown(dict(zip(MOTION_CHANNELS, past, strict=True)))


def correct_with_history(
    z: Float[Array, "9"],
    history: StateHistory,
    correction: Float[Array, "9 6"],
    innovation: Float[Array, "6"],
    late: Float[Array, "6"],
    t: Scalar,
    dt: Scalar,
) -> tuple[Float[Array, "9"], StateHistory]:
    """State and history after an innovation, `late` the `relative_latencies`."""
    now = z + matrix_vector(correction, innovation)
    history = history.retrodict(matrix_vector(correction, late * innovation), z[2], t)
    return now, history.append(now[:6], t, dt)


def without_time_errors(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel whose clock and sensors are those of all the run, and the data set put right.

    What a sensor shows too much since an instant is taken off, and rows are as of the clock of
    the orders.
    """
    return align_to_order_clock(*without_steps(vessel, dataset))


def without_steps(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel without steps of its sensors, and the data set without them."""
    sensors = vessel.sensors
    if not (sensors.heading_steps or sensors.gyro_steps):
        return vessel, dataset
    interval = jnp.concatenate([dataset.dt[:1], dataset.dt[:-1]])
    measured = dataset.measured - sensors.steps(dataset.run_time, interval)
    steady = dataclasses.replace(sensors, heading_steps=(), gyro_steps=())
    vessel = dataclasses.replace(vessel, sensors=steady)
    return vessel, dataclasses.replace(dataset, measured=measured)


def align_to_order_clock(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel without an error of the clock, and the data set with its rows when they truly were.

    A state stamped t is that of t - (offset + rate t) on the clock of the orders: the rows are
    moved there, however far the two clocks have parted. Orders within a row are met at their
    times, up to `servo.ORDERS_PER_STEP` of them.
    """
    clock = vessel.sensors.clock
    if clock is None:
        return vessel, dataset
    late = clock.late(dataset.run_time)
    t = dataset.t - late

    moved = dataclasses.replace(
        dataset,
        t=t,
        run_time=dataset.run_time - late,
        dt=dataset.dt * (1 - clock.rate),
        executed={
            c: values_between_rows(t, dataset.t, held) for c, held in dataset.executed.items()
        },
    )
    right = dataclasses.replace(vessel.sensors, clock=None)
    vessel = change_servos(vessel, vessel.channels, lambda servo, _: servo.with_delay())
    return dataclasses.replace(vessel, sensors=right), moved
