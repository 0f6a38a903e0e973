"""Route tracking by state feedback, rudder compensation and output limits (eqs. 8 to 16, Table 1).

Surge on its own and sway with yaw on their own: in eqs. 9 to 11 they do not act on each other.
Taken otherwise than printed: eq. 11 leaves out the rudder's yaw moment b_r_delta, without which
no gain steadies a course; eq. 16 adds F K c_v to an order of -F x, which turns the ship with the
disturbance, so its sign is reversed. Weights are not published.
"""

from experiments.unberthing.gradient_model import Linear, derivatives, discrete, steady_blades
from experiments.unberthing.harbour_route import Place
from experiments.unberthing.harbour_ship import DEGREE, KNOT, PERIOD

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea import Vessel
from diffsea.simulation.control import discrete_lqr
from diffsea.types import Scalar


BIAS_GAIN = 16.0  # K of eq. 16, published
SPEED_RATE = 0.05 * KNOT  # m/s per s, published
BLADE_LIMITS = (11 * DEGREE, 9 * DEGREE)  # bow, stern, published
BLADE_RATE, PROPELLER_RATE = 2 * DEGREE, 0.25 * DEGREE  # rad/s, published
FARTHEST = 10.0  # m: a longer way to the line is met no harder; chosen

# Bryson's rule: so much of each is equally bad; chosen, the same for every control system.
WORST_SURGE = (0.2, 6.0, 6 * DEGREE)  # m/s, X_d in m, propeller blades in rad
WORST = (0.5, 2.0 * DEGREE, 4.0, 5 * DEGREE)  # v in m/s, r in rad/s, Y_d in m, psi_d in rad
WORST_BLADES = (25 * DEGREE, *(0.3 * limit for limit in BLADE_LIMITS))  # rudder, bow, stern, rad

HORIZON = 12  # doublings of Riccati's equation: 2^12 periods, half an hour


class Weights(eqx.Module):
    """Diagonals of Q on (v, r, Y_d, psi_d) and of R on (rudder, bow, stern)."""

    Q: Float[Array, "4"]
    R: Float[Array, "3"]


def bryson(worst: tuple = WORST, blades: tuple = WORST_BLADES) -> Weights:
    """Weights by which these deviations and angles are equally bad."""
    return Weights(jnp.array(worst) ** -2.0, jnp.array(blades) ** -2.0)


class Surge(eqx.Module):
    """Gains on surge speed error and X_d, fixed beforehand from the nominal ship (rad per unit)."""

    sideways: Float[Array, "2"]
    ahead: Float[Array, "2"]
    steady: Scalar  # rad per (m/s)^2 that keep a speed


@jax.jit
def surge_gains(vessel: Vessel) -> Surge:
    """The surge part of eqs. 9 and 10, about 1.5 kn; the paper takes its own from earlier work."""
    speed = 1.5 * KNOT
    theta_P = steady_blades(vessel, speed)
    A, B = derivatives(vessel, jnp.asarray(speed), theta_P)
    bad, R = jnp.array(WORST_SURGE[:2]), jnp.eye(1) / WORST_SURGE[2] ** 2
    phi, gamma = discrete(jnp.array([[A[0, 0], 0.0], [1.0, 0.0]]), jnp.array([[B[0, 0]], [0.0]]))
    both = discrete_lqr(phi, gamma, jnp.diag(1 / bad**2), R)[0]
    alone = discrete_lqr(phi[:1, :1], gamma[:1], jnp.eye(1) / bad[0] ** 2, R)[0]
    return Surge(both, jnp.append(alone, 0.0), theta_P / speed**2)


def lateral_gain(
    model: Linear, speed: Scalar, leaving: Bool[Array, ""], weights: Weights
) -> Float[Array, "3 4"]:
    """Gain of (rudder, bow, stern) on (v, r, Y_d, psi_d) for the model of this period.

    The drift of Y_d with heading, U_l psi_d, is in eq. 11 and not in eqs. 9 and 10.
    """
    inputs = model.inputs * jnp.where(leaving, jnp.array([1, 0, 0]), jnp.array([0, 1, 1]))
    drift = jnp.where(leaving, PERIOD * speed, 0.0)
    kinematics = jnp.array([[PERIOD, 0.0, 1.0, 0.0], [0.0, PERIOD, 0.0, 1.0]]).at[0, 3].set(drift)
    upper = jnp.concatenate([model.transition, jnp.zeros((2, 2))], axis=1)
    A = jnp.concatenate([upper, kinematics])
    B = jnp.concatenate([inputs, jnp.zeros((2, 3))])
    return discrete_lqr(A, B, jnp.diag(weights.Q), jnp.diag(weights.R), HORIZON)


def demanded(
    at: Place,
    motion: Float[Array, "3"],
    wanted_speed: Scalar,
    surge: Surge,
    gain: Float[Array, "3 4"],
    step: Scalar,
) -> Float[Array, "4"]:
    """Blade and rudder angles of eq. 12, before limits; `motion` is (u, v, r) as filtered."""
    u, v, r = motion
    along = jnp.where(step == 1, surge.sideways, surge.ahead)
    theta_P = surge.steady * wanted_speed**2 - along @ jnp.stack([u - wanted_speed, at.X_d])
    Y_d = jnp.clip(at.Y_d, -FARTHEST, FARTHEST)
    lateral = -gain @ jnp.stack([v, r - at.curvature * u, Y_d, at.psi_d])
    return jnp.append(theta_P, lateral)


def compensation(gain: Float[Array, "3 4"], bias: Scalar) -> Scalar:
    """Rudder angle (rad) that turns the ship against a steady sway `bias` (eq. 16)."""
    return -gain[0, 3] * BIAS_GAIN * bias


def limited(
    wanted: Float[Array, "4"], last: Float[Array, "4"], speed: Scalar, leaving: Bool[Array, ""]
) -> Float[Array, "4"]:
    """Orders within Table 1 and section 3.5; rudder or thrusters are at rest by phase.

    The propeller's second range is taken to hold from 4 kn on.
    """
    knots = speed / KNOT
    fast = knots >= 4.0
    low = jnp.where(fast, 1.2, -4.0) * DEGREE
    high = jnp.where(fast, 8.7, 6.0) * DEGREE
    rudder = (35.0 - 5.0 * jnp.clip(jnp.floor(knots) - 3.0, 0.0, 5.0)) * DEGREE
    lower = jnp.stack([low, -rudder * leaving, *(-b * ~leaving for b in BLADE_LIMITS)])
    upper = jnp.stack([high, rudder * leaving, *(b * ~leaving for b in BLADE_LIMITS)])
    change = PERIOD * jnp.array([PROPELLER_RATE, jnp.inf, BLADE_RATE, BLADE_RATE])
    return jnp.clip(jnp.clip(wanted, lower, upper), last - change, last + change)
