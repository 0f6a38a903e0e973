"""Which manoeuvre to record next: D-optimal over a library within the vessel's limits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffsea.identification.coordinates import vessel_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.problem import Problem, jacobian, make_problem, selection, traced
from diffsea.scales import froude_speed, time_scale
from diffsea.simulation.control import ControlAllocation, full_throttle, throttle_for
from diffsea.simulation.replay import replay
from diffsea.simulation.standard import STANDARD_TRIALS, Schedule, Times, alternating_schedule
from diffsea.trajectory import MOTION_CHANNELS, Trajectory
from diffsea.vessel.base import Vessel


SECONDS = 170.0  # of an imagined recording, in sqrt(L / g)
SAMPLES = 600

# Times in sqrt(L / g) of the vessel, so that they suit a model as well as a ship.
LIBRARY: dict[str, Schedule] = {
    **{name: trial.schedule for name, trial in STANDARD_TRIALS.items() if trial.schedule},
    "fast steps": alternating_schedule(4.0, 0.45),
    "speed steps": lambda t: (0.2 + 0.2 * ((t // 21.0) % 4), np.zeros_like(t)),
    "sprint and coast": lambda t: (np.where((t // 28.0) % 2 == 0, 0.9, 0.0), 0.05 * np.sin(t / 10)),
    "crash stop": lambda t: (np.where((t // 28.0) % 2 == 0, 0.8, -0.5), np.zeros_like(t)),
    "slow and fast zigzag": lambda t: (
        np.where(t < SECONDS / 2, 0.25, 0.9),
        np.where((t // 14.0) % 2 == 0, 0.35, -0.35),
    ),
    "legs on four headings": lambda t: (
        np.where((t // 42.0) % 2 == 0, 0.7, 0.35),
        np.where(t % 21.0 < 6.0, 0.35, 0.0),
    ),
}


@dataclasses.dataclass(frozen=True)
class NextManoeuvre:
    """The manoeuvre that would tell most about the parameters."""

    manoeuvre: str
    seconds: float
    gains: dict[str, float]  # of every manoeuvre: half the rise of log det precision, in nats
    stds: dict[str, float]  # ratio of each parameter's standard error after to before

    @property
    def sentence(self) -> str:
        """In words."""
        most = sorted(self.stds, key=lambda name: self.stds[name])[:3]
        told = ", ".join(f"{name} to {100 * self.stds[name]:.0f} %" for name in most)
        return (
            f"{self.manoeuvre}, {self.seconds:.0f} s of it, would tell most: it would narrow "
            f"{told} of the present standard errors"
        )

    def as_dict(self) -> dict:
        """The record of fit.json."""
        return dataclasses.asdict(self) | {"message": self.sentence}


def next_manoeuvre(problem: Problem, fitted: Estimate, noise: Noise | None = None) -> NextManoeuvre:
    """The manoeuvre of the library with the largest gain of information on what was fitted.

    Recordings are imagined with the sensors of those that were fitted and the noise that was
    found; the gain is 1/2 log det(I + C J), C the covariance now and J the information of the
    manoeuvre (D-optimality, Goodwin and Payne 1977).
    """
    noise = fitted.noise if noise is None else noise
    names = [p.name for p in problem.layout.parameters]
    chosen = [n for n, k in enumerate(fitted.index) if k < len(names)]
    covariance = fitted.covariance[np.ix_(chosen, chosen)]
    free = tuple(names[fitted.index[n]] for n in chosen)
    vessel = vessel_in_environment(problem, first_run_coordinates(problem, fitted.coordinates))
    measured = np.asarray(problem.dataset.known).any(0)
    gains, after = {}, {}
    for manoeuvre, schedule in LIBRARY.items():
        J = manoeuvre_information(
            problem, simulate_manoeuvre(vessel, schedule, measured), fitted, free, noise
        )
        root = np.linalg.cholesky(covariance)
        values = np.linalg.eigvalsh(root.T @ J @ root)
        gains[manoeuvre] = float(0.5 * np.log1p(np.maximum(values, 0.0)).sum())
        after[manoeuvre] = np.linalg.inv(np.linalg.inv(covariance) + J)
    best = max(gains, key=lambda name: gains[name])
    ratio = np.sqrt(np.diag(after[best]) / np.diag(covariance))
    return NextManoeuvre(
        best,
        SECONDS * time_scale(float(vessel.rigid_body.length)),
        gains,
        dict(zip(free, map(float, ratio), strict=True)),
    )


def manoeuvre_information(
    problem: Problem, run: Trajectory, at: Estimate, free: tuple[str, ...], noise: Noise
) -> Float[np.ndarray, "free free"]:
    """Information of a recording on the free parameters, nothing else being estimated."""
    layout = problem.layout
    one = make_problem(
        problem.base, [run], tuple(p.name for p in layout.parameters),
        priors={p.name: p for p in layout.parameters},
    )  # fmt: skip
    coordinates = np.asarray(at.coordinates)[: len(layout.parameters)]
    index, matrix = selection(one.layout, free, one.width)
    inputs = traced(one, one.run_filter(coordinates, noise).gains, coordinates, matrix)
    J = jacobian(coordinates[index], inputs)[1]
    J = J[: one.dataset.measured.size, : len(index)]
    return J.T @ J


def first_run_coordinates(problem: Problem, coordinates: np.ndarray) -> np.ndarray:
    """Coordinates with one set per effect: the first run's where each has its own."""
    layout = problem.layout
    parts = [coordinates[: len(layout.parameters)]]
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        parts.append(coordinates[layout.slices()[effect.name]][: len(sizes)])
    return np.concatenate(parts)


def vessel_in_environment(problem: Problem, coordinates: np.ndarray) -> Vessel:
    """The vessel at coordinates with one set per effect, its environment in place."""
    layout = dataclasses.replace(problem.layout, runs=1, per_run=False)
    vessel, flows = vessel_at(problem.base, layout, np.asarray(coordinates))
    environment = type(flows)(*(float(np.asarray(leaf)[0]) for leaf in vars(flows).values()))
    vessel = dataclasses.replace(vessel, environment=environment)
    return jax.tree.map(float, vessel)


def simulate_manoeuvre(
    vessel: Vessel, schedule: Schedule, measured: np.ndarray | None = None
) -> Trajectory:
    """What the vessel would record in a manoeuvre, without noise, from rest.

    `measured` says which motion channels are recorded; all of them by default.
    """
    t, orders = manoeuvre_orders(
        vessel, schedule, SECONDS * time_scale(float(vessel.rigid_body.length))
    )
    first = np.where(t == t[0], 0.0, np.nan)
    run = replay(vessel, Trajectory(t, *(first,) * 6, orders, {}, {}, np.ones(len(t), bool)))
    if measured is None:
        return run
    silent = [c for c, known in zip(MOTION_CHANNELS, measured, strict=True) if not known]
    return dataclasses.replace(run, **{c: np.full(len(t), np.nan) for c in silent})


def manoeuvre_orders(
    vessel: Vessel, schedule: Schedule, seconds: float
) -> tuple[Times, dict[str, Times]]:
    """Times (s) and orders of a manoeuvre by channel, within the limits of the vessel."""
    time = time_scale(float(vessel.rigid_body.length))
    t = np.linspace(0.0, seconds, round(SAMPLES * seconds / (SECONDS * time)))
    share, angle = schedule(t / time)
    allocation, full = ControlAllocation(vessel), _full(vessel)
    given = jax.vmap(allocation.orders)(jnp.asarray(full * share), jnp.asarray(angle))
    limits = {c: (servo.lower, servo.upper) for c, servo in vessel.servos.items()}
    return t, {c: np.clip(np.asarray(given[c]), *_numbers(limits[c])) for c in vessel.channels}


def _numbers(limits: tuple) -> tuple[float, float]:
    low, high = limits
    return -np.inf if low is None else float(low), np.inf if high is None else float(high)


def _full(vessel: Vessel) -> float:
    """Full throttle; without a limit, the one for Froude number 0.3."""
    full = float(full_throttle(vessel))
    if np.isfinite(full):
        return full
    return float(throttle_for(vessel, froude_speed(float(vessel.rigid_body.length), 0.3)))
