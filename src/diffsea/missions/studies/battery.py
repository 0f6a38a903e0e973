"""A battery: one mission with many plants, weathers and seeds, its misfortunes counted.

The controller stays as it is, with the model that it believes in: what is drawn is what it does not
know.
"""

import dataclasses
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.stats import binomtest

from diffsea.errors import UserError
from diffsea.missions.numbers import with_numbers
from diffsea.missions.record import Mission
from diffsea.missions.running import DivergedError, MissionRun, run
from diffsea.missions.scores import scores
from diffsea.outside.documents import read_toml
from diffsea.parameters import check_names, file_parameters
from diffsea.vessel.files import check
from diffsea.vessel.tables import Table, check_keys, needed


Range = tuple[float, float]

_WEATHER = {  # names of numbers of the mission
    "current_speed": "weather.current.speed",
    "current_direction": "weather.current.direction",
    "wind_speed": "weather.wind.speed",
    "wind_direction": "weather.wind.direction",
    "gusts": "weather.wind.gusts",
}
_MOST_RUNS = 10_000
LEVEL = 0.95  # of intervals
FAILED = "failed"  # outcome of a run that diverged
# What is counted, and whether a row of the table has it.
EVENTS: dict[str, Callable[[Mapping[str, Any]], bool]] = {
    "not_finished": lambda row: row["outcome"] != "completed",
    "waypoint_missed": lambda row: row.get("missed", 0) > 0,
    "at_limit": lambda row: row.get("limit_events", 0) > 0,
    "wrong_way": lambda row: row.get("wrong_way_events", 0) > 0,
}


_SUMMED_UP = (  # numbers of a battery's runs
    *("time", "path_rms", "path_largest", "position_rms", "position_largest"),
    *("heading_rms", "speed_rms", "at_limit"),
)


@dataclasses.dataclass(frozen=True)
class Battery:
    """How often a mission is run, and what is drawn for each run, evenly between two numbers.

    `vessel` are numbers of the plant by name, `weather` those of `_WEATHER`: SI units, rad.
    """

    runs: int
    vessel: Mapping[str, Range]
    weather: Mapping[str, Range]
    seed: int = 0


def read_battery(path: str | pathlib.Path) -> Battery:
    """Read a battery from a TOML file. Raises `UserError` as `battery_of`, naming the file."""
    document = read_toml(path, "the battery")
    try:
        return battery_of(document)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def battery_of(document: Table) -> Battery:
    """The battery of a document, checked.

    Raises:
        UserError: an unknown key, no number of runs, or a range that is none.
    """
    if document.get("format", 1) != 1:
        raise UserError(f"format = {document['format']!r}; this version reads format = 1")
    check_keys(document, ("format", "runs", "seed", "vessel", "weather"), "the file")
    counts = {"runs": document.get("runs"), "seed": document.get("seed", 0)}
    for key, value in counts.items():
        least, most = (1, _MOST_RUNS) if key == "runs" else (0, 2**31)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise UserError(f"{key} = {value!r} is not a whole number from {least} to {most}")
    tables = {key: document.get(key, {}) for key in ("vessel", "weather")}
    for key, table in tables.items():
        if not isinstance(table, dict):
            raise UserError(f"write [{key}] as a table of ranges, for example mass = [70.0, 90.0]")
    check_keys(tables["weather"], tuple(_WEATHER), "[weather]")
    ranges = {
        key: {name: _range(pair, f"[{key}] {name}") for name, pair in table.items()}
        for key, table in tables.items()
    }
    for name, (low, _) in ranges["weather"].items():
        if low < 0 and not name.endswith("direction"):
            raise UserError(f"[weather] {name} is from {low:g}: it cannot be negative")
    return Battery(counts["runs"], **ranges, seed=counts["seed"])


def _range(pair: object, where: str) -> Range:
    if not isinstance(pair, list) or len(pair) != 2:
        raise UserError(f"{where} = {pair!r} is not [from, to]")
    ends: Table = dict(zip(("from", "to"), pair, strict=True))
    low, high = needed(ends, "from", where), needed(ends, "to", where)
    if low > high:
        raise UserError(f"{where} is from {low:g} to {high:g}: turn them round")
    return low, high


@dataclasses.dataclass(frozen=True)
class BatteryRun:
    """The runs of a battery that did not diverge, and a row of numbers for every one."""

    mission: Mission
    runs: tuple[MissionRun, ...]
    table: tuple[dict[str, Any], ...]


def run_battery(
    mission: Mission, battery: Battery, progress: Callable[[int], None] = lambda number: None
) -> BatteryRun:
    """Run a mission as a battery asks.

    `progress` is told how many runs are done.

    Raises:
        UserError: a number that the vessel does not have, a plant that is impossible, or a mission
            that cannot be run at all.
    """
    places = file_parameters(mission.vessel)
    check_names(mission.vessel, [name for name in battery.vessel if name not in places])
    rng = np.random.default_rng(battery.seed)
    runs, table = [], []
    for number in range(battery.runs):
        drawn = {
            name: float(rng.uniform(*ends))
            for name, ends in (*battery.vessel.items(), *battery.weather.items())
        }
        row: dict[str, Any] = {"seed": battery.seed + number, **drawn}
        chosen = {f"vessel.{name}": drawn[name] for name in battery.vessel}
        chosen |= {_WEATHER[name]: drawn[name] for name in battery.weather}
        one = with_numbers(dataclasses.replace(mission, seed=row["seed"]), chosen)
        check(one.vessel)
        try:
            found = run(one)
        except UserError as error:
            if number == 0 and not isinstance(error, DivergedError):
                raise
            row |= {"outcome": FAILED, "why": str(error)}
        else:
            runs.append(found)
            row |= _summary(scores(found))
        table.append(row)
        progress(number + 1)
    return BatteryRun(mission, tuple(runs), tuple(table))


def _summary(told: Mapping[str, Any]) -> dict[str, Any]:
    """A run's row of the table."""
    row = {"outcome": told["outcome"], "time": told["time"]}
    for key, short in (
        ("path_error", "path"),
        ("position_error", "position"),
        ("heading_error", "heading"),
        ("speed_error", "speed"),
    ):
        if key in told:
            row |= {f"{short}_{part}": told[key][part] for part in ("rms", "largest")}
    if "waypoints" in told:
        row["missed"] = sum(not point["reached"] for point in told["waypoints"])
        row["wrong_way_events"] = told["wrong_way"]["events"]
    orders = told["orders"].values()
    return row | {
        "at_limit": max(one["at_limit"] for one in orders),
        "limit_events": sum(one["limit_events"] for one in orders),
    }


def battery_scores(found: BatteryRun) -> dict[str, Any]:
    """The content of run.json of a battery: shares of runs with intervals, quantiles, the table.

    Intervals are Wilson's (1927), of 95 %; quantiles are over the runs that did not diverge.
    """
    count, events = len(found.table), dict(EVENTS)
    if not found.mission.waypoints:
        del events["waypoint_missed"], events["wrong_way"]
    shares = {}
    for name, happened in events.items():
        hits = sum(happened(row) for row in found.table)
        low, high = binomtest(hits, count).proportion_ci(LEVEL, method="wilson")
        shares[name] = {
            "runs": hits,
            "share": hits / count,
            "interval": [float(low), float(high)],
        }
    done = [row for row in found.table if row["outcome"] != FAILED]
    quantiles = {}
    for name in _SUMMED_UP:
        values = [row[name] for row in done if name in row]
        if values:
            middle, most = np.quantile(values, [0.5, 0.95])
            quantiles[name] = {
                "median": float(middle),
                "quantile_95": float(most),
                "largest": max(values),
            }
    return {
        "format": 1,
        "mission": found.mission.name,
        "vessel": found.mission.vessel.name,
        "controller": found.mission.controller.kind,
        "runs": count,
        "shares": shares,
        "numbers": quantiles,
        "table": list(found.table),
    }
