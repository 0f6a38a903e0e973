"""Nonlinear least squares with exact Jacobians, as every objective uses it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float


def least_squares(
    residual: Callable[[Float[Array, "free"], Any], Float[Array, "value"]],
    start: Float[Array, "free"],
    args: Any,
    steps: int,
    tolerance: float = 1e-4,
) -> Float[Array, "free"]:
    """Minimise the sum of squares from `start`; it ends after `steps` at the latest.

    Gauss-Newton steps inside a trust region that begins at one unit of the coordinates, about
    a prior's width (Powell's dogleg). The damping of Levenberg and Marquardt, which begins at
    one unit of the normal matrix, takes many rejected steps to matter beside precise data.

    Columns are scaled alike and regularised by priors, so that normal equations are accurate
    enough; a QR of the tall Jacobian in every step would cost more than everything else.
    """
    solver = optx.Dogleg(rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky()))
    return optx.least_squares(
        residual, solver, start, args, options={"jac": "fwd"}, max_steps=steps, throw=False
    ).value


@eqx.filter_custom_jvp
def _value(at: Array, *, given: tuple[Callable, Any]) -> Array:
    """The residual; its derivative is a product with the Jacobian found alongside it."""
    function, args = given
    return function(at, args)[0]


@_value.def_jvp
def _value_jvp(primals: tuple, tangents: tuple, *, given: tuple) -> tuple[Array, Array]:
    function, args = given
    residual, J = function(primals[0], args)
    return residual, J @ tangents[0]


def with_known_jacobian(
    function: Callable[[Array, Any], tuple[Array, Array]],
) -> Callable[[Array, Any], Array]:
    """A residual whose derivative is a Jacobian that `function` returns beside it.

    A solver differentiates the residual in several places; this way an expensive one is
    traced and compiled once.
    """
    return lambda at, args: _value(at, given=(function, args))
