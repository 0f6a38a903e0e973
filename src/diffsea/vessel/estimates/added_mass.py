"""Added masses of an outline: strip theory, Lamb's spheroid, and regressions for ships.

Every function gives positive numbers of ONE hull; `added_masses` adds the hulls and gives the signs
of SNAME.
"""

import math

from diffsea.vessel.estimates.outline import Outline


LAMB, SOEDING, ZHOU, CLARKE, STRIP = "Lamb", "Soeding", "Zhou", "Clarke", "strip theory"
SOURCES = {
    LAMB: "H. Lamb 1932, Hydrodynamics, article 114: prolate spheroid along its axis",
    SOEDING: "H. Soeding 1982: 2.7 rho volume^(5/3) / L^2",
    ZHOU: "Zhou Zhaoming et al. 1983: regression of Motora's charts",
    CLARKE: "D. Clarke, P. Gedling and G. Hine 1983, The application of manoeuvring criteria in "
    "hull design using linear theory",
    STRIP: "sections of half an ellipse, pi/2 rho T^2 (Newman 1977, Marine Hydrodynamics, "
    "table 4.3), along the length",
}
MOTORA_LEAST, MOTORA_MOST = 4.0, 9.0  # length over beam within which Motora's charts hold


def section_added_mass(outline: Outline) -> float:
    """Added mass in sway (kg/m) of a section: half of a cylinder of radius T, `pi/2 rho T^2`.

    That of a half ellipse of draught T whatever its beam (Newman 1977, table 4.3).
    """
    return 0.5 * math.pi * outline.water_density * outline.draught**2


def surge_added_mass(outline: Outline) -> dict[str, float]:
    """Added mass in surge (kg) of one hull, by method."""
    volume = outline.hull_mass / outline.water_density
    found = {
        LAMB: _spheroid_coefficient(outline) * outline.hull_mass,
        SOEDING: 2.7 * outline.water_density * volume ** (5 / 3) / outline.length**2,
    }
    if _in_motoras_range(outline):
        found[ZHOU] = _zhou(outline)[0] * outline.hull_mass
    return found


def sway_added_mass(outline: Outline) -> dict[str, float]:
    """Added mass in sway (kg) of one hull, by method."""
    L, B, T, C_B = _dimensions(outline)
    unit = 0.5 * outline.water_density * L**3 * math.pi * (T / L) ** 2
    found = {STRIP: section_added_mass(outline) * L}
    clarke = 1 + 0.16 * C_B * B / T - 5.1 * (B / L) ** 2
    if clarke > 0:
        found[CLARKE] = unit * clarke
    if _in_motoras_range(outline):
        found[ZHOU] = _zhou(outline)[1] * outline.hull_mass
    return found


def yaw_added_inertia(outline: Outline) -> dict[str, float]:
    """Added moment of inertia in yaw (kg m^2) of one hull about its own middle, by method."""
    L, B, T, C_B = _dimensions(outline)
    unit = 0.5 * outline.water_density * L**5 * math.pi * (T / L) ** 2
    found = {STRIP: section_added_mass(outline) * L**3 / 12}
    clarke = 1 / 12 + 0.017 * C_B * B / T - 0.33 * B / L
    if clarke > 0:
        found[CLARKE] = unit * clarke
    if _in_motoras_range(outline):
        found[ZHOU] = _zhou(outline)[2] * outline.hull_mass
    return found


def added_masses(outline: Outline) -> dict[str, dict[str, float]]:
    """X_udot, Y_vdot (kg) and N_rdot (kg m^2) of all hulls, by name and method, SNAME signs.

    Demihulls are taken not to feel one another. Each one's added mass in surge has its lever about
    the middle of the catamaran.
    """
    surge = surge_added_mass(outline)
    inner = sum(surge.values()) / len(surge) * (0.5 * outline.spacing) ** 2
    hulls = outline.hulls
    return {
        "X_udot": {source: -hulls * value for source, value in surge.items()},
        "Y_vdot": {s: -hulls * value for s, value in sway_added_mass(outline).items()},
        "N_rdot": {s: -hulls * (x + inner) for s, x in yaw_added_inertia(outline).items()},
    }


def _dimensions(outline: Outline) -> tuple[float, float, float, float]:
    """Length, beam, draught (m) and block coefficient of one hull."""
    return outline.length, outline.hull_beam, outline.draught, outline.block_coefficient


def _spheroid_coefficient(outline: Outline) -> float:
    """Lamb's k_1: added mass over displaced mass of a prolate spheroid moving along its axis.

    Its radius is that of a half circle of the midship section's bounding area, B T.
    """
    half_length = 0.5 * outline.length
    radius = math.sqrt(2 * outline.hull_beam * outline.draught / math.pi)
    e = math.sqrt(1 - min(radius / half_length, 0.99) ** 2)
    a = 2 * (1 - e**2) / e**3 * (0.5 * math.log((1 + e) / (1 - e)) - e)
    return a / (2 - a)


def _in_motoras_range(outline: Outline) -> bool:
    slenderness = outline.length / outline.hull_beam
    return MOTORA_LEAST <= slenderness <= MOTORA_MOST and outline.hulls == 1


def _zhou(outline: Outline) -> tuple[float, float, float]:
    """m_x / m, m_y / m and J_z / m (m^2) of a ship (Zhou et al. 1983, from Motora's charts)."""
    L, B, T, C_B = _dimensions(outline)
    l, d = L / B, T / B
    m_x = 0.398 + 11.97 * C_B * (1 + 3.73 * d) - 2.89 * C_B * l * (1 + 1.13 * d)
    m_x += 0.175 * C_B * l**2 * (1 + 0.541 * d) - 1.107 * l * d
    m_y = 0.882 - 0.54 * C_B * (1 - 1.6 * d) - 0.156 * l * (1 - 0.673 * C_B)
    m_y += 0.826 * d * l * (1 - 0.678 * d) - 0.638 * C_B * d * l * (1 - 0.669 * d)
    radius = 33 - 76.85 * C_B * (1 - 0.784 * C_B) + 3.43 * l * (1 - 0.63 * C_B)
    return 0.01 * m_x, m_y, (0.01 * L * radius) ** 2
