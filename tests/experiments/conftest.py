"""Experiments mix integers and reals as they like; what they call of the library does not."""

import jax
import pytest


@pytest.fixture(autouse=True, scope="module")
def usual_promotion():
    """Dtypes promoted as JAX does by default."""
    jax.config.update("jax_numpy_dtype_promotion", "standard")
    yield
    jax.config.update("jax_numpy_dtype_promotion", "strict")
