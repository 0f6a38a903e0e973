"""The evidence on files that nobody has mapped, weighed into one guess per channel.

A guess says how a channel is read, how sure that is, and why. How sure is the sum of the
posterior probabilities of all hypotheses that say the same of the channel.
"""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.mapping_proposal.actuators import ActuatorColumn, find_actuators
from diffsea.recordings.mapping_proposal.columns import (
    NO_CLOCK,
    ColumnRecord,
    ColumnWindows,
    TimeColumn,
    columns_over_time,
    find_geographic,
    find_time_column,
    relate_to_integral,
    varies,
    windows_of,
)
from diffsea.recordings.mapping_proposal.combined import (
    Course,
    are_on_a_circle,
    courses_of_speeds,
    with_headings,
    with_velocities,
)
from diffsea.recordings.mapping_proposal.guesses import ChannelGuess
from diffsea.recordings.mapping_proposal.hypotheses import (
    STATED_UNIT,
    ColumnHypothesis,
    FrameConvention,
    HypothesisPrior,
    ratio_penalty,
)
from diffsea.recordings.mapping_proposal.names import (
    NAMED,
    Suggestion,
    headings_as_sines,
    named_exactly,
    suggest_labels,
    suggest_sine,
)
from diffsea.recordings.mapping_proposal.search import ScoredHypothesis, search_hypotheses
from diffsea.recordings.mapping_proposal.table_layout import (
    TableLayout,
    numeric_columns,
    sniff_layout,
)
from diffsea.recordings.mappings import UNITS, Column, Mapping
from diffsea.recordings.readers import read_recording
from diffsea.recordings.wind import APPARENT, TRUE
from diffsea.trajectory import Samples, Trajectory


_MOST_FILES = 24  # that the evidence is taken from: more would cost time and add little
_FEWEST_ROWS = 20  # fewer tell nothing of how columns are related
_SURE_RUDDER = 0.55  # how sure a rudder must be to have a say in what is starboard
_TELLING = 0.5  # weight of "other" above which a name says that it is something else
# Log odds for a rudder, and for a pair of thrusters, that act the way their labels say.
_RUDDER_LABEL, _THRUSTER_LABELS = math.log(0.75 / 0.25), math.log(0.95 / 0.05)
_ODD_SCALE = 4.0  # log odds against a ratio that is that of no units
_SUREST = 0.999  # nothing is surer than the model of sensors that it rests on
_VELOCITY_OVER_GROUND = 0.8  # weight of a speed with its course: there may be a better one
_SUREST_OVER_GROUND = 0.5  # of course and speed over ground, for want of anything better
_OVER_GROUND = (
    "nothing better is there: course and speed over ground are not {channel} where the vessel "
    "drifts, turns or meets a current"
)
_LARGEST_RADIANS = {"phi": 1.0}  # beyond, it is degrees
_LARGEST_RADIANS |= dict.fromkeys(("wind_direction", "apparent_wind_angle"), 2 * math.pi + 0.05)


@dataclasses.dataclass(frozen=True)
class ProposalEvidence:
    """What a proposal rests on, for the text that is written of it.

    Attributes:
        clock: time in its likeliest unit, or with the step that kinematics tell.
        motion: the likeliest reading of the motion.
        convention: the frame that this reading is of.
        mirror: probability that the whole record is mirrored.
        guesses: of time, motion, wind and roll.
        origin: latitude and longitude (deg) that x and y count from, where they are geographic.
        constant: the columns that never change.
    """

    layout: TableLayout
    clock: TimeColumn
    suggestions: dict[str, Suggestion]
    motion: ColumnHypothesis
    convention: FrameConvention
    mirror: float
    guesses: tuple[ChannelGuess, ...]
    actuators: tuple[ActuatorColumn, ...]
    origin: tuple[float, float] | None
    constant: frozenset[str]


@dataclasses.dataclass(frozen=True)
class _Source:
    """Files of one layout, as they are before anything is decided."""

    paths: tuple[Path, ...]  # the longest first
    layout: TableLayout
    table: dict[str, Samples]  # of the longest file
    constant: frozenset[str]  # columns that never change, in any of the files
    clock: TimeColumn
    place: tuple[str, str] | None  # columns of latitude and longitude
    origin: tuple[float, float] | None  # the first fix of the longest file (deg)
    cosines: dict[str, str]  # of headings that are there as a sine and a cosine, by the sine
    courses: dict[str, Course]  # over ground, by the speeds that they are of
    windows: ColumnWindows
    prior: HypothesisPrior


def gather_evidence(paths: Sequence[Path]) -> ProposalEvidence:
    """What can be said of files of one layout.

    Raises:
        UserError: files are no tables of numbers, differ in columns, or are too short.
    """
    source = _read_source(paths)
    scored = search_hypotheses(source.windows, source.prior, source.clock, source.place)
    first = scored[0]
    actuators = _find_actuators(source, first)
    scored = _with_actuator_evidence(scored, actuators)
    best = scored[0]
    if best.hypothesis.starboard_sign != first.hypothesis.starboard_sign:
        actuators = [dataclasses.replace(a, push=-a.push) if a.turns else a for a in actuators]
    settled = settle_units(source.prior, source.clock, best)
    guesses = _motion_guesses(scored, settled, source)
    used = {guess.column.column for guess in guesses} | {a.column for a in actuators}
    guesses += _wind_and_roll_guesses(source, used)
    image = best.hypothesis.mirror_image
    mirrored = next((item for item in scored if item.hypothesis == image), None)
    return ProposalEvidence(
        layout=source.layout,
        clock=dataclasses.replace(source.clock, units={settled.units.tick: 1.0}, step=settled.step),
        suggestions=source.prior.suggestions,
        motion=best.hypothesis,
        convention=source.prior.convention(best.hypothesis),
        mirror=0.0 if mirrored is None else 1 / (1 + math.exp(best.log_odds - mirrored.log_odds)),
        guesses=tuple(guesses),
        actuators=tuple(actuators),
        origin=source.origin if any(guess.channel == "latitude" for guess in guesses) else None,
        constant=source.constant,
    )


def _read_source(paths: Sequence[Path]) -> _Source:
    layout = sniff_layout(paths[0])
    for path in paths[1:]:
        if sniff_layout(path).names != layout.names:
            raise UserError(
                f"{path} has other columns than {paths[0]}: a mapping fits files of one layout; "
                "audit each layout by itself"
            )
    kept, tables = _longest_tables(paths, layout)
    suggestions = {
        name: suggest_labels(name if layout.named else "", unit)
        for name, unit in zip(layout.names, layout.units, strict=True)
        if name
    }
    suggestions |= {n: suggest_labels(n, "rad") for n in tables[0] if n not in suggestions}
    cosines = {
        sine: cosine
        for sine, cosine in headings_as_sines(layout.names).items()
        if are_on_a_circle(tables[0].get(sine), tables[0].get(cosine))
    }
    suggestions |= {name: told for name in cosines if (told := suggest_sine(name)) is not None}
    tables = [with_headings(table, cosines) for table in tables]
    courses = courses_of_speeds(suggestions, tables[0])
    tables = [with_velocities(table, courses) for table in tables]
    for speed, course in courses.items():
        unit = suggestions[speed].unit
        suggestions[speed] = named_exactly("vn", _VELOCITY_OVER_GROUND, unit)
        suggestions[course.column] = named_exactly("ve", _VELOCITY_OVER_GROUND, unit)
    clock = find_time_column(tables[0], suggestions) or NO_CLOCK
    place, origin = find_geographic(tables[0], suggestions), None
    if place is not None:
        fixes = [tables[0][name][np.isfinite(tables[0][name])][0] for name in place]
        origin = round(float(fixes[0]), 6), round(float(fixes[1]), 6)
    varying = frozenset(
        name for table in tables for name, values in table.items() if varies(values)
    )
    records = [columns_over_time(table, clock, varying, place, origin) for table in tables]
    # Files that lack a column of the longest one, or are short, say nothing.
    shared = set(records[0].columns)
    told = [r.t.size >= _FEWEST_ROWS and shared <= set(r.columns) for r in records]
    if not shared or not told[0]:
        raise UserError(
            f"{kept[0]} has too few rows or no column that changes, so nothing can be guessed; "
            "write a mapping that says which columns are which"
        )
    kept = [path for path, tells in zip(kept, told, strict=True) if tells]
    records = tuple(
        ColumnRecord(r.t, {n: v for n, v in r.columns.items() if n in shared})
        for r, tells in zip(records, told, strict=True)
        if tells
    )
    wrapped = set()  # columns that run from 0 to 360 and wrap, as a compass does
    for name, values in itertools.chain(*(record.columns.items() for record in records)):
        in_range = np.min(values) >= 0 and 300 < np.max(values) <= 360.5
        if in_range and np.any(np.abs(np.diff(values)) > 300):
            wrapped.add(name)
    prior = HypothesisPrior(suggestions, frozenset(wrapped), frozenset(records[0].columns))
    windows = windows_of(records)
    fixed = frozenset(tables[0]) - varying
    return _Source(
        *(tuple(kept), layout, tables[0], fixed, clock, place, origin, cosines, courses),
        *(windows, prior),
    )


def _longest_tables(
    paths: Sequence[Path], layout: TableLayout
) -> tuple[list[Path], list[dict[str, Samples]]]:
    """The files with most rows and their columns, longest first; those that are broken left out.

    Raises:
        UserError: none can be read.
    """
    read: list[tuple[Path, dict[str, Samples]]] = []
    refused: list[UserError] = []
    for path in paths:
        try:
            read.append((path, numeric_columns(path, layout)))
        except UserError as error:
            refused.append(error)
    if not read:
        raise refused[0]
    read.sort(key=lambda item: -max((v.size for v in item[1].values()), default=0))
    return [path for path, _ in read[:_MOST_FILES]], [table for _, table in read[:_MOST_FILES]]


def _find_actuators(source: _Source, best: ScoredHypothesis) -> list[ActuatorColumn]:
    """Actuators among the columns that the best hypothesis leaves free.

    The longest files are read through the hypothesis, every free column as an order.
    """
    clock, suggestions = source.clock, source.prior.suggestions
    used = {*best.hypothesis.columns.values(), clock.column}
    free = [name for name in source.table if name not in used]
    settled = settle_units(source.prior, clock, best)
    channels = _motion_columns(best.hypothesis, settled.units, source)
    if not channels:
        return []
    if clock.column is not None:
        channels["t"] = Column(clock.column, settled.units.tick)
    mapping = dataclasses.replace(
        source.layout.mapping,
        channels=channels | {f"cmd_{name}": Column(name) for name in free},
        time_step=None if clock.column else settled.step if math.isfinite(settled.step) else 1.0,
        velocity_axes="earth" if best.hypothesis.earth and best.hypothesis.psi else "body",
    )
    runs = _readable_runs(source.paths, mapping)
    if not runs:
        return []
    kept = [name for name in free if all(name in run.commanded for run in runs)]
    runs = [
        dataclasses.replace(run, commanded={name: run.commanded[name] for name in kept})
        for run in runs
    ]
    others = [name for name in kept if suggestions[name].best == "other"]
    unnamed = [name for name in others if suggestions[name].weights["other"] < _TELLING]
    return find_actuators(runs, suggestions, unnamed)


def _readable_runs(paths: Sequence[Path], mapping: Mapping) -> list[Trajectory]:
    """The runs that can be read: what is wrong with another, its own audit will say."""
    runs: list[Trajectory] = []
    for path in paths:
        with contextlib.suppress(UserError):
            runs.append(read_recording(path, mapping))
    return runs


def _with_actuator_evidence(
    scored: list[ScoredHypothesis], actuators: list[ActuatorColumn]
) -> list[ScoredHypothesis]:
    """Log odds after the actuators: of two mirrored records, labels that are right count.

    A column without a telling name has no label that could be right.
    """
    labelled = [a for a in actuators if a.is_named]
    rudders = [a for a in labelled if a.role == "rudder" and a.sure > _SURE_RUDDER]
    gain = sum(_RUDDER_LABEL * a.push for a in rudders)
    gain += sum(_THRUSTER_LABELS * a.push for a in actuators if a.role == "port")
    if gain == 0:
        return scored
    best, heard = scored[0].hypothesis, []
    for item in scored:
        h = item.hypothesis
        same = (h.r, h.psi) == (best.r, best.psi)  # of other columns nothing was asked
        agrees = 1 if h.starboard_sign == best.starboard_sign else -1
        odds = item.log_odds + same * agrees * 0.5 * gain
        heard.append(dataclasses.replace(item, log_odds=odds))
    return sorted(heard, key=lambda item: -item.log_odds)


class UnitCombination(NamedTuple):
    """Units of time, yaw rate, position and velocity; empty where there is no such column."""

    tick: str
    r: str
    x: str
    u: str


class SettledUnits(NamedTuple):
    """Units of the best hypothesis: those whose ratios are the measured ones.

    Attributes:
        units: the likeliest.
        sure: their probabilities, by channel.
        step: the sampling interval (s) of a file without time, NaN where nothing tells it.
    """

    units: UnitCombination
    sure: dict[str, float]
    step: float


def settle_units(prior: HypothesisPrior, clock: TimeColumn, best: ScoredHypothesis) -> SettledUnits:
    """Units by their prior probabilities and the measured ratios between columns."""
    columns = best.hypothesis.columns
    options = [clock.units, *(prior.unit_probabilities(c, columns[c]) for c in ("r", "x", "u"))]
    table: dict[UnitCombination, float] = {}
    for names in itertools.product(*options):
        units = UnitCombination(*names)
        chance = math.prod(odds[unit] for odds, unit in zip(options, units, strict=True))
        table[units] = math.log(max(chance, 1e-12)) - sum(_unit_penalties(best, clock, units))
    likeliest = max(table, key=lambda units: table[units])
    top = table[likeliest]
    total = sum(math.exp(odds - top) for odds in table.values())
    sure = {"psi": 1.0}
    for place, channel in enumerate(("t", "r", "x", "u")):
        alike = [odds for units, odds in table.items() if units[place] == likeliest[place]]
        sure[channel] = sum(math.exp(odds - top) for odds in alike) / total
    yaw, speed = _unit_penalties(best, clock, likeliest)
    # Against a scale that nobody has a name for.
    sure["r"] *= 1 / (1 + math.exp(yaw - _ODD_SCALE))
    for channel in ("x", "u"):
        sure[channel] *= 1 / (1 + math.exp(speed - _ODD_SCALE))
    sure |= {"y": sure["x"], "v": sure["u"]}
    step = clock.step
    if clock.column is None and not math.isfinite(step):
        step = _kinematic_step(best, likeliest)
    return SettledUnits(likeliest, sure, step)


def _kinematic_step(best: ScoredHypothesis, units: UnitCombination) -> float:
    """The sampling interval (s) that makes the kinematics right, NaN where none tells."""
    steps = []
    if best.yaw is not None and best.hypothesis.r is not None and best.yaw.evidence > 5:
        turn = 2 * math.pi / best.hypothesis.period
        steps.append(abs(best.yaw.gain) * turn / UNITS[units.r][1])
    if math.isfinite(best.scale) and best.scale > 0 and min(best.left) < 0.2 and units.u:
        steps.append(best.scale * UNITS[units.x][1] / UNITS[units.u][1])
    if not steps or max(steps) > 1.2 * min(steps):
        return math.nan
    return float(f"{sum(steps) / len(steps):.2g}")


def _unit_penalties(
    best: ScoredHypothesis, clock: TimeColumn, units: UnitCombination
) -> tuple[float, float]:
    """Log odds against these units, given the measured ratios of yaw and of displacement."""
    yaw = speed = 0.0
    if clock.column is None:
        return yaw, speed
    second = UNITS[units.tick][1]
    if units.r and best.yaw is not None and best.hypothesis.psi and best.yaw.evidence > 0:
        expected = UNITS[units.r][1] * second * best.hypothesis.period / (2 * math.pi)
        yaw = min(ratio_penalty(abs(best.yaw.gain), expected, best.yaw.error), best.yaw.evidence)
    if units.u and units.x and min(best.left) < 1:
        expected = UNITS[units.u][1] * second / UNITS[units.x][1]
        speed = ratio_penalty(best.scale, expected, best.error)
    return yaw, speed


def _motion_guesses(
    scored: list[ScoredHypothesis], settled: SettledUnits, source: _Source
) -> list[ChannelGuess]:
    """Time and motion as the best hypothesis has them, sure as all together make them."""
    odds = np.array([item.log_odds for item in scored])
    weights = np.exp(odds - odds.max())
    chances, best, clock = weights / weights.sum(), scored[0], source.clock
    found = []
    if clock.column is not None:
        sure = min(clock.sure * settled.sure["t"], _SUREST)
        column = Column(clock.column, _unless_si(settled.units.tick))
        found.append(ChannelGuess("t", column, sure, clock.why))
    columns = _motion_columns(best.hypothesis, settled.units, source)
    for name, column in columns.items():
        channel = {"latitude": "x", "longitude": "y"}.get(name, name)
        said = _said_of(best.hypothesis, channel)
        pairs = zip(chances, scored, strict=True)
        agree = [p for p, item in pairs if _said_of(item.hypothesis, channel) == said]
        sure = min(float(np.sum(agree)) * settled.sure[channel], _SUREST)
        why = _reason(best, channel)
        if source.prior.suggestions[column.column].is_over_ground:
            sure, why = min(sure, _SUREST_OVER_GROUND), _OVER_GROUND.format(channel=channel)
        found.append(ChannelGuess(name, column, sure, why))
    return found


def _said_of(h: ColumnHypothesis, channel: str) -> tuple:
    """What a hypothesis says of a channel, for the sum over all that say the same."""
    return {
        "x": (h.x, h.signs[0]),
        "y": (h.y, h.signs[1]),
        "psi": (h.psi, h.period, h.turn, h.quarter),
        "u": (h.u, h.speeds[0], h.earth),
        "v": (h.v, h.speeds[1], h.earth),
        "r": (h.r, h.spin),
    }[channel]


def _motion_columns(
    h: ColumnHypothesis, units: UnitCombination, source: _Source
) -> dict[str, Column]:
    """The channels of a mapping that reads motion as the hypothesis does."""
    found, place = {}, source.place
    if place is not None and (h.x, h.y) == place:
        found = {"latitude": Column(place[0], "deg"), "longitude": Column(place[1], "deg")}
    else:
        for axis, name in enumerate((h.x, h.y)):
            if name is not None:
                found["xy"[axis]] = Column(name, _unless_si(units.x), h.signs[axis])
    if h.psi is not None:
        degrees = h.period == 360.0
        # A quarter turn is added after the sign: sign * (number + offset).
        quarter = h.quarter if h.quarter < 3 else -1
        offset = h.turn * quarter * (90.0 if degrees else 0.5 * math.pi)
        unit = "deg" if degrees else "rad" if quarter else None
        cosine = source.cosines.get(h.psi)
        found["psi"] = Column(h.psi, unit, h.turn, offset=offset, cosine=cosine)
    for axis, name in enumerate((h.u, h.v)):
        if name is not None:
            column = Column(name, _unless_si(units.u), h.speeds[axis])
            for speed, (course, unit) in source.courses.items():
                if name in (speed, course):
                    beside = {"column": speed, "course": course, "course_unit": unit}
                    column = dataclasses.replace(column, **beside)
            found["uv"[axis]] = column
    if h.r is not None:
        found["r"] = Column(h.r, _unless_si(units.r), h.spin)
    return found


def _unless_si(unit: str) -> str | None:
    """None for a unit of SI, which needs no mention."""
    return None if not unit or UNITS[unit][1] == 1.0 else unit


def _reason(best: ScoredHypothesis, channel: str) -> str:
    h = best.hypothesis
    if channel in ("psi", "r") and h.psi and h.r and best.yaw and best.yaw.evidence > 3:
        other = h.r if channel == "psi" else h.psi
        return f"heading is the integral of yaw rate: agrees with {other!r}"
    if channel != "r" and min(best.left) < 0.5:
        left = [max(100 * share, 0.01) for share in best.left]
        return (
            f"positions and velocities agree but for {left[0]:.2g} and {left[1]:.2g} % of "
            "squared displacement"
        )
    return "by its name"


def _wind_and_roll_guesses(source: _Source, used: set[str]) -> list[ChannelGuess]:
    """Wind and roll, which nothing but their names and ranges tells."""
    found: dict[str, ChannelGuess] = {}
    for channel in (*TRUE, *APPARENT, "phi", "p"):
        free = [name for name in source.table if name not in used]
        weights = {name: source.prior.suggestions[name].weights[channel] for name in free}
        named = [(weight, name) for name, weight in weights.items() if weight > NAMED]
        if not named:
            continue
        weight, name = max(named)
        unit, sure = None, 0.7
        stated = source.prior.suggestions[name].unit
        if stated in UNITS:
            unit, sure = _unless_si(stated), STATED_UNIT
        elif channel == "p":
            unit, sure = _roll_rate_unit(found.get("phi"), name, source.windows)
        elif channel in _LARGEST_RADIANS:
            degrees = float(np.nanmax(np.abs(source.table[name]))) > _LARGEST_RADIANS[channel]
            unit, sure = ("deg", 0.9) if degrees else (None, 0.6)
        found[channel] = ChannelGuess(channel, Column(name, unit), weight * sure, "by its name")
    return list(found.values())


def _roll_rate_unit(
    roll: ChannelGuess | None, name: str, windows: ColumnWindows
) -> tuple[str | None, float]:
    """The unit of roll rate from its ratio to the change of roll, and how sure it is."""
    if roll is None or not {name, roll.column.column} <= set(windows.records[0].columns):
        return None, 0.5
    relation = relate_to_integral(
        windows.increments(roll.column.column), windows.integrals(name), windows.duration
    )
    if relation.evidence < 3:
        return None, 0.5
    ratio = abs(relation.gain)
    like_roll = ratio_penalty(ratio, 1.0, relation.error)
    degrees = like_roll < ratio_penalty(ratio, 57.3, relation.error)
    if roll.column.unit != "deg":
        degrees = not like_roll < 2.0
    return ("deg/s" if degrees else None), 0.9
