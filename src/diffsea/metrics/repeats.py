"""What repeated trials say: mean with its interval, and how well one series follows another."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.stats import t as student

from diffsea.errors import UserError


def mean_and_half_width(
    values: Sequence[float] | Float[np.ndarray, "trial"], level: float = 0.95
) -> tuple[float, float]:
    """Mean of repeats and the half-width of its interval by Student's t, N - 1 degrees.

    `t S / sqrt(N)` with the sample's standard deviation S (Coleman and Steele 2009; Gavrilin and
    Steen 2017, eqs. 3 and 4). It covers the mean of such trials, not what a trial without
    their common disturbances would show.

    Raises:
        UserError: fewer than two values.
    """
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    if known.size < 2:
        raise UserError(f"{known.size} repeats have no scatter to judge by; give two or more")
    spread = float(np.std(known, ddof=1))
    factor = float(student.ppf(0.5 + level / 2, known.size - 1))
    return float(np.mean(known)), factor * spread / math.sqrt(known.size)


def fit_percent(
    measured: Float[Array, "*batch time"],
    predicted: Float[Array, "*batch time"],
    known: Bool[Array, "*batch time"] | None = None,
) -> Float[Array, "*batch"]:
    """Normalised root-mean-square fit: 100 (1 - |y - y_hat| / |y - mean y|) per cent.

    100 is perfect, 0 is no better than the mean of the measured series, below is worse
    (Gavrilin and Steen 2017, eq. 2). `known` marks the samples that count, all if absent.
    """
    measured, predicted = jnp.asarray(measured), jnp.asarray(predicted)
    weight = jnp.ones(measured.shape) if known is None else jnp.asarray(known, float)
    values = jnp.where(weight > 0, measured, 0.0)
    off = jnp.where(weight > 0, measured - predicted, 0.0)
    mean = values.sum(-1, keepdims=True) / weight.sum(-1, keepdims=True)
    about = jnp.sqrt(jnp.sum(weight * (values - mean) ** 2, axis=-1))
    return 100 * (1 - jnp.sqrt(jnp.sum(off**2, axis=-1)) / about)
