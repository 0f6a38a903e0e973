"""Fitting a vessel to recordings: estimates, standard errors, and how well they predict.

One round tunes the filter at the current estimate, improves the parameters by
Levenberg-Marquardt with the gains held fixed, and re-estimates the noise. A few rounds
converge. Which coordinates are free is a selection matrix, an input of the compiled
program: screening and refitting compile nothing new.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from diffsea.identification import likelihood
from diffsea.identification.colour import autocorrelation, long_run
from diffsea.identification.likelihood import Gains, Layout, Noise, Tuned, deviance
from diffsea.identification.noise import Clock, Path, Prior, noise_prior, refine
from diffsea.identification.tape import Tape, make_tape
from diffsea.parameters import Parameter, check_names, hull_prior, named
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import AbstractEffect


Progress = Callable[[str], None]

ROUNDS = 8
STEPS = 6  # of Levenberg-Marquardt in one round
NOISE_STEPS = 3  # of Fisher scoring in one round
FIRST_STEPS = 15  # and in the first one


class Estimate(NamedTuple):
    """Where a fit ended."""

    free: tuple[str, ...]
    coordinates: np.ndarray  # of the whole layout
    noise: Noise
    deviance: float  # -2 log posterior, the priors of parameters and noise included
    index: np.ndarray  # which coordinates were free
    covariance: np.ndarray  # of the free coordinates
    shrinkage: np.ndarray  # share of each free coordinate that the data determine, 0 to 1
    inflation: float  # variance of the scores over the information, at least one


@dataclasses.dataclass(frozen=True)
class Problem:
    """A base vessel, what may be estimated in it, and the recordings."""

    base: Vessel
    layout: Layout
    tape: Tape
    prior: Prior
    width: int  # free coordinates the compiled program has room for
    seeds: int  # and directions it differentiates in: copies for each run share one

    def start(self) -> tuple[np.ndarray, Noise]:
        """Prior mean of the coordinates and first guess of the noise."""
        return np.zeros(self.layout.size), Noise.of(self.prior.mean)

    def tuned(self, coordinates: np.ndarray, noise: Noise) -> Tuned:
        """The filter's run at an estimate."""
        return _tune(self.base, Static(self.layout), self.tape, noise, jnp.asarray(coordinates))


class Static:
    """A hashable wrapper by identity of the value's own equality, for jit."""

    def __init__(self, value: Layout):
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


def make_problem(
    vessel: Vessel,
    recordings: list[Trajectory],
    free: tuple[str, ...] | None = None,
    effects: tuple[AbstractEffect, ...] = (),
    per_run: bool = False,
    room: int = 0,
) -> Problem:
    """Set up a fit.

    Arguments:
        free: names of the vessel's parameters to estimate; `free_by_default` if None.
        effects: effects whose coordinates may be freed.
        per_run: whether environment effects differ from run to run.
        room: how many effect coordinates may be free at once, copies for each run not counted.

    Raises:
        UserError: an unknown name, or a recording that does not fit the vessel.
    """
    free = free_by_default(vessel) if free is None else free
    check_names(vessel, free)
    values = named(vessel)
    parameters = tuple(hull_prior(name, float(values[name])) for name in free)
    tape = make_tape(vessel, recordings)
    sizes = tuple(effect.sizes(vessel) for effect in effects)
    layout = Layout(parameters, effects, sizes, tape.runs, per_run)
    tape = jax.tree.map(jnp.asarray, tape)
    width = len(free) + room * (tape.runs if per_run else 1)
    return Problem(vessel, layout, tape, noise_prior(vessel, tape), width, len(free) + room)


@eqx.filter_jit
def _tune(base: Vessel, layout: Static, tape: Tape, noise: Noise, coordinates: Array) -> Tuned:
    return likelihood.tune(base, layout.value, tape, noise, coordinates)


class Inputs(eqx.Module):
    """What the residual needs, as one tree."""

    base: Vessel
    tape: Tape
    gains: Gains
    fixed: Float[Array, "coordinate"]  # values of the coordinates that are not free
    selection: Float[Array, "coordinate width"]
    spreads: Float[Array, "coordinate"]
    seeds: Float[Array, "seed width"]  # which free coordinates are differentiated together
    owner: Int[Array, "width"]  # the run a free coordinate belongs to; -1: all of them


def _white(free: Float[Array, "width"], args: tuple[Inputs, Static]) -> Array:
    """Whitened innovations; non-finite ones are large."""
    problem, layout = args
    coordinates = problem.fixed + problem.selection @ free
    white = likelihood.innovations(
        problem.base, layout.value, problem.tape, problem.gains, coordinates
    )
    return jnp.where(jnp.isfinite(white), white, 1e4).ravel()


def _prior(free: Float[Array, "width"], problem: Inputs) -> Array:
    """Deviations from the prior; unused columns of the selection have one of their own."""
    coordinates = problem.fixed + problem.selection @ free
    unused = 1 - jnp.abs(problem.selection).sum(0)
    return jnp.concatenate([coordinates / problem.spreads, unused * free])


def _residual(free: Float[Array, "width"], args: tuple[Inputs, Static]) -> Array:
    return jnp.concatenate([_white(free, args), _prior(free, args[0])])


def _with_jacobian(free: Array, args: tuple[Inputs, Static]) -> tuple[Array, Array]:
    """Residual and its exact Jacobian.

    What belongs to one run moves the innovations of no other, so that one direction serves
    the copies of all runs (Curtis, Powell and Reid 1974).
    """
    problem, _ = args
    push = jax.vmap(lambda seed: jax.jvp(lambda at: _white(at, args), (free,), (seed,))[1])
    run = jnp.repeat(problem.tape.run, 6)[:, None]
    own = (problem.owner < 0) | (problem.owner == run)
    J = jnp.where(own, push(problem.seeds).T @ problem.seeds, 0.0)
    prior = jax.jacfwd(lambda at: _prior(at, problem))(free)
    return _residual(free, args), jnp.concatenate([J, prior])


jacobian = eqx.filter_jit(_with_jacobian)


@eqx.filter_custom_jvp
def _known_slope(free: Array, *, args: tuple[Inputs, Static]) -> Array:
    """The residual; its derivative is a product with the Jacobian found alongside it.

    The solver differentiates the residual in several places; this way the filter is traced
    and compiled for one of them.
    """
    return _residual(free, args)


@_known_slope.def_jvp
def _known_slope_jvp(primals: tuple, tangents: tuple, *, args: tuple) -> tuple[Array, Array]:
    residual, J = _with_jacobian(primals[0], args)
    return residual, J @ tangents[0]


@eqx.filter_jit
def _improve(inputs: Inputs, layout: Static, start: Array, steps: int) -> Array:
    """Levenberg-Marquardt with the gains held fixed."""
    # Normal equations: columns are scaled alike and regularised by the prior, and a QR of
    # the tall Jacobian in every step would cost more than everything else.
    solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-4, linear_solver=lx.Normal(lx.Cholesky()))
    return optx.least_squares(
        lambda free, args: _known_slope(free, args=args), solver, start, (inputs, layout),
        options={"jac": "fwd"}, max_steps=steps, throw=False,
    ).value  # fmt: skip


def selection(layout: Layout, free: tuple[str, ...], width: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the free coordinates and the matrix that spreads them over the layout."""
    index = np.array(layout.indices(free), int)
    matrix = np.zeros((layout.size, width))
    matrix[index, np.arange(len(index))] = 1.0
    return index, matrix


def traced(
    problem: Problem, gains: Gains, coordinates: np.ndarray, matrix: np.ndarray
) -> tuple[Inputs, Static]:
    """The inputs of the compiled residual, `matrix` selecting what is free."""
    held = np.where(np.abs(matrix).sum(1) > 0, 0.0, coordinates)
    seeds, owner = _seeds(problem, matrix)
    inputs = Inputs(
        problem.base, problem.tape, gains, jnp.asarray(held), jnp.asarray(matrix),
        jnp.asarray(problem.layout.spreads()), jnp.asarray(seeds), jnp.asarray(owner),
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


def estimate(
    problem: Problem,
    free: tuple[str, ...],
    start: np.ndarray | None = None,
    noise: Noise | None = None,
    rounds: int = ROUNDS,
    fixed_noise: bool = False,
    progress: Progress = lambda message: None,
) -> Estimate:
    """Fit the free coordinates by name (parameters and effects), from `start`.

    Every round lowers the deviance: first by the noise, so that the innovations are weighed
    rightly, then by the parameters.
    """
    coordinates, first = problem.start()
    coordinates = coordinates if start is None else np.array(start, float)
    noise, steps = (first, FIRST_STEPS) if noise is None else (noise, NOISE_STEPS)
    index, matrix = selection(problem.layout, free, problem.width)
    tuned = problem.tuned(coordinates, noise)
    now = _posterior(problem, coordinates, noise, tuned)
    for number in range(rounds):
        last = now
        if not fixed_noise:
            better = refine(_path(tuned), _clock(problem), noise, problem.prior, steps)
            steps = NOISE_STEPS
            there = problem.tuned(coordinates, better)
            value = _posterior(problem, coordinates, better, there)
            if value < now or (np.isfinite(value) and not np.isfinite(now)):
                noise, tuned, now = better, there, value
        target = _target(problem, coordinates, tuned, index, matrix)
        coordinates, tuned, now = _walk(problem, coordinates, target, noise, tuned, now)
        progress(f"round {number + 1}: -2 log posterior {now:.1f}")
        if abs(last - now) < 0.05 + 1e-6 * abs(now):
            break
    uncertainty = _uncertainty(problem, coordinates, noise, index, matrix)
    return Estimate(free, coordinates, noise, now, index, *uncertainty)


def _target(
    problem: Problem, coordinates: np.ndarray, tuned: Tuned, index: np.ndarray, matrix: np.ndarray
) -> np.ndarray:
    """Coordinates that fit best with the gains held fixed."""
    inputs, layout = traced(problem, tuned.gains, coordinates, matrix)
    begin = np.zeros(problem.width)
    begin[: len(index)] = coordinates[index]
    found = _improve(inputs, layout, jnp.asarray(begin), STEPS)
    target = coordinates.copy()
    target[index] = np.asarray(found)[: len(index)]
    return target


def _walk(
    problem: Problem, start: np.ndarray, target: np.ndarray, noise: Noise, tuned: Tuned, now: float
) -> tuple[np.ndarray, Tuned, float]:
    """Go to the target, or part of the way where the filter with its own gains is worse there."""
    for share in (1.0, 0.5, 0.2, 0.05):
        coordinates = start + share * (target - start)
        there = problem.tuned(coordinates, noise)
        value = _posterior(problem, coordinates, noise, there)
        if value < now or (np.isfinite(value) and not np.isfinite(now)):
            return coordinates, there, value
    return start, tuned, now


def _path(tuned: Tuned) -> Path:
    g = tuned.gains
    return Path(tuned.F, tuned.H, g.correction, tuned.nu, g.used, tuned.kick)


def _clock(problem: Problem) -> Clock:
    tape = problem.tape
    return Clock(tape.dt, tape.starts, likelihood.first_variance(problem.base))


def _posterior(problem: Problem, coordinates: np.ndarray, noise: Noise, tuned: Tuned) -> float:
    off = (np.asarray(noise.scales) - problem.prior.mean) / problem.prior.spread
    away = coordinates / problem.layout.spreads()
    return float(deviance(tuned)) + float(off @ off) + float(away @ away)


def _uncertainty(
    problem: Problem, coordinates: np.ndarray, noise: Noise, index: np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Covariance of the free coordinates, how much of each is due to the data, inflation.

    The larger of the inverse information and the sandwich with the innovations' own
    autocorrelation, which does not trust them to be white.
    """
    tuned = problem.tuned(coordinates, noise)
    inputs, layout = traced(problem, tuned.gains, coordinates, matrix)
    begin = np.zeros(problem.width)
    begin[: len(index)] = coordinates[index]
    residual, J = (np.asarray(a) for a in jacobian(jnp.asarray(begin), (inputs, layout)))
    J, rows = J[:, : len(index)], problem.tape.measured.size
    information = J.T @ J
    plain = np.linalg.inv(information)
    white = residual[:rows].reshape(-1, 6)
    correlation = autocorrelation(white, np.asarray(problem.tape.run))
    coloured = plain @ long_run(J[:rows], correlation) @ plain
    ratio = np.maximum(np.diag(coloured) / np.diag(plain), 1.0)
    widen = np.sqrt(ratio)
    prior = problem.layout.spreads()[index]
    shrinkage = 1 - np.diag(plain) / prior**2
    return plain * np.outer(widen, widen), np.clip(shrinkage, 0.0, 1.0), float(np.mean(ratio))


def block_sums(scores: np.ndarray, length: int) -> np.ndarray:
    """Sums over consecutive blocks of rows."""
    spare = -len(scores) % length
    padded = np.concatenate([scores, np.zeros((spare, scores.shape[1]))])
    return padded.reshape(-1, length, scores.shape[1]).sum(1)


def normalised_rms(problem: Problem, coordinates: np.ndarray, noise: Noise) -> float:
    """Root-mean-square normalised innovation: one at the noise level."""
    tuned = problem.tuned(coordinates, noise)
    count = np.asarray(tuned.gains.used).sum()
    return float(np.sqrt((np.asarray(tuned.white) ** 2).sum() / max(count, 1)))


def physical_table(problem: Problem, fitted: Estimate) -> list[dict]:
    """One row per fitted vessel parameter: name, start, value, standard error, determined."""
    rows = []
    position = {int(k): n for n, k in enumerate(fitted.index)}
    for number, parameter in enumerate(problem.layout.parameters):
        if number not in position:
            continue
        n, at = position[number], float(fitted.coordinates[number])
        std = parameter.slope(at) * float(np.sqrt(fitted.covariance[n, n]))
        rows.append(_row(parameter, at, std, float(fitted.shrinkage[n])))
    return rows


def _row(parameter: Parameter, at: float, std: float, shrinkage: float) -> dict:
    return {
        "name": parameter.name,
        "start": parameter.value,
        "value": float(parameter.decode(at)),
        "std": std,
        "determined": shrinkage,
    }
