"""The paper's procedure: one coefficient after another, each from the runs that show it.

Drag coefficients are positive here, as in the paper; `PaperModel.values` gives them SNAME signs.
Eq. 9 leaves c, d and X_u one factor in common, which the paper does not fix: two ways to fix it
are tried, see `READINGS`.
"""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable

from experiments.vrx_wamv.campaign import Campaign, Run
from experiments.vrx_wamv.plant import THRUST_PER_SPEED

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize


# Table 1 of the paper, SI units.
LENGTH_OVERALL, LENGTH, DRAUGHT, BEAM, SPACING, MASS = 4.0, 3.21, 0.089, 2.44, 2.01, 180.0
HALF = SPACING / 2  # d_p, m
WATER = 1000.0  # kg/m^3
SETTLED = 15.0  # s, after which a run is steady
SHARE = 0.7  # of the largest speed or yaw rate, above which the correction looks


@dataclasses.dataclass(frozen=True)
class PaperModel:
    """The model of eqs. 7 and 8."""

    c: float  # N s^2/m
    d: float  # N s^2
    X_u: float
    Y_v: float
    N_r: float
    m11: float = 189.0
    m22: float = 229.0
    m33: float = 333.0

    def thrust(self, n: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Thrust of an engine (N), eq. 8."""
        return self.c * speed * n + self.d * np.abs(n) * n

    def values(self) -> dict[str, float]:
        """The model's numbers under the names and signs of a vessel file."""
        return {
            "mass": MASS, "I_z": self.m33, "X_udot": MASS - self.m11, "Y_vdot": MASS - self.m22,
            "X_u": -self.X_u, "Y_v": -self.Y_v, "N_r": -self.N_r, "c": self.c, "d": self.d,
            "arm": HALF,
        }  # fmt: skip


PUBLISHED_FIRST = PaperModel(-0.397956, 0.299914, 145.0, 56.0, 1023.0)
PUBLISHED = PaperModel(-0.397956, 0.299914, 340.0, 56.0, 1012.0)


@dataclasses.dataclass(frozen=True)
class Procedure:
    """What the procedure finds."""

    first: PaperModel  # before the correction
    corrected: PaperModel
    seconds: float  # of processor time


def identify(data: Campaign, reading: str) -> Procedure:
    """Sections 2.3 and 2.4 on a campaign, eq. 9 read in one of `READINGS`."""
    began = time.process_time()
    c, d, X_u = READINGS[reading](*plateaus(data.straight))
    first = PaperModel(c, d, X_u, math.nan, math.nan)
    first = dataclasses.replace(first, N_r=spin_drag(first, data.spin))
    first = dataclasses.replace(first, Y_v=sway_drag(first, data.wide))
    corrected = dataclasses.replace(
        first,
        X_u=corrected_surge(first, data.straight),
        N_r=corrected_yaw(first, data.spin),
    )
    return Procedure(first, corrected, time.process_time() - began)


def nelder_mead(cost: Callable, start: np.ndarray) -> np.ndarray:
    """The minimum of a cost by the simplex method, in units of the start."""
    scale = np.where(np.asarray(start, float) == 0, 1.0, np.abs(start))
    options = {"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000, "maxfev": 4000, "adaptive": True}
    begin = np.asarray(start, float) / scale
    for _ in range(3):  # a simplex that has collapsed on the way starts again
        begin = minimize(lambda z: cost(z * scale), begin, method="Nelder-Mead", options=options).x
    return begin * scale


def plateaus(runs: list[Run]) -> tuple[np.ndarray, np.ndarray]:
    """Engine speed (rev/s) and mean speed (m/s) of each straight run once it is steady."""
    late = [run.t > SETTLED for run in runs]
    n = np.array([run.port[rows].mean() for run, rows in zip(runs, late, strict=True)])
    u = [run.measured["u"][rows].mean() for run, rows in zip(runs, late, strict=True)]
    return n, np.array(u)


def from_speeds(n: np.ndarray, u: np.ndarray, start: tuple = (-0.4, 0.3, 150.0)) -> np.ndarray:
    """c, d and X_u of eq. 9 from speeds alone, as the start of the search leaves their scale."""

    def cost(z: np.ndarray) -> float:
        c, d, X_u = z
        return float(np.sum((u - 2 * d * n * np.abs(n) / (X_u - 2 * c * n)) ** 2) * 1e4)

    return nelder_mead(cost, np.array(start))


def scaled_at_rest(n: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """`from_speeds`, the factor in common being such that thrust at rest is that ordered."""
    z = from_speeds(n, u)
    c, d, X_u = z * THRUST_PER_SPEED / z[1]
    return float(c), float(d), float(X_u)


def with_thrust(n: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """c and d from the thrust ordered in N, as in the paper's figure 3, then X_u of eq. 9."""
    push, square = THRUST_PER_SPEED * n * np.abs(n), n * np.abs(n)
    c, d = nelder_mead(
        lambda z: np.sum((push - z[0] * u * n - z[1] * square) ** 2), np.array([-0.4, 0.3])
    )
    thrust = 2 * (c * u * n + d * square)
    X_u = nelder_mead(lambda z: np.sum((z[0] * u - thrust) ** 2), np.array([150.0]))[0]
    # What is zero to the search's own tolerance is.
    return round(float(c), 6) + 0.0, float(d), float(X_u)


READINGS = {"speeds alone": scaled_at_rest, "thrust as ordered": with_thrust}


def speeds_from_rest(model: PaperModel, run: Run) -> np.ndarray:
    """Speed ahead (m/s) of a model under a run's orders, from rest: eq. 7 straight ahead."""

    def rate(t: float, u: np.ndarray) -> np.ndarray:
        n = np.interp(t, run.t, run.port), np.interp(t, run.t, run.starboard)
        push = sum(model.thrust(np.asarray(one), u) for one in n)
        return (push - model.X_u * u) / model.m11

    found = solve_ivp(rate, run.t[[0, -1]], [0.0], t_eval=run.t, rtol=1e-8, atol=1e-10)
    return found.y[0]


def steady_speed(model: PaperModel, n: float) -> float:
    """Speed (m/s) that eq. 9 gives at `n` rev/s."""
    return 2 * model.d * n * n / (model.X_u - 2 * model.c * n)


def antenna_for(model: PaperModel, run: Run, Y_v: float) -> float:
    """Where sway must be measured (m forward of the origin) for eq. 12 to give `Y_v`."""
    late = run.t > SETTLED
    u, v, r = (float(run.measured[c][late].mean()) for c in "uvr")
    return (-model.m11 * u * r / Y_v - v) / r


def spin_drag(model: PaperModel, run: Run) -> float:
    """N_r of eq. 11."""
    late = run.t > SETTLED
    r, moment = run.measured["r"][late], _moment(model, run)[late]
    return float(nelder_mead(lambda z: np.sum((z[0] * r - moment) ** 2), np.array([1000.0]))[0])


def sway_drag(model: PaperModel, run: Run) -> float:
    """Y_v of eq. 12."""
    late = run.t > SETTLED
    u, v, r = (run.measured[c][late] for c in "uvr")
    inertia = model.m22 * np.gradient(v, run.t[late]) + model.m11 * u * r
    return float(nelder_mead(lambda z: np.sum((inertia + z[0] * v) ** 2), np.array([100.0]))[0])


def corrected_surge(model: PaperModel, runs: list[Run]) -> float:
    """X_u by the accelerations of eq. 16, where the speed is above 70 % of the largest."""
    fastest = max(run.measured["u"][run.t > SETTLED].mean() for run in runs)
    parts = []
    for run in runs:
        u, v, r = (run.measured[c] for c in "uvr")
        rows = u > SHARE * fastest
        push = _pushes(model, run).sum(0) + model.m22 * v * r
        parts.append(np.array([np.gradient(u, run.t), push, u])[:, rows])
    rate, push, u = np.concatenate(parts, axis=1)
    return float(
        nelder_mead(
            lambda z: np.sum((rate - (push - z[0] * u) / model.m11) ** 2), np.array([model.X_u])
        )[0]
    )


def corrected_yaw(model: PaperModel, run: Run) -> float:
    """N_r by the accelerations of eq. 17, where the yaw rate is above 70 % of the largest."""
    u, v, r = (run.measured[c] for c in "uvr")
    rows = r > SHARE * r[run.t > SETTLED].mean()
    moment = _moment(model, run) + (model.m11 - model.m22) * u * v
    rate, moment, r = (series[rows] for series in (np.gradient(r, run.t), moment, r))
    return float(
        nelder_mead(
            lambda z: np.sum((rate - (moment - z[0] * r) / model.m33) ** 2), np.array([model.N_r])
        )[0]
    )


def _pushes(model: PaperModel, run: Run) -> np.ndarray:
    speed = np.hypot(run.measured["u"], run.measured["v"])
    return np.array([model.thrust(run.port, speed), model.thrust(run.starboard, speed)])


def _moment(model: PaperModel, run: Run) -> np.ndarray:
    port, starboard = _pushes(model, run)
    return (port - starboard) * HALF


def masses(
    length: float = LENGTH, spacing: float = SPACING, density: float = WATER
) -> tuple[float, float, float]:
    """m11, m22 and m33 of eqs. 13 to 15."""
    swept = density * math.pi * DRAUGHT**2  # kg/m
    m33 = (MASS * (length**2 + BEAM**2) + 0.5 * (0.1 * MASS * spacing**2 + swept * length**3)) / 12
    return 1.05 * MASS, MASS + 0.5 * swept * length, m33


def readings_of_masses() -> list[tuple[str, tuple[float, float, float]]]:
    """Eqs. 13 to 15 with each length of Table 1, with and without the water's share of eq. 15."""
    lengths = {"waterline length": LENGTH, "length overall": LENGTH_OVERALL}
    out = []
    for (name, length), (label, spacing), water in itertools.product(
        lengths.items(), (("B = 2.01 m", SPACING), ("B = 2.44 m", BEAM)), (True, False)
    ):
        m11, m22, m33 = masses(length, spacing)
        if not water:
            m33 = masses(length, spacing, 0.0)[2]
        note = "" if water else ", without the water's term in eq. 15"
        out.append((f"{name}, {label}{note}", (m11, m22, m33)))
    return out
