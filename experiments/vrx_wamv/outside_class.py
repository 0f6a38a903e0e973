"""A boat outside the model class: roll, added mass, engines that lag, and thrust that flow takes.

The reference plant has the terms of the joint model, so that a fit of it comes out right by
construction. `rolling_plant.py` has other terms; here the same runs, procedures, fits, laws and
diagnosis meet it, in one draw of the sensors' noise. `outside_draws.py` says what holds over draws.
"""

import dataclasses
from collections.abc import Callable

from experiments.harness.reporting import table
from experiments.vrx_wamv.campaign import Campaign, campaign, explored, held_out
from experiments.vrx_wamv.closed import (
    SLOWEST,
    controller,
    differences,
    on_model,
    on_plant,
    track,
)
from experiments.vrx_wamv.joint import fit_linear, fit_whole
from experiments.vrx_wamv.models import document, errors_on, vessel_of
from experiments.vrx_wamv.outside_draws import JOINT, PROCEDURE, Draws, over_noise
from experiments.vrx_wamv.paths import KEPT_BACK, PATHS, WIDE
from experiments.vrx_wamv.procedure import identify
from experiments.vrx_wamv.rolling_plant import ROLLING, RollingPlant
from experiments.vrx_wamv.tuning import by_hand, tune

from diffsea import Vessel, diagnose
from diffsea.simulation.control.waypoints import DynamicPD
from diffsea.vessel.files import VesselFile, build


SEED = 1
LINEAR, NAMED = "joint, linear", "joint, and what is named"
Say = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Outside:
    """What was found: by model, then by path or channel."""

    predictions: dict[str, dict[str, float]]
    paths: dict[str, dict[str, dict]]
    tuned: dict[str, dict[str, dict]]  # on the plant, by gains and path
    diagnosis: dict
    outcome: str  # of the joint fit
    draws: Draws


def outside(say: Say) -> Outside:
    """Every model of the plant, its predictions and its closed loops."""
    data, kept = campaign(SEED, ROLLING), held_out(SEED + 100, ROLLING)
    joint, linear = fit_whole(data.runs, ("guessed", "afar")), fit_linear(data.runs)
    say("what the diagnosis names in the joint model")
    vessel, record = named(document(joint.values), data, say)
    models = {
        PROCEDURE: vessel_of(identify(data, "thrust as ordered").corrected.values()),
        LINEAR: linear.vessel, JOINT: joint.vessel, NAMED: vessel,
    }  # fmt: skip
    by_hands = by_hand(joint.vessel, list(PATHS.values()))
    laws = both_regimes(by_hands)
    paths = followed(ROLLING, models, laws)
    say("gains by derivative")
    hands = {"by hand": by_hands}
    hands["tuned"] = tune(joint.vessel, list(PATHS.values()), by_hands).gains
    tuned = {
        name: {path: track(on_plant(ROLLING, controller(points, numbers)), points)
               for path, points in (PATHS | KEPT_BACK).items()}
        for name, numbers in hands.items()
    }  # fmt: skip
    predictions = {name: errors_on(vessel, kept) for name, vessel in models.items()}
    drawn = over_noise(laws, say)
    return Outside(predictions, paths, tuned, record, joint.outcome.value, drawn)


def named(file: dict, data: Campaign, say: Say) -> tuple[Vessel, dict]:
    """The joint model with what the diagnosis names, from runs of its own, and its words."""
    *own, kept = explored(SEED + 200, ROLLING)
    found = diagnose(
        VesselFile(build(file), file, "joint"),
        [run.trajectory() for run in (*own, data.wide, data.straight[2])],
        [kept.trajectory()],
        progress=lambda message: say(message) if message.startswith("round") else None,
    )
    effects = [
        {"name": effect["name"], "alternatives": effect["alternatives"],
         "parameters": {key: [one["value"], one["std"]]
                        for key, one in effect["parameters"].items()}}
        for effect in found.record["effects"]
    ]  # fmt: skip
    return found.diagnosed.vessel, {"verdict": found.record["verdict"], "effects": effects}


def both_regimes(gains: dict[str, float]) -> dict[str, DynamicPD]:
    """The paper's law on its paths: slow at waypoints, and near full speed throughout."""
    return {
        f"{regime} {path}": controller(points, numbers)
        for regime, ways, numbers in (
            ("slow", PATHS, gains), ("fast", WIDE, gains | {"base_min": SLOWEST}),
        )
        for path, points in ways.items()
    }  # fmt: skip


def followed(
    plant: RollingPlant, models: dict[str, Vessel], laws: dict[str, DynamicPD]
) -> dict[str, dict[str, dict]]:
    """Differences of each model from the plant under each law."""
    driven = {name: on_plant(plant, law) for name, law in laws.items()}
    rows = {}
    for model, vessel in models.items():
        runs = {name: on_model(vessel, law) for name, law in laws.items()}
        rows[model] = {
            name: differences(run, driven[name])
            | {"finished": run.finished, "plant_finished": driven[name].finished}
            for name, run in runs.items()
        }
    return rows


def predictions_table(found: Outside) -> str:
    """Open-loop errors and closed-loop differences of every model in the one draw."""
    models = {name: (found.predictions[name], found.paths[name]) for name in found.predictions}
    names = list(next(iter(found.paths.values())))
    head = ("model", "position, m", "surge, m/s", "sway, m/s", "yaw rate, rad/s",
            *(f"time error, {name}, %" for name in names))  # fmt: skip
    return table(head, [
        (name, *(errors[key] for key in ("position", "u", "v", "r")),
         *(100 * paths[p]["time"] if paths[p]["finished"] and paths[p]["plant_finished"] else None
           for p in names))
        for name, (errors, paths) in models.items()
    ])  # fmt: skip


def tuned_table(found: Outside) -> str:
    """Gains by hand and by derivative on the joint model, judged on the plant."""
    head = ("path", "gains", "off the path, rms m", "largest, m", "time, s")
    rows = [
        (path, name, one["rms"], one["largest"], one["seconds"])
        for name, ways in found.tuned.items() for path, one in ways.items()
    ]  # fmt: skip
    return table(head, sorted(rows, key=lambda row: row[0]))


def diagnosis_table(record: dict) -> str:
    """What the diagnosis names in the joint model, with its numbers."""
    rows = [
        (effect["name"],
         ", ".join(f"{key} {value:.3g} +- {std:.1g}" for key, (value, std)
                   in effect["parameters"].items() if std is not None and std < abs(value)),
         ", ".join(effect["alternatives"]) or "none")
        for effect in record["effects"] if effect["parameters"]
    ]  # fmt: skip
    text = table(("effect", "found", "cannot be told from"), rows)
    return f"{text}\n\nVerdict: {record['verdict']}."
