# pyright: reportArgumentType=false
"""The controller on the reference plant and on models of it, and what their runs have in common."""

import dataclasses
from collections.abc import Mapping

from experiments.vrx_wamv.campaign import NOISE
from experiments.vrx_wamv.paths import Path, off_path
from experiments.vrx_wamv.plant import CHANNELS, AnyPlant

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea import State, Vessel, run_controlled
from diffsea.simulation.control.waypoints import DynamicPD, Pursued
from diffsea.types import Scalar


PERIOD = 0.1  # s, of the controller
STEP = 0.05  # s, of integration
SECONDS = 300.0  # the longest run
LARGEST = 30.0  # rev/s, 250 N: the largest order in the paper

# Not published; K_p is found as the paper found its gains, see `tuning.by_hand`.
GAINS = {
    "K_p": 8.0, "K_d": 1.0, "T_f": 0.3, "base_min": 12.0, "base_max": 28.0, "near": 4.0,
    "far": 16.0,
}  # fmt: skip
SLOWEST = 24.0  # rev/s, `base_min` of a boat that keeps its speed: 1.3 m/s
RADIUS = 2.0  # m, within which a waypoint counts as reached


@dataclasses.dataclass(frozen=True)
class Driven:
    """A closed-loop run up to its last waypoint, at the controller's period."""

    motion: dict[str, np.ndarray]  # t, x, y, psi, u, v, r
    orders: dict[str, np.ndarray]  # port, starboard, rev/s
    finished: bool

    @property
    def seconds(self) -> float:
        """Time to the last waypoint."""
        return float(self.motion["t"][-1])

    @property
    def length(self) -> float:
        """Distance travelled, m."""
        return float(np.hypot(np.diff(self.motion["x"]), np.diff(self.motion["y"])).sum())

    def error(self, waypoints: Path) -> tuple[float, float]:
        """Distance from the path: root mean square over the run and largest, m."""
        off = np.asarray(off_path(jnp.asarray(waypoints), self.motion["x"], self.motion["y"]))
        return float(np.sqrt(np.mean(off**2))), float(off.max())


class FixedPD(DynamicPD):
    """The same law with gains that depend on neither distance nor heading error."""

    def heading_gain(self, distance: Scalar) -> Scalar:
        return self.K_p

    def rate_gain(self, error: Scalar) -> Scalar:
        return self.K_d


LAWS: dict[str, type[DynamicPD]] = {"dynamic": DynamicPD, "fixed": FixedPD}


def controller(
    waypoints: Path,
    gains: Mapping[str, float] = GAINS,
    smoothing: float = 0.0,
    law: type[DynamicPD] = DynamicPD,
) -> DynamicPD:
    """The paper's law, or another of its form, with a set of gains."""
    numbers = {name: jnp.asarray(value, float) for name, value in gains.items()}
    return law(
        jnp.asarray(waypoints), **numbers, radius=RADIUS, largest=LARGEST, smoothing=smoothing
    )


def on_plant(
    plant: AnyPlant, law: DynamicPD, seconds: float = SECONDS, noise: int | None = None
) -> Driven:
    """Steer the reference plant; it knows nothing of the law nor the law of it.

    With `noise`, a seed, the law is shown the state as the sensors of `campaign` measure it.
    """
    state, memory, rows, over = plant.at_rest, law.init(), [], False
    errors = np.zeros((round(seconds / PERIOD), 6))
    if noise is not None:
        errors = np.random.default_rng(noise).standard_normal(errors.shape) * NOISE
    for k, error in enumerate(errors):
        memory, answer = _step(law, memory, np.add(state[: len(CHANNELS)], error))
        port, starboard, over = np.asarray(answer).tolist()
        rows.append((k * PERIOD, *state[: len(CHANNELS)], port, starboard))
        if over:
            break
        state = plant.advanced(state, port, starboard, PERIOD)
    return _driven(np.array(rows), bool(over))


def on_model(vessel: Vessel, law: DynamicPD) -> Driven:
    """Steer a model."""
    motion, orders, valid, finished = jax.tree.map(np.asarray, _closed(vessel, law))
    rows = np.column_stack([*motion, *orders])[valid]
    return _driven(rows, bool(finished))


def replayed(plant: AnyPlant, run: Driven) -> Driven:
    """The plant under a run's orders, without a controller."""
    state, rows = plant.at_rest, []
    held = zip(run.orders["port"], run.orders["starboard"], strict=True)
    for k, (port, starboard) in enumerate(held):
        rows.append((k * PERIOD, *state[: len(CHANNELS)], port, starboard))
        state = plant.advanced(state, float(port), float(starboard), PERIOD)
    return _driven(np.array(rows), run.finished)


def differences(model: Driven, plant: Driven) -> dict[str, float]:
    """How far the model's run is from the plant's: shares of the plant's time and length, and m.

    `position` is the root-mean-square separation at equal times.
    """
    count = min(len(model.motion["t"]), len(plant.motion["t"]))
    apart = [model.motion[c][:count] - plant.motion[c][:count] for c in "xy"]
    position = float(np.sqrt(np.mean(apart[0] ** 2 + apart[1] ** 2)))
    return {
        "time": abs(model.seconds - plant.seconds) / plant.seconds,
        "distance": abs(model.length - plant.length) / plant.length,
        "position": position, "position_share": position / plant.length,
    }  # fmt: skip


def track(run: Driven, waypoints: Path) -> dict[str, float]:
    """Figures of one run."""
    rms, largest = run.error(waypoints)
    return {
        "seconds": run.seconds, "length": run.length, "rms": rms, "largest": largest,
        "finished": run.finished,
    }  # fmt: skip


def _driven(rows: np.ndarray, finished: bool) -> Driven:
    names = ("t", "x", "y", "psi", "u", "v", "r")
    motion = dict(zip(names, rows.T[:7], strict=True))
    return Driven(motion, {"port": rows[:, 7], "starboard": rows[:, 8]}, finished)


@jax.jit
def _step(law: DynamicPD, memory: Pursued, seen: np.ndarray) -> tuple[Pursued, jax.Array]:
    """Next memory; the orders and whether the path is finished."""
    memory, orders = law.step(memory, State(*seen), 0.0, PERIOD)
    return memory, jnp.stack([orders["port"], orders["starboard"], law.is_finished(memory) * 1.0])


@eqx.filter_jit
def _closed(vessel: Vessel, law: DynamicPD) -> tuple:
    start = State(*(jnp.zeros(()) for _ in range(6)))
    run = run_controlled(vessel, law, start, SECONDS, PERIOD, STEP).trajectory
    motion = run.t, run.x, run.y, run.psi, run.u, run.v, run.r
    orders = run.commanded["port"], run.commanded["starboard"]
    return motion, orders, run.valid, run.outcome == 0
