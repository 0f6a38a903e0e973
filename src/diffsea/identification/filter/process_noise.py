"""Process and sensor noise, and the covariance of a Kalman filter that knows of both.

The filter's state is the vessel's six numbers and three accelerations by gusts that last:
first-order Gauss-Markov processes, besides gusts that are white. Were lasting gusts taken for
white ones, the fit would bend the vessel until its own dynamics had their autocorrelation (a
thruster's lag comes out a quarter too short).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Noise(eqx.Module):
    """Logarithms of the noise scales."""

    gust: Float[Array, "3"]  # white, of u (m/s), v (m/s), r (rad/s), per square root of a second
    slow: Float[Array, "3"]  # lasting, standard deviation of the acceleration (m/s^2, rad/s^2)
    memory: Float[Array, "3"]  # time constant (s) of the lasting ones
    sensor: Float[Array, "6"]  # of x, y (m), psi (rad), u, v (m/s), r (rad/s)

    @staticmethod
    def of(scales: Float[Array, "15"] | Float[np.ndarray, "15"]) -> "Noise":
        """From all logarithms in one array."""
        return Noise(*(jnp.asarray(part) for part in jnp.split(jnp.asarray(scales), (3, 6, 9))))

    @property
    def scales(self) -> Float[Array, "15"]:
        """All logarithms in one array."""
        return jnp.concatenate([self.gust, self.slow, self.memory, self.sensor])


class GustPropagation(eqx.Module):
    """What gusts do within each row, exactly for constant velocity of the vessel."""

    decay: Float[Array, "row 3"]  # share of a lasting acceleration left at the end
    half: Float[Array, "row 3"]  # half the speed it gives, per unit at the start (s)


def gust_propagation(
    noise: Noise, dt: Float[Array, "row"]
) -> tuple[GustPropagation, Float[Array, "row 9 9"]]:
    """Propagation of lasting gusts over each row, and the covariance that all gusts add.

    Exact integrals of a first-order Gauss-Markov acceleration and of the speed it gives
    (Jazwinski 1970, section 4.9); as the memory shrinks they become those of white noise.
    """
    memory = jnp.exp(noise.memory)
    share = dt[:, None] / memory
    decay = jnp.exp(-share)
    power = jnp.exp(2 * noise.slow)
    speed = power * memory**2 * (2 * share - 3 + 4 * decay - decay**2)
    speed = speed + jnp.exp(2 * noise.gust) * dt[:, None]
    both = power * memory * (1 - decay) ** 2
    left = power * (1 - decay**2)
    still = jnp.zeros_like(speed)
    diagonal = jnp.concatenate([still, speed, left], axis=1)
    beside = jnp.concatenate([still, both], axis=1)
    upper = jax.vmap(lambda row: jnp.diag(row, 3))(beside)
    Q = jax.vmap(jnp.diag)(diagonal) + upper + upper.mT
    return GustPropagation(decay, 0.5 * memory * (1 - decay)), Q
