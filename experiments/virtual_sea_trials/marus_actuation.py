"""What it costs to take commands for realised actuation, and whether the log itself tells.

One log of trials with a lag, a dead band and a limit between order and thrust is identified
twice: with the executed thrusts, and with the orders taken for them. Then the diagnosis sees
the orders alone, with a hull that is right, and is asked what is left out.
"""

import dataclasses
import math
from collections.abc import Callable

from experiments.virtual_sea_trials import marus_published as published
from experiments.virtual_sea_trials import marus_trials, marus_vessel

import numpy as np

from diffsea import Diagnosis, Trajectory, Vessel, cut, resample
from diffsea.diagnosis.verdict import diagnose
from diffsea.identification.estimates import Estimate
from diffsea.identification.fit import estimate
from diffsea.identification.problem import Problem, make_problem
from diffsea.vessel.files import build


# Logs of the fit and the one held out, by the names of the paper's trials.
FITTED = ("zigzag-20-starboard", "zigzag-10-port", "circle-port")
HELD_OUT = ("zigzag-20-port",)
BEFORE, LONGEST = 8.0, 45.0  # s of approach kept, s kept after the onset
INTERVAL = 0.1  # s
STATED_LIMIT = 1.25  # of the approach thrust: what the maker claims
OFF = 0.3  # spread of the logarithm by which the start is off
FREE = ("X_u", "X_uu", "X_vv", "Y_v", "Y_vv", "N_r", "N_rr")
LOOSE = ("X_u", "N_r")  # free in the diagnosis, which needs something to trade with


def wrong_start(hull: dict[str, float], seed: int = 4) -> dict[str, float]:
    """The true hull with every free derivative off by a random factor."""
    rng = np.random.default_rng(seed)
    return hull | {name: hull[name] * float(np.exp(OFF * rng.normal())) for name in FREE}


def nominal_vessel(hull: dict[str, float]) -> Vessel:
    """A hull whose thrusters answer at once, up to the limit that the maker states."""
    thrust = marus_vessel.drag_at(hull, published.TARGET_SPEED)
    limits = {"max_force": STATED_LIMIT * thrust, "min_force": -STATED_LIMIT * thrust}
    table = marus_vessel.document(hull)
    return build(table | {"thruster": [part | limits for part in table["thruster"]]})


def recording(log: Trajectory, seed: int) -> Trajectory:
    """The end of the approach and the manoeuvre, with sensor noise, on a coarser clock."""
    start = marus_trials.onset(log)
    piece = cut(log, start - BEFORE, min(start + LONGEST, float(np.asarray(log.t)[-1])))
    return resample(marus_trials.with_noise(piece, seed), INTERVAL)


def with_executed(run: Trajectory) -> Trajectory:
    """The log as it is: executed thrusts beside the orders."""
    return run


def orders_as_executed(run: Trajectory) -> Trajectory:
    """The same log with the orders written in the place of the executed thrusts."""
    return dataclasses.replace(run, executed=dict(run.commanded))


def orders_only(run: Trajectory) -> Trajectory:
    """The same log without executed thrusts."""
    return dataclasses.replace(run, executed={})


def identified(vessel: Vessel, runs: list[Trajectory]) -> tuple[Problem, Estimate]:
    """The derivatives by the innovation likelihood."""
    problem = make_problem(vessel, runs, FREE)
    return problem, estimate(problem, FREE)


def values_of(problem: Problem, fitted: Estimate) -> dict[str, dict[str, float]]:
    """Estimates and standard errors of the derivatives by name."""
    out = {}
    for number, parameter in enumerate(problem.layout.parameters):
        at = float(fitted.coordinates[number])
        std = float(fitted.stds[list(fitted.index).index(number)]) * parameter.slope(at)
        out[parameter.name] = {"value": float(parameter.decode(at)), "std": std}
    return out


def errors(truth: dict[str, float], found: dict[str, dict[str, float]]) -> dict[str, float]:
    """Relative error of each derivative."""
    return {name: found[name]["value"] / truth[name] - 1 for name in found}


def diagnosed(
    vessel: Vessel, runs: list[Trajectory], test: list[Trajectory], say: Callable[[str], None]
) -> Diagnosis:
    """The whole diagnosis on orders alone, the hull but for `LOOSE` taken as known."""
    train = [orders_only(run) for run in runs]
    return diagnose(vessel, train, [orders_only(run) for run in test], free=LOOSE, progress=say)


def actuators_of(hull: dict[str, float]) -> dict[str, float]:
    """What truly stands between order and thrust: s and N."""
    thrust = marus_vessel.drag_at(hull, published.TARGET_SPEED)
    real = marus_trials.REAL
    return {
        "time_constant": real.lag, "deadband": real.deadband * thrust, "limit": real.limit * thrust,
    }  # fmt: skip


def effects_of(found: Diagnosis) -> list[dict]:
    """What was named: parameters in SI units, log10 odds, rivals."""
    rows = []
    problem = found.split.train
    for one in found.effects:
        effect = next(e for e in problem.layout.effects if e.name == one.name)
        physical = problem.layout.physical(one.name, found.final.coordinates)[0]
        said = effect.decode(problem.base, physical)
        inflation = one.hypothesis.inflation
        rows.append(
            {
                "name": one.name,
                "parameters": {key: float(value) for key, value in said.items()},
                "log10_odds": float(one.hypothesis.evidence(inflation) / (2 * math.log(10))),
                "alternatives": list(one.rivals),
            }
        )  # fmt: skip
    return rows
