"""Units of the best reading, and the sampling interval that it implies."""

import math

from diffsea.recordings.mapping_proposal.clock import TimeColumn
from diffsea.recordings.mapping_proposal.readings import (
    HypothesisPrior,
    ratio_penalty,
    unit_probabilities,
)
from diffsea.recordings.mapping_proposal.search import ScoredHypothesis
from diffsea.recordings.mappings import UNITS


_ODD_SCALE = 4.0  # log odds against a ratio that is that of no units


class SettledUnits:
    """Units of the best reading: those whose ratios are the measured ones.

    `tick`, `r`, `x` and `u` are units, `sure` has their probabilities by channel, and `step` is
    the sampling interval (s) of a file without time, NaN where nothing tells it.
    """

    def __init__(self, prior: HypothesisPrior, clock: TimeColumn, best: ScoredHypothesis):
        reading = best.reading
        options = {
            channel: unit_probabilities(prior, channel, getattr(reading, channel))
            for channel in ("x", "u", "r")
            if getattr(reading, channel) is not None
        }
        table: dict[tuple, float] = {}
        for tick, likely in clock.units.items():
            for r, rate in options.get("r", {"": 1.0}).items():
                for x, length in options.get("x", {"": 1.0}).items():
                    for u, speed in options.get("u", {"": 1.0}).items():
                        odds = math.log(max(likely * rate * length * speed, 1e-12))
                        odds -= sum(unit_penalties(best, clock, tick, r, x, u))
                        table[tick, r, x, u] = odds
        chosen = max(table, key=lambda key: table[key])
        top = table[chosen]
        total = sum(math.exp(odds - top) for odds in table.values())
        self.tick, self.r, self.x, self.u = chosen
        self.sure = {}
        for place, name in enumerate(("t", "r", "x", "u")):
            alike = [odds for key, odds in table.items() if key[place] == chosen[place]]
            self.sure[name] = sum(math.exp(odds - top) for odds in alike) / total
        yaw, speed = unit_penalties(best, clock, *chosen)
        self.sure["r"] *= probability_of_units(yaw)
        for name in ("x", "u"):
            self.sure[name] *= probability_of_units(speed)
        self.sure |= {"y": self.sure["x"], "v": self.sure["u"], "psi": 1.0}
        self.step = clock.step
        if clock.column is None and not math.isfinite(clock.step):
            self.step = self._estimated(best)

    def _estimated(self, best: ScoredHypothesis) -> float:
        """The sampling interval (s) that makes the kinematics right, NaN where none tells."""
        steps = []
        if best.yaw is not None and best.reading.r is not None and best.yaw.evidence > 5:
            turn = 2 * math.pi / best.reading.period
            steps.append(abs(best.yaw.gain) * turn / UNITS[self.r][1])
        if math.isfinite(best.scale) and best.scale > 0 and min(best.left) < 0.2 and self.u:
            steps.append(best.scale * UNITS[self.x][1] / UNITS[self.u][1])
        if not steps or max(steps) > 1.2 * min(steps):
            return math.nan
        return float(f"{sum(steps) / len(steps):.2g}")


def unit_penalties(
    best: ScoredHypothesis, clock: TimeColumn, tick: str, r: str, x: str, u: str
) -> tuple[float, float]:
    """What these units cost, given the measured ratios of yaw and of displacement."""
    yaw = speed = 0.0
    if clock.column is None:
        return yaw, speed
    second = UNITS[tick][1]
    if r and best.yaw is not None and best.reading.psi and best.yaw.evidence > 0:
        expected = UNITS[r][1] * second * best.reading.period / (2 * math.pi)
        yaw = min(ratio_penalty(abs(best.yaw.gain), expected, best.yaw.error), best.yaw.evidence)
    if u and x and min(best.left) < 1:
        speed = ratio_penalty(best.scale, UNITS[u][1] * second / UNITS[x][1], best.error)
    return yaw, speed


def probability_of_units(cost: float) -> float:
    """Probability that units of such a cost are right, against a scale nobody has a name for."""
    return 1 / (1 + math.exp(cost - _ODD_SCALE))
