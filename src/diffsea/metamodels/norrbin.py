"""Metamodels: how a vessel answers in one kind of manoeuvre, and nothing else.

A metamodel is identified from several trials, each with disturbances of its own, and then
stands for what the trials have in common (Gavrilin and Steen 2017). It is no model of forces:
outside the angles and speeds of its trials it means nothing.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.kinematics import through_water
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.actuators import DerivativeRudder
from diffsea.vessel.base import Vessel
from diffsea.vessel.forces import AbstractForce, Force, Wind
from diffsea.vessel.hull import Scaling
from diffsea.vessel.inertia import AddedMass, RigidBody
from diffsea.vessel.servo import Servo


class Norrbin(eqx.Module):
    """Norrbin's nonlinear equation of yaw with bias and quadratic term.

    `dr/dt + a_0 + a_1 r + a_2 r^2 + a_3 r^3 = b delta` (Norrbin 1963; Gavrilin and Steen 2017,
    eq. 1): yaw rate `r` and rudder angle `delta` are positive to starboard. A positive `a_1`
    keeps a straight course without help; `a_0` and `a_2` are the asymmetry of a single
    screw or of rudders out of line. In the form `T dr/dt + H_N(r) = K delta` with
    `H_N = n_0 + n_1 r + n_2 r^2 + n_3 r^3` and |n_1| = 1 (Fossen 2021, section 7.2) it
    is T = 1 / |a_1|, K = b / |a_1| and n_i = a_i / |a_1|.

    Sway is not in it: a steady uniform current changes nothing, wind and waves do.
    """

    a0: Scalar  # rad/s^2
    a1: Scalar  # 1/s
    a2: Scalar  # 1/rad
    a3: Scalar  # s/rad^2
    b: Scalar  # 1/s^2

    @staticmethod
    def of(coefficients: Float[Array, "5"]) -> "Norrbin":
        """From a_0, a_1, a_2, a_3 and b in one array."""
        return Norrbin(*(coefficients[k] for k in range(5)))

    @property
    def coefficients(self) -> Float[Array, "5"]:
        """a_0, a_1, a_2, a_3 and b in one array."""
        return jnp.stack([jnp.asarray(x, float) for x in jax.tree.leaves(self)])

    @property
    def gain(self) -> Scalar:
        """Nomoto's K (1/s): yaw rate per rudder angle of small steady turns."""
        return self.b / self.a1

    @property
    def time_constant(self) -> Scalar:
        """Nomoto's T (s); negative where the vessel does not keep a straight course."""
        return 1 / self.a1

    @property
    def neutral(self) -> Scalar:
        """Rudder angle (rad) under which the vessel runs straight."""
        return self.a0 / self.b

    def response(self, r: Scalar, delta: Scalar) -> Scalar:
        """dr/dt (rad/s^2) at a yaw rate (rad/s) and a rudder angle (rad)."""
        return self.b * delta - (self.a0 + r * (self.a1 + r * (self.a2 + r * self.a3)))

    def step(self, r: Scalar, start: Scalar, end: Scalar, dt: Scalar) -> Scalar:
        """Yaw rate `dt` s later, the rudder moving evenly from angle `start` to `end` (rad)."""
        middle = 0.5 * (start + end)
        k1 = self.response(r, start)
        k2 = self.response(r + 0.5 * dt * k1, middle)
        k3 = self.response(r + 0.5 * dt * k2, middle)
        k4 = self.response(r + dt * k3, end)
        return r + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def simulate(self, r: Scalar, delta: Float[Array, "time"], dt: Scalar) -> Float[Array, "time"]:
        """Yaw rate (rad/s) at every sample, from `r` at the first.

        `delta` is the executed rudder angle (rad) every `dt` s, straight between samples.
        """

        def body(now: Scalar, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            return self.step(now, *ends, dt), now

        last, rates = jax.lax.scan(body, jnp.asarray(r, float), (delta[:-1], delta[1:]))
        return jnp.append(rates, last)

    def at_speed(self, ratio: Scalar) -> "Norrbin":
        """The model at `ratio` times its speed, the flow about hull and rudder being alike.

        Distances in ship lengths are then the same: rates grow with the speed, times fall. It
        holds where propeller and rudder share the speed; a metamodel of other trials tells.
        """
        s = ratio
        return Norrbin(self.a0 * s**2, self.a1 * s, self.a2, self.a3 / s, self.b * s**2)

    def vessel(self, length: Scalar, speed: Scalar, wind_moment: Scalar = 0.0) -> Vessel:
        """The model as a vessel, for trials, metrics, likelihoods and everything else.

        One channel, `rudder`, that acts at once. The vessel keeps `speed` (m/s) and never
        drifts; its moment of inertia is one, so that moments are yaw accelerations.
        `length` (m) sets scales of plausibility and noise. `wind_moment` is the yaw
        acceleration (rad/s^2) that wind from 45 deg ahead of abeam causes at 10 m/s apparent.
        """
        draught = 0.05 * length
        # Unit of moment one at this speed.
        scaling = Scaling("abkowitz", length, draught, 2 / (length**3 * speed**2), speed)
        rudder = DerivativeRudder({"rudder": Servo()}, {"N_d": self.b}, scaling)
        # Wind that only yaws, by `wind_moment` at 10 m/s from 45 deg.
        unit = 0.5 * 1.225 * 10.0**2 * length
        wind = Wind(0.0, 1.0, length, C_X=0.0, C_Y=0.0, C_N=-wind_moment / unit)
        body = RigidBody(1.0, 1.0, length=length, beam=0.15 * length, draught=draught)
        forces = {"norrbin": NorrbinDamping(self.a0, self.a1, self.a2, self.a3), "wind": wind}
        return Vessel(body, AddedMass(), forces, {"rudder": rudder}, name="norrbin")


class NorrbinDamping(AbstractForce):
    """The hull's side of Norrbin's equation, for a vessel of unit mass and unit inertia.

    `N = -(a_0 + a_1 r + a_2 r^2 + a_3 r^3)`; surge and sway forces hold speed and drift.
    """

    a0: Scalar
    a1: Scalar
    a2: Scalar
    a3: Scalar

    def __call__(self, state: State, environment: Environment, t: Scalar) -> Force:
        water = through_water(state, environment)
        r = water.r
        N = -(self.a0 + r * (self.a1 + r * (self.a2 + r * self.a3)))
        return Force(-r * water.v, r * water.u, N)


def in_degrees(model: Norrbin) -> dict[str, Scalar]:
    """The coefficients for rudder angles in deg and yaw rates in deg/s, as ships are quoted."""
    degrees = math.degrees(1.0)
    return {
        "a0": model.a0 * degrees,
        "a1": model.a1,
        "a2": model.a2 / degrees,
        "a3": model.a3 / degrees**2,
        "b": model.b,
    }
