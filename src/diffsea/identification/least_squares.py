"""Nonlinear least squares with exact Jacobians, as every objective uses it."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from diffsea.types import Scalar


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
    return optx.least_squares(
        residual, _solver(tolerance), start, args, options={"jac": "fwd"}, max_steps=steps,
        throw=False,
    ).value  # fmt: skip


def value_and_jacobian(function: Callable[[Array], Any], at: Float[Array, "n"]) -> tuple[Any, Any]:
    """A function's value, calculated once, and its derivatives along each coordinate, last axis."""
    along = lambda direction: jax.jvp(function, (at,), (direction,))
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(at.size))


class _TrustRegion(optx.AbstractSearch):
    """Optimistix's trust region with another first radius, which it has fixed at one."""

    radius: Scalar
    inner: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion()

    def init(self, y: Any, f_info_struct: Any) -> Any:
        state = self.inner.init(y, f_info_struct)
        return jax.tree.map(lambda _: jnp.asarray(self.radius, float), state)

    def step(self, *given: Any) -> tuple:
        return self.inner.step(*given)


def _solver(tolerance: Scalar, radius: Scalar = 1.0) -> optx.Dogleg:
    solver = optx.Dogleg(rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky()))
    return eqx.tree_at(lambda s: s.search, solver, _TrustRegion(radius))


ONCE = 1e300  # a tolerance that ends a solution where it starts


def least_squares_from(
    function: Callable[[Array, Any], tuple[Array, Array]],
    start: Float[Array, "free"],
    args: Any,
    steps: int,
    tolerance: Scalar = 1e-4,
    radius: Scalar = 1.0,
) -> tuple[Float[Array, "free"], Float[Array, "value"], Float[Array, "value free"]]:
    """As `least_squares` for a `function` that returns residual and Jacobian.

    The trust region begins at `radius`.

    Besides the minimum it returns both of them at an earlier point of the way; with a tolerance
    of `ONCE` that is the start. One compiled program thus serves fits and Jacobians.
    """
    found = optx.least_squares(
        lambda at, args: _both(at, given=(function, args)), _solver(tolerance, radius), start, args,
        has_aux=True, options={"jac": "fwd"}, max_steps=steps, throw=False,
    )  # fmt: skip
    return found.value, *found.aux


class Step(NamedTuple):
    """Where a solution stands after a step."""

    at: Float[Array, "free"]
    cost: float  # sum of squares
    accepted: bool
    length: float  # of the step that was tried, in units of the coordinates


def least_squares_steps(
    function: Callable[[Array, Any], tuple[Array, Array]],
    start: Float[Array, "free"],
    args: Any,
    steps: int,
    tolerance: float = 1e-4,
) -> Iterator[Step]:
    """The steps of `least_squares_from`, taken outside of a compiled program.

    `function`, compiled by itself, is called once a step: where compiling takes most of the time
    nothing else need contain it, and progress can be told. Ends with a small accepted step, or
    where even steps of a thousandth of the tolerance are rejected, as at a kink.
    """
    # The solver evaluates only where `y_eval` lies. What is found there beforehand is handed to
    # it: a compiled function that it linearised itself would be split, and compiled once more.
    fn = lambda at, found: _both(at, given=(lambda at, found: found, found))
    options, tags = {"jac": "fwd"}, frozenset()
    solver, at = _solver(tolerance), start
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
        yield Step(at, float(residual @ residual), accepted, length)
        ended = bool(solver.terminate(fn, at, found, options, state, tags)[0])
        if ended or (not accepted and 0 < length < 1e-3 * tolerance):
            return


@eqx.filter_custom_jvp
def _both(at: Array, *, given: tuple[Callable, Any]) -> tuple[Array, tuple[Array, Array]]:
    """The residual, and residual and Jacobian once more as what is passed along."""
    function, args = given
    residual, J = function(at, args)
    return residual, (residual, J)


@_both.def_jvp
def _both_jvp(primals: tuple, tangents: tuple, *, given: tuple) -> tuple:
    function, args = given
    residual, J = function(primals[0], args)
    still = jnp.zeros_like(residual), jnp.zeros_like(J)
    return (residual, (residual, J)), (J @ tangents[0], still)


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
