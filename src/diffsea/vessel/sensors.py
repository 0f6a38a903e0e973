"""What is measured, as a function of the state: offsets, biases, latencies, lever arms."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.kinematics import to_body, to_earth
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Scalar, State


Values = Scalar | Float[Array, "*row"] | Float[np.ndarray, "*row"]
SHORTEST_INTERVAL = 1e-6  # s, between readings: where a run begins there is none before


class Clock(eqx.Module):
    """How far the clock of all motion channels lags that of the orders: `offset + rate t`."""

    offset: Scalar = 0.0  # s
    rate: Scalar = 0.0  # s per second of the run

    def late(self, t: Scalar) -> Scalar:
        """The lag in s of what is stamped `t`."""
        return self.offset + self.rate * t


class Step(eqx.Module):
    """An error of a sensor from one instant on: a compass that is knocked, a gyro that is reset.

    A reading is a mean over the time since the last one: the one after the instant shows part of
    the error.
    """

    size: Scalar = 0.0  # rad or rad/s, measured minus true
    time: Scalar = 0.0  # s, on the run's clock

    def shown(
        self, t: Float[Array, "*row"] | Scalar, interval: Float[Array, "*row"] | Scalar
    ) -> Float[Array, "*row"]:
        """The error of readings at times `t` (s of the run), each `interval` s after the last."""
        share = (t - self.time) / jnp.maximum(interval, SHORTEST_INTERVAL)
        return jnp.asarray(self.size * jnp.clip(share, 0.0, 1.0))


class EstimatedHeading(eqx.Module):
    """Deviation of a heading that an estimator makes of a gyro and a magnetic compass.

    The heading follows the compass with a `time_constant`, and is off by what it makes of the
    compass's deviation `cosine cos(psi) + sine sin(psi)`. The field that deflects the compass is
    that of the `motors`, channels whose current makes it, at their full thrust; without any it is
    the hull's own. Velocities that are fixes' turned into the vessel's axes by that heading are
    turned too far with it.
    """

    cosine: Scalar = 0.0  # rad
    sine: Scalar = 0.0  # rad
    time_constant: Scalar = 0.0  # s
    motors: tuple[str, ...] = eqx.field(static=True, default=())

    def deviation(
        self,
        shown: Float[Array, "row"],
        shares: Mapping[str, Float[Array, "row"]],
        interval: Float[Array, "row"],
        begins: Bool[Array, "row"],
    ) -> Float[Array, "row"]:
        """Shown minus true heading (rad) along a run, in which `shown` (rad) was read.

        Arguments:
            shares: of its full thrust, that each motor makes from a row to the next, none negative.
            interval: s since the row before.
            begins: rows of which nothing is known before: what was, had been so for long.
        """
        load = sum((shares[c] for c in self.motors), 0.0) / len(self.motors) if self.motors else 1.0
        compass = load * (self.cosine * jnp.cos(shown) + self.sine * jnp.sin(shown))
        # By what was read before: else a deviation that shrinks all headings would seem likely.
        compass = jnp.where(begins, compass, jnp.roll(compass, 1))
        left = jnp.exp(-interval / jnp.maximum(self.time_constant, SHORTEST_INTERVAL))
        left = jnp.where(begins, 0.0, left)
        # Each row leaves a share of what was before, and adds: such maps are applied in pairs.
        follow = lambda first, then: (first[0] * then[0], first[1] * then[0] + then[1])
        return jax.lax.associative_scan(follow, (left, (1 - left) * compass))[1]


class Feedback(eqx.Module):
    """How the record of what an actuator executed is off.

    `recorded(t) = (1 + scale) true(t - delay) + offset`.
    """

    offset: Scalar = 0.0  # unit of the channel
    scale: Scalar = 0.0  # relative
    delay: Scalar = 0.0  # s

    def plus(self, **more: Scalar) -> "Feedback":
        """With errors added to its own."""
        return Feedback(*(value + more.get(key, 0.0) for key, value in vars(self).items()))


class Sensors(eqx.Module):
    """Errors of the sensors; all zero for perfect ones.

    `latency` is how far (s) a channel lags the clock of the motion channels.
    """

    heading_offset: Scalar = 0.0  # rad, measured minus true
    axes_offset: Scalar = 0.0  # rad, of heading and of the axes of u and v, measured minus true
    hard_iron_cos: Scalar = 0.0  # rad, compass error A cos(psi) + B sin(psi)
    hard_iron_sin: Scalar = 0.0
    gyro_bias: Scalar = 0.0  # rad/s, measured minus true
    heading_steps: tuple[Step, ...] = ()  # of the compass; their sum
    gyro_steps: tuple[Step, ...] = ()
    estimated_headings: tuple[EstimatedHeading, ...] = ()  # their deviations add up
    lever_x: Scalar = 0.0  # m, antenna forward of amidships
    lever_y: Scalar = 0.0  # m, antenna to starboard
    velocity_lever_x: Scalar = 0.0  # m, forward of amidships: where u and v are measured
    velocity_lever_y: Scalar = 0.0  # m, to starboard
    latency_position: Scalar = 0.0  # s
    latency_heading: Scalar = 0.0
    latency_velocity: Scalar = 0.0
    latency_yaw_rate: Scalar = 0.0
    latency_axes: Scalar = 0.0  # s: u and v are in the axes of a heading so much later than they
    clock: Clock | None = None  # None: that of the orders
    feedback: dict[str, Feedback] = eqx.field(default_factory=dict)  # by channel of an actuator

    def lags(self, t: Scalar | None = None) -> dict[str, Scalar]:
        """How late (s) each motion channel is against the orders at time `t` (s) of the run.

        Without a time, against the motion channels' own clock.
        """
        clock = 0.0 if t is None or self.clock is None else self.clock.late(t)
        position, velocity = self.latency_position, self.latency_velocity
        own = (position, position, self.latency_heading, velocity, velocity, self.latency_yaw_rate)
        return {c: lag + clock for c, lag in zip(MOTION_CHANNELS, own, strict=True)}

    def steps(
        self, t: Float[Array, "*row"] | Scalar, interval: Float[Array, "*row"] | Scalar
    ) -> Float[Array, "*row 6"]:
        """What is shown too much of (x, y, psi, u, v, r) since instants of the run.

        At times `t` (s of the run), readings `interval` s apart. It is beside what `measure` and
        `shown` say, which know no time.
        """
        none = jnp.zeros_like(jnp.asarray(t, float))
        psi = sum((one.shown(t, interval) for one in self.heading_steps), none)
        r = sum((one.shown(t, interval) for one in self.gyro_steps), none)
        return jnp.stack([none, none, psi, none, none, r], axis=-1)

    def deviation(
        self,
        shown: Float[Array, "row"],
        shares: Mapping[str, Float[Array, "row"]],
        interval: Float[Array, "row"],
        begins: Bool[Array, "row"],
    ) -> Float[Array, "row"]:
        """How far (rad) headings and velocities are turned that an estimator has `shown`.

        It is beside what `measure` and `shown` say, which know no past. For the arguments see
        `EstimatedHeading.deviation`.
        """
        found = (one.deviation(shown, shares, interval, begins) for one in self.estimated_headings)
        return sum(found, jnp.zeros_like(shown))

    def measure(
        self, state: State, rate: State, jerk: State, t: Scalar | None = None
    ) -> Float[Array, "6"]:
        """Measured (x, y, psi, u, v, r) of a state, at time `t` of the run or as in `lags`.

        `rate` and `jerk` are the first and second time derivatives of the state: a lagging
        channel is the Taylor polynomial of second order at t - latency, so latencies must
        be short against the vessel's own response.
        """
        past = {
            c: getattr(state, c) - d * getattr(rate, c) + 0.5 * d**2 * getattr(jerk, c)
            for c, d in self.lags(t).items()
        }
        late = self.latency_axes
        return self.shown(past, late * rate.psi - 0.5 * late**2 * jerk.psi)

    def shown(self, past: dict[str, Scalar], turned: Scalar = 0.0) -> Float[Array, "6"]:
        """Measured (x, y, psi, u, v, r) where each channel shows a value of its own past.

        Units are those of `State`; headings are not wrapped. The compass error is taken at the
        heading with its offset.

        Arguments:
            turned: rad, by which the heading has grown in `latency_axes`.
        """
        north, east = to_earth(self.lever_x, self.lever_y, past["psi"])
        psi = self.shown_heading(past["psi"])
        u, v = to_body(*self.shown_velocities(past["u"], past["v"], past["r"]), turned)
        x, y, r = past["x"] + north, past["y"] + east, past["r"] + self.gyro_bias
        return jnp.stack([x, y, psi, u, v, r])

    def shown_heading(self, psi: Values) -> Values:
        """The heading (rad) that a compass shows, its axes turned and with its deviation."""
        turned = psi + self.heading_offset + self.axes_offset
        iron = self.hard_iron_cos * jnp.cos(turned) + self.hard_iron_sin * jnp.sin(turned)
        return turned + iron

    def shown_velocities(self, u: Values, v: Values, r: Values) -> tuple[Values, Values]:
        """u and v (m/s) where and in whose axes they are measured, at a yaw rate r (rad/s)."""
        u, v = u - r * self.velocity_lever_y, v + r * self.velocity_lever_x
        return to_body(u, v, self.axes_offset)
