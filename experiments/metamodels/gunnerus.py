"""Case 2: repeated 10/10 zig-zags on two days, intervals of their overshoots, two speeds."""

from experiments.metamodels.metamodel import (
    cross_validated,
    ideal_overshoots,
    ideal_series,
    identified,
    overshoots_at,
    simulated,
    told,
    trials,
)  # fmt: skip
from experiments.metamodels.models import from_dimensions, from_tests
from experiments.metamodels.ship import SPEED, answers, ship
from experiments.metamodels.zigzags import GOOD, POOR, RECORDED, Records, ideal, run_trials

import jax.numpy as jnp
import numpy as np

from diffsea import Environment
from diffsea.metamodels.norrbin import Norrbin
from diffsea.metrics.repeats import fit_percent, mean_and_half_width


RATIO = 0.75  # 7.5 over 10 knots
DAYS = {"group 1": ((7.0, 11.0), POOR), "group 2": ((4.0, 6.0), GOOD)}  # wind (m/s), control
TESTS = 6  # of each day


def deviations_at_executes(records: Records) -> np.ndarray:
    """Headings (rad) beyond 10 deg at the second and third execute, towards the turn's side."""
    return np.asarray(records.deviations) - np.asarray(records.overshoots)


def set_of(records: Records, which):
    """Some trials of a batch for the identification."""
    return trials(
        [np.asarray(records.delta[k]) for k in which],
        [np.asarray(records.r[k]) for k in which], RECORDED,
    )  # fmt: skip


def intervals(overshoots) -> dict:
    """Mean and half-width (rad) of first and second overshoot over repeats of one side."""
    return {
        name: mean_and_half_width(np.asarray(overshoots)[:, k])
        for k, name in enumerate(("first", "second"))
    }


def study(seed: int, campaigns: int) -> dict:
    """The whole of case 2; `campaigns` repeats of both days say how often intervals hold."""
    truth = np.asarray(ideal().overshoots)
    days, fits, batches = {}, {}, {}
    for number, (name, (wind, control)) in enumerate(DAYS.items()):
        batch = run_trials(seed + number, TESTS * campaigns, wind, control)
        batches[name] = batch
        fits[name] = [
            identified(set_of(batch, range(TESTS * c, TESTS * (c + 1)))) for c in range(campaigns)
        ]
        days[name] = _day(batch, fits[name], truth)
    bench = batches["group 2"]
    aside = set_of(bench, [0])
    tried = {n: cross_validated(f[0].model, aside) for n, f in fits.items()}
    compared = {name: float(percent[0]) for name, (percent, _) in tried.items()}
    slow = identified(set_of(run_trials(seed + 9, TESTS, (4.0, 6.0), GOOD, RATIO), range(TESTS)))
    return {
        "days": days,
        "truth_deg": np.degrees(truth).tolist(),
        "benchmark_percent": compared,
        "speeds": _speeds(fits["group 2"][0].model, slow.model),
        "validation": (judged := _validated(fits["group 2"][0].model, slow.model, seed))["figures"],
        "slow": told(slow),
        "to_12": {name: _to_12(batches[name], f) for name, f in fits.items()},
        "series": {
            "validation": judged["series"],
            "records": batches,
            "benchmark": {name: np.asarray(rates)[0] for name, (_, rates) in tried.items()},
        },
    }


def _to_12(batch: Records, fits: list) -> dict:
    """The ideal zig-zag to port, reversed at 12 deg, beside the means of each campaign's trials."""
    asked = [np.asarray(overshoots_at(fit.model, np.radians(12.0))) for fit in fits]
    within = []
    for c, values in enumerate(asked):
        own = intervals(np.asarray(batch.overshoots)[TESTS * c + 1 : TESTS * (c + 1) : 2])
        within.append(
            [
                bool(abs(a - mean) <= half)
                for a, (mean, half) in zip(values, own.values(), strict=True)
            ]
        )
    return {
        "overshoots_deg": np.degrees(asked[0]).tolist(),
        "within": within[0],
        "share_within": float(np.mean(within)),
    }


def _day(batch: Records, fits: list, truth: np.ndarray) -> dict:
    """One day: the first campaign as published, and how often intervals hold over all."""
    overshoots = np.asarray(batch.overshoots)
    held_truth, held_meta = [], []
    for c, fit in enumerate(fits):
        meta = np.asarray(ideal_overshoots(fit.model))
        for side in (0, 1):
            own = overshoots[TESTS * c + side : TESTS * (c + 1) : 2]
            for k, (mean, half) in enumerate(intervals(own).values()):
                held_truth.append(abs(truth[side, k] - mean) <= half)
                held_meta.append(abs(meta[side, k] - mean) <= half)
    first = {
        f"{side} first": {
            name: {"mean_deg": np.degrees(mean), "u95_deg": np.degrees(half)}
            for name, (mean, half) in intervals(overshoots[k:TESTS:2]).items()
        }
        for k, side in enumerate(("starboard", "port"))
    }
    return told(fits[0]) | {
        "intervals": first,
        "ideal_overshoots_deg": np.degrees(ideal_overshoots(fits[0].model)).tolist(),
        "metamodel_within": float(np.mean(held_meta)),
        "truth_within": float(np.mean(held_truth)),
        "campaigns": len(fits),
    }


def _speeds(fast: Norrbin, slow: Norrbin) -> dict:
    """Reduction of yaw rate (per cent) at the lower speed, under the rudder of the ideal trial."""
    run = ideal_series(fast)
    delta, dt = run.delta, float(run.t[1] - run.t[0])
    rates = {
        "metamodels": (simulated(fast, 0.0, delta, dt), simulated(slow, 0.0, delta, dt)),
        "ship": _ship_rates(delta, dt),
        "scaling": (run.r, simulated(fast.at_speed(RATIO), 0.0, delta, dt)),
    }
    return {name: _reduction(*pair) for name, pair in rates.items()}


def _ship_rates(delta, dt: float):
    calm = Environment()
    return tuple(answers(ship(k), delta, SPEED * k, calm, dt) for k in (1.0, RATIO))


def _reduction(fast, slow) -> float:
    return float(100 * (1 - jnp.max(jnp.abs(slow)) / jnp.max(jnp.abs(fast))))


def _validated(fast: Norrbin, slow: Norrbin, seed: int) -> dict:
    """Both simulation models at both speeds against the metamodels; rudder bias removed."""
    run = ideal_series(fast)
    delta, dt, calm = run.delta, float(run.t[1] - run.t[0]), Environment()
    level = delta - fast.neutral
    cases = {
        "ship": (None, delta),
        "model 1": (from_tests(seed), delta),
        "model 2": (from_dimensions(), level),
    }
    metas = {1.0: simulated(fast, 0.0, delta, dt), RATIO: simulated(slow, 0.0, delta, dt)}
    figures, series = {}, {}
    for name, (hull, angles) in cases.items():
        rates = {
            ratio: answers(ship(ratio, hull), angles, SPEED * ratio, calm, dt) for ratio in metas
        }
        figures[name] = {
            "full_speed_percent": float(fit_percent(metas[1.0], rates[1.0])),
            "low_speed_percent": float(fit_percent(metas[RATIO], rates[RATIO])),
            "reduction_percent": _reduction(rates[1.0], rates[RATIO]),
        }
        series[name] = {ratio: np.asarray(r) for ratio, r in rates.items()}
    series["metamodel"] = {ratio: np.asarray(r) for ratio, r in metas.items()}
    series["t"] = np.asarray(run.t)
    return {"figures": figures, "series": series}
