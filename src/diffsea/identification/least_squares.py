# pyright: reportArgumentType=false
# Optimistix says float of tolerances that may be traced.
"""Nonlinear least squares with exact Jacobians, as every objective uses it.

Gauss-Newton steps inside a trust region that begins at the whole step (Powell's dogleg). The
damping of Levenberg and Marquardt, which begins at one unit of the normal matrix, takes many
rejected steps to matter beside precise data.

Columns are scaled alike and regularised by priors, so that normal equations are accurate enough;
a QR of the tall Jacobian in every step would cost more than everything else.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from diffsea.types import Scalar


# What a solver is given: residual and Jacobian at some free numbers and arguments.
ResidualAndJacobian = Callable[[Array, Any], tuple[Array, Array]]

REJECTED_SHARE = 1e-3  # of the tolerance: where such steps are rejected, it is at a kink


def value_and_jacobian(
    function: Callable[[Array], Any], at: Float[Array, "n"], at_once: int | None = None
) -> tuple[Any, Any]:
    """A function's value and its derivatives along each coordinate, last axis.

    All derivatives are found together and the value once; or as many `at_once` as divide n.
    """
    along = lambda direction: jax.jvp(function, (at,), (direction,))
    together = jax.vmap(along, out_axes=(None, -1))
    if at_once is None:
        return together(jnp.eye(at.size))
    groups = jnp.eye(at.size).reshape(-1, at_once, at.size)
    values, slopes = jax.lax.map(together, groups)
    value = jax.tree.map(lambda of_groups: of_groups[0], values)
    joined = lambda of_groups: jnp.concatenate(jnp.unstack(of_groups), axis=-1)
    return value, jax.tree.map(joined, slopes)


class DoglegStep(NamedTuple):
    """Where a solution stands after a step."""

    at: Float[Array, "free"]
    cost: float  # sum of squares
    accepted: bool
    length: float  # of the step that was tried, in units of the coordinates
    converged: bool


def dogleg(tolerance: Scalar) -> optx.Dogleg:
    """Powell's dogleg by normal equations."""
    return optx.Dogleg(rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky()))


def solve_least_squares(
    function: ResidualAndJacobian,
    start: Float[Array, "free"],
    args: Any,
    steps: int,
    tolerance: Scalar = 1e-4,
) -> Float[Array, "free"]:
    """Minimise the sum of squares from `start`; it ends after `steps` at the latest."""
    # The solver traces what it is given more than once; what it finds here is traced already.
    traced = eqx.filter_closure_convert(lambda at: function(at, args), start)
    found = optx.least_squares(
        with_known_jacobian(lambda at, traced: traced(at)),
        dogleg(tolerance),
        start,
        traced,
        has_aux=True,
        options={"jac": "fwd"},
        max_steps=steps,
        throw=False,
    )
    return found.value


def iterate_least_squares(
    function: ResidualAndJacobian,
    start: Float[Array, "free"],
    args: Any,
    steps: int,
    tolerance: float = 1e-4,
) -> Iterator[DoglegStep]:
    """The steps of `solve_least_squares`, taken outside of a compiled program.

    `function`, compiled by itself, is called once a step: where compiling takes most of the time
    nothing else need contain it, and progress can be told. Ends with a small accepted step, or
    where even steps of a thousandth of the tolerance are rejected, as at a kink.
    """
    # The solver evaluates only where `y_eval` lies. What is found there beforehand is handed to
    # it: a compiled function that it linearised itself would be split, and compiled once more.
    fn = with_known_jacobian(lambda at, found: found)
    options, tags = {"jac": "fwd"}, frozenset()
    solver, at = dogleg(tolerance), start
    found = function(start, args)
    structure = jax.eval_shape(lambda: fn(start, found))
    state = solver.init(fn, at, found, options, *structure, tags)
    for number in range(steps):
        tried, counted = state.y_eval, int(state.num_accepted_steps)
        length = float(jnp.linalg.norm(tried - at))
        found = function(tried, args) if number else found
        at, state, _ = solver.step(fn, at, found, options, state, tags)
        accepted = int(state.num_accepted_steps) > counted
        residual = state.f_info.residual
        ended = bool(solver.terminate(fn, at, found, options, state, tags)[0])
        ended = ended or (not accepted and 0 < length < REJECTED_SHARE * tolerance)
        yield DoglegStep(at, float(residual @ residual), accepted, length, ended)
        if ended:
            return


def with_known_jacobian(
    function: ResidualAndJacobian,
) -> Callable[[Array, Any], tuple[Array, tuple[Array, Array]]]:
    """A residual whose derivative is the Jacobian found beside it, and both once more as `aux`.

    A solver differentiates the residual in several places; this way an expensive one is traced
    and compiled once.
    """

    @eqx.filter_custom_jvp
    def with_jacobian(at: Array, *, args: Any) -> tuple[Array, tuple[Array, Array]]:
        residual, J = function(at, args)
        return residual, (residual, J)

    @with_jacobian.def_jvp
    def _(primals: tuple[Array], tangents: tuple[Array], *, args: Any) -> tuple[Any, Any]:
        residual, J = function(primals[0], args)
        still = jnp.zeros_like(residual), jnp.zeros_like(J)
        return (residual, (residual, J)), (J @ tangents[0], still)

    return lambda at, args: with_jacobian(at, args=args)
