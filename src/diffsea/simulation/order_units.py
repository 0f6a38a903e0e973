"""Whether a recording's actuation is in the units in which a vessel's channels are ordered."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from diffsea import pulses
from diffsea.errors import UserError
from diffsea.progress import Progress, Remark, no_progress
from diffsea.recordings.auditing.finding import Finding, finding_of
from diffsea.simulation.steered_thrust import with_thruster_orders
from diffsea.trajectory import Samples, Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.servo import Servo


# Of the largest limit. No controller asks for three times what there is, and units are further
# apart: per cent and N of boats, rev/s and rpm, rad and deg.
_BEYOND = 3.0
# A fiftieth of full thrust is a seventh of full speed, by quadratic drag: no run is driven by less.
_HARDLY_ANY = 0.02
_OFTEN = 0.05  # of the values beyond a limit: a vessel that takes no more is told of
_LARGEST_SHARE = 0.99  # of the values is below the largest size: wild values are no unit
_ROUNDING = 1.05  # of full order, that normalised orders and per cents may exceed


def unit_findings(vessel: Vessel, recording: Trajectory) -> list[Finding]:
    """Actuation that is plainly in another unit than the vessel's, one finding per column.

    Sizes are those of 99 % of the values, from neutral. An order beyond three times the largest
    limit, a steering angle beyond half a turn, and an angle that may go round but jumps by more
    than a turn are certain (no `doubt`). Propulsion that never exceeds a fiftieth of its limit, and
    orders of which a twentieth lie beyond theirs, are matters of doubt.
    """
    run, units, found = recording.counted(), vessel.units, []
    for prefix, group in (("cmd_", run.commanded), ("exec_", run.executed)):
        for name, servo in vessel.servos.items():
            values = np.asarray(group.get(name, ()), float)
            values = values[np.isfinite(values)]
            one = _finding(prefix + name, values, servo, units[name]) if values.size else None
            found += [] if one is None else [dataclasses.replace(one, recording=run.name)]
    return found


def with_usable_actuation(
    vessel: Vessel, recordings: Iterable[Trajectory], progress: Progress = no_progress
) -> list[Trajectory]:
    """Recordings without executed actuation that is in another unit than the vessel's orders.

    A shaft speed that was measured beside orders in per cent says nothing in per cent: what was
    executed is reconstructed from such orders. A helm and a throttle are those of an
    outboard, where the vessel has nothing else (`with_thruster_orders`).

    Raises:
        UserError: as `require_order_units` does, of what is left.
    """
    found, left_out = list[Trajectory](), dict[tuple[str, ...], list[str]]()
    for run in with_thruster_orders(vessel, recordings, progress):
        certain = [one for one in unit_findings(vessel, run) if not one.doubt]
        accused = {channel for one in certain for channel in one.channels}
        needless = tuple(
            name for name in run.executed if f"exec_{name}" in accused and name in run.commanded
        )
        if needless:
            left_out.setdefault(needless, []).append(run.name)
            executed = {name: run.executed[name] for name in run.executed if name not in needless}
            run = dataclasses.replace(run, executed=executed)
        found.append(run)
    for needless, names in left_out.items():
        columns = " and ".join(f"exec_{name}" for name in needless)
        progress(
            Remark(
                f"{columns} in another unit than the orders ({', '.join(names)}): what was "
                "executed is reconstructed from these; a scale in the mapping would make it count"
            )
        )
    require_order_units(vessel, found)
    return found


def require_order_units(vessel: Vessel, recordings: Iterable[Trajectory]) -> None:
    """Raise `UserError` for the first recording with actuation that is certainly in another unit.

    It says what was recorded, the vessel's limits, and which unit it looks like.
    """
    for run in recordings:
        certain = [one for one in unit_findings(vessel, run) if not one.doubt]
        if certain:
            alike = ", ".join(channel for one in certain[1:] for channel in one.channels)
            likewise = f" (likewise {alike})" if alike else ""
            first = certain[0]
            raise UserError(f"{run.name}: {first.message}{likewise}; {first.repair}")


def order_doubts(vessel: Vessel, recording: Trajectory, measured: Iterable[str]) -> list[str]:
    """What is doubtful about the actuation that is used of a recording, in words with what to do.

    Arguments:
        measured: channels of which it is the measured one; the orders of the others.
    """
    executed = set(measured)
    used = {f"{'exec_' if c in executed else 'cmd_'}{c}" for c in vessel.channels}
    found = [one for one in unit_findings(vessel, recording) if one.doubt]
    return [f"{one.message}; {one.repair}" for one in found if used & {*one.channels}]


def _finding(channel: str, values: Samples, servo: Servo, unit: str) -> Finding | None:
    """What is wrong with the unit of a column's values, if anything is."""
    neutral = 0.0 if servo.neutral is None else float(servo.neutral)
    ends = [float(end) - neutral for end in (servo.lower, servo.upper) if end is not None]
    limit, steers = max(map(abs, ends), default=0.0), unit == "rad"
    size = float(np.quantile(np.abs(values - neutral), _LARGEST_SHARE))
    if servo.endless:
        jump = float(np.abs(np.diff(values)).max(initial=0.0))
        certain = jump > 2 * np.pi and size > np.pi
    else:
        certain = (0 < _BEYOND * limit < size) or (steers and size > np.pi)
    beyond = 0.0 if certain or servo.endless else _share_beyond(values, servo)
    hardly = not steers and 0 < size < _HARDLY_ANY * limit
    if not (certain or hardly or beyond > _OFTEN):
        return None
    low, high = np.quantile(values, (1 - _LARGEST_SHARE, _LARGEST_SHARE))
    words = {"range": f"{low:.4g} to {high:.4g}", "limits": _limits(servo, unit)}
    words |= _guess(low, high, unit)
    ratio = size / (limit if limit > 0 else np.pi)
    if certain:
        return finding_of("actuation-unit", (channel,), ratio, 0.0, words)
    if beyond > _OFTEN:
        words["share"] = f"{100 * beyond:.0f} %"
        doubt = "a controller may ask for more than there is"
        return finding_of("clipped-orders", (channel,), beyond, 0.0, words, doubt=doubt)
    doubt = "the vessel may have been driven at next to nothing"
    return finding_of("hardly-driven", (channel,), ratio, 0.0, words, doubt=doubt)


def _share_beyond(values: Samples, servo: Servo) -> float:
    """Share of the values beyond a channel's limits, by more than rounding."""
    low, high = (None if end is None else float(end) for end in (servo.lower, servo.upper))
    span = max(abs(end) for end in (low, high, 0.0) if end is not None)
    slack = (_ROUNDING - 1) * span
    above = np.zeros(values.shape, bool) if high is None else values > high + slack
    below = np.zeros(values.shape, bool) if low is None else values < low - slack
    return float(np.mean(above | below))


def _limits(servo: Servo, unit: str) -> str:
    """What a channel takes, in words."""
    low, high = (None if end is None else float(end) for end in (servo.lower, servo.upper))
    if high is None:
        return f"angles in {unit}" if low is None else f"{low:.4g} {unit} or more"
    return f"at most {high:.4g} {unit}" if low is None else f"{low:.4g} to {high:.4g} {unit}"


def _guess(low: float, high: float, unit: str) -> dict[str, str]:
    """What values from `low` to `high` look like, and what to do then."""
    size, steers = max(abs(low), abs(high)), unit == "rad"
    if pulses.SHORTEST <= low and high <= pulses.LONGEST:
        looks, scale = "pulse widths in us", "us"
    elif steers:
        looks, scale = "degrees", "deg"
    elif size <= _ROUNDING:
        looks, scale = "normalised orders, -1 to 1", "normalised"
    elif size <= 100 * _ROUNDING:
        looks, scale = "per cent", "percent"
    else:
        looks, scale = "revolutions per minute, or newton", "rpm"
    if scale == unit:
        return {"guess": "one of them is wrong", "way": "correct the limits, or scale the column"}
    if scale == "deg":
        way = 'unit = "deg" for the column in the mapping'
    elif steers:
        way = "scale the column to angles in the mapping"
    else:
        way = f'unit = "{scale}" for the thruster in the vessel file, or scale the column'
    return {"guess": f"the values look like {looks}", "way": way}
