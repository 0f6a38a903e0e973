"""What the name of a column suggests: words of the field, abbreviations, units.

A name is cut into words at punctuation, digits and capitals; so are the topics and fields
of robot logs (`odom:pose.x`). Each entry of the vocabulary is some words and the labels that
they stand for, with weights; the longest entry that a name contains decides.
"""

import dataclasses
import re

from diffsea.recordings.mapping_proposal.vocabulary import (
    FRAMES,
    LABELS,
    ORDERS,
    REALISED,
    SPOILERS,
    UNIT_TAILS,
    UNIT_WORDS,
    VOCABULARY,
)
from diffsea.recordings.vocabulary import UNITS


# Weights are prior probabilities, set on the names of published data sets.
_SINGLE_LETTER = 0.3  # what a letter's weight is lessened by beside words: it is often an index
_UNSUGGESTED = 0.003  # the weight of a label that a name of known words does not suggest
_UNINFORMATIVE = 0.035  # the weight of every label for a name that says nothing
_WRONG_DIMENSION = 0.03  # factor on a label's weight where the unit is of another dimension


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
    bare = re.sub(r"[\[(<{].*?[\])>}]", " ", name)  # without what stands in brackets
    bare = re.sub(r"([a-z])([A-Z])", r"\1 \2", bare)
    words = tuple(word.lower() for word in re.split(r"[^A-Za-zµ°äöüß]+", bare) if word)
    unit = known_unit(stated_unit or unit_in(name)) or _unit_tail(words)
    entry = _vocabulary_entry(words)
    turns_or_drives = {"rudder", "propeller", "port", "starboard"} & set(entry or ())
    spoilers = SPOILERS - ORDERS if turns_or_drives else SPOILERS
    differentiated = "dot" in words and not VOCABULARY.get(" ".join(words[:2]))
    if entry is None:
        weights = dict.fromkeys(LABELS, _UNINFORMATIVE)
    elif spoilers & set(words) or differentiated:
        weights = dict.fromkeys(LABELS, _UNSUGGESTED)
    else:
        weights = dict.fromkeys(LABELS, _UNSUGGESTED) | entry
    weights["other"] += max(0.0, 1.0 - sum(weights.values()))
    ordered = True if ORDERS & set(words) else False if REALISED & set(words) else None
    frame = next((frame for word, frame in FRAMES.items() if word in words), "")
    return Suggestion(name, words, _given_unit(weights, unit), unit, frame, ordered)


def unit_in(name: str) -> str:
    """What stands in the last brackets of a header cell, such as `deg/s`."""
    found = re.findall(r"[\[(<{]\s*([^\])>}]*?)\s*[\])>}]", name)
    return found[-1] if found else ""


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
        if len(words) > length and tail in UNIT_TAILS:
            return UNIT_TAILS[tail]
    return ""


def _vocabulary_entry(words: tuple[str, ...]) -> dict[str, float] | None:
    """The vocabulary's entry for a name: of the most words, then the plainest, then the last."""
    for length in (4, 3, 2, 1):
        found = []
        for start in range(len(words) - length, -1, -1):
            entry = VOCABULARY.get(" ".join(words[start : start + length]))
            is_unit = length == 1 < len(words) == start + 1 and words[start] in UNIT_TAILS
            if entry is not None and not is_unit:
                letter = _SINGLE_LETTER if length == 1 and len(words[start]) == 1 else 0.0
                found.append((max(entry.values()) - letter, entry))
        if found:
            return max(found, key=lambda item: item[0])[1]
    return None


def _given_unit(weights: dict[str, float], unit: str) -> dict[str, float]:
    """The weights given the unit: labels of another dimension hardly count."""
    if not unit:
        return weights
    dimension = "?" if unit == "?" else UNITS[unit][0]
    scaled = {}
    for label, kind in LABELS.items():
        fits = kind in ("any", dimension) or (kind == "degrees" and unit == "deg")
        scaled[label] = weights[label] if fits else _WRONG_DIMENSION * weights[label]
    total = sum(scaled.values())
    return {label: weight / total for label, weight in scaled.items()}
