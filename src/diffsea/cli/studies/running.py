"""`diffsea run`: a mission in closed loop, once, with many plants or numbers, or tuned."""

import argparse
import pathlib
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.cli.grammar import GivenOnce
from diffsea.cli.options import add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.cli.studies.axes import GRID_FORM, RANGE_FORM, axis, by_name, range_of


if TYPE_CHECKING:
    from diffsea.workflows.missions import MissionResult


STARTS = 3  # of a tuning, as the library has it, which would import JAX to be asked
EFFORT = 1.0


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "a mission in closed loop: vessel, controller, waypoints, weather"
    run = options.add_command(commands, "run", run_command, summary)
    mission = "TOML file of the mission"
    run.add_argument("mission", metavar="MISSION", type=pathlib.Path, help=mission)
    many = run.add_argument_group("many runs, one of")
    several = many.add_mutually_exclusive_group()
    battery = "TOML file: run it so many times with other plants, weathers and seeds"
    add_option(several, "--battery", "FILE", pathlib.Path, battery)
    grid = "run it with all combinations of numbers of the mission"
    add_option(several, "--grid", GRID_FORM, axis, grid, nargs="+", action=GivenOnce)
    tune = "tune numbers of the mission by derivatives through the closed loop, then run it"
    add_option(several, "--tune", RANGE_FORM, range_of, tune, nargs="+", action=GivenOnce)
    tuning = run.add_argument_group("tuning")
    judge = "missions that judge what was tuned (default: the path turned by 120 deg, other seed)"
    add_option(tuning, "--judge", "MISSION", pathlib.Path, judge, nargs="+")
    starts = "the numbers as they stand, and others spread over the ranges"
    add_option(tuning, "--starts", "N", options.count, starts, default=STARTS)
    effort = "what the mean square change of orders costs, beside that of the errors"
    add_option(tuning, "--effort", "W", options.number, effort, default=EFFORT)
    run.set_defaults(usage_error=run.error)


def run_command(args: argparse.Namespace) -> None:
    """Run a mission in closed loop. Its file names the vessel, the controller with its limits,
    waypoints or timed steps, and may have weather that varies, sensors with noise, and a model
    that the controller believes in instead of the vessel.
    Writes recording.csv (as the sensors show it), truth.csv (the motion itself, where there are
    sensors), run.json with path and time errors, closest approaches and orders against limits,
    and run.html. With --battery it writes run.json with the share of runs in which something went
    wrong, battery.csv with a row for each run, and run.html; with --grid run.json, grid.csv with a
    row for each combination, and run.html.
    A number is named as in the file, its tables joined by dots: controller.lookahead,
    controller.heading.gain, model.mass, weather.current.speed; its end will do where it is the
    only one. --tune writes the tuned mission as mission.toml, and runs it.

    examples:
      diffsea run examples/missions/survey_in_a_tide.toml
      diffsea run survey.toml --battery examples/missions/batteries/tides_and_loads.toml
      diffsea run survey.toml --grid lookahead=3:12:10 heading.gain=0.5:3:6
      diffsea run survey.toml --tune lookahead=3:12 heading.gain=0.5:3 --judge other.toml
      diffsea run mission.toml -o out/mission --json
    """
    if args.judge is not None and args.tune is None:
        args.usage_error("--judge belongs to --tune")
    if not args.effort >= 0:
        args.usage_error(f"--effort {args.effort:g} is negative")
    if args.battery is not None:
        _run_battery(args)
    elif args.grid is not None:
        _run_grid(args)
    elif args.tune is not None:
        _tune(args)
    else:
        _run_once(args)


def _run_once(args: argparse.Namespace) -> None:
    """The mission as it stands."""
    from diffsea.workflows.missions import run_mission

    with Outputs(args.output) as out, StagedProgress({"running": 8.0, "writing": 2.0}) as tell:
        tell("running the mission")
        found = run_mission(args.mission)
        tell("writing")
        _write_run(found, out)
        out.json("run.json", found.numbers)
        out.text("run.html", found.html())
    out.present(args, _text(found))


def _write_run(found: "MissionResult", out: Outputs) -> None:
    """The recording, and the motion itself where sensors showed something else."""
    from diffsea.recordings import write_recording

    write_recording(found.recorded, out.path("recording.csv"))
    if found.run.mission.sensors is not None:
        write_recording(found.true, out.path("truth.csv"))


def _text(found: "MissionResult") -> str:
    rows = [(row["number"], f"{row['value']:.3g}", row["unit"]) for row in found.rows()]
    return f"{found.headline()}\n{table(rows)}"


def _run_battery(args: argparse.Namespace) -> None:
    """The mission with what its battery draws, run by run."""
    from diffsea.progress import PartialProgress
    from diffsea.workflows.missions import run_battery

    with Outputs(args.output) as out:
        with StagedProgress(1) as tell:
            tell("running the battery")
            found = run_battery(
                args.mission,
                args.battery,
                lambda share: tell(PartialProgress("running the battery", share)),
            )
        found.to_frame().to_csv(out.path("battery.csv"), index=False)
        out.json("run.json", found.numbers)
        out.text("run.html", found.html())
    out.present(args, "\n".join([found.headline(), *found.notes()]))


def _run_grid(args: argparse.Namespace) -> None:
    """The mission with every combination of some of its numbers."""
    from diffsea.simulation.designs import Grid
    from diffsea.workflows.missions import sweep_mission

    try:
        space = Grid(by_name(args.grid))
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise
    with Outputs(args.output) as out:
        with StagedProgress({"running": 20.0}) as tell:
            tell(f"running {space.count} designs")
            found = sweep_mission(args.mission, space, tell)
        found.to_frame().to_csv(out.path("grid.csv"), index=False)
        out.json("run.json", found.numbers)
        out.text("run.html", found.html())
    rows = [tuple(f"{value:.4g}" for value in row.values()) for row in found.best_rows()]
    header = tuple(found.best_rows()[0]) if rows else ()
    out.present(args, "\n".join([found.headline(), *found.notes(), table(rows, header)]))


def _tune(args: argparse.Namespace) -> None:
    """The mission with some numbers tuned, and run with them."""
    from diffsea.workflows.missions import tune_mission

    try:
        ranges = by_name(args.tune)
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise
    with Outputs(args.output) as out:
        with StagedProgress({"tuning": 60.0, "writing": 3.0}) as tell:
            tell("tuning")
            asked = {"starts": args.starts, "effort": args.effort}
            found = tune_mission(args.mission, ranges, args.judge or (), **asked, progress=tell)
            tell("writing")
            _write_run(found, out)
            out.text("mission.toml", found.mission_file(args.output))
            out.json("run.json", found.numbers)
            out.text("run.html", found.html())
    out.present(args, "\n".join([*found.tuning_lines(), "", _text(found)]))
