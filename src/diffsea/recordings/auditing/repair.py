"""Repairs what an audit finds, as far as it is certain, and says what was done and what is left.

Coarse faults first: a latency or an offset has no meaning while labels are wrong. The repairs of
one stage are made together, judged by another audit, and undone if that is no better.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from diffsea.recordings.auditing.audit import audit
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.mappings import Column, Mapping, native_channels
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


_CERTAIN = 5.0  # standard errors that a fault must measure to be repaired unasked
_MUCH_SMALLER = 0.5  # of a fault's size, that a repair must leave at most where no fault goes
_MOST_TRIALS = 30  # far more than any order of repairs needs

# What is repaired when, and within a stage in which order: velocities and yaw rate are scaled
# before anything is added to them, the compass curve is one of the heading as recorded.
_STAGES: tuple[tuple[str, ...], ...] = (
    ("duplicate", "time-step"),
    ("swapped-channels", "axes", "sign", "unit"),
    ("interpolated", "outliers", "stuck", "constant", "bursts"),
    ("clock-drift",),
    ("sensor-latency",),
    ("scale", "gyro-bias", "hard-iron", "heading-offset", "through-water", "lever-arm"),
)
_ORDER = [kind for kinds in _STAGES for kind in kinds]
_CLOCK, _LABELS = 0, 1
_ACTUATORS = len(_STAGES)
_HARMLESS = _ACTUATORS + 1  # nothing can be done, and nothing need be

_FINDING_KEYS = ("kind", "channels", "value", "std", "unit", "message")  # in repairs.json
_Fault = tuple[str, tuple[str, ...]]  # kind and channels: what makes two findings the same


@dataclasses.dataclass(frozen=True)
class RepairStep:
    """One finding and what became of it: `applied`, `undone` or `left`, and why."""

    finding: Finding
    outcome: str
    reason: str
    in_mapping: bool = False

    def as_dict(self) -> dict[str, object]:
        """The step as it stands in repairs.json."""
        own = {"outcome": self.outcome, "reason": self.reason, "in_mapping": self.in_mapping}
        return {key: self.finding.as_dict()[key] for key in _FINDING_KEYS} | own


@dataclasses.dataclass(frozen=True)
class Repair:
    """A repaired recording, the mapping that reads it so, and how it came about.

    `steps` are what was applied, in that order, then what was undone or left. `mapping` holds
    the steps that a mapping can say. `before` and `left` are the audits of the recording given
    and of the repaired one.
    """

    run: Trajectory
    mapping: Mapping
    steps: tuple[RepairStep, ...]
    before: tuple[Finding, ...]
    left: tuple[Finding, ...]

    @property
    def applied(self) -> tuple[RepairStep, ...]:
        """The steps that changed the recording."""
        return tuple(step for step in self.steps if step.outcome == "applied")

    def as_dict(self) -> dict[str, object]:
        """The repair as it stands in repairs.json."""
        return {
            "recording": self.run.name,
            "steps": [step.as_dict() for step in self.steps],
            "before": [finding.as_dict() for finding in self.before],
            "left": [finding.as_dict() for finding in self.left],
            "provenance": list(self.run.provenance),
        }


def repair(run: Trajectory, mapping: Mapping | None = None) -> Repair:
    """Repair a recording as far as its faults are certain and better repaired than not.

    A fault is repaired if the audit has an edit for it, names no other explanation, and measures
    it at five standard errors or more. An edit stays only if the next audit has fewer findings
    in the coarsest stage where the two differ, or a smaller one in place of the same. Repairing a
    repaired recording therefore changes nothing. `mapping` is the one that `run` was read
    through; without one its columns are the native ones.
    """
    before = tuple(audit(run))
    if mapping is None:
        measured = [name for name in MOTION_CHANNELS if run.has(name)]
        names = [n for n in native_channels(run) if n not in MOTION_CHANNELS or n in measured]
        mapping = Mapping(channels={name: Column(name) for name in names}, name="native columns")
    else:  # the edits are in north-east-down axes
        mapping = dataclasses.replace(mapping, channels=mapping.ned_channels, frame="NED")
    done = Repair(run, mapping, (), before, before)
    refused: dict[_Fault, str] = {}
    for _ in range(_MOST_TRIALS):
        waiting = [f for f in done.left if not hindrance(f, done.left)]
        waiting = [f for f in waiting if _fault(f) not in refused]
        if not waiting:
            break
        stage = min(map(_stage, waiting))
        together = [f for f in waiting if _stage(f) == stage]
        together.sort(key=lambda f: _ORDER.index(f.kind) if f.kind in _ORDER else len(_ORDER))
        for group in (together, *([f] for f in together if len(together) > 1)):
            trial = _with_repairs(done, group)
            if _is_better(done.left, trial.left):
                done, refused = trial, {}
                break
        else:
            found = "; ".join(finding.message for finding in trial.left)
            why = f"repaired, the audit was no better, so it was undone: {found}"
            refused |= {_fault(f): why for f in together}
    steps = list(done.steps)
    for finding in done.left:
        if why := hindrance(finding, done.left):
            steps.append(RepairStep(finding, "left", why))
        else:
            why = refused.get(_fault(finding), "too many trials were needed")
            steps.append(RepairStep(finding, "undone", why))
    return dataclasses.replace(done, steps=tuple(steps))


def _with_repairs(done: Repair, group: Iterable[Finding]) -> Repair:
    """The repairs of these findings as well, and what an audit leaves after them."""
    run, mapping, steps = done.run, done.mapping, list(done.steps)
    for finding in group:
        amended: Mapping | None = mapping
        for edit in finding.edits:
            run = edit.apply(run)
            amended = None if amended is None else edit.amend_mapping(amended)
        note = f"repaired {finding.kind}: {finding.message}"
        run = dataclasses.replace(run, provenance=(*run.provenance, note))
        why = "the audit is better for it"
        steps.append(RepairStep(finding, "applied", why, amended is not None))
        mapping = mapping if amended is None else amended
    return Repair(run, mapping, tuple(steps), done.before, tuple(audit(run)))


def _fault(finding: Finding) -> _Fault:
    return finding.kind, finding.channels


def _size(finding: Finding) -> float:
    """How far a finding is from no fault at all, in its unit."""
    return abs(finding.value - (finding.kind == "scale"))


def hindrance(finding: Finding, findings: Sequence[Finding]) -> str:
    """Why a finding cannot be repaired as things are; empty if it can."""
    if not finding.edits:
        return finding.repair or "nothing can be done about it here"
    if finding.doubt:
        return finding.doubt
    if np.isfinite(finding.std) and _size(finding) < _CERTAIN * finding.std:
        return f"its size is below {_CERTAIN:g} standard errors"
    mislabelled = [f for f in findings if _stage(f) == _LABELS and f is not finding]
    if _LABELS < _stage(finding) < _ACTUATORS and mislabelled:
        return f"has no meaning before this is settled: {mislabelled[0].message}"
    return ""


def _stage(finding: Finding) -> int:
    """When it is repaired: stamps and labels before sensors, actuators after motion."""
    if any(name.startswith(("cmd_", "exec_")) for name in finding.channels):
        return _ACTUATORS if finding.edits else _HARMLESS
    if finding.channels == ("t",) and finding.kind == "unit":
        return _CLOCK
    if finding.kind in _STAGES[_CLOCK] and not finding.edits:
        return _HARMLESS
    return next((i for i, kinds in enumerate(_STAGES) if finding.kind in kinds), _HARMLESS)


def _is_better(before: Sequence[Finding], after: Sequence[Finding]) -> bool:
    """Whether an audit has less to say, the coarser faults counting before the finer."""
    stages = [[_stage(finding) for finding in findings] for findings in (before, after)]
    counts = [[found.count(stage) for stage in range(_HARMLESS)] for found in stages]
    if counts[0] != counts[1]:
        return counts[1] < counts[0]
    old, new = ({_fault(f): _size(f) for f in findings} for findings in (before, after))
    if set(old) != set(new):
        return False
    changed = [fault for fault in old if old[fault] != new[fault]]
    return bool(changed) and all(new[fault] < _MUCH_SMALLER * old[fault] for fault in changed)
