# pyright: reportArgumentType=false
"""The control system: estimator, route tracking, compensation and limits as one controller."""

from experiments.unberthing.gradient_model import Linear
from experiments.unberthing.harbour_estimators import AbstractEstimator, Advice, Seen
from experiments.unberthing.harbour_route import DONE, Place, next_step, place
from experiments.unberthing.harbour_ship import PERIOD, nominal, orders
from experiments.unberthing.track_lqr import (
    SPEED_RATE,
    Surge,
    Weights,
    bryson,
    compensation,
    demanded,
    lateral_gain,
    limited,
    surge_gains,
)

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea import AbstractController, State
from diffsea.types import Scalar


SMOOTHING = (6.0, 3.0)  # s, time constants of the filters of sway speed and yaw rate; chosen


class Memory(eqx.Module):
    """What a period carries on, and what a log shows of it."""

    estimator: object
    advice: Advice
    at: Place
    step: Scalar  # 1 to 5, then `DONE`
    began: Bool[Array, ""]
    speeds: Float[Array, "2"]  # v and r, filtered
    wanted_speed: Scalar  # m/s
    blades: Float[Array, "4"]
    gain: Float[Array, "3 4"]


class ControlSystem(AbstractController[Memory]):
    """Figure 3 of the paper. The run is over after `last_step`."""

    estimator: AbstractEstimator
    surge: Surge
    weights: Weights
    first_step: Scalar
    last_step: Scalar
    compensate: Scalar  # eq. 16: 1, 0 for none, -1 with the printed sign

    def init(self) -> Memory:
        zero, still = jnp.zeros(()), State(*(jnp.zeros(()) for _ in range(6)))
        advice = Advice(Linear(jnp.zeros((2, 6))), jnp.zeros(2), jnp.ones(()))
        return Memory(
            self.estimator.init(), advice, place(zero + self.first_step, still),
            zero + self.first_step, zero > 1, jnp.zeros(2), zero, jnp.zeros(4), jnp.zeros((3, 4)),
        )  # fmt: skip

    def step(
        self, memory: Memory, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Memory, dict[str, Scalar]]:
        number = next_step(memory.step, place(memory.step, state), t)
        at, leaving = place(number, state), number >= 3
        measured = jnp.stack([state.v, state.r])
        keep = jnp.where(memory.began, jnp.exp(-PERIOD / jnp.array(SMOOTHING)), 0.0)
        speeds = keep * memory.speeds + (1 - keep) * measured
        fresh = ~memory.began | ((memory.step < 3) & leaving)
        seen = Seen(state, speeds, memory.blades, leaving, fresh)
        estimator, advice = self.estimator.step(memory.estimator, seen)
        gain = lateral_gain(advice.model, state.u, leaving, self.weights)
        # An estimate for which the Riccati equation has no solution leaves the gain as it was.
        gain = jnp.where(jnp.all(jnp.isfinite(gain)), gain, memory.gain)
        start = jnp.where(memory.began, memory.wanted_speed, state.u)
        change = SPEED_RATE * PERIOD
        wanted_speed = start + jnp.clip(at.speed - start, -change, change)
        motion = jnp.stack([state.u, *speeds])
        wanted = demanded(at, motion, wanted_speed, self.surge, gain, number)
        turn = self.compensate * compensation(gain, advice.model.rows[0, 5])
        wanted = wanted + jnp.stack([jnp.zeros(()), turn * leaving, *advice.ahead])
        blades = limited(wanted, memory.blades, state.u, leaving)
        after = Memory(
            estimator, advice, at, number, jnp.ones((), bool), speeds, wanted_speed, blades, gain
        )
        return after, orders(blades)

    def is_finished(self, memory: Memory) -> Bool[Array, ""]:
        return jnp.greater(memory.step, jnp.minimum(self.last_step, DONE - 1))


def system(estimator: AbstractEstimator, **options: float) -> ControlSystem:
    """A control system for the nominal ship."""
    numbers = {"first_step": 1.0, "last_step": 5.0, "compensate": 1.0} | options
    arrays = {name: jnp.asarray(value, float) for name, value in numbers.items()}
    return ControlSystem(estimator, surge_gains(nominal()), bryson(), **arrays)
