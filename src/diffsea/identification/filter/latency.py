"""Delayed sensors in a Kalman filter.

A sample is used at the first row after the time that it is of, not at the one of its stamp: the
filter knows no delay, and no delay is too long for it. What is left, less than a row, is bridged by
the motion since the row before. Which row that is stays as it is while a fit takes a step, whatever
becomes of the delay: the innovations must not jump.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from diffsea.identification.data.dataset import Dataset
from diffsea.kinematics import to_earth
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.base import Vessel


SAME_TIME = 1e-6  # s: times nearer to one another are one


class SamplePlacement(eqx.Module):
    """At which rows a filter uses the samples, and where it begins anew.

    It does so in every row of a part until there is a sample.
    """

    source: Int[Array, "row 6"]  # the row of the recording whose sample is used here; -1 for none
    restarts: Bool[Array, "row"]

    @staticmethod
    def as_stamped(dataset: Dataset) -> "SamplePlacement":
        """Every sample at the row of its stamp."""
        rows = jnp.arange(dataset.t.size)[:, None]
        return SamplePlacement(jnp.where(dataset.known, rows, -1), dataset.starts)

    @property
    def is_sampled(self) -> Bool[Array, "row 6"]:
        """Which rows have a sample of which channel."""
        return self.source >= 0


class PlacedSamples(eqx.Module):
    """The samples that rows have."""

    measured: Float[Array, "row 6"]
    known: Bool[Array, "row 6"]
    moved: Float[Array, "row 6"]  # s, the stamp of each less the time of its row


def channel_latencies(vessel: Vessel) -> Float[Array, "6"]:
    """How late (s) each motion channel is."""
    lags = vessel.sensors.lags()
    return jnp.stack([jnp.asarray(lags[channel], float) for channel in MOTION_CHANNELS])


def place_samples(vessel: Vessel, dataset: Dataset) -> SamplePlacement:
    """Each sample at the first row after the time that it is of, one to a row, in their order."""
    t, part, rows = dataset.t, dataset.part, jnp.arange(dataset.t.size)
    # JAX counts in 32 bits here, whatever the numbers are that it counts.
    first, end = (jnp.searchsorted(part, part, side=s).astype(int) for s in ("left", "right"))

    def source_of(known: Bool[Array, "row"], lag: Float[Array, ""]) -> Int[Array, "row"]:
        next_row = jnp.searchsorted(t, t - lag - SAME_TIME).astype(int)
        # Those before take each a row of their own: what is left is behind their last one.
        number = jnp.cumsum(known).astype(int)
        free = jnp.clip(next_row, first, end - 1) - number + rows.size * part
        row = jax.lax.cummax(jnp.where(known, free, -1)) + number - rows.size * part
        row = jnp.where(known & (row < end), row, rows.size)
        return jnp.full(rows.size, -1, rows.dtype).at[row].set(rows, mode="drop")

    lags = channel_latencies(vessel)
    source = jax.vmap(source_of, (1, 0), 1)(dataset.known, lags)
    sampled = jnp.cumsum(jnp.any(source >= 0, axis=1))
    before = jnp.where(rows > 0, jnp.roll(sampled, 1), 0)
    return SamplePlacement(source, before == before[first])


def placed_samples(dataset: Dataset, placement: SamplePlacement) -> PlacedSamples:
    """The samples of all rows as they are placed."""
    source = jnp.maximum(placement.source, 0)
    measured = jnp.take_along_axis(dataset.measured, source, axis=0)
    moved = dataset.run_time[source] - dataset.run_time[:, None]
    known = placement.is_sampled
    return PlacedSamples(measured, known, jnp.where(known, moved, 0.0))


def shown_samples(
    vessel: Vessel,
    x: Float[Array, "6"],
    acceleration: Float[Array, "3"],
    moved: Float[Array, "6"],
) -> Float[Array, "6"]:
    """What the sensors should show in a state, of samples with stamps that much later.

    Each channel is taken where it was, up to a row ago: on a parabola of positions and heading, on
    a straight line of the speeds.
    """
    lag = channel_latencies(vessel) - moved
    north, east = to_earth(x[3], x[4], x[2])
    turn = to_earth(acceleration[0] - x[4] * x[5], acceleration[1] + x[3] * x[5], x[2])
    rate = jnp.stack([north, east, x[5], *acceleration])
    change = jnp.stack([*turn, acceleration[2], *jnp.zeros(3)])
    past = x - lag * rate + 0.5 * lag**2 * change
    return vessel.sensors.shown(dict(zip(MOTION_CHANNELS, past, strict=True)))
