"""What the experiments on real recordings share: split, diagnose, predict, write down."""

import dataclasses
import json
import sys
import time
from pathlib import Path

from diffsea.cli import prepare_jax


prepare_jax()

import numpy as np

from diffsea.diagnosis.experiment import next_experiment
from diffsea.diagnosis.select import Diagnosis, diagnose
from diffsea.diagnosis.summary import nominal_document, summary, vessel_document
from diffsea.recordings import audit, read_mapping, read_recording
from diffsea.report.comparison import with_held_out_errors
from diffsea.report.diagnosis_page import diagnosis_report
from diffsea.report.text import verdict_text
from diffsea.types import Trajectory
from diffsea.vessel.catalogue import build, dump, read_vessel


DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@dataclasses.dataclass(frozen=True)
class Case:
    """One set of recordings and how it is split."""

    folder: Path  # the experiment's own
    vessel: str
    recordings: dict[str, Trajectory]
    held_out: tuple[str, ...]
    per_run: bool


def load(folder: Path, pattern: str, mapping: str = "mapping.toml") -> dict[str, Trajectory]:
    """Recordings by file name; ends with a message where the data are not there."""
    files = sorted(DATA.glob(pattern))
    if not files:
        sys.exit(f"no recordings match {pattern} under ../shared/data; nothing was done")
    table = read_mapping(folder / mapping)
    return {file.name: read_recording(file, table) for file in files}


def audited(runs: dict[str, Trajectory]) -> list[dict]:
    """Findings of the audit over all runs."""
    return [finding.as_dict() for run in runs.values() for finding in audit(run)]


def study(case: Case) -> dict:
    """Diagnose the training runs, predict the others, write report and figures."""
    began = time.monotonic()

    def tell(message: str) -> None:
        print(f"[{time.monotonic() - began:5.0f} s] {message}", file=sys.stderr, flush=True)

    file = read_vessel(case.vessel)
    train = [run for name, run in case.recordings.items() if name not in case.held_out]
    test = [case.recordings[name] for name in case.held_out]
    diagnosis = diagnose(file.vessel, train, test, case.per_run, progress=tell)
    record = _record(case, diagnosis, file.document)
    print(verdict_text(record))
    return record


def _record(case: Case, diagnosis: Diagnosis, document: dict) -> dict:
    out = Path("out") / case.folder.name
    out.mkdir(parents=True, exist_ok=True)
    after, before = vessel_document(document, diagnosis), nominal_document(document, diagnosis)
    record = summary(diagnosis, audited(case.recordings))
    experiment = next_experiment(diagnosis)
    record["next_experiment"] = None if experiment is None else experiment.as_dict()
    record = with_held_out_errors(record, diagnosis, build(before), build(after))
    source = {"vessel": case.vessel, "held_out": list(case.held_out)}
    page = diagnosis_report(record, diagnosis, build(before), build(after), source)
    (out / "report.html").write_text(page, encoding="utf-8")
    (out / "vessel.toml").write_text(dump(after), encoding="utf-8")
    write_results(case.folder, record)
    return record


def write_results(folder: Path, record: dict) -> None:
    """`results.json` in the output folder: every figure of the experiment."""
    out = Path("out") / folder.name
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(record, indent=1, default=lambda value: np.asarray(value).tolist())
    (out / "results.json").write_text(text + "\n", encoding="utf-8")
