"""A year of service: out and home every day, by autopilot, in whatever weather there is."""

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

from diffsea import State


STEP = 1.0  # s, of simulation and log
# Legs of the route: course (deg) and length (m); bends between islands, and one large turn.
OUT = ((130, 2600), (148, 900), (122, 950), (140, 2400), (205, 1500))
HOME = ((25, 1300), (320, 1400), (301, 950), (326, 900), (308, 2100), (328, 850), (303, 900),
        (315, 800))  # fmt: skip
SECONDS = 1320.0
LARGEST = 6 * RAD  # of the autopilot
REACH = 350.0  # m, ahead of a waypoint the next leg begins
LOOK_AHEAD = 900.0  # m
TURN = 0.4 * RAD  # rad/s, at which the wanted heading follows the leg


@dataclasses.dataclass(frozen=True)
class Log:
    """The record of one passage as the ship's logger has it; channels by name, on `t` (s)."""

    name: str
    t: np.ndarray
    channels: dict[str, np.ndarray]  # x, y, psi, u, v, r, rudder, wind_speed, wind_direction


class _Now(eqx.Module):
    state: State
    delta: jax.Array
    wanted: jax.Array  # rad, heading
    integral: jax.Array
    leg: jax.Array
    air: Air


def _route(legs) -> tuple[np.ndarray, np.ndarray]:
    """Corners (m, north and east) and courses (rad) of a route."""
    courses = np.array([c for c, _ in legs]) * RAD
    lengths = np.array([d for _, d in legs])
    hops = lengths[:, None] * np.stack([np.cos(courses), np.sin(courses)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(hops, axis=0)]), courses


@eqx.filter_jit
def _sail(vessel, factors, corners, courses, weather):
    def one(factor, around):
        return _passage(loaded(vessel, factor), corners, courses, around)

    return jax.vmap(one)(factors, weather)


def _passage(vessel, corners, courses, weather):
    zero = jnp.zeros(())
    state = State(corners[0, 0], corners[0, 1], courses[0], zero + SPEED, zero, zero)
    start = _Now(state, zero, courses[0], zero, jnp.zeros((), int), calm_air())

    def body(now: _Now, inputs):
        gusts, waves = inputs
        s, flow = now.state, environment(weather, now.air)
        shown = s.psi + now.air.wave[0], s.r + now.air.wave[1]
        wanted, leg = _guided(corners, courses, now)
        order, integral = _autopilot(now, shown, wanted)
        delta = turned(now.delta, order, STEP)
        state = moved(vessel, s, now.delta, delta, flow, STEP)
        air = next_air(weather, now.air, gusts, waves, STEP)
        out = (s.x, s.y, *shown, s.u, s.v, now.delta, flow.wind_north, flow.wind_east)
        return _Now(state, delta, wanted, integral, leg, air), out

    return jax.lax.scan(body, start, (weather.gusts, weather.waves))[1]


def _guided(corners, courses, now: _Now):
    """The wanted heading, led along the present leg and turned at a limited rate."""
    s, course = now.state, courses[now.leg]
    to_go = (corners[now.leg + 1, 0] - s.x) * jnp.cos(course)
    to_go = to_go + (corners[now.leg + 1, 1] - s.y) * jnp.sin(course)
    leg = jnp.where(to_go < REACH, jnp.minimum(now.leg + 1, len(courses) - 1), now.leg)
    course, corner = courses[leg], corners[leg]
    off = (s.y - corner[1]) * jnp.cos(course) - (s.x - corner[0]) * jnp.sin(course)
    aim = course - jnp.arctan(off / LOOK_AHEAD)
    change = jnp.mod(aim - now.wanted + jnp.pi, 2 * jnp.pi) - jnp.pi
    return now.wanted + jnp.clip(change, -TURN * STEP, TURN * STEP), leg


def _autopilot(now: _Now, shown, wanted):
    """A PID law on the heading as shown, waves included; it never asks for large angles."""
    off = wanted - shown[0]
    rate = jnp.clip((wanted - now.wanted) / STEP, -TURN, TURN)
    order = 0.6 * off - 18.0 * (shown[1] - rate) + now.integral
    limited = jnp.clip(order, -LARGEST, LARGEST)
    wound = jnp.where(order == limited, 0.003 * off * STEP, 0.0)
    return limited, now.integral + wound


def year(seed: int, days: int) -> list[Log]:
    """Logs of `days` passages out and as many home, faults of loggers included."""
    return [*_logs(seed, days, OUT, "out"), *_logs(seed + 1, days, HOME, "home")]


def _logs(seed: int, days: int, legs, name: str) -> list[Log]:
    draw = np.random.default_rng(seed)
    steps = round(SECONDS / STEP)
    wind = 8.0 * draw.weibull(2.0, days)  # m/s: a windy coast, 7 m/s on average
    around = weather_of(
        draw, steps, wind, draw.uniform(0, 2 * np.pi, days), draw.uniform(0, 0.6, days),
        draw.uniform(0, 2 * np.pi, days),
    )  # fmt: skip
    factors = jnp.asarray(1 + 0.04 * draw.standard_normal(days))
    corners, courses = _route(legs)
    if name == "home":
        corners = corners + _route(OUT)[0][-1]
    out = _sail(ship(), factors, jnp.asarray(corners), jnp.asarray(courses), around)
    columns = np.stack([np.asarray(a) for a in out], axis=-1)
    return [_log(draw, f"{name} {day:03d}", columns[day]) for day in range(days)]


def _log(draw: np.random.Generator, name: str, columns: np.ndarray) -> Log:
    """What the logger writes: noise, clocks that jitter, lost samples, now and then a fault."""
    kept = draw.random(len(columns)) > 0.02
    t = STEP * np.arange(len(columns)) + 0.05 * STEP * draw.standard_normal(len(columns))
    t, (x, y, psi, r, u, v, delta, wn, we) = t[kept], columns[kept].T
    apparent = wn - (u * np.cos(psi) - v * np.sin(psi)), we - (u * np.sin(psi) + v * np.cos(psi))
    channels = {"x": x, "y": y, "psi": psi, "u": u, "v": v, "r": r, "rudder": delta}
    sizes = dict(x=SENSORS.position, y=SENSORS.position, psi=SENSORS.heading, u=SENSORS.speed,
                 v=SENSORS.speed, r=SENSORS.yaw_rate, rudder=SENSORS.rudder)  # fmt: skip
    noisy = {k: a + sizes[k] * draw.standard_normal(len(t)) for k, a in channels.items()}
    noisy["wind_speed"] = np.hypot(*apparent) + SENSORS.wind_speed * draw.standard_normal(len(t))
    comes_from = np.arctan2(-apparent[1], -apparent[0]) - psi
    noisy["wind_direction"] = comes_from + SENSORS.wind_direction * draw.standard_normal(len(t))
    fault = draw.random()
    if fault < 0.02:
        noisy["r"] = np.zeros(len(t))
    elif fault < 0.04:
        noisy["u"] = noisy["u"] * 10
    return Log(name, t, noisy)
