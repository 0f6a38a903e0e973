# pyright: reportArgumentType=false
"""Zig-zag trials as run at sea: in gusts, late at the helm, at angles not quite ordered."""

import dataclasses

from experiments.metamodels.ship import (
    RAD,
    SENSORS,
    SPEED,
    Air,
    calm_air,
    environment,
    loaded,
    moved,
    next_air,
    ship,
    turned,
    weather_of,
)  # fmt: skip

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea import State, Trajectory


STEP = 0.5  # s
APPROACH, TRIAL = 120.0, 260.0  # s
RECORDED = 2.0  # s, interval of what is kept
ANGLE = HEADING = 10 * RAD


@dataclasses.dataclass(frozen=True)
class Control:
    """How well the helm keeps to the rules of the trial."""

    delay: float  # s, mean lateness of an order
    delay_spread: float
    rudder: float  # rad, standard deviation of each angle about the ordered one


GOOD = Control(0.5, 0.3, 0.3 * RAD)
POOR = Control(3.0, 1.5, 1.5 * RAD)


class Order(eqx.Module):
    """What one trial asks of the helm; two executes follow the first."""

    side: jax.Array  # +1 to starboard first
    course: jax.Array  # rad, of the approach
    angles: jax.Array  # (3,) rad, sizes
    delays: jax.Array  # (3,) s


class _Now(eqx.Module):
    state: State
    delta: jax.Array
    integral: jax.Array
    stage: jax.Array
    due: jax.Array  # s, when the next order is given; infinite while none is
    given: jax.Array  # (2, 3) heading (rad) off the course, and time (s), when orders were given
    air: Air


class Records(eqx.Module):
    """A batch of trials, from the first execute on."""

    t: jax.Array  # (time,) s
    psi: jax.Array  # (trial, time) rad, relative to the course; as measured
    r: jax.Array  # rad/s, as measured
    delta: jax.Array  # rad, as measured
    held: jax.Array  # rad, mean from each row to the next
    side: jax.Array  # (trial,)
    overshoots: jax.Array  # (trial, 2) rad, beyond the heading at which the rudder was reversed
    deviations: jax.Array  # (trial, 2) rad, beyond the nominal heading
    reversals: jax.Array  # (trial, 2) s, when the second and third order were given


@eqx.filter_jit
def _run(vessel, factors, orders: Order, weather, speed):
    def one(factor, order: Order, around):
        return _trial(loaded(vessel, factor), order, around, speed)

    return jax.vmap(one)(factors, orders, weather)


def _trial(vessel, order: Order, weather, speed):
    zero = jnp.zeros(())
    state = State(zero, zero, order.course, zero + speed, zero, zero)
    never = jnp.asarray(jnp.inf)
    now = _Now(state, zero, zero, jnp.zeros((), int), never, jnp.full((2, 3), jnp.nan), calm_air())

    def body(now: _Now, inputs):
        t, gusts, waves = inputs
        return _stepped(vessel, order, weather, now, t, gusts, waves)

    steps = round((APPROACH + TRIAL) / STEP)
    times = STEP * jnp.arange(steps) - APPROACH
    inputs = (times, weather.gusts, weather.waves)
    return jax.lax.scan(body, now, inputs)[1]


def _stepped(vessel, order: Order, weather, now: _Now, t, gusts, waves):
    s = now.state
    shown = s.psi + now.air.wave[0] - order.course, s.r + now.air.wave[1]
    approach = t < 0
    held = jnp.clip(-1.2 * shown[0] - 20.0 * shown[1] + now.integral, -10 * RAD, 10 * RAD)
    integral = now.integral - jnp.where(approach, 0.008 * shown[0] * STEP, 0.0)
    # The helm sees the heading pass the mark, and gives the order so much later.
    sense = order.side * (1 - 2 * ((now.stage + 1) % 2))
    passed = (now.stage > 0) & (now.stage < 3) & (sense * shown[0] >= HEADING)
    passed = passed | ((now.stage == 0) & ~approach)
    before = sense * (shown[0] - shown[1] * STEP)
    late = jnp.where(shown[1] * sense > 0, (sense * shown[0] - HEADING) / (shown[1] * sense), 0.0)
    late = jnp.where((now.stage == 0) | (before >= HEADING), 0.0, late)
    due = jnp.where(passed & jnp.isinf(now.due), t - late + order.delays[now.stage], now.due)
    due = jnp.where(now.stage >= 3, jnp.inf, due)
    acts = due < t + STEP
    stage = now.stage + acts
    late = jnp.clip(due - t, 0.0, STEP)
    angle = order.angles[jnp.maximum(stage - 1, 0)]
    new = order.side * (1 - 2 * ((stage - 1) % 2)) * angle
    old = jnp.where(now.stage == 0, held, order.side * (1 - 2 * ((now.stage - 1) % 2))
                    * order.angles[jnp.maximum(now.stage - 1, 0)])  # fmt: skip
    first = turned(now.delta, old, jnp.where(acts, late, 0.0))
    delta = turned(first, jnp.where(stage == 0, held, new), jnp.where(acts, STEP - late, STEP))
    flow = environment(weather, now.air)
    state = moved(vessel, s, now.delta, delta, flow, STEP)
    true = s.psi - order.course
    here = jnp.arange(3) == now.stage
    given = jnp.where(acts & here, jnp.stack([true + s.r * late, t + late])[:, None], now.given)
    out = (t, shown[0], shown[1], now.delta, true, s.r, now.stage, given, s.u)
    air = next_air(weather, now.air, gusts, waves, STEP)
    due = jnp.where(acts, jnp.inf, due)
    return _Now(state, delta, integral, stage, due, given, air), out


def run_trials(
    seed: int,
    count: int,
    wind: tuple[float, float],
    control: Control,
    ratio: float = 1.0,
    loading: float = 0.03,
    hull: dict | None = None,
) -> Records:
    """`count` zig-zags 10/10, to either side in turn, at wind speeds between two (m/s)."""
    draw = np.random.default_rng(seed)
    steps = round((APPROACH + TRIAL) / STEP)
    speeds, current = draw.uniform(*wind, count), draw.uniform(0.0, 0.5, count)
    around = weather_of(
        draw, steps, speeds, draw.uniform(0, 2 * np.pi, count), current,
        draw.uniform(0, 2 * np.pi, count),
    )  # fmt: skip
    orders = Order(
        jnp.where(jnp.arange(count) % 2 == 0, 1.0, -1.0),
        jnp.asarray(draw.uniform(0, 2 * np.pi, count)),
        jnp.asarray(ANGLE + control.rudder * draw.standard_normal((count, 3))),
        jnp.asarray(
            np.abs(control.delay + control.delay_spread * draw.standard_normal((count, 3)))
        ),
    )
    factors = jnp.asarray(1 + loading * draw.standard_normal(count))
    out = _run(ship(ratio, hull), factors, orders, around, SPEED * ratio)
    return _recorded(draw, orders, out)


def ideal(ratio: float = 1.0, hull: dict | None = None) -> Records:
    """The trial as it should be, in a calm and at the usual loading: first to either side."""
    nothing = np.random.default_rng(0)
    steps = round((APPROACH + TRIAL) / STEP)
    none = np.zeros(2)
    around = weather_of(nothing, steps, none, none, none, none)
    orders = Order(jnp.array([1.0, -1.0]), jnp.zeros(2), jnp.full((2, 3), ANGLE), jnp.zeros((2, 3)))
    return _recorded(
        None, orders, _run(ship(ratio, hull), jnp.ones(2), orders, around, SPEED * ratio)
    )


def _recorded(draw: np.random.Generator | None, orders: Order, out) -> Records:
    t, psi, r, delta, true, rate, stage, given, _ = (np.asarray(a) for a in out)
    t = t[0]
    begin, every = round(APPROACH / STEP), round(RECORDED / STEP)
    rows = slice(begin, None, every)
    noise = (lambda size: 0.0) if draw is None else (
        lambda size: size * draw.standard_normal(psi[:, rows].shape))  # fmt: skip
    side = np.asarray(orders.side)
    marks = given[:, -1, 0, 1:]
    peaks = np.stack([_peak(true, rate, stage, side, k) for k in (1, 2)], axis=1)
    senses = side[:, None] * np.array([1.0, -1.0])
    return Records(
        t[rows],
        psi[:, rows] + noise(SENSORS.heading),
        r[:, rows] + noise(SENSORS.yaw_rate),
        delta[:, rows] + noise(SENSORS.rudder),
        delta[:, begin:].reshape(len(side), -1, every).mean(2),
        side,
        senses * (peaks - marks),
        senses * peaks - HEADING,
        given[:, -1, 1, 1:],
    )


def _peak(true, rate, stage, side, k: int) -> np.ndarray:
    """Largest heading towards the side of execute `k`, by a parabola through the samples."""
    sense = (side * (1 if k == 1 else -1))[:, None]
    within = stage == k + 1
    value = np.where(within, sense * true, -np.inf)
    at = value.argmax(1)
    rows = np.arange(len(at))
    before, after = np.maximum(at - 1, 0), np.minimum(at + 1, true.shape[1] - 1)
    slope = 0.5 * (sense[:, 0]) * (rate[rows, after] - rate[rows, before]) / STEP
    top = value[rows, at] + np.where(
        slope < 0, (sense[:, 0] * rate[rows, at]) ** 2 / (-2 * slope), 0
    )
    ended = within[:, -1] & (at >= true.shape[1] - 2)
    return sense[:, 0] * np.where(np.isfinite(top) & ~ended, top, np.nan)


def recordings(records: Records, which, every: int = 2) -> list[Trajectory]:
    """Trials as recordings with heading, yaw rate and rudder, every so many rows.

    The rudder is its mean until the next row, as an order: those hold.
    """
    count = len(records.t) // every
    t = np.asarray(records.t)[::every][:count]
    held = np.asarray(records.held)[:, : count * every].reshape(-1, count, every).mean(2)
    nothing = np.full(t.shape, np.nan)
    return [
        Trajectory(
            t, nothing, nothing, np.asarray(records.psi[k])[::every][:count], nothing, nothing,
            np.asarray(records.r[k])[::every][:count], {"rudder": held[k]}, {}, {},
            np.ones(t.shape, bool), name=f"zigzag {k}",
        )
        for k in which
    ]  # fmt: skip
