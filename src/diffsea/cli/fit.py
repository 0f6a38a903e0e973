"""`fit`: from recordings, or a sheet of trial numbers, to a vessel file."""

import argparse
import dataclasses
import pathlib
from typing import TYPE_CHECKING, Any

from diffsea.cli.diagnose import add_common, clock, read_all
from diffsea.cli.options import Outputs, add_command, count, names, one_of, read_vessel, table
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.identification.study import FitSettings, Study
    from diffsea.trajectory import Trajectory
    from diffsea.vessel.base import Vessel


# Written out because asking the library would import JAX; a test compares the two.
OBJECTIVES = ("innovation", "free-run", "trial-numbers")
ANCHORS = ("mass", "thrust")

_FIT = """\
Fits a vessel's parameters, with standard errors, and predicts runs that were held out. By
default hull derivatives and added masses to recordings by an innovation-form likelihood, gusts
and sensor noise estimated; --objective free-run by multiple shooting instead. A TOML sheet of
trial numbers (advance, diameters, overshoots) in place of recordings is fitted as it is.
Says which combinations the data do not determine, and the manoeuvre to record next.
"""
_EXAMPLES = """\
  diffsea fit usv.toml run1.csv run2.csv --test run3.csv
  diffsea fit usv.toml run*.csv --free X_u,X_uu,N_r,Y_v --starts 8
  diffsea fit usv.toml run*.csv --priors known.toml --anchor thrust
  diffsea fit ship.toml sea_trial.toml"""


def register(commands: Any) -> None:
    """Add the command to the parser."""
    fit = add_command(
        commands, "fit", _fit, "identify a vessel's derivatives from recordings", _FIT, _EXAMPLES
    )
    add_common(fit)
    fit.add_argument(
        "--objective", metavar="O", type=one_of(OBJECTIVES, "objective"),
        help=f"{' | '.join(OBJECTIVES)} (default: innovation; trial-numbers for a sheet)",
    )  # fmt: skip
    fit.add_argument(
        "--priors", metavar="FILE", type=pathlib.Path,
        help="TOML file of starts, prior widths and bounds by parameter",
    )  # fmt: skip
    fit.add_argument(
        "--anchor", choices=ANCHORS, default="mass",
        help="what fixes the scale of forces; with thrust, mass and inertia are fitted "
        "(default: %(default)s)",
    )  # fmt: skip
    fit.add_argument(
        "--starts", metavar="N", type=count, default=1,
        help="starts drawn from the priors, explored at once (default: %(default)s)",
    )  # fmt: skip
    fit.add_argument(
        "--profile", metavar="NAMES", type=names,
        help="parameters whose intervals come from the profile likelihood, `none` for none "
        "(default: those whose likelihood is asymmetric)",
    )  # fmt: skip
    fit.add_argument(
        "--effects", metavar="NAMES", type=names, default=(),
        help="effects of the catalogue to estimate besides, for example current,wind",
    )  # fmt: skip
    fit.add_argument(
        "--environment", choices=("shared", "per-recording"), default="shared",
        help="whether wind and current are the same in all recordings (default: %(default)s)",
    )  # fmt: skip


def _fit(args: argparse.Namespace) -> None:
    with Outputs(args.output) as out:
        from diffsea.identification.study import identify
        from diffsea.report.comparison import horizon_table
        from diffsea.report.fit import compare_fit, fit_report, worse_warning
        from diffsea.vessel.files import build, dump, updated_document
        from diffsea.workflows.identification import provenance

        tell = clock()
        file = read_vessel(args)
        data, test = _data(args, file.vessel)
        runs = [] if _from_sheet(args) else data
        settings = _settings(args, file.vessel)
        tell(f"reading: {len(data)} to fit, {len(test)} held out; compiling")
        history: list[str] = []

        def follow(message: str) -> None:
            history.append(message)
            tell(message)

        study = identify(file.vessel, data, settings, follow)
        document = updated_document(file.document, study.values, study.effect_tables)
        vessel = build(document)
        quality = study.quality(test)
        told = provenance(file, runs, test)
        tell("predicting and writing the report")
        predicted = compare_fit(study, file.vessel, vessel, (runs, test))
        out.path("vessel.toml").write_text(dump(document), encoding="utf-8")
        record = _record(study, settings, quality, told)
        out.json("fit.json", record | {"predictions": horizon_table(predicted)})
        page = fit_report(study, quality, history, predicted, (runs, test), told)
        out.path("report.html").write_text(page, encoding="utf-8")
    out.present(args, _summary(study, quality, worse_warning(predicted)))


def _from_sheet(args: argparse.Namespace) -> bool:
    from diffsea.identification.objectives.trial_numbers import is_trial_table

    sheets = [is_trial_table(path) for path in args.recordings]
    if any(sheets) and not all(sheets):
        raise UserError("give either recordings or sheets of trial numbers (TOML), not both")
    if all(sheets) and args.test:
        raise UserError("--test takes recordings, and a fit to trial numbers has none to hold out")
    return all(sheets)


def _data(args: argparse.Namespace, vessel: "Vessel") -> "tuple[list, list[Trajectory]]":
    from diffsea.identification.objectives.trial_numbers import read_trial_table

    if _from_sheet(args):
        return [sheet for path in args.recordings for sheet in read_trial_table(path, vessel)], []
    return read_all(args)


def _settings(args: argparse.Namespace, vessel: "Vessel") -> "FitSettings":
    from diffsea.identification.problem import default_priors
    from diffsea.identification.study import FitSettings
    from diffsea.parameters import read_priors

    objective = args.objective or ("trial-numbers" if _from_sheet(args) else "innovation")
    priors = read_priors(args.priors, default_priors(vessel)) if args.priors else {}
    profiles = () if args.profile == ("none",) else args.profile
    return FitSettings(
        objective, args.free, args.anchor, priors, args.starts, profiles,
        effects=args.effects, per_recording=args.environment == "per-recording",
    )  # fmt: skip


def _record(study: "Study", settings: "FitSettings", quality: dict, told: dict) -> dict:
    record = {
        "format": 1,
        "objective": settings.objective,
        "parameters": {row["name"]: _without_name(row) for row in study.rows},
        "effects": study.effects,
        "anchor": study.anchor,
        "fit": quality,
        "deviance": study.estimate.deviance,
        "path": list(study.estimate.path),
        "outcome": study.estimate.outcome.value,
        "identifiability": study.identifiability.as_dict(),
        "next_manoeuvre": None if study.next is None else study.next.as_dict(),
        "starts": None if study.agreement is None else study.agreement.as_dict(),
        "outliers": study.outliers,
        "source": told,
    }
    if settings.objective == "innovation":
        record["noise"] = _noise(study)
    if settings.objective == "trial-numbers":
        record["trial_numbers"] = [
            dataclasses.asdict(one) for one in study.objective.residuals(study.estimate.coordinates)
        ]
    return record


def _without_name(row: dict) -> dict:
    return {key: value for key, value in row.items() if key != "name"}


def _noise(study: "Study") -> dict:
    import numpy as np

    scales = {field.name: np.exp(getattr(study.noise, field.name)) for field in
              dataclasses.fields(study.noise)}  # fmt: skip
    channels = ("x", "y", "psi", "u", "v", "r")
    measured = _by_name(channels, np.asarray(study.recorded.dataset.known).any(0))
    return {
        "gust": _by_name(channels[3:], scales["gust"]),
        "lasting_gust": _by_name(channels[3:], scales["slow"]),
        "gust_memory": _by_name(channels[3:], scales["memory"]),
        "sensor": {n: s for n, s in _by_name(channels, scales["sensor"]).items() if measured[n]},
    }


def _by_name(names: tuple[str, ...], values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _summary(study: "Study", quality: dict, warning: str) -> str:
    lines = [
        (
            row["name"], row["meaning"], row["unit"], f"{row['start']:.4g}",
            f"{row['value']:.4g}", f"{row['std']:.2g}", _interval(row), determined(row),
        )
        for row in study.rows
    ]  # fmt: skip
    header = (
        "symbol", "name", "unit", "start", "estimate", "+-", "90 % interval", "determined by"
    )  # fmt: skip
    told = ", ".join(f"{name} {value:.2f}" for name, value in quality.items())
    parts = [table(lines, header), "", f"normalised misfit (1 = noise level): {told}"]
    parts += _effect_lines(study)
    parts.append(study.anchor)
    parts.append(study.estimate.outcome.sentence)
    if study.agreement is not None:
        parts.append(study.agreement.sentence)
    if study.outliers:
        lost = ", ".join(f"{number} of {name}" for name, number in study.outliers.items())
        parts.append(f"outliers left out: {lost}")
    parts += study.identifiability.sentences
    if study.next is not None:
        parts.append(f"next: {study.next.sentence}")
    parts += [f"warning: {warning}"] if warning else []
    return "\n".join(parts)


def _effect_lines(study: "Study") -> list[str]:
    from diffsea.report.words import effect_lines

    return [line for name, copies in study.effects.items() for line in effect_lines(name, copies)]


def _interval(row: dict) -> str:
    low, high = row["interval"]
    return f"{low:.4g} to {high:.4g}" + (" (profile)" if row["profiled"] else "")


def determined(row: dict) -> str:
    """What an estimate rests on, in words."""
    share = row["determined"]
    if share > 0.9:
        return "the data"
    return "mostly the data" if share > 0.5 else "mostly the prior"
