"""Runs against what models predict of them, open loop, and by how much they miss.

A prediction starts at the first measured state and knows nothing but the orders (or the measured
actuation), so that its error is the model's own; it grows with time, and is told by horizon.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np

from diffsea.identification.coordinates import vessel_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Split, held_out_coordinates
from diffsea.simulation.replay import horizon_errors, replay
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


Errors = Mapping[float, Mapping[str, float]]  # by horizon (s), then by quantity


class Prediction(NamedTuple):
    """What one model makes of a run from its first state and its orders.

    Attributes:
        run: the predicted motion at the times of the recording.
        errors: root mean square by horizon (s) and quantity (m, rad, m/s, rad/s), over `starts`
            starts along the run.
    """

    run: Trajectory
    errors: Errors


@dataclasses.dataclass(frozen=True)
class ComparedRun:
    """One run and the predictions of it by model, the result last."""

    recording: Trajectory
    predictions: dict[str, Prediction]


def predict(vessel: Vessel, run: Trajectory) -> Prediction:
    """One model on one run.

    Raises:
        UserError: the run has no orders for an actuator of the vessel.
    """
    return Prediction(replay(vessel, run), horizon_errors(vessel, run))


def compare(
    split: Split, final: Estimate, effects: Sequence[str], nominal: Vessel, diagnosed: Vessel
) -> list[ComparedRun]:
    """The models `nominal` and `diagnosed` on every held-out run.

    Arguments:
        final: the fit of the diagnosed model.
        effects: names of those that were added to it; without any both models are one.
    """
    runs = split.held_out
    vessels = _in_own_environment(split, final, effects, diagnosed)
    out = []
    for run, vessel in zip(runs, vessels, strict=True):
        before = predict(nominal, run)
        after = predict(vessel, run) if effects else before
        out.append(ComparedRun(run, {"nominal": before, "diagnosed": after}))
    return out


def _in_own_environment(
    split: Split, final: Estimate, effects: Sequence[str], diagnosed: Vessel
) -> list[Vessel]:
    """The diagnosed vessel for each held-out run.

    Wind and current of one run say nothing about another's: there they are estimated on
    the held-out run itself, everything else as it was.
    """
    layout, count = split.train.layout, len(split.held_out)
    own = {effect.name: effect.per_run for effect in layout.effects}
    if not layout.per_run or not any(own[name] for name in effects):
        return [diagnosed] * count
    coordinates = jax.numpy.asarray(held_out_coordinates(split, final))
    vessel, flow = vessel_at(split.test.base, split.test.layout, coordinates)
    flows = [jax.tree.map(lambda leaf, k=k: leaf[k], flow) for k in range(count)]
    return [dataclasses.replace(vessel, environment=one) for one in flows]


def horizon_table(comparisons: Sequence[ComparedRun]) -> list[dict]:
    """Errors of every model at each horizon, root mean square over all starts of all runs.

    **Returns:** for each horizon `seconds`, `starts` (how many predictions), and by model the
    errors by quantity, as they stand in diagnosis.json and fit.json.
    """
    models = list(comparisons[0].predictions) if comparisons else []
    horizons = {h for one in comparisons for p in one.predictions.values() for h in p.errors}
    rows = []
    for horizon in sorted(horizons):
        errors = {
            model: [
                one.predictions[model].errors[horizon]
                for one in comparisons
                if horizon in one.predictions[model].errors
            ]
            for model in models
        }
        starts = sum(int(one["starts"]) for one in errors[models[0]])
        pooled = {model: _root_mean_square(given) for model, given in errors.items()}
        rows.append({"seconds": horizon, "starts": starts} | pooled)
    return rows


def _root_mean_square(errors: Sequence[Mapping[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for one in errors for name in one if name != "starts")
    pooled = {}
    for name in names:
        given = [one for one in errors if name in one]
        squares = [one[name] ** 2 for one in given]
        pooled[name] = math.sqrt(np.average(squares, weights=[one["starts"] for one in given]))
    return pooled
