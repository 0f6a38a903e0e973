"""The boats' zig-zags by diffrax: steps of a fixed length, switches at the first sample beyond.

diffrax has no classical Runge-Kutta method; its tableau is given. Thrusts answer by their own
differential equation, as one would write it there.
"""

from typing import Any, ClassVar

from benchmarks import boats

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import AbstractERK, ButcherTableau, ODETerm
from jaxtyping import Array, Float, PyTree


TABLEAU = ButcherTableau(
    c=np.array([0.5, 0.5, 1.0]),
    b_sol=np.array([1, 2, 2, 1]) / 6,
    b_error=np.zeros(4),  # steps are fixed
    a_lower=(np.array([0.5]), np.array([0.0, 0.5]), np.array([0.0, 0.0, 1.0])),
)


class ClassicalRungeKutta(AbstractERK):
    """Of order four, in four stages."""

    tableau: ClassVar[ButcherTableau] = TABLEAU
    interpolation_cls = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

    def order(self, terms: object) -> int:
        """Of the method."""
        return 4


def _rate(t: Any, s: PyTree, args: PyTree) -> tuple:
    """Derivatives of x, y, psi, u, v, r and both thrusts, under ordered thrusts."""
    p, to_port, to_starboard = args
    mass, I_z, X_udot, Y_vdot, N_rdot, X_u, X_uu, Y_v, N_r, N_rr, _, lag, _ = p
    m11, m22, m33 = mass - X_udot, mass - Y_vdot, I_z - N_rdot
    _, _, psi, u, v, r, port, starboard = s
    sine, cosine = jnp.sin(psi), jnp.cos(psi)
    surge = m22 * v * r + (X_u + X_uu * jnp.abs(u)) * u + port + starboard
    sway = Y_v * v - m11 * u * r
    yaw = (m11 - m22) * u * v + (N_r + N_rr * jnp.abs(r)) * r + boats.ARM * (port - starboard)
    return (u * cosine - v * sine, u * sine + v * cosine, r, surge / m11, sway / m22, yaw / m33,
            (to_port - port) / lag, (to_starboard - starboard) / lag)  # fmt: skip


def zigzag(p: Float[Array, "13"]) -> tuple[Float[Array, "6"], Float[Array, "execute"]]:
    """Last x, y, psi, u, v, r of a boat and times (s) of its switches; p as `boats.PARAMETERS`."""
    solver, term = ClassicalRungeKutta(), ODETerm(_rate)
    thrust, speed = p[10], p[12]

    def step(carry: tuple, t: Array) -> tuple[tuple, None]:
        state, side, count, times = carry
        share = side * boats.ANGLE / boats.HARD_OVER
        ordered = (jnp.clip(thrust * (1 + k), boats.LEAST, boats.MOST) for k in (share, -share))
        args, after = (p, *ordered), t + boats.STEP
        memory = solver.init(term, t, after, state, args)
        state, *_ = solver.step(term, t, after, state, args, memory, made_jump=False)
        passed = side * state[2] >= boats.CHECK
        here = passed & (jnp.arange(boats.EXECUTES) == count)
        times = jnp.where(here, after, times)
        return (state, jnp.where(passed, -side, side), count + passed, times), None

    zero = jnp.zeros_like(speed)
    begin = (zero, zero, zero, speed, zero, zero, thrust, thrust)
    none = jnp.full(boats.EXECUTES, jnp.nan)
    carry = (begin, zero + 1, jnp.zeros((), int), none)
    (state, _, _, times), _ = jax.lax.scan(step, carry, boats.STEP * jnp.arange(boats.STEPS))
    return jnp.stack(state[:6]), times
