"""The trial numbers of a recording, ready for `metrics.json`."""

import dataclasses
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.metrics.imo import imo_verdicts
from diffsea.metrics.manoeuvres import (
    APPROACH_SECONDS,
    stopping_metrics,
    turning_metrics,
    zigzag_metrics,
)
from diffsea.metrics.orders import MANOEUVRES, Orders, find_orders, identify, stop_order, the_turn
from diffsea.metrics.preparation import prepared
from diffsea.trajectory import MOTION_CHANNELS, ReadReport, Trajectory


# The heading may wander by this in the approach that defines the original heading.
_STEADY_HEADING = math.radians(2)
_SHIP_LENGTH = 100.0  # m, from which MSC.137(76) applies
_SWITCHES = 12  # of a zig-zag; fixed so that recordings share one compiled program
_LENGTHS = ("advance", "transfer", "tactical_diameter", "max_advance", "max_transfer",
            "steady_turning_diameter", "initial_turning_distance", "track_reach",
            "head_reach", "lateral_deviation")  # fmt: skip
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


def recording_metrics(
    trajectory: Trajectory,
    length: float | None = None,
    manoeuvre: str | None = None,
    scale: float = 1.0,
    orders: Orders | None = None,
) -> dict:
    """Everything that a recording tells about the trial in it.

    **Arguments:** `length` L_pp (m) as recorded; `manoeuvre`, one of `MANOEUVRES`, where it
    is known better than the recording shows; `scale`, full-scale over recorded length: the
    zig-zag limits depend on L/V, which is sqrt(scale) times larger at full scale; `orders`
    where they are known, as they are for a simulated run.

    **Returns:** the names of `metrics.json` in SI units, `_over_L` too where the length is
    known; `manoeuvre`, `side`, `execute_time` and `switch_times` (s), `order_angle` (rad);
    `imo`; and `notes` that say what was derived, assumed or is missing and why. A number
    that the recording does not contain is absent.

    Raises `UserError` for an unknown manoeuvre, a length or scale that is not positive, or
    a recording without heading and yaw rate.
    """
    _check(length, manoeuvre, scale)
    run, derivations = prepared(trajectory)
    notes = [derivation.note for derivation in derivations]
    orders = find_orders(run) if orders is None else orders
    if not orders.times and manoeuvre in ("turning-circle", "zigzag", "pull-out"):
        raise UserError(
            f"{trajectory.name}: no order was found to start a {manoeuvre} (steering read from "
            f"{orders.channel}); map a rudder, or a port and a starboard thruster"
        )
    named = manoeuvre or identify(run, orders)
    measure = _MEASURES.get(named, _of_the_run)
    result = {"manoeuvre": named, **measure(run, orders, notes)}
    notes += [f"{name} is missing: {why}" for name, why in _missing(result, run)]
    result = {name: value for name, value in result.items() if _is_known(value)}
    if length is None:
        notes.append("the length is not known: no value over L and no IMO verdict")
        return {**result, "imo": {}, "notes": notes}
    over = {f"{n}_over_L": result[n] / length for n in _LENGTHS if n in result}
    imo = _imo(result, length, scale)
    if "overshoot_2" in imo and length * scale < _SHIP_LENGTH:
        notes.append("the IMO limits are for the recorded size; give the scale of a model")
    return {**result, **over, "imo": imo, "notes": notes}


def _check(length: float | None, manoeuvre: str | None, scale: float) -> None:
    if manoeuvre is not None and manoeuvre not in MANOEUVRES:
        raise UserError(
            f"there is no manoeuvre {manoeuvre!r}; choose one of {', '.join(MANOEUVRES)}"
        )
    for name, value in (("length", length), ("scale", scale)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UserError(f"{name} must be a positive number, not {value}")


def _turning(run: Trajectory, orders: Orders, notes: list[str]) -> dict:
    orders = the_turn(run, orders)
    start, end = orders.times[0], orders.end
    psi0 = _original_heading(run, start, notes)
    side = _side(run, start, end, psi0)
    got = _TURNING(_padded(run, end), *_traced(start, side, psi0))
    return {**_floats(got), **_order(run, orders, side, notes)}


def _zigzag(run: Trajectory, orders: Orders, notes: list[str]) -> dict:
    times = orders.times[:_SWITCHES]
    psi0 = _original_heading(run, times[0], notes)
    side = _side(run, times[0], times[1] if len(times) > 1 else orders.end, psi0)
    switches = np.full(_SWITCHES, np.nan)
    switches[: len(times)] = times
    got = _floats(_ZIGZAG(_padded(run, orders.end), *_traced(switches, psi0, side)))
    reversals = np.interp(times[1:], run.t, run.psi) - psi0
    heading = {"switching_heading": float(np.mean(np.abs(reversals)))} if len(times) > 1 else {}
    return {**got, **heading, "switch_times": list(times), **_order(run, orders, side, notes)}


def _stopping(run: Trajectory, orders: Orders, notes: list[str]) -> dict:
    start = stop_order(run)
    if start is None:
        notes.append("no order to stop was found: propulsion never ceased before a stop")
        return _of_the_run(run, orders, notes)
    psi0 = _original_heading(run, start, notes)
    got = _STOPPING(_padded(run, math.inf), *_traced(start, psi0))
    return {**_floats(got), "execute_time": start}


def _of_the_run(run: Trajectory, orders: Orders, notes: list[str]) -> dict:
    """What can be said of any run."""
    if orders.channel == "none":
        notes.append("no steering channel was recorded, so no order could be found")
    speed = np.hypot(run.u, run.v)
    elapsed = max(run.t[-1] - run.t[0], 1e-12)
    return {
        "mean_speed": float(np.trapezoid(speed, run.t) / elapsed),
        "peak_yaw_rate": float(np.max(np.abs(run.r))),
    }


_MEASURES: dict[str, Callable] = {
    "turning-circle": _turning,
    "pull-out": _turning,
    "zigzag": _zigzag,
    "stopping": _stopping,
}
_TURNING = eqx.filter_jit(turning_metrics)
_ZIGZAG = eqx.filter_jit(zigzag_metrics)
_STOPPING = eqx.filter_jit(stopping_metrics)


def _padded(run: Trajectory, end: float) -> Trajectory:
    """The motion until the end, in a power of two of rows: few lengths, few compilations."""
    rows = 1 << (len(run.t) - 1).bit_length()
    spare = (0, rows - len(run.t))
    motion = {
        name: jnp.asarray(np.pad(getattr(run, name), spare)) for name in ("t", *MOTION_CHANNELS)
    }
    valid = jnp.asarray(np.pad(run.t <= end, spare))
    return dataclasses.replace(
        run, **motion, commanded={}, executed={}, extra={}, valid=valid,
        outcome=jnp.asarray(run.outcome), name="", provenance=(), read=ReadReport(),
    )  # fmt: skip


def _traced(*values: float | np.ndarray) -> list[jax.Array]:
    # A plain number would be a constant of the program, which is compiled again for each.
    return [jnp.asarray(value) for value in values]


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


def _side(run: Trajectory, start: float, end: float, psi0: float) -> float:
    return 1.0 if np.interp(end, run.t, run.psi) >= psi0 else -1.0


def _order(run: Trajectory, orders: Orders, side: float, notes: list[str]) -> dict:
    if orders.angles[0] * side < 0:
        notes.append(f"{orders.channel} has the opposite sign: positive turns to port")
    if ", " in orders.channel and "rudder" not in orders.channel:
        notes.append(f"order_angle takes {orders.channel} for thrusts, not rev/s or PWM")
    if orders.channel.startswith("executed"):
        notes.append("no steering command was recorded: orders are read from executed values")
    return {
        "side": "starboard" if side > 0 else "port",
        "execute_time": orders.times[0],
        "order_angle": float(np.mean(np.abs(orders.angles))),
    }


def _floats(metrics: dict) -> dict[str, float]:
    return {name: float(value) for name, value in metrics.items()}


def _is_known(value: object) -> bool:
    return not isinstance(value, float) or math.isfinite(value)


def _missing(result: dict, run: Trajectory) -> list[tuple[str, str]]:
    unknown = [name for name, value in result.items() if not _is_known(value)]
    if not np.isfinite(run.x).any() or not np.isfinite(run.y).any():
        placed = [name for name in unknown if name in (*_LENGTHS,)]
        return [(", ".join(placed), "positions were not recorded")] if placed else []
    return [(name, _WHY_MISSING[name]) for name in unknown if name in _WHY_MISSING]


def _imo(result: dict, length: float, scale: float) -> dict:
    full = {n: v * scale if n in _LENGTHS else v for n, v in result.items()}
    return imo_verdicts(
        full,
        length * scale,
        result.get("approach_speed", math.nan) * math.sqrt(scale),
        result["manoeuvre"],
        result.get("order_angle"),
        result.get("switching_heading"),
    )
