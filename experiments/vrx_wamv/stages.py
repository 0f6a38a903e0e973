"""The stages of the experiment: each returns what it found, as plain numbers."""

import dataclasses
from collections.abc import Callable, Mapping

from experiments.vrx_wamv.campaign import Campaign, campaign, held_out
from experiments.vrx_wamv.closed import (
    LAWS,
    SLOWEST,
    Driven,
    FixedPD,
    controller,
    differences,
    on_model,
    on_plant,
    replayed,
    track,
)
from experiments.vrx_wamv.joint import Joint, fit_linear, fit_whole
from experiments.vrx_wamv.models import errors_on, truth, vessel_of
from experiments.vrx_wamv.paths import KEPT_BACK, PATHS, WIDE
from experiments.vrx_wamv.plant import NEW, OLD, driven, speed_for
from experiments.vrx_wamv.procedure import (
    PUBLISHED,
    PUBLISHED_FIRST,
    READINGS,
    Procedure,
    antenna_for,
    from_speeds,
    identify,
    plateaus,
    steady_speed,
)
from experiments.vrx_wamv.tuning import NAMES, SMOOTHING, Tuned, by_hand, problem, slope_check, tune

import numpy as np

from diffsea import Vessel


SEED = 1
Say = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Identified:
    """Every model of the boat: values under the names of a vessel file, and seconds spent."""

    data: Campaign
    procedures: dict[str, Procedure]
    joint: dict[str, Joint]
    values: dict[str, dict[str, float]]
    seconds: dict[str, float]

    def vessel(self, name: str) -> Vessel:
        """A model by its name."""
        return vessel_of(self.values[name])


def checks() -> dict:
    """Steady speeds of the integrated plants beside the closed form."""
    out = {}
    for name, plant in (("new", NEW), ("old", OLD)):
        for thrust in (100.0, 500.0, 2000.0):
            n = speed_for(thrust / 2)
            run = driven(plant, lambda t, n=n: (n, n), 60.0, 0.1)
            form = plant.steady_speed(thrust)
            out[f"{name} {thrust:g} N"] = {"closed form": form, "integrated": run["u"][-1]}
    return out


def identification(quick: bool, say: Say) -> Identified:
    """The procedure both ways, and the joint fits, on one campaign."""
    data = campaign(SEED)
    procedures = {reading: identify(data, reading) for reading in READINGS}
    say("procedure done; joint fits")
    runs = [*data.straight[1::4], data.spin, data.wide] if quick else data.runs
    joint = {"joint": fit_whole(runs)}
    values = {"published": PUBLISHED.values(), "published, uncorrected": PUBLISHED_FIRST.values()}
    seconds = {}
    for reading, found in procedures.items():
        values[reading] = found.corrected.values()
        seconds[reading] = found.seconds
    if not quick:
        say("joint fit done; the linear one")
        joint["joint, linear"] = fit_linear(runs)
    for name in reversed(joint):
        values[name] = joint[name].values
        seconds[name] = joint[name].seconds
    return Identified(data, procedures, joint, values, seconds)


def scale(found: Identified) -> list[dict]:
    """Eq. 9 from three starts: what speeds alone fix and what they leave open."""
    n, u = plateaus(found.data.straight)
    rows = []
    for start in ((-0.4, 0.3, 150.0), (-0.4, 0.3, 300.0), (0.1, 0.1, 50.0)):
        c, d, X_u = from_speeds(n, u, start)
        rows.append({"start": start, "c": c, "d": d, "X_u": X_u, "c/d": c / d, "X_u/d": X_u / d})
    return rows


def arithmetic(found: Identified) -> dict:
    """The paper's own numbers put into its own equations."""
    n = speed_for(250.0)
    return {
        "speed_by_first_fit": steady_speed(PUBLISHED_FIRST, n),
        "speed_after_correction": steady_speed(PUBLISHED, n),
        "speed_with_drag_of_145": 45.0 / 150.0,  # where 100 + 150 u = 145, m/s
        "antenna_for_Y_v": antenna_for(PUBLISHED, found.data.wide, PUBLISHED.Y_v),
    }


def repeats(found: Identified) -> dict:
    """The joint fit again: on other noise, which costs no compiling, and on the older drag."""
    again = fit_whole(campaign(SEED + 1).runs)
    old = fit_whole(campaign(SEED, OLD).runs, starts=("afar",))
    return {
        "other noise": {"values": again.values, "seconds": again.seconds},
        "older drag": {
            "values": old.values, "stds": old.stds, "truth": truth(OLD), "seconds": old.seconds
        },
    }  # fmt: skip


def predictions(found: Identified) -> dict[str, dict[str, float]]:
    """Open-loop errors of every model on runs that nothing was fitted to."""
    runs = held_out(SEED + 100)
    return {name: errors_on(found.vessel(name), runs) for name in found.values}


@dataclasses.dataclass(frozen=True)
class Followed:
    """Closed-loop runs on the paper's paths: slow at waypoints, and near full speed throughout."""

    gains: dict[str, float]
    plant: dict[str, Driven]  # by regime and path, "slow circle"
    models: dict[str, dict[str, Driven]]  # by model, then likewise
    table: dict[str, dict[str, dict]]  # likewise: differences, and without a controller


def following(found: Identified, models: tuple[str, ...]) -> Followed:
    """The same law on the plant and on models of it, gains by hand on the joint model."""
    gains = by_hand(found.vessel("joint"), list(PATHS.values()))
    regimes = {"slow": (PATHS, gains), "fast": (WIDE, gains | {"base_min": SLOWEST})}
    laws = {
        f"{regime} {path}": controller(points, numbers)
        for regime, (ways, numbers) in regimes.items()
        for path, points in ways.items()
    }
    plant = {name: on_plant(NEW, law) for name, law in laws.items()}
    runs, table = {}, {}
    for model in models:
        vessel = found.vessel(model)
        runs[model] = {name: on_model(vessel, law) for name, law in laws.items()}
        table[model] = {name: _compared(run, plant[name]) for name, run in runs[model].items()}
    return Followed(gains, plant, runs, table)


def _compared(run: Driven, plant: Driven) -> dict:
    """A model's run beside the plant's, and the plant under the model's orders."""
    blind = differences(run, replayed(NEW, run))
    return differences(run, plant) | {
        "finished": run.finished, "seconds": run.seconds, "length": run.length,
        "open_loop_position": blind["position"],
    }  # fmt: skip


def tuning(found: Identified, gains: Mapping[str, float], evaluations: int, model: str) -> Tuned:
    """Gains tuned on a model, over the paper's two paths."""
    return tune(found.vessel(model), list(PATHS.values()), gains, evaluations)


@dataclasses.dataclass(frozen=True)
class Laws:
    """The fixed law's gains, and runs of both laws on the plant: by law and gains, then by path."""

    gains: dict[str, dict[str, float]]
    runs: dict[str, dict[str, Driven]]
    table: dict[str, dict[str, dict[str, float]]]


def laws(vessel: Vessel, gains: Mapping[str, Mapping[str, float]], evaluations: int) -> Laws:
    """Gains that follow distance and heading error against fixed ones, each at its best.

    Both by hand, as the paper finds them, and tuned alike on the paper's paths; all of them judged
    on the plant, on a path that was kept back, too.

    Arguments:
        gains: of the dynamic law, `by hand` and `tuned`.
    """
    ways = list(PATHS.values())
    hand = by_hand(vessel, ways, FixedPD)
    fixed = {"by hand": hand, "tuned": tune(vessel, ways, hand, evaluations, FixedPD).gains}
    sets = {"dynamic": {name: dict(gains[name]) for name in fixed}, "fixed": fixed}
    runs = {
        f"{law}, {name}": {
            path: on_plant(NEW, controller(points, numbers, law=LAWS[law]))
            for path, points in (PATHS | KEPT_BACK).items()
        }
        for law, own in sets.items()
        for name, numbers in own.items()
    }
    table = {
        name: {path: track(run, (PATHS | KEPT_BACK)[path]) for path, run in of.items()}
        for name, of in runs.items()
    }
    return Laws(fixed, runs, table)


def verified(gains: Mapping[str, Mapping[str, float]], noisy: bool) -> tuple[dict, dict]:
    """Sets of gains on the reference plant, on the tuned paths and one kept back.

    Runs by set and path, and their figures; `noisy`: the law sees what sensors measure.
    """
    runs, table = {}, {}
    for name, numbers in gains.items():
        runs[name] = {
            path: on_plant(NEW, controller(points, numbers), noise=SEED if noisy else None)
            for path, points in (PATHS | KEPT_BACK).items()
        }
        table[name] = {
            path: track(run, (PATHS | KEPT_BACK)[path]) for path, run in runs[name].items()
        }
    return runs, table


def derivatives(found: Identified, gains: Mapping[str, float]) -> dict:
    """The cost's derivatives by the logarithms of the gains, exact and by differences."""
    given = problem(found.vessel("joint"), list(PATHS.values()), gains)
    z = np.log([gains[name] for name in NAMES])
    return {"names": NAMES, **slope_check(given, z, SMOOTHING)}
