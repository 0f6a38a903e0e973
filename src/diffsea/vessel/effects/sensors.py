"""Errors of sensors and clocks."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.entry import (
    Bound,
    Coordinates,
    Effect,
    Numbers,
    shifted,
    time_scale,
)
from diffsea.vessel.sensors import Clock


LATENCY_CHANNELS = {
    "position": ("x", "y"), "heading": ("psi",), "velocity": ("u", "v"), "yaw_rate": ("r",),
}  # fmt: skip


def _terms(*fields: str) -> Callable[[Vessel, Coordinates], Vessel]:
    def add(vessel: Vessel, by: Coordinates) -> Vessel:
        for field, value in zip(fields, by, strict=True):
            vessel = shifted(vessel, lambda v, f=field: getattr(v.sensors, f), value)
        return vessel

    return add


# Positions that are ahead of everything else, as of a receiver that extrapolates: what is late is
# all the others.
_BUT_POSITION = ("heading", "velocity", "yaw_rate")


def _all_late(*groups: str) -> Callable[[Vessel, Coordinates], Vessel]:
    add = _terms(*(f"latency_{group}" for group in groups))
    return lambda vessel, by: add(vessel, jnp.repeat(jnp.asarray(by), len(groups)))


def _latency(variant: str, groups: tuple[str, ...]) -> Effect:
    return Effect(
        f"sensor-latency:{variant}", "sensor", {"delay": "s"}, _all_late(*groups),
        lambda v: (time_scale(v),), positive=True, valid=1.0,
        where={"channels": [name for group in groups for name in LATENCY_CHANNELS[group]]},
        law="measured(t) = true(t - delay), for delays up to the vessel's own response; in fits of "
        "free runs as its Taylor polynomial of second order",
        confusables=(
            "lever-arm", "clock-drift", "thrust-delay", "thrust-lag", "rate-limit", "current",
        ),
    )  # fmt: skip


def _clock(vessel: Vessel, by: Coordinates) -> Vessel:
    clock = vessel.sensors.clock or Clock()
    clock = Clock(clock.offset + by[1], clock.rate + by[0])
    return dataclasses.replace(vessel, sensors=dataclasses.replace(vessel.sensors, clock=clock))


def _on_board(vessel: Vessel) -> tuple[Bound, ...]:
    """An antenna is not farther off than a length: room for other reference points."""
    length = float(vessel.rigid_body.length)
    return ((-length, length),) * 2


def _iron_parameters(vessel: Vessel, at: Coordinates) -> dict[str, Scalar]:
    return {
        "amplitude": jnp.sqrt(at[0] ** 2 + at[1] ** 2),
        "phase": jnp.arctan2(-at[0], at[1]),
    }


def _iron_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    size, phase = numbers.get("amplitude", 0.0), numbers.get("phase", 0.0)
    return float(-size * np.sin(phase)), float(size * np.cos(phase))


SENSORS = (
    Effect(
        "heading-offset", "sensor", {"angle": "rad"}, _terms("heading_offset"), lambda v: (0.05,),
        law="psi_m = psi + angle",
        confusables=("current", "thruster-misalignment", "hard-iron", "actuator-bias"),
    ),
    Effect(
        "hard-iron", "sensor", {"amplitude": "rad", "phase": "rad"},
        _terms("hard_iron_cos", "hard_iron_sin"), lambda v: (0.05, 0.05),
        decode=_iron_parameters, encode=_iron_coordinates,
        coordinate_names=("cosine", "sine"),
        law="psi_m = psi + amplitude sin(psi - phase): the first harmonic of the deviation of a "
        "magnetic compass (Bowditch); semicircular deviation only",
        confusables=("current", "heading-offset", "wind"),
    ),
    Effect(
        "gyro-bias", "sensor", {"bias": "rad/s"}, _terms("gyro_bias"), lambda v: (0.01,),
        law="r_m = r + bias",
        confusables=("thrust-asymmetry", "actuator-bias", "thruster-misalignment"),
    ),
    *(_latency(group, (group,)) for group in LATENCY_CHANNELS),
    _latency("but_position", _BUT_POSITION),
    Effect(
        "lever-arm", "sensor", {"x": "m", "y": "m"}, _terms("lever_x", "lever_y"),
        lambda v: (0.1 * float(v.rigid_body.length),) * 2, bounds=_on_board,
        law="p_m = p + R(psi) (x, y): positions of an antenna off the reference point",
        confusables=("sensor-latency", "current", "clock-drift"),
    ),
    Effect(
        "clock-drift", "sensor", {"rate": "1", "offset": "s"}, _clock,
        lambda v: (0.003, 0.5 * time_scale(v)),
        law="motion stamped t is that of t - (offset + rate t) on the clock of the orders, which "
        "is that of measured actuators, too",
        confusables=("thrust-delay", "sensor-latency", "thrust-lag"),
    ),
)  # fmt: skip
