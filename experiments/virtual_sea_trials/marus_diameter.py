"""Can the steady turning diameter exceed the tactical one?

With U the speed, r the yaw rate, beta the drift angle (bow into the turn) and psi the change of
heading, the path runs at the angle psi - beta, so that

    D_T = integral from 0 to pi of (U / r) sin(psi - beta) d psi.

The tactical diameter is read when the *heading* has changed by 180 deg; the path has then
turned by beta less. Were radius and drift the steady ones from the start, D_T would be
D cos(beta). A radius that is larger at first makes D_T larger, drift makes it smaller.
"""

import dataclasses
import math

from experiments.virtual_sea_trials import marus_fit, marus_vessel
from experiments.virtual_sea_trials import marus_published as published

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import TrialPlan, replace
from diffsea.identification.objectives.trial_numbers import TrialNumbers
from diffsea.simulation import planning


SPREAD = 0.7  # of the draws, in prior widths: half to twice, about
SECONDS, STEP = 200.0, 0.1  # s


def least_drift(run: published.Run) -> float:
    """Drift (rad) that the published diameters need where the radius is never below the steady."""
    numbers = run.numbers
    ratio = numbers["tactical_diameter"] / numbers["steady_turning_diameter"]
    return math.acos(min(ratio, 1.0))


def draws(count: int, seed: int = 1) -> Float[np.ndarray, "draw coordinate"]:
    """Vessels around the rules of thumb, not around the fit: coordinates of the prior."""
    parameters = marus_vessel.parameters()
    spreads = np.array([p.spread for p in parameters])
    return SPREAD * spreads * np.random.default_rng(seed).normal(size=(count, len(parameters)))


def circles(coordinates: Float[np.ndarray, "draw coordinate"]) -> dict[str, np.ndarray]:
    """Circles to starboard of many vessels: ratio D_T / D, drift, speed loss; finite ones only."""
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), marus_vessel.start())
    run = published.RUNS[1]
    plan = marus_fit.plan_of(run, marus_vessel.start())
    settings = dataclasses.replace(plan.settings, seconds=SECONDS, step=STEP)
    found = _circles(vessel, jnp.asarray(coordinates), dataclasses.replace(plan, settings=settings))
    columns = {name: np.asarray(column) for name, column in found.items()}
    good = np.all([np.isfinite(column) for column in columns.values()], axis=0)
    good &= columns["turned"] >= 3 * math.pi - 1e-6
    return {name: column[good] for name, column in columns.items()}


@eqx.filter_jit
def _circles(vessel, coordinates: Array, plan: TrialPlan) -> dict[str, Array]:
    parameters = marus_vessel.parameters()

    def one(at: Array) -> dict[str, Array]:
        values = {p.name: p.decode(at[k]) for k, p in enumerate(parameters)}
        trial = planning.run_plan(replace(vessel, values), plan)
        numbers = planning.trial_numbers(plan, trial)
        last = trial.trajectory
        keep = ("tactical_diameter", "steady_turning_diameter", "speed_loss", "final_speed",
                "steady_yaw_rate")  # fmt: skip
        return {name: numbers[name] for name in keep} | {
            "drift": jnp.arctan2(-last.v[-1], last.u[-1]),
            "turned": last.psi[-1],
        }

    return jax.vmap(one)(coordinates)


def feasibility() -> dict[str, float]:
    """Whether the peak rates of the zig-zags go with the circles, by the published figures.

    The exponent of the peak rate in the order; the rate that it gives for a circle (deg/s), the
    speed that the published diameters then need (m/s), and the share of the approach's lost.
    """
    zigzags = {run.angle: run.numbers["peak_yaw_rate"] for run in published.RUNS if run.heading}
    circles_ = [run for run in published.RUNS if not run.heading]
    (small, slow), (large, fast) = sorted(zigzags.items())
    exponent = math.log(fast / slow) / math.log(large / small)
    rate = fast * (published.LARGEST_ANGLE / large) ** exponent
    radius = (
        0.5
        * published.LENGTH
        * float(np.mean([run.numbers["steady_turning_diameter"] for run in circles_]))
    )
    speed = math.radians(rate) * radius
    approach = float(np.mean([run.speed for run in circles_]))
    return {"exponent": exponent, "rate": rate, "speed": speed, "loss": 1 - speed / approach}


def slopes_of_ratio(objective: TrialNumbers, coordinates: np.ndarray) -> dict[str, float]:
    """Derivative of log(D / D_T) by every parameter's coordinate, exact; circle to starboard."""
    gradient = _gradient(objective, coordinates)[: len(objective.parameters)]
    names = [p.name for p in objective.parameters]
    return dict(zip(names, map(float, gradient), strict=True))


def _gradient(objective: TrialNumbers, coordinates: np.ndarray) -> np.ndarray:
    """Gradient of log(D / D_T) of the circle to starboard."""
    white, J = objective.misfits_and_jacobian(coordinates)
    values = np.concatenate([s.values + s.stds * 0 for s in objective.trials])
    stds = np.concatenate([s.stds for s in objective.trials])
    first = len(objective.trials[0].names)
    names = objective.trials[1].names
    tactical = first + names.index("tactical_diameter")
    steady = first + names.index("steady_turning_diameter")
    found = values + stds * white
    by = stds[:, None] * J / found[:, None]
    return by[steady] - by[tactical]
