"""What one diagnosis is given: a vessel's document, runs that are fitted, runs that are held out.

Runs are tables with native columns (`t`, `x`, ..., `cmd_<actuator>`), in SI units and radians.
Needs nothing of the tool.
"""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from jaxtyping import Float


Run = pd.DataFrame
Runs = dict[str, Run]  # by the name of the recording's file
Document = dict[str, Any]  # the content of a vessel file
Settings = dict[str, Any]  # of one injection: its size, and where and when it acts
Series = Float[np.ndarray, "time"]

MOTION = ("x", "y", "psi", "u", "v", "r")
ACTUATORS = ("thruster", "azimuth_thruster", "propeller", "rudder", "tunnel_thruster")


@dataclasses.dataclass(frozen=True)
class Material:
    """A vessel and its recordings."""

    document: Document
    train: Runs
    test: Runs
    per_recording: bool = False  # whether wind and current are each recording's own

    @property
    def runs(self) -> Runs:
        """All runs, those that are fitted first."""
        return self.train | self.test

    def with_runs(self, change: Callable[[Run], Run]) -> "Material":
        """The same with every run changed alike."""
        return dataclasses.replace(
            self,
            train={name: change(run) for name, run in self.train.items()},
            test={name: change(run) for name, run in self.test.items()},
        )

    def write(self, folder: Path) -> tuple[Path, list[Path], list[Path]]:
        """Write vessel.toml and the runs; the vessel's path, those of what is fitted and held out.

        Runs are written at full precision, under the names that they have, as CSV.
        """
        folder.mkdir(parents=True, exist_ok=True)
        vessel = folder / "vessel.toml"
        vessel.write_text(tomli_w.dumps(self.document), encoding="utf-8")
        paths: dict[str, list[Path]] = {"train": [], "test": []}
        for part, runs in (("train", self.train), ("test", self.test)):
            (folder / part).mkdir(exist_ok=True)
            for name, run in runs.items():
                path = folder / part / f"{Path(name).stem}.csv"
                run.to_csv(path, index=False)
                paths[part].append(path)
        return vessel, paths["train"], paths["test"]


def orders(run: Run) -> list[str]:
    """The columns with orders."""
    return [name for name in run.columns if name.startswith("cmd_")]


def measured_actuation(run: Run) -> list[str]:
    """The columns with measured actuation."""
    return [name for name in run.columns if name.startswith("exec_")]


def step_of(run: Run) -> float:
    """The usual time between rows, s."""
    return float(np.median(np.diff(run["t"].to_numpy())))


def replaced(run: Run, columns: dict[str, Series]) -> Run:
    """A copy of a run with some columns replaced."""
    return run.assign(**columns)


def parts_of(document: Document) -> Iterable[tuple[str, dict[str, Any]]]:
    """Kind and table of every actuator of a vessel."""
    return ((kind, part) for kind in ACTUATORS for part in document.get(kind, ()))
