"""Errors of sensors and clocks."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import (
    KINDS,
    ORDER_UNIT,
    SIDES,
    Kind,
    OrderedChannels,
    chosen_channels,
    largest_order,
)
from diffsea.vessel.effects.coordinates import Coefficient, Jump, Size, vessel_time
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    Numbers,
    Parametrisation,
    Place,
    add_to,
    entry,
    read_names,
    read_table,
)
from diffsea.vessel.sensors import Clock, EstimatedHeading, Feedback, Step
from diffsea.vessel.tables import Table, check_keys, needed, numbers


sensor_effect = functools.partial(entry, "sensor")
LATENCY_CHANNELS = {
    "position": ("x", "y"),
    "heading": ("psi",),
    "velocity": ("u", "v"),
    "yaw_rate": ("r",),
}
_LIKE_LATENCY = ("lever-arm", "clock-drift", "thrust-delay", "thrust-lag", "rate-limit", "current")


@dataclasses.dataclass(frozen=True)
class MeasuredChannels(Place):
    """Channels of the motion that are measured wrongly."""

    names: tuple[str, ...]

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """All of them by name."""
        return {"channels": list(self.names)}


def _add_latency(vessel: Vessel, delay: Scalar, groups: Sequence[str]) -> Vessel:
    """One delay (s) more for all channels of some groups."""
    for group in groups:
        vessel = add_to(vessel, lambda v, g=group: getattr(v.sensors, f"latency_{g}"), delay)
    return vessel


def _read_latency(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """A delay of the groups of channels that a table names, of positions where it names none."""
    check_keys(table, ("name", "delay", "channels"), where)
    delay = needed(table, "delay", where)
    channels = read_names(table, "channels", where, ' such as ["x", "y"]')
    if channels is None:
        channels = variants[0].place.in_file(vessel)["channels"]
    known = {channel for members in LATENCY_CHANNELS.values() for channel in members}
    groups = [g for g, members in LATENCY_CHANNELS.items() if set(members) & set(channels)]
    if not groups or not set(channels) <= known:
        raise UserError(f"{where}: channels are among x, y, psi, u, v, r")
    return _add_latency(vessel, np.asarray(delay), groups)


def _latency(
    variant: str,
    *groups: str,
    phrase: str = "a measured {channels} that arrives {delay:size} late",
    mirror: str = "",
) -> Effect:
    """Channels that are late by one delay; the variant `mirror` has all the others."""

    @sensor_effect(
        f"sensor-latency:{variant}",
        Size("delay", "s", vessel_time, positive=True, valid_to=3.0),
        phrase=phrase,
        confusables=_LIKE_LATENCY,
        place=MeasuredChannels(tuple(name for group in groups for name in LATENCY_CHANNELS[group])),
        mirror=mirror and f"sensor-latency:{mirror}",
        read=_read_latency,
    )
    def latency(vessel: Vessel, delay: CoordinateValues) -> Vessel:
        """measured(t) = true(t - delay); in fits of free runs as its Taylor polynomial of second
        order, which is good up to the vessel's own response.
        """
        return _add_latency(vessel, delay[0], groups)

    return latency


def _read_from_an_instant(
    vessel: Vessel, table: Table, variants: Sequence[Effect], where: str
) -> Vessel:
    """An error of all the run, or from the `time` on that a table states."""
    constant, stepped = variants
    chosen = stepped if "time" in table else constant
    return read_table(vessel, table, [chosen], where, others=("time",))


@sensor_effect(
    "heading-offset",
    Size("angle", "rad", 0.05),
    phrase="a compass that reads {angle:size} too {angle:high|low}",
    confusables=("current", "thruster-misalignment", "hard-iron", "actuator-bias"),
    read=_read_from_an_instant,
)
def heading_offset(vessel: Vessel, angle: CoordinateValues) -> Vessel:
    """psi_m = psi + angle."""
    return add_to(vessel, lambda v: v.sensors.heading_offset, angle[0])


@sensor_effect(
    "heading-offset:step",
    Size("angle", "rad", 0.05),
    Jump(channel="psi"),
    phrase="a compass that reads {angle:size} too {angle:high|low} from {time:size} on",
    confusables=("current", "hard-iron"),
)
def heading_step(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """psi_m = psi, and psi + angle from `time` on: a compass that was turned or reset."""
    return _add_step(vessel, "heading_steps", at)


def _add_step(vessel: Vessel, sensor: str, at: CoordinateValues) -> Vessel:
    """A sensor of the vessel that is off by a size from a time on."""
    steps = (*getattr(vessel.sensors, sensor), Step(at[0], at[1]))
    sensors = dataclasses.replace(vessel.sensors, **{sensor: steps})
    return dataclasses.replace(vessel, sensors=sensors)


@dataclasses.dataclass(frozen=True)
class TurnedByMotors(MeasuredChannels):
    """Channels that are turned by a heading, which the current of motors deflects."""

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """The channels and the motors by name."""
        return super().in_file(vessel) | {"actuators": list(_motors(vessel))}


def _motors(vessel: Vessel) -> tuple[str, ...]:
    """Channels of thrusters, whose motors are electric; a ship's propeller has another engine.

    It is craft with such that have an autopilot's estimate for a heading; a ship has a gyrocompass.
    """
    thrusters = [part for part in vessel.propulsors.values() if part.diameter is None]
    channels = [channel for part in thrusters for channel in part.servos]
    return tuple(channel for channel in channels if channel in vessel.thrusts_at_rest)


def _deviation_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """A and B of a deviation with an amplitude and a phase."""
    size, phase = numbers.get("amplitude", 0.0), numbers.get("phase", 0.0)
    return float(-size * np.sin(phase)), float(size * np.cos(phase))


USUAL_TIME_CONSTANT = 6.0  # s, in which a heading follows its compass, give or take a factor of e
SHORTEST_TIME_CONSTANT = 0.05  # s: one that follows at once
LARGEST_DEVIATION = 0.6  # rad: no compass is left like that
_DEVIATION = tuple(
    Size(part, "rad", 0.05, (-LARGEST_DEVIATION, LARGEST_DEVIATION)) for part in ("cosine", "sine")
)
_AMPLITUDE_AND_PHASE = {"amplitude": "rad", "phase": "rad"}
_TURNED = ("psi", "u", "v")


def _amplitude_and_phase(vessel: Vessel, at: CoordinateValues) -> Numbers:
    return {
        "amplitude": jnp.sqrt(at[0] ** 2 + at[1] ** 2),
        "phase": jnp.arctan2(-at[0], at[1]),
    }


def _read_deviation(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """The deviation of a compass, of an estimator's heading, or that which motors bring about.

    The last where the table names `actuators`, the second where it has a `time_constant` or names
    the velocities among its `channels`.
    """
    check_keys(
        table, ("name", "amplitude", "phase", "time_constant", "channels", "actuators"), where
    )
    values = numbers(table, ("amplitude", "phase", "time_constant"), where)
    if not values:
        raise UserError(f"{where} states no number; its keys are amplitude, phase, time_constant")
    if values.get("time_constant", 0.0) < 0:
        raise UserError(f"{where}: time_constant = {values['time_constant']:g} s is negative")
    channels = read_names(table, "channels", where, ' such as ["psi", "u", "v"]')
    if channels is not None and set(channels) not in ({"psi"}, set(_TURNED)):
        raise UserError(f'{where}: channels are ["psi"], or ["psi", "u", "v"] of an estimator')
    cosine, sine = map(np.asarray, _deviation_coordinates(vessel, values))
    motors = ()
    if "actuators" in table:
        motors = tuple(c for c in vessel.channels if c in chosen_channels(vessel, table, where))
        for channel in motors:
            if channel not in vessel.thrusts_at_rest:
                raise UserError(f"{where}: {channel} is no motor: it has no thrust of its own")
    is_compass = not motors and "time_constant" not in values
    if is_compass and set(channels or ["psi"]) == {"psi"}:
        return variants[0].apply(vessel, np.stack([cosine, sine]))
    if channels is not None and set(channels) == {"psi"}:
        raise UserError(
            f"{where}: an estimator's heading, of which time_constant and actuators speak, turns "
            'the velocities with it: channels = ["psi", "u", "v"], or leave them out'
        )
    delay = np.asarray(values.get("time_constant", 0.0))
    return _with_estimate(vessel, EstimatedHeading(cosine, sine, delay, motors))


def _with_estimate(vessel: Vessel, heading: EstimatedHeading) -> Vessel:
    """The vessel with one more thing that turns its estimator's heading."""
    found = (*vessel.sensors.estimated_headings, heading)
    sensors = dataclasses.replace(vessel.sensors, estimated_headings=found)
    return dataclasses.replace(vessel, sensors=sensors)


def _time_constant(logarithm: Scalar) -> Scalar:
    """In s: that of a usual estimator, times the exponential of a coordinate."""
    return USUAL_TIME_CONSTANT * jnp.exp(logarithm)


def _encode_estimate(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    time_constant = max(numbers.get("time_constant", 0.0), SHORTEST_TIME_CONSTANT)
    logarithm = math.log(time_constant / USUAL_TIME_CONSTANT)
    return *_deviation_coordinates(vessel, numbers), logarithm


_OF_COMPASS = Parametrisation(_AMPLITUDE_AND_PHASE, _amplitude_and_phase, _deviation_coordinates)
_OF_ESTIMATE = Parametrisation(
    _AMPLITUDE_AND_PHASE | {"time_constant": "s"},
    lambda vessel, at: _amplitude_and_phase(vessel, at) | {"time_constant": _time_constant(at[2])},
    _encode_estimate,
)
_FOLLOWS = Coefficient("logarithm", "1", 1.0, (-5.0, 3.0), trials=(-1.0,))


@sensor_effect(
    "hard-iron",
    *_DEVIATION,
    phrase="a compass error of {amplitude} that changes with heading",
    confusables=("current", "heading-offset", "wind"),
    parametrisation=_OF_COMPASS,
    read=_read_deviation,
)
def hard_iron(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """psi_m = psi + amplitude sin(psi - phase): the first harmonic of the deviation of a
    magnetic compass (Bowditch); semicircular deviation only.
    """
    vessel = add_to(vessel, lambda v: v.sensors.hard_iron_cos, at[0])
    return add_to(vessel, lambda v: v.sensors.hard_iron_sin, at[1])


@sensor_effect(
    "hard-iron:estimated",
    *_DEVIATION,
    _FOLLOWS,
    phrase="a compass error of {amplitude} that changes with heading, behind an estimator that "
    "follows it within {time_constant} and turns the velocities with it",
    confusables=("current", "heading-offset", "wind"),
    possible=lambda vessel: bool(_motors(vessel)),
    parametrisation=_OF_ESTIMATE,
    place=MeasuredChannels(_TURNED),
    nearly=True,
    read=_read_deviation,
)
def hard_iron_estimated(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """time_constant dE/dt + E = amplitude sin(psi_m - phase), psi_m = psi + E, and (u, v) turned
    with it: a heading estimated from a gyro and a compass, in whose axes velocities are given.
    """
    return _with_estimate(vessel, EstimatedHeading(at[0], at[1], _time_constant(at[2])))


@sensor_effect(
    "hard-iron:motors",
    *_DEVIATION,
    _FOLLOWS,
    phrase="a compass that the motors' current deflects, by {amplitude} at full thrust, which an "
    "estimator follows within {time_constant}, the velocities turned with it",
    confusables=("current", "heading-offset", "gyro-bias"),
    possible=lambda vessel: bool(_motors(vessel)),
    parametrisation=_OF_ESTIMATE,
    place=TurnedByMotors(_TURNED),
    nearly=True,
    read=_read_deviation,
)
def hard_iron_of_motors(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """time_constant dE/dt + E = L amplitude sin(psi_m - phase), psi_m = psi + E, and (u, v) turned
    with it; L is the mean share of their full thrust that the motors make, ahead or astern: the
    magnetic field of a current is proportional to it (Biot and Savart).
    """
    return _with_estimate(
        vessel, EstimatedHeading(at[0], at[1], _time_constant(at[2]), _motors(vessel))
    )


@sensor_effect(
    "gyro-bias",
    Size("bias", "rad/s", 0.01),
    phrase="a yaw-rate sensor that reads {bias:size} too {bias:high|low}",
    confusables=("thrust-asymmetry", "actuator-bias", "thruster-misalignment"),
    read=_read_from_an_instant,
)
def gyro_bias(vessel: Vessel, bias: CoordinateValues) -> Vessel:
    """r_m = r + bias."""
    return add_to(vessel, lambda v: v.sensors.gyro_bias, bias[0])


@sensor_effect(
    "gyro-bias:step",
    Size("bias", "rad/s", 0.01),
    Jump(channel="r"),
    phrase="a yaw-rate sensor that reads {bias:size} too {bias:high|low} from {time:size} on",
    confusables=("thrust-asymmetry", "actuator-bias"),
)
def gyro_step(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """r_m = r, and r + bias from `time` on."""
    return _add_step(vessel, "gyro_steps", at)


def _lever(axis: str) -> Size:
    """A coordinate of an antenna, not farther off than a length: reference points differ."""
    return Size(
        axis,
        "m",
        lambda vessel: 0.1 * float(vessel.rigid_body.length),
        lambda vessel: (-float(vessel.rigid_body.length), float(vessel.rigid_body.length)),
    )


@sensor_effect(
    "lever-arm",
    _lever("x"),
    _lever("y"),
    phrase="a sensor {x} forward and {y} to starboard of the reference point",
    confusables=("sensor-latency", "current", "clock-drift"),
)
def lever_arm(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """p_m = p + R(psi) (x, y): positions of an antenna off the reference point."""
    vessel = add_to(vessel, lambda v: v.sensors.lever_x, at[0])
    return add_to(vessel, lambda v: v.sensors.lever_y, at[1])


@sensor_effect(
    "clock-drift",
    Size("rate", "1", 0.003),
    Size("offset", "s", lambda vessel: 0.5 * vessel_time(vessel)),
    phrase="clocks of motion and orders that are {offset} apart and drift by {rate}",
    confusables=("thrust-delay", "sensor-latency", "thrust-lag"),
)
def clock_drift(vessel: Vessel, by: CoordinateValues) -> Vessel:
    """Motion stamped t is that of t - (offset + rate t) on the clock of the orders, which is
    that of measured actuators, too.
    """
    clock = vessel.sensors.clock or Clock()
    clock = Clock(clock.offset + by[1], clock.rate + by[0])
    return dataclasses.replace(vessel, sensors=dataclasses.replace(vessel.sensors, clock=clock))


def _with_feedback(vessel: Vessel, errors: Mapping[str, Mapping[str, Scalar]]) -> Vessel:
    """Errors of the records of some channels, by channel, added to their own."""
    known = vessel.sensors.feedback
    changed = {c: known.get(c, Feedback()).plus(**more) for c, more in errors.items()}
    sensors = dataclasses.replace(vessel.sensors, feedback=known | changed)
    return dataclasses.replace(vessel, sensors=sensors)


def _read_feedback(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """Errors of the records of the actuators that a table names, of all where it names none."""
    keys = tuple(vars(Feedback()))
    check_keys(table, ("name", "actuators", *keys), where)
    error = numbers(table, keys, where)
    if error.get("scale", 0.0) <= -1.0:
        raise UserError(f"{where}: scale = {error['scale']:g} leaves nothing of what was executed")
    channels = chosen_channels(vessel, table, where, "offset" if "offset" in error else "")
    return _with_feedback(vessel, dict.fromkeys(channels, error))


def _feedback_error(kind: Kind, size: Size, phrase: str) -> Effect:
    """One way in which the records of channels of a kind are off."""
    place, side = OrderedChannels(kind), SIDES.get(kind, 0)
    alike = OrderedChannels("propulsion") if side else place

    @sensor_effect(
        f"feedback-error:{kind}-{size.key}",
        size,
        phrase=phrase,
        confusables=("actuator-bias", "thrust-asymmetry", "wind", "current", "sensor-latency"),
        possible=lambda vessel: bool(place.all_on(vessel)),
        place=place,
        needs_feedback=True,
        read=_read_feedback,
    )
    def feedback_error(vessel: Vessel, at: CoordinateValues) -> Vessel:
        """recorded(t) = (1 + scale) executed(t - delay) + offset, of measured actuation."""
        errors = {}
        for part in vessel.actuators.values():
            # By `where`: under JAX an actuator's place is not known.
            own = jnp.where(jnp.sign(part.y) == side, at[0], 0.0) if side else at[0]
            errors |= {c: {size.key: own} for c in part.servos if c in alike.all_on(vessel)}
        return _with_feedback(vessel, errors)

    return feedback_error


RECORD_SCALES = (-0.5, 1.0)  # a record that is off by a factor of two has another unit


def _feedback_errors(kind: Kind) -> list[Effect]:
    """All ways of one kind. Sides have offsets alone: a scale of one is `thrust-asymmetry`."""
    place, unit = OrderedChannels(kind), "rad" if kind == "steering" else ORDER_UNIT
    alike = OrderedChannels("propulsion") if kind in SIDES else place

    def offset_size(vessel: Vessel) -> Scalar:
        return 0.03 * largest_order(vessel, alike.all_on(vessel))

    record = "a record of {actuators} that"
    ways = [
        (
            Size("offset", unit, offset_size),
            f"{record} reads {{offset:size}} too {{offset:high|low}}",
        ),
        (
            Size("scale", "1", 0.1, RECORD_SCALES),
            f"{record} reads {{scale:%}} too {{scale:high|low}}",
        ),
        (
            Size("delay", "s", vessel_time, positive=True, secants=(0.3, 1.0, 3.0)),
            f"{record} is {{delay:size}} late",
        ),
    ]
    return [_feedback_error(kind, *way) for way in (ways[:1] if kind in SIDES else ways)]


SENSORS = (
    heading_offset,
    heading_step,
    hard_iron,
    hard_iron_estimated,
    hard_iron_of_motors,
    gyro_bias,
    gyro_step,
    _latency("position", "position", mirror="but_position"),
    *(_latency(group, group) for group in ("heading", "velocity", "yaw_rate")),
    # Positions that are ahead of everything else, as of a receiver that extrapolates: what is late
    # is all the others.
    _latency(
        "but_position",
        *("heading", "velocity", "yaw_rate"),
        phrase="a measured position that is {delay:size} ahead of all else measured",
        mirror="position",
    ),
    lever_arm,
    clock_drift,
    *(effect for kind in (*KINDS, *SIDES) for effect in _feedback_errors(kind)),
)
