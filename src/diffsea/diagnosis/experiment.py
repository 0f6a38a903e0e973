"""Which manoeuvre would tell two explanations apart, from Fisher information.

If A is true with its estimated size and B is fitted to data from A, twice the expected log
likelihood ratio is `eta_A' (V_AA - V_AB V_BB^-1 V_BA) eta_A`, with V the information after
projecting out everything else that is estimated. The manoeuvre with the largest of these,
the smaller of the two directions, is the one to record.
"""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.score import LinearisedModel
from diffsea.diagnosis.verdict import Diagnosis
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import (
    Problem,
    first_run_coordinates,
    make_problem,
    vessel_in_environment,
)
from diffsea.identification.uncertainty import design
from diffsea.identification.uncertainty.design import LIBRARY, SECONDS
from diffsea.scales import time_scale
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, catalogue_name


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

    def as_dict(self) -> dict[str, Any]:
        """The record of diagnosis.json."""
        return dataclasses.asdict(self) | {"seconds": self.seconds if self.exists else None}


def next_experiment(diagnosis: Diagnosis) -> Experiment | None:
    """What to record next, if two explanations could not be told apart.

    None, too, where one of them leaves the vessel without the thrust for any manoeuvre.
    """
    train = diagnosis.split.train
    for accepted in diagnosis.effects:
        one = accepted.hypothesis
        for two in accepted.short_list.hypotheses:
            if catalogue_name(two.effect) not in accepted.rivals or two.effect == one.effect:
                continue
            try:
                evidence = {
                    manoeuvre: min(
                        expected_evidence(train, one, two, schedule),
                        expected_evidence(train, two, one, schedule),
                    )
                    for manoeuvre, schedule in LIBRARY.items()
                }
            except design.NoThrottleError:
                return None
            return choose_manoeuvre(train.base, one.effect, two.effect, evidence)
    return None


def choose_manoeuvre(
    vessel: Vessel, name: str, other: str, evidence: dict[str, float]
) -> Experiment:
    """The manoeuvre that separates two effects, by the evidence expected of each."""
    one, two = catalogue_name(name), catalogue_name(other)
    best = max(evidence, key=lambda name: evidence[name])
    time = time_scale(float(vessel.rigid_body.length))
    if evidence[best] <= DECISIVE * SECONDS / LONGEST:
        why = (
            f"{one} and {two} act alike in every manoeuvre that was weighed, for up to "
            f"{LONGEST * time / 60:.0f} min; what is known of the vessel and its clocks may tell"
        )
        return Experiment("none", why, float("inf"), evidence)
    seconds = max(SECONDS * DECISIVE / evidence[best], SHORTEST) * time
    return Experiment(best, f"separates {one} from {two}", float(seconds), evidence)


def commands(
    train: Problem, final: Estimate, experiment: Experiment
) -> dict[str, Float[np.ndarray, "time"]]:
    """The manoeuvre as a command sequence within the limits of the diagnosed vessel.

    `t` (s) and `cmd_<channel>` in the unit of each channel, for as long as it must run.
    """
    vessel = vessel_in_environment(train, first_run_coordinates(train, final.coordinates))
    t, orders = design.manoeuvre_orders(vessel, LIBRARY[experiment.manoeuvre], experiment.seconds)
    return {"t": t} | {f"cmd_{channel}": series for channel, series in orders.items()}


def expected_evidence(
    train: Problem, true: Hypothesis, other: Hypothesis, schedule: design.Schedule
) -> float:
    """Evidence of one run against the other effect if the vessel is as estimated with the true one.

    The other has the onset with which it was fitted: a change happens when it was found to.
    """
    coordinates = first_run_coordinates(train, true.estimate.coordinates)
    vessel = vessel_in_environment(train, coordinates)
    measured = train.dataset.recorded_channels
    priors = {parameter.name: parameter for parameter in train.layout.parameters}
    run = design.simulate_manoeuvre(vessel, schedule, measured)
    effects, least = train.layout.effects, train.dataset.shape
    problem = make_problem(train.base, [run], tuple(priors), effects, False, priors, least)
    onset = EFFECTS[other.effect].scanned
    if onset is not None:
        scanned = problem.layout.indices((other.effect,))[onset[0]]
        coordinates[scanned] = first_run_coordinates(train, other.estimate.coordinates)[scanned]
    gains = problem.run_filter(coordinates, true.estimate.noise).gains
    model, rivals = LinearisedModel(problem, coordinates, gains), (true.effect, other.effect)
    projection = model.projection(tuple(n for n in true.estimate.free if n not in rivals))
    place = problem.layout.indices((true.effect,))
    columns = model.by_name((true.effect,))[1].copy()
    columns[projection.data_values + np.array(place)] = 0.0  # its prior is no evidence of a run
    A = projection.efficient(columns)
    B = projection.efficient(model.by_name((other.effect,))[1])
    eta = coordinates[place].copy()
    eta[~EFFECTS[true.effect].amounts] = 0.0  # it is gone without its size, whatever its time
    left = A @ eta
    fitted = B @ np.linalg.lstsq(B, left, rcond=1e-10)[0]
    return float(((left - fitted) ** 2).sum())
