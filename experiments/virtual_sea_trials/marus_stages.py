"""The stages of the experiment, in order; each says what it found and draws its figure."""

import dataclasses
import json

from experiments.harness.reporting import Experiment
from experiments.virtual_sea_trials import (
    marus_actuation,
    marus_asymmetry,
    marus_diameter,
    marus_export,
    marus_fit,
    marus_plots,
    marus_responses,
    marus_support,
    marus_tables,
    marus_trials,
    marus_vessel,
)
from experiments.virtual_sea_trials import marus_published as published

import numpy as np

from diffsea import Trajectory, read_vessel
from diffsea.identification.estimates import Estimate
from diffsea.identification.objectives.trial_numbers import TrialNumbers
from diffsea.vessel.effects import catalogue_name


STARTS = 2
DRAWS = 768


@dataclasses.dataclass(frozen=True)
class Identified:
    """The derivatives from the figures, port and starboard alike; None where not fitted."""

    hull: dict[str, float]
    objective: TrialNumbers | None = None
    even: Estimate | None = None
    deviances: tuple[float, ...] = ()
    misfit: dict[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Uneven:
    """What explains the difference of port and starboard."""

    candidates: tuple[marus_asymmetry.Candidate, ...] = ()
    effects: tuple[dict, ...] = ()  # tables of a vessel file


@dataclasses.dataclass(frozen=True)
class Campaign:
    """The six trials with actuators that answer at once, and with real ones."""

    at_once: list[marus_trials.Logged]
    real: list[marus_trials.Logged]
    clean: dict[str, Trajectory]  # logs of real actuators on the even vessel, without noise
    repeated: float  # largest difference of any sample when all trials are run once more, SI


def shipped_hull() -> dict[str, float]:
    """The hull's table of `marus_usv`."""
    hull = read_vessel("marus_usv").document["hull"]
    return {name: float(value) for name, value in hull.items()}


def identified(work: Experiment) -> Identified:
    """Fit the figures; a quick run takes the vessel of the catalogue instead."""
    if work.quick:
        return Identified(shipped_hull())
    work.say("deriving the hydrodynamic derivatives from the figures of tables 3 and 4")
    misfit = marus_fit.misfits()
    objective, even, deviances = marus_fit.best_of(misfit, marus_vessel.FREE, STARTS, work.say)
    hull = marus_fit.hull_of(objective, even)
    return Identified(hull, objective, even, tuple(deviances), misfit)


def asymmetry(work: Experiment, found: Identified) -> Uneven:
    """What makes port differ from starboard."""
    if found.objective is None or found.even is None:
        return Uneven()
    work.say("refitting every candidate for the difference of port and starboard")
    candidates = marus_asymmetry.tried(found.objective, found.even, work.say)
    best = candidates[0]
    even = marus_fit.figures(found.objective, found.even.coordinates)
    uneven = marus_fit.figures(found.objective, best.estimate.coordinates)
    work.save(marus_plots.every_figure(even, uneven, best.name), "figures")
    rows = [{"name": one.name, "log10_odds": one.log10_odds} for one in candidates]
    work.save(marus_plots.odds(rows), "asymmetry")
    work.save(
        marus_plots.open_directions(marus_fit.directions(found.objective, found.even)),
        "directions",
    )
    return Uneven(tuple(candidates), ({"name": catalogue_name(best.name), **best.parameters},))


def support(work: Experiment, found: Identified, uneven: Uneven) -> dict:
    """How well the figures are met, what they foretell of each other, and the yaw inertia."""
    if found.objective is None or found.even is None:
        return {}
    best = uneven.candidates[0]
    work.say("refitting without some of the trials, and the yaw inertia under other assumptions")
    fits = {"port and starboard alike": found.even, best.name: best.estimate}
    return {
        "misfit": marus_support.misfits_by_trial(found.objective, fits),
        "foretold": marus_support.foretold(found.misfit, best.name, work.say),
        "inertia": marus_support.inertias(found.misfit, best.name, work.say),
    }


def campaign(work: Experiment) -> Campaign:
    """Run, log and process the six trials of the vessel that ships."""
    work.say("running the six trials, with actuators that answer at once and with real ones")
    actuators = (marus_trials.AT_ONCE, marus_trials.REAL)
    vessels = [marus_trials.vessel_of(shipped_hull(), one) for one in actuators]
    logs = marus_trials.simulated(vessels)
    repeated = marus_trials.largest_difference(logs, marus_trials.simulated(vessels))
    sets = []
    for vessel, runs in zip(vessels, logs, strict=True):
        sets.append(
            [
                marus_trials.processed(log, seed, run, vessel)
                for seed, (run, log) in enumerate(zip(published.RUNS, runs, strict=True))
            ]
        )
    work.say("logs processed")
    if not work.quick:
        _draw_campaign(work, *({one.run.name: one for one in runs} for runs in sets))
    folder = (
        work.folder if work.folder != work.home else work.home.parents[1] / "out" / work.home.name
    )
    marus_export.exported(folder / "logs", sets[1], vessels[1])
    clean = {run.name: log for run, log in zip(published.RUNS, logs[1], strict=True)}
    return Campaign(sets[0], sets[1], clean, repeated)


def _draw_campaign(
    work: Experiment,
    at_once: dict[str, marus_trials.Logged],
    real: dict[str, marus_trials.Logged],
) -> None:
    """The figures of the trials, by the names of their runs."""
    zigzag = "zigzag-10-starboard"
    work.save(marus_plots.traced(at_once[zigzag], real[zigzag]), "traceability")
    work.save(
        marus_responses.kinematics(at_once["circle-starboard"], at_once["zigzag-20-starboard"]),
        "kinematics",
    )
    circles = [at_once["circle-port"], at_once["circle-starboard"]]
    work.save(marus_responses.tracks(circles), "tracks")
    zigzags = [one for one in at_once.values() if one.run.manoeuvre == "zigzag"]
    work.save(marus_responses.zigzags(zigzags), "zigzags")
    work.save(marus_responses.yaw_rates(at_once["circle-port"]), "yaw_rates")


def diameters(work: Experiment, found: Identified) -> dict:
    """Whether the steady diameter can exceed the tactical one."""
    needed = {run.name: marus_diameter.least_drift(run) for run in published.RUNS[:2]}
    result: dict = {"least_drift": {k: float(np.degrees(v)) for k, v in needed.items()}}
    result["zigzags"] = marus_diameter.feasibility()
    if found.objective is None or found.even is None:
        return result
    work.say(f"turning {DRAWS} vessels drawn around the rules of thumb")
    at = found.even.coordinates[: len(marus_vessel.FREE)]
    drawn = marus_diameter.circles(np.vstack([at, marus_diameter.draws(DRAWS - 1)]))
    ratio = drawn["tactical_diameter"] / drawn["steady_turning_diameter"]
    fitted = {"drift": float(drawn["drift"][0]), "ratio": float(ratio[0])}
    result["turn"] = {
        "rate": float(np.degrees(drawn["steady_yaw_rate"][0])),
        "speed": float(drawn["final_speed"][0]),
        "loss": float(drawn["speed_loss"][0]),
    }
    slopes = marus_diameter.slopes_of_ratio(found.objective, found.even.coordinates)
    work.save(marus_plots.diameters(drawn, fitted), "diameters")
    return result | {
        "drawn": len(ratio),
        "share_above": float(np.mean(ratio < 1)),
        "least_ratio": float(np.min(ratio)),
        "share_below_cosine": float(np.mean(ratio < np.cos(drawn["drift"]) - 1e-3)),
        "fitted": {"drift": float(np.degrees(fitted["drift"])), "ratio": fitted["ratio"]},
        "slopes": slopes,
    }


def actuation(work: Experiment, runs: Campaign) -> dict:
    """The bias of orders taken for realised actuation, and the diagnosis of the orders alone."""
    if work.quick:
        return {}
    hull = shipped_hull()
    nominal = marus_actuation.nominal_vessel(marus_actuation.wrong_start(hull))
    log = {
        name: marus_actuation.recording(runs.clean[name], seed)
        for seed, name in enumerate((*marus_actuation.FITTED, *marus_actuation.HELD_OUT))
    }
    train = [log[name] for name in marus_actuation.FITTED]
    test = [log[name] for name in marus_actuation.HELD_OUT]
    ways = {
        "executed thrusts": [marus_actuation.with_executed(run) for run in train],
        "orders taken for executed": [marus_actuation.orders_as_executed(run) for run in train],
    }
    result: dict = {"truth": {n: hull[n] for n in marus_actuation.FREE}, "ways": {}}
    for way, recordings in ways.items():
        work.say(f"identifying with {way}")
        values = marus_actuation.values_of(*marus_actuation.identified(nominal, recordings))
        result["ways"][way] = values
    work.say("diagnosing the orders alone")
    told = marus_actuation.diagnosed(marus_actuation.nominal_vessel(hull), train, test, work.say)
    result["verdict"] = told.verdict
    result["effects"] = marus_actuation.effects_of(told)
    result["actuators"] = marus_actuation.actuators_of(hull)
    result["errors"] = {
        way: marus_actuation.errors(result["truth"], values)
        for way, values in result["ways"].items()
    }
    work.save(marus_plots.biases(result["errors"]), "biases")
    return result


def written(
    work: Experiment,
    found: Identified,
    uneven: Uneven,
    supported: dict,
    runs: Campaign,
    turning: dict,
    beyond: dict,
) -> None:
    """results.json, the README's tables and, of a full run, the vessel's numbers."""
    results, tables = marus_tables.assembled(found, uneven, supported, runs, turning, beyond)
    work.write(results, tables)
    if found.objective is not None:
        print(json.dumps({name: round(value, 4) for name, value in found.hull.items()}))
