"""Errors of the record of what actuators executed."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import jax.numpy as jnp

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
from diffsea.vessel.effects.coordinates import Size, vessel_time
from diffsea.vessel.effects.entry import CoordinateValues, Effect, entry
from diffsea.vessel.sensors import Feedback
from diffsea.vessel.tables import Table, check_keys, numbers


_feedback_effect = functools.partial(entry, "sensor")


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

    @_feedback_effect(
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


FEEDBACK = tuple(effect for kind in (*KINDS, *SIDES) for effect in _feedback_errors(kind))
