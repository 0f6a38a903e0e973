"""Innovation-form likelihood: how well a model predicts a recording one sample ahead.

An extended Kalman filter runs along the dataset; its state is the vessel's six numbers and the
three accelerations of lasting gusts.

Gains and innovation covariances are found once, at the current estimate (`tune`); the
innovations with those gains held fixed (`innovations`) are then a plain nonlinear
least-squares residual in the parameters, seven times cheaper to differentiate than the
filter. Repeating the two converges to the estimate with the optimal gains: dropping the
gains' own derivative costs no asymptotic efficiency, because the innovations are
uncorrelated with it (Ljung 1999, section 9.4).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.batching import batched_scan
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.filter.latency import (
    StateHistory,
    align_to_order_clock,
    channel_latencies,
    relative_latencies,
    retrodict,
    shown_measurements,
)
from diffsea.identification.filter.process_noise import (
    GustPropagation,
    Noise,
    gust_propagation,
    matrix_product,
    matrix_vector,
    measurement_update,
    time_update,
)
from diffsea.identification.least_squares import value_and_jacobian
from diffsea.kinematics import wrap
from diffsea.scales import froude_speed
from diffsea.simulation.integrate import rk4_looped
from diffsea.simulation.replay import heeled
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import OrderHistory, Response


class Gains(eqx.Module):
    """What the filter found: how to correct and how to weigh each innovation."""

    correction: Float[Array, "row 9 6"]  # state from innovation; zero columns where missing
    whitening: Float[Array, "row 6 6"]  # innovation to unit covariance; zero where missing
    used: Bool[Array, "row 6"]
    gusts: GustPropagation


class FilterRun(eqx.Module):
    """A filter's run: its gains, innovations, their variances and its linearisation."""

    gains: Gains
    state: Float[Array, "row 6"]  # of the vessel, after the row's measurements
    innovation: Float[Array, "row 6"]  # zero where missing
    white: Float[Array, "row 6"]  # the same, whitened
    variance: Float[Array, "row 6"]  # of the sequential innovations; one where missing
    F: Float[Array, "row 6 6"]  # the vessel's state to its next state
    H: Float[Array, "row 6 9"]  # the filter's state to measurement
    gust_impulse: Float[
        Array, "row 3"
    ]  # speeds given by lasting gusts before and again after the row
    gust_acceleration: Float[
        Array, "row 3"
    ]  # accelerations by lasting gusts, before the row's measurements
    rows_late: Float[Array, "row 6"]  # rows that each channel lags


def actuator_responses(vessel: Vessel, dataset: Dataset) -> dict[str, Response]:
    """What every channel executes during every row: measured, or the servo's answer."""
    return {
        channel: _measured_response(dataset.executed[channel])
        if channel in dataset.executed
        else _servo_response(vessel, channel, dataset)
        for channel in vessel.channels
    }


def _measured_response(executed: Float[Array, "row"]) -> Response:
    return Response(executed, executed, executed, executed)


def _servo_response(vessel: Vessel, channel: str, dataset: Dataset) -> Response:
    servo, orders = vessel.servos[channel], dataset.orders[channel]
    if servo.direct:
        return _measured_response(jax.vmap(servo.target)(orders))

    # Which orders fall into a row does not depend on the rows before: found for all at once.
    history = OrderHistory(dataset.order_times, dataset.order_values[channel])
    dt = servo.usable_length(dataset.dt)
    given = servo.order_segments(history, dataset.t, dt) if servo.delay is not None else None

    def body(executed: Scalar, row: tuple) -> tuple[Scalar, Response]:
        starts, order, dt, given = row
        executed = jnp.where(starts, servo.target(order), executed)
        breaks, values = ([0.0, 1.0], [order]) if given is None else given
        response = servo.respond_to(executed, breaks, values, dt)
        return response.final, response

    rows = (dataset.starts, orders, dt, given)
    return batched_scan(body, servo.target(orders[0]), rows, dataset.lanes)


def propagate(
    vessel: Vessel, x: Float[Array, "6"], row: dict, flow: Environment, substeps: int
) -> Float[Array, "6"]:
    """The state at the next row."""
    state = State(*x)
    dt = row["dt"] / substeps
    for k in range(substeps):
        part = {c: _part(r, k / substeps, 1 / substeps) for c, r in row["response"].items()}
        state = rk4_looped(vessel, state, part, flow, row["run_time"] + k * dt, dt)
    return jnp.stack(jax.tree.leaves(state))


def _part(response: Response, start: float, share: float) -> Response:
    """The response's quadratic over part of its step."""
    if share == 1.0:
        return response

    def at(s: float) -> Scalar:
        a, b, c = response.start, response.middle, response.end
        return a * (1 - s) * (1 - 2 * s) + 4 * b * s * (1 - s) + c * s * (2 * s - 1)

    return Response(at(start), at(start + share / 2), at(start + share), response.final)


def expected_measurements(
    vessel: Vessel, z: Float[Array, "9"], row: dict, flow: Environment
) -> Float[Array, "6"]:
    """What the sensors should show in a state, late channels by a Taylor polynomial.

    It says how what is shown depends on the present state, which a trail does not. Lasting gusts
    are part of the rate at which the present was reached.
    """
    state = State(*z[:6])
    lasting = State(0.0, 0.0, 0.0, *z[6:])
    executed = {c: r.start for c, r in row["response"].items()}

    def rate(at: State) -> State:
        own = vessel.rate(at, executed, flow, row["run_time"])
        return jax.tree.map(jnp.add, own, lasting)

    state = jax.tree.map(jnp.asarray, state)
    first, second = jax.jvp(rate, (state,), (rate(state),))
    return vessel.sensors.measure(state, first, second)


def innovation_of(row: dict, expected: Float[Array, "6"]) -> Float[Array, "6"]:
    """Measured less expected; zero where nothing was measured."""
    nu = row["measured"] - expected
    # Not nu.at[2].set: a scatter in a batched loop is slow on CPUs, and so is a gather.
    nu = jnp.where(_HEADING, wrap(nu), nu)
    return jnp.where(row["known"], nu, 0.0)


_HEADING = np.arange(6) == MOTION_CHANNELS.index("psi")


def filter_rows(vessel: Vessel, flows: Environment, dataset: Dataset) -> dict:
    """What a scan along the dataset takes in."""
    flow = jax.tree.map(lambda leaf: leaf[dataset.run], flows)
    return {
        "flow": heeled(flow, flow.heel + dataset.heel),
        "dt": dataset.dt,
        "run_time": dataset.run_time,
        "measured": dataset.measured,
        "known": dataset.known,
        "starts": dataset.starts,
        "first": dataset.first,
        "response": actuator_responses(vessel, dataset),
    }


def whitened_innovations(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    gains: Gains,
    coordinates: Float[Array, "coordinate"],
    push: Float[Array, "row 3"] | None = None,
) -> Float[Array, "row 6"]:
    """Whitened innovations of every row with the gains held fixed.

    `push` adds accelerations (m/s^2, m/s^2, rad/s^2), the generic candidate of
    `diagnosis.locate`.
    """
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, dataset = align_to_order_clock(vessel, dataset)
    late = relative_latencies(vessel)

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, correction, whitening, gusts, acceleration = inputs
        flow = row["flow"]
        z, trail = restart(*carry, row, dataset.memory)
        nu = innovation_of(row, shown_measurements(vessel, z[:6], row, trail))
        z, trail = retrodict(z, trail, correction, nu, late, row)
        kick = gusts.half * z[6:] + 0.5 * row["dt"] * acceleration
        x = propagate(vessel, with_impulse(z[:6], kick), row, flow, dataset.substeps)
        z = jnp.concatenate([with_impulse(x, kick), gusts.decay * z[6:]])
        return (z, trail), matrix_vector(whitening, nu)

    push = jnp.zeros((dataset.t.size, 3)) if push is None else push
    inputs = (
        filter_rows(vessel, flows, dataset), gains.correction, gains.whitening, gains.gusts, push,
    )  # fmt: skip
    start = jnp.zeros(9), StateHistory.begun(jnp.zeros(6), dataset.memory)
    return batched_scan(body, start, inputs, dataset.lanes)


def restart(
    z: Float[Array, "9"], trail: StateHistory, row: dict, memory: int
) -> tuple[Float[Array, "9"], StateHistory]:
    """State and trail, those of a run's beginning where the row is its first."""
    z = jnp.where(row["starts"], _first(row), z)
    fresh = StateHistory.begun(z[:6], memory)
    return z, jax.tree.map(lambda new, old: jnp.where(row["starts"], new, old), fresh, trail)


def _first(row: dict) -> Float[Array, "9"]:
    """State at the start of a run."""
    return jnp.concatenate([row["first"], jnp.zeros(3)])


def with_impulse(x: Float[Array, "6"], kick: Float[Array, "3"]) -> Float[Array, "6"]:
    """The vessel's state with its speeds raised."""
    return jnp.concatenate([x[:3], x[3:] + kick])


def run_filter(
    base: Vessel,
    layout: CoordinateLayout,
    dataset: Dataset,
    noise: Noise,
    coordinates: Float[Array, "coordinate"],
    gate: float = 1e9,
) -> FilterRun:
    """Extended Kalman filter at one estimate.

    Missing channels have zero innovation and unit variance, so that they add nothing to
    the likelihood. A value further than `gate` standard deviations off is left out.
    """
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, dataset = align_to_order_clock(vessel, dataset)
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([first_variance(vessel), jnp.exp(2 * noise.slow)]))
    lag, late = channel_latencies(vessel), relative_latencies(vessel)

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, gust, Q = inputs
        *before, P = carry
        flow = row["flow"]
        z, trail = restart(*before, row, dataset.memory)
        P = jnp.where(row["starts"], P0, P)
        nu = innovation_of(row, shown_measurements(vessel, z[:6], row, trail))
        lasting = z[6:]
        H = _shown_by(vessel, z, row, flow)
        spread = jnp.sqrt(jnp.sum(H * matrix_product(H, P), axis=1) + R)
        # What a filter that diverged makes of a value is no outlier: it must spoil the likelihood.
        near = (jnp.abs(nu) < gate * spread) | ~jnp.isfinite(nu / spread)
        used = row["known"] & (near | row["starts"])
        nu = jnp.where(used, nu, 0.0)
        rows_late = lag / jnp.where(row["dt"] > 0, row["dt"], 1.0)
        K, W, P, variance = measurement_update(P, H, R, used, Q, rows_late)
        z, trail = retrodict(z, trail, K, nu, late, row)
        kick = gust.half * z[6:]
        x = with_impulse(z[:6], kick)
        x, F = value_and_jacobian(lambda at: propagate(vessel, at, row, flow, dataset.substeps), x)
        P = time_update(P, F, gust, Q)
        x = with_impulse(x, kick)
        out = (
            K,
            W,
            used,
            z[:6],
            nu,
            matrix_vector(W, nu),
            variance,
            F,
            H,
            kick,
            lasting,
            rows_late,
        )
        return (jnp.concatenate([x, gust.decay * z[6:]]), trail, P), out

    gusts, Q = gust_propagation(noise, dataset.dt)
    start = jnp.zeros(9), StateHistory.begun(jnp.zeros(6), dataset.memory), P0
    _, found = jax.lax.scan(body, start, (filter_rows(vessel, flows, dataset), gusts, Q))
    return FilterRun(Gains(*found[:3], gusts), *found[3:])


def _shown_by(
    vessel: Vessel, z: Float[Array, "9"], row: dict, flow: Environment
) -> Float[Array, "6 9"]:
    """How what is shown (`expected`) depends on the state, its rate taken as linear there."""
    executed = {c: r.start for c, r in row["response"].items()}

    def rate(at: Float[Array, "6"]) -> Float[Array, "6"]:
        found = vessel.rate(State(*at), executed, flow, row["run_time"])
        return jnp.stack(jax.tree.leaves(found))

    own, A = value_and_jacobian(rate, z[:6])
    now = own + jnp.concatenate([jnp.zeros(3), z[6:]])
    first = jnp.concatenate([A, jnp.eye(6)[:, 3:]], axis=1)
    motion = z[:6], now, matrix_vector(A, now)
    moved = jnp.eye(6, 9), first, matrix_product(A, first)
    measure = lambda *given: vessel.sensors.measure(*(State(*one) for one in given))
    along = lambda *change: jax.jvp(measure, motion, change)[1]
    return jax.vmap(along, in_axes=1, out_axes=1)(*moved)


def first_variance(vessel: Vessel) -> Float[Array, "6"]:
    """Broad covariance of a run's first state, from the size of the vessel."""
    length = vessel.rigid_body.length
    speed = froude_speed(length, 0.5)
    spread = jnp.array([length, length, 0.5, speed, speed, speed / length])
    return spread**2


def deviance(run: FilterRun) -> Float[Array, ""]:
    """-2 log likelihood without its constant: sum(nu^2 / s + log s) of scalar innovations."""
    return jnp.sum(run.white**2) + jnp.sum(jnp.log(run.variance))
