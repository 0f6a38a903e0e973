"""Where a vessel is relative to the path of a mission: pure functions of the track."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.types import Scalar


Index = Int[Array, ""]
Points = Float[Array, "waypoint 2"]
Track = Float[Array, "time 2"]  # m, north and east


def legs_in_force(points: Points, track: Track, radius: Scalar) -> Int[Array, "time"]:
    """Which leg of the path a vessel is on at each position, whatever steers it.

    A leg ends within `radius` m of its end or abeam of it; one that has no room is passed over at
    once.
    """
    last = points.shape[0] - 2

    def is_over(number: Index, at: Float[Array, "2"]) -> Bool[Array, ""]:
        start, end = points[number], points[number + 1]
        left = jnp.dot(end - at, end - start)
        return (number < last) & ((left <= 0) | (jnp.hypot(*(end - at)) < radius))

    def on_leg(number: Index, at: Float[Array, "2"]) -> tuple[Index, Index]:
        number = jax.lax.while_loop(lambda n: is_over(n, at), lambda n: n + 1, number)
        return number, number

    return jax.lax.scan(on_leg, jnp.zeros((), int), jax.lax.stop_gradient(track))[1]


def path_offsets(points: Points, track: Track, radius: Scalar) -> Float[Array, "time"]:
    """Distance (m) of each position from the path, positive to starboard of it.

    That to the nearest point of the leg in force or of the one before: a corner that is cut or
    overshot is measured from whichever leg is nearer.
    """
    legs = legs_in_force(points, track, radius)
    now, before = (_from_legs(points, one, track) for one in (legs, jnp.maximum(legs - 1, 0)))
    return jnp.where(jnp.abs(now) <= jnp.abs(before), now, before)


def _from_legs(points: Points, legs: Int[Array, "time"], track: Track) -> Float[Array, "time"]:
    """Distance (m) of each position from the nearest point of its leg, positive to starboard."""
    start, along = points[legs], points[legs + 1] - points[legs]
    offset = track - start
    length = jnp.hypot(along[:, 0], along[:, 1])
    abeam = (along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / length
    share = (offset * along).sum(1) / length**2
    outside = jnp.where(share < 0, share, jnp.maximum(share - 1, 0.0)) * length
    # The root has no derivative at a distance of zero, where `abeam` alone is the distance.
    beyond = jnp.hypot(jnp.where(outside == 0, 1.0, abeam), jnp.where(outside == 0, 1.0, outside))
    return jnp.where(outside == 0, abeam, jnp.where(abeam < 0, -beyond, beyond))


def waypoints_reached(points: Points, track: Track, radius: Scalar) -> Bool[Array, "waypoint"]:
    """Whether each waypoint was come within `radius` m of, after the one before."""
    rows = jnp.arange(track.shape[0])
    first, reached = jnp.zeros((), int), []
    for point in points:
        within = (jnp.hypot(*(track - point).T) < radius) & (rows >= first)
        reached.append(jnp.any(within))
        first = jnp.where(reached[-1], jnp.argmax(within), first)
    return jnp.stack(reached)
