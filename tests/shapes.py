"""Checks of shape annotations while tests run: what jaxtyping's import hook decorates with."""

import functools
import operator
import types
import typing
from collections.abc import Callable

import beartype
import jaxtyping


def shape_of(hint: typing.Any) -> typing.Any:
    """A type hint of arrays of NumPy or JAX alike; None where it has no shape to check."""
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        return hint.dtype[typing.Any, hint.dim_str]
    parts = typing.get_args(hint)
    if not any(shape_of(part) is not None for part in parts):
        return None
    checked = [part if shape_of(part) is None else shape_of(part) for part in parts]
    origin: typing.Any = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return functools.reduce(operator.or_, checked)
    return origin[tuple(checked)]


def check_shapes(function: Callable) -> Callable:
    """The function with its shape annotations checked by beartype, and no others.

    What else is annotated is left to pyright: a number is a float, a NumPy or a JAX number, traced
    or not, which annotations of plain types do not say.
    """
    hints = getattr(function, "__annotations__", {})
    shapes = {name: shape_of(hint) for name, hint in hints.items() if shape_of(hint) is not None}
    if not shapes:
        return function
    function.__annotations__ = shapes
    return beartype.beartype(function)
