"""Parameters of ArduPilot Rover for a boat: speed, turning and steering feed-forward.

ArduPilot's throttle and steering are outputs from -1 to 1. Its throttle is `CRUISE_THROTTLE` per
cent at `CRUISE_SPEED`, and in proportion at other speeds; its steering `ATC_STR_RAT_FF` times the
desired yaw rate (rad/s), both before feedback. What outputs order is in `ardupilot_mixers`.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from diffsea.errors import UserError
from diffsea.exports.ardupilot_mixers import Mixer, Orders, mixer_of
from diffsea.simulation import planning
from diffsea.types import Environment, Scalar, State, as_inputs
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import build, updated_document
from diffsea.vessel.tables import Table


LARGEST_CHANGE = 0.2  # relative, within a fitted number's interval
_LENGTHS, _SPANS = 20.0, 40  # a turn is run for so many lengths at a time, so many times


@dataclasses.dataclass(frozen=True)
class RoverParameter:
    """A parameter of ArduPilot: its value, its unit, and what it is of this vessel."""

    value: float | None  # None: not determined
    unit: str
    meaning: str
    reason: str = ""  # why there is no value


def parameters_of(vessel: Vessel, speed: float | None = None) -> dict[str, RoverParameter]:
    """ArduPilot's parameters for a vessel, at `speed` m/s, by default that of its trials.

    Raises:
        UserError: as `mixer_of`, or the vessel cannot keep the speed.
    """
    mixer, balance = mixer_of(vessel), _acceleration(vessel)
    length = float(vessel.rigid_body.length)
    cruise = planning.default_speed(vessel) if speed is None else speed

    def surge(throttle: float) -> float:
        return float(balance(cruise, 0.0, 0.0, mixer.orders(throttle, 0.0))[0])

    if not surge(0.0) < 0 < surge(1.0):
        raise UserError(f"--to ardupilot: no throttle keeps {cruise:.3g} m/s; give another --speed")
    throttle = brentq(surge, 0.0, 1.0, xtol=1e-12, full_output=True)[0]
    if not mixer.steering_range(throttle) > 0:
        raise UserError(
            f"--to ardupilot: at {cruise:.3g} m/s no output is left for steering; give a lower "
            "--speed"
        )
    push = balance(cruise, 0.0, 0.0, mixer.orders(1.0, 0.0))[0]
    found = {
        "FRAME_CLASS": RoverParameter(2, "", "boat"),
        "CRUISE_SPEED": RoverParameter(cruise, "m/s", "the speed at which the others are said"),
        "CRUISE_THROTTLE": RoverParameter(
            100 * throttle, "%", "output that keeps it straight ahead"
        ),
        "SPEED_MAX": RoverParameter(planning.top_speed(vessel), "m/s", "at full throttle"),
        "ATC_ACCEL_MAX": RoverParameter(
            float(push), "m/s/s", "at CRUISE_SPEED under full throttle"
        ),
        "MOT_THST_EXPO": RoverParameter(mixer.expo, "", "thrust against output"),
    }
    if mixer.kind == "skid":
        weak = (
            "" if mixer.asymmetry >= 1 else "astern is stronger than ahead, for which it has none"
        )
        asymmetry = None if weak else mixer.asymmetry
        found["MOT_THST_ASYM"] = RoverParameter(asymmetry, "", "thrust ahead over astern", weak)
    if mixer.kind == "vectored":
        angle = math.degrees(mixer.largest_angle or 0.0)
        found["MOT_VEC_ANGLEMAX"] = RoverParameter(angle, "deg", "largest angle of the thruster")
    if mixer.kind == "rudder":
        meaning = "above it steering falls as 1 / speed, as a rudder needs it"
        found["MOT_SPD_SCA_BASE"] = RoverParameter(cruise, "m/s", meaning)
    return found | _turning(balance, mixer, cruise, throttle, length)


def _turning(
    balance: Callable[..., np.ndarray], mixer: Mixer, cruise: float, throttle: float, length: float
) -> dict[str, RoverParameter]:
    """The parameters of steering, at the throttle of a straight run."""
    limit, degrees = mixer.steering_range(throttle), math.degrees
    half, full = (
        _turn(balance, mixer.orders(throttle, share * limit), cruise, length)
        for share in (0.5, 1.0)
    )
    swing = balance(cruise, 0.0, 0.0, mixer.orders(throttle, limit))[2]
    forward, rate, radius, quickest = None, "", None, None
    if half is not None:
        forward, rate = 0.5 * limit / half[1], f", {degrees(half[1]):.4g} deg/s"
    if full is not None:
        quickest, radius = degrees(full[1]), full[0] / full[1]
    unsettled = "steered to starboard the vessel does not settle to a turn to starboard"
    return {
        "ATC_STR_RAT_FF": RoverParameter(
            forward,
            "1/(rad/s)",
            "output over yaw rate in the steady turn by half the steering that CRUISE_THROTTLE "
            f"leaves{rate}",
            unsettled,
        ),
        "ATC_STR_RAT_MAX": RoverParameter(
            quickest, "deg/s", "steady turn by all that steering", unsettled
        ),
        "TURN_RADIUS": RoverParameter(radius, "m", "of that turn", unsettled),
        "ATC_STR_ACC_MAX": RoverParameter(degrees(float(swing)), "deg/s/s", "at its beginning"),
    }


def parameter_file(
    vessel: Vessel, found: Mapping[str, RoverParameter], withheld: Mapping[str, str], source: str
) -> str:
    """The text of a .param file: comments, then one parameter a line.

    Arguments:
        withheld: why a parameter is not written, by its name.
        source: whether data determine the numbers, as a sentence.
    """
    lines = [
        f"# {vessel.name}, by diffsea, for ArduPilot Rover. Still water, actuators settled.",
        f"# {source}",
        "# MOT_SLEWRATE, filters and feedback gains are not the vessel's: tune them.",
    ]
    for name, one in found.items():
        if name in withheld or one.value is None:
            lines.append(f"# {name} WITHHELD: {withheld.get(name, one.reason)}")
        else:
            lines += [
                f"# {name}{f' ({one.unit})' if one.unit else ''}: {one.meaning}",
                f"{name},{one.value:.5g}",
            ]
    return "\n".join(lines) + "\n"


# What data determine


def withheld_by_fit(
    document: Table, fit: Mapping[str, Any], found: Mapping[str, RoverParameter]
) -> dict[str, str]:
    """Why parameters of ArduPilot are not determined by a fit, by their names.

    Each number of the fit goes to both ends of its 90 % interval, the others as they are. What that
    moves by more than `LARGEST_CHANGE` is not determined. Numbers that a fit knows only together
    count as if they were independent, which withholds rather too much.

    Arguments:
        document: of the vessel that was fitted.
        fit: the content of fit.json.
        found: what the vessel as it is gives.

    Raises:
        UserError: the fit is of another vessel, or no fit.
    """
    rows = rows_of_fit(fit)
    reasons: dict[str, str] = {}
    largest: dict[str, float] = {}
    for symbol, row in rows.items():
        _check_same_vessel(document, symbol, float(row["value"]))
        for end in row["interval"]:
            for name, change in _changes(document, symbol, float(end), found).items():
                if change > max(LARGEST_CHANGE, largest.get(name, 0.0)):
                    largest[name] = change
                    share = 100 * float(row["determined"])
                    reasons[name] = (
                        f"{symbol} moves it by {100 * change:.0f} % within its 90 % interval; "
                        f"data determine {share:.0f} % of {symbol}"
                    )
    return reasons


def rows_of_fit(fit: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The parameters of a fit.json that is read back, each with numbers where they are due.

    Raises:
        UserError: it has none, or one of another kind.
    """
    rows = fit.get("parameters")
    if not isinstance(rows, dict):
        raise UserError("--fit: not the fit.json of `diffsea fit`: it has no parameters")
    for symbol, row in rows.items():
        _check_row(symbol, row)
    return rows


def _check_row(symbol: str, row: object) -> None:
    """Raise `UserError` unless a row of fit.json has its value, its interval and its share."""
    interval = row.get("interval") if isinstance(row, dict) else None
    if isinstance(row, dict) and isinstance(interval, list) and len(interval) == 2:
        given = (row.get("value"), row.get("determined"), *interval)
        numbers = [x for x in given if isinstance(x, int | float) and not isinstance(x, bool)]
        if len(numbers) == len(given) and all(abs(x) < 1e100 for x in numbers):
            return
    raise UserError(
        f"--fit: not the fit.json of `diffsea fit`: {symbol!r} lacks a finite value, determined, "
        "or interval of two numbers"
    )


def _check_same_vessel(document: Table, symbol: str, value: float) -> None:
    """Raise `UserError` where a hull's number is not the one that was fitted."""
    stated = document["hull"].get(symbol)
    if stated is not None and not math.isclose(float(stated), value, rel_tol=1e-4):
        raise UserError(
            f"--fit: {symbol} = {value:.5g} there and {float(stated):.5g} in the vessel's file; "
            "give the vessel.toml and the fit.json of one fit"
        )


def _changes(
    document: Table, symbol: str, value: float, found: Mapping[str, RoverParameter]
) -> dict[str, float]:
    """Relative changes of ArduPilot's parameters where one number of the vessel is another."""
    try:
        vessel = build(updated_document(document, {symbol: value}, []))
        other = parameters_of(vessel, found["CRUISE_SPEED"].value)
    except UserError:  # no such vessel, or one that cannot run so: nothing is determined
        return dict.fromkeys(found, math.inf)
    changes = {}
    for name, one in found.items():
        after = other[name].value
        if one.value:
            changes[name] = math.inf if after is None else abs(after / one.value - 1)
    return changes


# Motion


@eqx.filter_jit
def _settled(vessel: Vessel, u: Scalar, v: Scalar, r: Scalar, orders: dict) -> Float[Array, "3"]:
    executed = {c: servo.target(orders[c]) for c, servo in vessel.servos.items()}
    zero = jnp.zeros(())
    state = State(zero, zero, zero, u, v, r)
    found = vessel.acceleration(state, executed, Environment(), zero)
    return jnp.stack([jnp.asarray(part, float) for part in found])


def _acceleration(vessel: Vessel) -> Callable[[float, float, float, Orders], np.ndarray]:
    """Accelerations (m/s^2, m/s^2, rad/s^2) in still water, actuators settled to their orders."""
    rest = {c: 0.0 if s.neutral is None else float(s.neutral) for c, s in vessel.servos.items()}
    given = as_inputs(vessel)  # vessels that differ in their numbers share a program

    def acceleration(u: float, v: float, r: float, orders: Orders) -> np.ndarray:
        held = {c: jnp.asarray(float(value)) for c, value in (rest | orders).items()}
        x = [jnp.asarray(float(value)) for value in (u, v, r)]
        return np.asarray(_settled(given, x[0], x[1], x[2], held))

    return acceleration


def _turn(
    acceleration: Callable[..., np.ndarray], orders: Orders, speed: float, length: float
) -> tuple[float, float] | None:
    """Speed (m/s) and yaw rate (rad/s) of the steady turn that orders end in, from a straight run.

    None where they end in none to starboard.
    """
    x, span = np.array([speed, 0.0, 0.0]), _LENGTHS * length / speed
    for _ in range(_SPANS):
        motion = solve_ivp(
            lambda t, x: acceleration(*x, orders),
            (0.0, span),
            x,
            method="LSODA",
            rtol=1e-8,
            atol=1e-10,
        )
        x = motion.y[:, -1]
        still = np.abs(acceleration(*x, orders)) < 1e-6 * np.array([speed, speed, speed / length])
        if still.all() and x[2] > 0:
            return float(np.hypot(x[0], x[1])), float(x[2])
    return None
