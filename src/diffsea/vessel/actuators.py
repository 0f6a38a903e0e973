"""Thrusters, propellers and rudders: the force that an executed actuation makes."""

import equinox as eqx
import jax.numpy as jnp

from diffsea.types import Scalar, State
from diffsea.vessel.base import AbstractActuator, Force, Jet
from diffsea.vessel.hull import Scaling
from diffsea.vessel.servo import Servo


class Losses(eqx.Module):
    """Factors on a thruster's force, all of them one at zero.

    Thrust times `(1 + asymmetry) (1 - with_speed u_r) (1 - in_turns |r|)`.
    """

    asymmetry: Scalar = 0.0  # relative change of this thruster's force
    with_speed: Scalar = 0.0  # s/m
    in_turns: Scalar = 0.0  # s/rad

    def factor(self, water: State) -> Scalar:
        """The factor at this motion through the water."""
        speed, turn = 1 - self.with_speed * water.u, 1 - self.in_turns * jnp.abs(water.r)
        return (1 + self.asymmetry) * speed * turn


def _push(thrust: Scalar, x: Scalar, y: Scalar, angle: Scalar) -> Force:
    """A force of `thrust` N at (x, y) m, `angle` rad clockwise from ahead."""
    X, Y = thrust * jnp.cos(angle), thrust * jnp.sin(angle)
    return Force(X, Y, x * Y - y * X)


def _drift_speed(water: State) -> Scalar:
    """Drift angle times speed, `U beta` with `beta = atan(-v / |u|)` (m/s): nearly -v."""
    # The small constant keeps the angle differentiable at rest.
    u = jnp.sqrt(water.u**2 + 1e-12)
    return jnp.sqrt(u**2 + water.v**2) * jnp.arctan2(-water.v, u)


class FixedThruster(AbstractActuator):
    """A thruster of fixed direction, commanded in N, or in rev/s with a thrust curve.

    With a curve, `T = c V n + d |n| n` where V is the speed through the water at the
    thruster along its axis (Blanke 1981 after Fossen 2021, eq. 9.7).
    """

    servos: dict[str, Servo]
    x: Scalar  # m forward of amidships
    y: Scalar  # m to starboard
    angle: Scalar = 0.0  # rad, direction of push from ahead, clockwise
    curve: tuple[Scalar, Scalar] | None = None  # c in N s^2/m, d in N s^2
    losses: Losses = Losses()

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (value,) = (executed[channel] for channel in self.servos)
        thrust = value if self.curve is None else self._thrust(value, water)
        return _push(thrust * self.losses.factor(water), self.x, self.y, self.angle)

    def _thrust(self, n: Scalar, water: State) -> Scalar:
        c, d = self.curve if self.curve is not None else (0.0, 0.0)
        along = water.u - self.y * water.r
        across = water.v + self.x * water.r
        advance = along * jnp.cos(self.angle) + across * jnp.sin(self.angle)
        return c * advance * n + d * jnp.abs(n) * n

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        return None

    def unit(self, channel: str) -> str:
        return "N" if self.curve is None else "rev/s"


class AzimuthThruster(AbstractActuator):
    """A thruster that turns: channels force (N) and angle (rad clockwise from ahead)."""

    servos: dict[str, Servo]  # "<name>.force" and "<name>.angle", in any order
    x: Scalar
    y: Scalar
    losses: Losses = Losses()

    def _channel(self, end: str) -> str:
        # By name: trees of arrays do not keep the order of a dictionary.
        return next(channel for channel in self.servos if channel.endswith(end))

    @property
    def force_channel(self) -> str:
        """The channel that orders its force."""
        return self._channel(".force")

    @property
    def angle_channel(self) -> str:
        """The channel that orders its angle."""
        return self._channel(".angle")

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        thrust = executed[self.force_channel] * self.losses.factor(water)
        return _push(thrust, self.x, self.y, executed[self.angle_channel])

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        return None

    def unit(self, channel: str) -> str:
        return "rad" if channel == self.angle_channel else "N"


class TunnelThruster(AbstractActuator):
    """A transverse thruster commanded in N to starboard; it fades with forward speed.

    The factor is `1 / (1 + (u_r / fading_speed)^2)`; no fading where that is None.
    """

    servos: dict[str, Servo]
    x: Scalar
    fading_speed: Scalar | None = None  # m/s, half the force is left here
    effectiveness: Scalar = 1.0  # force at rest over the ordered one

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (thrust,) = (self.effectiveness * executed[channel] for channel in self.servos)
        if self.fading_speed is not None:
            thrust = thrust / (1 + (water.u / self.fading_speed) ** 2)
        return Force(0.0, thrust, self.x * thrust)

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        return None

    def unit(self, channel: str) -> str:
        return "N"


class Propeller(AbstractActuator):
    """A fixed-pitch propeller commanded in rev/s.

    `T = rho D^4 (k_0 n |n| + k_1 |n| V + k_2 V |V|)` with V = (1 - w) u_r / D: the open-water
    polynomial `rho n^2 D^4 K_T(J)` made continuous through n = 0, where J is not defined.
    Astern the first term is multiplied by `astern_factor`. The wake fraction falls with
    the drift angle at the propeller, `w = w_0 exp(-wake_decay beta_P^2)` with
    `beta_P = beta - x r / U`, and `X = (1 - t) T` (Yasukawa and Yoshimura 2015, eqs. 9 to 16).
    """

    servos: dict[str, Servo]
    x: Scalar  # m forward of amidships
    diameter: Scalar  # m
    k_T: tuple[Scalar, Scalar, Scalar]
    water_density: Scalar  # kg/m^3
    y: Scalar = 0.0  # m to starboard
    wake_fraction: Scalar = 0.0
    wake_decay: Scalar = 0.0
    thrust_deduction: Scalar = 0.0
    astern_factor: Scalar = 0.7
    losses: Losses = Losses()

    def _advance(self, water: State) -> Scalar:
        """Speed into the disc, m/s."""
        drift = _drift_speed(water) - self.x * water.r
        speed_squared = water.u**2 + water.v**2 + 1e-12
        wake = self.wake_fraction * jnp.exp(-self.wake_decay * drift**2 / speed_squared)
        return (1 - wake) * water.u

    def _coefficient_times_square(self, n: Scalar, advance: Scalar) -> Scalar:
        """K_T n^2, in 1/s^2."""
        k0, k1, k2 = self.k_T
        V = advance / self.diameter
        bollard = k0 * jnp.where(n < 0, self.astern_factor, 1.0)
        return bollard * n * jnp.abs(n) + k1 * jnp.abs(n) * V + k2 * V * jnp.abs(V)

    def thrust(self, n: Scalar, water: State) -> Scalar:
        """Thrust in N before thrust deduction."""
        square = self._coefficient_times_square(n, self._advance(water))
        return self.water_density * self.diameter**4 * square

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (n,) = (executed[channel] for channel in self.servos)
        thrust = (1 - self.thrust_deduction) * self.thrust(n, water)
        return _push(thrust * self.losses.factor(water), self.x, self.y, 0.0)

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        (n,) = (executed[channel] for channel in self.servos)
        advance = self._advance(water)
        square = jnp.where(n > 0, self._coefficient_times_square(n, advance), 0.0)
        loading = 8 * jnp.maximum(square, 0.0) * self.diameter**2 / jnp.pi
        return Jet(advance, loading, self.diameter)

    def unit(self, channel: str) -> str:
        return "rev/s"


class Rudder(AbstractActuator):
    """A rudder in MMG form, behind a propeller or in the free stream; turns to starboard at +.

    Normal force `F_N = 1/2 rho A f_alpha U_R^2 sin(alpha_R)` with the propeller's
    slipstream in the inflow (Yasukawa and Yoshimura 2015, eqs. 17 to 25):
    `u_R = epsilon sqrt(eta (u_P + kappa (sqrt(u_P^2 + 8 K_T n^2 D^2 / pi) - u_P))^2 +
    (1 - eta) u_P^2)` and `v_R = U gamma_R (beta - l_R r / U)`, eta = D / H. Then
    `X = -(1 - t_R) F_N sin(delta)`, `Y = -(1 + a_H) F_N cos(delta)`,
    `N = -(x_R + a_H x_H) F_N cos(delta)`.
    """

    servos: dict[str, Servo]
    area: Scalar  # m^2
    x: Scalar  # m, x_R, negative aft
    height: Scalar  # m, span
    water_density: Scalar  # kg/m^3
    y: Scalar = 0.0  # m to starboard
    lift_slope: Scalar = 2.0  # f_alpha, per rad
    t_R: Scalar = 0.0  # steering resistance deduction
    a_H: Scalar = 0.0  # rise of the lateral force by the hull
    x_H: Scalar = 0.0  # m, where that rise acts
    gamma_R_port: Scalar = 1.0  # flow straightening, inflow from one side ...
    gamma_R_starboard: Scalar = 1.0  # ... and the other
    l_R: Scalar = 0.0  # m, effective longitudinal position of the rudder
    epsilon: Scalar = 1.0  # ratio of wakes at rudder and propeller
    kappa: Scalar = 0.5
    wake_fraction: Scalar = 0.0  # used without a propeller
    hull_lever: Scalar = 0.0  # m, beyond a_H x_H: a product that has a derivative at a_H = 0
    propeller: str | None = eqx.field(static=True, default=None)

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (delta,) = (executed[channel] for channel in self.servos)
        u_R, v_R = self._inflow(water, jets)
        alpha = delta - jnp.arctan2(v_R, u_R)
        square = u_R**2 + v_R**2
        normal = 0.5 * self.water_density * self.area * self.lift_slope * square * jnp.sin(alpha)
        side = -normal * jnp.cos(delta)
        X = -(1 - self.t_R) * normal * jnp.sin(delta)
        N = (self.x + self.a_H * self.x_H + self.hull_lever) * side - self.y * X
        return Force(X, (1 + self.a_H) * side, N)

    def _inflow(self, water: State, jets: dict[str, Jet]) -> tuple[Scalar, Scalar]:
        crossing = _drift_speed(water) - self.l_R * water.r
        gamma = jnp.where(crossing < 0, self.gamma_R_port, self.gamma_R_starboard)
        if self.propeller is None:
            axial = (1 - self.wake_fraction) * water.u
        else:
            jet = jets[self.propeller]
            eta = jnp.minimum(jet.diameter / self.height, 1.0)
            u_P = jet.inflow
            # The small constant keeps the square roots differentiable at rest.
            race = jnp.sqrt(u_P**2 + jet.loading + 1e-12) - u_P
            mixed = eta * (u_P + self.kappa * race) ** 2 + (1 - eta) * u_P**2
            axial = self.epsilon * jnp.sqrt(mixed + 1e-12)
        # A floor on the axial inflow keeps the angle of attack differentiable at rest.
        return jnp.where(jnp.abs(axial) < 1e-9, 1e-9, axial), gamma * crossing

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        return None

    def unit(self, channel: str) -> str:
        return "rad"


class DerivativeRudder(AbstractActuator):
    """A rudder given by derivatives with the letter d, as in Abkowitz sets.

    `tau = sum_k D_k m_k(u, v, r, d)` in the scaling of the hull's own set; d is positive
    to starboard (published sets for the opposite sign flip the odd powers of d).
    """

    servos: dict[str, Servo]
    derivatives: dict[str, Scalar]
    scaling: Scaling

    def force(self, executed: dict[str, Scalar], water: State, jets: dict[str, Jet]) -> Force:
        (delta,) = (executed[channel] for channel in self.servos)
        return self.scaling.force(self.derivatives, water, delta)

    def jet(self, executed: dict[str, Scalar], water: State) -> Jet | None:
        return None

    def unit(self, channel: str) -> str:
        return "rad"
