"""From logs of service to trials: what is sound, where the vessel turned, in how much wind.

After Gavrilin and Steen (2017): logs with dead channels are left out, the others put on an even
clock and low-pass filtered, turning motion marked, repeats grouped. Zig-zags that were ordered
as such are groups of their own.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, sosfiltfilt

from diffsea.errors import UserError
from diffsea.recordings import Finding, audit_set
from diffsea.segments import Segment, SegmentSettings, by_place, group_repeats
from diffsea.segments.free_motion import quarter_turn_window, turning_motions
from diffsea.segments.segments import segments_of
from diffsea.segments.signals import Signals, signals_of
from diffsea.trajectory import Samples, Trajectory
from diffsea.vessel.base import Vessel


# Findings of the audit that make yaw or steering worthless.
UNSOUND = ("constant", "stuck", "unit", "sign", "swapped-channels", "time-step")
SAMPLES_PER_WINDOW = 90  # of the even clock: the published 1 s of a window of 90 s
CUT_OFF = 4.5  # cycles per window, of the low-pass filter: the published 0.05 Hz
MARGIN = 1 / 3  # windows kept before and after a turning motion
FEWEST_SAMPLES = 40  # of a trial
ONE_SIDED = 0.8  # of all turning goes to one side
LEAST_TURN = math.radians(5.0)  # change of heading: any turn counts


@dataclasses.dataclass(frozen=True)
class ServiceTrial:
    """One trial found in a log, on an even clock from zero at its start.

    Attributes:
        start, end: s, on the log's clock.
        psi: rad, as recorded; `r` (rad/s) and `steer` (rad, executed) are low-pass filtered.
        place: x, y (m) where it began and ended; None where positions are not known.
        side_wind: mean of the true wind's part abeam, m/s; NaN where wind was not recorded.
        zigzag: the segment, where it was ordered as one.
    """

    log: str
    start: float
    end: float
    t: Samples
    psi: Samples
    r: Samples
    steer: Samples
    place: tuple[float, float, float, float] | None
    side_wind: float
    zigzag: Segment | None = None


@dataclasses.dataclass(frozen=True)
class ServiceSearch:
    """What the search of all logs gave.

    Attributes:
        groups: trials by the name of their group, the largest first.
        excluded: logs that could not be used, and why.
        window, interval: s.
        notes: of the logs, in words.
    """

    groups: dict[str, list[ServiceTrial]]
    excluded: dict[str, str]
    window: float
    interval: float
    notes: tuple[str, ...]


def search_logs(
    runs: Sequence[Trajectory], vessel: Vessel | None = None, window: float | None = None
) -> ServiceSearch:
    """Trials of all logs, grouped.

    Arguments:
        vessel: says which actuators steer and how orders are answered.
        window: s in which the vessel turns by 90 deg at its fastest; by default the median of
            what the logs show.

    Raises:
        UserError: no log is sound, or none has a trial.
    """
    excluded: dict[str, str] = {}
    signals: list[Signals] = []
    for run, findings in zip(runs, audit_set(runs), strict=True):
        try:
            own = signals_of(run, vessel)
        except UserError as error:
            excluded[run.name] = str(error)
            continue
        why = _unsound(own, findings)
        if why is None:
            signals.append(own)
        else:
            excluded[run.name] = why
    if not signals:
        told = "\n  ".join(f"{name}: {why}" for name, why in excluded.items())
        raise UserError(f"none of the {len(runs)} logs can be used:\n  {told}")
    if window is None:
        window = float(np.median([quarter_turn_window(one.t, one.r) for one in signals]))
    interval = max(window / SAMPLES_PER_WINDOW, max(one.interval for one in signals))
    # A turn of a ferry between islands is a fraction of its fastest.
    settings = SegmentSettings(window=window, turning_share=0.2, least_turn=LEAST_TURN)
    trials = [trial for one in signals for trial in _trials_in(one, settings, interval)]
    if not trials:
        raise UserError(
            f"no turning motion was found in {len(signals)} logs with a window of {window:.3g} s; "
            "set --window to the time in which the vessel turns by 90 deg at its fastest"
        )
    notes = dict.fromkeys(note for one in signals for note in one.notes)
    return ServiceSearch(_grouped(trials), excluded, window, interval, tuple(notes))


def _unsound(signals: Signals, findings: Sequence[Finding]) -> str | None:
    """What makes a log worthless for yaw and steering, in words."""
    if signals.steer is None:
        return "no channel steers: name one rudder in the mapping, or give --vessel"
    steering = [f"{kind}_{c}" for c in signals.steering_channels for kind in ("cmd", "exec")]
    yaw = {"psi", "r", "t", *steering}
    dead = [one for one in findings if one.kind in UNSOUND and yaw & set(one.channels)]
    return dead[0].message if dead else None


def _trials_in(signals: Signals, settings: SegmentSettings, interval: float) -> list[ServiceTrial]:
    """Zig-zags and turning motions outside them, of one log; none that a hole or an end cuts."""
    zigzags = [one for one in segments_of(signals, settings) if one.kind == "zigzag"]
    found = [_trial(signals, settings, interval, one.start, one.end, one) for one in zigzags]
    margin = MARGIN * settings.seconds
    everywhere = signals.known & signals.working
    for first, last in turning_motions(signals.t, signals.psi, signals.r, everywhere, settings):
        start, end = signals.t[first] - margin, signals.t[last] + margin
        if any(one.start < end and one.end > start for one in zigzags):
            continue
        found.append(_trial(signals, settings, interval, float(start), float(end), None))
    return [one for one in found if one is not None]


def _trial(
    signals: Signals,
    settings: SegmentSettings,
    interval: float,
    start: float,
    end: float,
    zigzag: Segment | None,
) -> ServiceTrial | None:
    """One trial on the even clock, or None where the log does not have the whole of it."""
    count = int((end - start) / interval) + 1
    broken = any(start < signals.t[row] <= end for row in signals.breaks)
    outside = start < signals.t[0] or end > signals.t[-1] + 1e-9
    if count < FEWEST_SAMPLES or broken or outside:
        return None
    t = interval * np.arange(count)
    rows = signals.rows(start - settings.seconds, end + settings.seconds)
    clock = np.arange(signals.t[rows][0], signals.t[rows][-1], interval)
    smooth = lambda series: np.interp(
        start + t, clock, _low_pass(np.interp(clock, signals.t, series), settings, interval)
    )
    inside = signals.rows(start, end)
    if not np.isfinite(np.asarray(signals.steer)[inside]).all():
        return None
    return ServiceTrial(
        log=signals.run.name,
        start=start,
        end=end,
        t=t,
        psi=np.interp(start + t, signals.t, signals.psi),
        r=smooth(signals.r),
        steer=smooth(np.asarray(signals.steer)),
        place=_place(signals, inside),
        side_wind=_side_wind(signals, inside),
        zigzag=zigzag,
    )


def _low_pass(series: Samples, settings: SegmentSettings, interval: float) -> Samples:
    """Without delay; where the clock is too coarse for the filter, as it is."""
    share = 2 * CUT_OFF * interval / settings.seconds
    if share >= 1:
        return series
    return sosfiltfilt(butter(4, share, output="sos"), series, padlen=min(27, len(series) - 1))


def _place(signals: Signals, rows: slice) -> tuple[float, float, float, float] | None:
    x, y = np.asarray(signals.run.x)[rows], np.asarray(signals.run.y)[rows]
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not known.size:
        return None
    first, last = known[0], known[-1]
    return float(x[first]), float(y[first]), float(x[last]), float(y[last])


def _side_wind(signals: Signals, rows: slice) -> float:
    """Mean of the wind's part abeam without sign, m/s."""
    extra = signals.run.extra
    if "wind_speed" not in extra or "wind_direction" not in extra:
        return math.nan
    off = np.asarray(extra["wind_direction"])[rows] - signals.psi[rows]
    abeam = np.abs(np.asarray(extra["wind_speed"])[rows] * np.sin(off))
    return float(np.mean(abeam[np.isfinite(abeam)])) if np.isfinite(abeam).any() else math.nan


def _grouped(trials: Sequence[ServiceTrial]) -> dict[str, list[ServiceTrial]]:
    """Zig-zags by order and speed, to either side together; turning motions by place, or by side
    where positions were not recorded."""
    groups: dict[str, list[ServiceTrial]] = {}
    zigzags = [one for one in trials if one.zigzag is not None]
    either = [dataclasses.replace(one.zigzag, side=None) for one in zigzags if one.zigzag]
    for one, labelled in zip(zigzags, group_repeats(either), strict=True):
        groups.setdefault(labelled.group, []).append(one)
    turns = [one for one in trials if one.zigzag is None]
    places = [one.place for one in turns if one.place is not None]
    if turns and len(places) == len(turns):
        labels = [f"turns at place {k + 1}" for k in by_place(places)]
    else:
        labels = [f"turns {_sense(one)}" for one in turns]
    for one, label in zip(turns, labels, strict=True):
        groups.setdefault(label, []).append(one)
    return dict(sorted(groups.items(), key=lambda item: -len(item[1])))


def _sense(trial: ServiceTrial) -> str:
    """To which side the vessel turned."""
    net, path = float(np.trapezoid(trial.r)), float(np.trapezoid(np.abs(trial.r)))
    if abs(net) < ONE_SIDED * path:
        return "to either side"
    return "to starboard" if net > 0 else "to port"


def least_side_wind(
    trials: Sequence[ServiceTrial], most: int
) -> tuple[list[ServiceTrial], list[ServiceTrial]]:
    """The trials to use, those with the least wind abeam, and the others.

    Where wind was not recorded, those used are spread evenly over all.
    """
    winds = np.array([one.side_wind for one in trials])
    if np.isfinite(winds).any():
        order = np.argsort(np.where(np.isfinite(winds), winds, np.inf), kind="stable")[:most]
    else:
        order = np.unique(np.linspace(0, len(trials) - 1, min(most, len(trials))).round())
    used = set(order.astype(int).tolist())
    return (
        [one for k, one in enumerate(trials) if k in used],
        [one for k, one in enumerate(trials) if k not in used],
    )
