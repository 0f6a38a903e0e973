"""Whether the thrusters of one side push as the other's do, where a fit has both freely."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.identification.coordinates import vessel_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.actuators.thrusters import FixedThruster
from diffsea.vessel.base import Vessel


SHARES = np.linspace(0.2, 1.0, 9)  # of full order ahead, at one of which sides are compared
CERTAIN = 3.0  # standard errors beyond which sides differ
WORTH_TELLING = 0.03  # of the stronger side's thrust: less is usual between motors of a kind


class SideRatio(NamedTuple):
    """Thrust (N) of one thruster over that of its mirror image, ahead at the same order."""

    weaker: str
    stronger: str
    ratio: float
    std: float
    share: float  # of full order, where the ratio is best known


def differing_sides(problem: Problem, fitted: Estimate) -> list[SideRatio]:
    """Pairs of thrusters that a fit found to differ for certain, and by what is worth telling.

    Thrusters on both sides of one place whose full thrusts are free. Errors are by the covariance
    of the fit, to first order: what moves both sides alike does not count.
    """
    pairs = _free_pairs(problem.base, fitted.free)
    if not pairs:
        return []
    at = jnp.asarray(fitted.coordinates)

    def log_ratios(free: Float[Array, "free"]) -> Float[Array, "pair share"]:
        vessel, _ = vessel_at(problem.base, problem.layout, at.at[fitted.index].set(free))
        return jnp.stack([jnp.log(_thrust(vessel, a) / _thrust(vessel, b)) for a, b in pairs])

    free = at[fitted.index]
    values, slopes = (
        np.asarray(jax.jit(one)(free)) for one in (log_ratios, jax.jacfwd(log_ratios))
    )
    found = []
    for (one, other), value, J in zip(pairs, values, slopes, strict=True):
        stds = np.sqrt(np.einsum("sf,fg,sg->s", J, fitted.covariance, J))
        best = int(np.argmin(stds))
        size, std = float(value[best]), float(stds[best])
        names = (one, other) if size < 0 else (other, one)
        ratio = float(np.exp(-abs(size)))
        if abs(size) > CERTAIN * std and 1 - ratio > WORTH_TELLING:
            found.append(SideRatio(*names, ratio, ratio * std, float(SHARES[best])))
    return found


def _free_pairs(vessel: Vessel, free: Sequence[str]) -> list[tuple[str, str]]:
    """Thrusters to port and starboard of one place, both with a full thrust that is free."""
    parts = {
        name: part
        for name, part in vessel.actuators.items()
        if isinstance(part, FixedThruster) and f"{name}.thrust_curve.full_thrust" in free
    }
    return [
        (one, other)
        for one, other in itertools.combinations(parts, 2)
        if float(parts[one].x) == float(parts[other].x)
        and float(parts[one].y) == -float(parts[other].y) != 0.0
    ]


def _thrust(vessel: Vessel, name: str) -> Float[Array, "share"]:
    """Thrust at rest (N) at all shares of full order."""
    part = vessel.actuators[name]
    assert isinstance(part, FixedThruster) and part.drive.thrust_curve is not None
    thrust = jax.vmap(part.drive.thrust_curve.thrust)(jnp.asarray(SHARES))
    return jnp.asarray(thrust * (1 + part.losses.asymmetry))
