"""One boat of a fleet: its recordings read and audited one by one, then fitted or diagnosed.

    python -m diffsea.workflows.boat JOB RESULT

does the job of a file of JSON and writes what was found as another, in a process of its own: what
a boat needs of memory ends with it, and a boat that brings its process down takes no other along.
"""

import json
import math
import sys
from pathlib import Path
from typing import Any

from diffsea.errors import UserError
from diffsea.runtime import prepare_jax


DEPTHS = ("diagnose", "fit", "audit")
SIGNIFICANT = 3.0  # standard errors by which a number differs from the vessel file's
DETERMINED = 0.5  # share of an estimate that the data must tell


def study_boat(job: dict[str, Any]) -> dict[str, Any]:
    """What is found of a boat.

    Arguments:
        job: `boat`, `vessel`, `recordings` (each with `recording`, `mapping` or None, `role`) and
            `settings` (`until`, `minutes` or None, `per_recording`, `free` or None).

    **Returns:** `status`, done or failed, and the `reason`; `recordings`, each with its own and
    with what the audit found; and of what was fitted `verdict`, `effects`, `parameters`, `fit`.
    """
    rows, runs = _read(job["recordings"])
    _audit(rows, runs)
    result: dict[str, Any] = {"boat": job["boat"], "vessel": job["vessel"], "recordings": rows}
    try:
        if job["settings"]["until"] != "audit":
            result |= _fitted(job, rows, runs)
        elif not any(run is not None for run in runs):
            raise UserError("no recording can be read")
    except UserError as error:
        return result | {"status": "failed", "reason": str(error)}
    return result | {"status": "done", "reason": ""}


def _read(given: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[Any]]:
    """A row for each recording, and the recordings; None for one that cannot be read."""
    from diffsea.recordings import Finding
    from diffsea.workflows.audits import read_readable

    rows, runs = [], []
    for one in given:
        row = one | {
            "status": "done",
            "reason": "",
            "idle": "",
            "samples": 0,
            "seconds": 0.0,
            "audit": [],
        }
        try:
            (read,) = read_readable([one["recording"]], one["mapping"])
        except UserError as error:  # of the mapping
            rows.append(row | {"status": "failed", "reason": str(error)})
            runs.append(None)
            continue
        if isinstance(read, Finding):
            found = {"status": "failed", "reason": read.message, "audit": [read.as_dict()]}
            rows.append(row | found)
            runs.append(None)
        else:
            t = read.counted().t
            rows.append(row | {"samples": len(t), "seconds": float(t[-1] - t[0])})
            runs.append(read)
    return rows, runs


def _audit(rows: list[dict[str, Any]], runs: list[Any]) -> None:
    """Put what the audit finds into the rows of recordings that could be read."""
    from diffsea.recordings import audit_set

    readable = [k for k, run in enumerate(runs) if run is not None]
    for k, findings in zip(readable, audit_set([runs[k] for k in readable]), strict=True):
        rows[k]["audit"] = [one.as_dict() for one in findings]


def _fitted(job: dict[str, Any], rows: list[dict[str, Any]], runs: list[Any]) -> dict[str, Any]:
    """Fit or diagnosis of the recordings that suit the vessel.

    Raises:
        UserError: the vessel cannot be read, or no recording to fit is left.
    """
    import dataclasses

    from diffsea.identification.data.dataset import make_dataset
    from diffsea.recordings.idle import used_parts
    from diffsea.simulation.order_units import with_usable_actuation
    from diffsea.workflows.diagnoses import diagnose
    from diffsea.workflows.fits import fit
    from diffsea.workflows.inputs import as_vessel_file

    file, settings = as_vessel_file(job["vessel"]), job["settings"]
    kept: dict[str, list[Any]] = {"train": [], "test": []}
    for row, run in zip(rows, runs, strict=True):
        if run is None:
            continue
        try:
            (run,) = with_usable_actuation(file.vessel, [run])
            make_dataset(file.vessel, [run])
        except UserError as error:
            row |= {"status": "failed", "reason": str(error)}
            continue
        parts, row["idle"] = used_parts(dataclasses.replace(run, name=row["name"]))
        kept[row["role"]] += parts
    if not kept["train"]:
        lost = "; ".join(dict.fromkeys(row["reason"] for row in rows if row["reason"]))
        raise UserError(f"no recording is left to fit: {lost}")
    free, per_recording = settings["free"], settings["per_recording"]
    if settings["until"] == "fit":
        found = fit(file, kept["train"], kept["test"], free=free, per_recording=per_recording)
        told = {"verdict": "missing" if found.missing else "consistent", "effects": []}
        told |= {"fit": {"nominal": found.misfit}, "parameters": found.study.rows}
        return told | {"complete": True}
    seconds = math.inf if settings["minutes"] is None else 60.0 * settings["minutes"]
    diagnosed = diagnose(
        file,
        kept["train"],
        kept["test"],
        free=free,
        per_recording=per_recording,
        seconds=seconds,
    ).record
    told = {key: diagnosed[key] for key in ("verdict", "effects", "fit", "parameters")}
    return told | {"complete": diagnosed["complete"]}


def moved_parameters(result: dict[str, Any]) -> dict[str, float]:
    """Parameters that the data place beyond doubt elsewhere than the vessel file.

    **Returns:** by name, estimate over the file's number, less one.
    """
    return {
        row["name"]: row["value"] / row["start"] - 1
        for row in result.get("parameters", [])
        if row["determined"] > DETERMINED
        and row["start"]
        and abs(row["value"] - row["start"]) > SIGNIFICANT * row["std"]
    }


def main(job: str, result: str) -> None:
    """Do the job of one file and write the other."""
    prepare_jax()
    found = study_boat(json.loads(Path(job).read_text(encoding="utf-8")))
    text = json.dumps(found, default=lambda value: value.tolist())
    try:
        Path(result).write_text(text, encoding="utf-8")
    except OSError as error:
        sys.exit(f"cannot write {result}: {error.strerror}")


if __name__ == "__main__":
    main(*sys.argv[1:])
