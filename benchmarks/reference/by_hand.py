"""One boat in JAX as one would write it for this boat alone: no names, no parts, no options."""

from benchmarks import boats

import jax
import jax.numpy as jnp
from jax.nn import relu
from jaxtyping import Array, Float


def switch_times(p: Float[Array, "13"]) -> Float[Array, "execute"]:
    """Times (s) of the switches of one boat's zig-zag, NaN for none; p as `boats.PARAMETERS`."""
    return _zigzag(p)[1]


def final_state(p: Float[Array, "13"]) -> Float[Array, "8"]:
    """x, y, psi, u, v, r and the thrusts of both sides after the last step."""
    return jnp.stack(_zigzag(p)[0])


def _zigzag(p: Float[Array, "13"]) -> tuple[tuple, Float[Array, "execute"]]:
    mass, I_z, X_udot, Y_vdot, N_rdot, X_u, X_uu, Y_v, N_r, N_rr, thrust, lag, speed = p
    m11, m22, m33 = mass - X_udot, mass - Y_vdot, I_z - N_rdot
    per_m11, per_m22, per_m33, munk = 1 / m11, 1 / m22, 1 / m33, m11 - m22

    def rate(s, port, starboard):
        _, _, psi, u, v, r = s
        sine, cosine = jnp.sin(psi), jnp.cos(psi)
        surge = m22 * v * r + (X_u + X_uu * jnp.abs(u)) * u + port + starboard
        sway = Y_v * v - m11 * u * r
        yaw = munk * u * v + (N_r + N_rr * jnp.abs(r)) * r + boats.ARM * (port - starboard)
        return (u * cosine - v * sine, u * sine + v * cosine, r,
                surge * per_m11, sway * per_m22, yaw * per_m33)  # fmt: skip

    def clipped(force):
        return boats.MOST - relu(boats.MOST - (boats.LEAST + relu(force - boats.LEAST)))

    def step(state, side, dt, half):
        *s, port, starboard = state
        share = side * boats.ANGLE / boats.HARD_OVER
        to_port, to_starboard = clipped(thrust * (1 + share)), clipped(thrust * (1 - share))
        a, b = port - to_port, starboard - to_starboard
        forces = [(to_port + a * left, to_starboard + b * left) for left in (half, half * half)]
        moved = lambda k, dt: [x + dt * d for x, d in zip(s, k, strict=True)]
        k1 = rate(s, port, starboard)
        k2 = rate(moved(k1, 0.5 * dt), *forces[0])
        k3 = rate(moved(k2, 0.5 * dt), *forces[0])
        k4 = rate(moved(k3, dt), *forces[1])
        mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        return (*moved(mean, dt), *forces[1])

    def left_after_half(dt):
        return jnp.exp(-0.5 * dt / lag)

    def located(state, after, side, dt):
        """Time to the switch: the secant's, and Newton's corrections of it, the last one exact."""
        hold = jax.lax.stop_gradient
        first, last = side * state[2] - boats.CHECK, side * after[2] - boats.CHECK
        to = hold(dt * first / (first - last))
        for _ in range(3):
            there = step(state, side, to, left_after_half(to))
            to = hold(to) - (side * there[2] - boats.CHECK) / hold(side * there[5])
        return to

    grid = left_after_half(boats.STEP)

    def body(carry, t):
        state, side, count, times = carry
        after = step(state, side, boats.STEP, grid)

        def switched(_):
            to = located(state, after, side, boats.STEP)
            there = step(state, side, to, left_after_half(to))
            rest = boats.STEP - to
            return (
                step(there, -side, rest, left_after_half(rest)),
                -side,
                count + 1,
                times.at[count].set(t + to),
            )

        passed = side * after[2] >= boats.CHECK
        return jax.lax.cond(passed, switched, lambda _: (after, side, count, times), None), None

    zero = jnp.zeros_like(speed)
    start = (zero, zero, zero, speed, zero, zero, thrust, thrust)
    times = jnp.full(boats.EXECUTES, jnp.nan)
    carry = (start, zero + 1, jnp.zeros((), int), times)
    (state, _, _, times), _ = jax.lax.scan(body, carry, boats.STEP * jnp.arange(boats.STEPS))
    return state, times
