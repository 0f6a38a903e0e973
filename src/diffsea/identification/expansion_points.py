"""Where an effect may first show itself: the sizes, shapes and times at which it is looked for."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect


Span = tuple[float, float]  # s, on the runs' clocks: start and end


@dataclasses.dataclass(frozen=True)
class ExpansionPoint:
    """One way in which an effect may first be seen.

    `at` are its coordinates in prior sizes: zero but for a shape, which does nothing while the
    effect is absent, or for a finite size.
    """

    effect: str
    at: tuple[float, ...]
    moved: tuple[int, ...]  # coordinates to differentiate by; the first one where it is finite
    finite: bool = False


def expansion_points(
    effect: Effect, vessel: Vessel, spans: list[Span], frequencies: np.ndarray | None = None
) -> list[ExpansionPoint]:
    """All ways to look at one effect in what was recorded during these spans.

    `frequencies` (Hz) are those at which a periodic effect is looked at.
    """
    sizes = effect.sizes(vessel)
    zero = [0.0] * len(sizes)
    moved = tuple(k for k in range(len(sizes)) if k not in (effect.shape, *effect.idle))
    secants = [ExpansionPoint(effect.name, (size, *zero[1:]), (0,), True) for size in effect.finite]
    if effect.flat:
        return secants
    if effect.shape is None or effect.grid is None:
        return [ExpansionPoint(effect.name, at, moved) for at in _at_rest(effect, zero)] + secants
    values = effect.grid(vessel, 0.0, sum(end - start for start, end in spans))
    if effect.periodic:
        values = tuple(() if frequencies is None else np.asarray(frequencies) - values[0])
    else:
        values = tuple(_recorded(spans, value) for value in values)
    out = []
    for value in values:
        at = list(zero)
        at[effect.shape] = value / sizes[effect.shape]
        out.append(ExpansionPoint(effect.name, tuple(at), moved))
    return out


def _at_rest(effect: Effect, zero: list[float]) -> list[tuple[float, ...]]:
    """Coordinates of an absent effect, with its idle ones at zero and at their places."""
    out = [tuple(zero)]
    for values in effect.places:
        at = list(zero)
        for k, value in zip(effect.idle, values, strict=True):
            at[k] = value
        out.append(tuple(at))
    return out


def merge_spans(spans: Iterable[Span]) -> list[Span]:
    """Spans in the order of time, those that overlap made one."""
    out: list[Span] = []
    for start, end in sorted(spans):
        if out and start <= out[-1][1]:
            out[-1] = out[-1][0], max(out[-1][1], end)
        else:
            out.append((start, end))
    return out


def _recorded(spans: list[Span], after: float) -> float:
    """The time at which so many seconds have been recorded."""
    for start, end in spans:
        if after <= end - start:
            return start + after
        after -= end - start
    return spans[-1][1]
