"""Derivatives of a fitted model's whitened innovations by everything that a diagnosis tries.

All of them come from one compiled program per problem: which coordinates are free is a selection
matrix, an unnamed force is a history of accelerations, and a candidate is differentiated at each of
its expansion points. The rows of the prior are those of all coordinates, so that columns combine.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.score import Projection
from diffsea.identification.estimates import Estimate
from diffsea.identification.expansion_points import ExpansionPoint
from diffsea.identification.filter.kalman import Gains
from diffsea.identification.problem import Problem
from diffsea.identification.residual import innovations_at, linearise


Columns = Float[np.ndarray, "value column"]  # six to each row of the data set, then the prior's


def linearise_model(problem: Problem, fitted: Estimate) -> "LinearisedModel":
    """The linearisation of a problem's innovations at an estimate."""
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
        residual, J = linearise(self.problem, self.gains, coordinates, index)
        keep = int(self.problem.dataset.measured.size) + self.problem.layout.size
        return residual[:keep], J[:keep]

    def projection(
        self, names: tuple[str, ...], correlation: Float[np.ndarray, "lag 6"] | None = None
    ) -> Projection:
        """The projection off parameters and effects as nuisances."""
        residual, nuisance = self.by_name(names)
        return Projection(residual, nuisance, np.asarray(self.problem.dataset.run), correlation)

    def by_pulses(self, pulses: Float[np.ndarray, "pulse row 3"]) -> Columns:
        """Columns of histories of accelerations (m/s^2, m/s^2, rad/s^2), which have no prior."""
        problem, parts = self.problem, []
        values = int(problem.dataset.measured.size)
        for first in range(0, len(pulses), problem.directions):
            part = pulses[first : first + problem.directions]
            J = linearise(problem, self.gains, self.coordinates, (), part).jacobian
            parts.append(J[:values])
        J = np.concatenate(parts, axis=1)
        return np.concatenate([J, np.zeros((problem.layout.size, J.shape[1]))])

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
            out |= {number: self._secant(points[number], base) for number in secants}
        return [out[number] for number in range(len(points))]

    def _secant(self, point: ExpansionPoint, base: np.ndarray) -> Columns:
        """Change of the innovations from `base` for each prior size; the prior's by its tangent."""
        change = innovations_at(self.problem, self.gains, self._coordinates_at([point])) - base
        prior, index = np.zeros(self.problem.layout.size), self._differentiated_index(point)
        prior[index] = 1 / self.problem.layout.spreads()[index]
        return np.concatenate([change / point.at[0], prior])[:, None]

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
        """Numbers of the points with a tangent for each run of the program, an effect once each."""
        batches: list[tuple[list[int], set[str], int]] = []
        for number, point in enumerate(points):
            if point.secant:
                continue
            width, size = len(self._differentiated_index(point)), len(point.directions)
            for k, (members, effects, used) in enumerate(batches):
                total = sum(len(self._differentiated_index(points[m])) for m in members) + width
                room = used + size <= self.problem.directions and total <= self.problem.width
                if room and point.effect not in effects:
                    batches[k] = ([*members, number], effects | {point.effect}, used + size)
                    break
            else:
                batches.append(([number], {point.effect}, size))
        return [members for members, _, _ in batches]
