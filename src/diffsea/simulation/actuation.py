"""What acts along a recording: orders, executed actuation, heel and wind."""

import dataclasses
from collections.abc import Container, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.series import hold_last, interpolate_missing
from diffsea.trajectory import MOTION_CHANNELS, Samples, Trajectory
from diffsea.types import MeasuredDisturbance, Scalar, State, as_inputs
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import largest_order
from diffsea.vessel.forces import Force
from diffsea.vessel.servo import OrderHistory, Response, Servo


# Correlation of an actuator's next step with its last above which it moves between its samples:
# that of steps at random is about zero, that of a slow lag near one.
_MOVING_CORRELATION = 0.3
# Share of an actuator's steps explained by orders of the same instant above which it holds them.
_AT_ONCE_SHARE = 0.5
_ROW_SIDE = 1e-7  # s, far below any row and far above what rounding does to times of 1e4 s
_LONGEST_GAP = 5.0  # sampling intervals of an actuator's own: a longer gap loses it


def recorded_actuation(
    vessel: Vessel, recording: Trajectory
) -> tuple[dict[str, Samples], dict[str, Samples]]:
    """Orders of every channel, and executed values of those that were measured throughout.

    A channel without orders takes its executed values for them. Missing values hold the one
    before, leading ones the first; executed ones for five of their own sampling intervals. Angles
    that may go round count their turns: none is more than half a turn from the one before.

    Raises:
        UserError: a channel of the vessel has neither.
    """
    run = recording.counted()
    orders, executed = {}, {}
    for channel in vessel.channels:
        done = run.executed.get(channel)
        order = run.commanded.get(channel, done)
        if order is None:
            have = ", ".join([*run.commanded, *run.executed]) or "none"
            raise UserError(
                f"{run.name}: the vessel's actuator channel {channel!r} has neither a "
                f"cmd_{channel} nor an exec_{channel} column (it has: {have}); add it, or map "
                "the file's own column to it with --mapping; where it never changed, say so there: "
                f"cmd_{channel} = {{ constant = VALUE }}"
            )
        if not np.isfinite(order).any():
            raise UserError(f"{run.name}: cmd_{channel} has no value at all")
        counted = np.unwrap if vessel.servos[channel].endless else np.asarray
        orders[channel] = counted(hold_last(order))
        if done is not None and _measured_throughout(run.t, done):
            executed[channel] = counted(hold_last(done))
    return orders, executed


def with_common_feedback(
    vessel: Vessel, recordings: Sequence[Trajectory], stale: Container[str] = ()
) -> tuple[list[Trajectory], list[str]]:
    """Recordings with the measured actuation that all of them have, and sentences on the rest.

    What a model is fitted to and judged by is of one kind throughout. A channel counts as measured
    where every recording has it without long gaps; elsewhere it is left out of those that have
    orders for it, from which what was executed is then reconstructed.

    Arguments:
        stale: channels that are not to count as measured in any case.
    """
    used = [recorded_actuation(vessel, run)[1] for run in recordings]
    left_out, lacking = set[str](), dict[tuple[str, ...], list[str]]()
    for channel in vessel.channels:
        known = [channel in own and channel not in stale for own in used]
        if not all(known) and any(channel in run.executed for run in recordings):
            left_out.add(channel)
            names = [run.name for run, there in zip(recordings, known, strict=True) if not there]
            lacking.setdefault(tuple(names), []).append(channel)
    common = [
        dataclasses.replace(
            run,
            executed={
                channel: values
                for channel, values in run.executed.items()
                if channel not in left_out or channel not in run.commanded
            },
        )
        for run in recordings
    ]
    notes = [
        f"{', '.join(f'exec_{channel}' for channel in channels)} is not known throughout in "
        f"{', '.join(names)}: what was executed is reconstructed from the orders"
        for names, channels in lacking.items()
    ]
    return (common if left_out else list(recordings)), notes


def _measured_throughout(t: Samples, values: Samples) -> bool:
    """Whether no stretch of the run (times in s) lacks values for long.

    Time of which the recording has no row at all does not count: orders are unknown there, too.
    """
    steps = np.diff(t)
    clock = np.append(0.0, np.cumsum(np.minimum(steps, np.median(steps)))) if len(steps) else t
    known = clock[np.isfinite(values)]
    if not len(known):
        return False
    usual = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    longest = np.diff([clock[0], *known, clock[-1]]).max()
    return bool(longest <= _LONGEST_GAP * usual * (1 + 1e-9))


def over_rows(
    recording: Trajectory, orders: dict[str, Samples], executed: dict[str, Samples]
) -> dict[str, Samples]:
    """Executed values as they act from each row to the next.

    Both are those of `recorded_actuation`.

    What moves in steps holds until the next value. What is on its way from one sample to the next
    (a rudder that slews, a thruster that spools up) has been sampled: held, it would act half a
    sampling interval late, so its mean over the row is taken, by straight lines.
    """
    run = recording.counted()
    out = {}
    for channel, values in executed.items():
        known = np.isfinite(run.executed[channel])
        order = orders[channel][known] if channel in run.commanded else None
        out[channel] = values
        if _moves_between_samples(values[known], order):
            sampled = np.where(known, values, np.nan)
            out[channel] = _row_means(interpolate_missing(run.t, sampled))
    return out


def _row_means(values: Samples) -> Samples:
    """Mean of each value and the next, as they act until then; the last stays."""
    return 0.5 * (values + np.append(values[1:], values[-1]))


def _moves_between_samples(values: Samples, orders: Samples | None) -> bool:
    """Whether a measured actuator moves between its samples, rather than at them.

    Its steps then follow one another. White noise is taken out of their correlations: it adds to
    that of a step with itself, and takes half as much from that with the next.
    """
    steps = np.diff(values)
    if len(steps) < 3 or not steps.any():
        return False
    itself, following, after = (float(steps[k:] @ steps[: len(steps) - k]) for k in range(3))
    noise = max(after - following, 0.0)
    if max(following, after) <= _MOVING_CORRELATION * max(itself - 2 * noise, 0.0):
        return False
    ordered = np.zeros(len(steps)) if orders is None else np.diff(orders)
    if not np.isfinite(ordered).all() or not ordered.any():
        return True
    return float(steps @ ordered) ** 2 < _AT_ONCE_SHARE * itself * float(ordered @ ordered)


def values_between_rows(
    t: Float[Array, "value"], rows: Float[Array, "row"], values: Float[Array, "row"]
) -> Float[Array, "value"]:
    """Values of rows (s) at other times, by straight lines; on a row, with the mean of both slopes.

    So that there is a derivative by the times.
    """
    before, after = (jnp.interp(t + side * _ROW_SIDE, rows, values) for side in (-1, 1))
    return 0.5 * (before + after)


def true_actuation(
    vessel: Vessel, channel: str, t: Float[Array, "row"], recorded: Float[Array, "row"]
) -> Float[Array, "row"]:
    """What a channel executed, of what was recorded in rows that begin at `t` s.

    As the vessel's sensors say that the record is off; it is the record to the last bit where they
    say nothing. A record that is late tells at `t` what will be in it later: this is for whole
    recordings.
    """
    error = vessel.sensors.feedback.get(channel)
    if error is None:
        return recorded
    later = values_between_rows(t + error.delay, t, recorded)
    on_time = values_between_rows(t, t, recorded)
    return (recorded + (later - on_time) - error.offset) / (1 + error.scale)


def thrust_shares(
    vessel: Vessel, executed: Mapping[str, Float[Array, "*row"] | Scalar]
) -> dict[str, Float[Array, "*row"]]:
    """What share of its full thrust, ahead or astern, each propulsion channel makes at rest.

    From executed values in the channels' units; of a channel that states no limit, of what a
    vessel of its size needs.
    """
    shares = {}
    for channel, thrust_of in vessel.thrusts_at_rest.items():
        servo, usual = vessel.servos[channel], largest_order(vessel, [channel])
        neutral = 0.0 if servo.neutral is None else servo.neutral
        ahead = jnp.abs(thrust_of(neutral + usual if servo.upper is None else servo.upper))
        astern = jnp.abs(thrust_of(neutral - usual if servo.lower is None else servo.lower))
        thrust = thrust_of(executed[channel])
        full = jnp.where((thrust > 0) & (ahead > 0) | (astern == 0), ahead, astern)
        shares[channel] = jnp.abs(thrust) / full
    return shares


def recorded_shares(vessel: Vessel, recording: Trajectory) -> dict[str, Samples]:
    """`thrust_shares` in the rows of a recording that count, if a sensor depends on them.

    Of measured actuation where there is any, else of what orders settle to.
    """
    if not vessel.sensors.estimated_headings:
        return {}
    orders, executed = recorded_actuation(vessel, recording)
    done = {
        c: jnp.asarray(executed[c])
        if c in executed
        else jax.vmap(vessel.servos[c].target)(jnp.asarray(order))
        for c, order in orders.items()
    }
    return {c: np.asarray(share) for c, share in thrust_shares(vessel, done).items()}


def measured_disturbance(recording: Trajectory) -> MeasuredDisturbance:
    """Heel and true wind: means over each row that counts until the next, missing samples
    interpolated; zero where not measured.
    """
    run = recording.counted()

    def over_each_row(series: Samples) -> Samples:
        if not np.isfinite(series).any():
            return np.zeros(len(run.t))
        return _row_means(interpolate_missing(run.t, series))  # it is held over a row

    nothing = np.full(len(run.t), np.nan)
    heel, *wind = (run.extra.get(c, nothing) for c in ("phi", "wind_speed", "wind_direction"))
    speed, comes_from = wind
    north, east = -speed * np.cos(comes_from), -speed * np.sin(comes_from)
    return MeasuredDisturbance(over_each_row(heel), over_each_row(north), over_each_row(east))


def servo_path(
    servo: Servo,
    orders: Float[Array, "step"],
    t: Float[Array, "step"],
    dt: Float[Array, "step"],
    history: OrderHistory,
) -> tuple[Response, Float[Array, "step"]]:
    """What a servo that has settled to the first order makes of orders along a recording.

    Arguments:
        orders: in force in each step, which begins at `t` s and takes `dt` s.
        history: all orders, from long before the run on, for a servo with a delay.

    Returns:
        The response in every step, and what is executed from the start of the step on.
    """
    if servo.direct:
        executed = jnp.asarray(jax.vmap(servo.target)(orders))
        return Response(executed, executed, executed, executed), executed

    def body(
        executed: Float[Array, "..."], step: tuple
    ) -> tuple[Float[Array, "..."], tuple[Response, Float[Array, "..."]]]:
        order, start, span = step
        given = OrderHistory(start[None], order[None]) if servo.delay is None else history
        answer = servo.respond(executed, given, start, span)
        return jnp.asarray(answer.final), (answer, executed)

    settled = jnp.asarray(servo.target(orders[0]), float)
    return jax.lax.scan(body, settled, (orders, t, dt))[1]


def executed_by(servo: Servo, t: Samples, orders: Samples) -> Samples:
    """What a servo executes in the rows of a recording whose orders were given at times `t` (s)."""
    history = OrderHistory(jnp.append(t[0] - 1e9, t), jnp.append(orders[0], orders))
    dt = jnp.asarray(np.append(np.diff(t), 0.0))
    path = servo_path(servo, jnp.asarray(orders), jnp.asarray(t), dt, history)
    return np.asarray(path[1], float)


def how_actuated(vessel: Vessel, recordings: Sequence[Trajectory]) -> dict[str, str]:
    """Whether what each channel executed is measured or reconstructed from its orders.

    Recordings that are fitted together take a channel as measured only where all have measured
    it; where some have, they are told.
    """
    done = [(run.name, recorded_actuation(vessel, run)[1]) for run in recordings]
    out = {}
    for channel in vessel.channels:
        lacking = [name for name, executed in done if channel not in executed]
        out[channel] = "reconstructed" if lacking else "measured"
        if 0 < len(lacking) < len(done):
            out[channel] += f" (not measured throughout in {', '.join(lacking)})"
    return out


@eqx.filter_jit
def _yaw_moments(
    vessel: Vessel, state: State, executed: dict[str, Scalar], t: Float[Array, "row"]
) -> Float[Array, "row"]:
    def moment(state: State, executed: dict[str, Scalar], t: Scalar) -> Float[Array, ""]:
        forces = vessel.breakdown(state, executed, vessel.environment, t)
        return jnp.asarray(sum((forces[name] for name in vessel.actuators), Force()).N, float)

    return jnp.asarray(jax.vmap(moment)(state, executed, t))


def yaw_moments(vessel: Vessel, run: Trajectory) -> Samples:
    """Yaw moment (N m, positive to starboard) of all actuators, in every row of a run.

    They act as executed, in the vessel's own environment.
    """
    rows = run.counted()
    state = State(*(jnp.asarray(getattr(rows, channel)) for channel in MOTION_CHANNELS))
    executed: dict[str, Scalar] = {c: jnp.asarray(rows.executed[c]) for c in vessel.channels}
    return np.asarray(_yaw_moments(as_inputs(vessel), state, executed, jnp.asarray(rows.t)), float)
