"""A vessel from above as text: hull, thrusters, propellers and rudders where they sit.

The bow is to the right and starboard below. Of the hull a vessel file has length and beam alone:
the outline is that of a box with a pointed bow.
"""

import math
from typing import TYPE_CHECKING, NamedTuple


if TYPE_CHECKING:
    from diffsea.vessel.base import Vessel


_WIDTH = 48  # characters that a length takes
_TALL = 2.0  # times as tall as wide is a character
_FOREBODY = 0.3  # of the length, over which the outline narrows to the bow
_SIGNS = {"AzimuthThruster": "O", "TunnelThruster": "T", "Propeller": "P"}
_PUSHES = (">", "v", "<", "^")  # of a fixed thruster: ahead, to starboard, astern, to port
_LEAST_ROWS = 3


class _Part(NamedTuple):
    """An actuator: its sign, name and place, m forward of amidships and to starboard."""

    sign: str
    name: str
    kind: str
    x: float
    y: float
    is_placed: bool  # whether the file says where it sits


def outline(vessel: "Vessel") -> str:
    """The drawing, with what its signs are."""
    body, parts = vessel.rigid_body, _parts(vessel)
    length, beam = float(body.length), float(body.beam)
    scale = _WIDTH / length
    row = lambda y: round(y * scale / _TALL)
    column = lambda x: round((x + 0.5 * length) * scale)
    half = max(row(0.5 * beam), _LEAST_ROWS // 2)
    places = {part.name: (row(part.y), column(part.x)) for part in parts}
    tall = max([half, *(abs(r) for r, _ in places.values())])
    left = min([0, *(c for _, c in places.values())])
    right = max([_WIDTH, *(c for _, c in places.values())])
    cells = [[" "] * (right - left + 1) for _ in range(2 * tall + 1)]
    put = lambda r, c, sign: cells[r + tall].__setitem__(c - left, sign)
    for r, c, sign in _hull(half):
        put(r, c, sign)
    for part in parts:
        put(*places[part.name], part.sign)
    lines = ["".join(line).rstrip() for line in cells]
    sizes = f"{length:.4g} m long, {beam:.4g} m wide; bow to the right, starboard below"
    return "\n".join([f"{vessel.name}: {sizes}", *lines, *(_legend(part) for part in parts)])


def _hull(half: int) -> list[tuple[int, int, str]]:
    """Rows, columns and signs of the outline: straight sides, narrowing to a pointed bow."""
    shoulder = round((1 - _FOREBODY) * _WIDTH)
    drawn = [(row, 0, "|") for row in range(-half + 1, half)]
    for side in (-1, 1):
        drawn += [(side * half, column, "-") for column in range(1, shoulder)]
        drawn.append((side * half, 0, "+"))
        last = half
        for column in range(shoulder, _WIDTH + 1):
            along = (column - shoulder) / (_WIDTH - shoulder)
            row = round(half * math.sqrt(max(1 - along, 0.0)))
            slope = "\\" if side < 0 else "/"
            drawn += [(side * r, column, slope) for r in range(row, max(last, row + 1))]
            last = row
    return [*drawn, (0, _WIDTH, ">")]


def _parts(vessel: "Vessel") -> list[_Part]:
    """The actuators; one without a place is drawn amidships of the stern."""
    stern = -0.5 * float(vessel.rigid_body.length)
    found = []
    for name, part in vessel.actuators.items():
        kind = type(part).__name__
        words = "".join(f" {c.lower()}" if c.isupper() else c for c in kind).strip()
        x = getattr(part, "x", None)
        sign = _SIGNS.get(kind, "R" if "Rudder" in kind else "*")
        if kind == "FixedThruster":
            quarter = round(float(getattr(part, "angle", 0.0)) / (0.5 * math.pi)) % 4
            sign = _PUSHES[quarter]
        place = stern if x is None else float(x)
        found.append(_Part(sign, name, words, place, float(getattr(part, "y", 0.0)), x is not None))
    return found


def _legend(part: _Part) -> str:
    named = part.name if part.name == part.kind else f"{part.name}, {part.kind}"
    if not part.is_placed:
        return f"  {part.sign} {named}: its place is not in the file"
    way = "aft" if part.x < 0 else "forward"
    ahead = f"{abs(part.x):.3g} m {way} of amidships" if part.x else "amidships"
    side = f", {abs(part.y):.3g} m to {'port' if part.y < 0 else 'starboard'}" if part.y else ""
    return f"  {part.sign} {named}: {ahead}{side}"
