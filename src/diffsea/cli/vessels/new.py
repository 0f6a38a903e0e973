"""`diffsea new`: a vessel file from what a boat's owner knows, and from a log's parameters."""

import argparse
import math
import pathlib
import shlex
import sys
import tomllib
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.options import add_flag, add_option
from diffsea.cli.outputs import json_text, table
from diffsea.cli.vessels.questions import HULLS, UNITS, ask_what_is_missing
from diffsea.errors import UserError
from diffsea.outside.durable import written_beside
from diffsea.outside.printable import printable


if TYPE_CHECKING:
    from diffsea.recordings.known.autopilot_parameters import AutopilotParameters, ServoOutput
    from diffsea.vessel.estimates import (
        Azimuths,
        DerivativeEstimate,
        MotorScale,
        Outline,
        RudderDrive,
        Thrusters,
    )


def register(commands: options.Commands) -> None:
    """Add the command."""
    summary = "a vessel file from length, beam, mass and drive"
    new = options.add_command(commands, "new", new_command, summary, writes=False)
    new.set_defaults(usage_error=new.error)
    new.add_argument(
        "file", metavar="FILE", type=pathlib.Path, nargs="?", help="the vessel file to write (TOML)"
    )
    hull = f"{', '.join(HULLS)} (default: catamaran; with --rudder alone monohull)"
    add_option(new, "--hull", "FORM", options.OneOf(HULLS, "hull form"), hull)
    for flag, metavar, text in (
        ("--length", "M", "length of the waterline, m"),
        ("--beam", "M", "beam over all, m"),
        ("--mass", "KG", "mass as she sails, kg (default: displaced at --draught)"),
        ("--draught", "M", "draught, m (default: what displaces the mass)"),
        ("--block-coefficient", "C_B", "of one hull (default: usual for the form, or of the mass)"),
        ("--hull-beam", "M", "beam of one demihull, m (default: a tenth of the length)"),
        ("--top-speed", "M/S", "speed at full thrust, m/s (default: a usual Froude number)"),
        ("--thrusters", "M", "two thrusters, so many metres between their axes"),
        ("--thrust", "N", "full thrust ahead of each thruster, N (default: drag at top speed)"),
        (
            "--shaft-speed",
            "REV/S",
            "its largest speed, rev/s (default: holds the top speed), or "
            "that of thrusters ordered in rpm or rev/s",
        ),
    ):
        add_option(new, flag, metavar, options.positive, text)
    density = "of the water, kg/m^3"
    add_option(new, "--water-density", "RHO", options.positive, density, default=1025.0)
    propeller = (
        "a propeller ahead of the rudder: its diameter in m, and where it sits, X m ahead of "
        "amidships (default: 0.47 L aft)"
    )
    add_option(new, "--propeller", "D[,X]", size_and_place, propeller)
    rudder = (
        "a rudder behind a thruster or propeller: its area in m^2 (without a number: usual), and "
        "where its stock is, X m ahead of amidships (default: at the stern)"
    )
    usual = {"nargs": "?", "const": (None, None)}
    add_option(new, "--rudder", "AREA[,X]", size_and_place, rudder, **usual)
    balance = "centre of gravity, m ahead of amidships, negative aft (default: found by a fit)"
    add_option(new, "--centre-of-gravity", "M", options.number, balance)
    azimuth = (
        "an azimuth thruster by the name of its channels, X m ahead of amidships (negative aft) "
        "and Y m to starboard (0 where left out); once for each"
    )
    more: dict[str, Any] = {"action": "append", "default": []}
    add_option(new, "--azimuth", "NAME=X[,Y]", azimuth_place, azimuth, **more)
    antenna = (
        "place of the antenna whose positions and velocities are recorded, X m ahead of amidships "
        "and Y m to starboard (default: amidships)"
    )
    add_option(new, "--antenna", "X[,Y]", place, antenna)
    unit = f"of the thrusters' orders: {', '.join(UNITS)} (default: us, pulse width)"
    add_option(new, "--unit", "UNIT", options.OneOf(UNITS, "unit"), unit)
    turned = "motors whose larger orders are astern: port, starboard, motor (default: by the log)"
    add_option(new, "--reversed", "NAMES", options.names, turned, default=())
    log = "log of ArduPilot: outputs, neutral, ends and sense of the motors are read from it"
    add_option(new, "--log", "LOG", pathlib.Path, log)
    add_flag(new, "--force", "write over a file that is there")


def new_command(args: argparse.Namespace) -> None:
    """Writes a vessel file for a boat of which little is known. Derivatives are published estimates
    from its dimensions, each with its sources in the file; their scatter, and how far they are off
    for the vessels that ship, are prior widths under [prior], which `fit` and `diagnose` use. The
    thrust of motors in pulse widths or per cent is free. What is not given is assumed, and said.
    Run alone in a terminal, it asks.

    examples:
      diffsea new
      diffsea new boat.toml --length 1.4 --beam 0.93 --mass 22 --thrusters 0.66
      diffsea new boat.toml --length 1.4 --beam 0.93 --mass 22 --thrusters 0.66 --log boat.bin
      diffsea new boat.toml --length 1.4 --beam 0.93 --mass 22 --thrusters 0.66 --antenna -0.3
      diffsea new ferry.toml --length 5 --beam 2.8 --mass 1800 --azimuth fore=1.8 --azimuth aft=-1.8
      diffsea new launch.toml --hull monohull --length 6 --beam 2.1 --mass 900 --rudder 0.05,-2.9
      diffsea new ship.toml --hull ship --length 54 --beam 11.1 --draught 3.3 --mass 1.1e6
    """
    needed = {"FILE": args.file, "--length": args.length, "--beam": args.beam}
    missing = [name for name, value in needed.items() if value is None]
    if missing and sys.stdin.isatty():
        ask_what_is_missing(args, check_target)
    elif missing:
        args.usage_error(f"{', '.join(missing)} missing; in a terminal it is asked for")
    check_target(args.file, args.force)
    if sum((args.thrusters is not None, args.rudder is not None, bool(args.azimuth))) > 1:
        args.usage_error("give one of --thrusters, --rudder and --azimuth")
    from diffsea.vessel.estimates import Known, hull_estimates, outline_of, vessel_text
    from diffsea.vessel.files import VesselFile, build

    told: list[str] = []
    parameters = None if args.log is None else _parameters(args, told)
    form = _hull_form(args, parameters)
    known = Known(
        form,
        args.length,
        args.beam,
        args.mass,
        args.draught,
        args.block_coefficient,
        args.hull_beam,
        args.top_speed,
        args.water_density,
        args.centre_of_gravity,
    )
    outline, top_known = outline_of(known), args.top_speed is not None
    drive = _drive(args, outline, parameters, told)
    hull = hull_estimates(outline, _thrust_at_top(args, drive))
    parts = drive.parts(outline, hull, top_known)
    text = vessel_text(args.file.stem, outline, hull, parts, args.antenna)
    document = tomllib.loads(text)
    file = VesselFile(build(document), document, str(args.file))
    assert file.priors
    _write(args.file, text)
    record = _record(args.file, file.vessel.units, outline, hull, told)
    print(json_text(record) if args.json else printable(_summary(record, args.log)))


def azimuth_place(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=X[,Y] as a name and where its thruster sits (m). Raises `ArgumentTypeError`."""
    name, _, where = text.partition("=")
    if not name or not where:
        raise argparse.ArgumentTypeError(
            f"an azimuth thruster is NAME=X or NAME=X,Y (m), such as bow=1.8, not {text!r}"
        )
    return name, place(where)


def place(text: str) -> tuple[float, float]:
    """X[,Y] as m ahead of amidships and to starboard. Raises `ArgumentTypeError`."""
    parts = text.split(",")
    try:
        x, y = [*map(float, parts), 0.0][:2]
    except ValueError:
        x = y = math.nan
    if len(parts) > 2 or not (math.isfinite(x) and math.isfinite(y)):
        raise argparse.ArgumentTypeError(
            f"a place is X or X,Y (m ahead, m to starboard), such as 0.4,-0.1, not {text!r}"
        )
    return x, y


def size_and_place(text: str) -> tuple[float, float | None]:
    """SIZE[,X]: a positive size, and m ahead of amidships. Raises `ArgumentTypeError`."""
    size, comma, where = text.partition(",")
    return options.positive(size), options.number(where) if comma else None


def check_target(file: pathlib.Path, force: bool) -> None:
    """Raises `UserError` where a file cannot be written, or is there and not to be replaced."""
    if file.is_dir() or not file.parent.is_dir():
        raise UserError(f"cannot write {file}: give the name of a file in a folder that is there")
    if file.exists() and not force:
        raise UserError(f"{file} is there already; choose another name, or replace it by --force")


def _write(file: pathlib.Path, text: str) -> None:
    """Write the file, whole or not at all."""
    try:
        with written_beside(file) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {file}: {error.strerror}") from None


# What drives it


def _parameters(args: argparse.Namespace, told: list[str]) -> "AutopilotParameters":
    """The parameters of the log, with what they say told.

    Raises:
        UserError: the log names no motor, or its orders are not in the unit that is asked for.
    """
    from diffsea.recordings.known.autopilot_parameters import FUNCTIONS, THROTTLE, read_parameters
    from diffsea.recordings.known.recognition import column_of_output

    found = read_parameters(args.log)
    if not found.values:
        raise UserError(f"{args.log} holds no parameters of an autopilot; leave --log out")
    if args.unit not in (None, "us"):
        raise UserError(f"{args.log} has orders as pulse widths; leave --unit {args.unit} out")
    for one in found.outputs:
        sense = "reversed" if one.is_reversed else "not reversed"
        column = column_of_output(args.log, one.channel)
        told.append(
            f"SERVO{one.channel} ({column}) is {FUNCTIONS[one.function]}: "
            f"{one.minimum:g} to {one.maximum:g} us, neutral {one.trim:g} us, {sense}"
        )
    sides = _sides(found)
    if None in sides.values() and found.output(THROTTLE) is None:
        raise UserError(
            f"{args.log}: no SERVOn_FUNCTION is 73 and 74 (throttle left and right) or 70 "
            "(throttle), so it does not say which output drives a motor; give the drive by "
            "options and leave --log out"
        )
    if found.changed:
        told.append(f"changed in the log, the last value is used: {', '.join(found.changed)}")
    told.append(f"MOT_THST_ASYM = {found.thrust_asymmetry:g}: full ahead over full astern")
    return found


def _sides(parameters: "AutopilotParameters") -> "dict[str, ServoOutput | None]":
    """The outputs of the throttles of both sides."""
    from diffsea.recordings.known.autopilot_parameters import THROTTLE_LEFT, THROTTLE_RIGHT

    functions = {"port": THROTTLE_LEFT, "starboard": THROTTLE_RIGHT}
    return {name: parameters.output(function) for name, function in functions.items()}


def _hull_form(args: argparse.Namespace, parameters: "AutopilotParameters | None") -> str:
    """The form of hull, where it is not given that which such a drive mostly has."""
    if args.hull is not None:
        return args.hull
    steered = args.rudder is not None
    if parameters is not None and args.thrusters is None:
        steered = steered or None in _sides(parameters).values()
    return "monohull" if steered else "catamaran"


def _drive(
    args: argparse.Namespace,
    outline: "Outline",
    parameters: "AutopilotParameters | None",
    told: list[str],
) -> "Thrusters | RudderDrive | Azimuths":
    """Thrusters of both sides, azimuth thrusters, or a rudder behind a thruster or a propeller."""
    from diffsea.recordings.known.autopilot_parameters import THROTTLE
    from diffsea.vessel.actuators.thrust_curve import PER_REVOLUTION
    from diffsea.vessel.estimates import Azimuths, RudderDrive, Thrusters

    sides = {} if parameters is None else _sides(parameters)
    has_sides = bool(sides) and None not in sides.values()
    is_steered = args.rudder is not None or (
        args.thrusters is None and not has_sides and outline.form in ("monohull", "ship")
    )
    unit = args.unit or "us"
    common: dict[str, Any] = {"unit": unit, "full_thrust": args.thrust}
    if unit in PER_REVOLUTION:
        common["shaft_speed"] = args.shaft_speed
    if parameters is not None and args.reversed:
        raise UserError("--log says which motors are reversed; leave --reversed out")
    if parameters is not None and parameters.thrust_asymmetry > 1:
        common["astern_ratio"] = 1 / parameters.thrust_asymmetry
    if args.azimuth:
        if args.log is not None:
            raise UserError("the log of an autopilot says nothing of --azimuth; leave --log out")
        places = dict(args.azimuth)
        if len(places) < len(args.azimuth):
            raise UserError("two azimuth thrusters have one name; give each its own")
        if args.shaft_speed is not None and unit not in PER_REVOLUTION:
            raise UserError("--shaft-speed is that of orders in rpm or rev/s: give --unit rpm")
        return Azimuths(places, Thrusters(tuple(places), reversed=args.reversed, **common))
    if not is_steered:
        if args.shaft_speed is not None and unit not in PER_REVOLUTION:
            raise UserError("--shaft-speed is that of a propeller ahead of a rudder; give --rudder")
        if parameters is not None and not has_sides:
            raise UserError(
                f"{args.log} has one throttle (SERVOn_FUNCTION 70), not one to each side; "
                "leave --thrusters out, or give --rudder"
            )
        scales = {name: _scale(one, args.log) for name, one in sides.items() if one is not None}
        return Thrusters(spacing=args.thrusters, scales=scales, reversed=args.reversed, **common)
    area, rudder_x = args.rudder or (None, None)
    in_pulses = outline.form != "ship" or args.unit is not None or parameters is not None
    by_shaft = args.shaft_speed is not None and unit not in PER_REVOLUTION
    if not in_pulses or args.propeller is not None or by_shaft:
        diameter, propeller_x = args.propeller or (None, None)
        return RudderDrive(area, diameter, None, args.shaft_speed, rudder_x, propeller_x)
    throttle = None if parameters is None else parameters.output(THROTTLE)
    scales = {} if throttle is None else {"motor": _scale(throttle, args.log)}
    told.append("the rudder is ordered in rad: a mapping turns pulse widths of steering into that")
    motor = Thrusters(("motor",), scales=scales, reversed=args.reversed, **common)
    return RudderDrive(area, None, motor, rudder_x=rudder_x)


def _scale(output: "ServoOutput", log: pathlib.Path) -> "MotorScale":
    """Orders of a motor as the log's parameters have them."""
    from diffsea.vessel.estimates import MotorScale

    output.check_ends(str(log))
    said = f"SERVO{output.channel} of {log.name}"
    return MotorScale(output.trim, output.full_ahead, output.full_astern, output.is_reversed, said)


def _thrust_at_top(
    args: argparse.Namespace, drive: "Thrusters | RudderDrive | Azimuths"
) -> float | None:
    """All thrust (N) at the top speed, where both are given."""
    from diffsea.vessel.estimates import Azimuths, RudderDrive

    thrusters = drive.thruster if isinstance(drive, RudderDrive) else drive
    thrusters = thrusters.thrusters if isinstance(thrusters, Azimuths) else thrusters
    if args.thrust is None or args.top_speed is None or thrusters is None:
        return None
    return args.thrust * len(thrusters.names)


# What is told


def _record(
    file: pathlib.Path,
    units: dict[str, str],
    outline: "Outline",
    hull: "dict[str, DerivativeEstimate]",
    told: list[str],
) -> dict[str, Any]:
    """What was written and what it rests on, SI units."""
    return {
        "file": str(file),
        "hull": outline.form,
        "assumed": [*outline.assumed.values(), f"I_z = {outline.I_z:.3g} kg m^2"],
        "log": told,
        "channels": units,
        "derivatives": {
            one.name: {"value": one.value, "spread": one.spread, "methods": one.methods}
            for one in hull.values()
        },
    }


def _summary(record: dict[str, Any], log: pathlib.Path | None) -> str:
    """The record for a person, and how to go on, with the log that was named."""
    rows = [
        (name, f"{one['value']:.4g}", f"{100 * one['spread']:.0f} %", "; ".join(one["methods"]))
        for name, one in record["derivatives"].items()
    ]
    orders = ", ".join(f"{name} ({unit})" for name, unit in record["channels"].items())
    file = shlex.quote(record["file"])
    recordings = "RECORDING..." if log is None else shlex.quote(str(log))
    return "\n".join(
        [
            table(rows, ("symbol", "estimate", "prior", "estimated by")),
            "",
            f"{record['hull']}; assumed: {'; '.join(record['assumed'])}",
            *record["log"],
            f"ordered by: {orders}",
            f"next: diffsea show {file}; diffsea diagnose {file} {recordings}",
            "",
            f"written: {record['file']}",
        ]
    )
