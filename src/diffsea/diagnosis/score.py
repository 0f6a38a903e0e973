"""Efficient score tests: of candidates, and of the strongest of many.

With residual e, Jacobian J_n of the nuisances and J_a of a candidate, the efficient score is
`J_a' M e` with M the projection off J_n (Rao 1948, Neyman 1959). Its variance is taken with the
autocorrelation of the innovations, so that coloured gusts do not pass for physics.

The joint null distribution is that of data sets drawn from the fitted model on the same inputs,
nuisances refitted to each, both to first order: the scores of all candidates, windows and regimes
are then jointly normal with the Gram matrix of their efficient columns.

All derivatives come from one compiled program per problem: directions are inputs, an unnamed force
is a history of accelerations, and a candidate is differentiated at each of its expansion points.
The rows of the prior are those of all coordinates, so that columns combine.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from diffsea.budget import on_every_core
from diffsea.identification.coordinates import ExpansionPoint
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.kalman import Gains
from diffsea.identification.problem import Problem
from diffsea.identification.residual import (
    group_size,
    innovations_at,
    linearise,
    slopes_by_pulses,
)
from diffsea.statistics import autocorrelation, long_run_covariance, variance_inflation


NULL_DRAWS = 1999  # of the joint null: its one per cent is then known to a fifth of itself
NULL_SEED = 7
COUNTABLE = 0.02  # share of the draws from which on they are counted: forty of them
NO_INFORMATION = 1e-12  # of a column, in squared standard deviations of the innovations
LEVEL = 0.01  # of significance, shared by the tests

# Six values to each row of the data set, then the prior's, then those of further data.
Columns = Float[np.ndarray, "value column"]
PerColumn = Float[np.ndarray, "column"]


@dataclasses.dataclass(frozen=True)
class NullDistribution:
    """Distribution of the smallest p-value among all tests of a screening."""

    smallest: Float[np.ndarray, "draw"]  # ascending

    def family_wise(self, p_value: float) -> float:
        """Chance that any test shows `p_value` or less.

        Below what draws can show, as many independent tests as their lowest tenth behaves
        like (the correction of Sidak 1967 with an effective number).
        """
        share = float(np.searchsorted(self.smallest, p_value, side="right")) / len(self.smallest)
        if share >= COUNTABLE:
            return share
        low = float(np.quantile(self.smallest, 0.1))
        number = np.log(0.9) / np.log1p(-low) if low > 0 else 1.0
        return float(-np.expm1(number * np.log1p(-min(p_value, 1 - 1e-12))))

    @property
    def threshold(self) -> float:
        """The p-value of one test that is family-wise one per cent."""
        grid = np.logspace(-12, -1, 400)
        family_wise = np.array([self.family_wise(p) for p in grid])
        return float(grid[np.searchsorted(family_wise, 0.01).clip(0, len(grid) - 1)])


def joint_null(
    gram: Float[np.ndarray, "column column"], tests: list[slice], draws: int = NULL_DRAWS
) -> NullDistribution:
    """The null distribution of several tests, each of the columns of one slice of a Gram matrix.

    Arguments:
        gram: `E' E` of efficient columns E, the covariance of their scores.
        draws: of the joint normal, always the same ones.
    """
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    z = np.random.default_rng(NULL_SEED).standard_normal((draws, len(gram))) @ root.T
    unit = gram / np.outer(scale, scale)
    strongest: dict[int, np.ndarray] = {}  # statistic among the tests of as many columns
    for columns in tests:
        size, scores = columns.stop - columns.start, z[:, columns]
        inverse = np.linalg.pinv(unit[columns, columns], rcond=1e-10, hermitian=True)
        statistic = ((scores @ inverse) * scores).sum(1)
        strongest[size] = np.maximum(strongest.get(size, 0.0), statistic)
    smallest = [np.ones(draws), *(stats.chi2.sf(most, k) for k, most in strongest.items())]
    return NullDistribution(np.sort(np.min(smallest, axis=0)))


class ScoreTest(NamedTuple):
    """Outcome of a score test of one candidate."""

    statistic: float  # chi-squared under the nominal model
    p_value: float
    step: Float[np.ndarray, "column"]  # one-step estimate of the candidate's coordinates
    inflation: float  # variance of the score over the Fisher information, at least one


class Projection:
    """The projection off the nuisances, and score tests of what it leaves of candidates.

    `residual` and columns have six values for each row of the data set, then rows of the prior and
    of further data.
    """

    def __init__(
        self,
        residual: Float[np.ndarray, "value"],
        nuisance: Float[np.ndarray, "value nuisance"],
        run: Int[np.ndarray, "row"],
        correlation: Float[np.ndarray, "lag 6"] | None = None,
    ):
        """Project the residual.

        Arguments:
            run: the number of the run that each row of the data set belongs to.
            correlation: of the innovations in time; estimated from them where None.
        """
        self.data_values = 6 * len(run)
        self.basis = np.linalg.qr(nuisance)[0]
        self.residual = self.efficient(residual[:, None])[:, 0]
        if correlation is None:
            correlation = autocorrelation(self.residual[: self.data_values].reshape(-1, 6), run)
        self.correlation = correlation

    def efficient(self, columns: Columns) -> Columns:
        """Columns with the nuisances projected out."""
        return columns - self.basis @ (self.basis.T @ columns)

    def is_informative(self, E: Columns) -> Bool[np.ndarray, "column"]:
        """Which columns move an innovation: those of the spare runs of a data set move none."""
        return (E[: self.data_values] ** 2).sum(0) > NO_INFORMATION * (E**2).sum(0)

    def test(self, E: Columns) -> ScoreTest:
        """Test one candidate by its efficient columns.

        The statistic is `s' V^-1 s` with `s = E' e` and `V = E' E`, over the mean factor by which
        autocorrelation widens the variance of s. Columns without information count for nothing.
        """
        step, informative = np.zeros(E.shape[1]), self.is_informative(E)
        k = int(informative.sum())
        if k == 0:
            return ScoreTest(0.0, 1.0, step, 1.0)
        E = E[:, informative]
        s = E.T @ self.residual
        inverse = np.linalg.pinv(E.T @ E, rcond=1e-10, hermitian=True)
        coloured = long_run_covariance(E[: self.data_values], self.correlation)
        ratio = max(1.0, float(np.trace(coloured @ inverse)) / k)
        statistic = float(s @ inverse @ s) / ratio
        step[informative] = -(inverse @ s)
        return ScoreTest(statistic, float(stats.chi2.sf(statistic, k)), step, ratio)

    def scatter(self, E: Columns, parts: Sequence[Int[np.ndarray, "_"]]) -> float:
        """Variance of a candidate's size over its information, by how it scatters between parts.

        The clustered covariance of Liang and Zeger (1986), averaged over the columns; at least one.
        What a model lacks besides differs from part to part, and tells of itself in nothing else.

        Arguments:
            parts: rows of the data set that belong to each.
        """
        E = E[:, self.is_informative(E)]
        if E.shape[1] == 0 or len(parts) < 2:
            return 1.0
        inverse = np.linalg.pinv(E.T @ E, rcond=1e-10, hermitian=True)
        left = (self.residual - E @ (inverse @ (E.T @ self.residual)))[: self.data_values]
        terms = (E[: self.data_values] * left[:, None]).reshape(-1, 6, E.shape[1]).sum(1)
        scores = np.array([terms[part].sum(0) for part in parts])
        spread = scores.T @ scores * len(parts) / (len(parts) - 1)
        return max(1.0, float(np.trace(spread @ inverse)) / E.shape[1])

    def test_each(self, E: Columns) -> tuple[PerColumn, PerColumn, PerColumn]:
        """Test every column as a candidate of its own: steps, standard errors, p-values.

        A column without information has a p-value of one and an infinite error.
        """
        information = (E**2).sum(0)
        informed = information > NO_INFORMATION
        V = np.where(informed, information, 1.0)
        ratio = variance_inflation(E[: self.data_values], self.correlation)
        step = -(E.T @ self.residual) / V
        std = np.where(informed, np.sqrt(ratio / V), np.inf)
        p = np.where(informed, stats.chi2.sf((step / std) ** 2, 1), 1.0)
        return step, std, p


def linearise_model(problem: Problem, fitted: Estimate) -> "LinearisedModel":
    """The linearisation of a problem's innovations at an estimate, with the gains of its filter."""
    gains = fitted.filter_run(problem).gains
    return LinearisedModel(problem, np.asarray(fitted.coordinates), gains)


@dataclasses.dataclass(frozen=True)
class LinearisedModel:
    """Whitened innovations around some coordinates, the gains of the filter held fixed."""

    problem: Problem
    coordinates: Float[np.ndarray, "coordinate"]
    gains: Gains

    def by_name(self, names: tuple[str, ...]) -> tuple[Float[np.ndarray, "value"], Columns]:
        """Residual and columns of parameters and effects."""
        return self.by_index([k for name in names for k in self.problem.layout.indices((name,))])

    def by_index(
        self, index: list[int], at: Float[np.ndarray, "coordinate"] | None = None
    ) -> tuple[Float[np.ndarray, "value"], Columns]:
        """Residual and columns of some coordinates by their positions, there or `at` others."""
        coordinates = self.coordinates if at is None else at
        return linearise(self.problem, self.gains, coordinates, index)

    def projection(
        self, names: tuple[str, ...], correlation: Float[np.ndarray, "lag 6"] | None = None
    ) -> Projection:
        """The projection off parameters and effects as nuisances.

        With the correlation of the innovations in time as they show it, where none is given.
        """
        residual, nuisance = self.by_name(names)
        return Projection(residual, nuisance, np.asarray(self.problem.dataset.run), correlation)

    def by_pulses(self, pulses: Float[np.ndarray, "pulse row 3"]) -> Columns:
        """Columns of histories of accelerations (m/s^2, m/s^2, rad/s^2), which have no prior."""
        J = slopes_by_pulses(self.problem, self.gains, self.coordinates, pulses)
        return np.concatenate([J, np.zeros((self._rows_beside, J.shape[1]))])

    @property
    def _rows_beside(self) -> int:
        """Rows of the prior and of further data."""
        return self.problem.layout.size + len(self.problem.further_misfits(self.coordinates))

    def by_points(self, points: list[ExpansionPoint]) -> list[Columns]:
        """Columns at each expansion point, several points to one run of the compiled program.

        An onset changes nothing while its effect is absent, so that points of different effects
        share their residual. Some columns are secants from the effect's absence to a size.
        """
        out: dict[int, Columns] = {}
        for batch in self._batches(points):
            members = [points[number] for number in batch]
            indices = [self._differentiated_index(point) for point in members]
            J = self.by_index(sum(indices, []), self._coordinates_at(members))[1]
            ends = np.cumsum([len(index) for index in indices])
            out |= zip(batch, np.split(J, ends[:-1], axis=1), strict=True)
        secants = [number for number, point in enumerate(points) if point.secant]
        if secants:
            base = innovations_at(self.problem, self.gains, self.coordinates)
            columns = on_every_core(lambda number: self._secant(points[number], base), secants)
            out |= zip(secants, columns, strict=True)
        return [out[number] for number in range(len(points))]

    def _secant(self, point: ExpansionPoint, base: np.ndarray) -> Columns:
        """Change of the innovations from `base` by prior size of the first amount that is not zero.

        The prior's and that of further data are by their tangents.
        """
        change = innovations_at(self.problem, self.gains, self._coordinates_at([point])) - base
        prior, index = np.zeros(self.problem.layout.size), self._differentiated_index(point)
        prior[index] = 1 / self.problem.layout.spreads()[index]
        further = self.problem.linear_rows(self.coordinates, np.array(index)).slopes.sum(1)
        by_size = change / point.at[point.directions[0]]
        return np.concatenate([by_size, prior, further])[:, None]

    def _coordinates_at(self, points: list[ExpansionPoint]) -> Float[np.ndarray, "coordinate"]:
        """Coordinates with some effects at expansion points, each at the same one in every run."""
        coordinates = np.array(self.coordinates, float)
        for point in points:
            index = self.problem.layout.indices((point.effect,))
            coordinates[index] = np.tile(point.at, len(index) // len(point.at))
        return coordinates

    def _differentiated_index(self, point: ExpansionPoint) -> list[int]:
        """Coordinates that an expansion point is differentiated by, for each run of its own."""
        index, size = self.problem.layout.indices((point.effect,)), len(point.at)
        return [k for position, k in enumerate(index) if position % size in point.directions]

    def _batches(self, points: list[ExpansionPoint]) -> list[list[int]]:
        """Numbers of the points with a tangent that are differentiated together.

        An effect once each, and no more directions than the cores take at once.
        """
        batches: list[tuple[list[int], set[str], int]] = []
        most = group_size(self.problem.layout) * (os.cpu_count() or 1)
        for number, point in enumerate(points):
            if point.secant:
                continue
            size = len(point.directions)
            for k, (members, effects, used) in enumerate(batches):
                if used + size <= most and point.effect not in effects:
                    batches[k] = ([*members, number], effects | {point.effect}, used + size)
                    break
            else:
                batches.append(([number], {point.effect}, size))
        return [members for members, _, _ in batches]
