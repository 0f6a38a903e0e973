"""Innovation-form likelihood: how well a model predicts a recording one sample ahead.

An extended Kalman filter (`run_filter`) runs along the data set; its state is the vessel's six
numbers and the three accelerations of lasting gusts. `covariance` has its `measurement_update`
and `time_update`.

Gains and innovation covariances are found once, at the current estimate; the innovations with
those gains held fixed (`whitened_innovations`) are then a plain nonlinear least-squares residual
in the parameters, seven times cheaper to differentiate than the filter. Repeating the two
converges to the estimate with the optimal gains: dropping the gains' own derivative costs no
asymptotic efficiency, because the innovations are uncorrelated with it (Ljung 1999, section 9.4).
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.batching import batched_scan
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.corrections import corrected
from diffsea.identification.filter.covariance import (
    GustPropagation,
    Noise,
    gust_propagation,
    matrix_product,
    matrix_vector,
    measurement_update,
    time_update,
)
from diffsea.identification.filter.latency import (
    SamplePlacement,
    channel_latencies,
    place_samples,
    placed_samples,
    shown_samples,
)
from diffsea.identification.least_squares import value_and_jacobian
from diffsea.kinematics import wrap
from diffsea.scales import froude_speed
from diffsea.simulation.actuation import true_actuation
from diffsea.simulation.integrate import rk4_looped
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import OrderHistory, Response


NO_GATE = 1e9  # standard deviations: no measurement is further off
_HEADING = np.arange(6) == MOTION_CHANNELS.index("psi")
_AHEAD = tuple(float(name in ("x", "u")) for name in MOTION_CHANNELS)  # of a straight run


class Gains(eqx.Module):
    """What the filter found: how to correct and how to weigh each innovation."""

    correction: Float[Array, "row 9 6"]  # state from innovation; zero columns where missing
    whitening: Float[Array, "row 6 6"]  # innovation to unit covariance; zero where missing
    used: Bool[Array, "row 6"]
    gusts: GustPropagation
    placement: SamplePlacement


class FilterRun(eqx.Module):
    """A filter's run: its gains, innovations, their variances and its linearisation."""

    gains: Gains
    state: Float[Array, "row 6"]  # of the vessel, after the row's measurements
    innovation: Float[Array, "row 6"]  # zero where missing
    white: Float[Array, "row 6"]  # the same, whitened
    covariance: Float[Array, "row 9 9"]  # of the filter's state, after the row's measurements
    variance: Float[Array, "row 6"]  # of the sequential innovations; one where missing
    F: Float[Array, "row 6 6"]  # the vessel's state to its next state
    H: Float[Array, "row 6 9"]  # the filter's state to measurement
    gust_impulse: Float[Array, "row 3"]  # speeds by lasting gusts before and again after the row
    gust_acceleration: Float[Array, "row 3"]  # by lasting gusts, before the row's measurements
    late: Float[Array, "row 6"]  # share of the row before, that each sample lies before its end


class FilterRow(eqx.Module):
    """What a filter takes in of one row of a data set, or of all rows in a leading axis."""

    flow: Environment
    dt: Float[Array, "*row"]  # s
    run_time: Float[Array, "*row"]  # s on the run's own clock
    measured: Float[Array, "*row 6"]
    known: Bool[Array, "*row 6"]
    starts: Bool[Array, "*row"]
    first: Float[Array, "*row 6"]
    moved: Float[Array, "*row 6"]  # s, stamps of the samples less the time of their row
    response: dict[str, Response]
    straight: Bool[Array, "*row"] | bool = False  # nothing tells of drift, heading or turning

    @property
    def actuation(self) -> dict[str, Scalar]:
        """What every channel executes at the beginning of the row."""
        return {channel: response.start for channel, response in self.response.items()}


def filter_rows(
    vessel: Vessel, flows: Environment, dataset: Dataset, placement: SamplePlacement
) -> FilterRow:
    """All rows of a data set with their samples, and with what the actuators do in them."""
    flow = jax.tree.map(lambda leaf: leaf[dataset.run], flows)
    samples = placed_samples(dataset, placement)
    return FilterRow(
        dataclasses.replace(flow, disturbance=dataset.disturbance),
        dataset.dt,
        dataset.run_time,
        samples.measured,
        samples.known,
        placement.restarts,
        dataset.first,
        samples.moved,
        {channel: _actuator_response(vessel, channel, dataset) for channel in vessel.channels},
        ~dataset.shows_turning[dataset.run],
    )


def _actuator_response(vessel: Vessel, channel: str, dataset: Dataset) -> Response:
    """What a channel executes during every row: as measured, or its servo's answer to orders."""
    servo = vessel.servos[channel]
    if channel in dataset.executed:
        return Response(
            *[true_actuation(vessel, channel, dataset.t, dataset.executed[channel])] * 4
        )
    orders = dataset.orders[channel]
    if servo.direct:
        return Response(*[jax.vmap(servo.target)(orders)] * 4)

    # Which orders fall into a row does not depend on the rows before: found for all at once.
    servo = servo.with_delay() if dataset.orders_within_rows else servo
    history = OrderHistory(dataset.order_times[channel], dataset.order_values[channel])
    dt = servo.usable_length(dataset.dt)
    given = servo.order_segments(history, dataset.t, dt) if servo.delay is not None else None

    def body(executed: Scalar, row: tuple) -> tuple[Scalar, Response]:
        starts, order, dt, given = row
        breaks, values = ([0.0, 1.0], [order]) if given is None else given
        executed = jnp.where(starts, servo.target(values[0]), executed)
        response = servo.respond_to(executed, breaks, values, dt)
        return response.final, response

    # Nothing is left of the run before, neither in a lead-in nor after it.
    begins = dataset.starts | (dataset.part != jnp.roll(dataset.part, 1))
    rows = (begins, orders, dt, given)
    return batched_scan(body, servo.target(orders[0]), rows, dataset.batches)


def propagate(
    vessel: Vessel, x: Float[Array, "6"], row: FilterRow, substeps: int
) -> Float[Array, "6"]:
    """The vessel's state at the next row.

    Where the data say nothing of drift, heading and turning, the run is taken as straight. A hull
    that is unstable there would let rounding grow to any turn, which nothing corrects.
    """
    state = State(*x)
    dt = row.dt / substeps
    for k in range(substeps):
        part = {c: _part_of(r, k / substeps, 1 / substeps) for c, r in row.response.items()}
        state = rk4_looped(vessel, state, part, row.flow, row.run_time + k * dt, dt)
    return jnp.stack(jax.tree.leaves(state)) * _followed(row)


def propagation_jacobian(
    vessel: Vessel, x: Float[Array, "6"], row: FilterRow, substeps: int
) -> tuple[Float[Array, "6"], Float[Array, "6 6"]]:
    """The vessel's state at the next row, and how it depends on the present one."""
    x, by_motion = _by_motion(lambda at: propagate(vessel, at, row, substeps), x)
    by_position = jnp.eye(6)[:, :2] * _followed(row)[:, None]
    return x, jnp.concatenate([by_position, by_motion], axis=1)


def _by_motion(
    function: Callable[[Float[Array, "6"]], Float[Array, "6"]], x: Float[Array, "6"]
) -> tuple[Float[Array, "6"], Float[Array, "6 4"]]:
    """A function's value, and its slopes by heading and velocities.

    No force depends on the position: what becomes of it is known without differentiation.
    """
    position, motion = x[:2], x[2:]
    return value_and_jacobian(lambda at: function(jnp.concatenate([position, at])), motion)


def _followed(row: FilterRow) -> Float[Array, "6"]:
    """One for numbers of the state that are followed, zero for those of a straight run's turn."""
    return jnp.where(row.straight, jnp.array(_AHEAD), 1.0)


def _part_of(response: Response, start: float, share: float) -> Response:
    """The response's quadratic over part of its step."""
    if share == 1.0:
        return response

    def at(s: float) -> Scalar:
        a, b, c = response.start, response.middle, response.end
        return a * (1 - s) * (1 - 2 * s) + 4 * b * s * (1 - s) + c * s * (2 * s - 1)

    return Response(at(start), at(start + share / 2), at(start + share), response.final)


def measurement_jacobian(
    vessel: Vessel,
    x: Float[Array, "6"],
    acceleration: Float[Array, "3"],
    moved: Float[Array, "6"],
) -> Float[Array, "6 9"]:
    """How `shown_samples` depend on the filter's state; the accelerations are taken as known."""
    by_position = jnp.eye(6)[:, :2]
    shown = lambda at: shown_samples(vessel, at, acceleration, moved)
    return jnp.concatenate([by_position, _by_motion(shown, x)[1], jnp.zeros((6, 3))], axis=1)


def innovation_of(row: FilterRow, expected: Float[Array, "6"]) -> Float[Array, "6"]:
    """Measured less expected; zero where nothing was measured."""
    innovation = row.measured - expected
    # Not innovation.at[2].set: a scatter in a batched loop is slow on CPUs, and so is a gather.
    innovation = jnp.where(_HEADING, wrap(innovation), innovation)
    return jnp.where(row.known, innovation, 0.0)


def restart(
    z: Float[Array, "9"], acceleration: Float[Array, "3"], row: FilterRow
) -> tuple[Float[Array, "9"], Float[Array, "3"]]:
    """State and acceleration, those of a run's beginning where the row is its first."""
    z = jnp.where(row.starts, jnp.concatenate([row.first, jnp.zeros(3)]), z)
    return z, jnp.where(row.starts, 0.0, acceleration)


def shares_of_rows(vessel: Vessel, rows: FilterRow) -> Float[Array, "row 6"]:
    """How long before their row samples are of, as share of the row before it: up to all of it."""
    before = jnp.roll(rows.dt, 1)[:, None]
    share = (channel_latencies(vessel) - rows.moved) / jnp.where(before > 0, before, jnp.inf)
    return jnp.where(rows.starts[:, None], 0.0, jnp.clip(share, 0.0, 1.0))


def mean_acceleration(
    row: FilterRow, before: Float[Array, "9"], after: Float[Array, "6"]
) -> Float[Array, "3"]:
    """Of the speeds over a row; zero where no time passes."""
    passes = row.dt > 0
    return jnp.where(passes, (after[3:] - before[3:6]) / jnp.where(passes, row.dt, 1.0), 0.0)


def with_impulse(x: Float[Array, "6"], impulse: Float[Array, "3"]) -> Float[Array, "6"]:
    """The vessel's state with its speeds raised."""
    return jnp.concatenate([x[:3], x[3:] + impulse])


def whitened_innovations(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    gains: Gains,
    coordinates: Float[Array, "coordinate"],
    pulses: Float[Array, "row 3"] | None = None,
) -> Float[Array, "row 6"]:
    """Whitened innovations of every row with the gains held fixed.

    `pulses` are accelerations (m/s^2, m/s^2, rad/s^2) during each row, beside all forces: by them
    an unexplained force is located.
    """
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, dataset = corrected(vessel, dataset)

    def body(carry: tuple[Float[Array, "9"], Float[Array, "3"]], inputs: tuple) -> tuple:
        row, correction, whitening, gusts, pulse = inputs
        z, acceleration = restart(*carry, row)
        innovation = innovation_of(row, shown_samples(vessel, z[:6], acceleration, row.moved))
        z = z + matrix_vector(correction, innovation)
        impulse = gusts.half * z[6:] + 0.5 * row.dt * pulse
        x = propagate(vessel, with_impulse(z[:6], impulse), row, dataset.substeps)
        x = with_impulse(x, impulse)
        carry = jnp.concatenate([x, gusts.decay * z[6:]]), mean_acceleration(row, z, x)
        return carry, matrix_vector(whitening, innovation)

    pulses = jnp.zeros((dataset.t.size, 3)) if pulses is None else pulses
    rows = filter_rows(vessel, flows, dataset, gains.placement)
    inputs = rows, gains.correction, gains.whitening, gains.gusts, pulses
    return batched_scan(body, (jnp.zeros(9), jnp.zeros(3)), inputs, dataset.batches)


def placement_at(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    coordinates: Float[Array, "coordinate"],
) -> SamplePlacement:
    """At which rows the samples are used, as late as the sensors are at one estimate."""
    return place_samples(vessel_at(base, layout, coordinates)[0], dataset)


def run_filter(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    noise: Noise,
    coordinates: Float[Array, "coordinate"],
    placement: SamplePlacement,
    gate: float = NO_GATE,
) -> FilterRun:
    """Extended Kalman filter at one estimate.

    Missing channels have zero innovation and unit variance, so that they add nothing to
    the likelihood. A value further than `gate` standard deviations off is left out.
    """
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, dataset = corrected(vessel, dataset)
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([first_variance(vessel), jnp.exp(2 * noise.slow)]))

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, gust, Q, Q_before, late = inputs
        z, acceleration, P = carry
        z, acceleration = restart(z, acceleration, row)
        P = jnp.where(row.starts, P0, P)
        innovation = innovation_of(row, shown_samples(vessel, z[:6], acceleration, row.moved))
        lasting = z[6:]
        H = measurement_jacobian(vessel, z[:6], acceleration, row.moved)
        spread = jnp.sqrt(jnp.sum(H * matrix_product(H, P), axis=1) + R)
        # What a filter that diverged makes of a value is no outlier: it must spoil the likelihood.
        near = (jnp.abs(innovation) < gate * spread) | ~jnp.isfinite(innovation / spread)
        used = row.known & (near | row.starts)
        innovation = jnp.where(used, innovation, 0.0)
        K, W, P, variance = measurement_update(P, H, R, used, Q_before, late)
        corrected = P
        z = z + matrix_vector(K, innovation)
        impulse = gust.half * z[6:]
        x = with_impulse(z[:6], impulse)
        x, F = propagation_jacobian(vessel, x, row, dataset.substeps)
        P = time_update(P, F, gust, Q)
        x = with_impulse(x, impulse)
        white = matrix_vector(W, innovation)
        out = (K, W, used, z[:6], innovation, white, corrected, variance, F, H, impulse, lasting)
        z, acceleration = jnp.concatenate([x, gust.decay * z[6:]]), mean_acceleration(row, z, x)
        return (z, acceleration, P), out

    gusts, Q = gust_propagation(noise, dataset.dt)
    rows = filter_rows(vessel, flows, dataset, placement)
    late = shares_of_rows(vessel, rows)
    inputs = rows, gusts, Q, jnp.roll(Q, 1, axis=0), late
    _, found = jax.lax.scan(body, (jnp.zeros(9), jnp.zeros(3), P0), inputs)
    correction, whitening, used, *rest = found
    return FilterRun(Gains(correction, whitening, used, gusts, placement), *rest, late=late)


def first_variance(vessel: Vessel) -> Float[Array, "6"]:
    """Broad covariance of a run's first state, from the size of the vessel."""
    length = vessel.rigid_body.length
    speed = froude_speed(length, 0.5)
    spread = jnp.array([length, length, 0.5, speed, speed, speed / length])
    return spread**2


def deviance(run: FilterRun) -> Float[Array, ""]:
    """-2 log likelihood without its constant: sum(nu^2 / s + log s) of scalar innovations nu."""
    return jnp.sum(run.white**2) + jnp.sum(jnp.log(run.variance))
