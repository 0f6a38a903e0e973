"""What the data determine, what only the prior does, and what goes together."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from diffsea.identification.estimates import Estimate
from diffsea.parameters import Parameter


STRONG_CORRELATION = 0.9  # correlation from which two parameters are known only together
LEAST_DETERMINED = 0.5  # share of a direction that the data must determine


@dataclasses.dataclass(frozen=True)
class Direction:
    """A combination of parameters, in units of their priors' standard deviations."""

    weights: dict[str, float]  # unit vector, small entries left out
    determined: float  # share of its variance that the data remove, 0 to 1

    @property
    def sentence(self) -> str:
        """The direction in words."""
        terms = [f"{w:+.2f} {name}" for name, w in self.weights.items()]
        combination = " ".join(terms).lstrip("+")
        return f"{combination} (the data determine {100 * self.determined:.0f} % of it)"


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Directions that the data leave to the prior, and groups that are known only together."""

    undetermined: tuple[Direction, ...]  # the worst first
    groups: tuple[tuple[str, ...], ...]
    condition: float  # ratio of the best to the worst determined direction's precision

    @property
    def sentences(self) -> list[str]:
        """What a user should know, in words; empty where all is well."""
        told = [f"not determined: {direction.sentence}" for direction in self.undetermined]
        for group in self.groups:
            told.append(
                f"known only together: {', '.join(group)} (correlated beyond "
                f"{STRONG_CORRELATION:g}; one may be far off if another is)"
            )
        return told

    def as_dict(self) -> dict:
        """The record of fit.json."""
        return {
            "undetermined": [dataclasses.asdict(d) for d in self.undetermined],
            "correlated_groups": [list(group) for group in self.groups],
            "condition": self.condition,
            "messages": self.sentences,
        }


def identifiability(parameters: Sequence[Parameter], fitted: Estimate) -> Identifiability:
    """Judge an estimate's vessel parameters, effects and environments left aside.

    The information of the data, deflated by the misfits' colour, is compared with that of the
    prior in each of its principal directions.
    """
    names = [p.name for p in parameters]
    chosen = [n for n, k in enumerate(fitted.index) if k < len(names)]
    if not chosen:
        return Identifiability((), (), 1.0)
    free = [names[fitted.index[n]] for n in chosen]
    spreads = np.array([parameters[fitted.index[n]].spread for n in chosen])
    information = _marginal(fitted.information, chosen) / fitted.inflation
    values, vectors = np.linalg.eigh(spreads[:, None] * information * spreads)
    values = np.maximum(values, 0.0)
    weak = tuple(
        Direction(_weights(free, vectors[:, k]), float(value / (1 + value)))
        for k, value in enumerate(values)
        if value / (1 + value) < LEAST_DETERMINED
    )
    covariance = fitted.covariance[np.ix_(chosen, chosen)]
    std = np.sqrt(np.diag(covariance))
    groups = _groups(free, np.abs(covariance / np.outer(std, std)))
    return Identifiability(weak, groups, float((1 + values[-1]) / (1 + values[0])))


def _marginal(information: np.ndarray, chosen: list[int]) -> np.ndarray:
    """Information on some coordinates when the others are estimated too."""
    others = [k for k in range(len(information)) if k not in chosen]
    own = information[np.ix_(chosen, chosen)]
    if not others:
        return own
    mixed = information[np.ix_(chosen, others)]
    return own - mixed @ np.linalg.pinv(information[np.ix_(others, others)]) @ mixed.T


def _weights(names: list[str], vector: np.ndarray) -> dict[str, float]:
    vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
    order = np.argsort(-np.abs(vector))
    kept = [k for k in order if abs(vector[k]) > 0.25 * abs(vector[order[0]])]
    return {names[k]: float(vector[k]) for k in kept}


def _groups(names: list[str], correlation: np.ndarray) -> tuple[tuple[str, ...], ...]:
    """Connected components of strong correlation."""
    left, found = set(range(len(names))), []
    while left:
        group, fresh = set(), {left.pop()}
        while fresh:
            group |= fresh
            strong = correlation[sorted(fresh)] > STRONG_CORRELATION
            fresh = {int(k) for k in np.flatnonzero(strong.any(0))} - group
        left -= group
        if len(group) > 1:
            found.append(tuple(names[k] for k in sorted(group)))
    return tuple(sorted(found))
