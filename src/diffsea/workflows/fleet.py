"""Many boats' recordings audited, fitted and diagnosed: one table, and what recurs among boats.

Each boat is done by a process of its own (`workflows.boat`), so that what a recording costs does
not grow with their number. What was found of a boat is kept under the hash of all that it rests
on: files, settings, version. A run that was stopped goes on from there.
"""

import contextlib
import dataclasses
import math
import pathlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from diffsea.errors import UserError
from diffsea.outside.cluster import connected
from diffsea.outside.unfinished import clear_abandoned
from diffsea.progress import PartialProgress, Progress, counted, no_progress
from diffsea.report.pages.fleet import fleet_report
from diffsea.workflows.audits import Tabulated
from diffsea.workflows.boat import DEPTHS, moved_parameters
from diffsea.workflows.boat_processes import (
    done_in_processes,
    done_on_cluster,
    keep_part,
    kept_part,
)
from diffsea.workflows.manifest import read_manifest


if TYPE_CHECKING:
    from distributed import Client

CHANGED = ("explained", "ambiguous", "unexplained", "missing")  # verdicts: the file is not enough
HORIZON = "20"  # s, of the free predictions that the table has


@dataclasses.dataclass(frozen=True, repr=False)
class FleetResult(Tabulated):
    """What was found of every boat, in the order of the manifest; see `boat.study_boat`."""

    boats: list[dict[str, Any]]
    settings: dict[str, Any]
    reused: int

    @property
    def done(self) -> list[dict[str, Any]]:
        """The boats that could be done."""
        return [one for one in self.boats if one["status"] == "done"]

    @property
    def table(self) -> pd.DataFrame:
        """A row for each recording, with what was found of its boat."""
        return pd.DataFrame([row for one in self.boats for row in _table_rows(one)])

    @property
    def recurring(self) -> dict[str, list[str]]:
        """The boats of each effect that was found, the most frequent first."""
        found: dict[str, list[str]] = defaultdict(list)
        for one in self.done:
            for name in dict.fromkeys(effect["name"] for effect in one.get("effects", [])):
                found[name].append(one["boat"])
        return dict(sorted(found.items(), key=lambda item: -len(item[1])))

    def headline(self) -> str:
        changed = [one["boat"] for one in self.done if one.get("verdict") in CHANGED]
        told = (
            ""
            if self.settings["until"] == "audit"
            else f", {len(changed)} show more than their file has"
        )
        return f"{len(self.done)} of {counted(len(self.boats), 'boat')} done{told}"

    def rows(self) -> list[dict[str, Any]]:
        return [
            {
                "boat": one["boat"],
                "verdict": one.get("verdict", one["status"]),
                "recordings": _count_done(one),
                "names": _names(one),
                "off the file": _moved_text(one),
            }
            for one in self.boats
        ]

    def notes(self) -> list[str]:
        told = [
            f"{name}: {len(boats)} boat{'s' * (len(boats) != 1)}"
            for name, boats in self.recurring.items()
        ]
        for one in self.boats:
            told += [f"{one['boat']}: {one['reason']}"] if one["reason"] else []
            told += [
                f"{one['boat']}, {row['name']}: {row['reason']}"
                for row in one["recordings"]
                if row["reason"] and row["reason"] not in one["reason"]
            ]
        return told

    def record(self) -> dict[str, Any]:
        """What `--json` prints."""
        return {
            "format": 1,
            "settings": self.settings,
            "recurring": self.recurring,
            "boats": [one | {"moved": moved_parameters(one)} for one in self.boats],
        }

    def html(self) -> str:
        """The page."""
        return fleet_report(self.record(), self.headline(), CHANGED)


def fleet(
    manifest: pd.DataFrame | str | pathlib.Path,
    until: str = "diagnose",
    jobs: int = 1,
    minutes: float | None = None,
    free: Sequence[str] | None = None,
    per_recording: bool = False,
    parts: str | pathlib.Path | None = None,
    progress: Progress = no_progress,
    cluster: "Client | str | None" = None,
) -> FleetResult:
    """Audit, fit and diagnose many boats, as `diffsea fleet` does.

    Arguments:
        manifest: a row for each recording: `boat`, `vessel`, `recording`, and where there is one
            `mapping` and `role` (`train` or `test`); a CSV, whose folder paths are relative to,
            or a DataFrame.
        until: `diagnose`, or no further than `fit` or `audit`.
        jobs: processes at once, without a cluster.
        minutes: after which no further step of a boat's diagnosis is begun.
        free: parameters that are fitted; the hull's derivatives if None.
        per_recording: whether wind and current are each recording's own.
        parts: folder in which the boats done are kept, so that a stopped run goes on; nothing is
            kept if None.
        cluster: whose workers do the boats, a client or a scheduler's address. Each worker reads
            vessels, recordings and mappings from the same paths as this process.

    Raises:
        UserError: the manifest cannot be read, the cluster cannot be used, or no boat could be
            done.
    """
    if until not in DEPTHS:
        raise UserError(f"a fleet is done until {', '.join(DEPTHS)}, not {until!r}")
    settings = {
        "until": until,
        "minutes": minutes,
        "free": None if free is None else list(free),
        "per_recording": per_recording,
    }
    tasks: list[dict[str, Any]] = [one | {"settings": settings} for one in read_manifest(manifest)]
    kept = None if parts is None else pathlib.Path(parts)
    found: dict[str, dict[str, Any]] = {}
    if kept is not None:
        clear_abandoned(kept)
    for task in tasks:
        if kept is not None and (part := kept_part(kept, task)) is not None:
            found[task["boat"]] = part
    reused = len(found)
    if reused:
        progress(f"{reused} boats were done before, and are taken from {kept}")
    left = [task for task in tasks if task["boat"] not in found]
    with contextlib.ExitStack() as stack:
        if cluster is not None and left:
            results = done_on_cluster(left, stack.enter_context(connected(cluster, progress)))
        else:
            results = done_in_processes(left, jobs)
        progress("taking the boats")
        for task, result in results:
            found[task["boat"]] = result
            told = result.get("verdict", result["status"])
            message = f"{task['boat']}: {told} ({len(found)} of {len(tasks)} boats)"
            share = (len(found) - reused) / len(left)
            progress(PartialProgress(message, share, "taking the boats"))
            if kept is not None and result["status"] == "done":
                keep_part(kept, task, result)
    boats = [found[task["boat"]] for task in tasks]
    if not any(one["status"] == "done" for one in boats):
        told = "\n  ".join(f"{one['boat']}: {one['reason']}" for one in boats)
        raise UserError(f"none of the {len(boats)} boats could be done:\n  {told}")
    return FleetResult(boats, settings, reused)


def _table_rows(one: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A row for each recording of a boat, the boat's own numbers in each."""
    fit = one.get("fit", {})
    shared: dict[str, Any] = {
        "verdict": one.get("verdict"),
        "changed": one.get("verdict") in CHANGED if "verdict" in one else None,
        "names": [effect["name"] for effect in one.get("effects", [])],
        "complete": one.get("complete"),
    }
    for model in ("nominal", "diagnosed"):
        misfit = fit.get(model) or {}
        ahead = (misfit.get("free") or {}).get(HORIZON) or {}
        shared[f"misfit_{model}"] = _number(misfit.get("train"))
        shared[f"misfit_{model}_test"] = _number(misfit.get("test"))
        shared[f"position_{HORIZON}s_{model}"] = _number(ahead.get("position"))
    for row in one.get("parameters", []):
        shared[row["name"]] = row["value"]
        shared[f"{row['name']}_std"] = row["std"]
    for row in one["recordings"]:
        failed = "failed" if one["status"] == "failed" else row["status"]
        yield {
            "boat": one["boat"],
            "vessel": one["vessel"],
            "recording": row["recording"],
            "role": row["role"],
            "status": failed,
            "reason": row["reason"] or one["reason"],
            "samples": row["samples"],
            "seconds": row["seconds"],
            "idle": row.get("idle", ""),
            "audit": [finding["kind"] for finding in row["audit"]],
            **shared,
        }


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _count_done(one: dict[str, Any]) -> str:
    done = sum(row["status"] == "done" for row in one["recordings"])
    return f"{done} of {len(one['recordings'])}"


def _names(one: dict[str, Any]) -> str:
    return ", ".join(dict.fromkeys(effect["name"] for effect in one.get("effects", [])))


def _moved_text(one: dict[str, Any]) -> str:
    """The parameters that are furthest off the vessel file, in per cent."""
    moved = sorted(moved_parameters(one).items(), key=lambda item: -abs(item[1]))
    return ", ".join(f"{name} {100 * change:+.0f} %" for name, change in moved[:3])
