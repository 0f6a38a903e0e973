# pyright: reportArgumentType=false
"""Sensors whose errors follow one another: found by their innovations, and used more seldom."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea import Trajectory
from diffsea.identification.estimates import parameter_estimates
from diffsea.identification.filter.correlated_errors import independent_sampling, thin_channels
from diffsea.identification.fit import estimate
from diffsea.identification.problem import make_problem
from diffsea.identification.study import FitSettings, identify
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


FREE = ("X_u", "X_uu", "N_r")
STEP = 0.1


@pytest.fixture(scope="module")
def boat():
    return build(load(str(ORACLE / "usv.toml")))


@pytest.fixture(scope="module")
def runs() -> list[Trajectory]:
    document = load(str(ORACLE / "usv.toml"))
    return [random_steps(document, seed, 40.0, STEP) for seed in (4, 5)]


def smeared(
    run: Trajectory, share: float, seed: int = 1, channel: str = "r", std: float = 0.02
) -> Trajectory:
    """A channel with an error (rad/s or m/s) of which so much is left from row to row."""
    noise = np.random.default_rng(seed).normal(0, std * np.sqrt(1 - share**2), run.t.size)
    series = run.motion[channel] + lfilter([1.0], [1.0, -share], noise)
    return dataclasses.replace(run, **{channel: series})


def sampling(boat, runs) -> dict[str, int]:
    problem = make_problem(boat, runs, FREE)
    run = estimate(problem, FREE, rounds=5).filter_run(problem)
    return independent_sampling(run, problem.dataset, float(boat.rigid_body.length))


def test_white_errors_are_used_as_they_are(boat, runs):
    assert sampling(boat, runs) == {}


def test_errors_that_last_are_used_as_seldom_as_they_are_forgotten(boat, runs):
    found = sampling(boat, [smeared(run, 0.7) for run in runs])
    # Rows of the data set are two samples apart: 0.7^4 and 0.7^6 lie on both sides of 0.2.
    assert found == {"r": 3}


def test_what_stays_alike_for_longer_than_a_vessel_does_is_not_left_out(boat, runs):
    """One sample in 2 sqrt(L / g) stays, however long innovations are alike."""
    problem = make_problem(boat, runs, FREE)
    run = problem.run_filter(*problem.start())
    white = np.random.default_rng(2).normal(size=run.white.shape)
    white[:, 5] = 1.0
    run, length = dataclasses.replace(run, white=jnp.asarray(white)), float(boat.rigid_body.length)
    found = independent_sampling(run, problem.dataset, length)
    # Rows are 0.2 s apart: the data set is thinned to 0.3 sqrt(L / g) before.
    assert found == {"r": int(2 * np.sqrt(length / 9.80665) / float(problem.dataset.dt[0]))}


def test_positions_are_used_alike_whichever_way_the_axes_of_the_world_point(boat, runs):
    """North alone errs alike from row to row: turned by any angle, as many samples are used."""
    problem = make_problem(boat, runs, FREE)
    run = problem.run_filter(*problem.start())
    rng = np.random.default_rng(3)
    white = rng.normal(size=run.white.shape)
    white[:, 0] = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], rng.normal(size=len(white)))
    found = []
    for angle in (0.0, 0.3, 0.7, np.pi / 2):
        c, s = np.cos(angle), np.sin(angle)
        turned = white.copy()
        turned[:, :2] = white[:, :2] @ np.array([[c, s], [-s, c]])
        now = dataclasses.replace(run, white=jnp.asarray(turned))
        found.append(independent_sampling(now, problem.dataset, 100.0))
    assert found[0]["x"] == found[0]["y"] > 1 and all(one == found[0] for one in found)


def test_every_run_keeps_its_first_sample_and_one_of_so_many(boat, runs):
    problem = make_problem(boat, runs, FREE)
    thin = thin_channels(problem.dataset, {"r": 4, "x": 3})
    run, was, now = (np.asarray(a) for a in (thin.run, problem.dataset.known, thin.known))
    for k, every in ((0, 3), (5, 4)):
        for own in (0, 1):
            rows = np.flatnonzero(was[:, k] & (run == own))
            np.testing.assert_array_equal(np.flatnonzero(now[:, k] & (run == own)), rows[::every])
    np.testing.assert_array_equal(now[:, 1:5], was[:, 1:5])


def test_a_fit_uses_such_a_channel_as_seldom(boat, runs):
    smeared_runs = [smeared(run, 0.7) for run in runs]
    study = identify(boat, smeared_runs, FitSettings(free=FREE, profiles=()))
    assert study.objective.one_sample_in == {"r": 3}
    used = np.asarray(study.split(smeared_runs[:1]).test.dataset.known)[:, 5].sum()
    whole = np.asarray(make_problem(boat, smeared_runs[:1], FREE).dataset.known)[:, 5].sum()
    assert used == -(-whole // 3)


@pytest.mark.proof
def test_such_fits_are_nearer_to_the_truth(boat):
    """Beside smoothed velocities taken for exact, gusts are made to explain the sensors."""
    document = load(str(ORACLE / "usv.toml"))
    truth = [document["hull"][name] for name in FREE]
    seldom, always = [], []
    for seed in range(8):
        runs = [random_steps(document, 100 + 2 * seed + k, 40.0, STEP) for k in (0, 1)]
        for channel, std in (("r", 0.02), ("u", 0.05), ("v", 0.05)):
            runs = [smeared(run, 0.9, seed, channel, std) for run in runs]
        study = identify(boat, runs, FitSettings(free=FREE, profiles=()))
        seldom.append([study.values[name] for name in FREE])
        problem = make_problem(boat, runs, FREE)
        rows = parameter_estimates(problem.layout.parameters, estimate(problem, FREE))
        always.append([row.value for row in rows])
    error, believed = (
        np.sqrt(np.mean((np.array(found) - truth) ** 2, axis=0)) for found in (seldom, always)
    )
    assert (error < 0.8 * believed).all()
