"""When the gate of an online estimator was closed, and why."""

import dataclasses

import numpy as np

from diffsea.identification.online.guarded import OnlineRun
from diffsea.identification.online.trust import ALARM_TRUST


@dataclasses.dataclass(frozen=True)
class ClosedSpan:
    """A time in which the gate was closed; why, the worst first, none where it only waited."""

    start: float  # s
    end: float
    reasons: tuple[str, ...]

    def __str__(self) -> str:
        why = "; ".join(self.reasons) or "it waited for a window without an alarm"
        return f"gate closed from {self.start:.1f} to {self.end:.1f} s: {why}"


def closed_spans(run: OnlineRun) -> list[ClosedSpan]:
    """When the gate was closed, and why: at the alarm that closed it, or, until it first opened,
    at the last alarm."""
    closed = ~run.open
    edges = np.flatnonzero(np.diff(np.concatenate([[False], closed, [False]]).astype(int)))
    spans = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        alarms = first + np.flatnonzero(~(run.trust[first:end] > ALARM_TRUST))
        why = run.reasons(int(alarms[0 if first else -1])) if alarms.size else ()
        until = run.t[min(end, len(run.t) - 1)]
        spans.append(ClosedSpan(float(run.t[first]), float(until), why))
    return spans
