"""Beyond the paper: disturbances of each trial as nuisances, by least squares and by likelihood.

Developed on other seeds than those scored here.
"""

from experiments.metamodels.ferry import CHOSEN, recordings_of, set_of
from experiments.metamodels.inservice import Piece
from experiments.metamodels.known import TRUE, sail
from experiments.metamodels.known import set_of as known_set_of
from experiments.metamodels.metamodel import cross_validated, ideal_overshoots, identified
from experiments.metamodels.ship import SPEED
from experiments.metamodels.zigzags import ideal

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from diffsea.identification.data.dataset import DatasetShape
from diffsea.metamodels.fit import COMMON_MOMENT, OWN_MOMENTS, identify_by_likelihood
from diffsea.metamodels.norrbin import Norrbin


LENGTH = 160.93  # m
TRIALS = 6  # of each set
LEAST = DatasetShape(
    runs=CHOSEN, rows=1024
)  # of a dataset of service: all sets share compiled programs
NAMES = ("a0", "a1", "a2", "a3", "b")
PUBLISHED, TRIALWISE, NUISANCE, LIKELY = (
    "least squares, white errors", "least squares, errors by trial",
    "own moments, errors by trial", "likelihood, own wind and gusts",
)  # fmt: skip


def study(seed: int, quick: bool, service: dict, say) -> dict:
    """Both comparisons and their tables."""
    sets, likely = (12, 0) if quick else (48, 8)
    known = _known(seed, sets, likely, say)
    say("beyond: trials of service in any wind")
    served = _service(seed, service, 6 if quick else 24, likely // 2)
    return {
        "known": known,
        "service": served,
        "tables": {"KNOWN": _known_table(known), "SERVICE": _service_table(served)},
        "series": {"figure": _boxes(known, served)},
    }


def _known(seed: int, sets: int, likely: int, say) -> dict:
    """Errors and coverage where the truth is a Norrbin model, over independent sets of trials."""
    truth = np.asarray(TRUE.coefficients)
    runs = sail(seed + 50, TRIALS * sets)
    aside = known_set_of(sail(seed + 51, 40))
    out: dict = {}
    for k in range(sets):
        own = runs[TRIALS * k : TRIALS * (k + 1)]
        table = known_set_of(own)
        common, apart = identified(table, COMMON_MOMENT), identified(table, OWN_MOMENTS)
        few = student.ppf(0.975, TRIALS - 1)
        _add(out, PUBLISHED, common.model, common.white, norm.ppf(0.975), truth, aside)
        _add(out, TRIALWISE, common.model, common.clustered, few, truth, aside)
        _add(out, NUISANCE, apart.model, apart.clustered, few, truth, aside)
        if k < likely:
            found = identify_by_likelihood(own, apart.model, LENGTH, SPEED)
            _add(out, LIKELY, found.model, found.covariance, norm.ppf(0.975), truth, aside)
            if k == 0:
                say("beyond: the first fit by likelihood is compiled")
    return {method: {k: np.array(v) for k, v in record.items()} for method, record in out.items()}


def _add(out: dict, method: str, model, covariance, factor, truth, aside) -> None:
    """Score one fit: errors over the truth, whether intervals hold it, the fit put aside."""
    record = out.setdefault(method, {"off": [], "held": [], "half": [], "aside": [], "ideal": []})
    off = np.asarray(model.coefficients) - truth
    half = factor * np.sqrt(np.diag(np.asarray(covariance)))
    record["off"].append(off / np.abs(truth))
    record["held"].append(np.abs(off) <= half)
    record["half"].append(half / np.abs(truth))
    record["aside"].append(float(np.median(cross_validated(model, aside)[0])))
    record["ideal"].append(np.degrees(ideal_overshoots(model) - ideal_overshoots(TRUE)))


def _known_table(known: dict) -> list[dict]:
    return [
        {
            "method": method,
            "sets": len(record["off"]),
            **{f"rms error of {n}, %": 100 * float(np.sqrt(np.mean(record["off"][:, k] ** 2)))
               for k, n in enumerate(NAMES)},
            "95 % intervals hold, %": 100 * float(record["held"].mean()),
            "rms error of overshoots, deg": _rms(record["ideal"]),
            "fit aside, median %": float(np.median(record["aside"])),
        }
        for method, record in known.items()
    ]  # fmt: skip


def _service(seed: int, service: dict, sets: int, likely: int) -> dict:
    """Sets of 12 trials of group 1 in whatever wind, the calmest put aside to score on.

    The likelihood, which takes long, on the first `likely` sets.
    """
    draw = np.random.default_rng(seed + 60)
    calm = sorted(service["series"]["members"], key=lambda p: p.side_wind)
    aside, others = set_of(calm[:CHOSEN]), calm[CHOSEN:]
    truth = np.degrees(np.asarray(ideal().overshoots))
    out: dict = {}

    def add(method: str, model) -> None:
        fit = float(np.median(cross_validated(model, aside)[0]))
        row = fit, np.degrees(ideal_overshoots(model)) - truth, model.a1 > 0
        out.setdefault(method, []).append(row)

    for k in range(sets):
        chosen = [others[i] for i in draw.choice(len(others), CHOSEN, replace=False)]
        table = set_of(chosen)
        common = identified(table, COMMON_MOMENT).model
        add("least squares", common)
        add("own moments", identified(table, OWN_MOMENTS).model)
        if k < likely:
            add("likelihood", _by_likelihood(chosen, common))
    return {
        method: {
            "aside": np.array([f for f, _, _ in rows]),
            "ideal": np.array([o for _, o, _ in rows]),
            "stable": float(np.mean([s for _, _, s in rows])),
        }
        for method, rows in out.items()
    }


def _by_likelihood(pieces: list[Piece], start: Norrbin) -> Norrbin:
    """The metamodel by the innovation likelihood at the trials' mean speed, from a first guess."""
    speed = float(np.mean([p.channels["u"].mean() for p in pieces]))
    return identify_by_likelihood(recordings_of(pieces), start, LENGTH, speed, least=LEAST).model


def _service_table(served: dict) -> list[dict]:
    return [
        {
            "method": method,
            "sets": len(record["aside"]),
            "fit to calm trials aside: median, %": float(np.median(_counted(record["aside"]))),
            "its tenth percentile, %": float(np.quantile(_counted(record["aside"]), 0.1)),
            "a1 positive, %": 100 * record["stable"],
            "ideal 10/10 completed, %": 100 * float(np.isfinite(record["ideal"]).mean()),
            "rms error of its overshoots, deg": _rms(record["ideal"]),
        }
        for method, record in served.items()
    ]


def _counted(fits) -> np.ndarray:
    """Fits (per cent), zero for sets whose metamodel runs away on a trial put aside."""
    return np.nan_to_num(np.asarray(fits, float), nan=0.0)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _boxes(known: dict, served: dict) -> dict:
    """What the figure shows: distributions over sets."""
    short = {PUBLISHED: "least\nsquares", NUISANCE: "own\nmoments", LIKELY: "likelihood"}
    return {
        "truth is a Norrbin: error of a1, %": {
            short[m]: 100 * known[m]["off"][:, 1] for m in short if m in known
        },
        "the same: fit to trials aside, %": {
            short[m]: known[m]["aside"] for m in short if m in known
        },
        "service in any wind: fit to calm trials, %": {
            m.replace(" ", "\n"): _counted(r["aside"]) for m, r in served.items()
        },
    }
