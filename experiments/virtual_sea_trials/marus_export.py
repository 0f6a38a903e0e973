"""The identification-ready data set: segments, the log of eq. 9, diagnostics, one record."""

import json
from pathlib import Path

from experiments.virtual_sea_trials import marus_trials

import numpy as np

from diffsea import Vessel
from diffsea.segments import export
from diffsea.segments.export import record


def exported(folder: Path, logged: list[marus_trials.Logged], vessel: Vessel) -> dict:
    """Write every trial's segment and its log, and `segments.json` beside them.

    The segment is a recording that `diffsea fit` reads as it stands, time from the onset; the
    log has the columns of eq. 9 besides. Checks go into the record.
    """
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for one in logged:
        found = export(one.log, [one.segment], folder, checks={0: one.checks})
        path = folder / f"{one.run.name}-log.csv"
        columns = marus_trials.state_log(one.log, one.segment.onset)
        values = np.column_stack(list(columns.values()))
        np.savetxt(path, values, "%.8g", ",", header=",".join(columns), comments="")
        entries.append({"recording": one.run.name, "log": path.name, "segments": found})
    told = record(entries)
    text = json.dumps(told, indent=1, default=lambda value: np.asarray(value).tolist())
    (folder / "segments.json").write_text(text + "\n", encoding="utf-8")
    return told
