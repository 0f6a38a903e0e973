"""Errors of sensors and clocks."""

import dataclasses
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.coordinates import Bound, Size, vessel_time
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    Numbers,
    Parametrisation,
    Place,
    add_to,
)
from diffsea.vessel.effects.tables import read_names
from diffsea.vessel.sensors import Clock
from diffsea.vessel.tables import Table, check_keys, needed


LATENCY_CHANNELS = {
    "position": ("x", "y"),
    "heading": ("psi",),
    "velocity": ("u", "v"),
    "yaw_rate": ("r",),
}


@dataclasses.dataclass(frozen=True)
class MeasuredChannels(Place):
    """Channels of the motion that are measured wrongly."""

    names: tuple[str, ...]

    def in_file(self, vessel: Vessel) -> dict[str, list[str]]:
        """All of them by name."""
        return {"channels": list(self.names)}


def _add_terms(*fields: str) -> Callable[[Vessel, CoordinateValues], Vessel]:
    """Adds coordinates to fields of the vessel's `Sensors`."""

    def apply(vessel: Vessel, by: CoordinateValues) -> Vessel:
        for field, value in zip(fields, by, strict=True):
            vessel = add_to(vessel, lambda v, f=field: getattr(v.sensors, f), value)
        return vessel

    return apply


def _add_latency(vessel: Vessel, by: CoordinateValues, groups: Sequence[str]) -> Vessel:
    """One delay (s) for all channels of some groups."""
    add = _add_terms(*(f"latency_{group}" for group in groups))
    return add(vessel, jnp.repeat(jnp.asarray(by), len(groups)))


def _read_latency(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """A delay of the groups of channels that a table names, of positions where it names none."""
    check_keys(table, ("name", "delay", "channels"), where)
    delay = needed(table, "delay", where)
    channels = read_names(table, "channels", where, ' such as ["x", "y"]')
    if channels is None:
        channels = variants[0].place_in(vessel)["channels"]
    groups = [g for g, members in LATENCY_CHANNELS.items() if set(members) & set(channels)]
    if not groups:
        raise UserError(f"{where}: channels are among x, y, psi, u, v, r")
    return _add_latency(vessel, np.array([delay]), groups)


def _latency(
    variant: str, *groups: str, phrase: str = "a measured {channels} that arrives {delay:size} late"
) -> Effect:
    """Channels that are late by one delay."""
    return Effect(
        f"sensor-latency:{variant}",
        "sensor",
        (Size("delay", "s", vessel_time, positive=True, valid_to=1.0),),
        lambda vessel, by: _add_latency(vessel, by, groups),
        law="measured(t) = true(t - delay), for delays up to the vessel's own response; in fits of "
        "free runs as its Taylor polynomial of second order",
        phrase=phrase,
        confusables=(
            "lever-arm",
            "clock-drift",
            "thrust-delay",
            "thrust-lag",
            "rate-limit",
            "current",
        ),
        place=MeasuredChannels(tuple(name for group in groups for name in LATENCY_CHANNELS[group])),
        read=_read_latency,
    )


def _add_clock(vessel: Vessel, by: CoordinateValues) -> Vessel:
    """A clock of the motion channels that lags by offset + rate t more."""
    clock = vessel.sensors.clock or Clock()
    clock = Clock(clock.offset + by[1], clock.rate + by[0])
    return dataclasses.replace(vessel, sensors=dataclasses.replace(vessel.sensors, clock=clock))


def _on_board(vessel: Vessel) -> Bound:
    """An antenna is not farther off than a length: room for other reference points."""
    length = float(vessel.rigid_body.length)
    return -length, length


def _deviation_parameters(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
    """Amplitude and phase of A cos(psi) + B sin(psi)."""
    return {
        "amplitude": jnp.sqrt(at[0] ** 2 + at[1] ** 2),
        "phase": jnp.arctan2(-at[0], at[1]),
    }


def _deviation_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """A and B of a deviation with an amplitude and a phase."""
    size, phase = numbers.get("amplitude", 0.0), numbers.get("phase", 0.0)
    return float(-size * np.sin(phase)), float(size * np.cos(phase))


def _tenth_of_length(vessel: Vessel) -> Scalar:
    """A tenth of the ship's length, m."""
    return 0.1 * float(vessel.rigid_body.length)


SENSORS = (
    Effect(
        "heading-offset",
        "sensor",
        (Size("angle", "rad", 0.05),),
        _add_terms("heading_offset"),
        law="psi_m = psi + angle",
        phrase="a compass that reads {angle:size} too {angle:high|low}",
        confusables=("current", "thruster-misalignment", "hard-iron", "actuator-bias"),
    ),
    Effect(
        "hard-iron",
        "sensor",
        (Size("cosine", "rad", 0.05), Size("sine", "rad", 0.05)),
        _add_terms("hard_iron_cos", "hard_iron_sin"),
        law="psi_m = psi + amplitude sin(psi - phase): the first harmonic of the deviation of a "
        "magnetic compass (Bowditch); semicircular deviation only",
        phrase="a compass error of {amplitude} that changes with heading",
        confusables=("current", "heading-offset", "wind"),
        parametrisation=Parametrisation(
            {"amplitude": "rad", "phase": "rad"}, _deviation_parameters, _deviation_coordinates
        ),
    ),
    Effect(
        "gyro-bias",
        "sensor",
        (Size("bias", "rad/s", 0.01),),
        _add_terms("gyro_bias"),
        law="r_m = r + bias",
        phrase="a yaw-rate sensor that reads {bias:size} too {bias:high|low}",
        confusables=("thrust-asymmetry", "actuator-bias", "thruster-misalignment"),
    ),
    *(_latency(group, group) for group in LATENCY_CHANNELS),
    # Positions that are ahead of everything else, as of a receiver that extrapolates: what is late
    # is all the others.
    _latency(
        "but_position",
        "heading",
        "velocity",
        "yaw_rate",
        phrase="a measured position that is {delay:size} ahead of all else measured",
    ),
    Effect(
        "lever-arm",
        "sensor",
        (Size("x", "m", _tenth_of_length, _on_board), Size("y", "m", _tenth_of_length, _on_board)),
        _add_terms("lever_x", "lever_y"),
        law="p_m = p + R(psi) (x, y): positions of an antenna off the reference point",
        phrase="a sensor {x} forward and {y} to starboard of the reference point",
        confusables=("sensor-latency", "current", "clock-drift"),
    ),
    Effect(
        "clock-drift",
        "sensor",
        (Size("rate", "1", 0.003), Size("offset", "s", lambda vessel: 0.5 * vessel_time(vessel))),
        _add_clock,
        law="motion stamped t is that of t - (offset + rate t) on the clock of the orders, which "
        "is that of measured actuators, too",
        phrase="clocks of motion and orders that are {offset} apart and drift by {rate}",
        confusables=("thrust-delay", "sensor-latency", "thrust-lag"),
    ),
)
