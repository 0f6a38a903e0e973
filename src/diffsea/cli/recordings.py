"""Commands that judge recordings: `diffsea metrics`, `diffsea audit` and `diffsea predict`."""

import argparse
import dataclasses
import math
import pathlib
import shlex
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.following import read_so
from diffsea.cli.options import add_flag, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.cli.trial import metrics_text
from diffsea.errors import UserError
from diffsea.progress import PartialProgress, counted


if TYPE_CHECKING:
    from diffsea.recordings import Finding
    from diffsea.recordings.mapping_proposal import Proposal
    from diffsea.trajectory import Trajectory


# As the library has them, which would import JAX to be asked.
RECORDED_TRIALS = (
    *("turning-circle", "zigzag", "pull-out"),
    *("stopping", "straight", "unknown"),
)
UNITS = {"position": "m", "heading": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}


def register(commands: options.Commands) -> None:
    """Add the commands."""
    summary = "IMO/ITTC numbers of recorded trials"
    metrics = options.add_command(commands, "metrics", metrics_command, summary)
    options.add_recordings(metrics)
    size = metrics.add_mutually_exclusive_group()
    add_option(size, "--vessel", "V", str, "vessel whose length and thrust curves count")
    add_option(size, "--length", "M", options.positive, "L_pp as recorded")
    trials = options.LibraryNames(RECORDED_TRIALS, "manoeuvre", "diffsea.metrics:RECORDED_TRIALS")
    manoeuvre = "what was run, if known better: %(choices)s"
    add_option(metrics, "--manoeuvre", "NAME", trials, manoeuvre, choices=trials)
    scale = "full-scale over recorded length, for the verdicts on a model"
    add_option(metrics, "--scale", "S", options.positive, scale, default=1.0)
    summary = "faults of recordings: frames, units, signs, clocks, sensors"
    audit = options.add_command(commands, "audit", audit_command, summary)
    options.add_recordings(audit)
    repair = "repair what is certain and write repaired recordings, never over the inputs"
    add_flag(audit, "--repair", repair)
    summary = "replay a recording's orders through a vessel"
    predict = options.add_command(commands, "predict", predict_command, summary)
    options.add_vessel(predict)
    options.add_recordings(predict, several=False)
    add_flag(predict, "--orders", "use the orders even where executed actuation was measured")
    environment = "estimate current (and wind) on the start of the run and predict the rest"
    add_option(predict, "--environment-from", "SECONDS", options.positive, environment)


def metrics_command(args: argparse.Namespace) -> None:
    """Read the numbers of a trial off recordings: advance, tactical diameter, overshoots and so on,
    with the verdicts of IMO MSC.137(76). Orders and the manoeuvre are found in the recording.
    Writes metrics.json, which holds {"runs": {name: ...}} of several recordings, and metrics.html.

    examples:
      diffsea metrics circle.csv --length 4.9
      diffsea metrics trials/*.csv --vessel usv.toml --json
      diffsea metrics model.csv --mapping tank.toml --length 7.0 --scale 45.7
    """
    from diffsea.metrics import recording_metrics
    from diffsea.metrics.orders import as_thrust
    from diffsea.report.pages.recordings import metrics_page

    vessel = options.read_vessel(args).vessel if args.vessel else None
    length = args.length if vessel is None else float(vessel.rigid_body.length)
    stages = {"reading": 1.0, "measuring": 2.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell(f"reading {counted(len(args.recordings), 'recording')}")
        runs = options.read_recordings(args.recordings, args)
        tell("measuring the trials")
        made = {} if vessel is None else vessel.thrusts_at_rest
        thrusts = [as_thrust(run, made) for run in runs] if made else runs
        found = {
            run.name: recording_metrics(run, length, args.manoeuvre, args.scale) for run in thrusts
        }
        if vessel is not None:
            for item in found.values():
                item["notes"].append(f"the length is that of {vessel.name}, {length:g} m")
        (first, *others) = found.values()
        out.json("metrics.json", {"runs": found} if others else first)
        by_name = {run.name: run for run in runs}
        out.text("metrics.html", metrics_page(found, by_name, options.source_of(args), length))
    out.present(args, "\n\n".join(f"{n}: {metrics_text(item)}" for n, item in found.items()))


def audit_command(args: argparse.Namespace) -> None:
    """Check recordings for faults of labels, units, frames, signs, clocks and sensors, by
    kinematics alone and before any physics is blamed. Writes audit.json, the list of findings, and
    audit.html.

    With --repair, what is certain is put right, the recording audited again, and a repair that is
    no better undone: this writes NAME.repaired.csv per recording with native columns, repairs.json
    (what was applied, undone or left, and why) and, where a mapping can say it,
    repaired_mapping.toml, or one NAME.repaired_mapping.toml per recording where their repairs
    differ. Inputs are never changed.

    For files without native columns and without --mapping a mapping is proposed: STEM.mapping.toml
    of the first file, one for files of one layout, to be checked and edited. A file that cannot be
    read has "unreadable" as its one finding; the others are audited all the same.

    examples:
      diffsea audit run1.csv run2.csv
      diffsea audit field/*.csv --mapping field.toml --json
      diffsea audit logged_by_others.csv
      diffsea audit run1.csv --repair -o out/repaired
    """
    if args.repair:
        _repair(args)
        return
    from diffsea.report.pages.recordings import audit_page
    from diffsea.report.wording.findings import heaviest_first

    stages = {"reading": 2.0, "looking": 4.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        found, runs, message = _audit_or_propose(args, out, tell)
        out.json("audit.json", [item.as_dict() for _, items in found for item in items])
        notes = ["Some were read through a mapping that was proposed."] if message else []
        out.text("audit.html", audit_page(found, runs, notes, options.source_of(args)))
    if message and args.json:
        options.progress(message)
    texts = [
        _findings_text(
            name,
            [("", one, one.repair and f"repair: {one.repair}") for one in heaviest_first(items)],
        )
        for name, items in found
    ]
    out.present(args, message + "\n\n".join(texts))


def _audit_or_propose(
    args: argparse.Namespace, out: Outputs, tell: Callable[[str], None]
) -> "tuple[list[tuple[str, list[Finding]]], dict[str, Trajectory], str]":
    """Findings by recording, read through proposed mappings, written to `out`, where need be.

    With them the recordings that could be read, by name, and a text.

    A file that cannot be read has what is wrong with it as its one finding, and so has one that
    cannot be audited for want of a time. The text says what was proposed, and is empty where
    nothing was.

    Raises:
        UserError: none of the recordings can be read, one is named twice, or the mapping is wrong.
    """
    from diffsea.recordings import Finding, read_mapping
    from diffsea.recordings.mapping_proposal import foreign_layouts
    from diffsea.recordings.mappings import mapping_for
    from diffsea.workflows.audits import audit_readable, read_readable
    from diffsea.workflows.checks import propose_by_axes

    paths: Sequence[pathlib.Path] = args.recordings
    if len(set(paths)) < len(paths):
        raise UserError("a recording is named twice; name each only once")
    tell(f"reading {counted(len(paths), 'recording')}")
    layouts = foreign_layouts(paths) if args.mapping is None else []
    read = dict(zip(paths, read_readable(paths, args.mapping, args.start, args.end), strict=True))
    readable = [path for path, one in read.items() if not isinstance(one, Finding)]
    mappings = {path: mapping_for(args.mapping, path) for path in readable} if args.mapping else {}
    texts = []
    for layout in layouts:
        try:
            proposals = propose_by_axes(layout)
        except UserError as error:
            for path in layout:
                one = read[path]
                if isinstance(one, Finding):
                    why = f"{one.message}; no mapping could be proposed: {error}"
                    read[path] = dataclasses.replace(one, message=why)
            continue
        for group, proposal in proposals:
            found, text, written = _read_through_proposal(group, proposal, out, args)
            read |= {path: _under_the_same_name(read[path], one) for path, one in found.items()}
            mappings |= dict.fromkeys(group, read_mapping(written))
            texts.append(text)
    runs = {one.name: one for one in read.values() if not isinstance(one, Finding)}
    options.tell_mappings(list(runs.values()))
    tell("looking for faults")
    through = [mappings.get(path) for path in read]
    return audit_readable(list(read.values()), through), runs, "".join(texts)


def _under_the_same_name(
    before: "Trajectory | Finding", now: "Trajectory | Finding"
) -> "Trajectory | Finding":
    """What was read of a file now, under the name that tells it from the others."""
    from diffsea.recordings import Finding

    name = before.recording if isinstance(before, Finding) else before.name
    if isinstance(now, Finding):
        return dataclasses.replace(now, recording=name)
    return dataclasses.replace(now, name=name)


def _read_through_proposal(
    paths: "Sequence[pathlib.Path]", proposal: "Proposal", out: Outputs, args: argparse.Namespace
) -> "tuple[dict[pathlib.Path, Trajectory | Finding], str, pathlib.Path]":
    """Files of one foreign layout through the mapping that is proposed, and what was proposed.

    With them the file of that mapping. Without a time each file has a finding instead.
    """
    from diffsea.recordings import Finding
    from diffsea.workflows.audits import read_readable

    name = f"{paths[0].stem}.mapping.toml"
    if out.folder / name in out.files:
        name = f"{paths[0].stem}.{len(out.files) + 1}.mapping.toml"
    written = out.text(name, proposal.text)
    mapping = shlex.quote(str(out.folder / name))
    lines = [
        f"{paths[0]} has no native columns, so a mapping was proposed: {mapping}",
        "  channel         how sure       column",
        proposal.summary,
    ]
    if proposal.checks:
        lines += ["check these, and edit the mapping:", *(f"  {item}" for item in proposal.checks)]
    files = " ".join(shlex.quote(str(path)) for path in paths)
    lines += ["then run", f"  diffsea audit {files} --mapping {mapping}", ""]
    found: dict[pathlib.Path, Trajectory | Finding]
    if proposal.timed:
        lines.append("The audit below is of the recordings read through the proposed mapping.")
        found = dict(zip(paths, read_readable(paths, written, args.start, args.end), strict=True))
    else:
        lines.append("Not audited: without a time step nothing read through it means anything.")
        why = "the file has no time, and nothing tells its sampling interval; it was not audited"
        repair = "put the interval (s) into [file] time_step of the proposed mapping"
        untimed = Finding("time-step", math.nan, math.nan, "", why, repair, ("t",))
        found = {path: untimed for path in paths}
    return found, "\n".join(lines) + "\n\n", written


def _repair(args: argparse.Namespace) -> None:
    """Write recordings, and mappings where they can say it, in which what is certain is right."""
    from diffsea.recordings import write_recording
    from diffsea.recordings.auditing.mapping_rows import mapping_text
    from diffsea.recordings.auditing.repair import repair
    from diffsea.recordings.mappings import mapping_for

    stems = [path.stem for path in args.recordings]
    inputs = {path.resolve() for path in args.recordings}
    for stem in stems:
        written = args.output / f"{stem}.repaired.csv"
        if written.resolve() in inputs:
            raise UserError(f"{written} would be written over a recording; choose a folder with -o")
        if stems.count(stem) > 1:
            raise UserError(f"two recordings would be repaired into {written}; do them in turn")
    mappings = [mapping_for(args.mapping, path) for path in args.recordings]
    with Outputs(args.output) as out, StagedProgress({"reading": 1.0, "repairing": 5.0}) as tell:
        tell("reading")
        runs = options.read_recordings(args.recordings, args)
        repairs = []
        for number, run in enumerate(runs):
            stage = f"repairing {counted(len(runs), 'recording')}"
            tell(PartialProgress(run.name, number / len(runs), stage))
            repairs.append(repair(run, mappings[number]))
        alike = all(one.mapping == repairs[0].mapping for one in repairs)
        records, texts = [], []
        for stem, one in zip(stems, repairs, strict=True):
            csv = f"{stem}.repaired.csv"
            write_recording(one.run, out.path(csv))
            records.append(one.as_dict() | {"repaired": csv})
            name = "repaired_mapping.toml" if alike else f"{stem}.repaired_mapping.toml"
            in_mapping = any(step.in_mapping for step in one.applied)
            if in_mapping and out.folder / name not in out.files:
                notes = [
                    f"{step.finding.message} ({'' if step.in_mapping else 'not '}repaired here)"
                    for step in one.applied
                ]
                out.text(name, mapping_text(one.mapping, notes))
            rows = []
            for step in one.steps:
                remark = "" if step.outcome == "applied" else f"why {step.outcome}: {step.reason}"
                rows.append((f"{step.outcome:8s} ", step.finding, remark))
            texts.append(_findings_text(one.run.name, rows))
        out.json("repairs.json", records)
        out.json("audit.json", [item.as_dict() for one in repairs for item in one.before])
    out.present(args, "\n\n".join(texts))


def _findings_text(name: str, rows: "Sequence[tuple[str, Finding, str]]") -> str:
    """Findings of one recording for a person, each between a word ahead of it and a remark."""
    from diffsea.report.wording.findings import cost_words

    lines = [f"{name}:" if rows else f"{name}: nothing found"]
    for word, finding, remark in rows:
        size = ""
        if math.isfinite(finding.value):
            unit = "" if finding.unit == "1" else f" {finding.unit}"
            error = f" +- {finding.std:.2g}" if math.isfinite(finding.std) and finding.std else ""
            size = f"{finding.value:.4g}{error}{unit}"
        if costs := cost_words(finding.cost):
            size += f"  ({costs} off in a minute)"
        lines += [f"  {word}{finding.kind:18s} {size}", f"    {finding.message}"]
        lines += [f"    {remark}"] if remark else []
    return "\n".join(lines)


def predict_command(args: argparse.Namespace) -> None:
    """Replay a recording's orders through a vessel, open loop, from the recorded initial state.

    Actuation that was measured (exec_ columns) is used as measured, any other goes through the
    vessel's actuators; the result says which. Writes predicted.csv, predict.json with
    root-mean-square errors over the whole run and 5, 20 and 60 s ahead of starts along it,
    prediction.png and predict.html. With --environment-from, current and wind are estimated on the
    first part of the run and only the rest is predicted.

    examples:
      diffsea predict usv.toml run1.csv
      diffsea predict out/fit/vessel.toml run7.csv --mapping field.toml -o out/run7
    """
    from diffsea.recordings import write_recording
    from diffsea.report.pages.recordings import prediction_page
    from diffsea.report.pictures import save_prediction
    from diffsea.report.predictions import Prediction
    from diffsea.report.wording.horizons import persistence_sentence
    from diffsea.simulation.actuation import how_actuated, recorded_shares
    from diffsea.simulation.order_units import with_usable_actuation
    from diffsea.simulation.persistence import persistence_errors
    from diffsea.simulation.replay import horizon_errors, replay, replay_errors
    from diffsea.trajectory import Outcome

    stages = {"reading": 2.0, "replaying": 4.0, "predicting": 4.0, "writing": 2.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell("reading")
        vessel = options.read_vessel(args).vessel
        recordings = options.read_recordings([args.recording], args)
        (recording,) = with_usable_actuation(vessel, recordings, tell)
        environment = None
        if args.environment_from is not None:
            from diffsea.identification.holdout import environment_from

            tell(f"estimating the environment of the first {args.environment_from:g} s")
            vessel, recording, environment = environment_from(
                vessel, recording, args.environment_from
            )
        actuation = how_actuated(vessel, [recording])
        if args.orders:
            actuation = dict.fromkeys(actuation, "reconstructed")
        tell("replaying the orders")
        predicted = replay(vessel, recording, not args.orders)
        if predicted.outcome == Outcome.DIVERGED:
            raise UserError(
                f"{recording.name}: {Outcome.DIVERGED.sentence}. The vessel file may not fit the "
                "recording: look at units and signs of the orders (diffsea audit), and at the "
                f"derivatives of {vessel.name!r}"
            )
        tell("predicting from starts along the run")
        ahead = horizon_errors(vessel, recording, measured_actuation=not args.orders)
        shares = recorded_shares(vessel, recording)
        kept_up = persistence_errors(recording, vessel.sensors, shares=shares)
        warning = persistence_sentence(ahead, kept_up)
        result: dict[str, Any] = {
            "vessel": vessel.name,
            "recording": recording.name,
            "actuation": actuation,
            "overall": replay_errors(predicted, recording),
            "horizons": {f"{seconds:g}": errors for seconds, errors in ahead.items()},
            "persistence": {f"{seconds:g}": errors for seconds, errors in kept_up.items()},
            "units": UNITS | {"horizons": "s"},
            "notes": [*predicted.provenance, *([warning] if warning else [])],
        }
        if environment is not None:
            result["environment"] = {"seconds": args.environment_from, **environment}
        tell("writing")
        write_recording(predicted, out.path("predicted.csv"))
        out.json("predict.json", result)
        title = f"{recording.name} predicted by {vessel.name}"
        save_prediction(predicted, recording, out.path("prediction.png"), title)
        drawn = Prediction(predicted, ahead)
        source = options.source_of(args)
        page = prediction_page(recording, drawn, result, source, vessel.units)
        out.text("predict.html", page)
    words = ["diffsea", "diagnose", str(args.vessel), str(args.recording), *read_so(args)]
    out.present(args, _prediction_text(result), [f"{shlex.join(words)}  # what the model lacks"])


def _prediction_text(result: dict[str, Any]) -> str:
    """predict.json for a person: a table of errors, the environment, notes."""
    from diffsea.report.quantities import for_people

    names = [name for name in UNITS if name in result["overall"]]
    shown = {name: for_people(1.0, UNITS[name]) for name in names}  # factor, unit

    def row(label: str, errors: dict[str, float]) -> list[str]:
        return [label, *(f"{shown[n][0] * errors.get(n, math.nan):.3g}" for n in names)]

    environment = result.get("environment", {})
    part = "the rest of the run" if environment else "the whole run"
    rows = [row(f"over {part}", result["overall"])]
    for seconds, errors in result["horizons"].items():
        diverged = f", {errors['diverged']} diverged" if "diverged" in errors else ""
        rows.append(row(f"{seconds} s ahead of {errors['starts']} starts{diverged}", errors))
    header = ["root mean square error", *(f"{name} ({shown[name][1]})" for name in names)]
    lines = [table(rows, header), ""]
    for name, numbers in environment.items():
        if name == "seconds":
            continue
        speed, direction = numbers["speed"], numbers["direction"]
        way = "flowing to" if name == "current" else "from"
        lines.append(
            f"{name} of the first {environment['seconds']:g} s: {speed['value']:.3g} +- "
            f"{speed['std']:.2g} m/s {way} {math.degrees(direction['value']):.0f} +- "
            f"{math.degrees(direction['std']):.0f} deg"
        )
    return "\n".join([*lines, *([""] if environment else []), *result["notes"]])
