"""Displacements against integrated velocities: scales, nuisances, what is left unexplained.

The search for the reading of a file's motion: names and kinematics weighed together.

What the survey leaves is compared as models of the same displacements, with the nuisances of
real sensors (heading offset, current, lever arm, late position, late heading) allowed for
within what is usual. Log prior plus log likelihood ratio is a weight; weights summed over
readings that agree in a channel are how sure that channel is.
"""

import dataclasses
import heapq
import math

import numpy as np

from diffsea.recordings.mapping_proposal.clock import TimeColumn
from diffsea.recordings.mapping_proposal.readings import (
    Hypothesis,
    HypothesisPrior,
    all_orientations,
    ratio_penalty,
    unit_probabilities,
)
from diffsea.recordings.mapping_proposal.survey import (
    ASSUMED_INCREMENTS,
    ColumnScreening,
    HeadingCandidate,
    UnsignedHypothesis,
    saturated_evidence,
)
from diffsea.recordings.mapping_proposal.windows import (
    ColumnWindows,
    IntegralRelation,
    effective_size,
)
from diffsea.recordings.mappings import UNITS


_FINEST = 1e-5  # share of squared displacement that is never explained


def shares_left(moved: np.ndarray, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares of squared displacement (R, F) left by the best positive scale, and the scales."""
    cross = np.maximum(np.real(moved @ np.conj(flow).T), 0.0)
    power = np.sum(np.abs(flow) ** 2, axis=1)[None]
    total = np.sum(np.abs(moved) ** 2, axis=1)[:, None]
    scale = cross / np.maximum(power, 1e-300)
    return 1 - cross * scale / np.maximum(total, 1e-300), scale


def explain_displacements(
    moved: np.ndarray, flow: np.ndarray, causes: list[np.ndarray]
) -> tuple[np.ndarray, float, float]:
    """Residuals (W,), penalty and scale of displacements explained by a flow and nuisances.

    Each nuisance is held to its size as a prior does, relative to residuals whose variance is
    estimated in turn. The scale is NaN, and nothing explained, where it would not be positive.
    """
    columns = [flow, *causes]
    matrix = np.stack([np.concatenate([c.real, c.imag]) for c in columns], axis=1)
    target = np.concatenate([moved.real, moved.imag])
    total = float(target @ target)
    # Nuisances are in the numbers of the velocities: they go with the scale.
    crude = float(matrix[:, 0] @ target) / max(float(matrix[:, 0] @ matrix[:, 0]), 1e-300)
    if crude <= 0:
        return moved, 0.0, math.nan
    matrix[:, 1:] *= crude
    variance, solution, rest = total / target.size, np.zeros(len(columns)), target
    for _ in range(6):
        held = np.diag([0.0, *([variance] * len(causes))])
        solution = np.linalg.lstsq(matrix.T @ matrix + held, matrix.T @ target, rcond=None)[0]
        rest = target - matrix @ solution
        variance = max(float(rest @ rest), _FINEST * total) / target.size
    if solution[0] <= 0:
        return moved, 0.0, math.nan
    half = moved.size
    penalty = variance * float(solution[1:] @ solution[1:])
    return rest[:half] + 1j * rest[half:], penalty, float(solution[0])


def component_shares(moved: np.ndarray, rest: np.ndarray, penalty: float) -> tuple[float, float]:
    """Shares left along x and y, each with half of the penalty."""
    return tuple(
        min(max((np.sum(b**2) + 0.5 * penalty) / max(np.sum(a**2), 1e-300), _FINEST), 1.0)
        for a, b in ((moved.real, rest.real), (moved.imag, rest.imag))
    )


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) if spread > 0 else 0.0


_WITHIN = 25.0  # log odds behind the best that a reading may be and still count
_COURSE = 3.0  # effective displacements that say that vessels move ahead
_SIGNS = 40  # readings of the same columns that are looked at further
_PLACED = 15.0  # the most that agreement with geographic positions counts


@dataclasses.dataclass(frozen=True)
class ScoredHypothesis:
    """A reading with its log odds, and what ratios it needs.

    `yaw` is the relation of heading to yaw rate, `scale` the displacement per integrated
    velocity (raw numbers and raw time), `left` the shares of squared displacement along x and
    y that stay unexplained, `number` the effective number of displacements.
    """

    reading: Hypothesis
    odds: float
    yaw: IntegralRelation | None = None
    scale: float = math.nan
    left: tuple[float, float] = (1.0, 1.0)
    number: float = ASSUMED_INCREMENTS

    @property
    def error(self) -> float:
        """Relative standard error of the scale."""
        share = min(self.left)
        return math.sqrt(share / max(1 - share, 1e-9) / self.number)


def search_hypotheses(
    windows: ColumnWindows, prior: HypothesisPrior, clock: TimeColumn, place: tuple[str, str] | None
) -> list[ScoredHypothesis]:
    """Readings of the motion with their weights, the best first.

    `place` names columns of position known to be north and east, if there are any.
    """
    survey = ColumnScreening(windows, prior, clock, list(windows.records[0].columns))
    drafts = survey.drafts(survey.headings())
    found = _DisplacementModels(windows, prior, clock, place).weigh(_near_best(drafts, 2 * _WITHIN))
    return sorted(_near_best(found, 2 * _WITHIN), key=lambda item: -item.odds)


class _DisplacementModels:
    """The second pass: readings as models of the same displacements."""

    def __init__(
        self,
        windows: ColumnWindows,
        prior: HypothesisPrior,
        clock: TimeColumn,
        place: tuple[str, str] | None,
    ):
        self.windows, self.prior, self.clock, self.place = windows, prior, clock, place
        tick = max(clock.units, key=lambda unit: clock.units[unit])
        self.second = 1.0 if clock.column is None else 1.0 / UNITS[tick][1]  # raw time
        self._fits: dict[tuple, tuple] = {}

    def weigh(self, drafts: list[UnsignedHypothesis]) -> list[ScoredHypothesis]:
        plain = [item for draft in drafts for item in self._plain(draft)]
        plain = heapq.nlargest(400, _near_best(plain, 2 * _WITHIN), key=lambda item: item.odds)
        number = self._number(plain[0].reading)
        fits = [self._fit(item, number) for item in plain]
        best: dict[str | None, float] = {}
        for item, (evidence, _, _) in zip(plain, fits, strict=True):
            for name, gain in zip((item.reading.x, item.reading.y), evidence, strict=True):
                best[name] = max(best.get(name, 0.0), gain)
        return [self._finer(i, fit, best, number) for i, fit in zip(plain, fits, strict=True)]

    def _plain(self, draft: UnsignedHypothesis) -> list[ScoredHypothesis]:
        """Orders and signs of a draft's columns, with the best scale and no nuisances.

        Odds are without what displacements say, but that only readings near the best in that
        are kept.
        """
        pairs, turns = all_orientations()
        headed, found = draft.headed, []
        options = _velocities(draft)
        moved = np.zeros((1, self.windows.duration.size), complex)
        if draft.a is None:
            pairs = pairs[:1]
        else:
            a, b = (self.windows.of("increments", name) for name in (draft.a, draft.b))
            moved = np.stack([_oriented(a, b, pair) for pair in pairs])
        for turn, quarter in turns if headed.column else turns[:1]:
            flows = np.stack([self._flow(draft, turn, quarter, option) for option in options])
            shares, scales = shares_left(moved, flows)
            course = self._course(headed, moved, turn, quarter)
            gains = ASSUMED_INCREMENTS * np.log(1 / np.clip(shares, 1e-4, 1.0))
            for i, pair in enumerate(pairs):
                for j, option in enumerate(options):
                    reading = _signed(draft, pair, turn, quarter, option)
                    found.append((reading, gains[i, j], course[i], scales[i, j]))
        top = max(gain for _, gain, _, _ in found)
        near = [entry for entry in found if entry[1] >= top - _WITHIN]
        near = heapq.nlargest(_SIGNS, near, key=lambda entry: self.prior.of(entry[0]) + entry[2])
        kept = [item for entry in near for item in self._with_rates(headed, *entry)]
        return heapq.nlargest(60, kept, key=lambda item: item.odds)

    def _with_rates(
        self,
        headed: HeadingCandidate,
        reading: Hypothesis,
        gain: float,
        course: float,
        scale: float,
    ) -> list[ScoredHypothesis]:
        found, used = [], (reading.x, reading.y, reading.u, reading.v)
        for r, relation, odds in headed.rates:
            if r is not None and r in used:
                continue
            spins = (1, -1) if r is not None else (1,)
            if relation is not None and relation.evidence > 3:
                spins = (reading.turn * (1 if relation.gain > 0 else -1),)
            for spin in spins:
                whole = reading.changed(r=r, spin=spin)
                total = self.prior.of(whole) + headed.odds + odds + course
                found.append(ScoredHypothesis(whole, total, relation, scale))
        return found

    def _flow(
        self, draft: UnsignedHypothesis, turn: int, quarter: int, option: tuple
    ) -> np.ndarray:
        u, v, su, sv = option
        nothing = np.zeros(self.windows.duration.size, complex)
        if u is None or (draft.headed.column is None and not draft.earth):
            return nothing
        reading = Hypothesis(
            psi=draft.headed.column, period=draft.headed.period, turn=turn, quarter=quarter, u=u,
            v=v, speeds=(su, sv), earth=draft.earth,
        )  # fmt: skip
        return self.flow(reading)

    def _course(
        self, headed: HeadingCandidate, moved: np.ndarray, turn: int, quarter: int
    ) -> np.ndarray:
        """Log odds for moving ahead rather than in any direction, per displacement (R,)."""
        if headed.column is None or not np.any(moved):
            return np.zeros(moved.shape[0])
        ahead = self.windows.of("courses", headed.column, headed.period)
        ahead = (ahead if turn > 0 else np.conj(ahead)) * 1j**quarter
        ahead = ahead / np.maximum(np.abs(ahead), 1e-12)
        power = np.sum(np.abs(moved) ** 2, axis=1)
        parted = np.sum(np.abs(moved - np.abs(moved) * ahead) ** 2, axis=1)
        share = 0.5 * parted / np.maximum(power, 1e-300)
        return _COURSE * np.log(1 / np.clip(share, 0.05, 1.0))

    def _number(self, reading: Hypothesis) -> float:
        """Effective number of the best reading's residuals."""
        if not self._related(reading):
            return ASSUMED_INCREMENTS
        moved, flow = self.displacement(reading), self.flow(reading)
        rest = explain_displacements(moved, flow, self._nuisances(reading, flow))[0]
        return max(6.0, min(effective_size(rest.real), effective_size(rest.imag), 60.0))

    def _related(self, reading: Hypothesis) -> bool:
        return (
            reading.x is not None
            and reading.u is not None
            and (reading.psi is not None or reading.earth)
        )

    def displacement(self, reading: Hypothesis) -> np.ndarray:
        """Displacement north + i east over the windows, raw numbers."""
        x, y = (self.windows.of("increments", name) for name in (reading.x, reading.y))
        return reading.signs[0] * x + 1j * reading.signs[1] * y

    def flow(self, reading: Hypothesis, what: str = "turned") -> np.ndarray:
        """Integrated velocity north + i east over the windows, raw numbers and time.

        Of `what` = `ends` or `swerves`, what position lags by per unit of time that it, or
        heading, is late.
        """
        total = np.zeros(self.windows.duration.size, complex)
        for name, factor in ((reading.u, reading.speeds[0]), (reading.v, 1j * reading.speeds[1])):
            if name is None:
                continue
            if reading.earth:
                part = {"turned": "integrals", "ends": "increments"}.get(what)
                total = total + factor * (self.windows.of(part, name) if part else 0.0)
                continue
            part = self.windows.of(what, name, reading.psi, reading.period)
            # Of a real column and a mirrored heading the integral is the conjugate.
            part = np.conj(part) if reading.turn < 0 else part
            total = total + factor * part * 1j**reading.quarter
        return total

    def _nuisances(self, reading: Hypothesis, flow: np.ndarray) -> list[np.ndarray]:
        """What sensors do to displacements (W,), of a size that is usual (raw numbers)."""
        duration = self.windows.duration
        speed = math.sqrt(np.sum(np.abs(flow) ** 2) / np.sum(duration**2))
        causes = [
            0.06 * 1j * flow,
            0.1 * speed * duration,
            0.1j * speed * duration,
            0.5 * self.second * self.flow(reading, "ends"),
        ]
        if not reading.earth:
            causes.append(0.25 * self.second * self.flow(reading, "swerves"))
        if reading.psi is not None:
            turned = self.windows.of("directions", reading.psi, reading.period)
            turned = (np.conj(turned) if reading.turn < 0 else turned) * 1j**reading.quarter
            causes += [0.4 * speed * self.second * factor * turned for factor in (1, 1j)]
        return causes

    def _fit(self, item: ScoredHypothesis, number: float) -> tuple:
        """Log likelihood ratios of x and y, shares left, and scale, nuisances allowed for."""
        reading = item.reading
        if not self._related(reading) or not item.scale > 0:
            return (0.0, 0.0), (1.0, 1.0), math.nan
        # Readings that differ by a turn or a mirror of everything have the same fit.
        columns = frozenset((reading.x, reading.y)), reading.u, reading.v, reading.psi
        key = (*columns, reading.period, reading.earth, f"{item.scale:.8g}")
        moved, flow = self.displacement(reading), self.flow(reading)
        if key not in self._fits:
            rest, penalty, scale = explain_displacements(
                moved, flow, self._nuisances(reading, flow)
            )
            self._fits[key] = reading, component_shares(moved, rest, penalty), scale
        first, shares, scale = self._fits[key]
        if first.x != reading.x:
            shares = shares[::-1]
        free = 2 + (reading.v is not None)
        evidence = [
            max(0.5 * number * math.log(1 / s) - 0.25 * free * math.log(number), 0.0)
            for s in shares
        ]
        return tuple(evidence), shares, scale

    def _finer(
        self, item: ScoredHypothesis, fit: tuple, best: dict, number: float
    ) -> ScoredHypothesis:
        """The reading with all evidence."""
        evidence, left, scale = fit
        reading = item.reading
        found = dataclasses.replace(item, scale=scale, left=left, number=number)
        gain = saturated_evidence(evidence[0], best[reading.x]) + saturated_evidence(
            evidence[1], best[reading.y]
        )
        if gain > 0:
            gain -= min(self._speed_cost(found), gain)
        odds = item.odds + gain + self._outwards(reading) + self._placed(reading, number)
        return dataclasses.replace(found, odds=odds)

    def _speed_cost(self, item: ScoredHypothesis) -> float:
        if self.clock.column is None:
            return 0.0
        return min(
            ratio_penalty(
                item.scale, UNITS[speed][1] * UNITS[tick][1] / UNITS[length][1], item.error
            )
            - math.log(likely * often * max(odds, 1e-9))
            for speed, likely in unit_probabilities(self.prior, "u", item.reading.u).items()
            for length, often in unit_probabilities(self.prior, "x", item.reading.x).items()
            for tick, odds in self.clock.units.items()
        )

    def _outwards(self, reading: Hypothesis) -> float:
        """A vessel drifts outwards in turns: v opposes r u."""
        if None in (reading.u, reading.v, reading.psi) or reading.earth:
            return 0.0
        inwards = []
        for record in self.windows.records:
            psi = np.unwrap(record.columns[reading.psi], period=reading.period)
            rate = reading.turn * np.gradient(psi, record.t)
            forward = reading.speeds[0] * record.columns[reading.u]
            sideways = reading.speeds[1] * record.columns[reading.v]
            inwards.append(correlation(rate * forward, sideways))
        return -1.5 * float(np.tanh(4 * np.mean(inwards)))

    def _placed(self, reading: Hypothesis, number: float) -> float:
        """Agreement with geographic positions, where the file has those besides."""
        if self.place is None or reading.x is None or reading.x in self.place:
            return 0.0
        north, east = (self.windows.of("increments", name) for name in self.place)
        true, moved = north + 1j * east, self.displacement(reading)
        if not np.any(np.abs(true) > 0) or not np.any(np.abs(moved) > 0):
            return 0.0
        share = max(float(shares_left(true[None], moved[None])[0][0, 0]), 0.01)
        return min(number * math.log(1 / share), _PLACED)


def _velocities(draft: UnsignedHypothesis) -> list[tuple]:
    """(u, v, sign of u, sign of v) in both orders and all signs."""
    if draft.u is None:
        return [(None, None, 1, 1)]
    if draft.v is None:
        return [(draft.u, None, sign, 1) for sign in (1, -1)]
    return [
        (*((draft.v, draft.u) if swapped else (draft.u, draft.v)), su, sv)
        for swapped, su, sv in all_orientations()[0]
    ]


def _oriented(a: np.ndarray, b: np.ndarray, pair: tuple[bool, int, int]) -> np.ndarray:
    swapped, first, second = pair
    return first * b + 1j * second * a if swapped else first * a + 1j * second * b


def _signed(draft: UnsignedHypothesis, pair, turn: int, quarter: int, option: tuple) -> Hypothesis:
    swapped, first, second = pair
    u, v, su, sv = option
    x, y = (draft.b, draft.a) if swapped else (draft.a, draft.b)
    return Hypothesis(
        x, y, (first, second), draft.headed.column, draft.headed.period, turn, quarter, u, v,
        (su, sv), draft.earth,
    )  # fmt: skip


def _near_best(items: list, within: float) -> list:
    """Those whose log odds are not far behind the best."""
    best = max(item.odds for item in items)
    return [item for item in items if item.odds >= best - within]
