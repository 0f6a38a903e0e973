"""Resistance ahead of an outline: friction and waves of a smooth hull, and a blunt one.

A ship has the first. Boats of a few metres, with open transoms, thrusters and cables in the water,
and barges have the pressure on a blunt body, with or without the first. Forces are of all hulls,
N, positive.
"""

import math

import numpy as np

from diffsea.scales import GRAVITY
from diffsea.vessel.estimates.outline import Outline


FRICTION, WAVES = "ITTC-57", "ITTC-57 and Michell"
BLUNT, BLUNT_AND_SMOOTH = "blunt body", "blunt body with ITTC-57 and Michell"
BALANCE = "full thrust at the top speed"
SOURCES = {
    "ITTC-57": "friction line of the ITTC 1957 with a form factor of 0.2, wetted surface by Denny "
    "and Mumford; of ships with the roughness of the ITTC 1978",
    "Michell": "J. H. Michell 1898, wave resistance of a thin ship (Newman 1977, section 6.20)",
    "blunt body": "S. F. Hoerner 1965, Fluid-Dynamic Drag, chapter 3: drag coefficient 1 on the "
    "frontal area",
}
VISCOSITY = 1.19e-6  # m^2/s, fresh to salt water at 15 deg C
FORM_FACTOR = 0.2
ROUGHNESS = 4e-4  # C_A, of ships (ITTC 1978)
LEAST_REYNOLDS = 1e5
ANGLES = 4000  # of Michell's integral


def friction(outline: Outline, speed: float) -> float:
    """`1/2 rho S (1 + k) C_F U^2` (N) with C_F of ITTC-57 and S of Denny and Mumford.

    `C_F = 0.075 / (lg Re - 2)^2`, `S = 1.7 L T + V / T` of each hull.
    """
    L, T = outline.length, outline.draught
    wetted = 1.7 * L * T + outline.hull_mass / (outline.water_density * T)
    reynolds = max(speed * L / VISCOSITY, LEAST_REYNOLDS)
    C_F = 0.075 / (math.log10(reynolds) - 2) ** 2
    C_V = (1 + FORM_FACTOR) * C_F + (ROUGHNESS if outline.is_streamlined else 0.0)
    return outline.hulls * 0.5 * outline.water_density * wetted * C_V * speed**2


def wave_resistance(outline: Outline, speed: float) -> float:
    """Michell's integral (N) for parabolic hulls of the outline's length, beam and draught.

    `R = 4 rho g^2 / (pi U^2) int J^2 sec^3 th dth` with J the integral of the hull's slope over the
    centre plane; demihulls are taken apart (Michell 1898; Newman 1977, section 6.20).
    """
    L, B, T = outline.length, outline.hull_beam, outline.draught
    theta = (np.arange(ANGLES) + 0.5) * 0.5 * math.pi / ANGLES
    secant = 1 / np.cos(theta)
    k = GRAVITY / speed**2 * secant
    depth = k * secant * T
    along = np.sin(0.5 * k * L) / k**2 - 0.5 * L * np.cos(0.5 * k * L) / k
    down = 1 - np.exp(-depth) - (2 - np.exp(-depth) * (depth**2 + 2 * depth + 2)) / depth**2
    J = 8 * B / L**2 * along * T * down / depth
    integral = np.sum(J**2 * secant**3) * 0.5 * math.pi / ANGLES
    one = 4 * outline.water_density * GRAVITY**2 / (math.pi * speed**2) * integral
    return outline.hulls * float(one)


def resistances(outline: Outline, speed: float) -> dict[str, float]:
    """Resistance (N) at a speed (m/s), by method."""
    rubbed = friction(outline, speed)
    smooth = rubbed + wave_resistance(outline, speed)
    if outline.is_streamlined:
        return {FRICTION: rubbed, WAVES: smooth}
    frontal = outline.hulls * outline.hull_beam * outline.draught
    blunt = 0.5 * outline.water_density * frontal * speed**2
    return {BLUNT: blunt, BLUNT_AND_SMOOTH: blunt + smooth}


def linear_share(outline: Outline, speed: float) -> float:
    """Share of the linear part in `X_u u + X_uu u^2` that gives it the slope of the friction.

    `d ln R / d ln U = 2 - share`; ITTC-57 friction has `2 - 2 / (ln(10) (lg Re - 2))`.
    """
    reynolds = max(speed * outline.length / VISCOSITY, LEAST_REYNOLDS)
    return 2 / (math.log(10) * (math.log10(reynolds) - 2))
