"""What these data could have shown: the smallest detectable size of every candidate.

A diagnosis as the records that files and reports are made of.
"""

import math
from typing import Any

import numpy as np
from scipy.stats import norm

from diffsea.diagnosis.constancy import Constancy
from diffsea.diagnosis.decision import Accepted, needed
from diffsea.diagnosis.localisation import DEGREES, Cell, regime_within
from diffsea.diagnosis.refit import Fitted
from diffsea.diagnosis.screening import Screening, Seen
from diffsea.diagnosis.search import ALPHA, Diagnosis
from diffsea.diagnosis.unexplained import latent_force
from diffsea.identification.effect_records import (
    effect_table,
    is_known,
    parameter_records,
)
from diffsea.identification.estimates import Estimate, parameter_estimates
from diffsea.identification.fit import normalised_rms
from diffsea.identification.holdout import HeldOut, held_out_coordinates
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.files import Table, updated_document


ERRORS = 3.0  # standard errors that make a size detectable
PLAUSIBLE = 30.0  # prior sizes beyond which nothing is expected
_NOTHING = 1e-12  # information that is none


def detection_limits(problem: Problem, screening: Screening, found: tuple[str, ...]) -> list[dict]:
    """For every candidate that was not found, the smallest size that would have been.

    Three standard errors of the effect's own parameter by the data alone, its other coefficients
    unknown, in the run that says most; None where no plausible size would have shown.
    """
    effects = {effect.name: effect for effect in problem.layout.effects}
    return [
        _limit(problem, effects[name], seen)
        for name, seen in screening.seen.items()
        if name not in found
    ]


def _limit(problem: Problem, effect: Effect, seen: Seen) -> dict:
    size = len(seen.look.directions)
    columns = seen.columns[: problem.dataset.measured.size]  # not the prior's rows
    copies = columns.shape[1] // size
    parameter = effect.stated_key
    row: dict = {"name": catalogue_name(effect.name), **effect.place.in_file(problem.base)}
    row |= {"parameter": parameter, "unit": effect.units[parameter], "limit": None}
    V = columns.T @ columns / seen.score.inflation
    found = [
        shown
        for k in range(0, copies * size, size)
        if (shown := _shown(problem, effect, seen, V[k : k + size, k : k + size]))
    ]
    if not found:
        return row | {"note": "these runs would not have shown it at any plausible size"}
    row["limit"] = max(found) if effect.stated_inversely else min(found)
    if effect.stated_inversely:
        row["note"] = "anything lower would have shown"
    return row


def _shown(problem: Problem, effect: Effect, seen: Seen, V: np.ndarray) -> float | None:
    """The parameter at three standard errors by the information `V`; None if implausible.

    Along each coordinate alone and along the worst direction, whichever says more of the
    parameter: a flow's speed has no coordinate of its own.
    """
    values, vectors = np.linalg.eigh(V)
    spread = ERRORS / np.sqrt(np.maximum(values, _NOTHING))
    steps = [*np.diag(np.sqrt((vectors**2) @ spread**2)), spread[0] * vectors[:, 0]]
    parameter = effect.stated_key
    sizes = np.array(effect.sizes(problem.base))
    named = []
    for step in steps:
        at = np.array(seen.look.at, float)
        at[list(seen.look.directions)] = step * (np.sign(step[np.abs(step).argmax()]) or 1.0)
        named.append((abs(float(effect.decode(problem.base, at * sizes)[parameter])), step))
    value, step = (min if effect.stated_inversely else max)(named, key=lambda pair: pair[0])
    return None if np.linalg.norm(step) > PLAUSIBLE else value


LOG10_OF_HALF = 0.5 / math.log(10)  # from twice a natural logarithm to a decimal one


HOLDING_OUT = {
    HeldOut.RECORDINGS: "whole recordings",
    HeldOut.LAST_PARTS: "the last part of each recording",
    HeldOut.AFTER_HEAD: "recordings, after a first part that shows their own environment",
}


def summary(
    diagnosis: Diagnosis,
    audit: list[dict],
    horizons: list[dict] | None = None,
    next_experiment: dict | None = None,
    source: dict | None = None,
) -> dict[str, Any]:
    """The content of diagnosis.json.

    Arguments:
        audit: findings about the recordings.
        horizons: errors of open-loop predictions of what was held out, a row for each horizon.
        next_experiment: the manoeuvre that would tell most; None where none is needed.
        source: what was run on what; left out where it is None.
    """
    held_out = _held_out(diagnosis) | ({} if horizons is None else {"horizons": horizons})
    out = {
        "format": 1,
        "verdict": diagnosis.verdict,
        "audit": audit,
        "where": _where(diagnosis),
        "effects": _effects(diagnosis),
        "fit": _fit(diagnosis),
        "parameters": [
            one.as_dict()
            for one in parameter_estimates(diagnosis.split.train.layout.parameters, diagnosis.final)
        ],
        "held_out": held_out,
        "screening": _screening(diagnosis),
        "candidates": candidate_table(diagnosis),
        "dropped": [catalogue_name(name) for name in diagnosis.dropped],
        "detection_limits": detection_limits(
            diagnosis.split.train, diagnosis.after, diagnosis.names
        ),
        "residual_force": {
            run.name: {key: [float(f"{x:.4g}") for x in values] for key, values in force.items()}
            for run, force in zip(
                diagnosis.split.recordings,
                latent_force(diagnosis.split.train, diagnosis.final),
                strict=False,
            )
        },
        "map": _map(diagnosis, diagnosis.where),
        "map_after": _map(diagnosis, diagnosis.after),
        "null": _null(diagnosis),
        "remainder_p_value": diagnosis.left,
        "next_experiment": next_experiment,
    }
    return out if source is None else out | {"source": source}


def _null(diagnosis: Diagnosis) -> dict:
    """How chance was told from cause; with `bootstrap` where data were simulated and refitted."""
    before, drawn = diagnosis.before, diagnosis.bootstrap
    told = {
        "draws": len(before.null.smallest), "alpha": ALPHA, "threshold": before.null.level,
        "p_value": before.p_value,
    }  # fmt: skip
    if not drawn.draws:
        return told
    p = drawn.of_strongest(before.p_value)
    return told | {"bootstrap": {"draws": drawn.draws, "p_value": p}}


def _held_out(diagnosis: Diagnosis) -> dict:
    kind = diagnosis.split.kind
    recordings = [run.name for run in diagnosis.split.held_out]
    return {"kind": str(kind), "how": HOLDING_OUT[kind], "recordings": recordings}


def _where(diagnosis: Diagnosis) -> list[dict]:
    """Significant cells of the nominal model, strongest first, with the regime they lie in."""
    level = diagnosis.where.null.level
    found = sorted(
        (cell for cell in diagnosis.where.cells if cell.p_value < level),
        key=lambda cell: cell.p_value,
    )
    shared = [cell for cell in found if cell.bin.run is None]
    out = []
    for cell in found[:40]:
        same = [other.bin.regime for other in shared if other.bin.degree == cell.bin.degree]
        regime = cell.bin.regime or regime_within(diagnosis.split.train, cell.bin, same)
        out.append(_cell_record(diagnosis, cell, regime))
    return out


def _cell_record(diagnosis: Diagnosis, cell: Cell, regime: str | None) -> dict:
    runs = diagnosis.split.recordings
    first, last = _span(diagnosis, cell)
    return {
        "degree_of_freedom": DEGREES[cell.bin.degree],
        "recording": "all" if cell.bin.run is None else runs[cell.bin.run].name,
        "start": first,
        "end": last,
        "regime": regime or "no regime stands out",
        "in_regime": bool(regime),
        "force_rms": abs(cell.force),
        "unit": _unit(cell),
        "p_value": cell.p_value,
    }


def _span(diagnosis: Diagnosis, cell: Cell) -> tuple[float, float]:
    """From when to when a cell is, s; a regime from the first start to the last end."""
    if cell.bin.run is not None:
        return cell.bin.start, cell.bin.end
    times = [np.asarray(run.t) for run in diagnosis.split.recordings]
    return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)


def _unit(cell: Cell) -> str:
    return "N m" if cell.bin.degree == 2 else "N"


def _map(diagnosis: Diagnosis, screening: Screening) -> dict:
    """Every tested force in its window or regime, in standard errors too."""
    runs = diagnosis.split.recordings
    out: dict = {"time": [], "regime": [], "threshold": float(norm.isf(screening.null.level / 2))}
    for cell in screening.cells:
        record: dict = {"degree_of_freedom": DEGREES[cell.bin.degree]}
        if cell.bin.run is None:
            record["regime"] = cell.bin.regime
        else:
            record |= {"recording": runs[cell.bin.run].name}
            record |= {"start": cell.bin.start, "end": cell.bin.end}
        record |= {"force": cell.force, "std": cell.std, "z": cell.z, "unit": _unit(cell)}
        out["regime" if cell.bin.run is None else "time"].append(record)
    return out


def _effects(diagnosis: Diagnosis) -> list[dict]:
    ranked = sorted(diagnosis.effects, key=lambda one: -one.fitted.drop)
    out = [record for accepted in ranked for record in _effect(diagnosis, accepted)]
    if diagnosis.verdict == "unexplained":
        out.append(_unexplained(diagnosis))
    return out


def _unexplained(diagnosis: Diagnosis) -> dict:
    left = diagnosis.unnamed
    return {
        "name": "unexplained",
        "remainder": None if left is None else left.as_dict(),
        "parameters": {},
        "evidence": {"score": 0.0, "p_value": diagnosis.left, "cost_drop": 0.0},
        "alternatives": [],
    }


def _effect(diagnosis: Diagnosis, accepted: Accepted) -> list[dict]:
    problem, final = diagnosis.split.train, diagnosis.final
    copies = parameter_records(problem, final, accepted.name)
    fitted, inflation = accepted.fitted, accepted.fitted.inflation
    evidence = {
        "score": fitted.seen.score.statistic,
        "p_value": fitted.seen.score.p_value,
        "cost_drop": _cost_drop(diagnosis, accepted),
        "log10_odds": fitted.evidence(inflation) * LOG10_OF_HALF,
        "log10_odds_next": accepted.ahead * LOG10_OF_HALF,
        **_gain(fitted),
    }
    records = []  # none for a recording in which it was not seen
    for number, parameters in enumerate(copies):
        record = {
            "name": catalogue_name(accepted.name),
            "parameters": _with_intervals(parameters, fitted.constancy),
            "evidence": evidence,
            "alternatives": list(accepted.rivals),
        }
        record |= EFFECTS[accepted.name].place.in_file(problem.base)
        if len(copies) > 1:
            if number >= len(diagnosis.split.recordings):
                break
            record["recording"] = diagnosis.split.recordings[number].name
        if is_known(parameters) or len(copies) == 1:
            records.append(record)
    return records


def _with_intervals(parameters: dict[str, dict], constancy: Constancy | None) -> dict[str, dict]:
    """Each number with its central 90 % interval, errors as wide as parts of the data scatter."""
    widen, out = 1.0 if constancy is None else constancy.scatter, {}
    if not is_known(parameters):
        return parameters
    for name, entry in parameters.items():
        std = widen * entry["std"]
        off = float(norm.ppf(0.95)) * std
        out[name] = entry | {"std": std, "interval": [entry["value"] - off, entry["value"] + off]}
    return out


def _gain(fitted: Fitted) -> dict:
    gain = fitted.borne_out
    if gain is None:
        return {}
    out: dict = {"held_out_gain": gain.total, "held_out_gain_std": gain.std}
    if fitted.constancy is not None:
        out["constancy"] = fitted.constancy._asdict() | {"scatter": fitted.constancy.scatter}
    return out


def candidate_table(diagnosis: Diagnosis) -> list[dict]:
    """What became of every candidate against the nominal model, best first."""
    problem, accepted = diagnosis.split.train, {one.name: one for one in diagnosis.effects}
    rivals = {name for one in diagnosis.effects for name in one.rivals}
    rows = []
    tried = {one.effect: one for one in diagnosis.refitted}
    inflation = diagnosis.refitted[0].inflation if tried else 1.0
    for name, seen in sorted(diagnosis.before.seen.items(), key=lambda i: -i[1].expected):
        row: dict = {"name": catalogue_name(name), **_which(problem, name)}
        row["p_value"] = diagnosis.before.null.family_wise(seen.score.p_value)
        one = tried.get(name)
        if one is None:
            row |= {"log10_odds": seen.expected * LOG10_OF_HALF, "status": "screened out"}
            row["reason"] = "a first look found it too weak to be worth a fit"
        else:
            row["log10_odds"] = one.evidence(inflation) * LOG10_OF_HALF
            row["parameters"] = parameter_records(problem, one.estimate, name)[0]
            row |= _gain(one) | {"status": "rejected", "reason": _reason(problem, one, inflation)}
        if name in accepted:
            row |= {"status": "accepted", "reason": "evidence and held-out data both speak for it"}
        elif catalogue_name(name) in rivals:
            row |= {"status": "rival", "reason": "the same data support it nearly as well"}
        rows.append(row)
    order = {"accepted": 0, "rival": 1, "rejected": 2, "screened out": 3}
    return sorted(rows, key=lambda row: (order[row["status"]], -row["log10_odds"]))


def _which(problem: Problem, name: str) -> dict:
    """What tells a candidate from others of its name: where it acts, or which terms it has."""
    variant = name.partition(":")[2]
    return EFFECTS[name].place.in_file(problem.base) or ({"variant": variant} if variant else {})


def _reason(problem: Problem, one: Fitted, inflation: float) -> str:
    if not one.possible:
        return "its size came out of the physical range"
    if one.evidence(inflation) <= needed(problem):
        return "too little evidence"
    if one.gain is None:
        return "explains far less than the best"
    if not one.gain.clear:
        return "it does not predict held-out data better"
    if one.constancy is not None and not one.constancy.holds:
        return "its size is not the same in all the data"
    return "another explains more"


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
    run = problem.run_filter(at.coordinates, noise.noise)
    return float((np.asarray(run.white) ** 2).sum())


def _fit(diagnosis: Diagnosis) -> dict:
    """Normalised innovations of both models, at the noise of the diagnosed one."""
    data, final = diagnosis.split, diagnosis.final

    def rms(problem: Problem, coordinates: np.ndarray) -> float:
        return normalised_rms(problem.run_filter(coordinates, final.noise))

    def both(fitted: Estimate) -> dict:
        return {
            "train": rms(data.train, fitted.coordinates),
            "test": rms(data.test, held_out_coordinates(data, fitted)),
        }

    return {"nominal": both(diagnosis.nominal), "diagnosed": both(final)}


def _screening(diagnosis: Diagnosis) -> list[dict]:
    seen = diagnosis.before.seen
    ranked = sorted(seen, key=lambda name: -seen[name].score.statistic)
    return [
        {
            "name": name,
            "score": seen[name].score.statistic,
            "p_value": seen[name].score.p_value,
            "inflation": seen[name].score.inflation,
        }
        for name in ranked
    ]


def vessel_document(document: Table, diagnosis: Diagnosis) -> Table:
    """The vessel's document with fitted derivatives and the effects found.

    An environment of its own for each recording belongs to the recordings, not the vessel.
    """
    problem, final = diagnosis.split.train, diagnosis.final
    values = {one.name: one.value for one in parameter_estimates(problem.layout.parameters, final)}
    tables = []
    for accepted in diagnosis.effects:
        copies = parameter_records(problem, final, accepted.name)
        if len(copies) == 1 and is_known(copies[0]):
            tables.append(effect_table(diagnosis.split.train.base, accepted.name, copies[0]))
    return updated_document(document, values, tables)


def nominal_document(document: Table, diagnosis: Diagnosis) -> Table:
    """The vessel's document with the nominal model's own fitted derivatives."""
    rows = parameter_estimates(diagnosis.split.train.layout.parameters, diagnosis.nominal)
    return updated_document(document, {one.name: one.value for one in rows}, [])
