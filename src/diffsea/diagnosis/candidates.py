"""Which effects a diagnosis considers, and at which sizes and shapes it looks at each."""

import dataclasses

import numpy as np

from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect


@dataclasses.dataclass(frozen=True)
class Look:
    """One way in which an effect may first be seen.

    `at` are its coordinates in prior sizes: zero but for a shape, which does nothing while the
    effect is absent, or for a finite size.
    """

    effect: str
    at: tuple[float, ...]
    moved: tuple[int, ...]  # coordinates to differentiate by; the first one where it is finite
    finite: bool = False


def candidates(vessel: Vessel, recordings: list[Trajectory]) -> tuple[Effect, ...]:
    """Effects of the catalogue that this vessel could have and its model lacks.

    What recordings would have to show and do not (heel) leaves an effect out.
    """

    def recorded(channel: str) -> bool:
        return all(
            channel in run.extra and bool(np.isfinite(np.asarray(run.extra[channel])).any())
            for run in recordings
        )

    return tuple(
        effect
        for effect in EFFECTS.values()
        if effect.possible(vessel) and (not effect.needs or recorded(effect.needs))
    )


def looks(
    effect: Effect,
    vessel: Vessel,
    recordings: tuple[Trajectory, ...],
    frequencies: np.ndarray | None = None,
) -> list[Look]:
    """All ways to look at one effect in these recordings.

    `frequencies` (Hz) are those at which a periodic effect is looked at.
    """
    sizes = effect.sizes(vessel)
    zero = [0.0] * len(sizes)
    moved = tuple(k for k in range(len(sizes)) if k != effect.shape)
    secants = [Look(effect.name, (size, *zero[1:]), (0,), True) for size in effect.finite]
    if effect.flat:
        return secants
    if effect.shape is None or effect.grid is None:
        return [Look(effect.name, tuple(zero), moved), *secants]
    spans = _spans(recordings)
    values = effect.grid(vessel, 0.0, sum(end - start for start, end in spans))
    if effect.periodic:
        values = tuple(() if frequencies is None else np.asarray(frequencies) - values[0])
    else:
        values = tuple(_recorded(spans, value) for value in values)
    out = []
    for value in values:
        at = list(zero)
        at[effect.shape] = value / sizes[effect.shape]
        out.append(Look(effect.name, tuple(at), moved))
    return out


def _spans(recordings: tuple[Trajectory, ...]) -> list[tuple[float, float]]:
    """Times (s, on the runs' clocks) at which anything was recorded: start and end of each span."""
    spans: list[tuple[float, float]] = []
    for start, end in sorted((float(run.t[0]), float(run.t[-1])) for run in recordings):
        if spans and start <= spans[-1][1]:
            spans[-1] = spans[-1][0], max(spans[-1][1], end)
        else:
            spans.append((start, end))
    return spans


def _recorded(spans: list[tuple[float, float]], after: float) -> float:
    """The time at which so many seconds have been recorded."""
    for start, end in spans:
        if after <= end - start:
            return start + after
        after -= end - start
    return spans[-1][1]


def shape_spacings(
    effects: tuple[Effect, ...], vessel: Vessel, tried: list[Look], resolution: float
) -> dict[str, float]:
    """Distance between neighbouring shapes to look at for each effect, in prior sizes.

    Between its looks, or the `resolution` (Hz) of a frequency; zero without a shape.
    """
    out = {}
    for effect in effects:
        out[effect.name] = 0.0
        if effect.shape is None:
            continue
        values = [look.at[effect.shape] for look in tried if look.effect == effect.name]
        out[effect.name] = float(np.median(np.diff(np.sort(values)))) if len(values) > 1 else 0.0
        if effect.periodic:
            out[effect.name] = resolution / effect.sizes(vessel)[effect.shape]
    return out


def nearby(effect: Effect, look: Look, spacing: float) -> list[Look]:
    """Looks at shapes around one, three to each side."""
    if effect.shape is None or spacing == 0:
        return []
    out = []
    for step in (-3, -2, -1, 1, 2, 3):
        at = list(look.at)
        at[effect.shape] += step * spacing
        out.append(dataclasses.replace(look, at=tuple(at)))
    return out
