"""What a fit or a diagnosis is given, and where its results come from."""

import importlib.metadata
import itertools
import pathlib
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from diffsea.errors import UserError
from diffsea.identification.objectives.trial_numbers import (
    MeasuredTrial,
    is_trial_table,
    read_trial_table,
)
from diffsea.progress import Progress, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.recordings.auditing.actuators import stale_feedback
from diffsea.simulation.actuation import how_actuated, with_common_feedback
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import (
    VesselFile,
    read_vessel,
)
from diffsea.workflows.audits import Recording, as_used_recordings


def as_vessel_file(given: VesselFile | str | pathlib.Path) -> VesselFile:
    """A vessel file as it is, or read. Raises `UserError` as `read_vessel` does."""
    return given if isinstance(given, VesselFile) else read_vessel(given)


class FittedData(NamedTuple):
    """What a fit is given: recordings and trials of sheets to fit, and recordings held out."""

    recordings: list[Trajectory]
    trials: list[MeasuredTrial]
    test: list[Trajectory]


def fitted_data(
    vessel: Vessel,
    data: Recording | MeasuredTrial | Iterable[Recording | MeasuredTrial],
    test: Recording | Iterable[Recording] = (),
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    keep_idle: bool = False,
    progress: Progress = no_progress,
) -> FittedData:
    """Recordings and sheets told apart, and read where they are files.

    Arguments:
        keep_idle: whether idle stretches of logs stay in.

    Raises:
        UserError: a file that cannot be read, or a test where there is nothing to judge by it.
    """
    given = [data] if isinstance(data, Recording | MeasuredTrial) else list(data)
    trials: list[MeasuredTrial] = []
    runs: list[Recording] = []
    for one in given:
        if isinstance(one, MeasuredTrial):
            trials.append(one)
        elif isinstance(one, str | pathlib.Path) and is_trial_table(one):
            trials += read_trial_table(one, vessel)
        else:
            runs.append(one)
    tests: list[Recording] = [test] if isinstance(test, Recording) else list(test)
    check_held_out(tests, bool(runs))
    fitted, held_out = (
        as_used_recordings(some, mapping, keep_idle, progress) for some in (runs, tests)
    )
    return FittedData(fitted, trials, held_out)


def with_same_feedback(
    vessel: Vessel, progress: Progress, *several: list[Trajectory]
) -> list[list[Trajectory]]:
    """All lists with the measured actuation that all runs have, which says what is left out."""
    whole = [run for some in several for run in some]
    stale = {channel for run in whole for channel in stale_feedback(run)}
    common, notes = with_common_feedback(vessel, whole, stale)
    for note in notes:
        progress(note)
    rest = iter(common)
    return [list(itertools.islice(rest, len(some))) for some in several]


def check_held_out(test: Sequence[Recording], recorded: bool) -> None:
    """Refuse sheets among what is held out, and a test where no recordings are fitted.

    Raises:
        UserError: as said.
    """
    for one in test:
        if isinstance(one, str | pathlib.Path) and is_trial_table(one):
            raise UserError(f"--test takes recordings, and {one} is a sheet of trial numbers")
    if test and not recorded:
        raise UserError("--test takes recordings, and a fit to trial numbers has none to hold out")


def provenance(
    file: VesselFile,
    runs: Sequence[Trajectory],
    test: Sequence[Trajectory],
    reference: Sequence[Trajectory] = (),
) -> dict[str, Any]:
    """What was run on what: vessel, recordings, where actuation came from, versions."""
    versions = {n: importlib.metadata.version(n) for n in ("diffsea", "jax", "optimistix")}
    return {
        "vessel": file.path,
        "recordings": {run.name: list(run.provenance) for run in [*runs, *test, *reference]},
        "actuation": {
            use: how_actuated(file.vessel, list(some))
            for use, some in (("fitted", runs), ("held out", test), ("reference", reference))
            if some
        },
        **({"reference": [run.name for run in reference]} if reference else {}),
        "versions": versions,
        "python": sys.version.split()[0],
    }
