"""The outline of a hull: what its owner knows, and what is taken where he does not.

A catamaran is two equal demihulls without a bridge in the water; every other form is one hull.
"""

import dataclasses
import math
from typing import NamedTuple

from diffsea.errors import UserError
from diffsea.scales import froude_speed


class Form(NamedTuple):
    """What is taken of a form of hull where nothing is said."""

    hulls: int
    block_coefficient: float  # of one hull
    service: float  # Froude number at which drag is estimated
    top: float  # Froude number of the top speed
    is_streamlined: bool  # a ship's lines, whose flow does not part at the ends


FORMS = {
    "catamaran": Form(2, 0.6, 0.35, 0.6, False),
    "monohull": Form(1, 0.5, 0.35, 0.6, False),
    "barge": Form(1, 0.9, 0.15, 0.2, False),
    "ship": Form(1, 0.7, 0.18, 0.25, True),
}
SLENDERNESS = 10.0  # length over beam of a demihull: 12, 8 and 11 of blueboat, otter and wamv
GYRATION = 0.25  # radius of gyration over length, as for ships (Yasukawa and Yoshimura 2015)
# Of x_G / L: root mean square of the vessels that ship and state a centre of gravity off amidships.
CENTRE_OF_GRAVITY_WIDTH = 0.056
LEAST_BLOCK, MOST_BLOCK = 0.2, 1.0
LEAST_DRAUGHT, MOST_DRAUGHT = 0.005, 2.0  # over a hull's beam, that are believed of a mass
BLOCK_MISMATCH = 0.1  # by which a stated block coefficient may differ from that of the mass


@dataclasses.dataclass(frozen=True)
class Known:
    """What an owner knows, SI units; None where he does not."""

    form: str
    length: float  # m, of the waterline
    beam: float  # m, over all
    mass: float | None = None  # kg, as she sails; of a draught and a block coefficient if None
    draught: float | None = None  # m
    block_coefficient: float | None = None  # of one hull
    hull_beam: float | None = None  # m, of one demihull, at the waterline
    top_speed: float | None = None  # m/s
    water_density: float = 1025.0  # kg/m^3
    x_G: float | None = None  # m, centre of gravity ahead of amidships


@dataclasses.dataclass(frozen=True)
class Outline:
    """Dimensions (SI units) that estimates need, all of them known or assumed.

    `assumed` says in words what was taken, by key.
    """

    form: str
    hulls: int
    length: float
    beam: float  # over all
    hull_beam: float  # of one hull
    draught: float
    mass: float
    block_coefficient: float  # of one hull
    water_density: float
    service_speed: float  # at which drag is estimated
    top_speed: float
    x_G: float  # centre of gravity ahead of amidships
    assumed: dict[str, str]

    @property
    def spacing(self) -> float:
        """Distance (m) between the centre planes of the demihulls; zero of a single hull."""
        return self.beam - self.hull_beam if self.hulls == 2 else 0.0

    @property
    def hull_mass(self) -> float:
        """The mass (kg) that one hull carries."""
        return self.mass / self.hulls

    @property
    def is_streamlined(self) -> bool:
        """Whether it has a ship's lines."""
        return FORMS[self.form].is_streamlined

    @property
    def I_z(self) -> float:
        """Moment of inertia (kg m^2) about the centre of gravity.

        That of a ship of radius of gyration 0.25 L; of a catamaran half of the mass is in the
        demihulls besides, at half their spacing.
        """
        return self.mass * ((GYRATION * self.length) ** 2 + 0.5 * (0.5 * self.spacing) ** 2)


def outline_of(known: Known) -> Outline:
    """The outline of what is known.

    Raises:
        UserError: an unknown form, a dimension that is not positive, or dimensions and mass that
            do not go together.
    """
    if known.form not in FORMS:
        raise UserError(f"unknown hull form {known.form!r}; known are {', '.join(FORMS)}")
    form, assumed = FORMS[known.form], dict[str, str]()
    for key, value in dataclasses.asdict(known).items():
        if key == "x_G" or not isinstance(value, float | int):
            continue
        if not (value > 0 and math.isfinite(value)):
            raise UserError(f"{key} = {value:g} must be positive")
    hull_beam = _hull_beam(known, form, assumed)
    plan = form.hulls * known.water_density * known.length * hull_beam  # kg for each m of draught
    draught, mass = known.draught, known.mass
    block = known.block_coefficient or form.block_coefficient
    if known.block_coefficient is None and (mass is None or draught is None):
        assumed["block_coefficient"] = f"C_B = {block:g}, usual for a {known.form}"
    if mass is None:
        if draught is None:
            raise UserError("give the mass (kg), or the draught (m) for a mass by displacement")
        mass = plan * block * draught
        assumed["mass"] = f"mass = {mass:.4g} kg, displaced at this draught by C_B = {block:g}"
    elif draught is None:
        draught = mass / (plan * block)
        if not LEAST_DRAUGHT < draught / hull_beam < MOST_DRAUGHT:
            raise UserError(
                f"a {known.form} of {known.length:g} m by {known.beam:g} m would float at "
                f"{draught:.2g} m draught with {mass:g} kg, hulls {hull_beam:.2g} m wide; check "
                f"mass (kg) and dimensions (m), or {_otherwise(known, form)}"
            )
        assumed["draught"] = f"draught = {draught:.3g} m, what displaces the mass"
    floated = mass / (plan * draught)
    if not LEAST_BLOCK <= floated <= MOST_BLOCK:
        raise UserError(
            f"a {known.form} of {known.length:g} m by {known.beam:g} m and {draught:.3g} m draught "
            f"would have a block coefficient of {floated:.2g} to displace {mass:g} kg, and hulls "
            f"have {LEAST_BLOCK:g} to {MOST_BLOCK:g}; check the mass (kg) and the dimensions (m), "
            f"or {_otherwise(known, form)}"
        )
    if known.block_coefficient is not None and abs(floated / block - 1) > BLOCK_MISMATCH:
        raise UserError(
            f"mass, draught and C_B = {block:g} do not go together: the mass displaces this "
            f"draught with C_B = {floated:.3g}; leave one of the three out"
        )
    top = known.top_speed
    if top is None:
        top = froude_speed(known.length, form.top)
        assumed["top_speed"] = f"top speed = {top:.3g} m/s, Froude number {form.top:g}"
    x_G = known.x_G
    if x_G is None:
        x_G = 0.0
        assumed["x_G"] = f"x_G = 0 +- {CENTRE_OF_GRAVITY_WIDTH * known.length:.2g} m"
    if not abs(x_G) < 0.5 * known.length:
        raise UserError(
            f"a centre of gravity {x_G:g} m ahead of amidships does not lie in a hull of "
            f"{known.length:g} m"
        )
    service = min(froude_speed(known.length, form.service), 0.7 * top)
    return Outline(
        known.form,
        form.hulls,
        known.length,
        known.beam,
        hull_beam,
        draught,
        mass,
        floated,
        known.water_density,
        service,
        top,
        x_G,
        assumed,
    )


def _otherwise(known: Known, form: Form) -> str:
    """What else may be given where a vessel of this form cannot float so, as options say it."""
    ways = ["the draught (--draught)"] if known.draught is None else []
    if form.hulls == 2:
        ways += ["the beam of one demihull (--hull-beam)"] if known.hull_beam is None else []
        ways += ["another hull form (--hull monohull, barge, ship)"]
    else:
        ways += ["another hull form (--hull)"]
    return f"give {' or '.join(ways)}"


def _hull_beam(known: Known, form: Form, assumed: dict[str, str]) -> float:
    """Beam (m) of one hull."""
    if form.hulls == 1:
        if known.hull_beam is not None:
            raise UserError(f"a {known.form} has no demihulls whose beam could be given")
        return known.beam
    if known.hull_beam is not None:
        if not known.hull_beam < 0.5 * known.beam:
            raise UserError(
                f"a demihull of {known.hull_beam:g} m is too wide for a catamaran of "
                f"{known.beam:g} m over all; the beam is the whole boat's"
            )
        return known.hull_beam
    taken = min(known.length / SLENDERNESS, known.beam / 3)
    assumed["hull_beam"] = f"beam of a demihull = {taken:.3g} m, a tenth of the length"
    return taken
