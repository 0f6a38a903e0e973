"""Waypoint paths, and how far a run is from one.

The paper does not say how large its circle and its zig-zag are; these are ours. All paths have
as many waypoints, so that they share one compiled program.
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


COUNT = 10  # waypoints of a path
Path = Float[np.ndarray, "waypoint 2"]  # m, north and east; all paths begin at the origin


def circle(radius: float = 20.0) -> Path:
    """Once round to starboard, from the origin heading north and back to it."""
    angle = 2 * math.pi * np.arange(1, COUNT + 1) / COUNT
    return np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle))], -1)


def zigzag(leg: float = 20.0, angle: float = math.pi / 4) -> Path:
    """Legs of equal length at `angle` to either side of north; the first is half as long."""
    k = np.arange(COUNT)
    north, east = leg * math.cos(angle), 0.5 * leg * math.sin(angle)
    return np.stack([(k + 0.5) * north, np.where(k % 2 == 0, east, -east)], -1)


def lawn(length: float = 25.0, spacing: float = 10.0) -> Path:
    """Parallel lanes as in a survey: right angles on two short legs in a row."""
    corners = [(length, 0), (length, 1), (0, 1), (0, 2), (length, 2), (length, 3), (0, 3), (0, 4),
               (length, 4), (length, 5)]  # fmt: skip
    return np.array([(north, spacing * lane) for north, lane in corners], float)


PATHS = {"circle": circle(), "zigzag": zigzag()}
WIDE = {"circle": circle(45.0), "zigzag": zigzag(35.0)}  # for a boat that keeps its speed
KEPT_BACK = {"lanes": lawn()}


def off_path(
    waypoints: Float[Array, "waypoint 2"], x: Float[Array, "time"], y: Float[Array, "time"]
) -> Float[Array, "time"]:
    """Distance (m) of positions from the nearest point of the legs, from the origin on."""
    start = jnp.concatenate([jnp.zeros((1, 2)), waypoints[:-1]])
    leg = waypoints - start
    offset = jnp.stack([x, y], -1)[:, None] - start
    share = jnp.clip((offset * leg).sum(-1) / (leg**2).sum(-1), 0.0, 1.0)
    apart = offset - share[..., None] * leg
    # The small constant keeps the root differentiable on the path.
    return jnp.sqrt((apart**2).sum(-1).min(1) + 1e-12)
