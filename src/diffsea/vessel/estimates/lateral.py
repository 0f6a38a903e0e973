"""Lateral damping of an outline: cross-flow drag at rest, and lift when under way.

Cross-flow drag is a section's drag coefficient along the hull. Lift is that of a wing of low aspect
ratio, whose forces go with `u v` and `u r`; the regressions for ships hold them by model tests.
Derivatives have SNAME signs and are those of the vessel file with all terms of the added-mass
Coriolis forces: what these bring by themselves (`X_udot u r`, the Munk moment) is taken out.
"""

import math
from typing import NamedTuple

import numpy as np

from diffsea.vessel.estimates.outline import Outline


HOERNER, PLATE, KIJIMA, SHIELDED = "Hoerner", "flat plate", "Kijima", " (shadowed)"
JONES, CLARKE, SMITT, INOUE = "Jones", "Clarke", "Smitt", "Inoue"
SOURCES = {
    HOERNER: "S. F. Hoerner 1965, Fluid-Dynamic Drag: a section's drag coefficient by beam over "
    "draught (Fossen 2021, section 6.4), along the length",
    PLATE: "the same with 1.2, a plate across the flow (Hoerner 1965, chapter 3)",
    KIJIMA: "the same with 2.5 T (1 - C_B) / B + 0.5 (Kijima et al. 1990)",
    "shadowed": "the second demihull in the shadow of the first",
    JONES: "R. T. Jones 1946, wing of low aspect ratio; slender-body theory with lift at the stern",
    CLARKE: "D. Clarke, P. Gedling and G. Hine 1983, The application of manoeuvring criteria in "
    "hull design using linear theory",
    SMITT: "L. Wagner Smitt 1970, in Clarke et al. 1983",
    INOUE: "S. Inoue, M. Hirano and K. Kijima 1981, Hydrodynamic derivatives on ship manoeuvring",
}
# Drag coefficient of a ship's section across the flow by half its beam over its draught.
_HALF_BEAM = (0.01, 0.18, 0.35, 0.45, 0.49, 0.56, 0.65, 0.83, 1.0, 1.3, 1.65, 2.3, 3.0, 4.0)
_DRAG = (1.97, 1.97, 1.90, 1.79, 1.28, 1.08, 1.0, 0.88, 0.83, 0.76, 0.69, 0.63, 0.59, 0.56)
LINEAR_AT = 0.1  # of the service speed: sway up to which linear damping at rest is as large


def section_drag(outline: Outline) -> dict[str, float]:
    """Drag coefficient of a section across the flow, by method; without unit."""
    ratio = 0.5 * outline.hull_beam / outline.draught
    found = {HOERNER: float(np.interp(ratio, _HALF_BEAM, _DRAG))}
    if outline.is_streamlined:
        full = 1 - min(outline.block_coefficient, 0.95)
        return found | {KIJIMA: 2.5 * full * outline.draught / outline.hull_beam + 0.5}
    return found | {PLATE: 1.2}


def cross_flow_drag(outline: Outline) -> dict[str, dict[str, float]]:
    """Y_vv (N s^2/m^2) and N_rr (N m s^2/rad^2), by name and method.

    `Y_vv = -1/2 rho T L C_d`, `N_rr = -1/64 rho T L^4 C_d`: the integrals of strip theory at pure
    sway and at pure yaw (Faltinsen 1990; Fossen 2021, eq. 6.91). Of two demihulls the second is in
    the shadow of the first, or not: both are estimates.
    """
    density, L, T = outline.water_density, outline.length, outline.draught
    drags = section_drag(outline)
    if outline.hulls == 2:
        drags = {source: 2 * c for source, c in drags.items()} | {
            source + SHIELDED: c for source, c in drags.items()
        }
    return {
        "Y_vv": {source: -0.5 * density * T * L * c for source, c in drags.items()},
        "N_rr": {source: -density * T * L**4 / 64 * c for source, c in drags.items()},
    }


class Lift(NamedTuple):
    """Forces of a hull under way, over u: what Y_uv, Y_ur, N_uv and N_ur are in all.

    The moment in `N_v` has the Munk moment, `Y_r` is without the centripetal force of the surge
    added mass.
    """

    Y_v: float  # kg/m
    Y_r: float  # kg
    N_v: float  # kg
    N_r: float  # kg m


def lifts(outline: Outline, surge_mass: float) -> dict[str, Lift]:
    """Lift of one hull by method; `surge_mass` (kg) is its added mass in surge, above zero."""
    L, B, T = outline.length, outline.hull_beam, outline.draught
    C_B, half = outline.block_coefficient, 0.5 * outline.water_density
    tail = math.pi * half * T**2  # kg/m, the last section's added mass
    by_length = lambda Y_v, Y_r, N_v, N_r: Lift(
        half * T**2 * Y_v,
        half * T**2 * L * Y_r + surge_mass,
        half * T**2 * L * N_v,
        half * T**2 * L**2 * N_r,
    )
    k = 2 * T / L
    found = {
        JONES: Lift(-tail, 0.5 * L * tail + surge_mass, -0.5 * L * tail, -0.25 * L**2 * tail),
        SMITT: by_length(-5.0, 1.02, -1.94, -0.65),
        CLARKE: by_length(
            -math.pi * (1 + 0.40 * C_B * B / T),
            -math.pi * (-1 / 2 + 2.2 * B / L - 0.080 * B / T),
            -math.pi * (1 / 2 + 2.4 * T / L),
            -math.pi * (1 / 4 + 0.039 * B / T - 0.56 * B / L),
        ),
    }
    unit = half * L * T
    inoue = Lift(
        -unit * (0.5 * math.pi * k + 1.4 * C_B * B / L),
        unit * L * 0.25 * math.pi * k,
        -unit * L * k,
        -unit * L**2 * (0.54 * k - k**2),
    )
    return found | {INOUE: inoue}


def lift_derivatives(
    outline: Outline, surge_mass: float, sway_mass: float, drag: float
) -> dict[str, dict[str, float]]:
    """Y_uv (kg/m), Y_ur, N_uv (kg) and N_ur (kg m) of all hulls, by name and method.

    Arguments:
        surge_mass, sway_mass: added masses of all hulls, kg, above zero.
        drag: quadratic drag ahead of all hulls, kg/m, above zero: a catamaran that turns has one
            hull faster than the other.
    """
    hulls, found = outline.hulls, lifts(outline, surge_mass / outline.hulls)
    unequal = 2 * drag * (0.5 * outline.spacing) ** 2
    munk = sway_mass - surge_mass
    return {
        "Y_uv": {source: hulls * lift.Y_v for source, lift in found.items()},
        "Y_ur": {source: hulls * lift.Y_r for source, lift in found.items()},
        "N_uv": {source: hulls * lift.N_v + munk for source, lift in found.items()},
        "N_ur": {source: hulls * lift.N_r - unequal for source, lift in found.items()},
    }
