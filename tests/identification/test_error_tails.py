"""Heavy tails of one-step errors, and held-out gains that a few events do not decide."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from scipy.stats import norm

from diffsea.identification.filter.covariance import GustPropagation
from diffsea.identification.filter.error_tails import error_tails
from diffsea.identification.filter.kalman import FilterRun, Gains


ROWS = 4000


def filter_run(
    white: np.ndarray, variance: float = 1.0, used: np.ndarray | None = None
) -> FilterRun:
    """A run of which whitened innovations and variances count, all else zero."""
    used = np.ones(white.shape, bool) if used is None else used

    def zeros(*shape: int) -> Array:
        return jnp.zeros((len(white), *shape))

    gains = Gains(zeros(9, 6), zeros(6, 6), jnp.asarray(used), GustPropagation(zeros(3), zeros(3)))
    spread = jnp.full(white.shape, variance)
    return FilterRun(gains, zeros(6), zeros(6), jnp.asarray(white), spread, zeros(6, 6),
                     zeros(6, 9), zeros(3), zeros(3), zeros(6))  # fmt: skip


def student_deviance(white: np.ndarray, degrees: np.ndarray, scale: np.ndarray) -> float:
    """-2 log of Student's density, written out, of all values together."""
    total = 0.0
    for errors, n, s in zip(white.T, degrees, scale, strict=True):
        if np.isinf(n):
            total += np.sum((errors / s) ** 2 + math.log(2 * math.pi * s**2))
            continue
        peak = math.lgamma((n + 1) / 2) - math.lgamma(n / 2) - 0.5 * math.log(n * math.pi * s**2)
        total += np.sum((n + 1) * np.log(1 + (errors / s) ** 2 / n) - 2 * peak)
    return float(total)


@pytest.fixture
def draws() -> np.random.Generator:
    return np.random.default_rng(7)


def test_tails_are_found_by_channel(draws):
    white = draws.standard_normal((ROWS, 6))
    white[:, 2] = 0.4 * draws.standard_t(3.0, ROWS)
    tails = error_tails(filter_run(white))
    normal = np.arange(6) != 2
    assert (tails.degrees[normal] > 30).all()
    np.testing.assert_allclose(tails.scale[normal], 1.0, atol=0.04)
    assert tails.degrees[2] == pytest.approx(3.0, rel=0.15)
    assert tails.scale[2] == pytest.approx(0.4, rel=0.06)


def test_with_normal_errors_the_likelihood_is_the_normal_one(draws):
    run = filter_run(draws.standard_normal((ROWS, 6)), 0.25)
    tails = error_tails(run)._replace(degrees=np.full(6, np.inf), scale=np.ones(6))
    normal = -2 * norm.logpdf(np.asarray(run.white)).sum(1) + 6 * np.log(0.25)
    np.testing.assert_allclose(tails.deviance(run), normal)


def test_a_gain_is_that_of_the_likelihood_and_few_events_do_not_decide(draws):
    """A model that is better nearly everywhere, and far worse in three rows of 4000."""
    before = draws.standard_normal((ROWS, 6))
    events = draws.choice(ROWS, 40, replace=False)
    before[events] *= 15.0
    after = 0.97 * before
    after[events[:3]] = 2.0 * before[events[:3]]
    tails = error_tails(filter_run(before))
    gain = (tails.deviance(filter_run(before)) - tails.deviance(filter_run(after))).sum()
    assert (before**2 - after**2).sum() < 0 < gain
    expected = student_deviance(before, *tails) - student_deviance(after, *tails)
    assert gain == pytest.approx(expected)


def test_what_diverged_has_no_likelihood_and_what_was_not_used_no_part_in_it(draws):
    white = draws.standard_normal((ROWS, 6))
    tails = error_tails(filter_run(white))
    used = np.ones((ROWS, 6), bool)
    used[5] = False
    assert tails.deviance(filter_run(white, used=used))[5] == 0.0
    white[7, 3] = np.nan
    found = tails.deviance(filter_run(white))
    assert np.isnan(found[7]) and np.isfinite(np.delete(found, 7)).all()
    again = error_tails(filter_run(white))
    np.testing.assert_allclose(again.scale, tails.scale, rtol=1e-3)
    few = error_tails(filter_run(white[:20]))
    assert np.isinf(few.degrees).all() and (few.scale == 1.0).all()
