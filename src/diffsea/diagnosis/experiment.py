"""Which manoeuvre would tell two explanations apart, from Fisher information.

If A is true with its estimated size and B is fitted to data from A, twice the expected log
likelihood ratio is `eta_A' (V_AA - V_AB V_BB^-1 V_BA) eta_A`, with V the information after
projecting out everything else that is estimated. The manoeuvre with the largest of these,
the smaller of the two directions, is the one to record.
"""

import dataclasses

import numpy as np

from diffsea.diagnosis.decision import Accepted
from diffsea.diagnosis.jacobians import columns_at
from diffsea.diagnosis.refit import Fitted
from diffsea.diagnosis.score import Projection
from diffsea.diagnosis.search import Diagnosis
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import (
    first_run_coordinates,
    make_problem,
    vessel_in_environment,
)
from diffsea.identification.uncertainty.design import (
    LIBRARY,
    SECONDS,
    Schedule,
    manoeuvre_orders,
    simulate_manoeuvre,
)
from diffsea.scales import time_scale
from diffsea.vessel.effects import catalogue_name


SHORTEST = 40.0  # of sqrt(L / g): no manoeuvre shows much in less
LONGEST = 3000.0  # of sqrt(L / g) that anybody would record
DECISIVE = 13.8  # twice the log of odds of 1000 to 1


@dataclasses.dataclass(frozen=True)
class Experiment:
    """A manoeuvre to record, and how long for odds of 1000 to 1.

    Where none would do, because the rivals act alike, its name is "none".
    """

    manoeuvre: str
    why: str
    seconds: float  # s; infinite where nothing in the library would do
    evidence: dict[str, float]  # of each manoeuvre, for SECONDS sqrt(L / g)

    @property
    def exists(self) -> bool:
        """Whether there is a manoeuvre that would do."""
        return bool(np.isfinite(self.seconds))

    def as_dict(self) -> dict:
        """The record of diagnosis.json."""
        return {
            "manoeuvre": self.manoeuvre,
            "why": self.why,
            "seconds": self.seconds if self.exists else None,
            "evidence": self.evidence,
        }


def next_experiment(diagnosis: Diagnosis) -> Experiment | None:
    """What to record next, if two explanations could not be told apart."""
    for accepted in diagnosis.effects:
        rivals = [
            one
            for one in accepted.tried
            if catalogue_name(one.effect) in accepted.rivals and one.effect != accepted.name
        ]
        if rivals:
            return _separating(diagnosis, accepted, rivals[0])
    return None


def _separating(diagnosis: Diagnosis, accepted: Accepted, rival: Fitted) -> Experiment:
    one, other = catalogue_name(accepted.name), catalogue_name(rival.effect)
    evidence = {name: _evidence(diagnosis, accepted, rival, LIBRARY[name]) for name in LIBRARY}
    best = max(evidence, key=lambda name: evidence[name])
    base = diagnosis.split.train.base
    time = time_scale(float(base.rigid_body.length))
    if evidence[best] <= DECISIVE * SECONDS / LONGEST:
        why = (
            f"{one} and {other} act alike in every manoeuvre that was weighed, for up to "
            f"{LONGEST * time / 60:.0f} min; what is known of the vessel and its clocks may tell"
        )
        return Experiment("none", why, float("inf"), evidence)
    seconds = max(SECONDS * DECISIVE / evidence[best], SHORTEST) * time
    return Experiment(best, f"separates {one} from {other}", float(seconds), evidence)


def commands(diagnosis: Diagnosis, experiment: Experiment) -> dict[str, np.ndarray]:
    """The manoeuvre as a command sequence within the vessel's limits.

    `t` (s) and `cmd_<channel>` in the unit of each channel, for as long as it must run.
    """
    train = diagnosis.split.train
    vessel = vessel_in_environment(train, first_run_coordinates(train, diagnosis.final.coordinates))
    t, orders = manoeuvre_orders(vessel, LIBRARY[experiment.manoeuvre], experiment.seconds)
    return {"t": t} | {f"cmd_{channel}": series for channel, series in orders.items()}


def _evidence(diagnosis: Diagnosis, accepted: Accepted, rival: Fitted, schedule: Schedule) -> float:
    """Expected evidence of one run, in the direction in which it is smaller."""
    one, two = accepted.fitted.estimate, rival.estimate
    a = _one_way(diagnosis, one, accepted.name, two, rival.effect, schedule)
    b = _one_way(diagnosis, two, rival.effect, one, accepted.name, schedule)
    return min(a, b)


def _one_way(
    diagnosis: Diagnosis,
    true: Estimate,
    name: str,
    otherwise: Estimate,
    other: str,
    schedule: Schedule,
) -> float:
    """Evidence against `other` if the vessel is as estimated with `name`.

    The other has the onset with which it was fitted: a change happens when it was found to.
    """
    train = diagnosis.split.train
    coordinates = first_run_coordinates(train, true.coordinates)
    base = train.base
    vessel = vessel_in_environment(train, coordinates)
    measured = np.asarray(train.dataset.known).any(0)
    problem = make_problem(
        base, [simulate_manoeuvre(vessel, schedule, measured)],
        tuple(p.name for p in train.layout.parameters), train.layout.effects, False,
        train.directions - len(train.layout.parameters),
        least=train.dataset.shape,
    )  # fmt: skip
    effects = {effect.name: effect for effect in problem.layout.effects}
    if effects[other].scanned is not None:
        scanned = problem.layout.indices((other,))[effects[other].scanned[0]]
        coordinates[scanned] = first_run_coordinates(train, otherwise.coordinates)[scanned]
    at = dataclasses.replace(true, coordinates=coordinates)
    gains = problem.run_filter(coordinates, true.noise).gains
    nuisance = tuple(n for n in true.free if n not in (name, other))
    residual, N = columns_at(problem, gains, at, nuisance)
    projection = Projection(residual, N, np.asarray(problem.dataset.run))
    place = problem.layout.indices((name,))
    columns = columns_at(problem, gains, at, (name,))[1].copy()
    columns[projection.rows + np.array(place)] = 0.0  # its prior is no evidence of a manoeuvre
    A = projection.efficient(columns)
    B = projection.efficient(columns_at(problem, gains, at, (other,))[1])
    eta = coordinates[place].copy()
    eta[~effects[name].amounts] = 0.0  # it is gone without its size, whatever its time
    left = A @ eta
    fitted = B @ np.linalg.lstsq(B, left, rcond=1e-10)[0]
    return float(((left - fitted) ** 2).sum())
