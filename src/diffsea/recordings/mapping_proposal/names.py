"""What the name of a column suggests: words of the field, abbreviations, units.

A name is cut into words at punctuation, digits and capitals; so are the topics and fields
of robot logs (`odom:pose.x`). Each entry of the vocabulary (`vocabulary.toml`) is some words and
the labels that they stand for, with weights; the longest entry that a name contains decides.
"""

import dataclasses
import importlib.resources
import re
import tomllib
from collections.abc import Sequence

from diffsea.recordings.mappings import UNITS


_TEXT = importlib.resources.files("diffsea.recordings.mapping_proposal") / "vocabulary.toml"
_TABLES = tomllib.loads(_TEXT.read_text(encoding="utf-8"))


def _meaning_of_words(table: str) -> dict[str, str]:
    """The key of a table of the vocabulary, by each of the words that have that meaning."""
    lists = ((meaning, words.split(", ")) for meaning, words in _TABLES[table].items())
    return {word: meaning for meaning, words in lists for word in words}


# The order of labels decides between those of equal weight.
_ORDER = (
    "t x y north east lat lon psi u v vx vy vn ve r phi p wind_speed wind_direction "
    "apparent_wind_speed apparent_wind_angle rudder propeller port starboard thrust other"
).split()
_DIMENSIONS = _meaning_of_words("labels")
LABELS = {label: _DIMENSIONS[label] for label in _ORDER}  # and the dimensions of their numbers
_VOCABULARY: dict[str, dict[str, float]] = {}  # labels and their weights, by words
for _words, _meaning in _meaning_of_words("words").items():
    _parts = _meaning.split()
    _VOCABULARY[_words] = dict(zip(_parts[::2], map(float, _parts[1::2]), strict=True))
UNIT_WORDS = _meaning_of_words("units")
_UNIT_TAILS = _meaning_of_words("unit_tails")
_FRAMES = _meaning_of_words("frames")
_SPOILERS, _ORDERS, _REALISED, _SPEEDS_OVER_GROUND, _COURSES_OVER_GROUND = (
    frozenset(_TABLES["kinds"][kind].split(", "))
    for kind in ("spoilers", "orders", "realised", "speed_over_ground", "course_over_ground")
)

_APPARENT = frozenset({"apparent", "relative"})  # what spoils any name but that of a wind
_ORDERED_BY_PULSES = ("rudder", "propeller", "thrust")
_ORDERED_BY_SHARES = ("propeller", "thrust")

_SINE = re.compile(r"(?:(?<![A-Za-z])sin|Sin|(?<![A-Z])SIN)(?:(e|E)(?![a-zA-Z])|(?![a-z]))")

# Weights are prior probabilities, set on the names of published data sets.
_SINGLE_LETTER = 0.3  # what a letter's weight is lessened by beside words: it is often an index
_UNSUGGESTED = 0.075 / len(LABELS)  # the weight of a label that known words do not suggest
_UNINFORMATIVE = 0.875 / len(LABELS)  # the weight of every label for a name that says nothing
_WRONG_DIMENSION = 0.03  # factor on a label's weight where the unit is of another dimension
NAMED = 0.5  # the weight of a label above which a name is believed


@dataclasses.dataclass(frozen=True)
class Suggestion:
    """What a name suggests.

    Attributes:
        words: the name's, in small letters.
        weights: of all `LABELS`, with sum one.
        unit: one of `UNITS`; empty where nothing is said, `"?"` where no mapping knows it.
        frame: `ned` or `enu` where the name has a word for it, else empty.
        ordered: true of an order, false of what was realised, None where the name does not say.
    """

    words: tuple[str, ...]
    weights: dict[str, float]
    unit: str = ""
    frame: str = ""
    ordered: bool | None = None

    @property
    def is_over_ground(self) -> bool:
        """Whether it is called course or speed over ground: neither heading nor surge velocity."""
        return self.is_speed_over_ground or self.is_course_over_ground

    @property
    def is_speed_over_ground(self) -> bool:
        """Whether it is called that; what is called both is its course."""
        return self._has_one_of(_SPEEDS_OVER_GROUND) and not self.is_course_over_ground

    @property
    def is_course_over_ground(self) -> bool:
        """Whether it is called that."""
        return self._has_one_of(_COURSES_OVER_GROUND)

    def _has_one_of(self, phrases: frozenset[str]) -> bool:
        name = f" {' '.join(self.words)} "
        return any(f" {phrase} " in name for phrase in phrases)

    @property
    def best(self) -> str:
        """The label of the greatest weight."""
        return max(self.weights, key=lambda label: self.weights[label])


def suggest_labels(name: str, stated_unit: str = "") -> Suggestion:
    """What a column's name, and what its header says of the unit, suggest.

    `name` may be a topic and field joined by `:`; the words nearest the end count first. A unit
    in brackets or at the end of the name counts where `stated_unit` is empty. Labels whose
    dimension is not that of the unit hardly count.
    """
    bare = re.sub(r"[\[(<{].*?[\])>}]", " ", name)  # without what stands in brackets
    bare = re.sub(r"([a-z])([A-Z])", r"\1 \2", bare)
    words = _words_of(bare)
    tails = [" ".join(words[-length:]) for length in (2, 1) if len(words) > length]
    tail = next((_UNIT_TAILS[tail] for tail in tails if tail in _UNIT_TAILS), "")
    unit = _known_unit(stated_unit or unit_in(name)) or tail
    entry = _vocabulary_entry(words)
    own = _vocabulary_entry(_words_of(bare.rpartition("/")[2]))
    if entry and own and "rudder" in entry and {"propeller", "thrust"} & set(own):
        entry = own  # a throttle among the topics of a helm
    if entry and tail == "ms" == unit and LABELS[max(entry, key=lambda of: entry[of])] == "speed":
        unit = "m/s"
    turns_or_drives = {"rudder", "propeller", "port", "starboard"} & set(entry or ())
    spoilers = _SPOILERS - _ORDERS if turns_or_drives else _SPOILERS
    if {"apparent_wind_speed", "apparent_wind_angle"} & set(entry or ()):
        spoilers = spoilers - _APPARENT
    differentiated = "dot" in words and not _VOCABULARY.get(" ".join(words[:2]))
    weights = dict.fromkeys(LABELS, _UNINFORMATIVE if entry is None else _UNSUGGESTED)
    if entry and not (spoilers & set(words) or differentiated):
        weights |= entry
    weights["other"] += max(0.0, 1.0 - sum(weights.values()))
    if unit:
        dimension = "?" if unit == "?" else UNITS[unit][0]
        fitting = {"any", dimension, *(("degrees",) if unit == "deg" else ())}
        for label, kind in LABELS.items():
            is_pulse = unit == "us" and label in _ORDERED_BY_PULSES
            is_share = dimension == "ratio" and label in _ORDERED_BY_SHARES
            if kind not in fitting and not is_pulse and not is_share:
                weights[label] = _WRONG_DIMENSION * weights[label]
        total = sum(weights.values())
        weights = {label: weight / total for label, weight in weights.items()}
    ordered = True if _ORDERS & set(words) else False if _REALISED & set(words) else None
    frame = next((frame for word, frame in _FRAMES.items() if word in words), "")
    return Suggestion(words, weights, unit, frame, ordered)


def named_exactly(label: str, weight: float, unit: str = "") -> Suggestion:
    """What is one quantity by its kind, with a weight, and by no words."""
    weights = dict.fromkeys(LABELS, _UNSUGGESTED) | {label: weight}
    weights["other"] += max(0.0, 1.0 - sum(weights.values()))
    return Suggestion((), weights, unit)


def headings_as_sines(names: Sequence[str]) -> dict[str, str]:
    """By columns that are called the sine of a heading, those called its cosine."""
    pairs = {name: _SINE.sub(_cosine_for, name) for name in names if suggest_sine(name) is not None}
    return {sine: cosine for sine, cosine in pairs.items() if cosine in names}


def suggest_sine(name: str) -> Suggestion | None:
    """What the angle is called that a column is the sine of; None where that is no heading."""
    found = suggest_labels(_SINE.sub("", name), "rad") if _SINE.search(name) else None
    return found if found is not None and found.weights["psi"] > NAMED else None


def _cosine_for(sine: re.Match[str]) -> str:
    """The word for a cosine, written as that for the sine."""
    whole = "cosine" if sine[1] else "cos"
    return whole.upper() if sine[0].isupper() else whole.title() if sine[0][0] == "S" else whole


def unit_in(name: str) -> str:
    """What stands in the last brackets of a header cell, such as `deg/s`; empty without any."""
    found = re.findall(r"[\[(<{]\s*([^\])>}]*?)\s*[\])>}]", name)
    return found[-1] if found else ""


def _words_of(text: str) -> tuple[str, ...]:
    """The words of a text, in small letters."""
    return tuple(word.lower() for word in re.split(r"[^A-Za-zµ°äöüß]+", text) if word)


def _known_unit(text: str) -> str:
    """A unit as mappings spell it, `"?"` for one that they do not know, `""` for none."""
    text = text.strip()
    if text == "-":  # said of numbers without a unit, and of units that nobody looked up
        return ""
    exact = {unit: unit for unit in UNITS} | {"Nm": "?", "NM": "nmi", "V": "?", "A": "?"}
    if text in exact:
        return exact[text]
    return UNIT_WORDS.get(re.sub(r"\s*/\s*", "/", text.lower()), "?" if text else "")


def _vocabulary_entry(words: tuple[str, ...]) -> dict[str, float] | None:
    """The vocabulary's entry for a name: of the most words, then the plainest, then the last."""
    for length in (4, 3, 2, 1):
        found = []
        for start in range(len(words) - length, -1, -1):
            entry = _VOCABULARY.get(" ".join(words[start : start + length]))
            is_unit = length == 1 < len(words) == start + 1 and words[start] in _UNIT_TAILS
            if entry is not None and not is_unit:
                letter = _SINGLE_LETTER if length == 1 and len(words[start]) == 1 else 0.0
                found.append((max(entry.values()) - letter, entry))
        if found:
            return max(found, key=lambda item: item[0])[1]
    return None
