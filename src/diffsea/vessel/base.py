"""The interfaces of forces and actuators, and the vessel that sums them.

`Vessel.acceleration` is the textbook's `M nu_r_dot = sum(tau)` (Fossen 2021, chapter 6),
with the Coriolis terms among the named forces, so that a plot, a report or a diagnosis can
ask where a motion comes from.
"""

import abc
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea.kinematics import through_water, to_body, to_earth
from diffsea.scales import positive_inertia, time_scale
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.sensors import Sensors
from diffsea.vessel.servo import Servo
from diffsea.vessel.tables import Table, number


class Force(eqx.Module):
    """A generalised force in body axes about the midship origin."""

    X: Scalar = 0.0  # N, forward
    Y: Scalar = 0.0  # N, to starboard
    N: Scalar = 0.0  # N m, turning the bow to starboard

    def __add__(self, other: "Force") -> "Force":
        return Force(self.X + other.X, self.Y + other.Y, self.N + other.N)

    def __sub__(self, other: "Force") -> "Force":
        return Force(self.X - other.X, self.Y - other.Y, self.N - other.N)

    @classmethod
    def of_thrust(cls, thrust: Scalar, x: Scalar, y: Scalar, angle: Scalar) -> "Force":
        """A thrust (N) that acts at (x, y) m, `angle` rad clockwise from ahead."""
        X, Y = thrust * jnp.cos(angle), thrust * jnp.sin(angle)
        return cls(X, Y, x * Y - y * X)

    @property
    def stacked(self) -> Float[Array, "3"]:
        """Surge force (N), sway force (N) and yaw moment (N m) as one array."""
        return jnp.stack([jnp.asarray(part, float) for part in (self.X, self.Y, self.N)])


Forces = dict[str, Force]  # by name


class Jet(eqx.Module):
    """What a rudder needs to know of the propeller ahead of it."""

    inflow: Scalar  # m/s, axial velocity into the propeller disc
    loading: Scalar  # m^2/s^2, 8 K_T n^2 D^2 / pi
    diameter: Scalar  # m


class AbstractForce(eqx.Module):
    """A generalised force on the hull that depends on motion, environment and time.

    `resists` says whether it is the water's resistance to the hull's motion, which changes
    with depth and fouling.
    """

    resists: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        """The force at this instant; `state` is over ground, `t` is the run's clock in s."""


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
        """The force at this instant; `forces` are the vessel's others by name."""


class CommandChannel(NamedTuple):
    """What a channel of an actuator commands.

    A steering channel takes an angle; propulsion drives ahead, a side thrust does not.
    """

    role: Literal["propulsion", "side thrust", "steering"]
    unit: Literal["N", "rev/s", "rad"]


class AbstractActuator(eqx.Module):
    """Something that is commanded: its channels, how they respond, and the force they make.

    A channel is one commanded number; `servos` gives each channel's response from order to
    executed value, `channels` its role and unit. `force` turns executed values into a force.
    Actuators of a `differential` kind steer by the difference of their thrusts on both sides.
    """

    differential: ClassVar[bool] = False
    servos: eqx.AbstractVar[dict[str, Servo]]
    y: eqx.AbstractVar[Scalar]  # m to starboard

    @property
    @abc.abstractmethod
    def channels(self) -> dict[str, CommandChannel]:
        """What every channel commands."""

    @abc.abstractmethod
    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Orders of its channels, its share in control allocation.

        `throttle` is what it shares with no other: N of its own thrust, or rev/s. A rudder of
        the same `angle` (rad) turns the vessel as much; positive is a turn to starboard.
        """

    @abc.abstractmethod
    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        """Force of the executed channels; `water` has velocities through the water (m/s)."""

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
        """The losses that an actuator's table states."""
        return cls(*(number(table, key, where, 0.0) for key in cls.KEYS))

    def factor(self, water: State) -> Scalar:
        """The factor at this motion through the water."""
        speed, turn = 1 - self.with_speed * water.u, 1 - self.in_turns * jnp.abs(water.r)
        return (1 + self.asymmetry) * speed * turn


class AbstractPropulsor(AbstractActuator):
    """An actuator that drives the vessel ahead, with losses on its thrust."""

    losses: eqx.AbstractVar[Losses]
    diameter: eqx.AbstractVar[Scalar | None]  # m, of a screw's disc; None where it is not known

    @property
    @abc.abstractmethod
    def bollard_coefficient(self) -> Scalar | None:
        """Thrust at rest over n |n| (N s^2); None where thrust is ordered in N."""


class RigidBody(eqx.Module):
    """Mass properties and main dimensions."""

    mass: Scalar  # kg
    I_z: Scalar  # kg m^2, about the centre of gravity
    x_G: Scalar = 0.0  # m, centre of gravity forward of amidships
    length: Scalar = 1.0  # m, L_pp
    beam: Scalar = 1.0  # m
    draught: Scalar = 1.0  # m
    water_density: Scalar = 1025.0  # kg/m^3
    payload: Scalar = 0.0  # kg, taken on amidships (negative: lost) ...
    payload_time: Scalar = 0.0  # s, ... at this time of the run

    def at(self, t: Scalar) -> "RigidBody":
        """The body with what it carries at time `t` of the run."""
        mass = self.mass + self.payload * step(t, self.payload_time, self.length)
        moment = self.mass * self.x_G  # amidships it has none, nor inertia about amidships
        x_G = moment / mass
        I_z = self.I_z + moment * (self.x_G - x_G)
        return eqx.tree_at(lambda b: (b.mass, b.x_G, b.I_z), self, (mass, x_G, I_z))

    def coriolis(self, water: State) -> Force:
        """Coriolis and centripetal force of the rigid body (Fossen 2021, eq. 3.63)."""
        u, v, r, m = water.u, water.v, water.r, self.mass
        return Force(m * r * (v + self.x_G * r), -m * u * r, -m * self.x_G * u * r)


class AddedMass(eqx.Module):
    """Added masses of planar motion, with SNAME signs (a negative value adds inertia)."""

    X_udot: Scalar = 0.0  # kg
    Y_vdot: Scalar = 0.0  # kg
    Y_rdot: Scalar = 0.0  # kg m
    N_vdot: Scalar = 0.0  # kg m
    N_rdot: Scalar = 0.0  # kg m^2
    coriolis_terms: str = eqx.field(static=True, default="full")

    def in_depth(self, shallowness: Scalar) -> "AddedMass":
        """The added masses in shallow water, where they grow as `(1 - T / h)^(-1/2)`.

        `shallowness` is `-ln(1 - T / h)`: any number is a depth then.

        About half more at h = 2 T and three quarters more at 1.5 T, what tests in shallow
        basins show for full hulls; hulls differ from it by tens of per cent.
        """
        growth = jnp.exp(0.5 * shallowness)
        return jax.tree.map(lambda value: value * growth, self)

    def coriolis(self, water: State) -> Force:
        """Coriolis force of the added mass from the same matrix (Fossen 2021, eq. 6.46).

        `coriolis_terms` is "full", "no-munk" where the moment proportional to `u v` is
        already in the hull's `N_v` (MMG sets), or "none" where the derivatives hold
        everything (Abkowitz sets).
        """
        if self.coriolis_terms == "none":
            return Force()
        u, v, r = water.u, water.v, water.r
        coupling = -0.5 * (self.Y_rdot + self.N_vdot)
        lateral = -self.Y_vdot * v + coupling * r
        munk = (self.Y_vdot - self.X_udot) * u * v if self.coriolis_terms == "full" else 0.0
        return Force(r * lateral, self.X_udot * u * r, munk - coupling * u * r)


def step(t: Scalar, at: Scalar, length: Scalar) -> Scalar:
    """A change at time `at` s: from zero to one, half at `at`, within some tenths of sqrt(L / g).

    Smooth, so that motion has a derivative by the time of the change.
    """
    return jax.nn.sigmoid((t - at) / (0.1 * time_scale(length)))


class Vessel(eqx.Module):
    """A surface vessel: rigid body, added mass, named forces, actuators and sensors.

    `environment` is where the vessel is unless a run says otherwise.
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
        return tuple(channel for part in self.actuators.values() for channel in part.servos)

    @property
    def units(self) -> dict[str, str]:
        """In what every channel is commanded: N, rev/s or rad."""
        parts = self.actuators.values()
        return {c: part.channels[c].unit for part in parts for c in part.servos}

    @property
    def servos(self) -> dict[str, Servo]:
        """The servo of every channel."""
        return {c: s for part in self.actuators.values() for c, s in part.servos.items()}

    @property
    def propulsors(self) -> dict[str, AbstractPropulsor]:
        """The actuators that drive the vessel ahead, by name."""
        parts = self.actuators.items()
        return {name: part for name, part in parts if isinstance(part, AbstractPropulsor)}

    def mass_matrix(self) -> Float[Array, "3 3"]:
        """Rigid-body plus added mass about the midship origin (kg, kg m, kg m^2)."""
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
        body, added = (
            self.rigid_body.at(t),
            self.added_mass.in_depth(environment.shallowness),
        )
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
        """Every force on the vessel by name (N, N m), inertial ones included."""
        water = through_water(state, environment)
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

    def acceleration(
        self, state: State, executed: dict[str, Scalar], environment: Environment, t: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Accelerations of `u`, `v` (m/s^2) and `r` (rad/s^2): `M^-1 sum(tau)`.

        The equation holds for velocities through the water; a steady current adds the
        turning of its own body-axis components (Fossen 2021, eq. 10.137).
        """
        forces = self.breakdown(state, executed, environment, t).values()
        tau = sum(forces, Force())
        m11, m22, m23, m32, m33 = self._inertia(environment, t)
        determinant = m22 * m33 - m23 * m32
        flow = to_body(environment.current_north, environment.current_east, state.psi)
        return (
            tau.X / m11 + state.r * flow[1],
            (m33 * tau.Y - m23 * tau.N) / determinant - state.r * flow[0],
            (m22 * tau.N - m32 * tau.Y) / determinant,
        )

    def rate(
        self, state: State, executed: dict[str, Scalar], environment: Environment, t: Scalar
    ) -> State:
        """Time derivative of the state."""
        north, east = to_earth(state.u, state.v, state.psi)
        u_dot, v_dot, r_dot = self.acceleration(state, executed, environment, t)
        return State(north, east, state.r, u_dot, v_dot, r_dot)
