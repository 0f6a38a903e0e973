"""A MATLAB function in the conventions of the Marine Systems Simulator (MSS, Fossen).

`[xdot, U] = name(x, ui, V_c, beta_c)` as MSS's vessels have it: x = [u v r x y psi ...]' with the
actuators that take time behind, orders in `ui`, current speed and direction last. NED, SI units.
The function needs no toolbox, MSS's own included, and runs in GNU Octave.
"""

from collections.abc import Iterable
from typing import Any

from diffsea.errors import UserError
from diffsea.exports.equations import Channel, Equations, Term
from diffsea.exports.fmu import identifier
from diffsea.exports.matlab import SMALL, SUBFUNCTIONS


# s. A rudder that slews and has no lag has no derivative where it arrives; over this time it does.
ARRIVAL = 0.05


def mss_losses(equations: Equations) -> tuple[str, ...]:
    """What a function of this kind leaves out: also delays, since it knows of no past."""
    delays = (f"the delay of {c.name!r}" for c in equations.channels if c.delay)
    return (*equations.left_out, *delays)


def function_name(equations: Equations) -> str:
    """The function's name, also of its file: none of MSS's own."""
    return f"{identifier(equations.name)}_3dof"


def mss_function(equations: Equations) -> str:
    """The text of the function's file.

    Raises:
        UserError: two channels would have the same variable.
    """
    _check_names([c.name for c in equations.channels])
    name, lagging = function_name(equations), [c for c in equations.channels if not _direct(c)]
    lines = _head(name, equations, lagging)
    lines += _motion(equations)
    for number, channel in enumerate(equations.channels, start=1):
        lines += _executed(channel, number, lagging)
    lines += ["", "% Hull: Coriolis forces, then damping", "tau = zeros(3, 1);"]
    for polynomial in equations.polynomials:
        lines += _polynomial(polynomial.terms, polynomial.scaling)
    if equations.crossflow is not None:
        drag = equations.crossflow
        unit = -0.5 * drag["water_density"] * drag["draught"] * drag["cd"]
        lines.append(f"tau = tau + strips(v_r, r, {_number(drag['length'] / 2)}, {_number(unit)});")
    for part in sorted(equations.actuators, key=lambda part: part["kind"] == "rudder"):
        lines += ["", f"% {part['name']}", *_ACTUATORS[part["kind"]](part)]
    rates = [_servo_rate(channel) for channel in lagging]
    lines += [
        "",
        "nu_dot = M \\ tau + [r * v_c; -r * u_c; 0];",
        "xdot = [ nu_dot",
        "         cos(psi) * u - sin(psi) * v",
        "         sin(psi) * u + cos(psi) * v",
        "         r",
        *(f"         {rate}" for rate in rates),
        "       ];",
        "end",
    ]
    return "\n".join([*lines, *_used_subfunctions(lines)]) + "\n"


def _check_names(names: list[str]) -> None:
    """Raise `UserError` where two names become the same variable."""
    found: dict[str, str] = {}
    for name in names:
        other = found.setdefault(_variable(name), name)
        if other != name:
            raise UserError(
                f"the channels {other!r} and {name!r} would have the same name in MATLAB, "
                f"{_variable(name)}; rename one of their actuators"
            )


def _number(value: float) -> str:
    """A number as MATLAB reads it, to the last bit."""
    return repr(float(value)).replace("inf", "Inf")


def _variable(channel: str) -> str:
    """The variable of what a channel executes."""
    return f"a_{identifier(channel)}"


def _direct(channel: Channel) -> bool:
    """Whether a channel needs no state; delays are left out."""
    return not (channel.time_constant or channel.slowness)


def _head(name: str, equations: Equations, lagging: list[Channel]) -> list[str]:
    """The function's line, its help and checks of its inputs."""
    states = [f"{_variable(c.name)} {c.name}, executed ({c.unit})" for c in lagging]
    orders = [f"ui({k}) {c.name} ({c.unit})" for k, c in enumerate(equations.channels, start=1)]
    source = " ".join(equations.source.split())
    lines = [
        f"function [xdot, U] = {name}(x, ui, V_c, beta_c)",
        f"% [xdot, U] = {name}(x, ui, V_c, beta_c) returns the time derivative of the state",
        "% and the speed U (m/s) over ground of a vessel in surge, sway and yaw. State:",
        "%   u v r    velocities over ground in body axes (m/s, rad/s), r positive to starboard",
        "%   x y psi  north, east (m) and heading (rad), clockwise from north",
        *(f"%   {state}" for state in states),
        "% Orders:",
        *(f"%   {order}" for order in orders or ["none: ui = []"]),
        "% Current: V_c (m/s) flowing to beta_c (rad); without them that of the vessel's file.",
        "% Origin amidships; derivatives in SNAME signs.",
        f"% {equations.name}: {source}",
        "% Written by diffsea.",
        *(f"% LEFT OUT: {loss}." for loss in mss_losses(equations)),
    ]
    if any(c.slowness and not c.time_constant for c in lagging):
        lines.append(
            f"% An actuator with a slew rate alone comes to rest over {ARRIVAL} s, as an"
            " approximation."
        )
    size, count = 6 + len(lagging), len(equations.channels)
    north, east = equations.current
    return [
        *lines,
        "",
        f"if length(x) ~= {size}, error('x must have dimension {size}'); end",
        f"if length(ui) ~= {count}, error('ui must have dimension {count}'); end",
        f"if nargin < 4, V_c = hypot({_number(north)}, {_number(east)}); "
        f"beta_c = atan2({_number(east)}, {_number(north)}); end",
        "",
    ]


def _motion(equations: Equations) -> list[str]:
    """State, motion through the water, and mass matrix."""
    m11, m22, m23, m32, m33 = map(_number, equations.mass_matrix)
    return [
        "u = x(1); v = x(2); r = x(3); psi = x(6);",
        "U = sqrt(u^2 + v^2);",
        "u_c = V_c * cos(beta_c - psi);",
        "v_c = V_c * sin(beta_c - psi);",
        "u_r = u - u_c;",
        "v_r = v - v_c;",
        f"M = [{m11} 0 0; 0 {m22} {m23}; 0 {m32} {m33}];",
        "",
        "% Actuators: what is ordered, and what is executed",
    ]


def _executed(channel: Channel, number: int, lagging: list[Channel]) -> list[str]:
    """What a channel is on its way to, and what it executes."""
    name = _variable(channel.name)
    lower = float("-inf") if channel.lower is None else channel.lower
    upper = float("inf") if channel.upper is None else channel.upper
    stages = (channel.bias, channel.deadband, channel.neutral, lower, upper)
    lines = [f"goal_{name} = settled(ui({number}), {', '.join(map(_number, stages))});"]
    if channel not in lagging:
        return [*lines, f"{name} = goal_{name};"]
    lines.append(f"{name} = x({7 + lagging.index(channel)});")
    if channel.endless:
        lines.append(
            f"goal_{name} = goal_{name} - 2 * pi * round((goal_{name} - {name}) / (2 * pi));"
        )
    return lines


def _servo_rate(channel: Channel) -> str:
    name, lag = _variable(channel.name), channel.time_constant or ARRIVAL
    return f"servo({name}, goal_{name}, {_number(lag)}, {_number(channel.slowness or 0.0)})"


def _polynomial(
    terms: Iterable[Term], scaling: dict[str, Any] | None, delta: str = ""
) -> list[str]:
    """Lines that add a sum of terms to tau, of a prime set in its scaling."""
    letters = {"u": "u_r", "v": "v_r", "r": "r", "d": delta}
    lines, units = [], {"X": "", "Y": "", "N": ""}
    if scaling:
        L, U0 = _number(scaling["length"]), _number(scaling["reference_speed"])
        q = 0.5 * scaling["water_density"] * scaling["length"] * scaling["width"]
        letters |= {"u": "u_p", "v": "v_p", "r": "r_p"}
        lines = [
            f"S = sqrt(u_r^2 + v_r^2 + {SMALL});",
            f"u_p = (u_r - {U0}) / S; v_p = v_r / S; r_p = r * {L} / S;",
            f"q = {_number(q)} * S^2;",
        ]
        units = {"X": "q * ", "Y": "q * ", "N": f"q * {L} * "}
    sums = {
        axis: " + ".join(_product(term, letters) for term in terms if term.axis == axis) or "0"
        for axis in "XYN"
    }
    return [
        *lines,
        *(
            f"tau({row}) = tau({row}) + {units[axis]}({sums[axis]});"
            for row, axis in enumerate("XYN", start=1)
            if sums[axis] != "0"
        ),
    ]


def _product(term: Term, letters: dict[str, str]) -> str:
    factors = [letters[letter] for letter in term.letters]
    if term.exponent != 1.0:
        (x,) = factors
        factors.append(f"({x}^2 + {SMALL})^{_number(0.5 * (term.exponent - 1))}")
    elif term.modulus:
        factors[0] = f"abs({factors[0]})"
    return " * ".join([f"({_number(term.coefficient)})", *factors])


# Actuators: lines that add an actuator's force to tau


def _factor(losses: dict[str, float]) -> str:
    """What is left of a thrust, as a factor with its sign; nothing where all is."""
    if not any(losses.values()):
        return ""
    a, s, t = (_number(losses[key]) for key in ("asymmetry", "with_speed", "in_turns"))
    return f" * (1 + {a}) * (1 - {s} * u_r) * (1 - {t} * abs(r))"


def _push(part: dict[str, Any], thrust: str, angle: str) -> str:
    x, y = _number(part["x"]), _number(part.get("y", 0.0))
    return f"tau = tau + push({thrust}, {x}, {y}, {angle});"


def _thruster(part: dict[str, Any]) -> list[str]:
    angle = _variable(part["angle_channel"]) if "angle_channel" in part else _number(part["angle"])
    sign = "-" if part["reversed"] else ""
    lines = [f"n = {sign}({_variable(part['channel'])} - {_number(part['neutral'])});"]
    if part["thrust_curve"] is not None:
        curve = part["thrust_curve"]
        ahead, astern = (
            curve["full_ahead"] - part["neutral"],
            part["neutral"] - curve["full_astern"],
        )
        keys = ("full_thrust", "deadband", "exponent", "astern_ratio")
        numbers = ", ".join(_number(x) for x in (ahead, astern, *(curve[key] for key in keys)))
        lines.append(f"T = curve_thrust(n, {numbers});")
    elif part["curve"] is not None:
        c, d = map(_number, part["curve"])
        x, y = _number(part["x"]), _number(part["y"])
        lines += [
            f"n = n / {_number(part['per_revolution'])};",
            f"V = (u_r - {y} * r) * cos({angle}) + (v_r + {x} * r) * sin({angle});",
            f"T = {c} * V * n + {d} * abs(n) * n;",
        ]
    else:
        lines.append("T = n;")
    return [*lines, _push(part, f"T{_factor(part['losses'])}", angle)]


def _tunnel(part: dict[str, Any]) -> list[str]:
    thrust = f"{_number(part['effectiveness'])} * {_variable(part['channel'])}"
    if part["fading_speed"]:
        thrust += f" / (1 + (u_r / {_number(part['fading_speed'])})^2)"
    return [_push(part, thrust, "pi / 2")]


def _propeller(part: dict[str, Any]) -> list[str]:
    n, name, D = _variable(part["channel"]), identifier(part["name"]), _number(part["diameter"])
    k_T = " ".join(map(_number, part["k_T"]))
    wake = ", ".join(_number(part[k]) for k in ("wake_fraction", "wake_decay", "astern_factor"))
    x = _number(part["x"])
    scale = (1 - part["thrust_deduction"]) * part["water_density"] * part["diameter"] ** 4
    return [
        f"[K_{name}, V_{name}] = open_water({n}, u_r, v_r, r, {x}, {D}, [{k_T}], {wake});",
        _push(part, f"{_number(scale)} * K_{name}{_factor(part['losses'])}", "0"),
        f"load_{name} = 8 * ({n} > 0) * max(K_{name}, 0) * {D}^2 / pi;",
        f"D_{name} = {D};",
    ]


def _rudder(part: dict[str, Any]) -> list[str]:
    number = {key: _number(value) for key, value in part.items() if isinstance(value, float)}
    delta = _variable(part["channel"])
    lines = [
        f"w = drift_speed(u_r, v_r) - ({number['l_R']}) * r;",
        f"if w < 0, w = {number['gamma_R_port']} * w; "
        f"else, w = {number['gamma_R_starboard']} * w; end",
    ]
    if part["propeller"] is None:
        lines.append(f"u_R = (1 - {number['wake_fraction']}) * u_r;")
    else:
        jet = identifier(part["propeller"])
        lines += [
            f"e = min(D_{jet} / {number['height']}, 1);",
            f"k = sqrt(V_{jet}^2 + load_{jet} + {SMALL}) - V_{jet};",
            f"k = e * (V_{jet} + {number['kappa']} * k)^2 + (1 - e) * V_{jet}^2;",
            f"u_R = {number['epsilon']} * sqrt(k + {SMALL});",
        ]
    scale = 0.5 * part["water_density"] * part["area"] * part["lift_slope"]
    lever = part["x"] + part["a_H"] * part["x_H"] + part["hull_lever"]
    return [
        *lines,
        "if abs(u_R) < 1e-9, u_R = 1e-9; end",
        f"F_N = {_number(scale)} * (u_R^2 + w^2) * sin({delta} - atan2(w, u_R));",
        f"X = -{_number(1 - part['t_R'])} * F_N * sin({delta});",
        f"Y = -F_N * cos({delta});",
        f"tau = tau + [X; {_number(1 + part['a_H'])} * Y; "
        f"{_number(lever)} * Y - ({number['y']}) * X];",
    ]


def _derivatives(part: dict[str, Any]) -> list[str]:
    terms = [Term(**term) for term in part["terms"]]
    return _polynomial(terms, part["scaling"], _variable(part["channel"]))


_ACTUATORS = {
    "thruster": _thruster,
    "tunnel": _tunnel,
    "propeller": _propeller,
    "rudder": _rudder,
    "derivatives": _derivatives,
}


def _used_subfunctions(lines: list[str]) -> list[str]:
    """The texts of the subfunctions that lines call, and that those call."""
    text, used = "\n".join(lines), []
    for name in ("servo", "settled", "strips", "curve_thrust", "open_water", "drift_speed", "push"):
        if f"{name}(" in text:
            used.append(SUBFUNCTIONS[name])
            text += SUBFUNCTIONS[name]
    return used
