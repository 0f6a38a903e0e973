"""Scales of a vessel that follow from its length and gravity, and limits of what can be.

Durations, speeds and first guesses suit a model basin's hull and a ship alike where they are
counted in these. Everything takes lengths and numbers, no vessels, so that it lies below all that
has them.
"""

import math
from typing import overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


# One number, or elementwise one for each of a block of vessels: the physics is written for both.
Scalar = Float[Array, "..."] | Float[np.ndarray, "..."] | float | int

GRAVITY = 9.81  # m/s^2
# Hard over: the largest rudder angle of most ships, and the turning trial's of IMO MSC.137(76).
# A pair of thrusters at this rudder-equivalent angle has all its thrust on one side.
HARD_OVER = math.radians(35)  # rad
_IMPLAUSIBLE_FROUDE = 10.0  # several times that of the fastest planing craft


def is_absent(*values: Scalar) -> bool:
    """Whether numbers are zeros of Python's: what they stand for need not be calculated.

    A compiled program is made once for them. An array that is zero now may be another number the
    next time that the same program runs, in a fit say.
    """
    return all(isinstance(value, (int, float)) and value == 0 for value in values)


@overload
def time_scale(length: float) -> float: ...
@overload
def time_scale(length: Scalar) -> Scalar: ...
def time_scale(length: Scalar) -> Scalar:
    """`sqrt(L / g)` in s of a length in m: the time in which gravity moves a hull by its length."""
    return _square_root(length / GRAVITY)


@overload
def froude_speed(length: float, number: float = 1.0) -> float: ...
@overload
def froude_speed(length: Scalar, number: float = 1.0) -> Scalar: ...
def froude_speed(length: Scalar, number: float = 1.0) -> Scalar:
    """Speed in m/s at a Froude number `U / sqrt(g L)` of a hull of `length` m."""
    return number * _square_root(GRAVITY * length)


def _square_root(value: Scalar) -> Scalar:
    return jnp.sqrt(value) if isinstance(value, jax.Array) else math.sqrt(value)


def plausible_motion(
    length: Scalar, u: Scalar, v: Scalar, r: Scalar
) -> Bool[Array, "..."] | Bool[np.ndarray, "..."] | bool:
    """Whether velocities (m/s, m/s, rad/s) are those of a craft of `length` m; NaN never is.

    Both below ten times the speed at Froude number one, and the yaw rate below what gives the bow
    that speed relative to the stern.
    """
    fastest = froude_speed(length, _IMPLAUSIBLE_FROUDE)
    return (abs(u) < fastest) & (abs(v) < fastest) & (abs(r) < fastest / length)


def positive_inertia(mass: Float[Array, "3 3"]) -> Bool[Array, ""]:
    """Whether a mass matrix of surge, sway and yaw is positive definite in its symmetric part.

    A vessel without that speeds up against a force. Surge is taken to be uncoupled.
    """
    coupling = 0.5 * (mass[1, 2] + mass[2, 1])
    return (mass[0, 0] > 0) & (mass[1, 1] > 0) & (mass[1, 1] * mass[2, 2] > coupling**2)
