"""Names for the numbers in a model, and what is known of each before seeing data.

A model is a tree of numbers; its parameters are named after their place in it. What is
free, its bounds and its prior stand in `Parameter` records beside the model, so that
choosing what to estimate never edits the model.
"""

import dataclasses
import re
from collections.abc import Iterable, Mapping
from typing import TypeVar

import jax
import numpy as np

from diffsea.errors import UserError, nearest
from diffsea.types import Scalar


Model = TypeVar("Model")

# Containers whose names say nothing that the parameter's own name does not.
_SILENT = {
    "rigid_body", "added_mass", "forces", "actuators", "servos", "derivatives", "damping",
    "losses", "environment",
}  # fmt: skip


def _name(path: tuple) -> str:
    parts: list[str] = []
    for key in path:
        part = str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key))))
        if part not in _SILENT and (not parts or parts[-1] != part):
            parts.append(part)
    return ".".join(parts)


def named(model: Model) -> dict[str, Scalar]:
    """Every number of `model` by name, for example `X_u`, `port.angle` or `current_north`."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(model)
    return {_name(path): leaf for path, leaf in leaves}


# Main dimensions that parts of a vessel keep a copy of.
_COPIED = ("length", "draught", "water_density", "reference_speed")


def designed(model: Model) -> dict[str, tuple[str, ...]]:
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


def spread(
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


def check_names(model: Model, names: Iterable[str]) -> None:
    """Raise `UserError` for the first name that is not a parameter of `model`."""
    known = named(model)
    for name in names:
        if name not in known:
            raise UserError(
                f"the vessel has no parameter {name!r}{nearest(name, known)}; "
                f"it has: {', '.join(known)}"
            )


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What is known of one number before seeing data.

    A positive or negative number is estimated by its logarithm, so that it keeps its
    sign; any other by its value in units of `scale`. The prior on that coordinate is
    normal with standard deviation `spread` about `value`.
    """

    name: str
    value: float
    scale: float = 1.0
    signed: bool = True  # may change sign: linear coordinate
    spread: float = 1.0

    def decode(self, coordinate: Scalar) -> Scalar:
        """The number at a coordinate; zero is the prior mean."""
        if self.signed:
            return self.value + self.scale * coordinate
        return self.value * jax.numpy.exp(coordinate)

    def encode(self, value: float) -> float:
        """The coordinate of a number."""
        if self.signed:
            return (value - self.value) / self.scale
        return float(np.log(value / self.value))

    def slope(self, coordinate: float) -> float:
        """Derivative of the number by its coordinate."""
        return self.scale if self.signed else abs(float(self.decode(coordinate)))


_SIGN_FREE = re.compile(r"(Y_u*r|N_u*v|Y_rdot|N_vdot|.*_G|x|y|.*\.(x|y|angle|bias))$")


def hull_prior(name: str, value: float, spread: float = 0.5) -> Parameter:
    """Prior of a hull derivative around the vessel file's value.

    Drag and added mass keep their sign; couplings (`Y_r`, `N_v`, ...) and positions may
    change it. `spread` is relative: 0.5 means that half as much again is unremarkable.
    """
    signed = bool(_SIGN_FREE.fullmatch(name)) or value == 0
    return Parameter(name, value, abs(value) or 1.0, signed, spread)


_LETTER_UNITS = {"u": "m/s", "v": "m/s", "r": "rad/s", "d": "rad"}
_UNITS = {
    "mass": "kg", "I_z": "kg m^2", "x_G": "m", "length": "m", "beam": "m", "draught": "m",
    "water_density": "kg/m^3", "X_udot": "kg", "Y_vdot": "kg", "Y_rdot": "kg m",
    "N_vdot": "kg m", "N_rdot": "kg m^2",
}  # fmt: skip


def unit(name: str) -> str:
    """SI unit of a dimensional hull parameter; an empty string where none is known."""
    if name in _UNITS:
        return _UNITS[name]
    match = re.fullmatch(r"([XYN])_([uvrd]+)", name)
    if match is None:
        return ""
    force = "N m" if match[1] == "N" else "N"
    per = " ".join(f"({_LETTER_UNITS[letter]})" for letter in match[2])
    return f"{force} / {per}"
