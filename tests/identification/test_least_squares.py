"""Steps of nonlinear least squares outside of a compiled program, against scipy."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from diffsea.identification.least_squares import iterate_least_squares, value_and_jacobian


TIMES = np.linspace(0.0, 3.0, 40)
VALUES = 2.0 * np.exp(-0.7 * TIMES) + 0.05 * np.cos(9 * TIMES)


def decay(at, values):
    """Residual and Jacobian of an exponential."""
    shape = jnp.exp(-at[1] * jnp.asarray(TIMES))
    return at[0] * shape - values, jnp.stack([shape, -at[0] * TIMES * shape], 1)


def test_steps_end_where_scipy_does():
    steps = list(iterate_least_squares(decay, jnp.array([0.5, 3.0]), jnp.asarray(VALUES), 50, 1e-8))
    off = lambda at: at[0] * np.exp(-at[1] * TIMES) - VALUES
    expected = optimize.least_squares(off, [0.5, 3.0], xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(steps[-1].at, expected.x, rtol=1e-6)
    assert steps[-1].cost == pytest.approx(2 * expected.cost, rel=1e-9)
    costs = [step.cost for step in steps]
    assert len(steps) > 3 and costs == sorted(costs, reverse=True)


def test_a_residual_that_was_called_before_is_not_compiled_again(caplog):
    def slow(at, values):
        return decay(at, values)

    given = jnp.array([0.5, 3.0]), jnp.asarray(VALUES)
    with jax.log_compiles(), caplog.at_level(logging.DEBUG):
        compiled = jax.jit(slow)
        compiled(*given)
        list(iterate_least_squares(compiled, *given, 50))
    assert sum("Finished XLA compilation of jit(slow)" in text for text in caplog.messages) == 1


@pytest.mark.parametrize("at_once", [1, 2, 3, 6])
def test_derivatives_some_at_once_are_those_of_all_together(at_once):
    def function(x):
        return jnp.outer(x, jnp.sin(x)), {"product": jnp.prod(x)}

    at = jnp.linspace(0.3, 1.7, 6)
    value, slopes = value_and_jacobian(function, at, at_once)
    together = value_and_jacobian(function, at)
    for one, other in zip(jax.tree.leaves((value, slopes)), jax.tree.leaves(together), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-14)
