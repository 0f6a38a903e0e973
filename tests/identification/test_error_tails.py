"""Heavy tails of one-step errors, and held-out gains that a few events do not decide."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, t

from diffsea.identification.filter.error_tails import error_tails
from diffsea.identification.filter.kalman import FilterRun, Gains


ROWS = 4000


def filter_run(
    white: np.ndarray, variance: float = 1.0, used: np.ndarray | None = None
) -> FilterRun:
    """A run of which no more is known than its whitened innovations."""
    rows = len(white)
    used = np.ones((rows, 6), bool) if used is None else used
    gains = bare(Gains, used=jnp.asarray(used))
    return bare(FilterRun, white=jnp.asarray(white), gains=gains,
                variance=jnp.full((rows, 6), variance))  # fmt: skip


def bare(kind: type, **known: object):
    """A record with only some of its fields."""
    made = object.__new__(kind)
    for name, value in known.items():
        object.__setattr__(made, name, value)
    return made


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
    expected = 2 * (t.logpdf(after, tails.degrees, scale=tails.scale)
                    - t.logpdf(before, tails.degrees, scale=tails.scale)).sum()  # fmt: skip
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
    few = error_tails(filter_run(white[:20]))
    assert np.isinf(few.degrees).all() and (few.scale == 1.0).all()
