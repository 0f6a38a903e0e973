"""The first hypotheses of a diagnosis: faults that the audit found, and disturbances measured.

An audit compares channels of one run with each other and needs no model of the vessel. A fault of a
sensor or a clock that it finds with one size in most of the runs is tried before any force is
blamed, and asked no more than that the model agrees. So is a disturbance that was measured, as the
wind by an anemometer: it acts on every vessel, and what the model makes of its absence would be
named as something else.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.decision import AcceptedEffect, ShortList
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.refits import Refit, refit_fully
from diffsea.diagnosis.screening import Screening
from diffsea.identification.coordinates import CoordinateLayout
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import Start
from diffsea.identification.holdout import Split
from diffsea.recordings import Finding
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.effects.compass import TurnedByMotors
from diffsea.vessel.effects.entry import MeasuredChannels


SHARE_OF_RUNS = 0.5  # in which it must have been found: others may not have excited it
SAME_TIME = 0.02  # of what is noticeable of an onset: a reading or two
LARGEST_SPREAD = 0.25  # of a size over runs, in its median: as of an effect's constancy


@dataclasses.dataclass(frozen=True)
class FirstHypothesis:
    """An effect of the catalogue that the recordings tell of by themselves, with its size."""

    effect: str
    coordinates: Float[np.ndarray, "own"]  # in noticeable sizes
    is_audited: bool = True  # or else it is a disturbance that was measured


def certain_effects(layout: CoordinateLayout) -> list[FirstHypothesis]:
    """The effects of a layout that surely act, since what they are made of was measured."""
    return [
        FirstHypothesis(effect.name, np.array(effect.usual_coordinates) / sizes, is_audited=False)
        for effect, sizes in zip(layout.effects, layout.sizes, strict=True)
        if effect.usual_coordinates
    ]


def audited_effects(
    vessel: Vessel, layout: CoordinateLayout, findings: Sequence[Finding], runs: int
) -> list[FirstHypothesis]:
    """The effects of a layout that an audit of so many runs found, most often found first.

    A finding that may have another cause (it has a `doubt`) is no first hypothesis.
    """
    found: dict[str, dict[str, np.ndarray]] = {}
    for effect, sizes in zip(layout.effects, layout.sizes, strict=True):
        for finding in filter(functools.partial(_shows, effect), findings):
            at = np.array(effect.encode(vessel, finding.parameters)) / sizes
            found.setdefault(effect.name, {})[finding.recording] = at
    out = []
    for name, by_run in sorted(found.items(), key=lambda item: -len(item[1])):
        middle = _common_size(EFFECTS[name], np.stack(list(by_run.values())), runs)
        if middle is not None:
            out.append(FirstHypothesis(name, middle))
    return out


def names_found(findings: Sequence[Finding]) -> set[str]:
    """Names of the catalogue, with their variants, that an audit points at without a doubt."""
    return {e.name for e in EFFECTS.values() if any(_shows(e, finding) for finding in findings)}


def _shows(effect: Effect, finding: Finding) -> bool:
    """Whether a finding is of this very effect, of its variant and channels, without a doubt.

    Not of measured actuation, of which an actuator that is off itself looks the same; nor of what
    motors do, which is known by the largest thrust of a run, not by the full one.
    """
    is_sensor = effect.family == "sensor" and not effect.needs_feedback
    if not is_sensor or isinstance(effect.place, TurnedByMotors):
        return False
    channels = isinstance(effect.place, MeasuredChannels) and effect.place.names
    alike = finding.kind == catalogue_name(effect.name) and not finding.doubt
    alike = alike and set(finding.parameters) == set(effect.units)
    return alike and (not channels or set(channels) == set(finding.channels))


def _common_size(
    effect: Effect, found: Float[np.ndarray, "run own"], runs: int
) -> Float[np.ndarray, "own"] | None:
    """The median of what was found, if it is one size at one time in most of so many runs."""
    middle = np.median(found, axis=0)
    same_time = (np.abs(found - middle) <= SAME_TIME)[:, ~effect.amounts].all(axis=1)
    if same_time.sum() < SHARE_OF_RUNS * runs:
        return None
    amounts = (found - middle)[same_time][:, effect.amounts]
    apart = np.median(np.linalg.norm(amounts, axis=1))
    is_one_size = apart <= LARGEST_SPREAD * np.linalg.norm(middle[effect.amounts])
    return middle if is_one_size else None


def judge_first(
    data: Split, current: Estimate, screening: Screening, first: FirstHypothesis
) -> AcceptedEffect | None:
    """The effect beside the current ones, fitted from the size it came with; None if it fails.

    It must be physical and have the evidence that any name needs; held-out runs and free
    predictions must not speak against it. That recordings tell of it by themselves stands for the
    constancy of its size, and for its lead over whatever else would explain the same.
    """
    candidate = screening.candidates.get(first.effect)
    if candidate is None:
        return None
    start = np.array(current.coordinates, float)
    start[data.train.layout.indices((first.effect,))] = first.coordinates
    asked = Refit(candidate, [Start.beside(current, start)])
    (one,) = refit_fully(data, current, [asked])
    listed = ShortList.of(data.train, [one])
    return AcceptedEffect(one, listed) if _is_believed(one, listed.needed) else None


def _is_believed(one: Hypothesis, needed: float) -> bool:
    if not (one.is_judged and one.predicts_motion and one.gain is not None):
        return False
    return one.evidence(one.inflation) > needed and (one.gain.open or one.gain.clear)
