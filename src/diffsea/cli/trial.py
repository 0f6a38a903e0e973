"""`diffsea trial`: run a standard trial, and the options that describe one."""

import argparse
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.options import add_choice, add_flag, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.simulation.planning import TrialPlan
    from diffsea.simulation.trials import Trial
    from diffsea.vessel.base import Vessel


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "run a standard trial: recording, metrics, IMO verdict, plots"
    add_trial_command(commands, "trial", trial_command, summary)


def add_trial_command(
    commands: options.Commands,
    name: str,
    run: Callable[[argparse.Namespace], None],
    summary: str,
) -> argparse.ArgumentParser:
    """A command on a vessel, with the options that describe a trial."""
    parser = options.add_command(commands, name, run, summary)
    options.add_vessel(parser)
    group = parser.add_argument_group("trial")
    trials = options.LibraryNames("manoeuvre", "diffsea.simulation.standard:STANDARD_TRIALS")
    add_option(group, "--manoeuvre", "NAME", trials, "%(choices)s", choices=trials, required=True)
    angle = (
        "rudder or rudder-equivalent angle (default: 35 for a turning circle, 20; 10 for a "
        "modified zig-zag)"
    )
    add_option(group, "--angle", "DEG", options.angle, angle)
    heading = "heading change at which a zig-zag switches (default: 20; modified: 1)"
    add_option(group, "--heading", "DEG", options.angle, heading)
    add_choice(group, "--side", ("starboard", "port"), "side of the first order")
    start = group.add_mutually_exclusive_group()
    speed = "approach speed, held until the execute (default: Froude number 0.2)"
    add_option(start, "--speed", "M/S", options.positive, speed)
    thrust = "total thrust, left alone, instead of a speed"
    add_option(start, "--thrust", "N", options.positive, thrust)
    keep = "let the speed controller go on after the execute (by the book it does not)"
    add_flag(group, "--keep-speed", keep)
    seconds = (
        "time limit; for acceleration, coasting, spiral and the straight part of a pull-out how "
        "long each order is held (default: by length and speed)"
    )
    add_option(group, "--seconds", "S", options.positive, seconds)
    step = "time step (default: about 0.05 sqrt(L/g))"
    add_option(group, "--step", "S", options.positive, step)
    executes = "rudder executions of a zig-zag"
    add_option(group, "--executes", "N", options.count, executes, default=4)
    return parser


def trial_plan(args: argparse.Namespace, vessel: "Vessel") -> "TrialPlan":
    """The trial that the options describe; tells the defaults that were taken.

    Raises:
        UserError: a trial that the vessel cannot run, or that would never end.
    """
    from diffsea.simulation.planning import plan_trial

    plan = plan_trial(
        vessel,
        args.manoeuvre,
        angle=args.angle,
        heading=args.heading,
        side=1.0 if args.side == "starboard" else -1.0,
        speed=args.speed,
        thrust=args.thrust,
        seconds=args.seconds,
        step=args.step,
        executes=args.executes,
        keep_speed=args.keep_speed,
    )
    speed = f"{plan.nominal_speed:.4g} m/s"
    if args.speed is None and args.thrust is None:
        options.progress(f"approach at {speed}; choose with --speed or --thrust")
    if args.thrust is not None:
        options.progress(f"{args.thrust:g} N gives {speed} straight ahead")
    options.progress(f"time step {plan.settings.step:g} s")
    return plan


def require_run(trial: "Trial", plan: "TrialPlan", vessel: "Vessel") -> None:
    """Raise `UserError` where a trial has no result: it diverged or was never executed."""
    from diffsea.trajectory import Outcome

    outcome = Outcome(int(trial.trajectory.outcome))
    if outcome is Outcome.DIVERGED:
        raise UserError(
            f"{outcome.sentence}. Try a time step below --step {plan.settings.step:g}, or look at "
            f"the derivatives of {vessel.name!r}: drag and added mass are negative (SNAME signs)"
        )
    if outcome is Outcome.APPROACH_UNSTEADY:
        raise UserError(
            f"{outcome.sentence}: {vessel.name!r} did not settle on a straight course at "
            f"{plan.nominal_speed:.3g} m/s within {plan.approach_seconds:g} s. Try another "
            "--speed; a vessel that is unstable on a straight course, or in a strong current or "
            "wind, may need a higher one"
        )


def trial_command(args: argparse.Namespace) -> None:
    """Run a standard trial: an approach at steady speed, the execute, the manoeuvre to its end.

    Orders switch at the exact instant at which the heading is reached, whatever the step.
    Angles are rudder angles; for twin thrusters 35 deg means all thrust on one side.
    Writes recording.csv, metrics.json (with the verdicts of IMO MSC.137(76)), track.png and
    series.png.

    examples:
      diffsea trial otter --manoeuvre turning-circle
      diffsea trial kvlcc2 --manoeuvre zigzag --angle 10 --heading 10 --speed 1.179
      diffsea trial usv.toml --manoeuvre stopping --thrust 120 -o out/stop
    """
    from diffsea.recordings import write_recording
    from diffsea.report.pictures import save_trial_series, save_trial_track
    from diffsea.simulation import planning

    vessel = options.read_vessel(args).vessel
    plan = trial_plan(args, vessel)
    with Outputs(args.output) as out:
        trial, numbers = planning.run_and_measure(vessel, plan)
        require_run(trial, plan, vessel)
        metrics = planning.summarise_trial(vessel, plan, trial, numbers)
        if metrics["outcome"] != "completed":
            options.progress(f"{metrics['outcome_message']}; give it more with --seconds")
        write_recording(trial.trajectory, out.path("recording.csv"))
        out.json("metrics.json", metrics)
        title = f"{vessel.name}: {plan.manoeuvre}"
        save_trial_track(trial, out.path("track.png"), title)
        save_trial_series(trial, out.path("series.png"), title, vessel)
    out.present(args, metrics_text(metrics))


def metrics_text(metrics: dict[str, Any]) -> str:
    """metrics.json for a person: angles in degrees, lengths in metres and ship lengths.

    A table of numbers, a line for each criterion of IMO MSC.137(76), then the notes.
    """
    head = [metrics["manoeuvre"], metrics.get("side"), metrics.get("outcome")]
    lines = [", ".join(part for part in head if part)]
    rows = []
    for name, value in metrics.items():
        if isinstance(value, float) and not name.endswith("_over_L"):
            over = metrics.get(f"{name}_over_L")
            in_lengths = "" if over is None else f"{over:.3g} L"
            rows.append((name, *_number_and_unit(name, value), in_lengths))
    lines.append(table(rows))
    for name, item in metrics["imo"].items():
        scale, unit = (math.degrees(1.0), "deg") if item["unit"] == "rad" else (1.0, item["unit"])
        value, limit = (f"{scale * item[key]:.3g} {unit}" for key in ("value", "limit"))
        lines.append(f"IMO {item['criterion']}: {name} {value}, limit {limit}: {item['verdict']}")
    return "\n".join([*lines, *(f"note: {note}" for note in metrics["notes"])])


def _number_and_unit(name: str, value: float) -> tuple[str, str]:
    """A number of metrics.json and its unit, for a person."""
    unit = "m/s" if "speed" in name else "m"
    if name == "speed_loss":
        unit = ""
    elif "yaw_rate" in name:
        value, unit = math.degrees(value), "deg/s"
    elif "time" in name or name == "period":
        unit = "s"
    elif any(word in name for word in ("overshoot", "angle", "heading")):
        value, unit = math.degrees(value), "deg"
    return f"{value:.4g}", unit
