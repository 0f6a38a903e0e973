"""The circle through the steady part of a turn."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


# Spread of the points, relative to its larger axis, below which they lie on a line.
_FLATTEST = 1e-6


def fitted_radius(
    x: Float[Array, "time"], y: Float[Array, "time"], chosen: Bool[Array, "time"]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Radius (m) of the circle nearest to the chosen points, and whether there is one.

    The algebraic fit of Kasa (1976): least squares of x^2 + y^2 = 2ax + 2by + c about the
    centroid, which is linear. Position noise of standard deviation s biases the radius R by
    a relative amount of order (s/R)^2, more on short arcs; ask for a quarter of a circle.
    """
    weight = jnp.where(chosen, 1.0, 0.0) / jnp.maximum(jnp.sum(chosen), 1)
    x, y = (jnp.where(chosen, p - jnp.sum(weight * p), 0.0) for p in (_filled(x), _filled(y)))
    square = x**2 + y**2
    xx, xy, yy, xz, yz, mean = (
        jnp.sum(weight * p) for p in (x * x, x * y, y * y, x * square, y * square, square)
    )
    determinant = xx * yy - xy**2
    found = determinant > _FLATTEST * (xx + yy) ** 2
    # Division and root see harmless numbers where there is no circle: no NaN in derivatives.
    safe = jnp.where(found, determinant, 1.0)
    a, b = (yy * xz - xy * yz) / (2 * safe), (xx * yz - xy * xz) / (2 * safe)
    return jnp.sqrt(jnp.where(found, a**2 + b**2 + mean, 1.0)), found


def _filled(p: Float[Array, "time"]) -> Float[Array, "time"]:
    return jnp.where(jnp.isfinite(p), p, 0.0)
