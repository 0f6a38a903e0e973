"""A fitted vessel in each run held out: its environment, and the states predictions begin in."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from diffsea.identification.coordinates import vessel_at
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.corrections import corrected
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.holdout import Split, held_out_coordinates
from diffsea.identification.problem import Coordinates, Problem
from diffsea.trajectory import MOTION_CHANNELS, Samples, Trajectory
from diffsea.vessel.base import Vessel


UNSETTLED = 2.0  # times the usual variance of filtered speeds: a filter that has just begun

Motion = dict[str, Samples]  # by motion channel, in the rows of a recording that count


class RunModel(NamedTuple):
    """A vessel in the environment of a run.

    Attributes:
        states: motion in which free predictions begin, in the rows that count, NaN where it is as
            recorded; all of it if None.
    """

    vessel: Vessel
    states: Motion | None = None


def held_out_models(split: Split, fitted: Estimate) -> list[RunModel]:
    """The fitted vessel in the environment of each held-out run.

    It has all parts of the catalogue, most of them without effect, whatever is fitted: programs
    compiled for one fit serve all.
    """
    coordinates = held_out_coordinates(split, fitted)
    vessel, flow = _vessel_at(split.test.base, split.test.layout, coordinates)
    flows = [jax.tree.map(lambda leaf, k=k: leaf[k], flow) for k in range(len(split.held_out))]
    states = filtered_states(split.test, coordinates, fitted.noise, split.held_out)
    return [
        RunModel(dataclasses.replace(vessel, environment=flow), own)
        for flow, own in zip(flows, states, strict=True)
    ]


_vessel_at = eqx.filter_jit(vessel_at)


def filtered_states(
    problem: Problem, coordinates: Coordinates, noise: Noise, runs: Sequence[Trajectory]
) -> list[Motion]:
    """What a filter makes of the motion in each of a problem's runs, once it has settled.

    One noisy sample of a yaw rate, or a sway that is derived from fixes, would be most of the error
    of a prediction, whatever the model. Between the rows that are filtered motion is linear; NaN
    where the filter has just begun, in a rough guess.
    """
    filtered = problem.run_filter(coordinates, noise)
    states, covariance = np.asarray(filtered.state), np.asarray(filtered.covariance)
    vessel, _ = _vessel_at(problem.base, problem.layout, coordinates)
    times = np.asarray(corrected(vessel, problem.dataset)[1].run_time)
    found: list[Motion] = []
    for run, rows in zip(runs, problem.dataset.rows_of_runs, strict=False):
        own = np.where(is_settled(covariance[rows])[:, None], states[rows], np.nan)
        found.append(_motion_at(run.counted().t, times[rows], own))
    return found


def is_settled(covariance: Float[np.ndarray, "row 9 9"]) -> Bool[np.ndarray, "row"]:
    """In which rows of a run a filter knows the speeds about as well as it usually does."""
    speeds = covariance[:, 3, 3] + covariance[:, 4, 4]
    return speeds <= UNSETTLED * np.median(speeds)


def _motion_at(
    t: Samples, times: Float[np.ndarray, "row"], states: Float[np.ndarray, "row 6"]
) -> Motion:
    return {c: np.interp(t, times, states[:, k]) for k, c in enumerate(MOTION_CHANNELS)}
