"""The first pass over a file's columns: which may belong together, names and numbers weighed.

Every column is tried as heading against every other as yaw rate, and increments of every
column are regressed on integrals of every pair of columns, turned by a candidate for heading
(velocities along body axes) or not (earth axes), with free gains: whatever the signs, order and
units, what belongs together is explained.

A relation between columns may have another reason than the one looked for (roll and roll rate
are related as well), so what it counts for a choice of columns saturates at `WORTH`; between
explanations of the same column the likelihood decides in full.
"""

import dataclasses
import heapq
import itertools
import math

import numpy as np

from diffsea.recordings.mapping_proposal.clock import TimeColumn
from diffsea.recordings.mapping_proposal.readings import (
    HypothesisPrior,
    period_log_odds,
    ratio_penalty,
    unit_probabilities,
)
from diffsea.recordings.mapping_proposal.windows import (
    ColumnWindows,
    IntegralRelation,
    relate_to_integral,
)
from diffsea.recordings.mappings import UNITS


SATURATION = 12.0  # log odds of a perfect relation of one column to others
ASSUMED_INCREMENTS = 20.0  # effective increments assumed in this pass
_HEADINGS = 6  # candidates for heading that are looked at closely
_DRAFTS = 60
_PAIRS = 40  # of position, by name and by how well they are explained
_FINEST = 1e-4  # share of variance that is taken for unexplained at least


@dataclasses.dataclass(frozen=True)
class HeadingCandidate:
    """A candidate for heading: column, period, log odds of its numbers, and yaw rates for it.

    `rates` are (column, relation, log odds of the relation without the name).
    """

    column: str | None
    period: float
    odds: float
    rates: tuple[tuple[str | None, IntegralRelation | None, float], ...]


@dataclasses.dataclass(frozen=True)
class UnsignedHypothesis:
    """Columns of a reading without their signs and order."""

    headed: HeadingCandidate
    a: str | None
    b: str | None
    u: str | None
    v: str | None
    earth: bool
    odds: float


def saturated_evidence(evidence: float, best: float) -> float:
    """What a log likelihood ratio counts where the best for the same column is `best`."""
    return max(min(best, SATURATION) - (best - evidence), 0.0)


@dataclasses.dataclass
class ColumnScreening:
    """The columns of a file, and what their names are worth."""

    windows: ColumnWindows
    prior: HypothesisPrior
    clock: TimeColumn
    names: list[str]

    def headings(self) -> list[HeadingCandidate]:
        """The likeliest columns and units of heading, and no heading at all."""
        found = []
        for name in self.names:
            values = np.concatenate([r.columns[name] for r in self.windows.records])
            stated = self.prior.suggestions[name].unit
            for period, odds in period_log_odds(values, stated).items():
                rates = self._rates(name, period)
                best = max(odds + self._rate_name(r) for r, _, odds in rates)
                total = odds + self.prior.label(name, "psi") + best
                found.append((total, HeadingCandidate(name, period, odds, rates)))
        found = heapq.nlargest(_HEADINGS, found, key=lambda item: item[0])
        named = heapq.nlargest(1, self.names, key=self._rate_name)
        none = HeadingCandidate(
            None, 2 * math.pi, 0.0, ((None, None, 0.0), *((n, None, 0.0) for n in named))
        )
        return [*(headed for _, headed in found), none]

    def _rate_name(self, column: str | None) -> float:
        return self.prior.label(column, "r")

    def _rates(self, heading: str, period: float) -> tuple:
        increments = self.windows.of("increments", heading, period)
        relations = {}
        for other in self.names:
            if other != heading:
                integrals = self.windows.of("integrals", other)
                relation = relate_to_integral(increments, integrals, self.windows.duration)
                cost = min(self._rate_cost(relation, other, period), relation.evidence)
                relations[other] = (relation, relation.evidence - cost)
        best = max((evidence for _, evidence in relations.values()), default=0.0)
        options = [
            (n, rel, saturated_evidence(evidence, best)) for n, (rel, evidence) in relations.items()
        ]
        options = heapq.nlargest(3, options, key=lambda o: o[2] + self._rate_name(o[0]))
        return (*options, (None, None, 0.0))

    def _rate_cost(self, relation: IntegralRelation, column: str, period: float) -> float:
        """What the ratio of heading to yaw rate costs under the best choice of units."""
        if self.clock.column is None or relation.gain == 0:
            return 0.0
        return min(
            ratio_penalty(
                abs(relation.gain),
                UNITS[unit][1] * UNITS[tick][1] * period / (2 * math.pi),
                relation.error,
            )
            - math.log(odds * max(likely, 1e-9))
            for unit, odds in unit_probabilities(self.prior, "r", column).items()
            for tick, likely in self.clock.units.items()
        )

    def drafts(self, headings: list[HeadingCandidate]) -> list[UnsignedHypothesis]:
        """The likeliest columns of position and velocity with each heading."""
        fits = {headed: self._fits(headed) for headed in headings}
        best: dict[str, float] = {}
        for tables in fits.values():
            for explained in tables.values():
                for name, evidence in explained.items():
                    best[name] = max(best.get(name, 0.0), evidence)
        drafts = []
        for headed, tables in fits.items():
            base = headed.odds + self.prior.label(headed.column, "psi")
            base += max(odds + self._rate_name(r) for r, _, odds in headed.rates)
            for (u, v, earth), explained in tables.items():
                speed = base + self._velocity_names(u, v, earth)
                gains = {
                    n: saturated_evidence(evidence, best[n]) for n, evidence in explained.items()
                }
                for a, b, odds in self._pairs(headed, (u, v), gains):
                    drafts.append(UnsignedHypothesis(headed, a, b, u, v, earth, speed + odds))
        drafts = heapq.nlargest(20 * _DRAFTS, drafts, key=lambda draft: draft.odds)
        return drafts[:_DRAFTS]

    def _pairs(self, headed: HeadingCandidate, used: tuple, gains: dict[str, float]) -> list[tuple]:
        """Pairs of position columns with log odds of names and relations, the likeliest."""
        free = [n for n in gains if n != headed.column and n not in used]
        first = {n: gains[n] + self.prior.label(n, "x", "north", "lat") for n in free}
        second = {n: gains[n] + self.prior.label(n, "y", "east", "lon") for n in free}
        pairs = [
            (a, b, max(first[a] + second[b], first[b] + second[a]))
            for a, b in itertools.combinations(free, 2)
        ]
        return [*heapq.nlargest(_PAIRS, pairs, key=lambda pair: pair[2]), (None, None, 0.0)]

    def _velocity_names(self, u: str | None, v: str | None, earth: bool) -> float:
        if earth:
            north, east = ("vn", "vx", "u"), ("ve", "vy", "v")
            north, east = (*north, "vy"), (*east, "vx")
        else:
            north, east = ("u", "vx"), ("v", "vy")
        if v is None:
            return self.prior.label(u, *north)
        straight = self.prior.label(u, *north) + self.prior.label(v, *east)
        return max(straight, self.prior.label(v, *north) + self.prior.label(u, *east))

    def _fits(self, headed: HeadingCandidate) -> dict[tuple, dict[str, float]]:
        """Log likelihood ratios of every column for pairs of velocities, by (u, v, earth)."""
        free = [name for name in self.names if name != headed.column]
        targets = np.stack([self.windows.of("increments", name) for name in free], axis=1)
        totals = np.maximum(np.sum(targets**2, axis=0), 1e-300)
        options: list[tuple] = [(None, None, False)]
        if headed.column is not None:
            options += [(u, None, False) for u in free]
            options += [(u, v, False) for u, v in itertools.combinations(free, 2)]
        options += [(u, v, True) for u, v in itertools.combinations(free, 2)]
        tables = {}
        for u, v, earth in options:
            if u is None:
                tables[u, v, earth] = dict.fromkeys(free, 0.0)
                continue
            matrix = np.stack(self._regressors(headed, u, v, earth), axis=1)
            gains = np.linalg.lstsq(matrix, targets, rcond=1e-9)[0]
            left = np.sum((targets - matrix @ gains) ** 2, axis=0) / totals
            cost = 0.5 * matrix.shape[1] * math.log(ASSUMED_INCREMENTS)
            evidence = 0.5 * ASSUMED_INCREMENTS * np.log(1 / np.clip(left, _FINEST, 1.0)) - cost
            explained = dict(zip(free, np.maximum(evidence, 0.0).tolist(), strict=True))
            tables[u, v, earth] = {n: e for n, e in explained.items() if n not in (u, v)}
        return tables

    def _regressors(
        self, headed: HeadingCandidate, u: str, v: str | None, earth: bool
    ) -> list[np.ndarray]:
        columns = []
        for name in (u, v):
            if name is None:
                continue
            if earth:
                columns.append(self.windows.of("integrals", name))
            else:
                flow = self.windows.of("turned", name, headed.column, headed.period)
                columns += [flow.real, flow.imag]
        return columns
