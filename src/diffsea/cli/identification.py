"""Commands from recordings to a vessel and what it lacks: `diffsea fit`, `diffsea diagnose`."""

import argparse
import dataclasses
import math
import pathlib
import time
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.following import commands_after_diagnosis
from diffsea.cli.options import add_choice, add_flag, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.parameters import Parameter
    from diffsea.trajectory import Trajectory
    from diffsea.vessel.files import VesselFile
    from diffsea.workflows.fits import FitResult


ANCHORS = ("mass", "thrust")  # as the library has them, which would import JAX to be asked
OBJECTIVES = ("innovation", "free-run", "trial-numbers")  # likewise
TABLE_OF_OBJECTIVES = "diffsea.identification.study:OBJECTIVES"
# Usual seconds of what is told, with programs that have to be compiled.
OF_FIT = {
    **{"reading": 2.0, "fitting": 30.0, "how": 10.0, "looking": 5.0, "predicting": 8.0},
    **{"writing": 3.0},
}
OF_DIAGNOSIS = {
    **{"reading": 2.0, "checking": 2.0, "fitting": 30.0, "asking": 8.0, "trying": 25.0},
    **{"finding": 2.0, "looking": 1.0, "comparing": 8.0, "writing": 5.0},
}


def register(commands: options.Commands) -> None:
    """Add the commands."""
    summary = "identify a vessel's derivatives from recordings"
    fit = options.add_command(commands, "fit", fit_command, summary)
    _add_inputs(fit)
    objectives = options.LibraryNames(OBJECTIVES, "objective", TABLE_OF_OBJECTIVES)
    objective = "%(choices)s (default: innovation; trial-numbers for a sheet)"
    add_option(fit, "--objective", "O", objectives, objective, choices=objectives)
    starts = "starts drawn from the priors; else one, and 8 more if that leaves something missing"
    add_option(fit, "--starts", "N", options.count, starts)
    profile = (
        "parameters whose intervals come from the profile likelihood, `none` for none (default: "
        "those whose likelihood is asymmetric)"
    )
    add_option(fit, "--profile", "NAMES", options.names, profile)
    effects = "effects to estimate besides: current,wind; of a sheet thrust-asymmetry ..."
    add_option(fit, "--effects", "NAMES", options.names, effects, default=())

    summary = "find the physics that the model leaves out"
    diagnose = options.add_command(commands, "diagnose", diagnose_command, summary)
    _add_inputs(diagnose)
    draws = "judge chance by so many simulated and refitted data sets (100 or more; seconds each)"
    add_option(diagnose, "--bootstrap", "DRAWS", int, draws, default=0)
    budget = "begin no further step of the search after so long; what was found is reported"
    add_option(diagnose, "--minutes", "M", options.positive, budget)
    sequence = "the recordings, then those of --test, were made in this order: what changed in one "
    sequence += "stays so in those after it, and the vessel is written as it was in the end"
    add_flag(diagnose, "--one-after-another", sequence)
    known = "recordings of the vessel as she was before: what they tell of her is known, and what "
    known += "is searched has changed since"
    paths = pathlib.Path
    add_option(diagnose, "--reference", "RECORDING", paths, known, nargs="+", default=[])
    manoeuvre = "write the manoeuvre that separates rivals as a command sequence (t, cmd_...)"
    add_option(diagnose, "--next-manoeuvre", "CSV", pathlib.Path, manoeuvre)


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    """What both are given: a vessel, recordings, what is free and held out."""
    options.add_vessel(parser)
    options.add_recordings(parser)
    free = "parameters to estimate, separated by commas (default: the hull's derivatives, and "
    free += "what has a prior)"
    add_option(parser, "--free", "NAMES", options.names, free)
    held_out = "recordings to hold out for judging"
    add_option(parser, "--test", "RECORDING", pathlib.Path, held_out, nargs="+", default=[])
    priors = "TOML file of starts, prior widths and bounds by parameter; else the vessel's own"
    add_option(parser, "--priors", "FILE", pathlib.Path, priors)
    anchor = "what fixes the scale of forces; with thrust, mass and inertia are fitted"
    add_choice(parser, "--anchor", ANCHORS, anchor)
    budget = "begin no further step of any stage after so long; results say what was left out"
    add_option(parser, "--budget", "SECONDS", options.positive, budget, default=math.inf)
    options.add_parts(parser, "that keeps fits until all is done")
    add_flag(parser, "--keep-idle", "keep stretches of logs at rest, disarmed or carried about")
    quick = "a first look in less time; what it has not done is told"
    add_flag(parser, "--quick", quick)
    environment = "whether wind and current are the same in all recordings"
    add_choice(parser, "--environment", ("shared", "per-recording"), environment)


def fit_command(args: argparse.Namespace) -> None:
    """Fits a vessel's parameters, with standard errors, and predicts runs that were held out. By
    default hull derivatives and added masses to recordings by an innovation-form likelihood, gusts
    and sensor noise estimated; --objective free-run by multiple shooting instead. A TOML sheet of
    trial numbers (advance, diameters, overshoots) is fitted as it is, alone or together with
    recordings: one fit, each weighed by its errors, which says what each determines alone.
    Says how far free predictions miss, whether something is missing from the model, which
    combinations the data do not determine, and the manoeuvre to record next.
    Writes vessel.toml, fit.json and report.html.

    examples:
      diffsea fit usv.toml run1.csv run2.csv --test run3.csv
      diffsea fit usv.toml run*.csv --free X_u,X_uu,N_r,Y_v --starts 8
      diffsea fit usv.toml run*.csv --priors known.toml --anchor thrust
      diffsea fit ship.toml sea_trial.toml
      diffsea fit ship.toml sea_trial.toml log.csv --test other.csv
    """
    from diffsea.identification.kept_fits import fits_kept

    began, parts = time.monotonic(), options.parts_folder(args)
    with fits_kept(parts) as kept, Outputs(args.output) as out, StagedProgress(OF_FIT) as tell:
        kept.tell = tell
        tell("reading")
        from diffsea.report.fit import fit_report
        from diffsea.report.predictions import horizon_table
        from diffsea.vessel.files import dump
        from diffsea.workflows.fits import fit
        from diffsea.workflows.inputs import provenance

        history: list[str] = []

        def follow(message: str) -> None:
            history.append(message)
            tell(message)

        file = options.read_vessel(args)
        data, test = _read_data(args)
        found = fit(
            file,
            data,
            test,
            objective=args.objective,
            free=args.free,
            anchor=args.anchor,
            priors=_read_priors(args, file),
            starts=args.starts,
            effects=args.effects,
            per_recording=args.environment == "per-recording",
            progress=follow,
            profiles=() if args.profile == ("none",) else args.profile,
            quick=args.quick,
            budget=args.budget - (time.monotonic() - began),
        )
        tell("writing the report")
        runs = found.data.recordings, found.data.test
        source = provenance(file, *runs)
        out.text("vessel.toml", dump(found.fitted.document))
        horizons = horizon_table(found.predicted)
        out.json("fit.json", _fit_record(found) | {"source": source, "predictions": horizons})
        judged = found.study, found.misfit, history, found.predicted
        told = found.verdict, found.not_done, found.left_out
        out.text("report.html", fit_report(*judged, runs, source, *told))
    out.present(args, _summary_text(found))


def _read_data(args: argparse.Namespace) -> "tuple[list[Any], list[Trajectory]]":
    """What is fitted, recordings and sheets of trial numbers, and the recordings held out."""
    from diffsea.identification.objectives.trial_numbers import is_trial_table
    from diffsea.workflows.inputs import check_held_out

    sheets = [path for path in args.recordings if is_trial_table(path)]
    recordings = [path for path in args.recordings if path not in sheets]
    if len(set(sheets)) < len(sheets):
        raise UserError("a sheet of trial numbers is named twice; name each only once")
    check_held_out(args.test, bool(recordings))
    runs = options.read_recordings([*recordings, *args.test], args)
    fitted, test = runs[: len(recordings)], runs[len(recordings) :]
    return [*options.used_parts(fitted, args), *sheets], options.used_parts(test, args)


def _read_priors(args: argparse.Namespace, file: "VesselFile") -> "dict[str, Parameter | None]":
    """Priors of the file that `--priors` names."""
    from diffsea.parameters import read_priors
    from diffsea.vessel.files import default_priors

    return read_priors(args.priors, default_priors(file.vessel)) if args.priors else {}


def _fit_record(found: "FitResult") -> dict[str, Any]:
    """The content of fit.json, all but the source and the predictions."""
    study = found.study
    rows = [dict(row) for row in study.rows]
    record: dict[str, Any] = {
        "format": 1,
        "complete": not found.left_out,
        "left_out": found.left_out,
        "free": found.free,
        "missing": found.missing,
        "missing_evidence": found.verdict.as_dict(),
        "objective": found.objective,
        "parameters": {row.pop("name"): row for row in rows},
        "effects": study.effects,
        "anchor": study.anchor,
        "fit": found.misfit,
        "deviance": study.estimate.deviance,
        "path": list(study.estimate.path),
        "outcome": study.estimate.outcome.value,
        "identifiability": study.identifiability.as_dict(),
        "sides": study.side_records,
        "next_manoeuvre": None if study.next is None else study.next.as_dict(),
        "starts": None if study.agreement is None else dataclasses.asdict(study.agreement),
        "outliers": study.outliers,
        "one_sample_in": study.objective.one_sample_in,
    }
    if found.objective == "innovation":
        from diffsea.identification.filter.noise_record import noise_record

        record["noise"] = noise_record(study.noise, study.recorded.dataset.recorded_channels)
    if found.data.trials:
        residuals = study.objective.residuals(study.estimate.coordinates)
        record["trial_numbers"] = [dataclasses.asdict(one) for one in residuals]
    if study.log10_odds:
        record["log10_odds"] = dict(study.log10_odds)
    if found.not_done:
        record["not_done"] = list(found.not_done)
    if study.sources is not None:
        record["sources"] = study.sources.as_dict()
    return record


def _summary_text(found: "FitResult") -> str:
    """fit.json for a person: free predictions, a table of parameters, then sentences."""
    from diffsea.budget import left_out_sentence
    from diffsea.report.fit import MODELS, fitted_effects, worse_warning
    from diffsea.report.predictions import horizon_table
    from diffsea.report.wording.caveats import quick_sentence, side_sentences
    from diffsea.report.wording.horizons import horizon_line

    study, sources = found.study, found.study.sources
    horizons = [horizon_line(row, tuple(MODELS)) for row in horizon_table(found.predicted)]
    on = "runs held out" if found.data.test else "the runs it was fitted to"
    parts = [f"free predictions of {on}, {' -> '.join(MODELS.values())}:"] if horizons else []
    parts += [*horizons, ""] if horizons else []
    rows = []
    for row in study.rows:
        numbers = (f"{row['start']:.4g}", f"{row['value']:.4g}", f"{row['std']:.2g}")
        low, high = row["interval"]
        interval = f"{low:.4g} to {high:.4g}" + (" (profile)" if row["profiled"] else "")
        source = "mostly the data" if row["determined"] > 0.5 else "mostly the prior"
        source = "the data" if row["determined"] > 0.9 else source
        rows.append((row["name"], row["meaning"], row["unit"], *numbers, interval, source))
    header = ("symbol", "name", "unit", "start", "estimate", "+-", "90 % interval", "determined by")
    misfit = ", ".join(
        f"{name.replace('_', ' ')} {value:.2f}" for name, value in found.misfit.items()
    )
    parts += [table(rows, header), "", f"normalised misfit (1 = noise level): {misfit}"]
    parts += fitted_effects(study)
    parts += [study.anchor, study.estimate.outcome.sentence]
    parts += [] if study.agreement is None else [study.agreement.sentence]
    if study.outliers:
        lost = ", ".join(f"{number} of {name}" for name, number in study.outliers.items())
        parts.append(f"outliers left out: {lost}")
    parts += study.identifiability.sentences
    parts += side_sentences(study.side_records)
    parts += [] if sources is None else sources.sentences
    parts += [] if study.next is None else [f"next: {study.next.sentence}"]
    warning = worse_warning(found.predicted)
    parts += [f"warning: {warning}"] if warning else []
    parts += [quick_sentence(found.not_done)] if found.not_done else []
    parts += [f"warning: {left_out_sentence(found.left_out)}"] if found.left_out else []
    return "\n".join([*parts, found.verdict.sentence])


def diagnose_command(args: argparse.Namespace) -> None:
    """Locates where model and recordings differ, names what was left out, models it and
    shows the fit improve on data that was held out. Writes diagnosis.json, the vessel with what
    was found as vessel.toml, and report.html.

    examples:
      diffsea diagnose usv.toml run*.csv --test other*.csv
      diffsea diagnose boat.toml run*.csv --quick
      diffsea diagnose boat.toml run*.csv --priors known.toml
      diffsea diagnose ship.toml a.csv b.csv --environment per-recording
    """
    if args.quick and args.next_manoeuvre is not None:
        raise UserError("--quick looks for no manoeuvre; leave it or --next-manoeuvre out")
    from diffsea.identification.kept_fits import fits_kept

    began = time.monotonic()
    with fits_kept(options.parts_folder(args)) as kept, Outputs(args.output) as out:
        import pandas as pd

        from diffsea.diagnosis.experiment import commands
        from diffsea.report.wording.terminal import verdict_text
        from diffsea.vessel.files import dump
        from diffsea.workflows.diagnoses import diagnose

        next_csv = args.next_manoeuvre and out.elsewhere(args.next_manoeuvre, "--next-manoeuvre")
        with StagedProgress(OF_DIAGNOSIS) as tell:
            kept.tell = tell
            tell("reading")
            file = options.read_vessel(args)
            runs, test, reference = options.read_groups(
                args, args.recordings, args.test, args.reference
            )
            per_run = args.environment == "per-recording"
            found = diagnose(
                file,
                runs,
                test,
                per_recording=per_run,
                free=args.free,
                bootstrap=args.bootstrap,
                progress=tell,
                seconds=math.inf if args.minutes is None else 60.0 * args.minutes,
                priors=_read_priors(args, file),
                anchor=args.anchor,
                quick=args.quick,
                budget=args.budget - (time.monotonic() - began),
                one_after_another=args.one_after_another,
                reference=reference,
            )
            if next_csv is not None:
                experiment, train = found.experiment, found.diagnosis.split.train
                if experiment is None:
                    tell("no two explanations are left to separate, so no manoeuvre is written")
                elif not experiment.exists:
                    tell(f"no manoeuvre is written: {experiment.why}")
                else:
                    sequence = pd.DataFrame(commands(train, found.diagnosis.final, experiment))
                    sequence.to_csv(next_csv, index=False, float_format="%.6g")
            tell("writing the report")
            out.json("diagnosis.json", found.record)
            out.text("vessel.toml", dump(found.diagnosed.document))
            out.text("report.html", found.html())
    following = commands_after_diagnosis(args, out.folder, found.record, found.in_order)
    out.present(args, verdict_text(found.record), following)
