"""Ranges and grids on the command line: `NAME=FROM:TO` and `NAME=FROM:TO:COUNT`."""

import argparse
from typing import Any

from diffsea.cli import options


GRID_FORM = "NAME=FROM:TO:COUNT"
RANGE_FORM = "NAME=FROM:TO"
_EXAMPLES = {GRID_FORM: "mass=150:220:8", RANGE_FORM: "mass=150:220"}


def axis(text: str, form: str = GRID_FORM) -> tuple[str, tuple[Any, ...]]:
    """A parameter and its values: from, to and, where the form has it, how many.

    Raises:
        ArgumentTypeError: another form, a number that is not finite, or a count below one.
    """
    name, equals, values = text.partition("=")
    bounds = values.split(":")
    if not (name and equals and len(bounds) == len(form.split(":"))):
        example = _EXAMPLES[form]
        raise argparse.ArgumentTypeError(
            f"{text!r} is not of the form {form}, for example {example}"
        )
    first, last = (options.number(bound) for bound in bounds[:2])
    return name, (first, last, *map(options.count, bounds[2:]))


def range_of(text: str) -> tuple[str, tuple[float, float]]:
    """A type of argument: a parameter, from and to."""
    name, (low, high) = axis(text, RANGE_FORM)
    return name, (low, high)


def by_name(axes: list[tuple[str, Any]]) -> dict[str, Any]:
    """The axes by parameter; one that is given twice is bad usage."""
    names = [name for name, _ in axes]
    for name in names:
        if names.count(name) > 1:
            raise argparse.ArgumentTypeError(f"{name!r} is given twice")
    return dict(axes)


def number_and_ranges(words: list[str]) -> tuple[int, dict[str, tuple[float, float]]]:
    """Of `N NAME=FROM:TO ...` the number, and the ranges by name.

    Raises:
        ArgumentTypeError: no range, one of another form, or one that is given twice.
    """
    number, *ranges = words
    if not ranges:
        raise argparse.ArgumentTypeError("give a number of designs, then NAME=FROM:TO")
    return options.count(number), by_name([range_of(text) for text in ranges])
