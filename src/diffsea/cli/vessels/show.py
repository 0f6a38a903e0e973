"""`diffsea vessels`, `diffsea show`: what ships, and a vessel in words."""

import argparse
import math
from typing import TYPE_CHECKING, Any

from diffsea.cli import options
from diffsea.cli.outputs import json_text, table
from diffsea.cli.progress.staged import StagedProgress
from diffsea.cli.vessels.outline import outline
from diffsea.outside.printable import printable


if TYPE_CHECKING:
    from diffsea.studies.handling import Handling
    from diffsea.vessel.base import Vessel


def register(commands: options.Commands) -> None:
    """Add the commands."""
    add = lambda name, run, text: options.add_command(commands, name, run, text, writes=False)
    vessels = add("vessels", vessels_command, "list and draw the vessels that ship")
    text = "draw each from above, or this vessel alone (one that ships, or a file)"
    vessels.add_argument("--draw", metavar="VESSEL", nargs="?", const="", help=text)
    show = add("show", show_command, "a vessel in words: speed, stability, turning, lags")
    options.add_vessel(show)


def vessels_command(args: argparse.Namespace) -> None:
    """List the vessels that come with diffsea, each of which any command takes by its name.

    With --draw they are drawn from above as text, with thrusters, propellers and rudders where they
    sit; so is any vessel file.

    examples:
      diffsea vessels
      diffsea vessels --draw otter
      diffsea show otter
    """
    from diffsea.vessel.files import read_vessel, shipped_vessels

    names = [args.draw] if args.draw else shipped_vessels()
    found = {name: read_vessel(name).vessel for name in names}
    if args.json:
        print(json_text({name: _particulars(vessel) for name, vessel in found.items()}))
        return
    if args.draw is not None:
        print(printable("\n\n".join(outline(vessel) for vessel in found.values())))
        return
    rows = [
        (
            name,
            f"{float(vessel.rigid_body.length):.4g}",
            f"{float(vessel.rigid_body.mass):.4g}",
            _actuator_words(vessel),
        )
        for name, vessel in found.items()
    ]
    print(table(rows, ("name", "length m", "mass kg", "actuators")))


def show_command(args: argparse.Namespace) -> None:
    """Say what a vessel is like: size, actuators, top speed, stability, turning, time constants,
    and what of it is unusual.

    Everything is in still water, at the speed of the vessel's standard trials. Unusual is what lies
    outside of the range of the vessels that ship, in numbers that are free of size.

    examples:
      diffsea show kvlcc2
      diffsea show boat.toml
    """
    from diffsea.parameters import file_parameters, named
    from diffsea.studies.handling import handling
    from diffsea.studies.unusual import unusual_figures

    vessel = options.read_vessel(args).vessel
    with StagedProgress({"running": 5.0}) as tell:
        tell("running a turning circle")
        found = handling(vessel)
    unusual = unusual_figures(vessel, found)
    if args.json:
        values = named(vessel)
        numbers = {name: float(values[p[0]]) for name, p in file_parameters(vessel).items()}
        record = {"handling": found.as_dict(), "unusual": unusual, "parameters": numbers}
        print(json_text(_particulars(vessel) | record))
        return
    lines = [f"unusual: {line}" for line in unusual]
    lines = lines or ["nothing unusual beside the vessels that ship"]
    print(printable("\n".join([*_sentences(vessel, found), *lines])))


def _particulars(vessel: "Vessel") -> dict[str, Any]:
    """Size, source and actuators of a vessel, SI units."""
    body = vessel.rigid_body
    return {
        "name": vessel.name,
        "source": vessel.source,
        "length": float(body.length),
        "beam": float(body.beam),
        "draught": float(body.draught),
        "mass": float(body.mass),
        "actuators": {name: type(part).__name__ for name, part in vessel.actuators.items()},
        "channels": vessel.units,
    }


def _actuator_words(vessel: "Vessel") -> str:
    """Kinds of actuators and their names."""
    kinds: dict[str, list[str]] = {}
    for name, part in vessel.actuators.items():
        words = "".join(f" {c.lower()}" if c.isupper() else c for c in type(part).__name__)
        kinds.setdefault(words.strip(), []).append(name)
    return "; ".join(f"{kind}: {', '.join(names)}" for kind, names in kinds.items()) or "none"


def _sentences(vessel: "Vessel", found: "Handling") -> list[str]:
    """The vessel in words."""
    from diffsea.scales import froude_speed

    body = vessel.rigid_body
    length = float(body.length)
    sizes = ", ".join(
        f"{float(value):.4g} {unit}"
        for value, unit in (
            (length, "m long"),
            (body.beam, "m wide"),
            (body.draught, "m deep"),
            (body.mass, "kg"),
        )
    )
    froude = found.speed / froude_speed(length)
    limits = "no limit is stated" if math.isinf(found.top_speed) else f"{found.top_speed:.3g} m/s"
    lines = [
        f"{vessel.name}: {sizes}",
        *([vessel.source] if vessel.source else []),
        f"actuators: {_actuator_words(vessel)}",
        f"commanded: {', '.join(f'{c} ({unit})' for c, unit in vessel.units.items()) or 'nothing'}",
        f"top speed: {limits}",
        f"at {found.speed:.3g} m/s (Froude number {froude:.2g}):",
        f"  {_course_sentence(found)}",
        f"  its speed settles with a time constant of {found.surge_time:.3g} s",
    ]
    if found.turning_diameter is not None:
        over_length = found.turning_diameter / length
        lines.append(
            f"  tactical diameter at 35 deg: {found.turning_diameter:.3g} m ({over_length:.2g} L)"
        )
    elif found.turning_outcome:
        lines.append(f"  it does not turn by 180 deg at 35 deg: {found.turning_outcome}")
    else:
        lines.append("  it cannot be steered")
    return lines


def _course_sentence(found: "Handling") -> str:
    slow, fast = found.course_times
    if not found.is_course_stable:
        growing = min((time for time in found.course_times if time <= 0), key=abs)
        return (
            "unstable on a straight course: without helm a deviation grows by e in "
            f"{-growing:.3g} s"
        )
    if math.isinf(slow):
        return (
            "neutral on a straight course: no linear damping makes a small deviation fall; the "
            f"other time constant is {fast:.3g} s"
        )
    if found.course_period is not None:
        return (
            f"stable on a straight course: deviations swing with a period of "
            f"{found.course_period:.3g} s and a time constant of {slow:.3g} s"
        )
    return f"stable on a straight course: time constants of {slow:.3g} and {fast:.3g} s"
