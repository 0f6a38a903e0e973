"""Noise of a filter as fit.json has it: scales in SI units, by kind and channel."""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.filter.covariance import Noise
from diffsea.trajectory import MOTION_CHANNELS


NoiseRecord = dict[str, dict[str, float]]

_SPEEDS = MOTION_CHANNELS[3:]
_KINDS: Mapping[str, tuple[str, Sequence[str]]] = {
    "gust": ("gust", _SPEEDS),
    "lasting_gust": ("slow", _SPEEDS),
    "gust_memory": ("memory", _SPEEDS),
    "sensor": ("sensor", MOTION_CHANNELS),
    "position_walk": ("walk", ("position",)),
}


def noise_record(noise: Noise, measured: Bool[np.ndarray, "6"]) -> NoiseRecord:
    """The scales as they are written; of sensors, those whose channels were `measured`."""
    fixes = bool(measured[:2].any())
    shown = dict(zip(MOTION_CHANNELS, map(bool, measured), strict=True)) | {"position": fixes}
    gusts = ("gust", "lasting_gust", "gust_memory")
    return {
        kind: {
            channel: float(scale)
            for channel, scale in zip(names, np.exp(np.asarray(getattr(noise, part))), strict=True)
            if kind in gusts or shown[channel]
        }
        for kind, (part, names) in _KINDS.items()
    }


def noise_of_record(record: Mapping[str, Mapping[str, float]], guess: Noise) -> Noise:
    """The noise that a record tells of; `guess` where it has no such sensor or fixes may not walk.

    Raises:
        KeyError: it lacks one of the kinds, but for a walk of fixes.
        TypeError, ValueError, AttributeError: it is none.
    """
    told = {"position_walk": {}} | dict(record)

    def scales(kind: str) -> Float[Array, "channel"]:
        part, names = _KINDS[kind]
        known = np.exp(np.asarray(getattr(guess, part)))
        found = [told[kind].get(name, float(old)) for name, old in zip(names, known, strict=True)]
        return jnp.log(jnp.asarray(found, float))

    return Noise(**{part: scales(kind) for kind, (part, _) in _KINDS.items()})
