"""What results rest on, a sentence each: what was left out, thinned, or tells of nothing."""

from collections.abc import Mapping, Sequence

from diffsea.report.wording.words import Record, enumeration
from diffsea.trajectory import in_words


def quick_sentence(not_done: Sequence[str]) -> str:
    """That this was a quick look, and what it has not done; or nothing."""
    if not not_done:
        return ""
    return f"A quick look. Not done: {'; '.join(not_done)}. Without --quick all of it is."


def incomplete_sentence(summary: Record) -> str:
    """That the search ended early, by the time or as a quick look, or nothing."""
    if not_done := summary.get("not_done"):
        return quick_sentence(not_done)
    if summary["complete"]:
        return ""
    told = "The time was over before everything had been asked: more may be missing."
    left_out = summary["left_out"]
    return f"{told} Left out: {enumeration(left_out)}." if left_out else told


def sampling_sentence(every: Mapping[str, int] | None) -> str:
    """Of which channels one sample in so many was used, and why; or nothing."""
    if not every:
        return ""
    used = enumeration(
        [f"one sample in {number} of {in_words([name])[0]}" for name, number in every.items()]
    )
    return f"Successive samples err alike, so that only {used} counted."


def straight_sentence(runs: int) -> str:
    """That nothing tells of the turning of so many runs; nothing where there are none."""
    if not runs:
        return ""
    which = "one run" if runs == 1 else f"{runs} runs"
    return f"Nothing tells of drift and turning in {which}, taken as straight ahead."


def side_sentences(sides: Sequence[Record]) -> list[str]:
    """Pairs of thrusters that a fit found to differ, a sentence each."""
    return [
        f"As fitted, {one['weaker']} pushes {one['ratio']:.2f} +- {one['std']:.2f} times as much "
        f"as {one['stronger']} at {one['share']:.0%} of full order."
        for one in sides
    ]
