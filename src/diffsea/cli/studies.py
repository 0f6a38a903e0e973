"""Commands for designing: `sensitivity` and `sweep`."""

import argparse
import math
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.cli.trial import add_trial_options, plan_of, require_run
from diffsea.errors import UserError


if TYPE_CHECKING:
    import pandas as pd

    from diffsea.studies.sweep import Designs


_SENSITIVITY = """\
Derivatives of every number of a trial with respect to every parameter of the vessel, exact
through the switching of orders. The approach speed, the orders and the time step stay as they
are. Writes sensitivity.json, {metric: {parameter: derivative}} in the SI units of both, and
tornado.png with the relative sensitivities.
"""
_SENSITIVITY_EXAMPLES = """\
  diffsea sensitivity kvlcc2 --manoeuvre zigzag --speed 1.179
  diffsea sensitivity usv.toml --manoeuvre turning-circle --parameters mass,N_r,N_rr"""
_SWEEP = """\
Run a trial of many designs. A design is the vessel with some parameters changed: any number of
the vessel file by name (mass, N_r, rudder.area ...), the approach speed (speed, m/s) or the
total thrust (thrust, N). All values are in SI units.
Writes sweep.parquet with one row per design: parameters, metrics, IMO verdicts and outcome; a
summary in sweep.json; and map.png for a grid over two parameters. A design that diverges or is
impossible has nulls and its outcome says so.
"""
_SWEEP_EXAMPLES = """\
  diffsea sweep wamv --manoeuvre zigzag --grid mass=200:350:16 N_r=-1200:-500:16
  diffsea sweep usv.toml --manoeuvre turning-circle --sample 2000 mass=150:220 x_G=-0.3:0.3
  diffsea sweep kvlcc2 --manoeuvre zigzag --grid speed=0.6:1.2:7"""


def register(commands) -> None:
    """Add the commands."""
    sensitivity = options.add_command(
        commands, "sensitivity", _sensitivity, "exact derivatives of a trial's numbers",
        _SENSITIVITY, _SENSITIVITY_EXAMPLES,
    )  # fmt: skip
    options.add_vessel(sensitivity)
    add_trial_options(sensitivity)
    sensitivity.add_argument(
        "--parameters", metavar="NAMES", type=options.names,
        help="parameters, separated by commas (default: all of them)",
    )  # fmt: skip
    sweep = options.add_command(
        commands, "sweep", _sweep, "run a trial of many designs at once", _SWEEP, _SWEEP_EXAMPLES
    )
    options.add_vessel(sweep)
    add_trial_options(sweep)
    group = sweep.add_argument_group("designs")
    group.add_argument(
        "--grid", metavar="NAME=FROM:TO:COUNT", nargs="+", type=_axis, action="extend",
        help="all combinations of evenly spaced values",
    )  # fmt: skip
    group.add_argument(
        "--sample", metavar=("N", "NAME=FROM:TO"), nargs="+",
        help="N random designs that cover all ranges evenly",
    )  # fmt: skip
    group.add_argument(
        "--seed", metavar="K", type=int, default=0, help="of the sample (default: 0)"
    )
    sweep.set_defaults(usage_error=sweep.error)


def _sensitivity(args: argparse.Namespace) -> None:
    from diffsea.report.pictures import save_tornado
    from diffsea.simulation import planning
    from diffsea.studies.sensitivity import parameter_names, sensitivities

    vessel = options.read_vessel(args).vessel
    parameter_names(vessel, args.parameters)
    plan = plan_of(args, vessel)
    with options.Outputs(args.output) as out:
        trial, _ = planning.run_and_measure(vessel, plan)
        require_run(trial, plan, vessel)
        options.progress("differentiating; the first time takes a while to compile")
        found = sensitivities(vessel, plan, args.parameters)
        relative = found.elasticities
        out.json("sensitivity.json", found.derivatives)
        title = f"{vessel.name}: {plan.manoeuvre}"
        save_tornado(relative, out.path("tornado.png"), title)
    out.present(args, _strongest_text(found.numbers, relative))


def _strongest_text(numbers: dict[str, float], relative: dict[str, dict[str, float]]) -> str:
    """The strongest elasticities of every number."""
    rows = []
    for number, row in relative.items():
        strongest = sorted(row, key=lambda name: -abs(row[name]))[:5]
        strongest = [name for name in strongest if abs(row[name]) > 1e-6]
        shown = ", ".join(f"{name} {row[name]:+.3g}" for name in strongest)
        rows.append((number, f"{numbers[number]:.4g}", shown or "-"))
    header = ("number", "value (SI)", "% change per 1 % of the strongest parameters")
    return options.table(rows, header)


def _axis(text: str) -> tuple[str, float, float, int]:
    """`NAME=FROM:TO:COUNT`."""
    name, bounds = _named(text, 3, "NAME=FROM:TO:COUNT, for example mass=150:220:8")
    return name, options.number(bounds[0]), options.number(bounds[1]), options.count(bounds[2])


def _range(text: str) -> tuple[str, float, float]:
    """`NAME=FROM:TO`."""
    name, bounds = _named(text, 2, "NAME=FROM:TO, for example mass=150:220")
    return name, options.number(bounds[0]), options.number(bounds[1])


def _named(text: str, parts: int, form: str) -> tuple[str, list[str]]:
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
            return sweep.grid(_by_name([(name, axis) for name, *axis in args.grid]))
        count, *ranges = args.sample
        if not ranges:
            raise argparse.ArgumentTypeError("give a number of designs, then NAME=FROM:TO")
        axes = _by_name([(name, axis) for name, *axis in map(_range, ranges)])
        return sweep.sample(axes, options.count(count), args.seed)
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise


def _by_name(axes: list[tuple[str, list]]) -> dict[str, tuple]:
    names = [name for name, _ in axes]
    for name in names:
        if names.count(name) > 1:
            raise argparse.ArgumentTypeError(f"{name!r} is given twice")
    return {name: tuple(axis) for name, axis in axes}


def _sweep(args: argparse.Namespace) -> None:
    from diffsea.report.pictures import save_map
    from diffsea.studies import sweep

    designs = _designs(args)
    vessel = options.read_vessel(args).vessel
    sweep.check_names(vessel, designs.names)
    plan = plan_of(_at_slowest(args, designs), vessel)
    options.progress(f"{len(designs.values)} designs; the first block is compiled")
    with options.Outputs(args.output) as out:
        table, rate = sweep.sweep(vessel, plan, designs, options.progress)
        summary = _summary(table, designs, rate)
        table.to_parquet(out.path("sweep.parquet"), index=False)
        out.json("sweep.json", {"vessel": vessel.name, "manoeuvre": plan.manoeuvre, **summary})
        if args.grid is not None and len(designs.names) == 2:
            title = f"{vessel.name}: {plan.manoeuvre}"
            save_map(table, designs.names, out.path("map.png"), title)
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


def _summary(table: "pd.DataFrame", designs: "Designs", rate: float) -> dict:
    numbers = [name for name in table.select_dtypes("number") if name not in designs.names]
    verdicts = [name for name in table if str(name).startswith("imo_")]
    return {
        "designs": len(table),
        "parameters": {
            name: {"from": float(column.min()), "to": float(column.max())}
            for name, column in zip(designs.names, designs.values.T, strict=True)
        },
        "outcomes": {str(k): int(n) for k, n in table["outcome"].value_counts().items()},
        "metrics": {
            name: {
                "least": float(table[name].min()),
                "median": float(table[name].median()),
                "most": float(table[name].max()),
                "designs": int(table[name].notna().sum()),
            }
            for name in numbers
        },
        "imo": {
            str(name).removeprefix("imo_"): {
                verdict: int((table[name] == verdict).sum()) for verdict in ("pass", "fail")
            }
            for name in verdicts
        },
        "vessel_steps_per_second": rate,
    }


def _summary_text(summary: dict) -> str:
    outcomes = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
    lines = [
        f"{summary['designs']} designs ({outcomes}), "
        f"{summary['vessel_steps_per_second']:.2g} vessel-steps/s"
    ]
    rows = [
        (name, *(f"{column[key]:.4g}" for key in ("least", "median", "most")))
        for name, column in summary["metrics"].items()
        if math.isfinite(column["median"])
    ]
    if rows:
        lines.append(options.table(rows, ("number (SI)", "least", "median", "most")))
    for name, verdict in summary["imo"].items():
        lines.append(f"IMO {name}: {verdict['pass']} pass, {verdict['fail']} fail")
    return "\n".join(lines)
