"""One log checked: what is in it, whether it is sound, what was run, and what it shows."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from diffsea.checks.answers import Answers, answers_of
from diffsea.checks.corrections import correct_motion
from diffsea.checks.open_questions import OpenQuestion, next_length, next_minutes, open_questions
from diffsea.checks.shares import OrderScale, in_shares, order_scales, orders_of
from diffsea.errors import UserError
from diffsea.recordings import Finding
from diffsea.recordings.conditioning import cut
from diffsea.recordings.idle import IdleStretch, idle_stretches, used_spans
from diffsea.recordings.known import Output
from diffsea.recordings.mappings import is_held, native_channels
from diffsea.recordings.motion import motion_of
from diffsea.segments import Segment, find_segments, group_repeats
from diffsea.series import stretches
from diffsea.trajectory import Trajectory


REVERSED = ("sign", "swapped-actuators")  # findings of an audit that may be of turning
TRIALS = ("turning", "zigzag", "coasting", "straight")  # kinds that are listed
_SHORTEST = 5.0  # s: shorter coasting and straight courses are no trials
_MOST_GAPS = 400  # of a channel that are told: more is a ragged clock


@dataclasses.dataclass(frozen=True)
class ChannelContent:
    """Where a channel comes from: its column, the unit there, and samples per second."""

    source: str
    unit: str
    rate: float
    spans: tuple[tuple[float, float], ...]  # s, where it is known

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json."""
        return {"source": self.source, "unit": self.unit, "rate": self.rate}


@dataclasses.dataclass(frozen=True)
class LogCheck:
    """What a log contains and shows; times are s on the recording's clock.

    Attributes:
        log: the name of its format.
        title: the format for people.
        run: the recording, orders as they stand.
        corrected: the same without what is certain to be wrong in its motion, as `answers` and
            `trials` take it.
        scales: of its orders.
        idle, used: stretches that are left out, and spans that count.
        trials: what was run in these.
        missing: what was not recorded, with the setting that would.
        guesses: channels whose columns are no more than guessed, and why.
        notes: what else to know.
    """

    name: str
    log: str
    title: str
    craft: str
    run: Trajectory
    corrected: Trajectory
    channels: dict[str, ChannelContent]
    scales: dict[str, OrderScale]
    audit: tuple[Finding, ...]
    idle: tuple[IdleStretch, ...]
    used: tuple[tuple[float, float], ...]
    trials: tuple[Segment, ...]
    answers: Answers
    cannot_tell: tuple[OpenQuestion, ...]
    missing: tuple[str, ...] = ()
    guesses: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def reversed_turning(self) -> bool:
        """Whether the audit says that orders turn the vessel to the other side.

        Reversed or exchanged actuators do, and motion whose axes are mirrored.
        """

        def turns_back(one: Finding) -> bool:
            actuators = any(name.startswith(("cmd_", "exec_")) for name in one.channels)
            mirrored = one.kind in ("axes", "sign") and bool({"psi", "r"} & set(one.channels))
            return (one.kind in REVERSED and actuators) or mirrored

        return any(map(turns_back, self.audit))

    @property
    def next(self) -> list[OpenQuestion]:
        """What to record in the next minutes."""
        return next_minutes(self.cannot_tell, next_length(self.answers))

    def as_dict(self) -> dict[str, object]:
        """The content of check.json."""
        return {
            "format": 1,
            "file": self.name,
            "log": self.log,
            "craft": self.craft,
            "channels": {name: one.as_dict() for name, one in self.channels.items()},
            "orders": {name: dataclasses.asdict(one) for name, one in self.scales.items()},
            "missing": list(self.missing),
            "guesses": list(self.guesses),
            "audit": [finding.as_dict() for finding in self.audit],
            "used": [list(span) for span in self.used],
            "idle": [dataclasses.asdict(one) for one in self.idle],
            "trials": [_trial_record(one) for one in self.trials],
            "shows": self.answers.as_dict(),
            "cannot_tell": [one.as_dict() for one in self.cannot_tell],
            "next": {
                "seconds": next_length(self.answers),
                "record": [one.record for one in self.next],
            },
            "notes": list(self.notes),
        }


def check_run(
    run: Trajectory,
    findings: Sequence[Finding],
    log: tuple[str, str, str],
    sources: dict[str, tuple[str, str]],
    outputs: Sequence[Output] = (),
    missing: Sequence[str] = (),
    guesses: Sequence[str] = (),
) -> LogCheck:
    """The check of a recording that was read and audited.

    Arguments:
        log: the name of the format, the same for people, and the craft.
        sources: column and unit of each channel.
        outputs: what the orders of an autopilot are, where its parameters tell.
        missing: what was not recorded.
        guesses: which channels' columns are guessed, and why.
    """
    run = run.counted()
    scales = order_scales(run, outputs)
    corrected, notes = correct_motion(run, findings)
    shares = in_shares(corrected, scales)
    idle = idle_stretches(run)
    used = used_spans(run, idle)
    notes = list(notes)
    parts = [cut(shares, *span) for span in used]
    trials: list[Segment] = []
    for part in parts:
        try:
            trials += [one for one in find_segments(part) if _is_trial(one)]
        except UserError as error:
            notes.append(f"no trials were looked for: {error}")
    judged = orders_of(shares) is not None
    answers = answers_of([(shares, used)])
    whole = cut(shares, used[0][0], used[-1][1]) if used else shares
    questions = open_questions([whole], answers, trials, missing, judged)
    if not used:
        notes.append("all of it is idle: nothing is shown")
    name, title, craft = log
    return LogCheck(
        name=run.name,
        log=name,
        title=title,
        craft=craft,
        run=run,
        corrected=corrected,
        channels=_channels(run, sources),
        scales=scales,
        audit=tuple(findings),
        idle=tuple(idle),
        used=tuple(used),
        trials=tuple(group_repeats(trials)),
        answers=answers,
        cannot_tell=tuple(questions),
        missing=tuple(missing),
        guesses=tuple(guesses),
        notes=tuple(dict.fromkeys(notes)),
    )


def _is_trial(one: Segment) -> bool:
    """Whether a segment is worth a line: a manoeuvre, or a course that lasts."""
    manoeuvre = one.kind in ("turning", "zigzag")
    return one.kind in TRIALS and (manoeuvre or one.end - one.onset >= _SHORTEST)


def _channels(run: Trajectory, sources: dict[str, tuple[str, str]]) -> dict[str, ChannelContent]:
    """What every channel with a sample is from, how often it was sampled, and when it is known."""
    motion, found = motion_of(run), {}
    for name, series in native_channels(run).items():
        finite = np.isfinite(series)
        if name == "t" or not finite.any():
            continue
        known = finite
        if not is_held(name):
            known = motion.known[name] if name in motion.known else _bridged(run, finite)
        clock = motion.t if name in motion.known else run.t
        parts = stretches(known)[:_MOST_GAPS]
        spans = tuple((float(clock[part.start]), float(clock[part.stop - 1])) for part in parts)
        rate = run.read.rates.get(name, math.nan)
        if not math.isfinite(rate):
            times = run.t[finite]
            span = float(times[-1] - times[0]) if times.size > 1 else 0.0
            rate = (times.size - 1) / span if span > 0 else math.nan
        source, unit = sources.get(name, (name, ""))
        found[name] = ChannelContent(source, unit, float(rate), spans)
    return found


def _bridged(run: Trajectory, finite: np.ndarray) -> np.ndarray:
    """Rows of another channel that lie between samples no further apart than a few of its own."""
    times = run.t[finite]
    if times.size < 2:
        return finite
    after = np.searchsorted(times, run.t).clip(1, times.size - 1)
    apart = times[after] - times[after - 1]
    inside = (run.t >= times[0]) & (run.t <= times[-1])
    return inside & (apart <= 3.5 * np.median(np.diff(times)))


def _trial_record(one: Segment) -> dict[str, object]:
    """A trial as it stands in check.json; angles in rad, of rudder or rudder-equivalent."""
    return {
        "kind": one.kind,
        "side": one.side,
        "start": one.start,
        "onset": one.onset,
        "end": one.end,
        "order": one.order,
        "heading_change": one.heading_change,
        "approach_speed": one.approach.speed,
        "approach": one.approach.verdict,
        "group": one.group,
    }
