"""Commands for designing: `diffsea sensitivity`, `diffsea sweep` and `diffsea run`."""

import argparse
import math
import pathlib
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.grammar import GivenOnce
from diffsea.cli.options import add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress import StagedProgress
from diffsea.cli.trial import add_trial_command, require_run, trial_plan
from diffsea.errors import UserError


if TYPE_CHECKING:
    import pandas as pd

    from diffsea.studies.sweep import Designs


STRONGEST = 5  # parameters of a number that a person is told
WEAKEST = 1e-6  # elasticity below which a parameter has no influence
AXIS_FORMS = {"NAME=FROM:TO:COUNT": "mass=150:220:8", "NAME=FROM:TO": "mass=150:220"}  # examples


def register(commands: options.Commands) -> None:
    """Add the commands."""
    summary = "exact derivatives of a trial's numbers"
    sensitivity = add_trial_command(commands, "sensitivity", sensitivity_command, summary)
    parameters = "parameters, separated by commas (default: all of them)"
    add_option(sensitivity, "--parameters", "NAMES", options.names, parameters)
    summary = "run a trial of many designs at once"
    sweep = add_trial_command(commands, "sweep", sweep_command, summary)
    group = sweep.add_argument_group("designs")
    grid, form = "all combinations of evenly spaced values", "NAME=FROM:TO:COUNT"
    add_option(group, "--grid", form, axis, grid, nargs="+", action=GivenOnce)
    sample = "N random designs that cover all ranges evenly"
    form = ("N", "NAME=FROM:TO")
    add_option(group, "--sample", form, str, sample, nargs="+", action=GivenOnce)
    add_option(group, "--seed", "K", int, "of the sample (default: 0)", default=0)
    sweep.set_defaults(usage_error=sweep.error)
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


def axis(text: str, form: str = "NAME=FROM:TO:COUNT") -> tuple[str, tuple[Any, ...]]:
    """A parameter and its values: from, to and, where the form has it, how many.

    Raises:
        ArgumentTypeError: another form, a number that is not finite, or a count below one.
    """
    name, equals, values = text.partition("=")
    bounds = values.split(":")
    if not (name and equals and len(bounds) == len(form.split(":"))):
        example = AXIS_FORMS[form]
        raise argparse.ArgumentTypeError(
            f"{text!r} is not of the form {form}, for example {example}"
        )
    first, last = (options.number(bound) for bound in bounds[:2])
    return name, (first, last, *map(options.count, bounds[2:]))


def _designs(args: argparse.Namespace) -> "Designs":
    """What `--grid` or `--sample` asks for; bad usage ends here."""
    from diffsea.studies import sweep

    if (args.grid is None) == (args.sample is None):
        args.usage_error("give either --grid or --sample")
    try:
        if args.grid is not None:
            return sweep.grid(_by_name(args.grid))
        number, *ranges = args.sample
        if not ranges:
            raise argparse.ArgumentTypeError("give a number of designs, then NAME=FROM:TO")
        axes = _by_name([axis(text, "NAME=FROM:TO") for text in ranges])
        return sweep.sample(axes, options.count(number), args.seed)
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise


def _by_name(axes: list[tuple[str, Any]]) -> dict[str, Any]:
    """The axes by parameter; one that is given twice is bad usage."""
    names = [name for name, _ in axes]
    for name in names:
        if names.count(name) > 1:
            raise argparse.ArgumentTypeError(f"{name!r} is given twice")
    return dict(axes)


def sweep_command(args: argparse.Namespace) -> None:
    """Run a trial of many designs. A design is the vessel with some parameters changed: any number
    of the vessel file by name (mass, N_r, rudder.area ...), the approach speed (speed, m/s) or the
    total thrust (thrust, N). All values are in SI units.
    Writes sweep.parquet with one row per design: parameters, metrics, IMO verdicts and outcome; a
    summary in sweep.json; sweep.html; and map.png for a grid over two parameters. A design that
    diverges or is impossible has nulls and its outcome says so.

    examples:
      diffsea sweep wamv --manoeuvre zigzag --grid mass=200:350:16 N_r=-1200:-500:16
      diffsea sweep usv.toml --manoeuvre turning-circle --sample 2000 mass=150:220 x_G=-0.3:0.3
      diffsea sweep kvlcc2 --manoeuvre zigzag --grid speed=0.6:1.2:7
    """
    from diffsea.report.pages.studies import sweep_page
    from diffsea.report.pictures import save_map
    from diffsea.studies import sweep

    designs = _designs(args)
    vessel = options.read_vessel(args).vessel
    sweep.check_names(vessel, designs.names)
    plan = trial_plan(_at_slowest(args, designs), vessel)
    with Outputs(args.output) as out, StagedProgress({"running": 20.0, "writing": 1.0}) as tell:
        tell(f"running {len(designs.values)} designs")
        found, rate = sweep.sweep(vessel, plan, designs, tell)
        tell("writing")
        summary = _sweep_summary(found, designs)
        summary["vessel_steps_per_second"] = rate
        found.to_parquet(out.path("sweep.parquet"), index=False)
        summary = {"vessel": vessel.name, "manoeuvre": plan.manoeuvre, **summary}
        out.json("sweep.json", summary)
        out.text("sweep.html", sweep_page(found, summary, options.source_of(args)))
        if args.grid is not None and len(designs.names) == 2:
            title = f"{vessel.name}: {plan.manoeuvre}"
            save_map(found, designs.names, out.path("map.png"), title)
    outcomes = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
    lines = [f"{summary['designs']} designs ({outcomes}), {rate:.2g} vessel-steps/s"]
    rows = [
        (name, *(f"{column[key]:.4g}" for key in ("least", "median", "most")))
        for name, column in summary["metrics"].items()
        if math.isfinite(column["median"])
    ]
    lines += [table(rows, ("number (SI)", "least", "median", "most"))] if rows else []
    for name, verdict in summary["imo"].items():
        lines.append(f"IMO {name}: {verdict['pass']} pass, {verdict['fail']} fail")
    out.present(args, "\n".join(lines))


def _at_slowest(args: argparse.Namespace, designs: "Designs") -> argparse.Namespace:
    """The options with the lowest speed or thrust of a sweep over it: time limits follow it."""
    for name, lowest in designs.slowest().items():
        if args.speed is not None or args.thrust is not None:
            args.usage_error(f"{name} is swept: leave --speed and --thrust out")
        if lowest <= 0:
            raise UserError(f"{name} must be above zero in every design; the lowest is {lowest:g}")
        args = argparse.Namespace(**{**vars(args), name: lowest})
    return args


def _sweep_summary(found: "pd.DataFrame", designs: "Designs") -> dict[str, Any]:
    """The content of sweep.json, all but what was swept and how fast; `found` has designs as rows.

    Counts of outcomes and of IMO verdicts; least, median and most of each number in SI units.
    """
    metrics, imo = {}, {}
    for name, column in found.drop(columns=[*designs.names]).select_dtypes("number").items():
        least, median, most = map(float, column.agg(["min", "median", "max"]))
        extent = {"least": least, "median": median, "most": most}
        metrics[str(name)] = extent | {"designs": len(column.dropna())}
    for name in map(str, found):
        if name.startswith("imo_"):
            verdicts = list(found[name])
            counts = {word: verdicts.count(word) for word in ("pass", "fail")}
            imo[name.removeprefix("imo_")] = counts
    return {
        "designs": len(found),
        "parameters": {
            name: {"from": float(column.min()), "to": float(column.max())}
            for name, column in zip(designs.names, designs.values.T, strict=True)
        },
        "outcomes": {str(k): int(n) for k, n in found["outcome"].value_counts().items()},
        "metrics": metrics,
        "imo": imo,
    }


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
