"""What a diagnosis says of a model: what is missing, where, and what predictions gain by it.

The same sentences stand in the terminal and at the head of a page, so that they never differ.
`summary` is the content of diagnosis.json throughout.
"""

from diffsea.identification.holdout import HeldOut
from diffsea.identification.sufficiency import Shortfall
from diffsea.report.quantities import is_known, p_equals, significant
from diffsea.report.wording.horizons import (
    QUANTITIES,
    headline_horizon,
    known_quantities,
    two_digits,
    worsened,
)
from diffsea.report.wording.words import (
    Record,
    as_words,
    capital,
    enumeration,
    named_effects,
    phrases,
)


MODELS = ("nominal", "diagnosed")
SURE_REMAINDER = 0.01  # p-value below which structure is said to remain
LITTLE_LEFT = 0.2  # of an error, which is worth saying


def verdict_sentence(summary: Record) -> str:
    """What is missing, in one sentence."""
    effects = named_effects(summary)
    if summary["verdict"] == "consistent" and not effects:
        return (
            "The model agrees with the recordings: they show nothing that is missing from it "
            "beyond the values of its parameters. What it misses is put down to gusts and sensor "
            "noise; if it was calm, more than sensor noise means that something is missing."
        )
    if not effects and summary["verdict"] != "insufficient":
        where = "".join(f", strongest in {place}" for place in strongest_places(summary, 1))
        return (
            "The recordings show something that the model leaves out and that no effect known here "
            f"describes{where}."
        )
    if summary["verdict"] == "insufficient":
        why = enumeration([Shortfall(one).sentence for one in summary["insufficient"]])
        return f"The recordings do not tell whether the model lacks anything: {why}."
    what = enumeration(phrases(effects, with_rivals=True))
    if summary["verdict"] == "unexplained":
        return (
            f"The recordings show {what}, which the model leaves out, and something else "
            "that has no name here."
        )
    if summary["verdict"] == "ambiguous":
        return f"The model leaves out {what}."
    return f"The recordings show {what}, which the model leaves out."


def prediction_sentence(summary: Record) -> str:
    """What the diagnosis does to predictions of held-out runs, in one sentence."""
    held_out, found = summary["held_out"], named_effects(summary)
    parts = held_out.get("kind") == HeldOut.LAST_PARTS
    on = f"On {'the last part of each run,' if parts else 'runs'} kept back as a test"
    row = headline_horizon(held_out["horizons"], MODELS)
    if row is None:  # no run is long enough: the error of the next sample
        old, new = (summary["fit"][model].get("test") for model in MODELS)
        if not is_known(old) or not is_known(new):
            return "There was nothing held out to judge it by."
        after = f"{significant(new, 2)} times the noise"
        change = f"goes from {significant(old, 2)} to {after}" if found else f"is {after}"
        return f"{on}, the error of the next sample {change}."
    quantity = known_quantities(row, MODELS)[0]
    old, new = (row[model][quantity] for model in MODELS)
    before, after = (two_digits(value, QUANTITIES[quantity]) for value in (old, new))
    once = " (one prediction)" if row.get("starts") == 1 else ""
    what = f"{on}, the {quantity} predicted {row['seconds']:g} s ahead{once} is"
    if not found:
        return f"{what} off by {after}."
    if before == after or abs(new - old) < 0.02 * old:
        return f"{what} off by {after} with or without it."
    if new > old:
        return f"{what} off by {after} with what was found, worse than {before} without it."
    return f"{what} off by {after} with what was found, instead of {before}."


def unimproved_sentence(summary: Record) -> str:
    """Where what was found does not improve the predictions of held-out runs, or nothing.

    How far ahead the first quantity that was measured (position, else heading) is predicted no
    better, and how far ahead another one is predicted worse by more than a tenth.
    """
    if not named_effects(summary):
        return ""
    far, worse = [], []
    for row in summary["held_out"]["horizons"]:
        ahead = f"{row['seconds']:g} s"
        for number, quantity in enumerate(known_quantities(row, MODELS)):
            old, new = (row[model][quantity] for model in MODELS)
            if number == 0 and new >= old:
                far.append(ahead)
            elif number > 0 and quantity in worsened(row, MODELS):
                change = " -> ".join(two_digits(one, QUANTITIES[quantity]) for one in (old, new))
                worse.append(f"{quantity} {ahead} ahead ({change})")
    told = []
    if far:
        told.append(
            f"What was found explains single steps, but not the motion {enumeration(far)} ahead: "
            "predictions there are no better with it."
        )
    if worse:
        told.append(f"Predicted worse with it: {enumeration(worse)}.")
    return " ".join(told)


def remainder_sentence(summary: Record) -> str:
    """What the final model still does not explain, in one sentence."""
    p = summary["remainder_p_value"]
    if not is_known(p):
        return ""
    if p < SURE_REMAINDER:
        return (
            f"Structure remains in the residuals that the model does not explain ({p_equals(p)})"
            f"{_share_left(summary)}."
        )
    told = f"No significant structure remains in the residuals ({p_equals(p)})"
    if summary["verdict"] == "unexplained":
        return f"{told}, but runs held out are still predicted worse than noise explains."
    return f"{told}."


def _share_left(summary: Record) -> str:
    """How little of the error is left, where it is."""
    row = headline_horizon(summary["held_out"]["horizons"], MODELS)
    if row is None or not named_effects(summary):
        return ""
    quantity = known_quantities(row, MODELS)[0]
    old, new = (row[model][quantity] for model in MODELS)
    if not 0 < new <= LITTLE_LEFT * old:
        return ""
    share = f"{significant(100 * new / old, 2)} %"
    return f"; of the error of {quantity} {row['seconds']:g} s ahead {share} is left"


def single_step_sentence(summary: Record) -> str:
    """Names that were refused because free predictions of the motion get worse with them.

    Not those of which another kind was accepted.
    """
    refused = [row for row in summary["candidates"] if row.get("predicts_motion") is False]
    given = {one["name"] for one in named_effects(summary)}
    names = list(dict.fromkeys(as_words(r["name"]) for r in refused if r["name"] not in given))
    if not names:
        return ""
    verb = "explains" if len(names) == 1 else "explain"
    return (
        f"{capital(enumeration(names))} {verb} single steps, but not the motion: no name is given."
    )


def strongest_places(summary: Record, count: int = 3) -> list[str]:
    """Where the mismatch is, one line for each degree of freedom, strongest first.

    A window of one recording is named before a regime of all of them.
    """
    by_degree: dict[str, list[Record]] = {}
    for cell in summary["where"]:
        by_degree.setdefault(cell["degree_of_freedom"], []).append(cell)
    lines = []
    for degree, cells in by_degree.items():
        cell = next((c for c in cells if c["recording"] != "all"), cells[0])
        where = f"{cell['recording']} from {cell['start']:.0f} to {cell['end']:.0f} s"
        where = "all runs" if cell["recording"] == "all" else where
        regime = f", {cell['regime']}" if cell.get("in_regime", True) else ""
        force = f"{significant(cell['force_rms'], 2)} {cell['unit']}"
        lines.append(f"{degree}, {where}{regime} (about {force})")
    return lines[:count]
