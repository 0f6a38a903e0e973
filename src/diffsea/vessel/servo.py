"""How an actuator channel answers its order: delay, dead band, limits, lag, slew rate.

Orders are constant between samples, so the response within a step is known in closed
form. A lag alone that is long against the step hands the integrator its exponential at the
nodes of the step. Whatever may have kinks, or is quick, hands it the quadratic with the same
first three moments: a Runge-Kutta step of fourth order then stays of fourth order through
kinks of the response and of third through jumps (a delay without a lag), a time constant far
below the step is integrated rightly, and a lag or a delay is exactly absent at zero with a
derivative that is not.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from diffsea.types import Scalar, in_any_lane
from diffsea.vessel.characteristics import Characteristic, dead_zone
from diffsea.vessel.tables import Table, optional_number


ORDERS_PER_STEP = 4  # that can take effect within one step after a delay
SHORTEST_STEP = 1e-12  # s, far below any clock's resolution
LARGEST_RATIO = 0.25  # of a step to a lag, up to which the latter's nodes are enough
BREAK_ROUNDING = 1e-8  # of a step: how exactly sums of steps meet the times of orders

# Integral of s^2 exp(-z s) over the unit interval by powers of z; exact to rounding at 1/4.
_SERIES = tuple((-1) ** j / (math.factorial(j) * (j + 3)) for j in range(11))

Moments = tuple[Scalar, ...]  # of order 0, 1 and 2
_Reached = tuple[Scalar, Moments]  # value, and moments of the response so far


class OrderHistory(eqx.Module):
    """Orders of one channel: each value holds from its time until the next."""

    times: Float[Array, "order"]  # s, ascending
    values: Float[Array, "order"]

    def push(self, t: Scalar, value: Scalar) -> "OrderHistory":
        """Forget the oldest order and append one at time `t`."""
        return OrderHistory(jnp.append(self.times[1:], t), jnp.append(self.values[1:], value))


class Response(eqx.Module):
    """Executed value during one step."""

    start: Scalar  # what the integrator takes at the start of the step
    middle: Scalar
    end: Scalar
    final: Scalar  # executed value itself at the end of the step


class Servo(eqx.Module):
    """The chain delay - bias - dead band - limits - play - lag and slew rate of one channel.

    A stage that is None is not there. The dead band is about `neutral`. An `endless` channel is an
    angle that may go round: it turns the short way. `slowness` adds to the inverse of the rate
    limit, so that a slew rate can be exactly absent. `sharpness` smooths the limits: the result
    stays within `log(2) / sharpness` half-ranges of the hard limit (0.7 % at 100) and is furthest
    from it where the order equals the limit; None means the hard limit.
    """

    KEYS: ClassVar = ("time_constant", "rate_limit", "delay", "deadband", "sharpness")

    delay: Scalar | None = None  # s
    deadband: Scalar | None = None  # unit of the channel, half width
    lower: Scalar | None = None
    upper: Scalar | None = None
    sharpness: Scalar | None = None
    time_constant: Scalar | None = None  # s
    rate_limit: Scalar | None = None  # unit of the channel per second
    bias: Scalar | None = None  # unit of the channel, added to the order
    backlash: Scalar | None = None  # unit of the channel, half width of the play
    slowness: Scalar | None = None  # s per unit of the channel
    neutral: Scalar | None = None  # unit of the channel, where nothing is done; zero without one
    endless: bool = eqx.field(static=True, default=False)
    characteristics: tuple[Characteristic, ...] = ()  # on what is executed, the first one first

    @classmethod
    def from_table(cls, table: Table, where: str, lower: str = "", upper: str = "") -> "Servo":
        """The stages that an actuator's table states; `lower` and `upper` are keys of limits.

        Raises `UserError` for a value that is no number; `where` is the table's name in it.
        """
        keys = {key: key for key in cls.KEYS} | {"lower": lower, "upper": upper}
        read: dict[str, Any] = {s: optional_number(table, key, where) for s, key in keys.items()}
        return cls(**read)

    @property
    def direct(self) -> bool:
        """Whether an order is executed within the same instant, whatever was before."""
        stages = (self.delay, self.time_constant, self.rate_limit, self.backlash, self.slowness)
        return all(stage is None for stage in stages)

    @property
    def slew(self) -> Scalar | None:
        """Least time per unit of change (s), None without a slew rate."""
        if self.rate_limit is None:
            return self.slowness
        return 1 / self.rate_limit + (0.0 if self.slowness is None else self.slowness)

    def target(self, order: Scalar) -> Scalar:
        """What the channel settles to under a constant order, both in the channel's unit.

        Bias, dead band and limits act in this order; play is left out.
        """
        value = order if self.bias is None else order + self.bias
        if self.deadband is not None:
            above = value if self.neutral is None else value - self.neutral
            above = dead_zone(above, self.deadband)
            value = above if self.neutral is None else above + self.neutral
        if self.sharpness is None or self.lower is None or self.upper is None:
            value = value if self.lower is None else jnp.maximum(value, self.lower)
            return value if self.upper is None else jnp.minimum(value, self.upper)
        middle, half = 0.5 * (self.upper + self.lower), 0.5 * (self.upper - self.lower)
        k, s = self.sharpness, (value - middle) / half
        soft = (jnp.logaddexp(0.0, k * (s + 1)) - jnp.logaddexp(0.0, k * (s - 1))) / k - 1
        return middle + half * soft

    def acting(self, executed: Scalar) -> Scalar:
        """What acts of an executed value, by the characteristics."""
        if not self.characteristics:
            return executed
        above = executed if self.neutral is None else executed - self.neutral
        for characteristic in self.characteristics:
            above = characteristic(above)
        return above if self.neutral is None else above + self.neutral

    def respond(self, executed: Scalar, history: OrderHistory, t: Scalar, dt: Scalar) -> Response:
        """Response over [t, t + dt] from `executed` to the orders in `history`."""
        if self.direct:
            held = self.target(history.values[-1])
            return Response(held, held, held, held)
        length = self.usable_length(dt)
        if self.is_pure_lag:
            return self._lag_response(executed, self.target(history.values[-1]), length)
        return self.respond_to(executed, *self.order_segments(history, t, length), length)

    def with_delay(self) -> "Servo":
        """With a delay, of zero where there is none: orders are then met within steps."""
        return self if self.delay is not None else dataclasses.replace(self, delay=0.0)

    @property
    def is_pure_lag(self) -> bool:
        """Whether it answers at once, and approaches its target exponentially."""
        others = (self.delay, self.slew, self.backlash)
        return self.time_constant is not None and not self.endless and others == (None,) * 3

    def _lag_response(self, executed: Scalar, target: Scalar, dt: Scalar) -> Response:
        """Response of a pure lag to a constant target: shares of what is left to go.

        Where the step is short against the lag they are the exponential itself at the nodes, whose
        mean by Simpson's rule is off by `(dt / tau)^4 / 2880` of itself.
        """
        tau = jnp.asarray(self.time_constant, float)
        unit = jnp.ones_like(dt * tau)
        is_long = jax.lax.stop_gradient(dt > LARGEST_RATIO * tau)
        rate = 1 / jnp.where(tau > 0, tau, 1.0)  # where the lag is constant, found once a run
        half = _power_series(_EXPONENTIAL, jnp.where(is_long, 0.0, 0.5 * dt * rate))
        at_nodes = unit, half, half**2, half**2

        def by_moments() -> tuple[Scalar, ...]:
            moments = _exponential_moments(unit, tau / dt)
            return *_quadratic_nodes(moments), _decay(unit, tau / dt)

        def whichever() -> tuple[Scalar, ...]:
            pairs = zip(by_moments(), at_nodes, strict=True)
            return tuple(jnp.where(is_long, long, short) for long, short in pairs)

        shares = jax.lax.cond(in_any_lane(is_long), whichever, lambda: at_nodes)
        return Response(*(target + (executed - target) * share for share in shares))

    @staticmethod
    def usable_length(dt: Scalar) -> Scalar:
        """The length of a step, or a tiny one instead of none.

        A step of no length (an event on the step's boundary) is as good as that, which keeps
        its derivative.
        """
        shortest = SHORTEST_STEP + (dt - jax.lax.stop_gradient(dt))
        return jnp.where(dt > SHORTEST_STEP, dt, shortest)

    def respond_to(
        self, executed: Scalar, breaks: Sequence[Scalar], orders: Sequence[Scalar], dt: Scalar
    ) -> Response:
        """Response over a step of `usable_length` to the orders of its segments."""
        targets = [self.target(order) for order in orders]
        moments, final = self._moments(executed, targets, breaks, dt)
        return Response(*_quadratic_nodes(moments), final)

    def order_segments(
        self, history: OrderHistory, t: Scalar, dt: Scalar
    ) -> tuple[list[Scalar], list[Scalar]]:
        """Fractions of the step at which the effective order changes, and the orders.

        Of several steps at once where `t` and `dt` are arrays.
        """
        if self.delay is None:
            return [0.0, 1.0], [history.values[-1]]
        # Strictly before: an order that takes effect just now stays a break at fraction
        # zero, which gives a delay of zero its derivative.
        method = "compare_all" if history.times.size <= 64 else "scan"
        first = jnp.searchsorted(history.times, t - self.delay, method=method) - 1
        last = history.times.size - 1
        index = [jnp.clip(first + k, 0, last) for k in range(ORDERS_PER_STEP)]
        inner = [
            jnp.where(first + k <= last, _break_fraction(history.times[i], self.delay, t, dt), 1.0)
            for k, i in enumerate(index)
        ]
        none = jnp.zeros_like(inner[0])
        return [none, *inner[1:], none + 1.0], [history.values[i] for i in index]

    def _moments(
        self, executed: Scalar, targets: Sequence[Scalar], breaks: Sequence[Scalar], dt: Scalar
    ) -> tuple[Moments, Scalar]:
        """Moments of order 0 to 2 of the response over the unit step, and its end.

        In each segment the deviation e from a constant target follows
        `de/ds = -sat(e / tau, rho)`: at constant rate while |e| > rho tau, then
        exponentially. Times are in units of the step.
        """
        tau = 0.0 if self.time_constant is None else self.time_constant / dt
        slow = None if self.slew is None else self.slew / dt

        def segment(so_far: _Reached, part: tuple[Scalar, ...]) -> tuple[_Reached, None]:
            value, sums = so_far
            target, begin, end = part
            if self.endless:  # the same angle within half a turn of where it is
                target = target - 2 * jnp.pi * jnp.round((target - value) / (2 * jnp.pi))
            goal = target
            if self.backlash is not None:  # driven no further than it must
                high, low = target + self.backlash, target - self.backlash
                goal = jnp.where(value > high, high, jnp.where(value < low, low, value))
            error, span = value - goal, end - begin
            slewing, rest = (0.0, error) if slow is None else _slewing_phase(error, span, slow, tau)
            decay = _moments_from(_exponential_moments(span - slewing, tau), slewing)
            moments = tuple(rest * m for m in decay)
            if slow is not None:
                # Without slowness everything is travelled in no time, and a lag answers to all.
                travelled = jnp.where(slow == 0, error, error - rest)
                moments = tuple(
                    m + slewing ** (k + 1) * (error / (k + 1) - travelled / (k + 2))
                    for k, m in enumerate(moments)
                )
            held = ((end ** (k + 1) - begin ** (k + 1)) / (k + 1) for k in range(3))
            deviation = _moments_from(moments, begin)
            after = (s + goal * h + d for s, h, d in zip(sums, held, deviation, strict=True))
            return (goal + rest * _decay(span - slewing, tau), tuple(after)), None

        begun = jnp.asarray(executed, float), (jnp.zeros(()),) * 3
        if len(targets) == 1:
            (value, moments), _ = segment(begun, (targets[0], breaks[0], breaks[1]))
        else:
            # Written out, every segment repeats the code of all before it when it is compiled.
            stack = (targets, breaks[:-1], breaks[1:])
            parts = tuple(jnp.stack([jnp.asarray(p, float) for p in part]) for part in stack)
            (value, moments), _ = jax.lax.scan(segment, begun, parts)
        return moments, value


def _quadratic_nodes(moments: Moments) -> tuple[Scalar, Scalar, Scalar]:
    """Begin, middle and end of the quadratic with these moments: shifted Legendre polynomials."""
    m0, m1, m2 = moments
    c1, c2 = 3 * (2 * m1 - m0), 5 * (6 * m2 - 6 * m1 + m0)
    return m0 - c1 + c2, m0 - 0.5 * c2, m0 + c1 + c2


# exp(-x) by powers of x; exact to rounding at an eighth.
_EXPONENTIAL = tuple((-1) ** j / math.factorial(j) for j in range(11))


def _power_series(coefficients: Sequence[float], x: Scalar) -> Scalar:
    """Sum of coefficients times powers of x, by Horner's rule."""
    total: Scalar = 0.0
    for coefficient in reversed(coefficients):
        total = coefficient + x * total
    return total


def _moments_from(moments: Moments, by: Scalar) -> Moments:
    """Moments about an origin `by` earlier than the one of `moments`."""
    m0, m1, m2 = moments
    return m0, by * m0 + m1, by**2 * m0 + 2 * by * m1 + m2


def _slewing_phase(error: Scalar, span: Scalar, slow: Scalar, tau: Scalar) -> tuple[Scalar, Scalar]:
    """Time that a deviation falls at its limiting rate `1 / slow`, and what is left of it then."""
    size = jnp.abs(error)
    some = slow > 0
    # Where it slews at all it does so until the lag alone would be slower.
    needed = size * slow - jnp.where(some, tau, 0.0)
    slews = (needed > 0) | ((slow == 0) & (tau == 0))
    slewing = jnp.where(slews, jnp.where(needed < span, needed, span), 0.0)
    rate = 1 / jnp.where(some, slow, 1.0)
    left = jnp.where(needed < span, tau * rate, size - span * rate)
    # Not by the modulus where nothing slews: that has no derivative at no error.
    return slewing, jnp.where(slews & some, jnp.sign(error) * left, error)


def _break_fraction(order: Scalar, delay: Scalar, t: Scalar, dt: Scalar) -> Scalar:
    """Fraction of the step at which an order takes effect.

    Delays only grow from zero, and the derivative by them is that of growth. A step may move
    either way against the orders: its derivative by `t` is the mean of both sides, where an order
    takes effect just at the beginning or the end.
    """
    hold = jax.lax.stop_gradient
    # With the derivative of growth on the lower end, which jnp.clip halves. What takes effect at
    # the end, to rounding, is the next step's alone: no derivative, however short the time left.
    grown = (order + delay - hold(t)) / hold(dt)
    grown = jnp.where(grown < 0, 0.0, jnp.where(grown > 1 - BREAK_ROUNDING, 1.0, grown))
    moved = (order + hold(delay) - t) / dt
    place = hold(moved)
    inside = (place > -BREAK_ROUNDING) & (place < 1 + BREAK_ROUNDING)
    sides = jnp.where((place < BREAK_ROUNDING) | (place > 1 - BREAK_ROUNDING), 0.5, 1.0)
    return grown + jnp.where(inside, sides, 0.0) * (moved - place)


def _decay(span: Scalar, tau: Scalar) -> Scalar:
    """exp(-span / tau), which is exactly one over no span and zero for no tau."""
    # Below a thousandth of the span it is zero to rounding.
    slow = tau > 1e-3 * span
    left = jnp.where(slow, jnp.exp(-span / jnp.where(slow, tau, 1.0)), 0.0)
    return jnp.where(span > 0, left, 1.0)


def _exponential_moments(span: Scalar, tau: Scalar) -> Moments:
    """Integrals of s^k exp(-s / tau) over [0, span] for k = 0, 1, 2.

    From integration by parts, I_k = k tau I_(k-1) - tau span^k exp(-span / tau). Upwards from
    I_0 that cancels where tau is long against the span; there I_2 is its power series in
    span / tau and the others follow downwards.
    """
    left, flat = _decay(span, tau), tau > 4 * span
    short, long = jnp.where(flat, 0.0, tau), jnp.where(flat, tau, 1.0)
    zeroth = short * (1 - left)
    first = short * (zeroth - span * left)
    upwards = zeroth, first, short * (2 * first - span**2 * left)
    second = span**3 * _power_series(_SERIES, jnp.where(flat, span, 0.0) / long)
    first = 0.5 * (second / long + span**2 * left)
    downwards = first / long + span * left, first, second
    zeroth, first, second = (
        jnp.where(flat, down, up) for down, up in zip(downwards, upwards, strict=True)
    )
    return zeroth, first, second
