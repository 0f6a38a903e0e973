"""Errors of free predictions in words: how far ahead, of what, and which to quote."""

from collections.abc import Mapping, Sequence

from diffsea.report.quantities import is_known, round_to_error
from diffsea.report.wording.words import Record


HEADLINE_SECONDS = 20  # ahead: far enough for errors to grow, short enough for most runs
WORSE = 1.1  # times an error before, which chance alone hardly gives
QUANTITIES = {"position": "m", "heading": "rad"}  # whose errors are quoted


def headline_horizon(rows: Sequence[Record], models: Sequence[str]) -> Record | None:
    """The row of errors to quote: 20 s ahead, else the longest horizon that there is."""
    rows = [row for row in rows if known_quantities(row, models)]
    preferred = [row for row in rows if row["seconds"] == HEADLINE_SECONDS]
    return (preferred or rows[-1:] or [None])[0]


def known_quantities(row: Record, models: Sequence[str]) -> list[str]:
    """Position and heading, as far as all models have an error of them."""
    return [one for one in QUANTITIES if all(is_known(row[model].get(one)) for model in models)]


def worsened(row: Record, models: Sequence[str]) -> list[str]:
    """Quantities whose error grew, from the first model to the last, by more than a tenth."""
    first, last = row[models[0]], row[models[-1]]
    return [one for one in known_quantities(row, models) if last[one] > WORSE * first[one]]


def horizon_line(row: Record, models: Sequence[str]) -> str:
    """`20 s ahead: position 3.9 m -> 0.5 m, heading 12 deg -> 1.1 deg`, and what diverged.

    Arguments:
        row: of `comparison.horizon_table`.
        models: keys of the row, the result last.
    """
    parts = []
    for quantity in known_quantities(row, models):
        errors = [two_digits(row[model][quantity], QUANTITIES[quantity]) for model in models]
        parts.append(f"{quantity} {' -> '.join(errors)}")
    ahead, diverged = f"{row['seconds']:g} s ahead", diverged_predictions(row, models)
    if parts:
        return f"{ahead}: {', '.join(parts)}{diverged}"
    return f"{ahead}: nothing to compare{diverged}" if diverged else ""


def diverged_predictions(row: Record, models: Sequence[str]) -> str:
    """` (3 -> 0 of 20 diverge)` where predictions of any model do, whose errors are not counted."""
    counts = [int(row[model].get("diverged", 0)) for model in models]
    said = " -> ".join(map(str, counts))
    return f" ({said} of {row['starts']} diverge)" if any(counts) else ""


def persistence_sentence(
    predicted: Mapping[float, Mapping[str, float]], kept_up: Mapping[float, Mapping[str, float]]
) -> str:
    """A warning where a model is noticeably worse than going on as before, else nothing.

    At the horizon that is quoted, in the first quantity that was measured.

    Arguments:
        predicted: errors of a model by horizon (s), as `horizon_errors` has them.
        kept_up: those of going on as before, as `persistence_errors` has them.
    """
    both = [
        {"seconds": seconds, "predicted": errors, "kept up": kept_up[seconds]}
        for seconds, errors in predicted.items()
    ]
    row = headline_horizon(both, ("predicted", "kept up"))
    if row is None:
        return ""
    name = known_quantities(row, ("predicted", "kept up"))[0]
    model, kept = (row[one][name] for one in ("predicted", "kept up"))
    if not model > WORSE * kept:
        return ""
    off, before = (two_digits(one, QUANTITIES[name]) for one in (model, kept))
    return (
        f"the {name} {row['seconds']:g} s ahead is off by {off}, and would be by {before} if the "
        "boat went on as before, whatever is ordered: the vessel file tells nothing of this motion"
    )


def two_digits(value: float, unit: str) -> str:
    """An error with two significant digits."""
    return round_to_error(value, 0.1 * abs(value), unit)
