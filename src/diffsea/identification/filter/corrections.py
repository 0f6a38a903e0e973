"""What sensors show too much by what was before: taken off, before a filter sees it.

A compass that was knocked, a heading that an estimator makes of a compass and a gyro, a clock that
is not that of the orders.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.identification.data.dataset import Dataset
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
    return align_to_order_clock(*_without_deviation(*_without_steps(vessel, dataset)))


def as_shown(
    vessel: Vessel, dataset: Dataset, measured: Float[Array, "row 6"]
) -> Float[Array, "row 6"]:
    """What `corrected` takes off, put on measurements that lack it, in the rows of a data set."""
    e = jnp.zeros(dataset.t.size)
    for _ in range(DEVIATION_ROUNDS):
        shown = eqx.tree_at(lambda d: d.measured, dataset, _turned(measured, e))
        e = _deviation(vessel, shown)
    return _turned(measured, e) + _steps(vessel, dataset)


def _without_steps(vessel: Vessel, dataset: Dataset) -> tuple[Vessel, Dataset]:
    """A vessel without steps of its sensors, and the data set without them."""
    sensors = vessel.sensors
    if not (sensors.heading_steps or sensors.gyro_steps):
        return vessel, dataset
    measured = dataset.measured - _steps(vessel, dataset)
    steady = dataclasses.replace(sensors, heading_steps=(), gyro_steps=())
    vessel = dataclasses.replace(vessel, sensors=steady)
    return vessel, dataclasses.replace(dataset, measured=measured)


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
    begins = dataset.starts | (dataset.part != jnp.roll(dataset.part, 1))
    shown, shares = _last_headings(dataset, begins), thrust_shares(vessel, executed)
    found = vessel.sensors.deviation(shown, shares, _intervals(dataset), begins)
    return jnp.where(jnp.any(dataset.known[:, _PSI]), found, 0.0)


def _last_headings(dataset: Dataset, begins: Bool[Array, "row"]) -> Float[Array, "row"]:
    """The heading that was read last in every row; before the first of a part, that one."""
    rows = jnp.arange(dataset.t.size)
    known, psi = dataset.known[:, _PSI], dataset.measured[:, _PSI]
    last = jax.lax.cummax(jnp.where(known, rows, -1))
    following = jax.lax.cummin(jnp.where(known, rows, rows.size - 1), reverse=True)
    first = jax.lax.cummax(jnp.where(begins, rows, 0))
    return psi[jnp.where(last >= first, last, following)]


def _turned(measured: Float[Array, "row 6"], angle: Float[Array, "row"]) -> Float[Array, "row 6"]:
    """Measurements whose heading is greater by an angle (rad), the velocities turned with it."""
    x, y, psi, u, v, r = jnp.moveaxis(measured, 1, 0)
    u, v = to_body(u, v, angle)
    return jnp.stack([x, y, psi + angle, u, v, r], axis=1)


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
