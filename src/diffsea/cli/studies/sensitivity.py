"""`diffsea sensitivity`: exact derivatives of a trial's numbers."""

import argparse

from diffsea.cli import options
from diffsea.cli.grammar import GivenOnce
from diffsea.cli.options import add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.cli.studies.axes import RANGE_FORM, number_and_ranges
from diffsea.cli.trial import add_trial_command, require_run, trial_plan


STRONGEST = 5  # parameters of a number that a person is told
WEAKEST = 1e-6  # elasticity below which a parameter has no influence


def register(commands: options.Commands) -> None:
    """Add the commands."""
    summary = "exact derivatives of a trial's numbers"
    sensitivity = add_trial_command(commands, "sensitivity", sensitivity_command, summary)
    parameters = "parameters, separated by commas (default: all of them)"
    add_option(sensitivity, "--parameters", "NAMES", options.names, parameters)
    group = sensitivity.add_argument_group("over ranges")
    sobol, form = (
        "Sobol indices from N (2 + parameters) designs, N a power of two",
        ("N", RANGE_FORM),
    )
    add_option(group, "--sobol", form, str, sobol, nargs="+", action=GivenOnce)
    add_option(group, "--seed", "K", int, "of the designs (default: 0)", default=0)
    sensitivity.set_defaults(usage_error=sensitivity.error)


def sensitivity_command(args: argparse.Namespace) -> None:
    """Derivatives of every number of a trial with respect to every parameter of the vessel, exact
    through the switching of orders. The approach speed, the orders and the time step stay as they
    are. Writes sensitivity.json, {metric: {parameter: derivative}} in the SI units of both, and
    tornado.png and sensitivity.html with the relative sensitivities.
    With --sobol it says instead which share of each number's variance a parameter makes over its
    range, alone and in all: sobol.json, {metric: {parameter: {first, total}}} with intervals of
    90 %, and sensitivity.html.

    examples:
      diffsea sensitivity kvlcc2 --manoeuvre zigzag --speed 1.179
      diffsea sensitivity usv.toml --manoeuvre turning-circle --parameters mass,N_r,N_rr
      diffsea sensitivity wamv --manoeuvre zigzag --sobol 256 mass=200:350 N_r=-1200:-500
    """
    from diffsea.report.pages.sensitivity import sensitivity_page
    from diffsea.report.pictures import save_tornado
    from diffsea.report.wording.numbers import number_unit
    from diffsea.simulation.planning import run_and_measure
    from diffsea.studies.sensitivity import parameter_names, sensitivities

    if args.sobol is not None:
        _sobol_indices(args)
        return
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
    from diffsea.report.quantities import for_people

    rows = []
    for number, row in relative.items():
        value, unit = for_people(found.numbers[number], number_unit(number))
        strongest = sorted(row, key=lambda name: -abs(row[name]))[:STRONGEST]
        parts = [f"{name} {row[name]:+.3g}" for name in strongest if abs(row[name]) > WEAKEST]
        rows.append((number, f"{value:.4g}", unit, ", ".join(parts) or "-"))
    header = ("number", "value", "", "% change per 1 % of the strongest parameters")
    out.present(args, table(rows, header))


def _sobol_indices(args: argparse.Namespace) -> None:
    """Shares of variance over ranges."""
    from diffsea.report.pages.sensitivity import sobol_page
    from diffsea.studies.sobol import sobol_indices

    if args.parameters is not None:
        args.usage_error("--sobol names its parameters itself: leave --parameters out")
    try:
        count, ranges = number_and_ranges(args.sobol)
    except argparse.ArgumentTypeError as error:
        args.usage_error(str(error))
        raise
    vessel = options.read_vessel(args).vessel
    plan = trial_plan(args, vessel)
    with Outputs(args.output) as out, StagedProgress({"running": 20.0, "writing": 1.0}) as tell:
        tell(f"running {count * (2 + len(ranges))} designs")
        found = sobol_indices(vessel, plan, ranges, count, args.seed, tell)
        tell("writing")
        out.json("sobol.json", found.as_dict())
        title = vessel.name, plan.manoeuvre
        page = sobol_page(found.as_dict(), ranges, found.left_out, title, options.source_of(args))
        out.text("sensitivity.html", page)
    rows = []
    for number, row in found.total.items():
        strongest = sorted(row, key=lambda name: -row[name].value)[:STRONGEST]
        first = found.first[number]
        parts = [f"{name} {row[name].value:.2f} ({first[name].value:.2f})" for name in strongest]
        rows.append((number, ", ".join(parts)))
    header = ("number", "share of its variance in all (alone) of the strongest parameters")
    notes = [f"{name} is not a number of every design: left out" for name in found.left_out]
    out.present(args, "\n".join([table(rows, header), *notes]))
