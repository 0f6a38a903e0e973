"""Hostile files: 1 to 8 structural changes of a valid one, drawn by Hypothesis."""

import struct

from hypothesis import strategies as st
from tests.fuzz.seeds import TEXTS, seed


CELLS = (
    "nan", "inf", "-inf", "1e400", "-1e308", "5e-324", "4e492493924924", "9" * 5000, "true",
    "1979-05-27T07:32:00Z", "12:00:00", "", '""', '"', "'", "\x00", "\x1b]0;x\x07", "\u202e", "é",
    "[" * 5000, "{" * 50, "[[[1]]]", "{ a = 1 }", "0x" + "f" * 40, "-0.0", "1_000", "1e9", "-1",
    "0", "1000000000", '"text"', '"((["', "a" * 100_000, "\ufeff", "[1, nan]", "null", "[]",
    '"\\u001b[31m"', '"X_u"', "1.5", "3", '"$x_{$"', "{}", "0.3 0.4", "99999999999999999999",
)  # fmt: skip
_LENGTHS = (0, 1, 2, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x0FFFFFFF)
_FLOATS = (float("nan"), float("inf"), -float("inf"), 5e-324, 1e308, -1.0)

_share = st.floats(0, 1, exclude_max=True)
_change = st.tuples(st.integers(0, 11), _share, _share, st.integers(0, 10_000))
# Every other file has one or two: a reader goes far into it before it stops, if it does.
_changes = st.one_of(*(st.lists(_change, min_size=1, max_size=most) for most in (1, 2, 8, 8)))


def hostile(kind):
    """Bytes of hostile files of a kind."""
    is_text = kind in TEXTS or kind in ("csv", "tlogcsv", "fit")
    change = _changed_text if is_text else _changed_bytes
    structural = _changes.map(lambda own: _all(own, kind, change))
    by_bytes = _changes.map(lambda own: _all(own, kind, _changed_bytes))
    return st.one_of(structural, structural, by_bytes, st.binary(max_size=400))


def _all(changes, kind, apply):
    content = seed(kind)
    for one in changes:
        content = apply(content, *one)[:4_000_000]
    return content


def _changed_bytes(content, what, place, extent, number):
    """Cut, doubled, swapped, removed, or a length, a float or a byte written over."""
    size = len(content)
    at = int(place * size)
    length = int(extent * min(size - at, 1 if what % 2 else size)) + 1
    part = content[at : at + length]
    if what == 0:
        return content[:at]
    if what == 1:
        return content[:at] + part * 2 + content[at + length :]
    if what == 2:
        other = int(extent * size)
        low, high = sorted((at, other))
        return content[:low] + content[high:] + content[low:high]
    if what == 3:
        return content[:at] + content[at + length :]
    if what in (4, 5, 6):
        value = struct.pack("<I" if what < 6 else ">I", _LENGTHS[number % len(_LENGTHS)])
        return content[:at] + value + content[at + 4 :]
    if what == 7:
        return content[:at] + struct.pack("<Q", number**4) + content[at + 8 :]
    if what == 8:
        at -= at % 8
        return content[:at] + struct.pack("<d", _FLOATS[number % 6]) + content[at + 8 :]
    if what == 9:
        return (b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")[number % 3] + content
    return content[:at] + bytes([number % 256]) + content[at + 1 :]


def _changed_text(content, what, place, extent, number):
    """The same of lines and cells; or columns by the thousand, names that are empty or repeated."""
    lines = content.decode("utf-8", errors="surrogateescape").split("\n")
    row, other = int(place * len(lines)), int(extent * len(lines))
    is_pair = lines[row].count(",") < 6 and any(sign in lines[row] for sign in "=:")
    separators = "=:" if is_pair else ","
    cells = _split(lines[row], separators)
    cell = int(extent * len(cells))
    hostile_cell = CELLS[number % len(CELLS)]
    if what == 0:
        lines = lines[:row]
    elif what == 1:
        lines.insert(other, lines[row])
    elif what == 2:
        lines[row], lines[other] = lines[other], lines[row]
    elif what == 3:
        del lines[row]
    elif what in (4, 5, 6, 7):
        cells[-1 if separators != "," else cell] = hostile_cell
        lines[row] = _joined(cells, separators)
    elif what == 8:
        cells[0] = hostile_cell
        lines[row] = _joined(cells, separators)
    elif what == 9:
        lines[0] = "\ufeff" + lines[0]
    elif what == 10:
        lines = [line + ("," + hostile_cell[:20]) * 10_000 for line in lines[:4]]
    else:
        lines[row] = lines[row][: int(extent * len(lines[row]))]
    return "\n".join(lines).encode("utf-8", errors="surrogateescape")


def _split(line, separators):
    for sign in separators:
        if sign in line:
            return line.split(sign, 1) if sign != "," else line.split(sign)
    return [line]


def _joined(cells, separators):
    return (" = " if "=" in separators and len(cells) == 2 else ",").join(cells)
