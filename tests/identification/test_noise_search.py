"""Where the search for noise and the last steps of a fit end, against optimisers of SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from diffsea.identification.filter import noise_fit
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.filter.noise_fit import RowTimes, refine_noise, rerun_linearised


FREE = ("X_u", "Y_v", "N_r")


@pytest.fixture(scope="module")
def problem(late_orders):
    return late_orders


@pytest.fixture(scope="module")
def found(late_orders_fitted):
    return late_orders_fitted


@pytest.fixture(scope="module")
def search(problem, found):
    """A run of the filter, its rows, and its deviance by the scales of the noise, x and y alike."""
    data = problem.dataset
    times = RowTimes(data.dt, data.run, first_variance(problem.base))
    _, noise = problem.start()
    run = problem.run_filter(found.coordinates, noise)

    @jax.jit
    def deviance(free: jax.Array) -> jax.Array:
        log = jnp.insert(free, 10, free[9])
        white, variance = rerun_linearised(run, times, Noise.of(log))
        off = (log - problem.prior.mean) / problem.prior.spread
        return jnp.sum(white**2) + jnp.sum(jnp.log(variance)) + jnp.sum(off**2)

    return run, times, noise, deviance


def free_of(noise: Noise) -> np.ndarray:
    return np.delete(np.asarray(noise.scales), 10)


def test_many_steps_end_where_another_optimiser_does(problem, search):
    run, times, noise, deviance = search
    prior = problem.prior
    bounds = np.delete(np.stack([prior.lowest, prior.highest], 1), 10, axis=0)
    best = minimize(
        jax.value_and_grad(deviance), free_of(noise), jac=True, method="L-BFGS-B", bounds=bounds,
        options={"maxiter": 500, "ftol": 1e-14},
    )  # fmt: skip
    before, after = (
        float(deviance(free_of(at)))
        for at in (noise, refine_noise(run, times, noise, prior, 15).noise)
    )
    assert before - best.fun > 100
    assert after - best.fun < 1.5


def test_each_step_gains(problem, search):
    run, times, noise, deviance = search
    ends = [
        float(deviance(free_of(refine_noise(run, times, noise, problem.prior, steps).noise)))
        for steps in (1, 2, 4, 8)
    ]
    assert np.all(np.diff([float(deviance(free_of(noise))), *ends]) <= 0)
    assert ends[1] < ends[0] - 1.0


def test_a_borrowed_curvature_serves_as_the_expected_one_does(problem, search, monkeypatch):
    """From near by, and nothing is scored anew."""
    run, times, noise, deviance = search
    end, curvature = refine_noise(run, times, noise, problem.prior, 15)
    near = Noise.of(np.asarray(end.scales) + 0.1)
    fresh = refine_noise(run, times, near, problem.prior, 15)
    assert float(deviance(free_of(near))) - float(deviance(free_of(fresh.noise))) > 5

    def scored(*given: object) -> None:
        raise AssertionError("scored anew")

    monkeypatch.setattr(noise_fit, "_expected_curvature", scored)
    same = refine_noise(run, times, near, problem.prior, 15, curvature)
    assert same.curvature is not None
    ends = [float(deviance(free_of(one.noise))) for one in (fresh, same)]
    assert ends[1] == pytest.approx(ends[0], abs=0.2)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_borrowed_curvature_that_misleads_is_found_anew(problem, search, factor):
    """Its steps are too long or too short by far, and gain nothing of what they promise."""
    run, times, noise, deviance = search
    fresh = refine_noise(run, times, noise, problem.prior, 1)
    assert fresh.curvature is not None
    wrong = refine_noise(run, times, noise, problem.prior, 1, factor * fresh.curvature)
    ends = [float(deviance(free_of(one.noise))) for one in (fresh, wrong)]
    assert ends[1] == pytest.approx(ends[0], rel=1e-9)
    assert wrong.curvature is not None
    np.testing.assert_allclose(wrong.curvature, fresh.curvature)
