"""Rotations between earth and body axes, and angles."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffsea.scales import is_absent
from diffsea.types import Environment, Scalar, State


class _Kernel(NamedTuple):
    """What sine and cosine are made of within a quarter of pi, in one precision.

    pi / 2 is in three parts, the first two with trailing zeros, so that their products with the
    whole numbers of quarter turns that occur are exact.
    """

    half_pi: tuple[float, float, float]
    sine: tuple[float, ...]  # of x^3, x^5 ...
    cosine: tuple[float, ...]  # of x^4, x^6 ...


# fdlibm (Sun Microsystems 1993): to the last bit or two, for angles below a million.
_DOUBLE = _Kernel(
    (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21),
    (
        -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
        2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
    ),
    (
        4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
        -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
    ),
)  # fmt: skip
# Cephes (Moshier 1992), sinf and cosf: likewise, for angles below some thousand.
_SINGLE = _Kernel(
    (1.5703125, 4.837512969970703125e-4, 7.549789948768648e-8),
    (-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4),
    (4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5),
)
_KERNELS = {jnp.dtype("float64"): _DOUBLE, jnp.dtype("float32"): _SINGLE}


@jax.custom_jvp
def sine_and_cosine(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine of an angle (rad), in 64 and 32 bits by polynomials.

    XLA calls a function per number for them on CPUs, and they are most of what a step of
    a vessel costs. Right to 2e-16 for angles up to a million, in 32 bits to 2e-7 up to a thousand.
    """
    angle = jnp.asarray(angle)
    if angle.dtype not in _KERNELS:
        return jnp.sin(angle), jnp.cos(angle)
    kernel = _KERNELS[angle.dtype]
    turns = jnp.round(angle * (2 / jnp.pi))
    x = angle
    for part in kernel.half_pi:
        x = x - turns * part
    square = x * x
    sine = x + x * square * _polynomial(kernel.sine, square)
    cosine = 1 - 0.5 * square + square * square * _polynomial(kernel.cosine, square)
    odd = jnp.abs(turns - 2 * jnp.round(0.5 * turns)) > 0.5
    quadrant = turns - 4 * jnp.floor(0.25 * turns)
    below = quadrant >= 1.5
    left = (quadrant > 0.5) & (quadrant < 2.5)
    s, c = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where(below, -s, s), jnp.where(left, -c, c)


@sine_and_cosine.defjvp
def _sine_and_cosine_jvp(primals: tuple, tangents: tuple) -> tuple:
    sine, cosine = sine_and_cosine(*primals)
    (change,) = tangents
    return (sine, cosine), (cosine * change, -sine * change)


def _polynomial(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    value = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


def to_body(north: Scalar, east: Scalar, psi: Scalar) -> tuple[Scalar, Scalar]:
    """Forward and starboard components of a horizontal vector given in earth axes."""
    sin, cos = sine_and_cosine(psi)
    return cos * north + sin * east, cos * east - sin * north


def to_earth(forward: Scalar, starboard: Scalar, psi: Scalar) -> tuple[Scalar, Scalar]:
    """North and east components of a horizontal vector given in body axes."""
    sin, cos = sine_and_cosine(psi)
    return cos * forward - sin * starboard, sin * forward + cos * starboard


def wrap(angle: Scalar) -> Scalar:
    """The same angle in [-pi, pi), with derivative one everywhere."""
    return angle - 2 * jnp.pi * jnp.floor((angle + jnp.pi) / (2 * jnp.pi))


def through_water(state: State, environment: Environment) -> State:
    """The state with `u`, `v` relative to the water (m/s); the rest is unchanged."""
    if is_absent(environment.current_north, environment.current_east):
        return state
    current = to_body(environment.current_north, environment.current_east, state.psi)
    return State(state.x, state.y, state.psi, state.u - current[0], state.v - current[1], state.r)


def through_air(state: State, environment: Environment) -> tuple[Scalar, Scalar]:
    """Velocity of the air relative to the vessel in body axes: forward, starboard (m/s)."""
    air = to_body(environment.wind_north, environment.wind_east, state.psi)
    return air[0] - state.u, air[1] - state.v


def components_towards(speed: Scalar, direction: Scalar) -> tuple[Scalar, Scalar]:
    """North and east components of a flow of `speed` m/s TO `direction` rad."""
    return speed * jnp.cos(direction), speed * jnp.sin(direction)


def speed_and_direction(north: Scalar, east: Scalar) -> tuple[Scalar, Scalar]:
    """Speed and the direction it flows TO, in [0, 2 pi)."""
    return jnp.hypot(north, east), jnp.mod(jnp.arctan2(east, north), 2 * jnp.pi)
