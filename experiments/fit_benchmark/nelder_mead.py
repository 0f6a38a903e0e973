"""Nelder and Mead's simplex: on the common cost, and in the stages published for such a craft.

J. Yoon and R. Kim, Identifying Kinetic Model Parameters and Implementing 3-DOF Control for a
Dual-Thruster USV (sections 2.3 and 2.4): drag X_u from steady straight runs, N_r from turning on
the spot, Y_v from steady turns, masses from main dimensions, then X_u and N_r once more from
accelerations at more than 70 % of the highest speed. README.md says what the paper leaves open.
"""

from collections.abc import Callable

from experiments.fit_benchmark import plain
from experiments.fit_benchmark.data import NAMES, RUNS, Data
from experiments.fit_benchmark.outcome import Outcome
from experiments.fit_benchmark.with_scipy import compiled_residual

import numpy as np
from scipy.optimize import minimize


WATER = 1025.0  # kg/m^3
SETTLED = 6.0  # s after a change of thrust; the craft's own times are below 2 s
TRIALS = {"straight": "speed-steps", "spot": "spin", "turn": "circle-fast"}


def output_error(data: Data) -> Outcome:
    """The common cost over the eight derivatives, what was measured first taken for known.

    A simplex over all 44 unknowns would have to find directions that the other contestants are
    told by derivatives; it is left out.
    """
    residual, z, count = compiled_residual(data), plain.begin(data), [0]

    def cost(ratios: np.ndarray) -> float:
        count[0] += 1
        r = residual(np.concatenate([ratios, z[len(NAMES) :]]))
        total = float(r @ r)
        return total if np.isfinite(total) else 1e300

    options = {"maxfev": 8000, "maxiter": 8000, "xatol": 1e-6, "fatol": 0.01}
    found = minimize(cost, z[: len(NAMES)], method="Nelder-Mead", options=options).x
    return Outcome(data.start * found, None, count[0], 0)


def published(data: Data) -> Outcome:
    """Linear drag and masses from main dimensions, as in the paper."""
    return _stages(data, _masses(data), quadratic=False)


def own_terms(data: Data) -> Outcome:
    """The same stages with this craft's quadratic drag and its file's masses."""
    mass, I_z = data.hull["mass"], data.hull["I_z"]
    added = dict(zip(NAMES, data.start, strict=True))
    masses = mass - added["X_udot"], mass - added["Y_vdot"], I_z - added["N_rdot"]
    return _stages(data, masses, quadratic=True)


def _masses(data: Data) -> tuple[float, float, float]:
    """m11, m22, m33 after the paper's equations 13 to 15."""
    m, L, W, D = (data.hull[k] for k in ("mass", "length", "beam", "draught"))
    B = data.arms[1] - data.arms[0]
    water = WATER * np.pi * D**2
    m33 = (m * (L**2 + W**2) + 0.5 * (0.1 * m * B**2 + water * L**3)) / 12
    return 1.05 * m, m + 0.5 * water * L, m33


def _stages(data: Data, masses: tuple[float, float, float], quadratic: bool) -> Outcome:
    m11, m22, m33 = masses
    force, moment = (push.T for push in plain.pushes(data))
    u, v, r = (data.measured[..., k] for k in (3, 4, 5))
    du, dv, dr = (np.gradient(w, data.dt, axis=1) for w in (u, v, r))
    parts = _parts(data)
    start, count = dict(zip(NAMES, data.start, strict=True)), [0]

    def drag(w: np.ndarray, values: np.ndarray) -> np.ndarray:
        return values[0] * w + (values[1] * np.abs(w) * w if quadratic else 0.0)

    def least(error: Callable, begin: list[float], use: np.ndarray) -> np.ndarray:
        def cost(values: np.ndarray) -> float:
            count[0] += 1
            return float(np.mean(error(values)[use] ** 2))

        return minimize(cost, begin, method="Nelder-Mead").x

    terms = 2 if quadratic else 1
    X = least(
        lambda d: force + drag(u, d), [start["X_u"], start["X_uu"]][:terms], parts["straight"]
    )
    N = least(lambda d: moment + drag(r, d), [start["N_r"], start["N_rr"]][:terms], parts["spot"])
    (Y,) = least(lambda d: m22 * dv + m11 * u * r - d[0] * v, [start["Y_v"]], parts["turn"])
    fast = _upper(u, parts["straight, all"])
    X = least(lambda d: (force + m22 * v * r + drag(u, d)) / m11 - du, list(X), fast)
    quick = _upper(r, parts["spot, all"])
    N = least(lambda d: (moment + (m11 - m22) * u * v + drag(r, d)) / m33 - dr, list(N), quick)
    X_uu, N_rr = (float(d[1]) if quadratic else 0.0 for d in (X, N))
    mass, I_z = data.hull["mass"], data.hull["I_z"]
    found = [mass - m11, mass - m22, I_z - m33, X[0], X_uu, Y, N[0], N_rr]
    return Outcome(np.array(found), None, count[0], 0)


def _upper(values: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Rows with more than 70 % of the highest speed."""
    return use & (np.abs(values) > 0.7 * np.abs(values[use]).max())


def _parts(data: Data) -> dict[str, np.ndarray]:
    """Rows (run, row) of the three trials that the procedure asks for, whole and where steady.

    Steady means thrust held for `SETTLED` s, and ahead on both sides where that is meant.
    """
    changed = np.any(np.diff(data.thrust, axis=1, prepend=data.thrust[:, :1]) != 0, -1)
    rows = np.arange(len(data.t))
    last = np.maximum.accumulate(np.where(changed, rows, -len(rows)), axis=1)
    steady = (rows - last) * data.dt > SETTLED
    port, starboard = data.thrust[..., 0], data.thrust[..., 1]
    trials = {name: np.zeros(port.shape, bool) for name in TRIALS}
    for name, run in TRIALS.items():
        trials[name][RUNS.index(run)] = True
    return {
        "straight": trials["straight"] & steady & (port > 0) & (starboard > 0),
        "spot": trials["spot"] & steady & (port * starboard < 0),
        "turn": trials["turn"] & steady,
        "straight, all": trials["straight"],
        "spot, all": trials["spot"],
    }
