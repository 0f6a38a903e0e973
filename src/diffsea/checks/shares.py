"""Orders as shares of full order, and what of them drives and what turns a vessel."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from diffsea import pulses
from diffsea.channels import is_azimuth, side_pair, steers
from diffsea.recordings.known import Output
from diffsea.scales import HARD_OVER
from diffsea.series import hold_last
from diffsea.trajectory import Samples, Trajectory


_ROUNDING = 1.05  # of full order, that normalised orders may exceed
_LARGEST = 0.995  # quantile of sizes that stands for the largest order


@dataclasses.dataclass(frozen=True)
class OrderScale:
    """What of an order is none and what is full, in its own `unit`, and how that is known."""

    unit: str
    neutral: float
    full_ahead: float
    full_astern: float
    why: str

    def share(self, orders: Samples) -> Samples:
        """Shares of full order, from -1 astern to 1 ahead; a pulse of no length is none."""
        sign = 1.0 if self.full_ahead > self.neutral else -1.0
        above = sign * (orders - self.neutral)
        ahead, astern = abs(self.full_ahead - self.neutral), abs(self.full_astern - self.neutral)
        share = np.where(above >= 0, above / ahead, above / astern)
        return np.where((self.unit == "us") & (orders < pulses.SHORTEST), 0.0, share)


def order_scales(run: Trajectory, outputs: Sequence[Output] = ()) -> dict[str, OrderScale]:
    """The scale of every order that is no angle, by the autopilot's parameters or by its values.

    Of executed actuation where no order was recorded.
    """
    stated = {output.channel: output for output in outputs}
    found = {}
    for name, series in (run.commanded or run.executed).items():
        values = np.asarray(series, float)
        values = values[np.isfinite(values)]
        if steers(name) or not values.size or not np.any(values):
            continue
        if name in stated:
            one = stated[name]
            ends = (one.neutral, one.full_ahead, one.full_astern)
            found[name] = OrderScale("us", *ends, f"parameters of output {one.number}")
        else:
            found[name] = _scale_of(values)
    return found


def _scale_of(values: Samples) -> OrderScale:
    """The scale that values look like."""
    largest = float(np.quantile(np.abs(values), _LARGEST))
    if pulses.are_pulses(values):
        neutral = pulses.neutral_pulse(values)
        ends = neutral, neutral + pulses.SPAN, neutral - pulses.SPAN
        return OrderScale("us", *ends, "pulse widths by their values")
    if largest <= _ROUNDING:
        return OrderScale("normalised", 0.0, 1.0, -1.0, "shares by their values")
    return OrderScale("own", 0.0, largest, -largest, "shares of the largest order recorded")


def joint_scales(scales: Sequence[Mapping[str, OrderScale]]) -> list[dict[str, OrderScale]]:
    """The scales of several logs of one boat, in each of them.

    Where full order is the largest one recorded, it is that of all logs.
    """

    def joint(name: str, own: OrderScale) -> OrderScale:
        alike = [one[name] for one in scales if name in one and one[name].unit == "own"]
        if own.unit != "own":
            return own
        largest = max(one.full_ahead for one in alike)
        why = "shares of the largest order in any log"
        return OrderScale("own", 0.0, largest, -largest, why)

    return [{name: joint(name, own) for name, own in one.items()} for one in scales]


def in_shares(run: Trajectory, scales: Mapping[str, OrderScale]) -> Trajectory:
    """The run with its orders as shares of full order; angles stay."""

    def scaled(group: Mapping[str, Samples]) -> dict[str, Samples]:
        return {
            name: scales[name].share(np.asarray(series, float)) if name in scales else series
            for name, series in group.items()
        }

    return dataclasses.replace(run, commanded=scaled(run.commanded), executed=scaled(run.executed))


@dataclasses.dataclass(frozen=True)
class OrderShares:
    """What is ordered, as shares of full order in every row.

    Attributes:
        ahead: the mean of the propulsors.
        turning: half of port less starboard, or the rudder's angle over 35 deg to starboard; None
            where nothing steers.
        sides: port and starboard of a pair of thrusters.
    """

    ahead: Samples
    turning: Samples | None
    sides: tuple[Samples, Samples] | None


def orders_of(run: Trajectory) -> OrderShares | None:
    """The orders of a run whose orders are shares; None without any, and of azimuth thrusters."""
    group = {
        name: np.nan_to_num(hold_last(np.asarray(series, float)))
        for name, series in (run.commanded or run.executed).items()
        if np.any(np.isfinite(np.asarray(series, float)))
    }
    if any(map(is_azimuth, group)):
        return None
    rudders = [series for name, series in group.items() if steers(name)]
    driving = {name: series for name, series in group.items() if not steers(name)}
    if not group:
        return None
    none = np.zeros(run.t.shape)
    ahead = np.mean(list(driving.values()), axis=0) if driving else none
    if rudders:
        return OrderShares(ahead, np.mean(rudders, axis=0) / HARD_OVER, None)
    pair = side_pair(driving)
    if pair is not None:
        port, starboard = (driving[name] for name in pair)
        return OrderShares(ahead, (port - starboard) / 2, (port, starboard))
    return OrderShares(ahead, None, None)
