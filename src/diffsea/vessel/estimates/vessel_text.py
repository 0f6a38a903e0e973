"""The text of an estimated vessel's file: every number with what it rests on, and the priors."""

from collections.abc import Mapping, Sequence

import tomli_w

from diffsea.errors import UserError
from diffsea.vessel.estimates import added_mass, lateral, resistance
from diffsea.vessel.estimates.drives import Part
from diffsea.vessel.estimates.outline import CENTRE_OF_GRAVITY_WIDTH, Outline
from diffsea.vessel.estimates.scatter import COUPLINGS, DerivativeEstimate


SOURCE = (
    "estimated from its dimensions by `diffsea new`; none of the derivatives was measured: a "
    "starting point for a fit, whose prior widths stand under [prior]"
)


def vessel_text(
    name: str,
    outline: Outline,
    hull: Mapping[str, DerivativeEstimate],
    parts: Sequence[Part],
    antenna: tuple[float, float] | None = None,
) -> str:
    """A vessel file (TOML) of an outline, its derivatives and its actuators.

    Arguments:
        name: of the vessel.
        hull: derivatives and added masses by name.
        parts: the actuators, each under a name of its own.
        antenna: where it sits whose positions and velocities are recorded, m ahead of amidships
            and to starboard.

    Raises:
        UserError: an antenna outside the hull.
    """
    lines = ["format = 1", tomli_w.dumps({"name": name, "source": SOURCE})]
    lines += [f"# A {outline.form}. Taken where nothing was said:"] if outline.assumed else []
    lines += [f"#   {text}" for text in outline.assumed.values()]
    lines += ["", "[hull]", *_body_lines(outline), ""]
    lines += ["# Each derivative is the middle of these estimates:"]
    lines += [f"#   {short}: {source}" for short, source in _sources(hull).items()]
    lines += [_line(one.name, one.value, reason(one)) for one in hull.values()]
    for part in parts:
        lines += ["", f"[[{part.kind}]]", *_part_lines(part)]
    lines += [] if antenna is None else ["", "[[effect]]", *_antenna_lines(outline, *antenna)]
    lines += [
        "",
        "# What is known of these numbers before any recording, for `diffsea fit` and `diagnose`:",
        "# spread is relative, std is in the number's unit; value, lower, upper and free = false",
        "# may stand beside them, as in a file for --priors.",
        "[prior]",
    ]
    if "x_G" in outline.assumed:
        lines.append(_prior_line("x_G", {"std": CENTRE_OF_GRAVITY_WIDTH * outline.length}))
    for one in hull.values():
        width = {"std": one.std} if one.name in COUPLINGS else {"spread": one.spread}
        lines.append(_prior_line(one.name, width))
    for part in parts:
        for key, width in part.widths.items():
            lines.append(_prior_line(f"{part.table['name']}.{key}", {"spread": width}))
    return "\n".join(lines) + "\n"


def reason(one: DerivativeEstimate) -> str:
    """What a derivative rests on: its methods with what each gives, and what its width holds."""
    given = "; ".join(f"{source} {value:.3g}" for source, value in one.methods.items())
    return f"{given}; {one.note}" if one.note else given


def _sources(hull: Mapping[str, DerivativeEstimate]) -> dict[str, str]:
    """The sources that the methods of some derivatives name."""
    used = " ".join(method for one in hull.values() for method in one.methods)
    known = added_mass.SOURCES | resistance.SOURCES | lateral.SOURCES
    return {short: source for short, source in known.items() if short in used}


def _body_lines(outline: Outline) -> list[str]:
    said = lambda key: "assumed, see above" if key in outline.assumed else "as given"
    in_hulls = ", half the mass in the demihulls" if outline.spacing else ""
    rows = (
        ("water_density", outline.water_density, "kg/m^3"),
        ("length", outline.length, "m, as given"),
        ("beam", outline.beam, "m, over all, as given"),
        ("draught", outline.draught, f"m, {said('draught')}"),
        ("mass", outline.mass, f"kg, {said('mass')}"),
        ("x_G", outline.x_G, f"m ahead of amidships, {said('x_G')}"),
        ("I_z", outline.I_z, f"kg m^2, assumed: radius of gyration 0.25 L{in_hulls}"),
    )
    return [_line(*row) for row in rows]


def _antenna_lines(outline: Outline, x: float, y: float) -> list[str]:
    """The entry of the catalogue for an antenna off amidships."""
    if abs(x) > outline.length or abs(y) > outline.beam:
        raise UserError(
            f"the antenna at {x:g} m ahead of amidships and {y:g} m to starboard is not on a boat "
            f"of {outline.length:g} m by {outline.beam:g} m"
        )
    return [
        _line("name", "lever-arm", "of the antenna"),
        _line("x", x, "m ahead of amidships, as given"),
        _line("y", y, "m to starboard, as given"),
        _line("channels", ["x", "y", "u", "v"], "velocities are the antenna's own, too"),
    ]


def _part_lines(part: Part) -> list[str]:
    """The lines of an actuator's table, those of tables further in last."""
    lines, inner = [], []
    for key, value in part.table.items():
        if isinstance(value, dict):
            inner.append(f"[{part.kind}.{key}]")
            inner += [_line(k, x, part.reasons.get(f"{key}.{k}", "")) for k, x in value.items()]
        else:
            lines.append(_line(key, value, part.reasons.get(key, "")))
    return [*lines, *inner]


def _line(key: str, value: object, told: str) -> str:
    written = f"{key} = {_written(value)}"
    return f"{written:<23} # {told}" if told else written


def _prior_line(name: str, width: dict[str, float]) -> str:
    key = f'"{name}"' if "." in name else name
    ((kind, value),) = width.items()
    return f"{key} = {{ {kind} = {value:.3g} }}"


def _written(value: object) -> str:
    """A value as TOML has it, numbers with five digits."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(map(_written, value))}]"
    text = f"{value:.5g}"
    return text if any(mark in text for mark in ".e") else f"{text}.0"
