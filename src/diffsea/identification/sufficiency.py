"""Whether data tell enough to say that a model agrees with them, and whether it does.

That nothing is found to be missing means little where parameters may be anything, or where held-out
runs are not predicted: then the data do not tell. A fit whose parameters are determined and which
nevertheless fails lacks something.
"""

import dataclasses
import enum
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.noise_fit import PLAUSIBLE_NOISE
from diffsea.identification.free_predictions import motion_misfit
from diffsea.identification.holdout import Split, held_out_coordinates
from diffsea.statistics import block_sums
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect


DETERMINED = 0.5  # share of a parameter's estimate that is due to the data
LEAST_SHARE = 0.5  # of the parameters that must be determined
LARGEST_MISFIT = 2.0  # mean square normalised innovation: twice the variance that noise explains
LARGEST_MISS = 4.0  # mean square over the expected one: off by twice what noise explains
LARGEST_COLOUR = 2.0  # long-run variance of innovations: means are twice as uncertain as they seem
LEVEL = 0.99  # of the tests
NEAR_BOUND = 0.01  # standard deviations from the bound of gusts, at which they are held by it
BLOCK_ROWS = 32  # rows whose innovations count as one
LAGS = 10  # rows at which innovations must not be correlated


class Shortfall(enum.StrEnum):
    """What a model that nothing was found to be missing from still owes."""

    PARAMETERS = "parameters"
    MISFIT = "misfit"
    MOTION = "motion"
    GUSTS = "gusts"

    @property
    def sentence(self) -> str:
        """In words."""
        return _SENTENCES[self]


_SENTENCES = {
    Shortfall.PARAMETERS: "most parameters are not determined by these recordings",
    Shortfall.MISFIT: "runs kept back are not predicted as well as the noise would allow",
    Shortfall.MOTION: "free predictions go further astray than gusts and sensor noise explain",
    Shortfall.GUSTS: "the fit needs gusts stronger than weather is for a vessel of this size",
}


@dataclasses.dataclass(frozen=True)
class Whiteness:
    """The portmanteau test of Ljung and Box (1978) on the most coloured channel of innovations.

    Attributes:
        p_value: chance of so much correlation among white ones, by the number of channels.
        colour: their long-run variance over the variance that noise explains, 1 at its level.
    """

    p_value: float
    colour: float

    @property
    def is_rejected(self) -> bool:
        """Whether they are coloured beyond chance, and enough to matter."""
        return self.p_value < 1 - LEVEL and self.colour > LARGEST_COLOUR


def whiteness(
    white: Float[np.ndarray, "row 6"], used: Bool[np.ndarray, "row 6"], run: Int[np.ndarray, "row"]
) -> Whiteness:
    """Test normalised innovations, zero where not `used`, for correlation within runs.

    At every lag at which a channel has two samples in one run; with white ones the sum of their
    products is normal, its variance the number of pairs times the square of the channel's own.
    """
    found = [Whiteness(1.0, 1.0)]
    channels = np.flatnonzero(used.any(0))
    for k in channels:
        w, seen = white[:, k], used[:, k]
        power = float((w**2).sum()) / seen.sum()
        statistic, freedom, colour = 0.0, 0, 1.0
        for lag in range(1, min(LAGS, len(w) - 1) + 1):
            pairs = int((seen[lag:] & seen[:-lag] & (run[lag:] == run[:-lag])).sum())
            if pairs > 1 and power > 0:
                same = run[lag:] == run[:-lag]
                correlation = float((w[lag:] * w[:-lag] * same).sum()) / (pairs * power)
                statistic, freedom = statistic + pairs * correlation**2, freedom + 1
                colour += 2 * (1 - lag / (LAGS + 1)) * correlation
        if freedom:
            chance = min(1.0, len(channels) * float(chi2.sf(statistic, freedom)))
            found.append(Whiteness(chance, colour * power))
    return min(found, key=lambda one: (not one.is_rejected, one.p_value))


@dataclasses.dataclass(frozen=True)
class Sufficiency:
    """How well a fitted model does on runs held out, and how well data determine it.

    Attributes:
        determined: share of the parameters that the data determine.
        misfit: mean square normalised innovation, one at the noise level.
        misfit_std: of it, from blocks of rows.
        motion: mean square miss of free predictions over what noise explains, by horizon (s).
        motion_limit: what chance or a small flaw of the noise may make of it, by horizon.
        whiteness: of the innovations.
        gusts: how far the strongest lasting gusts that the fit needs are above those expected for a
            vessel of this size, in standard deviations of their prior.
    """

    determined: float
    misfit: float
    misfit_std: float
    motion: dict[float, float]
    motion_limit: dict[float, float]
    whiteness: Whiteness
    gusts: float

    @property
    def shortfalls(self) -> tuple[Shortfall, ...]:
        """What keeps the model from being called in agreement with the data."""
        found = []
        if self.determined < LEAST_SHARE:
            found.append(Shortfall.PARAMETERS)
        # Also where the model diverges and there is no number.
        if not (self.misfit < LARGEST_MISFIT or self.misfit - 2 * self.misfit_std < 1.0):
            found.append(Shortfall.MISFIT)
        if not all(ratio < self.motion_limit[horizon] for horizon, ratio in self.motion.items()):
            found.append(Shortfall.MOTION)
        if self.gusts > PLAUSIBLE_NOISE - NEAR_BOUND:
            found.append(Shortfall.GUSTS)
        return tuple(found)

    @property
    def reasons(self) -> list[str]:
        """What in its predictions shows that something is missing, in words.

        Parameters that are not determined may be what predictions fail by.
        """
        found = self.shortfalls
        if Shortfall.PARAMETERS in found:
            return []
        told = []
        if Shortfall.MISFIT in found:
            times = math.sqrt(self.misfit)
            told.append(f"samples are off by {times:.2g} times the noise")
        if Shortfall.MOTION in found:
            by = max(self.motion, key=lambda h: self.motion[h] / self.motion_limit[h])
            times = math.sqrt(self.motion[by])
            told.append(
                f"free predictions are off by {times:.2g} times what gusts and noise explain "
                f"{by:g} s ahead"
                if math.isfinite(times)
                else f"free predictions diverge within {by:g} s"
            )
        # Free predictions that miss less than noise explains leave nothing to miss.
        noticed = not self.motion or max(self.motion.values()) > 1.0
        if self.whiteness.is_rejected and noticed:
            told.append("what is left over from sample to sample is no noise: it is correlated")
        return told

    def as_dict(self) -> dict[str, Any]:
        """The record of fit.json."""
        return {
            "determined": self.determined,
            "misfit": {
                "mean_square": self.misfit, "std": self.misfit_std, "limit": LARGEST_MISFIT
            },
            "motion": {
                f"{horizon:g}": {"ratio": ratio, "limit": self.motion_limit[horizon]}
                for horizon, ratio in self.motion.items()
            },
            "whiteness": {
                "p_value": self.whiteness.p_value,
                "level": 1 - LEVEL,
                "colour": self.whiteness.colour,
                "limit": LARGEST_COLOUR,
            },
            "gusts": {"deviations": self.gusts, "limit": PLAUSIBLE_NOISE},
        }  # fmt: skip


def sufficiency(data: Split, fitted: Estimate) -> Sufficiency:
    """Judge a fitted model on what is held out; `fitted` has the noise of a filter."""
    determined = float(np.mean(fitted.shrinkage >= DETERMINED)) if len(fitted.free) else 1.0
    run = data.test.run_filter(held_out_coordinates(data, fitted), fitted.noise)
    used, white = np.asarray(run.gains.used), np.asarray(run.white)
    rows, mean, scatter = used.any(1), 1.0, 0.0
    if rows.any():
        squares = (white**2).sum(1)[rows]
        sums = block_sums(np.stack([squares, used[rows].sum(1)], axis=1), BLOCK_ROWS)
        mean = float(sums[:, 0].sum() / sums[:, 1].sum())
        scatter = float(np.std(sums[:, 0] / sums[:, 1]) / np.sqrt(len(sums)))
    motion, limits = motion_misfit(data, fitted), {}
    for horizon in motion.ratio:
        freedom = 2 * max(motion.blocks[horizon], 1)
        limits[horizon] = max(LARGEST_MISS, float(chi2.ppf(LEVEL, freedom)) / freedom)
    colour = whiteness(white, used, np.asarray(data.test.dataset.run))
    # Of lasting gusts alone: a force that is missing lasts.
    prior, scales = data.train.prior, np.asarray(fitted.noise.scales)
    excess = float(np.max(((scales - prior.mean) / prior.spread)[3:6]))
    return Sufficiency(determined, mean, scatter, motion.ratio, limits, colour, excess)


def shortfalls(data: Split, fitted: Estimate) -> tuple[Shortfall, ...]:
    """What keeps a fitted model from being called in agreement with the data."""
    return sufficiency(data, fitted).shortfalls


@dataclasses.dataclass(frozen=True)
class FitVerdict:
    """Whether a fitted model describes its data, or something is missing.

    Attributes:
        runs: how it does on runs; None where trial numbers alone were fitted.
        numbers: chance that trial numbers with their errors lie so far off; None without any.
        is_held_out: whether the runs were held out.
        one_start: whether the fit had one start: another optimum may do better.
    """

    runs: Sufficiency | None
    numbers: float | None
    is_held_out: bool
    one_start: bool = False

    @property
    def reasons(self) -> list[str]:
        """Why something must be missing, in words; none where it need not be."""
        told = [] if self.runs is None else list(self.runs.reasons)
        if told and self.is_held_out:
            told[0] = f"on runs held out, {told[0]}"
        short = () if self.runs is None else self.runs.shortfalls
        if Shortfall.GUSTS in short and Shortfall.PARAMETERS not in short:
            told.append(Shortfall.GUSTS.sentence)
        if self.numbers is not None and self.numbers < 1 - LEVEL:
            told.append("trial numbers are further off than their errors allow")
        return told

    @property
    def missing(self) -> bool:
        """Whether the model does not describe the data."""
        return bool(self.reasons)

    @property
    def sentence(self) -> str:
        """In words, with what to do."""
        if self.missing:
            told = f"something is missing: {'; '.join(self.reasons)}. "
            if self.runs is None:
                return f"{told}`diffsea diagnose` names it from recordings"
            first = "`--starts 8` says whether a better fit was missed; if not, "
            named = "`diffsea diagnose` with the same vessel and recordings names it"
            return f"{told}{first if self.one_start else ''}{named}"
        if self.runs is not None and Shortfall.PARAMETERS in self.runs.shortfalls:
            return (
                "these data do not tell whether something is missing: most parameters rest on the "
                "vessel file"
            )
        return "nothing is missing as far as these data tell"

    def as_dict(self) -> dict[str, Any]:
        """The figures in fit.json."""
        runs = {} if self.runs is None else self.runs.as_dict()
        numbers = {} if self.numbers is None else {"trial_numbers": {"p_value": self.numbers}}
        return {**runs, **numbers, "held_out": self.is_held_out, "reasons": self.reasons}


def unmodelled_disturbances(vessel: Vessel, recordings: Sequence[Trajectory]) -> tuple[str, ...]:
    """Names of effects that surely act, as all recordings measured, and that a vessel lacks."""
    return tuple(
        effect.name
        for effect in EFFECTS.values()
        if effect.usual_coordinates
        and effect.possible(vessel)
        and not missing_channel(effect, vessel, recordings)
    )


def missing_channel(effect: Effect, vessel: Vessel, recordings: Sequence[Trajectory]) -> str:
    """A channel that an effect must have measured and some recording lacks; empty where none."""
    for run in recordings:
        measured = {**run.extra, **run.motion}
        for channel in effect.needs:
            if not np.isfinite(measured.get(channel, np.nan)).any():
                return channel
        for channel in effect.place.all_on(vessel) if effect.needs_feedback else ():
            if channel not in run.executed:
                return f"exec_{channel}"
    return ""
