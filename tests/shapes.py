"""Checks of shape annotations while tests run: what jaxtyping's import hook decorates with."""

import collections
import functools
import itertools
import operator
import sys
import types
import typing
from collections.abc import Callable

import beartype
import jaxtyping


CHECKED_CALLS = 100  # of each function, in each process
CHECKED_CLOSURES = 20  # of each function within another, which is a new one at every call of that
_closures: collections.Counter[types.CodeType] = collections.Counter()


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
    or not, which annotations of plain types do not say. After so many calls a function is left
    alone: loops of NumPy call some a hundred thousand times, and would take twice as long.
    Closures are left alone after so many of one kind: to check them takes longer than they do.
    """
    code = getattr(function, "__code__", None)
    if code is not None and "<locals>" in function.__qualname__:
        _closures[code] += 1
        if _closures[code] > CHECKED_CLOSURES:
            return function
    hints = getattr(function, "__annotations__", {})
    shapes = {name: shape_of(hint) for name, hint in hints.items() if shape_of(hint) is not None}
    checked = function
    if shapes:
        function.__annotations__ = shapes
        checked = beartype.beartype(function)
    calls = itertools.count()

    @functools.wraps(function)
    def counted(*args, **kwargs):
        if next(calls) == CHECKED_CALLS:
            leave_alone(function.__module__, function.__qualname__)
        return checked(*args, **kwargs)

    return counted


def leave_alone(module: str, qualname: str) -> None:
    """Check a function no more; one that its module does not have by name is checked on."""
    found: typing.Any = sys.modules.get(module)
    for name in qualname.split("."):
        found = vars(found).get(name) if hasattr(found, "__dict__") else None
    found = getattr(found, "fget", found)  # of a property
    if isinstance(found, types.FunctionType):
        typing.no_type_check(found)
