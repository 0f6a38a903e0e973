"""Innovation-form likelihood: how well a model predicts a recording one sample ahead.

An extended Kalman filter runs along the tape. Its gains and innovation covariances are
found once, at the current estimate (`tune`); the innovations with those gains held fixed
(`innovations`) are then a plain nonlinear least-squares residual in the parameters, seven
times cheaper to differentiate than the filter. Repeating the two converges to the
estimate with the optimal gains: dropping the gains' own derivative costs no asymptotic
efficiency, because the innovations are uncorrelated with it (Ljung 1999, section 9.4).
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.identification.tape import Tape
from diffsea.kinematics import wrap
from diffsea.parameters import Parameter, replace
from diffsea.simulation.integrate import rk4
from diffsea.types import MOTION_CHANNELS, Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import AbstractEffect
from diffsea.vessel.servo import OrderHistory, Response


class Noise(eqx.Module):
    """Logarithms of the noise scales."""

    gust: Float[Array, "3"]  # of u (m/s), v (m/s), r (rad/s), per square root of a second
    sensor: Float[Array, "6"]  # of x, y (m), psi (rad), u, v (m/s), r (rad/s)


class Gains(eqx.Module):
    """What the filter found: how to correct and how to weigh each innovation."""

    correction: Float[Array, "row 6 6"]  # state from innovation; zero columns where missing
    whitening: Float[Array, "row 6 6"]  # innovation to unit covariance; zero where missing
    used: Bool[Array, "row 6"]


class Tuned(eqx.Module):
    """A filter's run: its gains, innovations, their variances and its linearisation."""

    gains: Gains
    nu: Float[Array, "row 6"]  # innovations, zero where missing
    white: Float[Array, "row 6"]  # the same, whitened
    variance: Float[Array, "row 6"]  # of the sequential innovations; one where missing
    F: Float[Array, "row 6 6"]  # state to next state
    H: Float[Array, "row 6 6"]  # state to measurement


@dataclasses.dataclass(frozen=True)
class Layout:
    """Which coordinates there are: first the parameters, then each effect's.

    Environment effects have one set per run where `per_run`, all others one set.
    """

    parameters: tuple[Parameter, ...]
    effects: tuple[AbstractEffect, ...]
    sizes: tuple[tuple[float, ...], ...]
    runs: int
    per_run: bool

    def copies(self, effect: AbstractEffect) -> int:
        """How many sets of coordinates an effect has."""
        return self.runs if self.per_run and effect.group == "environment" else 1

    def slices(self) -> dict[str, slice]:
        """Where each effect's coordinates stand."""
        out, start = {}, len(self.parameters)
        for effect, sizes in zip(self.effects, self.sizes, strict=True):
            stop = start + self.copies(effect) * len(sizes)
            out[effect.name] = slice(start, stop)
            start = stop
        return out

    @property
    def size(self) -> int:
        """Number of coordinates."""
        counts = [self.copies(e) * len(s) for e, s in zip(self.effects, self.sizes, strict=True)]
        return len(self.parameters) + sum(counts)

    def spreads(self) -> np.ndarray:
        """Prior standard deviation of every coordinate."""
        effects = sum(
            self.copies(e) * len(s) for e, s in zip(self.effects, self.sizes, strict=True)
        )
        return np.array([p.spread for p in self.parameters] + [3.0] * effects)

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """Positions of the coordinates of parameters and effects by name."""
        slices = self.slices()
        found: list[int] = []
        for number, parameter in enumerate(self.parameters):
            found += [number] if parameter.name in names else []
        for name in names:
            found += range(slices[name].start, slices[name].stop) if name in slices else []
        return found

    def physical(self, name: str, coordinates: np.ndarray) -> np.ndarray:
        """An effect's coordinates in SI units, one row per copy."""
        index = [effect.name for effect in self.effects].index(name)
        scaled = np.asarray(coordinates)[self.slices()[name]]
        return scaled.reshape(-1, len(self.sizes[index])) * np.array(self.sizes[index])


def equipped(
    base: Vessel, layout: Layout, coordinates: Float[Array, "coordinate"]
) -> tuple[Vessel, Environment]:
    """The vessel at these coordinates, and the environment of each run (leaves of shape run)."""
    values = {p.name: p.decode(coordinates[k]) for k, p in enumerate(layout.parameters)}
    vessel = replace(base, values)
    zero = jnp.zeros(layout.runs)
    flow = jax.tree.map(lambda leaf: leaf + zero, vessel.environment)
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        scaled = coordinates[layout.slices()[effect.name]].reshape(-1, len(sizes))
        physical = scaled * jnp.asarray(sizes)
        if effect.group != "environment":
            vessel = effect.apply(vessel, physical[0])
            continue
        # The parts are attached by applying the effect at zero; the flow is each run's own.
        still = effect.apply(vessel, jnp.zeros(len(sizes)))
        changed = jax.vmap(lambda p, e=effect, v=vessel: e.apply(v, p).environment)(physical)
        added = jax.tree.map(lambda new, old: new - old, changed, vessel.environment)
        flow = jax.tree.map(lambda now, more: now + more + zero, flow, added)
        vessel = still
    return vessel, flow


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

    def body(executed: Scalar, row: tuple) -> tuple[Scalar, Response]:
        starts, order, t, dt = row
        executed = jnp.where(starts, servo.target(order), executed)
        if servo.delay is None:
            history = OrderHistory(t[None], order[None])
        else:
            history = OrderHistory(tape.order_times, tape.order_values[channel])
        response = servo.respond(executed, history, t, dt)
        return response.final, response

    rows = (tape.starts, orders, tape.t, tape.dt)
    return jax.lax.scan(body, servo.target(orders[0]), rows)[1]


def _propagate(
    vessel: Vessel, x: Float[Array, "6"], row: dict, flow: Environment, substeps: int
) -> Float[Array, "6"]:
    """The state at the next row."""
    state = State(*x)
    dt = row["dt"] / substeps
    for k in range(substeps):
        part = {c: _part(r, k / substeps, 1 / substeps) for c, r in row["response"].items()}
        state = rk4(vessel, state, part, flow, row["run_time"] + k * dt, dt)
    return jnp.stack(jax.tree.leaves(state))


def _part(response: Response, start: float, share: float) -> Response:
    """The response's quadratic over part of its step."""
    if share == 1.0:
        return response

    def at(s: float) -> Scalar:
        a, b, c = response.start, response.middle, response.end
        return a * (1 - s) * (1 - 2 * s) + 4 * b * s * (1 - s) + c * s * (2 * s - 1)

    return Response(at(start), at(start + share / 2), at(start + share), response.final)


def _expected(
    vessel: Vessel, x: Float[Array, "6"], row: dict, flow: Environment
) -> Float[Array, "6"]:
    """What the sensors should show in a state."""
    state = State(*x)
    executed = {c: r.start for c, r in row["response"].items()}

    def rate(at: State) -> State:
        return vessel.rate(at, executed, flow, row["run_time"])

    state = jax.tree.map(jnp.asarray, state)
    first, second = jax.jvp(rate, (state,), (rate(state),))
    return vessel.sensors.measure(state, first, second)


def _innovation(row: dict, expected: Float[Array, "6"]) -> Float[Array, "6"]:
    nu = row["measured"] - expected
    # Not nu.at[2].set: a scatter in a batched loop is slow on CPUs, and so is a gather.
    nu = jnp.where(_HEADING, wrap(nu), nu)
    return jnp.where(row["known"], nu, 0.0)


_HEADING = np.arange(6) == MOTION_CHANNELS.index("psi")


def _rows(vessel: Vessel, flows: Environment, tape: Tape) -> dict:
    return {
        "flow": jax.tree.map(lambda leaf: leaf[tape.run], flows),
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
    push: Float[Array, "bin 3"] | None = None,
    bins: Int[Array, "row"] | None = None,
) -> Float[Array, "row 6"]:
    """Whitened innovations of every row with the gains held fixed.

    `push` adds accelerations (m/s^2, m/s^2, rad/s^2) during the rows of each bin, the
    generic candidate of `diagnosis.locate`.
    """
    vessel, flows = equipped(base, layout, coordinates)

    def body(x: Float[Array, "6"], inputs: tuple) -> tuple:
        row, correction, whitening, kick = inputs
        flow = row["flow"]
        x = jnp.where(row["starts"], row["first"], x)
        nu = _innovation(row, _expected(vessel, x, row, flow))
        x = x + _applied(correction, nu)
        x = _propagate(vessel, x, row, flow, tape.substeps)
        if push is not None:
            x = x + kick * row["dt"]
        return x, _applied(whitening, nu)

    kicks = jnp.zeros((tape.t.size, 6)) if push is None else _kicks(push, bins)
    inputs = (_rows(vessel, flows, tape), gains.correction, gains.whitening, kicks)
    return jax.lax.scan(body, jnp.zeros(6), inputs)[1]


def _kicks(push: Float[Array, "bin 3"], bins: Int[Array, "row"]) -> Float[Array, "row 6"]:
    """Acceleration of every state in every row; bin -1 is none."""
    chosen = jnp.where((bins >= 0)[:, None], push[jnp.maximum(bins, 0)], 0.0)
    return jnp.concatenate([jnp.zeros_like(chosen), chosen], axis=1)


def _applied(matrix: Float[Array, "6 6"], vector: Float[Array, "6"]) -> Float[Array, "6"]:
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
    Q = jnp.diag(jnp.concatenate([jnp.zeros(3), jnp.exp(2 * noise.gust)]))
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(first_variance(vessel))

    def body(carry: tuple, row: dict) -> tuple:
        x, P = carry
        flow = row["flow"]
        x = jnp.where(row["starts"], row["first"], x)
        P = jnp.where(row["starts"], P0, P)
        nu = _innovation(row, _expected(vessel, x, row, flow))
        H = jax.jacfwd(lambda s: _expected(vessel, s, row, flow))(x)
        spread = jnp.sqrt(jnp.sum(H * product(P, H.T).T, axis=1) + R)
        used = row["known"] & ((jnp.abs(nu) < gate * spread) | row["starts"])
        nu = jnp.where(used, nu, 0.0)
        K, W, P, variance = updated(P, H, R, used)
        x_new = x + _applied(K, nu)
        F = jax.jacfwd(lambda s: _propagate(vessel, s, row, flow, tape.substeps))(x_new)
        P = product(product(F, P), F.T) + Q * row["dt"]
        x_next = _propagate(vessel, x_new, row, flow, tape.substeps)
        return (x_next, P), (K, W, used, nu, _applied(W, nu), variance, F, H)

    start = (jnp.zeros(6), P0)
    _, found = jax.lax.scan(body, start, _rows(vessel, flows, tape))
    return Tuned(Gains(*found[:3]), *found[3:])


def product(a: Float[Array, "6 6"], b: Float[Array, "6 6"]) -> Float[Array, "6 6"]:
    """Matrix product as fused multiplications, for the reason of `_applied`."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


def updated(
    P: Float[Array, "6 6"], H: Float[Array, "6 6"], R: Float[Array, "6"], used: Bool[Array, "6"]
) -> tuple:
    """One channel after the other: correction, whitening, covariance and innovation variances.

    Sensors are independent, so six scalar updates equal the joint one (Bierman 1977), and
    their innovations are the whitened ones, without any factorisation. In terms of the
    joint innovation nu the state's correction is C nu, built up row by row.
    """
    C, rows, variances = jnp.zeros((6, 6)), [], []
    unit = np.eye(6)
    for j in range(6):
        h = jnp.where(used[j], H[j], 0.0)
        Ph = jnp.sum(P * h, axis=1)
        s = jnp.where(used[j], jnp.sum(h * Ph) + R[j], 1.0)
        fresh = jnp.where(used[j], unit[j] - jnp.sum(h[:, None] * C, axis=0), 0.0)
        C = C + (Ph / s)[:, None] * fresh[None, :]
        # Joseph form: stays positive definite however small the sensor noise.
        gain = Ph / s
        left = unit - gain[:, None] * h[None, :]
        P = product(product(left, P), left.T) + R[j] * gain[:, None] * gain[None, :]
        rows.append(fresh / jnp.sqrt(s))
        variances.append(s)
    return C, jnp.stack(rows), P, jnp.stack(variances)


def first_variance(vessel: Vessel) -> Float[Array, "6"]:
    """Broad covariance of a run's first state, from the size of the vessel."""
    length = vessel.rigid_body.length
    speed = 0.5 * jnp.sqrt(9.81 * length)
    spread = jnp.array([length, length, 0.5, speed, speed, speed / length])
    return spread**2


def deviance(tuned: Tuned) -> Float[Array, ""]:
    """-2 log likelihood without its constant: sum(nu^2 / s + log s) of scalar innovations."""
    return jnp.sum(tuned.white**2) + jnp.sum(jnp.log(tuned.variance))
