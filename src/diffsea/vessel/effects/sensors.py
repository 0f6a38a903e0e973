"""Errors of gyro, receiver and clocks; those of the compass are in `compass`."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from diffsea.errors import UserError
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.coordinates import Jump, Size, vessel_time
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    MeasuredChannels,
    add_step,
    add_to,
    entry,
    read_from_an_instant,
    read_names,
    read_table,
)
from diffsea.vessel.sensors import Clock
from diffsea.vessel.tables import Table, check_keys, needed


_sensor_effect = functools.partial(entry, "sensor")
LATENCY_CHANNELS = {
    "position": ("x", "y"),
    "heading": ("psi",),
    "velocity": ("u", "v"),
    "yaw_rate": ("r",),
}
RECEIVER = ("position", "velocity")  # of which it tells together
_LIKE_LATENCY = ("lever-arm", "clock-drift", "thrust-delay", "thrust-lag", "rate-limit", "current")


def _add_latency(vessel: Vessel, delay: Scalar, groups: Sequence[str]) -> Vessel:
    """One delay (s) more for all channels of some groups."""
    for group in groups:
        vessel = add_to(vessel, lambda v, g=group: getattr(v.sensors, f"latency_{g}"), delay)
    return vessel


def _read_latency(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """A delay of the groups of channels that a table names, of positions where it names none."""
    check_keys(table, ("name", "delay", "channels", "turned_by"), where)
    delay = needed(table, "delay", where)
    channels = read_names(table, "channels", where, ' such as ["x", "y"]')
    if channels is None:
        channels = variants[0].place.in_file(vessel)["channels"]
    known = {channel for members in LATENCY_CHANNELS.values() for channel in members}
    groups = [g for g, members in LATENCY_CHANNELS.items() if set(members) & set(channels)]
    if not groups or not set(channels) <= known:
        raise UserError(f"{where}: channels are among x, y, psi, u, v, r")
    turned_by = read_names(table, "turned_by", where, ' such as ["psi"]')
    if turned_by is None:
        return _add_latency(vessel, np.asarray(delay), groups)
    if turned_by != ["psi"] or set(groups) != set(RECEIVER):
        raise UserError(
            f'{where}: turned_by is ["psi"], of a receiver: with channels = ["x", "y", "u", "v"]'
        )
    return late_receiver.apply(vessel, np.array([delay]))


def _latency(
    variant: str,
    *groups: str,
    phrase: str = "a measured {channels} that arrives {delay:size} late",
    mirror: str = "",
) -> Effect:
    """Channels that are late by one delay; the variant `mirror` has all the others."""

    @_sensor_effect(
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


@dataclasses.dataclass(frozen=True)
class TurnedChannels(MeasuredChannels):
    """Channels of which velocities over ground were turned into the axes of a measured heading."""

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """All of them by name, and what turned them."""
        return super().in_file(vessel) | {"turned_by": ["psi"]}


@_sensor_effect(
    "sensor-latency:receiver",
    Size("delay", "s", vessel_time, positive=True, valid_to=3.0),
    phrase="a receiver whose positions and velocities arrive {delay:size} late",
    confusables=_LIKE_LATENCY,
    place=TurnedChannels(tuple(name for group in RECEIVER for name in LATENCY_CHANNELS[group])),
    needs=("u",),
    read=_read_latency,
)
def late_receiver(vessel: Vessel, delay: CoordinateValues) -> Vessel:
    """p_m(t) = p(t - delay), and velocities over ground of then in the axes of the heading at t:
    (u + i v)_m(t) = (u + i v)(t - delay) exp(i (psi(t - delay) - psi(t))).
    """
    vessel = _add_latency(vessel, delay[0], RECEIVER)
    return add_to(vessel, lambda v: v.sensors.latency_axes, delay[0])


@_sensor_effect(
    "gyro-bias",
    Size("bias", "rad/s", 0.01),
    phrase="a yaw-rate sensor that reads {bias:size} too {bias:high|low}",
    confusables=("thrust-asymmetry", "actuator-bias", "thruster-misalignment"),
    read=read_from_an_instant,
)
def gyro_bias(vessel: Vessel, bias: CoordinateValues) -> Vessel:
    """r_m = r + bias."""
    return add_to(vessel, lambda v: v.sensors.gyro_bias, bias[0])


@_sensor_effect(
    "gyro-bias:step",
    Size("bias", "rad/s", 0.01),
    Jump(channel="r"),
    phrase="a yaw-rate sensor that reads {bias:size} too {bias:high|low} from {time:size} on",
    confusables=("thrust-asymmetry", "actuator-bias"),
)
def gyro_step(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """r_m = r, and r + bias from `time` on."""
    return add_step(vessel, "gyro_steps", at)


def _lever(axis: str) -> Size:
    """A coordinate of an antenna, not farther off than a length: reference points differ."""
    return Size(
        axis,
        "m",
        lambda vessel: 0.1 * float(vessel.rigid_body.length),
        lambda vessel: (-float(vessel.rigid_body.length), float(vessel.rigid_body.length)),
    )


def _read_lever(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """The arm of positions, or of the velocities that a table names among its `channels`, too."""
    check_keys(table, ("name", "x", "y", "channels"), where)
    channels = read_names(table, "channels", where, ' such as ["x", "y"]')
    of_positions, of_antenna = variants
    known = {frozenset("xy"): of_positions, frozenset("xyuv"): of_antenna}
    chosen = known.get(frozenset("xy" if channels is None else channels))
    if chosen is None:
        raise UserError(
            f'{where}: channels are ["x", "y"], or ["x", "y", "u", "v"] of an antenna whose '
            "velocities are its own"
        )
    table = {key: value for key, value in table.items() if key != "channels"}
    return read_table(vessel, table, [chosen], where)


@_sensor_effect(
    "lever-arm",
    _lever("x"),
    _lever("y"),
    phrase="a sensor {x} forward and {y} to starboard of the reference point",
    confusables=("sensor-latency", "current", "clock-drift"),
    read=_read_lever,
)
def lever_arm(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """p_m = p + R(psi) (x, y): positions of an antenna off the reference point."""
    vessel = add_to(vessel, lambda v: v.sensors.lever_x, at[0])
    return add_to(vessel, lambda v: v.sensors.lever_y, at[1])


@_sensor_effect(
    "lever-arm:antenna",
    _lever("x"),
    _lever("y"),
    phrase="an antenna {x} forward and {y} to starboard of the reference point, positions and "
    "velocities its own",
    confusables=("sway-yaw-coupling", "sensor-latency", "current"),
    place=MeasuredChannels(("x", "y", "u", "v")),
    read=_read_lever,
)
def lever_arm_of_antenna(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """p_m = p + R(psi) (x, y), u_m = u - y r, v_m = v + x r: the motion of an antenna, whose
    velocities were turned into the vessel's axes and not moved to its reference point.
    """
    vessel = add_to(lever_arm.apply(vessel, at), lambda v: v.sensors.velocity_lever_x, at[0])
    return add_to(vessel, lambda v: v.sensors.velocity_lever_y, at[1])


@_sensor_effect(
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


SENSORS = (
    gyro_bias,
    gyro_step,
    _latency("position", "position", mirror="but_position"),
    *(_latency(group, group) for group in ("heading", "velocity", "yaw_rate")),
    late_receiver,
    # Positions that are ahead of everything else, as of a receiver that extrapolates: what is late
    # is all the others.
    _latency(
        "but_position",
        *("heading", "velocity", "yaw_rate"),
        phrase="a measured position that is {delay:size} ahead of all else measured",
        mirror="position",
    ),
    lever_arm,
    lever_arm_of_antenna,
    clock_drift,
)
