"""What is known of a set without its recordings: for drawing cases of it.

Imports nothing of the tool.
"""

import math
from collections.abc import Iterable
from typing import Any

from experiments.concealed_real.material import Document, Material, Runs, parts_of, step_of

import numpy as np


SMOOTH = 0.2  # of its range: how far a continuous actuation moves within a row
MOVING = 0.05  # of its largest value: the range of an actuation that is used
KINDS = {"thruster": "thruster", "propeller": "propeller", "rudder": "rudder"}

Features = dict[str, Any]


def features(material: Material) -> Features:
    """Columns, actuators and scatter of a set, for drawing without its recordings."""
    runs = material.runs
    columns = sorted(set.intersection(*(set(run) for run in runs.values())))
    of = {c: np.concatenate([run[c].to_numpy() for run in runs.values()]) for c in columns}
    largest = {c: float(np.nanmax(np.abs(values))) for c, values in of.items()}
    moves = [c for c in columns if c.startswith(("cmd_", "exec_"))]
    return {
        "columns": columns,
        "step": min(step_of(run) for run in runs.values()),
        "shortest": min(float(run["t"].iloc[-1] - run["t"].iloc[0]) for run in runs.values()),
        "largest": largest,
        "scatter": {c: _scatter(runs, c) for c in columns if c != "t"},
        "moving": [c for c in moves if np.ptp(of[c]) > MOVING * largest[c]],
        "smooth": [c for c in moves if _is_smooth(runs, c)],
        **_actuators(material.document, moves),
    }


def _actuators(document: Document, columns: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Kind and side of the actuator of every column of actuation."""
    kinds: dict[str, str] = {}
    sides: dict[str, float] = {}
    parts = {part["name"]: (kind, part) for kind, part in parts_of(document)}
    for column in columns:
        name, _, channel = column.split("_", 1)[1].partition(".")
        if name in parts:
            kind, part = parts[name]
            usual = "angle" if channel == "angle" else "azimuth"
            kinds[column] = KINDS.get(kind, usual)
            sides[column] = float(np.sign(part.get("y", 0.0)))
    return {"kinds": kinds, "sides": sides}


def _scatter(runs: Runs, column: str) -> float:
    """White scatter of a channel from row to row, from its second differences."""
    bends = np.concatenate([np.diff(run[column].to_numpy(), 2) for run in runs.values()])
    bends = np.abs(bends[np.isfinite(bends) & (bends != 0)])
    return float(np.median(bends) / 0.6745 / math.sqrt(6)) if bends.size else 0.0


def _is_smooth(runs: Runs, column: str) -> bool:
    """Whether an actuation moves continuously: never far within a row."""
    widest = max(float(np.ptp(run[column].to_numpy())) for run in runs.values())
    jump = max(float(np.max(np.abs(np.diff(run[column].to_numpy())))) for run in runs.values())
    return 0 < jump < SMOOTH * widest
