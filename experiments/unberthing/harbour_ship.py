"""The plant: a nonlinear ship of Shioji Maru's size, her blade angles, weather and sensors.

It shares nothing with the estimators' models but the catalogue's nominal numbers, off which every
seed's ship differs.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import Vessel, named, read_vessel, replace
from diffsea.kinematics import components_towards
from diffsea.types import Scalar


DEGREE, KNOT = np.pi / 180, 1852 / 3600
PERIOD = 0.5  # s, T_s: 2 Hz
INPUTS = ("propeller", "rudder", "bow", "stern")  # theta_P, delta, theta_B, theta_S, rad

# Blade angles are not in the vessel file: forces per blade angle are assumed.
TURNS_SQUARED = 1.0 / DEGREE  # (rev/s)^2 per rad of the propeller's blades
BOW_FORCE = 30e3 / (11 * DEGREE)  # N per rad, 30 kN at the published limits
STERN_FORCE = 30e3 / (9 * DEGREE)

# How much a seed's ship differs from the regressions: relative standard deviations.
SPREAD = {
    "X_uu": 0.15, "Y_uv": 0.15, "Y_ur": 0.1, "N_uv": 0.15, "N_ur": 0.15, "crossflow-drag.cd": 0.15,
    "bow.effectiveness": 0.15, "stern.effectiveness": 0.15, "rudder.lift_slope": 0.1,
    "bow.fading_speed": 0.15, "stern.fading_speed": 0.15, "bow.time_constant": 0.2,
    "stern.time_constant": 0.2,
}  # fmt: skip
NOISE = (0.3, 0.3, 0.1 * DEGREE, 0.02, 0.02, 0.03 * DEGREE)  # std of x, y, psi, u, v, r


class Weather(eqx.Module):
    """Water and air of one run, a row per control period, and what the sensors add."""

    current_north: Float[Array, "time"]  # m/s, where the water flows to
    current_east: Float[Array, "time"]
    wind_north: Float[Array, "time"]  # m/s, where the air moves to
    wind_east: Float[Array, "time"]
    noise: Float[Array, "time 6"]


def nominal() -> Vessel:
    """The ship as the regressions have her, which is what the estimators start from."""
    return read_vessel("shioji_maru").vessel


def ship(seed: int) -> Vessel:
    """The true ship of a seed; seed 0 is the nominal one."""
    rng = np.random.default_rng([seed, 1])
    vessel = nominal()
    values = named(vessel)
    factors = {name: np.exp(spread * rng.normal()) for name, spread in SPREAD.items()}
    changed = {n: values[n] * (factors[n] if seed else 1.0) for n in factors}
    return replace(vessel, changed)


def orders(blades: Float[Array, "4"]) -> dict[str, Scalar]:
    """The vessel's orders for the angles of `INPUTS`."""
    theta_P, delta, theta_B, theta_S = blades
    # The small constant keeps the square root differentiable with the blades at zero.
    turns = jnp.sign(theta_P) * jnp.sqrt(TURNS_SQUARED * jnp.abs(theta_P) + 1e-12)
    return {
        "propeller": turns, "rudder": delta,
        "bow": BOW_FORCE * theta_B, "stern": STERN_FORCE * theta_S,
    }  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Tide and wind of one run in words a mate would use."""

    current: float  # m/s, largest
    current_to: float  # rad, where it flows to
    least: float  # share of the current that is always there
    peak: float  # s, when it is largest
    swing: float  # s, time between two largest
    wind: float  # m/s, mean
    wind_from: float  # rad


def drawn(seed: int) -> Conditions:
    """A seed's conditions: up to half a knot of current and 7 m/s of wind from anywhere."""
    rng = np.random.default_rng([seed, 2])
    direction, wind_from = rng.uniform(0, 2 * np.pi, 2)
    return Conditions(
        rng.uniform(0.0, 0.5 * KNOT), direction, rng.uniform(0.2, 0.8), rng.uniform(100, 800),
        rng.uniform(600, 1500), rng.uniform(0.0, 7.0), wind_from,
    )  # fmt: skip


def weather(conditions: Conditions, seed: int, rows: int, noisy: bool = True) -> Weather:
    """Series of the conditions: a tide that swells and ebbs, wind with gusts of 15 % over 20 s."""
    rng = np.random.default_rng([seed, 3])
    t, c = PERIOD * np.arange(rows), conditions
    share = 0.5 * (1 + np.cos(2 * np.pi * (t - c.peak) / c.swing))
    speed = c.current * (c.least + (1 - c.least) * share)
    north, east = components_towards(speed, c.current_to)
    gust = 0.15 * c.wind * gusts(rng, rows)
    air_north, air_east = components_towards(1.0, c.wind_from + np.pi)
    air = c.wind * np.array([[air_north], [air_east]]) + gust
    noise = np.array(NOISE) * rng.normal(size=(rows, 6)) * noisy
    return Weather(*(jnp.asarray(x, float) for x in (north, east, *air, noise)))


def gusts(rng: np.random.Generator, rows: int, lasting: float = 20.0) -> np.ndarray:
    """Two Gauss-Markov series of unit variance."""
    keep = np.exp(-PERIOD / lasting)
    white = np.sqrt(1 - keep**2) * rng.normal(size=(2, rows))
    series = np.zeros((2, rows))
    for k in range(1, rows):
        series[:, k] = keep * series[:, k - 1] + white[:, k]
    return series
