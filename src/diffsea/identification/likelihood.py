"""Innovation-form likelihood: how well a model predicts a recording one sample ahead.

An extended Kalman filter runs along the tape. Its state is the vessel's six numbers and
three accelerations of gusts that last: first-order Gauss-Markov processes, besides gusts that
are white. Were lasting gusts taken for white ones, the fit would bend the vessel until its
own dynamics had their colour (a thruster's lag comes out a quarter too short).

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

    gust: Float[Array, "3"]  # white, of u (m/s), v (m/s), r (rad/s), per square root of a second
    slow: Float[Array, "3"]  # lasting, standard deviation of the acceleration (m/s^2, rad/s^2)
    memory: Float[Array, "3"]  # time constant (s) of the lasting ones
    sensor: Float[Array, "6"]  # of x, y (m), psi (rad), u, v (m/s), r (rad/s)

    @staticmethod
    def of(scales: Float[Array, "15"] | np.ndarray) -> "Noise":
        """From all logarithms in one array."""
        return Noise(*(jnp.asarray(part) for part in jnp.split(jnp.asarray(scales), (3, 6, 9))))

    @property
    def scales(self) -> Float[Array, "15"]:
        """All logarithms in one array."""
        return jnp.concatenate([self.gust, self.slow, self.memory, self.sensor])


class Gusts(eqx.Module):
    """What gusts do within each row, exactly for constant velocity of the vessel."""

    decay: Float[Array, "row 3"]  # share of a lasting acceleration left at the end
    half: Float[Array, "row 3"]  # half the speed it gives, per unit at the start (s)


class Gains(eqx.Module):
    """What the filter found: how to correct and how to weigh each innovation."""

    correction: Float[Array, "row 9 6"]  # state from innovation; zero columns where missing
    whitening: Float[Array, "row 6 6"]  # innovation to unit covariance; zero where missing
    used: Bool[Array, "row 6"]
    gusts: Gusts


class Tuned(eqx.Module):
    """A filter's run: its gains, innovations, their variances and its linearisation."""

    gains: Gains
    nu: Float[Array, "row 6"]  # innovations, zero where missing
    white: Float[Array, "row 6"]  # the same, whitened
    variance: Float[Array, "row 6"]  # of the sequential innovations; one where missing
    F: Float[Array, "row 6 6"]  # the vessel's state to its next state
    H: Float[Array, "row 6 6"]  # the vessel's state to measurement
    kick: Float[Array, "row 3"]  # speeds given by lasting gusts before and again after the row


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

    def kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """What each coordinate is, the same number for its copies, and its run or -1."""
        kind, run = list(range(len(self.parameters))), [-1] * len(self.parameters)
        for effect, sizes in zip(self.effects, self.sizes, strict=True):
            copies, first = self.copies(effect), len(kind)
            for copy in range(copies):
                kind += range(first, first + len(sizes))
                run += [copy if copies > 1 else -1] * len(sizes)
        return np.array(kind), np.array(run)

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
    push: Float[Array, "row 3"] | None = None,
) -> Float[Array, "row 6"]:
    """Whitened innovations of every row with the gains held fixed.

    `push` adds accelerations (m/s^2, m/s^2, rad/s^2), the generic candidate of
    `diagnosis.locate`.
    """
    vessel, flows = equipped(base, layout, coordinates)

    def body(z: Float[Array, "9"], inputs: tuple) -> tuple:
        row, correction, whitening, gusts, acceleration = inputs
        flow = row["flow"]
        z = jnp.where(row["starts"], _first(row), z)
        nu = _innovation(row, _expected(vessel, z[:6], row, flow))
        z = z + _applied(correction, nu)
        kick = gusts.half * z[6:] + 0.5 * row["dt"] * acceleration
        x = _propagate(vessel, _faster(z[:6], kick), row, flow, tape.substeps)
        z = jnp.concatenate([_faster(x, kick), gusts.decay * z[6:]])
        return z, _applied(whitening, nu)

    push = jnp.zeros((tape.t.size, 3)) if push is None else push
    inputs = (
        _rows(vessel, flows, tape), gains.correction, gains.whitening, gains.gusts, push,
    )  # fmt: skip
    return jax.lax.scan(body, jnp.zeros(9), inputs)[1]


def _first(row: dict) -> Float[Array, "9"]:
    """State at the start of a run."""
    return jnp.concatenate([row["first"], jnp.zeros(3)])


def _faster(x: Float[Array, "6"], kick: Float[Array, "3"]) -> Float[Array, "6"]:
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
    R = jnp.exp(2 * noise.sensor)
    P0 = jnp.diag(jnp.concatenate([first_variance(vessel), jnp.exp(2 * noise.slow)]))

    def body(carry: tuple, inputs: tuple) -> tuple:
        row, gust, Q = inputs
        z, P = carry
        flow = row["flow"]
        z = jnp.where(row["starts"], _first(row), z)
        P = jnp.where(row["starts"], P0, P)
        nu = _innovation(row, _expected(vessel, z[:6], row, flow))
        H = jax.jacfwd(lambda s: _expected(vessel, s, row, flow))(z[:6])
        spread = jnp.sqrt(jnp.sum(H * product(P[:6, :6], H.T).T, axis=1) + R)
        used = row["known"] & ((jnp.abs(nu) < gate * spread) | row["starts"])
        nu = jnp.where(used, nu, 0.0)
        K, W, P, variance = updated(P, H, R, used)
        z = z + _applied(K, nu)
        kick = gust.half * z[6:]
        x = _faster(z[:6], kick)
        F = jax.jacfwd(lambda s: _propagate(vessel, s, row, flow, tape.substeps))(x)
        P = predicted(P, F, gust, Q)
        x = _faster(_propagate(vessel, x, row, flow, tape.substeps), kick)
        out = (K, W, used, nu, _applied(W, nu), variance, F, H, kick)
        return (jnp.concatenate([x, gust.decay * z[6:]]), P), out

    gusts, Q = gust_model(noise, tape.dt)
    _, found = jax.lax.scan(body, (jnp.zeros(9), P0), (_rows(vessel, flows, tape), gusts, Q))
    return Tuned(Gains(*found[:3], gusts), *found[3:])


def gust_model(noise: Noise, dt: Float[Array, "row"]) -> tuple[Gusts, Float[Array, "row 9 9"]]:
    """Propagation of lasting gusts over each row, and the covariance that all gusts add.

    Exact integrals of a first-order Gauss-Markov acceleration and of the speed it gives
    (Jazwinski 1970, section 4.9); as the memory shrinks they become those of white noise.
    """
    memory = jnp.exp(noise.memory)
    share = dt[:, None] / memory
    decay = jnp.exp(-share)
    power = jnp.exp(2 * noise.slow)
    speed = power * memory**2 * (2 * share - 3 + 4 * decay - decay**2)
    speed = speed + jnp.exp(2 * noise.gust) * dt[:, None]
    both = power * memory * (1 - decay) ** 2
    left = power * (1 - decay**2)
    still = jnp.zeros_like(speed)
    diagonal = jnp.concatenate([still, speed, left], axis=1)
    beside = jnp.concatenate([still, both], axis=1)
    upper = jax.vmap(lambda row: jnp.diag(row, 3))(beside)
    Q = jax.vmap(jnp.diag)(diagonal) + upper + upper.mT
    return Gusts(decay, 0.5 * memory * (1 - decay)), Q


def predicted(
    P: Float[Array, "9 9"], F: Float[Array, "6 6"], gust: Gusts, Q: Float[Array, "9 9"]
) -> Float[Array, "9 9"]:
    """Covariance at the end of a row: gusts act half before and half after the vessel moves."""
    act = F[:, 3:] * gust.half + jnp.eye(6)[:, 3:] * gust.half
    keep = jnp.concatenate([jnp.zeros((3, 6)), jnp.eye(3) * gust.decay], axis=1)
    whole = jnp.concatenate([jnp.concatenate([F, act], axis=1), keep])
    return product(product(whole, P), whole.T) + Q


def product(a: Float[Array, "n n"], b: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Matrix product as fused multiplications, for the reason of `_applied`."""
    return jnp.sum(a[:, :, None] * b[None, :, :], axis=1)


def updated(
    P: Float[Array, "9 9"], H: Float[Array, "6 6"], R: Float[Array, "6"], used: Bool[Array, "6"]
) -> tuple:
    """One channel after the other: correction, whitening, covariance and innovation variances.

    Sensors are independent and do not see gusts, so six scalar updates equal the joint one
    (Bierman 1977), and their innovations are the whitened ones, without any factorisation.
    In terms of the joint innovation nu the state's correction is C nu, built up row by row.
    """
    C, rows, variances = jnp.zeros((9, 6)), [], []
    unit = np.eye(6)
    for j in range(6):
        h = jnp.where(used[j], H[j], 0.0)
        Ph = jnp.sum(P[:, :6] * h, axis=1)
        s = jnp.where(used[j], jnp.sum(h * Ph[:6]) + R[j], 1.0)
        fresh = jnp.where(used[j], unit[j] - jnp.sum(h[:, None] * C[:6], axis=0), 0.0)
        gain = Ph / s
        C = C + gain[:, None] * fresh[None, :]
        # Joseph form: stays positive definite however small the sensor noise.
        left = P - gain[:, None] * Ph[None, :]
        spare = jnp.sum(left[:, :6] * h, axis=1) - R[j] * gain
        P = left - spare[:, None] * gain[None, :]
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
