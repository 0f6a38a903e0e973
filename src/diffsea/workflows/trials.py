"""Standard trials of a vessel: one, over many designs, and their derivatives."""

import dataclasses
import pathlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd

from diffsea.errors import UserError
from diffsea.metrics.numbers import numbers_of
from diffsea.outside.durable import working_folder
from diffsea.progress import Progress, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.report.wording.horizons import persistence_sentence
from diffsea.simulation import planning
from diffsea.simulation.actuation import recorded_shares
from diffsea.simulation.designs import Grid, LatinHypercube
from diffsea.simulation.order_units import with_usable_actuation
from diffsea.simulation.persistence import persistence_errors
from diffsea.simulation.replay import horizon_errors, replay, replay_errors
from diffsea.studies import inverse, merging, sensitivity
from diffsea.studies import parts as kept
from diffsea.studies import sweep as designs
from diffsea.trajectory import Outcome, Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import VesselFile, read_vessel
from diffsea.workflows.audits import Recording, Tabulated, as_recording


if TYPE_CHECKING:
    from distributed import Client


def as_vessel(given: Vessel | VesselFile | str | pathlib.Path) -> Vessel:
    """A vessel as it is, that of a file, or read from a file or by the name of one that ships.

    Raises:
        UserError: the file cannot be read; says what is wrong, where, and what to do.
    """
    if isinstance(given, Vessel):
        return given
    return (given if isinstance(given, VesselFile) else read_vessel(given)).vessel


@dataclasses.dataclass(frozen=True, repr=False)
class TrialResult(Tabulated):
    """A standard trial that was run, with its numbers.

    `metrics` is the content of metrics.json: SI units, `<length>_over_L`, IMO verdicts.
    """

    vessel: Vessel
    plan: planning.TrialPlan
    trajectory: Trajectory
    metrics: dict[str, Any]

    def headline(self) -> str:
        return f"{self.plan.manoeuvre} of {self.vessel.name}: {self.metrics['outcome_message']}"

    def rows(self) -> list[dict[str, Any]]:
        verdicts = {
            name: f"{item['verdict']} (limit {item['limit']:.4g} {item['unit']})"
            for name, item in self.metrics["imo"].items()
        }
        return [
            {"number": one.name, "SI": one.value, "IMO": verdicts.get(one.name, "")}
            for one in numbers_of(self.metrics)
        ]

    def notes(self) -> list[str]:
        return [f"note: {note}" for note in self.metrics["notes"]]


def trial(
    vessel: Vessel | VesselFile | str | pathlib.Path, manoeuvre: str, **options: Any
) -> TrialResult:
    """Run a standard trial as `diffsea trial` does.

    Arguments:
        manoeuvre: `turning-circle`, `zigzag` ...
        options: those of `plan_trial`, angles in rad: `angle`, `heading`, `side` (+1 starboard),
            `speed` m/s or `thrust` N, `seconds`, `step`, `executes`, `keep_speed`.

    Raises:
        UserError: a manoeuvre that is unknown or that the vessel cannot run, or a run that diverged
            or was never executed.
    """
    boat = as_vessel(vessel)
    plan = planning.plan_trial(boat, manoeuvre, **options)
    found, numbers = planning.run_and_measure(boat, plan)
    outcome = Outcome(int(found.trajectory.outcome))
    if outcome in (Outcome.DIVERGED, Outcome.APPROACH_UNSTEADY):
        raise UserError(f"{manoeuvre} of {boat.name!r}: {outcome.sentence}")
    summary = planning.summarise_trial(boat, plan, found, numbers)
    return TrialResult(boat, plan, found.trajectory, summary)


@dataclasses.dataclass(frozen=True, repr=False)
class PredictionResult(Tabulated):
    """What a vessel predicts for a recording's orders, open loop, and how far it is off.

    `errors` are root-mean-square errors over the run, `horizons` those so many seconds ahead of
    starts all over the run, `persistence` those of going on as before from there; SI units.
    """

    vessel: Vessel
    recording: Trajectory
    predicted: Trajectory
    errors: dict[str, float]
    horizons: dict[float, dict[str, float]]
    persistence: dict[float, dict[str, float]]

    def headline(self) -> str:
        who = f"{self.recording.name} predicted by {self.vessel.name}"
        return f"{who}: root-mean-square errors (SI)"

    def rows(self) -> list[dict[str, Any]]:
        ahead = {f"{seconds:g} s ahead": row for seconds, row in self.horizons.items()}
        table = {"whole run": self.errors, **ahead}
        return [{"": label, **row} for label, row in table.items()]

    def notes(self) -> list[str]:
        told = persistence_sentence(self.horizons, self.persistence)
        return [f"warning: {told}"] if told else []


def predict(
    vessel: Vessel | VesselFile | str | pathlib.Path,
    recording: Recording,
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    measured_actuation: bool = True,
) -> PredictionResult:
    """Replay a recording's orders through a vessel as `diffsea predict` does.

    Arguments:
        measured_actuation: use executed actuation where it was measured, else the orders alone.

    Raises:
        UserError: a recording that cannot be read or does not fit the vessel, or a prediction that
            diverges.
    """
    boat = as_vessel(vessel)
    (run,) = with_usable_actuation(boat, [as_recording(recording, mapping)])
    predicted = replay(boat, run, measured_actuation)
    if predicted.outcome == Outcome.DIVERGED:
        raise UserError(f"{run.name}: {Outcome.DIVERGED.sentence}")
    horizons = horizon_errors(boat, run, measured_actuation=measured_actuation)
    kept_up = persistence_errors(run, boat.sensors, shares=recorded_shares(boat, run))
    return PredictionResult(boat, run, predicted, replay_errors(predicted, run), horizons, kept_up)


def sweep(
    vessel: Vessel | VesselFile | str | pathlib.Path,
    manoeuvre: str,
    grid: Mapping[str, tuple[float, float, int]] | None = None,
    sample: Mapping[str, tuple[float, float]] | None = None,
    count: int = 1000,
    seed: int = 0,
    progress: Progress = no_progress,
    cluster: "Client | str | None" = None,
    part: int = kept.PART,
    **options: Any,
) -> pd.DataFrame:
    """One trial of many designs, batched, as `diffsea sweep` runs it.

    Arguments:
        grid: from, to and how many values, by the name of a vessel's number, `speed` or `thrust`.
        sample: from and to by name, in place of a grid: `count` designs, a Latin hypercube.
        cluster: whose workers run the designs, a client or a scheduler's address; this process
            if None.
        part: designs that a worker of the cluster runs at a time.
        options: those of the trial, see `trial`.

    **Returns:** a row for each design: its parameters, the trial's numbers in SI units,
    `imo_<number>` verdicts, and the `outcome`.

    Raises:
        UserError: neither or both of grid and sample, an unknown name, a trial that the vessel
            cannot run, or a cluster that cannot be used or where a part failed.
    """
    if (grid is None) == (sample is None):
        raise UserError("give either a grid or a sample of designs")
    boat = as_vessel(vessel)
    space = LatinHypercube(sample or {}, count, seed) if grid is None else Grid(grid)
    chosen = space.all()
    designs.check_names(boat, chosen.names)
    plan = planning.plan_trial(boat, manoeuvre, **{**options, **chosen.slowest()})
    if cluster is None:
        return designs.sweep(boat, plan, chosen, progress).table
    with working_folder() as folder:
        parts = kept.parts_of(folder, boat, {}, plan, space, part)
        kept.do_parts(parts, boat, plan, space, progress=progress, cluster=cluster)
        merging.merge(parts, folder / "sweep.parquet")
        return pd.read_parquet(folder / "sweep.parquet")


@dataclasses.dataclass(frozen=True, repr=False)
class InverseDesignResult(Tabulated):
    """Designs found for wanted numbers, the best first, and the sweep that they started from."""

    wanted: dict[str, float]  # by number, SI units
    found: list[inverse.FoundDesign]
    swept: pd.DataFrame

    def headline(self) -> str:
        return inverse.found_sentence(self.wanted, [one.off for one in self.found])

    def rows(self) -> list[dict[str, Any]]:
        return [
            {**one.parameters, **{name: one.numbers.get(name) for name in self.wanted}}
            | {"off": one.off}
            for one in self.found
        ]


def inverse_design(
    vessel: Vessel | VesselFile | str | pathlib.Path,
    manoeuvre: str,
    ranges: Mapping[str, tuple[float, float]],
    wanted: Mapping[str, float],
    count: int = 256,
    seed: int = 0,
    progress: Progress = no_progress,
    **options: Any,
) -> InverseDesignResult:
    """Designs within ranges whose trial has the numbers that are wanted.

    A sweep of `count` designs, a Latin hypercube, finds where to start; from its nearest designs
    exact derivatives lead on.

    Arguments:
        ranges: from and to by the name of a vessel's number, `speed` or `thrust`; SI units.
        wanted: numbers of the trial by name, SI units.
        options: those of the trial, see `trial`.

    Raises:
        UserError: an unknown name, a range that is none, a trial that the vessel cannot run, or no
            design that has all the wanted numbers.
    """
    boat = as_vessel(vessel)
    space = LatinHypercube(ranges, count, seed)
    chosen = space.all()
    designs.check_names(boat, chosen.names)
    plan = planning.plan_trial(boat, manoeuvre, **{**options, **chosen.slowest()})
    swept = designs.sweep(boat, plan, chosen, progress).table
    found = inverse.designs_for(boat, plan, ranges, wanted, swept, progress)
    return InverseDesignResult(dict(wanted), found, swept)


@dataclasses.dataclass(frozen=True, repr=False)
class SensitivityResult(Tabulated):
    """Derivatives of a trial's numbers, exact through the switching of orders.

    `derivatives[number][parameter]` is in the SI units of both; `relative` is the relative change
    of a number by the relative change of a parameter.
    """

    vessel: Vessel
    manoeuvre: str
    numbers: dict[str, float]
    derivatives: dict[str, dict[str, float]]
    relative: dict[str, dict[str, float]]

    def headline(self) -> str:
        trial = f"{self.manoeuvre} of {self.vessel.name}"
        return f"{trial}: % change by 1 % of the strongest parameters"

    def rows(self) -> list[dict[str, Any]]:
        table = []
        for number, value in self.numbers.items():
            row = self.relative.get(number, {})
            strongest = sorted(row, key=lambda name: -abs(row[name]))[:5]
            shares = ", ".join(f"{name} {row[name]:+.3g}" for name in strongest)
            table.append({"number": number, "SI": value, "strongest": shares or "-"})
        return table


def sensitivities(
    vessel: Vessel | VesselFile | str | pathlib.Path,
    manoeuvre: str,
    parameters: Iterable[str] | None = None,
    **options: Any,
) -> SensitivityResult:
    """How each number of a trial depends on each number of the vessel, as `diffsea sensitivity`.

    Arguments:
        parameters: names as in the vessel's file; all of them if None.
        options: those of the trial, see `trial`.

    Raises:
        UserError: an unknown name, or a trial that the vessel cannot run.
    """
    boat = as_vessel(vessel)
    plan = planning.plan_trial(boat, manoeuvre, **options)
    found = sensitivity.sensitivities(boat, plan, parameters)
    return SensitivityResult(boat, manoeuvre, found.numbers, found.derivatives, found.elasticities)
