"""Effects of the environment: current, wind, waves and shallow water."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from diffsea.kinematics import components_towards, speed_and_direction
from diffsea.scales import GRAVITY
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.dependent_forces import ShallowDamping
from diffsea.vessel.effects.entry import (
    Coordinates,
    Effect,
    Numbers,
    fresh,
    shifted,
    time_scale,
    with_force,
    with_secondary,
)
from diffsea.vessel.environment import EarthForce, Wind


SCALE = 0.8  # spread of a logarithm: what is known of a superstructure that nobody measured


def default_wind(vessel: Vessel) -> Wind:
    """Wind areas of a vessel that states none: as much above the water as below."""
    body = vessel.rigid_body
    return Wind(body.beam * body.draught, body.length * body.draught, body.length)


def _current(vessel: Vessel, flow: Coordinates) -> Vessel:
    vessel = shifted(vessel, lambda v: v.environment.current_north, flow[0])
    return shifted(vessel, lambda v: v.environment.current_east, flow[1])


def _wind(vessel: Vessel, flow: Coordinates) -> Vessel:
    if "wind" not in vessel.forces:
        vessel = with_force(vessel, "wind", default_wind(vessel))
    vessel = shifted(vessel, lambda v: v.environment.wind_north, flow[0])
    return shifted(vessel, lambda v: v.environment.wind_east, flow[1])


def _flow(name: str, turn: float, add, size: float, law: str, confusables: tuple) -> Effect:
    """A uniform flow, named by speed and direction, moved by its components.

    `turn` is added to the direction in which the fluid moves to get the one that is named.
    """

    def decode(vessel: Vessel, at: Coordinates) -> dict[str, Scalar]:
        speed, direction = speed_and_direction(at[0], at[1])
        return {"speed": speed, "direction": jnp.mod(direction + turn, 2 * jnp.pi)}

    def encode(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
        speed, direction = numbers.get("speed", 0.0), numbers.get("direction", 0.0)
        north, east = components_towards(speed, direction - turn)
        return float(north), float(east)

    return Effect(
        name, "environment", {"speed": "m/s", "direction": "rad"}, add, lambda v: (size, size),
        own=True, decode=decode, encode=encode, coordinate_names=("north", "east"), law=law,
        confusables=confusables,
    )  # fmt: skip


_PLAIN_WIND = _flow(
    "wind", np.pi, _wind, 5.0,
    "quadratic in apparent wind, coefficients of Isherwood type (Fossen 2021, eq. 10.23)",
    ("current", "wave-force", "thrust-asymmetry"),
)  # fmt: skip


def _superstructure(vessel: Vessel) -> Wind:
    return vessel.forces.get("wind", default_wind(vessel))


def _wind_and_superstructure(vessel: Vessel, at: Coordinates) -> Vessel:
    """Coordinates: flow north and east, added C_N, logarithms of the factors of C_X and C_Y."""
    meant = _superstructure(vessel)
    changed = dataclasses.replace(
        meant, C_N=meant.C_N + at[2], C_X=meant.C_X * jnp.exp(at[3]), C_Y=meant.C_Y * jnp.exp(at[4])
    )
    return _wind(with_force(vessel, "wind", changed), at[:2])


def _wind_and_superstructure_parameters(vessel: Vessel, at: Coordinates) -> dict[str, Scalar]:
    meant = _superstructure(vessel)
    return _PLAIN_WIND.parameters(vessel, at[:2]) | {
        "C_X": meant.C_X * jnp.exp(at[3]), "C_Y": meant.C_Y * jnp.exp(at[4]),
        "C_N": meant.C_N + at[2],
    }  # fmt: skip


def _wind_and_superstructure_coordinates(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    meant = _superstructure(vessel)
    ratios = (numbers.get(key, getattr(meant, key)) / getattr(meant, key) for key in ("C_X", "C_Y"))
    return (
        *_PLAIN_WIND.coordinates(vessel, numbers),
        float(numbers.get("C_N", meant.C_N) - meant.C_N), *(float(np.log(r)) for r in ratios),
    )  # fmt: skip


def _waves(vessel: Vessel, at: Coordinates) -> Vessel:
    train = EarthForce(*at[:6], frequency=_base_frequency(vessel) + at[6])
    return with_force(vessel, fresh("wave-force", vessel.forces), train)


def _base_frequency(vessel: Vessel) -> Scalar:
    """Frequency (Hz) from which the one of a wave train is counted."""
    return 0.5 / (2 * np.pi * time_scale(vessel))


def _wave_sizes(vessel: Vessel) -> tuple[Scalar, ...]:
    """Accelerations of a thousandth of gravity."""
    force = 1e-3 * GRAVITY * float(vessel.rigid_body.mass)
    return (*(force,) * 6, _base_frequency(vessel))


def _wave_parameters(vessel: Vessel, at: Coordinates) -> dict[str, Scalar]:
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
    get = {"bias": 0.0, "amplitude": 0.0, "frequency": 0.1, "phase": 0.0, "direction": 0.0}
    get |= numbers
    ahead = np.array([np.cos(get["direction"]), np.sin(get["direction"])])
    swing = get["amplitude"] * np.array([np.cos(get["phase"]), np.sin(get["phase"])])
    forces = np.concatenate([get["bias"] * ahead, swing[0] * ahead, swing[1] * ahead])
    return (*map(float, forces), float(get["frequency"] - _base_frequency(vessel)))


def _wave_frequencies(vessel: Vessel, first: float, last: float) -> tuple[float, ...]:
    return (float(_base_frequency(vessel)),)


def _shallow(vessel: Vessel, ratio: Coordinates) -> Vessel:
    vessel = shifted(vessel, lambda v: v.environment.shallowness, ratio[0])
    return with_secondary(vessel, "shallow-water", ShallowDamping())


def _depth(vessel: Vessel, ratio: Coordinates) -> dict[str, Scalar]:
    return {"depth": -vessel.rigid_body.draught / jnp.expm1(-ratio[0])}


def _depth_ratio(vessel: Vessel, numbers: Numbers) -> tuple[float, ...]:
    depth = numbers.get("depth", 0.0)
    return (-float(np.log1p(-float(vessel.rigid_body.draught) / depth)) if depth else 0.0,)


ENVIRONMENT = (
    _flow(
        "current", 0.0, _current, 0.3,
        "forces by velocity through the water nu_r = nu - R'(psi) V_c, V_c steady and uniform "
        "(Fossen 2021, section 10.3)",
        ("wind", "hard-iron", "heading-offset", "wave-force"),
    ),
    _PLAIN_WIND,
    Effect(
        "wind:coefficients", "environment",
        {"speed": "m/s", "direction": "rad", "C_X": "1", "C_Y": "1", "C_N": "1"},
        _wind_and_superstructure, lambda v: (5.0, 5.0, 0.1, SCALE, SCALE),
        # What a file states of the superstructure is believed.
        lambda v: "wind" not in v.forces, own=True,
        decode=_wind_and_superstructure_parameters, encode=_wind_and_superstructure_coordinates,
        idle=(2, 3, 4), places=((-1.0, 0.0, 0.0), (-2.0, 0.0, 0.0)),
        coordinate_names=("north", "east", "C_N added", "log C_X factor", "log C_Y factor"),
        law="wind on a superstructure of which only what is usual is known: C_X and C_Y within a "
        "factor of 2.2, C_N within 0.1 (one standard deviation)",
        confusables=("current", "wave-force", "thrust-asymmetry"),
    ),
    Effect(
        "wave-force", "environment",
        {"bias": "N", "amplitude": "N", "frequency": "Hz", "phase": "rad", "direction": "rad"},
        _waves, _wave_sizes, decode=_wave_parameters, encode=_wave_coordinates, shape=6,
        grid=_wave_frequencies, periodic=True,
        coordinate_names=(
            "bias north", "bias east", "sine north", "sine east", "cosine north", "cosine east",
            "frequency",
        ),
        law="bias + amplitude sin(2 pi frequency t + phase) towards `direction`, fixed in the "
        "earth, at amidships: one regular wave train with its mean drift, or a tow, of one phase "
        "on the clocks of all runs",
        confusables=("wind", "current"),
    ),
    Effect(
        "shallow-water", "environment", {"depth": "m"}, _shallow, lambda v: (0.3,),
        positive=True, own=True, decode=_depth, encode=_depth_ratio,
        coordinate_names=("shallowness",),
        law="with q = T / h: added masses times (1 - q)^-1/2, lateral damping (1 - q)^-1, "
        "longitudinal (1 - q)^-1/4: of the size that tests of full hulls show down to h = 1.3 T; "
        "hulls differ by tens of per cent",
        confusables=("drag-change", "added-mass-coupling", "crossflow-drag"),
    ),
)  # fmt: skip
