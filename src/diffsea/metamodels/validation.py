"""How far a metamodel can be believed: trials it did not see, and averages that it corrects.

After Gavrilin and Steen (2017): cross-validation by the normalised root-mean-square fit. The
corrected average is what remains of measured overshoots after the metamodel has taken out how each
trial differs from the ideal one; it has neither the metamodel's error of structure nor the
trials' errors of execution.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.metamodels.fit import Trials, identify
from diffsea.metamodels.norrbin import Norrbin
from diffsea.metrics.repeats import fit_percent
from diffsea.trajectory import Samples
from diffsea.types import Scalar


class TrialPrediction(NamedTuple):
    """Yaw rates of trials under their own rudder, and how well they follow what was measured."""

    percent: Float[Array, "trial"]  # 100 is perfect, 0 no better than the mean
    r: Float[Array, "trial time"]  # rad/s


@eqx.filter_jit
def predict_trials(model: Norrbin, trials: Trials) -> TrialPrediction:
    """What a metamodel says of trials put aside, only their first yaw rates adapted."""

    def one(delta: Array, measured: Array, known: Array) -> tuple[Array, Array]:
        run = lambda first: model.simulate(first, delta, trials.dt)
        predicted, slope = jax.jvp(run, (measured[0],), (jnp.ones(()),))
        slope = jnp.where(known, slope, 0.0)
        change = jnp.sum(slope * jnp.where(known, measured - predicted, 0.0)) / jnp.sum(slope**2)
        predicted = run(measured[0] + change)
        return fit_percent(measured, predicted, known), predicted

    return TrialPrediction(*jax.vmap(one)(trials.delta, trials.r, trials.known))


@eqx.filter_jit
def leave_one_out(trials: Trials, tie: Scalar) -> TrialPrediction:
    """Each trial as predicted by the metamodel of all the others.

    Arguments:
        tie: of `identify`.
    """
    number = trials.r.shape[0]

    def one(k: Array) -> tuple[Array, Array]:
        others = trials.known & (jnp.arange(number) != k)[:, None]
        model = identify(dataclasses.replace(trials, known=others), tie).model
        alone = Trials(trials.dt, *(a[k][None] for a in (trials.delta, trials.r, trials.known)))
        percent, r = predict_trials(model, alone)
        return percent[0], r[0]

    return TrialPrediction(*jax.lax.map(one, jnp.arange(number)))


def overshoots_beyond(
    t: Samples, psi: Samples, reversals: tuple[float, ...], side: float, end: float
) -> Float[np.ndarray, "overshoot"]:
    """How far (rad) the heading went on after each reversal of the rudder.

    Arguments:
        t: s, increasing.
        psi: rad, unwrapped.
        reversals: times (s) at which the rudder left for the other side, the second order first.
        side: 1 for a first order to starboard, -1 to port.
        end: of the trial, s.
    """
    found = []
    for k, (start, until) in enumerate(zip(reversals, (*reversals[1:], end), strict=True)):
        towards = side * (-1) ** k * psi
        within = (t >= start) & (t <= until)
        peak = float(np.max(towards[within], initial=-np.inf))
        found.append(peak - float(np.interp(start, t, towards)))
    return np.array(found)
