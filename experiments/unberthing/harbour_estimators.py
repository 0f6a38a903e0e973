"""Where the linear model of each control period comes from: gradient descent or least squares."""

import abc

from experiments.unberthing.gradient_model import (
    RATES,
    Linear,
    Window,
    derivatives,
    empty,
    estimated,
    linear_model,
    nominal_linear,
    push,
)
from experiments.unberthing.guarded_model import guard
from experiments.unberthing.harbour_ship import KNOT, PERIOD, nominal, orders
from experiments.unberthing.track_lqr import BLADE_LIMITS

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea import State, replace
from diffsea.identification.online.guarded import GuardedEstimator, GuardedState, GuardedStep
from diffsea.identification.online.trust import TrustLimits
from diffsea.kinematics import to_body
from diffsea.types import Scalar


class Seen(eqx.Module):
    """What an estimator is given each period."""

    state: State  # as measured
    speeds: Float[Array, "2"]  # v and r, filtered
    blades: Float[Array, "4"]  # angles that held since the last period
    leaving: Bool[Array, ""]
    fresh: Bool[Array, ""]  # a phase begins


class Advice(eqx.Module):
    """What an estimator gives the controller."""

    model: Linear  # its last term of the sway equation is the bias c_v
    ahead: Float[Array, "2"]  # thruster angles against the steady push, rad; zero where not used
    trust: Scalar  # 0 to 1; 1 where nobody asks


class AbstractEstimator(eqx.Module):
    """Turns what is seen into a model."""

    @abc.abstractmethod
    def init(self) -> object:
        """Memory at the start."""

    @abc.abstractmethod
    def step(self, memory: object, seen: Seen) -> tuple[object, Advice]:
        """Next memory, and advice for this period."""


class Gradient(AbstractEstimator):
    """The published estimator; each phase starts from the nominal model of its first speed.

    With `bias` eq. 4 has a bias in both equations, as eq. 5 has one in sway, and with `forward`,
    too, the thrusters also bear the push that it stands for.
    """

    unberthing: Linear
    leaving: Linear
    rates: Float[Array, "2"]
    bias: Scalar = 0.0  # or 1
    forward: Scalar = 0.0  # or 1

    def init(self) -> tuple[Linear, Window]:
        return self.unberthing, empty()

    def step(self, memory: tuple[Linear, Window], seen: Seen) -> tuple[tuple, Advice]:
        start = _where(seen.leaving, self.leaving, self.unberthing)
        model = _where(seen.fresh, start, memory[0])
        window = push(memory[1], seen.speeds, seen.blades[1:], seen.fresh)
        model = estimated(model, window, seen.leaving, self.rates, self.bias)
        # Estimates on their way through zero ask for more than thrusters have.
        ahead = -jnp.linalg.solve(model.inputs[:, 1:], model.rows[:, 5])
        ahead = jnp.clip(jnp.nan_to_num(ahead), -jnp.array(BLADE_LIMITS), jnp.array(BLADE_LIMITS))
        ahead = jnp.where(seen.leaving, 0.0, self.forward * ahead)
        return (model, window), Advice(model, ahead, jnp.ones(()))


class Recursive(AbstractEstimator):
    """Recursive least squares; `gated`, only what trust lets through reaches the controller.

    With `forward` the thrusters also bear the estimated steady force.
    """

    guard: GuardedEstimator
    standing: GuardedState
    gated: Scalar = 1.0  # or 0
    forward: Scalar = 0.0  # or 1

    def init(self) -> tuple[GuardedState, Bool[Array, ""]]:
        return self.standing, jnp.zeros((), bool)

    def step(self, memory: tuple, seen: Seen) -> tuple[tuple, Advice]:
        standing, out = self.learned(memory, seen)
        used = jnp.where(self.gated > 0, out.handed, out.evidence.coordinates)
        values = self.guard.decode(used)
        vessel = replace(self.guard.estimator.vessel, values)
        A, B = derivatives(vessel, jnp.maximum(seen.state.u, 0.0), seen.blades[0])
        _, side = to_body(values["steady.north"], values["steady.east"], seen.state.psi)
        inertia = vessel.mass_matrix()[1:, 1:]
        pushed = jnp.linalg.solve(inertia, jnp.stack([side, values["steady.moment"]]))
        ahead = -self.forward * jnp.linalg.solve(B[1:, 2:], pushed) * ~seen.leaving
        model = linear_model(A, B, PERIOD * pushed[0])
        return (standing, jnp.ones((), bool)), Advice(model, ahead, out.trust.value)

    def learned(self, memory: tuple, seen: Seen) -> tuple[GuardedState, GuardedStep]:
        """One step of the guarded estimator on what was measured, unfiltered."""
        standing, begun = memory
        s = seen.state
        row = jnp.stack([s.x, s.y, s.psi, s.u, s.v, s.r])
        dt = jnp.where(begun, PERIOD, 0.0)
        return self.guard.step(standing, orders(seen.blades), row, dt)


def gradient(
    rates: tuple[float, float] = RATES, bias: bool = False, forward: bool = False
) -> Gradient:
    """The published estimator, from the regressions' ship at 1 and at 3 kn."""
    models = (nominal_linear(nominal(), jnp.asarray(knots * KNOT)) for knots in (1.0, 3.0))
    unberthing, leaving = models
    switches = jnp.asarray(bias, float), jnp.asarray(forward, float)
    return Gradient(unberthing, leaving, jnp.array(rates, float), *switches)


def recursive(
    limits: TrustLimits | None = None,
    gated: bool = True,
    forward: bool = False,
    fading: bool = True,
) -> Recursive:
    """The library's estimator with its trust and gate; `fading`: it knows that thrusters fade."""
    switches = (jnp.asarray(switch, float) for switch in (gated, forward))
    return Recursive(*guard(limits, fading), *switches)


def _where(which: Bool[Array, ""], one: Linear, other: Linear) -> Linear:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), one, other)
