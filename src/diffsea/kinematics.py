"""Rotations between earth and body axes, and angles."""

import jax.numpy as jnp

from diffsea.types import Environment, Scalar, State


def to_body(north: Scalar, east: Scalar, psi: Scalar) -> tuple[Scalar, Scalar]:
    """Forward and starboard components of a horizontal vector given in earth axes."""
    cos, sin = jnp.cos(psi), jnp.sin(psi)
    return cos * north + sin * east, cos * east - sin * north


def to_earth(forward: Scalar, starboard: Scalar, psi: Scalar) -> tuple[Scalar, Scalar]:
    """North and east components of a horizontal vector given in body axes."""
    cos, sin = jnp.cos(psi), jnp.sin(psi)
    return cos * forward - sin * starboard, sin * forward + cos * starboard


def wrap(angle: Scalar) -> Scalar:
    """The same angle in [-pi, pi), with derivative one everywhere."""
    return angle - 2 * jnp.pi * jnp.floor((angle + jnp.pi) / (2 * jnp.pi))


def through_water(state: State, environment: Environment) -> State:
    """The state with `u`, `v` relative to the water (m/s); the rest is unchanged."""
    current = to_body(environment.current_north, environment.current_east, state.psi)
    return State(
        state.x, state.y, state.psi, state.u - current[0], state.v - current[1], state.r
    )


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
