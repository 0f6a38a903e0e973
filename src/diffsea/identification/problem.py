"""A base vessel, what may be estimated in it, and recordings: what a fit is about."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from diffsea.identification.coordinates import CoordinateLayout, free_by_default, vessel_at
from diffsea.identification.data.dataset import (
    ANY_SHAPE,
    LEAD_IN,
    Dataset,
    DatasetShape,
    make_dataset,
)
from diffsea.identification.filter import kalman
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun
from diffsea.identification.filter.latency import SamplePlacement
from diffsea.identification.filter.noise_fit import NoisePrior, noise_prior
from diffsea.parameters import Parameter, check_names
from diffsea.scales import time_scale
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect
from diffsea.vessel.files import default_priors


Coordinates = Float[np.ndarray, "coordinate"]
Names = tuple[str, ...]  # of parameters, by their symbols, and of effects, as in the catalogue
FreeIndex = Int[np.ndarray, "free"]  # positions of the free ones among the coordinates


@dataclasses.dataclass(frozen=True)
class NumberResidual:
    """A trial number as it was given and as a fit has it, in SI units."""

    trial: str
    number: str
    given: float
    std: float
    fitted: float  # NaN where the simulated trial does not reach it


class FurtherData(Protocol):
    """Data beside the recordings that say something of the same coordinates.

    Trial numbers, or what a reference period told. Where `is_before`, they are of the vessel before
    the recordings: something may have changed since.
    """

    is_before: ClassVar[bool]

    def misfits_and_jacobian(
        self, coordinates: Coordinates
    ) -> tuple[Float[np.ndarray, "value"], Float[np.ndarray, "value coordinate"]]:
        """Misfits over their standard deviations, and their exact Jacobian."""
        ...

    def residuals(self, coordinates: Coordinates) -> list[NumberResidual]:
        """The same as they were given and as they are at some coordinates, if they are numbers."""
        ...


class LinearRows(NamedTuple):
    """Misfits over their standard deviations, and their slopes by the free coordinates."""

    misfit: Float[np.ndarray, "value"]
    slopes: Float[np.ndarray, "value free"]

    @property
    def information(self) -> Float[np.ndarray, "free free"]:
        """What they tell of the free coordinates, the rest known."""
        return self.slopes.T @ self.slopes


@dataclasses.dataclass(frozen=True)
class Problem:
    """A base vessel, what may be estimated in it, and the recordings.

    Compiled programs are the same whatever is free: screening and refitting compile nothing new.

    What `further` data say is independent of the recordings: its squares add up with theirs.
    """

    base: Vessel
    layout: CoordinateLayout
    dataset: Dataset
    prior: NoisePrior
    further: FurtherData | None = None

    def start(self) -> tuple[Coordinates, Noise]:
        """Prior mean of the coordinates and first guess of the noise."""
        return np.zeros(self.layout.size), Noise.of(self.prior.mean)

    @property
    def before(self) -> float | None:
        """A time (s) before all recordings, at which something may have changed.

        None without data of the vessel as she was.
        """
        if self.further is None or not self.further.is_before:
            return None
        lead_in = LEAD_IN * float(time_scale(self.base.rigid_body.length))
        return self.dataset.spans[0][0] - 2 * lead_in

    def run_filter(
        self,
        coordinates: Coordinates,
        noise: Noise,
        gate: float = kalman.NO_GATE,
        placement: SamplePlacement | None = None,
    ) -> FilterRun:
        """The filter's run at some coordinates; `Estimate.filter_run` at an estimate.

        Values further than `gate` standard deviations from what was expected are left out. Samples
        are used at the rows of a `placement`; at those that the coordinates say if None.
        """
        at = jnp.asarray(coordinates)
        placement = self.placement(coordinates) if placement is None else placement
        return _run_filter(self.base, self.layout, self.dataset, noise, at, placement, gate)

    def placement(self, coordinates: Coordinates) -> SamplePlacement:
        """At which rows the filter uses the samples, as late as they are at some coordinates."""
        return _placement_at(self.base, self.layout, self.dataset, jnp.asarray(coordinates))

    def linear_rows(self, coordinates: Coordinates, index: FreeIndex) -> LinearRows:
        """Misfits of the further data at some coordinates and their slopes; none without them."""
        if self.further is None:
            return LinearRows(np.zeros(0), np.zeros((0, len(index))))
        misfit, J = self.further.misfits_and_jacobian(coordinates)
        return LinearRows(misfit, J[:, index])

    def further_misfits(self, coordinates: Coordinates) -> Float[np.ndarray, "value"]:
        """Misfits of the further data; none without them."""
        return self.linear_rows(coordinates, np.zeros(0, int)).misfit

    def further_cost(self, coordinates: Coordinates) -> float:
        """Sum of squares of the further data's misfits; zero without them."""
        misfit = self.further_misfits(coordinates)
        return float(misfit @ misfit)


_run_filter = eqx.filter_jit(kalman.run_filter)
_placement_at = eqx.filter_jit(kalman.placement_at)


def make_problem(
    vessel: Vessel,
    recordings: Sequence[Trajectory],
    free: tuple[str, ...] | None = None,
    effects: tuple[Effect, ...] = (),
    per_run: bool = False,
    priors: Mapping[str, Parameter] | None = None,
    least: DatasetShape = ANY_SHAPE,
) -> Problem:
    """Set up a fit.

    Arguments:
        free: names of the vessel's parameters to estimate; `free_by_default` if None.
        effects: effects whose coordinates may be freed.
        per_run: whether environment effects differ from run to run.
        priors: of parameters that have one other than `default_priors`.
        least: shape that the data set has at least: problems of one shape share their programs.

    Raises:
        UserError: an unknown name, or a recording that does not fit the vessel.
    """
    free = free_by_default(vessel) if free is None else free
    check_names(vessel, free)
    known = default_priors(vessel) | dict(priors or {})
    parameters = tuple(known[name] for name in free)
    dataset = make_dataset(vessel, recordings, least)
    sizes = tuple(effect.sizes(vessel) for effect in effects)
    latest = float(np.abs(dataset.run_time).max())
    layout = CoordinateLayout(parameters, effects, sizes, dataset.runs, per_run, latest)
    dataset = jax.tree.map(jnp.asarray, dataset)
    prior = noise_prior(vessel, dataset)
    return Problem(vessel, layout, dataset, prior)


def first_run_coordinates(problem: Problem, coordinates: Coordinates) -> Float[np.ndarray, "own"]:
    """Coordinates with one set per effect: the first run's where each has its own."""
    layout = problem.layout
    parts = [coordinates[: len(layout.parameters)]]
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        parts.append(coordinates[layout.slices[effect.name]][: len(sizes)])
    return np.concatenate(parts)


def vessel_in_environment(problem: Problem, coordinates: Float[np.ndarray, "own"]) -> Vessel:
    """The vessel at coordinates with one set per effect, its environment in place."""
    layout = dataclasses.replace(problem.layout, runs=1, per_run=False)
    vessel, flows = vessel_at(problem.base, *layout.present(np.asarray(coordinates)))
    environment = jax.tree.map(lambda leaf: float(np.asarray(leaf)[0]), flows)
    return jax.tree.map(float, dataclasses.replace(vessel, environment=environment))
