"""Errors of the compass, and of the heading that an autopilot makes of it."""

import dataclasses
import functools
import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.actuators import chosen_channels
from diffsea.vessel.effects.coordinates import Coefficient, Jump, Size
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    MeasuredChannels,
    Numbers,
    Parametrisation,
    add_step,
    add_to,
    entry,
    read_from_an_instant,
    read_names,
    read_table,
)
from diffsea.vessel.sensors import EstimatedHeading
from diffsea.vessel.tables import Table, check_keys, needed, numbers


_compass_effect = functools.partial(entry, "sensor")
_TURNED = ("psi", "u", "v")  # channels that a heading turns in whose axes velocities are given


def _turns_velocities(table: Table, where: str) -> bool | None:
    """Whether a table's `channels` are turned with the heading; None where it names none."""
    channels = read_names(table, "channels", where, ' such as ["psi", "u", "v"]')
    if channels is None:
        return None
    if set(channels) not in ({"psi"}, set(_TURNED)):
        raise UserError(
            f'{where}: channels are ["psi"], or ["psi", "u", "v"] where velocities are turned '
            "with the heading"
        )
    return set(channels) == set(_TURNED)


def _read_offset(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """An offset of the compass, from a `time` on where there is one, or of the axes."""
    constant, stepped, axes = variants
    check_keys(table, ("name", "angle", "time", "channels"), where)
    turns = _turns_velocities(table, where)
    table = {key: value for key, value in table.items() if key != "channels"}
    if not turns:
        return read_from_an_instant(vessel, table, (constant, stepped), where)
    if "time" in table:
        raise UserError(f"{where}: from a time on it is the heading alone: leave out channels")
    needed(table, "angle", where)
    return read_table(vessel, table, [axes], where)


@_compass_effect(
    "heading-offset",
    Size("angle", "rad", 0.05),
    phrase="a compass that reads {angle:size} too {angle:high|low}",
    confusables=("current", "thruster-misalignment", "hard-iron", "actuator-bias"),
    read=_read_offset,
)
def heading_offset(vessel: Vessel, angle: CoordinateValues) -> Vessel:
    """psi_m = psi + angle."""
    return add_to(vessel, lambda v: v.sensors.heading_offset, angle[0])


@_compass_effect(
    "heading-offset:step",
    Size("angle", "rad", 0.05),
    Jump(channel="psi"),
    phrase="a compass that reads {angle:size} too {angle:high|low} from {time:size} on",
    confusables=("current", "hard-iron"),
)
def heading_step(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """psi_m = psi, and psi + angle from `time` on: a compass that was turned or reset."""
    return add_step(vessel, "heading_steps", at)


@_compass_effect(
    "heading-offset:axes",
    Size("angle", "rad", 0.05),
    phrase="a heading that reads {angle:size} too {angle:high|low}, the velocities turned with it",
    confusables=("current", "wind", "thruster-misalignment", "actuator-bias"),
    place=MeasuredChannels(_TURNED),
    read=_read_offset,
)
def axes_offset(vessel: Vessel, angle: CoordinateValues) -> Vessel:
    """psi_m = psi + angle, and (u, v) in axes that are turned by it: an instrument mounted askew,
    or velocities of fixes in the axes of a heading that is off.
    """
    return add_to(vessel, lambda v: v.sensors.axes_offset, angle[0])


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
    turns = _turns_velocities(table, where)
    cosine, sine = map(np.asarray, _deviation_coordinates(vessel, values))
    motors = ()
    if "actuators" in table:
        motors = tuple(c for c in vessel.channels if c in chosen_channels(vessel, table, where))
        for channel in motors:
            if channel not in vessel.thrusts_at_rest:
                raise UserError(f"{where}: {channel} is no motor: it has no thrust of its own")
    is_compass = not motors and "time_constant" not in values
    if is_compass and not turns:
        return variants[0].apply(vessel, np.stack([cosine, sine]))
    if turns is False:
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


@_compass_effect(
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


@_compass_effect(
    "hard-iron:estimated",
    *_DEVIATION,
    _FOLLOWS,
    phrase="a compass error of {amplitude} that changes with heading, behind an estimator that "
    "follows it within {time_constant} and turns the velocities with it",
    confusables=("current", "heading-offset", "wind"),
    usual=lambda vessel: bool(_motors(vessel)),
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


@_compass_effect(
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


COMPASS = (
    heading_offset,
    heading_step,
    axes_offset,
    hard_iron,
    hard_iron_estimated,
    hard_iron_of_motors,
)
