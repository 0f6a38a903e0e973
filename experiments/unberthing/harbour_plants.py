# pyright: reportArgumentType=false
"""What sails under the control system: a ship of the estimator's structure, or of another one."""

import abc
from typing import Any

from experiments.unberthing.harbour_ship import PERIOD, orders
from experiments.unberthing.polynomial_ship import (
    Afloat,
    PolynomialShip,
    advanced,
    at,
    thrusters_side_force,
)

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea import Environment, State, Vessel
from diffsea.simulation.integrate import SimulationState, advance, begin, history_lengths
from diffsea.types import Scalar


LONGEST_DELAY = 8.0  # s, of any actuator of any seed's ship


class Air(eqx.Module):
    """Water and air of one control period, m/s: where they move to."""

    current_north: Scalar
    current_east: Scalar
    wind_north: Scalar
    wind_east: Scalar


class AbstractPlant(eqx.Module):
    """A ship; all numbers are leaves, so that ships of one kind make a batch."""

    @abc.abstractmethod
    def begin(self, start: State) -> Any:
        """The ship's motion at the start, actuators at rest."""

    @abc.abstractmethod
    def state(self, motion: Any) -> State:
        """True position, heading and speeds over ground."""

    @abc.abstractmethod
    def advance(self, motion: Any, blades: Float[Array, "4"], air: Air, t: Scalar) -> Any:
        """One control period (`PERIOD`) on, with the angles of `INPUTS` (rad) ordered."""

    @abc.abstractmethod
    def side_force(self, motion: Any, blades: Float[Array, "4"]) -> Scalar:
        """What the thrusters' orders come to once executed at this speed, N to starboard."""


class RegressionShip(AbstractPlant):
    """A vessel of the library: the structure that the estimators' models have, too."""

    vessel: Vessel

    def begin(self, start: State) -> SimulationState:
        lengths = history_lengths(self.vessel, PERIOD, longest=LONGEST_DELAY)
        still = {c: jnp.zeros(()) for c in self.vessel.channels}
        return begin(self.vessel, start, still, lengths)

    def state(self, motion: SimulationState) -> State:
        return motion.state

    def advance(
        self, motion: SimulationState, blades: Float[Array, "4"], air: Air, t: Scalar
    ) -> SimulationState:
        environment = Environment(
            air.current_north, air.current_east, air.wind_north, air.wind_east
        )
        ordered = {c: jnp.asarray(order, float) for c, order in orders(blades).items()}
        return advance(self.vessel, motion, ordered, environment, t, PERIOD)

    def side_force(self, motion: SimulationState, blades: Float[Array, "4"]) -> Scalar:
        ordered = orders(blades)
        parts = (self.vessel.actuators[name] for name in ("bow", "stern"))
        return sum(part.force(ordered, motion.state, {}).Y for part in parts)


class OtherShip(AbstractPlant):
    """A ship of another structure: a whole-hull polynomial, jets that act on the hull, a quay."""

    ship: PolynomialShip

    def begin(self, start: State) -> Afloat:
        return at(self.ship, start.x, start.y, start.psi, start.u)

    def state(self, motion: Afloat) -> State:
        return State(motion.x, motion.y, motion.psi, motion.u, motion.v, motion.r)

    def advance(self, motion: Afloat, blades: Float[Array, "4"], air: Air, t: Scalar) -> Afloat:
        flow = air.current_north, air.current_east, air.wind_north, air.wind_east
        return advanced(self.ship, motion, blades, *flow, PERIOD)

    def side_force(self, motion: Afloat, blades: Float[Array, "4"]) -> Scalar:
        return thrusters_side_force(self.ship, motion, blades)
