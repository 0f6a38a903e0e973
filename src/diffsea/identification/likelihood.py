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

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.gusts import Gusts, Noise, gust_model, predicted, product, updated
from diffsea.identification.lanes import scan
from diffsea.identification.layout import Layout, equipped
from diffsea.identification.tape import Tape
from diffsea.kinematics import to_earth, wrap
from diffsea.simulation.integrate import rk4_looped
from diffsea.simulation.replay import heeled
from diffsea.types import MOTION_CHANNELS, Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import on_channels
from diffsea.vessel.servo import OrderHistory, Response, Servo


SIDE = 1e-7  # s


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


def on_order_clock(vessel: Vessel, tape: Tape) -> tuple[Vessel, Tape]:
    """A vessel without an error of the clock, and the tape with its rows when they truly were.

    A state stamped t is that of t - (offset + rate t) on the clock of the orders: moving the
    rows there is exact, however far the two clocks have parted.
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


class Trail(eqx.Module):
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
    def begun(x: Float[Array, "6"], memory: int) -> "Trail":
        """Before a run: on with its first velocities, a tenth of a second for each row."""
        ages = 0.1 * jnp.arange(1.0, memory + 1)
        north, east = to_earth(x[3], x[4], x[2])
        rate = jnp.stack([north, east, x[5], *(jnp.zeros(3))])
        return Trail(x - ages[:, None] * rate, ages, jnp.zeros(6), jnp.zeros(6))

    def corrected(self, step: Float[Array, "9"], psi: Scalar, t: Scalar) -> "Trail":
        """With what late channels have found at time `t`, as a step of the filter's state."""
        north, east = to_earth(step[3], step[4], psi)
        rate = jnp.stack([north, east, step[5], *step[6:]])
        level = self.level + step[:6] - t * rate
        return Trail(self.states, self.ages, level, self.slope + rate)

    def after(self, x: Float[Array, "6"], t: Scalar, dt: Scalar) -> "Trail":
        """With the state at time `t`, `dt` s later."""
        kept = x - self.level - t * self.slope
        states = jnp.concatenate([kept[None], self.states[:-1]])
        ages = jnp.concatenate([jnp.zeros(1), self.ages[:-1]]) + dt
        return Trail(states, ages, self.level, self.slope)

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


def latencies(vessel: Vessel) -> Float[Array, "6"]:
    """How late (s) each motion channel is."""
    lags = vessel.sensors.lags()
    return jnp.stack([jnp.asarray(lags[channel], float) for channel in MOTION_CHANNELS])


def shown(vessel: Vessel, x: Float[Array, "6"], row: dict, trail: Trail) -> Float[Array, "6"]:
    """What the sensors should show in a state that was reached along a trail."""
    past = trail.past(x, latencies(vessel), row["run_time"])
    return vessel.sensors.shown(dict(zip(MOTION_CHANNELS, past, strict=True)))


def lateness(vessel: Vessel) -> Float[Array, "6"]:
    """How much each channel tells of the past and not of the present: one for the latest."""
    lag = jax.lax.stop_gradient(latencies(vessel))
    latest = jnp.max(lag)
    return jnp.where(latest > 0, jnp.maximum(lag, 0.0) / jnp.where(latest > 0, latest, 1.0), 0.0)


def followed(
    z: Float[Array, "9"],
    trail: Trail,
    gain: Float[Array, "9 6"],
    nu: Float[Array, "6"],
    late: Float[Array, "6"],
    row: dict,
) -> tuple[Float[Array, "9"], Trail]:
    """State and trail after an innovation."""
    now = z + _applied(gain, nu)
    trail = trail.corrected(_applied(gain, late * nu), z[2], row["run_time"])
    return now, trail.after(now[:6], row["run_time"], row["dt"])


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
    layout: Layout,
    tape: Tape,
    gains: Gains,
    coordinates: Float[Array, "coordinate"],
    push: Float[Array, "row 3"] | None = None,
) -> Float[Array, "row 6"]:
    """Whitened innovations of every row with the gains held fixed.

    `push` adds accelerations (m/s^2, m/s^2, rad/s^2), the generic candidate of
    `diagnosis.locate`.
    """
    vessel, flows = equipped(base, layout, coordinates)
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
        return (z, trail), _applied(whitening, nu)

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


def _applied(matrix: Float[Array, "n 6"], vector: Float[Array, "6"]) -> Float[Array, "n"]:
    """Matrix times vector as fused multiplications: a library call per row costs far more."""
    return jnp.sum(matrix * vector, axis=-1)


def tune(
    base: Vessel,
    layout: Layout,
    tape: Tape,
    noise: Noise,
    coordinates: Float[Array, "coordinate"],
    gate: float = 1e9,
) -> Tuned:
    """Extended Kalman filter at one estimate.

    Missing channels have zero innovation and unit variance, so that they add nothing to
    the likelihood. A value further than `gate` standard deviations off is left out.
    """
    vessel, flows = equipped(base, layout, coordinates)
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
        H = jax.jacfwd(lambda s: expected(vessel, s, row, flow))(z)
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
        F = jax.jacfwd(lambda s: propagate(vessel, s, row, flow, tape.substeps))(x)
        P = predicted(P, F, gust, Q)
        x = faster(propagate(vessel, x, row, flow, tape.substeps), kick)
        out = (K, W, used, z[:6], nu, _applied(W, nu), variance, F, H, kick, lasting, rows_late)
        return (jnp.concatenate([x, gust.decay * z[6:]]), trail, P), out

    gusts, Q = gust_model(noise, tape.dt)
    start = jnp.zeros(9), Trail.begun(jnp.zeros(6), tape.memory), P0
    _, found = jax.lax.scan(body, start, (rows(vessel, flows, tape), gusts, Q))
    return Tuned(Gains(*found[:3], gusts), *found[3:])


def first_variance(vessel: Vessel) -> Float[Array, "6"]:
    """Broad covariance of a run's first state, from the size of the vessel."""
    length = vessel.rigid_body.length
    speed = 0.5 * jnp.sqrt(9.81 * length)
    spread = jnp.array([length, length, 0.5, speed, speed, speed / length])
    return spread**2


def deviance(tuned: Tuned) -> Float[Array, ""]:
    """-2 log likelihood without its constant: sum(nu^2 / s + log s) of scalar innovations."""
    return jnp.sum(tuned.white**2) + jnp.sum(jnp.log(tuned.variance))
