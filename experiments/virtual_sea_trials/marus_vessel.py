"""The vessel before anything was fitted, what may move, and what may be uneven about it.

Table 1 gives length, beam, draught and mass. Everything else starts from a rule of thumb that
knows nothing of the trials: yaw inertia of a uniform bar, added masses and drag of a round
order of magnitude.
"""

import dataclasses
from typing import Any

from experiments.virtual_sea_trials import marus_published as published

import equinox as eqx

from diffsea import EFFECTS, Effect, Parameter, Vessel
from diffsea.parameters import hull_prior
from diffsea.vessel.effects import Size
from diffsea.vessel.files import Table, build
from diffsea.vessel.hull import Damping


ARM = 0.5  # m, thrusters off the centreline: not published, and a gauge of the yaw equation
AFT = -1.2  # m; a thrust straight ahead does not depend on it

HULL = {
    "length": published.LENGTH, "beam": published.BEAM, "draught": published.DRAUGHT,
    "mass": published.MASS, "x_G": 0.0,
    "I_z": published.MASS * published.LENGTH**2 / 12,
    "X_udot": -0.05 * published.MASS, "Y_vdot": -0.3 * published.MASS,
    "X_u": -100.0, "X_uu": -50.0, "X_vv": -100.0,
    "Y_v": -100.0, "Y_vv": -200.0, "Y_r": 0.0,
    "N_r": -100.0, "N_rr": -1000.0, "N_v": 0.0,
}  # fmt: skip
FREE = (
    "I_z", "X_udot", "Y_vdot", "X_u", "X_uu", "X_vv", "Y_v", "Y_vv", "Y_r", "N_r", "N_rr", "N_v",
)  # fmt: skip
_COUPLINGS = {"Y_r": 100.0, "N_v": 50.0}  # N s/rad and N s: a size that would be noticed


def document(hull: dict[str, float] = HULL, arm: float = ARM) -> Table:
    """The vessel's file, its thrusters `arm` m off the centreline."""
    thrusters = [
        {"name": side, "x": AFT, "y": sign * arm} for side, sign in (("port", -1), ("starboard", 1))
    ]
    return {
        "format": 1,
        "name": "marus_usv",
        "source": "started from Table 1 of Rezayan (2026) and rules of thumb",
        "hull": dict(hull),
        "thruster": thrusters,
    }


def start(arm: float = ARM) -> Vessel:
    """The vessel before the fit."""
    return build(document(arm=arm))


def parameters() -> tuple[Parameter, ...]:
    """What may move: within a factor of e where a number keeps its sign."""
    return tuple(_parameter(name) for name in FREE)


def _parameter(name: str) -> Parameter:
    if name in _COUPLINGS:
        return Parameter(name, 0.0, _COUPLINGS[name], 1.0, unit=hull_prior(name, 0.0).unit)
    prior = hull_prior(name, HULL[name], 1.0)
    return dataclasses.replace(prior, upper=0.0) if HULL[name] < 0 else prior


def _off_centre(vessel: Vessel, at) -> Vessel:
    """Both thrusters moved to starboard: the centre of gravity is off to port."""

    def change(part: Any) -> Any:
        return eqx.tree_at(lambda p: p.y, part, part.y + at[0])

    moved = {name: change(part) for name, part in vessel.actuators.items()}
    return eqx.tree_at(lambda v: v.actuators, vessel, moved)


def _trimmed(vessel: Vessel, at) -> Vessel:
    """A hull that is bent: a yaw moment with the square of the speed ahead."""
    forces = vessel.forces | {"bent-hull": Damping({"N_uu": at[0]})}
    return eqx.tree_at(lambda v: v.forces, vessel, forces)


OFF_CENTRE = Effect(
    "off-centre",
    "hull",
    (Size("y", "m", lambda vessel: 0.02 * float(vessel.rigid_body.beam)),),
    _off_centre,
    law="the centre of gravity off the middle between the thrusters by -y",
)
BENT_HULL = Effect(
    "bent-hull",
    "hull",
    (Size("N_uu", "N m s^2/m^2", 5.0),),
    _trimmed,
    law="N = N_uu u^2, as of a skewed hull or a fixed fin",
)

# What the catalogue has that can tell port from starboard on this vessel, and two of our own.
CANDIDATES: tuple[Effect, ...] = (
    *(EFFECTS[name] for name in (
        "thrust-asymmetry", "thruster-misalignment", "actuator-bias:port",
        "actuator-bias:starboard", "current",
    )),
    OFF_CENTRE,
    BENT_HULL,
)  # fmt: skip


def drag_at(hull: dict[str, float], speed: float) -> float:
    """Thrust (N) that holds a speed (m/s) straight ahead: closed form."""
    return -(hull["X_u"] * speed + hull["X_uu"] * speed * abs(speed))
