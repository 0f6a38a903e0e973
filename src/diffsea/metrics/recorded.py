"""The trial in a recording: which one it is, and its numbers ready for `metrics.json`.

A `RecordedTrial` says all that reading needs to know of one trial: how it shows in a recording,
how its numbers are read, and by which criteria they are judged.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.metrics.imo import (
    SHORTEST_SHIP,
    Criteria,
    imo_verdicts,
    stopping_criteria,
    turning_criteria,
    zigzag_criteria,
)
from diffsea.metrics.manoeuvres import (
    APPROACH_SECONDS,
    stopping_metrics,
    turning_metrics,
    zigzag_metrics,
)
from diffsea.metrics.numbers import LENGTHS, over_length
from diffsea.metrics.orders import (
    Orders,
    find_orders,
    heading_changes,
    largest_turn,
    neutral_share,
    stop_order,
)
from diffsea.metrics.preparation import prepare_recording
from diffsea.runtime import SELDOM_RUN, are_flags_known
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


_STEADY_HEADING = math.radians(2)  # the heading may wander by this in the approach
_SWITCHES = 12  # of a zig-zag; fixed so that recordings share one compiled program
_TURN = math.radians(120)  # change of heading under one order that makes it a turn
_LONG_LEG = math.radians(150)  # as much of one order among several: no zig-zag leg
_LARGEST_REVERSAL = math.radians(60)  # a zig-zag is reversed at no larger change of heading
_PULL_OUT = math.radians(20)  # least change of heading before the rudder is released
_STRAIGHT = math.radians(15)  # a straight run's heading stays within this
_RECORD_SHARE = 0.4  # of the record: orders that fill more are what it was made for
_NEUTRAL_SHARE = 0.7  # of the rest: as much near zero means that little else was ordered
_WHY_MISSING = {
    "advance": "the heading did not change by 90 deg under the order",
    "tactical_diameter": "the heading did not change by 180 deg under the order",
    "max_advance": "the path did not turn back from its furthest advance",
    "max_transfer": "the path did not turn back from its furthest transfer",
    "steady_turning_diameter": "the heading did not change by 270 deg under the order",
    "initial_turning_distance": "the heading did not change by 10 deg under the first order",
    "reach_time": "the heading did not return to the original one",
    "period": "there were fewer than three reversals",
    "track_reach": "the vessel did not stop",
}


@dataclasses.dataclass(frozen=True)
class RecordedTrial:
    """A trial as recordings show it.

    `recognise` says whether a prepared run with these orders is one, `read` gives its entries of
    `metrics.json` and adds to a list of notes. A trial that is `steered` begins with the first of
    the orders. `segment` is the kind of a piece of a long recording that is such a trial.
    """

    name: str
    recognise: Callable[[Trajectory, Orders], bool]
    read: Callable[[Trajectory, Orders, list[str]], dict[str, Any]]
    steered: bool = False
    criteria: Criteria | None = None
    segment: str | None = None


def recording_metrics(
    trajectory: Trajectory,
    length: float | None = None,
    manoeuvre: str | None = None,
    scale: float = 1.0,
    orders: Orders | None = None,
) -> dict[str, Any]:
    """Everything that a recording tells about the trial in it.

    Arguments:
        length: L_pp (m) as recorded.
        manoeuvre: one of `RECORDED_TRIALS`, where it is known better than the recording shows.
        scale: full-scale over recorded length: the zig-zag limits depend on L/V, which is
            sqrt(scale) times larger at full scale.
        orders: what was ordered where that is known, as it is for a simulated run.

    Returns:
        The names of `metrics.json` in SI units, `_over_L` too where the length is known;
        `manoeuvre`, `side`, `execute_time` and `switch_times` (s), `order_angle` (rad); `imo`;
        and `notes` that say what was derived, assumed or is missing and why. A number that the
        recording does not contain is absent.

    Raises:
        UserError: an unknown manoeuvre, a length or scale that is not positive, or a recording
            without heading and yaw rate.
    """
    if manoeuvre is not None and manoeuvre not in RECORDED_TRIALS:
        raise UserError(
            f"there is no manoeuvre {manoeuvre!r}; choose one of {', '.join(RECORDED_TRIALS)}"
        )
    for name, value in (("length", length), ("scale", scale)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UserError(f"{name} must be a positive number, not {value}")
    run, derivations = prepare_recording(trajectory)
    notes = [derivation.note for derivation in derivations]
    orders = find_orders(run) if orders is None else orders
    trial = RECORDED_TRIALS[manoeuvre] if manoeuvre else recognise_trial(run, orders)
    if not orders.times and trial.steered:
        raise UserError(
            f"{trajectory.name}: no order was found to start a {manoeuvre} (steering read from "
            f"{orders.source}); map a rudder, or a port and a starboard thruster"
        )
    result = {"manoeuvre": trial.name, **trial.read(run, orders, notes)}
    unknown = [n for n, v in result.items() if isinstance(v, float) and not math.isfinite(v)]
    notes += [f"{name} is missing: {why}" for name, why in _missing_numbers(unknown, run)]
    result = {name: value for name, value in result.items() if name not in unknown}
    if length is None:
        notes.append(
            "the length is not known (--length, or a --vessel): no value over L and no IMO verdict"
        )
        return {**result, "imo": {}, "notes": notes}
    imo = imo_verdicts(
        {name: v * scale if name in LENGTHS else v for name, v in result.items()},
        length * scale,
        result.get("approach_speed", math.nan) * math.sqrt(scale),
        trial.criteria,
        result.get("order_angle"),
        result.get("switching_heading"),
    )
    if "overshoot_2" in imo and length * scale < SHORTEST_SHIP:
        notes.append("the IMO limits are for the recorded size; give the scale of a model")
    return {**result, **over_length(result, length), "imo": imo, "notes": notes}


def _missing_numbers(unknown: list[str], run: Trajectory) -> list[tuple[str, str]]:
    """Numbers that the recording does not contain, and why."""
    if not (run.has("x") and run.has("y")):
        distances = [name for name in unknown if name in LENGTHS]
        return [(", ".join(distances), "positions were not recorded")] if distances else []
    return [(name, _WHY_MISSING[name]) for name in unknown if name in _WHY_MISSING]


# Which trial it is


def recognise_trial(run: Trajectory, orders: Orders) -> RecordedTrial:
    """The first of `RECORDED_TRIALS` that a prepared run is, by the orders and by its motion.

    Orders count where they fill much of the record, or hardly anything else was ordered, and the
    vessel was under way before them: a turn on the spot is no trial.
    """
    steered = False
    if orders.times:
        start = orders.times[0]
        share = (orders.end - start) / (run.t[-1] - run.t[0])
        alone = share > _RECORD_SHARE or neutral_share(run, orders) > _NEUTRAL_SHARE
        speed = np.hypot(run.u, run.v)
        under_way = True
        if np.isfinite(speed).any():
            after = np.quantile(speed[run.t >= start], 0.95)
            under_way = bool(np.interp(start, run.t, speed) >= 0.5 * after)
        steered = bool(alone) and under_way
    trials = RECORDED_TRIALS.values()
    return next(t for t in trials if (steered or not t.steered) and t.recognise(run, orders))


def _is_turning_circle(run: Trajectory, orders: Orders) -> bool:
    change = np.abs(heading_changes(run, orders))
    return bool(np.max(change) >= (_TURN if len(change) == 1 else _LONG_LEG))


def _is_zigzag(run: Trajectory, orders: Orders) -> bool:
    """Whether the heading at the reversals alternates in sign and is about the same in size."""
    change = heading_changes(run, orders)
    reached = np.cumsum(change)[:-1]
    size = np.abs(reached)
    if len(change) == 1 or np.min(size) == 0 or np.any(reached[1:] * reached[:-1] >= 0):
        return False
    return bool(np.ptp(size) <= 0.5 * np.mean(size) and np.mean(size) < _LARGEST_REVERSAL)


def _is_pull_out(run: Trajectory, orders: Orders) -> bool:
    change = heading_changes(run, orders)
    released = neutral_share(run, orders) > _NEUTRAL_SHARE
    return len(change) == 1 and released and bool(abs(change[0]) > _PULL_OUT)


def _is_stopping(run: Trajectory, orders: Orders) -> bool:
    start = stop_order(run)
    if start is None or not np.isfinite(run.u).any():
        return False
    at_order = np.interp(start, run.t, run.u)
    return bool(at_order > 0.8 * np.max(run.u) and np.min(run.u[run.t >= start]) <= 0)


# Reading its numbers


def _compiled(numbers: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """The function compiled quickly: Equinox's annotations leave out that options go on to JAX."""
    options: dict[str, Any] = {"compiler_options": SELDOM_RUN} if are_flags_known() else {}
    return eqx.filter_jit(numbers, **options)


_turning_numbers = _compiled(turning_metrics)
_zigzag_numbers = _compiled(zigzag_metrics)
_stopping_numbers = _compiled(stopping_metrics)


def _read_turning(run: Trajectory, orders: Orders, notes: list[str]) -> dict[str, Any]:
    orders = largest_turn(run, orders)
    start, end = orders.times[0], orders.end
    psi0 = _original_heading(run, start, notes)
    side = _side_of_turn(run, end, psi0)
    found = _turning_numbers(_padded_run(run, end), *map(jnp.asarray, (start, side, psi0)))
    return {**_as_floats(found), **_read_order(orders, side, notes)}


def _read_zigzag(run: Trajectory, orders: Orders, notes: list[str]) -> dict[str, Any]:
    times = orders.times[:_SWITCHES]
    psi0 = _original_heading(run, times[0], notes)
    side = _side_of_turn(run, times[1] if len(times) > 1 else orders.end, psi0)
    switches = np.full(_SWITCHES, np.nan)
    switches[: len(times)] = times
    # A plain number would be a constant of the program, which is compiled again for each.
    traced = map(jnp.asarray, (switches, psi0, side))
    numbers = _as_floats(_zigzag_numbers(_padded_run(run, orders.end), *traced))
    if len(times) > 1:
        reversals = np.interp(times[1:], run.t, run.psi) - psi0
        numbers["switching_heading"] = float(np.mean(np.abs(reversals)))
    return {**numbers, "switch_times": list(times), **_read_order(orders, side, notes)}


def _read_stopping(run: Trajectory, orders: Orders, notes: list[str]) -> dict[str, Any]:
    start = stop_order(run)
    if start is None:
        notes.append("no order to stop was found: propulsion never ceased before a stop")
        return _read_any_run(run, orders, notes)
    psi0 = _original_heading(run, start, notes)
    found = _stopping_numbers(_padded_run(run, math.inf), *map(jnp.asarray, (start, psi0)))
    return {**_as_floats(found), "execute_time": start}


def _read_any_run(run: Trajectory, orders: Orders, notes: list[str]) -> dict[str, Any]:
    """What can be said of any run."""
    if not orders.source.channels:
        notes.append("no steering channel was recorded, so no order could be found")
    elapsed = max(run.t[-1] - run.t[0], 1e-12)
    return {
        "mean_speed": float(np.trapezoid(np.hypot(run.u, run.v), run.t) / elapsed),
        "peak_yaw_rate": float(np.max(np.abs(run.r))),
    }


RECORDED_TRIALS = {
    trial.name: trial
    for trial in (
        RecordedTrial(
            "turning-circle",
            _is_turning_circle,
            _read_turning,
            steered=True,
            criteria=turning_criteria,
            segment="turning",
        ),
        RecordedTrial(
            "zigzag",
            _is_zigzag,
            _read_zigzag,
            steered=True,
            criteria=zigzag_criteria,
            segment="zigzag",
        ),
        RecordedTrial("pull-out", _is_pull_out, _read_turning, steered=True),
        RecordedTrial("stopping", _is_stopping, _read_stopping, criteria=stopping_criteria),
        RecordedTrial(
            "straight", lambda run, orders: bool(np.ptp(run.psi) < _STRAIGHT), _read_any_run
        ),
        RecordedTrial("unknown", lambda run, orders: True, _read_any_run),  # the last: any run
    )
}


def _padded_run(run: Trajectory, end: float) -> Trajectory:
    """The motion until the end, in a power of two of rows: few lengths, few compilations."""
    spare = (0, (1 << (len(run.t) - 1).bit_length()) - len(run.t))
    t, *motion = (
        jnp.asarray(np.pad(getattr(run, name), spare)) for name in ("t", *MOTION_CHANNELS)
    )
    valid, outcome = jnp.asarray(np.pad(run.t <= end, spare)), jnp.asarray(run.outcome)
    return Trajectory(t, *motion, commanded={}, executed={}, extra={}, valid=valid, outcome=outcome)


def _original_heading(run: Trajectory, start: float, notes: list[str]) -> float:
    """Mean heading (rad) of the steady end of the approach."""
    at_start = float(np.interp(start, run.t, run.psi))
    near = (run.t <= start) & (run.t >= start - APPROACH_SECONDS)
    wandering = np.flatnonzero(near & (np.abs(run.psi - at_start) > _STEADY_HEADING))
    if wandering.size:
        near[: wandering[-1] + 1] = False
    if near.sum() < 3:
        notes.append("there is no steady approach: the original heading is that at the execute")
        return at_start
    return float(np.mean(run.psi[near]))


def _side_of_turn(run: Trajectory, end: float, psi0: float) -> float:
    return 1.0 if np.interp(end, run.t, run.psi) >= psi0 else -1.0


def _read_order(orders: Orders, side: float, notes: list[str]) -> dict[str, str | float]:
    if orders.angles[0] * side < 0:
        notes.append(f"{orders.source} has the opposite sign: positive turns to port")
    if orders.source.pair:
        notes.append(f"order_angle takes {orders.source} for thrusts, not rev/s or PWM")
    if orders.source.group == "executed":
        notes.append("no steering command was recorded: orders are read from executed values")
    return {
        "side": "starboard" if side > 0 else "port",
        "execute_time": orders.times[0],
        "order_angle": float(np.mean(np.abs(orders.angles))),
    }


def _as_floats(numbers: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in numbers.items()}
