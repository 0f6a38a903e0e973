"""A base vessel, what may be estimated in it, and recordings: the residual and its Jacobian.

Which coordinates are free is a selection matrix, an input of the compiled program: screening
and refitting compile nothing new.
"""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diffsea.identification.coordinates import CoordinateLayout
from diffsea.identification.data.dataset import ANY_SHAPE, Dataset, DatasetShape, make_dataset
from diffsea.identification.filter import kalman
from diffsea.identification.filter.kalman import FilterRun, Gains
from diffsea.identification.filter.noise_fit import NoisePrior, noise_prior
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.least_squares import ONCE, least_squares_from, value_and_jacobian
from diffsea.parameters import Parameter, check_names, hull_prior, named
from diffsea.trajectory import Trajectory
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect


@dataclasses.dataclass(frozen=True)
class Problem:
    """A base vessel, what may be estimated in it, and the recordings."""

    base: Vessel
    layout: CoordinateLayout
    dataset: Dataset
    prior: NoisePrior
    width: int  # free coordinates the compiled program has room for
    seeds: int  # and directions it differentiates in: copies for each run share one

    def start(self) -> tuple[np.ndarray, Noise]:
        """Prior mean of the coordinates and first guess of the noise."""
        return np.zeros(self.layout.size), Noise.of(self.prior.mean)

    def run_filter(self, coordinates: np.ndarray, noise: Noise) -> FilterRun:
        """The filter's run at an estimate."""
        return _tune(self.base, Static(self.layout), self.dataset, noise, jnp.asarray(coordinates))


class Static:
    """A hashable wrapper by identity of the value's own equality, for jit."""

    def __init__(self, value: CoordinateLayout):
        self.value = value

    def __hash__(self) -> int:
        value = self.value
        names = tuple(p.name for p in value.parameters), tuple(e.name for e in value.effects)
        return hash((names, value.runs, value.per_run))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Static) and self.value == other.value


def free_by_default(vessel: Vessel) -> tuple[str, ...]:
    """Hull derivatives and added masses that the vessel has.

    Mass, moment of inertia, centre of gravity and the actuators stay as they are: they
    anchor the common factor of mass, drag and thrust that motion alone cannot fix.
    """
    added = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
    hull = getattr(vessel.forces.get("damping"), "derivatives", {})
    return tuple(
        name
        for name, value in named(vessel).items()
        if (name in hull or name in added) and float(value) != 0.0
    )


def default_priors(vessel: Vessel) -> dict[str, Parameter]:
    """Priors around every number of the vessel, half of it wide."""
    prime = getattr(vessel.forces.get("damping"), "scaling", None) is not None
    return {
        name: hull_prior(name, float(value), nondimensional=prime)
        for name, value in named(vessel).items()
    }


def make_problem(
    vessel: Vessel,
    recordings: list[Trajectory],
    free: tuple[str, ...] | None = None,
    effects: tuple[Effect, ...] = (),
    per_run: bool = False,
    room: int = 0,
    priors: Mapping[str, Parameter] | None = None,
    least: DatasetShape = ANY_SHAPE,
) -> Problem:
    """Set up a fit.

    Arguments:
        free: names of the vessel's parameters to estimate; `free_by_default` if None.
        effects: effects whose coordinates may be freed.
        per_run: whether environment effects differ from run to run.
        least: shape that the dataset has at least: problems of one shape share their programs.
        room: how many effect coordinates may be free at once, copies for each run not counted.
        priors: of parameters that have one other than `default_prior`.

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
    width = len(free) + room * (dataset.runs if per_run else 1)
    return Problem(vessel, layout, dataset, noise_prior(vessel, dataset), width, len(free) + room)


@eqx.filter_jit
def _tune(
    base: Vessel, layout: Static, dataset: Dataset, noise: Noise, coordinates: Array
) -> FilterRun:
    return kalman.run_filter(base, layout.value, dataset, noise, coordinates)


class Inputs(eqx.Module):
    """What the residual needs, as one tree."""

    base: Vessel
    dataset: Dataset
    gains: Gains
    fixed: Float[Array, "coordinate"]  # values of the coordinates that are not free
    selection: Float[Array, "coordinate width"]
    spreads: Float[Array, "coordinate"]
    pushes: Float[Array, "push row 3"]  # histories of unnamed accelerations, to be added
    seeds: Float[Array, "group seed free"]  # what is differentiated together
    groups: Int[Array, ""]  # the first of them that are used, at least one
    owner: Int[Array, "free"]  # the run a free coordinate belongs to; -1: all of them


def _white(free: Float[Array, "free"], args: tuple[Inputs, Static]) -> Array:
    """Whitened innovations; non-finite ones are large."""
    problem, layout = args
    width = problem.selection.shape[1]
    coordinates = problem.fixed + problem.selection @ free[:width]
    push = jnp.tensordot(free[width:], problem.pushes, axes=1)
    white = kalman.whitened_innovations(
        problem.base, layout.value, problem.dataset, problem.gains, coordinates, push
    )
    return jnp.where(jnp.isfinite(white), white, 1e4).ravel()


def _prior(free: Float[Array, "free"], args: tuple[Inputs, Static]) -> Array:
    """Deviations from the prior; unused columns of the selection have one of their own."""
    problem, layout = args
    width = problem.selection.shape[1]
    coordinates = problem.fixed + problem.selection @ free[:width]
    unused = jnp.concatenate([1 - jnp.abs(problem.selection).sum(0), jnp.ones(free.size - width)])
    strains = layout.value.strains(coordinates, problem.spreads)
    return jnp.concatenate([strains, unused * free])


def with_jacobian(free: Array, args: tuple[Inputs, Static]) -> tuple[Array, Array]:
    """Residual and its exact Jacobian.

    What belongs to one run moves the innovations of no other, so that one direction serves
    the copies of all runs (Curtis, Powell and Reid 1974). Directions are taken a group at a time,
    those that no coordinate uses not at all.
    """
    problem, _ = args
    along = lambda seed: jax.jvp(lambda at: _white(at, args), (free,), (seed,))
    together = jax.vmap(along, out_axes=(None, 0))

    def group(number: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        white, slopes = together(problem.seeds[number])
        return white, found[1].at[number].set(slopes)

    run = jnp.repeat(problem.dataset.run, 6)
    nothing = jnp.zeros(run.size), jnp.zeros((*problem.seeds.shape[:2], run.size))
    white, slopes = jax.lax.fori_loop(0, problem.groups, group, nothing)
    own = (problem.owner < 0) | (problem.owner == run[:, None])
    J = jnp.where(own, jnp.tensordot(slopes, problem.seeds, axes=((0, 1), (0, 1))), 0.0)
    strains, pulls = value_and_jacobian(lambda at: _prior(at, args), free)
    return jnp.concatenate([white, strains]), jnp.concatenate([J, pulls])


STEPS = 3  # of Gauss-Newton with the gains held fixed
RADII = (1.0, 1 / 16, 1 / 256)  # of the trust region at first, and where nothing was gained


def minimised(
    inputs: Inputs, layout: Static, start: Array, tolerance: Scalar = 1e-4, radius: Scalar = 1.0
) -> tuple[Array, Array, Array]:
    """Free numbers after Gauss-Newton steps, and residual and Jacobian on the way."""
    # Compiled within the compiled: the solver traces it several times, and finds it traced.
    function = eqx.filter_jit(with_jacobian)
    return least_squares_from(function, start, (inputs, layout), STEPS, tolerance, radius)


_minimise = eqx.filter_jit(minimised)


def minimise(inputs: Inputs, layout: Static, start: np.ndarray) -> np.ndarray:
    """Free coordinates after Gauss-Newton steps with the gains held fixed.

    Where no step within the first radii lowers the sum of squares, shorter ones are tried: the
    force of a light wind, say, is far from linear over the wind's prior.
    """
    begin = _padded(inputs, start)
    for radius in RADII:
        given = (jnp.asarray(1e-4), jnp.asarray(radius))
        found = np.asarray(_minimise(inputs, layout, begin, *given)[0])[: len(start)]
        if np.any(found != start):
            break
    return found


def jacobian(start: np.ndarray, args: tuple[Inputs, Static]) -> tuple[np.ndarray, np.ndarray]:
    """Residual and Jacobian by the free coordinates at `start`, then by the pushes."""
    inputs, layout = args
    given = (jnp.asarray(ONCE), jnp.asarray(RADII[0]))
    _, residual, J = _minimise(inputs, layout, _padded(inputs, start), *given)
    return np.asarray(residual), np.asarray(J)


_innovations = eqx.filter_jit(_white)


def innovations(start: np.ndarray, args: tuple[Inputs, Static]) -> np.ndarray:
    """The residual at `start` but for the prior's rows, without any derivative."""
    return np.asarray(_innovations(_padded(args[0], start), args))


def _padded(inputs: Inputs, start: np.ndarray) -> Array:
    """The free coordinates, with pushes of nothing."""
    whole = np.zeros(inputs.owner.size)
    whole[: len(start)] = start
    return jnp.asarray(whole)


def selection(
    layout: CoordinateLayout, free: tuple[str, ...], width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the free coordinates and the matrix that spreads them over the layout."""
    index = np.array(layout.indices(free), int)
    matrix = np.zeros((layout.size, width))
    matrix[index, np.arange(len(index))] = 1.0
    return index, matrix


def traced(
    problem: Problem,
    gains: Gains,
    coordinates: np.ndarray,
    matrix: np.ndarray,
    pushes: np.ndarray | None = None,
) -> tuple[Inputs, Static]:
    """The inputs of the compiled residual, `matrix` selecting what is free.

    Where `pushes` are given, at most as many as there are seeds, the Jacobian is by them.
    """
    held = np.where(np.abs(matrix).sum(1) > 0, 0.0, coordinates)
    seeds, owner = _seeds(problem, matrix)
    room = problem.seeds
    histories = np.zeros((room, problem.dataset.t.size, 3))
    by_push = np.zeros((room, room))
    if pushes is not None:
        histories[: len(pushes)] = pushes
        seeds = np.zeros_like(seeds)
        by_push[: len(pushes), : len(pushes)] = np.eye(len(pushes))
    grouped, used = _grouped(problem, np.concatenate([seeds, by_push], axis=1))
    inputs = Inputs(
        problem.base, problem.dataset, gains, jnp.asarray(held), jnp.asarray(matrix),
        jnp.asarray(problem.layout.spreads()), jnp.asarray(histories),
        jnp.asarray(grouped), jnp.asarray(used),
        jnp.asarray(np.append(owner, np.full(room, -1))),
    )  # fmt: skip
    return inputs, Static(problem.layout)


def _seeds(problem: Problem, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Groups of free coordinates to differentiate together, and the runs they belong to."""
    kind, run = problem.layout.kinds()
    chosen = matrix.argmax(0)
    used = matrix.any(0)
    groups = np.unique(kind[chosen[used]])
    seeds = np.zeros((problem.seeds, problem.width))
    seeds[: len(groups)] = used & (kind[chosen] == groups[:, None])
    return seeds, np.where(used, run[chosen], -1)


WIDEST = 12  # directions taken together: with more, each costs more than alone
BESIDE = 2  # coordinates of an effect that is tried: one group holds it beside the parameters


def _grouped(problem: Problem, seeds: np.ndarray) -> tuple[np.ndarray, int]:
    """Directions in groups of one size, and how many groups are used."""
    few = len(problem.layout.parameters) + BESIDE
    size = -(-few // -(-few // WIDEST))
    padded = np.concatenate([seeds, np.zeros((-len(seeds) % size, seeds.shape[1]))])
    used = 1 + int(np.flatnonzero(padded.any(1)).max(initial=0)) // size
    return padded.reshape(-1, size, seeds.shape[1]), used
