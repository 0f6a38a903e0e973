"""The page of the catalogue of effects, docs/effects.md, from the catalogue and what it cannot say.

    .venv/bin/python docs/site/effects_page.py

writes it anew. It is committed, so that it can be read where the repository is; a test compares.
"""

import re
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import get_args

from diffsea import EFFECTS, Effect
from diffsea.vessel.base import OrderUnit
from diffsea.vessel.effects import catalogue_name
from diffsea.vessel.effects.actuators import ORDER_UNIT, OrderedChannels
from diffsea.vessel.effects.compass import TurnedByMotors
from diffsea.vessel.effects.entry import DegreesOfFreedom, MeasuredChannels


PAGE = Path(__file__).resolve().parents[1] / "effects.md"
WIDTH = 110
PLACES = {  # keys, by what is chosen
    OrderedChannels: "actuators",
    MeasuredChannels: "channels",
    TurnedByMotors: "actuators",
    DegreesOfFreedom: "degrees_of_freedom",
}

FAMILIES = {
    "environment": (
        "Environment",
        "What the vessel moves in. `diagnose --environment per-recording` (and `fit`) lets each "
        "recording have its own {per_run}; the others are the same in all.",
    ),
    "sensor": (
        "Sensors and clocks",
        "What is recorded is off; the vessel moves as ever. Errors are what is measured less what "
        "is true: a compass that reads too high shows a heading to starboard of the true one.",
    ),
    "actuator": (
        "Actuators",
        "What lies between an order and the force. Variants are of `propulsion` (thrusts and shaft "
        "speeds), `steering` (angles), and `port` or `starboard` (thrusts and shaft speeds on that "
        "side of the centreline).",
    ),
    "hull": ("Hull", "Damping, inertia and their changes."),
}

INTRODUCTION = """\
# The catalogue of effects

An effect is physics that a vessel's model may lack. What stands here can be stated in a vessel
file, be estimated by `diffsea fit --effects` and be named by [`diffsea diagnose`](diagnosis.md).
Symbols are in the [glossary](glossary.md).

{families}

## In a vessel file

```toml
[[effect]]
name = "actuator-response"
delay = 0.4               # s
time_constant = 0.8       # s
actuators = ["port"]      # without it: all of them
```

- A number that is left out says that there is nothing of it, unless its row says otherwise or that
  it is *needed*. All are in SI units and radians; directions count from north, clockwise.
- *Order* stands for the unit in which an actuator is ordered: {units},
  or rad of an angle.
- `actuators` are names of actuators of the file, or of their channels. Where a vessel has both
  thrusts and angles, a number in the unit of the order needs it.
- `time` is on the run's clock, in s.
- Tables of one name add up; of limits the tighter one holds. An unknown key is refused, with what
  is known.
- Write the name as it stands in a heading here. What follows a colon below is for `--effects`:
  which actuators a table acts on, `actuators` alone says.

[Vessel files](vessel-files.md) has all other tables.

## In `fit --effects`

`--effects current,thrust-asymmetry` estimates effects beside the derivatives. The name of a heading
stands for the entry of that very name, and where there is none for all its variants that the vessel
can have; these share what there is to explain, so ask for one (`--effects actuator-bias:port`).
*Vessels* says which vessels are asked, where not all are; a file may state the effect for others,
too, unless it says *refused*. Of a sheet of trial numbers only effects of actuators and hull can be
estimated, and no change at a `time`. Where a recording lacks what
an effect needs (*Recordings*), `fit` refuses it.

## In a verdict

`effects` in `diagnosis.json` has the name of a heading here, its `parameters` by the keys of its
table, the `actuators` or `channels` of the variant that was found, the `recording` where each has
its own (which no vessel file has), and as `alternatives` the names that the same data support
nearly as well. *May be confused with* lists what looks much the same in common manoeuvres; these
are fitted, too. Where *Recordings* is not said, motion and orders are enough; where it is, the
effect is no candidate without. *In a report* is how the verdict says it, a word in brackets for a
negative number.
"""
END = "<!-- Written by docs/site/effects_page.py: change it there, or in the catalogue. -->"

# What each effect is, in a sentence.
WHAT = {
    "current": "The water flows steadily, the same everywhere.",
    "wind": "A steady wind, or the one that was measured, pushes the superstructure; the drag of "
    "still air is the hull's already.",
    "wave-force": "A force fixed in the earth swings about a mean: a swell, or a tow.",
    "shallow-water": "The bottom is near: added masses and damping grow.",
    "heading-offset": "The compass is turned by an angle, always or from some time on, or all that "
    "is measured in the vessel's axes is.",
    "hard-iron": "The compass is off by an angle that goes round once with the heading, as iron "
    "aboard makes it, or as the current of the motors does. A heading that is estimated from a "
    "compass and a gyro follows the compass slowly, and velocities that a receiver gives over "
    "ground are turned into the vessel's axes by it.",
    "gyro-bias": "The yaw-rate sensor is off by a constant, always or from some time on.",
    "sensor-latency": "Some measured channels arrive late on the clock of the others.",
    "lever-arm": "Positions, or positions and velocities, are those of an antenna that is not at "
    "the reference point.",
    "clock-drift": "Motion and orders were stamped by clocks that differ, perhaps more and more.",
    "feedback-error": "The record of what an actuator executed is off; the actuator is not.",
    "thrust-lag": "Actuators follow their orders with a first-order lag.",
    "thrust-delay": "Actuators begin to follow after a dead time.",
    "rate-limit": "Actuators move no faster than at some rate.",
    "deadband": "Small orders do nothing, and larger ones act that much smaller.",
    "backlash": "Actuators stay where they are until the order has gone through a play.",
    "thrust-saturation": "Orders beyond a limit act as the limit.",
    "actuator-bias": "Neutral is not where orders say: rudder trim, a thruster's neutral point.",
    "actuator-response": "Actuators answer late in two ways: a dead time with a lag, or with a "
    "rate limit.",
    "thrust-asymmetry": "One side pushes harder than the other at the same order.",
    "thruster-misalignment": "The fixed thrusters do not push where the file says.",
    "thrust-loss-with-speed": "Thrust falls with speed through the water.",
    "thrust-loss-in-turns": "Thrust falls with the yaw rate, as by ventilation or shadowing.",
    "thrust-change": "From some time on all thrusts, or those on one side, are another share of "
    "what they were.",
    "thrust-curve": "Thrust depends on the order otherwise than the file says: by a dead band, an "
    "exponent, a weaker astern, a limit; perhaps by its scale and a loss with speed, too.",
    "propeller-side-force": "A turning screw pushes the stern sideways.",
    "rudder-interaction": "Hull and propeller change what a rudder does: the hull adds to its "
    "force, and the flow to it is straightened.",
    "crossflow-drag": "Drag of the flow across the hull, section by section.",
    "quadratic-damping": "A drag that grows with the square of a velocity, along one axis.",
    "sway-yaw-coupling": "Yaw rate makes a sway force, and sway a yaw moment.",
    "speed-dependent-damping": "Sway forces and yaw moments grow with forward speed, as lift does.",
    "added-mass-coupling": "Inertia couples sway and yaw: mass or added mass lies further ahead or "
    "astern than the file has it.",
    "munk-moment": "The moment that turns a drifting hull across the flow is not the model's.",
    "mass-change": "From some time on the vessel is heavier or lighter by a load.",
    "drag-change": "From some time on the hull's damping is another share of what it was, as by "
    "a net or weed.",
    "roll-coupling": "Heel makes a sway force and a yaw moment.",
}

# What each key of a table says, in order: all keys but the name.
_STEPPED = "from when on; without it the whole run"
_FLOW_SPEED = "over ground"
_ALL = "which ones; without it all"
_TIME = "from when on; without it from zero on the clock"
_COEFFICIENT = "without it an earlier table's, else"
KEYS = {
    "current": {"speed": _FLOW_SPEED, "direction": "towards which it flows"},
    "wind": {
        "speed": "how fast the air flows; without it, or zero, as the recording's `wind_speed` and "
        "`wind_direction` say",
        "direction": "from which it blows",
        "C_X": f"coefficient of the force ahead; {_COEFFICIENT} 0.7",
        "C_Y": f"coefficient of the force to the side; {_COEFFICIENT} 0.85",
        "C_N": f"coefficient of the moment; {_COEFFICIENT} 0.1",
        "C_NY": f"C_Y times the lever of the side force, forward of amidships, over the length; "
        f"{_COEFFICIENT} 0",
        "frontal_area": f"seen from ahead; {_COEFFICIENT} beam times draught",
        "lateral_area": f"seen from the side; {_COEFFICIENT} length times draught",
    },
    "wave-force": {
        "bias": "mean of the force",
        "amplitude": "of its swing",
        "frequency": "of its swing; without it 0.1",
        "phase": "of its swing at zero on the clock",
        "direction": "towards which a positive force pushes",
    },
    "shallow-water": {"depth": "of the water, from the surface; more than the draught"},
    "heading-offset": {
        "angle": "by which the compass reads too high",
        "time": _STEPPED,
        "channels": '`["psi", "u", "v"]` where the velocities are turned with the heading: an '
        "instrument mounted askew, or fixes' velocities turned by a heading that is off; without "
        "it the heading alone",
    },
    "hard-iron": {
        "amplitude": "of the error; with `actuators`, at their full thrust",
        "phase": "heading at which the error is zero and grows with the heading",
        "time_constant": "in which an estimated heading follows the compass; without it the "
        "heading is the compass",
        "channels": '`["psi", "u", "v"]`, as with a `time_constant` or `actuators`: '
        "velocities are turned with the heading",
        "actuators": "the motors whose current deflects the compass; without it iron aboard does",
    },
    "gyro-bias": {"bias": "by which the sensor reads too high", "time": _STEPPED},
    "sensor-latency": {
        "delay": "*needed*; how late they are",
        "channels": "of `x`, `y`, `psi`, `u`, `v`, `r`; `x` with `y`, and `u` with `v`; without it "
        "`x` and `y`",
        "turned_by": '`["psi"]` of a late receiver, with `["x", "y", "u", "v"]`: velocities over '
        "ground were turned into the vessel's axes by a heading that is not late",
    },
    "lever-arm": {
        "x": "forward of the reference point",
        "y": "to starboard of it",
        "channels": '`["x", "y", "u", "v"]` where velocities are the antenna\'s own, too; without '
        "it positions alone",
    },
    "clock-drift": {
        "rate": "s by which motion lags further behind the orders in each s",
        "offset": "by which motion lags behind the orders at zero on the clock",
    },
    "feedback-error": {
        "offset": "by which the record reads too high",
        "scale": "share by which it reads too high; above -1",
        "delay": "by which it is late",
        "actuators": _ALL,
    },
    "thrust-lag": {"time_constant": "*needed*", "actuators": _ALL},
    "thrust-delay": {"delay": "*needed*", "actuators": _ALL},
    "rate-limit": {"rate_limit": "*needed*; the fastest change", "actuators": _ALL},
    "deadband": {"width": "*needed*; orders up to it do nothing", "actuators": _ALL},
    "backlash": {
        "width": "*needed*; how far off the order may be, either way, before it follows",
        "actuators": _ALL,
    },
    "thrust-saturation": {
        "limit": "*needed*; the largest order that acts, from neutral, either way",
        "actuators": _ALL,
    },
    "actuator-bias": {"bias": "*needed*; what is added to every order", "actuators": _ALL},
    "actuator-response": {
        "delay": "dead time; one of the three is *needed*",
        "time_constant": "of the lag",
        "rate_limit": "the fastest change",
        "actuators": _ALL,
    },
    "thrust-asymmetry": {
        "ratio": "share by which starboard is stronger than stated, and port weaker",
    },
    "thruster-misalignment": {"angle": "by which the thrust is turned, clockwise from above"},
    "thrust-loss-with-speed": {"slope": "share of the thrust that is lost for each m/s"},
    "thrust-loss-in-turns": {"slope": "share of the thrust that is lost for each rad/s"},
    "thrust-change": {
        "factor": "relative change: -0.2 is a fifth less",
        "time": _TIME,
        "actuators": _ALL,
    },
    "thrust-curve": {
        "deadband": "orders up to it do nothing",
        "exponent": "of the order; without it 1",
        "astern_ratio": "astern over ahead at the same order; without it 1",
        "limit": "that the order is rounded off to; without it none",
        "gain": "thrust over the stated one; without it 1",
        "slope": "share of the thrust that is lost for each m/s",
        "actuators": _ALL,
    },
    "propeller-side-force": {
        "Y_ahead": "side force over the screw's own force ahead",
        "N_ahead": "moment over that force and the length",
        "Y_astern": "side force over the screw's own force astern",
        "N_astern": "moment over that force and the length",
    },
    "rudder-interaction": {
        "a_H": "share of the rudder's force that the hull adds",
        "x_H": "where that acts, forward of the origin; without it that of the first rudder",
        "gamma_R": "by which the angle of the flow to the rudder shrinks; without it 1",
    },
    "crossflow-drag": {"cd": "drag coefficient of the sections"},
    "quadratic-damping": {
        "X_uu": "of surge; negative for drag",
        "Y_vv": "of sway; negative for drag",
        "N_rr": "of yaw; negative for drag",
    },
    "sway-yaw-coupling": {
        "Y_r": "force by yaw rate; without unit where `[hull]` is nondimensional",
        "N_v": "moment by sway; likewise",
    },
    "speed-dependent-damping": {
        "Y_ur": "force by speed and yaw rate",
        "N_ur": "moment by speed and yaw rate",
        "Y_uv": "force by speed and sway",
        "N_uv": "moment by speed and sway; alone it is `munk-moment`",
    },
    "added-mass-coupling": {
        "Y_rdot": "added to that of `[hull]`",
        "N_vdot": "added to that of `[hull]`",
        "x_G": "added to that of `[hull]`",
    },
    "munk-moment": {
        "Y_vdot - X_udot": "beyond that of `[hull]`; the key stands in quotes in the file",
    },
    "mass-change": {
        "mass": "taken on; negative for put down",
        "time": _TIME,
        "x": "where it lies, forward of amidships; without it amidships",
    },
    "drag-change": {
        "factor": "relative change: 0.2 is a fifth more",
        "time": _TIME,
        "degrees_of_freedom": '`["surge"]` where only the resistance ahead changes, as by weed or '
        "fouling; without it the damping in all of them",
    },
    "roll-coupling": {"Y_phi": "force by heel", "N_phi": "moment by heel"},
}
KEY_UNITS = {
    "frontal_area": "m^2",
    "lateral_area": "m^2",
    "turned_by": "names",
}  # of keys that are no parameter

CHANNEL_UNITS = {
    "phi": "rad",
    "u": "m/s",
    "wind_direction": "rad",
    "wind_speed": "m/s",
}  # of channels that recordings must have

# Which vessels are asked whether they have it, where not all are.
_KIND = "those with such channels."
VESSELS = {
    "hard-iron": "`hard-iron:motors`, those with thrusters, whose motors are electric; "
    "`hard-iron:estimated` those, and others where the audit found it.",
    "wind": "`wind:measured` and `wind:coefficients`, those whose file has no `wind` yet; the "
    "second not with an environment per recording.",
    "shallow-water": "refused for a depth up to the draught.",
    "feedback-error": _KIND,
    **dict.fromkeys(
        ("thrust-lag", "thrust-delay", "rate-limit", "deadband", "backlash", "actuator-bias"), _KIND
    ),
    "actuator-response": _KIND,
    "thrust-saturation": "those with such channels that have a stated limit.",
    "thrust-asymmetry": "those with thrusters or propellers on both sides of the centreline.",
    "thruster-misalignment": "those with thrusters on both sides of the centreline, some of them a "
    "`[[thruster]]`, which does not turn.",
    "thrust-loss-with-speed": "those with a thruster that is no `[[propeller]]` and has no `curve` "
    "of the shaft speed: with these thrust falls with speed already.",
    "thrust-loss-in-turns": "those with a thruster or propeller.",
    "thrust-change": "those with a thruster or propeller; on one side, those with some on both. "
    "Refused where none of the actuators drives the vessel ahead.",
    "thrust-curve": "those with a thruster or propeller; `thrust-curve:law` as "
    "`thrust-loss-with-speed`. Refused where none of the actuators drives the vessel ahead.",
    "propeller-side-force": "those with one `[[propeller]]`; refused without any.",
    "rudder-interaction": "those whose rudders all have `a_H` zero and `gamma_R` one; refused "
    "without a `[[rudder]]` that is stated by its area.",
    "crossflow-drag": "those whose `[hull]` has none of the derivatives that cross-flow makes "
    "(`Y_vv`, `Y_vr`, `Y_rr`, `Y_vvv`, `Y_vvr`, `N_vv`, `N_vr`, `N_rrv`, `N_vvr`), and that have "
    "no `crossflow-drag` yet.",
    "quadratic-damping": "those with a `[hull]` in SI units that lacks the derivative and its "
    "cubic (`X_uuu`, `Y_vvv`, `N_rrr`); of `Y_vv` and `N_rr`, those without `crossflow-drag`.",
    "sway-yaw-coupling": "those whose file lacks the derivatives.",
    "speed-dependent-damping": "those with a `[hull]` in SI units and without the derivatives.",
    "added-mass-coupling": "those with `Y_rdot` and `N_vdot` zero.",
    "munk-moment": 'those with `added_mass_coriolis = "full"`, as is usual.',
    "mass-change": "those whose file has none; a file may have several.",
}


def page() -> str:
    """The page's Markdown."""
    rows = [
        wrapped(f"[{title}](#{anchor(title)}): {', '.join(map(linked, names(family)))}.", "- ")
        for family, (title, _) in FAMILIES.items()
    ]
    units = ", ".join(get_args(OrderUnit))
    parts = [INTRODUCTION.format(families="\n".join(rows), units=units).rstrip()]
    for family, (title, what) in FAMILIES.items():
        parts += [f"## {title}", wrapped(what.format(per_run=enumeration(own_of_a_run())))]
        parts += [section(name) for name in names(family)]
    return "\n\n".join([*parts, END]) + "\n"


def names(family: str) -> list[str]:
    """Catalogue names of a family, in the catalogue's order."""
    own = (effect.name for effect in EFFECTS.values() if effect.family == family)
    return list(dict.fromkeys(map(catalogue_name, own)))


def own_of_a_run() -> list[str]:
    """Links to the effects of which each recording may have its own."""
    own = (effect.name for effect in EFFECTS.values() if effect.per_run)
    return [linked(name) for name in dict.fromkeys(map(catalogue_name, own))]


def variants(name: str) -> list[Effect]:
    """The entries of one catalogue name."""
    return [effect for effect in EFFECTS.values() if catalogue_name(effect.name) == name]


def section(name: str) -> str:
    """What a user needs to know of one effect."""
    entries = variants(name)
    units = key_units(entries)
    rows = [f"| `{key}` | {units[key]} | {what} |" for key, what in KEYS[name].items()]
    lines = [
        *laws(entries),
        "In a report: " + "; or ".join(dict.fromkeys(spoken(one.phrase) for one in entries)) + ".",
    ]
    if [one.name for one in entries] != [name]:
        lines.append("For `--effects`: " + ", ".join(f"`{one.name}`" for one in entries) + ".")
    parts = dict.fromkeys(part for one in entries for part in one.parts if part != name)
    if parts:
        alone = ", ".join(map(linked, parts))
        lines.append(f"Special cases, each named instead where it does nearly as well: {alone}.")
    alike = dict.fromkeys(other for one in entries for other in one.confusables if other != name)
    lines.append("May be confused with: " + ", ".join(map(linked, alike)) + ".")
    for needed in dict.fromkeys(one.needs for one in entries if one.needs):
        needing = [f"`{one.name}`" for one in entries if one.needs == needed]
        of = "" if len(needing) == len(entries) else f", for {', '.join(needing)}"
        channels = " and ".join(f"`{channel}`" for channel in needed)
        units = " and ".join(CHANNEL_UNITS[channel] for channel in needed)
        columns = "a column of that name" if len(needed) == 1 else "columns of those names"
        lines.append(f"Recordings: {channels} in every run ({columns}, in {units}){of}.")
    if any(one.needs_feedback for one in entries):
        lines.append("Recordings: `exec_` of the channels in every run, measured.")
    if name in VESSELS:
        lines.append(f"Vessels: {VESSELS[name]}")
    table = "\n".join(["| key | unit | |", "| --- | --- | --- |", *rows])
    return "\n\n".join(
        [f"### {name}", wrapped(WHAT[name]), table, "\n".join(wrapped(x, "- ") for x in lines)]
    )


def key_units(entries: list[Effect]) -> dict[str, str]:
    """Unit of each key that the table of an effect may have, besides its name."""
    units: dict[str, str] = {}
    for one in entries:
        for key, unit in one.units.items():
            units.setdefault(key, unit.replace(ORDER_UNIT, "order"))
        units |= {key: "names" for kind, key in PLACES.items() if isinstance(one.place, kind)}
    return units | KEY_UNITS


def laws(entries: list[Effect]) -> list[str]:
    """The laws of an effect's variants; with their names where not all have the same."""
    by_law: dict[str, list[str]] = {}
    for one in entries:
        by_law.setdefault(one.law.rstrip("."), []).append(f"`{one.name}`")
    if len(by_law) == 1:
        return [f"Law: {law}." for law in by_law]
    return [f"Law of {enumeration(of)}: {law}." for law, of in by_law.items()]


def spoken(phrase: str) -> str:
    """A phrase of reports with its numbers by name: `{speed}` is `*speed*`; a choice is both."""

    def word(braces: re.Match[str]) -> str:
        key, _, way = braces[1].partition(":")
        first, choice, other = way.partition("|")
        return f"{first} ({other})" if choice else f"*{key}*"

    return re.sub(r"{([^}]*)}", word, phrase).rstrip(",")


def linked(name: str) -> str:
    """A link to the section of an effect."""
    return f"[{name}](#{anchor(name)})"


def anchor(title: str) -> str:
    """The anchor of a heading, as sites and repositories make it."""
    return title.lower().replace(" ", "-")


def enumeration(words: Iterable[str]) -> str:
    """The words with commas and an `and`."""
    *rest, last = words
    return f"{', '.join(rest)} and {last}" if rest else last


def wrapped(text: str, mark: str = "") -> str:
    """A paragraph, or an item of a list, in lines; a sign between numbers never begins one."""
    bound = re.sub(r" ([-+*]) ", "\x00\\1 ", text)
    lines = textwrap.fill(
        bound,
        WIDTH,
        initial_indent=mark,
        subsequent_indent=" " * len(mark),
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines.replace("\x00", " ")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
