"""Columns of azimuth thrusters: for each a shaft speed or thrust, and the angle that turns it.

Both are called alike but for the words that say which is which: `bow_rpm` and `bow_angle_deg`.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from diffsea.recordings.mapping_proposal.names import Suggestion
from diffsea.recordings.wind import APPARENT, TRUE


_ANGLES = {"angle", "azimuth", "azi", "alpha", "winkel"}
_POWERS = {"rpm", "rps", "revs", "n", "drehzahl", "force", "thrust", "throttle", "power", "pwm"}
_UNITS = {"deg", "degree", "degrees", "rad", "us", "percent", "pct", "newton", "kn"}
_ORDERS = {"order", "ordered", "orders", "cmd", "command", "commanded", "setpoint", "sp", "ref"}
_NO_THRUSTERS = ("psi", "phi", *TRUE, *APPARENT)
_FIELDS = {"data", "value"}  # of a topic that has but one
_SIDES = {"port", "starboard", "stbd", "left", "right"}
_FORE, _AFT = (
    {"bow", "fore", "forward", "front"},
    {"stern", "aft", "rear", "outboard", *_SIDES},
)
_REALISED = {"actual", "feedback", "fb", "measured", "meas", "act", "state"}
# What has an angle and revolutions, or a force, but does not turn its thrust all round.
_OTHERS = {
    *("rudder", "wheel", "helm", "sail", "boom", "wind", "crane", "heading", "course", "roll"),
    *("pitch", "yaw", "heel", "trim", "phase", "blade", "engine", "propeller", "prop", "shaft"),
}


class AzimuthColumns(NamedTuple):
    """The columns of one azimuth thruster.

    Attributes:
        name: the words that both have in common.
        power: of its shaft speed or thrust.
        angle: of its angle.
        realised: of what was measured of an order, by `force` or `angle`, where not both were.
    """

    name: str
    power: str
    angle: str
    realised: Mapping[str, str]

    @property
    def columns(self) -> tuple[str, ...]:
        """All of them."""
        return self.power, self.angle, *self.realised.values()

    @property
    def place(self) -> str:
        """`fore` or `aft` of amidships, where the name says so, or else empty."""
        told = set(_words(self.name))
        return "fore" if told & _FORE else "aft" if told & _AFT else ""


def azimuth_columns(
    names: Sequence[str], suggestions: Mapping[str, Suggestion]
) -> list[AzimuthColumns]:
    """Azimuth thrusters among columns, those that are named alike but for angle and power."""
    powers: dict[tuple[str, ...], str] = {}
    orders: dict[tuple[str, ...], str] = {}  # of what, their names do not say
    angles: dict[tuple[str, ...], str] = {}
    for name in names:
        if suggestions[name].best in _NO_THRUSTERS:
            continue
        words = _words(name)
        told = frozenset(words)
        of = angles if told & _ANGLES else powers if told & _POWERS else None
        if of is angles and told & _OTHERS and "azimuth" not in told:
            continue
        if of is None and told & _ORDERS:
            of, words = orders, [word for word in words if word not in _ORDERS]
        if of is not None:
            of.setdefault(_in_common(words), name)
    driven = orders | powers

    def realised(kind: str, *called: str) -> dict[str, str]:
        """Columns of an order's thruster that are no order, and no pair of their own."""
        others = [(one, *called) for one in ("realised", "") if kind == "order"]
        alone = [words for words in others if (words in powers) != (words in angles)]
        parts = (("force", powers), ("angle", angles))
        return {part: of[words] for words in alone for part, of in parts if words in of}

    return [
        AzimuthColumns(
            re.sub(r"_(\d)", r"\1", "_".join(words[1:])), driven[words], angle, realised(*words)
        )
        for words, angle in angles.items()
        if words in driven
    ]


def _in_common(words: Sequence[str]) -> tuple[str, ...]:
    """What a power and an angle of one thruster share: first whether both are orders."""
    told = set(words)
    kind = "order" if told & _ORDERS else "realised" if told & _REALISED else ""
    named = _ANGLES | _POWERS | _UNITS | _ORDERS | _REALISED | _FIELDS
    rest = [word for word in words if word not in named]
    return kind, *([] if rest and rest[0].isalpha() else ["azimuth"]), *rest


def _words(name: str) -> list[str]:
    """The words of a name, and its numbers, in small letters; units in brackets left out."""
    bare = re.sub(r"[\[(<{].*?[\])>}]", " ", name)
    bare = re.sub(r"([a-z])([A-Z])", r"\1 \2", bare)
    return [word.lower() for word in re.findall(r"[A-Za-zäöüß]+|\d+", bare)]
