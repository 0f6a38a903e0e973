"""Hydrodynamic derivatives straight from the figures of tables 3 and 4.

Each figure is weighed by the rounding of its last digit and by what a model of three degrees
of freedom may be off: half a per cent of lengths and yaw rates, and of overshoots the scatter
of the published ones under the same order. Fits start from the rules of thumb and from draws
of the prior, never from an answer.
"""

import dataclasses
import math
from collections.abc import Callable, Collection

from experiments.virtual_sea_trials import marus_published as published
from experiments.virtual_sea_trials import marus_vessel

import numpy as np

from diffsea import TrialPlan, Vessel
from diffsea.identification.estimates import Estimate, normal_interval
from diffsea.identification.objectives.trial_numbers import MeasuredTrial, TrialNumbers
from diffsea.identification.uncertainty.identifiability import Identifiability, identifiability
from diffsea.simulation import planning


STEP = 0.05  # s
APPROACH = 40.0  # s, at most
SECONDS = {"turning-circle": 110.0, "zigzag": 40.0}
CLASSES = ("L", "deg", "deg/s")  # printed units of lengths, overshoots and yaw rates
MODEL_ERROR = 0.005  # of lengths and yaw rates
BLURS = (5.0, 2.5, 1.5, 1.0, 1.0)  # factors on the misfits in the fits from a start
KEPT_OUT = 1e4  # times the standard deviations of figures that a fit is not to see
SEED = 0


def plan_of(run: published.Run, vessel: Vessel) -> TrialPlan:
    """The trial as the paper ran it, from its mean approach speed."""
    plan = planning.plan_trial(
        vessel, run.manoeuvre, math.radians(run.angle), math.radians(run.heading) or None,
        float(run.side), run.speed, seconds=SECONDS[run.manoeuvre], step=STEP, executes=3,
    )  # fmt: skip
    return dataclasses.replace(plan, approach_seconds=APPROACH)


def sheet_of(
    run: published.Run, vessel: Vessel, misfit: dict[str, float], factor: float = 1.0
) -> MeasuredTrial:
    """A trial's figures in SI with their standard deviations, times a factor."""
    names = tuple(run.numbers)
    factors = np.array([published.in_si(name) for name in names])
    stds = [math.hypot(misfit[published.unit(n)], published.rounding(n)) for n in names]
    values = np.array([run.numbers[name] for name in names])
    stds = factor * np.array(stds) * factors
    return MeasuredTrial(plan_of(run, vessel), names, values * factors, stds)


def objective_of(
    misfit: dict[str, float],
    kept_out: Collection[str] = (),
    arm: float = marus_vessel.ARM,
    effects: tuple = marus_vessel.CANDIDATES,
) -> TrialNumbers:
    """The metric objective on the published trials; those kept out weigh next to nothing."""
    vessel = marus_vessel.start(arm)
    sheets = [
        sheet_of(run, vessel, misfit, KEPT_OUT if run.name in kept_out else 1.0)
        for run in published.RUNS
    ]
    return TrialNumbers(vessel, marus_vessel.parameters(), sheets, effects)


def misfits() -> dict[str, float]:
    """Standard deviation of the figures about a model, by printed unit, rounding apart."""
    own: dict[str, list[float]] = {kind: [] for kind in CLASSES}
    spread = []
    for heading in sorted({run.heading for run in published.RUNS if run.heading}):
        same = [run for run in published.RUNS if run.heading == heading]
        read = [v for run in same for n, v in run.numbers.items() if n.startswith("overshoot")]
        spread.append(np.var(read, ddof=1))
    for run in published.RUNS:
        for name, value in run.numbers.items():
            own[published.unit(name)].append(value)
    scales = {kind: MODEL_ERROR * float(np.mean(own[kind])) for kind in ("L", "deg/s")}
    return scales | {"deg": math.sqrt(float(np.mean(spread)))}


def best_of(
    misfit: dict[str, float], free: tuple[str, ...], starts: int, say: Callable[[str], None]
) -> tuple[TrialNumbers, Estimate, list[float]]:
    """The objective, the best fit from the prior mean and draws, every start's deviance.

    Overshoots are far from linear in the derivatives: every start is fitted to blurred figures
    first, and then to ever sharper ones.
    """
    objectives = [objective_of({k: blur * one for k, one in misfit.items()}) for blur in BLURS]
    objective = objectives[-1]
    rng = np.random.default_rng(SEED)
    count, parameters = len(objective.owners), len(objective.parameters)
    found = []
    for number in range(starts):
        at = np.zeros(count)
        if number:
            at[:parameters] = 0.5 * rng.normal(size=parameters)
        path = []
        for sharper in objectives:
            fitted = sharper.fit(free, at)
            at = fitted.coordinates
            path.append(f"{fitted.deviance:.1f}")
        found.append(fitted)
        say(f"start {number + 1} of {starts}: deviance {', '.join(path)}")
    deviances = [one.deviance for one in found]
    return objective, found[int(np.argmin(deviances))], deviances


def derivative_rows(objective: TrialNumbers, fitted: Estimate) -> list[dict]:
    """One row per derivative: start, estimate, 90 % interval, share due to the figures."""
    rows = []
    for number, parameter in enumerate(objective.parameters):
        place = list(fitted.index).index(number)
        at, std = float(fitted.coordinates[number]), float(fitted.stds[place])
        low, high = normal_interval(parameter, at, std)
        rows.append(
            {
                "name": parameter.name, "unit": parameter.unit, "start": parameter.value,
                "value": float(parameter.decode(at)), "low": low, "high": high,
                "determined": float(fitted.shrinkage[place]),
            }
        )  # fmt: skip
    return rows


def directions(objective: TrialNumbers, fitted: Estimate) -> list[dict]:
    """Eigenvectors of the figures' information on the derivatives, the least known first.

    In units of the prior's standard deviation; `determined` is the share of a direction's
    variance that the figures remove.
    """
    chosen = [n for n, k in enumerate(fitted.index) if k < len(objective.parameters)]
    spreads = objective.spreads[fitted.index[chosen]]
    others = [n for n in range(len(fitted.index)) if n not in chosen]
    information = fitted.information[np.ix_(chosen, chosen)]
    if others:
        mixed = fitted.information[np.ix_(chosen, others)]
        own = np.linalg.pinv(fitted.information[np.ix_(others, others)])
        information = information - mixed @ own @ mixed.T
    values, vectors = np.linalg.eigh(spreads[:, None] * information * spreads)
    names = [objective.parameters[fitted.index[n]].name for n in chosen]
    return [
        {
            "determined": float(max(value, 0.0) / (1 + max(value, 0.0))),
            "vector": dict(zip(names, map(float, vector), strict=True)),
        }
        for value, vector in zip(values, vectors.T, strict=True)
    ]


def in_words(objective: TrialNumbers, fitted: Estimate) -> Identifiability:
    """What the figures leave to the prior, as `diffsea fit` would say it."""
    return identifiability(objective.parameters, fitted)


def figures(objective: TrialNumbers, coordinates: np.ndarray) -> list[dict]:
    """Every figure of tables 3 and 4 in the unit in which it is printed."""
    found = objective.numbers(coordinates)
    rows = []
    for run, numbers in zip(published.RUNS, found, strict=True):
        for name, value in run.numbers.items():
            rows.append(
                {
                    "run": run.name, "title": run.title, "number": name,
                    "unit": published.unit(name), "published": value,
                    "obtained": numbers[name] / published.in_si(name),
                }
            )  # fmt: skip
    return rows


def hull_of(objective: TrialNumbers, fitted: Estimate) -> dict[str, float]:
    """The hull's table with the fitted derivatives."""
    values = {
        p.name: float(p.decode(fitted.coordinates[k])) for k, p in enumerate(objective.parameters)
    }
    return marus_vessel.HULL | values
