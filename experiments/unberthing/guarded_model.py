"""The cure: recursive least squares on the ship's own equations, behind trust and gate.

What is estimated: how much force the two thrusters make of an order, and one steady force and
moment for wind, current and whatever else pushes. Masses are the anchor. A thruster whose force has
changed its sign is then five standard deviations off its prior, and a push that comes with the tide
has a place of its own to go to.
"""

from experiments.unberthing.harbour_ship import PERIOD, nominal

import equinox as eqx
import jax.numpy as jnp

from diffsea import Parameter, State, Vessel, replace
from diffsea.identification.online.guarded import Gate, GuardedEstimator, GuardedState
from diffsea.identification.online.rls import recursive_least_squares
from diffsea.identification.online.trust import TrustLimits, trust_limits
from diffsea.vessel.forces import SteadyForce


MEMORY = 120.0  # s of forgetting
BANDWIDTH = 0.2  # rad/s, of the filters: sway noise below it, thrusters' changes within it
LASTING = 5.0  # s that a gust lasts in the residual
WINDOW = 30.0  # s of the trust, and of the quarantine
REOPEN = 0.6  # trust that opens the gate: while leaving, the thrusters rest and tell nothing
NEVER = 1e3  # m/s, at which thrusters that do not fade are down to half
NOISE = (1.5e3, 2.5e3, 4.0e4)  # N, N, N m: residual of the leaving phase on development seeds

FREE = (
    Parameter("bow.effectiveness", 1.0, scale=1.0, spread=0.2),
    Parameter("stern.effectiveness", 1.0, scale=1.0, spread=0.2),
    Parameter("steady.north", 0.0, scale=1e4, spread=1.0, unit="N"),
    Parameter("steady.east", 0.0, scale=1e4, spread=1.0, unit="N"),
    Parameter("steady.moment", 0.0, scale=2e5, spread=1.0, unit="N m"),
)


def model_vessel(fading: bool = True) -> Vessel:
    """The nominal ship in calm water with a steady force at zero; without `fading` her thrusters
    push as hard at any speed."""
    vessel = nominal()
    if not fading:
        vessel = replace(vessel, dict.fromkeys(("bow.fading_speed", "stern.fading_speed"), NEVER))
    forces = {n: f for n, f in vessel.forces.items() if n != "wind"} | {"steady": SteadyForce()}
    return eqx.tree_at(lambda v: v.forces, vessel, forces, is_leaf=lambda x: x is vessel.forces)


def guard(
    limits: TrustLimits | None = None, fading: bool = True
) -> tuple[GuardedEstimator, GuardedState]:
    """The estimator behind its gate, before the first measurement."""
    estimator = recursive_least_squares(
        model_vessel(fading),
        FREE,
        memory=MEMORY,
        bandwidth=BANDWIDTH,
        disturbance_memory=LASTING,
        noise=NOISE,
        interval=PERIOD,
    )
    if limits is None:
        limits = trust_limits(estimator.vessel, estimator.parameters, estimator.channels, WINDOW)
    guarded = GuardedEstimator(estimator, limits, Gate(limits.window, reopen=jnp.asarray(REOPEN)))
    return guarded, guarded.init(estimator.init(State(*jnp.zeros(6))))
