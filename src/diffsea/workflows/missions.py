"""Missions from a script: a file or document run in closed loop, with its numbers and its page."""

import dataclasses
import pathlib
from collections.abc import Callable
from typing import Any

from diffsea.report.pages.battery import battery_page, share_sentences
from diffsea.report.pages.mission import mission_page
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
from diffsea.trajectory import Trajectory
from diffsea.workflows.audits import Tabulated


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


def run_battery(
    mission: Mission | dict[str, Any] | str | pathlib.Path,
    battery: Battery | str | pathlib.Path,
    progress: Callable[[float], None] = lambda share: None,
) -> BatteryResult:
    """Run a mission with many plants, weathers and seeds, as `diffsea run --battery` does.

    Arguments:
        progress: is told the share that is done.

    Raises:
        UserError: a mission or battery that cannot be read or run.
    """
    asked = battery if isinstance(battery, Battery) else read_battery(battery)
    tell = lambda number: progress(number / asked.runs)
    found = missions.run_battery(_as_mission(mission), asked, tell)
    return BatteryResult(found, battery_scores(found))
