"""Missions from a script: a file or document run in closed loop, with its numbers and its page."""

import dataclasses
import math
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import tomli_w

from diffsea import missions
from diffsea.missions import (
    Battery,
    BatteryRun,
    Mission,
    MissionRun,
    battery_scores,
    mission_of,
    read_battery,
    read_mission,
    scores,
)
from diffsea.missions.numbers import with_numbers_in_file
from diffsea.missions.studies.sweep import ClosedLoopSweep, closed_loop_sweep
from diffsea.missions.studies.tuning import EFFORT, STARTS, Tuning, tune
from diffsea.outside.documents import read_toml
from diffsea.progress import Progress, no_progress
from diffsea.report.pages.battery import battery_page, share_sentences
from diffsea.report.pages.closed_loop import (
    best_sentences,
    closed_loop_page,
    judged_sentences,
    tuning_page,
)
from diffsea.report.pages.mission import mission_page
from diffsea.simulation.designs import DesignSpace
from diffsea.simulation.planning import outcome_label
from diffsea.trajectory import Outcome, Trajectory
from diffsea.workflows.audits import Tabulated


BEST_ROWS = 10  # of a grid


@dataclasses.dataclass(frozen=True, repr=False)
class MissionResult(Tabulated):
    """A mission that was run; `numbers` is the content of run.json, in SI units and rad."""

    run: MissionRun
    numbers: dict[str, Any]

    @property
    def true(self) -> Trajectory:
        """The motion."""
        return self.run.true

    @property
    def recorded(self) -> Trajectory:
        """The motion as the sensors showed it to the controller."""
        return self.run.recorded

    def headline(self) -> str:
        told = self.numbers
        return f"{told['mission']}: {told['outcome_message']} after {told['time']:.4g} s"

    def rows(self) -> list[dict[str, Any]]:
        told = self.numbers
        errors = (
            ("path error", "path_error", "m"),
            ("position error", "position_error", "m"),
            ("heading error", "heading_error", "rad"),
            ("speed error", "speed_error", "m/s"),
        )
        rows = [
            {"number": f"{name}, {part}", "value": told[key][part], "unit": unit}
            for name, key, unit in errors
            if key in told
            for part in ("rms", "largest")
        ]
        for number, point in enumerate(told.get("waypoints", ()), start=1):
            name = f"waypoint {number}, {'reached' if point['reached'] else 'missed'}, closest"
            rows.append({"number": name, "value": point["closest_approach"], "unit": "m"})
        for channel, orders in told["orders"].items():
            name = f"{channel}, at its limit"
            rows.append(
                {"number": name, "value": 100 * orders["at_limit"], "unit": "% of the time"}
            )
        return rows

    def html(self) -> str:
        """The page."""
        return mission_page(self.run, self.numbers)


def run_mission(mission: Mission | dict[str, Any] | str | pathlib.Path) -> MissionResult:
    """Run a mission in closed loop, as `diffsea run` does.

    Arguments:
        mission: a TOML file, its content as a dictionary, or a mission that has been read.

    Raises:
        UserError: a mission that cannot be read or run, or that diverged; says what to do.
    """
    found = missions.run(_as_mission(mission))
    return MissionResult(found, scores(found))


def _as_mission(given: Mission | dict[str, Any] | str | pathlib.Path) -> Mission:
    if isinstance(given, dict):
        return mission_of(given)
    return given if isinstance(given, Mission) else read_mission(given)


@dataclasses.dataclass(frozen=True, repr=False)
class BatteryResult(Tabulated):
    """A battery that was run; `numbers` is the content of its run.json."""

    run: BatteryRun
    numbers: dict[str, Any]

    def headline(self) -> str:
        return f"{self.numbers['mission']}: {self.numbers['runs']} runs"

    def rows(self) -> list[dict[str, Any]]:
        return list(self.run.table)

    def notes(self) -> list[str]:
        return share_sentences(self.numbers)

    def html(self) -> str:
        """The page."""
        return battery_page(self.run, self.numbers)


@dataclasses.dataclass(frozen=True, repr=False)
class ClosedLoopResult(Tabulated):
    """A mission that was run with many values of its numbers; `numbers` is its run.json."""

    found: ClosedLoopSweep
    numbers: dict[str, Any]

    def headline(self) -> str:
        outcomes = ", ".join(f"{n} {name}" for name, n in self.numbers["outcomes"].items())
        return f"{self.numbers['mission']}: {self.numbers['designs']} runs ({outcomes})"

    def rows(self) -> list[dict[str, Any]]:
        return self.found.table.to_dict("records")

    def best_rows(self) -> list[dict[str, Any]]:
        """The completed runs with the smallest error, their numbers alone."""
        return self._best().drop(columns="outcome").to_dict("records")

    def _best(self) -> pd.DataFrame:
        completed, judged_by = _completed(self.found.table), self.numbers["judged_by"]
        ranked = completed.sort_values(judged_by) if judged_by else completed
        return ranked.head(BEST_ROWS)

    def notes(self) -> list[str]:
        return best_sentences(self.numbers) if self.numbers["judged_by"] else []

    def html(self) -> str:
        """The page."""
        return closed_loop_page(self.found.table, self._best(), self.numbers)


def _completed(table: pd.DataFrame) -> pd.DataFrame:
    return table.loc[table["outcome"] == outcome_label(Outcome.COMPLETED)]


def sweep_mission(
    mission: Mission | dict[str, Any] | str | pathlib.Path,
    space: DesignSpace,
    progress: Progress = no_progress,
) -> ClosedLoopResult:
    """Run a mission with many values of its numbers, as `diffsea run --grid` does.

    Arguments:
        space: designs whose names are numbers of the mission.

    Raises:
        UserError: a mission that cannot be read or run, or a name of no number.
    """
    asked = _as_mission(mission)
    found = closed_loop_sweep(asked, space, progress)
    return ClosedLoopResult(found, _closed_loop_record(found, space))


def _closed_loop_record(found: ClosedLoopSweep, space: DesignSpace) -> dict[str, Any]:
    """The content of run.json of a grid."""
    table, mission = found.table, found.mission
    names = list(table)[: len(space.names)]
    numeric = [name for name in list(table)[len(names) :] if name != "outcome"]
    judged_by = next(
        (name for name in ("path_rms", "position_rms", "heading_rms") if name in numeric), None
    )
    record: dict[str, Any] = {
        "format": 1,
        "mission": mission.name,
        "vessel": mission.vessel.name,
        "controller": mission.controller.kind,
        "designs": len(table),
        "outcomes": {str(k): int(n) for k, n in table["outcome"].value_counts().items()},
        "parameters": {
            name: {"from": axis[0], "to": axis[1]}
            for name, axis in zip(names, space.axes.values(), strict=True)
        },
        "metrics": {name: _extent(table, name, names) for name in numeric},
        "judged_by": judged_by,
        "source": {"mission": mission.name, "seed": mission.seed, "designs": space.as_dict()},
    }
    if judged_by:
        stands, error = found.as_it_stands, judged_by.replace("_rms", "_error")
        record["as_it_stands"] = {
            judged_by: None if stands is None else scores(stands)[error]["rms"]
        }
        ranked = _completed(table).sort_values(judged_by).to_dict("records")
        if ranked:
            record["best"] = {name: float(ranked[0][name]) for name in (*names, *numeric)}
    return record


def _extent(table: pd.DataFrame, number: str, parameters: Sequence[str]) -> dict[str, Any]:
    """Least, median and most of a number, and the designs of its ends."""
    values = table[number].to_numpy(float)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) == 0:
        nothing = dict.fromkeys(("least", "median", "most"), math.nan)
        return nothing | {"designs": 0, "least_design": None, "most_design": None}
    rows = known[np.argsort(values[known], kind="stable")]
    told: dict[str, Any] = {"median": float(np.median(values[known])), "designs": len(known)}
    for end, row in (("least", rows[0]), ("most", rows[-1])):
        told[end] = float(values[row])
        told[f"{end}_design"] = {name: float(table[name].iloc[row]) for name in parameters}
    return told


@dataclasses.dataclass(frozen=True, repr=False)
class TuningResult(MissionResult):
    """A mission that was tuned, run with what was found; `numbers` has `tuning` besides."""

    tuning: Tuning
    document: dict[str, Any]  # of the mission's file, empty where there was none
    folder: pathlib.Path

    def tuning_lines(self) -> list[str]:
        """What was found, and what the paths say of it."""
        found = self.numbers["tuning"]
        lines = [
            f"{name}: {one['before']:.4g} before, {one['after']:.4g} tuned"
            for name, one in found["numbers"].items()
        ]
        return [*lines, *judged_sentences(found)]

    def notes(self) -> list[str]:
        return self.tuning_lines()

    def mission_file(self, folder: pathlib.Path) -> str:
        """The tuned mission as TOML text that lies in `folder`."""
        changed = with_numbers_in_file(self.document, self.tuning.after)
        for whose in ("vessel", "model"):
            file = changed.get(whose, {}).get("file")
            if file is not None:
                changed[whose]["file"] = os.path.relpath(self.folder / file, folder)
        return tomli_w.dumps(changed)

    def html(self) -> str:
        """The page."""
        return tuning_page(self.run, self.numbers)


def tune_mission(
    mission: dict[str, Any] | str | pathlib.Path,
    ranges: Mapping[str, tuple[float, float]],
    judges: Sequence[Mission | dict[str, Any] | str | pathlib.Path] = (),
    starts: int = STARTS,
    effort: float = EFFORT,
    progress: Progress = no_progress,
) -> TuningResult:
    """Tune numbers of a mission and run it with them, as `diffsea run --tune` does.

    Arguments:
        ranges: from and to by name of a number of the mission, SI units.
        judges: missions that judge; the path turned by 120 deg, with another seed, if none.
        starts, effort: as of `missions.tune`.

    Raises:
        UserError: a mission that cannot be read or run, a name of no number, or a range that is
            none.
    """
    if isinstance(mission, dict):
        folder, document = pathlib.Path(), mission
    else:
        folder, document = pathlib.Path(mission).parent, read_toml(mission, "the mission")
    asked = _as_mission(mission)
    others = [_as_mission(one) for one in judges]
    found = tune(asked, ranges, others, starts, effort, progress)
    run = missions.run(found.mission)
    record = scores(run) | {"tuning": _tuning_record(found)}
    return TuningResult(run, record, found, document, folder)


def _tuning_record(found: Tuning) -> dict[str, Any]:
    numbers = {
        name: {"before": found.before[name], "after": found.after[name], "from": low, "to": high}
        for name, (low, high) in found.ranges.items()
    }
    judging = [one for one in found.paths if not one.tuned_on]
    return {
        "numbers": numbers,
        "effort": found.effort,
        "better": all(one.after["cost"] < one.before["cost"] for one in judging),
        "paths": [one._asdict() for one in found.paths],
        "starts": [one._asdict() for one in found.starts],
    }


def run_battery(
    mission: Mission | dict[str, Any] | str | pathlib.Path,
    battery: Battery | str | pathlib.Path,
    progress: Callable[[float], None] = lambda share: None,
) -> BatteryResult:
    """Run a mission with many plants, weathers and seeds, as `diffsea run --battery` does.

    Arguments:
        battery: or its file.
        progress: is told the share that is done.

    Raises:
        UserError: a mission or battery that cannot be read or run.
    """
    asked = battery if isinstance(battery, Battery) else read_battery(battery)
    tell = lambda number: progress(number / asked.runs)
    found = missions.run_battery(_as_mission(mission), asked, tell)
    return BatteryResult(found, battery_scores(found))
