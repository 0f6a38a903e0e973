"""Weather that varies, and sensors between vessel and controller."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError
from diffsea.kinematics import components_towards
from diffsea.missions.record import Flow, SensorErrors, Weather
from diffsea.simulation.control import AbstractController
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import with_effect
from diffsea.vessel.sensors import Sensors


Series = Float[Array, "time"] | float


class WeatherSeries(eqx.Module):
    """Water and air by controller period: each row holds until the next."""

    around: Environment  # of the vessel itself, to which the series add
    current_north: Series  # m/s, where the water flows to; the number zero where there is none
    current_east: Series
    wind_north: Series  # m/s, where the air moves to
    wind_east: Series
    period: float = eqx.field(static=True)  # s

    def __call__(self, t: Scalar) -> Environment:
        """What is around the vessel at `t` s."""
        row = jnp.floor(t / self.period + 1e-6).astype(int)
        names = ("current_north", "current_east", "wind_north", "wind_east")
        now = {}
        for name in names:
            series, own = getattr(self, name), getattr(self.around, name)
            if not isinstance(series, float):
                now[name] = own + series[jnp.minimum(row, series.shape[0] - 1)]
        return dataclasses.replace(self.around, **now)


def weather_series(
    weather: Weather, vessel: Vessel, rows: int, period: float, seed: int
) -> WeatherSeries:
    """The weather in rows of `period` s.

    Components go from one stated time to the next by straight lines. Gusts are two Gauss-Markov
    series, drawn by `seed`.
    """
    t = period * np.arange(rows)
    current_north = current_east = wind_north = wind_east = 0.0
    if weather.current is not None:
        current_north, current_east = _components(weather.current, t, 0.0)
    if weather.wind is not None:
        gusts = gauss_markov(np.random.default_rng([seed, 1]), rows, period, weather.gust_time)
        mean = jnp.stack(_components(weather.wind, t, math.pi))
        wind_north, wind_east = mean + weather.gusts * gusts
    return WeatherSeries(
        vessel.environment, current_north, current_east, wind_north, wind_east, period
    )


def _components(flow: Flow, t: Float[np.ndarray, "time"], turn: float) -> tuple[Array, Array]:
    """North and east (m/s) that a flow moves to; `turn` rad are added to its direction."""
    stated = components_towards(jnp.asarray(flow.speeds), jnp.asarray(flow.directions) + turn)
    north, east = (jnp.interp(t, jnp.asarray(flow.times), part) for part in stated)
    return north, east


def gauss_markov(
    rng: np.random.Generator, rows: int, period: float, time_constant: float
) -> Float[np.ndarray, "2 time"]:
    """Two series of unit variance whose correlation falls by e in `time_constant` s."""
    keep = math.exp(-period / time_constant)
    white = rng.normal(size=(2, rows))
    series = np.zeros((2, rows))
    series[:, 0] = white[:, 0]
    for k in range(1, rows):
        series[:, k] = keep * series[:, k - 1] + math.sqrt(1 - keep**2) * white[:, k]
    return series


def in_weather(vessel: Vessel, weather: Weather) -> Vessel:
    """The vessel with what the weather acts on: a superstructure, and the force of waves."""
    with jax.ensure_compile_time_eval():  # an effect is read from numbers, under jit, too
        if weather.wind is not None:
            still = {"name": "wind", "speed": 0.0, "direction": 0.0}
            vessel = with_effect(vessel, still | dict(weather.superstructure))
        if weather.wave:
            vessel = with_effect(vessel, {"name": "wave-force", **weather.wave})
    return vessel


PSI = MOTION_CHANNELS.index("psi")


class Instruments(eqx.Module):
    """What `Instrumented` remembers."""

    row: Int[Array, ""]
    past: Float[Array, "late 6"]  # true states, the latest first
    shown: Float[Array, "6"]  # what the controller was shown last
    inner: object  # the controller's own memory


class Instrumented(AbstractController[Instruments]):
    """A controller that sees the vessel through its sensors, and whose orders have limits.

    Each channel shows a true value of so many periods ago, with the sensors' errors and its noise.
    """

    inner: AbstractController
    sensors: Sensors
    noise: Float[Array, "row 6"]  # of x, y, psi, u, v, r
    limits: dict[str, tuple[Scalar, Scalar]]  # by channel
    late: tuple[int, ...] = eqx.field(static=True)  # periods, of each channel
    late_axes: int = eqx.field(static=True)  # periods, of `Sensors.latency_axes`

    def init(self) -> Instruments:
        past = jnp.zeros((max(*self.late, self.late_axes) + 1, 6))
        return Instruments(jnp.zeros((), int), past, jnp.zeros(6), self.inner.init())

    def step(
        self, memory: Instruments, state: State, t: Scalar, dt: Scalar
    ) -> tuple[Instruments, dict[str, Scalar]]:
        true = jnp.stack([jnp.asarray(getattr(state, c), float) for c in MOTION_CHANNELS])
        earlier = jnp.concatenate([true[None], memory.past[:-1]])
        past = jnp.where(memory.row == 0, jnp.broadcast_to(true, earlier.shape), earlier)
        latest = enumerate(zip(MOTION_CHANNELS, self.late, strict=True))
        shown: dict[str, Scalar] = {channel: past[row, k] for k, (channel, row) in latest}
        noise = self.noise[jnp.minimum(memory.row, self.noise.shape[0] - 1)]
        turned = past[0, PSI] - past[self.late_axes, PSI]
        measured = self.sensors.shown(shown, turned) + self.sensors.steps(t, dt) + noise
        inner, orders = self.inner.step(memory.inner, State(*measured), t, dt)
        limited = {
            channel: jnp.clip(order, *self.limits[channel]) if channel in self.limits else order
            for channel, order in orders.items()
        }
        return Instruments(memory.row + 1, past, measured, inner), limited

    def is_finished(self, memory: Instruments) -> Bool[Array, ""]:
        return self.inner.is_finished(memory.inner)


def instrumented(
    controller: AbstractController,
    vessel: Vessel,
    errors: SensorErrors,
    limits: dict[str, tuple[float, float]],
    rows: int,
    period: float,
    seed: int,
) -> Instrumented:
    """A controller behind the vessel's own sensors and the errors that a mission adds.

    Delays are rounded to whole periods of `period` s; noise is drawn by `seed`. Raises `UserError`
    for a vessel whose heading is an estimator's: none runs along a mission.
    """
    own = vessel.sensors
    if own.estimated_headings:
        raise UserError(
            "the vessel has the effect hard-iron of an estimator's heading, which missions do not "
            "have; state it as a compass's (amplitude and phase alone), or take it out of the file"
        )
    sensors = dataclasses.replace(
        own,
        heading_offset=own.heading_offset + errors.heading_offset,
        gyro_bias=own.gyro_bias + errors.gyro_bias,
    )
    size = jnp.array(
        [
            errors.position,
            errors.position,
            errors.heading,
            errors.velocity,
            errors.velocity,
            errors.yaw_rate,
        ]
    )
    noise = size * np.random.default_rng([seed, 2]).normal(size=(rows, 6))
    lags = (float(own.lags()[channel]) + errors.delay for channel in MOTION_CHANNELS)
    late = tuple(max(round(lag / period), 0) for lag in lags)
    bounds = jax.tree.map(lambda end: jnp.asarray(end, float), dict(limits))
    axes = max(round(float(own.latency_axes) / period), 0)
    return Instrumented(controller, sensors, jnp.asarray(noise), bounds, late, axes)
