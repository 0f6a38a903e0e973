"""Commands for designing: `diffsea sensitivity` and `diffsea sweep`."""

import argparse
import math
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.options import add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.trial import add_trial_options, require_run, trial_plan
from diffsea.errors import UserError


if TYPE_CHECKING:
    import pandas as pd

    from diffsea.studies.sweep import Designs

STRONGEST = 5  # parameters of a number that a person is told
WEAKEST = 1e-6  # elasticity below which a parameter has no influence


def register(commands: options.Commands) -> None:
    """Add the commands."""
    summary = "exact derivatives of a trial's numbers"
    sensitivity = options.add_command(commands, "sensitivity", sensitivity_command, summary)
    options.add_vessel(sensitivity)
    add_trial_options(sensitivity)
    parameters = "parameters, separated by commas (default: all of them)"
    add_option(sensitivity, "--parameters", "NAMES", options.names, parameters)
    summary = "run a trial of many designs at once"
    sweep = options.add_command(commands, "sweep", sweep_command, summary)
    options.add_vessel(sweep)
    add_trial_options(sweep)
    group = sweep.add_argument_group("designs")
    grid, form = "all combinations of evenly spaced values", "NAME=FROM:TO:COUNT"
    add_option(group, "--grid", form, grid_axis, grid, nargs="+", action="extend")
    sample = "N random designs that cover all ranges evenly"
    add_option(group, "--sample", ("N", "NAME=FROM:TO"), str, sample, nargs="+")
    add_option(group, "--seed", "K", int, "of the sample (default: 0)", default=0)
    sweep.set_defaults(usage_error=sweep.error)


def sensitivity_command(args: argparse.Namespace) -> None:
    """Derivatives of every number of a trial with respect to every parameter of the vessel, exact
    through the switching of orders. The approach speed, the orders and the time step stay as they
    are. Writes sensitivity.json, {metric: {parameter: derivative}} in the SI units of both, and
    tornado.png with the relative sensitivities.

    examples:
      diffsea sensitivity kvlcc2 --manoeuvre zigzag --speed 1.179
      diffsea sensitivity usv.toml --manoeuvre turning-circle --parameters mass,N_r,N_rr
    """
    from diffsea.report.pictures import save_tornado
    from diffsea.simulation.planning import run_and_measure
    from diffsea.studies.sensitivity import parameter_names, sensitivities

    vessel = options.read_vessel(args).vessel
    parameter_names(vessel, args.parameters)
    plan = trial_plan(args, vessel)
    with Outputs(args.output) as out:
        trial, _ = run_and_measure(vessel, plan)
        require_run(trial, plan, vessel)
        options.progress("differentiating; the first time takes a while to compile")
        found = sensitivities(vessel, plan, args.parameters)
        out.json("sensitivity.json", found.derivatives)
        save_tornado(
            found.elasticities, out.path("tornado.png"), f"{vessel.name}: {plan.manoeuvre}"
        )
    out.present(args, _strongest_text(found.numbers, found.elasticities))


def _strongest_text(numbers: dict[str, float], relative: dict[str, dict[str, float]]) -> str:
    """The strongest elasticities of every number, a row each.

    Arguments:
        relative: by number, then by parameter: % of change per 1 % of the parameter.
    """
    rows = []
    for number, row in relative.items():
        strongest = sorted(row, key=lambda name: -abs(row[name]))[:STRONGEST]
        parts = [f"{name} {row[name]:+.3g}" for name in strongest if abs(row[name]) > WEAKEST]
        rows.append((number, f"{numbers[number]:.4g}", ", ".join(parts) or "-"))
    header = ("number", "value (SI)", "% change per 1 % of the strongest parameters")
    return table(rows, header)


def grid_axis(text: str) -> tuple[str, tuple[float, float, int]]:
    """A parameter and its evenly spaced values, `NAME=FROM:TO:COUNT`."""
    name, bounds = _name_and_bounds(text, 3, "NAME=FROM:TO:COUNT, for example mass=150:220:8")
    first, last = (options.number(bound) for bound in bounds[:2])
    return name, (first, last, options.count(bounds[2]))


def sample_range(text: str) -> tuple[str, tuple[float, float]]:
    """A parameter and its range, `NAME=FROM:TO`."""
    name, bounds = _name_and_bounds(text, 2, "NAME=FROM:TO, for example mass=150:220")
    return name, (options.number(bounds[0]), options.number(bounds[1]))


def _name_and_bounds(text: str, parts: int, form: str) -> tuple[str, list[str]]:
    name, equals, values = text.partition("=")
    bounds = values.split(":")
    if not (name and equals and len(bounds) == parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form {form}")
    return name, bounds


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
        axes = _by_name([sample_range(text) for text in ranges])
        return sweep.sample(axes, options.count(number), args.seed)
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise


def _by_name(axes: list[tuple[str, Any]]) -> dict[str, Any]:
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
    summary in sweep.json; and map.png for a grid over two parameters. A design that diverges or is
    impossible has nulls and its outcome says so.

    examples:
      diffsea sweep wamv --manoeuvre zigzag --grid mass=200:350:16 N_r=-1200:-500:16
      diffsea sweep usv.toml --manoeuvre turning-circle --sample 2000 mass=150:220 x_G=-0.3:0.3
      diffsea sweep kvlcc2 --manoeuvre zigzag --grid speed=0.6:1.2:7
    """
    from diffsea.report.pictures import save_map
    from diffsea.studies import sweep

    designs = _designs(args)
    vessel = options.read_vessel(args).vessel
    sweep.check_names(vessel, designs.names)
    plan = trial_plan(_at_slowest(args, designs), vessel)
    options.progress(f"{len(designs.values)} designs; the first block is compiled")
    with Outputs(args.output) as out:
        found, rate = sweep.sweep(vessel, plan, designs, options.progress)
        summary = sweep_summary(found, designs, rate)
        found.to_parquet(out.path("sweep.parquet"), index=False)
        out.json("sweep.json", {"vessel": vessel.name, "manoeuvre": plan.manoeuvre, **summary})
        if args.grid is not None and len(designs.names) == 2:
            title = f"{vessel.name}: {plan.manoeuvre}"
            save_map(found, designs.names, out.path("map.png"), title)
    out.present(args, _summary_text(summary))


def _at_slowest(args: argparse.Namespace, designs: "Designs") -> argparse.Namespace:
    """The options with the lowest speed or thrust of a sweep over it: time limits follow it."""
    for k, name in enumerate(designs.names):
        if name not in ("speed", "thrust"):
            continue
        if args.speed is not None or args.thrust is not None:
            args.usage_error(f"{name} is swept: leave --speed and --thrust out")
        lowest = float(designs.values[:, k].min())
        if lowest <= 0:
            raise UserError(f"{name} must be above zero in every design; the lowest is {lowest:g}")
        args = argparse.Namespace(**{**vars(args), name: lowest})
    return args


def sweep_summary(found: "pd.DataFrame", designs: "Designs", rate: float) -> dict[str, Any]:
    """The content of sweep.json, all but what was swept.

    Arguments:
        found: a row for each design.
        rate: vessel-steps per second.
    """
    numbers = [str(name) for name in found.select_dtypes("number") if name not in designs.names]
    verdicts = [str(name) for name in found if str(name).startswith("imo_")]
    metrics, imo = {}, {}
    for name in numbers:
        column = found[name]
        least, median, most = map(float, column.agg(["min", "median", "max"]))
        count = len(column.dropna())
        metrics[name] = {"least": least, "median": median, "most": most, "designs": count}
    for name in verdicts:
        counts = {word: list(found[name]).count(word) for word in ("pass", "fail")}
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
        "vessel_steps_per_second": rate,
    }


def _summary_text(summary: dict[str, Any]) -> str:
    outcomes = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
    rate = f"{summary['vessel_steps_per_second']:.2g} vessel-steps/s"
    lines = [f"{summary['designs']} designs ({outcomes}), {rate}"]
    rows = [
        (name, *(f"{column[key]:.4g}" for key in ("least", "median", "most")))
        for name, column in summary["metrics"].items()
        if math.isfinite(column["median"])
    ]
    if rows:
        lines.append(table(rows, ("number (SI)", "least", "median", "most")))
    for name, verdict in summary["imo"].items():
        lines.append(f"IMO {name}: {verdict['pass']} pass, {verdict['fail']} fail")
    return "\n".join(lines)
