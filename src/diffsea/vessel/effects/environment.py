"""Effects of the environment: current, wind, waves and shallow water."""

import dataclasses
import functools
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from diffsea.kinematics import components_towards, speed_and_direction
from diffsea.scales import GRAVITY
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.coordinates import Coefficient, Frequency, OfVessel, Size, vessel_time
from diffsea.vessel.effects.entry import (
    CoordinateValues,
    Effect,
    Numbers,
    Parametrisation,
    add_force,
    add_to,
    entry,
    read_table,
    with_force,
)
from diffsea.vessel.forces import EarthForce, MeasuredWind, Wind
from diffsea.vessel.hull import ShallowDamping
from diffsea.vessel.tables import Table, numbers


# Spread of the logarithm of a wind coefficient: what is known of an unmeasured superstructure.
LOG_COEFFICIENT_SPREAD = 0.8
C_N_SPREAD = 0.1  # of the coefficient of the wind's moment: as large as its usual value
CURRENT_SIZE = 0.3  # m/s
WIND_SIZE = 5.0  # m/s
MEASURED_WIND = "measured-wind"  # the force
environment_effect = functools.partial(entry, "environment")
_SUPERSTRUCTURE_KEYS = ("frontal_area", "lateral_area", "C_X", "C_Y", "C_N", "C_NY")


def _components(unit: str, size: OfVessel, of: str = "") -> tuple[Size, Size]:
    """Coordinates of a vector fixed in the earth, north and east."""
    return Size(f"{of}north", unit, size), Size(f"{of}east", unit, size)


def _flow_parametrisation(turn: float, note: str) -> Parametrisation:
    """Speed and direction of a flow whose coordinates are its components north and east.

    `turn` (rad) is added to the direction in which the fluid moves to get the one that is named.
    """

    def decode(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
        speed, direction = speed_and_direction(at[0], at[1])
        return {"speed": speed, "direction": jnp.mod(direction + turn, 2 * jnp.pi)}

    def encode(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
        speed, direction = numbers.get("speed", 0.0), numbers.get("direction", 0.0)
        north, east = components_towards(speed, direction - turn)
        return float(north), float(east)

    units = {"speed": "m/s", "direction": "rad"}
    return Parametrisation(units, decode, encode, notes={"direction": note})


def superstructure(vessel: Vessel) -> Wind:
    """The wind's force on a vessel; where it states none, of the usual coefficients.

    Its areas are as large above the water as below then.
    """
    stated, body = vessel.forces.get("wind"), vessel.rigid_body
    if isinstance(stated, Wind):
        return stated
    return Wind(body.beam * body.draught, body.length * body.draught, body.length)


def _read_wind(vessel: Vessel, table: Table, variants: Sequence[Effect], where: str) -> Vessel:
    """A wind and the superstructure that it acts on.

    What an earlier table says of the superstructure holds for a wind that is added. A wind without
    speed is that of the recordings.
    """
    given = numbers(table, _SUPERSTRUCTURE_KEYS, where)
    stated = dataclasses.replace(superstructure(vessel), **given)
    vessel = with_force(vessel, "wind", stated)
    if not numbers(table, ("speed",), where).get("speed"):
        vessel = with_force(vessel, MEASURED_WIND, MeasuredWind(stated))
    return read_table(vessel, table, variants, where, _SUPERSTRUCTURE_KEYS)


@environment_effect(
    "current",
    *_components("m/s", CURRENT_SIZE),
    phrase="a steady current of {speed} flowing to {direction}",
    confusables=("wind", "hard-iron", "heading-offset", "wave-force"),
    parametrisation=_flow_parametrisation(0.0, "flows to"),
    per_run=True,
)
def current(vessel: Vessel, flow: CoordinateValues) -> Vessel:
    """Forces by velocity through the water nu_r = nu - R'(psi) V_c, V_c steady and uniform
    (Fossen 2021, section 10.3).
    """
    vessel = add_to(vessel, lambda v: v.environment.current_north, flow[0])
    return add_to(vessel, lambda v: v.environment.current_east, flow[1])


@environment_effect(
    "wind",
    *_components("m/s", WIND_SIZE),
    phrase="a steady wind of {speed} from {direction}",
    confusables=("current", "wave-force", "thrust-asymmetry"),
    parametrisation=_flow_parametrisation(np.pi, "comes from"),
    per_run=True,
    read=_read_wind,
)
def wind(vessel: Vessel, flow: CoordinateValues) -> Vessel:
    """Quadratic in apparent wind, coefficients of Isherwood type (Fossen 2021, eq. 10.23)."""
    if "wind" not in vessel.forces:
        vessel = with_force(vessel, "wind", superstructure(vessel))
    vessel = add_to(vessel, lambda v: v.environment.wind_north, flow[0])
    return add_to(vessel, lambda v: v.environment.wind_east, flow[1])


def _coefficients_at(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
    """Coefficients of the superstructure, by what is added to C_N and the logarithms of factors."""
    usual = superstructure(vessel)
    return {
        "C_X": usual.C_X * jnp.exp(at[3]),
        "C_Y": usual.C_Y * jnp.exp(at[4]),
        "C_N": usual.C_N + at[2],
    }


def _wind_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """Components (m/s), what is added to C_N, logarithms of the factors on C_X and C_Y."""
    usual = superstructure(vessel)
    ratios = (numbers.get(key, getattr(usual, key)) / getattr(usual, key) for key in ("C_X", "C_Y"))
    added = float(numbers.get("C_N", usual.C_N) - usual.C_N)
    return (*wind.encode(vessel, numbers), added, *(float(np.log(ratio)) for ratio in ratios))


@environment_effect(
    "wind:coefficients",
    *_components("m/s", WIND_SIZE),
    Coefficient("C_N added", "1", C_N_SPREAD, trials=(-1.0, -2.0)),
    Coefficient("log C_X factor", "1", LOG_COEFFICIENT_SPREAD),
    Coefficient("log C_Y factor", "1", LOG_COEFFICIENT_SPREAD),
    phrase=wind.phrase,
    confusables=wind.confusables,
    # What a file states of the superstructure is believed.
    possible=lambda vessel: "wind" not in vessel.forces,
    parametrisation=Parametrisation(
        wind.units | {"C_X": "1", "C_Y": "1", "C_N": "1"},
        lambda vessel, at: wind.decode(vessel, at[:2]) | _coefficients_at(vessel, at),
        _wind_coordinates,
        notes={"direction": "comes from"},
    ),
    per_run=True,
)
def wind_and_coefficients(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """Wind on a superstructure of which only what is usual is known: C_X and C_Y within a
    factor of 2.2, C_N within 0.1 (one standard deviation).
    """
    changed = dataclasses.replace(superstructure(vessel), **_coefficients_at(vessel, at))
    return wind.apply(with_force(vessel, "wind", changed), at[:2])


@environment_effect(
    "wind:measured",
    Size("C_X", "1", 0.25, (0.0, 5.0), positive=True),
    Size("C_Y", "1", 0.3, (0.0, 5.0), positive=True),
    Size("C_N", "1", 0.05, (-1.0, 1.0)),
    Size("C_NY", "1", 0.05, (-1.0, 1.0)),
    phrase="the measured wind on a superstructure with C_X {C_X}, C_Y {C_Y} and C_N {C_N}",
    confusables=wind.confusables,
    possible=lambda vessel: "wind" not in vessel.forces,
    needs=("wind_speed", "wind_direction"),
    usual_coordinates=(Wind.C_X, Wind.C_Y, Wind.C_N, 0.0),
    nearly=True,
)
def measured_wind(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """The law of `wind` with the true wind that was measured all along, and coefficients on areas
    as large above the water as below, the side force acting anywhere (Blendermann 1994).
    """
    keys = ("C_X", "C_Y", "C_N", "C_NY")
    found = dataclasses.replace(superstructure(vessel), **dict(zip(keys, at, strict=True)))
    return with_force(vessel, MEASURED_WIND, MeasuredWind(found))


def _base_frequency(vessel: Vessel) -> Scalar:
    """Frequency (Hz) from which the one of a wave train is counted."""
    return 0.5 / (2 * np.pi * vessel_time(vessel))


def _thousandth_of_weight(vessel: Vessel) -> Scalar:
    """Force of an acceleration of a thousandth of gravity, N."""
    return 1e-3 * GRAVITY * float(vessel.rigid_body.mass)


def _wave_parameters(vessel: Vessel, at: CoordinateValues) -> dict[str, Scalar]:
    """One direction for mean and swing: the principal axis of both."""
    north, east = jnp.asarray(at[0:6:2]), jnp.asarray(at[1:6:2])
    twice = 2 * jnp.sum(north * east), jnp.sum(north**2) - jnp.sum(east**2)
    direction = 0.5 * jnp.arctan2(*twice)
    bias = north[0] * jnp.cos(direction) + east[0] * jnp.sin(direction)
    direction = jnp.where(bias < 0, direction + jnp.pi, direction)
    bias, sine, cosine = north * jnp.cos(direction) + east * jnp.sin(direction)
    return {
        "bias": bias,
        "amplitude": jnp.sqrt(sine**2 + cosine**2),
        "frequency": _base_frequency(vessel) + at[6],
        "phase": jnp.arctan2(cosine, sine),
        "direction": jnp.mod(direction, 2 * jnp.pi),
    }


def _wave_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """Mean, sine and cosine north and east, and the frequency above the vessel's base."""
    get = {"bias": 0.0, "amplitude": 0.0, "frequency": 0.1, "phase": 0.0, "direction": 0.0}
    get |= numbers
    ahead = np.array([np.cos(get["direction"]), np.sin(get["direction"])])
    swing = get["amplitude"] * np.array([np.cos(get["phase"]), np.sin(get["phase"])])
    forces = np.concatenate([get["bias"] * ahead, swing[0] * ahead, swing[1] * ahead])
    return (*map(float, forces), float(get["frequency"] - _base_frequency(vessel)))


@environment_effect(
    "wave-force",
    *_components("N", _thousandth_of_weight, "bias "),
    *_components("N", _thousandth_of_weight, "sine "),
    *_components("N", _thousandth_of_weight, "cosine "),
    Frequency("frequency", "Hz", _base_frequency, origin=_base_frequency),
    phrase="a wave force with mean {bias} and amplitude {amplitude} at {frequency}",
    confusables=("wind", "current"),
    parametrisation=Parametrisation(
        {"bias": "N", "amplitude": "N", "frequency": "Hz", "phase": "rad", "direction": "rad"},
        _wave_parameters,
        _wave_coordinates,
    ),
)
def wave_force(vessel: Vessel, at: CoordinateValues) -> Vessel:
    """Bias + amplitude sin(2 pi frequency t + phase) towards `direction`, fixed in the
    earth, at amidships: one regular wave train with its mean drift, or a tow, of one phase
    on the clocks of all runs.
    """
    train = EarthForce(*at[:6], frequency=_base_frequency(vessel) + at[6])
    return add_force(vessel, "wave-force", train)


def _shallowness(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    """-log(1 - T / h) of the depth h (m) that a file states; zero, deep, for none."""
    depth = numbers.get("depth", 0.0)
    return (-float(np.log1p(-float(vessel.rigid_body.draught) / depth)) if depth else 0.0,)


def _is_aground(vessel: Vessel, numbers: Numbers) -> str:
    """Why there is no water of that depth below the vessel."""
    draught = float(vessel.rigid_body.draught)
    if numbers.get("depth", 2 * draught) > draught:
        return ""
    return f"depth = {numbers['depth']:g} m is not more than the draught of {draught:g} m"


@environment_effect(
    "shallow-water",
    Size("shallowness", "1", 0.3, positive=True),
    phrase="shallow water, {depth} deep,",
    confusables=("drag-change", "added-mass-coupling", "crossflow-drag"),
    parametrisation=Parametrisation(
        {"depth": "m"},
        lambda vessel, at: {"depth": -vessel.rigid_body.draught / jnp.expm1(-at[0])},
        _shallowness,
        inverse=True,
    ),
    per_run=True,
    refusal=_is_aground,
)
def shallow_water(vessel: Vessel, shallowness: CoordinateValues) -> Vessel:
    """With q = T / h: added masses times (1 - q)^-1/2, lateral damping (1 - q)^-1,
    longitudinal (1 - q)^-1/4: of the size that tests of full hulls show down to h = 1.3 T;
    hulls differ by tens of per cent.
    """
    vessel = add_to(vessel, lambda v: v.environment.shallowness, shallowness[0])
    return with_force(vessel, "shallow-water", ShallowDamping())


ENVIRONMENT = (current, wind, wind_and_coefficients, measured_wind, wave_force, shallow_water)
