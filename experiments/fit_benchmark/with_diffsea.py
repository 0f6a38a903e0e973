"""The library's contestants: its free-run fit, one shot over its simulator, its likelihood.

Beside them optimistix as it comes, over the library's simulator.

Reading the vessel's file and setting up the problem count as part of a fit.
"""

import os

from experiments.fit_benchmark.data import CHANNELS, NAMES, SIGMA, VESSEL, Data
from experiments.fit_benchmark.outcome import Outcome

import numpy as np

from diffsea.runtime import prepare_jax


os.environ["XDG_CACHE_HOME"] = os.devnull  # so that no compiled program outlives its process
prepare_jax()

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx

from diffsea import Trajectory, read_vessel
from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.estimates import Estimate, ShootingState
from diffsea.identification.filter import kalman
from diffsea.identification.filter.latency import SamplePlacement
from diffsea.identification.fit import estimate
from diffsea.identification.least_squares import with_known_jacobian
from diffsea.identification.objectives import output_error
from diffsea.identification.problem import Problem, make_problem


STEPS = 200


def problem_of(data: Data) -> Problem:
    """The problem as a user would set it up, the eight derivatives free."""
    runs = [
        Trajectory(
            data.t, **dict(zip(CHANNELS, measured.T, strict=True)),
            commanded={"port": thrust[:, 0], "starboard": thrust[:, 1]},
            executed={}, extra={}, valid=np.ones(len(data.t), bool),
        )
        for measured, thrust in zip(data.measured, data.thrust, strict=True)
    ]  # fmt: skip
    return make_problem(read_vessel(VESSEL).vessel, runs, NAMES)


def free_run(data: Data) -> Outcome:
    """`OutputError` as the library offers it: windows, soft loss, estimated scales, priors."""
    problem = problem_of(data)
    with Counter() as counter:
        fit = output_error.OutputError(problem)
        fitted = fit.fit(NAMES)
    assert isinstance(fitted.state, ShootingState)
    firsts = fit.windows.number[np.flatnonzero(np.asarray(problem.dataset.starts))]
    return Outcome(
        decoded(problem, fitted.coordinates), fitted.state.states[firsts], counter.shots,
        counter.slopes, away(problem, fitted, data.truth),
    )  # fmt: skip


def innovations(data: Data) -> Outcome:
    """The library's default, which predicts one sample ahead and has no first states."""
    problem = problem_of(data)
    fitted = estimate(problem, NAMES)
    rounds = len(fitted.path) - 1
    return Outcome(
        decoded(problem, fitted.coordinates), None, rounds, 0, away(problem, fitted, data.truth)
    )


def one_shot(data: Data) -> Outcome:
    """The common cost itself: whole runs, exact Jacobian, Levenberg-Marquardt of optimistix.

    The library's own misfits take heading modulo a turn; here it counts turns, as for the others.
    """
    problem = problem_of(data)
    given = problem.base, problem.dataset, jnp.asarray(data.measured[:, 0])
    begin = jnp.zeros(len(NAMES) + data.measured[:, 0].size)
    z, steps = _descended(begin, given, problem.layout)
    z = np.asarray(z)
    first = data.measured[:, 0] + SIGMA * z[len(NAMES) :].reshape(-1, 6)
    return Outcome(decoded(problem, z[: len(NAMES)]), first, int(steps), int(steps))


def optimistix_alone(data: Data) -> Outcome:
    """The common cost from the simulator to optimistix, which differentiates it by itself."""
    problem = problem_of(data)
    given = problem.base, problem.dataset, jnp.asarray(data.measured[:, 0])
    begin = jnp.zeros(len(NAMES) + data.measured[:, 0].size)
    z, steps = _descended_alone(begin, given, problem.layout)
    z = np.asarray(z)
    first = data.measured[:, 0] + SIGMA * z[len(NAMES) :].reshape(-1, 6)
    return Outcome(decoded(problem, z[: len(NAMES)]), first, int(steps), int(steps))


@eqx.filter_jit
def _descended_alone(
    begin: jax.Array, given: tuple, layout: CoordinateLayout
) -> tuple[jax.Array, jax.Array]:
    """Where its Levenberg-Marquardt ends with its defaults, and after how many steps."""

    def residual(z: jax.Array, given: tuple) -> jax.Array:
        at = z[: len(NAMES)], given[2] + SIGMA * z[len(NAMES) :].reshape(-1, 6)
        return _misfits(at, given, layout).ravel()

    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
    found = optx.least_squares(residual, solver, begin, given, max_steps=STEPS, throw=False)
    return found.value, found.stats["num_steps"]


def _misfits(at: tuple, given: tuple, layout: CoordinateLayout) -> jax.Array:
    """(measured - simulated) / sigma, (row, channel), from coordinates and first states."""
    base, dataset, _ = given
    vessel, flows = vessel_at(base, layout, at[0])

    def body(x: jax.Array, inputs: tuple) -> tuple:
        row, first = inputs
        x = jnp.where(row.starts, first, x)
        shown = output_error.expected_measurements(vessel, x, row)
        misfit = jnp.where(row.known, (row.measured - shown) / SIGMA, 0.0)
        return kalman.propagate(vessel, x, row, dataset.substeps), misfit

    as_stamped = SamplePlacement.as_stamped(dataset)
    inputs = kalman.filter_rows(vessel, flows, dataset, as_stamped), at[1][dataset.run]
    return jax.lax.scan(body, jnp.zeros(6), inputs)[1]


def _white(z: jax.Array, args: tuple) -> tuple[jax.Array, jax.Array]:
    """Misfits and their Jacobian; a first state moves its own run only."""
    given, layout = args
    n, dataset, start = len(NAMES), given[1], given[2]
    at = z[:n], start + SIGMA * z[n:].reshape(-1, 6)
    still = jnp.zeros(n), jnp.zeros_like(start)

    def along(tangent: tuple) -> jax.Array:
        return jax.jvp(lambda a: _misfits(a, given, layout), (at,), (tangent,))[1]

    by_parameter = jax.vmap(lambda d: along((d, still[1])))(jnp.eye(n))
    by_state = jax.vmap(lambda d: along((still[0], still[1] + d)))(jnp.diag(jnp.asarray(SIGMA)))
    own = dataset.run[:, None] == jnp.arange(len(start))  # row, run
    spread = jnp.where(own[:, None, :, None], jnp.moveaxis(by_state, 0, -1)[:, :, None], 0.0)
    J = jnp.concatenate(
        [jnp.moveaxis(by_parameter, 0, -1), spread.reshape(*spread.shape[:2], -1)], -1
    )
    return _misfits(at, given, layout).ravel(), J.reshape(-1, z.size)


@eqx.filter_jit
def _descended(
    begin: jax.Array, given: tuple, layout: CoordinateLayout
) -> tuple[jax.Array, jax.Array]:
    """Where Levenberg-Marquardt ends, and after how many steps.

    As identification/least_squares.py has it, whose function does not tell the steps.
    """
    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6, linear_solver=lx.Normal(lx.Cholesky()))
    found = optx.least_squares(
        with_known_jacobian(_white), solver, begin, (given, layout), has_aux=True,
        options={"jac": "fwd"}, max_steps=STEPS, throw=False,
    )  # fmt: skip
    return found.value, found.stats["num_steps"]


def decoded(problem: Problem, coordinates: np.ndarray) -> np.ndarray:
    """Derivatives at an estimate."""
    pairs = zip(problem.layout.parameters, coordinates, strict=True)
    return np.array([float(parameter.decode(z)) for parameter, z in pairs])


def away(problem: Problem, fitted: Estimate, truth: np.ndarray) -> np.ndarray:
    """Estimates less the truth in standard errors, in the coordinates of the fit."""
    pairs = zip(problem.layout.parameters, truth, strict=True)
    return (fitted.coordinates - [parameter.encode(v) for parameter, v in pairs]) / fitted.stds


class Counter:
    """Counts the simulations of a free-run fit while it lasts."""

    def __enter__(self) -> "Counter":
        self.shots = self.slopes = 0
        self._kept = output_error.shoot, output_error.shoot_with_slopes
        output_error.shoot, output_error.shoot_with_slopes = self._shoot, self._slopes
        return self

    def __exit__(self, *_: object) -> None:
        output_error.shoot, output_error.shoot_with_slopes = self._kept

    def _shoot(self, *args):
        self.shots += 1
        return self._kept[0](*args)

    def _slopes(self, *args):
        self.slopes += 1
        return self._kept[1](*args)
