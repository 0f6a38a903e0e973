"""The same runs told otherwise give the same fit: turned, in another order, moved, later."""

import dataclasses

from experiments.concealed_real import retellings, sets

import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import DATA, ORACLE
from tests.runs import random_steps

from diffsea import Trajectory, read_recording, read_vessel
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.filter.noise_fit import RowTimes, refine_noise
from diffsea.identification.fit import Start, estimate, estimate_surely, normalised_rms
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


FREE = ("X_u", "X_uu", "Y_v", "N_r", "N_rr")


def turned(run: Trajectory, angle: float) -> Trajectory:
    x, y = np.asarray(run.x), np.asarray(run.y)
    cos, sin = np.cos(angle), np.sin(angle)
    return dataclasses.replace(
        run, x=cos * x - sin * y, y=sin * x + cos * y, psi=np.asarray(run.psi) + angle
    )


TELLINGS = {
    "turned": lambda runs: [turned(run, 0.7) for run in runs],
    "in another order": lambda runs: runs[::-1],
    "moved": lambda runs: [dataclasses.replace(r, x=r.x + 500.0, y=r.y - 300.0) for r in runs],
    "later": lambda runs: [dataclasses.replace(run, t=run.t + 900.0) for run in runs],
}


@pytest.fixture(scope="module")
def boat():
    return build(load(str(ORACLE / "usv.toml")))


@pytest.fixture(scope="module")
def runs() -> list[Trajectory]:
    """Runs of different lengths, with noise that is coarser to the north than to the east."""
    document, rng = load(str(ORACLE / "usv.toml")), np.random.default_rng(3)
    found = [
        random_steps(document, seed, seconds, 0.25) for seed, seconds in ((4, 60.0), (5, 90.0))
    ]
    return [
        dataclasses.replace(
            run,
            x=run.x + 0.05 * rng.normal(size=run.x.shape),
            y=run.y + 0.02 * rng.normal(size=run.y.shape),
        )
        for run in found
    ]


def fitted(boat, runs):
    problem = make_problem(boat, runs, FREE)
    found = estimate(problem, FREE)
    return found, normalised_rms(found.filter_run(problem))


@pytest.fixture(scope="module")
def told(boat, runs):
    return fitted(boat, runs)


@pytest.mark.parametrize("telling", TELLINGS)
def test_a_fit_ends_where_it_did(boat, runs, told, telling):
    (before, misfit), (after, same) = told, fitted(boat, TELLINGS[telling](runs))
    assert same == pytest.approx(misfit, rel=0.01)
    assert np.abs((after.coordinates - before.coordinates) / before.stds).max() < 0.1


def test_a_fit_from_afar_ends_at_the_same_optimum(boat, runs):
    problem = make_problem(boat, runs, FREE)
    sure = estimate_surely(problem, FREE)
    far = sure.coordinates.copy()
    far[sure.index] += 1.0
    again = estimate_surely(problem, FREE, Start(far))
    assert again.deviance == pytest.approx(sure.deviance, abs=1.0)


def test_noise_stays_as_it_is_where_the_model_diverges(boat, runs):
    problem = make_problem(boat, runs, FREE)
    at, noise = problem.start()
    data = problem.dataset
    run = problem.run_filter(np.full_like(at, np.nan), noise)
    times = RowTimes(data.dt, data.run, first_variance(boat))
    kept = refine_noise(run, times, noise, problem.prior, 3).noise
    np.testing.assert_array_equal(kept.scales, noise.scales)


@pytest.mark.proof
def test_a_real_set_told_otherwise_is_fitted_the_same(tmp_path):
    """One set of those that `make proof` asks."""
    name = "blueboat"
    data = DATA / name
    if not data.exists():
        pytest.skip(f"no recordings in {data}")
    material = sets.SETS[name].load()
    tellings = {"as recorded": material} | retellings.retold(material)
    fits = {}
    for telling in ("as recorded", "turned", "reordered"):
        vessel, train, _ = tellings[telling].write(tmp_path / telling)
        problem = make_problem(read_vessel(vessel).vessel, [read_recording(run) for run in train])
        found = estimate_surely(problem, tuple(p.name for p in problem.layout.parameters))
        fits[telling] = normalised_rms(found.filter_run(problem)), found.deviance
    misfit, deviance = fits["as recorded"]
    for same, value in fits.values():
        assert same == pytest.approx(misfit, rel=0.01)
        assert value == pytest.approx(deviance, abs=2.0)
