# pyright: reportArgumentType=false
"""In which states predictions of a run begin whose velocities were not recorded."""

import dataclasses

import numpy as np
import pytest
from tests.oracle.sensors import gust
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea.identification.fit import estimate, noise_at
from diffsea.identification.free_predictions import expected_squares, motion_misfit
from diffsea.identification.holdout import split_data
from diffsea.identification.problem import make_problem
from diffsea.identification.run_models import filtered_states, held_out_models
from diffsea.simulation.replay import horizon_errors, prediction_misses
from diffsea.vessel.files import build


pytestmark = [pytest.mark.slow, pytest.mark.compiles]


FREE = ("X_u", "X_uu", "Y_v", "N_r", "N_rr")
FIX, COMPASS = 0.3, 0.01  # m, rad, by which fixes and headings scatter


def fixes(seed: int):
    """A run with the velocities that are true, and as a receiver and a compass show it."""
    rng = np.random.default_rng(seed)
    gusts = gust(rng, 0.0, 200.0)
    whole = random_steps(load(str(ORACLE / "usv.toml")), seed, 200.0, 0.5, gust=gusts, noise=1e-9)
    scattered = lambda values, by: values + by * rng.normal(size=len(whole.t))
    x, y, psi = scattered(whole.x, FIX), scattered(whole.y, FIX), scattered(whole.psi, COMPASS)
    nothing = np.full(whole.t.shape, np.nan)
    return whole, dataclasses.replace(whole, x=x, y=y, psi=psi, u=nothing, v=nothing, r=nothing)


@pytest.fixture(scope="module")
def runs():
    return [fixes(seed) for seed in (11, 12)]


@pytest.fixture(scope="module")
def data(runs):
    boat = build(load(str(ORACLE / "usv.toml")))

    def problem_of(recordings, least):
        return make_problem(boat, recordings, FREE, least=least)

    (_, train), (_, test) = runs
    return split_data(problem_of, [train], [test], per_run=False)


@pytest.fixture(scope="module")
def fitted(data):
    return estimate(data.train, FREE)


def rms(values) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def test_predictions_begin_in_what_the_filter_knows(data, fitted, runs):
    """Its velocities are nearer to the true ones, and so is where predictions lead."""
    whole, run = runs[1]
    ((vessel, states),) = held_out_models(data, fitted)
    assert states is not None and all(len(states[c]) == len(run.t) for c in "uvr")
    # A filter that has just begun knows less than all fixes do: it is not asked.
    assert np.isnan(states["u"][0]) and np.isfinite(states["u"][whole.t > 10.0]).all()
    first = [
        prediction_misses(vessel, run, (20.0,), 5.0, states=own)[20.0]["y"][0]
        for own in (states, None)
    ]
    assert first[0] == pytest.approx(first[1], abs=1e-9)
    later = whole.t > 10.0
    for channel, error in (("u", 0.025), ("v", 0.03), ("r", 0.01)):
        assert rms((states[channel] - whole.motion[channel])[later]) < error, channel
    by_filter, derived = (
        horizon_errors(vessel, run, (5.0,), 5.0, states=own)[5.0] for own in (states, None)
    )
    assert by_filter["position"] < 0.85 * derived["position"]


def test_the_filter_states_how_well_it_knows_them(data, fitted, runs):
    whole, _ = runs[1]
    found = data.test.run_filter(np.zeros(len(FREE)), fitted.noise)
    rows = data.test.dataset.rows_of_runs[0]
    rows = rows[np.asarray(data.test.dataset.run_time)[rows] > 10.0]
    at = np.searchsorted(whole.t, np.asarray(data.test.dataset.run_time)[rows])
    for k, channel in ((3, "u"), (4, "v"), (5, "r")):
        off = np.asarray(found.state)[rows, k] - np.asarray(whole.motion[channel])[at]
        stated = np.asarray(found.covariance)[rows, k, k]
        assert 0.3 < np.mean(off**2 / stated) < 2.0, channel


def test_noise_explains_what_predictions_from_filtered_states_miss(data, fitted):
    ratio = motion_misfit(data, fitted).ratio
    assert set(ratio) == {20.0, 60.0} and all(0.3 < one < 3.0 for one in ratio.values())


def test_what_noise_explains_of_a_run_does_not_depend_on_other_runs(data, fitted, runs):
    """One of measured velocities beside one without."""
    whole, run = runs[1]

    def expected(*some) -> np.ndarray:
        problem = make_problem(data.test.base, list(some), FREE)
        return expected_squares(problem, np.zeros(len(FREE)), fitted.noise, 20.0)

    alone, other, both = expected(run), expected(whole), expected(run, whole)
    np.testing.assert_allclose(both, (alone + other) / 2, rtol=0.02)


def test_no_reading_of_what_follows_is_known_where_a_prediction_begins(data, fitted, runs):
    """Whatever is recorded from 100 s on, the states before are the same."""
    _, run = runs[1]
    rng, later = np.random.default_rng(0), run.t > 100.0
    shuffled = dataclasses.replace(run, x=np.where(later, rng.normal(size=len(run.t)), run.x))
    states = [
        filtered_states(
            make_problem(data.test.base, [one], FREE), fitted.coordinates, fitted.noise, [one]
        )[0]
        for one in (run, shuffled)
    ]
    before = run.t <= 100.0
    for channel in ("x", "u", "v", "r"):
        np.testing.assert_allclose(*(one[channel][before] for one in states), rtol=1e-9)
    assert np.abs(states[0]["u"] - states[1]["u"])[later].max() > 0.02


def test_a_noisy_sample_is_not_what_a_prediction_begins_with(data, fitted, runs):
    """Of a yaw rate that swings, as in waves, a filter makes less than it shows."""
    whole, _ = runs[1]
    rng = np.random.default_rng(1)
    noisy = dataclasses.replace(whole, r=whole.r + rng.normal(0.0, 0.1, len(whole.t)))
    problem = make_problem(data.test.base, [noisy], FREE)
    noise = noise_at(problem, fitted.coordinates)
    (states,) = filtered_states(problem, fitted.coordinates, noise, [noisy])
    later = whole.t > 10.0
    assert rms((states["r"] - whole.r)[later]) < 0.03
    by_filter, by_sample = (
        horizon_errors(data.test.base, noisy, (5.0,), 5.0, states=own)[5.0]
        for own in (states, None)
    )
    assert by_filter["heading"] < 0.6 * by_sample["heading"]


def test_states_that_are_given_are_what_predictions_begin_with(data, runs):
    whole, _ = runs[1]
    true = {c: np.asarray(whole.motion[c]) for c in whole.motion}
    told, as_recorded = (
        prediction_misses(data.test.base, whole, (5.0,), 5.0, states=own)[5.0]["u"]
        for own in (true, None)
    )
    np.testing.assert_allclose(told, as_recorded, atol=1e-6)
