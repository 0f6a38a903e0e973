"""The boats' zig-zags in numba: a boat as a scalar loop, boats shared out among threads.

Each switch is located inside its step.
"""

import math

from benchmarks import boats

import numba
import numpy as np
from jaxtyping import Float


ARM, MOST, LEAST, HARD_OVER = boats.ARM, boats.MOST, boats.LEAST, boats.HARD_OVER
compiled = numba.njit(fastmath=True)


@compiled
def rate(s, port, starboard, c):
    """Derivatives of x, y, psi, u, v and r."""
    _, _, psi, u, v, r = s
    m11, m22, per_m11, per_m22, per_m33, X_u, X_uu, Y_v, N_r, N_rr = c
    sine, cosine = math.sin(psi), math.cos(psi)
    surge = m22 * v * r + (X_u + X_uu * abs(u)) * u + port + starboard
    sway = Y_v * v - m11 * u * r
    yaw = (m11 - m22) * u * v + (N_r + N_rr * abs(r)) * r + ARM * (port - starboard)
    return (u * cosine - v * sine, u * sine + v * cosine, r,
            surge * per_m11, sway * per_m22, yaw * per_m33)  # fmt: skip


@compiled
def moved(s, k, dt):
    """The state after `dt` s at the rates k."""
    return (s[0] + dt * k[0], s[1] + dt * k[1], s[2] + dt * k[2],
            s[3] + dt * k[3], s[4] + dt * k[4], s[5] + dt * k[5])  # fmt: skip


@compiled
def step(s, thrusts, to, dt, half, c):
    """A Runge-Kutta step; `half` is what the lag leaves of a deviation after half of it."""
    off = thrusts[0] - to[0], thrusts[1] - to[1]
    there = to[0] + off[0] * half, to[1] + off[1] * half
    then = to[0] + off[0] * half * half, to[1] + off[1] * half * half
    k1 = rate(s, thrusts[0], thrusts[1], c)
    k2 = rate(moved(s, k1, 0.5 * dt), there[0], there[1], c)
    k3 = rate(moved(s, k2, 0.5 * dt), there[0], there[1], c)
    k4 = rate(moved(s, k3, dt), then[0], then[1], c)
    s = moved(moved(moved(moved(s, k1, dt / 6), k2, dt / 3), k3, dt / 3), k4, dt / 6)
    return s, then


@compiled
def targets(thrust, side, angle):
    """Thrusts ordered of port and starboard."""
    share = side * angle / HARD_OVER
    return (min(max(thrust * (1 + share), LEAST), MOST),
            min(max(thrust * (1 - share), LEAST), MOST))  # fmt: skip


@compiled
def zigzag(row, steps, dt, angle, check, final, switches):
    """One boat: fill its last state and the times (s) of its switches."""
    mass, I_z, X_udot, Y_vdot, N_rdot, X_u, X_uu, Y_v, N_r, N_rr, thrust, lag, speed = row
    m11, m22 = mass - X_udot, mass - Y_vdot
    c = (m11, m22, 1 / m11, 1 / m22, 1 / (I_z - N_rdot), X_u, X_uu, Y_v, N_r, N_rr)
    s, thrusts = (0.0, 0.0, 0.0, speed, 0.0, 0.0), (thrust, thrust)
    side, count, half = 1.0, 0, math.exp(-dt / (2 * lag))
    to = targets(thrust, side, angle)
    for n in range(steps):
        after, then = step(s, thrusts, to, dt, half, c)
        if side * after[2] >= check:
            first, last = side * s[2] - check, side * after[2] - check
            at = dt * first / (first - last)
            for _ in range(3):
                there, _ = step(s, thrusts, to, at, math.exp(-at / (2 * lag)), c)
                at -= (side * there[2] - check) / (side * there[5])
            s, thrusts = step(s, thrusts, to, at, math.exp(-at / (2 * lag)), c)
            side, rest = -side, dt - at
            to = targets(thrust, side, angle)
            after, then = step(s, thrusts, to, rest, math.exp(-rest / (2 * lag)), c)
            switches[count] = n * dt + at
            count += 1
        s, thrusts = after, then
    for j in range(6):
        final[j] = s[j]


@numba.njit(fastmath=True, parallel=True)
def zigzags(rows, steps, dt, angle, check, final, switches):
    """All boats: `final` is (state, boat), `switches` (boat, execute)."""
    for i in numba.prange(rows.shape[1]):
        row = (
            rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], rows[5, i], rows[6, i],
            rows[7, i], rows[8, i], rows[9, i], rows[10, i], rows[11, i], rows[12, i],
        )  # fmt: skip
        zigzag(row, steps, dt, angle, check, final[:, i], switches[i])


def run(rows: boats.Rows) -> tuple[Float[np.ndarray, "6 boat"], Float[np.ndarray, "boat execute"]]:
    """Last states, and times (s) of the switches, NaN for none; by every core."""
    final = np.zeros((6, rows.shape[1]))
    switches = np.full((rows.shape[1], boats.EXECUTES), np.nan)
    zigzags(rows, boats.STEPS, boats.STEP, boats.ANGLE, boats.CHECK, final, switches)
    return final, switches
