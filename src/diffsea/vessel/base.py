"""The interface of actuators, and the vessel that sums all forces.

`Vessel.acceleration` is the textbook's `M nu_r_dot = sum(tau)` (Fossen 2021, chapter 6),
with the Coriolis terms among the named forces, so that a plot, a report or a diagnosis can
ask where a motion comes from.
"""

import abc
from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.kinematics import through_water, to_body, to_earth
from diffsea.scales import is_absent, positive_inertia
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.forces import AbstractForce, Force
from diffsea.vessel.inertia import AddedMass, RigidBody
from diffsea.vessel.sensors import Sensors
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, numbers


Forces = dict[str, Force]  # by name
OrderUnit = Literal["N", "rev/s", "rpm", "percent", "normalised", "us"]  # of propulsion


class Jet(eqx.Module):
    """What a rudder needs to know of the propeller ahead of it."""

    inflow: Scalar  # m/s, axial velocity into the propeller disc
    loading: Scalar  # m^2/s^2, 8 K_T n^2 D^2 / pi
    diameter: Scalar  # m


class AbstractDependentForce(eqx.Module):
    """A force that follows from others: what they bring about, or a change of them.

    `part_of` says what it adds to, so that a change of that ("resistance", "thrust") changes it
    too; changes have no such part and come last.
    """

    part_of: ClassVar[str] = ""

    @abc.abstractmethod
    def __call__(
        self, vessel: "Vessel", forces: Forces, water: State, environment: Environment, t: Scalar
    ) -> Force:
        """The force (N, N m) at `t` s of the run's clock; `water` is the motion through the water.

        `forces` are the vessel's others by name, as far as they are known yet.
        """


class CommandChannel(NamedTuple):
    """What a channel of an actuator commands.

    A steering channel takes an angle; propulsion drives ahead, a side thrust does not.
    """

    role: Literal["propulsion", "side thrust", "steering"]
    unit: OrderUnit | Literal["rad"]


class AbstractActuator(eqx.Module):
    """Something that is commanded: its channels, how they respond, and the force they make.

    A channel is one commanded number; `servos` gives each channel's response from order to
    executed value. `command` is the role and unit of all channels; a class whose channels differ
    says it in `channels` instead. `force` turns executed values into a force.
    """

    command: ClassVar[CommandChannel]
    servos: eqx.AbstractVar[dict[str, Servo]]
    y: eqx.AbstractVar[Scalar]  # m to starboard

    @property
    def differential(self) -> bool:
        """Whether it steers by the difference of thrusts on both sides."""
        return False

    @property
    def channels(self) -> dict[str, CommandChannel]:
        """What every channel commands."""
        return dict.fromkeys(self.servos, self.command)

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders of its channels, its share in control allocation.

        `throttle` is what it shares with no other: N of its own thrust at rest, or rev/s. A rudder
        of the same `angle` (rad) turns the vessel as much; positive is a turn to starboard. Side
        thrusts are left alone.
        """
        of_role = {"propulsion": throttle, "steering": angle, "side thrust": 0.0}
        return {name: of_role[channel.role] for name, channel in self.channels.items()}

    @abc.abstractmethod
    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        """Force (N, N m) of the executed channels, in their units.

        `water` has velocities through the water (m/s, rad/s), `jets` the slipstreams of the
        vessel's propellers by the name of the actuator.
        """

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        """The slipstream it makes for a rudder behind it, or None."""
        return None

    @classmethod
    @abc.abstractmethod
    def from_table(cls, name: str, table: Table, vessel: "Vessel") -> "AbstractActuator":
        """The actuator of a table in a vessel file.

        `vessel` is what the file has said before: the hull, and actuators of other kinds.

        Raises:
            UserError: an unknown key, a missing or an impossible value.
        """


class Losses(eqx.Module):
    """Factors on a propulsor's thrust, all of them one at zero.

    Thrust times `(1 + asymmetry) (1 - with_speed u_r) (1 - in_turns |r|)`.
    """

    KEYS: ClassVar[tuple[str, ...]] = ("asymmetry", "with_speed", "in_turns")

    asymmetry: Scalar = 0.0  # relative change of this propulsor's thrust
    with_speed: Scalar = 0.0  # s/m
    in_turns: Scalar = 0.0  # s/rad

    @classmethod
    def from_table(cls, table: Table, where: str) -> "Losses":
        """The losses that an actuator's table states. Raises `UserError` for no numbers."""
        return cls(**numbers(table, cls.KEYS, where))

    def factor(self, water: State) -> Scalar:
        """The factor at this motion through the water (m/s, rad/s)."""
        speed = 1.0 if is_absent(self.with_speed) else 1 - self.with_speed * water.u
        turn = 1.0 if is_absent(self.in_turns) else 1 - self.in_turns * jnp.abs(water.r)
        return (1 + self.asymmetry) * speed * turn


class AbstractPropulsor(AbstractActuator):
    """An actuator that drives the vessel ahead, with losses on its thrust."""

    x: eqx.AbstractVar[Scalar]  # m forward of amidships
    losses: eqx.AbstractVar[Losses]
    diameter: eqx.AbstractVar[Scalar | None]  # m, of a screw's disc; None where it is not known

    @property
    def takes_throttle(self) -> bool:
        """Whether control allocation drives with it; one that pushes across is left alone."""
        return True

    @property
    @abc.abstractmethod
    def bollard_coefficient(self) -> Scalar | None:
        """Thrust at rest over n |n| (N s^2, n rev/s); None where a throttle is a thrust in N."""

    @property
    def full_throttle(self) -> Scalar | None:
        """Its own throttle (N, or rev/s) at its limit ahead; None without a limit."""
        of_role = (c for c, channel in self.channels.items() if channel.role == "propulsion")
        return self.servos[next(of_role)].upper

    def thrust_at_rest(self, executed: Scalar) -> Scalar:
        """Thrust (N) in still water at rest of executed values of its propulsion channel."""
        d = self.bollard_coefficient
        return executed if d is None else d * executed * jnp.abs(executed)


class Vessel(eqx.Module):
    """A surface vessel: rigid body, added mass, named forces, actuators and sensors.

    `environment` is where the vessel is unless a run says otherwise.

    Raises:
        TypeError: one of the forces does not return a `Force`.
    """

    rigid_body: RigidBody
    added_mass: AddedMass
    forces: dict[str, AbstractForce]
    actuators: dict[str, AbstractActuator]
    dependent_forces: dict[str, AbstractDependentForce] = eqx.field(default_factory=dict)
    environment: Environment = Environment()
    sensors: Sensors = Sensors()
    name: str = eqx.field(static=True, default="vessel")
    source: str = eqx.field(static=True, default="")

    def __check_init__(self):
        still = State(*(jnp.zeros(()) for _ in range(6)))
        for name, force in self.forces.items():
            made = eqx.filter_eval_shape(force, still, Environment(), 0.0)
            if not isinstance(made, Force):
                raise TypeError(f"force {name!r} returns {type(made).__name__}, expected Force")

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the command channels, in the order of the actuators."""
        return tuple(self.servos)

    @property
    def units(self) -> dict[str, str]:
        """In what every channel is commanded: rad, or one of `OrderUnit`."""
        parts = self.actuators.values()
        return {c: part.channels[c].unit for part in parts for c in part.servos}

    @property
    def servos(self) -> dict[str, Servo]:
        """The servo of every channel."""
        return {c: s for part in self.actuators.values() for c, s in part.servos.items()}

    @property
    def thrusts_at_rest(self) -> dict[str, Callable[[Scalar], Scalar]]:
        """What makes executed values a thrust at rest (N), by propulsion channel."""
        return {
            name: part.thrust_at_rest
            for part in self.propulsors.values()
            for name, channel in part.channels.items()
            if channel.role == "propulsion"
        }

    @property
    def propulsors(self) -> dict[str, AbstractPropulsor]:
        """The actuators that drive the vessel ahead, by name."""
        parts = self.actuators.items()
        return {name: part for name, part in parts if isinstance(part, AbstractPropulsor)}

    @property
    def driving(self) -> list[AbstractPropulsor]:
        """The propulsors that take a throttle."""
        return [part for part in self.propulsors.values() if part.takes_throttle]

    def mass_matrix(self) -> Float[Array, "3 3"]:
        """Rigid-body plus added mass about the midship origin (kg, kg m, kg m^2).

        That of the vessel's own environment, without what it takes on during a run.
        """
        m11, m22, m23, m32, m33 = self._inertia(self.environment, 0.0)
        return jnp.array([[m11, 0.0, 0.0], [0.0, m22, m23], [0.0, m32, m33]])

    def has_inertia(self) -> Bool[Array, ""]:
        """Whether the mass matrix is positive definite: else a vessel speeds up against a force."""
        return positive_inertia(self.mass_matrix())

    def if_possible(self) -> "Vessel":
        """This vessel; where its inertia is impossible, one that predicts nothing but NaN.

        A fit cannot end there.
        """
        mass = jnp.where(self.has_inertia(), self.rigid_body.mass, jnp.nan)
        return eqx.tree_at(lambda v: v.rigid_body.mass, self, mass)

    def _inertia(self, environment: Environment, t: Scalar) -> tuple[Scalar, ...]:
        """Elements 11, 22, 23, 32 and 33 of the mass matrix at time `t` of a run."""
        body = self.rigid_body.at(t)
        added = self.added_mass.in_depth(environment.shallowness)
        moment = body.mass * body.x_G
        return (
            body.mass - added.X_udot,
            body.mass - added.Y_vdot,
            moment - added.Y_rdot,
            moment - added.N_vdot,
            body.I_z + moment * body.x_G - added.N_rdot,
        )

    def breakdown(
        self, state: State, executed: dict[str, Scalar], environment: Environment, t: Scalar
    ) -> Forces:
        """Every force on the vessel by name (N, N m), inertial ones included.

        `executed` are the values of all channels in their units, `t` is the run's clock in s.
        """
        water = through_water(state, environment)
        executed = {c: servo.acting(executed[c]) for c, servo in self.servos.items()}
        jets = {n: part.jet(executed, water) for n, part in self.actuators.items()}
        jets = {name: jet for name, jet in jets.items() if jet is not None}
        added = self.added_mass.in_depth(environment.shallowness)
        forces = {
            "rigid-body-coriolis": self.rigid_body.at(t).coriolis(water),
            "added-mass-coriolis": added.coriolis(water),
            **{name: force(state, environment, t) for name, force in self.forces.items()},
            **{n: part.force(executed, water, jets) for n, part in self.actuators.items()},
        }
        for last in (False, True):
            forces = forces | {
                name: force(self, forces, water, environment, t)
                for name, force in self.dependent_forces.items()
                if (force.part_of == "") == last
            }
        return forces

    def sum_of_part(self, forces: Forces, part: str) -> Force:
        """The "resistance" of the water to the hull's motion, or the "thrust" of all propulsors.

        With the dependent forces that are part of it, as far as `forces` has them yet.
        """
        if part == "thrust":
            names = list(self.propulsors)
        else:
            names = [name for name, force in self.forces.items() if force.resists]
        names += [n for n, f in self.dependent_forces.items() if f.part_of == part and n in forces]
        return sum((forces[name] for name in names), Force())

    def acceleration(
        self, state: State, executed: dict[str, Scalar], environment: Environment, t: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Accelerations of `u`, `v` (m/s^2) and `r` (rad/s^2): `M^-1 sum(tau)`.

        The equation holds for velocities through the water; a steady current adds the
        turning of its own body-axis components (Fossen 2021, eq. 10.137).
        """
        tau = sum(self.breakdown(state, executed, environment, t).values(), Force())
        m11, m22, m23, m32, m33 = self._inertia(environment, t)
        determinant = m22 * m33 - m23 * m32
        u_dot = tau.X / m11
        v_dot = (m33 * tau.Y - m23 * tau.N) / determinant
        r_dot = (m22 * tau.N - m32 * tau.Y) / determinant
        current = environment.current_north, environment.current_east
        if not is_absent(*current):
            flow = to_body(*current, state.psi)
            u_dot, v_dot = u_dot + state.r * flow[1], v_dot - state.r * flow[0]
        return u_dot, v_dot, r_dot

    def rate(
        self, state: State, executed: dict[str, Scalar], environment: Environment, t: Scalar
    ) -> State:
        """Time derivative of the state: m/s, rad/s, m/s^2 and rad/s^2."""
        north, east = to_earth(state.u, state.v, state.psi)
        u_dot, v_dot, r_dot = self.acceleration(state, executed, environment, t)
        return State(north, east, state.r, u_dot, v_dot, r_dot)
