# pyright: reportArgumentType=false
"""Metamodels: Norrbin's equation, its identification, ideal zig-zags, grouping, the experiment."""

import dataclasses
import math
import sys
from types import SimpleNamespace

from experiments.metamodels import gunnerus, pictures
from experiments.metamodels.metamodel import overshoots_at

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import t as student
from tests.experiment_runs import quick_run

from diffsea import Environment, State, Trajectory, UserError
from diffsea.metamodels.fit import (
    COMMON_MOMENT,
    OWN_MOMENTS,
    Trials,
    identify,
    identify_by_likelihood,
    trials_of,
)
from diffsea.metamodels.ideal_zigzag import Zigzag, ideal_zigzag, overshoots, overshoots_with_std
from diffsea.metamodels.norrbin import Norrbin, in_degrees
from diffsea.metrics.repeats import fit_percent, mean_and_half_width
from diffsea.segments.places import by_place, place_features


pytestmark = pytest.mark.experiment


RAD = math.pi / 180
MODEL = Norrbin(-5e-5, 0.022, 0.2, 120.0, 2.0e-3)

identified = jax.jit(identify)


def _rudder(count: int, seed: int) -> np.ndarray:
    """A rudder angle (rad) that moves evenly between random angles every 30 samples."""
    draw = np.random.default_rng(seed)
    marks = np.arange(0, count + 30, 30)
    return np.interp(np.arange(count), marks, 8 * RAD * draw.uniform(-1, 1, len(marks)))


def _trials(moments=(0.0,) * 4, noise=0.0, count=200, dt=2.0) -> Trials:
    draw = np.random.default_rng(3)
    delta = np.stack([_rudder(count, k) for k in range(len(moments))])
    # What an autopilot does: rudder against the moment.
    delta = delta - np.array(moments)[:, None] / MODEL.b * 0.8
    r = np.stack(
        [
            Norrbin(MODEL.a0 - m, MODEL.a1, MODEL.a2, MODEL.a3, MODEL.b).simulate(
                0.1 * RAD, jnp.asarray(d), dt
            )
            for m, d in zip(moments, delta, strict=True)
        ]
    )
    r = r + noise * draw.standard_normal(r.shape)
    return Trials(jnp.asarray(dt), jnp.asarray(delta), jnp.asarray(r), jnp.ones(r.shape, bool))


def test_simulation_is_the_equation_integrated():
    delta, dt = _rudder(120, 1), 1.0
    t = dt * np.arange(120)

    def rate(now, r):
        angle = np.interp(now, t, delta)
        return 5e-5 - 0.022 * r - 0.2 * r**2 - 120.0 * r**3 + 2.0e-3 * angle

    exact = solve_ivp(rate, (0, t[-1]), [0.2 * RAD], t_eval=t, rtol=1e-10, atol=1e-13, max_step=1.0)
    found = MODEL.simulate(0.2 * RAD, jnp.asarray(delta), dt)
    np.testing.assert_allclose(found, exact.y[0], rtol=0, atol=1e-9)


def test_without_cubic_it_is_nomoto():
    b = 0.08 / 45.0
    model = Norrbin(0.01 * b, 1 / 45.0, 0.0, 0.0, b)
    r = model.simulate(0.0, jnp.full(200, 0.11), 1.0)
    t = np.arange(200.0)
    np.testing.assert_allclose(r, 0.08 * 0.1 * (1 - np.exp(-t / 45.0)), atol=1e-8)
    assert float(model.gain) == pytest.approx(0.08)
    assert float(model.time_constant) == pytest.approx(45.0)
    assert float(model.neutral) == pytest.approx(0.01)
    assert float(model.simulate(0.0, jnp.full(50, 0.01), 1.0)[-1]) == pytest.approx(0.0, abs=1e-15)


def test_at_twice_the_speed_everything_happens_in_half_the_time():
    delta = jnp.asarray(_rudder(100, 2))
    slow = MODEL.simulate(0.0, delta, 2.0)
    fast = MODEL.at_speed(2.0).simulate(0.0, delta, 1.0)
    np.testing.assert_allclose(fast, 2 * slow, rtol=1e-9)


def test_degrees_and_radians_say_the_same():
    degrees = in_degrees(MODEL)
    r, delta = 0.4, 6.0
    rate = degrees["b"] * delta - (
        degrees["a0"] + degrees["a1"] * r + degrees["a2"] * r**2 + degrees["a3"] * r**3
    )
    assert rate * RAD == pytest.approx(float(MODEL.response(r * RAD, delta * RAD)))


def test_as_a_vessel_it_accelerates_as_the_equation_says_and_does_not_drift():
    vessel = MODEL.vessel(160.0, 7.7, wind_moment=3e-5)
    state = State(*(jnp.asarray(x) for x in (0.0, 0.0, 0.3, 7.7, 0.0, 0.006)))
    executed = {"rudder": jnp.asarray(0.1)}
    u_dot, v_dot, r_dot = vessel.acceleration(state, executed, Environment(), 0.0)
    assert float(r_dot) == pytest.approx(float(MODEL.response(0.006, 0.1)), rel=1e-9)
    assert abs(float(u_dot)) < 1e-12 and abs(float(v_dot)) < 1e-12
    # Apparent wind of 10 m/s from 45 deg on the starboard bow.
    still = dataclasses.replace(state, psi=jnp.zeros(()))
    part = 10 / math.sqrt(2)
    air = Environment(wind_north=7.7 - part, wind_east=-part)
    pushed = vessel.acceleration(still, executed, air, 0.0)[2]
    assert float(pushed - r_dot) == pytest.approx(3e-5, rel=1e-6)


def _zigzag_by_scipy(model, angle, heading, rate) -> list[float]:
    """First and second overshoot (rad), starboard first, by an adaptive integrator."""
    a0, a1, a2, a3, b = (float(c) for c in model.coefficients)
    time, state, peaks = 0.0, np.array([0.0, 0.0, a0 / b]), []
    for sense in (1.0, -1.0, 1.0):
        order = sense * angle

        def slopes(t, y, order=order):
            turning = 0.0 if abs(order - y[2]) < 1e-9 else math.copysign(rate, order - y[2])
            return [y[1], b * y[2] - a0 - a1 * y[1] - a2 * y[1] ** 2 - a3 * y[1] ** 3, turning]

        reached = time + abs(order - state[2]) / rate
        first = solve_ivp(slopes, (time, reached), state, rtol=1e-9, atol=1e-12, max_step=0.2)

        def passes(t, y, sense=sense):
            return sense * y[0] - heading

        passes.terminal, passes.direction = True, 1.0
        held = first.y[:, -1].copy()
        held[2] = order
        flat = solve_ivp(
            lambda t, y: [*slopes(t, y)[:2], 0.0], (reached, reached + 400), held,
            events=passes, rtol=1e-9, atol=1e-12, max_step=0.5,
        )  # fmt: skip
        path = np.concatenate([first.y, flat.y], axis=1)
        if time > 0:
            peaks.append(np.max(-sense * path[0]) - heading)
        time, state = flat.t[-1], flat.y[:, -1]
    return peaks


def test_ideal_zigzag_agrees_with_an_adaptive_integrator():
    wanted = Zigzag(rate_limit=2.5 * RAD)
    found = np.degrees(overshoots(MODEL, wanted))
    exact = np.degrees(_zigzag_by_scipy(MODEL, 10 * RAD, 10 * RAD, 2.5 * RAD))
    np.testing.assert_allclose(found, exact, atol=3e-3)
    run = ideal_zigzag(MODEL, wanted)
    assert np.interp(run.switch_times[0], run.t, run.psi) == pytest.approx(10 * RAD, abs=2e-5)


def test_overshoots_have_derivatives_through_the_switching():
    wanted = Zigzag(rate_limit=2.5 * RAD)
    theta = MODEL.coefficients
    values, spread = overshoots_with_std(MODEL, jnp.diag((0.02 * theta) ** 2), wanted)
    by_hand = np.zeros(2)
    for k in range(5):
        h = 1e-4 * theta[k]
        high, low = (overshoots(Norrbin.of(theta.at[k].add(s * h)), wanted) for s in (1, -1))
        by_hand += (np.asarray(high - low) / (2 * h) * 0.02 * theta[k]) ** 2
    np.testing.assert_allclose(spread, np.sqrt(by_hand), rtol=2e-2)
    assert np.all(np.asarray(values) > 0)


def test_least_squares_finds_the_coefficients():
    fit = identified(_trials())
    np.testing.assert_allclose(fit.model.coefficients, MODEL.coefficients, rtol=1e-5)
    np.testing.assert_allclose(fit.own[:, 0], 0.1 * RAD, rtol=1e-5)
    assert bool(fit.converged)


def test_trials_of_which_nothing_is_known_do_not_count():
    few, many = _trials(noise=1e-4), _trials((0.0,) * 6, noise=1e-4)
    known = many.known.at[4:].set(False)
    same = dataclasses.replace(
        many, known=known, r=many.r.at[:4].set(few.r), delta=many.delta.at[:4].set(few.delta)
    )
    one, other = identified(few), identified(same)
    np.testing.assert_allclose(one.model.coefficients, other.model.coefficients, rtol=1e-6)
    np.testing.assert_allclose(one.clustered, other.clustered, rtol=1e-5)


def test_moments_that_the_autopilot_answers_bias_all_but_a_fit_that_knows_of_them():
    moments = np.array([2.0, -3.0, 1.0, -1.0, 2.5, -1.5]) * 1e-5
    trials = _trials(tuple(moments), noise=1e-5)
    common, own = identified(trials, COMMON_MOMENT).model, identified(trials, OWN_MOMENTS).model
    off = np.abs(np.asarray(common.coefficients / MODEL.coefficients) - 1)
    less = np.abs(np.asarray(own.coefficients / MODEL.coefficients) - 1)
    assert off[1] > 0.02 and less[1] < 0.5 * off[1], (off, less)
    assert less[4] < 0.01
    found = identified(trials, OWN_MOMENTS).own[:, 1]
    np.testing.assert_allclose(found - np.mean(found), -(moments - moments.mean()), atol=1.5e-6)


def test_white_standard_errors_are_those_of_white_noise():
    fits = [identified(_noisy(seed)) for seed in range(40)]
    found = np.std([f.model.coefficients for f in fits], axis=0)
    said = np.sqrt(np.diag(fits[0].white))
    np.testing.assert_allclose(found / said, 1.0, atol=0.45)


def _noisy(seed: int) -> Trials:
    clean = _trials()
    noise = 2e-4 * np.random.default_rng(seed).standard_normal(clean.r.shape)
    return dataclasses.replace(clean, r=clean.r + noise)


def test_fit_percent_at_its_marks():
    y = jnp.asarray(np.random.default_rng(0).standard_normal(100))
    assert float(fit_percent(y, y)) == 100.0
    assert float(fit_percent(y, jnp.full(100, y.mean()))) == pytest.approx(0.0, abs=1e-12)
    half = jnp.arange(100) < 50
    assert float(fit_percent(y, jnp.where(half, y, 7.0), half)) == 100.0


def test_interval_of_repeats_is_students():
    values = [8.1, 9.0, 7.7, 8.6]
    mean, half = mean_and_half_width(values)
    assert mean == pytest.approx(8.35)
    assert half == pytest.approx(student.ppf(0.975, 3) * np.std(values, ddof=1) / 2)
    with pytest.raises(UserError, match="two or more"):
        mean_and_half_width([1.0, math.nan])


def test_trials_are_grouped_by_where_they_began_and_ended():
    draw = np.random.default_rng(1)
    centres = [(0, 0, 900, 0), (900, 0, 0, 0), (0, 5000, 300, 5900)]
    places = [
        tuple(np.array(centres[k]) + 30 * draw.standard_normal(4))
        for k in [0] * 12 + [1] * 7 + [2] * 5
    ]
    labels = by_place(places)
    assert labels.tolist() == [0] * 12 + [1] * 7 + [2] * 5
    assert by_place(places, 1).max() == 0
    table = place_features(places)
    assert np.abs(table.mean(0)).max() < 1e-12
    with pytest.raises(UserError, match="cannot make 30 groups"):
        by_place(places, 30)


def test_grouping_without_scikit_learn_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.cluster", None)
    with pytest.raises(UserError, match=r"diffsea\[places\]"):
        by_place([(0.0, 0.0, float(k), 0.0) for k in range(5)], 2)


def _recording(delta, r, dt: float, name: str) -> Trajectory:
    t = dt * np.arange(len(r))
    nothing = np.full(t.shape, np.nan)
    psi = np.concatenate([[0.0], np.cumsum(0.5 * (r[1:] + r[:-1])) * dt])
    return Trajectory(
        t, nothing, nothing, psi, nothing, nothing, r, {}, {"rudder": delta}, {},
        np.ones(t.shape, bool), name=name,
    )  # fmt: skip


def test_recordings_become_trials():
    short, long = (_recording(_rudder(n, n), np.zeros(n) + 0.01, 1.0, str(n)) for n in (50, 80))
    trials = trials_of([short, long], 2.0)
    assert trials.r.shape == (2, 40) and trials.known.sum() == 25 + 40
    with pytest.raises(UserError, match="no channel 'helm'; it has: rudder"):
        trials_of([short], 1.0, "helm")


def test_likelihood_finds_the_coefficients_under_each_trials_wind():
    draw = np.random.default_rng(5)
    runs = []
    for k, wind in enumerate((1.5e-5, -2e-5, 1e-5)):
        model = Norrbin(MODEL.a0 - wind, MODEL.a1, MODEL.a2, MODEL.a3, MODEL.b)
        fine = 3.0 * _rudder(400, k) - wind / MODEL.b
        r = np.asarray(model.simulate(0.0, jnp.asarray(fine), 1.0))
        r = r[::4] + 1e-4 * draw.standard_normal(100)
        runs.append(_recording(fine[::4], r, 4.0, f"trial {k}"))
    start = Norrbin(0.0, 0.03, 0.0, 60.0, 2.4e-3)
    found = identify_by_likelihood(runs, start, 160.0, 7.7)
    std = np.sqrt(np.diag(found.covariance))
    off = np.asarray(found.model.coefficients - MODEL.coefficients)
    assert np.all(np.abs(off) < 4 * std)
    assert std[4] < 0.05 * float(MODEL.b) and std[1] < 0.2 * float(MODEL.a1)


def test_an_ideal_trial_is_judged_by_the_intervals_of_every_repeated_day():
    asked = np.asarray(overshoots_at(MODEL, 12 * RAD))
    assert np.all(np.isfinite(asked)) and asked[0] != asked[1]
    # Two days of six trials, port first in every other: means hit on the first, 5 deg off in the
    # second overshoot on the other; trials to starboard are no part of it.
    scatter = 0.1 * RAD * np.array([-1.0, 0.0, 1.0])[:, None]
    table = np.full((12, 2), 1.0)
    table[1:6:2], table[7:12:2] = asked + scatter, asked + scatter + np.array([0.0, 5 * RAD])
    day, fit = SimpleNamespace(overshoots=table), SimpleNamespace(model=MODEL)
    found = gunnerus._to_12(day, [fit, fit])
    assert found["within"] == [True, True] and found["share_within"] == 0.75
    np.testing.assert_allclose(found["overshoots_deg"], np.degrees(asked))


def test_a_mean_is_drawn_while_nine_in_ten_trials_last():
    def piece(level: float, rows: int) -> SimpleNamespace:
        t = np.arange(rows) - 30.0
        return SimpleNamespace(t=t, channels={"u": np.full(rows, level), "r": level * RAD + 0 * t})

    pieces = [piece(4.0, 60), *(piece(2.0, 100) for _ in range(8)), piece(0.0, 140)]
    t, mean = pictures._mean(pieces, "u")
    np.testing.assert_allclose(t, np.arange(100) - 30.0)
    np.testing.assert_allclose(mean[:60], 2.0)
    np.testing.assert_allclose(mean[60:], 16 / 9)
    np.testing.assert_allclose(pictures._mean(pieces, "r")[1][:60], 2.0)


@pytest.fixture(scope="module")
def quick(tmp_path_factory) -> dict:
    """Results of the quick run."""
    folder = tmp_path_factory.mktemp("metamodels")
    found = quick_run("metamodels", folder)
    drawn = {p.name for p in (folder / "figures").iterdir()}
    assert {"service.png", "group.png", "chosen.png", "averaging.png"} <= drawn
    return found


@pytest.mark.proof
def test_every_published_figure_has_its_row(quick):
    rows = quick["comparison"]
    assert all(set(row) == {"quantity", "unit", "published", "obtained", "note"} for row in rows)
    published = [row["published"] for row in rows]
    assert {67.0, 35.0, 64.4, 62.3, 25.0, 30.0, 0.46} <= {p for p in published if p is not None}
    assert all(row["obtained"] is not None for row in rows)


def test_service_gives_groups_a_metamodel_and_an_order_of_models(quick):
    case = quick["case_1"]
    assert len(case["group_sizes"]) >= 2 and case["excluded"] < 0.2 * case["logs"]
    first = case["metamodels"][0]
    assert first["converged"] and first["coefficients"]["a1"] > 0
    assert first["cross_validation_percent"] > 60
    against = {k: v["against_metamodel_percent"] for k, v in case["validation"].items()}
    assert against["ship"] > against["model 2"] and against["model 1"] > against["model 2"]


def test_yaw_rate_falls_with_speed_and_somewhat_more_than_it(quick):
    speeds = quick["case_2"]["speeds"]
    for name in ("ship", "scaling"):
        assert 24 < speeds[name] < 44  # between in proportion to speed and to its square
    assert 5 < speeds["metamodels"] < 44


def test_corrected_averages_are_best_where_control_is_poor(quick):
    errors = quick["averaging"]["errors"]["poor"]["calm"]
    assert errors["corrected average"]["rms"][-1] < 0.8 * errors["metamodel"]["rms"][-1]
    assert errors["corrected average"]["rms"][0] < 0.8 * errors["average"]["rms"][0]


def test_own_moments_help_where_the_truth_is_known(quick):
    rows = {row["method"]: row for row in quick["beyond"]["tables"]["KNOWN"]}
    common, own = rows["least squares, white errors"], rows["own moments, errors by trial"]
    assert own["rms error of a1, %"] < common["rms error of a1, %"]
    assert own["95 % intervals hold, %"] > 80 > common["95 % intervals hold, %"]
