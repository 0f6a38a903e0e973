"""A short log and trial numbers of other runs, alone and in one fit, judged on runs held out.

python -m experiments.real_fits.both kvlcc2
"""

import dataclasses
import json
import math
import sys
import time

from experiments.harness.diagnosis_tables import predictions_table
from experiments.harness.reporting import Experiment, experiment_in_parts
from experiments.real_fits.run import ROOT, SETS, errors, load

import numpy as np

from diffsea import Trajectory, Vessel, cut, read_vessel, recording_metrics
from diffsea.identification.estimates import Estimate, parameter_estimates
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.objectives.joint import with_trial_numbers
from diffsea.identification.objectives.trial_numbers import (
    RELATIVE_STD,
    MeasuredTrial,
    TrialNumbers,
)
from diffsea.identification.problem import make_problem
from diffsea.identification.run_models import RunModel
from diffsea.identification.uncertainty.sources import sources
from diffsea.simulation import planning
from diffsea.vessel.files import VesselFile, build, updated_document


NUMBERS = ("overshoot_1", "overshoot_2", "peak_yaw_rate")  # of a zig-zag, as a sheet has them
TITLES = {"log": "the log", "numbers": "the numbers", "both": "both"}
EXECUTES = 3  # rudder orders of the simulated trial: two overshoots


@dataclasses.dataclass(frozen=True)
class Case:
    """Which runs are logged in part, read off, and held out, by file name; a set of `run`."""

    logged: str
    seconds: float  # of it, from its start
    read_off: tuple[str, ...]


CASES = {
    "kvlcc2": Case(
        "HSVA_CPMC_KVLCC2_Z_15_05.dat", 40.0,
        ("HSVA_CPMC_KVLCC2_Z_20_10_S.dat", "HSVA_CPMC_KVLCC2_Z_10_10_P.dat"),
    ),
    "kcs": Case(
        "SIMMAN2020_container_KCS_MARIN_zigzag_star_10_FS.txt", 100.0,
        ("SIMMAN2020_container_KCS_MARIN_zigzag_port_10_FS.txt",),
    ),
}  # fmt: skip


def sheet_of(run: Trajectory, vessel: Vessel) -> MeasuredTrial:
    """What `diffsea metrics` reads off a zig-zag, each number good to the sheet's default."""
    read = recording_metrics(run, float(vessel.rigid_body.length), "zigzag")
    plan = planning.plan_trial(
        vessel, "zigzag", float(read["order_angle"]), float(read["switching_heading"]),
        1.0 if read["side"] == "starboard" else -1.0, float(read["approach_speed"]),
        executes=EXECUTES, keep_speed=False,
    )  # fmt: skip
    values = np.array([float(read[name]) for name in NUMBERS])
    return MeasuredTrial(plan, NUMBERS, values, RELATIVE_STD * np.abs(values))


def fitted_vessel(file: VesselFile, objective: AbstractObjective, found: Estimate) -> Vessel:
    """The vessel at an estimate."""
    rows = parameter_estimates(objective.parameters, found)
    return build(updated_document(file.document, {row.name: row.value for row in rows}, []))


def study(run: Experiment, name: str) -> None:
    """Fit three ways, predict what is held out, print and write."""
    case, runs, began = CASES[name], load(SETS[name]), time.perf_counter()
    file = read_vessel(SETS[name].vessel)
    log = cut(runs[case.logged], 0.0, case.seconds)
    sheet = [sheet_of(runs[one], file.vessel) for one in case.read_off]
    held_out = [runs[one] for one in SETS[name].held_out]
    problem = make_problem(file.vessel, [log])
    parameters = problem.layout.parameters
    free = tuple(one.name for one in parameters)
    ways = {
        "log": Innovations(problem),
        "numbers": TrialNumbers(file.vessel, parameters, sheet),
        "both": Innovations(with_trial_numbers(problem, sheet)),
    }
    record: dict[str, dict] = {}
    for way, objective in ways.items():
        found = objective.fit(free)
        vessel = fitted_vessel(file, objective, found)
        rows = errors(held_out, *([RunModel(one)] * len(held_out) for one in (file.vessel, vessel)))
        judged = sources(objective, found)
        record[way] = {
            "outcome": found.outcome.value,
            "horizons": rows,
            "sources": None if judged is None else judged.as_dict(),
            "numbers": [dataclasses.asdict(n) for n in objective.residuals(found.coordinates)],
        }
        print(f"[{time.perf_counter() - began:5.0f} s] {name}, {way}: {found.outcome.sentence}")
        for row in rows:
            told = [
                f"{quantity} {factor * row['file'][quantity]:.2g} -> "
                f"{factor * row['fit'][quantity]:.2g}"
                for quantity, factor in (
                    ("position", 1.0),
                    ("heading", math.degrees(1.0)),
                    ("u", 1.0),
                )
            ]
            print(f"  {row['seconds']:g} s ahead ({row['starts']} starts): {', '.join(told)}")
        if judged is not None:
            print(*(f"  {sentence}" for sentence in judged.sentences), sep="\n")
            print(f"  numbers: squared misfits {judged.trial_numbers.cost:.2g} in "
                  f"{judged.trial_numbers.values} values")  # fmt: skip
        sys.stdout.flush()
    out = ROOT / "out" / "real_fits"
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(record, indent=1, default=lambda value: np.asarray(value).tolist())
    (out / f"{name}-both.json").write_text(text + "\n", encoding="utf-8")
    horizons = {f"file -> {TITLES[way]}": record[way]["horizons"] for way in ways}
    ahead = {f"{name.upper()}_BOTH": predictions_table(horizons, ("file", "fit"))}
    run.write_part(f"{name}-both", record, ahead)


def main() -> None:
    """Study the sets that are named."""
    run, names = experiment_in_parts(__file__, __doc__, list(CASES))
    for name in names:
        study(run, name)


if __name__ == "__main__":
    main()
