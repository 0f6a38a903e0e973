"""`diffsea sensitivity`: exact derivatives of a trial's numbers."""

import argparse

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
