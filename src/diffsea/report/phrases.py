"""Effects and their sizes as phrases of plain words."""

from collections.abc import Callable

from diffsea.report.quantities import known, rounded


Record = dict

_TEMPLATES = {
    "current": "a steady current of {speed} flowing to {direction}",
    "wind": "a steady wind of {speed} from {direction}",
    "wave-force": "a wave force with mean {bias} and amplitude {amplitude} at {frequency}",
    "shallow-water": "shallow water, {depth} deep,",
    "hard-iron": "a compass error of {amplitude} that changes with heading",
    "lever-arm": "a sensor {x} forward and {y} to starboard of the reference point",
    "clock-drift": "clocks of motion and orders that are {offset} apart and drift by {rate}",
    "thrust-lag": "a lag with a time constant of {time_constant} in {actuators}",
    "thrust-delay": "a dead time of {delay} between order and action",
    "rate-limit": "a slew limit of {rate_limit} in {actuators}",
    "deadband": "a dead band of {width} in {actuators}",
    "backlash": "a play of {width} in {actuators}",
    "thrust-saturation": "thrust that clips at {limit}",
    "actuator-bias": "a neutral point of {actuators} that is off by {bias}",
    "propeller-side-force": "a side force of the propeller",
    "rudder-interaction": "an interaction of hull, propeller and rudder",
    "quadratic-damping": "a drag that grows with the square of speed",
    "crossflow-drag": "a cross-flow drag of the hull with coefficient {cd}",
    "sway-yaw-coupling": "a linear coupling of sway and yaw",
    "speed-dependent-damping": "a damping that grows with forward speed",
    "added-mass-coupling": "an added mass that couples sway and yaw",
    "munk-moment": "a Munk moment other than the model's",
    "roll-coupling": "a coupling of roll into sway and yaw",
}
_CHANNELS = {
    frozenset(("x", "y")): "position", frozenset(("psi",)): "heading",
    frozenset(("u", "v")): "velocity", frozenset(("r",)): "yaw rate",
}  # fmt: skip
_BUT_POSITION = frozenset(("psi", "u", "v", "r"))


def title(name: str) -> str:
    """A catalogue name as words: `thrust-lag` is `thrust lag`."""
    return name.replace("-", " ")


def listed(items: list[str], last: str = "and") -> str:
    """`a, b and c`."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def _value(effect: Record, parameter: str) -> float:
    return float(effect["parameters"].get(parameter, {}).get("value") or 0.0)


def _size(effect: Record, parameter: str, scale: float = 1.0, unit: str | None = None) -> str:
    """Absolute value of a parameter, rounded."""
    entry = effect["parameters"].get(parameter, {"value": None})
    if not known(entry["value"]):
        return "an unknown amount"
    std = entry.get("std")
    unit = entry.get("unit", "") if unit is None else unit
    return rounded(abs(entry["value"]) * scale, std * scale if known(std) else None, unit)


def _asymmetry(effect: Record) -> str:
    strong, weak = ("starboard", "port") if _value(effect, "ratio") > 0 else ("port", "starboard")
    share = _size(effect, "ratio", 100.0, "%")
    return f"thrust {share} stronger than stated on the {strong} side and weaker on the {weak} side"


def _misalignment(effect: Record) -> str:
    side = "starboard" if _value(effect, "angle") > 0 else "port"
    return f"a thrust line turned {_size(effect, 'angle')} to {side}"


def _reading(what: str, parameter: str) -> Callable[[Record], str]:
    def phrase(effect: Record) -> str:
        way = "high" if _value(effect, parameter) > 0 else "low"
        return f"{what} that reads {_size(effect, parameter)} too {way}"

    return phrase


def _loss(per: str, scale: float) -> Callable[[Record], str]:
    def phrase(effect: Record) -> str:
        way = "falls" if _value(effect, "slope") > 0 else "rises"
        return f"a thrust that {way} by {_size(effect, 'slope', 100 * scale, '%')} {per}"

    return phrase


def _change(what: str, parameter: str, scale: float, unit: str | None) -> Callable[[Record], str]:
    def phrase(effect: Record) -> str:
        way = "larger" if _value(effect, parameter) > 0 else "smaller"
        amount = _size(effect, parameter, scale, unit)
        return f"a {what} that is {amount} {way} from {_size(effect, 'time')} on"

    return phrase


def _latency(effect: Record) -> str:
    late = frozenset(effect.get("channels", ()))
    if late == _BUT_POSITION:
        return f"a measured position that is {_size(effect, 'delay')} ahead of all else measured"
    channels = _CHANNELS.get(late, "signal")
    return f"a measured {channels} that arrives {_size(effect, 'delay')} late"


_PHRASES: dict[str, Callable[[Record], str]] = {
    "thrust-asymmetry": _asymmetry,
    "thruster-misalignment": _misalignment,
    "heading-offset": _reading("a compass", "angle"),
    "thrust-change": _change("thrust", "factor", 100.0, "%"),
    "drag-change": _change("drag", "factor", 100.0, "%"),
    "mass-change": _change("mass", "mass", 1.0, None),
    "gyro-bias": _reading("a yaw-rate sensor", "bias"),
    "sensor-latency": _latency,
    "thrust-loss-with-speed": _loss("for every m/s of speed", 1.0),
    "thrust-loss-in-turns": _loss("for every deg/s of yaw rate", 0.017453292519943295),
}


def phrase(effect: Record) -> str:
    """An effect and its size as a phrase: `a steady current of 0.30 m/s flowing to 69 deg`."""
    name = effect["name"]
    if name in _PHRASES:
        return _PHRASES[name](effect)
    values = {
        key: rounded(entry["value"], entry.get("std"), entry.get("unit", ""))
        for key, entry in effect["parameters"].items()
    }
    values["actuators"] = f"the {listed(effect.get('actuators') or ['actuators'])}"
    try:
        return _TEMPLATES[name].format(**values)
    except KeyError:
        return f"the effect {title(name)!r}"


def group_phrase(group: list[Record]) -> str:
    """One effect as a phrase, or one that has its own size in each recording."""
    if len(group) == 1:
        return phrase(group[0])
    first, entry = next(iter(group[0]["parameters"].items()), (None, {}))
    if first is None:
        return f"a {title(group[0]['name'])} of its own in each recording"
    values = [_value(effect, first) for effect in group]
    low, high = (rounded(v, None, entry.get("unit", "")) for v in (min(values), max(values)))
    return f"a {title(group[0]['name'])} of its own in each recording ({first} {low} to {high})"
