"""What the name of a column suggests: words of the field, abbreviations, units.

A name is cut into words at punctuation, digits and capitals; so are the topics and fields
of robot logs (`odom:pose.x`). Each entry of the vocabulary is a set of words and the labels
that they stand for, with weights; the longest entry that a name contains decides. A label is
a role as people name it, which need not be a channel as it is: `x` is some horizontal
coordinate, `north` is the coordinate north.
"""

import dataclasses
import re

from diffsea.recordings.mapping_proposal.table_layout import UNIT_WORDS, unit_in
from diffsea.recordings.mappings import UNITS


# label -> the dimension of its numbers
LABELS = {
    "t": "time", "x": "length", "y": "length", "north": "length", "east": "length",
    "lat": "degrees", "lon": "degrees", "psi": "angle", "u": "speed", "v": "speed",
    "vx": "speed", "vy": "speed", "vn": "speed", "ve": "speed", "r": "angular rate",
    "phi": "angle", "p": "angular rate", "wind_speed": "speed", "wind_direction": "angle",
    "rudder": "angle", "propeller": "revolutions", "port": "", "starboard": "", "thrust": "force",
    "other": "",
}  # fmt: skip
KINEMATIC = ("t", "x", "y", "psi", "u", "v", "r")

# Words -> labels and weights. What is left of one is "other" and everything else.
_VOCABULARY: dict[str, dict[str, float]] = {
    "time": {"t": 0.95}, "timestamp": {"t": 0.95}, "zeit": {"t": 0.95}, "temps": {"t": 0.95},
    "tiempo": {"t": 0.95}, "tempo": {"t": 0.95}, "tid": {"t": 0.9}, "stamp": {"t": 0.9},
    "t": {"t": 0.95}, "secs": {"t": 0.8}, "seconds": {"t": 0.9}, "sec": {"t": 0.8},
    "sekunden": {"t": 0.9}, "clock": {"t": 0.7}, "epoch": {"t": 0.9}, "ts": {"t": 0.85},
    "utc": {"t": 0.8}, "date": {"other": 0.9}, "index": {"other": 0.95}, "id": {"other": 0.95},
    "x": {"x": 0.9, "north": 0.04}, "y": {"y": 0.9, "east": 0.04},
    "pos x": {"x": 0.95}, "pos y": {"y": 0.95}, "position x": {"x": 0.95},
    "position y": {"y": 0.95}, "x position": {"x": 0.95}, "y position": {"y": 0.95},
    "x ned": {"north": 0.97}, "y ned": {"east": 0.97}, "x enu": {"east": 0.97},
    "y enu": {"north": 0.97}, "north": {"north": 0.93}, "northing": {"north": 0.97},
    "east": {"east": 0.93}, "easting": {"east": 0.97}, "nord": {"north": 0.9},
    "ost": {"east": 0.9}, "est": {"east": 0.8}, "n pos": {"north": 0.95}, "e pos": {"east": 0.95},
    "pos n": {"north": 0.95}, "pos e": {"east": 0.95}, "hochwert": {"north": 0.95},
    "rechtswert": {"east": 0.95}, "e": {"east": 0.6}, "utm x": {"east": 0.95},
    "utm y": {"north": 0.95}, "xn": {"north": 0.8}, "ye": {"east": 0.8},
    "lat": {"lat": 0.97}, "latitude": {"lat": 0.97}, "lon": {"lon": 0.97}, "lng": {"lon": 0.97},
    "long": {"lon": 0.9}, "longitude": {"lon": 0.97}, "breite": {"lat": 0.6},
    "laenge": {"lon": 0.4},
    "psi": {"psi": 0.95}, "yaw": {"psi": 0.95}, "heading": {"psi": 0.95}, "hdg": {"psi": 0.95},
    "head": {"psi": 0.8}, "kurs": {"psi": 0.75}, "cap": {"psi": 0.8}, "rumbo": {"psi": 0.8},
    "compass": {"psi": 0.9}, "theta": {"psi": 0.5}, "gyro heading": {"psi": 0.95},
    "cog": {"psi": 0.03, "other": 0.9}, "course": {"psi": 0.3, "other": 0.6},
    "steuerkurs": {"psi": 0.95}, "angle yaw": {"psi": 0.95}, "orientation": {"psi": 0.5},
    "r": {"r": 0.93}, "yaw rate": {"r": 0.97}, "yawrate": {"r": 0.97}, "rot": {"r": 0.93},
    "rate of turn": {"r": 0.97}, "turn rate": {"r": 0.95}, "heading rate": {"r": 0.95},
    "psi dot": {"r": 0.95}, "psidot": {"r": 0.95}, "yaw dot": {"r": 0.95}, "gyro z": {"r": 0.9},
    "gyr z": {"r": 0.9}, "wz": {"r": 0.85}, "omega z": {"r": 0.9}, "angular velocity": {"r": 0.7},
    "angular velocity z": {"r": 0.97}, "angvel": {"r": 0.7}, "r angvelo": {"r": 0.97},
    "drehrate": {"r": 0.95}, "gierrate": {"r": 0.97}, "yaw vel": {"r": 0.9},
    "yaw velocity": {"r": 0.95}, "yawspeed": {"r": 0.95}, "dpsi": {"r": 0.9},
    "u": {"u": 0.93}, "surge": {"u": 0.95}, "v": {"v": 0.9}, "vm": {"v": 0.9},
    "sway": {"v": 0.95}, "u velo": {"u": 0.95}, "vm velo": {"v": 0.95}, "v velo": {"v": 0.95},
    "forward speed": {"u": 0.9}, "lateral speed": {"v": 0.9}, "lateral velocity": {"v": 0.9},
    "longitudinal speed": {"u": 0.9}, "longitudinal velocity": {"u": 0.9},
    "transverse speed": {"v": 0.9}, "transverse velocity": {"v": 0.9},
    "vx": {"vx": 0.95}, "vy": {"vy": 0.95}, "v x": {"vx": 0.95}, "v y": {"vy": 0.95},
    "vel x": {"vx": 0.95}, "vel y": {"vy": 0.95}, "velocity x": {"vx": 0.95},
    "velocity y": {"vy": 0.95}, "x velocity": {"vx": 0.95}, "y velocity": {"vy": 0.95},
    "x vel": {"vx": 0.95}, "y vel": {"vy": 0.95}, "linear x": {"vx": 0.8},
    "linear y": {"vy": 0.8}, "x dot": {"vx": 0.9}, "y dot": {"vy": 0.9},
    "v n": {"vn": 0.95}, "v e": {"ve": 0.95}, "vn": {"vn": 0.95}, "ve": {"ve": 0.95},
    "vel n": {"vn": 0.95}, "vel e": {"ve": 0.95}, "v north": {"vn": 0.97},
    "v east": {"ve": 0.97}, "vel north": {"vn": 0.97}, "vel east": {"ve": 0.97},
    "north velocity": {"vn": 0.97}, "east velocity": {"ve": 0.97}, "velocity north": {"vn": 0.97},
    "velocity east": {"ve": 0.97}, "velocity n": {"vn": 0.95}, "velocity e": {"ve": 0.95},
    "north speed": {"vn": 0.97}, "east speed": {"ve": 0.97}, "speed north": {"vn": 0.97},
    "speed east": {"ve": 0.97}, "sog": {"u": 0.1, "other": 0.85},
    "speed": {"u": 0.5, "other": 0.3},
    "speed over ground": {"u": 0.1, "other": 0.85}, "geschwindigkeit": {"u": 0.5, "other": 0.3},
    "vitesse": {"u": 0.5, "other": 0.4}, "velocity": {"u": 0.3, "other": 0.4},
    "phi": {"phi": 0.9}, "roll": {"phi": 0.93}, "p": {"p": 0.85}, "roll rate": {"p": 0.95},
    "phi dot": {"p": 0.9}, "roulis": {"phi": 0.9}, "gyro x": {"p": 0.8},
    "pitch": {"other": 0.97}, "q": {"other": 0.9}, "pitch rate": {"other": 0.97},
    "wind speed": {"wind_speed": 0.9}, "wind velocity": {"wind_speed": 0.9},
    "true wind speed": {"wind_speed": 0.97}, "tws": {"wind_speed": 0.95},
    "wind direction": {"wind_direction": 0.9}, "wind dir": {"wind_direction": 0.9},
    "true wind direction": {"wind_direction": 0.97}, "twd": {"wind_direction": 0.95},
    "wind angle": {"wind_direction": 0.3, "other": 0.6}, "windspeed": {"wind_speed": 0.9},
    "wind velo": {"wind_speed": 0.9},
    "winddirection": {"wind_direction": 0.9}, "apparent wind": {"other": 0.97},
    "apparent wind speed": {"other": 0.97}, "apparent wind direction": {"other": 0.97},
    "relative wind speed": {"other": 0.97}, "relative wind direction": {"other": 0.97},
    "rudder": {"rudder": 0.95}, "delta": {"rudder": 0.9}, "helm": {"rudder": 0.93},
    "ruder": {"rudder": 0.95}, "ruderwinkel": {"rudder": 0.95}, "barre": {"rudder": 0.9},
    "timon": {"rudder": 0.95}, "timone": {"rudder": 0.95}, "ror": {"rudder": 0.9},
    "rudder angle": {"rudder": 0.96}, "steering": {"rudder": 0.85}, "steer": {"rudder": 0.85},
    "n": {"propeller": 0.7, "north": 0.2}, "rpm": {"propeller": 0.9}, "rps": {"propeller": 0.9},
    "propeller": {"propeller": 0.95}, "prop": {"propeller": 0.95}, "n prop": {"propeller": 0.97},
    "drehzahl": {"propeller": 0.93}, "revs": {"propeller": 0.85}, "shaft": {"propeller": 0.85},
    "throttle": {"propeller": 0.7, "thrust": 0.2}, "engine": {"propeller": 0.8},
    "thrust": {"thrust": 0.8}, "motor": {"propeller": 0.6},
    "thr left": {"port": 0.95}, "thr right": {"starboard": 0.95}, "left": {"port": 0.85},
    "right": {"starboard": 0.85}, "port": {"port": 0.9}, "starboard": {"starboard": 0.93},
    "stbd": {"starboard": 0.93}, "backbord": {"port": 0.93}, "steuerbord": {"starboard": 0.93},
    "babord": {"port": 0.93}, "tribord": {"starboard": 0.93}, "bb": {"port": 0.7},
    "sb": {"starboard": 0.7}, "stb": {"starboard": 0.85}, "left force": {"port": 0.95},
    "right force": {"starboard": 0.95}, "left thrust": {"port": 0.95},
    "right thrust": {"starboard": 0.95}, "thruster l": {"port": 0.9},
    "thruster r": {"starboard": 0.9}, "torque": {"other": 0.95}, "alt": {"other": 0.97},
    "altitude": {"other": 0.97}, "z": {"other": 0.97}, "depth": {"other": 0.97},
    "down": {"other": 0.97}, "w": {"other": 0.9}, "heave": {"other": 0.97},
    "temperature": {"other": 0.97}, "voltage": {"other": 0.97}, "battery": {"other": 0.97},
    "current": {"other": 0.95}, "power": {"other": 0.95},
}  # fmt: skip
# Words that make of a quantity another one, not wanted: derivatives, errors, references.
_SPOILERS = {
    "acc", "accel", "acceleration", "bias", "std", "var", "variance", "cov", "error", "err",
    "ref", "reference", "desired", "target", "setpoint", "zero", "status", "flag", "quality",
    "ddot", "sigma", "limit", "apparent", "relative", "jerk", "seq",
}  # fmt: skip
_ORDERS = {
    "cmd", "command", "commanded", "order", "ordered", "setpoint", "ref", "reference", "desired",
    "demand", "soll", "target", "pwm", "consigne",
}  # fmt: skip
_REALISED = {
    "act", "actual", "exec", "executed", "measured", "meas", "feedback", "fb", "ist", "real",
    "realised", "realized", "response", "state",
}  # fmt: skip
_UNIT_TAILS = {
    "deg": "deg", "rad": "rad", "ms": "ms", "us": "us", "ns": "ns", "kn": "kn", "kts": "kn",
    "knots": "kn", "mps": "m/s", "rpm": "rpm", "rps": "rps", "dps": "deg/s", "radps": "rad/s",
    "degps": "deg/s", "degs": "deg/s", "rads": "rad/s", "km": "km", "mm": "mm", "cm": "cm",
    "ft": "ft", "sec": "s", "s": "s", "m": "m", "kmh": "km/h", "pct": "%", "degrees": "deg",
    "radians": "rad", "hz": "Hz", "deg s": "deg/s", "rad s": "rad/s", "m s": "m/s",
    "deg min": "deg/min", "degpm": "deg/min", "km h": "km/h", "kt": "kn",
}  # fmt: skip
# What these words add to the odds of a right-handed frame with z up.
_FRAMES = {"enu": "enu", "ned": "ned", "odom": "enu", "ros": "enu", "utm": "enu", "rep": "enu"}
_LETTER = 0.3  # what a single letter's weight is lessened by beside words
_RARE = 0.003  # the weight of a label that a name does not suggest
_ANY = 0.035  # the same, of a name that says nothing


@dataclasses.dataclass(frozen=True)
class Suggestion:
    """What a name suggests.

    `weights` of all `LABELS` add up to one. `unit` is one of `UNITS`, `""` where nothing is
    said and `"?"` where it is one that no mapping knows. `ordered` is true of an order, false
    of what was realised, None where the name does not say.
    """

    name: str
    words: tuple[str, ...]
    weights: dict[str, float]
    unit: str = ""
    frame: str = ""
    ordered: bool | None = None

    @property
    def best(self) -> str:
        """The label of the greatest weight."""
        return max(self.weights, key=lambda label: self.weights[label])


def suggest_labels(name: str, stated_unit: str = "") -> Suggestion:
    """What a column's name, and what its header says of the unit, suggest.

    `name` may be a topic and field joined by `:`; the words nearest the end count first.
    """
    words = words_of(name)
    unit = known_unit(stated_unit or unit_in(name)) or _unit_tail(words)
    entry = _entry(words)
    spoilers = _SPOILERS - _ORDERS if _is_actuator(entry) else _SPOILERS
    differentiated = "dot" in words and not _VOCABULARY.get(" ".join(words[:2]))
    weights = _weights(entry, bool(spoilers & set(words)) or differentiated)
    weights = _fitting(weights, unit)
    ordered = True if _ORDERS & set(words) else False if _REALISED & set(words) else None
    frame = next((frame for word, frame in _FRAMES.items() if word in words), "")
    return Suggestion(name, words, weights, unit, frame, ordered)


def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in lower case, without what stands in brackets."""
    bare = re.sub(r"[\[(<{].*?[\])>}]", " ", name)
    bare = re.sub(r"([a-z])([A-Z])", r"\1 \2", bare)
    return tuple(word.lower() for word in re.split(r"[^A-Za-zµ°äöüß]+", bare) if word)


def known_unit(text: str) -> str:
    """A unit as mappings spell it, `"?"` for one that they do not know, `""` for none."""
    text = text.strip()
    if text == "-":  # said of numbers without a unit, and of units that nobody looked up
        return ""
    exact = {"Nm": "?", "N m": "?", "N·m": "?", "kN": "kN", "NM": "nmi", "V": "?", "A": "?"}
    if text in exact:
        return exact[text]
    if text in UNITS:
        return text
    return UNIT_WORDS.get(re.sub(r"\s*/\s*", "/", text.lower()), "?" if text else "")


def _unit_tail(words: tuple[str, ...]) -> str:
    for length in (2, 1):
        tail = " ".join(words[-length:])
        if len(words) > length and tail in _UNIT_TAILS:
            return _UNIT_TAILS[tail]
    return ""


def _entry(words: tuple[str, ...]) -> dict[str, float] | None:
    """The vocabulary's entry for a name: of the most words, then the plainest, then the last."""
    for length in (4, 3, 2, 1):
        found = []
        for start in range(len(words) - length, -1, -1):
            entry = _VOCABULARY.get(" ".join(words[start : start + length]))
            unit = length == 1 < len(words) == start + 1 and words[start] in _UNIT_TAILS
            if entry is not None and not unit:
                # A letter beside a word is more often an index or an abbreviated quantity.
                letter = _LETTER if length == 1 and len(words[start]) == 1 else 0.0
                found.append((max(entry.values()) - letter, entry))
        if found:
            return max(found, key=lambda item: item[0])[1]
    return None


def _is_actuator(entry: dict[str, float] | None) -> bool:
    return entry is not None and bool({"rudder", "propeller", "port", "starboard"} & set(entry))


def _weights(entry: dict[str, float] | None, spoiled: bool) -> dict[str, float]:
    if entry is None:
        weights = dict.fromkeys(LABELS, _ANY)
    elif spoiled:
        weights = dict.fromkeys(LABELS, _RARE)
    else:
        weights = dict.fromkeys(LABELS, _RARE) | entry
    weights["other"] += max(0.0, 1.0 - sum(weights.values()))
    return weights


def _fitting(weights: dict[str, float], unit: str) -> dict[str, float]:
    """The weights given the unit: labels of another dimension hardly count."""
    if not unit:
        return weights
    dimension = "?" if unit == "?" else UNITS[unit][0]
    fits = {
        label: not kind or kind == dimension or (kind == "degrees" and unit == "deg")
        for label, kind in LABELS.items()
    }
    scaled = {label: w if fits[label] else 0.03 * w for label, w in weights.items()}
    total = sum(scaled.values())
    return {label: w / total for label, w in scaled.items()}
