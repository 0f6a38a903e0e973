"""Several logs of one boat together: how she answers, and what all of them leave open."""

import dataclasses
from collections import Counter
from collections.abc import Sequence

from diffsea.checks.answers import Answers, answers_of
from diffsea.checks.log_check import LogCheck
from diffsea.checks.open_questions import OpenQuestion, next_length, next_minutes, open_questions
from diffsea.checks.shares import OrderScale, in_shares, joint_scales, orders_of
from diffsea.recordings.conditioning import cut


@dataclasses.dataclass(frozen=True)
class PooledCheck:
    """What logs of one boat show together.

    Attributes:
        names: of the logs.
        scales: of their orders, in each.
        commanded: whether orders were recorded, rather than executed actuation alone.
        reversed_turning: whether the audit of any says that orders turn it the other way.
    """

    names: tuple[str, ...]
    scales: tuple[dict[str, OrderScale], ...]
    commanded: bool
    reversed_turning: bool
    answers: Answers
    cannot_tell: tuple[OpenQuestion, ...]

    @property
    def next(self) -> list[OpenQuestion]:
        """What to record in the next minutes."""
        return next_minutes(self.cannot_tell, next_length(self.answers))

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json, in `together`."""
        return {
            "logs": list(self.names),
            "shows": self.answers.as_dict(),
            "cannot_tell": [one.as_dict() for one in self.cannot_tell],
            "next": {
                "seconds": next_length(self.answers),
                "record": [one.record for one in self.next],
            },
        }


def check_together(checks: Sequence[LogCheck]) -> PooledCheck | None:
    """What the logs show together that have the same orders, most of them; None of a single one.

    Full order is the same in all of them, and an answer counts whichever log it is in.
    """
    ordered = [one for one in checks if one.used and (one.run.commanded or one.run.executed)]
    orders = [frozenset(one.run.commanded or one.run.executed) for one in ordered]
    if not orders:
        return None
    common = Counter(orders).most_common(1)[0][0]
    alike = [one for one, own in zip(ordered, orders, strict=True) if own == common]
    scales = joint_scales([one.scales for one in alike])
    shares = [in_shares(one.corrected, own) for one, own in zip(alike, scales, strict=True)]
    if len(alike) < 2 or any(orders_of(run) is None for run in shares):
        return None
    spans = [one.used for one in alike]
    answers = answers_of(list(zip(shares, spans, strict=True)))
    whole = [cut(run, used[0][0], used[-1][1]) for run, used in zip(shares, spans, strict=True)]
    trials = [trial for one in alike for trial in one.trials]
    missing = [text for text in alike[0].missing if all(text in one.missing for one in alike)]
    return PooledCheck(
        names=tuple(one.name for one in alike),
        scales=tuple(scales),
        commanded=bool(alike[0].run.commanded),
        reversed_turning=any(one.reversed_turning for one in alike),
        answers=answers,
        cannot_tell=tuple(open_questions(whole, answers, trials, missing, is_judged=True)),
    )
