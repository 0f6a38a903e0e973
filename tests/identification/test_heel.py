"""Heel predicted from motion, against an oscillator integrated by scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from diffsea import Trajectory
from diffsea.identification.data.heel import predicted_heel


STEP, ROWS, NOISE = 0.2, 900, 0.003


def rolling(rng, exogenous=0.0, step=STEP):
    """(true mean heel of rows, recorded heel, u, v, r) of a vessel that rolls in turns."""
    t = step * np.arange(ROWS)
    u = 2.0 + 0.5 * np.sin(0.05 * t)
    r = 0.2 * np.sign(np.sin(0.21 * t) + 0.3 * np.sin(0.77 * t))
    v = -0.5 * r
    waves = exogenous * np.cumsum(rng.normal(0, 1, ROWS)) / np.sqrt(np.arange(1, ROWS + 1))
    at = lambda values, now: np.interp(now, t, values)

    def slope(now, x):
        push = -0.35 * at(u, now) * at(r, now) + at(waves, now)
        return [x[1], -0.4 * x[1] - 2.2**2 * x[0] + push]

    found = solve_ivp(slope, (0, t[-1] + step), [0, 0], max_step=0.05, dense_output=True).sol
    mean = np.mean([found(t + share * step)[0] for share in np.linspace(0, 1, 21)], axis=0)
    return mean, found(t)[0] + rng.normal(0, NOISE, ROWS), u, v, r


def run(phi, u, v, r, valid=None, step=STEP):
    t = step * np.arange(len(phi))
    nothing = np.full(len(phi), np.nan)
    return Trajectory(
        t=t, x=nothing, y=nothing, psi=nothing, u=u, v=v, r=r, commanded={}, executed={},
        extra={"phi": phi}, valid=np.ones(len(phi), bool) if valid is None else valid,
    )  # fmt: skip


def test_heel_is_predicted_to_better_than_it_was_recorded():
    true, phi, u, v, r = rolling(np.random.default_rng(1))
    error = predicted_heel(run(phi, u, v, r)) - true
    assert 5 * NOISE < true.std()
    assert error[50:].std() < NOISE


def test_what_a_row_records_is_not_in_its_own_prediction():
    _, phi, u, v, r = rolling(np.random.default_rng(2), exogenous=0.3)
    kick = np.where(np.arange(ROWS) == 500, NOISE, 0.0)
    # The estimated model changes a very little with any value.
    moved = np.abs(predicted_heel(run(phi + kick, u, v, r)) - predicted_heel(run(phi, u, v, r)))
    assert moved[501:].max() > 0.3 * NOISE
    assert moved[:501].max() < 0.03 * NOISE


def test_a_swing_between_rows_that_are_far_apart_is_followed():
    step = 0.8  # between values, of a period of 2.86
    true, *recorded = rolling(np.random.default_rng(6), step=step)
    # A straight line from one value to the next would be off by 1.1 times the noise.
    assert (predicted_heel(run(*recorded, step=step)) - true)[50:].std() < 0.8 * NOISE


def test_heel_from_waves_is_followed_from_its_past():
    true, phi, u, v, r = rolling(np.random.default_rng(3), exogenous=0.3)
    error = predicted_heel(run(phi, u, v, r)) - true
    assert error[50:].std() < 0.35 * true.std()


def test_missing_and_wild_values_do_little():
    rng = np.random.default_rng(4)
    true, phi, u, v, r = rolling(rng)
    phi[rng.random(ROWS) < 0.1] = np.nan
    phi[[200, 600]] += 0.5
    r[::2] = np.nan
    error = predicted_heel(run(phi, u, v, r)) - true
    assert np.sqrt(np.median(error[50:] ** 2)) < NOISE


@pytest.mark.parametrize("rows", [1, 10, 59])
def test_few_values_are_held(rows):
    phi = np.full(ROWS, np.nan)
    phi[:rows] = 0.1 * np.arange(rows)
    nothing = np.full(ROWS, np.nan)
    found = predicted_heel(run(phi, nothing, nothing, nothing))
    assert found[rows - 1 :] == pytest.approx(0.1 * (rows - 1))


def test_without_heel_there_is_none():
    nothing = np.full(ROWS, np.nan)
    assert not predicted_heel(run(nothing, nothing, nothing, nothing)).any()


def test_heel_alone_is_predicted_from_itself():
    true, phi, *_ = rolling(np.random.default_rng(5))
    nothing = np.full(ROWS, np.nan)
    error = predicted_heel(run(phi, nothing, nothing, nothing)) - true
    assert error[50:].std() < 0.5 * true.std()
