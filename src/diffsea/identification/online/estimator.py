"""What every online estimator is: parameters, a belief about them, and one step per measurement.

Trust and gate (`guarded`) know an estimator by this interface alone, so that a further one needs
nothing but its recursion.
"""

import abc
from collections.abc import Mapping, Sequence
from typing import ClassVar, Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError
from diffsea.identification.coordinates import free_by_default
from diffsea.parameters import Parameter, check_names, hull_prior, named, replace
from diffsea.simulation.integrate import SimulationState, begin, history_lengths
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS
from diffsea.vessel.effects.actuators import change_servos
from diffsea.vessel.servo import Servo


ParameterChoice = Sequence[str | Parameter]
Orders = dict[str, Scalar]  # by channel, in the channel's unit
Measurement = Float[Array, "6"]  # x, y (m), psi (rad), u, v (m/s), r (rad/s); NaN where missing


ESTIMATORS = ("kalman", "least-squares")
DRIFT = 1e-3  # of a parameter's prior mean per sqrt(s): 3 % in a quarter of an hour
_ADDED_MASS = "dot"  # how the names of added masses end


class AbstractBelief(eqx.Module):
    """What an estimator knows at one instant."""

    t: Scalar  # s
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    @property
    @abc.abstractmethod
    def coordinates(self) -> Float[Array, "parameter"]:
        """Estimates of the parameters' coordinates, zero at the prior mean."""

    @property
    @abc.abstractmethod
    def parameter_covariance(self) -> Float[Array, "parameter parameter"]:
        """Covariance of the coordinates."""

    @property
    def values(self) -> dict[str, Scalar]:
        """The parameters in SI units."""
        return decode_parameters(self.parameters, self.coordinates)


Belief = TypeVar("Belief", bound=AbstractBelief)


class Innovation(eqx.Module):
    """What one measurement said beyond what was expected of it."""

    white: Float[Array, "channel"]  # in unit variance, given the channels before; 0 where missing
    share: Float[Array, "channel"]  # independent samples that it counts for, 0 to 1
    change: Float[Array, "parameter"]  # of the coordinates, by this measurement
    settled: Float[Array, "parameter"]  # variance of the coordinates that it took away


class AbstractEstimator(eqx.Module, Generic[Belief]):
    """A recursive estimator of a vessel's parameters; its fields do not change while it runs.

    `channels` names the innovations of each step in their order.
    """

    channels: ClassVar[tuple[str, ...]]

    vessel: Vessel  # at the prior mean
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    @abc.abstractmethod
    def init(
        self, start: State, *, orders: Mapping[str, Scalar] | None = None, t: float = 0.0
    ) -> Belief:
        """The belief before the first measurement.

        Arguments:
            start: rough guess of the first state (m, rad, m/s, rad/s).
            orders: orders under which the actuators have settled; zero by default.
            t: s.
        """

    @abc.abstractmethod
    def step(
        self, belief: Belief, orders: Orders, measurement: Measurement, dt: Scalar
    ) -> tuple[Belief, Innovation]:
        """The belief `dt` s later, after a measurement there. Pure, for `jit` and `lax.scan`.

        Arguments:
            orders: what held since the last step; the executed value for a channel whose
                execution is measured.
            measurement: NaN where there is none, so that sensors of different rates and lost
                samples need nothing special.
            dt: s since the last step; zero for the first measurement of a run.
        """

    @abc.abstractmethod
    def reset(self, belief: Belief, coordinates: Float[Array, "parameter"]) -> Belief:
        """The same motion, the parameters back at `coordinates` with their prior's uncertainty."""

    def settled_motion(
        self, start: State, orders: Mapping[str, Scalar] | None, step: float
    ) -> SimulationState:
        """The vessel at `start`, its actuators settled to the orders (zero where none is given).

        `step` (s) is the time between orders: it sets how many of them a delay remembers.
        """
        settled: Orders = {
            c: jnp.asarray((orders or {}).get(c, 0.0), float) for c in self.vessel.channels
        }
        return begin(self.vessel, start, settled, history_lengths(self.vessel, step, 3.0))

    def vessel_at(self, coordinates: Float[Array, "parameter"]) -> Vessel:
        """The vessel with its parameters at these coordinates."""
        return replace(self.vessel, decode_parameters(self.parameters, coordinates))


def decode_parameters(
    parameters: Sequence[Parameter], coordinates: Float[Array, "parameter"]
) -> dict[str, Scalar]:
    """The parameters in SI units at some coordinates, by name."""
    return {p.name: p.decode(coordinates[k]) for k, p in enumerate(parameters)}


def parameters_with_priors(vessel: Vessel, free: ParameterChoice) -> tuple[Parameter, ...]:
    """The parameters to estimate, those given by name with the prior of `hull_prior`.

    Their coordinate is the number itself, not its logarithm: motion is linear in most of them,
    and a filter that linearises once and never looks back goes astray in a logarithm. The sign
    is looked after by `online.trust`. A component of current or wind has the catalogue's size of
    that effect as its standard deviation.

    Raises:
        UserError: nothing chosen, an unknown name, one chosen twice, or a number that is zero
            in the vessel, whose scale cannot be told from it.
    """
    if not free:
        raise UserError("nothing to estimate: name at least one parameter of the vessel")
    names = [choice.name if isinstance(choice, Parameter) else choice for choice in free]
    check_names(vessel, names)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise UserError(f"parameter {twice!r} is chosen twice")
    values, parameters = named(vessel), []
    for choice in free:
        if isinstance(choice, Parameter):
            parameters.append(choice)
            continue
        value = float(values[choice])
        flow, _, component = choice.partition("_")
        if flow in ("current", "wind") and component in ("north", "east"):
            size = EFFECTS[flow].sizes(vessel)[0]
            parameters.append(Parameter(choice, value, size, 1.0, unit="m/s"))
        elif value == 0:
            raise UserError(
                f"{choice} is zero in the vessel, which says nothing of its size: give a Parameter "
                "with a scale, for example Parameter('sensors.gyro_bias', 0.0, scale=0.01)"
            )
        else:
            parameters.append(without_bounds(hull_prior(choice, value)))
    return tuple(parameters)


def usual_parameters(vessel: Vessel) -> tuple[str, ...]:
    """The hull's derivatives, which are estimated where nothing else is asked for."""
    return tuple(name for name in free_by_default(vessel) if not name.endswith(_ADDED_MASS))


def without_bounds(parameter: Parameter) -> Parameter:
    """The same prior mean and standard deviation on the number itself, without bounds."""
    scale = parameter.slope(0.0)
    return Parameter(parameter.name, parameter.value, scale, parameter.spread, unit=parameter.unit)


def prior_std(parameters: Sequence[Parameter]) -> Float[np.ndarray, "parameter"]:
    """Prior standard deviation of every coordinate."""
    return np.array([parameter.spread for parameter in parameters])


def with_measured_actuation(vessel: Vessel, measured: Sequence[str]) -> Vessel:
    """The vessel whose measured channels execute at once what is passed for their order.

    Raises:
        UserError: a channel that the vessel does not have.
    """
    for channel in measured:
        if channel not in vessel.channels:
            raise UserError(
                f"{channel!r} is said to be measured, but the vessel has no such actuator "
                f"channel; it has: {', '.join(vessel.channels)}"
            )
    return change_servos(vessel, measured, lambda servo, actuator: Servo())
