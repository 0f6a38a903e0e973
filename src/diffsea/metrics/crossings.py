"""Where a sampled curve crosses a level or turns back, to the interpolated instant.

A number read off at the nearest sample jumps when a parameter moves, so it has no useful
derivative. Here a curve is the cubic Hermite interpolant of its samples and their time
derivatives. A crossing is bracketed by samples and solved with every derivative stopped;
one last Newton step with the derivatives on then carries the implicit-function derivative

    dt = -(dvalue - dlevel) / rate

exactly, in forward and reverse mode, because at the solution the step has length zero.

Samples alone say where to look; the cubics are those of a few intervals there.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.types import Scalar


# Halves the bracket to below one unit in the last place even if Newton never helps.
_ITERATIONS = 55
_MARGIN = 2  # rows to either side that differences look at
# Intervals to either side of a sample that are looked at. All but one of them may be empty: a
# simulation repeats a row three times while it locates an event.
_BESIDE = 4


class AbstractCurve(eqx.Module):
    """Samples of one channel that have time derivatives; times never decrease.

    A repeated time stamp marks a switching event: the value is continuous there and the
    empty interval is never used.
    """

    t: eqx.AbstractVar[Float[Array, "time"]]  # s
    value: eqx.AbstractVar[Float[Array, "time"]]

    @abc.abstractmethod
    def rates(self, row: Int[Array, ""], before: int, after: int) -> Float[Array, "near"]:
        """Derivatives (1/s times the unit of `value`) from so many rows before a row to as many
        after it; beyond the ends those there."""

    def near(self, row: Int[Array, ""], before: int, after: int) -> "Curve":
        """The same curve from so many rows before a row to as many after it."""
        rows = self.rows(row, before, after)
        return Curve(self.t[rows], self.value[rows], self.rates(row, before, after))

    def rows(self, row: Int[Array, ""], before: int, after: int) -> Int[Array, "near"]:
        """Rows around one; beyond the ends those there, as if their time were repeated."""
        return jnp.clip(row + jnp.arange(-before, after + 1), 0, self.t.shape[0] - 1)


class Curve(AbstractCurve):
    """A curve with a derivative at each sample. `curve` builds it where some rows do not count."""

    t: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # s
    value: Float[Array, "time"] = eqx.field(converter=jnp.asarray)
    rate: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # 1/s times the unit of `value`

    def rates(self, row: Int[Array, ""], before: int, after: int) -> Float[Array, "near"]:
        return self.rate[self.rows(row, before, after)]


class DifferencedCurve(AbstractCurve):
    """A curve whose derivatives are three-point differences, taken where they are needed."""

    t: Float[Array, "time"] = eqx.field(converter=jnp.asarray)  # s
    value: Float[Array, "time"] = eqx.field(converter=jnp.asarray)

    def rates(self, row: Int[Array, ""], before: int, after: int) -> Float[Array, "near"]:
        rows = self.rows(row, before + _MARGIN, after + _MARGIN)
        return slopes(self.t[rows], self.value[rows])[_MARGIN:-_MARGIN]


class Crossing(NamedTuple):
    """An instant (s) and whether there is one; `time` is finite either way.

    Computing on a finite stand-in and masking at the end keeps NaN out of derivatives.
    """

    time: Float[Array, ""]
    found: Bool[Array, ""]


class Extremum(NamedTuple):
    """Where a curve turns back: instant (s), value there, and whether there is one."""

    time: Float[Array, ""]
    value: Float[Array, ""]
    found: Bool[Array, ""]


def valid_rows(valid: Bool[Array, "time"]) -> Int[Array, "time"]:
    """Indices that bring the valid rows to the front and repeat the last one after them.

    Gathering with them keeps the fixed length: the spare rows become empty intervals.
    """
    size, number = valid.shape[0], jnp.cumsum(valid)
    # Every valid row goes to the place of its number, every other out of bounds.
    place = jnp.where(valid, number - 1, size)
    order = jnp.zeros(size, int).at[place].set(jnp.arange(size), mode="drop")
    return order[jnp.minimum(jnp.arange(size), jnp.maximum(number[-1] - 1, 0))]


def curve(
    t: Float[Array, "time"],
    value: Float[Array, "time"],
    rate: Float[Array, "time"],
    valid: Bool[Array, "time"],
) -> Curve:
    """The curve through the valid rows of a channel."""
    rows = valid_rows(valid)
    return Curve(t[rows], value[rows], rate[rows])


def value_or_nan(value: Scalar | Array, found: Bool[Array, "..."]) -> Float[Array, "..."]:
    """The value where it was found, else NaN with derivative zero."""
    return jnp.where(found, value, jnp.nan)


def interval_at(t: Float[Array, "time"], time: Scalar) -> Int[Array, ""]:
    """Index of the sample that begins the interval holding a time, the last such one."""
    # A count and not a binary search, whose loop takes long to compile and does not batch.
    return jnp.clip(jnp.sum(t <= time) - 1, 0, t.shape[0] - 2)


def value_at(curve: AbstractCurve, time: Scalar) -> Float[Array, ""]:
    """Interpolated value at a time (s), differentiable in it; held before and after."""
    time = jnp.clip(time, curve.t[0], curve.t[-1])
    piece = _piece(curve, interval_at(curve.t, time))
    return _hermite(piece, (time - piece.t) / piece.step)


def first_crossing(
    curve: AbstractCurve,
    level: Scalar,
    direction: int,
    after: Scalar = -jnp.inf,
    before: Scalar = jnp.inf,
) -> Crossing:
    """First time that a curve passes a level between two times.

    **Arguments:** `level` in the unit of the curve; `direction` +1 upwards, -1 downwards,
    0 either; `after`, `before` (s) only choose the crossing and carry no derivative.

    Starting exactly on the level is not a crossing of it. Two crossings between the same
    two samples cancel out and are not seen.
    """
    fixed, (first, last) = jax.lax.stop_gradient((curve, (after, before)))
    begin, end, excess = fixed.t[:-1], fixed.t[1:], fixed.value - jax.lax.stop_gradient(level)
    # Samples say which interval is crossed, but for the two that the window begins and ends in.
    window = jnp.stack([jnp.asarray(time, fixed.t.dtype) for time in (first, last)])
    at_first, at_last = jax.vmap(lambda time: _excess_at(fixed, time, level))(window)
    low = jnp.where(begin < first, at_first, excess[:-1])
    high = jnp.where(end > last, at_last, excess[1:])
    inside = ((end > first) | (begin == end) & (begin >= first)) & (begin < last)
    upwards = (low < 0) & (high >= 0)
    downwards = (low > 0) & (high <= 0)
    hits = {1: upwards, -1: downwards, 0: upwards | downwards}[direction] & inside & (first < last)
    i = first_row(hits)
    found = hits[i]
    piece = _piece(curve, i)
    still = jax.lax.stop_gradient(piece)
    left, right = (jnp.clip((time - still.t) / still.step, 0.0, 1.0) for time in (first, last))
    s = _bisected_newton((still, jax.lax.stop_gradient(level)), left, right)
    # An empty interval is crossed only when rounding differs between its two rows.
    s = jnp.where(piece.proper, s, 0.0)
    s = s - _implicit(_hermite(piece, s) - level, _hermite_rate(piece, s), found)
    return Crossing(jnp.where(found, piece.t + s * piece.step, fixed.t[-1]), found)


def first_row(where: Bool[Array, "row"]) -> Int[Array, ""]:
    """The first row where it holds, the last row if in none: a third of the time of `argmax`."""
    last = where.shape[0] - 1
    return jnp.min(jnp.where(where, jnp.arange(last + 1), last))


def _excess_at(fixed: AbstractCurve, time: Scalar, level: Scalar) -> Float[Array, ""]:
    """Value above a level at a time (s); no derivative."""
    return value_at(fixed, time) - jax.lax.stop_gradient(level)


def highest(
    curve: AbstractCurve, sense: Scalar, after: Scalar = -jnp.inf, before: Scalar = jnp.inf
) -> Extremum:
    """Highest turning point between two times; the lowest where `sense` is -1.

    A turning point is where the derivative of the Hermite cubic, a quadratic, vanishes:
    a closed form in an interval. It is looked for beside the highest sample that is no lower than
    those before and after it. There is none if the curve is still beyond it at the end of the
    window, for then it has not turned back. The bounds (s) carry no derivative.
    """
    fixed, bounds = jax.lax.stop_gradient((curve, (after, before)))
    t, value = fixed.t, fixed.value * sense
    inside = (t[1:-1] >= bounds[0]) & (t[1:-1] <= bounds[1])
    inside = inside & (value[1:-1] >= value[:-2]) & (value[1:-1] >= value[2:])
    height = jnp.where(inside, value[1:-1], -jnp.inf)
    row = 1 + first_row(height == jnp.max(height))
    found = _highest_near(curve.near(row, _BESIDE, _BESIDE), sense, bounds)
    at_end = sense * value_at(fixed, bounds[1])
    return found._replace(
        found=found.found & (jax.lax.stop_gradient(sense * found.value) >= at_end)
    )


def _highest_near(curve: Curve, sense: Scalar, bounds: tuple[Scalar, Scalar]) -> Extremum:
    """The highest turning point of a few intervals between two times (s)."""
    fixed = jax.lax.stop_gradient(curve)
    upright = Curve(fixed.t, fixed.value * sense, fixed.rate * sense)
    pieces = _pieces(upright, *_ALL)
    s = _maximum(pieces)
    time = pieces.t + s * pieces.step
    # The margin is for a turning point on a sample, which rounding may put in neither.
    usable = pieces.proper & (jnp.abs(s - 0.5) <= 0.5 + 1e-6)
    usable = usable & (time >= bounds[0]) & (time <= bounds[1])
    height = jnp.where(usable, _hermite(pieces, jnp.where(usable, s, 0.0)), -jnp.inf)
    i = first_row(height == jnp.max(height))
    found = usable[i]
    piece = _pieces(curve, i, i + 1)
    s = jnp.where(found, s[i], 0.0)
    _, _, c2, c3 = _cubic(piece)
    s = s - _implicit(_hermite_rate(piece, s), 2 * c2 + s * 6 * c3, found)
    return Extremum(piece.t + s * piece.step, _hermite(piece, s), found)


def slopes(t: Float[Array, "time"], value: Float[Array, "time"]) -> Float[Array, "time"]:
    """Time derivatives by three-point differences on uneven samples.

    At the ends, and on both sides of a repeated time stamp, where the derivative may jump,
    the parabola is taken from one side.
    """
    step, rise = jnp.diff(t), jnp.diff(value)
    secant = jnp.where(step > 0, rise / jnp.where(step > 0, step, 1.0), 0.0)
    # Two empty intervals at each end: the arrays below then have a sample more on each side.
    steps, secants = jnp.pad(step, 2), jnp.pad(secant, 2)
    before, after, left, right = steps[:-1], steps[1:], secants[:-1], secants[1:]
    inside = (before > 0) & (after > 0)
    central = (after * left + before * right) / jnp.where(inside, before + after, 1.0)
    # On a parabola the mean of the derivatives at two ends is the secant between them.
    last = jnp.where(inside[:-2], 2 * left[1:-1] - central[:-2], left[1:-1])
    first = jnp.where(inside[2:], 2 * right[1:-1] - central[2:], right[1:-1])
    one_sided = jnp.where(before[1:-1] > 0, last, first)
    return jnp.where(inside[1:-1], central[1:-1], one_sided)


def with_corners(smooth: Curve, times: Float[Array, "corner"]) -> Curve:
    """The curve with a second sample at each of some times (s), where its slope may jump.

    A yaw rate has such a corner where thrust answers an order at once; differences across it
    would round it off, by an amount that depends on how the samples lie.
    """
    times = jnp.clip(times, smooth.t[0], smooth.t[-1])
    added = jax.vmap(lambda time: value_at(smooth, time))(times)
    fixed, corners = jax.lax.stop_gradient((smooth.t, times))
    # Every sample moves behind the corners before it; sorting them all takes far longer.
    rows = jnp.arange(fixed.size) + jnp.sum(corners < fixed[:, None], axis=1)
    number = jnp.argsort(jnp.argsort(corners, stable=True), stable=True)
    own = jnp.sum(fixed <= corners[:, None], axis=1) + number
    place, size = jnp.concatenate([rows, own]), fixed.size + corners.size
    t, value = (
        jnp.zeros(size).at[place].set(jnp.concatenate(both))
        for both in ((smooth.t, times), (smooth.value, added))
    )
    return Curve(t, value, slopes(t, value))


class _Piece(NamedTuple):
    """Intervals between samples. `step` is 1 where an interval is empty, so that neither
    a value nor a derivative divides by zero; `proper` says which are not."""

    t: Array
    step: Array  # s
    start: Array
    end: Array
    start_slope: Array  # per unit of s = (t - t_i) / step
    end_slope: Array
    proper: Array


def _pieces(curve: Curve, first: Int[Array, ""] | slice, after: Int[Array, ""] | slice) -> _Piece:
    """From one sample to another, or between as many as two slices choose."""
    proper = curve.t[after] > curve.t[first]
    step = jnp.where(proper, curve.t[after] - curve.t[first], 1.0)
    slopes = curve.rate[first] * step, curve.rate[after] * step
    return _Piece(curve.t[first], step, curve.value[first], curve.value[after], *slopes, proper)


_ALL = slice(None, -1), slice(1, None)  # every interval of a curve


def _piece(curve: AbstractCurve, row: Int[Array, ""]) -> _Piece:
    """The interval that a sample begins."""
    both = curve.near(row, 0, 1)
    return _pieces(both, jnp.asarray(0), jnp.asarray(1))


def _cubic(p: _Piece) -> tuple[Array, Array, Array, Array]:
    rise = p.end - p.start
    square = 3 * rise - 2 * p.start_slope - p.end_slope
    return p.start, p.start_slope, square, p.start_slope + p.end_slope - 2 * rise


def _hermite(p: _Piece, s: Array) -> Array:
    c0, c1, c2, c3 = _cubic(p)
    return c0 + s * (c1 + s * (c2 + s * c3))


def _hermite_rate(p: _Piece, s: Array) -> Array:
    _, c1, c2, c3 = _cubic(p)
    return c1 + s * (2 * c2 + s * 3 * c3)


def _implicit(residual: Array, slope: Array, found: Array) -> Array:
    # A tangent crossing has slope zero and no derivative: the step is dropped there, since
    # an infinite one would turn into NaN in whatever else depends on the same arrays.
    slope = jax.lax.stop_gradient(slope)
    usable = found & (jnp.abs(slope) > 1e-14)
    return jnp.where(usable, residual / jnp.where(usable, slope, 1.0), 0.0)


def _bisected_newton(problem: tuple[_Piece, Scalar], left: Array, right: Array) -> Array:
    """Root of the cubic minus the level in a bracket: Newton, halving where it leaves."""
    piece, level = problem
    sign = jnp.sign(_hermite(piece, right) - _hermite(piece, left))

    def narrow(_, carry):
        low, high, s = carry
        excess = _hermite(piece, s) - level
        below = sign * excess < 0
        low, high = jnp.where(below, s, low), jnp.where(below, high, s)
        slope = _hermite_rate(piece, s)
        newton = s - excess / jnp.where(slope == 0, 1.0, slope)
        inside = (newton > low) & (newton < high) & (slope != 0)
        return low, high, jnp.where(inside, newton, 0.5 * (low + high))

    start = (left, right, 0.5 * (left + right))
    return jax.lax.fori_loop(0, _ITERATIONS, narrow, start)[2]


def _maximum(p: _Piece) -> Array:
    """Position s of the cubic's local maximum, outside [0, 1] where it has none."""
    _, c, b, a = _cubic(p)
    # p'(s) = 3a s^2 + 2b s + c; the root with p'' < 0, each in the form that does not cancel.
    discriminant = b * b - 3 * a * c
    root = jnp.sqrt(jnp.maximum(discriminant, 0.0))
    shallow = jnp.where(a == 0, 1.0, 3 * a)
    steep = jnp.where(root - b == 0, 1.0, root - b)
    s = jnp.where(b > 0, -(b + root) / shallow, c / steep)
    exists = (discriminant > 0) & jnp.where(b > 0, a != 0, root - b != 0)
    return jnp.where(exists, s, -1.0)
