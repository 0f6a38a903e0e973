"""Numbers for people: units they use, and no more digits than the error allows."""

import math
import re
from collections.abc import Sequence
from typing import TypeGuard


MOST_WITHOUT_EXPONENT = 1e6  # beyond, digits have to be counted
CERTAIN = 6.0  # decimal logarithm of odds from which their size tells nothing more


_DEGREES = {"rad": "deg", "rad/s": "deg/s", "rad per s": "deg/s"}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_EXPONENT = re.compile(r"(?:(?<![\w.])(-?\d+(?:\.\d+)?)|(?<=\)))e(-?\d+)(?!\w)")
_MINUS = re.compile(r"(?<![\w.\-])-(?=\d)")
UNKNOWN = "not known"


def for_people(value: float, unit: str) -> tuple[float, str]:
    """A value in the unit that people read it in: degrees instead of radians."""
    if unit in _DEGREES:
        return math.degrees(value), _DEGREES[unit]
    return value, "" if unit == "1" else unit


def is_known(value: float | None) -> TypeGuard[float]:
    """Whether there is a finite number: records have None, tables NaN, where nothing is known."""
    return value is not None and math.isfinite(value)


def significant(value: float, digits: int) -> str:
    """A number with so many significant digits, without an exponent where that is readable.

    From 0.0001 to ten million: `0.00123`, `12300`; beyond, `1.2e-9`.
    """
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")
    return _with_decimals(value, digits - 1 - _exponent(value, digits))


def _exponent(value: float, digits: int) -> int:
    """The power of ten of the leading digit after rounding."""
    return int(f"{abs(value):.{digits - 1}e}".split("e")[1])


def _with_decimals(value: float, decimals: int) -> str:
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def _decimals(std: float) -> int:
    """Decimals that show one digit of an error, or two where it begins with a one."""
    digits = 2 if f"{std:e}"[0] == "1" else 1
    return digits - 1 - _exponent(std, digits)


def _power(size: float) -> int:
    """The power of ten that is written out; zero where the number can be read without."""
    return _exponent(size, 2) if size >= MOST_WITHOUT_EXPONENT else 0


def round_to_error(value: float | None, std: float | None = None, unit: str = "") -> str:
    """A value alone, rounded as its error suggests: `0.30 m/s`.

    Arguments:
        value: in SI units; None or not finite is `not known`.
        std: its standard error; three significant digits where there is none, and a whole number
            without a unit of error zero is a count.
        unit: of both; radians become degrees.
    """
    if not is_known(value):
        return UNKNOWN
    value, name = for_people(value, unit)
    if unit == "1" and std == 0 and float(value).is_integer():
        return f"{value:.0f}"  # a count
    if not is_known(std) or std <= 0:
        return f"{significant(value, 3)} {name}".strip()
    # In a sentence two digits are enough, or all those before the point.
    enough = max(1 - _exponent(value, 2), 0) if value else 0
    decimals = min(_decimals(for_people(std, unit)[0]), enough)
    power = _power(abs(value))
    mantissa = _with_decimals(value / 10**power, decimals + power)
    return f"{mantissa}{f'e{power}' if power else ''} {name}".strip()


def with_error(value: float | None, std: float | None, unit: str = "") -> str:
    """A value with its standard error: `0.301 +- 0.004 m/s`.

    Arguments:
        value: in SI units.
        std: one digit is shown of it, two where it begins with a one.
        unit: of both; radians become degrees.
    """
    if not is_known(value) or not is_known(std) or std <= 0:
        return round_to_error(value, std, unit)
    value, name = for_people(value, unit)
    std, _ = for_people(std, unit)
    power = _power(max(abs(value), std))
    decimals = _decimals(std) + power
    both = " +- ".join(_with_decimals(one / 10**power, decimals) for one in (value, std))
    return f"({both})e{power} {name}".strip() if power else f"{both} {name}".strip()


def probability(p: float | None) -> str:
    """A p-value: `0.03`, `2e-9`."""
    if not is_known(p):
        return UNKNOWN
    if p < 1e-99:
        return "< 1e-99"
    return f"{p:.0e}".replace("e-0", "e-") if p < 1e-3 else significant(min(p, 1.0), 2)


def p_equals(p: float | None) -> str:
    """A p-value with its sign: `p = 0.03`, `p < 1e-99`."""
    told = probability(p)
    return f"p {told}" if told.startswith("<") else f"p = {told}"


def interval(bounds: Sequence[float | None], unit: str = "") -> str:
    """An interval in people's units: `0.294 to 0.308 m/s`; an end that is not finite is `open`."""
    low, high = (for_people(end, unit)[0] if is_known(end) else None for end in bounds)
    if low is None or high is None or not high > low:
        ends = ["open" if end is None else significant(end, 3) for end in (low, high)]
    else:
        decimals = _decimals((high - low) / 3.29)
        ends = [_with_decimals(end, decimals) for end in (low, high)]
    return f"{' to '.join(ends)} {for_people(0.0, unit)[1]}".strip()


def odds(log10: float | None) -> str:
    """Odds from their decimal logarithm: `850 : 1`, `1e23 : 1`, `1 : 30`."""
    if not is_known(log10):
        return UNKNOWN
    size = abs(log10)
    number = f"{float(significant(10**size, 2)):g}" if size < 4 else f"1e{size:.0f}"
    return f"{number} : 1" if log10 >= 0 else f"1 : {number}"


def odds_or_bound(log10: float | None) -> str:
    """Odds, of such as nobody would doubt the bound alone: `over 1e6 : 1`."""
    certain = is_known(log10) and log10 > CERTAIN
    return f"over {odds(CERTAIN)}" if certain else odds(log10)


def duration(seconds: float) -> str:
    """A length of time: `90 s`, `12 min`, `5 h`."""
    for scale, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 3 * scale:
            return f"{significant(seconds / scale, 2)} {unit}"
    return f"{significant(seconds, 2)} s"


def typeset(text: str) -> str:
    """The same text with the signs of print: plus-minus, minus, powers of ten, degrees."""
    out = text.replace("+-", "±").replace("->", "→").replace("^2", "²").replace("^3", "³")
    power = lambda m: f"{m[1] or ''}×10{str(int(m[2])).translate(_SUPERSCRIPTS)}"
    out = _EXPONENT.sub(power, out)
    out = _MINUS.sub("−", out)
    return out.replace(" deg/s", "°/s").replace(" deg", "°")
