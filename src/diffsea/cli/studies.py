"""Commands for designing: `diffsea sensitivity` and `diffsea run`."""

import argparse
import pathlib

from diffsea.cli import options
from diffsea.cli.options import add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.cli.trial import add_trial_command, require_run, trial_plan


STRONGEST = 5  # parameters of a number that a person is told
WEAKEST = 1e-6  # elasticity below which a parameter has no influence


def register(commands: options.Commands) -> None:
    """Add the commands."""
    summary = "exact derivatives of a trial's numbers"
    sensitivity = add_trial_command(commands, "sensitivity", sensitivity_command, summary)
    parameters = "parameters, separated by commas (default: all of them)"
    add_option(sensitivity, "--parameters", "NAMES", options.names, parameters)
    summary = "a mission in closed loop: vessel, controller, waypoints, weather"
    run = options.add_command(commands, "run", run_command, summary)
    mission = "TOML file of the mission"
    run.add_argument("mission", metavar="MISSION", type=pathlib.Path, help=mission)
    battery = "TOML file: run it so many times with other plants, weathers and seeds"
    add_option(run, "--battery", "FILE", pathlib.Path, battery)


def sensitivity_command(args: argparse.Namespace) -> None:
    """Derivatives of every number of a trial with respect to every parameter of the vessel, exact
    through the switching of orders. The approach speed, the orders and the time step stay as they
    are. Writes sensitivity.json, {metric: {parameter: derivative}} in the SI units of both, and
    tornado.png and sensitivity.html with the relative sensitivities.

    examples:
      diffsea sensitivity kvlcc2 --manoeuvre zigzag --speed 1.179
      diffsea sensitivity usv.toml --manoeuvre turning-circle --parameters mass,N_r,N_rr
    """
    from diffsea.report.pages.studies import sensitivity_page
    from diffsea.report.pictures import save_tornado
    from diffsea.simulation.planning import run_and_measure
    from diffsea.studies.sensitivity import parameter_names, sensitivities

    vessel = options.read_vessel(args).vessel
    parameter_names(vessel, args.parameters)
    plan = trial_plan(args, vessel)
    stages = {"running": 6.0, "differentiating": 20.0, "writing": 1.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell("running the trial")
        trial, _ = run_and_measure(vessel, plan)
        require_run(trial, plan, vessel)
        tell("differentiating")
        found = sensitivities(vessel, plan, args.parameters)
        tell("writing")
        relative, title = found.elasticities, f"{vessel.name}: {plan.manoeuvre}"
        out.json("sensitivity.json", found.derivatives)
        save_tornado(relative, out.path("tornado.png"), title)
        named = vessel.name, plan.manoeuvre
        page = sensitivity_page(relative, found.numbers, named, options.source_of(args))
        out.text("sensitivity.html", page)
    rows = []
    for number, row in relative.items():
        strongest = sorted(row, key=lambda name: -abs(row[name]))[:STRONGEST]
        parts = [f"{name} {row[name]:+.3g}" for name in strongest if abs(row[name]) > WEAKEST]
        rows.append((number, f"{found.numbers[number]:.4g}", ", ".join(parts) or "-"))
    header = ("number", "value (SI)", "% change per 1 % of the strongest parameters")
    out.present(args, table(rows, header))


def run_command(args: argparse.Namespace) -> None:
    """Run a mission in closed loop. Its file names the vessel, the controller with its limits,
    waypoints or timed steps, and may have weather that varies, sensors with noise, and a model
    that the controller believes in instead of the vessel.
    Writes recording.csv (as the sensors show it), truth.csv (the motion itself, where there are
    sensors), run.json with path and time errors, closest approaches and orders against limits,
    and run.html. With --battery it writes run.json with the share of runs in which something went
    wrong, battery.csv with a row for each run, and run.html.

    examples:
      diffsea run examples/missions/survey_in_a_tide.toml
      diffsea run survey.toml --battery examples/missions/batteries/tides_and_loads.toml
      diffsea run mission.toml -o out/mission --json
    """
    from diffsea.recordings import write_recording
    from diffsea.workflows.missions import run_mission

    if args.battery is not None:
        _run_battery(args)
        return
    stages = {"running": 8.0, "writing": 2.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell("running the mission")
        found = run_mission(args.mission)
        tell("writing")
        write_recording(found.recorded, out.path("recording.csv"))
        if found.run.mission.sensors is not None:
            write_recording(found.true, out.path("truth.csv"))
        out.json("run.json", found.numbers)
        out.text("run.html", found.html())
    rows = [(row["number"], f"{row['value']:.3g}", row["unit"]) for row in found.rows()]
    out.present(args, f"{found.headline()}\n{table(rows)}")


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
