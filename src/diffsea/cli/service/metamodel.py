"""`diffsea metamodel`: Norrbin models from logs of service, validated."""

import argparse
import math
from typing import TYPE_CHECKING

from diffsea.cli import options
from diffsea.cli.options import add_flag, add_option
from diffsea.cli.outputs import Outputs, table
from diffsea.cli.progress.staged import StagedProgress


if TYPE_CHECKING:
    from diffsea.metamodels.ideal_zigzag import Zigzag
    from diffsea.workflows.metamodel import MetamodelResult

MOST = 12  # as the library has it, which would import JAX to be asked
RUDDER_RATE = 5.0  # deg/s, likewise


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "Norrbin models from service, validated"
    parser = options.add_command(commands, "metamodel", metamodel_command, summary)
    options.add_recordings(parser)
    vessel = "vessel that names the actuators and answers the orders"
    add_option(parser, "--vessel", "V", str, vessel)
    window = "time in which the vessel turns by 90 deg at its fastest (default: as recorded)"
    add_option(parser, "--window", "S", options.positive, window)
    most = "trials of a metamodel, those with the least wind abeam"
    add_option(parser, "--most", "N", options.count, most, default=MOST)
    own = "let each trial have a steady moment of its own, as of wind"
    add_flag(parser, "--own-moments", own)
    drop = "leave out so many of them, which the metamodel of all follows worst (default: none)"
    add_option(parser, "--drop", "N", options.count, drop)
    against = "vessel to judge by the metamodels, under the orders of their trials"
    add_option(parser, "--against", "V", str, against)
    group = parser.add_argument_group("the ideal zig-zag to ask for")
    angle = "rudder angle (default: as ordered in zig-zags; 10 of turns)"
    add_option(group, "--angle", "DEG", options.angle, angle)
    heading = "heading of the reversals (default: the rudder angle)"
    add_option(group, "--heading", "DEG", options.angle, heading)
    rate = f"speed of the rudder, deg/s (default: {RUDDER_RATE:g})"
    add_option(group, "--rudder-rate", "R", options.positive, rate)
    parser.set_defaults(usage_error=parser.error)


def metamodel_command(args: argparse.Namespace) -> None:
    """Identify Norrbin's equation of yaw from the trials that logs of service hold. Logs with dead
    channels are left out; turning motions and zig-zags are found and grouped, turns by place (needs
    scikit-learn) or by side; of each group the trials with the least wind abeam are used. Each
    metamodel is cross-validated, and asked for the overshoots of the ideal zig-zag; of zig-zags
    that were run there is the corrected average as well. With --against a vessel file is simulated
    under the orders of the trials, without their wind, and compared with metamodel and trials.
    Writes metamodel.json and metamodel.html.

    examples:
      diffsea metamodel year/*.csv --mapping ferry.toml
      diffsea metamodel zigzags/*.csv --angle 10 --heading 10 --rudder-rate 2.5
      diffsea metamodel patrols/*.csv --vessel usv.toml --window 20
      diffsea metamodel year/*.csv --against ferry.toml --drop 2
    """
    wanted = _zigzag(args)
    stages = {"reading": 5.0, "looking": 15.0, "identifying": 20.0, "writing": 2.0}
    with Outputs(args.output) as out, StagedProgress(stages) as tell:
        tell("reading")
        from diffsea.vessel import files
        from diffsea.workflows.metamodel import metamodel

        against = files.read_vessel(args.against) if args.against else None
        vessel = options.read_vessel(args) if args.vessel else None
        found = metamodel(
            options.read_recordings(args.recordings, args),
            vessel=vessel,
            window=args.window,
            most=args.most,
            own_moments=args.own_moments,
            zigzag=wanted,
            progress=tell,
            drop=args.drop or 0,
            against=against,
        )
        tell("writing")
        out.json("metamodel.json", found.record())
        out.text("metamodel.html", found.html())
    out.present(args, _summary_text(found))


def _zigzag(args: argparse.Namespace) -> "Zigzag | None":
    """The ideal zig-zag that is asked for; None leaves it to what the logs hold."""
    if args.angle is None:
        if args.heading is not None or args.rudder_rate is not None:
            args.usage_error("--heading and --rudder-rate go with --angle")
        return None
    from diffsea.metamodels.ideal_zigzag import Zigzag

    rate = math.radians(args.rudder_rate or RUDDER_RATE)
    return Zigzag(args.angle, args.heading or args.angle, rate_limit=rate)


def _summary_text(found: "MetamodelResult") -> str:
    """metamodel.json for a person: a row for each group, overshoots, then notes."""
    shown = lambda cell: f"{cell:.3g}" if isinstance(cell, float) else str(cell)
    rows = [[shown(cell) for cell in row.values()] for row in found.rows()]
    parts = [found.headline(), "", table(rows, tuple(found.rows()[0])), ""]
    for one in found.models:
        for side, (values, errors) in one.ideal.items():
            asked = one.asked[side]
            name = f"{math.degrees(asked.angle):.0f}/{math.degrees(asked.heading):.0f} {side}"
            pairs = zip(values, errors, strict=True)
            numbers = ", ".join(
                f"{math.degrees(value):.2f} +- {math.degrees(std):.2f}" for value, std in pairs
            )
            parts.append(f"{one.group}: ideal {name} overshoots {numbers} deg")
    return "\n".join([*parts, *found.notes()])
