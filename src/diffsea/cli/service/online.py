"""`diffsea online`: estimates as the boat ran, with trust."""

import argparse
import pathlib

from diffsea.cli import options
from diffsea.cli.options import add_choice, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress


ESTIMATORS = ("kalman", "least-squares")  # as the library has them, which would import JAX
OF_THE_OTHER = {"kalman": ("memory",), "least-squares": ("drift", "noise")}
TOLD_SPANS = 5  # in which the gate was closed, for a person; the page has more


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "estimates as the boat ran, with trust"
    parser = options.add_command(commands, "online", online_command, summary)
    options.add_vessel(parser)
    options.add_recordings(parser, several=False)
    estimator = "extended Kalman filter, or recursive least squares on the equations of motion"
    add_choice(parser, "--estimator", ESTIMATORS, estimator)
    free = "parameters to estimate, separated by commas (default: the hull's derivatives)"
    add_option(parser, "--free", "NAMES", options.names, free)
    drift = "kalman: random walk of parameters, share of their size per sqrt(s) (default: 0.001)"
    add_option(parser, "--drift", "SHARE", _zero_or_more, drift)
    memory = "least-squares: time constant of forgetting (default: nothing is forgotten)"
    add_option(parser, "--memory", "SECONDS", options.positive, memory)
    noise = "kalman: fit.json whose gust and sensor noise to take (default: a guess)"
    add_option(parser, "--noise", "FIT", pathlib.Path, noise)
    sound = "recordings known to be sound: what they show is no alarm"
    add_option(parser, "--sound", "RECORDING", pathlib.Path, sound, nargs="+", default=[])
    interval = "seconds between the rows of online.json (default: every row of the recording)"
    add_option(parser, "--interval", "S", options.positive, interval)
    parser.set_defaults(usage_error=parser.error)


def _zero_or_more(text: str) -> float:
    """A number not below zero."""
    value = options.number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is below zero")
    return value


def online_command(args: argparse.Namespace) -> None:
    """Estimate a vessel's parameters row by row along a recording, as an estimator on board would
    have: each estimate with its standard error, the trust in it, and what a gate would have passed
    to a controller. Where trust fell, it says why.
    Writes online.json and online.html.

    examples:
      diffsea online usv.toml run1.csv
      diffsea online usv.toml run1.csv --free N_r,N_rr,Y_v --sound run2.csv run3.csv
      diffsea online out/fit/vessel.toml run9.csv --noise out/fit/fit.json
      diffsea online boat.toml log.csv --mapping boat_log.toml --estimator least-squares
    """
    for other in OF_THE_OTHER[args.estimator]:
        if getattr(args, other) is not None:
            args.usage_error(f"--{other} does not belong to --estimator {args.estimator}")
    stages = {"reading": 2.0, "calibrating": 8.0, "estimating": 10.0, "writing": 2.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell("reading")
        from diffsea.workflows.online import online

        file = options.read_vessel(args)
        runs = options.read_recordings([args.recording, *args.sound], args)
        found = online(
            file,
            runs[0],
            args.free,
            estimator=args.estimator,
            drift=args.drift,
            memory=args.memory,
            noise=args.noise,
            sound=runs[1:],
            progress=tell,
        )
        tell("writing")
        out.json("online.json", found.record(args.interval or 0.0))
        out.text("online.html", found.html())
    rows = [
        [f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row.values()]
        for row in found.rows()
    ]
    trust, *spans = found.notes()
    more = [f"... and {len(spans) - TOLD_SPANS} more"] if len(spans) > TOLD_SPANS else []
    parts = [table(rows, tuple(found.rows()[0])), "", found.headline(), trust]
    out.present(args, "\n".join([*parts, *spans[:TOLD_SPANS], *more]))
