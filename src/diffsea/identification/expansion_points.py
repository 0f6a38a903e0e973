"""Where the residuals are expanded in an effect: the sizes and times at which it is looked for.

An absent effect is screened by derivatives. These need a point: its onset or frequency has to be
chosen, and what is strong soon is better seen by a secant than by the tangent at zero.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Coefficient, Effect
from diffsea.vessel.effects.coordinates import TimeSpan


@dataclasses.dataclass(frozen=True)
class ExpansionPoint:
    """One point at which the residuals are expanded in an effect.

    `at` are its coordinates in noticeable sizes: amounts are zero, unless this is a `secant` from
    the effect's absence to its size there. `directions` are the coordinates to differentiate by.
    """

    effect: str
    at: tuple[float, ...]
    directions: tuple[int, ...]
    secant: bool = False


def expansion_points(
    effect: Effect,
    vessel: Vessel,
    spans: Sequence[TimeSpan],
    frequencies: Float[np.ndarray, "peak"] | None = None,
) -> list[ExpansionPoint]:
    """All points for one effect in what was recorded during these spans of time.

    `frequencies` (Hz) are those at which an effect that swings is looked for.
    """
    absent = [0.0] * len(effect.coordinates)

    def at(place: int, value: float) -> tuple[float, ...]:
        return (*absent[:place], value, *absent[place + 1 :])

    tangents: list[tuple[float, ...]] = []
    if effect.scanned is not None:
        place, scanned = effect.scanned
        size = effect.sizes(vessel)[place]
        tangents += [at(place, v / size) for v in scanned.scan(vessel, spans, frequencies)]
    elif effect.leading.tangent:
        tangents.append(tuple(absent))
        for place, one in enumerate(effect.coordinates):
            trials = one.trials if isinstance(one, Coefficient) else ()
            tangents += [at(place, trial) for trial in trials]
    amounts = tuple(np.flatnonzero(effect.amounts).tolist())
    return [
        *(ExpansionPoint(effect.name, point, amounts) for point in tangents),
        *(ExpansionPoint(effect.name, at(0, s), (0,), True) for s in effect.leading.secants),
    ]


def merge_spans(spans: Iterable[TimeSpan]) -> list[TimeSpan]:
    """Spans in the order of time, those that overlap made one."""
    out: list[TimeSpan] = []
    for start, end in sorted(spans):
        if out and start <= out[-1][1]:
            out[-1] = out[-1][0], max(out[-1][1], end)
        else:
            out.append((start, end))
    return out
