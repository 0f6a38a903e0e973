"""Innovation-form likelihood: how well a model predicts a recording one sample ahead.

An extended Kalman filter runs along the tape; its state is the vessel's six numbers and the
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
from diffsea.identification.data.batching import scan
from diffsea.identification.data.dataset import Tape
from diffsea.identification.filter.latency import (
    Trail,
    followed,
    latencies,
    lateness,
    on_order_clock,
    shown,
)
from diffsea.identification.filter.process_noise import (
    Gusts,
    Noise,
    applied,
    gust_model,
    predicted,
    product,
    updated,
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
    gusts: Gusts


class Tuned(eqx.Module):
    """A filter's run: its gains, innovations, their variances and its linearisation."""

    gains: Gains
    state: Float[Array, "row 6"]  # of the vessel, after the row's measurements
    nu: Float[Array, "row 6"]  # innovations, zero where missing
    white: Float[Array, "row 6"]  # the same, whitened
    variance: Float[Array, "row 6"]  # of the sequential innovations; one where missing
    F: Float[Array, "row 6 6"]  # the vessel's state to its next state
    H: Float[Array, "row 6 9"]  # the filter's state to measurement
    kick: Float[Array, "row 3"]  # speeds given by lasting gusts before and again after the row
    lasting: Float[Array, "row 3"]  # accelerations by lasting gusts, before the row's measurements
    late: Float[Array, "row 6"]  # rows that each channel lags


def responses(vessel: Vessel, tape: Tape) -> dict[str, Response]:
    """What every channel executes during every row: measured, or the servo's answer."""
    return {
        channel: _measured_response(tape.executed[channel])
        if channel in tape.executed
        else _servo_response(vessel, channel, tape)
        for channel in vessel.channels
    }


def _measured_response(executed: Float[Array, "row"]) -> Response:
    return Response(executed, executed, executed, executed)


def _servo_response(vessel: Vessel, channel: str, tape: Tape) -> Response:
    servo, orders = vessel.servos[channel], tape.orders[channel]
    if servo.direct:
        return _measured_response(jax.vmap(servo.target)(orders))

    # Which orders fall into a row does not depend on the rows before: found for all at once.
    history = OrderHistory(tape.order_times, tape.order_values[channel])
    dt = servo.usable(tape.dt)
    given = servo.segments(history, tape.t, dt) if servo.delay is not None else None

    def body(executed: Scalar, row: tuple) -> tuple[Scalar, Response]:
        starts, order, dt, given = row
        executed = jnp.where(starts, servo.target(order), executed)
        breaks, values = ([0.0, 1.0], [order]) if given is None else given
        response = servo.answer(executed, breaks, values, dt)
        return response.final, response

    rows = (tape.starts, orders, dt, given)
    return scan(body, servo.target(orders[0]), rows, tape.lanes)


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


def expected(
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


def innovation(row: dict, expected: Float[Array, "6"]) -> Float[Array, "6"]:
    """Measured less expected; zero where nothing was measured."""
    nu = row["measured"] - expected
    # Not nu.at[2].set: a scatter in a batched loop is slow on CPUs, and so is a gather.
    nu = jnp.where(_HEADING, wrap(nu), nu)
    return jnp.where(row["known"], nu, 0.0)


_HEADING = np.arange(6) == MOTION_CHANNELS.index("psi")


def rows(vessel: Vessel, flows: Environment, tape: Tape) -> dict:
    """What a scan along the tape takes in."""
    flow = jax.tree.map(lambda leaf: leaf[tape.run], flows)
    return {
        "flow": heeled(flow, flow.heel + tape.heel),
        "dt": tape.dt,
        "run_time": tape.run_time,
        "measured": tape.measured,
        "known": tape.known,
        "starts": tape.starts,
        "first": tape.first,
        "response": responses(vessel, tape),
    }


def innovations(
    base: Vessel,
    layout: CoordinateLayout,
    tape: Tape,
    gains: Gains,
    coordinates: Float[Array, "coordinate"],
    push: Float[Array, "row 3"] | None = None,
) -> Float[Array, "row 6"]:
    """Whitened innovations of every row with the gains held fixed.

    `push` adds accelerations (m/s^2, m/s^2, rad/s^2), the generic candidate of
    `diagnosis.locate`.
    """
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, tape = on_order_clock(vessel, tape)
    late = lateness(vessel)

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, correction, whitening, gusts, acceleration = inputs
        flow = row["flow"]
        z, trail = restarted(*carry, row, tape.memory)
        nu = innovation(row, shown(vessel, z[:6], row, trail))
        z, trail = followed(z, trail, correction, nu, late, row)
        kick = gusts.half * z[6:] + 0.5 * row["dt"] * acceleration
        x = propagate(vessel, faster(z[:6], kick), row, flow, tape.substeps)
        z = jnp.concatenate([faster(x, kick), gusts.decay * z[6:]])
        return (z, trail), applied(whitening, nu)

    push = jnp.zeros((tape.t.size, 3)) if push is None else push
    inputs = (
        rows(vessel, flows, tape), gains.correction, gains.whitening, gains.gusts, push,
    )  # fmt: skip
    start = jnp.zeros(9), Trail.begun(jnp.zeros(6), tape.memory)
    return scan(body, start, inputs, tape.lanes)


def restarted(
    z: Float[Array, "9"], trail: Trail, row: dict, memory: int
) -> tuple[Float[Array, "9"], Trail]:
    """State and trail, those of a run's beginning where the row is its first."""
    z = jnp.where(row["starts"], _first(row), z)
    fresh = Trail.begun(z[:6], memory)
    return z, jax.tree.map(lambda new, old: jnp.where(row["starts"], new, old), fresh, trail)


def _first(row: dict) -> Float[Array, "9"]:
    """State at the start of a run."""
    return jnp.concatenate([row["first"], jnp.zeros(3)])


def faster(x: Float[Array, "6"], kick: Float[Array, "3"]) -> Float[Array, "6"]:
    """The vessel's state with its speeds raised."""
    return jnp.concatenate([x[:3], x[3:] + kick])


def tune(
    base: Vessel,
    layout: CoordinateLayout,
    tape: Tape,
    noise: Noise,
    coordinates: Float[Array, "coordinate"],
    gate: float = 1e9,
) -> Tuned:
    """Extended Kalman filter at one estimate.

    Missing channels have zero innovation and unit variance, so that they add nothing to
    the likelihood. A value further than `gate` standard deviations off is left out.
    """
    vessel, flows = vessel_at(base, layout, coordinates)
    vessel, tape = on_order_clock(vessel, tape)
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([first_variance(vessel), jnp.exp(2 * noise.slow)]))
    lag, late = latencies(vessel), lateness(vessel)

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, gust, Q = inputs
        *before, P = carry
        flow = row["flow"]
        z, trail = restarted(*before, row, tape.memory)
        P = jnp.where(row["starts"], P0, P)
        nu = innovation(row, shown(vessel, z[:6], row, trail))
        lasting = z[6:]
        H = _shown_by(vessel, z, row, flow)
        spread = jnp.sqrt(jnp.sum(H * product(H, P), axis=1) + R)
        # What a filter that diverged makes of a value is no outlier: it must spoil the likelihood.
        near = (jnp.abs(nu) < gate * spread) | ~jnp.isfinite(nu / spread)
        used = row["known"] & (near | row["starts"])
        nu = jnp.where(used, nu, 0.0)
        rows_late = lag / jnp.where(row["dt"] > 0, row["dt"], 1.0)
        K, W, P, variance = updated(P, H, R, used, Q, rows_late)
        z, trail = followed(z, trail, K, nu, late, row)
        kick = gust.half * z[6:]
        x = faster(z[:6], kick)
        x, F = value_and_jacobian(lambda at: propagate(vessel, at, row, flow, tape.substeps), x)
        P = predicted(P, F, gust, Q)
        x = faster(x, kick)
        out = (K, W, used, z[:6], nu, applied(W, nu), variance, F, H, kick, lasting, rows_late)
        return (jnp.concatenate([x, gust.decay * z[6:]]), trail, P), out

    gusts, Q = gust_model(noise, tape.dt)
    start = jnp.zeros(9), Trail.begun(jnp.zeros(6), tape.memory), P0
    _, found = jax.lax.scan(body, start, (rows(vessel, flows, tape), gusts, Q))
    return Tuned(Gains(*found[:3], gusts), *found[3:])


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
    motion = z[:6], now, applied(A, now)
    moved = jnp.eye(6, 9), first, product(A, first)
    measure = lambda *given: vessel.sensors.measure(*(State(*one) for one in given))
    along = lambda *change: jax.jvp(measure, motion, change)[1]
    return jax.vmap(along, in_axes=1, out_axes=1)(*moved)


def first_variance(vessel: Vessel) -> Float[Array, "6"]:
    """Broad covariance of a run's first state, from the size of the vessel."""
    length = vessel.rigid_body.length
    speed = froude_speed(length, 0.5)
    spread = jnp.array([length, length, 0.5, speed, speed, speed / length])
    return spread**2


def deviance(tuned: Tuned) -> Float[Array, ""]:
    """-2 log likelihood without its constant: sum(nu^2 / s + log s) of scalar innovations."""
    return jnp.sum(tuned.white**2) + jnp.sum(jnp.log(tuned.variance))
