"""A long recording as the signals that trials show in: yaw, speed, steering and push.

Steering is a rudder angle or the rudder-equivalent angle of a pair of thrusters; a positive
one is what the channel calls positive. Commanded and executed actuation stay apart: where
nothing was measured the executed angle is what the vessel's servos make of the orders, or
without a vessel the orders themselves, and `origin` says which.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from diffsea.channels import side_of, steers
from diffsea.errors import UserError
from diffsea.metrics.orders import SteeringSource, propulsion, steering_angle
from diffsea.recordings.motion import MeasuredMotion, motion_of
from diffsea.series import integrate, median_interval, strictly_later
from diffsea.simulation.actuation import executed_by, recorded_actuation
from diffsea.trajectory import Samples, Trajectory
from diffsea.vessel.base import Vessel


MEASURED, RECONSTRUCTED, ORDERED, NOTHING = "measured", "reconstructed", "commanded", "none"
_FEWEST_ROWS = 20  # in which a trial can be found
_HOLE = 5.0  # median time steps: a longer one is a hole in the recording
_USUAL_PUSH = 0.98  # quantile of push that stands for the largest: orders have peaks
_SLACK = 0.1  # of the largest thrust: below it a pair of thrusters does not steer


@dataclasses.dataclass(frozen=True)
class Signals:
    """Signals of one recording on its own clock, without rows that do not count.

    Attributes:
        run: the rows that count, as plain arrays.
        t: s, strictly increasing.
        psi: rad, unwrapped.
        r: rad/s.
        speed: m/s over ground, None where neither velocity nor position was recorded.
        ahead: whether the vessel goes ahead; true where that is not known.
        commanded: ordered steering (rad), None where no order was recorded.
        steer: executed steering (rad), None where no such channel was recorded.
        drive: executed push, about one at its largest, None as `steer`.
        throttle: the same of the orders.
        working: whether anything pushes noticeably.
        origin: of `steer` and `drive`: `MEASURED`, `RECONSTRUCTED`, `ORDERED` or `NOTHING`.
        steering_channels: those that `steer` is made of.
        known: false where heading is missing.
        breaks: the rows after a hole in the recording.
        notes: what stands for a signal that was not recorded, in words.
    """

    run: Trajectory
    t: Samples
    psi: Samples
    r: Samples
    speed: Samples | None
    ahead: Bool[np.ndarray, "time"]
    commanded: Samples | None
    steer: Samples | None
    drive: Samples | None
    throttle: Samples | None
    working: Bool[np.ndarray, "time"]
    origin: str
    steering_channels: tuple[str, ...]
    known: Bool[np.ndarray, "time"]
    breaks: tuple[int, ...]
    notes: tuple[str, ...]

    @property
    def channel(self) -> str:
        """The steering channels as text."""
        return ", ".join(self.steering_channels) or "none"

    @property
    def orders(self) -> Samples | None:
        """The steering in which orders show (rad): as commanded, else as executed."""
        return self.steer if self.commanded is None else self.commanded

    @property
    def interval(self) -> float:
        """Median time step, s."""
        return median_interval(self.t)

    def rows(self, start: float, end: float) -> slice:
        """Rows from `start` to `end` (s), both included."""
        return slice(*np.searchsorted(self.t, [start - 1e-9, end + 1e-9]))


def signals_of(run: Trajectory, vessel: Vessel | None = None) -> Signals:
    """The signals of a recording.

    A vessel says which thrusters are to port, what its thrust curves are, and how its servos
    answer. Without one, channels are told apart by their names.

    Raises:
        UserError: there is neither heading nor yaw rate, or fewer than twenty rows.
    """
    run = run.counted()
    run = run.rows(strictly_later(run.t))
    if run.t.size < _FEWEST_ROWS:
        raise UserError(
            f"{run.name} has {run.t.size} rows; trials cannot be found in fewer than {_FEWEST_ROWS}"
        )
    motion = motion_of(run)
    notes: list[str] = []
    psi, r, known = _yaw(motion, run.name, notes)
    origin, executed = _executed_actuation(run, vessel, notes)
    orders = _within_limits(run.commanded, vessel)
    commanded = _group_angle(run, orders, vessel)
    steered = _group_angle(run, executed, vessel)
    throttle = _push(run, _by_side(orders, vessel))
    pushing = _by_side(executed, vessel)
    drive = _push(run, pushing)
    if drive is None and executed is run.executed:
        drive, pushing = throttle, orders
        notes += [] if drive is None else ["executed push was not measured: orders stand for it"]
    steps = np.diff(motion.t)
    return Signals(
        run=run,
        t=motion.t,
        psi=psi,
        r=r,
        speed=_speed(motion, notes),
        ahead=motion.values["u"] >= 0 if motion.has("u") else np.ones(motion.t.shape, bool),
        commanded=None if commanded is None else commanded[0],
        steer=None if steered is None else steered[0],
        drive=drive,
        throttle=throttle,
        working=_is_working(pushing, len(motion.t)),
        origin=origin if steered is not None or pushing else NOTHING,
        steering_channels=() if steered is None else steered[1].channels,
        known=known,
        breaks=tuple(int(k) + 1 for k in np.flatnonzero(steps > _HOLE * np.median(steps))),
        notes=tuple(notes),
    )


def _yaw(
    motion: MeasuredMotion, name: str, notes: list[str]
) -> tuple[Samples, Samples, Bool[np.ndarray, "time"]]:
    """Heading, yaw rate, and where they are known; one derived from the other if need be."""
    values, known = motion.values, motion.known
    if motion.has("psi") and motion.has("r"):
        return values["psi"], values["r"], known["psi"]
    if motion.has("psi"):
        notes.append("yaw rate was not recorded: it is the derivative of the heading")
        return values["psi"], np.gradient(values["psi"], motion.t), known["psi"]
    if motion.has("r"):
        notes.append("heading was not recorded: it is the integral of the yaw rate, from zero")
        return integrate(motion.t, values["r"]), values["r"], known["r"]
    raise UserError(
        f"{name} has neither heading (psi) nor yaw rate (r), at least 20 samples of it: no trial "
        "can be found; map one of them"
    )


def _speed(motion: MeasuredMotion, notes: list[str]) -> Samples | None:
    values = motion.values
    if motion.has("u"):
        return np.hypot(values["u"], values["v"] if motion.has("v") else 0.0)
    if motion.has("x", "y"):
        notes.append("velocity was not recorded: speed is the derivative of the positions")
        return np.hypot(*(np.gradient(values[axis], motion.t) for axis in "xy"))
    notes.append("neither velocity nor position was recorded: the vessel is taken to be moving")
    return None


def _executed_actuation(
    run: Trajectory, vessel: Vessel | None, notes: list[str]
) -> tuple[str, dict[str, Samples]]:
    """Where executed actuation is from, and what it is. Groups are never mixed."""
    if run.executed and set(run.commanded) <= set(run.executed):
        return MEASURED, run.executed
    if _group_angle(run, run.executed, vessel) is not None:
        absent = ", ".join(c for c in run.commanded if c not in run.executed)
        notes.append(f"executed {absent} was not measured and is left out")
        return MEASURED, run.executed
    if not run.commanded:
        return MEASURED, run.executed
    if vessel is None or not set(vessel.channels) <= set(run.commanded):
        notes.append(
            "executed actuation was not measured, and no vessel says how the orders are answered: "
            "they are taken as executed at once"
        )
        return ORDERED, run.commanded
    notes.append(f"executed actuation is reconstructed from the orders by {vessel.name!r}")
    orders, _ = recorded_actuation(vessel, run)
    answered = {c: executed_by(servo, run.t, orders[c]) for c, servo in vessel.servos.items()}
    return RECONSTRUCTED, answered


def _within_limits(orders: dict[str, Samples], vessel: Vessel | None) -> dict[str, Samples]:
    """Orders as the vessel's servos take them: a controller may ask for more than there is."""
    servos = {} if vessel is None else vessel.servos
    taken = {
        name: np.asarray(jax.vmap(servos[name].target)(jnp.asarray(series)), float)
        for name, series in orders.items()
        if name in servos
    }
    return {name: taken.get(name, series) for name, series in orders.items()}


def _by_side(channels: dict[str, Samples], vessel: Vessel | None) -> dict[str, Samples]:
    """The channels by what they do: with a vessel its thrusts are summed by side."""
    if vessel is None:
        return channels
    grouped = dict(channels)
    for part in vessel.actuators.values():
        for name, channel in part.channels.items():
            if name not in grouped:
                continue
            if channel.role == "steering":
                sense = float(part.orders(0.0, 1.0)[name])  # what a rudder angle of 1 rad orders
                grouped[name] = sense * grouped[name]
            elif part.differential:
                value = np.asarray(vessel.thrusts_at_rest[name](grouped.pop(name)), float)
                y = float(part.y)
                side = "port" if y < 0 else "starboard" if y > 0 else f"middle {name}"
                grouped[side] = grouped.get(side, 0.0) + value
            elif channel.role == "propulsion" and channel.unit != "rev/s":
                # A shaft that does not steer counts by its speed.
                grouped[name] = np.asarray(vessel.thrusts_at_rest[name](grouped[name]), float)
    return grouped


def _group_angle(
    run: Trajectory, channels: dict[str, Samples], vessel: Vessel | None
) -> tuple[Samples, SteeringSource] | None:
    """Steering angle (rad) of a group of channels; zero where a pair of thrusters is idle."""
    grouped = _by_side(channels, vessel)
    found = steering_angle(dataclasses.replace(run, commanded=grouped, executed={}))
    if found is None or not found[1].pair:
        return found
    angle, source = found
    pair = [grouped[name] for name in source.channels]
    largest = max(np.nanmax(np.abs(side)) for side in pair)
    return np.where(np.max(np.abs(pair), axis=0) < _SLACK * largest, 0.0, angle), source


def _push(run: Trajectory, grouped: dict[str, Samples]) -> Samples | None:
    """Sum of the push of a group, about one at its largest; None where nothing pushes."""
    driving = {n: s for n, s in grouped.items() if not steers(n) and np.isfinite(s).any()}
    if len(driving) == 2 and all(map(side_of, driving)):
        push = np.nan_to_num(sum(driving.values()))  # one unit: what is more to port is push too
    else:
        push = propulsion(dataclasses.replace(run, commanded=driving, executed={}))
    if push is None or not np.max(np.abs(push)) > 0:
        return None
    usual = np.quantile(np.abs(push), _USUAL_PUSH)
    return push / (usual if usual > 0 else np.max(np.abs(push)))


def _is_working(channels: dict[str, Samples], rows: int) -> Bool[np.ndarray, "time"]:
    """Whether any propulsor pushes noticeably; everywhere, where none was recorded."""
    loads = [
        np.abs(series) / max(np.nanmax(np.abs(series)), 1e-12)
        for name, series in channels.items()
        if not steers(name) and np.isfinite(series).any()
    ]
    return np.max(loads, axis=0) > _SLACK if loads else np.ones(rows, bool)
