"""The words of headers that stand for labels and units, from `vocabulary.toml`."""

import importlib.resources
import tomllib


_TEXT = importlib.resources.files("diffsea.recordings.mapping_proposal") / "vocabulary.toml"
_TABLES = tomllib.loads(_TEXT.read_text(encoding="utf-8"))


def _meaning_of_words(table: str) -> dict[str, str]:
    """The key of the table by each of the words that have that meaning."""
    lists = ((meaning, words.split(", ")) for meaning, words in _TABLES[table].items())
    return {word: meaning for meaning, words in lists for word in words}


def _label_weights(meaning: str) -> dict[str, float]:
    parts = meaning.split()
    return dict(zip(parts[::2], map(float, parts[1::2]), strict=True))


# The order of labels decides between those of equal weight.
_ORDER = (
    "t x y north east lat lon psi u v vx vy vn ve r phi p wind_speed wind_direction rudder "
    "propeller port starboard thrust other"
).split()
_DIMENSIONS = _meaning_of_words("labels")

LABELS = {label: _DIMENSIONS[label] for label in _ORDER}  # and the dimensions of their numbers
VOCABULARY = {words: _label_weights(m) for words, m in _meaning_of_words("words").items()}
UNIT_WORDS = _meaning_of_words("units")
UNIT_TAILS = _meaning_of_words("unit_tails")
FRAMES = _meaning_of_words("frames")
SPOILERS, ORDERS, REALISED = (
    frozenset(_TABLES["kinds"][kind].split(", ")) for kind in ("spoilers", "orders", "realised")
)
