"""Free predictions of held-out runs: which of two models misses less, and what noise explains."""

import copy
import dataclasses
import math
import threading
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import numpy as np
import pytest
from scipy.linalg import expm
from tests.diagnosis.small import linear_estimate, still_problem, still_run
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea import EFFECTS
from diffsea.identification import free_predictions
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import first_variance
from diffsea.identification.filter.noise_fit import RowTimes, refine_noise
from diffsea.identification.fit import estimate, noise_at
from diffsea.identification.free_predictions import (
    MotionChange,
    expected_squares,
    motion_change,
    motion_misfit,
    pooled_losses,
    relative_losses,
)
from diffsea.identification.holdout import (
    Gain,
    Split,
    _Known,
    exchanged_fit,
    held_out_gain,
    row_deviance,
    split_data,
)
from diffsea.identification.problem import make_problem
from diffsea.identification.run_models import RunModel, held_out_models
from diffsea.identification.sufficiency import (
    FitVerdict,
    Shortfall,
    Sufficiency,
    Whiteness,
    shortfalls,
    sufficiency,
    whiteness,
)
from diffsea.recordings.conditioning import cut
from diffsea.statistics import moving_block_draws
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


FREE = ("X_u", "X_uu", "Y_v", "N_r", "N_rr")


@pytest.fixture(scope="module")
def data():
    """A run that is fitted and a long one held out, of the file's own vessel."""
    document = load(str(ORACLE / "usv.toml"))
    boat = build(document)
    train, test = (random_steps(document, seed, 200.0, 0.5) for seed in (11, 12))

    def problem_of(recordings, least):
        return make_problem(boat, recordings, FREE, least=least)

    return split_data(problem_of, [train], [test], per_run=False)


@pytest.fixture(scope="module")
def right(data):
    return estimate(data.train, FREE)


@pytest.fixture(scope="module")
def wrong(right):
    """The same with a turning damping that is far off."""
    coordinates = right.coordinates.copy()
    coordinates[3:5] -= 0.7
    return dataclasses.replace(right, coordinates=coordinates)


def test_the_worse_model_is_told_from_the_better_one_and_from_itself(data, right, wrong):
    assert motion_change(data, right, wrong).is_worse
    change = motion_change(data, wrong, right)
    assert not change.is_worse and max(change.ratio.values()) < 0.5
    assert change.is_better and change.is_probably_better
    same = motion_change(data, right, right)
    assert not same.is_worse and same.ratio == {20.0: 1.0, 60.0: 1.0}
    assert not (same.is_better or same.is_probably_better)


def test_a_late_sensor_is_no_divergence_where_a_prediction_ends_with_the_run(
    data, right, monkeypatch
):
    """At 180 s the true motion is shown after the last row; a model that diverges is infinite."""
    exact = held_out_models(data, right)[0].vessel
    late = eqx.tree_at(lambda v: v.sensors.latency_position, exact, 0.8)
    wild = eqx.tree_at(lambda v: v.rigid_body.mass, exact, 1e-9)
    delayed, loose = dataclasses.replace(right), dataclasses.replace(right)
    vessels = {id(right): exact, id(delayed): late, id(loose): wild}
    models = lambda _, model: [RunModel(vessels[id(model)])]
    monkeypatch.setattr(free_predictions, "held_out_models", models)
    run = data.held_out[0]
    data = dataclasses.replace(data, held_out=(run.rows(run.t <= 180.0),))
    found, whole = (relative_losses(data, right, other) for other in (delayed, right))
    for horizon in (20.0, 60.0):
        assert len(found[horizon].after) == len(whole[horizon].after) - 1
        assert np.isfinite(found[horizon].after).all()
    assert np.isinf(relative_losses(data, right, loose)[60.0].after).any()


def student_deviance(white: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """-2 log of Student's density by row, written out: ten degrees of freedom, this variance."""
    square = 8.0  # degrees less two: what the squares are counted in where the variance is one
    peak = math.lgamma(5.5) - math.lgamma(5.0) - 0.5 * math.log(square * math.pi)
    return (np.log(variance) + 11.0 * np.log1p(white**2 / square) - 2 * peak).sum(1)


def test_the_likelihood_of_held_out_rows_is_students(data, right, wrong):
    for fitted in (right, wrong):
        run = fitted.filter_run(data.test)
        white, variance, used = (
            np.asarray(part) for part in (run.white, run.variance, run.gains.used)
        )
        whole = used.all(1)
        assert whole.sum() > 100 and not used.all()
        found = row_deviance(data.test, fitted.coordinates, fitted.noise)
        np.testing.assert_allclose(found[whole], student_deviance(white, variance)[whole])
        assert (found[~used.any(1)] == 0.0).all()


def test_held_out_gains_are_normal_where_errors_are_small_and_bounded_where_not(data, right, wrong):
    near = dataclasses.replace(right, coordinates=right.coordinates - [0.0, 0.0, 0.0, 0.01, 0.01])

    def normal_gain(before, *noises) -> Gain:
        models = zip((before, right), noises, strict=True)
        runs = [data.test.run_filter(m.coordinates, noise) for m, noise in models]
        old, new = (np.asarray(run.white) ** 2 + np.log(np.asarray(run.variance)) for run in runs)
        return Gain.of_rows((old - new).sum(1)[data.test.dataset.recorded_rows])

    small, large = (held_out_gain(data, before, right) for before in (near, wrong))
    there = [noise_at(data.test, m.coordinates, m.noise) for m in (near, right)]
    assert small.clear and small.total == pytest.approx(normal_gain(near, *there).total, rel=0.15)
    sure = normal_gain(wrong, wrong.noise, right.noise)
    assert large.clear and small.total < large.total < 0.1 * sure.total
    assert held_out_gain(data, right, right).total == 0.0


def test_noise_that_runs_held_out_do_not_share_decides_nothing_about_the_vessel(data, right):
    near = dataclasses.replace(right, coordinates=right.coordinates - [0.0, 0.0, 0.0, 0.05, 0.05])
    calm = Noise.of(np.asarray(right.noise.scales) - 2.0)
    sure, usual = (
        row_deviance(data.test, one.coordinates, noise).sum()
        for one, noise in ((right, calm), (near, near.noise))
    )
    assert sure > usual + 1000.0  # the right model, of too little noise, by far the less likely
    quiet = dataclasses.replace(right, state=calm)
    found, expected = (held_out_gain(data, near, one) for one in (quiet, right))
    assert found.clear and found.total == pytest.approx(expected.total, rel=0.02)


def test_predictions_that_diverge_are_a_shortfall_and_told_in_words():
    found = Sufficiency(1.0, 1.0, 0.1, {20.0: 1.2, 60.0: math.inf}, {20.0: 2.0, 60.0: 2.0},
                        Whiteness(0.5, 1.0), 0.0)  # fmt: skip
    assert found.shortfalls == (Shortfall.MOTION,)
    assert found.reasons == ["free predictions diverge within 60 s"]


def test_what_several_threads_ask_of_a_model_is_calculated_once(right, wrong):
    known, made, begun = _Known(), [], threading.Event()

    def make() -> int:
        made.append(1)
        begun.wait(5.0)
        return len(made)

    def asked(number: int) -> int:
        if number == 2:  # the last one to ask: the others wait for the first
            begun.set()
        return known.of(right, make)

    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(asked, range(3))) == [1, 1, 1]
    assert known.of(wrong, make) == 2
    with pytest.raises(ZeroDivisionError):
        known.of(dataclasses.replace(right), lambda: 1 // 0)


def test_runs_that_change_places_are_judged_together(data, right, wrong):
    other = data.exchanged
    again, corrected = (exchanged_fit(data, model) for model in (right, wrong))
    assert exchanged_fit(data, right) is again
    assert (other.recordings, other.held_out) == (data.held_out, data.recordings)
    assert np.abs((again.coordinates - corrected.coordinates) / again.stds).max() < 0.2
    here, there = relative_losses(data, wrong, right), relative_losses(other, wrong, again)
    for horizon, both in pooled_losses(here, there).items():
        assert set(both.run) == {0, 1}
        np.testing.assert_array_equal(both.after[both.run == 1], there[horizon].after)
    assert MotionChange.of(pooled_losses(here, there)).is_better
    assert set(pooled_losses({20.0: here[20.0]}, {60.0: there[60.0]})) == {20.0, 60.0}


def test_runs_with_environments_of_their_own_do_not_change_places():
    problem = still_problem("current", runs=2, per_run=True)
    split = Split(problem, problem, None, (), ())
    with pytest.raises(ValueError, match="cannot change places"):
        exchanged_fit(split, linear_estimate(("X_u", "current")))


def test_what_is_stronger_than_weather_is_no_gust(data, right, wrong):
    """Gusts that a wrong model asks for end at their bound, sensor noise has none."""
    train = data.train
    prior = train.prior._replace(mean=train.prior.mean - np.repeat([3.0, 0.0], [9, 7]))
    dataset = train.dataset
    times = RowTimes(dataset.dt, dataset.run, first_variance(train.base))
    run = train.run_filter(wrong.coordinates, right.noise)
    found = np.asarray(refine_noise(run, times, Noise.of(prior.mean), prior, 15).noise.scales)
    off = (found - prior.mean)[:9] / prior.spread[:9]
    assert off.max() == pytest.approx(2.0, abs=1e-6)
    assert np.isinf(prior.highest[9:15]).all() and np.isfinite(prior.highest[15])


def test_one_block_tells_nothing_however_bad(data, right, wrong):
    (run,) = data.held_out
    short = dataclasses.replace(data, held_out=(cut(run, float(run.t[0]), float(run.t[0]) + 30.0),))
    change = motion_change(short, right, wrong)
    assert set(change.ratio) == {20.0} and change.ratio[20.0] > 2.0
    assert not change.is_worse


def test_what_was_not_measured_is_not_missed(data, right, wrong):
    """Without positions the headings tell."""
    (run,) = data.held_out
    nothing = np.full(run.t.shape, np.nan)
    turning = dataclasses.replace(data, held_out=(dataclasses.replace(run, x=nothing, y=nothing),))
    assert motion_change(turning, right, wrong).is_worse
    assert motion_misfit(turning, wrong).ratio[60.0] > 4.0


def test_noise_explains_what_a_right_model_misses_and_not_what_a_wrong_one_does(data, right, wrong):
    assert all(0.1 < ratio < 4.0 for ratio in motion_misfit(data, right).ratio.values())
    assert max(motion_misfit(data, wrong).ratio.values()) > 4.0
    assert shortfalls(data, right) == ()
    assert shortfalls(data, wrong) == (Shortfall.MISFIT, Shortfall.MOTION)


@pytest.mark.proof
def test_a_current_that_passes_for_gusts_is_missing_from_a_fit():
    """Innovations are at the noise level, and free predictions within what such gusts explain."""
    document = load(str(ORACLE / "usv.toml"))
    boat, hidden = build(document), {"current": {"speed": 0.25, "direction": 2.2}}
    runs = [random_steps(document, seed, 150.0, 0.5, hidden) for seed in (11, 12, 13)]
    effects = (EFFECTS["current"],)

    def problem_of(recordings, least):
        return make_problem(boat, recordings, FREE, effects, least=least)

    data = split_data(problem_of, runs[:2], runs[2:], per_run=False)
    without, found = estimate(data.train, FREE), estimate(data.train, (*FREE, "current"))
    verdict = FitVerdict(sufficiency(data, without), None, True)
    assert Shortfall.GUSTS in shortfalls(data, without)
    assert Shortfall.MISFIT not in shortfalls(data, without)
    assert verdict.missing and "gusts stronger than weather" in verdict.sentence
    assert not FitVerdict(sufficiency(data, found), None, True).missing
    assert shortfalls(data, found) == ()


def test_a_fit_says_that_something_is_missing_where_it_is_and_not_where_parameters_are_open(
    data, right, wrong
):
    sound = FitVerdict(sufficiency(data, right), None, True)
    assert not sound.missing and sound.sentence.startswith("nothing is missing")
    off = FitVerdict(sufficiency(data, wrong), None, True)
    assert off.missing and "diffsea diagnose" in off.sentence
    assert "times the noise" in off.sentence and "times what gusts and noise" in off.sentence
    assert "--starts" not in off.sentence
    assert "`--starts 8` says" in dataclasses.replace(off, one_start=True).sentence
    record = off.as_dict()
    assert record["misfit"]["mean_square"] > record["misfit"]["limit"]
    assert record["motion"]["60"]["ratio"] > record["motion"]["60"]["limit"]
    vague = dataclasses.replace(wrong, shrinkage=np.full(5, 0.1))
    open_ended = FitVerdict(sufficiency(data, vague), None, True)
    assert not open_ended.missing and "do not tell" in open_ended.sentence
    # Numbers of a sheet that are off say so whatever the runs do.
    assert FitVerdict(sufficiency(data, right), 0.001, True).missing
    assert not FitVerdict(None, 0.2, False).missing and FitVerdict(None, 0.001, False).missing


def test_coloured_innovations_are_told_from_white_ones():
    """A first-order autoregression of coefficient a has the long-run variance (1 + a) / (1 - a)."""
    rng, rows = np.random.default_rng(0), 4000
    run = np.repeat([0, 1, 2, 3], rows // 4)
    used = np.ones((rows, 6), bool)
    white = rng.normal(size=(rows, 6))
    chances = [
        whiteness(rng.normal(size=(400, 6)), used[:400], run[:400]).p_value for _ in range(200)
    ]
    assert np.mean(np.array(chances) < 0.05) < 0.09 and np.mean(np.array(chances) < 0.01) < 0.03
    coloured = white.copy()
    for k in range(1, rows):
        coloured[k, 2] += 0.5 * coloured[k - 1, 2] * (run[k] == run[k - 1])
    coloured[:, 2] *= np.sqrt(1 - 0.5**2)
    found = whiteness(coloured, used, run)
    assert found.is_rejected and found.p_value < 1e-20
    taper = sum(2 * 0.5**k * (1 - k / 11) for k in range(1, 11))
    assert found.colour == pytest.approx(1 + taper, rel=0.2)
    # A weak correlation is found, and does not matter.
    weak = 0.99 * white + 0.1 * np.roll(white, 1, axis=0)
    assert whiteness(weak, used, run).p_value < 0.01 and not whiteness(weak, used, run).is_rejected
    # A channel that is measured every other row has no neighbours at odd lags.
    sparse = used & ((np.arange(rows) % 2 == 0)[:, None] | (np.arange(6) != 2))
    there = whiteness(np.where(sparse, coloured, 0.0), sparse, run)
    pairs = [2 * 0.5**k * (1 - k / 11) for k in range(2, 11, 2)]
    assert there.p_value < 0.01 and there.colour == pytest.approx(1 + sum(pairs), rel=0.2)
    # The first of a run has nothing to do with the last of the one before.
    short = np.arange(rows)
    assert whiteness(coloured, used, short).p_value == 1.0


def test_what_gusts_explain_is_the_integral_of_their_spectrum():
    """Surge of a craft at rest, linearly damped: one linear system of x, u and gust (Van Loan)."""
    document = copy.deepcopy(load(str(ORACLE / "usv.toml")))
    document["hull"] |= {"X_u": -30.0}
    boat, horizon = build(document), 20.0
    inertia = float(boat.rigid_body.mass) - float(boat.added_mass.X_udot)
    problem = make_problem(boat, [still_run(boat, 120.0)], ("X_u",))
    white, lasting, memory, walk, none = 0.02, 0.01, 8.0, 0.05, 1e-9
    scales = [white, none, none, lasting, none, none, memory, 8.0, 8.0, *[1e-6] * 6, walk]
    found = expected_squares(problem, np.zeros(1), Noise.of(np.log(scales)), horizon)
    A = np.array([[0, 1, 0], [0, -30.0 / inertia, 1], [0, 0, -1 / memory]])
    noise = np.diag([0.0, white**2, 2 * lasting**2 / memory])
    whole = expm(horizon * np.block([[-A, noise], [np.zeros((3, 3)), A.T]]))
    F = whole[3:, 3:].T
    P = F @ whole[:3, 3:] + F @ np.diag([0.0, 0.0, lasting**2]) @ F.T
    wandered = 2 * walk**2 * horizon  # on both axes
    assert found[0] == pytest.approx(P[0, 0] + wandered, rel=0.02)
    assert found[1] < 1e-9


def test_a_model_that_the_data_do_not_determine_is_not_in_agreement_with_them(data, right):
    vague = dataclasses.replace(right, shrinkage=np.array([0.9, 0.1, 0.1, 0.1, 0.9]))
    assert shortfalls(data, vague) == (Shortfall.PARAMETERS,)


def test_block_bootstrap_has_the_error_of_a_mean_of_dependent_values():
    rng = np.random.default_rng(1)
    run = np.repeat([0, 1], 400)
    spread = []
    for _ in range(40):
        values = np.convolve(rng.normal(size=809), np.ones(10) / np.sqrt(10), "valid")
        spread.append(moving_block_draws(values, run, 40, 200, rng).std())
    exact = np.sqrt(10 / 800)  # ten values count as one
    assert np.mean(spread) == pytest.approx(exact, rel=0.2)
    assert exact > 2.5 / np.sqrt(800)  # as independent ones it would be a third of that
