"""`diffsea trial`: run a standard trial, and the options that describe one."""

import argparse
import math
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.errors import UserError


if TYPE_CHECKING:
    from diffsea.simulation.standard import TrialPlan
    from diffsea.vessel.base import Vessel


_DESCRIPTION = """\
Run a standard trial: an approach at steady speed, the execute, the manoeuvre to its end.

Orders switch at the exact instant at which the heading is reached, whatever the step.
Angles are rudder angles; for twin thrusters 35 deg means all thrust on one side.
Writes recording.csv, metrics.json (with the verdicts of IMO MSC.137(76)), track.png and
series.png.
"""
_EXAMPLES = """\
  diffsea trial otter --manoeuvre turning-circle
  diffsea trial kvlcc2 --manoeuvre zigzag --angle 10 --heading 10 --speed 1.179
  diffsea trial usv.toml --manoeuvre stopping --thrust 120 -o out/stop"""


def register(commands) -> None:
    """Add the command."""
    parser = options.add_command(
        commands, "trial", _run, "run a standard trial: recording, metrics, IMO verdict, plots",
        _DESCRIPTION, _EXAMPLES,
    )  # fmt: skip
    options.add_vessel(parser)
    add_trial_options(parser)


def add_trial_options(parser: argparse.ArgumentParser) -> None:
    """The options that describe a trial."""
    group = parser.add_argument_group("trial")
    trials = options.LazyChoices(_standard_trials)
    group.add_argument(
        "--manoeuvre",
        metavar="NAME",
        required=True,
        type=options.one_of(trials, "manoeuvre"),
        choices=trials,
        help="%(choices)s",
    )
    group.add_argument(
        "--angle", metavar="DEG", type=options.angle,
        help="rudder or rudder-equivalent angle (default: 35 for a turning circle, 20; 10 for a "
        "modified zig-zag)",
    )  # fmt: skip
    group.add_argument(
        "--heading", metavar="DEG", type=options.angle,
        help="heading change at which a zig-zag switches (default: 20; modified: 1)",
    )  # fmt: skip
    group.add_argument(
        "--side", choices=("port", "starboard"), default="starboard",
        help="side of the first order (default: %(default)s)",
    )  # fmt: skip
    start = group.add_mutually_exclusive_group()
    start.add_argument(
        "--speed", metavar="M/S", type=options.positive,
        help="approach speed, held until the execute (default: Froude number 0.2)",
    )  # fmt: skip
    start.add_argument(
        "--thrust", metavar="N", type=options.positive,
        help="total thrust, left alone, instead of a speed",
    )  # fmt: skip
    group.add_argument(
        "--keep-speed", action="store_true",
        help="let the speed controller go on after the execute (by the book it does not)",
    )  # fmt: skip
    group.add_argument(
        "--seconds", metavar="S", type=options.positive,
        help="time limit; for acceleration, coasting, spiral and the straight part of a pull-out "
        "how long each order is held (default: by length and speed)",
    )  # fmt: skip
    group.add_argument(
        "--step", metavar="S", type=options.positive,
        help="time step (default: about 0.05 sqrt(L/g))",
    )  # fmt: skip
    group.add_argument(
        "--executes", metavar="N", type=options.count, default=4,
        help="rudder executions of a zig-zag (default: %(default)s)",
    )  # fmt: skip


def _standard_trials() -> dict[str, str]:
    from diffsea.simulation.standard import STANDARD_TRIALS

    return {name: trial.help for name, trial in STANDARD_TRIALS.items()}


def plan_of(args: argparse.Namespace, vessel: "Vessel") -> "TrialPlan":
    """The trial that the options describe; tells the defaults that were taken."""
    from diffsea.simulation import planning

    plan = planning.plan_trial(
        vessel,
        args.manoeuvre,
        angle=None if args.angle is None else math.radians(args.angle),
        heading=None if args.heading is None else math.radians(args.heading),
        side=1.0 if args.side == "starboard" else -1.0,
        speed=args.speed,
        thrust=args.thrust,
        seconds=args.seconds,
        step=args.step,
        executes=args.executes,
        keep_speed=args.keep_speed,
    )
    if args.speed is None and args.thrust is None:
        options.progress(
            f"approach at {plan.nominal_speed:.4g} m/s; choose with --speed or --thrust"
        )
    if args.thrust is not None:
        options.progress(f"{args.thrust:g} N gives {plan.nominal_speed:.4g} m/s straight ahead")
    options.progress(f"time step {plan.settings.step:g} s")
    return plan


def require_run(trial, plan: "TrialPlan", vessel: "Vessel") -> None:
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


def _run(args: argparse.Namespace) -> None:
    from diffsea.recordings import write_recording
    from diffsea.report import pictures
    from diffsea.simulation import planning

    vessel = options.read_vessel(args).vessel
    plan = plan_of(args, vessel)
    with options.Outputs(args.output) as out:
        trial, numbers = planning.run_and_measure(vessel, plan)
        require_run(trial, plan, vessel)
        metrics = planning.summarise_trial(vessel, plan, trial, numbers)
        if metrics["outcome"] != "completed":
            options.progress(f"{metrics['outcome_message']}; give it more with --seconds")
        write_recording(trial.trajectory, out.path("recording.csv"))
        out.json("metrics.json", metrics)
        title = f"{vessel.name}: {plan.manoeuvre}"
        pictures.save_trial_track(trial, out.path("track.png"), title)
        pictures.save_trial_series(trial, out.path("series.png"), title, vessel.units)
    out.present(args, metrics_text(metrics))


def metrics_text(metrics: dict) -> str:
    """metrics.json for a person: angles in degrees, lengths in metres and ship lengths."""
    head = [metrics["manoeuvre"], metrics.get("side"), metrics.get("outcome")]
    lines = [", ".join(part for part in head if part)]
    rows = []
    for name, value in metrics.items():
        if isinstance(value, float) and not name.endswith("_over_L"):
            over = metrics.get(f"{name}_over_L")
            rows.append((name, *_shown(name, value), "" if over is None else f"{over:.3g} L"))
    lines.append(options.table(rows))
    for name, item in metrics["imo"].items():
        degrees = item["unit"] == "rad"
        value, limit = (
            math.degrees(item[key]) if degrees else item[key] for key in ("value", "limit")
        )
        unit = "deg" if degrees else item["unit"]
        lines.append(
            f"IMO {item['criterion']}: {name} {value:.3g} {unit}, limit {limit:.3g} {unit}: "
            f"{item['verdict']}"
        )
    return "\n".join([*lines, *(f"note: {note}" for note in metrics["notes"])])


def _shown(name: str, value: float) -> tuple[str, str]:
    """A number of metrics.json and its unit, for a person."""
    if name in ("speed_loss",):
        return f"{value:.4g}", ""
    if "yaw_rate" in name:
        return f"{math.degrees(value):.4g}", "deg/s"
    if "time" in name or name == "period":
        return f"{value:.4g}", "s"
    if any(word in name for word in ("overshoot", "angle", "heading")):
        return f"{math.degrees(value):.4g}", "deg"
    return f"{value:.4g}", "m/s" if "speed" in name else "m"
