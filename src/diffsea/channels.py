"""What actuator channels do, by their names: where no vessel says it, and no mapping."""

from collections.abc import Iterable
from typing import Literal


_RUDDERS = ("rudder", "helm", "delta")
_SIDES: dict[Literal["port", "starboard"], tuple[str, ...]] = {
    "port": ("port", "left"),
    "starboard": ("starboard", "stbd", "right"),
}


def is_rudder(channel: str) -> bool:
    """Whether a channel is the angle of a rudder."""
    return any(word in channel.lower() for word in _RUDDERS)


def is_azimuth(channel: str) -> bool:
    """Whether a channel is the angle of an azimuth thruster."""
    return channel.lower().endswith(".angle")


def steers(channel: str) -> bool:
    """Whether a channel is an angle of steering."""
    return is_rudder(channel) or is_azimuth(channel)


def side_of(channel: str) -> Literal["port", "starboard"] | None:
    """The side on which a channel pushes; None of an angle, and where its name tells none."""
    if steers(channel):
        return None
    low = channel.lower()
    return next((side for side, words in _SIDES.items() if any(w in low for w in words)), None)


def side_pair(channels: Iterable[str]) -> tuple[str, str] | None:
    """The first channels of port and of starboard; None where either side has none."""
    first: dict[str | None, str] = {}
    for channel in channels:
        first.setdefault(side_of(channel), channel)
    return (first["port"], first["starboard"]) if {"port", "starboard"} <= first.keys() else None
