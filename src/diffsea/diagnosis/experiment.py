"""Which manoeuvre would tell two explanations apart, from Fisher information.

If A is true with its estimated size and B is fitted to data from A, twice the expected log
likelihood ratio is `eta_A' (V_AA - V_AB V_BB^-1 V_BA) eta_A`, with V the information after
projecting out everything else that is estimated. The manoeuvre with the largest of these,
the smaller of the two directions, is the one to record.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from diffsea.diagnosis.candidates import catalogue_name
from diffsea.diagnosis.score import Projection
from diffsea.diagnosis.select import Accepted, Diagnosis, Fitted, columns_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.layout import equipped
from diffsea.identification.problem import Problem, make_problem
from diffsea.simulation.control import Helm, full_throttle, throttle_for
from diffsea.simulation.replay import replay
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel


DECISIVE = 13.8  # twice the log of odds of 1000 to 1
SECONDS = 120.0
INTERVAL = 0.2  # s between samples of the imagined recording

Series = np.ndarray
Schedule = Callable[[Series], tuple[Series, Series]]  # time to throttle share and angle (rad)


@dataclasses.dataclass(frozen=True)
class Experiment:
    """A manoeuvre to record, and how long for odds of 1000 to 1."""

    manoeuvre: str
    why: str
    seconds: float  # s; infinite where nothing in the library would do
    evidence: dict[str, float]  # of each manoeuvre, for SECONDS s

    def as_dict(self) -> dict:
        """The record of diagnosis.json."""
        seconds = self.seconds if np.isfinite(self.seconds) else None
        return {
            "manoeuvre": self.manoeuvre,
            "why": self.why,
            "seconds": seconds,
            "evidence": self.evidence,
        }


def _alternating(period: float, angle: float) -> Schedule:
    return lambda t: (np.full_like(t, 0.6), np.where((t // period) % 2 == 0, angle, -angle))


LIBRARY: dict[str, Schedule] = {
    "turning-circle": lambda t: (np.full_like(t, 0.6), np.full_like(t, 0.35)),
    "zigzag": _alternating(12.0, 0.35),
    "fast steps": _alternating(3.0, 0.45),
    "speed steps": lambda t: (0.2 + 0.2 * ((t // 15.0) % 4), np.zeros_like(t)),
    "sprint and coast": lambda t: (np.where((t // 20.0) % 2 == 0, 0.9, 0.0), 0.05 * np.sin(t / 7)),
    "crash stop": lambda t: (np.where((t // 20.0) % 2 == 0, 0.8, -0.5), np.zeros_like(t)),
    "slow and fast zigzag": lambda t: (
        np.where(t < SECONDS / 2, 0.25, 0.9),
        np.where((t // 10.0) % 2 == 0, 0.35, -0.35),
    ),
    "legs on four headings": lambda t: (
        np.where((t // 30.0) % 2 == 0, 0.7, 0.35),
        np.where(t % 15.0 < 4.0, 0.35, 0.0),
    ),
}


def next_experiment(diagnosis: Diagnosis) -> Experiment | None:
    """What to record next, if two explanations could not be told apart."""
    for accepted in diagnosis.effects:
        rivals = [
            one
            for one in diagnosis.refitted
            if catalogue_name(one.effect) in accepted.rivals and one.effect != accepted.name
        ]
        if rivals:
            return _separating(diagnosis, accepted, rivals[0])
    return None


def _separating(diagnosis: Diagnosis, accepted: Accepted, rival: Fitted) -> Experiment:
    names = (accepted.name, rival.effect)
    evidence = {name: _evidence(diagnosis, accepted, rival, LIBRARY[name]) for name in LIBRARY}
    best = max(evidence, key=lambda name: evidence[name])
    seconds = SECONDS * DECISIVE / evidence[best] if evidence[best] > 0 else np.inf
    why = f"separates {catalogue_name(names[0])} from {catalogue_name(names[1])}"
    return Experiment(best, why, float(seconds), evidence)


def _evidence(diagnosis: Diagnosis, accepted: Accepted, rival: Fitted, schedule: Schedule) -> float:
    """Expected evidence of one run, in the direction in which it is smaller."""
    a = _one_way(diagnosis, accepted.fitted.estimate, accepted.name, rival.effect, schedule)
    b = _one_way(diagnosis, rival.estimate, rival.effect, accepted.name, schedule)
    return min(a, b)


def _one_way(
    diagnosis: Diagnosis, true: Estimate, name: str, other: str, schedule: Schedule
) -> float:
    """Evidence against `other` if the vessel is as estimated with `name`."""
    train = diagnosis.split.train
    coordinates = _single(train, true)
    base = train.base
    vessel = equipped_vessel(train, coordinates)
    problem = make_problem(
        base, [_imagined(vessel, schedule)], tuple(p.name for p in train.layout.parameters),
        train.layout.effects, False, train.seeds - len(train.layout.parameters),
    )  # fmt: skip
    at = dataclasses.replace(true, coordinates=coordinates)
    gains = problem.tuned(coordinates, true.noise).gains
    nuisance = tuple(n for n in true.free if n not in (name, other))
    residual, N = columns_at(problem, gains, at, nuisance)
    projection = Projection(residual, N, np.asarray(problem.tape.run))
    A = projection.efficient(columns_at(problem, gains, at, (name,))[1])
    B = projection.efficient(columns_at(problem, gains, at, (other,))[1])
    eta = coordinates[problem.layout.indices((name,))]
    left = A @ eta
    fitted = B @ np.linalg.lstsq(B, left, rcond=1e-10)[0]
    return float(((left - fitted) ** 2).sum())


def _single(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Coordinates with one set per effect: the first run's where each has its own."""
    layout = problem.layout
    parts = [estimate.coordinates[: len(layout.parameters)]]
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        parts.append(estimate.coordinates[layout.slices()[effect.name]][: len(sizes)])
    return np.concatenate(parts)


def equipped_vessel(problem: Problem, coordinates: np.ndarray) -> Vessel:
    """The vessel at coordinates with one set per effect, its environment in place."""
    layout = dataclasses.replace(problem.layout, runs=1, per_run=False)
    vessel, flows = equipped(problem.base, layout, np.asarray(coordinates))
    environment = type(flows)(*(float(np.asarray(leaf)[0]) for leaf in vars(flows).values()))
    return dataclasses.replace(vessel, environment=environment)


def _imagined(vessel: Vessel, schedule: Schedule) -> Trajectory:
    """What the vessel would record in a manoeuvre, without noise, from rest."""
    t = np.arange(0.0, SECONDS, INTERVAL)
    share, angle = schedule(t)
    helm, full = Helm(vessel), _full(vessel)
    rows = [helm.orders(full * s, a) for s, a in zip(share, angle, strict=True)]
    orders = {c: np.array([float(row[c]) for row in rows]) for c in vessel.channels}
    first = np.where(t == t[0], 0.0, np.nan)
    motion = (first,) * 6
    imagined = Trajectory(t, *motion, orders, {}, {}, np.ones(len(t), bool))
    return replay(vessel, imagined)


def _full(vessel: Vessel) -> float:
    """Full throttle; without a limit, the one for Froude number 0.3."""
    full = float(full_throttle(vessel))
    if np.isfinite(full):
        return full
    return float(throttle_for(vessel, 0.3 * np.sqrt(9.81 * float(vessel.rigid_body.length))))
