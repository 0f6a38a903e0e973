"""Standard trials as tables of stages."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.types import Scalar


class Stages(eqx.Module):
    """The table of a manoeuvre.

    A stage ends when `on_heading (psi - psi_0) + on_time t_stage + on_speed u - level`
    reaches zero from below, psi_0 being the heading at the first execute and t_stage the
    time in the stage.
    """

    angle: Float[Array, "stage"]  # rad, rudder or rudder-equivalent, positive to starboard
    throttle: Float[Array, "stage"]  # multiple of the approach throttle
    on_heading: Float[Array, "stage"]
    on_time: Float[Array, "stage"]  # 1/s
    on_speed: Float[Array, "stage"]  # s/m
    level: Float[Array, "stage"]
    by_speed: bool = eqx.field(static=True)  # whether any stage ends by speed

    @property
    def count(self) -> int:
        """Number of stages."""
        return self.angle.shape[0]


def _stages(rows: list[tuple]) -> Stages:
    columns = [
        jnp.stack([jnp.asarray(e, float) for e in column]) for column in zip(*rows, strict=True)
    ]
    return Stages(*columns, by_speed=any(row[-2] != 0.0 for row in rows))


_FULL_CIRCLES = math.radians(540)  # of the turning circle: MSC/Circ.1053 asks for 540 deg


def turning_circle(angle: Scalar, heading_change: Scalar = _FULL_CIRCLES) -> Stages:
    """Full turn at a constant angle (rad; negative to port) until a heading change (rad)."""
    return _stages([(angle, 1.0, jnp.sign(angle), 0.0, 0.0, heading_change)])


def zigzag(angle: Scalar, heading: Scalar, executes: int = 4) -> Stages:
    """Zig-zag or modified zig-zag: +-`angle`, switched when the heading has changed by `heading`.

    First to starboard for a positive angle. `executes` rudder executions, the last of
    which is followed until the heading passes the switching heading once more.
    """
    side = jnp.sign(jnp.asarray(angle, float))
    signs = [(-1.0) ** number for number in range(executes)]
    return _stages([(sign * angle, 1.0, side * sign, 0.0, 0.0, heading) for sign in signs])


def acceleration(seconds: Scalar) -> Stages:
    """Straight ahead at the approach throttle for some time."""
    return _stages([(0.0, 1.0, 0.0, 1.0, 0.0, seconds)])


def stopping() -> Stages:
    """The approach throttle in reverse until dead in the water."""
    return _stages([(0.0, -1.0, 0.0, 0.0, -1.0, 0.0)])


def coasting(seconds: Scalar) -> Stages:
    """Throttle to zero for some time."""
    return _stages([(0.0, 0.0, 0.0, 1.0, 0.0, seconds)])


def pull_out(angle: Scalar, heading_change: Scalar, seconds: Scalar) -> Stages:
    """Turn by a heading change, then rudder amidships for some time."""
    turn = (angle, 1.0, jnp.sign(jnp.asarray(angle, float)), 0.0, 0.0, heading_change)
    return _stages([turn, (0.0, 1.0, 0.0, 1.0, 0.0, seconds)])


def spiral(angle: Scalar, seconds: Scalar) -> Stages:
    """Dieudonne spiral: `angle` rad in ten steps down to -angle and back, each held `seconds` s."""
    down = [1 - k / 5 for k in range(11)]
    shares = [*down, *reversed(down[:-1])]
    return _stages([(share * angle, 1.0, 0.0, 1.0, 0.0, seconds) for share in shares])
