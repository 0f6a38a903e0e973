# pyright: reportArgumentType=false
"""The ship whose true answer is known: a Mariner in wind, waves and current.

The records of the published ships are not public, so that a catalogue ship sails instead. Wind
acts on it, waves shake what its compass and gyro show, and loading changes its mass.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea import Environment, State, read_vessel, replace
from diffsea.vessel.effects.environment import superstructure
from diffsea.vessel.files import build


RAD = math.pi / 180
SPEED = 7.7175  # m/s, of the Mariner's derivatives
RUDDER_RATE = 2.5 * RAD  # rad/s
INERTIAS = ("mass", "I_z", "X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
WAVE_PERIOD, WAVE_DAMPING = 9.0, 0.1  # s, and of the shaping filter
WAVE_YAW = 0.06 * RAD  # rad, standard deviation of the yaw by waves at 10 m/s of wind
GUST_TIME, GUSTINESS, VEERING = 30.0, 0.15, 8 * RAD


def ship(ratio: float = 1.0, hull: dict | None = None):
    """The Mariner with a superstructure, its speed `ratio` times the usual one.

    At another speed the same primes hold about that speed, as they do where engine power
    changes and resistance and rudder forces go with speed squared. `hull` replaces entries of
    the vessel file's hull. The house stands aft: the bow turns into the wind.
    """
    document = dict(read_vessel("mariner").document)
    document["hull"] = {**document["hull"], "reference_speed": SPEED * ratio, **(hull or {})}
    vessel = build(document)
    wind = dataclasses.replace(superstructure(vessel), C_N=-0.1)
    return eqx.tree_at(lambda v: v.forces, vessel, vessel.forces | {"wind": wind})


def loaded(vessel, factor):
    """The ship with all inertias times `factor`: more or less cargo."""
    values = {name: getattr(vessel.rigid_body, name, None) for name in ("mass", "I_z")}
    values |= {name: getattr(vessel.added_mass, name) for name in INERTIAS[2:]}
    return replace(vessel, {name: value * factor for name, value in values.items()})


class Weather(eqx.Module):
    """What is around one run. Directions in rad, speeds in m/s."""

    wind: float  # mean speed
    wind_from: float
    current: float
    current_to: float
    gusts: jax.Array  # (step, 2): standard normal, of speed and direction
    waves: jax.Array  # (step,): standard normal


class Air(eqx.Module):
    """Gusts and the yaw by waves as they are now."""

    gust: jax.Array  # relative gust and veer, unit variance
    wave: jax.Array  # yaw by waves (rad) and its rate (rad/s)


def weather_of(draw: np.random.Generator, steps: int, wind, wind_from, current, current_to):
    """Weather of a batch: arrays of means, noise drawn."""
    count = len(wind)
    shapes = (count, steps, 2), (count, steps)
    noises = [jnp.asarray(draw.standard_normal(shape)) for shape in shapes]
    means = [jnp.asarray(a, float) for a in (wind, wind_from, current, current_to)]
    return Weather(*means, *noises)


def calm_air() -> Air:
    """No gust and no wave."""
    return Air(jnp.zeros(2), jnp.zeros(2))


def environment(weather: Weather, air: Air) -> Environment:
    """Current and the wind of this moment."""
    speed = weather.wind * (1 + GUSTINESS * air.gust[0])
    blows_to = weather.wind_from + VEERING * air.gust[1] + jnp.pi
    return Environment(
        weather.current * jnp.cos(weather.current_to),
        weather.current * jnp.sin(weather.current_to),
        speed * jnp.cos(blows_to),
        speed * jnp.sin(blows_to),
    )


def next_air(weather: Weather, air: Air, gusts, waves, dt) -> Air:
    """Gusts as Gauss-Markov processes, waves as a lightly damped oscillator under white noise."""
    keep = jnp.exp(-dt / GUST_TIME)
    gust = keep * air.gust + jnp.sqrt(1 - keep**2) * gusts
    omega, zeta = 2 * jnp.pi / WAVE_PERIOD, WAVE_DAMPING
    size = WAVE_YAW * (weather.wind / 10.0) ** 2
    drive = size * jnp.sqrt(4 * zeta * omega**3 * dt) * waves
    # Semi-implicit Euler keeps the oscillation bounded at steps up to a tenth of the period.
    rate = air.wave[1] + drive - dt * (omega**2 * air.wave[0] + 2 * zeta * omega * air.wave[1])
    return Air(gust, jnp.stack([air.wave[0] + dt * rate, rate]))


def moved(vessel, state: State, start, end, flow: Environment, dt) -> State:
    """One Runge-Kutta step, the rudder moving evenly from `start` to `end` (rad)."""

    def rate(at: State, delta) -> State:
        return vessel.rate(at, {"rudder": delta}, flow, 0.0)

    def ahead(slope: State, share: float) -> State:
        return jax.tree.map(lambda s, d: s + share * dt * d, state, slope)

    middle = 0.5 * (start + end)
    k1 = rate(state, start)
    k2 = rate(ahead(k1, 0.5), middle)
    k3 = rate(ahead(k2, 0.5), middle)
    k4 = rate(ahead(k3, 1.0), end)
    total = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
    return ahead(total, 1.0)


def turned(delta, order, dt):
    """Rudder angle `dt` s later on the way to an order."""
    return delta + jnp.clip(order - delta, -RUDDER_RATE * dt, RUDDER_RATE * dt)


@dataclasses.dataclass(frozen=True)
class Sensors:
    """Standard deviations of what is recorded."""

    heading: float = 0.1 * RAD
    yaw_rate: float = 0.01 * RAD  # rad/s
    rudder: float = 0.1 * RAD
    position: float = 1.0  # m
    speed: float = 0.05  # m/s
    wind_speed: float = 0.5  # m/s
    wind_direction: float = 3 * RAD


SENSORS = Sensors()


@eqx.filter_jit
def answers(vessel, delta, first, flow: Environment, dt):
    """Yaw rates (rad/s) of the ship under recorded rudder angles, from straight running.

    `first` is its speed (m/s) at the start, `delta` the angles every `dt` s.
    """
    zero = jnp.zeros(())

    def body(state, ends):
        begin, end = ends
        return moved(vessel, state, begin, end, flow, dt), state.r

    start = State(zero, zero, zero, zero + first, zero, zero)
    last, rates = jax.lax.scan(body, start, (delta[:-1], delta[1:]))
    return jnp.append(rates, last.r)
