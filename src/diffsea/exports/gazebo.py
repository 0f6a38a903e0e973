"""A Gazebo model (SDF 1.10) of a vessel: hull, added mass, `Hydrodynamics` and thrusters.

Axes. Gazebo's body axes are forward, port, up and its world is east, north, up. Both differ from
ours by half a turn about the forward axis, so that sway and yaw change sign together: `Y_v`, `N_r`,
and the couplings `Y_r`, `N_v`, `X_vr` keep theirs; `Y_0`, `N_u` and the like, the thrusters' places
to starboard and their angles change. Gazebo's yaw angle is pi / 2 less the heading.

Added mass stands in the link's `<fluid_added_mass>`: the physics engine (DART) has it in its mass
matrix, with Kirchhoff's Coriolis forces. That of the `Hydrodynamics` system lags by a step, so that
it diverges where added mass exceeds mass, and its Coriolis matrix is not the textbook's; both are
switched off, and where a vessel's Coriolis forces differ from Kirchhoff's the system's products of
two velocities make up for it.
"""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from diffsea.errors import UserError
from diffsea.exports.equations import Channel, Equations, Term
from diffsea.exports.fmu import identifier


BASE = "base_link"
PROPELLER_SHARE = 1e-3  # of the mass: Gazebo needs some at each thruster's joint
_UNLIMITED = 1e12  # N or rad/s: Gazebo's own default is 1000

_Coefficients = dict[str, float]  # by the name of an element of the Hydrodynamics system


def gazebo_losses(equations: Equations) -> tuple[str, ...]:
    """What a model leaves out of a vessel, in words.

    Raises:
        UserError: the hull is a prime set, of which nothing can be written.
    """
    if any(polynomial.scaling for polynomial in equations.polynomials):
        raise UserError(
            "--to gazebo cannot express a non-dimensional hull (MMG, Abkowitz): Gazebo's "
            "Hydrodynamics has products of at most two velocities, and none of its terms remains"
        )
    terms = [t for polynomial in equations.polynomials for t in polynomial.terms]
    lost = [t.name for t in terms if not _is_expressible(t)]
    found = [*equations.left_out, *(f"the derivative {name}" for name in lost)]
    if equations.crossflow is not None:
        found.append("the cross-flow drag")
    added = equations.added_mass
    if added["Y_rdot"] != added["N_vdot"]:
        found.append("the difference of Y_rdot and N_vdot (the mass matrix is symmetric there)")
    if any(equations.current) and any(added.values()):
        found.append("the current in the Coriolis forces of the added mass")
    channels = {channel.name: channel for channel in equations.channels}
    for part in equations.actuators:
        found += _actuator_losses(part, channels)
    return tuple(found)


def gazebo_model(equations: Equations, losses: Iterable[str]) -> str:
    """The model as the text of an SDF file, naming what it leaves out."""
    name = identifier(equations.name)
    root = Element("sdf", version="1.10")
    root.append(ElementTree.Comment(_header(equations, losses)))
    model = SubElement(root, "model", name=name)
    channels = {channel.name: channel for channel in equations.channels}
    thrusters = [part for part in equations.actuators if _is_thruster(part)]
    link = SubElement(model, "link", name=BASE)
    _add_inertial(link, equations, thrusters)
    for part in thrusters:
        _add_propeller(model, part, equations)
    _add_hydrodynamics(model, equations)
    for part in thrusters:
        _add_thruster(model, part, channels[part["channel"]], equations)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def hydrodynamics(equations: Equations) -> _Coefficients:
    """Coefficients of the Hydrodynamics system in forward, port, up, by the element's name."""
    sums: _Coefficients = {}
    hull = [t for polynomial in equations.polynomials[1:] for t in polynomial.terms]
    for term in (*_coriolis_rest(equations), *filter(_is_expressible, hull)):
        name = _element(term)
        sums[name] = sums.get(name, 0.0) + _flipped(term)
    return {name: value for name, value in sums.items() if value}


def _header(equations: Equations, losses: Iterable[str]) -> str:
    """What the file says of itself."""
    source = " ".join(f"{equations.name}: {equations.source}".split()).replace("--", "-")
    lines = [
        source,
        "Written by diffsea: surge, sway and yaw, axes forward, port, up, origin amidships.",
        "Assumed: roll and pitch inertia of a flat body. Heave, roll and pitch damping and",
        "buoyancy are not the vessel's file's to say: add zW, kP, mQ and a buoyancy system.",
        *(f"LEFT OUT: {loss}." for loss in losses),
    ]
    return "\n  " + "\n  ".join(lines) + "\n"


# Terms


def _is_expressible(term: Term) -> bool:
    return term.exponent == 1.0 and 1 <= len(term.letters) <= 2


def _element(term: Term) -> str:
    """The name of a term's element: `yVabsV` for |v| v, `xVR` for v r."""
    first, *second = term.letters.upper()
    if term.modulus:
        first, second = second[0], ["abs", first]
    return term.axis.lower() + first + "".join(second)


def _flipped(term: Term) -> float:
    """A term's coefficient in forward, port, up: sway and yaw have the other sign."""
    signed = term.letters[1:] if term.modulus else term.letters
    turns = (term.axis in "YN") + sum(letter in "vr" for letter in signed)
    return -term.coefficient if turns % 2 else term.coefficient


def _coriolis_rest(equations: Equations) -> list[Term]:
    """Coriolis forces of the vessel less those of the mass matrix that the physics engine has."""
    added, mass = equations.added_mass, equations.body["mass"]
    moment = mass * equations.body["x_G"]
    coupling = _coupling(added)
    engine = {
        "X_vr": mass - added["Y_vdot"],
        "X_rr": moment + coupling,
        "Y_ur": added["X_udot"] - mass,
        "N_uv": added["Y_vdot"] - added["X_udot"],
        "N_ur": -moment - coupling,
    }
    own = {term.name: term.coefficient for term in equations.polynomials[0].terms}
    rests = {name: own.get(name, 0.0) - value for name, value in engine.items()}
    scale = 1e-12 * max(map(abs, engine.values()))
    return [Term(name[0], rest, name[2:]) for name, rest in rests.items() if abs(rest) > scale]


def _coupling(added: dict[str, float]) -> float:
    """Added mass between sway and yaw (kg m), the same in both axes' signs."""
    return -0.5 * (added["Y_rdot"] + added["N_vdot"])


# Inertia


@dataclasses.dataclass(frozen=True)
class _Body:
    """Mass (kg), place (m forward, m to port) and yaw inertia about itself (kg m^2)."""

    mass: float
    x: float
    y: float
    izz: float


def _propeller_body(part: dict[str, Any], equations: Equations) -> _Body:
    mass = PROPELLER_SHARE * equations.body["mass"]
    radius = 0.02 * equations.body["length"]
    return _Body(mass, part["x"], -part["y"], 0.4 * mass * radius**2)


def _hull_body(equations: Equations, thrusters: list[dict[str, Any]]) -> _Body:
    """The hull without what stands at the thrusters' joints: all together are the vessel."""
    whole = equations.body
    parts = [_propeller_body(part, equations) for part in thrusters]
    mass = whole["mass"] - sum(p.mass for p in parts)
    x = (whole["mass"] * whole["x_G"] - sum(p.mass * p.x for p in parts)) / mass
    y = -sum(p.mass * p.y for p in parts) / mass
    about_origin = whole["I_z"] + whole["mass"] * whole["x_G"] ** 2
    about_origin -= sum(p.izz + p.mass * (p.x**2 + p.y**2) for p in parts)
    return _Body(mass, x, y, about_origin - mass * (x**2 + y**2))


def _add_inertial(link: Element, equations: Equations, thrusters: list[dict[str, Any]]) -> None:
    hull, size = _hull_body(equations, thrusters), equations.body
    across = size["beam"] ** 2 / (size["beam"] ** 2 + size["length"] ** 2)
    # Of a flat body, and a twentieth more of each: the three must be those of a possible body.
    ixx, iyy = (hull.izz * (share + 0.05) for share in (across, 1 - across))
    inertial = _add_mass(link, hull, ixx, iyy)
    added = equations.added_mass
    if any(added.values()):
        fluid = SubElement(inertial, "fluid_added_mass")
        _add_number(fluid, "xx", -added["X_udot"])
        _add_number(fluid, "yy", -added["Y_vdot"])
        _add_number(fluid, "yr", _coupling(added))
        _add_number(fluid, "rr", -added["N_rdot"])


def _add_mass(link: Element, body: _Body, ixx: float, iyy: float, place: bool = True) -> Element:
    """The `<inertial>` of a body; its own place is that of the link where `place` is False."""
    inertial = SubElement(link, "inertial")
    if place:
        SubElement(inertial, "pose").text = _numbers(body.x, body.y, 0, 0, 0, 0)
    _add_number(inertial, "mass", body.mass)
    inertia = SubElement(inertial, "inertia")
    for name, value in (("ixx", ixx), ("iyy", iyy), ("izz", body.izz)):
        _add_number(inertia, name, value)
    return inertial


# Systems


def _add_hydrodynamics(model: Element, equations: Equations) -> None:
    system = _add_system(model, "hydrodynamics", "Hydrodynamics")
    SubElement(system, "link_name").text = BASE
    _add_number(system, "water_density", equations.body["water_density"])
    SubElement(system, "disable_added_mass").text = "true"
    SubElement(system, "disable_coriolis").text = "true"
    for name, value in hydrodynamics(equations).items():
        _add_number(system, name, value)
    north, east = equations.current
    SubElement(system, "default_current").text = _numbers(east, north, 0)


def _is_thruster(part: dict[str, Any]) -> bool:
    return part["kind"] == "thruster" and "angle_channel" not in part


def _actuator_losses(part: dict[str, Any], channels: dict[str, Channel]) -> list[str]:
    """What a model leaves out of an actuator."""
    name = repr(part["name"])
    if not _is_thruster(part):
        return [f"the actuator {name}"]
    channel = channels[part["channel"]]
    stages = {
        "the delay": channel.delay,
        "the lag": channel.time_constant,
        "the slew rate": channel.slowness,
        "the dead band": channel.deadband,
        "the bias": channel.bias,
        "the thrust curve (its order is a thrust)": part["thrust_curve"],
        "the fall of thrust with the speed of advance": part["curve"] and part["curve"][0],
        "the asymmetry": part["losses"]["asymmetry"],
        "the loss of thrust with speed": part["losses"]["with_speed"],
        "the loss of thrust in turns": part["losses"]["in_turns"],
        "the reversed or shifted orders": part["reversed"] or channel.neutral,
    }
    return [f"{words} of {name}" for words, value in stages.items() if value]


def _add_propeller(model: Element, part: dict[str, Any], equations: Equations) -> None:
    """The link and joint that a thruster pushes at, along the link's forward axis."""
    name, body = identifier(part["name"]), _propeller_body(part, equations)
    link = SubElement(model, "link", name=f"{name}_propeller")
    SubElement(link, "pose").text = _numbers(body.x, body.y, 0, 0, 0, -part["angle"])
    _add_mass(link, body, body.izz, body.izz, place=False)
    joint = SubElement(model, "joint", name=f"{name}_joint", type="revolute")
    SubElement(joint, "parent").text = BASE
    SubElement(joint, "child").text = f"{name}_propeller"
    axis = SubElement(joint, "axis")
    SubElement(axis, "xyz").text = "1 0 0"


def _add_thruster(
    model: Element, part: dict[str, Any], channel: Channel, equations: Equations
) -> None:
    """The Thruster system: ordered in N, or in rad/s where thrust goes with the square of that."""
    system = _add_system(model, "thruster", "Thruster")
    SubElement(system, "namespace").text = identifier(equations.name)
    SubElement(system, "joint_name").text = f"{identifier(part['name'])}_joint"
    SubElement(system, "velocity_control").text = "true"
    low, high = thrust_limits(part, channel)
    if part["curve"] is not None:
        SubElement(system, "use_angvel_cmd").text = "true"
        density = equations.body["water_density"]
        _add_number(system, "fluid_density", density)
        _add_number(system, "propeller_diameter", 1.0)
        _add_number(system, "thrust_coefficient", part["curve"][1] / (density * (2 * math.pi) ** 2))
    _add_number(system, "max_thrust_cmd", high)
    _add_number(system, "min_thrust_cmd", low)


def thrust_limits(part: dict[str, Any], channel: Channel) -> tuple[float, float]:
    """Least and largest order that Gazebo takes: N, or rad/s with a curve of the shaft speed."""
    if part["thrust_curve"] is not None:
        curve = part["thrust_curve"]
        return -curve["astern_ratio"] * curve["full_thrust"], curve["full_thrust"]
    ends = [
        -_UNLIMITED if channel.lower is None else channel.lower - channel.neutral,
        _UNLIMITED if channel.upper is None else channel.upper - channel.neutral,
    ]
    unit = 2 * math.pi / part["per_revolution"] if part["curve"] is not None else 1.0
    low, high = (unit * (-end if part["reversed"] else end) for end in ends)
    return min(low, high), max(low, high)


def _add_system(model: Element, file: str, name: str) -> Element:
    return SubElement(
        model, "plugin", filename=f"gz-sim-{file}-system", name=f"gz::sim::systems::{name}"
    )


def _add_number(parent: Element, name: str, value: float) -> None:
    SubElement(parent, name).text = _numbers(value)


def _numbers(*values: float) -> str:
    """Numbers to the last bit, with blanks between; no zero is negative."""
    return " ".join(repr(float(value) + 0.0) for value in values)
