"""`diffsea fit`: from recordings, or a sheet of trial numbers, to a vessel file."""

import argparse
import dataclasses
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.options import add_choice, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.identification.study import FitSettings, Study
    from diffsea.trajectory import Trajectory
    from diffsea.vessel.base import Vessel


ANCHORS = ("mass", "thrust")  # as the library has them, which would import JAX to be asked
PROFILE_HELP = (
    "parameters whose intervals come from the profile likelihood, `none` for none (default: those "
    "whose likelihood is asymmetric)"
)
ANCHOR_HELP = "what fixes the scale of forces; with thrust, mass and inertia are fitted"
EFFECTS_HELP = "effects of the catalogue to estimate besides, for example current,wind"


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "identify a vessel's derivatives from recordings"
    fit = options.add_command(commands, "fit", fit_command, summary)
    options.add_fit_options(fit)
    objectives = options.LazyChoices(_objectives)
    kind = options.one_of(objectives, "objective")
    objective = "%(choices)s (default: innovation; trial-numbers for a sheet)"
    add_option(fit, "--objective", "O", kind, objective, choices=objectives)
    priors = "TOML file of starts, prior widths and bounds by parameter"
    add_option(fit, "--priors", "FILE", pathlib.Path, priors)
    add_choice(fit, "--anchor", ANCHORS, ANCHOR_HELP)
    starts = "starts drawn from the priors, explored at once"
    add_option(fit, "--starts", "N", options.count, starts, default=1)
    add_option(fit, "--profile", "NAMES", options.names, PROFILE_HELP)
    add_option(fit, "--effects", "NAMES", options.names, EFFECTS_HELP, default=())


def _objectives() -> dict[str, str]:
    from diffsea.identification.study import OBJECTIVES

    return dict.fromkeys(OBJECTIVES, "")


def fit_command(args: argparse.Namespace) -> None:
    """Fits a vessel's parameters, with standard errors, and predicts runs that were held out. By
    default hull derivatives and added masses to recordings by an innovation-form likelihood, gusts
    and sensor noise estimated; --objective free-run by multiple shooting instead. A TOML sheet of
    trial numbers (advance, diameters, overshoots) in place of recordings is fitted as it is.
    Says which combinations the data do not determine, and the manoeuvre to record next.
    Writes vessel.toml, fit.json and report.html.

    examples:
      diffsea fit usv.toml run1.csv run2.csv --test run3.csv
      diffsea fit usv.toml run*.csv --free X_u,X_uu,N_r,Y_v --starts 8
      diffsea fit usv.toml run*.csv --priors known.toml --anchor thrust
      diffsea fit ship.toml sea_trial.toml
    """
    with Outputs(args.output) as out:
        from diffsea.identification.study import identify
        from diffsea.report.fit import compare_fit, fit_report, worse_warning
        from diffsea.report.predictions import horizon_table
        from diffsea.vessel.files import build, dump, updated_document
        from diffsea.workflows.identification import provenance

        tell = options.timed_progress()
        file = options.read_vessel(args)
        data, test = _read_data(args, file.vessel)
        settings = _fit_settings(args, file.vessel)
        runs = [] if settings.objective == "trial-numbers" else data
        tell(f"reading: {len(data)} to fit, {len(test)} held out; compiling")
        history: list[str] = []

        def follow(message: str) -> None:
            history.append(message)
            tell(message)

        study = identify(file.vessel, data, settings, follow)
        document = updated_document(file.document, study.values, study.effect_tables)
        vessel = build(document)
        quality = study.quality(test)
        source = provenance(file, runs, test)
        tell("predicting and writing the report")
        predicted = compare_fit(study, file.vessel, vessel, (runs, test))
        out.text("vessel.toml", dump(document))
        record = fit_record(study, settings.objective, quality)
        horizons = horizon_table(predicted)
        out.json("fit.json", record | {"source": source, "predictions": horizons})
        page = fit_report(study, quality, history, predicted, (runs, test), source)
        out.text("report.html", page)
    out.present(args, _summary_text(study, quality, worse_warning(predicted)))


def _is_sheet(args: argparse.Namespace) -> bool:
    """Whether trial numbers are to be fitted, and not recordings."""
    from diffsea.identification.objectives.trial_numbers import is_trial_table

    sheets = [is_trial_table(path) for path in args.recordings]
    if any(sheets) and not all(sheets):
        raise UserError("give either recordings or sheets of trial numbers (TOML), not both")
    if all(sheets) and args.test:
        raise UserError("--test takes recordings, and a fit to trial numbers has none to hold out")
    return all(sheets)


def _read_data(args: argparse.Namespace, vessel: "Vessel") -> "tuple[list[Any], list[Trajectory]]":
    """What is fitted, recordings or measured trials, and recordings that are held out."""
    from diffsea.identification.objectives.trial_numbers import read_trial_table

    if _is_sheet(args):
        return [trial for path in args.recordings for trial in read_trial_table(path, vessel)], []
    return options.read_fitted_and_held_out(args)


def _fit_settings(args: argparse.Namespace, vessel: "Vessel") -> "FitSettings":
    from diffsea.identification.problem import default_priors
    from diffsea.identification.study import FitSettings
    from diffsea.parameters import read_priors

    return FitSettings(
        args.objective or ("trial-numbers" if _is_sheet(args) else "innovation"),
        args.free,
        args.anchor,
        read_priors(args.priors, default_priors(vessel)) if args.priors else {},
        args.starts,
        () if args.profile == ("none",) else args.profile,
        effects=args.effects,
        per_recording=args.environment == "per-recording",
    )


def fit_record(study: "Study", objective: str, quality: dict[str, float]) -> dict[str, Any]:
    """The content of fit.json, all but the source and the predictions."""
    rows = [dict(row) for row in study.rows]
    record: dict[str, Any] = {
        "format": 1,
        "objective": objective,
        "parameters": {row.pop("name"): row for row in rows},
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
    }
    if objective == "innovation":
        record["noise"] = _noise_record(study)
    if objective == "trial-numbers":
        residuals = study.objective.residuals(study.estimate.coordinates)
        record["trial_numbers"] = [dataclasses.asdict(one) for one in residuals]
    return record


def _noise_record(study: "Study") -> dict[str, dict[str, float]]:
    """Scales of process noise and of the sensors that measured anything, in SI units."""
    import numpy as np

    from diffsea.trajectory import MOTION_CHANNELS

    noise = dataclasses.asdict(study.noise)
    scales = {name: np.exp(logarithms) for name, logarithms in noise.items()}
    measured = np.asarray(study.recorded.dataset.known).any(0)

    def by_channel(channels: Sequence[str], values: Sequence[float]) -> dict[str, float]:
        return {name: float(value) for name, value in zip(channels, values, strict=True)}

    sensors = by_channel(MOTION_CHANNELS, scales["sensor"])
    return {
        "gust": by_channel(MOTION_CHANNELS[3:], scales["gust"]),
        "lasting_gust": by_channel(MOTION_CHANNELS[3:], scales["slow"]),
        "gust_memory": by_channel(MOTION_CHANNELS[3:], scales["memory"]),
        "sensor": {name: sensors[name] for name in np.array(MOTION_CHANNELS)[measured]},
    }


def _summary_text(study: "Study", quality: dict[str, float], warning: str) -> str:
    from diffsea.report.words import effect_lines

    rows = []
    for row in study.rows:
        numbers = (f"{row['start']:.4g}", f"{row['value']:.4g}", f"{row['std']:.2g}")
        low, high = row["interval"]
        interval = f"{low:.4g} to {high:.4g}" + (" (profile)" if row["profiled"] else "")
        basis = basis_of(row["determined"])
        rows.append((row["name"], row["meaning"], row["unit"], *numbers, interval, basis))
    header = ("symbol", "name", "unit", "start", "estimate", "+-", "90 % interval", "determined by")
    misfit = ", ".join(f"{name} {value:.2f}" for name, value in quality.items())
    parts = [table(rows, header), "", f"normalised misfit (1 = noise level): {misfit}"]
    parts += [line for item in study.effects.items() for line in effect_lines(*item)]
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


def basis_of(share: float) -> str:
    """What an estimate rests on, by the share of it that the data determine."""
    if share > 0.9:
        return "the data"
    return "mostly the data" if share > 0.5 else "mostly the prior"
