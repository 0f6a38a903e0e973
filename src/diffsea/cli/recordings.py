"""Commands that judge recordings: `metrics`, `audit` and `predict`."""

import argparse
import math
from typing import TYPE_CHECKING

from diffsea.cli import options, proposals
from diffsea.cli.trial import metrics_text
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.recordings import Finding
    from diffsea.recordings.auditing.repair import Repair


_UNITS = {"position": "m", "heading": "rad", "u": "m/s", "v": "m/s", "r": "rad/s"}

_METRICS = """\
Read the numbers of a trial off recordings: advance, tactical diameter, overshoots and so on,
with the verdicts of IMO MSC.137(76). Orders and the manoeuvre are found in the recording.
Writes metrics.json; with several recordings it holds {"runs": {name: ...}}.
"""
_METRICS_EXAMPLES = """\
  diffsea metrics circle.csv --length 4.9
  diffsea metrics trials/*.csv --vessel usv.toml --json
  diffsea metrics model.csv --mapping tank.toml --length 7.0 --scale 45.7"""
_AUDIT = """\
Check recordings for faults of labels, units, frames, signs, clocks and sensors, by kinematics
alone and before any physics is blamed. Writes audit.json, the list of findings. With --repair,
what is certain is put right, the recording audited again, and a repair that is no better undone:
this writes NAME.repaired.csv per recording with native columns, repairs.json (what was applied,
undone or left, and why) and, where a mapping can say it, repaired_mapping.toml, or one
NAME.repaired_mapping.toml per recording where their repairs differ. Inputs are never changed.
For files without native columns and without --mapping a mapping is proposed: STEM.mapping.toml
of the first file, one for files of one layout, to be checked and edited.
"""
_AUDIT_EXAMPLES = """\
  diffsea audit run1.csv run2.csv
  diffsea audit field/*.csv --mapping field.toml --json
  diffsea audit logged_by_others.csv
  diffsea audit run1.csv --repair -o out/repaired"""
_PREDICT = """\
Replay a recording's orders through a vessel, open loop, from the recorded initial state.
Actuation that was measured (exec_ columns) is used as measured, any other goes through the
vessel's actuators; the result says which. Writes predicted.csv, predict.json with
root-mean-square errors over the whole run and 5, 20 and 60 s ahead of starts along it, and
prediction.png. With --environment-from, current and wind are estimated on the first part of
the run and only the rest is predicted.
"""
_PREDICT_EXAMPLES = """\
  diffsea predict usv.toml run1.csv
  diffsea predict out/fit/vessel.toml run7.csv --mapping field.toml -o out/run7"""


def register(commands) -> None:
    """Add the commands."""
    metrics = options.add_command(
        commands, "metrics", _metrics, "IMO/ITTC numbers of recorded trials", _METRICS,
        _METRICS_EXAMPLES,
    )  # fmt: skip
    options.add_recordings(metrics)
    size = metrics.add_mutually_exclusive_group()
    size.add_argument("--vessel", metavar="V", help="vessel whose length and thrust curves count")
    size.add_argument("--length", metavar="M", type=options.positive, help="L_pp as recorded")
    trials = options.LazyChoices(_recorded_trials)
    metrics.add_argument(
        "--manoeuvre",
        metavar="NAME",
        type=options.one_of(trials, "manoeuvre"),
        choices=trials,
        help="what was run, if known better: %(choices)s",
    )
    metrics.add_argument(
        "--scale", metavar="S", type=options.positive, default=1.0,
        help="full-scale over recorded length, for the verdicts on a model (default: 1)",
    )  # fmt: skip
    audit = options.add_command(
        commands, "audit", _audit, "faults of recordings: frames, units, signs, clocks, sensors",
        _AUDIT, _AUDIT_EXAMPLES,
    )  # fmt: skip
    options.add_recordings(audit)
    audit.add_argument(
        "--repair", action="store_true",
        help="repair what is certain and write repaired recordings, never over the inputs",
    )  # fmt: skip
    predict = options.add_command(
        commands, "predict", _predict, "replay a recording's orders through a vessel", _PREDICT,
        _PREDICT_EXAMPLES,
    )  # fmt: skip
    options.add_vessel(predict)
    options.add_recordings(predict, several=False)
    predict.add_argument(
        "--orders", action="store_true",
        help="use the orders even where executed actuation was measured",
    )  # fmt: skip
    predict.add_argument(
        "--environment-from", metavar="SECONDS", type=options.positive,
        help="estimate current (and wind) on the start of the run and predict the rest",
    )  # fmt: skip


def _recorded_trials() -> dict[str, str]:
    from diffsea.metrics import RECORDED_TRIALS

    return dict.fromkeys(RECORDED_TRIALS, "")


def _metrics(args: argparse.Namespace) -> None:
    from diffsea.metrics import recording_metrics
    from diffsea.metrics.orders import as_thrust

    vessel = options.read_vessel(args).vessel if args.vessel else None
    length = args.length if vessel is None else float(vessel.rigid_body.length)
    runs = options.read_recordings(args.recordings, args.mapping)
    with options.Outputs(args.output) as out:
        found = {
            run.name: recording_metrics(
                run if vessel is None else as_thrust(run, vessel.units), length, args.manoeuvre,
                args.scale,
            )
            for run in runs
        }  # fmt: skip
        (first, *others) = found.values()
        out.json("metrics.json", {"runs": found} if others else first)
    out.present(args, "\n\n".join(f"{n}: {metrics_text(item)}" for n, item in found.items()))


def _audit(args: argparse.Namespace) -> None:
    from diffsea.recordings import audit

    if args.repair:
        _repair(args)
        return
    with options.Outputs(args.output) as out:
        runs, unread, told = proposals.read_recordings(args, out)
        found = [(run.name, audit(run)) for run in runs] + unread
        out.json("audit.json", [item.as_dict() for _, items in found for item in items])
    if told and args.json:
        options.progress(told)
    out.present(args, told + "\n\n".join(_findings_text(name, items) for name, items in found))


def _repair(args: argparse.Namespace) -> None:
    from diffsea.recordings import read_mapping, write_recording
    from diffsea.recordings.auditing.repair import mapping_text, repair

    stems = _repaired_stems(args)
    mapping = read_mapping(args.mapping) if args.mapping else None
    runs = options.read_recordings(args.recordings, args.mapping)
    with options.Outputs(args.output) as out:
        repairs = [repair(run, mapping) for run in runs]
        for stem, done in zip(stems, repairs, strict=True):
            write_recording(done.run, out.path(f"{stem}.repaired.csv"))
        mapped = [any(step.in_mapping for step in done.applied) for done in repairs]
        alike = all(done.mapping == repairs[0].mapping for done in repairs)
        for stem, done, said in zip(stems, repairs, mapped, strict=True):
            name = "repaired_mapping.toml" if alike else f"{stem}.repaired_mapping.toml"
            if said and out.folder / name not in out.files:
                notes = [f"{s.finding.message} ({'' if s.in_mapping else 'not '}repaired here)"
                         for s in done.applied]  # fmt: skip
                text = mapping_text(done.mapping, notes)
                out.path(name).write_text(text, encoding="utf-8")
        out.json("repairs.json", [
            done.as_dict() | {"repaired": f"{stem}.repaired.csv"}
            for stem, done in zip(stems, repairs, strict=True)
        ])  # fmt: skip
        out.json("audit.json", [item.as_dict() for done in repairs for item in done.before])
    out.present(args, "\n\n".join(_repair_text(done) for done in repairs))


def _repaired_stems(args: argparse.Namespace) -> list[str]:
    """The inputs' names without suffix; raises where an output would replace anything."""
    stems = [path.stem for path in args.recordings]
    inputs = {path.resolve() for path in args.recordings}
    for stem in stems:
        written = args.output / f"{stem}.repaired.csv"
        if written.resolve() in inputs:
            raise UserError(f"{written} would be written over a recording; choose a folder with -o")
        if stems.count(stem) > 1:
            raise UserError(f"two recordings would be repaired into {written}; do them in turn")
    return stems


def _repair_text(done: "Repair") -> str:
    lines = [f"{done.run.name}:" if done.steps else f"{done.run.name}: nothing found"]
    for step in done.steps:
        lines.append(f"  {step.outcome:8s} {step.finding.kind:18s} {_size(step.finding)}")
        lines.append(f"    {step.finding.message}")
        lines += [f"    why {step.outcome}: {step.reason}"] if step.outcome != "applied" else []
    return "\n".join(lines)


def _findings_text(name: str, findings: "list[Finding]") -> str:
    if not findings:
        return f"{name}: nothing found"
    lines = [f"{name}:"]
    for item in findings:
        lines.append(f"  {item.kind:18s} {_size(item)}")
        lines.append(f"    {item.message}")
        lines += [f"    repair: {item.repair}"] if item.repair else []
    return "\n".join(lines)


def _size(finding: "Finding") -> str:
    if not math.isfinite(finding.value):
        return ""
    unit = "" if finding.unit == "1" else f" {finding.unit}"
    error = f" +- {finding.std:.2g}" if math.isfinite(finding.std) else ""
    return f"{finding.value:.4g}{error}{unit}"


def _predict(args: argparse.Namespace) -> None:
    from diffsea.recordings import write_recording
    from diffsea.report import pictures
    from diffsea.simulation.actuation import how_actuated
    from diffsea.simulation.replay import horizon_errors, replay, replay_errors
    from diffsea.trajectory import Outcome

    vessel = options.read_vessel(args).vessel
    (recording,) = options.read_recordings([args.recording], args.mapping)
    environment = None
    if args.environment_from is not None:
        from diffsea.identification.holdout import environment_from

        options.progress(f"estimating the environment of the first {args.environment_from:g} s")
        vessel, recording, environment = environment_from(vessel, recording, args.environment_from)
    actuation = how_actuated(vessel, [recording])
    if args.orders:
        actuation = dict.fromkeys(actuation, "reconstructed")
    with options.Outputs(args.output) as out:
        predicted = replay(vessel, recording, not args.orders)
        if predicted.outcome == Outcome.DIVERGED:
            raise UserError(
                f"{recording.name}: {Outcome.DIVERGED.sentence}. The vessel file may not fit the "
                "recording: look at units and signs of the orders (diffsea audit), and at the "
                f"derivatives of {vessel.name!r}"
            )
        ahead = horizon_errors(vessel, recording, measured_actuation=not args.orders)
        result = {
            "vessel": vessel.name,
            "recording": recording.name,
            "actuation": actuation,
            "overall": replay_errors(predicted, recording),
            "horizons": {f"{seconds:g}": errors for seconds, errors in ahead.items()},
            "units": _UNITS | {"horizons": "s"},
            "notes": list(predicted.provenance),
        }
        if environment is not None:
            result["environment"] = {"seconds": args.environment_from, **environment}
        write_recording(predicted, out.path("predicted.csv"))
        out.json("predict.json", result)
        title = f"{recording.name} predicted by {vessel.name}"
        pictures.save_prediction(predicted, recording, out.path("prediction.png"), title)
    out.present(args, _errors_text(result))


def _errors_text(result: dict) -> str:
    names = [name for name in _UNITS if name in result["overall"]]
    shown = {"rad": ("deg", 180 / math.pi), "rad/s": ("deg/s", 180 / math.pi)}
    header = ["root mean square error", *(f"{n} ({shown.get(u, (u, 1))[0]})"
              for n, u in _UNITS.items() if n in names)]  # fmt: skip

    def row(label: str, errors: dict) -> list[str]:
        cells = [shown.get(_UNITS[n], ("", 1.0))[1] * errors.get(n, math.nan) for n in names]
        return [label, *(f"{cell:.3g}" for cell in cells)]

    part = "the rest of the run" if "environment" in result else "the whole run"
    rows = [row(f"over {part}", result["overall"])]
    for seconds, errors in result["horizons"].items():
        rows.append(row(f"{seconds} s ahead of {errors['starts']} starts", errors))
    return "\n".join(
        [options.table(rows, header), *_environment_text(result), "", *result["notes"]]
    )


def _environment_text(result: dict) -> list[str]:
    """The environment that was estimated on the start of the run, a line for each effect."""
    found = result.get("environment", {})
    lines = []
    for name, numbers in found.items():
        if name == "seconds":
            continue
        speed, direction = numbers["speed"], numbers["direction"]
        way = "flowing to" if name == "current" else "from"
        lines.append(
            f"{name} of the first {found['seconds']:g} s: {speed['value']:.3g} +- "
            f"{speed['std']:.2g} m/s {way} {math.degrees(direction['value']):.0f} +- "
            f"{math.degrees(direction['std']):.0f} deg"
        )
    return ["", *lines] if lines else []
