"""How far a metamodel can be believed: trials it did not see, and averages that it corrects.

After Gavrilin and Steen (2017): cross-validation by the normalised root-mean-square fit. The
corrected average is what remains of measured overshoots after the metamodel has taken out how each
trial differs from the ideal one; it has neither the metamodel's error of structure nor the
trials' errors of execution. A vessel file is judged by the metamodel under the rudder of the same
trials, where the wind of each is left out of both.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.metamodels.fit import Trials, identify
from diffsea.metamodels.norrbin import Norrbin
from diffsea.metrics.repeats import fit_percent
from diffsea.simulation.replay import replay
from diffsea.trajectory import Samples, Trajectory
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


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


class VesselComparison(NamedTuple):
    """Yaw rates of a vessel under the orders of trials, and how well they follow two others.

    Per cent as in `TrialPrediction`.
    """

    of_metamodel: Float[np.ndarray, "trial"]
    of_measured: Float[np.ndarray, "trial"]
    r: Float[np.ndarray, "trial time"]  # rad/s


def compare_vessel(
    vessel: Vessel,
    model: Norrbin,
    trials: Trials,
    runs: Sequence[Trajectory],
    starts: Sequence[float],
) -> VesselComparison:
    """A vessel beside a metamodel, both under the actuation of the trials, wind left out.

    The vessel begins with the motion that was recorded then, and has the weather of its file.

    Arguments:
        runs: each trial as recorded.
        starts: when it begins, s on the clock of its run.

    Raises:
        UserError: a run has no orders for one of the vessel's actuators, or no speed.
    """
    expected = np.asarray(predict_trials(model, trials).r)
    times = float(trials.dt) * np.arange(trials.r.shape[1])
    alone = lambda start, run: np.interp(start + times, run.t, replay(vessel, run).r)
    r = np.stack([alone(start, run) for start, run in zip(starts, runs, strict=True)])
    follows = lambda series: np.asarray(fit_percent(series, jnp.asarray(r), trials.known))
    return VesselComparison(follows(jnp.asarray(expected)), follows(trials.r), r)


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
