"""The craft's equations in NumPy, all runs side by side; no part of the library.

    m11 u' = T_p + T_s + m22 v r + X_u u + X_uu |u| u
    m22 v' = -m11 u r + Y_v v
    m33 r' = -(y_p T_p + y_s T_s) - (m22 - m11) u v + N_r r + N_rr |r| r

with m11 = m - X_udot, m22 = m - Y_vdot, m33 = I_z - N_rdot. Runge-Kutta steps of order four, one
for each row, thrust held over the row.
"""

from experiments.fit_benchmark.data import NAMES, SIGMA, Data

import numpy as np


def coefficients(data: Data, values: np.ndarray) -> tuple:
    """m11, m22, m33, X_u, X_uu, Y_v, N_r, N_rr from derivatives (parameter, ...)."""
    X_udot, Y_vdot, N_rdot, *damping = values
    mass, I_z = data.hull["mass"], data.hull["I_z"]
    return mass - X_udot, mass - Y_vdot, I_z - N_rdot, *damping


def rate(state: np.ndarray, push: tuple, c: tuple) -> np.ndarray:
    """Time derivative of the state (6, ...) under `push`, force (N) and moment (N m)."""
    m11, m22, m33, X_u, X_uu, Y_v, N_r, N_rr = c
    _, _, psi, u, v, r = state
    cos, sin = np.cos(psi), np.sin(psi)
    out = np.empty_like(state)
    out[0] = u * cos - v * sin
    out[1] = u * sin + v * cos
    out[2] = r
    out[3] = (push[0] + m22 * v * r + (X_u + X_uu * np.abs(u)) * u) / m11
    out[4] = (Y_v * v - m11 * u * r) / m22
    out[5] = (push[1] + (m11 - m22) * u * v + (N_r + N_rr * np.abs(r)) * r) / m33
    return out


def pushes(data: Data) -> tuple[np.ndarray, np.ndarray]:
    """Force (N) and moment (N m) of the thrusters, (row, run)."""
    port, starboard = data.thrust[..., 0].T, data.thrust[..., 1].T
    return port + starboard, -(data.arms[0] * port + data.arms[1] * starboard)


def simulate(data: Data, values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """States (row, 6, run, ...) from first states (6, run, ...) and derivatives (8, ...)."""
    c = coefficients(data, values)
    force, moment = pushes(data)
    extra = (None,) * (first.ndim - 2)
    h, state = data.dt, np.array(first, float)
    out = np.empty((len(data.t), *state.shape))
    out[0] = state
    for k in range(len(data.t) - 1):
        push = force[k][(..., *extra)], moment[k][(..., *extra)]
        a = rate(state, push, c)
        b = rate(state + 0.5 * h * a, push, c)
        d = rate(state + 0.5 * h * b, push, c)
        e = rate(state + h * d, push, c)
        state = state + h / 6 * (a + 2 * (b + d) + e)
        out[k + 1] = state
    return out


def misfits(data: Data, values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """(simulated - measured) / sigma, (row, 6, run, ...)."""
    shape = (slice(None),) * 3 + (None,) * (first.ndim - 2)
    measured = np.moveaxis(data.measured, 0, -1)[shape]
    scale = SIGMA[:, None][(..., *((None,) * (first.ndim - 2)))]
    return (simulate(data, values, first) - measured) / scale


def cost(data: Data, values: np.ndarray, first: np.ndarray) -> float:
    """The common cost: sum of squared misfits, `first` (run, 6)."""
    return float(np.sum(misfits(data, values, np.asarray(first).T) ** 2))


def unpack(data: Data, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives and first states (run, 6) of the unknowns.

    The unknowns are ratios to the file's derivatives, then first states in standard deviations
    from the first row measured: 8 + 36 numbers of about one.
    """
    values = data.start * z[: len(NAMES)]
    return values, data.measured[:, 0] + SIGMA * z[len(NAMES) :].reshape(-1, 6)


def begin(data: Data) -> np.ndarray:
    """Where all contestants start: the file's values and what was measured first."""
    return np.concatenate([np.ones(len(NAMES)), np.zeros(6 * len(data.measured))])


def residual(data: Data, z: np.ndarray) -> np.ndarray:
    """Misfits in one row, run by run."""
    values, first = unpack(data, z)
    return np.ravel(np.moveaxis(misfits(data, values, first.T), -1, 0))


STEP = 1.5e-8  # sqrt of the rounding error: two-point differences


def lanes_jacobian(data: Data, z: np.ndarray, step: float = STEP) -> np.ndarray:
    """Two-point differences with all directions simulated side by side.

    A first state moves its own run only, so that six directions serve those of all runs
    (Curtis, Powell and Reid 1974).
    """
    n, runs = len(NAMES), len(data.measured)
    directions = n + 6
    # The same steps as scipy's: relative to the unknown where it is of order one.
    shifted = np.repeat(z[None], directions + 1, 0)
    h = step * np.maximum(np.abs(z), 1.0)
    for k in range(n):
        shifted[k, k] += h[k]
    for k in range(6):
        shifted[n + k, n + k :: 6] += step
    pairs = [unpack(data, row) for row in shifted]
    values = np.stack([p[0] for p in pairs], -1)[:, None]  # parameter, 1, lane
    first = np.stack([p[1].T for p in pairs], -1)
    r = misfits(data, values, first)  # row, channel, run, lane
    slope = (r[..., :-1] - r[..., -1:]) / np.append(h[:n], np.full(6, step))
    J = np.zeros((runs, *r.shape[:2], len(z)))
    for k in range(runs):
        J[k, ..., :n] = slope[:, :, k, :n]
        J[k, ..., n + 6 * k : n + 6 * k + 6] = slope[:, :, k, n:]
    return J.reshape(-1, len(z))


def with_best_states(data: Data, values: np.ndarray, steps: int = 12) -> tuple[np.ndarray, float]:
    """First states that suit given derivatives best, and the cost there.

    Levenberg-Marquardt; far from the truth the few steps give an upper bound of the cost.
    """
    z, n, damping = begin(data), len(NAMES), 1e-3
    z[:n] = np.asarray(values) / data.start
    r = residual(data, z)
    for _ in range(steps):
        J = lanes_jacobian(data, z)[:, n:]
        A, g = J.T @ J, J.T @ r
        trial = z.copy()
        trial[n:] -= np.linalg.solve(A + damping * np.diag(np.diag(A)), g)
        there = residual(data, trial)
        drop = r @ r - there @ there
        if drop > 0:
            z, r, damping = trial, there, damping / 10
            if drop < 1e-6 * (r @ r):
                break
        elif (damping := 10 * damping) > 1e6:
            break
    return unpack(data, z)[1], float(r @ r)
