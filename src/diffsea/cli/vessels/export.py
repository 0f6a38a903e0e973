"""`diffsea export`: a vessel for other tools."""

import argparse
import pathlib
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.outputs import Outputs, json_text
from diffsea.cli.progress.staged import StagedProgress
from diffsea.errors import UserError
from diffsea.outside.documents import read_json


if TYPE_CHECKING:
    from diffsea.vessel.files import VesselFile


def register(commands: options.Commands) -> None:
    """Add the command."""
    text = (
        "a vessel for Gazebo, ArduPilot, FMI or MATLAB; a recording for Foxglove, ROS 2 or tables"
    )
    parser = options.add_command(commands, "export", export_command, text)
    text = "TOML file, or name of a shipped vessel; for mcap, ros2 and parquet a RECORDING"
    parser.add_argument("vessel", metavar="VESSEL", help=text)
    every = (*_WRITERS, *_OF_RECORDINGS)
    targets = options.OneOf(every, "target")
    text = f"the tool: {', '.join(every)}"
    options.add_option(parser, "--to", "TOOL", targets, text, required=True)
    options.add_flag(parser, "--allow-loss", "leave out, by name, what the tool cannot express")
    pilot = parser.add_argument_group("for ardupilot")
    text = "fit.json of the fit that gave the vessel: withholds what its data do not determine"
    options.add_option(pilot, "--fit", "FILE", pathlib.Path, text)
    text = "cruising speed (default: Froude number 0.2, at most 80 %% of top speed)"
    options.add_option(pilot, "--speed", "M/S", options.positive, text)
    options.add_reading(parser.add_argument_group("for mcap, ros2 and parquet"))


def export_command(args: argparse.Namespace) -> None:
    """Write a vessel, or a recording, as another tool's file.

    gazebo     a model (SDF) with mass, added mass, Hydrodynamics and Thruster systems
    ardupilot  parameters of Rover: speed, turning and steering feed-forward
    fmu        a unit for co-simulation by FMI 3.0 (needs the extra `fmu`); runs without diffsea
    mss        a MATLAB function as in Fossen's Marine Systems Simulator, which GNU Octave runs too

    What a tool cannot express is refused by name, or left out with --allow-loss.

    mcap       a recording for Foxglove and other viewers, by its schemas (needs the extra `mcap`)
    ros2       a recording as a ROS 2 bag with odometry, poses and tf (needs the extra `ros`)
    parquet    a recording as a long table: run, t, channel, value, unit

    examples:
      diffsea export otter --to mss
      diffsea export boat.toml --to fmu -o models
      diffsea export out/fit/vessel.toml --to ardupilot --fit out/fit/fit.json --speed 1.5
      diffsea export out/trial/recording.csv --to mcap
    """
    if args.to != "ardupilot" and (args.fit is not None or args.speed is not None):
        raise UserError("--fit and --speed are for --to ardupilot; leave them out")
    if args.to in _OF_RECORDINGS:
        _export_recording(args)
        return
    if any(getattr(args, name) is not None for name in ("mapping", "start", "end")):
        raise UserError("--mapping, --start and --end are for recordings; leave them out")
    file = options.read_vessel(args)
    with Outputs(args.output) as out, StagedProgress({"writing": 5.0}) as tell:
        tell(f"writing for {args.to}")
        found = _WRITERS[args.to](file, args, out)
    for loss in found["left_out"]:
        options.progress(f"left out: {loss}")
    if args.json:
        head = {"format": 1, "to": args.to, "vessel": file.vessel.name, "file": str(out.files[0])}
        print(json_text(head | found))
    else:
        out.present(args, f"{file.vessel.name} for {args.to}")


def _export_recording(args: argparse.Namespace) -> None:
    """A recording for viewers and tables."""
    from diffsea.exports.recordings import long_table, write_mcap
    from diffsea.exports.ros_bags import write_ros_bag

    if args.allow_loss:
        raise UserError("--allow-loss is for vessels; leave it out")
    path = pathlib.Path(args.vessel)
    (run,) = options.read_recordings([path], args)
    with Outputs(args.output) as out, StagedProgress({"writing": 3.0}) as tell:
        tell(f"writing for {args.to}")
        target = out.path(f"{path.stem}{_OF_RECORDINGS[args.to]}")
        if args.to == "mcap":
            write_mcap(run, target)
        elif args.to == "ros2":
            write_ros_bag(run, target)
        else:
            long_table(run).to_parquet(target, index=False)
    told = {"format": 1, "to": args.to, "recording": run.name, "file": str(out.files[0])}
    if args.json:
        print(json_text(told | {"rows": len(run.t)}))
    else:
        out.present(args, f"{run.name} for {args.to}")


def _write_gazebo(file: "VesselFile", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports.equations import equations_of, require_nothing_lost
    from diffsea.exports.fmu import identifier
    from diffsea.exports.gazebo import gazebo_losses, gazebo_model

    equations = equations_of(file.vessel)
    losses = gazebo_losses(equations)
    require_nothing_lost(losses, args.to, args.allow_loss)
    out.text(f"{identifier(equations.name)}.sdf", gazebo_model(equations, losses))
    return {"left_out": losses}


def _write_ardupilot(file: "VesselFile", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports import ardupilot
    from diffsea.exports.fmu import identifier

    vessel = file.vessel
    found = ardupilot.parameters_of(vessel, args.speed)
    withheld = {name: one.reason for name, one in found.items() if one.value is None}
    source = "No fit.json was given: nothing says whether data determine these numbers."
    if args.fit is not None:
        options.progress("what the fit determines of them")
        fit = _read_fit(args.fit)
        withheld |= ardupilot.withheld_by_fit(file.document, fit, found)
        source = f"Withheld is what the data of {args.fit.name} do not determine."
    text = ardupilot.parameter_file(vessel, found, withheld, source)
    out.text(f"{identifier(vessel.name)}.param", text)
    values = {name: one.value for name, one in found.items() if name not in withheld}
    reasons = [f"{name}: {reason}" for name, reason in withheld.items()]
    return {"left_out": reasons, "parameters": values, "withheld": withheld}


def _read_fit(path: pathlib.Path) -> dict[str, Any]:
    """The content of a fit.json."""
    content = read_json(path, "the fit.json of `diffsea fit`")
    if not isinstance(content, dict):
        raise UserError(f"--fit: {path} is not the fit.json of `diffsea fit`")
    return content


def _write_fmu(file: "VesselFile", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports.equations import equations_of, require_nothing_lost
    from diffsea.exports.fmu import identifier, platforms, write_fmu

    equations = equations_of(file.vessel)
    require_nothing_lost(equations.left_out, args.to, args.allow_loss)
    unit = out.path(f"{identifier(equations.name)}.fmu")
    write_fmu(equations, unit)
    return {"left_out": equations.left_out, "platforms": platforms(unit)}


def _write_mss(file: "VesselFile", args: argparse.Namespace, out: Outputs) -> dict[str, Any]:
    from diffsea.exports.equations import equations_of, require_nothing_lost
    from diffsea.exports.mss import function_name, mss_function, mss_losses

    equations = equations_of(file.vessel)
    losses = mss_losses(equations)
    require_nothing_lost(losses, args.to, args.allow_loss)
    out.text(f"{function_name(equations)}.m", mss_function(equations))
    return {"left_out": losses}


_WRITERS = {
    "gazebo": _write_gazebo,
    "ardupilot": _write_ardupilot,
    "fmu": _write_fmu,
    "mss": _write_mss,
}
_OF_RECORDINGS = {"mcap": ".mcap", "ros2": "-ros2.mcap", "parquet": ".parquet"}
