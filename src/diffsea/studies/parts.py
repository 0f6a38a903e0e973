"""A sweep done part by part, each part a Parquet file that is kept as soon as it is finished.

Parts lie in a folder named by the hash of all that they rest on: the vessel's numbers, the plan of
the trial, the designs, how they are divided, and the versions. Whoever asks for the same again,
after a kill, on another day or as another shard, finds there what is done.
"""

import contextlib
import dataclasses
import hashlib
import importlib.metadata
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from diffsea.errors import UserError
from diffsea.outside.cluster import RETRIES, Failed, connected
from diffsea.outside.documents import read_json
from diffsea.outside.durable import written_beside
from diffsea.outside.unfinished import clear_abandoned
from diffsea.parameters import parameter_unit
from diffsea.progress import PartialProgress, Progress, no_progress
from diffsea.simulation.designs import OF_THE_TRIAL, DesignSpace, check_count
from diffsea.simulation.standard import TrialPlan
from diffsea.studies.sweep import Sweeper, SweepResult, check_names
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import default_priors


if TYPE_CHECKING:
    from distributed import Client

PART = 4096  # designs of a part: seconds of work
MANIFEST = "manifest.json"
TOLD = 6  # failed parts that a message names


@dataclasses.dataclass(frozen=True)
class Parts:
    """The parts of one sweep: where they are, and what they are of.

    `manifest` has `vessel` (name), `manoeuvre`, `designs`, `part` (designs of each), `parts` (how
    many), `space` (what the designs follow from), `parameters`, their `units` and `versions`.
    """

    folder: Path
    manifest: dict[str, Any]

    @property
    def count(self) -> int:
        """How many parts there are to be."""
        return self.manifest["parts"]

    def file(self, number: int) -> Path:
        """Of a part, done or not."""
        return self.folder / f"part-{number:08d}.parquet"

    def rows(self, number: int) -> tuple[int, int]:
        """The first design of a part, and the one after its last."""
        size = self.manifest["part"]
        return number * size, min((number + 1) * size, self.manifest["designs"])

    def unit_of(self, parameter: str) -> str:
        """The unit of what is swept, empty where the manifest tells none."""
        units = self.manifest.get("units")
        return str(units.get(parameter, "")) if isinstance(units, dict) else ""

    def is_done(self, number: int) -> bool:
        """Whether a part is there as a whole."""
        begin, end = self.rows(number)
        try:
            return pq.read_metadata(self.file(number)).num_rows == end - begin
        except (OSError, pa.ArrowException):
            return False

    def missing(self) -> Iterator[int]:
        """Numbers of the parts that are not done."""
        return (number for number in range(self.count) if not self.is_done(number))

    def keep(self, number: int, table: pd.DataFrame) -> None:
        """Write a part, the whole of it or nothing.

        Raises:
            UserError: it cannot be written.
        """
        file = self.file(number)
        try:
            with written_beside(file) as beside, beside.open("wb") as opened:
                pq.write_table(as_arrow(table), opened)
        except OSError as error:
            raise UserError(f"cannot write {file}: {error.strerror}") from None


class PartsFailedError(UserError):
    """Parts failed on a cluster as often as they were tried; all others are done."""


def as_arrow(table: pd.DataFrame) -> pa.Table:
    """Numbers and text, missing ones null, whatever is missing."""
    columns = {
        str(name): pa.array(column, pa.float64() if column.dtype.kind == "f" else pa.string())
        for name, column in table.items()
    }
    return pa.table(columns)


def _units(vessel: Vessel, names: Sequence[str]) -> dict[str, str]:
    """Units of what is swept, empty where there is none."""
    known = {name: prior.unit for name, prior in default_priors(vessel).items()} | OF_THE_TRIAL
    return {name: known.get(name) or parameter_unit(name) for name in names}


def parts_of(
    folder: Path,
    vessel: Vessel,
    document: Mapping[str, Any],
    plan: TrialPlan,
    space: DesignSpace,
    part: int = PART,
) -> Parts:
    """The parts of a sweep in a folder of sweeps; nothing is written.

    Arguments:
        document: of the vessel file.
        part: designs of each part.

    Raises:
        UserError: a name that is no parameter, or too many designs.
    """
    check_names(vessel, space.names)
    check_count(space.count)
    manifest = {
        "format": 1,
        "vessel": vessel.name,
        "manoeuvre": plan.manoeuvre,
        "designs": space.count,
        "part": part,
        "parts": -(-space.count // part),
        "parameters": list(space.names),
        "units": _units(vessel, space.names),
        "space": space.as_dict(),
        "versions": {name: importlib.metadata.version(name) for name in ("diffsea", "jaxlib")},
    }
    rests_on = {"manifest": manifest, "document": document, "plan": repr(plan)}
    text = json.dumps(rests_on, sort_keys=True, default=str)
    key = hashlib.sha256(text.encode()).hexdigest()[:16]
    return Parts(folder / key, manifest | {"key": key})


def read_parts(folder: Path) -> Parts:
    """The parts that lie in a folder, or in the one sweep of a folder of sweeps.

    Raises:
        UserError: there are none, or of several sweeps.
    """
    if not (folder / MANIFEST).is_file():
        found = sorted(file.parent for file in folder.glob(f"*/{MANIFEST}"))
        if not found:
            raise UserError(f"{folder} holds no parts of a sweep; name the folder of --parts")
        if len(found) > 1:
            told = ", ".join(str(one) for one in found)
            raise UserError(f"{folder} holds several sweeps; name one of {told}")
        folder = found[0]
    manifest = read_json(folder / MANIFEST, "the manifest of a sweep")
    numbers = ("designs", "part", "parts")
    if not isinstance(manifest, dict) or not all(isinstance(manifest.get(n), int) for n in numbers):
        raise UserError(f"{folder / MANIFEST} is no manifest of a sweep")
    return Parts(folder, manifest)


@dataclasses.dataclass(frozen=True)
class PartRunner:
    """Runs the parts of a sweep by number, in this process or in that of a worker."""

    parts: Parts
    vessel: Vessel
    plan: TrialPlan
    space: DesignSpace

    @cached_property
    def _sweeper(self) -> Sweeper:
        return Sweeper(self.vessel, self.plan, min(self.parts.manifest["part"], self.space.count))

    def __call__(self, number: int, progress: Progress = no_progress) -> SweepResult:
        """Run a part; nothing is written."""
        designs = self.space.rows(*self.parts.rows(number))
        return self._sweeper.run(designs, progress, whole=True)


def do_parts(
    parts: Parts,
    vessel: Vessel,
    plan: TrialPlan,
    space: DesignSpace,
    shard: tuple[int, int] = (1, 1),
    progress: Progress = no_progress,
    cluster: "Client | str | None" = None,
) -> int:
    """Do what is not done of the parts of a shard; one part is held at a time.

    Arguments:
        shard: its number, from one on, and how many there are: it does every n-th part.
        cluster: whose workers do the parts, a client or a scheduler's address; this process if
            None.

    **Returns:** how many of them were done before.

    Raises:
        UserError: a part cannot be written, or the cluster cannot be used.
        PartsFailedError: parts failed on the cluster; all others are kept.
    """
    own = range(shard[0] - 1, parts.count, shard[1])
    left = [number for number in own if not parts.is_done(number)]
    done, failed = len(own) - len(left), {}
    run = PartRunner(parts, vessel, plan, space)
    with contextlib.ExitStack() as stack:
        if cluster is not None and left:
            results = stack.enter_context(connected(cluster, progress)).results(run, left)
        else:
            results = _run_in_turn(run, left, done, progress)
        _make_folder(parts)
        if done:
            progress(f"{done} of {len(own)} parts were done before, in {parts.folder}")
        kept = done
        for number, found in results:
            if isinstance(found, Failed):
                failed[number] = found.reason
                continue
            parts.keep(number, found.table)
            kept += 1
            rate = f"{found.steps_per_second:.2g} vessel-steps/s"
            told = f"{kept} of {len(own)} parts done, {rate}"
            progress(PartialProgress(told, kept / len(own)))
    if failed:
        raise PartsFailedError(_failure_text(parts, failed))
    return done


def _make_folder(parts: Parts) -> None:
    """The folder of the parts with its manifest.

    Raises:
        UserError: it cannot be written.
    """
    try:
        parts.folder.mkdir(parents=True, exist_ok=True)
        clear_abandoned(parts.folder)
        if not (parts.folder / MANIFEST).exists():
            with written_beside(parts.folder / MANIFEST) as beside:
                beside.write_text(json.dumps(parts.manifest, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        where = error.filename or parts.folder
        raise UserError(f"cannot write {where}: {error.strerror}") from None


def _run_in_turn(
    run: PartRunner, left: Sequence[int], done: int, progress: Progress
) -> Iterator[tuple[int, SweepResult]]:
    """Parts with what is found of them, one after the other in this process."""
    for before, number in enumerate(left, done):
        yield number, run(number, partial(_share_of_all, progress, before, done + len(left)))


def _failure_text(parts: Parts, failed: Mapping[int, str]) -> str:
    """Which parts failed on a cluster, each with its designs and why."""
    lines = []
    for number, reason in sorted(failed.items())[:TOLD]:
        begin, end = parts.rows(number)
        lines.append(f"part {number} (designs {begin} to {end - 1}): {reason}")
    more = [f"and {len(failed) - TOLD} more"] if len(failed) > TOLD else []
    tries = f"{len(failed)} of {parts.count} parts failed, each tried {RETRIES + 1} times or more:"
    return "\n  ".join([tries, *lines, *more])


def _share_of_all(progress: Progress, done: int, count: int, message: str) -> None:
    """Tell what a part tells; a share of the part as that which it is of all parts."""
    if isinstance(message, PartialProgress):
        message = PartialProgress(message, (done + message.share) / count)
    progress(message)
