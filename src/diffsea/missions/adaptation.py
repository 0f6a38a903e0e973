"""A controller that learns: its model is made of what passes the gate of an online estimator."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from diffsea.identification.filter.covariance import Noise
from diffsea.identification.online.ekf import kalman_filter
from diffsea.identification.online.estimator import DRIFT, usual_parameters
from diffsea.identification.online.guarded import (
    GuardedEstimator,
    GuardedState,
    GuardedStep,
    guard_estimator,
)
from diffsea.identification.online.rls import recursive_least_squares
from diffsea.missions.controllers import controller_of
from diffsea.missions.record import Mission
from diffsea.parameters import replace
from diffsea.simulation.control import AbstractController
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Scalar, State


Limits = Mapping[str, tuple[Scalar, Scalar]]


class Learning(eqx.Module):
    """What `AdaptiveController` remembers."""

    guarded: GuardedState
    told: GuardedStep  # of the last step
    orders: dict[str, Scalar]  # that have held since then
    begun: Bool[Array, ""]
    inner: Any  # the controller's own memory


class AdaptiveController(AbstractController[Learning]):
    """A controller whose model follows an online estimator, once its gate lets an estimate pass.

    The estimator sees what the controller sees, and the orders within their limits.
    """

    guard: GuardedEstimator
    controller: AbstractController  # for the model as it was stated
    made_for: Callable[[Mapping[str, Scalar]], AbstractController] | None = eqx.field(static=True)
    limits: Limits
    start: State  # rough guess of the first state

    def init(self) -> Learning:
        inner, zero = self.controller.init(), jnp.zeros(())
        orders = self._limited(self.controller.step(inner, self.start, zero, jnp.ones(()))[1])
        state = self.guard.init(self.guard.estimator.init(self.start, orders=orders))
        unmeasured = jnp.full(len(MOTION_CHANNELS), jnp.nan)
        told = self.guard.step(state, orders, unmeasured, zero)[1]
        return Learning(state, told, orders, jnp.zeros((), bool), inner)

    def step(
        self, memory: Learning, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Learning, dict[str, Scalar]]:
        measured = jnp.stack([jnp.asarray(getattr(state, c), float) for c in MOTION_CHANNELS])
        elapsed = jnp.where(memory.begun, dt, 0.0)
        guarded, told = self.guard.step(memory.guarded, memory.orders, measured, elapsed)
        controller = self.controller
        if self.made_for is not None:
            controller = self.made_for(self.guard.decode(told.handed))
        inner, orders = controller.step(memory.inner, state, t, dt)
        held = self._limited(orders)
        return Learning(guarded, told, held, jnp.ones((), bool), inner), orders

    def is_finished(self, memory: Learning) -> Bool[Array, ""]:
        return self.controller.is_finished(memory.inner)

    def _limited(self, orders: dict[str, Scalar]) -> dict[str, Scalar]:
        return {
            channel: jnp.clip(jnp.asarray(order, float), *self.limits.get(channel, (None, None)))
            for channel, order in orders.items()
        }


def estimator_beside(mission: Mission, period: float, noise: Noise | None) -> GuardedEstimator:
    """The mission's `[estimator]` with its gate, which begins at the mission's own model.

    Made outside of compiled programs: what is estimated, and how, is settled by plain numbers.

    Arguments:
        period: s.
        noise: gusts and sensor noise, which the Kalman filter needs.

    Raises:
        UserError: parameters that cannot be estimated so.
    """
    asked, model = mission.estimator, mission.model
    assert asked is not None
    free = asked.free or usual_parameters(model)
    if asked.kind == "kalman":
        assert noise is not None
        drift = DRIFT if asked.drift is None else asked.drift
        return guard_estimator(kalman_filter(model, free, noise, drift=drift, interval=period))
    memory = math.inf if asked.memory is None else asked.memory
    return guard_estimator(recursive_least_squares(model, free, memory=memory, interval=period))


def adaptive_controller(
    mission: Mission, period: float, start: State, guard: GuardedEstimator
) -> AdaptiveController:
    """The controller of a mission with an estimator beside it. Pure in the mission's numbers.

    Arguments:
        period: s.
        start: rough guess of the first state.
    """
    asked = mission.estimator
    assert asked is not None

    def made_for(values: Mapping[str, Scalar]) -> AbstractController:
        believed = dataclasses.replace(mission, model=replace(mission.model, values))
        return controller_of(believed, period)

    return AdaptiveController(
        guard,
        controller_of(mission, period),
        made_for if asked.adapt else None,
        dict(mission.controller.limits),
        start,
    )
