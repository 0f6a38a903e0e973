"""Hydrodynamic forces on the hull: derivative sets, cross-flow drag, heel, and their changes."""

import re
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from diffsea.kinematics import through_water
from diffsea.scales import is_absent
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import AbstractDependentForce, Forces, Vessel
from diffsea.vessel.forces import AbstractForce, Force, step


def is_derivative(name: str) -> bool:
    """Whether `name` is a hull derivative such as `X_u`, `Y_vvr` or `N_0`."""
    return re.fullmatch(r"[XYN]_(0|[uvr]+)", name) is not None


def is_rudder_derivative(name: str) -> bool:
    """Whether `name` is a derivative with the rudder angle d, such as `N_d` or `Y_vvd`."""
    return re.fullmatch(r"[XYN]_[uvr]*d[uvrd]*", name) is not None


def monomial(
    axis: str, letters: str, values: dict[str, Scalar], u_is_deviation: bool = False
) -> Scalar:
    """What a derivative multiplies: the product of its letters, with a modulus by symmetry.

    A hull that is the same to port and to starboard has Y and N odd in the transverse
    letters (v, r, d) and drag odd in u. Where the plain product has the wrong parity the
    first letter is taken in modulus: `Y_vv` is |v| v, `N_vr` |v| r, `X_uu` |u| u, while
    `Y_ur` is u r, `X_vv` v^2 and `Y_vvv` v^3 (SNAME 1950, Abkowitz 1964). Where u is the
    deviation from a reference speed, drag has no symmetry in it and `X_uu` is u^2.
    """
    if letters == "0":
        return 1.0
    transverse = sum(letter in "vrd" for letter in letters)
    if axis in "YN":
        wrong = transverse > 0 and transverse % 2 == 0
    else:
        wrong = transverse == 0 and len(letters) % 2 == 0 and not u_is_deviation
    product = jnp.abs(values[letters[0]]) if wrong else values[letters[0]]
    for letter in letters[1:]:
        product = product * values[letter]
    return product


def polynomial_force(
    derivatives: dict[str, Scalar], values: dict[str, Scalar], u_is_deviation: bool = False
) -> Force:
    """Sum of derivative times monomial on each axis."""
    sums: dict[str, Scalar] = {"X": 0.0, "Y": 0.0, "N": 0.0}
    for name, coefficient in derivatives.items():
        axis, letters = name.split("_")
        sums[axis] = sums[axis] + coefficient * monomial(axis, letters, values, u_is_deviation)
    return Force(**sums)


class Damping(AbstractForce):
    """Any subset of dimensional SNAME derivatives: N and N m per unit of motion.

    `tau = sum_k D_k m_k(u_r, v_r, r)` with the monomials of `monomial` (Fossen 2021,
    section 6.4). `X_u` is negative for drag.

    `exponents` turn `X_u`, `Y_v` or `N_r` into a power law: with `a` for `X_u` the force is
    `X_u sign(u) |u|^a`, in N per (m/s)^a.
    """

    resists: ClassVar[bool] = True
    derivatives: dict[str, Scalar]
    exponents: dict[str, Scalar] = eqx.field(default_factory=dict)

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        water = through_water(state, environment)
        motion = {"u": water.u, "v": water.v, "r": water.r}
        plain = {n: d for n, d in self.derivatives.items() if n not in self.exponents}
        made = polynomial_force(plain, motion)
        for name, exponent in self.exponents.items():
            axis, letter = name.split("_")
            power = signed_power(motion[letter], exponent)
            made = made + Force(**{axis: self.derivatives[name] * power})
        return made


POWERS = ("X_u", "Y_v", "N_r")  # derivatives that may be power laws


def signed_power(x: Scalar, exponent: Scalar) -> Scalar:
    """`sign(x) |x|^exponent`; exactly `x` for an exponent of one.

    Below an exponent of one its slope at zero is infinite. Here it is linear within about 1e-6
    of zero instead, so that derivatives by `x` and by the exponent are finite everywhere.
    """
    return x * (x**2 + 1e-12) ** (0.5 * (exponent - 1))


class Scaling(eqx.Module):
    """Reference quantities that make a non-dimensional ("prime") set dimensional.

    Force = 1/2 rho A U^2 sum(D' m'), moment the same times L, velocities divided by U and
    yaw rate by U / L. A is L T in MMG sets (Yasukawa and Yoshimura 2015, eq. 6), L^2 in
    Abkowitz sets, whose letter u is the deviation from `reference_speed` (Chislett and
    Stroem-Tejsen 1965).
    """

    kind: str = eqx.field(static=True)  # "mmg" or "abkowitz"
    length: Scalar  # m
    draught: Scalar  # m
    water_density: Scalar  # kg/m^3
    reference_speed: Scalar = 0.0  # m/s

    def force(self, derivatives: dict[str, Scalar], water: State, delta: Scalar = 0.0) -> Force:
        """Dimensional force of a prime set at this motion (and rudder angle, rad)."""
        # The small constant keeps the square root differentiable at rest.
        speed = jnp.sqrt(water.u**2 + water.v**2 + 1e-12)
        letters = {
            "u": (water.u - self.reference_speed) / speed,
            "v": water.v / speed,
            "r": water.r * self.length / speed,
            "d": delta,
        }
        prime = polynomial_force(derivatives, letters, self.kind == "abkowitz")
        width = self.draught if self.kind == "mmg" else self.length
        unit = 0.5 * self.water_density * self.length * width * speed**2
        return Force(unit * prime.X, unit * prime.Y, unit * self.length * prime.N)


class PrimeDamping(AbstractForce):
    """A non-dimensional derivative set (MMG or Abkowitz), see `Scaling`."""

    resists: ClassVar[bool] = True
    derivatives: dict[str, Scalar]
    scaling: Scaling

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        return self.scaling.force(self.derivatives, through_water(state, environment))


class CrossFlowDrag(AbstractForce):
    """Drag of the cross-flow along the hull, strip theory with one coefficient.

    `dY = -1/2 rho C_d T |v_r + x r| (v_r + x r) dx` over the length, `dN = x dY`
    (Faltinsen 1990; Fossen 2021, eq. 6.91). The integral is in closed form.
    """

    resists: ClassVar[bool] = True
    cd: Scalar  # drag coefficient of a section
    length: Scalar  # m
    draught: Scalar  # m
    water_density: Scalar  # kg/m^3

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        water = through_water(state, environment)
        sway, yaw = _cross_flow_integrals(water.v, water.r, 0.5 * self.length)
        unit = -0.5 * self.water_density * self.draught * self.cd
        return Force(0.0, unit * sway, unit * yaw)


class RollCoupling(AbstractForce):
    """Sway force and yaw moment of the recorded heel."""

    Y_phi: Scalar = 0.0  # N/rad
    N_phi: Scalar = 0.0  # N m/rad

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        heel = environment.disturbance.heel
        return Force(0.0, self.Y_phi * heel, self.N_phi * heel)


class ShallowDamping(AbstractDependentForce):
    """What shallow water adds to the hull's resistance.

    With q = T / h, surge is multiplied by `(1 - q)^(-1/4)`, sway and yaw by `(1 - q)^(-1)`:
    twice the lateral damping at h = 2 T and three times at 1.5 T.
    """

    part_of: ClassVar[str] = "resistance"

    def __call__(
        self, vessel: Vessel, forces: Forces, water: State, environment: Environment, t: Scalar
    ) -> Force:
        if is_absent(environment.shallowness):
            return Force()
        along = jnp.expm1(0.25 * environment.shallowness)
        across = jnp.expm1(environment.shallowness)
        drag = vessel.sum_of_part(forces, "resistance")
        return Force(along * drag.X, across * drag.Y, across * drag.N)


class Change(AbstractDependentForce):
    """A change of the hull's resistance, or of thrusts, from one time on."""

    factor: Scalar  # relative: 0.2 is a fifth more
    time: Scalar  # s, on the run's clock
    part: str = eqx.field(static=True)  # "resistance" or "thrust"
    shares: Mapping[str, Scalar] | None = None  # that change, of single propulsors; None: all of it
    in_surge: bool = eqx.field(static=True, default=False)  # whether nothing else changes

    def __call__(
        self, vessel: Vessel, forces: Forces, water: State, environment: Environment, t: Scalar
    ) -> Force:
        changed = vessel.sum_of_part(forces, self.part)
        if self.shares is not None:
            changed = sum((forces[n] * share for n, share in self.shares.items()), Force())
        if self.in_surge:
            changed = Force(changed.X, 0.0, 0.0)
        return changed * (self.factor * step(t, self.time, vessel.rigid_body.length))


@jax.custom_jvp
def _cross_flow_integrals(v: Scalar, r: Scalar, half: Scalar) -> tuple[Scalar, Scalar]:
    """Integrals of |w| w and x |w| w over [-half, half] with w = v + x r.

    With ends a = v - r half and b = v + r half: (|b|^3 - |a|^3) / (3 r), and so on. Those
    forms cancel at small r, where the sign of w is the same everywhere and the integrals
    are polynomials; so both are used, each where it is exact.
    """
    reach = jnp.abs(r) * half
    uniform = jnp.abs(v) >= reach
    sway_uniform = jnp.sign(v) * (2 * half * v**2 + 2 / 3 * r**2 * half**3)
    yaw_uniform = jnp.sign(v) * (4 / 3) * v * r * half**3
    safe = jnp.where(uniform, 1.0, r)
    a, b = v - safe * half, v + safe * half
    cubes = (jnp.abs(b) ** 3 - jnp.abs(a) ** 3) / 3
    fourths = (jnp.abs(b) ** 3 * b - jnp.abs(a) ** 3 * a) / 4
    sway_split = cubes / safe
    yaw_split = (fourths - v * cubes) / safe**2
    return (
        jnp.where(uniform, sway_uniform, sway_split),
        jnp.where(uniform, yaw_uniform, yaw_split),
    )


@_cross_flow_integrals.defjvp
def _cross_flow_integrals_jvp(primals, tangents):
    """d/dv and d/dr are integrals of 2 |w| and 2 x |w|, smooth where the branches meet."""
    v, r, half = primals
    v_dot, r_dot, half_dot = tangents
    zeroth, first, second = _modulus_moments(v, r, half)
    a, b = v - r * half, v + r * half
    out = _cross_flow_integrals(v, r, half)
    sway_dot = 2 * (zeroth * v_dot + first * r_dot)
    yaw_dot = 2 * (first * v_dot + second * r_dot)
    ends = jnp.abs(b) * b + jnp.abs(a) * a, half * (jnp.abs(b) * b - jnp.abs(a) * a)
    return out, (sway_dot + ends[0] * half_dot, yaw_dot + ends[1] * half_dot)


def _modulus_moments(v: Scalar, r: Scalar, half: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Integrals of |w|, x |w| and x^2 |w| over [-half, half] with w = v + x r."""
    sign = jnp.sign(v)
    uniform = jnp.abs(v) >= jnp.abs(r) * half
    # Where w changes sign at x0 = -v / r, twice the part beyond x0 is flipped.
    safe = jnp.where(uniform, 1.0, r)
    x0 = jnp.where(uniform, 0.0, -v / safe)

    def antiderivative(x: Scalar, power: int) -> Scalar:
        return v * x ** (power + 1) / (power + 1) + r * x ** (power + 2) / (power + 2)

    def moment(power: int) -> Scalar:
        low, high = antiderivative(-half, power), antiderivative(half, power)
        split = jnp.sign(r) * (high + low - 2 * antiderivative(x0, power))
        return jnp.where(uniform, sign * (high - low), split)

    return moment(0), moment(1), moment(2)
