"""The search for the reading of a file's motion: names and kinematics weighed together.

What the screening leaves is compared as models of the same displacements over windows, with the
nuisances of real sensors (heading offset, current, lever arm, late position, late heading)
allowed for within what is usual. Log prior plus log likelihood ratio is the log posterior odds of
a hypothesis; probabilities summed over hypotheses that agree in a channel are how sure that
channel is.
"""

import dataclasses
import heapq
import itertools
import math
from typing import TypeVar

import numpy as np
from jaxtyping import Complex, Float

from diffsea.recordings.mapping_proposal.columns import (
    ColumnWindows,
    ComplexWindowed,
    IntegralRelation,
    TimeColumn,
    effective_size,
)
from diffsea.recordings.mapping_proposal.hypotheses import (
    ColumnHypothesis,
    HypothesisPrior,
    ratio_penalty,
)
from diffsea.recordings.mapping_proposal.screening import (
    ASSUMED_INCREMENTS,
    ColumnScreening,
    ColumnSet,
    HeadingCandidate,
    saturated_evidence,
)
from diffsea.recordings.mappings import UNITS


_FINEST = 1e-5  # share of squared displacement that is never explained
_COUNTED = 25.0  # log odds behind the best that a hypothesis may be and still count
_MOVING_AHEAD = 3.0  # effective displacements that say that vessels move ahead
_MOST_SIGNS = 40  # hypotheses of the same columns that are looked at further, of 512
_MOST_OF_SET = 60  # hypotheses of the same columns that are compared, yaw rates included
_MOST_COMPARED = 400  # hypotheses of all columns: bounds the time that a proposal takes
_MOST_OF_PLACE = 15.0  # log odds that agreement with geographic positions counts at most
_OUTWARDS = 1.5  # log odds that vessels drift outwards in turns counts at most
# What is usual of sensors, one standard deviation: heading offset (rad), current as a share of
# the speed, lateness of positions and of heading (s), and the lever arm as the way of some seconds.
_OFFSET, _CURRENT, _LATE_POSITION, _LATE_HEADING, _LEVER = 0.06, 0.1, 0.5, 0.25, 0.4
# Whether a pair of columns is exchanged, and the signs of both.
_ORIENTATIONS = tuple(itertools.product((False, True), (1, -1), (1, -1)))
_TURNS = tuple(itertools.product((1, -1), range(4)))  # sign of heading, and quarter turns


@dataclasses.dataclass(frozen=True)
class ScoredHypothesis:
    """A hypothesis with its log posterior odds, and what ratios of columns it needs.

    Attributes:
        yaw: the relation of heading to yaw rate.
        scale: displacement per integrated velocity, in raw numbers and raw time.
        left: the shares of squared displacement along x and y that stay unexplained.
        number: the effective number of displacements.
    """

    hypothesis: ColumnHypothesis
    log_odds: float
    yaw: IntegralRelation | None = None
    scale: float = math.nan
    left: tuple[float, float] = (1.0, 1.0)
    number: float = ASSUMED_INCREMENTS

    @property
    def error(self) -> float:
        """Relative standard error of the scale."""
        share = min(self.left)
        return math.sqrt(share / max(1 - share, 1e-9) / self.number)


Item = TypeVar("Item", ColumnSet, ScoredHypothesis)


def search_hypotheses(
    windows: ColumnWindows,
    prior: HypothesisPrior,
    clock: TimeColumn,
    place: tuple[str, str] | None,
) -> list[ScoredHypothesis]:
    """Hypotheses of the motion with their log posterior odds, the best first.

    `place` names columns of position known to be north and east, if there are any.
    """
    screening = ColumnScreening(windows, prior, clock)
    sets = _near_best(screening.column_sets(screening.headings()))
    found = _near_best(_DisplacementModels(windows, prior, clock, place).score(sets))
    return sorted(found, key=lambda item: -item.log_odds)


def _near_best(items: list[Item]) -> list[Item]:
    """Those whose log odds are not far behind the best."""
    best = max(item.log_odds for item in items)
    return [item for item in items if item.log_odds >= best - 2 * _COUNTED]


def shares_left(
    moved: Complex[np.ndarray, "order window"], flow: Complex[np.ndarray, "flow window"]
) -> tuple[Float[np.ndarray, "order flow"], Float[np.ndarray, "order flow"]]:
    """Shares of squared displacement left by the best positive scale, and the scales."""
    cross = np.maximum(np.real(moved @ np.conj(flow).T), 0.0)
    power = np.sum(np.abs(flow) ** 2, axis=1)[None]
    total = np.sum(np.abs(moved) ** 2, axis=1)[:, None]
    scale = cross / np.maximum(power, 1e-300)
    return 1 - cross * scale / np.maximum(total, 1e-300), scale


def explain_displacements(
    moved: ComplexWindowed, flow: ComplexWindowed, causes: list[ComplexWindowed]
) -> tuple[ComplexWindowed, float, float]:
    """Residuals, penalty and scale of displacements explained by a flow and nuisances.

    Each nuisance is held to its size as a prior does, relative to residuals whose variance is
    estimated in turn. The scale is NaN, and nothing explained, where it would not be positive.
    """
    columns = [flow, *causes]
    matrix = np.stack([np.concatenate([np.real(c), np.imag(c)]) for c in columns], axis=1)
    target = np.concatenate([np.real(moved), np.imag(moved)])
    total = float(target @ target)
    # Nuisances are in the numbers of the velocities: they go with the scale.
    crude = float(matrix[:, 0] @ target) / max(float(matrix[:, 0] @ matrix[:, 0]), 1e-300)
    if crude <= 0:
        return moved, 0.0, math.nan
    matrix[:, 1:] *= crude
    variance, solution, rest = total / target.size, np.zeros(len(columns)), target
    for _ in range(6):
        prior = np.diag([0.0, *([variance] * len(causes))])
        solution = np.linalg.lstsq(matrix.T @ matrix + prior, matrix.T @ target, rcond=None)[0]
        rest = target - matrix @ solution
        variance = max(float(rest @ rest), _FINEST * total) / target.size
    if solution[0] <= 0:
        return moved, 0.0, math.nan
    half = moved.size
    penalty = variance * float(solution[1:] @ solution[1:])
    return rest[:half] + 1j * rest[half:], penalty, float(solution[0])


@dataclasses.dataclass(frozen=True)
class _DisplacementModels:
    """The second pass: hypotheses as models of the same displacements."""

    windows: ColumnWindows
    prior: HypothesisPrior
    clock: TimeColumn
    place: tuple[str, str] | None
    _fits: dict[tuple, tuple[ColumnHypothesis, tuple[float, float], float]] = dataclasses.field(
        default_factory=dict
    )

    @property
    def second(self) -> float:
        """One second in the file's likeliest unit of time."""
        tick = max(self.clock.units, key=lambda unit: self.clock.units[unit])
        return 1.0 if self.clock.column is None else 1.0 / UNITS[tick][1]

    def score(self, sets: list[ColumnSet]) -> list[ScoredHypothesis]:
        """Hypotheses of the column sets with all evidence in their log odds."""
        plain = _near_best([item for columns in sets for item in self._with_signs(columns)])
        plain = heapq.nlargest(_MOST_COMPARED, plain, key=lambda item: item.log_odds)
        number = self._effective_number(plain[0].hypothesis)
        fits = [self._fit(item, number) for item in plain]
        best: dict[str | None, float] = {}
        for item, evidence in fits:
            for name, gain in zip((item.hypothesis.x, item.hypothesis.y), evidence, strict=True):
                best[name] = max(best.get(name, 0.0), gain)
        scored = []
        for item, (north, east) in fits:
            h = item.hypothesis
            gain = saturated_evidence(north, best[h.x])
            gain += saturated_evidence(east, best[h.y])
            if gain > 0:
                gain -= min(self._speed_penalty(item), gain)
            odds = item.log_odds + gain + self._drifting_outwards(h) + self._placed_right(h, number)
            scored.append(dataclasses.replace(item, log_odds=odds))
        return scored

    def _with_signs(self, columns: ColumnSet) -> list[ScoredHypothesis]:
        """Orders and signs of a set of columns, with the best scale and no nuisances.

        Log odds are without what displacements say, but that only hypotheses near the best in
        that are kept.
        """
        heading, found = columns.heading, []
        positions = _ORIENTATIONS if columns.a is not None else _ORIENTATIONS[:1]
        velocities = _ORIENTATIONS
        if columns.v is None:  # one column, of either sign, or none
            velocities = _ORIENTATIONS[:4:2] if columns.u is not None else _ORIENTATIONS[:1]
        moved = np.zeros((1, self.windows.duration.size), complex)
        if columns.a is not None:
            a, b = (self.windows.of("increments", name) for name in (columns.a, columns.b))
            moved = np.stack(
                [
                    first * b + 1j * second * a if swapped else first * a + 1j * second * b
                    for swapped, first, second in positions
                ]
            )
        for turn, quarter in _TURNS if heading.column else _TURNS[:1]:
            hypotheses = [
                _hypothesis(columns, position, velocity, turn, quarter)
                for position in positions
                for velocity in velocities
            ]
            flows = np.stack([self.flow(h) for h in hypotheses[: len(velocities)]])
            shares, scales = shares_left(moved, flows)
            ahead = self._moving_ahead(heading, moved, turn, quarter)
            gains = ASSUMED_INCREMENTS * np.log(1 / np.clip(shares, 1e-4, 1.0))
            for place, hypothesis in enumerate(hypotheses):
                i, j = divmod(place, len(velocities))
                found.append((hypothesis, gains[i, j], ahead[i], scales[i, j]))
        top = max(gain for _, gain, _, _ in found)
        near = [entry for entry in found if entry[1] >= top - _COUNTED]
        near = heapq.nlargest(
            _MOST_SIGNS, near, key=lambda entry: self.prior.log_odds(entry[0]) + entry[2]
        )
        kept = []
        for hypothesis, _, ahead, scale in near:
            kept += self._with_rates(heading, hypothesis, ahead, scale)
        return heapq.nlargest(_MOST_OF_SET, kept, key=lambda item: item.log_odds)

    def _with_rates(
        self, heading: HeadingCandidate, hypothesis: ColumnHypothesis, ahead: float, scale: float
    ) -> list[ScoredHypothesis]:
        """The hypothesis with each of the yaw rates that go with its heading."""
        found, h = [], hypothesis
        for r, relation, odds in heading.rates:
            if r is not None and r in (h.x, h.y, h.u, h.v):
                continue
            spins = (1, -1) if r is not None else (1,)
            if relation is not None and relation.evidence > 3:
                spins = (h.turn * (1 if relation.gain > 0 else -1),)
            for spin in spins:
                whole = dataclasses.replace(h, r=r, spin=spin)
                total = self.prior.log_odds(whole) + heading.log_odds + odds + ahead
                found.append(ScoredHypothesis(whole, total, relation, scale))
        return found

    def _moving_ahead(
        self, heading: HeadingCandidate, moved: np.ndarray, turn: int, quarter: int
    ) -> Float[np.ndarray, "order"]:
        """Log odds for moving ahead rather than in any direction, for each displacement."""
        if heading.column is None or not np.any(moved):
            return np.zeros(moved.shape[0])
        ahead = self.windows.of("courses", heading.column, heading.period)
        ahead = (ahead if turn > 0 else np.conj(ahead)) * 1j**quarter
        ahead = ahead / np.maximum(np.abs(ahead), 1e-12)
        power = np.sum(np.abs(moved) ** 2, axis=1)
        parted = np.sum(np.abs(moved - np.abs(moved) * ahead) ** 2, axis=1)
        share = 0.5 * parted / np.maximum(power, 1e-300)
        return _MOVING_AHEAD * np.log(1 / np.clip(share, 0.05, 1.0))

    def _effective_number(self, hypothesis: ColumnHypothesis) -> float:
        """Effective number of the hypothesis' residuals, 6 to 60."""
        if not hypothesis.explains_displacement:
            return ASSUMED_INCREMENTS
        moved, flow = self.displacement(hypothesis), self.flow(hypothesis)
        rest = explain_displacements(moved, flow, self._nuisances(hypothesis, flow))[0]
        north, east = effective_size(np.real(rest)), effective_size(np.imag(rest))
        return max(6.0, min(north, east, 60.0))

    def displacement(self, h: ColumnHypothesis) -> ComplexWindowed:
        """Displacement north + i east over the windows, raw numbers."""
        x, y = (self.windows.of("increments", name) for name in (h.x, h.y))
        return h.signs[0] * x + 1j * h.signs[1] * y

    def flow(self, h: ColumnHypothesis, what: str = "turned") -> ComplexWindowed:
        """Integrated velocity north + i east over the windows, raw numbers and time.

        Of `what` = `ends` or `swerves`, what position lags by per unit of time that it, or
        heading, is late. Zero without a heading to turn body axes by.
        """
        total = np.zeros(self.windows.duration.size, complex)
        if h.psi is None and not h.earth:
            return total
        for name, factor in ((h.u, h.speeds[0]), (h.v, 1j * h.speeds[1])):
            if name is None:
                continue
            if h.earth:
                part = self.windows.of("integrals" if what == "turned" else "increments", name)
                total = total + factor * part
                continue
            part = self.windows.of(what, name, h.psi, h.period)
            # Of a real column and a mirrored heading the integral is the conjugate.
            part = np.conj(part) if h.turn < 0 else part
            total = total + factor * part * 1j**h.quarter
        return total

    def _nuisances(self, h: ColumnHypothesis, flow: ComplexWindowed) -> list[ComplexWindowed]:
        """What sensors do to displacements, of a size that is usual (raw numbers)."""
        duration = self.windows.duration
        speed = math.sqrt(np.sum(np.abs(flow) ** 2) / np.sum(duration**2))
        causes = [
            _OFFSET * 1j * flow,
            _CURRENT * speed * duration,
            _CURRENT * 1j * speed * duration,
            _LATE_POSITION * self.second * self.flow(h, "ends"),
        ]
        if not h.earth:
            causes.append(_LATE_HEADING * self.second * self.flow(h, "swerves"))
        if h.psi is not None:
            turned = self.windows.of("directions", h.psi, h.period)
            turned = (np.conj(turned) if h.turn < 0 else turned) * 1j**h.quarter
            causes += [_LEVER * speed * self.second * factor * turned for factor in (1, 1j)]
        return causes

    def _fit(
        self, item: ScoredHypothesis, number: float
    ) -> tuple[ScoredHypothesis, tuple[float, float]]:
        """The hypothesis with its scale and what is left, nuisances allowed for.

        And log likelihood ratios of its displacements along x and y, zero where it explains none.
        """
        h = item.hypothesis
        if not h.explains_displacement or not item.scale > 0:
            return dataclasses.replace(item, scale=math.nan, number=number), (0.0, 0.0)
        # Hypotheses that differ by a turn or a mirror of everything have the same fit.
        key = (frozenset((h.x, h.y)), h.u, h.v, h.psi, h.period, h.earth, f"{item.scale:.8g}")
        if key not in self._fits:
            moved, flow = self.displacement(h), self.flow(h)
            rest, penalty, scale = explain_displacements(moved, flow, self._nuisances(h, flow))
            shares = []
            for axis in (np.real, np.imag):
                whole = max(np.sum(axis(moved) ** 2), 1e-300)
                share = (np.sum(axis(rest) ** 2) + 0.5 * penalty) / whole
                shares.append(min(max(share, _FINEST), 1.0))
            self._fits[key] = h, (shares[0], shares[1]), scale
        first, left, scale = self._fits[key]
        if first.x != h.x:
            left = left[1], left[0]
        free = 2 + (h.v is not None)
        cost = 0.25 * free * math.log(number)
        north, east = (max(0.5 * number * math.log(1 / share) - cost, 0.0) for share in left)
        return dataclasses.replace(item, scale=scale, left=left, number=number), (north, east)

    def _speed_penalty(self, item: ScoredHypothesis) -> float:
        """Log odds against the ratio of displacement to velocity under the best units."""
        if self.clock.column is None:
            return 0.0
        h, penalties = item.hypothesis, []
        for speed, likely in self.prior.unit_probabilities("u", h.u).items():
            for length, often in self.prior.unit_probabilities("x", h.x).items():
                for tick, odds in self.clock.units.items():
                    expected = UNITS[speed][1] * UNITS[tick][1] / UNITS[length][1]
                    penalty = ratio_penalty(item.scale, expected, item.error)
                    penalties.append(penalty - math.log(likely * often * max(odds, 1e-9)))
        return min(penalties)

    def _drifting_outwards(self, h: ColumnHypothesis) -> float:
        """Log odds for a vessel that drifts outwards in turns: v opposes r u."""
        if h.u is None or h.v is None or h.psi is None or h.earth:
            return 0.0
        inwards = []
        for record in self.windows.records:
            psi = np.unwrap(record.columns[h.psi], period=h.period)
            rate = h.turn * np.gradient(psi, record.t)
            forward = h.speeds[0] * record.columns[h.u]
            sideways = h.speeds[1] * record.columns[h.v]
            pull = rate * forward
            spread = float(np.std(pull) * np.std(sideways))
            common = np.mean((pull - pull.mean()) * (sideways - sideways.mean()))
            inwards.append(float(common / spread) if spread > 0 else 0.0)
        return -_OUTWARDS * float(np.tanh(4 * np.mean(inwards)))

    def _placed_right(self, h: ColumnHypothesis, number: float) -> float:
        """Log odds of agreement with geographic positions, where the file has those besides."""
        if self.place is None or h.x is None or h.x in self.place:
            return 0.0
        north, east = (self.windows.of("increments", name) for name in self.place)
        true, moved = north + 1j * east, self.displacement(h)
        if not np.any(np.abs(true) > 0) or not np.any(np.abs(moved) > 0):
            return 0.0
        share = max(float(shares_left(true[None], moved[None])[0][0, 0]), 0.01)
        return min(number * math.log(1 / share), _MOST_OF_PLACE)


def _hypothesis(
    columns: ColumnSet,
    position: tuple[bool, int, int],
    velocity: tuple[bool, int, int],
    turn: int,
    quarter: int,
) -> ColumnHypothesis:
    """The columns with an orientation of both pairs and of the heading."""
    return ColumnHypothesis(
        x=columns.b if position[0] else columns.a,
        y=columns.a if position[0] else columns.b,
        signs=position[1:],
        psi=columns.heading.column,
        period=columns.heading.period,
        turn=turn,
        quarter=quarter,
        u=columns.v if velocity[0] else columns.u,
        v=columns.u if velocity[0] else columns.v,
        speeds=velocity[1:],
        earth=columns.earth,
    )
