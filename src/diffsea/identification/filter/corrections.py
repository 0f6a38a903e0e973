"""What sensors show too much by what was before: taken off, before a filter sees it.

A compass that was knocked, a heading that an estimator makes of a compass and a gyro, a clock that
is not that of the orders.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.data.dataset import Dataset, held_headings
from diffsea.kinematics import to_body
from diffsea.simulation.actuation import thrust_shares, values_between_rows
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import change_servos


DEVIATION_ROUNDS = 20  # a deviation of half a radian has converged by then
_PSI = MOTION_CHANNELS.index("psi")


def corrected(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel whose sensors err by the present state alone, and the data set put right.

    What a sensor shows too much since an instant, or by what was before, is taken off, and rows
    are as of the clock of the orders.
    """
    put_right = _without_deviation(*_without_steps(vessel, dataset))
    return align_to_order_clock(*_in_own_axes(*put_right))


def as_shown(vessel: Vessel, dataset: Dataset) -> Dataset:
    """A data set as sensors would show it, of one that lacks what `corrected` takes off."""
    turned = _velocities_turned(dataset.measured, _turned_since(vessel, dataset))
    dataset = dataclasses.replace(dataset, measured=turned)
    begins, e = np.asarray(_begins(dataset)), jnp.zeros(dataset.t.size)
    known = np.asarray(dataset.known)[:, _PSI]
    shown = dataset
    for _ in range(DEVIATION_ROUNDS):
        measured = _turned(dataset.measured, e)
        heading = jnp.asarray(held_headings(np.asarray(measured)[:, _PSI], known, begins))
        shown = dataclasses.replace(dataset, measured=measured, heading=heading)
        e = _deviation(vessel, shown)
    steps = _steps(vessel, dataset)
    return dataclasses.replace(
        shown, measured=shown.measured + steps, heading=shown.heading + steps[:, _PSI]
    )


def _without_steps(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel without steps of its sensors, and the data set without them."""
    sensors = vessel.sensors
    if not (sensors.heading_steps or sensors.gyro_steps):
        return vessel, dataset
    steps = _steps(vessel, dataset)
    measured, heading = dataset.measured - steps, dataset.heading - steps[:, _PSI]
    steady = dataclasses.replace(sensors, heading_steps=(), gyro_steps=())
    vessel = dataclasses.replace(vessel, sensors=steady)
    return vessel, dataclasses.replace(dataset, measured=measured, heading=heading)


def _steps(vessel: Vessel, dataset: Dataset) -> Float[Array, "row 6"]:
    return vessel.sensors.steps(dataset.run_time, _intervals(dataset))


def _intervals(dataset: Dataset) -> Float[Array, "row"]:
    """Time (s) since the row before; of the first row, until the next."""
    return jnp.concatenate([dataset.dt[:1], dataset.dt[:-1]])


def _without_deviation(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel whose heading is no estimator's, and the data set without what that makes of it."""
    if not vessel.sensors.estimated_headings:
        return vessel, dataset
    measured = _turned(dataset.measured, -_deviation(vessel, dataset))
    sensors = dataclasses.replace(vessel.sensors, estimated_headings=())
    vessel = dataclasses.replace(vessel, sensors=sensors)
    return vessel, dataclasses.replace(dataset, measured=measured)


def _deviation(vessel: Vessel, dataset: Dataset) -> Float[Array, "row"]:
    """How far (rad) the estimators' headings are off in the rows of a data set."""
    executed = {
        channel: dataset.executed[channel]
        if channel in dataset.executed
        else jax.vmap(vessel.servos[channel].target)(dataset.orders[channel])
        for channel in vessel.thrusts_at_rest
    }
    shares, begins = thrust_shares(vessel, executed), _begins(dataset)
    found = vessel.sensors.deviation(dataset.heading, shares, _intervals(dataset), begins)
    has_heading = jnp.zeros(dataset.runs, bool).at[dataset.run].max(dataset.known[:, _PSI])
    return jnp.where(has_heading[dataset.run], found, 0.0)


def _begins(dataset: Dataset) -> Bool[Array, "row"]:
    """First rows of parts, or of their lead-ins, and first recorded ones."""
    return dataset.starts | (dataset.part != jnp.roll(dataset.part, 1))


def _in_own_axes(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel whose velocities are in the axes of when they are of, and the data set so."""
    since = _turned_since(vessel, dataset)
    sensors = dataclasses.replace(vessel.sensors, latency_axes=0.0)
    vessel = dataclasses.replace(vessel, sensors=sensors)
    return vessel, dataclasses.replace(
        dataset, measured=_velocities_turned(dataset.measured, -since)
    )


def _turned_since(vessel: Vessel, dataset: Dataset) -> Float[Array, "row"]:
    """How far (rad) the heading has turned at each row since so long before as axes are late."""
    t, part = dataset.t, dataset.part
    begin = t[jnp.searchsorted(part, part, side="left").astype(int)]
    then = jnp.maximum(t - vessel.sensors.latency_axes, begin)
    return dataset.heading_between - jnp.interp(then, t, dataset.heading_between)


def _velocities_turned(
    measured: Float[Array, "row 6"], angle: Float[Array, "row"]
) -> Float[Array, "row 6"]:
    """Measurements whose velocities are in axes turned by an angle (rad)."""
    x, y, psi, u, v, r = jnp.moveaxis(measured, 1, 0)
    return jnp.stack([x, y, psi, *to_body(u, v, angle), r], axis=1)


def _turned(measured: Float[Array, "row 6"], angle: Float[Array, "row"]) -> Float[Array, "row 6"]:
    """Measurements whose heading is greater by an angle (rad), the velocities turned with it."""
    turned = _velocities_turned(measured, angle)
    return turned.at[:, _PSI].add(angle)


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
