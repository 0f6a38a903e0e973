"""Gymnasium environments: one boat, or a thousand at once, that are to reach a point.

A step is that of `simulation.integrate` for all boats together, compiled once. Observations are
in the boat's own axes and scales, so that a policy of one boat means something to another: the goal
forward and to starboard in lengths, `u`, `v` over sqrt(g L), `r` times sqrt(L / g), and what each
channel executes as an action. Actions are orders from -1 to 1: neutral at zero, the limits of
the channel at the ends.
"""

import dataclasses
from typing import Any, ClassVar

from diffsea.runtime import prepare_library


prepare_library()  # before JAX is imported below: this module is imported by its own name

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.scales import froude_speed, time_scale
from diffsea.simulation import planning
from diffsea.simulation.integrate import SimulationState, advance, begin, history_lengths
from diffsea.types import Scalar, State, as_inputs
from diffsea.vessel.base import Vessel


Actions = Float[np.ndarray, "boat channel"]
Observations = Float[np.ndarray, "boat number"]
Flags = Bool[np.ndarray, "boat"]


_FASTEST = 10.0  # Froude number: no craft moves faster, and observations end there


@dataclasses.dataclass(frozen=True)
class Task:
    """To reach a point: a boat at rest, with any heading, and a goal some lengths away.

    The reward of a step is by how many lengths the goal has come nearer, and one on reaching it.

    Attributes:
        interval: s, between actions; None for the time scale sqrt(L / g) of the boat.
        seconds: s, of an episode; None for a hundred intervals.
        nearest, farthest: of the goal at first, in lengths.
        reached: lengths, from which on it is reached.
    """

    interval: float | None = None
    seconds: float | None = None
    nearest: float = 5.0
    farthest: float = 15.0
    reached: float = 1.0


class _Boats:
    """Boats of one kind under the same task, without Gymnasium's grammar."""

    def __init__(self, vessel: Vessel, number: int, task: Task):
        """
        Raises:
            UserError: a channel has no limits, so that nothing says what an action of one is.
        """
        self.vessel, self.number, self.task = as_inputs(vessel), number, task
        self.length = float(vessel.rigid_body.length)
        self.interval = time_scale(self.length) if task.interval is None else task.interval
        seconds = 100 * self.interval if task.seconds is None else task.seconds
        self.last = round(seconds / self.interval)
        self.steps = max(1, round(self.interval / planning.default_step(self.length)))
        self.ends = np.array([_ends(c, vessel) for c in vessel.channels])
        self.lengths = history_lengths(vessel, self.interval / self.steps)
        unit = np.ones(len(self.ends), np.float32)
        self.action_space = gymnasium.spaces.Box(-unit, unit, dtype=np.float32)
        away = task.farthest + _FASTEST * self.last * self.interval / time_scale(self.length)
        far = np.array([away, away, _FASTEST, _FASTEST, _FASTEST, *unit], np.float32)
        self.observation_space = gymnasium.spaces.Box(-far, far, dtype=np.float32)
        self.goal, self.age = np.zeros((number, 2)), np.zeros(number, int)
        self.motion: SimulationState = self._at_rest(np.zeros(number))

    def _at_rest(self, heading: Float[np.ndarray, "boat"]) -> SimulationState:
        """Boats at the origin whose actuators have long been neutral."""
        middle = jnp.asarray(self.ends[:, 1])
        neutral: dict[str, Scalar] = {c: middle[k] for k, c in enumerate(self.vessel.channels)}

        def one(psi: Float[Array, ""]) -> SimulationState:
            zero = jnp.zeros(())
            state = State(zero, zero, psi, zero, zero, zero)
            motion = begin(self.vessel, state, neutral, self.lengths)
            return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), motion)

        return jax.vmap(one)(jnp.asarray(heading))

    def start(self, chosen: Flags, random: np.random.Generator) -> None:
        """Begin a new episode of some boats."""
        heading, bearing = random.uniform(-np.pi, np.pi, (2, self.number))
        away = random.uniform(self.task.nearest, self.task.farthest, self.number) * self.length
        goal = away[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        fresh = self._at_rest(heading)
        self.motion = jax.tree.map(
            lambda new, old: jnp.where(chosen.reshape(-1, *[1] * (old.ndim - 1)), new, old),
            fresh,
            self.motion,
        )
        self.goal = np.where(chosen[:, None], goal, self.goal)
        self.age = np.where(chosen, 0, self.age)

    def step(self, actions: Actions) -> tuple[Float[np.ndarray, "boat"], Flags, Flags]:
        """Move on by an interval: rewards, and whether goals are reached and time is up."""
        before = self._distance()
        orders = self._orders(np.asarray(actions, float))
        t = jnp.asarray(self.age * self.interval)
        self.motion = _moved(
            self.vessel, self.motion, orders, t, self.interval / self.steps, self.steps
        )
        self.age = self.age + 1
        after = self._distance()
        reached = after <= self.task.reached
        return before - after + reached, reached, (self.age >= self.last) & ~reached

    def observations(self) -> Observations:
        """What the boats see."""
        names = ("x", "y", "psi", "u", "v", "r")
        state = {name: np.asarray(getattr(self.motion.state, name)) for name in names}
        north, east = self.goal[:, 0] - state["x"], self.goal[:, 1] - state["y"]
        sine, cosine = np.sin(state["psi"]), np.cos(state["psi"])
        fastest, slow = froude_speed(self.length), time_scale(self.length)
        done = np.column_stack([np.asarray(self.motion.executed[c]) for c in self.vessel.channels])
        low, neutral, high = self.ends.T
        above = done - neutral
        shares = np.where(above < 0, above / (neutral - low), above / (high - neutral))
        seen = [
            (cosine * north + sine * east) / self.length,
            (cosine * east - sine * north) / self.length,
            state["u"] / fastest,
            state["v"] / fastest,
            state["r"] * slow,
        ]
        space = self.observation_space
        return np.clip(np.column_stack([*seen, shares]).astype(np.float32), space.low, space.high)

    def _orders(self, actions: Actions) -> dict[str, Float[Array, "boat"]]:
        low, neutral, high = self.ends.T
        span = np.where(actions < 0, neutral - low, high - neutral)
        orders = neutral + np.clip(actions, -1, 1) * span
        return {c: jnp.asarray(orders[:, k]) for k, c in enumerate(self.vessel.channels)}

    def _distance(self) -> Float[np.ndarray, "boat"]:
        """To the goal, in lengths."""
        state = self.motion.state
        apart = self.goal - np.column_stack([np.asarray(state.x), np.asarray(state.y)])
        return np.hypot(*apart.T) / self.length


def _ends(channel: str, vessel: Vessel) -> tuple[float, float, float]:
    """A channel's lower limit, neutral order and upper limit; an angle without limits has a turn.

    A channel that does nothing below neutral has an action of minus one that does nothing.
    """
    servo = vessel.servos[channel]
    neutral = 0.0 if servo.neutral is None else float(servo.neutral)
    if servo.endless:
        return -np.pi, neutral, np.pi
    if servo.lower is None or servo.upper is None:
        raise UserError(
            f"channel {channel!r} has no limits, so an action from -1 to 1 means nothing; state "
            "them in the vessel's file"
        )
    low, high = float(servo.lower), float(servo.upper)
    tiny = 1e-9 * (high - low)
    return min(low, neutral - tiny), neutral, max(high, neutral + tiny)


@eqx.filter_jit
def _moved(
    vessel: Vessel,
    motion: SimulationState,
    orders: dict[str, Float[Array, "boat"]],
    t: Float[Array, "boat"],
    step: float,
    count: int,
) -> SimulationState:
    """All boats `count` steps of `step` s later, their orders held."""

    def one(motion: SimulationState, orders: dict, t: Float[Array, ""]) -> SimulationState:
        def body(k: Array, motion: SimulationState) -> SimulationState:
            at = t + step * k.astype(float)
            return advance(vessel, motion, orders, vessel.environment, at, jnp.asarray(step))

        return jax.lax.fori_loop(0, count, body, motion)

    return jax.vmap(one)(motion, orders, t)


class BoatEnv(gymnasium.Env):
    """One boat."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(self, vessel: Vessel, task: Task = Task()):
        """Raises `UserError` for a vessel with a channel without limits."""
        self._boats = _Boats(vessel, 1, task)
        self.observation_space = self._boats.observation_space
        self.action_space = self._boats.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._boats.start(np.ones(1, bool), self.np_random)
        return self._boats.observations()[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        reward, reached, late = self._boats.step(np.asarray(action)[None])
        return self._boats.observations()[0], float(reward[0]), bool(reached[0]), bool(late[0]), {}


class BoatVectorEnv(VectorEnv):
    """Many boats at once; one that is done begins anew at the next step, whatever its action."""

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, vessel: Vessel, num_envs: int = 1024, task: Task = Task()):
        """Raises `UserError` for a vessel with a channel without limits."""
        self._boats = _Boats(vessel, num_envs, task)
        self.num_envs = num_envs
        self.single_observation_space = self._boats.observation_space
        self.single_action_space = self._boats.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._done = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._boats.start(np.ones(self.num_envs, bool), self.np_random)
        self._done = np.zeros(self.num_envs, bool)
        return self._boats.observations(), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        again = self._done
        reward, reached, late = self._boats.step(actions)
        if again.any():
            self._boats.start(again, self.np_random)
            reward, reached, late = np.where(again, 0.0, reward), reached & ~again, late & ~again
        self._done = reached | late
        return self._boats.observations(), reward, reached, late, {}
