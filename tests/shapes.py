"""Checks of shape annotations while tests run: what jaxtyping's import hook decorates with."""

import typing
from collections.abc import Callable

import beartype
import jaxtyping


def mentions_shape(hint: object) -> bool:
    """Whether a type hint has a jaxtyping array in it."""
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        return True
    return any(mentions_shape(part) for part in typing.get_args(hint))


def check_shapes(function: Callable) -> Callable:
    """The function with its shape annotations checked by beartype, and no others.

    What else is annotated is left to pyright: a number is a float, a NumPy or a JAX number, traced
    or not, which annotations of plain types do not say.
    """
    hints = getattr(function, "__annotations__", {})
    shapes = {name: hint for name, hint in hints.items() if mentions_shape(hint)}
    if not shapes:
        return function
    function.__annotations__ = shapes
    return beartype.beartype(function)
