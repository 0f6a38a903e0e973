# pyright: reportArgumentType=false
"""Gains by derivative: least squares through the closed loop on the identified model.

What is minimised, in m^2: the mean square distance from the path along the way, plus `WEIGHT`
times the time it takes relative to the time before. Decisions at waypoints are smooth here.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

from experiments.vrx_wamv.closed import GAINS, PERIOD, SECONDS, STEP, controller, on_model
from experiments.vrx_wamv.paths import Path, off_path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from diffsea import State, Vessel, run_controlled
from diffsea.simulation.control.waypoints import DynamicPD


# What is tuned and where it is looked for. The largest base order is what the boat is run at.
BOUNDS = {
    "K_p": (0.5, 40.0), "K_d": (0.05, 40.0), "T_f": (0.1, 3.0), "base_min": (6.0, 26.0),
    "near": (1.0, 8.0), "far": (8.5, 40.0),
}  # fmt: skip
FIXED_BOUNDS = {"K_p": (0.5, 160.0), "K_d": (0.05, 160.0)}  # logarithms reach four
WEIGHT = 1.0  # m^2 for all of the time before
SMOOTHING = 0.5  # s
NAMES = tuple(BOUNDS)
LOOPED = 1.2  # times the path's length: a longer way has circled a waypoint


@dataclasses.dataclass(frozen=True)
class Tuned:
    """Gains found, and the cost on the way there."""

    gains: dict[str, float]
    costs: list[float]  # m^2, one per evaluation of the derivatives
    evaluations: int


def by_hand(
    vessel: Vessel, paths: Sequence[Path], law: type[DynamicPD] = DynamicPD
) -> dict[str, float]:
    """K_p doubled from 1 until every path is followed without circling a waypoint.

    The paper's way, "from small to large"; the other numbers stay as in `GAINS`.
    """
    for K_p in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0):
        gains = GAINS | {"K_p": K_p}
        runs = [on_model(vessel, controller(path, gains, law=law)) for path in paths]
        short = [
            run.length < LOOPED * length_of(path) for run, path in zip(runs, paths, strict=True)
        ]
        if all(run.finished for run in runs) and all(short):
            return gains
    raise RuntimeError("no K_p follows the paths; the model cannot be steered by this law")


def length_of(waypoints: Path) -> float:
    """Length (m) of the legs from the origin on."""
    corners = np.concatenate([np.zeros((1, 2)), waypoints])
    return float(np.hypot(*np.diff(corners, axis=0).T).sum())


def tune(
    vessel: Vessel,
    paths: Sequence[Path],
    before: Mapping[str, float],
    evaluations: int = 15,
    law: type[DynamicPD] = DynamicPD,
) -> Tuned:
    """Gains with the least cost over some paths, from gains that work, by Gauss-Newton steps."""
    given = problem(vessel, paths, before, law)
    start = np.log([before[name] for name in NAMES])
    bounds = BOUNDS if law is DynamicPD else BOUNDS | FIXED_BOUNDS
    low, high = np.log(np.array([bounds[name] for name in NAMES])).T
    costs: list[float] = []

    def slopes(z: np.ndarray) -> np.ndarray:
        residual, J = both(jnp.asarray(z), given, SMOOTHING)
        costs.append(float(np.sum(np.square(residual))))
        return np.asarray(J)

    found = least_squares(
        lambda z: np.asarray(both(jnp.asarray(z), given, SMOOTHING)[0]), start, slopes,
        (low + 1e-9, high - 1e-9), xtol=1e-4, ftol=1e-4, max_nfev=evaluations,
    )  # fmt: skip
    gains = dict(before) | dict(zip(NAMES, np.exp(found.x).tolist(), strict=True))
    return Tuned(gains, [*costs, float(2 * found.cost)], int(found.nfev))


class Given(eqx.Module):
    """What the cost needs besides the gains."""

    vessel: Vessel
    paths: jax.Array  # path, waypoint, 2
    lengths: jax.Array  # m
    seconds: jax.Array  # that each path took before
    fixed: dict[str, jax.Array]
    law: type[DynamicPD] = eqx.field(static=True, default=DynamicPD)


def problem(
    vessel: Vessel,
    paths: Sequence[Path],
    before: Mapping[str, float],
    law: type[DynamicPD] = DynamicPD,
) -> Given:
    """The cost's inputs; times are those under the gains `before`."""
    runs = [on_model(vessel, controller(path, before, law=law)) for path in paths]
    seconds = [run.seconds for run in runs]
    fixed = {name: jnp.asarray(v) for name, v in before.items() if name not in NAMES}
    return Given(
        vessel, jnp.asarray(np.array(paths)), jnp.array([length_of(p) for p in paths]),
        jnp.array(seconds), fixed, law,
    )  # fmt: skip


def residuals(z: jax.Array, given: Given, smoothing: float) -> jax.Array:
    """What is squared and summed, by the logarithms of the gains: (path, row) flattened."""
    gains = given.fixed | dict(zip(NAMES, jnp.exp(z), strict=True))

    def one(waypoints: jax.Array, length: jax.Array, seconds: jax.Array) -> jax.Array:
        law = controller(waypoints, gains, smoothing, given.law)
        start = State(*(jnp.zeros(()) for _ in range(6)))
        run = run_controlled(given.vessel, law, start, SECONDS, PERIOD, STEP)
        rows = run.trajectory
        speed = jnp.sqrt(rows.u**2 + rows.v**2 + 1e-9)
        off = off_path(waypoints, rows.x, rows.y) * jnp.sqrt(speed * PERIOD / length)
        left = jnp.where(rows.valid, 1 - jax.vmap(law.progress)(run.memory), 0.0)
        late = jnp.sqrt(WEIGHT * left.sum() * PERIOD / seconds)
        return jnp.append(jnp.where(rows.valid, off, 0.0), late)

    each = jax.vmap(one)(given.paths, given.lengths, given.seconds)
    return each.ravel() / math.sqrt(len(given.paths))


@eqx.filter_jit
def both(z: jax.Array, given: Given, smoothing: float) -> tuple[jax.Array, jax.Array]:
    """Residuals and their Jacobian."""
    one = jax.vmap(
        lambda d: jax.jvp(lambda at: residuals(at, given, smoothing), (z,), (d,)),
        out_axes=(None, 0),
    )
    found, columns = one(jnp.eye(len(z)))
    return found, columns.T


STEPS = {"differences": 1e-5, "trend": 0.02}  # of the gains' logarithms


def slope_check(given: Given, z: np.ndarray, smoothing: float) -> dict[str, list]:
    """Derivatives of the cost by the logarithms of the gains: exact, and by central differences."""
    residual, J = map(np.asarray, both(jnp.asarray(z), given, smoothing))

    def cost(at: np.ndarray) -> float:
        return float(np.sum(np.square(both(jnp.asarray(at), given, smoothing)[0])))

    found = {
        name: [(cost(z + step * e) - cost(z - step * e)) / (2 * step) for e in np.eye(len(z))]
        for name, step in STEPS.items()
    }
    return {"exact": (2 * J.T @ residual).tolist(), **found}
