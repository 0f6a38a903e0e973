"""A mapping proposed for files that nobody has mapped: guessed, weighed, and written down."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings.mappings import UNITS, Column
from diffsea.recordings.proposal.actuators import Actuator, find_actuators
from diffsea.recordings.proposal.clock import (
    Clock,
    Record,
    find_clock,
    record_of,
    stamped_clock,
)
from diffsea.recordings.proposal.layout import Layout, columns_of, sniff
from diffsea.recordings.proposal.names import Suggestion, suggestion
from diffsea.recordings.proposal.ratios import ratio_cost, unit_odds
from diffsea.recordings.proposal.readings import Convention, Prior, Reading, mirrored
from diffsea.recordings.proposal.search import Weighed, search
from diffsea.recordings.proposal.windows import Windows, follows, windows_of
from diffsea.recordings.readers import read_recording


_FILES = 6  # that the evidence is taken from
_EQUATOR, _FLATTENING = 6378137.0, 1 / 298.257223563  # WGS 84: semi-major axis (m)
# Log odds for a rudder, and for a pair of thrusters, that act the way their labels say.
_RUDDER, _THRUSTERS = math.log(0.75 / 0.25), math.log(0.95 / 0.05)
_CERTAIN = 0.999  # nothing is surer than the model of sensors that it rests on


@dataclasses.dataclass(frozen=True)
class Guess:
    """One proposed channel: how it is read, how sure that is (0 to 1), and why."""

    channel: str
    column: Column
    sure: float
    why: str


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What a proposal rests on, for the text that is written of it."""

    layout: Layout
    clock: Clock
    suggestions: dict[str, Suggestion]
    best: Weighed
    convention: Convention
    mirror: float  # probability that the whole record is mirrored
    guesses: tuple[Guess, ...]
    actuators: tuple[Actuator, ...]
    place: tuple[str, str] | None
    constant: frozenset[str]


def propose_evidence(paths: Sequence[Path]) -> Evidence:
    """What can be said of files of one layout.

    Raises `UserError` for files that are no tables of numbers, or that differ in columns.
    """
    layout = sniff(paths[0])
    tables = [columns_of(path, layout) for path in _alike(paths, layout)]
    suggestions = {
        name: suggestion(name if layout.named else "", unit)
        for name, unit in zip(layout.names, layout.units, strict=True)
        if name
    }
    clock = find_clock(tables[0], suggestions) or stamped_clock(paths[0], layout)
    place = _geographic(tables[0], suggestions)
    records = tuple(_local(record_of(table, clock), tables[0], place) for table in tables)
    shared = set.intersection(*(set(record.columns) for record in records))
    records = tuple(
        Record(r.t, {n: v for n, v in r.columns.items() if n in shared}) for r in records
    )
    if not shared or min(record.t.size for record in records) < 20:
        raise UserError(
            f"{paths[0]} has too few rows or no column that changes, so nothing can be guessed; "
            "write a mapping that says which columns are which"
        )
    prior = Prior(suggestions, _compasses(records))
    windows = windows_of(records)
    weighed = search(windows, prior, clock, place)
    return _weighed(paths, layout, clock, windows, prior, weighed, tables, place)


def _alike(paths: Sequence[Path], layout: Layout) -> list[Path]:
    """The first files, checked against the layout of the first of all."""
    for path in paths[1:]:
        other = sniff(path)
        if other.names != layout.names:
            raise UserError(
                f"{path} has other columns than {paths[0]}: a mapping fits files of one layout; "
                "audit each layout by itself"
            )
    return list(paths[:_FILES])


def _compasses(records: tuple[Record, ...]) -> frozenset[str]:
    """Columns that run from 0 to 360 and wrap, as a compass does."""
    found = set()
    for record in records:
        for name, values in record.columns.items():
            low, high = float(np.min(values)), float(np.max(values))
            if low >= 0 and 300 < high <= 360.5 and np.any(np.abs(np.diff(values)) > 300):
                found.add(name)
    return frozenset(found)


def _geographic(
    table: dict[str, np.ndarray], suggestions: dict[str, Suggestion]
) -> tuple[str, str] | None:
    """Columns of latitude and longitude in degrees, if the file has them and they move."""
    found = []
    for label, limit in (("lat", 90.0), ("lon", 180.0)):
        named = [name for name in table if suggestions[name].weights[label] > 0.5]
        named = [n for n in named if 0 < np.nanmax(np.abs(table[n])) <= limit]
        named = [n for n in named if 0 < np.nanmax(table[n]) - np.nanmin(table[n]) < 2.0]
        if len(named) != 1:
            return None
        found += named
    return found[0], found[1]


def degrees_to_metres(latitude: float) -> tuple[float, float]:
    """Metres north and east per degree of latitude and longitude (deg), on WGS 84."""
    square = _FLATTENING * (2 - _FLATTENING)
    narrow = 1 - square * math.sin(math.radians(latitude)) ** 2
    north = _EQUATOR * (1 - square) / narrow**1.5
    east = _EQUATOR / math.sqrt(narrow) * math.cos(math.radians(latitude))
    return math.radians(north), math.radians(east)


def _origin(table: dict[str, np.ndarray], name: str) -> float:
    values = table[name]
    return float(values[np.isfinite(values)][0])


def _local(record: Record, table: dict[str, np.ndarray], place: tuple[str, str] | None) -> Record:
    """The record with geographic positions in metres from the first of all."""
    if place is None or not set(place) <= set(record.columns):
        return record
    factors = degrees_to_metres(_origin(table, place[0]))
    changed = {
        name: factor * (record.columns[name] - _origin(table, name))
        for name, factor in zip(place, factors, strict=True)
    }
    return Record(record.t, record.columns | changed)


def _weighed(paths, layout, clock, windows, prior, weighed, tables, place) -> Evidence:
    """The evidence with actuators heard, units settled and everything summed per channel."""
    best = weighed[0]
    used = {c for c in _columns(best.reading).values() if c}
    if clock.column is not None:
        used.add(clock.column)
    free = [name for name in tables[0] if name not in used]
    runs = _runs(paths, layout, clock, windows, prior, best, tables, place, free)
    unnamed = [n for n in free if prior.suggestions[n].best == "other"
               and prior.suggestions[n].weights["other"] < 0.5]  # fmt: skip
    actuators = find_actuators(runs, prior.suggestions, unnamed) if runs and free else []
    weighed = _answered(weighed, best, actuators, prior)
    if _hand(weighed[0].reading) != _hand(best.reading):
        actuators = [dataclasses.replace(a, push=-a.push) if a.turns else a for a in actuators]
    best = weighed[0]
    settled = _Units(prior, clock, windows, best)
    guesses = _motion_guesses(weighed, settled, clock, tables, place)
    used = {guess.column.column for guess in guesses} | {a.column for a in actuators}
    guesses += _others(prior, tables[0], windows, used)
    constant = frozenset(n for n, v in tables[0].items() if np.nanmax(v) == np.nanmin(v))
    return Evidence(
        layout, dataclasses.replace(clock, units={settled.tick: 1.0}, step=settled.step),
        prior.suggestions, best, prior.convention(best.reading), _mirror(weighed), tuple(guesses),
        tuple(actuators), place, constant,
    )  # fmt: skip


def _columns(reading: Reading) -> dict[str, str | None]:
    return {channel: getattr(reading, channel) for channel in ("x", "y", "psi", "u", "v", "r")}


def _hand(reading: Reading) -> int:
    """The sign that decides which way a turn to starboard goes."""
    return reading.spin if reading.r is not None else reading.turn


def _answered(
    weighed: list[Weighed], best: Weighed, actuators: list[Actuator], prior: Prior
) -> list[Weighed]:
    """Weights after the actuators: of two mirrored records, labels that are right count."""
    gain = sum(_RUDDER * a.push for a in actuators if a.role == "rudder" and a.sure > 0.5)
    gain += sum(_THRUSTERS * a.push for a in actuators if a.role == "port")
    if gain == 0:
        return weighed
    hand = _hand(best.reading)
    heard = []
    for item in weighed:
        # Of other columns nothing was asked.
        same = (item.reading.r, item.reading.psi) == (best.reading.r, best.reading.psi)
        agrees = 1 if _hand(item.reading) == hand else -1
        heard.append(dataclasses.replace(item, odds=item.odds + same * agrees * 0.5 * gain))
    return sorted(heard, key=lambda item: -item.odds)


def _probabilities(weighed: list[Weighed]) -> np.ndarray:
    odds = np.array([item.odds for item in weighed])
    weights = np.exp(odds - odds.max())
    return weights / weights.sum()


def _mirror(weighed: list[Weighed]) -> float:
    """Probability of the best reading's mirror image, against the two of them."""
    image = mirrored(weighed[0].reading)
    alike = [item for item in weighed if item.reading == image]
    if not alike:
        return 0.0
    return 1 / (1 + math.exp(weighed[0].odds - alike[0].odds))


def _key(reading: Reading, channel: str):
    """What a reading says of a channel, for the sum over all that say the same."""
    column = getattr(reading, channel)
    if column is None:
        return None
    return {
        "x": (column, reading.signs[0]),
        "y": (column, reading.signs[1]),
        "psi": (column, reading.period, reading.turn, reading.quarter),
        "u": (column, reading.speeds[0], reading.earth),
        "v": (column, reading.speeds[1], reading.earth),
        "r": (column, reading.spin),
    }[channel]


class _Units:
    """Units of the best reading: those whose ratios are the measured ones."""

    def __init__(self, prior: Prior, clock: Clock, windows: Windows, best: Weighed):
        reading = best.reading
        options = {
            channel: unit_odds(prior, channel, getattr(reading, channel))
            for channel in ("x", "u", "r")
            if getattr(reading, channel) is not None
        }
        table: dict[tuple, float] = {}
        for tick, likely in clock.units.items():
            for r, rate in options.get("r", {"": 1.0}).items():
                for x, length in options.get("x", {"": 1.0}).items():
                    for u, speed in options.get("u", {"": 1.0}).items():
                        odds = math.log(max(likely * rate * length * speed, 1e-12))
                        odds -= _cost(best, clock, tick, r, x, u)
                        table[tick, r, x, u] = odds
        chosen = max(table, key=lambda key: table[key])
        top = table[chosen]
        total = sum(math.exp(odds - top) for odds in table.values())
        self.tick, self.r, self.x, self.u = chosen
        self.sure = {}
        for place, name in enumerate(("t", "r", "x", "u")):
            alike = [odds for key, odds in table.items() if key[place] == chosen[place]]
            self.sure[name] = sum(math.exp(odds - top) for odds in alike) / total
        self.sure |= {"y": self.sure["x"], "v": self.sure["u"], "psi": 1.0}
        self.step = clock.step
        if clock.column is None and not math.isfinite(clock.step):
            self.step = self._estimated(best)

    def _estimated(self, best: Weighed) -> float:
        """The sampling interval (s) that makes the kinematics right, NaN where none tells."""
        steps = []
        if best.yaw is not None and best.reading.r is not None and best.yaw.evidence > 5:
            turn = 2 * math.pi / best.reading.period
            steps.append(abs(best.yaw.gain) * turn / UNITS[self.r][1])
        if math.isfinite(best.scale) and best.scale > 0 and min(best.left) < 0.2 and self.u:
            steps.append(best.scale * UNITS[self.x][1] / UNITS[self.u][1])
        if not steps or max(steps) > 1.2 * min(steps):
            return math.nan
        return float(f"{np.mean(steps):.2g}")


def _cost(best: Weighed, clock: Clock, tick: str, r: str, x: str, u: str) -> float:
    """What these units cost, given the measured ratios."""
    if clock.column is None:
        return 0.0
    cost, second = 0.0, UNITS[tick][1]
    if r and best.yaw is not None and best.reading.psi and best.yaw.evidence > 0:
        expected = UNITS[r][1] * second * best.reading.period / (2 * math.pi)
        yaw = ratio_cost(abs(best.yaw.gain), expected, best.yaw.error)
        cost += min(yaw, best.yaw.evidence)
    if u and x and min(best.left) < 1:
        cost += ratio_cost(best.scale, UNITS[u][1] * second / UNITS[x][1], best.error)
    return cost


def _motion_guesses(weighed, settled: _Units, clock: Clock, tables, place) -> list[Guess]:
    chances, best = _probabilities(weighed), weighed[0]
    reading, found = best.reading, []
    if clock.column is not None:
        sure = min(clock.sure * settled.sure["t"], _CERTAIN)
        unit = None if settled.tick == "s" else settled.tick
        found.append(Guess("t", Column(clock.column, unit), sure, clock.why))
    for channel, name in _columns(reading).items():
        if name is None:
            continue
        key = _key(reading, channel)
        agree = [
            p for p, w in zip(chances, weighed, strict=True) if _key(w.reading, channel) == key
        ]
        sure = min(float(np.sum(agree)) * settled.sure[channel], _CERTAIN)
        column = _read_as(reading, channel, name, settled, tables, place)
        found.append(Guess(channel, column, sure, _why(best, channel)))
    return found


def _read_as(reading: Reading, channel: str, name: str, settled: _Units, tables, place) -> Column:
    if channel in ("x", "y"):
        sign = reading.signs[channel == "y"]
        if place is not None and name in place:
            origin = _origin(tables[0], name)
            scale = degrees_to_metres(_origin(tables[0], place[0]))[place.index(name)]
            scale = float(f"{scale:.8g}")
            return Column(name, sign=sign, scale=scale, offset=-scale * origin)
        return Column(name, _plain(settled.x), sign)
    if channel == "psi":
        degrees = reading.period == 360.0
        size = 90.0 if degrees else 0.5 * math.pi
        # A quarter turn is added after the sign: sign * (number + offset).
        quarter = reading.quarter if reading.quarter < 3 else -1
        return Column(
            name, "deg" if degrees else "rad" if quarter else None, reading.turn,
            offset=reading.turn * quarter * size,
        )  # fmt: skip
    if channel == "r":
        return Column(name, _plain(settled.r), reading.spin)
    return Column(name, _plain(settled.u), reading.speeds[channel == "v"])


def _plain(unit: str) -> str | None:
    """None for a unit of SI, which needs no mention."""
    return None if not unit or UNITS[unit][1] == 1.0 else unit


def _why(best: Weighed, channel: str) -> str:
    reading = best.reading
    if channel in ("psi", "r") and reading.psi and reading.r and best.yaw and best.yaw.evidence > 3:
        other = reading.r if channel == "psi" else reading.psi
        return f"heading is the integral of yaw rate: agrees with {other!r}"
    if channel != "r" and min(best.left) < 0.5:
        left = [max(100 * share, 0.01) for share in best.left]
        return (
            f"positions and velocities agree but for {left[0]:.2g} and {left[1]:.2g} % of "
            "squared displacement"
        )
    return "by its name"


def _others(prior: Prior, table, windows: Windows, used: set[str]) -> list[Guess]:
    """Wind and roll, which nothing but their names and ranges tells."""
    found = []
    for channel in ("wind_speed", "wind_direction", "phi", "p"):
        named = [
            (prior.suggestions[n].weights[channel], n) for n in table if n not in used
            and prior.suggestions[n].weights[channel] > 0.5
        ]  # fmt: skip
        if not named:
            continue
        weight, name = max(named)
        unit, sure = _named_unit(prior.suggestions[name].unit, channel, table[name])
        if channel == "p" and prior.suggestions[name].unit not in UNITS:
            unit, sure = _roll_unit(found, name, windows)
        found.append(Guess(channel, Column(name, unit), weight * sure, "by its name"))
    return found


def _named_unit(stated: str, channel: str, values: np.ndarray) -> tuple[str | None, float]:
    if stated in UNITS:
        return _plain(stated), 0.97
    largest = float(np.nanmax(np.abs(values)))
    if channel in ("phi", "wind_direction"):
        limit = 1.0 if channel == "phi" else 2 * math.pi + 0.05
        return ("deg", 0.9) if largest > limit else (None, 0.6)
    return None, 0.7


def _roll_unit(found: list[Guess], name: str, windows: Windows) -> tuple[str | None, float]:
    """The unit of roll rate, from its ratio to the change of roll."""
    roll = next((guess for guess in found if guess.channel == "phi"), None)
    if roll is None or not {name, roll.column.column} <= set(windows.records[0].columns):
        return None, 0.5
    relation = follows(
        windows.increments(roll.column.column), windows.integrals(name), windows.duration
    )
    if relation.evidence < 3:
        return None, 0.5
    ratio = abs(relation.gain)
    degrees = ratio_cost(ratio, 1.0, relation.error) < ratio_cost(ratio, 57.3, relation.error)
    if roll.column.unit != "deg":
        degrees = not ratio_cost(ratio, 1.0, relation.error) < 2.0
    return ("deg/s" if degrees else None), 0.9


def _runs(paths, layout, clock, windows, prior, best, tables, place, free):
    """The first files read through the best reading, every free column as an order."""
    settled = _Units(prior, clock, windows, best)
    step = settled.step if math.isfinite(settled.step) else 1.0
    channels = {}
    if clock.column is not None:
        channels["t"] = Column(clock.column, settled.tick)
    for channel, name in _columns(best.reading).items():
        if name is not None:
            channels[channel] = _read_as(best.reading, channel, name, settled, tables, place)
    if len(channels) < 2:
        return []
    numeric = [n for n in free if n in tables[0]]
    channels |= {f"cmd_{name}": Column(name) for name in numeric}
    mapping = dataclasses.replace(
        layout.mapping, channels=channels, time_step=None if clock.column else step,
        velocity_axes="earth" if best.reading.earth and best.reading.psi else "body",
    )  # fmt: skip
    runs = [read_recording(path, mapping) for path in paths[:3]]
    kept = set.intersection(*(set(run.commanded) for run in runs))
    return [
        dataclasses.replace(run, commanded={n: run.commanded[n] for n in numeric if n in kept})
        for run in runs
    ]
