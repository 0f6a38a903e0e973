# pyright: reportArgumentType=false
"""Case 1: a metamodel from a year of service, cross-validated, and two models judged by it."""

from experiments.metamodels.inservice import CUT_OFF, INTERVAL, Found, Piece, search
from experiments.metamodels.metamodel import (
    cross_validated,
    ideal_overshoots,
    identified,
    same_length,
    simulated,
    told,
    trials,
)
from experiments.metamodels.models import from_dimensions, from_tests
from experiments.metamodels.ship import answers, ship
from experiments.metamodels.voyages import year

import jax.numpy as jnp
import numpy as np

from diffsea import Environment, Trajectory
from diffsea.metrics.repeats import fit_percent


CHOSEN = 12  # trials with the least side wind, as published
DROPPED = 4  # of those in any wind, where the worst fits are left out
LONGEST = 480  # samples
MOST = 150  # trials put aside
MODERATE = np.radians(60.0)  # heading stays within


def zigzag_like(piece: Piece) -> bool:
    """Whether the ship turned both ways and no further than moderately."""
    r, psi = piece.channels["r"], piece.channels["psi"]
    both = min(r.max(), -r.min()) > np.radians(0.1)
    return bool(both and np.ptp(psi) < MODERATE)


def zigzag_groups(found: Found) -> list[list[Piece]]:
    """Groups most of whose members turn both ways, the largest first."""
    groups = []
    for label in range(found.labels.max() + 1):
        members = [p for p, l in zip(found.pieces, found.labels, strict=True) if l == label]
        if np.mean([zigzag_like(p) for p in members]) > 0.5 and len(members) > CHOSEN + 4:
            groups.append([p for p in members if zigzag_like(p)])
    return groups


def set_of(pieces: list[Piece]):
    """Pieces as trials for the identification."""
    series = [(p.channels["rudder"], p.channels["r"]) for p in pieces]
    return trials([d for d, _ in series], [r for _, r in series], INTERVAL, LONGEST)


def recordings_of(pieces: list[Piece]) -> list[Trajectory]:
    """Pieces as recordings as sparse as their filter allows, rudders as means between rows."""
    every = round(0.5 / CUT_OFF / INTERVAL)
    return [_recording(piece, every) for piece in pieces]


def _recording(piece: Piece, every: int) -> Trajectory:
    rows = len(piece.t) // every
    t, *series = piece.t, *(piece.channels[name] for name in ("psi", "u", "r", "rudder"))
    held = series[-1][: rows * every].reshape(rows, every).mean(1)
    t, psi, u, r = (a[: rows * every : every] for a in (t, *series[:-1]))
    nothing = np.full(t.shape, np.nan)
    return Trajectory(
        t, nothing, nothing, psi, u, nothing, r, {"rudder": held}, {}, {},
        np.ones(t.shape, bool), name=f"{piece.log} at {piece.t[0]:.0f} s",
    )  # fmt: skip


def study(seed: int, days: int) -> dict:
    """The whole of case 1; figures as plain numbers, series for the pictures under `series`."""
    logs = year(seed, days)
    found = search(logs)
    groups = zigzag_groups(found)
    rows = [_group(members) for members in groups[:3]]
    first = rows[0]
    validation = _validated(first["fit"], first["aside"], seed)
    return {
        "logs": len(logs),
        "excluded": len(found.excluded),
        "trials": len(found.pieces),
        "groups": int(found.labels.max() + 1),
        "group_sizes": [len(g) for g in groups],
        "metamodels": [row["told"] for row in rows],
        "validation": validation["figures"],
        "series": {
            "found": found,
            "members": groups[0],
            "chosen": first["chosen"],
            "aside": first["aside"],
            "predicted": first["predicted"],
            "validation": validation["series"],
        },
        "model": first["fit"].model,
    }


def _group(members: list[Piece]) -> dict:
    calm = sorted(members, key=lambda p: p.side_wind)
    chosen, aside, rest = calm[:CHOSEN], calm[CHOSEN], calm[CHOSEN + 1 :]
    fit = identified(set_of(chosen))
    percent, predicted = (np.asarray(a)[0] for a in cross_validated(fit.model, set_of([aside])))
    rest = rest[:MOST]
    others = np.asarray(cross_validated(fit.model, set_of(rest))[0])
    some = identified(set_of(members[:CHOSEN]))
    record = told(fit) | {
        "cross_validation_percent": percent,
        "others_percent": {
            "median": float(np.median(others)),
            "tenth": float(np.quantile(others, 0.1)),
            "ninetieth": float(np.quantile(others, 0.9)),
            "count": len(others),
        },
        "largest_side_wind": chosen[-1].side_wind,
        "largest_rudder_deg": float(
            np.degrees(np.median([np.abs(p.channels["rudder"]).max() for p in chosen]))
        ),
        "ideal_overshoots_deg": np.degrees(ideal_overshoots(fit.model)).tolist(),
        "scatter_percent": _scatter(members),
        "without_wind_exclusion": _of(some, aside),
        "worst_fits_dropped": _of(_without_worst(some, members[:CHOSEN]), aside),
    }
    return {"fit": fit, "chosen": chosen, "aside": aside, "predicted": predicted, "told": record}


def _of(fit, aside: Piece) -> dict:
    """What a metamodel says of itself, of the ideal trial and of the one put aside."""
    return told(fit) | {
        "ideal_overshoots_deg": np.degrees(ideal_overshoots(fit.model)).tolist(),
        "cross_validation_percent": float(cross_validated(fit.model, set_of([aside]))[0][0]),
    }


def _without_worst(fit, pieces: list[Piece]):
    """Identified again without the trials that the metamodel of all of them fits worst."""
    percent = np.asarray(cross_validated(fit.model, set_of(pieces))[0])
    kept = np.argsort(-percent)[: len(pieces) - DROPPED]
    return identified(set_of([pieces[k] for k in kept]))


def _scatter(members: list[Piece]) -> dict:
    """How far trials of a group are apart at the same time since their start, in per cent.

    Root mean square of what differs from the mean of all trials over that of the mean itself.
    """
    found = {}
    for name in ("u", "v", "r", "rudder"):
        table, known = same_length([piece.channels[name] for piece in members], LONGEST)
        mean = (table * known).sum(0) / np.maximum(known.sum(0), 1)
        apart = np.sqrt(np.mean((table - mean)[known] ** 2))
        found[name] = float(100 * apart / np.sqrt(np.mean(mean[known.any(0)] ** 2)))
    return found


def _validated(fit, aside: Piece, seed: int) -> dict:
    """Models and the ship herself, in a calm, under the rudder of the trial put aside."""
    delta = aside.channels["rudder"]
    speed, calm = float(aside.channels["u"][0]), Environment()
    meta = np.asarray(simulated(fit.model, 0.0, jnp.asarray(delta), INTERVAL))
    # The regression knows no screw and so no neutral angle: as published, the bias goes.
    level = delta - float(fit.model.neutral)
    cases = {
        "ship": (ship(), delta),
        "model 1": (ship(hull=from_tests(seed)), delta),
        "model 2": (ship(hull=from_dimensions()), level),
    }
    series = {
        name: np.asarray(answers(vessel, jnp.asarray(angles), speed, calm, INTERVAL))
        for name, (vessel, angles) in cases.items()
    }
    figures = {
        name: {
            "against_metamodel_percent": float(fit_percent(meta, values)),
            "against_ship_percent": float(fit_percent(series["ship"], values)),
        }
        for name, values in (series | {"metamodel": meta}).items()
    }
    return {"figures": figures, "series": series | {"metamodel": meta, "t": aside.t}}
