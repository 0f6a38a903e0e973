"""Sheets of trial numbers: advance, diameters, overshoots as a paper or a sea trial gives them.

format = 1
relative_std = 0.02          # of every number without one of its own

[[trial]]
manoeuvre = "turning-circle" # orders as in `diffsea trial`
angle = 35.0                 # deg
side = "starboard"
speed = 1.179                # m/s; or thrust in N
[trial.numbers]              # names as in metrics.json, SI units, lengths also over L
advance_over_L = 3.1
tactical_diameter = { value = 22.4, std = 0.3 }
[[trial]]
manoeuvre = "zigzag"
angle = 10.0
heading = 10.0
[trial.numbers]
overshoot_1 = { value = 8.2, unit = "deg", std = 0.5 }
"""

import dataclasses
import math
import tomllib
from pathlib import Path

import numpy as np
from jaxtyping import Float

from diffsea.errors import UserError, nearest
from diffsea.simulation import standard
from diffsea.simulation.standard import Plan
from diffsea.vessel.base import Vessel


RELATIVE_STD = 0.03
_ORDERS = ("angle", "heading", "speed", "thrust", "seconds", "step")
_KEYS = (*_ORDERS, "manoeuvre", "side", "executes", "numbers")
_UNITS = {"m": 1.0, "s": 1.0, "rad": 1.0, "rad/s": 1.0, "m/s": 1.0, "deg": math.pi / 180,
          "deg/s": math.pi / 180}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Sheet:
    """One trial and what was read off it, in SI units."""

    plan: Plan
    names: tuple[str, ...]
    values: Float[np.ndarray, "number"]
    stds: Float[np.ndarray, "number"]

    @property
    def title(self) -> str:
        """The trial in a few words."""
        plan, degrees = self.plan, math.degrees(self.plan.angle)
        side = "starboard" if plan.side > 0 else "port"
        heading = f"/{math.degrees(plan.heading):g}" if plan.heading else ""
        return f"{plan.manoeuvre} {degrees:g}{heading} deg to {side}"


def is_sheet(path: str | Path) -> bool:
    """Whether a file is a sheet of trial numbers rather than a recording."""
    return Path(path).suffix.lower() == ".toml"


def read_sheet(path: str | Path, vessel: Vessel) -> tuple[Sheet, ...]:
    """The trials of a sheet, planned for a vessel.

    Raises:
        UserError: a file that cannot be read, an unknown key, manoeuvre, number or unit.
    """
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"cannot read trial numbers from {path}: {error}") from error
    trials = document.get("trial")
    if document.get("format", 1) != 1 or not isinstance(trials, list) or not trials:
        raise UserError(
            f"{path} is no sheet of trial numbers: it needs format = 1 and a [[trial]] with "
            "manoeuvre and [trial.numbers]"
        )
    relative = _number(document.get("relative_std", RELATIVE_STD), f"{path}: relative_std")
    return tuple(
        _sheet(f"{path}, trial {k + 1}", entry, relative, vessel) for k, entry in enumerate(trials)
    )


def _sheet(where: str, entry: dict, relative: float, vessel: Vessel) -> Sheet:
    for key in entry:
        if key not in _KEYS:
            raise UserError(f"{where}: unknown key {key!r}{nearest(key, _KEYS)}")
    if "manoeuvre" not in entry or not entry.get("numbers"):
        raise UserError(f"{where} needs a manoeuvre and [trial.numbers] with at least one number")
    side = entry.get("side", "starboard")
    if side not in ("starboard", "port"):
        raise UserError(f"{where}: side = {side!r} is neither starboard nor port")
    orders = {key: _number(entry[key], f"{where}: {key}") for key in _ORDERS if key in entry}
    for key in ("angle", "heading"):
        orders |= {key: math.radians(orders[key])} if key in orders else {}
    plan = standard.plan(
        vessel, entry["manoeuvre"], side=1.0 if side == "starboard" else -1.0,
        executes=int(entry.get("executes", _executes(entry["numbers"]))), **orders,
    )  # fmt: skip
    rows = [
        _read_number(f"{where}, {name}", name, given, relative, float(vessel.rigid_body.length))
        for name, given in entry["numbers"].items()
    ]
    names, values, stds = zip(*rows, strict=True)
    return Sheet(plan, names, np.array(values), np.array(stds))


def _executes(numbers: dict) -> int:
    """Enough rudder executions for the overshoots that are asked for."""
    last = [int(n.rsplit("_", 1)[1]) for n in numbers if n.startswith("overshoot_")]
    return max([2, *(k + 1 for k in last)])


def _read_number(
    where: str, name: str, given: object, relative: float, length: float
) -> tuple[str, float, float]:
    """Name as simulated, value and standard deviation."""
    entry = given if isinstance(given, dict) else {"value": given}
    for key in entry:
        if key not in ("value", "std", "unit"):
            raise UserError(f"{where}: unknown key {key!r}; give value, std and unit")
    factor = 1.0
    if "unit" in entry:
        if entry["unit"] not in _UNITS:
            raise UserError(f"{where}: unknown unit {entry['unit']!r}; use {', '.join(_UNITS)}")
        factor = _UNITS[entry["unit"]]
    if name.endswith("_over_L"):
        name, factor = name.removesuffix("_over_L"), length
    value = factor * _number(entry.get("value"), where)
    std = factor * _number(entry["std"], where) if "std" in entry else relative * abs(value)
    if not std > 0:
        raise UserError(f"{where}: the standard deviation must be above zero")
    return name, value, std


def _number(given: object, where: str) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not math.isfinite(given):
        raise UserError(f"{where}: {given!r} is not a number")
    return float(given)
