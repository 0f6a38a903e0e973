"""Hypotheses: models with one effect more, and what all data say of each."""

import dataclasses

import numpy as np

from diffsea.diagnosis.constancy import Constancy
from diffsea.diagnosis.screening import Candidate, mimicry
from diffsea.identification.estimates import Estimate
from diffsea.identification.free_predictions import MotionChange
from diffsea.identification.holdout import Gain
from diffsea.vessel.effects import EFFECTS, catalogue_name
from diffsea.vessel.effects.entry import Place


SIZE_LEVEL = 0.01  # of the test that a size is zero
NEARLY_ONE_SIZE = 0.5  # of what an effect explains is due to sizes that differ, at most


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A refitted model: the effects accepted so far and one more."""

    effect: str
    estimate: Estimate
    without: Estimate  # the model that has everything but the effect
    deviance_drop: float  # against the model without the effect, priors included
    occam: float  # what its room in the prior costs: -2 log of posterior over prior volume
    gain: Gain | None  # on held-out data; None where it was not fitted to its end
    candidate: Candidate
    is_physical: bool  # inside physical bounds, and a change within the recordings
    constancy: Constancy | None = None  # of its size; None where it was not fitted to its end
    instances: int = 1  # sets of coordinates: one for each run, for an environment of its own
    inflation: float = 1.0  # variance of its own scores over the information, at least one
    wald: float = np.inf  # Wald's statistic of its amounts: what the data lose if they were zero
    zero_p_value: float = 0.0  # of the same by errors that count correlation in time
    exchanged: Gain | None = None  # on the training data, with the held-out ones to train on
    motion: MotionChange | None = None  # of free predictions; None where not fitted to its end
    held_out_motion: MotionChange | None = None  # of the held-out runs, where the other is of all

    @property
    def predicts_motion(self) -> bool:
        """Whether free predictions of held-out runs get no worse with it, beyond chance."""
        return self.motion is None or not self.motion.is_worse

    @property
    def is_judged(self) -> bool:
        """Whether it is physical and was judged on held-out data."""
        return self.is_physical and self.gain is not None

    @property
    def has_one_size(self) -> bool:
        """Whether it was fitted to its end and has one size in all the data.

        Or one size predicts the motion better beyond chance, and explains most of what it does, or
        is, of a law of hull or actuators, that of every run: on real vessels laws hold nearly, a
        wind blows in gusts, and what else is missing comes and goes with the phases of a manoeuvre.
        """
        if self.constancy is not None and self.constancy.holds:
            return True
        return self.predicts_motion_better and self.has_nearly_one_size

    @property
    def is_there(self) -> bool:
        """Whether its size is not one that may as well be zero.

        Where a fit with it ends far better, and yet with none of it, the fit was what was worse.
        """
        return self.zero_p_value < SIZE_LEVEL

    @property
    def statistic(self) -> float:
        """How far it stands out, as a chi-squared: its score, or what its fit gained, if more."""
        return max(self.candidate.score.statistic, self.deviance_drop / self.inflation)

    @property
    def predicts_motion_better(self) -> bool:
        """Whether free predictions of all runs asked get better beyond chance.

        Or of the held-out ones, and probably of all.
        """
        if self.motion is None:
            return False
        alone = self.held_out_motion
        return self.motion.is_better or (alone is not None and alone.holds_by(self.motion))

    @property
    def has_nearly_one_size(self) -> bool:
        """Whether one size in all the data is to be believed, if it predicts the motion better."""
        if self.constancy is None:
            return False
        in_runs = self.constancy.same_in_runs and EFFECTS[self.effect].is_law
        predicts = in_runs and self.gain is not None and self.gain.clear
        return predicts or self.constancy.share < NEARLY_ONE_SIZE

    @property
    def is_undecided(self) -> bool:
        """Whether the runs held out are too few to say what is asked of them.

        They leave open whether single steps are predicted better; or the size is one only nearly,
        and is believed by the motion alone: that asks for as many runs as there are.
        """
        if self.constancy is None or self.gain is None or not self.predicts_motion:
            return False
        if self.constancy.holds:
            return self.gain.open
        is_tried = self.motion is not None and min(self.motion.ratio.values(), default=1.0) < 1.0
        may_be_gain = self.gain.open or self.gain.clear
        return is_tried and may_be_gain and self.has_nearly_one_size

    def is_part_of(self, other: "Hypothesis") -> bool:
        """Whether the other is this with something more, on the same channels."""
        return EFFECTS[self.effect].is_part_of(EFFECTS[other.effect])

    def is_plainer_than(self, other: "Hypothesis") -> bool:
        """Whether it is to be believed of two that are supported nearly as well.

        A part rather than the whole, a property of hull or actuators rather than the weather, and
        a law of the whole vessel rather than a record of an actuator that is off: no vessel is
        exactly what its file says, whereas weather is there or it is not, and a record right or
        wrong.
        """
        effect, beside = EFFECTS[self.effect], EFFECTS[other.effect]
        is_own = effect.is_law and beside.family == "environment"
        is_of_all = effect.is_law and (effect.family == "hull" or effect.place == Place())
        is_law = is_of_all and catalogue_name(other.effect) == "feedback-error"
        return is_own or is_law or self.is_part_of(other)

    def share_mimicked_by(self, other: "Hypothesis") -> float:
        """Share of its information that the other reproduces, to first order, 0 to 1."""
        return mimicry(self.candidate.columns, other.candidate.columns)

    def is_akin_to(self, other: "Hypothesis") -> bool:
        """Whether it has the other's name, or one of the two is part of the other."""
        is_same = catalogue_name(self.effect) == catalogue_name(other.effect)
        return is_same or self.is_part_of(other) or other.is_part_of(self)

    @property
    def size(self) -> int:
        """Coordinates that it adds."""
        return len(self.candidate.point.at) * self.instances

    @property
    def pooled_gain(self) -> Gain | None:
        """What all data say that were held out once."""
        if self.gain is None or self.exchanged is None:
            return self.gain
        return self.gain.pooled(self.exchanged)

    @property
    def has_held_out_support(self) -> bool:
        """Whether data speak for it that were held out once.

        What single steps leave open, which a few events that no model knows may spoil, free
        predictions decide.
        """
        gain = self.pooled_gain
        if gain is None or gain.clear:
            return gain is not None
        return gain.open and self.motion is not None and self.motion.is_probably_better

    @property
    def stands(self) -> bool:
        """Whether it has one size, predicts motion no worse, and held-out data speak for it."""
        is_sound = self.is_there and self.has_one_size and self.predicts_motion
        return is_sound and self.has_held_out_support

    def still_stands(self, needed: float) -> bool:
        """Whether an effect that held-out data spoke for once is still needed beside others.

        Then they may leave it open; against it speaks a lack of evidence, or their loss. Nor need
        it predict the motion better a second time, where its size is nearly one: what it shares
        with the others it does not show beside them.
        """
        if self.gain is None or self.constancy is None:
            return False
        if not (self.is_judged and self.is_there and self.predicts_motion):
            return False
        if not (self.constancy.holds or self.has_nearly_one_size):
            return False
        return self.evidence(self.inflation) > needed and (self.gain.open or self.gain.clear)

    def evidence(self, inflation: float) -> float:
        """Twice the log of the Bayes factor against the model without the effect (Laplace).

        `inflation` says how many dependent values count as one (of the best hypothesis:
        under a wrong one the dependence is the effect itself).
        """
        occam = max(self.occam - self.size * np.log(inflation), 0.0)
        return self.deviance_drop / inflation - occam

    def support(self, inflation: float) -> float:
        """Evidence and held-out gain together: what all data say; -inf where a run diverges.

        Of a gain counts what is beyond its error: where a few events spoil it, rivals differ by how
        they happen to meet these.
        """
        counted = 0.0 if self.gain is None else self.gain.sure
        out = self.evidence(inflation) + counted / inflation
        return out if np.isfinite(out) else -np.inf
