"""A diagnosis as the records that files and reports are made of."""

import math
from typing import Any

import numpy as np

from diffsea.diagnosis.locate import DEGREES, Cell
from diffsea.diagnosis.select import ALPHA, Accepted, Diagnosis
from diffsea.identification.estimates import Estimate, physical_table
from diffsea.identification.found_effects import catalogue_name, effect_table, reported
from diffsea.identification.holdout import transferred
from diffsea.identification.problem import Problem
from diffsea.vessel.catalogue import Table, updated_document


def summary(diagnosis: Diagnosis, audit: list[dict]) -> dict[str, Any]:
    """The content of diagnosis.json, all but the next experiment."""
    return {
        "format": 1,
        "verdict": diagnosis.verdict,
        "audit": audit,
        "where": _where(diagnosis),
        "effects": _effects(diagnosis),
        "fit": _fit(diagnosis),
        "parameters": physical_table(diagnosis.split.train.layout.parameters, diagnosis.final),
        "held_out": _held_out(diagnosis),
        "screening": _screening(diagnosis),
        "remainder_p_value": diagnosis.remainder,
    }


def _held_out(diagnosis: Diagnosis) -> dict:
    how = "the last part of each recording" if diagnosis.split.by_time else "whole recordings"
    if diagnosis.split.head is not None:
        how = "recordings, after a first part that shows their own environment"
    return {"how": how, "recordings": [run.name for run in diagnosis.split.held_out]}


def _where(diagnosis: Diagnosis) -> list[dict]:
    """Significant windows of the nominal model, strongest first, with the regime they share."""
    cells = [cell for cell in diagnosis.before if cell.p_value * len(diagnosis.before) < ALPHA]
    cells = sorted(cells, key=lambda cell: cell.p_value)
    regimes = [cell for cell in cells if cell.run is None]
    out = []
    for cell in cells[:40]:
        regime = cell.regime
        if not regime:
            same = [other.regime for other in regimes if other.degree == cell.degree]
            regime = same[0] if same else "no regime stands out"
        out.append(_cell_record(diagnosis, cell, regime))
    return out


def _cell_record(diagnosis: Diagnosis, cell: Cell, regime: str) -> dict:
    runs = diagnosis.split.recordings
    whole = cell.run is None
    times = [np.asarray(run.t) for run in runs]
    first = min(float(t[0]) for t in times) if whole else cell.start
    last = max(float(t[-1]) for t in times) if whole else cell.end
    return {
        "degree_of_freedom": DEGREES[cell.degree],
        "recording": "all" if cell.run is None else runs[cell.run].name,
        "start": first,
        "end": last,
        "regime": regime,
        "force_rms": abs(cell.force),
        "unit": "N m" if cell.degree == 2 else "N",
        "p_value": cell.p_value,
    }


def _effects(diagnosis: Diagnosis) -> list[dict]:
    ranked = sorted(diagnosis.effects, key=lambda one: -one.fitted.drop)
    out = [record for accepted in ranked for record in _effect(diagnosis, accepted)]
    if diagnosis.verdict == "unexplained":
        out.append(_unexplained(diagnosis))
    return out


def _unexplained(diagnosis: Diagnosis) -> dict:
    return {
        "name": "unexplained",
        "parameters": {},
        "evidence": {"score": 0.0, "p_value": diagnosis.remainder, "cost_drop": 0.0},
        "alternatives": [],
    }


def _effect(diagnosis: Diagnosis, accepted: Accepted) -> list[dict]:
    problem, final = diagnosis.split.train, diagnosis.final
    copies = reported(problem, final, accepted.name)
    own = len(copies) > 1
    evidence = {
        "score": accepted.fitted.score.statistic,
        "p_value": accepted.fitted.score.p_value,
        "cost_drop": _cost_drop(diagnosis, accepted),
        "held_out_gain": accepted.fitted.gain.total,
        "held_out_gain_std": accepted.fitted.gain.std,
    }
    records = []
    for number, parameters in enumerate(copies):
        table = effect_table(accepted.name, parameters)
        record = {
            "name": catalogue_name(accepted.name),
            "parameters": parameters,
            "evidence": evidence,
            "alternatives": list(accepted.rivals),
        }
        if "channels" in table:
            record["channels"] = table["channels"]
        if own:
            record["recording"] = diagnosis.split.recordings[number].name
        records.append(record)
    return records


def _cost_drop(diagnosis: Diagnosis, accepted: Accepted) -> float:
    """Share of the squared innovations that the effect removes, at the final noise."""
    problem = diagnosis.split.train
    names = [one.name for one in diagnosis.effects]
    before = diagnosis.nominal
    position = names.index(accepted.name)
    if position:
        before = diagnosis.effects[position - 1].fitted.estimate
    old = _squares(problem, before, diagnosis.final)
    new = _squares(problem, accepted.fitted.estimate, diagnosis.final)
    return 1 - new / old if old > 0 else 0.0


def _squares(problem: Problem, at: Estimate, noise: Estimate) -> float:
    tuned = problem.tuned(at.coordinates, noise.noise)
    return float((np.asarray(tuned.white) ** 2).sum())


def _fit(diagnosis: Diagnosis) -> dict:
    """Normalised innovations of both models, at the noise of the diagnosed one."""
    data, final = diagnosis.split, diagnosis.final

    def rms(problem: Problem, coordinates: np.ndarray) -> float:
        tuned = problem.tuned(coordinates, final.noise)
        count = float(np.asarray(tuned.gains.used).sum())
        return math.sqrt(float((np.asarray(tuned.white) ** 2).sum()) / max(count, 1.0))

    def both(fitted: Estimate) -> dict:
        return {
            "train": rms(data.train, fitted.coordinates),
            "test": rms(data.test, transferred(data, fitted)),
        }

    return {"nominal": both(diagnosis.nominal), "diagnosed": both(final)}


def _screening(diagnosis: Diagnosis) -> list[dict]:
    ranked = sorted(diagnosis.screened.items(), key=lambda item: -item[1].statistic)
    refitted = {one.effect: one for one in diagnosis.refitted}
    best = diagnosis.refitted[0].estimate.inflation if diagnosis.refitted else 1.0
    rows = []
    for name, score in ranked:
        row: dict = {
            "name": name,
            "score": score.statistic,
            "p_value": score.p_value,
            "inflation": score.inflation,
        }
        if name in refitted:
            one = refitted[name]
            row |= {
                "bic": one.bic(best),
                "held_out_gain": one.gain.total,
                "held_out_gain_std": one.gain.std,
                "possible": one.possible,
            }
        rows.append(row)
    return rows


def vessel_document(document: Table, diagnosis: Diagnosis) -> Table:
    """The vessel's document with fitted derivatives and the effects found.

    An environment of its own for each recording belongs to the recordings, not the vessel.
    """
    problem, final = diagnosis.split.train, diagnosis.final
    values = {row["name"]: row["value"] for row in physical_table(problem.layout.parameters, final)}
    tables = []
    for accepted in diagnosis.effects:
        copies = reported(problem, final, accepted.name)
        if len(copies) == 1:
            tables.append(effect_table(accepted.name, copies[0]))
    return updated_document(document, values, tables)


def nominal_document(document: Table, diagnosis: Diagnosis) -> Table:
    """The vessel's document with the nominal model's own fitted derivatives."""
    rows = physical_table(diagnosis.split.train.layout.parameters, diagnosis.nominal)
    return updated_document(document, {row["name"]: row["value"] for row in rows}, [])
