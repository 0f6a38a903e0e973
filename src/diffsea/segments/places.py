"""Repeats by place: trials of a vessel on a fixed route that began and ended alike.

After Gavrilin and Steen (2017): k-means on the positions of beginning and end. `groups` puts
together what was ordered alike; here it is what happened at one place of the route.
"""

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from jaxtyping import Float, Int

from diffsea.errors import UserError


_MOST_GROUPS = 12  # that are looked for; no route had more trials at different places
_RESTARTS = 10  # of k-means
_NEARLY_AS_GOOD = 0.02  # of silhouette, that fewer groups may be worse and still be preferred

Place = tuple[float, float, float, float]


def place_features(places: Sequence[Place]) -> Float[np.ndarray, "trial 4"]:
    """Beginning and end, north and east (m), without their mean, over one common spread.

    North and east keep their scale to each other: a degree of longitude is shorter than one of
    latitude, a metre is not.
    """
    table = np.asarray(places, float)
    if table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
        raise UserError("a place is four numbers: x and y (m) of beginning and end of a trial")
    table = table - table.mean(0)
    spread = float(np.sqrt(np.mean(table**2)))
    return table / spread if spread > 0 else table


def by_place(
    places: Sequence[Place], count: int | None = None, seed: int = 0
) -> Int[np.ndarray, "trial"]:
    """A group number for every trial, those of the largest group zero.

    Arguments:
        places: x, y (m) where each trial began and x, y where it ended.
        count: how many groups; None takes the number with the best silhouette, or the least
            number that is hardly worse.
        seed: of the starts of k-means.

    Raises `UserError` without scikit-learn, or for more groups than trials.
    """
    table = place_features(places)
    if count is not None and not 1 <= count <= len(table):
        raise UserError(f"{len(table)} trials cannot make {count} groups")
    if len(table) < 3 or count == 1:
        return np.zeros(len(table), int)
    labels = _place_labels(table, _best_count(table, seed) if count is None else count, seed)
    sizes = np.bincount(labels)
    rank = np.empty(len(sizes), int)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[labels]


def _place_labels(table: np.ndarray, count: int, seed: int) -> np.ndarray:
    return _sklearn_cluster().KMeans(count, n_init=_RESTARTS, random_state=seed).fit_predict(table)


def _best_count(table: np.ndarray, seed: int) -> int:
    """The number of groups by the mean silhouette (Rousseeuw 1987)."""
    from sklearn.metrics import silhouette_score

    most = min(_MOST_GROUPS, len(table) - 1)
    scores = [silhouette_score(table, _place_labels(table, k, seed)) for k in range(2, most + 1)]
    return 2 + int(np.flatnonzero(np.array(scores) > max(scores) - _NEARLY_AS_GOOD)[0])


def _sklearn_cluster() -> ModuleType:
    try:
        import sklearn.cluster
    except ImportError:
        raise UserError(
            "grouping trials by place needs scikit-learn: pip install 'diffsea[places]'"
        ) from None
    return sklearn.cluster
