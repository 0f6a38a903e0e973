"""Numbers of the standard trials: turning circle, zig-zag and stopping.

Every function takes one trajectory, reads each number off at an interpolated instant and
can be differentiated, in both modes, with respect to the trajectory and the times of the
orders; under `vmap` it works on a batch. Definitions follow IMO MSC.137(76) and
MSC/Circ.1053. A number that the run does not contain is NaN with derivative zero.

Rows that do not count are brought to the end first. Those of a simulated trial repeat the
row before and do no harm: with `spare_rows_repeat` they stay, which takes half of the time.

The axes are those of the approach: distances are along the original heading and, for a
turn, towards the side that the vessel turns to. Angles are positive that way too.
"""

import functools
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.kinematics import to_body, to_earth
from diffsea.metrics.crossings import (
    AbstractCurve,
    Crossing,
    Curve,
    DifferencedCurve,
    first_crossing,
    first_row,
    highest,
    interval_at,
    valid_rows,
    value_at,
    value_or_nan,
    with_corners,
)
from diffsea.trajectory import Trajectory
from diffsea.types import Scalar


APPROACH_SECONDS = 10.0  # before the execute, whose mean is the approach speed
# IMO MSC.137(76) section 5.3.2: the initial turning ability is judged at this change.
INITIAL_TURN = math.radians(10)
# A zig-zag that reverses at 10 deg reverses at 10 deg give or take a sample.
_REVERSAL_MARGIN = math.radians(1)
# Spread of the points, relative to its larger axis, below which they lie on a line.
_FLATTEST = 1e-6
_AROUND_PEAK = 4  # samples to either side of the largest yaw rate, for differences beside it


def fitted_radius(
    x: Float[Array, "time"], y: Float[Array, "time"], chosen: Bool[Array, "time"]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Radius (m) of the circle nearest to the chosen points, and whether there is one.

    The algebraic fit of Kasa (1976): least squares of x^2 + y^2 = 2ax + 2by + c about the
    centroid, which is linear. Position noise of standard deviation s biases the radius R by
    a relative amount of order (s/R)^2, more on short arcs; ask for a quarter of a circle.
    """
    finite = [jnp.where(jnp.isfinite(p), p, 0.0) for p in (x, y)]
    weight = jnp.where(chosen, 1.0, 0.0) / jnp.maximum(jnp.sum(chosen, dtype=float), 1)
    x, y = (jnp.where(chosen, p - jnp.sum(weight * p), 0.0) for p in finite)
    square = x**2 + y**2
    xx, xy, yy, xz, yz, mean = (
        jnp.sum(weight * p) for p in (x * x, x * y, y * y, x * square, y * square, square)
    )
    determinant = xx * yy - xy**2
    found = determinant > _FLATTEST * (xx + yy) ** 2
    # Division and root see harmless numbers where there is no circle: no NaN in derivatives.
    safe = jnp.where(found, determinant, 1.0)
    a, b = (yy * xz - xy * yz) / (2 * safe), (xx * yz - xy * xz) / (2 * safe)
    return jnp.sqrt(jnp.where(found, a**2 + b**2 + mean, 1.0)), found


def turning_metrics(
    trajectory: Trajectory,
    execute_time: Scalar,
    side: Scalar,
    psi0: Scalar | None = None,
    *,
    spare_rows_repeat: bool = False,
) -> dict[str, Float[Array, ""]]:
    """Turning circle after one order that is held to the end of the record.

    **Arguments:** `execute_time` (s) of the order; `side` +1 to starboard, -1 to port;
    `psi0` (rad) the original heading, that at the execute if absent.

    **Returns:** `advance`, `transfer` at 90 deg and `tactical_diameter` at 180 deg change
    of heading (m); the largest `max_advance` and `max_transfer` (m); `time_to_90` and
    `time_to_180` (s); `steady_turning_diameter` (m), `steady_yaw_rate` (rad/s) and
    `final_speed` (m/s) of the steady part; `speed_loss`, the fraction of the approach speed
    lost by then; `peak_yaw_rate` (rad/s) and `approach_speed` (m/s).

    The steady part is what follows 360 deg, or in a shorter record the last 180 deg but
    nothing before 180 deg; it needs 270 deg in all.
    """
    run = _refer_to_execute(trajectory, execute_time, side, psi0, spare_rows_repeat)
    turn, start = run.heading, execute_time
    quarters = jnp.array([0.5, 1.0, 1.5]) * math.pi
    crossings = jax.vmap(lambda angle: first_crossing(turn, angle, +1, after=start))(quarters)
    to_90, to_180, to_270 = map(Crossing, crossings.time, crossings.found)
    until_180 = jnp.where(to_180.found, to_180.time, jnp.inf)
    until_270 = jnp.where(to_270.found, to_270.time, jnp.inf)
    foremost = highest(run.along, 1.0, after=start, before=until_180)
    outermost = highest(run.across, 1.0, after=start, before=until_270)
    approach = _approach_speed(run, start)
    steady = _steady_turn(run)
    return {
        "advance": value_or_nan(value_at(run.along, to_90.time), to_90.found),
        "transfer": value_or_nan(value_at(run.across, to_90.time), to_90.found),
        "tactical_diameter": value_or_nan(value_at(run.across, to_180.time), to_180.found),
        "max_advance": value_or_nan(foremost.value, foremost.found),
        "max_transfer": value_or_nan(outermost.value, outermost.found),
        "time_to_90": value_or_nan(to_90.time - start, to_90.found),
        "time_to_180": value_or_nan(to_180.time - start, to_180.found),
        **steady,
        "speed_loss": value_or_nan(
            1 - steady["final_speed"] / _one_unless_positive(approach), approach > 0
        ),
        "peak_yaw_rate": _peak_yaw_rate(run.yaw, start),
        "approach_speed": approach,
    }


def zigzag_metrics(
    trajectory: Trajectory,
    switch_times: Float[Array, "switch"],
    psi0: Scalar | None = None,
    side: Scalar = 1.0,
    *,
    spare_rows_repeat: bool = False,
) -> dict[str, Float[Array, ""]]:
    """Zig-zag with its orders at the switch times.

    **Arguments:** `switch_times` (s) the first execute and then every reversal, NaN for
    one that did not happen; `psi0` (rad) the original heading, that at the first execute if
    absent; `side` of the first order, +1 starboard, -1 port.

    **Returns:** `overshoot_k` (rad), how far the heading goes beyond the heading at
    reversal k before it turns back, and `time_to_check_yaw_k` (s) until then;
    `initial_turning_distance` (m) made good along the original course, and
    `initial_turning_time` (s), until the heading has changed by 10 deg under the first
    order; `reach_time` (s) from the execute until the heading is the original one again;
    `period` (s) between reversals 1 and 3; `peak_yaw_rate` (rad/s) either way;
    `approach_speed` (m/s).
    """
    # Zero for those that did not happen, and at least two of them: no NaN in derivatives.
    times = jnp.atleast_1d(jnp.asarray(switch_times))
    missing = max(0, 2 - times.shape[0])
    times = jnp.concatenate([times, jnp.full((missing,), jnp.nan, times.dtype)])
    happened = jnp.isfinite(times)
    times = jnp.where(happened, times, 0.0)
    start, first = times[0], times[1]
    run = _refer_to_execute(trajectory, start, side, psi0, spare_rows_repeat)
    turned = first_crossing(run.heading, INITIAL_TURN, +1, after=start)
    under_order = ~happened[1] | (value_at(run.heading, first) > INITIAL_TURN - _REVERSAL_MARGIN)
    turned = Crossing(turned.time, turned.found & under_order)
    back = first_crossing(run.heading, 0.0, -1, after=first)
    starts = times[1:]
    ends = jnp.append(jnp.where(happened[2:], times[2:], jnp.inf), jnp.inf)
    senses = jnp.where(jnp.arange(starts.shape[0]) % 2 == 0, 1.0, -1.0)
    peaks = jax.vmap(highest, (None, 0, 0, 0))(run.heading, senses, starts, ends)
    at_reversal = jax.vmap(value_at, (None, 0))(run.heading, starts)
    found = peaks.found & happened[1:]
    beyond = value_or_nan(senses * (peaks.value - at_reversal), found)
    checked = value_or_nan(peaks.time - starts, found)
    period = jnp.full((), jnp.nan)
    if times.shape[0] >= 4:
        period = value_or_nan(times[3] - times[1], happened[1] & happened[3])
    return {
        **{f"overshoot_{k + 1}": angle for k, angle in enumerate(beyond)},
        **{f"time_to_check_yaw_{k + 1}": time for k, time in enumerate(checked)},
        "initial_turning_distance": value_or_nan(value_at(run.along, turned.time), turned.found),
        "initial_turning_time": value_or_nan(turned.time - start, turned.found),
        "reach_time": value_or_nan(back.time - start, back.found & happened[1]),
        "period": period,
        "peak_yaw_rate": _peak_yaw_rate(run.yaw, start, times),
        "approach_speed": _approach_speed(run, start),
    }


def stopping_metrics(
    trajectory: Trajectory,
    execute_time: Scalar,
    psi0: Scalar | None = None,
    *,
    spare_rows_repeat: bool = False,
) -> dict[str, Float[Array, ""]]:
    """Stopping trial: from the order until the surge velocity passes zero.

    **Returns:** `track_reach` (m) along the path; `head_reach` (m) along the original
    heading; `lateral_deviation` (m), positive to starboard; `stopping_time` (s);
    `heading_change` (rad) until then; `approach_speed` (m/s).
    """
    run = _refer_to_execute(trajectory, execute_time, 1.0, psi0, spare_rows_repeat)
    # A simulated run ends at the stop, with a speed that rounding may leave above zero.
    stopped = 1e-12 * jax.lax.stop_gradient(jnp.abs(value_at(run.surge, execute_time)))
    stop = first_crossing(run.surge, stopped, -1, after=execute_time)
    travelled = _distance_between(run, execute_time, stop.time)
    return {
        "track_reach": value_or_nan(travelled, stop.found),
        "head_reach": value_or_nan(value_at(run.along, stop.time), stop.found),
        "lateral_deviation": value_or_nan(value_at(run.across, stop.time), stop.found),
        "stopping_time": value_or_nan(stop.time - execute_time, stop.found),
        "heading_change": value_or_nan(value_at(run.heading, stop.time), stop.found),
        "approach_speed": _approach_speed(run, execute_time),
    }


class _Position(AbstractCurve):
    """A position along an axis of the approach; its derivative is the velocity along that axis."""

    t: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # s
    value: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # m
    u: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # m/s
    v: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # m/s, towards the side
    heading: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # rad, towards the side
    axis: int = eqx.field(static=True)  # 0 along, 1 across

    def rates(self, row: Int[Array, ""], before: int, after: int) -> Float[Array, "near"]:
        rows = self.rows(row, before, after)
        north, east = to_earth(self.u[rows], self.v[rows], self.heading[rows])
        return jnp.asarray(east if self.axis else north)


class _TrialFrame(NamedTuple):
    """A trajectory referred to the position and heading at the execute."""

    heading: Curve  # rad, change towards the side
    along: _Position  # m, in the direction of the original heading
    across: _Position  # m, towards the side
    surge: DifferencedCurve  # m/s
    sway: DifferencedCurve  # m/s, towards the side
    yaw: DifferencedCurve  # rad/s, towards the side
    speed: Float[Array, "time"]  # m/s
    counts: Bool[Array, "time"]


def _refer_to_execute(
    trajectory: Trajectory,
    execute_time: Scalar,
    side: Scalar,
    psi0: Scalar | None,
    spare_rows_repeat: bool,
) -> _TrialFrame:
    valid = jnp.asarray(trajectory.valid)
    rows = slice(None) if spare_rows_repeat else valid_rows(valid)
    t, x, y, psi, u, v, r = (
        jnp.asarray(getattr(trajectory, name))[rows]
        for name in ("t", "x", "y", "psi", "u", "v", "r")
    )
    psi0 = value_at(Curve(t, psi, r), execute_time) if psi0 is None else psi0
    x0, y0 = (
        value_at(_Position(t, value, u, v, psi, axis), execute_time)
        for axis, value in enumerate((x, y))
    )
    along, across = to_body(x - x0, y - y0, psi0)
    # As if the first order were to starboard: a turn to port is its mirror image.
    across, heading, v, r = (jnp.asarray(side * one) for one in (across, psi - psi0, v, r))
    return _TrialFrame(
        heading=Curve(t, heading, r),
        along=_Position(t, jnp.asarray(along), u, v, heading, 0),
        across=_Position(t, across, u, v, heading, 1),
        surge=DifferencedCurve(t, u),
        sway=DifferencedCurve(t, v),
        yaw=DifferencedCurve(t, r),
        speed=_magnitude(u, v),
        counts=jnp.append(True, t[1:] > t[:-1]),
    )


def _speed_at(run: _TrialFrame, time: Scalar) -> Float[Array, ""]:
    return _magnitude(value_at(run.surge, time), value_at(run.sway, time))


def _distance_between(run: _TrialFrame, begin: Scalar, end: Scalar) -> Float[Array, ""]:
    """Distance (m) travelled from a time to a later one: trapezoids with their end correction.

    The correction of an interval is h^2 / 12 times how much less the speed grows at its end than at
    its start. Over evenly spaced samples only the first and the last growth are left of it.
    """
    t, speed = run.surge.t, run.speed
    # Both ends by one program: compiling is most of the time that a single trial takes.
    times = jnp.stack([jnp.asarray(time, t.dtype) for time in (begin, end)])
    times = jnp.clip(times, t[0], t[-1])
    rows = jax.vmap(functools.partial(interval_at, t))(times)
    first, last = rows
    row = jnp.arange(t.shape[0])
    step, pair = t[1:] - t[:-1], speed[1:] + speed[:-1]
    whole = jnp.where((row[:-1] >= first) & (row[:-1] < last), step * pair, 0.0)
    within = (row[1:-1] > first) & (row[1:-1] < last)
    uneven = jnp.where(within, (speed[2:] - speed[:-2]) * (step[1:] - step[:-1]), 0.0)
    before = step[jnp.maximum(last - 1, 0)]
    at_first, at_last = jax.vmap(functools.partial(_growth, run))(rows)
    growth = jnp.where(last > first, step[first] ** 2 * at_first - before**2 * at_last, 0.0)
    speeds = jax.vmap(functools.partial(_speed_at, run))(times)
    lead, rest = (times - t[rows]) * (speed[rows] + speeds) / 2
    return jnp.sum(whole) / 2 + (jnp.sum(uneven) + growth) / 12 + rest - lead


def _growth(run: _TrialFrame, row: Int[Array, ""]) -> Float[Array, ""]:
    """How fast the speed grows (m/s^2) at a sample.

    By the components' differences: those of the speed smear its kink where the vessel stops.
    """
    u, v = run.surge.value[row], run.sway.value[row]
    growth = u * run.surge.rates(row, 0, 0)[0] + v * run.sway.rates(row, 0, 0)[0]
    speed = run.speed[row]
    return jnp.where(speed > 0, growth / _one_unless_positive(speed), 0.0)


def _magnitude(u: Array, v: Array) -> Array:
    # The root has an infinite derivative at rest.
    square = u**2 + v**2
    return jnp.where(square > 0, jnp.sqrt(_one_unless_positive(square)), 0.0)


def _approach_speed(run: _TrialFrame, execute_time: Scalar) -> Float[Array, ""]:
    """Mean speed (m/s) over the last 10 s before the execute, fewer if not recorded."""
    begin = jnp.maximum(execute_time - APPROACH_SECONDS, run.surge.t[0])
    duration = execute_time - begin
    mean = _distance_between(run, begin, execute_time) / _one_unless_positive(duration)
    return jnp.where(duration > 0, mean, _speed_at(run, execute_time))


def _peak_yaw_rate(
    yaw: DifferencedCurve, execute_time: Scalar, orders: Float[Array, "order"] | None = None
) -> Float[Array, ""]:
    """Largest yaw rate (rad/s) to either side after the execute, at an order's corner or beside
    the largest sample."""
    sizes = jnp.where(yaw.t >= execute_time, jnp.abs(yaw.value), -jnp.inf)
    sampled = jnp.max(sizes)
    row = first_row(sizes == sampled)
    around = yaw.near(row, _AROUND_PEAK, _AROUND_PEAK)
    around = around if orders is None else with_corners(around, orders)
    sense = jnp.where(yaw.value[row] < 0, -1.0, 1.0)
    peak = highest(around, sense, after=execute_time)
    return jnp.maximum(sampled, jnp.where(peak.found, sense * peak.value, -jnp.inf))


def _steady_turn(run: _TrialFrame) -> dict[str, Float[Array, ""]]:
    turn = run.heading
    total = jax.lax.stop_gradient(turn.value[-1])
    begin = first_crossing(turn, jnp.clip(total - math.pi, math.pi, 2 * math.pi), +1)
    enough = begin.found & (total >= 1.5 * math.pi)
    chosen = run.counts & (turn.t >= begin.time) & enough
    radius, round_ = fitted_radius(run.along.value, run.across.value, chosen)
    duration = jnp.where(enough, turn.t[-1] - begin.time, 1.0)
    turned = (run.heading.value[-1] - value_at(run.heading, begin.time)) / duration
    travelled = _distance_between(run, begin.time, turn.t[-1]) / duration
    return {
        "steady_turning_diameter": value_or_nan(2 * radius, enough & round_),
        "steady_yaw_rate": value_or_nan(turned, enough),
        "final_speed": value_or_nan(travelled, enough),
    }


def _one_unless_positive(value: Scalar | Array) -> Array:
    return jnp.where(value > 0, value, 1.0)
