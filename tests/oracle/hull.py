"""Rigid body, added mass and damping of the hull, in Kirchhoff's momentum form.

With the velocity through the water (u, v, r) and the kinetic energy of hull and water
T = 1/2 (m11 u^2 + m22 v^2 + 2 m23 v r + m33 r^2), the impulse is

    p_x = dT/du = m11 u          [N s]
    p_y = dT/dv = m22 v + m23 r  [N s]
    p_n = dT/dr = m23 v + m33 r  [N m s]

and Kirchhoff's equations in axes that turn with r and translate with (u, v) read

    d p_x/dt = X + r p_y,   d p_y/dt = Y - r p_x,   d p_n/dt = N - (u p_y - v p_x).

    m11 = m - X_udot,  m22 = m - Y_vdot,  m33 = I_z + m x_G^2 - N_rdot   [kg, kg, kg m^2]
    m23 = m x_G - a,   a = (Y_rdot + N_vdot) / 2                          [kg m]

In Fossen's notation the right-hand terms are -C(nu) nu with C = C_RB + C_A, where
C_A nu = [ (Y_vdot v + a r) r, -X_udot u r, -(Y_vdot v + a r) u + X_udot u v ].
A steady uniform irrotational current leaves these equations as they are in relative velocities.
Where Y_rdot and N_vdot differ, the inertia matrix keeps both; the momentum takes their mean.
"""

from __future__ import annotations

import math
import re


DERIVATIVE = re.compile(r"^([XYN])_([uvr]+)$")
WATER_DENSITY = 1025.0  # kg/m^3


def inertia(hull: dict) -> list[list[float]]:
    """M = M_RB + M_A about amidships, SNAME signs (a negative X_udot adds mass)."""
    m, x_g = hull["mass"], hull.get("x_G", 0.0)
    a = {k: hull.get(k, 0.0) for k in ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")}
    return [
        [m - a["X_udot"], 0.0, 0.0],
        [0.0, m - a["Y_vdot"], m * x_g - a["Y_rdot"]],
        [0.0, m * x_g - a["N_vdot"], hull["I_z"] + m * x_g**2 - a["N_rdot"]],
    ]


def loaded(M, loads) -> list[list[float]]:
    """M with point masses more, each (kg, m forward of amidships)."""
    mass, first, second = (sum(m * x**k for m, x in loads) for k in range(3))
    return [
        [M[0][0] + mass, 0.0, 0.0],
        [0.0, M[1][1] + mass, M[1][2] + first],
        [M[2][0], M[2][1] + first, M[2][2] + second],
    ]


def impulse(M, u: float, v: float, r: float) -> tuple[float, float, float]:
    """(p_x, p_y, p_n) in body axes, from the symmetric part of M."""
    m23 = 0.5 * (M[1][2] + M[2][1])
    return M[0][0] * u, M[1][1] * v + m23 * r, m23 * v + M[2][2] * r


def momentum_force(M, u: float, v: float, r: float) -> tuple[float, float, float]:
    """-C(nu) nu: (r p_y, -r p_x, v p_x - u p_y) in N, N, N m."""
    px, py, _ = impulse(M, u, v, r)
    return r * py, -r * px, v * px - u * py


def solve_inertia(M, X: float, Y: float, N: float) -> tuple[float, float, float]:
    """nu_dot of M nu_dot = (X, Y, N): surge alone, sway and yaw by Cramer's rule."""
    (b, c), (d, e) = M[1][1:], M[2][1:]
    det = b * e - c * d
    return X / M[0][0], (e * Y - c * N) / det, (b * N - d * Y) / det


def damping_terms(hull: dict) -> list[tuple]:
    """Derivative names as (degree of freedom, value, powers of u, v, r, letter with modulus).

    The value multiplies the product of the letters. A modulus keeps a force odd where that
    would be even: in Y and N when v and r occur an even number of times, at least two (on the
    first of them: Y_vr |v| r, Y_rv |r| v); in X for an even number of u alone (X_uu |u| u).
    """
    terms = []
    for name, value in hull.items():
        match = DERIVATIVE.match(name)
        if not match or value == 0.0:
            continue
        axis, letters = match.groups()
        lateral = [c for c in letters if c != "u"]
        if axis == "X":
            modulus = "u" if not lateral and len(letters) % 2 == 0 else ""
        else:
            modulus = lateral[0] if lateral and len(lateral) % 2 == 0 else ""
        powers = tuple(letters.count(c) for c in "uvr")
        terms.append(("XYN".index(axis), float(value), *powers, "uvr".find(modulus or "-")))
    return terms


def damping(terms, u: float, v: float, r: float) -> list[float]:
    """Sum of the derivative terms [N, N, N m]; |z| z is written as sign(z) z z."""
    force, nu = [0.0, 0.0, 0.0], (u, v, r)
    for axis, value, a, b, c, modulus in terms:
        term = value
        if a:
            term *= u if a == 1 else u**a
        if b:
            term *= v if b == 1 else v**b
        if c:
            term *= r if c == 1 else r**c
        if modulus >= 0:
            term = math.copysign(1.0, nu[modulus]) * term
        force[axis] += term
    return force


def crossflow_integrals(v: float, r: float, half: float) -> tuple[float, float]:
    """(int |w| w dx, int x |w| w dx) over |x| <= half with w = v + x r, exact.

    With w^2 = v^2 + 2 v r x + r^2 x^2 the antiderivatives are
    F = v^2 x + v r x^2 + r^2 x^3 / 3 and G = v^2 x^2/2 + 2 v r x^3/3 + r^2 x^4/4;
    the interval splits at the pivot x0 = -v/r, where w changes sign.
    """
    if abs(v) >= abs(r) * half:
        s = math.copysign(1.0, v)
        return s * (2 * v * v * half + 2 * r * r * half**3 / 3), s * 4 * v * r * half**3 / 3

    def F(x):
        return x * (v * v + x * (v * r + x * r * r / 3))

    def G(x):
        return x * x * (v * v / 2 + x * (2 * v * r / 3 + x * r * r / 4))

    x0, s = -v / r, math.copysign(1.0, r)  # w has the sign of r forward of the pivot
    return (
        s * (F(half) - 2 * F(x0) + F(-half)),
        s * (G(half) - 2 * G(x0) + G(-half)),
    )


def crossflow(hull: dict, cd: float, v: float, r: float) -> tuple[float, float]:
    """Strip-theory drag (Y, N) = -1/2 rho cd T int (1, x) |v + x r| (v + x r) dx  [N, N m]."""
    rho = hull.get("water_density", WATER_DENSITY)
    k = -0.5 * rho * cd * hull["draught"]
    y, n = crossflow_integrals(v, r, 0.5 * hull["length"])
    return k * y, k * n


def kinetic_energy(M, u: float, v: float, r: float) -> float:
    """T = 1/2 nu' M nu  [J]."""
    px, py, pn = impulse(M, u, v, r)
    return 0.5 * (px * u + py * v + pn * r)
