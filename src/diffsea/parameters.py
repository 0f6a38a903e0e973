"""Names for the numbers in a model, and what is known of them before seeing data.

A model is a tree of numbers; its parameters are named after their place in it. Start, spread,
bounds and unit of a parameter stand beside the model, so that choosing what to estimate never
edits the model.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError, nearest, nearest_of
from diffsea.outside.documents import read_toml
from diffsea.types import Scalar


Model = TypeVar("Model")

PARAMETERS_LISTED = "`diffsea show VESSEL --json`"  # what lists the numbers of a vessel

# Containers whose names say nothing that the parameter's own name does not.
_SILENT = {"rigid_body", "added_mass", "forces", "actuators", "servos", "derivatives", "damping"}
_SILENT |= {"losses", "environment", "dependent_forces", "drive"}


def _name(path: tuple) -> str:
    parts: list[str] = []
    for key in path:
        part = str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key))))
        if part not in _SILENT and (not parts or parts[-1] != part):
            parts.append(part.removeprefix(f"{parts[-1]}.") if parts else part)
    return ".".join(parts)


def named(model: object) -> dict[str, Scalar]:
    """Every number of `model` by name, for example `X_u`, `port.angle` or `current_north`."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(model)
    return {_name(path): leaf for path, leaf in leaves}


# Main dimensions that parts of a vessel keep a copy of.
_COPIED = ("length", "draught", "water_density", "reference_speed")


def file_parameters(model: object) -> dict[str, tuple[str, ...]]:
    """The numbers of `model` as its file has them: each with the names of all its places.

    A vessel file states its length once, and several parts work with it; a design with
    another length changes it in all of them.
    """
    places: dict[str, tuple[str, ...]] = {}
    values = named(model)
    for name, value in values.items():
        stem = name.rsplit(".", 1)[-1]
        shared = stem in _COPIED and float(values.get(stem, value)) == float(value)
        places[stem if shared else name] = (*places.get(stem, ()), name) if shared else (name,)
    return places


def spread_over_places(
    places: Mapping[str, tuple[str, ...]], values: Mapping[str, Scalar]
) -> dict[str, Scalar]:
    """Values of `designed` numbers for all their places, as `replace` takes them."""
    return {place: value for name, value in values.items() for place in places[name]}


def replace(model: Model, values: Mapping[str, Scalar]) -> Model:
    """The same model with some numbers replaced.

    Raises:
        UserError: a name that the model does not have, with the nearest one it has.
    """
    check_names(model, values)
    leaves, structure = jax.tree_util.tree_flatten_with_path(model)
    return jax.tree_util.tree_unflatten(
        structure, [values.get(_name(path), leaf) for path, leaf in leaves]
    )


def check_names(model: object, names: Iterable[str]) -> None:
    """Raise `UserError` for the first name that is not a parameter of `model`."""
    known = named(model)
    for name in names:
        if name not in known:
            raise UserError(
                f"the vessel has no parameter {name!r}{nearest_of(name, known, PARAMETERS_LISTED)}"
            )


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What is known of one number before seeing data.

    It is estimated by a coordinate that is zero at the prior mean `value`, has a normal prior
    of standard deviation `spread`, and cannot leave the bounds: the number itself in units of
    `scale` where there are none, the logarithm of its distance to one bound, or the logit of
    its place between two.
    """

    name: str
    value: float
    scale: float = 1.0  # in the number's own unit: change for a unit step, without bounds
    spread: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = ""

    @property
    def bounded(self) -> int:
        """How many bounds there are."""
        return math.isfinite(self.lower) + math.isfinite(self.upper)

    def decode(self, coordinate: Scalar) -> Scalar:
        """The number at a coordinate; zero is the prior mean."""
        if self.bounded == 0:
            return self.value + self.scale * coordinate
        if self.bounded == 1:
            bound = self._bound
            return bound + (self.value - bound) * jnp.exp(coordinate)
        return self.lower + (self.upper - self.lower) / (1 + jnp.exp(-self._zero - coordinate))

    def encode(self, value: float) -> float:
        """The coordinate of a number inside the bounds."""
        if self.bounded == 0:
            return (value - self.value) / self.scale
        if self.bounded == 1:
            return float(np.log((value - self._bound) / (self.value - self._bound)))
        return _logit((value - self.lower) / (self.upper - self.lower)) - self._zero

    def slope(self, coordinate: float) -> float:
        """Derivative of the number by its coordinate, without its sign."""
        if self.bounded == 0:
            return abs(self.scale)
        at = float(self.decode(coordinate))
        if self.bounded == 1:
            return abs(at - self._bound)
        return (at - self.lower) * (self.upper - at) / (self.upper - self.lower)

    @property
    def std(self) -> float:
        """Prior standard deviation of the number, to first order."""
        return self.spread * self.slope(0.0)

    @property
    def _bound(self) -> float:
        return self.lower if math.isfinite(self.lower) else self.upper

    @property
    def _zero(self) -> float:
        return _logit((self.value - self.lower) / (self.upper - self.lower))


def _logit(share: float) -> float:
    return math.log(share / (1 - share))


# Hull derivatives that dissipate or carry inertia, and so keep their sign; couplings need not.
_SIGNED = re.compile(r"X_(0|u+)|Y_v+|N_r+|X_udot|Y_vdot|N_rdot")
_DERIVATIVE = re.compile(r"[XYN]_(0|[uvrd]+|[uvr]dot)")
_PLACE = re.compile(r"(.*\.)?(x|y|x_\w|angle|bias|l_R)")


_SHARE = re.compile(r".*\.thrust_curve\.deadband")


def hull_prior(
    name: str, value: float, spread: float = 0.5, nondimensional: bool = False
) -> Parameter:
    """Prior of a number of a vessel around the vessel file's value.

    Drag, added mass, masses and sizes keep their sign; couplings (`Y_r`, `N_v`, `Y_vvr` ...)
    and positions may change it; shares stay below one. `spread` is relative: 0.5 means that half
    as much again is unremarkable.
    """
    free = value == 0 or (
        not _SIGNED.fullmatch(name) and bool(_DERIVATIVE.fullmatch(name) or _PLACE.fullmatch(name))
    )
    lower = 0.0 if value > 0 and not free else -math.inf
    upper = 0.0 if value < 0 and not free else 1.0 if _SHARE.fullmatch(name) else math.inf
    scale, of = abs(value) or 1.0, parameter_unit(name, nondimensional)
    return Parameter(name, value, scale, spread, lower, upper, of)


_KEYS = ("value", "std", "spread", "lower", "upper", "free")


def read_priors(path: str | Path, known: Mapping[str, Parameter]) -> dict[str, Parameter | None]:
    """Priors from a TOML file, by name; None for a number that is to stay as it is.

        format = 1
        [X_u]
        value = -50.0     # prior mean and start; default: the vessel file's
        std = 10.0        # prior standard deviation; or spread = 0.2, relative
        lower = -200.0    # bounds, open where absent
        upper = 0.0
        [x_G]
        free = false

    `known` are the numbers that may be named, with their defaults.

    Raises:
        UserError: a file that cannot be read, an unknown name or key, a value out of bounds.
    """
    document = read_toml(path, "priors from")
    if document.pop("format", 1) != 1:
        raise UserError(f"{path}: this version reads format = 1")
    return priors_of_tables(document, known, str(path))


def priors_of_tables(
    tables: Mapping[str, object], known: Mapping[str, Parameter], where: str
) -> dict[str, Parameter | None]:
    """Priors from tables by name, with the keys of `read_priors`.

    Raises:
        UserError: an unknown name or key, a value out of bounds; the message begins with `where`.
    """
    return {name: _prior_of(where, name, entry, known) for name, entry in tables.items()}


def _prior_of(
    path: str, name: str, entry: object, known: Mapping[str, Parameter]
) -> Parameter | None:
    if name not in known:
        raise UserError(f"{path}: the vessel has no parameter {name!r}{nearest(name, known)}")
    if not isinstance(entry, dict):
        raise UserError(f"{path}: {name} must be a table, for example [{name}] std = 1.0")
    for key, value in entry.items():
        if key not in _KEYS:
            raise UserError(f"{path}, [{name}]: unknown key {key!r}{nearest(key, _KEYS)}")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (isinstance(value, bool) if key == "free" else is_number and value == value):
            raise UserError(f"{path}, [{name}]: {key} = {value!r} is not what it should be")
    if not entry.get("free", True):
        return None
    default = known[name]
    lower, upper = default.lower, default.upper
    if "lower" in entry or "upper" in entry:
        lower, upper = float(entry.get("lower", -math.inf)), float(entry.get("upper", math.inf))
    value = float(entry.get("value", default.value))
    if not (lower < value < upper and math.isfinite(value)):
        raise UserError(
            f"{path}, [{name}]: the value {value:g} is not between the bounds "
            f"{lower:g} and {upper:g}"
        )
    made = Parameter(name, value, abs(value) or 1.0, 1.0, lower, upper, default.unit)
    spread = entry["std"] / made.slope(0.0) if "std" in entry else entry.get("spread", 0.5)
    if not (spread > 0 and math.isfinite(spread)):
        raise UserError(f"{path}, [{name}]: the prior's width must be a finite number above zero")
    return dataclasses.replace(made, spread=float(spread))


_LETTER_UNITS = {"u": "m/s", "v": "m/s", "r": "rad/s", "d": "rad"}
_UNITS = {"mass": "kg", "I_z": "kg m^2", "water_density": "kg/m^3"}
_UNITS |= dict.fromkeys(("x_G", "length", "beam", "draught"), "m")
_UNITS |= {"X_udot": "kg", "Y_vdot": "kg", "Y_rdot": "kg m", "N_vdot": "kg m", "N_rdot": "kg m^2"}
# Of actuators, sensors and surroundings, by the last part of the name.
_UNITS_OF_PARTS: dict[str, str] = dict.fromkeys(
    ("x", "y", "x_H", "l_R", "hull_lever", "height", "diameter"), "m"
)
_UNITS_OF_PARTS |= dict.fromkeys(
    ("lever_x", "lever_y", "velocity_lever_x", "velocity_lever_y"), "m"
)
_UNITS_OF_PARTS |= dict.fromkeys(("area", "frontal_area", "lateral_area"), "m^2")
_UNITS_OF_PARTS |= dict.fromkeys(("time_constant", "delay"), "s")
_UNITS_OF_PARTS |= {
    f"latency_{channel}": "s" for channel in ("position", "heading", "velocity", "yaw_rate", "axes")
}
_UNITS_OF_PARTS |= dict.fromkeys(
    ("angle", "heading_offset", "axes_offset", "hard_iron_cos", "hard_iron_sin", "heel"), "rad"
)
_UNITS_OF_PARTS |= dict.fromkeys(("fading_speed", "reference_speed"), "m/s")
_UNITS_OF_PARTS |= {f"{of}_{to}": "m/s" for of in ("current", "wind") for to in ("north", "east")}
_UNITS_OF_PARTS |= {"gyro_bias": "rad/s", "air_density": "kg/m^3"}
_UNITS_OF_PARTS |= {"full_thrust": "N", "with_speed": "s/m", "in_turns": "s/rad"}


def parameter_unit(name: str, nondimensional: bool = False) -> str:
    """SI unit of a parameter of a vessel file; an empty string where none is known."""
    if nondimensional and _DERIVATIVE.fullmatch(name) and not name.endswith("dot"):
        return "1"
    if name in _UNITS:
        return _UNITS[name]
    stem = name.rsplit(".", 1)[-1]
    if stem in _UNITS_OF_PARTS:
        return _UNITS_OF_PARTS[stem]
    match = re.fullmatch(r"([XYN])_([uvrd]+)", name)
    if match is None:
        return ""
    force = "N m" if match[1] == "N" else "N"
    per = " ".join(f"({_LETTER_UNITS[letter]})" for letter in match[2])
    return f"{force} / {per}"


_DEGREES = {"X": "surge", "Y": "sway", "N": "yaw"}
_OWN = {"X": "u", "Y": "v", "N": "r"}
_ORDERS = {1: "linear", 2: "quadratic", 3: "cubic", 4: "quartic"}
_MEANINGS = {
    "mass": "mass",
    "I_z": "moment of inertia about the centre of gravity",
    "x_G": "centre of gravity forward of amidships",
    "X_0": "resistance ahead",
    "X_udot": "added mass in surge",
    "Y_vdot": "added mass in sway",
    "N_rdot": "added moment of inertia in yaw",
    "Y_rdot": "added mass, sway and yaw",
    "N_vdot": "added mass, yaw and sway",
}
_MEANINGS_OF_PARTS = {  # by the name within an actuator
    "k_T.0": "thrust coefficient at rest",
    "kappa": "speeding up of the slipstream at the rudder",
    "gamma_R_port": "flow straightening, port",
    "gamma_R_starboard": "flow straightening, starboard",
    "astern_factor": "thrust astern over ahead",
}


def parameter_meaning(name: str) -> str:
    """A hull parameter in words: `N_rr` is quadratic damping in yaw."""
    if name in _MEANINGS:
        return _MEANINGS[name]
    part, _, own = name.partition(".")
    if own in _MEANINGS_OF_PARTS:
        return f"{part}, {_MEANINGS_OF_PARTS[own]}"
    match = re.fullmatch(r"([XYN])_([uvrd]+)", name)
    if match is None:
        return name.replace(".", ", ").replace("_", " ")
    degree, letters = match[1], match[2]
    if set(letters) == {_OWN[degree]}:
        return f"{_ORDERS.get(len(letters), '')} damping in {_DEGREES[degree]}".strip()
    force = "moment" if degree == "N" else "force"
    return f"{_DEGREES[degree]} {force} from {' '.join(letters)}"
