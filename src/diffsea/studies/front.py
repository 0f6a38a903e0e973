"""Designs that no other beats: the Pareto front of a sweep in some of its numbers."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from diffsea.errors import UserError, nearest_of


Goals = Mapping[str, Literal["least", "most"]]  # by number


def front(tables: Iterable[pd.DataFrame], goals: Goals) -> pd.DataFrame:
    """Designs that no other beats in one of some numbers without being beaten in another.

    Arguments:
        tables: rows of a sweep, part by part, of which but the front is held.
        goals: whether the least or the most of a number is wanted, by its name.

    **Returns:** the rows in the order of the first number; those that lack one of the numbers, as
    of designs that failed, are not among them.

    Raises:
        UserError: a goal that is no number of the sweep.
    """
    signs = np.array([1.0 if goal == "least" else -1.0 for goal in goals.values()])
    kept: pd.DataFrame | None = None
    for table in tables:
        require_numbers(goals, list(table.select_dtypes("number")))
        whole = table.dropna(subset=list(goals))
        rows = whole if kept is None else pd.concat([kept, whole])
        kept = rows.loc[unbeaten(rows[list(goals)].to_numpy(float) * signs)]
    if kept is None:
        return pd.DataFrame()
    order = np.lexsort((kept[list(goals)].to_numpy(float) * signs).T[::-1])
    return kept.iloc[order].reset_index(drop=True)


def require_numbers(names: Iterable[str], known: Sequence[str]) -> None:
    """Raise `UserError` for a name that is no number of a sweep."""
    for name in names:
        if name not in known:
            raise UserError(
                f"there is no number {name!r}{nearest_of(name, known, 'sweep.parquet')}"
            )


def unbeaten(costs: Float[np.ndarray, "design goal"]) -> Bool[np.ndarray, "design"]:
    """Which rows no other dominates: none is as low in every cost and lower in one.

    Of equal rows the first is taken.
    """
    found = np.zeros(len(costs), bool)
    best = np.empty((0, costs.shape[1]))
    for row in np.lexsort(costs.T[::-1]):  # what beats a row comes before it
        if not (best <= costs[row]).all(axis=1).any():
            found[row] = True
            best = np.vstack([best, costs[row]])
    return found


def goals_of(words: Sequence[str]) -> dict[str, Literal["least", "most"]]:
    """Goals as they are written: `NAME` for the least of a number, `NAME:most` for the most.

    Raises:
        UserError: another word behind the colon, or a number that is given twice.
    """
    goals: dict[str, Literal["least", "most"]] = {}
    for word in words:
        name, colon, goal = word.partition(":")
        if colon and goal not in ("least", "most"):
            raise UserError(f"{word!r}: write {name}:least or {name}:most")
        if name in goals:
            raise UserError(f"{name!r} is given twice")
        goals[name] = "most" if goal == "most" else "least"
    return goals
