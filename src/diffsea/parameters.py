"""Names for the numbers in a model.

A model is a tree of numbers; its parameters are named after their place in it. What is
known of them before seeing data stands beside the model, in `priors`.
"""

from collections.abc import Iterable, Mapping
from typing import TypeVar

import jax

from diffsea.errors import UserError, nearest
from diffsea.types import Scalar


Model = TypeVar("Model")

# Containers whose names say nothing that the parameter's own name does not.
_SILENT = {
    "rigid_body", "added_mass", "forces", "actuators", "servos", "derivatives", "damping",
    "losses", "environment", "secondary",
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
