"""Which effects a diagnosis considers, and how closely it looks at their shapes."""

import dataclasses

import numpy as np

from diffsea.identification.looks import Look
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect


def candidates(
    vessel: Vessel, recordings: list[Trajectory], per_run: bool = False
) -> tuple[Effect, ...]:
    """Effects of the catalogue that this vessel could have and its model lacks.

    What recordings would have to show and do not (heel) leaves an effect out. So do coefficients
    of the vessel's own that come with an environment, where each run has its own.
    """

    def recorded(channel: str) -> bool:
        return all(
            channel in run.extra and bool(np.isfinite(np.asarray(run.extra[channel])).any())
            for run in recordings
        )

    return tuple(
        effect
        for effect in EFFECTS.values()
        if effect.possible(vessel)
        and (not effect.needs or recorded(effect.needs))
        and not (per_run and effect.own and effect.idle)
    )


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
