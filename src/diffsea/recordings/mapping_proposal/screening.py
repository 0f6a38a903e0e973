"""The first pass over a file's columns: which may belong together, names and numbers weighed.

Every column is tried as heading against every other as yaw rate, and increments of every
column are regressed on integrals of every pair of columns, turned by a candidate for heading
(velocities along body axes) or not (earth axes), with free gains: whatever the signs, order and
units, what belongs together is explained.

A relation between columns may have another reason than the one looked for (roll and roll rate
are related as well), so what it counts for a choice of columns saturates; between explanations
of the same column the likelihood decides in full.
"""

import dataclasses
import heapq
import itertools
import math

import numpy as np

from diffsea.recordings.mapping_proposal.actuators import ROLES
from diffsea.recordings.mapping_proposal.columns import (
    ColumnWindows,
    IntegralRelation,
    TimeColumn,
    relate_to_integral,
)
from diffsea.recordings.mapping_proposal.hypotheses import (
    HypothesisPrior,
    period_log_odds,
    ratio_penalty,
)
from diffsea.recordings.mapping_proposal.names import NAMED
from diffsea.recordings.mappings import UNITS


_SATURATION = 12.0  # log odds of a perfect relation of one column to others
ASSUMED_INCREMENTS = 20.0  # effective ones in this pass, of about sixty per file
_MOST_HEADINGS = 6  # candidates that are looked at closely; the right one is hardly ever later
_MOST_RATES = 3  # columns of yaw rate that are kept for each heading
_MOST_COLUMN_SETS = 60  # that the second pass can afford
_MOST_PAIRS = 40  # of position, by name and by how well they are explained
_FINEST = 1e-4  # share of variance that is taken for unexplained at least

# A column of yaw rate, its relation to heading, and log odds of the relation without the name.
YawRate = tuple[str | None, IntegralRelation | None, float]
# Columns of velocity, and whether they are along earth axes.
Velocities = tuple[str | None, str | None, bool]


@dataclasses.dataclass(frozen=True)
class HeadingCandidate:
    """A column that may be the heading, None for no heading, and yaw rates for it.

    Attributes:
        period: of the column's numbers, 360 or 2 pi.
        log_odds: of its numbers being an angle of that period.
    """

    column: str | None
    period: float
    log_odds: float
    rates: tuple[YawRate, ...]


@dataclasses.dataclass(frozen=True)
class ColumnSet:
    """Columns of a hypothesis without their signs and order: a and b are of position."""

    heading: HeadingCandidate
    a: str | None
    b: str | None
    u: str | None
    v: str | None
    earth: bool
    log_odds: float


def saturated_evidence(evidence: float, best: float) -> float:
    """What a log likelihood ratio counts where the best for the same column is `best`."""
    return max(min(best, _SATURATION) - (best - evidence), 0.0)


@dataclasses.dataclass
class ColumnScreening:
    """The columns of a file, and what their names and numbers say that they may be."""

    windows: ColumnWindows
    prior: HypothesisPrior
    clock: TimeColumn

    @property
    def names(self) -> list[str]:
        """The columns that vary in every file."""
        return list(self.windows.records[0].columns)

    def headings(self) -> list[HeadingCandidate]:
        """The likeliest columns and units of heading, and no heading at all."""
        found = []
        for name in self._possible_headings():
            values = np.concatenate([r.columns[name] for r in self.windows.records])
            stated = self.prior.suggestions[name].unit
            for period, odds in period_log_odds(values, stated).items():
                rates = self._yaw_rates(name, period)
                best = max(rate + self.prior.label(r, "r") for r, _, rate in rates)
                total = odds + self.prior.label(name, "psi") + best
                found.append((total, HeadingCandidate(name, period, odds, rates)))
        likely = heapq.nlargest(_MOST_HEADINGS, found, key=lambda item: item[0])
        kept = self.prior.named_for("psi")
        found = likely + [i for i in found if i[1].column in kept and i not in likely]
        named = heapq.nlargest(1, self.names, key=lambda name: self.prior.label(name, "r"))
        rates = ((None, None, 0.0), *((name, None, 0.0) for name in named))
        return [*(heading for _, heading in found), HeadingCandidate(None, 2 * math.pi, 0.0, rates)]

    def _possible_headings(self) -> list[str]:
        """Columns that are no orders, and no course where anything is called a heading.

        Speed over ground along the course agrees with positions better than any heading does.
        """
        told = self.prior.suggestions
        names = [name for name in self.names if not told[name].ordered]
        if any(told[name].weights["psi"] > NAMED for name in names):
            names = [name for name in names if not told[name].is_over_ground]
        return names

    def _yaw_rates(self, heading: str, period: float) -> tuple[YawRate, ...]:
        """The likeliest columns of yaw rate, and none."""
        increments = self.windows.of("increments", heading, period)
        relations = {}
        for other in self.names:
            if other != heading and not self.prior.suggestions[other].ordered:
                integrals = self.windows.of("integrals", other)
                relation = relate_to_integral(increments, integrals, self.windows.duration)
                penalty = min(self._rate_penalty(relation, other, period), relation.evidence)
                relations[other] = (relation, relation.evidence - penalty)
        best = max((evidence for _, evidence in relations.values()), default=0.0)
        options = [
            (name, relation, saturated_evidence(evidence, best))
            for name, (relation, evidence) in relations.items()
        ]
        likely = heapq.nlargest(
            _MOST_RATES, options, key=lambda option: option[2] + self.prior.label(option[0], "r")
        )
        kept = self.prior.named_for("r")
        named = [option for option in options if option[0] in kept and option not in likely]
        return (*likely, *named, (None, None, 0.0))

    def _rate_penalty(self, relation: IntegralRelation, column: str, period: float) -> float:
        """Log odds against the ratio of heading to yaw rate under the best choice of units."""
        if self.clock.column is None or relation.gain == 0:
            return 0.0
        penalties = []
        for unit, probability in self.prior.unit_probabilities("r", column).items():
            for tick, likely in self.clock.units.items():
                expected = UNITS[unit][1] * UNITS[tick][1] * period / (2 * math.pi)
                penalty = ratio_penalty(abs(relation.gain), expected, relation.error)
                penalties.append(penalty - math.log(probability * max(likely, 1e-9)))
        return min(penalties)

    def column_sets(self, headings: list[HeadingCandidate]) -> list[ColumnSet]:
        """The likeliest columns of position and velocity with each heading."""
        fits = {heading: self._evidence_of_velocities(heading) for heading in headings}
        best: dict[str, float] = {}
        for tables in fits.values():
            for explained in tables.values():
                for name, evidence in explained.items():
                    best[name] = max(best.get(name, 0.0), evidence)
        sets = []
        for heading, tables in fits.items():
            base = heading.log_odds + self.prior.label(heading.column, "psi")
            base += max(odds + self.prior.label(r, "r") for r, _, odds in heading.rates)
            rates = frozenset(r for r, _, _ in heading.rates if r is not None)
            for (u, v, earth), explained in tables.items():
                speed = base + self._velocity_names(u, v, earth)
                gains = {n: saturated_evidence(e, best[n]) for n, e in explained.items()}
                for a, b, odds in self._position_pairs(gains):
                    odds -= self.prior.passes_over((a, b, heading.column, u, v), rates)
                    sets.append(ColumnSet(heading, a, b, u, v, earth, speed + odds))
        return heapq.nlargest(_MOST_COLUMN_SETS, sets, key=lambda item: item.log_odds)

    def _position_pairs(
        self, gains: dict[str, float]
    ) -> list[tuple[str | None, str | None, float]]:
        """Pairs of position columns with log odds of names and relations, the likeliest."""
        first = {n: gains[n] + self.prior.label(n, "x", "north", "lat") for n in gains}
        second = {n: gains[n] + self.prior.label(n, "y", "east", "lon") for n in gains}
        pairs = [
            (a, b, max(first[a] + second[b], first[b] + second[a]))
            for a, b in itertools.combinations(gains, 2)
        ]
        return [*heapq.nlargest(_MOST_PAIRS, pairs, key=lambda pair: pair[2]), (None, None, 0.0)]

    def _velocity_names(self, u: str | None, v: str | None, earth: bool) -> float:
        """Log odds of the names of velocities in the better order."""
        north, east = ("u", "vx"), ("v", "vy")
        if earth:  # north may be called x or y
            north, east = ("vn", "vx", "u", "vy"), ("ve", "vy", "v", "vx")
        if v is None:
            return self.prior.label(u, *north)
        straight = self.prior.label(u, *north) + self.prior.label(v, *east)
        return max(straight, self.prior.label(v, *north) + self.prior.label(u, *east))

    def _may_be_velocity(self, name: str) -> bool:
        """Whether a column is no order, and not called an actuator or anything beside motion."""
        told = self.prior.suggestions[name]
        beside = max(told.weights[label] for label in (*ROLES, "other"))
        return not told.ordered and (told.is_over_ground or beside <= NAMED)

    def _evidence_of_velocities(
        self, heading: HeadingCandidate
    ) -> dict[Velocities, dict[str, float]]:
        """Log likelihood ratios of every column for one or two of velocity.

        Least squares with a free gain for every velocity along earth axes, a free complex one
        for every velocity that the heading turns.
        """
        free = [name for name in self.names if name != heading.column]
        tables: dict[Velocities, dict[str, float]] = {(None, None, False): dict.fromkeys(free, 0.0)}
        if not free:
            return tables
        targets = np.stack([self.windows.of("increments", name) for name in free], axis=1)
        totals = np.maximum(np.sum(targets**2, axis=0), 1e-300)
        options: list[tuple[tuple[str, ...], bool]] = []
        moving = [name for name in free if self._may_be_velocity(name)]
        if heading.column is not None:
            options = [((u,), False) for u in moving]
            options += [(pair, False) for pair in itertools.combinations(moving, 2)]
        options += [(pair, True) for pair in itertools.combinations(moving, 2)]
        for velocities, earth in options:
            regressors = []
            for name in velocities:
                if earth:
                    regressors.append(self.windows.of("integrals", name))
                else:
                    flow = self.windows.of("turned", name, heading.column, heading.period)
                    regressors += [np.real(flow), np.imag(flow)]
            matrix = np.stack(regressors, axis=1)
            gains = np.linalg.lstsq(matrix, targets, rcond=1e-9)[0]
            left = np.sum((targets - matrix @ gains) ** 2, axis=0) / totals
            cost = 0.5 * matrix.shape[1] * math.log(ASSUMED_INCREMENTS)
            evidence = 0.5 * ASSUMED_INCREMENTS * np.log(1 / np.clip(left, _FINEST, 1.0)) - cost
            explained = dict(zip(free, np.maximum(evidence, 0.0).tolist(), strict=True))
            u, v = (*velocities, None)[:2]
            tables[u, v, earth] = {n: e for n, e in explained.items() if n not in velocities}
        return tables
