"""Effects, their sizes and lists in plain words."""

import math
from collections.abc import Sequence
from typing import Any

from diffsea.parameters import parameter_meaning
from diffsea.report.quantities import is_known, odds, round_to_error, with_error
from diffsea.trajectory import in_words
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.effects.actuators import SIDES, OrderedChannels
from diffsea.vessel.effects.entry import DegreesOfFreedom, MeasuredChannels


Record = dict[str, Any]  # a part of diagnosis.json or fit.json

# What symbols of effects mean that are no parameters of a vessel file.
SYMBOLS = {
    "C_X": "wind coefficient ahead",
    "C_Y": "wind coefficient abeam",
    "C_N": "wind coefficient in yaw",
    "C_NY": "moment of the wind coefficient abeam",
    "Y_phi": "sway force from heel",
    "N_phi": "yaw moment from heel",
    "Y_vdot - X_udot": "added mass, sway less surge",
    "a_H": "hull's share of the rudder's force",
    "x_H": "where that share acts",
    "gamma_R": "straightening of the rudder's inflow",
    "cd": "cross-flow drag coefficient",
    **{f"{force}_{way}": f"{what} of a propeller {way}, in thrusts"
       for force, what in (("Y", "side force"), ("N", "moment")) for way in ("ahead", "astern")},
}  # fmt: skip
PERCENT_SCALES = {"%": 100.0, "%/deg": math.radians(100.0)}
EARLIER = "before these recordings"  # when something changed, since those of reference
_LATE = "sensor-latency"  # the name of the catalogue


def as_words(name: str) -> str:
    """A catalogue name as words: `thrust-lag` is `thrust lag`."""
    return name.replace("-", " ")


def enumeration(items: list[str], last: str = "and") -> str:
    """`a, b and c`."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def capital(text: str) -> str:
    """The text beginning with a capital letter."""
    return text[:1].upper() + text[1:]


def count_recordings(number: int) -> str:
    """How many recordings, in words: `1 recording`, `3 recordings`."""
    return "1 recording" if number == 1 else f"{number} recordings"


class PhrasedParameter:
    """A parameter of an effect, formatted as the braces of the effect's phrase ask for it.

    `{speed}` is the value in people's units, `{time:size}` its absolute value, `{ratio:%}` that
    in percent, `{slope:%/deg}` in percent per degree, `{angle:starboard|port}` a word for its sign.
    """

    def __init__(self, entry: Record):
        """
        Arguments:
            entry: `value`, `std` and `unit` of the parameter, in SI units.
        """
        self.value, self.std, self.unit = entry["value"], entry.get("std"), entry.get("unit", "")
        self.is_earlier = "before_recordings" in entry

    def __format__(self, form: str) -> str:
        if self.is_earlier:
            return EARLIER
        if not form:
            return round_to_error(self.value, self.std, self.unit)
        if "|" in form:
            positive, other = form.split("|")
            return positive if self.value is not None and self.value > 0 else other
        if not is_known(self.value):
            return "an unknown amount"
        scale = PERCENT_SCALES.get(form, 1.0)
        std = self.std * scale if is_known(self.std) else None
        unit = "%" if form in PERCENT_SCALES else self.unit
        return round_to_error(abs(self.value) * scale, std, unit)


def catalogue_entry(effect: Record) -> Effect | None:
    """The effect's entry of the catalogue: of variants that with its channels (degrees of
    freedom) or parameters.

    Of those with the same parameters one that acts on some actuators, where it does.
    """
    name = effect["name"]
    some = {*effect.get("channels", ()), *effect.get("degrees_of_freedom", ())}
    variants = [one for one in EFFECTS.values() if name in (one.name, catalogue_name(one.name))]
    alike = [
        one
        for one in variants
        if isinstance(one.place, MeasuredChannels | DegreesOfFreedom)
        and set(one.place.names) == some
    ]
    told = [one for one in variants if set(one.units) == set(effect["parameters"])]
    on_some = bool(effect.get("actuators"))
    placed = [one for one in told if isinstance(one.place, OrderedChannels) == on_some]
    return (alike or placed or told or variants or [None])[0]


def phrase(effect: Record) -> str:
    """An effect and its size as a phrase: `a steady current of 0.30 m/s flowing to 69 deg`."""
    entry = catalogue_entry(effect)
    parts: dict[str, object] = {k: PhrasedParameter(e) for k, e in effect["parameters"].items()}
    parts["actuators"] = f"the {enumeration(_actuator_words(effect.get('actuators', ())))}"
    parts["channels"] = enumeration(in_words(effect.get("channels", ())) or ["signal"])
    try:
        text = entry.phrase.format(**parts) if entry and entry.phrase else ""
    except KeyError:  # a record without a parameter that the phrase names
        text = ""
    return text or f"the effect {as_words(effect['name'])!r}"


def acted_on(effect: Record) -> str:
    """What an effect acts on, where it has a choice: ` of heading, yaw rate`."""
    names = in_words(effect.get("channels") or ())
    names += [*(effect.get("actuators") or ()), *(effect.get("degrees_of_freedom") or ())]
    return f" of {', '.join(names)}" if names else ""


def _actuator_words(names: Sequence[str]) -> list[str]:
    """Actuators in a phrase; those that have but the name of a side or a place need a noun."""

    def word(name: str) -> str:
        thruster, _, part = name.partition(".")
        of_azimuths = {"force": f"{thruster} thruster", "angle": f"{thruster} thruster's angle"}
        if part in of_azimuths:
            return of_azimuths[part]
        return f"{name} actuator" if name in SIDES else name

    return [word(name) for name in names] or ["actuators"]


def phrases(effects: list[Record], with_rivals: bool = False) -> list[str]:
    """What was found, a phrase each; several delays of sensors are one.

    With those `with_rivals` that would explain the same, in brackets.
    """
    late = [one for one in effects if one["name"] == _LATE and "recording" not in one]
    together = late if len(late) > 1 else []
    told = [(_late_together(together), together)] if together else []
    others = [one for one in effects if one not in together]
    told += [(_group_phrase(group).rstrip(","), group) for group in effect_groups(others)]
    if not with_rivals:
        return [text for text, _ in told]
    return [text + _or_else(of) for text, of in told]


def _or_else(effects: list[Record]) -> str:
    """What would explain the same as effects that were found, in brackets; empty for nothing."""
    names = dict.fromkeys(name for one in effects for name in one.get("alternatives", []))
    rivals = enumeration([as_words(name) for name in names], "or") if names else ""
    return f" (or else {rivals}: these recordings cannot tell which)" if rivals else ""


def _late_together(late: list[Record]) -> str:
    """Several sensors that are late: each by itself, for what is ahead of one lags another."""
    delays = [PhrasedParameter(one["parameters"]["delay"]) for one in late]
    channels = [enumeration(in_words(one["channels"])) for one in late]
    parts = [f"{names} by {delay}" for names, delay in zip(channels, delays, strict=True)]
    return f"late measurements ({'; '.join(parts)})"


def _group_phrase(group: list[Record]) -> str:
    """One effect as a phrase, or one that has its own size in each recording."""
    if len(group) == 1:
        return phrase(group[0])
    text = f"a {as_words(group[0]['name'])} of its own in each recording"
    if group[0]["parameters"]:
        first, entry = next(iter(group[0]["parameters"].items()))
        sizes = [effect["parameters"].get(first, {}).get("value") for effect in group]
        values, unit = [float(size or 0.0) for size in sizes], entry.get("unit", "")
        low, high = (round_to_error(end(values), None, unit) for end in (min, max))
        text += f" ({first} {low} to {high})"
    return text


def named_effects(summary: Record) -> list[Record]:
    """The effects that have a name."""
    return [effect for effect in summary["effects"] if effect["name"] != "unexplained"]


def effect_groups(effects: list[Record]) -> list[list[Record]]:
    """Effects with the records of one that has its own size in each recording together."""
    groups: dict[object, list[Record]] = {}
    for number, effect in enumerate(effects):
        key = effect["name"] if "recording" in effect else number
        groups.setdefault(key, []).append(effect)
    return list(groups.values())


def parameter_words(name: str) -> str:
    """A parameter of an effect: symbols with their meaning, `Y_ur (sway force from u r)`."""
    meaning = SYMBOLS.get(name) or parameter_meaning(name)
    words = name.replace("_", " ")
    return words if meaning == words else f"{name} ({meaning})"


def parameter_lines(effect: Record) -> list[str]:
    """`speed 0.301 +- 0.004 m/s` for each parameter of an effect.

    One of which data only say that it is no smaller reads `rate limit above 90 N/s, if any`.
    """
    lines = []
    for name, entry in effect["parameters"].items():
        text = with_error(entry["value"], entry.get("std"), entry.get("unit", ""))
        if "beyond" in entry:
            text = f"above {round_to_error(entry['beyond'], None, entry['unit'])}, if any"
        if "before_recordings" in entry:
            text = EARLIER
        text += f" ({within})" if (within := within_recording(entry)) else ""
        lines.append(f"{parameter_words(name)} {text}{direction_note(effect, name)}")
    return lines


def within_recording(entry: Record) -> str:
    """`70.1 s into run3.csv`, of a time that lies in one recording; nothing of all else."""
    if "since_start" not in entry:
        return ""
    since = round_to_error(entry["since_start"], entry.get("std"), "s")
    return f"{since} into {entry['recording']}"


def effect_lines(name: str, runs: Sequence[Record], log10_odds: float | None = None) -> list[str]:
    """A fitted effect in a line, or in one line for each recording.

    Arguments:
        name: in the registry, `rate-limit:propulsion`.
        runs: parameters by name, each with `value`, `std` and `unit`, for each recording.
        log10_odds: decimal logarithm of its odds against none, where it is known.
    """
    sure = "" if log10_odds is None else f"; odds against none {odds(log10_odds)}"
    lines = []
    for number, parameters in enumerate(runs, start=1):
        sizes = ", ".join(parameter_lines({"name": name, "parameters": parameters}))
        where = f", recording {number}" if len(runs) > 1 else ""
        lines.append(f"{as_words(name).replace(':', ', ')}{where}: {sizes}{sure}")
    return lines


def together_note(effect: Record) -> str:
    """That several parameters are needed, but only together, where no size stands by itself."""
    entries = effect["parameters"].values()
    sizes = [(one["value"], one.get("std")) for one in entries if "beyond" not in one]
    open_ones = [is_known(v) and is_known(s) and abs(v) < 2 * s for v, s in sizes]
    return (
        " (needed together, none determined by itself)" if len(sizes) > 1 and all(open_ones) else ""
    )


def direction_note(effect: Record, parameter: str) -> str:
    """Whether a direction is where something flows to or comes from."""
    entry = catalogue_entry(effect)
    form = None if entry is None else entry.parametrisation
    note = "" if form is None else form.notes.get(parameter, "")
    return f" ({note})" if note else ""
