"""The boat outside the model class over draws of the sensors' noise: what may be claimed of it.

Fixed before it was run: seeds 1 to 100 for the procedure and the joint model, 1 to 20 for plants
that lack a part and for the planar plant; errors as in `outside_class` (free predictions of 64 s of
the three runs kept back, root mean square). A draw's noise is the same, sample by sample, on every
plant, so that differences are of pairs. Two models are told apart where the interval of 95 % of
the median difference leaves out zero. The first draw is fitted from both starts, every other one
from where the better of these ended: from the guesses some end in another minimum.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

from experiments.harness.reporting import table
from experiments.vrx_wamv.campaign import campaign, held_out, measured_again
from experiments.vrx_wamv.closed import Driven, differences, on_model, on_plant
from experiments.vrx_wamv.intervals import Interval, over_draws, paired
from experiments.vrx_wamv.joint import Start, fit_whole
from experiments.vrx_wamv.models import errors_on, vessel_of
from experiments.vrx_wamv.plant import NEW, AnyPlant
from experiments.vrx_wamv.procedure import identify
from experiments.vrx_wamv.rolling_plant import ROLLING, WITHOUT

from diffsea import Vessel
from diffsea.identification.estimates import FitOutcome
from diffsea.simulation.control.waypoints import DynamicPD


DRAWS, DRAWS_LESS = 100, 20
HELD_OUT = 100  # added to a seed; its noise is not looked at
PROCEDURE, JOINT, PLANAR = "procedure", "joint", "joint, of the planar plant"
CHANNELS = {"position": "position, m", "u": "surge, m/s", "v": "sway, m/s", "r": "yaw rate, rad/s"}
Errors = dict[int, dict[str, float]]  # by seed and channel, times by path


@dataclasses.dataclass(frozen=True)
class Draws:
    """What was found over the draws: by model, then by channel or path."""

    counts: dict[str, int]
    converged: dict[str, int]  # joint fits that did not end at a limit of steps
    medians: dict[str, dict[str, Interval]]
    differences: dict[str, dict[str, Interval]]
    finished: dict[str, dict[str, int]]  # draws in which model and plant finished a path
    times: dict[str, dict[str, Interval | None]]  # errors as shares; None where some did not


def less(part: str) -> str:
    """The name of the joint model of the plant without a part."""
    return f"joint, of the plant without {part}"


def over_noise(laws: Mapping[str, DynamicPD], say: Callable[[str], None]) -> Draws:
    """Models of every draw.

    Arguments:
        laws: the paper's law on each path, the same in every draw.
    """
    found: dict[str, Errors] = {PROCEDURE: {}}
    times: dict[str, Errors] = {PROCEDURE: {}}
    converged = {}
    plants: dict[str, tuple[AnyPlant, int]] = {JOINT: (ROLLING, DRAWS), PLANAR: (NEW, DRAWS_LESS)}
    plants |= {less(part): (plant, DRAWS_LESS) for part, plant in WITHOUT.items()}
    for name, (plant, count) in plants.items():
        say(f"{count} draws of noise: {name}")
        kept, first = held_out(HELD_OUT, plant), campaign(1, plant)
        driven = {path: on_plant(plant, law) for path, law in laws.items()}
        starts: tuple[Start, ...] = ("guessed", "afar")
        found[name], times[name], converged[name] = {}, {}, 0
        for seed in range(1, count + 1):
            data = measured_again(first, seed)
            fitted = fit_whole(data.runs, starts)
            starts = (fitted.coordinates,) if seed == 1 else starts
            converged[name] += fitted.outcome is FitOutcome.CONVERGED
            models = {name: fitted.vessel}
            if name == JOINT:
                drag = identify(data, "thrust as ordered").corrected
                models[PROCEDURE] = vessel_of(drag.values())
            for model, vessel in models.items():
                found[model][seed] = errors_on(vessel, kept)
                times[model][seed] = time_errors(vessel, laws, driven)
    return judged(found, times, converged, list(laws))


def time_errors(
    vessel: Vessel, laws: Mapping[str, DynamicPD], driven: Mapping[str, Driven]
) -> dict[str, float]:
    """By path the share by which a model's time differs from the plant's, where both finish."""
    runs = {path: on_model(vessel, law) for path, law in laws.items() if driven[path].finished}
    return {
        path: differences(run, driven[path])["time"] for path, run in runs.items() if run.finished
    }


def judged(
    found: Mapping[str, Errors],
    times: Mapping[str, Errors],
    converged: dict[str, int],
    paths: Sequence[str],
) -> Draws:
    """Medians, pairs and times of what was found in each draw."""

    def series(of: Mapping[str, Errors], model: str, key: str) -> dict[int, float]:
        return {seed: one[key] for seed, one in of[model].items() if key in one}

    medians = {
        model: {key: over_draws(list(series(found, model, key).values())) for key in CHANNELS}
        for model in found
    }
    pairs = {
        f"{one}, less {other}": {
            key: paired(series(found, one, key), series(found, other, key)) for key in CHANNELS
        }
        for one, other in compared(list(found))
    }
    finished = {model: {path: len(series(times, model, path)) for path in paths} for model in times}
    in_time = {
        model: {
            path: over_draws(list(series(times, model, path).values()))
            if finished[model][path] == len(times[model]) else None
            for path in paths
        }
        for model in times
    }  # fmt: skip
    counts = {model: len(errors) for model, errors in found.items()}
    return Draws(counts, converged, medians, pairs, finished, in_time)


def compared(models: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs: the procedure and every plant that is not the whole one, each against the joint."""
    return [(model, JOINT) for model in models if model != JOINT]


def medians_table(found: Draws) -> str:
    """Medians over draws of every model's errors, with their intervals."""
    rows = [
        (model, str(found.counts[model]), *(_shown(one[key]) for key in CHANNELS))
        for model, one in found.medians.items()
    ]
    return table(("model", "draws", *CHANNELS.values()), rows)


def differences_table(found: Draws) -> str:
    """Median differences of pairs; bold where the interval leaves out zero."""
    rows = [
        (pair, *(_shown(one[key], signed=True) for key in CHANNELS))
        for pair, one in found.differences.items()
    ]
    return table(("in the same draws", *CHANNELS.values()), rows)


def times_table(found: Draws) -> str:
    """Medians of the errors of the time to follow a path, per cent, or how many draws have one."""
    paths = list(next(iter(found.times.values())))
    rows = []
    for model, one in found.times.items():
        count = found.counts[model]
        rows.append((model, *(
            f"done in {found.finished[model][path]} of {count}" if one[path] is None
            else _shown(one[path], factor=100.0)
            for path in paths
        )))  # fmt: skip
    return table(("model", *(f"{path}, %" for path in paths)), rows)


def _shown(one: Interval | None, signed: bool = False, factor: float = 1.0) -> str:
    if one is None:
        return "-"
    sign = "+" if signed else ""
    median, low, high = (f"{factor * x:{sign}.3g}" for x in (one.median, one.low, one.high))
    text = f"{median} ({low} to {high})"
    return f"**{text}**" if signed and one.leaves_out_zero else text
