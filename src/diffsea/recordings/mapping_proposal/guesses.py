"""Guesses of channels: one per channel, with how it is read, how sure that is, and why."""

import dataclasses
import math

import numpy as np

from diffsea.recordings.mapping_proposal.columns import (
    ColumnWindows,
    TimeColumn,
    relate_to_integral,
)
from diffsea.recordings.mapping_proposal.hypotheses import (
    ColumnHypothesis,
    HypothesisPrior,
    ratio_penalty,
    unit_probabilities,
)
from diffsea.recordings.mapping_proposal.search import ScoredHypothesis
from diffsea.recordings.mappings import Column
from diffsea.recordings.vocabulary import UNITS
from diffsea.trajectory import Samples


_ODD_SCALE = 4.0  # log odds against a ratio that is that of no units
_SUREST = 0.999  # nothing is surer than the model of sensors that it rests on
_NAMED = 0.5  # weight of a label above which a name is believed
_STATED_UNIT = 0.97  # probability that a stated unit is right


@dataclasses.dataclass(frozen=True)
class ChannelGuess:
    """One proposed channel: how it is read, how probable that is (0 to 1), and why."""

    channel: str
    column: Column
    sure: float
    why: str


@dataclasses.dataclass(frozen=True)
class UnitCombination:
    """Units of time, yaw rate, position and velocity; empty where there is no such column."""

    tick: str
    r: str
    x: str
    u: str


class SettledUnits:
    """Units of the best hypothesis: those whose ratios are the measured ones.

    `units` are the likeliest, `sure` has their probabilities by channel, and `step` is the
    sampling interval (s) of a file without time, NaN where nothing tells it.
    """

    def __init__(self, prior: HypothesisPrior, clock: TimeColumn, best: ScoredHypothesis):
        columns = best.hypothesis.columns
        options = {
            channel: unit_probabilities(prior, channel, columns[channel])
            if columns[channel]
            else {"": 1.0}
            for channel in ("r", "x", "u")
        }
        table: dict[UnitCombination, float] = {}
        for tick, likely in clock.units.items():
            for r, rate in options["r"].items():
                for x, length in options["x"].items():
                    for u, speed in options["u"].items():
                        units = UnitCombination(tick, r, x, u)
                        odds = math.log(max(likely * rate * length * speed, 1e-12))
                        table[units] = odds - sum(_unit_penalties(best, clock, units))
        self.units = max(table, key=lambda units: table[units])
        top = table[self.units]
        total = sum(math.exp(odds - top) for odds in table.values())
        self.sure = {"psi": 1.0}
        for channel, field in (("t", "tick"), ("r", "r"), ("x", "x"), ("u", "u")):
            chosen = getattr(self.units, field)
            alike = [odds for units, odds in table.items() if getattr(units, field) == chosen]
            self.sure[channel] = sum(math.exp(odds - top) for odds in alike) / total
        yaw, speed = _unit_penalties(best, clock, self.units)
        # Against a scale that nobody has a name for.
        self.sure["r"] *= 1 / (1 + math.exp(yaw - _ODD_SCALE))
        for name in ("x", "u"):
            self.sure[name] *= 1 / (1 + math.exp(speed - _ODD_SCALE))
        self.sure |= {"y": self.sure["x"], "v": self.sure["u"]}
        self.step = clock.step
        if clock.column is None and not math.isfinite(clock.step):
            self.step = self._kinematic_step(best)

    def _kinematic_step(self, best: ScoredHypothesis) -> float:
        """The sampling interval (s) that makes the kinematics right, NaN where none tells."""
        steps, units = [], self.units
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


def motion_guesses(
    scored: list[ScoredHypothesis],
    settled: SettledUnits,
    clock: TimeColumn,
    place: tuple[str, str] | None,
) -> list[ChannelGuess]:
    """Time and motion as the best hypothesis has them, sure as all together make them.

    `place` names columns of latitude and longitude.
    """
    odds = np.array([item.log_odds for item in scored])
    weights = np.exp(odds - odds.max())
    chances, best = weights / weights.sum(), scored[0]
    found = []
    if clock.column is not None:
        sure = min(clock.sure * settled.sure["t"], _SUREST)
        tick = settled.units.tick
        unit = None if tick == "s" else tick
        found.append(ChannelGuess("t", Column(clock.column, unit), sure, clock.why))
    for name, column in motion_columns(best.hypothesis, settled, place).items():
        channel = {"latitude": "x", "longitude": "y"}.get(name, name)
        said = _said_of(best.hypothesis, channel)
        pairs = zip(chances, scored, strict=True)
        agree = [p for p, item in pairs if _said_of(item.hypothesis, channel) == said]
        sure = min(float(np.sum(agree)) * settled.sure[channel], _SUREST)
        found.append(ChannelGuess(name, column, sure, _reason(best, channel)))
    return found


def _said_of(h: ColumnHypothesis, channel: str) -> tuple | None:
    """What a hypothesis says of a channel, for the sum over all that say the same."""
    if h.columns[channel] is None:
        return None
    return {
        "x": (h.x, h.signs[0]),
        "y": (h.y, h.signs[1]),
        "psi": (h.psi, h.period, h.turn, h.quarter),
        "u": (h.u, h.speeds[0], h.earth),
        "v": (h.v, h.speeds[1], h.earth),
        "r": (h.r, h.spin),
    }[channel]


def motion_columns(
    h: ColumnHypothesis, settled: SettledUnits, place: tuple[str, str] | None
) -> dict[str, Column]:
    """The channels of a mapping that reads motion as the hypothesis does."""
    units, found = settled.units, {}
    for axis, name in enumerate((h.x, h.y)):
        if name is not None:
            found["xy"[axis]] = Column(name, _unless_si(units.x), h.signs[axis])
    if h.psi is not None:
        degrees = h.period == 360.0
        # A quarter turn is added after the sign: sign * (number + offset).
        quarter = h.quarter if h.quarter < 3 else -1
        offset = h.turn * quarter * (90.0 if degrees else 0.5 * math.pi)
        unit = "deg" if degrees else "rad" if quarter else None
        found["psi"] = Column(h.psi, unit, h.turn, offset=offset)
    for axis, name in enumerate((h.u, h.v)):
        if name is not None:
            found["uv"[axis]] = Column(name, _unless_si(units.u), h.speeds[axis])
    if h.r is not None:
        found["r"] = Column(h.r, _unless_si(units.r), h.spin)
    if place is None or (h.x, h.y) != place:
        return found
    fixes = {"latitude": Column(place[0], "deg"), "longitude": Column(place[1], "deg")}
    return fixes | {name: c for name, c in found.items() if name not in ("x", "y")}


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


def wind_and_roll_guesses(
    prior: HypothesisPrior, table: dict[str, Samples], windows: ColumnWindows, used: set[str]
) -> list[ChannelGuess]:
    """Wind and roll, which nothing but their names and ranges tells."""
    found: dict[str, ChannelGuess] = {}
    for channel in ("wind_speed", "wind_direction", "phi", "p"):
        weights = {n: prior.suggestions[n].weights[channel] for n in table if n not in used}
        named = [(weight, name) for name, weight in weights.items() if weight > _NAMED]
        if not named:
            continue
        weight, name = max(named)
        stated = prior.suggestions[name].unit
        if stated in UNITS:
            unit, sure = _unless_si(stated), _STATED_UNIT
        elif channel == "p":
            unit, sure = _roll_rate_unit(found.get("phi"), name, windows)
        else:
            unit, sure = _unit_by_range(channel, float(np.nanmax(np.abs(table[name]))))
        found[channel] = ChannelGuess(channel, Column(name, unit), weight * sure, "by its name")
    return list(found.values())


def _unit_by_range(channel: str, largest: float) -> tuple[str | None, float]:
    if channel in ("phi", "wind_direction"):
        limit = 1.0 if channel == "phi" else 2 * math.pi + 0.05
        return ("deg", 0.9) if largest > limit else (None, 0.6)
    return None, 0.7


def _roll_rate_unit(
    roll: ChannelGuess | None, name: str, windows: ColumnWindows
) -> tuple[str | None, float]:
    """The unit of roll rate, from its ratio to the change of roll."""
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
