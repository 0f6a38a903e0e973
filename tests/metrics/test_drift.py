"""Drift of turning circles, against circles drawn by hand."""

import dataclasses
import math

import numpy as np
import pytest

from diffsea import Trajectory, UserError
from diffsea.metrics.drift import circle_drift


def circle(north=0.03, east=-0.01, rate=0.1, laps=1.8, noise=0.0, bent=0.0):
    """A circle of 5 m radius whose centre drifts; `bent` makes the yaw rate uneven."""
    t = np.arange(0.0, laps * 2 * math.pi / abs(rate), 0.1)
    psi = rate * t + bent * np.sin(rate * t)
    rng = np.random.default_rng(0)
    x = 5.0 / rate * abs(rate) * np.sin(psi) + north * t + noise * rng.normal(size=len(t))
    y = -5.0 / rate * abs(rate) * np.cos(psi) + east * t + noise * rng.normal(size=len(t))
    nothing = np.full(len(t), np.nan)
    return Trajectory(
        t=t, x=x, y=y, psi=psi, u=nothing, v=nothing, r=nothing, commanded={}, executed={},
        extra={}, valid=np.ones(len(t), bool),
    )  # fmt: skip


@pytest.mark.parametrize("rate", [0.1, -0.07])
@pytest.mark.parametrize("bent", [0.0, 0.4])
def test_the_centre_moves_as_it_was_moved(rate, bent):
    run = circle(rate=rate, bent=bent)
    found = circle_drift(run, 0.0)
    assert found.north == pytest.approx(0.03, abs=1e-4)
    assert found.east == pytest.approx(-0.01, abs=1e-4)
    assert found.direction == pytest.approx(math.atan2(-0.01, 0.03) % (2 * math.pi), abs=5e-3)
    assert found.laps == pytest.approx(abs(run.psi[-1]) / (2 * math.pi))
    assert found.scatter < 1e-4


def test_laps_may_take_ever_longer():
    t = np.arange(0.0, 240.0, 0.1)
    psi = 0.12 * t - 1.5e-4 * t**2
    run = dataclasses.replace(
        circle(), t=t, psi=psi, x=5 * np.sin(psi) + 0.03 * t, y=-5 * np.cos(psi) - 0.01 * t,
        **{c: np.full(len(t), np.nan) for c in ("u", "v", "r")}, valid=np.ones(len(t), bool),
    )  # fmt: skip
    found = circle_drift(run, 0.0)
    assert (found.north, found.east) == pytest.approx((0.03, -0.01), abs=1e-4)
    assert found.scatter < 1e-4


def test_headings_may_be_wrapped_and_samples_missing():
    run = circle(noise=0.02)
    psi = (np.asarray(run.psi) + math.pi) % (2 * math.pi) - math.pi
    x, y = np.array(run.x), np.array(run.y)
    x[::3], y[1::3], psi[::5] = np.nan, np.nan, np.nan
    found = circle_drift(dataclasses.replace(run, x=x, y=y, psi=psi), 5.0)
    assert (found.north, found.east) == pytest.approx((0.03, -0.01), abs=5e-4)
    assert 0 < found.scatter < 2e-3


def test_too_short_a_circle_is_refused():
    with pytest.raises(UserError, match="laps after t = 60 s"):
        circle_drift(circle(laps=1.8), 60.0)
    with pytest.raises(UserError, match=r"1\.04"):
        circle_drift(circle(laps=1.04), 0.0)
