"""Columns of actuators: what they drive, whether ordered or realised, and which way they push.

Names say what is a rudder or a thruster; whether a positive value turns the vessel to
starboard, the yaw rate says. The responses are those of the audit: a column whose negative
would be found to push the wrong way is confirmed as it stands.
"""

import dataclasses
import math
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from diffsea import pulses
from diffsea.recordings.auditing.actuators import order_findings
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.auditing.responses import (
    LaggedResponse,
    on_motion_clock,
    response_findings,
    response_to,
    with_yaw_rate,
)
from diffsea.recordings.mapping_proposal.azimuths import AzimuthColumns, azimuth_columns
from diffsea.recordings.mapping_proposal.names import NAMED, Suggestion, suggest_labels
from diffsea.recordings.mappings import UNITS
from diffsea.recordings.motion import MeasuredMotion, motion_of
from diffsea.series import hold_last
from diffsea.trajectory import Series, Trajectory


ROLES = ("rudder", "propeller", "port", "starboard", "thrust")  # labels of names
_LARGEST_RADIANS = 0.9  # of a rudder: beyond, the numbers are degrees
SIDES = ("port", "starboard")
# Probabilities that a column is an order, or was realised, for each reason to think so: what moves
# gradually may also be an order from a lever that somebody moves, or from a controller.
_JUMPS, _SAID, _GRADUAL, _CONSTANT = 0.98, 0.95, 0.75, 0.6
_MOST_TRIED = 3  # runs whose motion is asked for its answer to a column: each is audited
_FASTEST = 30.0  # rev/s of a propeller: beyond, the numbers are rpm
# Probabilities that an unnamed column is a rudder where yaw answers it and no other one so well,
# and where only its reversals show that it steers.
_ANSWERED, _REVERSED = 0.9, 0.5
_MOMENT = 0.005  # of a run, in which a column that stands does not move
_STILL = 0.02  # of its range, that noise may move it then
_PAIRED = 0.9  # probability that an angle and a power of one name are an azimuth thruster's
_WHOLE_TURN = 2 * math.pi + 0.05  # rad: beyond, an angle is in degrees
_FORCES = ("N", "kN")
_ENGINE = {"engine", "eng"}
_MOST_SHARE = 150.0  # of an engine whose orders are shares: beyond, they are revolutions
_ROTATING = {"rpm", "rps", "n", "propeller", "prop", "shaft", "drehzahl", "revs"}


@dataclasses.dataclass(frozen=True)
class ActuatorColumn:
    """One column that drives the vessel.

    Attributes:
        role: one of `ROLES`, `motor` for a propeller whose orders are no shaft speeds, or
            `NAME.force` and `NAME.angle` of an azimuth thruster.
        sure: probability that the role, and `ordered`, are right.
        unit: one of `UNITS`, or empty where nothing tells it.
        ordered: whether it holds orders, rather than what was realised.
        reason: why it is taken for what it is, in words.
        push: 1 where a positive value was seen to turn to starboard (speed up, of a
            propeller), -1 where the contrary, 0 where the runs do not tell. Of thrusters on
            either side, 1 where more on the port side turns to starboard.
        is_named: whether its name says its role.
        scale, offset: as of a mapping's column.
    """

    column: str
    role: str
    sure: float
    unit: str
    ordered: bool
    reason: str
    push: int
    is_named: bool = True
    scale: float = 1.0
    offset: float = 0.0

    @property
    def turns(self) -> bool:
        """Whether it is yaw that answers."""
        return self.role in ("rudder", "port", "starboard")


def called_like_actuators(names: Iterable[str]) -> list[str]:
    """The columns of those names that drive the vessel, by what they are called."""
    suggestions = {name: suggest_labels(name) for name in names}
    turning = azimuth_columns(list(suggestions), suggestions)
    azimuths = {column for one in turning for column in one.columns}
    return [
        name
        for name, told in suggestions.items()
        if name in azimuths or max(told.weights[role] for role in ROLES) > NAMED
    ]


def find_actuators(
    runs: list[Trajectory], suggestions: dict[str, Suggestion], unnamed: list[str]
) -> list[ActuatorColumn]:
    """Actuators of runs whose `commanded` has every column that may be one.

    `unnamed` are those whose names say nothing; the one that yaw answers best is taken for
    a rudder where no column is named as what turns the vessel.
    """
    tried = runs[:_MOST_TRIED]
    found = _azimuths(runs, suggestions)
    turning = {one.column for one in found}
    unnamed = [column for column in unnamed if column not in turning]
    for role in ROLES:
        columns = [c for c in runs[0].commanded if suggestions[c].weights[role] > NAMED]
        columns = [c for c in columns if c not in turning]
        if role == "rudder":  # a pulse of no length is no angle, and no mapping can say so
            columns = [c for c in columns if not any(_has_lost_pulses(run, c) for run in runs)]
        pair = _order_and_answer(role, columns, suggestions, runs)
        for column in pair:
            verdicts = []
            if role in ("rudder", "propeller"):
                verdicts = [_push_of(run, role, run.commanded[column]) for run in tried]
            chance = suggestions[column].weights[role]
            beside = any(suggestions[one].ordered for one in pair if one != column)
            told = suggestions[column]
            found.append(_actuator(column, role, chance, told, runs, verdicts, beside))
    if len({one.role for one in found} & set(SIDES)) == 1:  # of one side alone: something else's
        found = [one for one in found if one.role not in SIDES]
    found = _with_sides(found, tried)
    if turning or any(actuator.turns for actuator in found) or not unnamed:
        return found
    best, chance = _most_answered(tried, unnamed)
    why = "yaw rate answers it best of the unnamed columns"
    if not best:
        best, chance = _reversed_in_zigzags(tried, unnamed), _REVERSED
        why = "of the unnamed columns it is the one that is reversed as in a zig-zag"
        if not best:
            return found
    verdicts = [_push_of(run, "rudder", run.commanded[best]) for run in tried]
    rudder = _actuator(best, "rudder", chance, suggestions[best], runs, verdicts)
    reason = f"{why}; {rudder.reason}"
    return [*found, dataclasses.replace(rudder, reason=reason, is_named=False)]


def _azimuths(runs: list[Trajectory], suggestions: dict[str, Suggestion]) -> list[ActuatorColumn]:
    """Azimuth thrusters: power and angle of each, and which way its positive angles push."""
    found, columns = [], azimuth_columns(list(runs[0].commanded), suggestions)
    alone = len({one.name for one in columns}) == 1
    for one in columns:
        others, push = {"force": one.angle, "angle": one.power}, 0
        parts = (("force", one.power), ("angle", one.angle), *one.realised.items())
        for part, column in parts:
            suggestion, reason = suggestions[column], f"named like {others[part]!r}"
            values = np.concatenate([_finite(run, column) for run in runs])
            unit = suggestion.unit if suggestion.unit in _FORCES else ""
            if part == "angle":
                degrees = float(np.max(np.abs(values), initial=0.0)) > _WHOLE_TURN
                unit = "deg" if suggestion.unit == "deg" or degrees else "rad"
                place = one.place or ("aft" if alone else "")
                if place and not push:  # what was realised pushes as what was ordered
                    push = _azimuth_push(runs[:_MOST_TRIED], one, place, unit)
                if place:
                    reason += f"; taken to be {place} of amidships"
            else:
                reason += "; taken as it stands: the vessel file states the unit"
                reason += f', "{suggestion.unit}"' if suggestion.unit in ("rpm", "rev/s") else ""
            is_realised = column in one.realised.values()
            ordered, why, sure = _is_order(column, suggestion, runs, is_realised)
            ordered = ordered and not is_realised
            role, acts = f"{one.name}.{part}", push if part == "angle" else 0
            reason = f"an azimuth thruster, {reason}; {why}"
            sure *= _PAIRED
            found.append(ActuatorColumn(column, role, sure, unit, ordered, reason, acts))
    return found


def _azimuth_push(runs: list[Trajectory], one: AzimuthColumns, place: str, unit: str) -> int:
    """1 where positive angles are seen to push to starboard, -1 to port, 0 where nothing tells.

    By the yaw rate's answer to the athwart part of the thrust: a push to starboard turns the bow to
    starboard where it acts `fore` of amidships, and to port `aft`.
    """
    verdicts = []
    for run in runs:
        power, angle = (hold_last(run.commanded[c]) for c in (one.power, one.angle))
        athwart = power * np.sin(np.radians(angle) if unit == "deg" else angle)
        verdicts.append(_push_of(run, "rudder", athwart))
    return _vote(verdicts) * (1 if place == "fore" else -1)


def _most_answered(runs: list[Trajectory], columns: list[str]) -> tuple[str, float]:
    """The column that yaw rate answers best, and the probability that it is what steers.

    By the likelihoods of yaw rates with what each column leaves unexplained, or with all of it;
    no column where none is answered soundly.
    """
    weights = dict.fromkeys(["", *columns], 0.0)
    for run in runs:
        motion = with_yaw_rate(motion_of(run))
        if not motion.has("r"):
            continue
        answers = {c: _answer_to(run, motion, c) for c in columns}
        sound = {c: answer for c, answer in answers.items() if answer.sound}
        if sound:
            # One number of independent samples for all, or the smoothest would count most.
            freedom = max(sound.values(), key=lambda answer: answer.explained).freedom
            for column, answer in sound.items():
                weights[column] -= 0.5 * freedom * math.log(max(1 - answer.explained, 1e-6))
    best = max(weights, key=lambda column: weights[column])
    total = sum(math.exp(weight - weights[best]) for weight in weights.values())
    return best, _ANSWERED / total


def _reversed_in_zigzags(runs: list[Trajectory], columns: list[str]) -> str:
    """The column whose reversals are most surely those of a zig-zag's rudder, if any.

    It must stand between them: roll and sway follow a zig-zag, too, but never stand.
    """
    strength = {}
    for column in columns:
        if all(_stands(run, column) for run in runs):
            pushes = [_push_of(run, "rudder", run.commanded[column]) for run in runs]
            strength[column] = math.hypot(*(push * sure for push, sure in pushes))
    best = max(strength, key=lambda column: strength[column], default="")
    return best if best and strength[best] > 0 else ""


def _stands(run: Trajectory, column: str) -> bool:
    """Whether a column mostly stands still for a moment, as what is ordered or set does."""
    values = np.asarray(run.commanded[column], dtype=float)
    values = values[np.isfinite(values)]
    moment = max(1, round(_MOMENT * values.size))
    if values.size <= moment or not np.ptp(values) > 0:
        return False
    moved = np.abs(values[moment:] - values[:-moment])
    return float(np.mean(moved < _STILL * np.ptp(values))) > 0.5


def _answer_to(run: Trajectory, motion: MeasuredMotion, column: str) -> LaggedResponse:
    """Response of yaw rate to a column."""
    series = on_motion_clock(run, motion, run.commanded[column])
    return response_to(motion, "r", series[None])


def _order_and_answer(
    role: str, columns: list[str], suggestions: dict[str, Suggestion], runs: list[Trajectory]
) -> list[str]:
    """At most one order and one realised value of a role; forces before pulse widths."""

    def rank(column: str) -> tuple[bool, bool, float]:
        words = set(suggestions[column].words)
        force = "force" in words or suggestions[column].unit in ("N", "kN")
        return force, "pwm" not in words, suggestions[column].weights[role]

    kept: dict[bool, str] = {}
    for column in sorted(columns, key=rank, reverse=True):
        kept.setdefault(_is_order(column, suggestions[column], runs)[0], column)
    # Of different dimensions they are not order and answer of one actuator.
    best = max(map(rank, kept.values()), default=None)
    return [column for column in kept.values() if best and rank(column)[:2] == best[:2]]


def _actuator(
    column: str,
    role: str,
    chance: float,
    suggestion: Suggestion,
    runs: list[Trajectory],
    verdicts: list[tuple[int, float]],
    beside_order: bool = False,
) -> ActuatorColumn:
    """The column in a role that it has with some chance, with its unit and its push."""
    ordered, reason, sure = _is_order(column, suggestion, runs, beside_order)
    values = np.concatenate([_finite(run, column) for run in runs])
    push, is_share = _vote(verdicts), _is_share(suggestion, values)
    if pulses.are_pulses(values):
        if role == "rudder":
            return _rudder_by_pulses(column, values, sure * chance, push)
        is_share = True
    # A pulse width is no time, and a share has no unit in a mapping: both are taken as they stand.
    plain = suggestion.unit in UNITS and UNITS[suggestion.unit][0] in ("time", "ratio")
    unit = suggestion.unit if suggestion.unit in UNITS and not plain else ""
    if not unit and not plain:
        largest = float(np.max(np.abs(values)))
        if role == "rudder":
            unit = "deg" if largest > _LARGEST_RADIANS else "rad"
        elif role == "propeller" and suggestion.unit != "?" and _ROTATING & set(suggestion.words):
            unit = "rpm" if largest > _FASTEST else "rev/s"
        elif role == "propeller" and not is_share and _ENGINE & set(suggestion.words):
            unit = "rpm" if largest > _MOST_SHARE else ""
    if unit in ("rpm", "rev/s") and _ENGINE & set(suggestion.words):
        reason += "; revolutions of an engine: behind a gear the shaft's need scale = 1 / reduction"
    role = "motor" if role == "propeller" and is_share else role
    return ActuatorColumn(column, role, sure * chance, unit, ordered, reason, push)


def _is_share(suggestion: Suggestion, values: Float[np.ndarray, "_"]) -> bool:
    """Whether a column holds shares of full power: a throttle, or no more than one of something."""
    if suggestion.unit == "%" or "throttle" in suggestion.words:
        return True
    revolves = bool(_ROTATING & set(suggestion.words))
    within_one = float(np.max(np.abs(values), initial=0.0)) <= 1.0
    return not revolves and suggestion.unit in ("", "1") and within_one


def _rudder_by_pulses(
    column: str, values: Float[np.ndarray, "_"], sure: float, push: int
) -> ActuatorColumn:
    """A rudder's servo by its pulse widths, as rad if its linkage is as usual."""
    neutral, slope = pulses.neutral_pulse(values), pulses.SERVO_ANGLE / pulses.SPAN
    reason = (
        f"pulse widths of a servo, taken for {np.degrees(pulses.SERVO_ANGLE):.0f} deg at "
        f"{pulses.SPAN:.0f} us from {neutral:.0f} us: a guess, look at the rudder"
    )
    return ActuatorColumn(
        *(column, "rudder", sure, "", True, reason, push), scale=slope, offset=-slope * neutral
    )


def _is_order(
    column: str, suggestion: Suggestion, runs: list[Trajectory], beside_order: bool = False
) -> tuple[bool, str, float]:
    """Whether the column holds orders, why, and how probable that is.

    `beside_order` says that another of the same actuator is an order by its name.
    """
    angle = suggestion.weights["rudder"] > NAMED
    if any(pulses.are_pulses(_finite(run, column)) for run in runs):
        return True, "pulse widths are orders", _SAID
    name = "rudder" if angle else "thrust"
    for run in runs:
        series = np.asarray(run.commanded[column], dtype=float)
        if angle and np.nanmax(np.abs(series)) > _LARGEST_RADIANS:
            series = np.radians(series)
        tested = dataclasses.replace(run, commanded={}, executed={name: series})
        for finding in order_findings(tested):
            size = f"{np.degrees(finding.value):.3g} deg" if angle else f"{finding.value:.3g}"
            return True, f"it jumps by up to {size} within one sample, as only orders do", _JUMPS
    if suggestion.ordered is not None:
        return suggestion.ordered, "so its name says", _SAID
    if beside_order:
        return False, "what was realised: the order is another column, by its name", _SAID
    if all(np.nanmax(run.commanded[column]) == np.nanmin(run.commanded[column]) for run in runs):
        return True, "it never changes, as orders may", _CONSTANT
    if not angle and _is_thrust(suggestion):
        return True, "no sensor reads a thrust or a share of it: it is what was asked for", _GRADUAL
    return False, "it moves gradually, as what was realised does", _GRADUAL


def _finite(run: Trajectory, column: str) -> Float[np.ndarray, "_"]:
    values = np.asarray(run.commanded[column], float)
    return values[np.isfinite(values)]


def _has_lost_pulses(run: Trajectory, column: str) -> bool:
    values = _finite(run, column)
    return pulses.are_pulses(values) and bool(np.any(values == 0))


def _is_thrust(suggestion: Suggestion) -> bool:
    """Whether a name is that of a thruster's push, and not of a shaft that a sensor may count."""
    pushes = any(suggestion.weights[role] > NAMED for role in ("port", "starboard", "thrust"))
    turns = suggestion.unit in UNITS and UNITS[suggestion.unit][0] == "revolutions"
    return pushes and not turns and not _ROTATING & set(suggestion.words)


def _push_of(run: Trajectory, role: str, series: Series) -> tuple[int, float]:
    """Which way an actuator pushes, and how many standard errors that is sure."""
    values = np.asarray(series, dtype=float)
    size = float(np.nanmax(values) - np.nanmin(values))
    if not size > 0:
        return 0, 0.0
    for sign in (1, -1):
        # The audit tells only what is wrong: both signs are shown to it.
        found = _audit_responses(run, {role: sign * values / size})
        if found:
            return -sign, abs(found[0].value) / max(found[0].std, 1e-12)
    return 0, 0.0


def _audit_responses(run: Trajectory, commanded: dict[str, Series]) -> list[Finding]:
    ordered = dataclasses.replace(run, commanded=commanded, executed={})
    return response_findings(ordered, motion_of(run))


def _vote(verdicts: list[tuple[int, float]]) -> int:
    """The sign of the verdicts, each counting as it is certain."""
    return int(np.sign(sum(push * certainty for push, certainty in verdicts)))


def _with_sides(found: list[ActuatorColumn], runs: list[Trajectory]) -> list[ActuatorColumn]:
    """Thrusters on either side, with which way their difference turns the vessel."""
    port = [a for a in found if a.role == "port"]
    starboard = [a for a in found if a.role == "starboard"]
    if not port or not starboard:
        return found
    verdicts = []
    for run in runs:
        left, right = run.commanded[port[0].column], run.commanded[starboard[0].column]
        for push, pair in ((-1, (left, right)), (1, (right, left))):
            findings = _audit_responses(run, dict(zip(("port", "starboard"), pair, strict=True)))
            swapped = [f for f in findings if f.kind == "swapped-actuators"]
            verdicts += [(push, abs(f.value) / max(f.std, 1e-12)) for f in swapped]
    push = _vote(verdicts)
    return [dataclasses.replace(a, push=push) if a in (*port, *starboard) else a for a in found]
