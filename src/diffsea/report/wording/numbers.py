"""Numbers that trials and missions are summed up by: in words, and their units."""

from diffsea.metrics.numbers import trial_unit
from diffsea.missions.performance import NUMBERS


def number_words(number: str) -> str:
    """The name of a number of metrics.json or run.json in words."""
    return number.replace("_", " ")


def number_unit(name: str) -> str:
    """The SI unit of a number of metrics.json or run.json, `1` where it has none.

    Raises:
        KeyError: no such number.
    """
    return NUMBERS.get(name) or trial_unit(name)
