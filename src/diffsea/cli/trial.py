"""`diffsea trial` and `diffsea campaign`: standard trials, and the options that describe one."""

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.options import add_choice, add_flag, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.errors import UserError
from diffsea.runtime import prepare_jax


if TYPE_CHECKING:
    from diffsea.simulation.planning import TrialPlan
    from diffsea.simulation.trials import Trial
    from diffsea.vessel.base import Vessel
    from diffsea.workflows.campaigns import PlannedTrial

# As the library has them, which would import JAX to be asked; what each is, its table says.
STANDARD_TRIALS = (
    *("turning-circle", "zigzag", "modified-zigzag", "acceleration", "stopping", "coasting"),
    *("pull-out", "spiral"),
)
TABLE_OF_TRIALS = "diffsea.simulation.standard:STANDARD_TRIALS"
RUN_OPTIONS = ("speed", "thrust", "seconds", "step", "executes", "keep_speed")


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "run a standard trial: recording, metrics, IMO verdict, plots"
    add_trial_command(commands, "trial", trial_command, summary)
    summary = "the standard trials both ways with their verdicts"
    parser = options.add_command(commands, "campaign", campaign_command, summary)
    options.add_vessel(parser)
    group = parser.add_argument_group("trials")
    trials = (
        "what to run, with other angles than the usual ones where they are given, for example "
        "zigzag:10/10 (default: turning-circle:35 zigzag:10/10 zigzag:20/20)"
    )
    form = "NAME[:ANGLE[/HEADING]]"
    add_option(group, "--trials", form, planned_trial, trials, nargs="+")
    _add_run_options(group)


def add_trial_command(
    commands: options.Commands,
    name: str,
    run: Callable[[argparse.Namespace], None],
    summary: str,
    needed: bool = True,
) -> argparse.ArgumentParser:
    """A command on a vessel, with the options that describe a trial, which may be `needed`."""
    parser = options.add_command(commands, name, run, summary)
    options.add_vessel(parser)
    group = parser.add_argument_group("trial")
    trials = options.LibraryNames(STANDARD_TRIALS, "manoeuvre", TABLE_OF_TRIALS)
    add_option(group, "--manoeuvre", "NAME", trials, "%(choices)s", choices=trials, required=needed)
    angle = (
        "rudder or rudder-equivalent angle (default: 35 for a turning circle, 20; 10 for a "
        "modified zig-zag)"
    )
    add_option(group, "--angle", "DEG", options.angle, angle)
    heading = "heading change at which a zig-zag switches (default: 20; modified: 1)"
    add_option(group, "--heading", "DEG", options.angle, heading)
    add_choice(group, "--side", ("starboard", "port"), "side of the first order")
    _add_run_options(group)
    return parser


def _add_run_options(group: argparse._ArgumentGroup) -> None:
    """How trials are run: speed or thrust, time limit, step, executes."""
    start = group.add_mutually_exclusive_group()
    usual = "Froude number 0.2, at most 80 %% of top speed"
    speed = f"approach speed, held until the execute (default: {usual})"
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
    Writes recording.csv, metrics.json (with the verdicts of IMO MSC.137(76)), trial.html,
    track.png and series.png.

    examples:
      diffsea trial otter --manoeuvre turning-circle
      diffsea trial kvlcc2 --manoeuvre zigzag --angle 10 --heading 10 --speed 1.179
      diffsea trial usv.toml --manoeuvre stopping --thrust 120 -o out/stop
    """
    from diffsea.recordings import write_recording
    from diffsea.report.pictures import save_trial_series, save_trial_track
    from diffsea.simulation import planning
    from diffsea.workflows.campaigns import trial_of_plan

    vessel = options.read_vessel(args).vessel
    plan = trial_plan(args, vessel)
    stages = {"running": 6.0, "writing": 2.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell("running the trial")
        trial, numbers = planning.run_and_measure(vessel, plan)
        require_run(trial, plan, vessel)
        metrics = planning.summarise_trial(vessel, plan, trial, numbers)
        if metrics["outcome"] != "completed":
            options.progress(f"{metrics['outcome_message']}; give it more with --seconds")
        tell("writing")
        write_recording(trial.trajectory, out.path("recording.csv"))
        out.json("metrics.json", metrics)
        title = f"{vessel.name}: {plan.manoeuvre}"
        save_trial_track(trial, out.path("track.png"), title)
        save_trial_series(trial, out.path("series.png"), title, vessel)
        out.text("trial.html", trial_of_plan(vessel, plan, trial, metrics).html())
    out.present(args, metrics_text(metrics))


def planned_trial(text: str) -> "PlannedTrial":
    """A type of argument: a trial of a campaign, such as `zigzag:10/10`."""
    prepare_jax()
    from diffsea.workflows.campaigns import PlannedTrial

    try:
        return PlannedTrial.from_text(text)
    except UserError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def campaign_command(args: argparse.Namespace) -> None:
    """Run the standard trials to both sides: turning circle, zig-zags 10/10 and 20/20, or others.
    Judges them by IMO MSC.137(76), says how steadily each was begun, checks what was executed of
    what was ordered, and compares both sides. A trial that fails is told and the others go on.
    Writes campaign.json, campaign.html, and of every trial its recording and its log with derived
    quantities (headings wrapped and relative, reconstructed yaw rate, steering angles, thrusts,
    yaw moment), time from the onset.

    examples:
      diffsea campaign otter
      diffsea campaign kvlcc2 --speed 1.179
      diffsea campaign usv.toml --trials turning-circle zigzag:5/5 stopping --thrust 120
    """
    import pandas as pd

    from diffsea.recordings import write_recording
    from diffsea.workflows.campaigns import USUAL_TRIALS, campaign

    vessel = options.read_vessel(args).vessel
    asked = args.trials or USUAL_TRIALS
    run_options = {key: getattr(args, key) for key in RUN_OPTIONS}
    with Outputs(args.output) as out:
        with StagedProgress(sum(len(one.sides) for one in asked)) as tell:
            found = campaign(vessel, asked, tell, **run_options)
        for one in found.trials:
            if one.run is not None:
                write_recording(one.run, out.path(f"{one.file_name}.csv"))
                log = pd.DataFrame(one.log)
                log.to_csv(out.path(f"{one.file_name}-log.csv"), index=False, float_format="%.8g")
        out.json("campaign.json", found.record)
        out.text("campaign.html", found.html())
    header = tuple(found.rows()[0])
    rows = table([tuple(row.values()) for row in found.rows()], header)
    notes = [f"note: {note}" for note in found.notes()]
    out.present(args, "\n".join([found.headline(), rows, *notes]))


def metrics_text(metrics: dict[str, Any]) -> str:
    """metrics.json for a person: angles in degrees, lengths in metres and ship lengths.

    A table of numbers, a line for each criterion of IMO MSC.137(76), then the notes.
    """
    from diffsea.metrics.numbers import numbers_of
    from diffsea.report.quantities import for_people

    head = [metrics["manoeuvre"], metrics.get("side"), metrics.get("outcome")]
    lines = [", ".join(part for part in head if part)]
    rows = []
    for one in numbers_of(metrics):
        value, unit = for_people(one.value, one.unit)
        in_lengths = "" if one.over_length is None else f"{one.over_length:.3g} L"
        rows.append((one.name, f"{value:.4g}", unit, in_lengths))
    lines.append(table(rows))
    for name, item in metrics["imo"].items():
        told = (for_people(item[key], item["unit"]) for key in ("value", "limit"))
        value, limit = (f"{size:.3g} {unit}" for size, unit in told)
        lines.append(f"IMO {item['criterion']}: {name} {value}, limit {limit}: {item['verdict']}")
    return "\n".join([*lines, *(f"note: {note}" for note in metrics["notes"])])
