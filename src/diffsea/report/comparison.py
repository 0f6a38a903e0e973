"""Held-out runs against what the nominal and the diagnosed model predict, open loop."""

import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np

from diffsea.diagnosis.holdout import transferred
from diffsea.diagnosis.select import Diagnosis
from diffsea.identification.likelihood import equipped
from diffsea.simulation.replay import horizon_errors, replay
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel


Errors = dict[float, dict[str, float]]  # by horizon (s), then by quantity


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One run and what two models predict of it from its first state on."""

    recording: Trajectory
    nominal: Trajectory
    diagnosed: Trajectory
    nominal_errors: Errors
    diagnosed_errors: Errors


def compare(diagnosis: Diagnosis, nominal: Vessel, diagnosed: Vessel) -> list[Comparison]:
    """Both models on every held-out run."""
    runs = diagnosis.split.held_out
    vessels = _in_own_environment(diagnosis, diagnosed)
    return [
        Comparison(
            run, replay(nominal, run), replay(vessel, run),
            horizon_errors(nominal, run), horizon_errors(vessel, run),
        )
        for run, vessel in zip(runs, vessels, strict=True)
    ]  # fmt: skip


def own_environment(diagnosis: Diagnosis) -> bool:
    """Whether an accepted effect has its own size in each recording."""
    if not diagnosis.effects or not diagnosis.split.train.layout.per_run:
        return False
    groups = {effect.name: effect.group for effect in diagnosis.split.train.layout.effects}
    return any(groups[name] == "environment" for name in diagnosis.names)


def _in_own_environment(diagnosis: Diagnosis, diagnosed: Vessel) -> list[Vessel]:
    """The diagnosed vessel for each held-out run.

    Wind and current of one run say nothing about another's: there they are estimated on
    the held-out run itself, everything else as it was.
    """
    data = diagnosis.split
    if not own_environment(diagnosis):
        return [diagnosed] * len(data.held_out)
    coordinates = transferred(data, diagnosis.final)
    vessel, flow = equipped(data.test.base, data.test.layout, coordinates)
    flows = [jax.tree.map(lambda leaf, k=k: leaf[k], flow) for k in range(len(data.held_out))]
    return [dataclasses.replace(vessel, environment=one) for one in flows]


def horizon_table(comparisons: Sequence[Comparison]) -> list[dict]:
    """Errors of both models at each horizon, root mean square over all starts of all runs."""
    horizons = sorted({h for one in comparisons for h in one.nominal_errors})
    return [
        {
            "seconds": horizon,
            "starts": sum(
                int(one.nominal_errors[horizon]["starts"])
                for one in comparisons
                if horizon in one.nominal_errors
            ),
            "nominal": _pooled([c.nominal_errors.get(horizon) for c in comparisons]),
            "diagnosed": _pooled([c.diagnosed_errors.get(horizon) for c in comparisons]),
        }
        for horizon in horizons
    ]


def _pooled(errors: list[dict[str, float] | None]) -> dict[str, float]:
    given = [one for one in errors if one]
    names = [name for name in given[0] if name != "starts"] if given else []
    pooled = {}
    for name in dict.fromkeys([*names, *(n for one in given for n in one if n != "starts")]):
        squares = [(one[name] ** 2, one["starts"]) for one in given if name in one]
        mean = float(np.average([s for s, _ in squares], weights=[w for _, w in squares]))
        pooled[name] = math.sqrt(mean)
    return pooled


def with_held_out_errors(
    summary: dict, diagnosis: Diagnosis, nominal: Vessel, diagnosed: Vessel
) -> dict:
    """The summary with prediction errors at several horizons among what was held out."""
    return _with(summary, compare(diagnosis, nominal, diagnosed))


def _with(summary: dict, comparisons: Sequence[Comparison]) -> dict:
    table = horizon_table(comparisons)
    return summary | {"held_out": summary.get("held_out", {}) | {"horizons": table}}
