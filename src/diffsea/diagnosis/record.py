"""A diagnosis as files have it: diagnosis.json, and vessel files with what was found.

The contract of diagnosis.json is written here and nowhere else.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import norm

from diffsea.diagnosis.decision import AcceptedEffect
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.localisation import (
    DEGREES_OF_FREEDOM,
    FORCE_UNITS,
    Cell,
    latent_force,
    regime_within,
)
from diffsea.diagnosis.screening import Screening, detection_limits
from diffsea.diagnosis.selection import ALPHA
from diffsea.diagnosis.verdict import Diagnosis
from diffsea.identification.estimates import (
    Estimate,
    effect_table,
    is_known,
    parameter_estimates,
    parameter_records,
)
from diffsea.identification.fit import normalised_rms
from diffsea.identification.free_predictions import free_errors
from diffsea.identification.holdout import HeldOut, held_out_coordinates
from diffsea.identification.problem import Problem
from diffsea.identification.uncertainty.onsets import onset_interval
from diffsea.identification.uncertainty.sides import differing_sides
from diffsea.vessel.effects import EFFECTS, Onset, catalogue_name
from diffsea.vessel.files import Table, updated_document


Record = dict[str, Any]  # an object of the JSON file

LOG10_OF_HALF = 0.5 / math.log(10)  # from twice a natural logarithm to a decimal one
MOST_PLACES = 40  # significant cells that are listed
HOLDING_OUT = {
    HeldOut.RECORDINGS: "whole recordings",
    HeldOut.LAST_PARTS: "the last part of each recording",
    HeldOut.AFTER_HEAD: "recordings, after a first part that shows their own environment",
}
STATUSES = ("accepted", "rival", "rejected", "screened out")  # of candidates, as they are listed


def summary(
    diagnosis: Diagnosis,
    audit: list[Record],
    horizons: Sequence[Record] = (),
    next_experiment: Record | None = None,
    source: Record | None = None,
) -> Record:
    """The content of diagnosis.json.

    Arguments:
        audit: findings about the recordings.
        horizons: errors of open-loop predictions of what was held out, a row for each horizon.
        next_experiment: the manoeuvre that would tell most; None where none is needed.
        source: what was run on what; left out where it is None.
    """
    data, problem, final = diagnosis.split, diagnosis.split.train, diagnosis.final
    screening, bootstrap = diagnosis.nominal_screening, diagnosis.bootstrap
    held_out = {
        "kind": str(data.kind),
        "how": HOLDING_OUT[data.kind],
        "recordings": [run.name for run in data.held_out],
        "horizons": list(horizons),
    }
    null: Record = {
        "draws": len(screening.null.smallest),
        "alpha": ALPHA,
        "threshold": screening.null.threshold,
        "p_value": screening.p_value,
    }
    if bootstrap.draws:
        p_value = bootstrap.of_strongest(screening.p_value)
        null["bootstrap"] = {"draws": bootstrap.draws, "p_value": p_value}
    by_score = sorted(screening.candidates.items(), key=lambda item: -item[1].score.statistic)
    limits = detection_limits(problem, diagnosis.final_screening, diagnosis.names)
    fitted = parameter_estimates(problem.layout.parameters, final)
    out = {
        "format": 1,
        "verdict": diagnosis.verdict,
        "complete": diagnosis.complete,
        "left_out": [],
        "audit": audit,
        "where": _where(diagnosis),
        "effects": _effects(diagnosis),
        "fit": {
            "nominal": _misfits(diagnosis, diagnosis.nominal) | _free(horizons, "nominal"),
            "diagnosed": _misfits(diagnosis, final) | _free(horizons, "diagnosed"),
        },
        "one_sample_in": dict(data.one_sample_in),
        "straight_runs": data.train.dataset.straight_runs,
        "insufficient": [str(one) for one in diagnosis.shortfalls],
        "parameters": [one.as_dict() for one in fitted],
        "sides": [one._asdict() for one in differing_sides(problem, final)],
        "held_out": held_out,
        "screening": [
            {
                "name": name,
                "score": one.score.statistic,
                "p_value": one.score.p_value,
                "inflation": one.score.inflation,
            }
            for name, one in by_score
        ],
        "candidates": _candidates(diagnosis),
        "dropped": [catalogue_name(name) for name in diagnosis.dropped],
        "detection_limits": [_limit(problem, name, limit) for name, limit in limits.items()],
        "residual_force": {
            run.name: {key: [float(f"{x:.4g}") for x in values] for key, values in force.items()}
            for run, force in zip(data.recordings, latent_force(problem, final), strict=False)
        },
        "map": _map(diagnosis, diagnosis.location),
        "map_after": _map(diagnosis, diagnosis.final_screening),
        "null": null,
        "remainder_p_value": diagnosis.unexplained_p_value,
        "next_experiment": next_experiment,
    }
    return out if source is None else out | {"source": source}


def _where(diagnosis: Diagnosis) -> list[Record]:
    """Significant cells of the nominal model, strongest first, with the regime they lie in."""
    level, recordings = diagnosis.location.null.threshold, diagnosis.split.recordings
    found = [cell for cell in diagnosis.location.cells if cell.p_value < level]
    found.sort(key=lambda cell: cell.p_value)
    times = [np.asarray(run.t) for run in recordings]
    records = []
    for cell in found[:MOST_PLACES]:
        name, start, end, regime = "all", cell.bin.start, cell.bin.end, cell.bin.regime
        if cell.bin.run is None:
            start, end = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
        else:
            name = recordings[cell.bin.run].name
            alike = [other.bin.regime for other in found if other.degree == cell.degree]
            regime = regime_within(diagnosis.split.train, cell.bin, [one for one in alike if one])
        records.append(
            {
                "degree_of_freedom": DEGREES_OF_FREEDOM[cell.degree],
                "recording": name,
                "start": start,
                "end": end,
                "regime": regime or "no regime stands out",
                "in_regime": bool(regime),
                "force_rms": abs(cell.force),
                "unit": FORCE_UNITS[cell.degree],
                "p_value": cell.p_value,
            }
        )
    return records


def _map(diagnosis: Diagnosis, screening: Screening) -> Record:
    """Every tested force in its window or regime, in standard errors too."""

    def record(cell: Cell) -> Record:
        place: Record = {"regime": cell.bin.regime}
        if cell.bin.run is not None:
            name = diagnosis.split.recordings[cell.bin.run].name
            place = {"recording": name, "start": cell.bin.start, "end": cell.bin.end}
        return {
            "degree_of_freedom": DEGREES_OF_FREEDOM[cell.degree],
            **place,
            "force": cell.force,
            "std": cell.std,
            "z": cell.z,
            "unit": FORCE_UNITS[cell.degree],
        }

    return {
        "time": [record(cell) for cell in screening.cells if cell.bin.run is not None],
        "regime": [record(cell) for cell in screening.cells if cell.bin.run is None],
        "threshold": float(norm.isf(screening.null.threshold / 2)),
    }


def _effects(diagnosis: Diagnosis) -> list[Record]:
    """Accepted effects, strongest first, then what has no name."""
    strongest = sorted(diagnosis.effects, key=lambda one: -one.hypothesis.deviance_drop)
    records = [record for accepted in strongest for record in _effect(diagnosis, accepted)]
    if diagnosis.verdict != "unexplained":
        return records
    remainder: Record | None = None
    if (force := diagnosis.unexplained) is not None:
        classes = zip(force.classes.texts, force.force, force.std, strict=True)
        remainder = {
            "degree_of_freedom": DEGREES_OF_FREEDOM[force.degree],
            "quantity": force.classes.name,
            "unit": FORCE_UNITS[force.degree],
            "classes": [
                {"regime": text, "force": float(size), "std": float(std)}
                for text, size, std in classes
            ],
            "inclusion": force.inclusion,
            "held_out_gain": force.gain.total,
            "held_out_gain_std": force.gain.std,
        }
    p_value = diagnosis.unexplained_p_value
    nameless = {
        "name": "unexplained",
        "remainder": remainder,
        "parameters": {},
        "evidence": {"score": 0.0, "p_value": p_value, "cost_drop": 0.0},
        "alternatives": [],
    }
    return [*records, nameless]


def _effect(diagnosis: Diagnosis, accepted: AcceptedEffect) -> list[Record]:
    """An accepted effect; a record for each recording in which it was seen, if it has its own."""
    problem, hypothesis = diagnosis.split.train, accepted.hypothesis
    score = hypothesis.candidate.score
    constancy = hypothesis.constancy
    evidence = {
        "score": score.statistic,
        "p_value": score.p_value,
        "cost_drop": _cost_drop(diagnosis, accepted),
        "log10_odds": hypothesis.evidence(hypothesis.inflation) * LOG10_OF_HALF,
        "log10_odds_next": accepted.lead * LOG10_OF_HALF,
        "audited": accepted.name in diagnosis.audited,
        **_gain(hypothesis),
    }
    instances = parameter_records(problem, diagnosis.final, accepted.name)
    records = []
    for number, parameters in enumerate(instances):
        if is_known(parameters):
            # Errors as wide as sizes in parts of the data scatter, and central 90 % intervals.
            for entry in parameters.values():
                entry["std"] *= 1.0 if constancy is None else constancy.scatter
                off = float(norm.ppf(0.95)) * entry["std"]
                entry["interval"] = [entry["value"] - off, entry["value"] + off]
        if key := _changed_before(problem, accepted.name, parameters):
            first = problem.dataset.spans[0][0]
            unknown = {"std": None, "interval": None}
            parameters[key] |= {"value": first, "before_recordings": True} | unknown
        for key, (began, first, last) in _began_in(diagnosis, accepted.name, parameters).items():
            parameters[key] |= began
            low, high = parameters[key]["interval"]
            if low < first or high > last:  # the slope there says nothing
                low, high = onset_interval(problem, diagnosis.final, accepted.name)
                std = (high - low) / (2 * float(norm.ppf(0.95)))
                parameters[key] |= {"std": std, "interval": [low, high]}
        record = {
            "name": catalogue_name(accepted.name),
            "parameters": parameters,
            "evidence": evidence,
            "alternatives": list(accepted.rivals),
            **EFFECTS[accepted.name].place.in_file(problem.base),
        }
        if len(instances) == 1:
            records.append(record)
        elif number < len(diagnosis.split.recordings) and is_known(parameters):
            records.append(record | {"recording": diagnosis.split.recordings[number].name})
    return records


def _changed_before(problem: Problem, name: str, parameters: Mapping[str, Record]) -> str:
    """The key of an onset that lies before all recordings, after a reference; else empty."""
    scanned = EFFECTS[name].scanned
    if problem.before is None or scanned is None or not isinstance(scanned[1], Onset):
        return ""
    time = parameters[scanned[1].key]["value"]
    return scanned[1].key if time is not None and time <= problem.dataset.spans[0][0] else ""


def _began_in(
    diagnosis: Diagnosis, name: str, parameters: Mapping[str, Record]
) -> dict[str, tuple[Record, float, float]]:
    """In which recording an onset lies, and how long (s) after its start, by the onset's key.

    With the recording's first and last time.

    Nothing where none of them or more than one has that time on its clock, or there is but one.
    """
    scanned = EFFECTS[name].scanned
    if scanned is None or not isinstance(scanned[1], Onset):
        return {}
    key = scanned[1].key
    time = parameters[key]["value"]
    if "before_recordings" in parameters[key]:
        return {}
    runs = [*diagnosis.split.recordings, *diagnosis.split.held_out]
    if time is None or len(runs) == 1:
        return {}
    of = [run for run in runs if run.t[0] <= time <= run.t[-1]]
    if len(of) != 1:
        return {}
    first, last = float(of[0].t[0]), float(of[0].t[-1])
    return {key: ({"recording": of[0].name, "since_start": time - first}, first, last)}


def _gain(hypothesis: Hypothesis) -> Record:
    """The gain on held-out data, and the constancy of the size, as far as they were judged."""
    gain, constancy = hypothesis.pooled_gain, hypothesis.constancy
    if gain is None:
        return {}
    out: Record = {"held_out_gain": gain.total, "held_out_gain_std": gain.std}
    if constancy is not None:
        out["constancy"] = constancy._asdict() | {"scatter": constancy.scatter}
    return out


def _cost_drop(diagnosis: Diagnosis, accepted: AcceptedEffect) -> float:
    """Share of the squared innovations that the effect removes, at the final noise."""

    def squares(at: Estimate) -> float:
        filtered = diagnosis.split.train.run_filter(at.coordinates, diagnosis.final.noise)
        return float((np.asarray(filtered.white) ** 2).sum())

    position = diagnosis.names.index(accepted.name)
    before = diagnosis.nominal
    if position:
        before = diagnosis.effects[position - 1].hypothesis.estimate
    old, new = squares(before), squares(accepted.hypothesis.estimate)
    return 1 - new / old if old > 0 else 0.0


def _misfits(diagnosis: Diagnosis, fitted: Estimate) -> dict[str, float]:
    """Normalised innovations of a model, at the noise of the diagnosed one; 1 is noise level."""
    data, noise = diagnosis.split, diagnosis.final.noise
    there = held_out_coordinates(data, fitted)
    return {
        "train": normalised_rms(data.train.run_filter(fitted.coordinates, noise)),
        "test": normalised_rms(data.test.run_filter(there, noise)),
    }


def _free(horizons: Sequence[Record], model: str) -> Record:
    """The errors of a model's free predictions, where there are any."""
    found = free_errors(horizons, model)
    return {"free": found} if found else {}


def _candidates(diagnosis: Diagnosis) -> list[Record]:
    """What became of every candidate against the nominal model, best first."""
    problem, screening = diagnosis.split.train, diagnosis.nominal_screening
    rivals = {name for one in diagnosis.effects for name in one.rivals}
    tried = {one.effect: one for one in diagnosis.short_list.hypotheses}
    inflation = next(iter(tried.values())).inflation if tried else 1.0
    rows = []
    by_evidence = sorted(screening.candidates.items(), key=lambda item: -item[1].expected)
    placed: dict[str, Record] = {
        name: {"name": catalogue_name(name), **EFFECTS[name].place.in_file(problem.base)}
        for name in screening.candidates
    }
    for name, candidate in by_evidence:
        row, variant = dict(placed[name]), name.partition(":")[2]
        alone = list(placed.values()).count(row) == 1
        if variant and (len(row) == 1 or not alone):  # no actuators or channels tell it from others
            row["variant"] = variant
        row["p_value"] = screening.null.family_wise(candidate.score.p_value)
        one = tried.get(name)
        if one is None:
            row |= {"log10_odds": candidate.expected * LOG10_OF_HALF, "status": "screened out"}
            row["reason"] = "a first look promised far less than others: not fitted"
        else:
            row["log10_odds"] = one.evidence(inflation) * LOG10_OF_HALF
            row["parameters"] = parameter_records(problem, one.estimate, name)[0]
            reason = _reason(one, inflation, diagnosis.short_list.needed)
            row |= _gain(one) | {"status": "rejected", "reason": reason}
            row["predicts_motion"] = one.predicts_motion
        if name in diagnosis.names:
            row |= {"status": "accepted", "reason": "evidence and held-out data both speak for it"}
        elif catalogue_name(name) in rivals:
            row |= {"status": "rival", "reason": "the same data support it nearly as well"}
        rows.append(row)
    return sorted(rows, key=lambda row: (STATUSES.index(row["status"]), -row["log10_odds"]))


def _reason(one: Hypothesis, inflation: float, needed: float) -> str:
    """Why a refitted candidate was not accepted."""
    if not one.is_physical:
        return "its size came out of the physical range"
    if one.evidence(inflation) <= needed:
        return "too little evidence"
    if one.gain is None:
        return "explains far less than the best"
    if not one.is_there:
        return "its size may as well be zero"
    if not one.gain.clear:
        return "it does not predict held-out data better"
    if one.constancy is not None and not one.has_one_size:
        return "its size is not the same in all the data"
    if not one.predicts_motion:
        return "it explains single steps, but the motion is predicted worse with it"
    return "another explains more"


def _limit(problem: Problem, name: str, limit: float | None) -> Record:
    """The smallest size of an effect that would have shown, with a note on what that means."""
    effect = EFFECTS[name]
    row = {
        "name": catalogue_name(name),
        **effect.place.in_file(problem.base),
        "parameter": effect.stated_key,
        "unit": effect.place.unit_on(problem.base, effect.units[effect.stated_key]),
        "limit": limit,
    }
    if variant := name.partition(":")[2]:
        row["variant"] = variant
    if limit is None:
        row["note"] = "these runs would not have shown it at any plausible size"
    elif effect.stated_inversely:
        row["note"] = "anything lower would have shown"
    return row


def vessel_document(document: Table, diagnosis: Diagnosis, in_the_end: bool = False) -> Table:
    """The vessel's document with fitted derivatives and the effects found.

    An environment of its own for each recording belongs to the recordings, not the vessel. A vessel
    as it is `in_the_end` has every change from the beginning of a run on; of a change before all
    recordings, since those of reference, she has it in any case.
    """
    problem, final = diagnosis.split.train, diagnosis.final
    tables = []
    for name in diagnosis.names:
        instances = parameter_records(problem, final, name)
        if len(instances) == 1 and is_known(instances[0]):
            table = effect_table(problem.base, name, instances[0])
            onset = EFFECTS[name].scanned
            if key := _changed_before(problem, name, instances[0]):
                table.pop(key, None)
            elif in_the_end and onset is not None and isinstance(onset[1], Onset):
                table.pop(onset[1].key, None)
            tables.append(table)
    return _fitted_document(document, problem, final, tables)


def nominal_document(document: Table, diagnosis: Diagnosis) -> Table:
    """The vessel's document with the nominal model's own fitted derivatives."""
    return _fitted_document(document, diagnosis.split.train, diagnosis.nominal, [])


def _fitted_document(
    document: Table, problem: Problem, fitted: Estimate, effects: list[Table]
) -> Table:
    """The vessel's document with the numbers of an estimate and tables of effects."""
    rows = parameter_estimates(problem.layout.parameters, fitted)
    values = {one.name: one.value for one in rows}
    what = "the recordings of a diagnosis"
    return updated_document(document, values, effects, f"{', '.join(values)} fitted to {what}")
