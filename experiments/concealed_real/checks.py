"""Checks of what a diagnosis or an audit says. `line` is a line of results as `run` writes it."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any


Line = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Check:
    """One thing that must be so. `holds` sees the line; None where it does not apply.

    Arguments:
        welcome: right where it is said, not wrong where it is not.
    """

    what: str
    holds: Callable[[Line], bool | None]
    welcome: bool = False


def sizes(
    line: Line, names: Sequence[str], parameter: str, acting: Sequence[str] = ("",)
) -> list[float]:
    """Values of a parameter in the effects of some names.

    Arguments:
        acting: texts of which every actuator or channel of the effect must end with one.
    """
    return [
        effect["parameters"][parameter]["value"]
        for effect in line["effects"]
        if effect["name"] in names
        and parameter in effect["parameters"]
        and all(one.endswith(tuple(acting)) for one in acted_on(effect))
    ]


def acted_on(effect: dict[str, Any]) -> list[str]:
    """Actuators or channels that an effect names; none where it acts on all."""
    return [*effect.get("actuators", ()), *effect.get("channels", ())]


def within(
    what: str, names: Sequence[str], parameter: str, low: float, high: float,
    acting: Sequence[str] = ("",), welcome: bool = False,
) -> Check:  # fmt: skip
    """An effect of one of the names is given, and every size of it lies in an interval.

    Signs count where the interval is below zero.
    """

    def holds(line: Line) -> bool | None:
        found = sizes(line, names, parameter, acting)
        if not found:
            return None if welcome else False
        return all(low <= (value if low < 0 else abs(value)) <= high for value in found)

    return Check(what, holds, welcome)


def any_of(what: str, *checks: Check) -> Check:
    """One of several checks holds."""
    return Check(what, lambda line: any(check.holds(line) for check in checks))


def unnamed(names: Sequence[str]) -> Check:
    """None of the names is given."""
    given = lambda line: {effect["name"] for effect in line["effects"]}
    return Check(f"no {', '.join(names)}", lambda line: not given(line) & set(names))


def named(names: Sequence[str]) -> Check:
    """One of the names is given."""
    return Check(
        f"named {' or '.join(names)}",
        lambda line: any(effect["name"] in names for effect in line["effects"]),
    )


def something_left() -> Check:
    """The diagnosis says that the model lacks something for which it has no name."""
    return Check("something is left", lambda line: line["verdict"] == "unexplained")


def audited(
    kind: str, recordings: Sequence[str], low: float = 0.0, high: float = math.inf,
    channel: str = "", at_least: int = 0,
) -> Check:  # fmt: skip
    """The audit finds a kind in the recordings, with a size in an interval.

    Arguments:
        channel: that the finding must concern, where it says which it does.
        at_least: in so many of the recordings; in all for 0.
    """
    wanted = {stem(name) for name in recordings}
    needed = at_least or len(wanted)

    def holds(line: Line) -> bool:
        found = {
            stem(one["recording"])
            for one in line["audit"]
            if one["kind"] == kind
            and low <= abs(one.get("value") or 0.0) <= high
            and (not channel or channel in one.get("channels", (channel,)))
        }
        return len(found & wanted) >= needed

    return Check(f"audit: {kind} in {needed} of {len(wanted)} recordings", holds)


def not_audited(kind: str, recordings: Sequence[str]) -> Check:
    """The audit finds a kind in none of the recordings."""
    names = {stem(name) for name in recordings}
    return Check(
        f"audit: no {kind} in {len(recordings)} recordings",
        lambda line: (
            not any(
                one["kind"] == kind and stem(one["recording"]) in names for one in line["audit"]
            )
        ),
    )


def stem(name: str) -> str:
    """A recording's name without its suffix."""
    return name.rsplit(".", 1)[0]
