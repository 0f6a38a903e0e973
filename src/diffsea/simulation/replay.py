"""What a vessel would have done under a recording's orders, from the recording's own state.

Nothing is corrected on the way: a replay shows how errors of a model grow, over the whole
run (`replay`, `replay_errors`) and from many starts along it (`horizon_errors`).
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError
from diffsea.kinematics import wrap
from diffsea.scales import plausible_motion, time_scale
from diffsea.series import median_interval
from diffsea.simulation.actuation import (
    measured_disturbance,
    over_rows,
    recorded_actuation,
    recorded_shares,
    servo_path,
    true_actuation,
)
from diffsea.simulation.integrate import rk4, rk4_looped
from diffsea.simulation.order_units import order_doubts
from diffsea.simulation.sensed_motion import has_sample_near, shown_motion, true_motion
from diffsea.trajectory import MOTION_CHANNELS, Outcome, Samples, Trajectory
from diffsea.types import MeasuredDisturbance, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.forces import moves_in_measured_wind
from diffsea.vessel.servo import OrderHistory, Response


HORIZONS = (5.0, 20.0, 60.0)  # s
_LONGEST_STEP = 0.3  # of sqrt(L / g): RK4 errs by less than sensors see
_STEP_LIMIT = 10_000_000  # more do not fit into memory
_FEWEST_STEPS = 256  # steps are padded to this times a power of two, so that runs share programs
_COARSE_FACTOR = 16  # of sixteen where spare steps are not taken, until they take memory
_MOST_COARSE = 65_536
_STARTS_TOGETHER = 32  # likewise predictions ahead, which fill a core's vector units


class _Steps(eqx.Module):
    """The integration steps through a recording. Spare ones at the end take no time."""

    t: Float[Array, "step"]  # s, start of the step
    dt: Float[Array, "step"]
    orders: dict[str, Float[Array, "step"]]
    executed: dict[str, Float[Array, "step"]]  # of the channels taken as measured
    disturbance: MeasuredDisturbance
    order_times: Float[Array, "order"]  # s, beginning long before the run
    order_values: dict[str, Float[Array, "order"]]


class _DrivenSteps(NamedTuple):
    """Integration steps with what acts in them, or one of them."""

    t: Float[Array, "*step"]  # s, start of the step
    dt: Float[Array, "*step"]
    response: dict[str, Response]
    disturbance: MeasuredDisturbance


class _ReplayInputs(NamedTuple):
    """A recording made ready to be replayed through a vessel."""

    run: Trajectory  # the rows that count
    orders: dict[str, Samples]
    executed: dict[str, Samples]  # of the channels taken as measured
    steps: _Steps
    rows: Int[np.ndarray, "time"]  # the first step of each row
    response: dict[str, Response]  # of every channel in every step
    now: dict[str, Float[Array, "step"]]  # what it executes from the start of the step on
    shares: dict[str, Samples]  # of its full thrust that each channel makes
    motion: dict[str, Samples]  # as the sensors' errors leave it
    notes: tuple[str, ...]

    @property
    def driven(self) -> _DrivenSteps:
        """The steps with the response of every channel."""
        return _DrivenSteps(self.steps.t, self.steps.dt, self.response, self.steps.disturbance)


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
    vessel = _as_arrays(vessel)
    inputs = _replay_inputs(vessel, recording, measured_actuation)
    states = _integrate(vessel, _states_at(inputs.motion, 0), inputs.driven)
    true = {c: np.asarray(getattr(states, c))[inputs.rows] for c in MOTION_CHANNELS}
    length = float(vessel.rigid_body.length)
    finite = all(np.isfinite(values).all() for values in true.values())
    plausible = finite and np.all(plausible_motion(length, true["u"], true["v"], true["r"]))
    now = {c: np.asarray(now)[inputs.rows] for c, now in inputs.now.items()}
    t = inputs.run.t
    shown = shown_motion(vessel.sensors, t, true, inputs.shares)
    return Trajectory(
        t,
        *[shown[c] for c in MOTION_CHANNELS],
        commanded=inputs.orders,
        executed=now | inputs.executed,
        extra={},
        valid=np.ones(t.shape, bool),
        outcome=int(Outcome.COMPLETED if plausible else Outcome.DIVERGED),
        name=recording.name,
        provenance=(
            f"predicted by {vessel.name!r} from the state at t = {t[0]:g} s",
            *inputs.notes,
        ),
    )


def replay_errors(predicted: Trajectory, recording: Trajectory) -> dict[str, float]:
    """Root-mean-square difference of a replay and its recording, where both have values.

    `position` (m), `heading` (rad), `u`, `v` (m/s) and `r` (rad/s); a channel that was not
    measured is absent.
    """
    measured = recording.counted()
    if not np.array_equal(measured.t, np.asarray(predicted.t)):
        raise ValueError("a replay is compared with the recording that it was made from")
    shown = {c: np.asarray(getattr(predicted, c)) for c in MOTION_CHANNELS}
    return rms_errors({c: shown[c] - measured.motion[c] for c in MOTION_CHANNELS})


def horizon_errors(
    vessel: Vessel,
    recording: Trajectory,
    horizons: Sequence[float] = HORIZONS,
    spacing: float = 10.0,
    measured_actuation: bool = True,
    states: Mapping[str, Samples] | None = None,
) -> dict[float, dict[str, float]]:
    """Errors of predictions so many seconds ahead, started every `spacing` s along the run.

    For each horizon (s) that the recording is long enough for: the names of `replay_errors`,
    root mean square over the starts, and `starts`, how many there were. Where predictions diverged
    the errors are those of the others, and `diverged` is how many.

    Arguments:
        states: true motion in the rows that count, by channel, in which predictions begin; what was
            recorded, and what is derived from it, where it is NaN or None.
    """
    misses = prediction_misses(vessel, recording, horizons, spacing, measured_actuation, states)
    errors = {}
    for horizon, found in misses.items():
        diverged = int(np.isinf(np.stack(list(found.values()))).any(0).sum())
        told = {"diverged": diverged} if diverged else {}
        errors[horizon] = {**rms_errors(found), **told, "starts": len(found["x"])}
    return errors


def prediction_misses(
    vessel: Vessel,
    recording: Trajectory,
    horizons: Sequence[float] = HORIZONS,
    spacing: float = 10.0,
    measured_actuation: bool = True,
    states: Mapping[str, Samples] | None = None,
) -> dict[float, dict[str, Float[np.ndarray, "start"]]]:
    """Predicted less measured motion so many seconds after each of many starts.

    For each horizon (s) that the recording is long enough for, by motion channel, in SI units
    (headings not wrapped); NaN where a channel was not measured, infinite where the prediction
    diverged: where its motion is none of a craft of that length. `states` are those of
    `horizon_errors`.
    """
    t = recording.counted().t
    if t[0] + min(horizons) > t[-1]:
        return {}
    vessel = _as_arrays(vessel)
    inputs = _replay_inputs(vessel, recording, measured_actuation)
    rows, motion = inputs.rows, inputs.motion
    begin, end = spans_ahead(t, horizons, spacing)
    ends = np.where(end >= 0, rows[np.maximum(end, 0)] - rows[begin][:, None], 0)
    given = {} if states is None else states
    first = {c: np.where(np.isfinite(v := given.get(c, motion[c])), v, motion[c]) for c in motion}
    reached = _predict_from_each(vessel, inputs, first, begin, ends)
    length = float(vessel.rigid_body.length)
    known = {c: has_sample_near(vessel.sensors, inputs.run, c) for c in MOTION_CHANNELS}
    found = {}
    for k, horizon, counted in horizons_within(t, horizons, end):
        at = end[counted, k]
        ahead = {c: getattr(reached, c)[counted, k] for c in MOTION_CHANNELS}
        sound = plausible_motion(length, *(ahead[c] for c in "uvr")) & np.all(
            np.isfinite([ahead[c] for c in ("x", "y", "psi")]), axis=0
        )
        misses = {}
        for c in MOTION_CHANNELS:
            missed = np.where(sound, ahead[c] - motion[c][at], np.inf)
            misses[c] = np.where(known[c][at], missed, np.nan)
        found[horizon] = misses
    return found


def spans_ahead(
    t: Samples, horizons: Sequence[float], spacing: float
) -> tuple[Int[np.ndarray, "start"], Int[np.ndarray, "start horizon"]]:
    """Rows at which predictions start, and those at which each is compared, -1 for none."""
    near = max(0.05, 0.5 * median_interval(t)) * (1 + 1e-9)
    begin = np.unique(np.searchsorted(t, np.arange(t[0], t[-1] - min(horizons) + 1e-9, spacing)))
    wanted = t[begin][:, None] + np.asarray(horizons)
    after = np.searchsorted(t, wanted).clip(1, len(t) - 1)
    end = np.where(wanted - t[after - 1] < t[after] - wanted, after - 1, after)
    return begin, np.where(np.abs(t[end] - wanted) <= near, end, -1)


def horizons_within(
    t: Samples, horizons: Sequence[float], end: Int[np.ndarray, "start horizon"]
) -> Iterator[tuple[int, float, Bool[np.ndarray, "start"]]]:
    """The horizons (s) for which times are long enough, by number, and which starts reach a row."""
    for number, horizon in enumerate(horizons):
        if t[0] + horizon <= t[-1]:
            yield number, float(horizon), end[:, number] >= 0


def _replay_inputs(
    vessel: Vessel, recording: Trajectory, measured_actuation: bool
) -> _ReplayInputs:
    run = recording.counted()
    orders, executed = recorded_actuation(vessel, run)
    executed = executed if measured_actuation else {}
    commanded = [c for c in vessel.channels if c not in executed]
    disturbance = measured_disturbance(run)
    notes = order_doubts(vessel, run, executed)
    notes += [f"executed {', '.join(executed)} as measured"] if executed else []
    if commanded:
        notes.append(f"executed {', '.join(commanded)} reconstructed from the orders")
    blows = bool(np.any(disturbance.wind_north) or np.any(disturbance.wind_east))
    if moves_in_measured_wind(vessel.forces):
        notes.append("in the wind as measured" if blows else "in still air: no wind was measured")
    elif blows:
        notes.append("not in the wind that was measured: the vessel file has no wind without speed")
    acting = {
        channel: np.asarray(
            true_actuation(vessel, channel, jnp.asarray(run.t), jnp.asarray(values))
        )
        for channel, values in over_rows(run, orders, executed).items()
    }
    steps, rows = _integration_steps(vessel, run, orders, acting, disturbance)
    shares = recorded_shares(vessel, run)
    motion, derived = true_motion(vessel.sensors, run, shares)
    made_of = run, orders, executed, steps, rows, *_actuate(vessel, steps)
    return _ReplayInputs(*made_of, shares, motion, (*notes, *derived))


def _integration_steps(
    vessel: Vessel,
    run: Trajectory,
    orders: dict[str, Samples],
    executed: dict[str, Samples],
    disturbance: MeasuredDisturbance,
) -> tuple[_Steps, Int[np.ndarray, "time"]]:
    """Steps no longer than the vessel's own time scale allows, and the first of each row."""
    t, interval = run.t, np.diff(run.t)
    longest = _LONGEST_STEP * time_scale(float(vessel.rigid_body.length))
    parts = np.maximum(1, np.ceil(interval / longest - 1e-9)).astype(int)
    rows = np.concatenate([[0], np.cumsum(parts)])
    if rows[-1] > _STEP_LIMIT:
        raise UserError(
            f"the recording lasts {t[-1] - t[0]:g} s, {rows[-1]:.2g} steps of at most "
            f"{longest:.2g} s: too long to replay; cut it, or look at the unit of its time"
        )
    spare = _padded(rows[-1] + 1) - rows[-1]  # at least one: the last row is its start
    row = np.repeat(np.arange(len(t)), np.append(parts, spare))
    dt = np.append(np.repeat(interval / parts, parts), np.zeros(spare))
    late = _padded(len(t)) - len(t)
    steps = _Steps(
        t=jnp.asarray(t[row] + (np.arange(len(row)) - rows[row]) * dt),
        dt=jnp.asarray(dt),
        orders={c: jnp.asarray(values[row]) for c, values in orders.items()},
        executed={c: jnp.asarray(values[row]) for c, values in executed.items()},
        disturbance=jax.tree.map(lambda series: jnp.asarray(series[row]), disturbance),
        order_times=jnp.append(t[0] - 1e9, np.pad(t, (0, late), mode="edge")),
        order_values={
            c: jnp.asarray(np.pad(values, (1, late), mode="edge")) for c, values in orders.items()
        },
    )
    return steps, rows


def _as_arrays(vessel: Vessel) -> Vessel:
    """The vessel with its numbers as arrays: as floats they would be part of compiled programs."""
    return jax.tree.map(jnp.asarray, vessel)


def _padded(count: int, factor: int = 2) -> int:
    """Steps with spare ones, not fewer than `count`: a size of a geometric series."""
    size = _FEWEST_STEPS
    while size < count:
        size *= factor if size < _MOST_COARSE else 2
    return size


@eqx.filter_jit
def _actuate(
    vessel: Vessel, steps: _Steps
) -> tuple[dict[str, Response], dict[str, Float[Array, "step"]]]:
    """Response and executed values of every channel, which do not depend on the motion."""
    response, now = {}, {}
    for channel, servo in vessel.servos.items():
        if channel in steps.executed:
            done = now[channel] = steps.executed[channel]
            response[channel] = Response(done, done, done, done)
        else:
            history = OrderHistory(steps.order_times, steps.order_values[channel])
            orders = steps.orders[channel]
            response[channel], now[channel] = servo_path(servo, orders, steps.t, steps.dt, history)
    return response, now


@eqx.filter_jit
def _integrate(vessel: Vessel, first: State, steps: _DrivenSteps) -> State:
    """The state at the start of every step."""

    def body(state: State, step: _DrivenSteps) -> tuple[State, State]:
        environment = dataclasses.replace(vessel.environment, disturbance=step.disturbance)
        return rk4(vessel, state, step.response, environment, step.t, step.dt), state

    return jax.lax.scan(body, first, steps)[1]


def _predict_from_each(
    vessel: Vessel,
    inputs: _ReplayInputs,
    motion: Mapping[str, Samples],
    begin: Int[np.ndarray, "start"],
    ends: Int[np.ndarray, "start horizon"],
) -> State:
    """The states so many steps after those of a motion in the rows at which predictions begin."""
    steps, last, found = inputs.driven, len(begin) - 1, []
    spare = _padded(steps.t.size, _COARSE_FACTOR) - steps.t.size
    steps = jax.tree.map(lambda leaf: jnp.asarray(np.pad(leaf, (0, spare))), steps)
    for k in range(0, len(begin), _STARTS_TOGETHER):
        # Spare starts repeat the last one.
        together = np.arange(k, k + _STARTS_TOGETHER).clip(max=last)
        rows = begin[together]
        spans = jnp.asarray(inputs.rows[rows]), jnp.asarray(ends[together])
        found.append(_integrate_from_each(vessel, _states_at(motion, rows), *spans, steps))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: last + 1], *found)


@eqx.filter_jit
def _integrate_from_each(
    vessel: Vessel,
    first: State,
    begin: Int[Array, "start"],
    ends: Int[Array, "start horizon"],
    steps: _DrivenSteps,
) -> State:
    """The states so many steps after each of several starts along a run.

    How many steps are taken is no part of the program: no state is kept that is not asked for.
    """

    def next_state(state: State, at: Int[Array, ""]) -> State:
        step = jax.tree.map(lambda leaf: leaf[at], steps)
        environment = dataclasses.replace(vessel.environment, disturbance=step.disturbance)
        return rk4_looped(vessel, state, step.response, environment, step.t, step.dt)

    def body(k: Int[Array, ""], carry: tuple[State, State]) -> tuple[State, State]:
        state, found = carry
        found = jax.tree.map(lambda f, s: jnp.where(ends == k, s[:, None], f), found, state)
        at = jnp.minimum(begin + k, steps.t.size - 1)
        return jax.vmap(next_state)(state, at), found

    first = jax.tree.map(lambda value: jnp.asarray(value, float), first)
    none = jax.tree.map(lambda value: jnp.broadcast_to(value[:, None], ends.shape), first)
    return jax.lax.fori_loop(0, ends.max() + 1, body, (first, none))[1]


def _states_at(motion: Mapping[str, Samples], rows: Int[np.ndarray, "start"] | int) -> State:
    return State(*(jnp.asarray(motion[c][rows]) for c in MOTION_CHANNELS))


def rms_errors(difference: Mapping[str, Samples]) -> dict[str, float]:
    """Root mean squares of the known differences by channel, by the names of `replay_errors`."""
    misses = {
        "position": np.hypot(difference["x"], difference["y"]),
        "heading": np.asarray(wrap(difference["psi"])),
        **{c: difference[c] for c in ("u", "v", "r")},
    }
    known = {name: miss[np.isfinite(miss)] for name, miss in misses.items()}
    return {name: float(np.sqrt(np.mean(m**2))) for name, m in known.items() if m.size}
