"""What a recording holds of a vessel's actuators and heel, in the rows that count."""

from collections.abc import Sequence

import numpy as np

from diffsea.errors import UserError
from diffsea.series import hold_last, interpolate_missing
from diffsea.trajectory import Samples, Trajectory
from diffsea.vessel.base import Vessel


MOVING = 0.3  # correlation of an actuator's next step with its last: above, it is on its way
AT_ONCE = 0.5  # share of its steps that orders of the same instant explain: above, it holds them
_LOST = 5.0  # sampling intervals of an actuator's own: without a value for longer, it is lost


def recorded_actuation(
    vessel: Vessel, recording: Trajectory
) -> tuple[dict[str, Samples], dict[str, Samples]]:
    """Orders of every channel, and executed values of those that were measured throughout.

    A channel without orders takes its executed values for them. Missing values hold the one
    before, leading ones the first; executed ones for five of their own sampling intervals.

    Raises:
        UserError: a channel of the vessel has neither.
    """
    run = recording.counted()
    orders, executed = {}, {}
    for channel in vessel.channels:
        done = run.executed.get(channel)
        order = run.commanded.get(channel, done)
        if order is None:
            have = ", ".join([*run.commanded, *run.executed]) or "none"
            raise UserError(
                f"{run.name}: the vessel's actuator channel {channel!r} has neither a "
                f"cmd_{channel} nor an exec_{channel} column (it has: {have}); add it, or map "
                "the file's own column to it with --mapping"
            )
        if not np.isfinite(order).any():
            raise UserError(f"{run.name}: cmd_{channel} has no value at all")
        orders[channel] = hold_last(order)
        found = None if done is None else _measured(run.t, done)
        if found is not None:
            executed[channel] = found
    return orders, executed


def over_rows(recording: Trajectory, executed: dict[str, Samples]) -> dict[str, Samples]:
    """Executed values as they act from each row to the next.

    What moves in steps holds until the next value. What is on its way from one sample to the next
    (a rudder that slews, a thruster that spools up) has been sampled: held, it would act half a
    sampling interval late, so its mean over the row is taken, by straight lines.
    """
    run = recording.counted()
    out = {}
    for channel, values in executed.items():
        sampled = run.executed[channel]
        known = np.isfinite(sampled)
        order = run.commanded.get(channel)
        order = None if order is None else hold_last(order)[known]
        out[channel] = values
        if _on_its_way(sampled[known], order):
            line = interpolate_missing(run.t, sampled)
            out[channel] = 0.5 * (line + np.append(line[1:], line[-1]))
    return out


def _on_its_way(values: Samples, orders: Samples | None) -> bool:
    """Whether a measured actuator moves between its samples, rather than at them.

    Its steps then follow one another. White noise is taken out of their correlations: it adds to
    that of a step with itself, and takes half as much from that with the next.
    """
    steps = np.diff(values)
    if len(steps) < 3 or not steps.any():
        return False
    itself, following, after = (float(steps[k:] @ steps[: len(steps) - k]) for k in range(3))
    noise = max(after - following, 0.0)
    if max(following, after) <= MOVING * max(itself - 2 * noise, 0.0):
        return False
    ordered = np.zeros(len(steps)) if orders is None else np.diff(orders)
    if not np.isfinite(ordered).all() or not ordered.any():
        return True
    return float(steps @ ordered) ** 2 < AT_ONCE * itself * float(ordered @ ordered)


def recorded_heel(recording: Trajectory) -> Samples:
    """Recorded heel (rad) of the rows that count, missing samples interpolated; zero without."""
    run = recording.counted()
    if "phi" not in run.extra or not np.isfinite(run.extra["phi"]).any():
        return np.zeros(len(run.t))
    phi = interpolate_missing(run.t, run.extra["phi"])
    return 0.5 * (phi + np.append(phi[1:], phi[-1]))  # it is held over a row: the mean there


def how_actuated(vessel: Vessel, recordings: Sequence[Trajectory]) -> dict[str, str]:
    """Whether what each channel executed is measured or reconstructed from its orders.

    Recordings that are fitted together take a channel as measured only where all have measured
    it; where some have, they are told.
    """
    done = [(run.name, recorded_actuation(vessel, run)[1]) for run in recordings]
    out = {}
    for channel in vessel.channels:
        lacking = [name for name, executed in done if channel not in executed]
        out[channel] = "reconstructed" if lacking else "measured"
        if 0 < len(lacking) < len(done):
            out[channel] += f" (not measured throughout in {', '.join(lacking)})"
    return out


def _measured(t: Samples, values: Samples) -> Samples | None:
    """Executed values, each held until the next; None where a stretch of the run lacks them."""
    known = t[np.isfinite(values)]
    if not len(known):
        return None
    usual = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    longest = np.diff([t[0], *known, t[-1]]).max()
    return hold_last(values) if longest <= _LOST * usual * (1 + 1e-9) else None
