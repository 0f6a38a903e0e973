"""What the experiments on real recordings share: split, diagnose, predict, write down."""

import dataclasses
import json
import sys
import time
from pathlib import Path

from diffsea.runtime import prepare_jax


prepare_jax()

from experiments.check_data import absent, data_folder
from experiments.harness.diagnosis_tables import labelled

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from diffsea import Diagnosis, Trajectory, cut, read_mapping, read_recording, read_vessel
from diffsea.diagnosis.experiment import next_experiment
from diffsea.diagnosis.record import summary, vessel_document
from diffsea.diagnosis.verdict import diagnose
from diffsea.identification.run_models import held_out_models
from diffsea.recordings import audit
from diffsea.report.diagnosis import diagnosis_report
from diffsea.report.predictions import compare, horizon_table
from diffsea.report.wording.terminal import verdict_text
from diffsea.vessel.files import Table, build, dump


ROOT = Path(__file__).resolve().parents[2]
DATA = data_folder()
SHOWN = 8  # candidates in tables and plots


@dataclasses.dataclass(frozen=True)
class Case:
    """One diagnosis: what is fitted, what is held out."""

    name: str  # folder under out/
    document: Table  # of the vessel
    recordings: dict[str, Trajectory]
    held_out: tuple[str, ...]
    per_run: bool = False
    findings: list[dict] | None = None  # of the audit, where it has been done

    @property
    def train(self) -> list[Trajectory]:
        """What is fitted."""
        return [run for name, run in self.recordings.items() if name not in self.held_out]

    @property
    def test(self) -> list[Trajectory]:
        """What is held out."""
        return [self.recordings[name] for name in self.held_out]


def load(folder: Path, pattern: str, mapping: str = "mapping.toml") -> dict[str, Trajectory]:
    """Recordings by file name; ends with a message where the data are not there."""
    files = sorted(DATA.glob(pattern))
    if not files:
        sys.exit(absent(pattern))
    table = read_mapping(folder / mapping)
    return {file.name: read_recording(file, table) for file in files}


def spans(runs: dict[str, Trajectory], which: dict[str, tuple]) -> dict[str, Trajectory]:
    """The recordings named in `which`, each from one second to another (None: to its end)."""
    out = {}
    for name, (first, last) in which.items():
        t = np.asarray(runs[name].t)
        end = t[-1] if last is None else t[0] + last
        out[name] = cut(runs[name], float(t[0] + first), float(end))
    return out


def document_of(vessel: str) -> Table:
    """A vessel's document; ends with a message where there is none."""
    if vessel.endswith(".toml") and not Path(vessel).exists():
        sys.exit(f"{vessel} is missing; run experiments/real_fits/run.py first")
    return read_vessel(vessel).document


def audited(runs: dict[str, Trajectory]) -> list[dict]:
    """Findings of the audit over all runs."""
    return [finding.as_dict() for run in runs.values() for finding in audit(run)]


def show_audit(title: str, findings: list[dict]) -> None:
    """Print what an audit found."""
    print(f"audit {title}: {len(findings) or 'no'} findings")
    for finding in findings:
        print(f"  {finding['recording']}: {finding['kind']}: {finding['message']}")


def study(case: Case) -> dict:
    """Diagnose the training runs, predict the others, write report and figures."""
    began = time.monotonic()

    def tell(message: str) -> None:
        print(f"[{time.monotonic() - began:5.0f} s] {case.name}: {message}", file=sys.stderr,
              flush=True)  # fmt: skip

    diagnosis = diagnose(
        build(case.document), case.train, case.test, case.per_run, progress=tell
    )  # fmt: skip
    record = _record(case, diagnosis)
    record["seconds"] = time.monotonic() - began
    write_results(case.name, record)
    show(case.name, record)
    return record


def _record(case: Case, diagnosis: Diagnosis) -> dict:
    after = vessel_document(case.document, diagnosis)
    findings = audited(case.recordings) if case.findings is None else case.findings
    experiment = next_experiment(diagnosis)
    proposal = None if experiment is None else experiment.as_dict()
    split = diagnosis.split
    before, with_names = (
        held_out_models(split, one) for one in (diagnosis.nominal, diagnosis.final)
    )
    runs = compare(split.held_out, before, with_names if diagnosis.names else None)
    record = summary(diagnosis, findings, horizon_table(runs), proposal)
    source = {"vessel": str(case.document["name"]), "held_out": list(case.held_out)}
    page = diagnosis_report(record, str(case.document["name"]), split, runs, source)
    out = out_folder(case.name)
    (out / "report.html").write_text(page, encoding="utf-8")
    (out / "vessel.toml").write_text(dump(after), encoding="utf-8")
    return record


def show(title: str, record: dict) -> None:
    """Print the verdict, the best candidates and the errors of predictions."""
    print(f"\n== {title}: {record['seconds']:.0f} s\n{verdict_text(record)}")
    print(f"p {record['null']['p_value']:.2g}, of what is left {record['remainder_p_value']:.2g}; "
          f"misfit over noise {record['fit']}")  # fmt: skip
    for row in record["candidates"][:SHOWN]:
        values = ", ".join(_valued(*item) for item in row.get("parameters", {}).items())
        told = f"  {labelled(row)}: {row['status']} ({row['reason']}), log10 odds "
        told += f"{row['log10_odds']:.1f}"
        if "held_out_gain" in row:
            told += f", held-out {row['held_out_gain']:.0f} +- {row['held_out_gain_std']:.0f}"
        print(f"{told}; {values}")
    for row in record["held_out"]["horizons"]:
        before, after = row["nominal"], row["diagnosed"]
        pairs = ", ".join(f"{k} {before[k]:.3g} -> {after[k]:.3g}" for k in before)
        print(f"  {row['seconds']:g} s ahead ({row['starts']} starts): {pairs}")


def _valued(name: str, entry: dict) -> str:
    return f"{name} {entry['value']:.3g} +- {entry['std']:.2g} {entry['unit']}"


def named(record: dict) -> list[str]:
    """Names that a diagnosis gave, each once."""
    return list(dict.fromkeys(labelled(effect) for effect in record["effects"]))


def plot_candidates(name: str, records: dict[str, dict]) -> None:
    """Odds of the best candidates of every diagnosis, those accepted dark."""
    figure = Figure(figsize=(8.0, 0.4 + 2.0 * len(records)), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(records), 1, squeeze=False)[:, 0]
    colours = {"accepted": "#1f5fa8", "rival": "#d1720f"}
    for axes, (title, record) in zip(rows, records.items(), strict=True):
        shown = record["candidates"][:SHOWN][::-1]
        axes.barh(
            [f"{k} {labelled(row)}" for k, row in enumerate(shown)],
            [row["log10_odds"] for row in shown],
            color=[colours.get(row["status"], "#b8c0c8") for row in shown],
        )
        axes.set_yticks(range(len(shown)), [labelled(row) for row in shown], fontsize=7)
        axes.set_xscale("symlog")
        axes.set_title(f"{title}: {record['verdict']}", fontsize=9, loc="left")
    rows[-1].set_xlabel("log10 odds of the effect against the nominal model, one at a time")
    figure.savefig(out_folder(name) / "candidates.png", dpi=110)


def out_folder(name: str) -> Path:
    """The output folder, made where it is missing."""
    out = Path("out") / name
    out.mkdir(parents=True, exist_ok=True)
    return out


def write_results(name: str, record: dict) -> None:
    """`results.json` in the output folder: every figure of the experiment."""
    text = json.dumps(record, indent=1, default=lambda value: np.asarray(value).tolist())
    (out_folder(name) / "results.json").write_text(text + "\n", encoding="utf-8")
