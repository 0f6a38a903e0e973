"""Output error: the parameters that predict recordings best from a first state alone.

No process noise: what gusts do is taken for sensor noise, so estimates are less sure than by
the innovation likelihood, but they are those that an open-loop simulation needs. A soft loss keeps
outliers from ruling it.

A long simulation from poor parameters drifts so far that its misfit says nothing about the way
back. In multiple shooting (Bock 1983) runs are simulated in windows that start anew, each from a
state of its own, and keep near the data; what a window's end and the next one's start differ by is
a misfit too, which is weighed more and more until the windows join.

Levenberg-Marquardt is written out because its normal equations are not dense: a window's data
move with its own first state only, so that six columns hold the derivatives by all of them. A
solver that is handed the whole Jacobian needs, with eighty windows, forty times the memory.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.budget import current_budget
from diffsea.identification.coordinates import CoordinateLayout, vessel_at
from diffsea.identification.data.dataset import Dataset
from diffsea.identification.estimates import (
    Estimate,
    FitOutcome,
    ShootingState,
    is_at_bound,
    posterior_estimate,
)
from diffsea.identification.filter.corrections import corrected
from diffsea.identification.filter.kalman import (
    FilterRow,
    filter_rows,
    first_variance,
    innovation_of,
    propagate,
)
from diffsea.identification.filter.latency import SamplePlacement
from diffsea.identification.objectives.base import AbstractObjective, Costs, Starts
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.problem import Coordinates, FreeIndex, Names, Problem
from diffsea.progress import PartialProgress, Progress, no_progress
from diffsea.scales import time_scale
from diffsea.statistics import autocorrelation, long_run_covariance, robust_scale
from diffsea.types import State
from diffsea.vessel.base import Vessel


WINDOW_LIMIT = 80  # the normal equations have six rows for each
DIVERGED = 1e6  # misfit of a simulation that diverges, in the channel's unit
WINDOW = 20.0  # of a window, in sqrt(L / g): short against the drift of a poor first guess
SOFT = 3.0  # standard deviations beyond which a misfit counts less and less
JOINTS = (1.0, 0.1, 0.01)  # how far windows may be apart, in standard deviations of sensors
JOINT_ROUNDS = 3  # of descent and new scales for each of them
SETTLED_SCALE = 0.02  # of the logarithm of a scale: below, another round changes nothing
STEP_LIMIT = 40  # of Levenberg-Marquardt in one descent
DAMPINGS_TRIED = 8  # in one step, each five times the one before
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9  # over the diagonal of the normal equations
LEAST_DROP, RELATIVE_DROP = 1e-3, 1e-7  # of the cost, below which a step is the last


class ShootingWindows(eqx.Module):
    """How rows fall into windows, in order along the data set."""

    number: Int[Array, "row"]  # of the row's window
    begins: Bool[Array, "row"]
    joins: Int[Array, "join"]  # rows at which a window begins where one of its run ended
    count: int = eqx.field(static=True)


def shooting_windows(dataset: Dataset, seconds: float) -> ShootingWindows:
    """Windows of about `seconds`; longer where there would be too many."""
    t, starts = np.asarray(dataset.run_time), np.asarray(dataset.starts)
    run = np.maximum(np.cumsum(starts) - 1, 0)
    first = t[np.flatnonzero(starts)][run]
    total = sum(np.ptp(t[run == k]) for k in range(dataset.runs))
    seconds = max(seconds, total / WINDOW_LIMIT)
    inside = np.floor((t - first) / seconds + 1e-9).astype(int)
    spare = ~dataset.recorded_rows & (np.asarray(dataset.dt) == 0)
    inside[spare | dataset.lead_in] = -1  # they stay in the last window
    inside = np.where(inside < 0, np.maximum.accumulate(np.where(inside < 0, 0, inside)), inside)
    begins = starts | (np.diff(inside, prepend=-1) > 0)
    begins &= np.asarray(dataset.dt) > 0
    begins[starts] = True
    number = np.maximum(np.cumsum(begins) - 1, 0)
    joins = jnp.asarray(np.flatnonzero(begins & ~starts))
    return ShootingWindows(jnp.asarray(number), jnp.asarray(begins), joins, int(number[-1]) + 1)


class ShootingInputs(eqx.Module):
    """What the compiled simulation of all windows needs beside coordinates and states."""

    base: Vessel
    layout: CoordinateLayout = eqx.field(static=True)
    dataset: Dataset
    windows: ShootingWindows


class Shot(eqx.Module):
    """Misfits of a simulation: measured less shown, and each window's end at the next's start."""

    misfit: Float[Array, "*slope row 6"]  # zero where nothing was measured
    end: Float[Array, "*slope join 6"]


def simulate_windows(
    inputs: ShootingInputs,
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
) -> Shot:
    """Simulate every window from its first state, without any correction."""
    vessel, flows = vessel_at(inputs.base, inputs.layout, coordinates)
    vessel, dataset = corrected(vessel, inputs.dataset)

    def body(x: Float[Array, "6"], row_inputs: tuple) -> tuple:
        row, begin, first = row_inputs
        end = x
        x = jnp.where(begin, first, x)
        expected = expected_measurements(vessel, x, row)
        return propagate(vessel, x, row, dataset.substeps), (innovation_of(row, expected), end)

    windows = inputs.windows
    as_stamped = SamplePlacement.as_stamped(dataset)
    rows = filter_rows(vessel, flows, dataset, as_stamped), windows.begins, states[windows.number]
    misfit, end = jax.lax.scan(body, jnp.zeros(6), rows)[1]
    return Shot(jnp.where(jnp.isfinite(misfit), misfit, DIVERGED), end[windows.joins])


def expected_measurements(
    vessel: Vessel, x: Float[Array, "6"], row: FilterRow
) -> Float[Array, "6"]:
    """What the sensors should show in a state, delayed channels by a Taylor polynomial."""
    rate = lambda at: vessel.rate(at, row.actuation, row.flow, row.run_time)
    state = jax.tree.map(jnp.asarray, State(*x))
    first, second = jax.jvp(rate, (state,), (rate(state),))
    return vessel.sensors.measure(state, first, second)


shoot = eqx.filter_jit(simulate_windows)


@eqx.filter_jit
def shoot_with_slopes(
    inputs: ShootingInputs,
    coordinates: Float[Array, "coordinate"],
    states: Float[Array, "window 6"],
    directions: Float[Array, "free coordinate"],
) -> tuple[Shot, Shot]:
    """The shot and its slopes: along the directions, then by the first state of a window.

    That is the state of the row's own window, and of the earlier one of a join: windows share
    their six directions of differentiation.
    """
    # All directions together, so that the run itself is simulated once.
    free = directions.shape[0]
    along = jnp.concatenate([directions, jnp.zeros((6, coordinates.size))])
    first = jnp.concatenate([jnp.zeros((free, 6)), jnp.eye(6)])
    first = jnp.broadcast_to(first[:, None, :], (free + 6, *states.shape))

    def derivative(d: Array, f: Array) -> tuple[Shot, Shot]:
        simulate = lambda *at: simulate_windows(inputs, *at)
        return jax.jvp(simulate, (coordinates, states), (d, f))

    return jax.vmap(derivative, out_axes=(None, 0))(along, first)


@dataclasses.dataclass(frozen=True)
class NormalEquations:
    """Gauss-Newton matrix and gradient of parameters and states, and weighed derivatives.

    States are counted in standard deviations of sensors.
    """

    matrix: Float[np.ndarray, "n n"]
    gradient: Float[np.ndarray, "n"]  # half that of the cost
    by_parameter: Float[np.ndarray, "row 6 free"]
    by_state: Float[np.ndarray, "row 6 6"]  # by the first state of the row's own window
    misfit: Float[np.ndarray, "row 6"]


class OutputError(AbstractObjective):
    """The objective: `problem` says what is free, the noise scales of its filter are not used."""

    def __init__(self, problem: Problem):
        """Set up, with windows of 20 sqrt(L / g)."""
        self._window_seconds = WINDOW * time_scale(float(problem.base.rigid_body.length))
        self.problem: Problem = problem
        self.base, self.parameters = problem.base, problem.layout.parameters
        self.effects = problem.layout.effects
        self.outliers, self.one_sample_in = {}, {}  # the soft loss leaves nothing out
        self.windows = shooting_windows(problem.dataset, self._window_seconds)
        self._inputs = ShootingInputs(problem.base, problem.layout, problem.dataset, self.windows)
        self._number, self._begins = (
            np.asarray(self.windows.number),
            np.asarray(self.windows.begins),
        )
        self._joined = self._number[self.windows.joins]  # windows that follow another
        # A first state is known from the filter and what was measured, and otherwise hardly.
        self._broad = np.sqrt(np.asarray(first_variance(problem.base)))
        self._firsts = self._number[np.asarray(problem.dataset.starts)]

    def start(self, coordinates: Coordinates | None = None) -> ShootingState:
        """Where a fit begins: first states as the filter finds them, scales as expected."""
        first, noise = self.problem.start()
        coordinates = first if coordinates is None else np.array(coordinates, float)
        run = self.problem.run_filter(coordinates, noise)
        states = np.asarray(run.state)[self._begins]
        sigma = np.exp(np.asarray(noise.sensor))
        return ShootingState(coordinates, states, states.copy(), sigma, sigma)

    def fit(
        self, free: Names, start: Coordinates | None = None, progress: Progress = no_progress
    ) -> Estimate:
        """Fit the free parameters by name, from `start`."""
        index = np.array(self.problem.layout.indices(free), int)
        state, path, outcome = self.start(start), [], FitOutcome.CONVERGED
        for joint in JOINTS:
            if path and current_budget().skips("joining the windows of a fit"):
                outcome = FitOutcome.OUT_OF_TIME
                break
            state = self._with_new_scales(state, joint)
            for number in range(JOINT_ROUNDS):
                state, cost, outcome = self._descend(state, index)
                path.append(cost)
                done = (JOINTS.index(joint) + (number + 1) / JOINT_ROUNDS) / len(JOINTS)
                message = f"fitting, step {len(path)}: misfit {cost:.1f}"
                progress(PartialProgress(message, done))
                old, state = state.sigma, self._with_new_scales(state, joint)
                if np.all(np.abs(np.log(state.sigma / old)) < SETTLED_SCALE):
                    break
        return self._with_covariance(free, state, index, outcome, path)

    def refit(self, fitted: Estimate, free: Names, start: Coordinates) -> Estimate:
        """Fit with the scales of an earlier fit, from its first states."""
        index = np.array(self.problem.layout.indices(free), int)
        assert isinstance(fitted.state, ShootingState)
        state = dataclasses.replace(fitted.state, coordinates=np.array(start, float))
        state, _, outcome = self._descend(state, index)
        return self._with_covariance(free, state, index, outcome)

    def cost(self, coordinates: Coordinates, fitted: Estimate) -> float:
        """-2 log posterior with the scales of a fit, first states following to first order."""
        assert isinstance(fitted.state, ShootingState)
        state, index = fitted.state, fitted.index
        equations = self.normal_equations(state, index)
        A, n = equations.matrix, len(index)
        step = np.zeros(len(A))
        step[:n] = (coordinates - fitted.coordinates)[index]
        step[n:] = -np.linalg.solve(A[n:, n:], A[n:, :n] @ step[:n])
        return self.state_cost(self.state_after(state, index, step))

    def squares(self, fitted: Estimate) -> tuple[float, int]:
        """Sum of soft squares of the free runs' misfits, and how many there are."""
        assert isinstance(fitted.state, ShootingState)
        white = np.asarray(self.shot(fitted.state).misfit) / fitted.state.sigma
        return float(soft_square(white).sum()), int(np.asarray(self.problem.dataset.known).sum())

    def explore(self, starts: Starts, free: Names) -> tuple[Starts, Costs]:
        """As the innovation likelihood does, whose basin is wider."""
        return Innovations(self.problem).explore(starts, free)

    def window_gaps(self, state: ShootingState, shot: Shot) -> Float[np.ndarray, "join 6"]:
        """What the windows' ends and the next ones' first states differ by, in units of both."""
        return np.asarray(shot.end) - state.states[self._joined]

    @np.errstate(over="ignore", invalid="ignore")  # of a trial that diverges
    def state_cost(self, state: ShootingState) -> float:
        """-2 log posterior of parameters and first states, the soft loss for a likelihood."""
        shot = self.shot(state)
        white = np.asarray(shot.misfit) / state.sigma
        gap = self.window_gaps(state, shot) / state.joint
        away = (state.states - state.guess)[self._firsts] / self._broad
        layout = self.problem.layout
        prior = np.asarray(layout.strains(state.coordinates, layout.spreads()))
        total = soft_square(white).sum() + (gap**2).sum() + (away**2).sum() + (prior**2).sum()
        known = np.asarray(self.problem.dataset.known).sum(0)
        scales = 2 * known @ np.log(state.sigma)
        return float(total + scales + self.problem.further_cost(state.coordinates))

    def state_after(
        self, state: ShootingState, index: FreeIndex, step: Float[np.ndarray, "n"]
    ) -> ShootingState:
        """After a step of the normal equations' unknowns."""
        coordinates = state.coordinates.copy()
        coordinates[index] += step[: len(index)]
        states = state.states + step[len(index) :].reshape(-1, 6) * state.sigma
        return dataclasses.replace(state, coordinates=coordinates, states=states)

    @np.errstate(over="ignore", invalid="ignore")  # where a profile begins, the vessel may diverge
    def normal_equations(self, state: ShootingState, index: FreeIndex) -> NormalEquations:
        """Normal equations of the free parameters and of all first states."""
        coordinates, states = jnp.asarray(state.coordinates), jnp.asarray(state.states)
        directions = jnp.eye(len(coordinates))[index]
        shot, slopes = shoot_with_slopes(self._inputs, coordinates, states, directions)
        white = np.asarray(shot.misfit) / state.sigma
        root = np.sqrt(soft_weight(white))
        r, scale = root * white, root / state.sigma
        n, size = len(index), len(index) + 6 * self.windows.count
        by_misfit, by_end = np.asarray(slopes.misfit), np.asarray(slopes.end) / state.joint
        P = np.moveaxis(by_misfit[:n], 0, -1) * scale[..., None]
        S = np.moveaxis(by_misfit[n:], 0, -1) * scale[..., None] * state.sigma
        A, g = np.zeros((size, size)), np.zeros(size)
        flat = P.reshape(-1, n)
        A[:n, :n] = flat.T @ flat
        g[:n] = flat.T @ r.ravel()
        edges = np.flatnonzero(self._begins)
        mixed = np.add.reduceat(np.einsum("rci,rck->rik", P, S), edges)
        own = np.add.reduceat(np.einsum("rck,rcl->rkl", S, S), edges)
        score = np.add.reduceat(np.einsum("rck,rc->rk", S, r), edges)
        for w in range(self.windows.count):
            at = slice(n + 6 * w, n + 6 * w + 6)
            A[:n, at], A[at, :n] = mixed[w], mixed[w].T
            A[at, at], g[at] = own[w], score[w]
        # What windows are apart.
        gap = self.window_gaps(state, shot) / state.joint
        by_state = by_end[n:] * state.sigma[:, None, None]
        own_state = -np.diag(state.sigma / state.joint)
        for j, w in enumerate(self._joined):
            columns = np.r_[0:n, n + 6 * (w - 1) : n + 6 * (w + 1)]
            J = np.hstack([by_end[:n, j].T, by_state[:, j].T, own_state])
            A[np.ix_(columns, columns)] += J.T @ J
            g[columns] += J.T @ gap[j]
        # The priors of parameters and of each run's first state.
        spreads = self.problem.layout.local_spreads(state.coordinates)[index]
        A[np.arange(n), np.arange(n)] += 1 / spreads**2
        g[:n] += state.coordinates[index] / spreads**2
        further = self.problem.linear_rows(state.coordinates, index)
        A[:n, :n] += further.information
        g[:n] += further.slopes.T @ further.misfit
        for w in self._firsts:
            at = np.arange(n + 6 * w, n + 6 * w + 6)
            weight = state.sigma / self._broad
            A[at, at] += weight**2
            g[at] += weight * (state.states[w] - state.guess[w]) / self._broad
        return NormalEquations(A, g, P, S, r)

    def shot(self, state: ShootingState) -> Shot:
        """Misfits and ends of the windows, simulated from their first states."""
        coordinates, states = jnp.asarray(state.coordinates), jnp.asarray(state.states)
        return shoot(self._inputs, coordinates, states)

    def _with_new_scales(self, state: ShootingState, joint: float) -> ShootingState:
        """Scales from the misfits themselves."""
        misfit = np.asarray(self.shot(state).misfit)
        known = np.asarray(self.problem.dataset.known)
        sigma = state.sigma.copy()
        for k in np.flatnonzero(known.any(0)):
            sigma[k] = _bulk_scale(misfit[known[:, k], k])
        return dataclasses.replace(state, sigma=sigma, joint=joint * sigma)

    def _descend(
        self, state: ShootingState, index: FreeIndex
    ) -> tuple[ShootingState, float, FitOutcome]:
        """Levenberg-Marquardt with the scales as they are."""
        damping, cost = FIRST_DAMPING, self.state_cost(state)
        for _ in range(STEP_LIMIT):
            if current_budget().skips("steps of a fit"):
                return state, cost, FitOutcome.OUT_OF_TIME
            equations = self.normal_equations(state, index)
            A, g = equations.matrix, equations.gradient
            for _ in range(DAMPINGS_TRIED):
                step = -np.linalg.solve(A + damping * np.diag(np.diag(A)), g)
                trial = self.state_after(state, index, step)
                value = self.state_cost(trial)
                if value < cost:
                    break
                damping *= 5
            else:
                # At the minimum even the shortest step gains nothing but rounding.
                promised = g @ np.linalg.solve(A, g)
                stalled = not promised < LEAST_DROP + RELATIVE_DROP * abs(cost)
                return state, cost, FitOutcome.STALLED if stalled else FitOutcome.CONVERGED
            drop, state, cost = cost - value, trial, value
            damping = max(damping / 5, LEAST_DAMPING)
            if drop < LEAST_DROP + RELATIVE_DROP * abs(cost):
                return state, cost, FitOutcome.CONVERGED
        return state, cost, FitOutcome.STEP_LIMIT

    def _with_covariance(
        self,
        free: Names,
        state: ShootingState,
        index: FreeIndex,
        outcome: FitOutcome,
        path: Sequence[float] = (),
    ) -> Estimate:
        """The estimate, its states eliminated, its misfits as correlated in time as they are."""
        equations = self.normal_equations(state, index)
        A, P, S = equations.matrix, equations.by_parameter, equations.by_state
        n, spreads = len(index), self.problem.layout.local_spreads(state.coordinates)
        shares = np.linalg.solve(A[n:, n:], A[n:, :n]).reshape(-1, 6, n)
        E = P - np.einsum("rck,rki->rci", S, shares[self._number])
        prior = np.diag(1 / spreads[index] ** 2)
        information = A[:n, :n] - A[:n, n:] @ shares.reshape(-1, n) - prior
        dataset = self.problem.dataset
        dt = np.asarray(dataset.dt)
        lags = int(self._window_seconds / np.median(dt[dt > 0])) + 1
        correlation = autocorrelation(equations.misfit, np.asarray(dataset.run), lags)
        further = self.problem.linear_rows(state.coordinates, index).information
        score_variance = long_run_covariance(E.reshape(-1, n), correlation) + further
        at_bound = is_at_bound(self.parameters, state.coordinates, index)
        if at_bound and outcome is FitOutcome.CONVERGED:
            outcome = FitOutcome.BOUNDED
        return posterior_estimate(
            free,
            state.coordinates,
            self.state_cost(state),
            index,
            spreads,
            information,
            score_variance,
            state,
            path,
            outcome,
        )


def _bulk_scale(values: Float[np.ndarray, "value"]) -> float:
    """Standard deviation of the bulk of some misfits: each counts for nine variances at most."""
    scale = max(robust_scale(values), 1e-9)
    grid = np.linspace(-8, 8, 2001)
    normal = np.exp(-(grid**2) / 2) / np.exp(-(grid**2) / 2).sum()
    usual = float(normal @ (grid * soft_weight(grid)) ** 2)
    for _ in range(20):
        white = values / scale
        scale *= float(np.sqrt(np.mean((white * soft_weight(white)) ** 2) / usual))
    return scale


def soft_square(white: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The soft loss: the square of a small misfit, and less than it of a large one."""
    return 2 * SOFT**2 * (np.hypot(1.0, white / SOFT) - 1)


def soft_weight(white: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Weight of a squared misfit under the soft loss."""
    return 1 / np.hypot(1.0, white / SOFT)
