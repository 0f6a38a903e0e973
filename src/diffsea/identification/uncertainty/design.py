"""Which manoeuvre to record next: D-optimal over a library within the vessel's limits."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from diffsea.errors import UserError
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import (
    Problem,
    first_run_coordinates,
    make_problem,
    vessel_in_environment,
)
from diffsea.identification.residual import linearise
from diffsea.scales import froude_speed, time_scale
from diffsea.simulation.control import ControlAllocation, full_throttle, throttle_for
from diffsea.simulation.replay import replay
from diffsea.simulation.standard import STANDARD_TRIALS, Schedule, Times, alternating_schedule
from diffsea.trajectory import MOTION_CHANNELS, Trajectory
from diffsea.vessel.base import Vessel


SECONDS = 170.0  # of a simulated recording, in sqrt(L / g): ten legs of the library's zig-zag
SAMPLES = 600  # of it: three to each sqrt(L / g)
UNLIMITED_FROUDE = 0.3  # at full throttle, for a vessel without a limit

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

    def as_dict(self) -> dict[str, Any]:
        """The record of fit.json."""
        return dataclasses.asdict(self) | {"message": self.sentence}


class NoThrottleError(UserError):
    """A vessel without a limit to its throttle, which none brings to a speed to manoeuvre at."""


def next_manoeuvre(problem: Problem, fitted: Estimate) -> NextManoeuvre | None:
    """The manoeuvre of the library with the largest gain of information on what was fitted.

    Recordings are simulated with the sensors of those that were fitted and the noise that was
    found; the gain is 1/2 log det(I + C J), C the covariance now and J the information of the
    manoeuvre (D-optimality, Goodwin and Payne 1977). None where the vessel as fitted can do none
    of them, for want of thrust.
    """
    fitted_parameters = fitted.of_vessel(problem.layout.parameters)
    free, chosen = tuple(p.name for p in fitted_parameters.values()), list(fitted_parameters)
    covariance = fitted.covariance[np.ix_(chosen, chosen)]
    vessel = vessel_in_environment(problem, first_run_coordinates(problem, fitted.coordinates))
    measured = problem.dataset.recorded_channels
    gains, after = {}, {}
    for manoeuvre, schedule in LIBRARY.items():
        try:
            recording = simulate_manoeuvre(vessel, schedule, measured)
        except NoThrottleError:
            return None
        J = manoeuvre_information(problem, recording, fitted, free)
        root = np.linalg.cholesky(covariance)
        values = np.linalg.eigvalsh(root.T @ J @ root)
        gains[manoeuvre] = float(0.5 * np.log1p(np.maximum(values, 0.0)).sum())
        after[manoeuvre] = np.linalg.inv(np.linalg.inv(covariance) + J)
    best = max(gains, key=lambda name: gains[name])
    ratio = np.sqrt(np.diag(after[best]) / np.diag(covariance))
    seconds = SECONDS * time_scale(float(vessel.rigid_body.length))
    return NextManoeuvre(best, seconds, gains, dict(zip(free, map(float, ratio), strict=True)))


def manoeuvre_information(
    problem: Problem, run: Trajectory, at: Estimate, free: tuple[str, ...]
) -> Float[np.ndarray, "free free"]:
    """Information of a recording on the free parameters, nothing else being estimated."""
    priors = {p.name: p for p in problem.layout.parameters}
    one = make_problem(problem.base, [run], tuple(priors), priors=priors)
    coordinates = np.asarray(at.coordinates)[: len(priors)]
    gains = one.run_filter(coordinates, at.noise).gains
    J = linearise(one, gains, coordinates, one.layout.indices(free)).jacobian
    J = J[: one.dataset.measured.size]
    return J.T @ J


def simulate_manoeuvre(
    vessel: Vessel, schedule: Schedule, measured: Bool[np.ndarray, "6"] | None = None
) -> Trajectory:
    """What the vessel would record in a manoeuvre, without noise, from rest.

    `measured` says which motion channels are recorded; all of them by default.

    Raises:
        NoThrottleError: as `manoeuvre_orders`.
    """
    seconds = SECONDS * time_scale(float(vessel.rigid_body.length))
    t, orders = manoeuvre_orders(vessel, schedule, seconds)
    first, valid = np.where(t == t[0], 0.0, np.nan), np.ones(len(t), bool)
    run = replay(
        vessel, Trajectory(t, *(first,) * 6, commanded=orders, executed={}, extra={}, valid=valid)
    )
    known = np.ones(6, bool) if measured is None else measured
    missing = np.array(MOTION_CHANNELS)[~known]
    return dataclasses.replace(run, **dict.fromkeys(missing, np.full(len(t), np.nan)))


def manoeuvre_orders(
    vessel: Vessel, schedule: Schedule, seconds: float
) -> tuple[Times, dict[str, Times]]:
    """Times (s) and orders of a manoeuvre by channel, within the limits of the vessel.

    Full throttle is, for a vessel without a limit, the one for Froude number 0.3.

    Raises:
        NoThrottleError: by its model none brings the vessel there.
    """
    length = float(vessel.rigid_body.length)
    time = time_scale(length)
    t = np.linspace(0.0, seconds, round(SAMPLES * seconds / (SECONDS * time)))
    share, angle = schedule(t / time)
    full = float(full_throttle(vessel))
    if not np.isfinite(full):
        full = float(throttle_for(vessel, froude_speed(length, UNLIMITED_FROUDE)))
    if not np.isfinite(full):
        raise NoThrottleError(
            f"{vessel.name} has no limit to its throttle, and by this model none brings it to "
            f"Froude number {UNLIMITED_FROUDE:g}: give its propulsion a limit in the vessel file"
        )
    allocation = ControlAllocation(vessel)
    given = jax.vmap(allocation.orders)(jnp.asarray(full * share), jnp.asarray(angle))
    orders = {}
    for channel in vessel.channels:
        servo = vessel.servos[channel]
        low = -np.inf if servo.lower is None else float(servo.lower)
        high = np.inf if servo.upper is None else float(servo.upper)
        orders[channel] = np.clip(np.asarray(given[channel]), low, high)
    return t, orders
