"""Names and messages as a terminal or a page may show them: nothing in them acts.

Names of files, topics, channels and cells come from outside. Control characters move a cursor, set
a title or hide a line; marks of direction make text read otherwise than it is; half of a character
of two (a file name that is not UTF-8) cannot be written at all. All of them are shown by their
codes. JSON keeps them as what they are, written as escapes.
"""

import re


LONGEST_LINE = 4000  # letters; what is beyond is counted
_ACTING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # controls but tab and new line
    "\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"  # direction, invisible
    "\ud800-\udfff\U000e0000-\U000e0fff]"  # halves of characters, tags
)


def printable(text: object, longest: int = LONGEST_LINE) -> str:
    """The text with acting characters as their codes, such as `\\x1b`, and long lines cut."""
    lines = _ACTING.sub(_code, str(text)).split("\n")
    return "\n".join(
        line
        if len(line) <= longest
        else f"{line[:longest]} ... ({len(line) - longest} more letters)"
        for line in lines
    )


def escaped_json(text: str) -> str:
    """JSON text with acting characters in its strings as escapes: the same content."""
    return _ACTING.sub(_json_code, text)


def _code(found: re.Match[str]) -> str:
    code = ord(found[0])
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 2**16 else f"\\U{code:08x}"


def _json_code(found: re.Match[str]) -> str:
    code = ord(found[0])
    if code < 2**16:
        return f"\\u{code:04x}"
    code -= 2**16
    return f"\\u{0xD800 + (code >> 10):04x}\\u{0xDC00 + (code & 0x3FF):04x}"
