"""What a vessel would have done under a recording's orders, from the recording's own state.

Nothing is corrected on the way: a replay shows how errors of a model grow, over the whole
run (`replay`, `replay_errors`) and from many starts along it (`horizon_errors`).
"""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError
from diffsea.kinematics import to_earth, wrap
from diffsea.metrics.preparation import prepare_recording
from diffsea.scales import plausible_motion, time_scale
from diffsea.simulation.actuation import over_rows, recorded_actuation, recorded_heel
from diffsea.simulation.integrate import rk4
from diffsea.trajectory import MOTION_CHANNELS, Outcome, Samples, Trajectory
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.sensors import Clock, Sensors
from diffsea.vessel.servo import OrderHistory, Response


HORIZONS = (5.0, 20.0, 60.0)  # s
_LONGEST_STEP = 0.3  # of sqrt(L / g)
_MOST_STEPS = 10_000_000
_PADDING = 256  # steps are padded to a multiple, so that recordings share a program


class _Steps(eqx.Module):
    """The integration steps through a recording. Spare ones at the end take no time."""

    t: Float[Array, "step"]  # s, start of the step
    dt: Float[Array, "step"]
    orders: dict[str, Float[Array, "step"]]
    executed: dict[str, Float[Array, "step"]]  # of the channels taken as measured
    heel: Float[Array, "step"]  # rad, as recorded; zero where it was not
    order_times: Float[Array, "order"]  # s, beginning long before the run
    order_values: dict[str, Float[Array, "order"]]


class _Actuation(eqx.Module):
    """What every channel executes in every step."""

    response: dict[str, Response]
    now: dict[str, Float[Array, "step"]]  # from the start of the step on


def replay(vessel: Vessel, recording: Trajectory, measured_actuation: bool = True) -> Trajectory:
    """The run that the model predicts at the recording's time stamps, open loop.

    It starts in the first recorded state; what was not measured of it is derived from the
    rest. Actuation that was measured throughout is taken as it is, any other goes through
    the vessel's servos as an order; the provenance says which. Motion is what the vessel's
    sensors would have shown.

    Arguments:
        measured_actuation: whether measured actuation is used where there is any.

    Raises:
        UserError: the recording lacks a channel's orders, or a state to start from.
    """
    t, orders, executed, notes = _inputs(vessel, recording, measured_actuation)
    acting = over_rows(recording, executed)
    steps, rows = _steps(vessel, t, orders, acting, recorded_heel(recording))
    start, derived = _true_motion(vessel.sensors, recording, t)
    first = State(*(jnp.asarray(start[c][0]) for c in MOTION_CHANNELS))
    actuation = _actuation(vessel, steps)
    states = _integrated(vessel, first, steps, actuation)
    true = {c: np.asarray(getattr(states, c))[rows] for c in MOTION_CHANNELS}
    return Trajectory(
        t=t,
        **_shown(vessel.sensors, t, true),
        commanded=orders,
        executed={c: np.asarray(now)[rows] for c, now in actuation.now.items()} | executed,
        extra={},
        valid=np.ones(t.shape, bool),
        outcome=int(Outcome.COMPLETED if _plausible(vessel, true) else Outcome.DIVERGED),
        name=recording.name,
        provenance=(
            f"predicted by {vessel.name!r} from the state at t = {t[0]:g} s", *notes, *derived,
        ),
    )  # fmt: skip


def replay_errors(predicted: Trajectory, recording: Trajectory) -> dict[str, float]:
    """Root-mean-square difference of a replay and its recording, where both have values.

    `position` (m), `heading` (rad), `u`, `v` (m/s) and `r` (rad/s); a channel that was not
    measured is absent.
    """
    measured = recording.counted()
    if not np.array_equal(measured.t, np.asarray(predicted.t)):
        raise ValueError("a replay is compared with the recording that it was made from")
    shown = {c: np.asarray(getattr(predicted, c)) for c in MOTION_CHANNELS}
    return _rms({c: shown[c] - measured.motion[c] for c in MOTION_CHANNELS})


def horizon_errors(
    vessel: Vessel,
    recording: Trajectory,
    horizons: Sequence[float] = HORIZONS,
    spacing: float = 10.0,
    measured_actuation: bool = True,
) -> dict[float, dict[str, float]]:
    """Errors of predictions so many seconds ahead, started every `spacing` s along the run.

    For each horizon (s) that the recording is long enough for: the names of `replay_errors`,
    root mean square over the starts, and `starts`, how many there were.
    """
    t, orders, executed, _ = _inputs(vessel, recording, measured_actuation)
    horizons = [h for h in horizons if t[0] + h <= t[-1]]
    if not horizons:
        return {}
    acting = over_rows(recording, executed)
    steps, rows = _steps(vessel, t, orders, acting, recorded_heel(recording))
    motion, _ = _true_motion(vessel.sensors, recording, t)
    begin, end = _windows(t, horizons, spacing)
    first = State(*(jnp.asarray(motion[c][begin]) for c in MOTION_CHANNELS))
    ends = np.where(end >= 0, rows[np.maximum(end, 0)] - rows[begin][:, None], 0)
    length = 64 * math.ceil((ends.max() + 1) / 64)
    actuation = _actuation(vessel, steps)
    states = _from_each(vessel, first, rows[begin], ends, steps, actuation, length)
    known = {c: _supported(vessel.sensors, recording, t, c) for c in MOTION_CHANNELS}
    errors = {}
    for k, horizon in enumerate(horizons):
        counted = end[:, k] >= 0
        at = end[counted, k]
        reached = {c: np.asarray(getattr(states, c))[counted, k] for c in MOTION_CHANNELS}
        misses = {
            c: np.where(known[c][at], reached[c] - motion[c][at], np.nan) for c in MOTION_CHANNELS
        }
        errors[float(horizon)] = {**_rms(misses), "starts": int(counted.sum())}
    return errors


def heeled(environment: Environment, heel: Scalar) -> Environment:
    """The environment with the recorded heel of a moment in it."""
    return eqx.tree_at(lambda e: e.heel, environment, heel)


def _inputs(
    vessel: Vessel, recording: Trajectory, measured_actuation: bool
) -> tuple[Samples, dict[str, Samples], dict[str, Samples], tuple[str, ...]]:
    orders, executed = recorded_actuation(vessel, recording)
    executed = executed if measured_actuation else {}
    commanded = [c for c in vessel.channels if c not in executed]
    notes = [f"executed {', '.join(executed)} as measured"] if executed else []
    if commanded:
        notes.append(f"executed {', '.join(commanded)} reconstructed from the orders")
    return recording.counted().t, orders, executed, tuple(notes)


def _steps(
    vessel: Vessel,
    t: Samples,
    orders: dict[str, Samples],
    executed: dict[str, Samples],
    heel: Samples,
) -> tuple[_Steps, Int[np.ndarray, "time"]]:
    """Steps no longer than the vessel's own time scale allows, and the first of each row."""
    longest = _LONGEST_STEP * time_scale(float(vessel.rigid_body.length))
    interval = np.diff(t)
    parts = np.maximum(1, np.ceil(interval / longest - 1e-9)).astype(int)
    rows = np.concatenate([[0], np.cumsum(parts)])
    if rows[-1] > _MOST_STEPS:
        raise UserError(
            f"the recording lasts {t[-1] - t[0]:g} s, {rows[-1]:.2g} steps of at most "
            f"{longest:.2g} s: too long to replay; cut it, or look at the unit of its time"
        )
    spare = _PADDING - rows[-1] % _PADDING  # at least one: the last row is its start
    row = np.repeat(np.arange(len(t)), np.append(parts, spare))
    dt = np.append(np.repeat(interval / parts, parts), np.zeros(spare))
    start = t[row] + (np.arange(len(row)) - rows[row]) * dt
    late = np.pad(t, (0, -len(t) % _PADDING), mode="edge")
    gathered = {
        kind: {c: jnp.asarray(values[row]) for c, values in table.items()}
        for kind, table in (("orders", orders), ("executed", executed))
    }
    steps = _Steps(
        jnp.asarray(start),
        jnp.asarray(dt),
        **gathered,
        heel=jnp.asarray(heel[row]),
        order_times=jnp.append(t[0] - 1e9, late),
        order_values={c: jnp.asarray(_from_before(v, len(late))) for c, v in orders.items()},
    )
    return steps, rows


def _from_before(values: Samples, length: int) -> Samples:
    return np.pad(values, (1, length - len(values)), mode="edge")


@eqx.filter_jit
def _actuation(vessel: Vessel, steps: _Steps) -> _Actuation:
    """The response of every channel, which does not depend on the motion."""
    response, now = {}, {}
    for channel, servo in vessel.servos.items():
        if channel in steps.executed:
            now[channel] = held = steps.executed[channel]
            response[channel] = Response(held, held, held, held)
            continue
        orders = steps.orders[channel]
        if servo.direct:
            now[channel] = held = jax.vmap(servo.target)(orders)
            response[channel] = Response(held, held, held, held)
            continue

        def body(executed: Scalar, step: tuple, servo=servo, channel=channel) -> tuple:
            order, t, dt = step
            history = OrderHistory(t[None], order[None])
            if servo.delay is not None:
                history = OrderHistory(steps.order_times, steps.order_values[channel])
            answer = servo.respond(executed, history, t, dt)
            return answer.final, (answer, executed)

        settled = jnp.asarray(servo.target(orders[0]), float)
        scanned = (orders, steps.t, steps.dt)
        _, (response[channel], now[channel]) = jax.lax.scan(body, settled, scanned)
    return _Actuation(response, now)


@eqx.filter_jit
def _integrated(vessel: Vessel, first: State, steps: _Steps, actuation: _Actuation) -> State:
    """The state at the start of every step."""

    def body(state: State, step: tuple) -> tuple[State, State]:
        t, dt, response, heel = step
        return rk4(vessel, state, response, heeled(vessel.environment, heel), t, dt), state

    scanned = (steps.t, steps.dt, actuation.response, steps.heel)
    return jax.lax.scan(body, first, scanned)[1]


@eqx.filter_jit
def _from_each(
    vessel: Vessel,
    first: State,
    begin: Int[Array, "start"],
    ends: Int[Array, "start horizon"],
    steps: _Steps,
    actuation: _Actuation,
    length: int,
) -> State:
    """The states so many steps after each of several starts."""
    whole = (steps.t, steps.dt, actuation.response, steps.heel)

    def one(state: State, begin: Int[Array, ""], ends: Int[Array, "horizon"]) -> State:
        def body(state: State, k: Int[Array, ""]) -> tuple[State, State]:
            at = jnp.minimum(begin + k, steps.t.size - 1)
            t, dt, response, heel = jax.tree.map(lambda leaf: leaf[at], whole)
            return rk4(vessel, state, response, heeled(vessel.environment, heel), t, dt), state

        states = jax.lax.scan(body, state, jnp.arange(length))[1]
        return jax.tree.map(lambda leaf: leaf[ends], states)

    return jax.vmap(one)(first, begin, ends)


def _windows(
    t: Samples, horizons: Sequence[float], spacing: float
) -> tuple[Int[np.ndarray, "start"], Int[np.ndarray, "start horizon"]]:
    """Rows at which predictions start, and those at which each is compared, -1 for none."""
    near = max(0.05, 0.5 * float(np.median(np.diff(t)))) * (1 + 1e-9)
    begin = np.unique(np.searchsorted(t, np.arange(t[0], t[-1] - min(horizons) + 1e-9, spacing)))
    wanted = t[begin][:, None] + np.asarray(horizons)
    after = np.searchsorted(t, wanted).clip(1, len(t) - 1)
    end = np.where(wanted - t[after - 1] < t[after] - wanted, after - 1, after)
    return begin, np.where(np.abs(t[end] - wanted) <= near, end, -1)


def _true_motion(
    sensors: Sensors, recording: Trajectory, t: Samples
) -> tuple[dict[str, Samples], tuple[str, ...]]:
    """Motion in every row as the sensors' errors leave it, and notes on what was derived."""
    run = recording.counted()
    own_t, motion = run.t, run.motion
    notes: tuple[str, ...] = ()
    unmeasured = [c for c in MOTION_CHANNELS if not np.isfinite(motion[c]).any()]
    derivable = [c for c in unmeasured if c not in ("x", "y")]
    if derivable:
        whole, derivations = prepare_recording(recording)
        notes = tuple(f"initial state: {d.note}" for d in derivations if d.kind == "derived")
    true = {}
    for channel in MOTION_CHANNELS:
        times, values = own_t, motion[channel]
        if channel in derivable:
            times, values = np.asarray(whole.t), np.asarray(getattr(whole, channel))
        elif channel in unmeasured:
            values = np.zeros_like(own_t)
        finite = np.isfinite(values)
        if not finite.any():
            raise UserError(
                f"{recording.name}: {channel} was not recorded, nor anything to derive it from, so "
                "there is no state to start from; map a velocity (u) or positions (x, y)"
            )
        shown = _shown_at(sensors, t, channel)
        true[channel] = _interpolated(shown, times[finite], values[finite])
    return _corrected(sensors, true), notes


def _interpolated(wanted: Samples, times: Samples, values: Samples) -> Samples:
    """Values between samples; beyond the first and the last, on with the slope there.

    A clock that is off shows the beginning or the end of a run outside its recording.
    """
    found = np.interp(wanted, times, values)
    if len(times) < 2:
        return found
    least = 4 * float(np.median(np.diff(times)))
    for edge, beyond in ((0, wanted < times[0]), (-1, wanted > times[-1])):
        if beyond.any():
            span = max(least, float(np.abs(wanted[beyond] - times[edge]).max()))
            near = np.abs(times - times[edge]) <= span
            slope = np.polyfit(times[near] - times[edge], values[near], 1)[0]
            found[beyond] = values[edge] + slope * (wanted[beyond] - times[edge])
    return found


def _supported(
    sensors: Sensors, recording: Trajectory, t: Samples, channel: str
) -> Bool[np.ndarray, "time"]:
    """Rows of the true motion that have a sample of the channel near them."""
    run = recording.counted()
    sampled = run.t[np.isfinite(run.motion[channel])]
    if sampled.size < 2:
        return np.zeros(t.shape, bool)
    wanted = _shown_at(sensors, t, channel)
    after = np.searchsorted(sampled, wanted).clip(1, sampled.size - 1)
    distance = np.minimum(np.abs(wanted - sampled[after - 1]), np.abs(wanted - sampled[after]))
    return distance <= 0.75 * float(np.median(np.diff(sampled)))


def _corrected(sensors: Sensors, shown: dict[str, Samples]) -> dict[str, Samples]:
    """True motion from what sensors without latency show."""
    psi = measured = shown["psi"] + 0.0
    for _ in range(20):  # the compass error depends on the heading itself
        psi = measured - _compass_error(sensors, psi)
    lever = to_earth(sensors.lever_x, sensors.lever_y, psi)
    return shown | {
        "psi": psi,
        "x": shown["x"] - np.asarray(lever[0]),
        "y": shown["y"] - np.asarray(lever[1]),
        "r": shown["r"] - float(sensors.gyro_bias),
    }


def _offsets(sensors: Sensors, true: dict[str, Samples]) -> dict[str, Samples]:
    """What sensors without latency show of true motion."""
    lever = to_earth(sensors.lever_x, sensors.lever_y, true["psi"])
    return true | {
        "psi": true["psi"] + _compass_error(sensors, true["psi"]),
        "x": true["x"] + np.asarray(lever[0]),
        "y": true["y"] + np.asarray(lever[1]),
        "r": true["r"] + float(sensors.gyro_bias),
    }


def _compass_error(sensors: Sensors, psi: Samples) -> Samples:
    turned = psi + float(sensors.heading_offset)
    iron = float(sensors.hard_iron_cos) * np.cos(turned)
    return turned - psi + iron + float(sensors.hard_iron_sin) * np.sin(turned)


def _shown(sensors: Sensors, t: Samples, true: dict[str, Samples]) -> dict[str, Samples]:
    """What the sensors show at the times."""
    lags = sensors.lags(t)
    late = {c: _interpolated(t - np.asarray(lags[c]), t, true[c]) for c in true}
    return _offsets(sensors, late)


def _shown_at(sensors: Sensors, t: Samples, channel: str) -> Samples:
    """When a channel shows what was true at the times: `shown - lag(shown) = t`."""
    clock = sensors.clock or Clock()
    return (t + float(sensors.lags(0.0)[channel])) / (1 - float(clock.rate))


def _rms(difference: dict[str, Samples]) -> dict[str, float]:
    misses = {
        "position": np.hypot(difference["x"], difference["y"]),
        "heading": np.asarray(wrap(difference["psi"])),
        **{c: difference[c] for c in ("u", "v", "r")},
    }
    known = {name: miss[np.isfinite(miss)] for name, miss in misses.items()}
    return {name: float(np.sqrt(np.mean(m**2))) for name, m in known.items() if m.size}


def _plausible(vessel: Vessel, true: dict[str, Samples]) -> bool:
    """Whether all of a motion is finite and that of a craft of this length."""
    length = float(vessel.rigid_body.length)
    finite = all(np.isfinite(values).all() for values in true.values())
    return bool(finite and np.all(plausible_motion(length, true["u"], true["v"], true["r"])))
