"""Generalised forces on a vessel, and those that come from outside: wind, swell, a steady force."""

import abc
import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.kinematics import through_air, to_body
from diffsea.scales import is_absent, time_scale
from diffsea.types import Environment, Scalar, State


class Force(eqx.Module):
    """A generalised force in body axes about the midship origin."""

    X: Scalar = 0.0  # N, forward
    Y: Scalar = 0.0  # N, to starboard
    N: Scalar = 0.0  # N m, turning the bow to starboard

    def __add__(self, other: "Force") -> "Force":
        return Force(self.X + other.X, self.Y + other.Y, self.N + other.N)

    def __sub__(self, other: "Force") -> "Force":
        return Force(self.X - other.X, self.Y - other.Y, self.N - other.N)

    def __mul__(self, factor: Scalar) -> "Force":
        return Force(self.X * factor, self.Y * factor, self.N * factor)

    @classmethod
    def of_thrust(cls, thrust: Scalar, x: Scalar, y: Scalar, angle: Scalar) -> "Force":
        """A thrust (N) that acts at (x, y) m, `angle` rad clockwise from ahead.

        x is forward of amidships, y to starboard of the centreline.
        """
        # Alike for every angle, even none: so the moments of equal thrusts on both sides cancel to
        # the last bit, and what is not measured of a straight run stays zero.
        X, Y = thrust * jnp.cos(angle), thrust * jnp.sin(angle)
        return cls(X, Y, x * Y - y * X)

    @property
    def stacked(self) -> Float[Array, "3"]:
        """Surge force (N), sway force (N) and yaw moment (N m) as one array."""
        return jnp.stack([jnp.asarray(part, float) for part in (self.X, self.Y, self.N)])


class AbstractForce(eqx.Module):
    """A generalised force on the hull that depends on motion, environment and time.

    `resists` says whether it is the water's resistance to the hull's motion, which changes
    with depth and fouling.
    """

    resists: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        """The force at this instant; `state` is over ground, `t` is the run's clock in s."""


class Wind(AbstractForce):
    """Wind on the superstructure, quadratic in apparent wind, beyond the drag of still air.

    With the air's velocity relative to the vessel (u_a, v_a) and V its size,
    `X = q A_F C_X V u_a`, `Y = q A_L C_Y V v_a`, `N = q A_L L (C_NY V v_a - 2 C_N u_a v_a)`,
    q = rho_air / 2: the cos, sin and sin-2-gamma laws of Isherwood-type coefficients
    (Fossen 2021, eq. 10.23): C_N > 0 turns the bow away from a wind on the bow. C_NY is C_Y times
    the lever of the side force, forward of amidships, over the length (Blendermann 1994). The same
    forces in still air are subtracted: drag measured in a calm, which the hull's derivatives stand
    for, contains them already.
    """

    frontal_area: Scalar  # m^2
    lateral_area: Scalar  # m^2
    length: Scalar  # m
    C_X: Scalar = 0.7
    C_Y: Scalar = 0.85
    C_N: Scalar = 0.1
    C_NY: Scalar = 0.0
    air_density: Scalar = 1.225  # kg/m^3

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        if is_absent(environment.wind_north, environment.wind_east):
            return Force()
        return self.by_air(*through_air(state, environment)) - self.by_air(-state.u, -state.v)

    def by_air(self, u_a: Scalar, v_a: Scalar) -> Force:
        """The force of air that moves at (u_a, v_a) m/s past the vessel, its drag included."""
        # The small constant keeps the speed differentiable in a calm at rest.
        speed = jnp.sqrt(u_a**2 + v_a**2 + 1e-12)
        q = 0.5 * self.air_density
        across = q * self.lateral_area * speed * v_a
        return Force(
            q * self.frontal_area * self.C_X * speed * u_a,
            self.C_Y * across,
            self.length * (self.C_NY * across - q * self.lateral_area * self.C_N * 2 * u_a * v_a),
        )


class MeasuredWind(AbstractForce):
    """What the measured wind does to a superstructure, beside the environment's steady wind."""

    superstructure: Wind

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        blown = environment.disturbance
        if is_absent(blown.wind_north, blown.wind_east):
            return Force()
        whole = dataclasses.replace(
            environment,
            wind_north=environment.wind_north + blown.wind_north,
            wind_east=environment.wind_east + blown.wind_east,
        )
        by_air = self.superstructure.by_air
        return by_air(*through_air(state, whole)) - by_air(*through_air(state, environment))


def moves_in_measured_wind(forces: Mapping[str, AbstractForce]) -> bool:
    """Whether a wind that was measured along a run is among the forces on a vessel."""
    return any(isinstance(force, MeasuredWind) for force in forces.values())


class EarthForce(AbstractForce):
    """A mean plus a sinusoidal force, fixed in the earth: waves or swell, or a tow.

    `bias + sine sin(2 pi frequency t) + cosine cos(2 pi frequency t)` in both directions.
    """

    bias_north: Scalar = 0.0  # N
    bias_east: Scalar = 0.0
    sine_north: Scalar = 0.0  # N
    sine_east: Scalar = 0.0
    cosine_north: Scalar = 0.0  # N
    cosine_east: Scalar = 0.0
    frequency: Scalar = 0.1  # Hz

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        angle = 2 * jnp.pi * self.frequency * t
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        north = self.bias_north + self.sine_north * sine + self.cosine_north * cosine
        east = self.bias_east + self.sine_east * sine + self.cosine_east * cosine
        X, Y = to_body(north, east, state.psi)
        return Force(X, Y, 0.0)


class SteadyForce(AbstractForce):
    """A force fixed in the earth and a moment, whatever they come from: zero by default.

    What an estimator that cannot tell wind, current and swell apart may call all of them
    together, since motion is linear in it.
    """

    north: Scalar = 0.0  # N
    east: Scalar = 0.0  # N
    moment: Scalar = 0.0  # N m, turning the bow to starboard

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        return Force(*to_body(self.north, self.east, state.psi), self.moment)


def step(t: Scalar, at: Scalar, length: Scalar) -> Scalar:
    """A change at time `at` s: from zero to one, half at `at`, within some tenths of sqrt(L / g).

    Smooth, so that motion has a derivative by the time of the change.
    """
    return jax.nn.sigmoid((t - at) / (0.1 * time_scale(length)))
