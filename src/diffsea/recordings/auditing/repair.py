"""Repairs what an audit finds, as far as it is certain, and says what was done and what is left.

Coarse faults first: a latency or an offset has no meaning while labels are wrong. The repairs of
one stage are made together, judged by another audit, and undone if that is no better.
"""

import dataclasses
import json
from collections.abc import Iterable

import numpy as np

from diffsea.recordings.auditing.audit import audit
from diffsea.recordings.auditing.edits import Edit
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.mappings import Column, Mapping
from diffsea.trajectory import MOTION_CHANNELS, Trajectory


_CERTAIN = 5.0  # standard errors that a fault must measure to be repaired unasked
_MOST = 30  # trials, far more than any order of repairs needs

# What is repaired when, and within a stage in which order: velocities and yaw rate are scaled
# before anything is added to them, the compass curve is one of the heading as recorded.
_STAGES: tuple[tuple[str, ...], ...] = (
    ("duplicate", "time-step"),
    ("swapped-channels", "axes", "sign", "unit"),
    ("outliers", "stuck"),
    ("clock-drift",),
    ("sensor-latency",),
    ("scale", "gyro-bias", "hard-iron", "heading-offset", "through-water", "lever-arm"),
)
_ACTUATORS = len(_STAGES)
_KNOWN = _ACTUATORS + 1  # nothing can be done, and nothing need be


@dataclasses.dataclass(frozen=True)
class Step:
    """One finding and what became of it: `applied`, `undone` or `left`, and why."""

    finding: Finding
    outcome: str
    reason: str
    in_mapping: bool = False

    def as_dict(self) -> dict:
        """The step as it stands in repairs.json."""
        return {
            "kind": self.finding.kind,
            "channels": list(self.finding.channels),
            "value": self.finding.value,
            "std": self.finding.std,
            "unit": self.finding.unit,
            "message": self.finding.message,
            "outcome": self.outcome,
            "reason": self.reason,
            "in_mapping": self.in_mapping,
        }


@dataclasses.dataclass(frozen=True)
class Repair:
    """A repaired recording, the mapping that reads it so, and how it came about.

    `steps` are what was applied, in that order, then what was undone or left. `mapping` holds
    the steps that a mapping can say. `before` and `left` are the audits of the recording given
    and of the repaired one.
    """

    run: Trajectory
    mapping: Mapping
    steps: tuple[Step, ...]
    before: tuple[Finding, ...]
    left: tuple[Finding, ...]

    @property
    def applied(self) -> tuple[Step, ...]:
        """The steps that changed the recording."""
        return tuple(step for step in self.steps if step.outcome == "applied")

    def as_dict(self) -> dict:
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
    before = audit(run)
    state = _State(run, _native(run) if mapping is None else _ned(mapping), before)
    refused: dict[tuple, str] = {}
    for _ in range(_MOST):
        waiting = [f for f in state.findings if not _hindrance(f, state.findings)]
        waiting = [f for f in waiting if _key(f) not in refused]
        if not waiting:
            break
        stage = min(map(_stage, waiting))
        together = sorted((f for f in waiting if _stage(f) == stage), key=_place)
        for group in (together, *([f] for f in together if len(together) > 1)):
            trial = state.after(group)
            if _better(state.findings, trial.findings):
                state, refused = trial, {}
                break
        else:
            refused |= {_key(f): _told(trial.findings) for f in together}
    return _outcome(state, before, refused)


@dataclasses.dataclass(frozen=True)
class _State:
    run: Trajectory
    mapping: Mapping
    findings: list[Finding]
    steps: tuple[Step, ...] = ()

    def after(self, group: Iterable[Finding]) -> "_State":
        """The state with the repairs of these findings."""
        run, mapping, steps = self.run, self.mapping, list(self.steps)
        for finding in group:
            mapped = _mapped(mapping, finding.edits)
            for edit in finding.edits:
                run = edit.apply(run)
            note = f"repaired {finding.kind}: {finding.message}"
            run = dataclasses.replace(run, provenance=(*run.provenance, note))
            steps.append(Step(finding, "applied", "the audit is better for it", bool(mapped)))
            mapping = mapped or mapping
        return _State(run, mapping, audit(run), tuple(steps))


def _mapped(mapping: Mapping, edits: Iterable[Edit]) -> Mapping | None:
    """The mapping with all these edits, None if it cannot say one of them."""
    changed: Mapping | None = mapping
    for edit in edits:
        changed = None if changed is None else edit.mapped(changed)
    return changed


def _outcome(state: _State, before: list[Finding], refused: dict[tuple, str]) -> Repair:
    steps = list(state.steps)
    for finding in state.findings:
        hindrance = _hindrance(finding, state.findings)
        if hindrance:
            steps.append(Step(finding, "left", hindrance))
        else:
            told = refused.get(_key(finding), "too many trials were needed")
            steps.append(Step(finding, "undone", told))
    return Repair(state.run, state.mapping, tuple(steps), tuple(before), tuple(state.findings))


def _hindrance(finding: Finding, findings: list[Finding]) -> str:
    """Why a finding cannot be repaired as things are; empty if it can."""
    if not finding.edits:
        return finding.repair or "nothing can be done about it here"
    if finding.doubt:
        return finding.doubt
    size = abs(finding.value - (finding.kind == "scale"))
    if np.isfinite(finding.std) and size < _CERTAIN * finding.std:
        return f"its size is below {_CERTAIN:g} standard errors"
    mislabelled = [f for f in findings if _stage(f) == 1 and f is not finding]
    if 1 < _stage(finding) < _ACTUATORS and mislabelled:
        return f"has no meaning before this is settled: {mislabelled[0].message}"
    return ""


def _stage(finding: Finding) -> int:
    if any(name.startswith(("cmd_", "exec_")) for name in finding.channels):
        return _ACTUATORS if finding.edits else _KNOWN
    stages = [i for i, kinds in enumerate(_STAGES) if finding.kind in kinds]
    if finding.channels == ("t",) and finding.kind == "unit":
        return 0
    if finding.kind in ("duplicate", "time-step") and not finding.edits:
        return _KNOWN
    return stages[0] if stages else _KNOWN


def _place(finding: Finding) -> int:
    order = [kind for kinds in _STAGES for kind in kinds]
    return order.index(finding.kind) if finding.kind in order else len(order)


def _key(finding: Finding) -> tuple:
    return (finding.kind, finding.channels)


def _counts(findings: list[Finding]) -> list[int]:
    stages = [_stage(finding) for finding in findings]
    return [stages.count(stage) for stage in range(_KNOWN)]


def _better(before: list[Finding], after: list[Finding]) -> bool:
    """Whether an audit has less to say, the coarser faults counting before the finer."""
    if _counts(before) != _counts(after):
        return _counts(after) < _counts(before)
    sizes = {_key(f): abs(f.value - (f.kind == "scale")) for f in before}
    same = {_key(f): abs(f.value - (f.kind == "scale")) for f in after}
    if set(sizes) != set(same):
        return False
    changed = [key for key in sizes if sizes[key] != same[key]]
    return bool(changed) and all(same[key] < 0.5 * sizes[key] for key in changed)


def _told(after: list[Finding]) -> str:
    found = "; ".join(finding.message for finding in after)
    return f"repaired, the audit was no better, so it was undone: {found}"


def _native(run: Trajectory) -> Mapping:
    """The mapping that reads a native file as it is."""
    names = ["t", *(name for name in MOTION_CHANNELS if run.has(name))]
    names += [f"cmd_{name}" for name in run.commanded]
    names += [f"exec_{name}" for name in run.executed] + list(run.extra)
    return Mapping(channels={name: Column(name) for name in names}, name="native columns")


def _ned(mapping: Mapping) -> Mapping:
    """The same mapping said in north-east-down axes, which the edits are in."""
    return dataclasses.replace(mapping, channels=mapping.ned_channels, frame="NED")


def mapping_text(mapping: Mapping, notes: Iterable[str] = ()) -> str:
    """The mapping as TOML, under comments."""
    lines = [f"# {line}" for note in notes for line in note.splitlines()]
    lines += ["format = 1", "", "[file]"]
    plain = Mapping(channels={})
    for field in dataclasses.fields(Mapping):
        value = getattr(mapping, field.name)
        if field.name in ("channels", "name") or value == getattr(plain, field.name):
            continue
        if field.name == "origin":
            value = [float(np.degrees(angle)) for angle in value]
        lines.append(f"{field.name} = {_toml(value)}")
    lines += ["", "[columns]"]
    lines += [f"{_toml_key(name)} = {_entry(c)}" for name, c in mapping.channels.items()]
    return "\n".join(lines) + "\n"


def _entry(column: Column) -> str:
    plain = Column(column.column)
    pairs = [
        f"{field.name} = {_toml(getattr(column, field.name))}"
        for field in dataclasses.fields(Column)
        if field.name == "column" or getattr(column, field.name) != getattr(plain, field.name)
    ]
    return "{ " + ", ".join(pairs) + " }"


def _toml(value: object) -> str:
    """Text, numbers and lists of them are written alike in TOML and JSON."""
    return json.dumps(value, ensure_ascii=False)


def _toml_key(name: str) -> str:
    plain = all(letter.isascii() and (letter.isalnum() or letter in "_-") for letter in name)
    return name if plain else _toml(name)
