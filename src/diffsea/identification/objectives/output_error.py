"""Free-run output error: the parameters that predict recordings best from a first state alone.

No process noise: what gusts do is taken for sensor noise, so estimates are less sure than by
the innovation likelihood, but they are those that an open-loop simulation needs. Multiple
shooting keeps it convergent from far away, a soft loss keeps outliers from ruling it.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import Estimate, Progress, no_progress, posterior_estimate
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.objectives import shooting
from diffsea.identification.objectives.base import Innovations
from diffsea.identification.objectives.shooting import (
    ShootingWindows,
    Shot,
    ShotSlopes,
    shooting_windows,
)
from diffsea.identification.problem import Problem, Static
from diffsea.parameters import Parameter
from diffsea.scales import time_scale
from diffsea.statistics import autocorrelation, long_run_covariance, robust_scale


WINDOW = 20.0  # sqrt(L / g)
SOFT = 3.0  # standard deviations beyond which a misfit counts less and less
JOINTS = (1.0, 0.1, 0.01)  # how far windows may be apart, in standard deviations of sensors
STEPS = 40  # of Levenberg-Marquardt for each of them


@dataclasses.dataclass(frozen=True)
class ShootingState:
    """Parameters and first states, and the scales by which misfits are judged."""

    coordinates: Float[np.ndarray, "coordinate"]
    states: Float[np.ndarray, "window 6"]
    sigma: Float[np.ndarray, "6"]
    joint: Float[np.ndarray, "6"]


class OutputError:
    """The objective: `problem` says what is free, the noise scales of its filter are not used."""

    def __init__(self, problem: Problem, seconds: float | None = None):
        """Set up; windows of `seconds`, 20 sqrt(L / g) by default."""
        seconds = (
            WINDOW * time_scale(float(problem.base.rigid_body.length))
            if seconds is None
            else seconds
        )
        self.problem = problem
        self.windows: ShootingWindows = shooting_windows(problem.dataset, seconds)
        cut = self.windows.number, self.windows.begins, self.windows.joins
        windows = tuple(jnp.asarray(c) for c in cut)
        self._fixed = (problem.base, Static(problem.layout), problem.dataset, windows)
        # A first state is known from the filter and what was measured, and otherwise hardly.
        self._broad = np.sqrt(np.asarray(first_variance(problem.base)))
        starts = np.asarray(problem.dataset.starts)
        self._firsts = self.windows.number[np.flatnonzero(starts)]

    def fit(
        self,
        free: tuple[str, ...],
        start: np.ndarray | None = None,
        progress: Progress = no_progress,
    ) -> Estimate:
        """Fit the free parameters by name, from `start`."""
        problem = self.problem
        coordinates, noise = problem.start()
        coordinates = coordinates if start is None else np.array(start, float)
        index = np.array(problem.layout.indices(free), int)
        states = np.asarray(problem.run_filter(coordinates, noise).state)[self.windows.begins]
        self._guess = states.copy()
        sigma = np.exp(np.asarray(noise.sensor))
        point, path = ShootingState(coordinates, states, sigma, sigma), []
        for joint in JOINTS:
            point = self._rescaled(point, joint)
            for number in range(3):
                point, cost = self._descend(point, index)
                path.append(cost)
                progress(f"windows {joint:g} apart, round {number + 1}: misfit {cost:.1f}")
                old, point = point.sigma, self._rescaled(point, joint)
                if np.all(np.abs(np.log(point.sigma / old)) < 0.02):
                    break
        return dataclasses.replace(self._judged(free, point, index), path=tuple(path))

    def refit(self, fitted: Estimate, free: tuple[str, ...], start: np.ndarray) -> Estimate:
        """Fit with the scales of an earlier fit, from its first states."""
        index = np.array(self.problem.layout.indices(free), int)
        point = dataclasses.replace(fitted.noise, coordinates=np.array(start, float))
        point, _ = self._descend(point, index)
        return self._judged(free, point, index)

    def cost(self, coordinates: np.ndarray, fitted: Estimate) -> float:
        """-2 log posterior with the scales of a fit, first states following to first order."""
        point = dataclasses.replace(fitted.noise, coordinates=fitted.coordinates)
        index = fitted.index
        A, g, _ = self._normal(point, index)
        step = np.zeros(len(g))
        n = len(index)
        step[:n] = (coordinates - fitted.coordinates)[index]
        step[n:] = -np.linalg.solve(A[n:, n:], A[n:, :n] @ step[:n])
        return self._cost(self._moved(point, index, step))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The vessel's parameters."""
        return self.problem.layout.parameters

    def explore(self, starts: np.ndarray, free: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """As the innovation likelihood does, whose basin is wider."""
        return Innovations(self.problem).explore(starts, free)

    def _shot(self, point: ShootingState) -> Shot:
        return shooting.shoot(
            *self._fixed, jnp.asarray(point.coordinates), jnp.asarray(point.states)
        )

    def _rescaled(self, point: ShootingState, joint: float) -> ShootingState:
        """Scales from the misfits themselves."""
        misfit = np.asarray(self._shot(point).misfit)
        known = np.asarray(self.problem.dataset.known)
        sigma = point.sigma.copy()
        for k in np.flatnonzero(known.any(0)):
            sigma[k] = _scale(misfit[known[:, k], k])
        return dataclasses.replace(point, sigma=sigma, joint=joint * sigma)

    def _cost(self, point: ShootingState) -> float:
        shot = self._shot(point)
        white = np.asarray(shot.misfit) / point.sigma
        gap = (np.asarray(shot.end) - point.states[self._later]) / point.joint
        away = (point.states - self._guess)[self._firsts] / self._broad
        layout = self.problem.layout
        prior = np.asarray(layout.strains(point.coordinates, layout.spreads()))
        soft = 2 * SOFT**2 * (np.sqrt(1 + (white / SOFT) ** 2) - 1)
        total = soft.sum() + (gap**2).sum() + (away**2).sum() + (prior**2).sum()
        known = np.asarray(self.problem.dataset.known).sum(0)
        return float(total + 2 * known @ np.log(point.sigma))

    @property
    def _later(self) -> np.ndarray:
        return self.windows.number[self.windows.joins]

    def _descend(self, point: ShootingState, index: np.ndarray) -> tuple[ShootingState, float]:
        """Levenberg-Marquardt with the scales as they are."""
        damping, cost = 1e-3, self._cost(point)
        for _ in range(STEPS):
            A, g, _ = self._normal(point, index)
            for _ in range(8):
                step = -np.linalg.solve(A + damping * np.diag(np.diag(A)), g)
                trial = self._moved(point, index, step)
                value = self._cost(trial)
                if value < cost:
                    break
                damping *= 5
            else:
                return point, cost
            drop, point, cost, damping = cost - value, trial, value, max(damping / 5, 1e-9)
            if drop < 1e-3 + 1e-7 * abs(cost):
                break
        return point, cost

    def _moved(self, point: ShootingState, index: np.ndarray, step: np.ndarray) -> ShootingState:
        coordinates = point.coordinates.copy()
        coordinates[index] += step[: len(index)]
        states = point.states + step[len(index) :].reshape(-1, 6) * point.sigma
        return dataclasses.replace(point, coordinates=coordinates, states=states)

    def _normal(
        self, point: ShootingState, index: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Gauss-Newton matrix and gradient of parameters and states, and the columns.

        States are counted in standard deviations of sensors.
        """
        directions = jnp.eye(len(point.coordinates))[index]
        shot, slopes = shooting.shoot_with_slopes(
            *self._fixed, jnp.asarray(point.coordinates), jnp.asarray(point.states), directions
        )
        white = np.asarray(shot.misfit) / point.sigma
        root = np.sqrt(_weight(white))
        r = root * white
        P, S = _columns(slopes, root / point.sigma, point.sigma)
        n, size = len(index), len(index) + 6 * self.windows.count
        A, g = np.zeros((size, size)), np.zeros(size)
        flat = P.reshape(-1, n)
        A[:n, :n] = flat.T @ flat
        g[:n] = flat.T @ r.ravel()
        edges = np.flatnonzero(self.windows.begins)
        mixed = np.add.reduceat(np.einsum("rci,rck->rik", P, S), edges)
        own = np.add.reduceat(np.einsum("rck,rcl->rkl", S, S), edges)
        score = np.add.reduceat(np.einsum("rck,rc->rk", S, r), edges)
        for w in range(self.windows.count):
            at = slice(n + 6 * w, n + 6 * w + 6)
            A[:n, at], A[at, :n] = mixed[w], mixed[w].T
            A[at, at], g[at] = own[w], score[w]
        self._join(A, g, point, shot, slopes, n)
        self._regularise(A, g, point, index)
        return A, g, (P, S, r)

    def _join(
        self,
        A: np.ndarray,
        g: np.ndarray,
        point: ShootingState,
        shot: Shot,
        slopes: ShotSlopes,
        n: int,
    ) -> None:
        """Add what windows are apart."""
        gap = (np.asarray(shot.end) - point.states[self._later]) / point.joint
        by_parameter = np.asarray(slopes.by_parameter.end) / point.joint
        by_state = np.asarray(slopes.by_state.end) / point.joint * point.sigma[:, None, None]
        for j, w in enumerate(self._later):
            columns = np.r_[0:n, n + 6 * (w - 1) : n + 6 * (w + 1)]
            J = np.hstack(
                [by_parameter[:, j].T, by_state[:, j].T, -np.diag(point.sigma / point.joint)]
            )
            A[np.ix_(columns, columns)] += J.T @ J
            g[columns] += J.T @ gap[j]

    def _regularise(
        self, A: np.ndarray, g: np.ndarray, point: ShootingState, index: np.ndarray
    ) -> None:
        """Add the priors of parameters and of each run's first state."""
        n, spreads = len(index), self.problem.layout.local_spreads(point.coordinates)[index]
        A[np.arange(n), np.arange(n)] += 1 / spreads**2
        g[:n] += point.coordinates[index] / spreads**2
        for w in self._firsts:
            at = np.arange(n + 6 * w, n + 6 * w + 6)
            weight = point.sigma / self._broad
            A[at, at] += weight**2
            g[at] += weight * (point.states[w] - self._guess[w]) / self._broad

    def _judged(self, free: tuple[str, ...], point: ShootingState, index: np.ndarray) -> Estimate:
        """The estimate, its states eliminated, its misfits taken for as coloured as they are."""
        A, _, (P, S, r) = self._normal(point, index)
        n, spreads = len(index), self.problem.layout.local_spreads(point.coordinates)
        shares = np.linalg.solve(A[n:, n:], A[n:, :n]).reshape(-1, 6, n)
        E = P - np.einsum("rck,rki->rci", S, shares[self.windows.number])
        prior = np.diag(1 / spreads[index] ** 2)
        information = A[:n, :n] - A[:n, n:] @ shares.reshape(-1, n) - prior
        t = np.asarray(self.problem.dataset.dt)
        lags = (
            int(
                WINDOW
                * time_scale(float(self.problem.base.rigid_body.length))
                / np.median(t[t > 0])
            )
            + 1
        )
        correlation = autocorrelation(r, np.asarray(self.problem.dataset.run), lags)
        coloured = long_run_covariance(E.reshape(-1, n), correlation)
        return posterior_estimate(
            free, point.coordinates, self._cost(point), index, spreads, information, coloured, point
        )


def _scale(values: np.ndarray) -> float:
    """Standard deviation of the bulk of some misfits: each counts for nine variances at most."""
    scale = max(robust_scale(values), 1e-9)
    grid = np.linspace(-8, 8, 2001)
    normal = np.exp(-(grid**2) / 2) / np.exp(-(grid**2) / 2).sum()
    usual = float(normal @ (grid * _weight(grid)) ** 2)
    for _ in range(20):
        white = values / scale
        scale *= float(np.sqrt(np.mean((white * _weight(white)) ** 2) / usual))
    return scale


def _weight(white: np.ndarray) -> np.ndarray:
    """Weight of a squared misfit under the soft loss."""
    return 1 / np.sqrt(1 + (white / SOFT) ** 2)


def _columns(
    slopes: ShotSlopes, scale: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighed derivatives of the misfits, (row, channel, coordinate) and (..., state)."""
    P = np.moveaxis(np.asarray(slopes.by_parameter.misfit), 0, -1) * scale[..., None]
    S = np.moveaxis(np.asarray(slopes.by_state.misfit), 0, -1) * scale[..., None] * sigma
    return P, S
