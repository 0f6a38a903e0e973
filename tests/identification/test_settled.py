# pyright: reportArgumentType=false
"""A fit that stalled is begun again: where, and when two fits count as one. Fits are made up."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from diffsea.identification import fit
from diffsea.identification.estimates import Estimate, FitOutcome, posterior_estimate
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.fit import RESTART_DISTANCE, RESTARTS, Start, settled


NOISE = Noise.of(np.zeros(16))
# Two coordinates of which the data tell the sum a hundred times as well as the difference.
INFORMATION = np.array([[1.0, 1.0], [1.0, 1.0]]) * 5000 + np.array([[1.0, -1.0], [-1.0, 1.0]]) / 2


def made_up(deviance: float, outcome=FitOutcome.STALLED, began: float | None = None) -> Estimate:
    found = posterior_estimate(
        ("a", "b"), np.zeros(2), deviance, np.arange(2), np.full(2, 100.0), INFORMATION
    )
    path = (deviance if began is None else began, deviance)
    return dataclasses.replace(found, outcome=outcome, state=NOISE, path=path)


@pytest.fixture
def restarts(monkeypatch):
    """The starts of fits that are asked for, and how those end."""
    asked, ends = [], []

    def estimate(problem, free, start, progress):
        asked.append(start.coordinates)
        return ends[len(asked) - 1]

    monkeypatch.setattr(fit, "estimate", estimate)
    monkeypatch.setattr(fit, "filter_at", lambda _, at, noise: SimpleNamespace(deviance=at.sum()))
    return asked, ends


def test_a_stalled_fit_begins_again_where_the_data_allow_it_to(restarts):
    asked, ends = restarts
    ends += [made_up(10.0 * k) for k in range(1, 1 + RESTARTS)]
    assert settled(None, made_up(0.0)).outcome is FitOutcome.STALLED
    assert len(asked) == RESTARTS
    for start in asked:
        rise = start @ INFORMATION @ start
        assert 0 < rise < RESTART_DISTANCE**2 * 20  # two axes: 20 is beyond all but 5e-5 of draws
        assert np.abs(start).max() > 0.1  # along the difference, which is known badly


@pytest.mark.parametrize("wall", [np.nan, 1e5])
def test_it_begins_nearer_where_the_filter_has_it_far_less_likely(restarts, monkeypatch, wall):
    asked, ends = restarts
    ends += [made_up(10.0 * k) for k in range(1, 1 + RESTARTS)]
    settled(None, made_up(0.0))
    before = asked[0]
    near = 0.3 * np.abs(before).max()
    walled = lambda _, at, noise: SimpleNamespace(deviance=wall if np.abs(at).max() > near else 1.0)
    monkeypatch.setattr(fit, "filter_at", walled)
    asked.clear()
    settled(None, made_up(0.0))
    assert asked[0] == pytest.approx(before / 4)


def test_two_fits_that_end_alike_have_settled(restarts):
    asked, ends = restarts
    ends += [made_up(0.5)]
    assert settled(None, made_up(0.0)).outcome is FitOutcome.CONVERGED
    assert len(asked) == 1


def test_a_fit_that_converged_is_not_begun_again(restarts):
    found = made_up(0.0, FitOutcome.CONVERGED)
    assert settled(None, found, [Start(np.array([-9.0, 0.0]), NOISE)]) is found
    assert not restarts[0]


@pytest.mark.parametrize(("end", "outcome"), [(-9.4, FitOutcome.CONVERGED), (-40.0, None)])
def test_where_a_plainer_model_ended_comes_first_if_that_is_likelier(restarts, end, outcome):
    """Where nothing is gained from there, the model is no more than the plainer one."""
    asked, ends = restarts
    plainer = Start(np.array([-9.0, 0.0]), NOISE)
    ends += [made_up(end, began=-9.0), *[made_up(0.0)] * RESTARTS]
    found = settled(None, made_up(0.0), [Start(np.array([1.0, 0.0]), NOISE), plainer])
    assert asked[0] is plainer.coordinates and found.deviance == end
    assert found.outcome is (outcome or FitOutcome.STALLED)
    assert len(asked) == 1 + (0 if outcome else RESTARTS)


def test_a_plainer_model_that_is_less_likely_is_no_start(restarts):
    asked, ends = restarts
    ends += [made_up(0.1)]
    settled(None, made_up(0.0), [Start(np.array([5.0, 0.0]), NOISE)])
    assert len(asked) == 1 and asked[0].sum() != 5.0 and asked[0].any()
