"""`fit` and `diagnose`: from recordings to a vessel, and to what its model lacks."""

import argparse
import pathlib
import sys
import time
from typing import TYPE_CHECKING, Any

from diffsea.cli.options import (
    Outputs,
    add_command,
    add_recordings,
    add_vessel,
    names,
    progress,
    read_recordings,
    read_vessel,
    table,
)


if TYPE_CHECKING:
    from diffsea.identification.estimates import Estimate
    from diffsea.identification.problem import Problem
    from diffsea.types import Trajectory


ANCHOR = (
    "mass, moment of inertia, centre of gravity and actuators stay as in the vessel file: "
    "motion alone fixes mass, drag and thrust only up to one common factor"
)


def register(commands: Any) -> None:
    """Add the two commands to the parser."""
    fit = add_command(
        commands, "fit", _fit, "identify a vessel's derivatives from recordings",
        "Fits hull derivatives to recordings by an innovation-form likelihood, with standard\n"
        "errors, and predicts runs that were held out.",
        "  diffsea fit usv.toml run1.csv run2.csv --test run3.csv\n"
        "  diffsea fit usv.toml run*.csv --free X_u,X_uu,N_r,Y_v",
    )  # fmt: skip
    _common(fit)
    diagnose = add_command(
        commands, "diagnose", _diagnose, "find the physics that the model leaves out",
        "Locates where model and recordings differ, names what was left out, models it and\n"
        "shows the fit improve on data that was held out.",
        "  diffsea diagnose usv.toml run*.csv --test other*.csv\n"
        "  diffsea diagnose ship.toml a.csv b.csv --environment per-recording",
    )  # fmt: skip
    _common(diagnose)
    diagnose.add_argument(
        "--environment", choices=("shared", "per-recording"), default="shared",
        help="whether wind and current are the same in all recordings (default: %(default)s)",
    )  # fmt: skip


def _common(parser: argparse.ArgumentParser) -> None:
    add_vessel(parser)
    add_recordings(parser)
    parser.add_argument(
        "--free", metavar="NAMES", type=names,
        help="parameters to estimate, separated by commas (default: the hull's derivatives)",
    )  # fmt: skip
    parser.add_argument(
        "--test", metavar="RECORDING", nargs="+", type=pathlib.Path, default=[],
        help="recordings to hold out for judging",
    )  # fmt: skip


def _read(args: argparse.Namespace) -> "tuple[list[Trajectory], list[Trajectory]]":
    runs = read_recordings([*args.recordings, *args.test], args.mapping)
    return runs[: len(args.recordings)], runs[len(args.recordings) :]


def _clock() -> Any:
    """Progress with the seconds since the start."""
    began = time.monotonic()

    def tell(message: str) -> None:
        progress(f"[{time.monotonic() - began:5.0f} s] {message}")

    return tell


def _source(args: argparse.Namespace, runs: "list[Trajectory]") -> dict:
    import importlib.metadata

    versions = {n: importlib.metadata.version(n) for n in ("diffsea", "jax", "optimistix")}
    return {
        "vessel": str(args.vessel),
        "recordings": {run.name: list(run.provenance) for run in runs},
        "versions": versions,
        "python": sys.version.split()[0],
    }


def _fit(args: argparse.Namespace) -> None:
    with Outputs(args.output) as out:
        from diffsea.identification.estimates import physical_table
        from diffsea.identification.fit import estimate, normalised_rms
        from diffsea.identification.problem import make_problem
        from diffsea.report.fit_page import fit_report
        from diffsea.vessel.catalogue import build, dump, updated_document

        tell = _clock()
        file = read_vessel(args)
        runs, test = _read(args)
        tell(f"reading: {len(runs)} recordings, {len(test)} held out; compiling")
        problem = make_problem(file.vessel, runs, args.free)
        free = tuple(p.name for p in problem.layout.parameters)
        history: list[str] = []

        def follow(message: str) -> None:
            history.append(message)
            tell(message)

        fitted = estimate(problem, free, progress=follow)
        rows = physical_table(problem.layout.parameters, fitted)
        document = updated_document(file.document, {r["name"]: r["value"] for r in rows}, [])
        vessel = build(document)
        quality = {"train": normalised_rms(problem, fitted.coordinates, fitted.noise)}
        if test:
            held = make_problem(file.vessel, test, free)
            quality["test"] = normalised_rms(held, fitted.coordinates, fitted.noise)
        source = _source(args, [*runs, *test])
        result = {
            "format": 1,
            "parameters": {row["name"]: _record(row) for row in rows},
            "anchor": ANCHOR,
            "fit": quality,
            "noise": _noise(problem, fitted),
            "deviance": fitted.deviance,
            "source": source,
        }
        out.path("vessel.toml").write_text(dump(document), encoding="utf-8")
        out.json("fit.json", result)
        page = fit_report(rows, history, vessel, runs, test, source)
        out.path("report.html").write_text(page, encoding="utf-8")
    out.present(args, _fit_summary(rows, quality))


def _record(row: dict) -> dict:
    from diffsea.priors import unit

    return {key: row[key] for key in ("start", "value", "std", "determined")} | {
        "unit": unit(row["name"])
    }


def _noise(problem: "Problem", fitted: "Estimate") -> dict:
    import numpy as np

    scales = {name: np.exp(part) for name, part in vars(fitted.noise).items()}
    names = ("x", "y", "psi", "u", "v", "r")
    measured = _by_name(names, np.asarray(problem.tape.known).any(0))
    return {
        "gust": _by_name(names[3:], scales["gust"]),
        "lasting_gust": _by_name(names[3:], scales["slow"]),
        "gust_memory": _by_name(names[3:], scales["memory"]),
        "sensor": {n: s for n, s in _by_name(names, scales["sensor"]).items() if measured[n]},
    }


def _by_name(names: tuple[str, ...], values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _fit_summary(rows: list[dict], quality: dict) -> str:
    from diffsea.priors import unit

    lines = [
        (
            row["name"], unit(row["name"]), f"{row['start']:.4g}", f"{row['value']:.4g}",
            f"{row['std']:.2g}", _determined(row["determined"]),
        )
        for row in rows
    ]  # fmt: skip
    header = ("parameter", "unit", "start", "estimate", "+-", "determined by")
    told = ", ".join(f"{name} {value:.2f}" for name, value in quality.items())
    return f"{table(lines, header)}\n\nnormalised innovation (1 = noise level): {told}\n{ANCHOR}"


def _determined(share: float) -> str:
    if share > 0.9:
        return "the recordings"
    return "mostly the recordings" if share > 0.5 else "mostly the prior"


def _diagnose(args: argparse.Namespace) -> None:
    with Outputs(args.output) as out:
        from diffsea.diagnosis.experiment import next_experiment
        from diffsea.diagnosis.select import diagnose
        from diffsea.diagnosis.summary import nominal_document, summary, vessel_document
        from diffsea.recordings import audit
        from diffsea.report.comparison import with_held_out_errors
        from diffsea.report.diagnosis_page import diagnosis_report
        from diffsea.report.text import verdict_text
        from diffsea.vessel.catalogue import build, dump

        tell = _clock()
        file = read_vessel(args)
        runs, test = _read(args)
        tell(f"auditing {len(runs) + len(test)} recordings")
        findings = [f.as_dict() for run in [*runs, *test] for f in audit(run)]
        per_run = args.environment == "per-recording"
        diagnosis = diagnose(file.vessel, runs, test, per_run, args.free, tell)
        result = summary(diagnosis, findings)
        tell("looking for the manoeuvre that would tell more")
        experiment = next_experiment(diagnosis)
        result["next_experiment"] = None if experiment is None else experiment.as_dict()
        result["source"] = _source(args, [*runs, *test])
        tell("writing the report")
        document = vessel_document(file.document, diagnosis)
        nominal = build(nominal_document(file.document, diagnosis))
        diagnosed = build(document)
        result = with_held_out_errors(result, diagnosis, nominal, diagnosed)
        page = diagnosis_report(result, diagnosis, nominal, diagnosed, result["source"])
        out.json("diagnosis.json", result)
        out.path("vessel.toml").write_text(dump(document), encoding="utf-8")
        out.path("report.html").write_text(page, encoding="utf-8")
    out.present(args, verdict_text(result))
