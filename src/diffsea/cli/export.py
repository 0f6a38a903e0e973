"""`diffsea export`: a vessel for other tools."""

import argparse
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.outputs import Outputs, json_text


if TYPE_CHECKING:
    from diffsea.vessel.base import Vessel


def register(commands: options.Commands) -> None:
    """Add the command."""
    text = "a vessel for Gazebo, FMI or MATLAB"
    parser = options.add_command(commands, "export", export_command, text)
    options.add_vessel(parser)
    targets = options.one_of(tuple(_WRITERS), "target")
    text = f"the tool: {', '.join(_WRITERS)}"
    options.add_option(parser, "--to", "TOOL", targets, text, required=True)
    options.add_flag(parser, "--allow-loss", "leave out, by name, what the tool cannot express")


def export_command(args: argparse.Namespace) -> None:
    """Write a vessel as another tool's file.

    gazebo a model (SDF) with mass, added mass, Hydrodynamics and Thruster systems
    fmu    a unit for co-simulation by FMI 3.0 (needs the extra `fmu`), which runs without diffsea
    mss    a MATLAB function as in Fossen's Marine Systems Simulator, which GNU Octave runs too

    What a tool cannot express is refused by name, or left out with --allow-loss.

    examples:
      diffsea export otter --to mss
      diffsea export boat.toml --to fmu -o models
    """
    vessel = options.read_vessel(args).vessel
    with Outputs(args.output) as out:
        found = _WRITERS[args.to](vessel, args, out)
    for loss in found["left_out"]:
        options.progress(f"left out: {loss}")
    if args.json:
        head = {"format": 1, "to": args.to, "vessel": vessel.name, "file": str(out.files[0])}
        print(json_text(head | found))
    else:
        out.present(args, f"{vessel.name} for {args.to}")


def _write_gazebo(vessel: "Vessel", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports.equations import equations_of, require_nothing_lost
    from diffsea.exports.fmu import identifier
    from diffsea.exports.gazebo import gazebo_losses, gazebo_model

    equations = equations_of(vessel)
    losses = gazebo_losses(equations)
    require_nothing_lost(losses, args.to, args.allow_loss)
    out.text(f"{identifier(equations.name)}.sdf", gazebo_model(equations, losses))
    return {"left_out": losses}


def _write_fmu(vessel: "Vessel", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports.equations import equations_of, require_nothing_lost
    from diffsea.exports.fmu import identifier, platforms, write_fmu

    equations = equations_of(vessel)
    require_nothing_lost(equations.left_out, args.to, args.allow_loss)
    file = out.path(f"{identifier(equations.name)}.fmu")
    write_fmu(equations, file)
    return {"left_out": equations.left_out, "platforms": platforms(file)}


def _write_mss(vessel: "Vessel", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports.equations import equations_of, require_nothing_lost
    from diffsea.exports.mss import function_name, mss_function, mss_losses

    equations = equations_of(vessel)
    losses = mss_losses(equations)
    require_nothing_lost(losses, args.to, args.allow_loss)
    out.text(f"{function_name(equations)}.m", mss_function(equations))
    return {"left_out": losses}


_WRITERS = {"gazebo": _write_gazebo, "fmu": _write_fmu, "mss": _write_mss}
