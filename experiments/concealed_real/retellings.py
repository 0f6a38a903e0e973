"""The same runs told otherwise: turned, moved, later, reordered, mirrored, in a current, cut.

What a diagnosis finds must not depend on how the world is told. Every retelling says what becomes
of the material, and of the numbers of what is found in it. Imports nothing of the tool.
"""

import copy
import dataclasses
import math
from collections.abc import Callable
from typing import Any

from experiments.concealed_real import sensor_injections as sensor
from experiments.concealed_real.material import Document, Material, Run, Runs, parts_of, replaced

import numpy as np


TURN = 0.7  # rad
NORTH, EAST = 137.0, -61.0  # m
LATER = 1234.5  # s
FLOW = {"size": 0.25, "angle": 2.1}  # m/s, rad, of a 3 m model; others by the root of length
FLOW_LENGTH = 3.0  # m

DIRECTIONS = {  # parameters that are directions on earth, by effect
    "current": ("direction",),
    "wind": ("direction",),
    "wave-force": ("direction",),
    "hard-iron": ("phase",),
}
TIMES = {"thrust-change": ("time",), "mass-change": ("time",), "drag-change": ("time",)}
ODD = {  # parameters that change their sign in a mirror
    "current": ("direction",),
    "wind": ("direction",),
    "wave-force": ("direction",),
    "heading-offset": ("angle",),
    "hard-iron": ("phase",),
    "gyro-bias": ("bias",),
    "lever-arm": ("y",),
    "thrust-asymmetry": ("ratio",),
    "thruster-misalignment": ("angle",),
    "propeller-side-force": ("Y_ahead", "N_ahead", "Y_astern", "N_astern"),
}
STEERING = ("rudder", "tunnel_thruster")  # whose orders change their sign in a mirror
CIRCULAR = ("direction", "phase")

Effect = dict[str, Any]  # an entry of `effects` in diagnosis.json


@dataclasses.dataclass(frozen=True)
class Retelling:
    """One way to tell the same.

    Arguments:
        tell: what the diagnosis is given instead.
        translate: an effect, as found in the material as it was, as it must be found then.
        tolerance: of sizes, in standard errors.
        misfit: how far the nominal misfit may be off, as a share.
    """

    tell: Callable[[Material], Material]
    translate: Callable[[Effect, Document], Effect] = lambda effect, document: effect
    tolerance: float = 0.1
    misfit: float = 0.01


# The world moved


def turned(run: Run, angle: float = TURN) -> Run:
    """The world turned by an angle about the origin, rad."""
    new = {}
    if "psi" in run:
        new["psi"] = run["psi"].to_numpy() + angle
    if {"x", "y"} <= set(run):
        x, y = run["x"].to_numpy(), run["y"].to_numpy()
        new["x"] = x * math.cos(angle) - y * math.sin(angle)
        new["y"] = x * math.sin(angle) + y * math.cos(angle)
    if "wind_direction" in run:
        new["wind_direction"] = run["wind_direction"].to_numpy() + angle
    return replaced(run, new)


def moved(run: Run) -> Run:
    """The origin of positions somewhere else."""
    shift = {"x": NORTH, "y": EAST}
    return replaced(run, {c: run[c].to_numpy() + by for c, by in shift.items() if c in run})


def later(run: Run) -> Run:
    """The clock set otherwise."""
    return replaced(run, {"t": run["t"].to_numpy() + LATER})


def _later_effect(effect: Effect, document: Document) -> Effect:
    """Times are later; what a drifting clock was off at time zero is another number."""
    new = _shifted(effect, TIMES, LATER)
    if effect["name"] == "clock-drift":
        new["parameters"].pop("offset", None)
    return new


def _shifted(effect: Effect, parameters: dict[str, tuple[str, ...]], by: float) -> Effect:
    new = copy.deepcopy(effect)
    for name in parameters.get(effect["name"], ()):
        if name in new["parameters"]:
            new["parameters"][name]["value"] += by
    return new


def reordered(material: Material) -> Material:
    """The recordings named in the reverse order."""
    back = lambda runs: dict(reversed(list(runs.items())))
    return dataclasses.replace(material, train=back(material.train), test=back(material.test))


# The mirror


def mirrored(material: Material) -> Material:
    """Port for starboard in the world, in the vessel and in all orders."""
    signs = {"y": -1, "psi": -1, "v": -1, "r": -1, "phi": -1, "p": -1, "wind_direction": -1}
    for channel in odd_channels(material.document):
        signs |= {f"cmd_{channel}": -1, f"exec_{channel}": -1}
    mirror = lambda run: replaced(
        run, {c: sign * run[c].to_numpy() for c, sign in signs.items() if c in run}
    )
    told = material.with_runs(mirror)
    return dataclasses.replace(told, document=mirrored_document(material.document))


def odd_channels(document: Document) -> list[str]:
    """Actuator channels whose orders change their sign in a mirror."""
    found = []
    for kind, part in parts_of(document):
        if kind in STEERING:
            found.append(part["name"])
        elif kind == "azimuth_thruster":
            found.append(f"{part['name']}.angle")
    return found


def mirrored_document(document: Document) -> Document:
    """The vessel in a mirror: actuators keep their names and change sides.

    Raises ValueError for a vessel file with effects, whose mirror is not written here.
    """
    if document.get("effect"):
        raise ValueError("a vessel file with effects is not mirrored")
    new = copy.deepcopy(document)
    new["hull"] = {k: _mirrored_term(k, v) for k, v in new["hull"].items()}
    for kind, part in parts_of(new):
        for key in ("y", "angle"):
            if key in part:
                part[key] = -part[key]
        if {"gamma_R_port", "gamma_R_starboard"} <= set(part):
            both = part["gamma_R_port"], part["gamma_R_starboard"]
            part["gamma_R_starboard"], part["gamma_R_port"] = both
        if kind in STEERING and {"max_force", "min_force"} <= set(part):
            part["max_force"], part["min_force"] = -part["min_force"], -part["max_force"]
    return new


def _mirrored_term(name: str, value: Any) -> Any:
    """A derivative in the mirror.

    X is even in v and r together. Y and N are odd: a modulus (Y_vv of |v| v) makes them so, and
    only what depends on u alone, or on nothing, changes its sign.
    """
    force, _, monomial = name.partition("_")
    if force not in ("X", "Y", "N") or monomial.endswith("dot"):
        return value
    lateral = sum(monomial.count(letter) for letter in "vrp")
    keeps = lateral % 2 == 0 if force == "X" else lateral > 0
    return value if keeps else -value


def mirrored_effect(effect: Effect, document: Document) -> Effect:
    """An effect as the mirrored runs have it."""
    new, odd = copy.deepcopy(effect), ODD.get(effect["name"], ())
    biased = effect["name"] in ("actuator-bias", "feedback-error")
    acted_on = set(effect.get("actuators", ()))
    if biased and acted_on and acted_on <= set(odd_channels(document)):
        odd = ("bias", "offset")
    for name in odd:
        if name in new["parameters"]:
            new["parameters"][name]["value"] *= -1
    return new


# A current put in and told, and runs cut


def in_known_current(material: Material) -> Material:
    """A current put into every run, and the same current in the vessel file."""
    length = float(material.document["hull"].get("length", FLOW_LENGTH))
    flow = {"size": FLOW["size"] * math.sqrt(length / FLOW_LENGTH), "angle": FLOW["angle"]}
    told = material.with_runs(lambda run: sensor.current(run, flow))
    document = copy.deepcopy(material.document)
    known = {"name": "current", "speed": flow["size"], "direction": flow["angle"]}
    document["effect"] = [*document.get("effect", []), known]
    return dataclasses.replace(told, document=document)


def cut_in_two(material: Material) -> Material:
    """Every run as two recordings, each with half of its rows."""
    return dataclasses.replace(material, train=_halves(material.train), test=_halves(material.test))


def _halves(runs: Runs) -> Runs:
    out: Runs = {}
    for name, run in runs.items():
        stem, middle = name.rsplit(".", 1)[0], len(run) // 2
        out[f"{stem}_first.csv"] = run.iloc[:middle].reset_index(drop=True)
        out[f"{stem}_second.csv"] = run.iloc[middle:].reset_index(drop=True)
    return out


def _of_runs(change: Callable[[Run], Run]) -> Callable[[Material], Material]:
    return lambda material: material.with_runs(change)


RETELLINGS: dict[str, Retelling] = {
    "turned": Retelling(_of_runs(turned), lambda e, d: _shifted(e, DIRECTIONS, TURN)),
    "moved": Retelling(_of_runs(moved)),
    "later": Retelling(_of_runs(later), _later_effect),
    "reordered": Retelling(reordered),
    "mirrored": Retelling(mirrored, mirrored_effect),
    "in-known-current": Retelling(in_known_current),
    "cut-in-two": Retelling(cut_in_two, tolerance=1.0, misfit=0.05),
}
NEEDS_POSITIONS = ("moved", "in-known-current")  # and a heading, the latter


def retold(material: Material) -> dict[str, Material]:
    """The transformed recordings and vessel of every retelling that is possible, by name."""
    columns = set.intersection(*(set(run) for run in material.runs.values()))
    return {
        name: retelling.tell(material)
        for name, retelling in RETELLINGS.items()
        if name not in NEEDS_POSITIONS or {"x", "y", "psi"} <= columns
    }


def difference(found: Effect, expected: Effect) -> dict[str, float]:
    """How far the parameters of two effects lie apart, in standard errors of the expected one."""
    apart = {}
    for name, entry in expected["parameters"].items():
        other = found["parameters"].get(name)
        if other is None or not entry.get("std"):
            continue
        off = other["value"] - entry["value"]
        if name in CIRCULAR:
            off = (off + math.pi) % (2 * math.pi) - math.pi
        apart[name] = float(np.abs(off) / entry["std"])
    return apart
