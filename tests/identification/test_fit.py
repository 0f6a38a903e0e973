# pyright: reportArgumentType=false
"""Fits of recordings from the independent simulator recover what made them."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, toeplitz
from tests.oracle import sensors
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE

from diffsea import EFFECTS, Parameter, Trajectory, UserError
from diffsea.identification import study
from diffsea.identification.coordinates import negative_effects, vessel_at
from diffsea.identification.descent import filter_at
from diffsea.identification.estimates import FitOutcome, parameter_estimates, posterior_estimate
from diffsea.identification.filter.covariance import Noise, gust_propagation, measurement_update
from diffsea.identification.filter.kalman import deviance, first_variance, whitened_innovations
from diffsea.identification.filter.noise_fit import RowTimes, rerun_linearised
from diffsea.identification.fit import Start, compile_programs, estimate, normalised_rms
from diffsea.identification.multistart import effect_starts
from diffsea.identification.problem import make_problem
from diffsea.identification.residual import (
    group_size,
    innovations_at,
    linearise,
)
from diffsea.identification.study import FitSettings
from diffsea.parameters import hull_prior
from diffsea.statistics import autocorrelation, long_run_covariance, variance_inflation
from diffsea.vessel.files import build
from diffsea.vessel.forces import Wind


pytestmark = pytest.mark.slow


HULL = ("X_u", "X_uu", "Y_v", "N_r", "N_rr", "N_rdot")


@pytest.fixture(scope="module")
def document() -> dict:
    return load(str(ORACLE / "usv.toml"))


@pytest.fixture(scope="module")
def recordings(document) -> list[Trajectory]:
    """Two noisy runs of the file's own vessel, made by the oracle."""
    return [_run(document, seed) for seed in (1, 2)]


def _run(document: dict, seed: int, seconds: float = 80.0, gusts: bool = False) -> Trajectory:
    rng = np.random.default_rng(seed)
    blow = sensors.gust(rng, 0.0, seconds) if gusts else None
    times = np.arange(0.0, seconds, 4.0)
    orders = [
        (
            t,
            {
                n: v
                for n, v in zip(
                    ("port", "starboard"), 120 + 90 * rng.uniform(-1, 1, 2), strict=True
                )
            },
        )
        for t in times
    ]
    sim = simulate(document, orders, seconds, gust=blow, rtol=1e-8, atol=1e-10)
    t = np.arange(0.0, seconds, 0.25)
    rec = sensors.record(sim, t, sensors.suite(), rng, wrapped=False)
    motion = {c: np.asarray(rec[c], float) for c in ("x", "y", "psi", "u", "v", "r")}
    commanded = {c: np.asarray(rec[f"cmd_{c}"], float) for c in ("port", "starboard")}
    return Trajectory(
        t, **motion, commanded=commanded, executed={}, extra={}, valid=np.ones(len(t), bool),
        name=f"run{seed}.csv",
    )  # fmt: skip


def _away(document: dict, factor: float) -> dict:
    """The document with every fitted derivative wrong by a factor, up or down in turn."""
    hull = dict(document["hull"])
    for number, name in enumerate(HULL):
        hull[name] *= factor if number % 2 else 1 / factor
    return document | {"hull": hull}


@pytest.fixture(scope="module")
def fitted(document, recordings):
    problem = make_problem(build(_away(document, 1.4)), recordings, HULL)
    return problem, estimate(problem, HULL)


def test_derivatives_are_recovered_from_a_start_far_away(document, fitted):
    problem, result = fitted
    for row in parameter_estimates(problem.layout.parameters, result):
        truth = document["hull"][row.name]
        assert abs(row.value - truth) < 4 * row.std + 1e-9, row
        assert abs(row.start - truth) > 0.25 * abs(truth)
        assert row.std < 0.3 * abs(truth)


def test_innovations_are_at_the_noise_level(fitted):
    problem, result = fitted
    assert normalised_rms(result.filter_run(problem)) == pytest.approx(1, abs=0.05)


def test_sensor_noise_is_estimated(fitted):
    problem, result = fitted
    suite = sensors.suite()
    for k, channel in enumerate(("x", "y", "psi", "u", "v", "r")):
        estimated = math.exp(float(result.noise.sensor[k]))
        assert estimated == pytest.approx(suite[channel].noise, rel=0.35)


def test_a_wrong_start_predicts_worse(fitted):
    problem, result = fitted
    start, _ = problem.start()
    wrong = normalised_rms(problem.run_filter(start, result.noise))
    assert wrong > 1.5 * normalised_rms(result.filter_run(problem))


def test_sequential_update_equals_the_joint_kalman_update():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(9, 9))
    P, H, R = root @ root.T, rng.normal(size=(6, 9)), rng.uniform(0.5, 2.0, 6)
    used = np.array([True, True, False, True, True, True])
    still, late = np.zeros((9, 9)), np.zeros(6)
    C, W, after, variance = measurement_update(*map(jnp.asarray, (P, H, R, used, still, late)))
    h = H[used]
    S = h @ P @ h.T + np.diag(R[used])
    K = P @ h.T @ np.linalg.inv(S)
    nu = np.where(used, rng.normal(size=6), 0.0)
    np.testing.assert_allclose(np.asarray(C)[:, used], K, atol=1e-9)
    np.testing.assert_allclose(after, (np.eye(9) - K @ h) @ P, atol=1e-9)
    white = np.asarray(W) @ nu
    assert white @ white == pytest.approx(nu[used] @ np.linalg.solve(S, nu[used]))
    assert np.log(np.asarray(variance)).sum() == pytest.approx(np.linalg.slogdet(S)[1])


def test_a_sample_of_a_while_ago_tells_of_the_state_before_the_gusts():
    """y = h (x - w) + e with w the gusts since: conditioning of normal numbers."""
    rng = np.random.default_rng(1)
    before, Q = (root @ root.T for root in rng.normal(size=(2, 9, 9)))
    Q[:2] = Q[:, :2] = 0.0
    P, late = before + Q, np.array([0.0, 0.0, 0.6, 0.0, 0.3, 0.0])
    H, R, used = rng.normal(size=(6, 9)), rng.uniform(0.5, 2.0, 6), np.arange(6) == 4
    C, _, after, variance = measurement_update(*map(jnp.asarray, (P, H, R, used, Q, late)))
    cross = (P - 0.3 * Q) @ H[4]
    s = H[4] @ cross + R[4]
    assert float(variance[4]) == pytest.approx(s)
    np.testing.assert_allclose(np.asarray(C)[:, 4], cross / s)
    np.testing.assert_allclose(after, P - np.outer(cross, cross) / s, atol=1e-12)


@pytest.mark.parametrize("dt", [0.0, 0.02, 0.5, 3.0])
def test_gusts_over_a_row_are_the_integrals_of_their_equation(dt):
    """Van Loan's matrix exponential of d(speed) = a dt + g dw, d a = -a dt / T + b dw'."""
    noise = Noise.of(np.log([0.03, 0.02, 0.01, 0.2, 0.1, 0.05, 0.4, 3.0, 12.0, *np.ones(6), 0.5]))
    gusts, Q = gust_propagation(noise, jnp.array([dt]))
    for k in range(3):
        g, s, T = (math.exp(part[k]) for part in (noise.gust, noise.slow, noise.memory))
        A, L = np.array([[0, 1], [0, -1 / T]]), np.diag([g**2, 2 * s**2 / T])
        block = expm(np.block([[-A, L], [np.zeros((2, 2)), A.T]]) * dt)
        F = block[2:, 2:].T
        assert gusts.decay[0, k] == pytest.approx(F[1, 1])
        assert 2 * gusts.half[0, k] == pytest.approx(F[0, 1])
        both = np.ix_([3 + k, 6 + k], [3 + k, 6 + k])
        np.testing.assert_allclose(np.asarray(Q[0])[both], F @ block[:2, 2:], rtol=1e-6, atol=1e-15)
    # Fixes walk independently of all that, on two axes, and headings do not.
    np.testing.assert_allclose(np.diag(Q[0])[:3], [0.25 * dt, 0.25 * dt, 0.0])
    assert not np.triu(Q[0], 1)[:3].any()


def test_a_residual_without_derivatives_is_the_same_residual(fitted):
    problem, result = fitted
    gains = result.filter_run(problem).gains
    away = result.coordinates + 0.2 * np.resize([1.0, -1.0], result.coordinates.size)
    whole, _ = linearise(problem, gains, away, [0])
    alone = innovations_at(problem, gains, away)
    np.testing.assert_allclose(alone, whole[: alone.size], atol=1e-12)
    assert alone.size == problem.dataset.measured.size and np.abs(alone).max() > 1.0


def test_the_linearised_filter_repeats_the_filter_it_was_made_from(fitted):
    problem, result = fitted
    run = result.filter_run(problem)
    dataset = problem.dataset
    times = RowTimes(dataset.dt, dataset.run, first_variance(problem.base))
    white, variance = rerun_linearised(run, times, result.noise)
    np.testing.assert_allclose(white, run.white, atol=1e-9)
    np.testing.assert_allclose(variance, run.variance, rtol=1e-9)
    # With other noise it is another filter's, but for the curvature of the motion.
    other = Noise.of(result.noise.scales + 0.3 * np.resize([1.0, -1.0], 16))
    again = problem.run_filter(result.coordinates, other)
    white, variance = rerun_linearised(run, times, other)
    np.testing.assert_allclose(white, again.white, atol=0.05)
    np.testing.assert_allclose(variance, again.variance, rtol=0.02)
    assert np.abs(np.asarray(white - run.white)).max() > 0.5


def test_instances_for_each_run_share_directions_without_changing_the_jacobian(
    document, recordings
):
    effects = EFFECTS["current"], EFFECTS["wind"], EFFECTS["gyro-bias"]
    problem = make_problem(build(document), recordings, HULL, effects, per_run=True)
    start, noise = problem.start()
    index = problem.layout.indices((*HULL, *(effect.name for effect in effects)))
    gains = problem.run_filter(start, noise).gains
    start[index] = np.random.default_rng(0).normal(0.0, 0.1, len(index))
    residual, found = linearise(problem, gains, start, index)

    @jax.jit
    def white(at: jax.Array) -> jax.Array:
        return whitened_innovations(
            problem.base, problem.layout, problem.dataset, gains, at
        ).ravel()

    rows = problem.dataset.measured.size
    assert len(index) == 15 and group_size(problem.layout) < 11  # directions, in two groups
    np.testing.assert_allclose(found[:rows], jax.jacfwd(white)(start)[:, index], atol=1e-12)
    np.testing.assert_allclose(residual[:rows], white(start), atol=1e-12)
    strains = lambda at: problem.layout.strains(at, problem.layout.spreads())
    prior = slice(rows, rows + problem.layout.size)
    np.testing.assert_allclose(found[prior], jax.jacfwd(strains)(start)[:, index], atol=1e-12)
    np.testing.assert_allclose(residual[prior], strains(start), atol=1e-12)


def test_a_lag_is_told_from_gusts_that_last(document):
    """Gusts taken for white ones bend lag and inertia until they have the gusts' colour."""
    vessel = document | {"thruster": [t | {"time_constant": 0.8} for t in document["thruster"]]}
    runs = [_run(vessel, seed, gusts=True) for seed in (3, 4)]
    lag = EFFECTS["thrust-lag:propulsion"]
    problem = make_problem(build(_away(document, 1.2)), runs, HULL, (lag,))
    result = estimate(problem, (*HULL, lag.name))
    found = problem.layout.physical(lag.name, result.coordinates)[0, 0]
    std = math.sqrt(result.covariance[-1, -1]) * problem.layout.sizes[0][0]
    assert abs(found - 0.8) < 3 * std < 0.3
    assert result.inflation < 1.3


@pytest.mark.proof
def test_an_effect_is_sought_where_it_shows_itself(document):
    """Orders followed slowly have hardly a derivative where they are followed at once."""
    slow = document | {"thruster": [t | {"rate_limit": 30.0} for t in document["thruster"]]}
    runs = [_run(slow, seed) for seed in (3, 4)]
    settings = FitSettings(free=HULL, effects=("rate-limit",), starts=2, profiles=())
    result = study.identify(build(_away(document, 1.2)), runs, settings)
    found = result.effects["rate-limit:propulsion"][0]["rate_limit"]
    assert abs(found["value"] - 30.0) < 3 * found["std"] < 6.0
    assert result.agreement is not None and result.agreement.starts == 5


@pytest.mark.proof
def test_a_wind_is_found_with_the_superstructure_that_it_meets(document):
    """Twice to three times the usual areas, and a bow that turns into the wind."""
    house = {"frontal_area": 1.2, "lateral_area": 2.4, "C_X": 0.6, "C_Y": 0.9, "C_N": -0.04}
    blown = document | {"effect": [{"name": "wind", "speed": 9.0, "direction": 1.0, **house}]}
    runs = [_run(blown, seed) for seed in (3, 4)]
    settings = FitSettings(free=HULL, effects=("wind:coefficients",), profiles=())
    result = study.identify(build(_away(document, 1.2)), runs, settings)
    found = result.effects["wind:coefficients"][0]
    hull = document["hull"]
    front, side = hull["beam"] * hull["draught"], hull["length"] * hull["draught"]
    truth = {
        "speed": 9.0, "direction": 1.0, "C_X": 0.6 * 1.2 / front, "C_Y": 0.9 * 2.4 / side,
        "C_N": -0.04 * 2.4 / side,
    }  # fmt: skip
    for name, value in truth.items():
        assert abs(found[name]["value"] - value) < 4 * found[name]["std"], name
    assert found["speed"]["std"] < 2.0 and found["direction"]["std"] < 0.05
    assert [table["name"] for table in result.effect_tables] == ["wind"]
    again = build(document | {"effect": result.effect_tables})
    wind = again.forces["wind"]
    assert isinstance(wind, Wind)
    assert float(wind.C_N) == pytest.approx(found["C_N"]["value"])


def test_coefficients_that_runs_share_are_not_fitted_with_a_wind_of_each_run(document, recordings):
    settings = FitSettings(free=HULL, effects=("wind:coefficients",), per_recording=True)
    with pytest.raises(UserError, match="wind:coefficients.*all recordings share.*ask for wind,"):
        study.identify(build(document), recordings, settings)


def test_an_entry_of_all_coefficients_stands_for_its_parts(document):
    chosen = study.effects_to_estimate(build(document), ("wind", "thrust-lag"))
    assert [effect.name for effect in chosen] == ["wind", "thrust-lag:propulsion"]


def test_an_estimate_that_comes_out_impossible_is_told(document, recordings):
    lag = EFFECTS["thrust-lag:propulsion"]
    problem = make_problem(build(document), recordings, HULL, (lag,))
    names, index = (*HULL, lag.name), np.arange(len(HULL) + 1)
    spreads = problem.layout.spreads()

    def found(amount: float, deviance: float):
        at = np.append(np.zeros(len(HULL)), amount)
        return posterior_estimate(names, at, deviance, index, spreads, np.eye(len(index)))

    study.require_possible(problem, found(0.5, 0.0))
    with pytest.raises(UserError, match="do not show thrust-lag:propulsion.*--effects"):
        study.require_possible(problem, found(-0.5, 0.0))
    with pytest.raises(UserError, match="diverges on these data"):
        study.require_possible(problem, found(0.5, math.inf))


def test_what_every_start_makes_negative_is_told_not_to_be_there(document, recordings):
    """Positions that are early; a start at zero and one at a delay both lead below zero."""
    early = [
        dataclasses.replace(
            run, **{n: np.interp(run.t + 0.5, run.t, getattr(run, n)) for n in ("x", "y")}
        )
        for run in recordings
    ]
    settings = FitSettings(free=HULL, effects=("sensor-latency:position",), profiles=())
    with pytest.raises(UserError, match="do not show sensor-latency:position"):
        study.identify(build(document), early, settings)


def test_starts_of_effects_are_their_sizes_and_times(document, recordings):
    effects = tuple(EFFECTS[name] for name in ("rate-limit:propulsion", "thrust-change", "current"))
    one, other = recordings
    runs = [one, dataclasses.replace(other, t=other.t + 3000.0)]
    problem = make_problem(build(document), runs, HULL, effects)
    starts = effect_starts(problem)
    layout = problem.layout
    assert not starts[:, : len(HULL)].any() and not starts[0].any()
    late = [layout.physical("rate-limit:propulsion", row)[0, 0] for row in starts]
    assert sum(size > 0 for size in late) == len(effects[0].leading.secants) > 1
    times = [layout.physical("thrust-change", row)[0, 1] for row in starts]
    recorded = [at <= 80.0 or 3000.0 <= at <= 3080.0 for at in times]
    assert len(set(times)) > 4 and all(recorded) and max(times) > 3000.0
    assert not any(layout.physical("current", row).any() for row in starts)
    row = starts[-1].copy()
    row[layout.indices(("rate-limit:propulsion",))] = -1.0
    assert negative_effects(layout, row) == ["rate-limit:propulsion"] and not negative_effects(
        layout, starts[-1]
    )


def test_colour_inflates_the_variance_of_a_mean_as_theory_says():
    rng = np.random.default_rng(3)
    noise = np.zeros((20000, 6))
    for k in range(1, len(noise)):
        noise[k] = 0.5 * noise[k - 1] + rng.normal(size=6)
    found = variance_inflation(
        np.ones((noise.size, 1)), autocorrelation(noise, np.zeros(len(noise), int))
    )
    # Long-run over instantaneous variance of a first-order process: (1 + a) / (1 - a).
    assert found[0] == pytest.approx(3.0, rel=0.1)
    white = rng.normal(size=(20000, 6))
    plain = variance_inflation(
        np.ones((white.size, 1)), autocorrelation(white, np.zeros(20000, int))
    )
    assert plain[0] == pytest.approx(1.0, abs=0.15)


def test_products_with_correlations_are_those_of_their_matrix():
    """Written out as the banded symmetric Toeplitz matrix of each channel."""
    rng = np.random.default_rng(4)
    columns, correlation = rng.normal(size=(50 * 6, 3)), 0.2 * rng.normal(size=(7, 6))
    C = np.zeros((300, 300))
    for channel in range(6):
        band = toeplitz(np.concatenate([[1.0], correlation[:, channel], np.zeros(42)]))
        C[channel::6, channel::6] = band
    expected = columns.T @ C @ columns
    np.testing.assert_allclose(long_run_covariance(columns, correlation), expected, atol=1e-10)
    ratio = np.diag(expected) / (columns**2).sum(0)
    np.testing.assert_allclose(variance_inflation(columns, correlation), np.maximum(ratio, 1.0))


def test_a_fit_cannot_end_in_an_impossible_vessel(document, recordings):
    """Y_rdot + N_vdot so large that a vessel would speed up against a force predicts nothing."""
    effect = EFFECTS["added-mass-coupling:Y_rdot"]
    problem = make_problem(build(document), recordings, HULL, (effect,))
    start, noise = problem.start()
    place = problem.layout.indices((effect.name,))
    for size, possible in ((1.0, True), (60.0, False)):
        start[place] = size
        vessel, _ = vessel_at(problem.base, problem.layout, start)
        changed = effect.apply(problem.base, np.array([size * problem.layout.sizes[0][0]]))
        mass = np.asarray(changed.mass_matrix())
        assert (np.linalg.eigvalsh(0.5 * (mass + mass.T)).min() > 0) == possible
        assert bool(changed.has_inertia()) == possible
        assert np.isfinite(float(vessel.rigid_body.mass)) == possible
        assert np.isfinite(filter_at(problem, start, noise).deviance) == possible
    start[place] = 3.0
    fitted = estimate(problem, (*HULL, effect.name), Start(start))
    vessel, _ = vessel_at(problem.base, problem.layout, fitted.coordinates)
    assert bool(vessel.has_inertia())


def test_a_fit_that_was_cut_short_says_so(document, recordings):
    problem = make_problem(build(document), recordings, HULL)
    said: list[str] = []
    short = estimate(problem, HULL, rounds=1, progress=said.append)
    assert "not at its end after 1 steps" in said[-1]
    assert short.outcome is FitOutcome.STEP_LIMIT
    whole = estimate(problem, HULL, rounds=40, progress=said.append)
    assert "step" in said[-1] and "not at its end" not in said[-1]
    assert whole.outcome is FitOutcome.CONVERGED


def test_a_number_at_the_bound_of_its_prior_is_told(document, recordings):
    """Quadratic drag of the truth lies below the bound; the fit runs into it."""
    truth = document["hull"]["X_uu"]
    wide = Parameter("X_uu", 2 * truth, abs(truth), 3.0, lower=3 * truth, upper=1.5 * truth)
    problem = make_problem(build(document), recordings, ("X_uu",), priors={"X_uu": wide})
    assert estimate(problem, ("X_uu",)).outcome is FitOutcome.BOUNDED


def test_signs_survive_the_log_coordinate():
    drag = hull_prior("X_u", -52.0)
    assert float(drag.decode(-5.0)) < 0 and float(drag.decode(5.0)) < 0
    assert drag.encode(float(drag.decode(0.7))) == pytest.approx(0.7)
    coupling = hull_prior("Y_r", 10.0)
    assert float(coupling.decode(-3.0)) < 0


def test_unknown_parameter_names_the_nearest(document, recordings):
    with pytest.raises(UserError, match="no parameter 'N_rrr'; did you mean 'N_rr'"):
        make_problem(build(document), recordings, ("N_rrr",))


def test_missing_orders_are_told(document, recordings):
    silent = dataclasses.replace(recordings[0], commanded={})
    with pytest.raises(UserError, match="cmd_port"):
        make_problem(build(document), [silent])


def test_orders_between_kept_rows_are_averaged(document):
    """Thinned like this, a moving order is not late; the mean over all time stays."""
    t = np.arange(0.0, 30.0, 0.02)
    order = 100 + 80 * np.sin(0.7 * t)
    still = np.zeros_like(t)
    run = dataclasses.replace(
        _run(document, 1), t=t, x=still, y=still, psi=still, u=still, v=still, r=still,
        commanded={"port": order, "starboard": order}, executed={}, extra={},
        valid=np.ones(len(t), bool),
    )  # fmt: skip
    dataset = make_problem(build(document), [run], HULL).dataset
    kept = (np.asarray(dataset.dt) > 0) & ~dataset.lead_in
    dt = float(np.asarray(dataset.dt)[0])
    assert dt > 5 * 0.02
    middle = np.asarray(dataset.run_time)[kept][:-1] + 0.5 * dt
    found = np.asarray(dataset.orders["port"])[kept][:-1]
    np.testing.assert_allclose(found, 100 + 80 * np.sin(0.7 * (middle - 0.01)), atol=0.3)
    assert np.abs(found - (100 + 80 * np.sin(0.7 * (middle - 0.5 * dt)))).max() > 4.0


def test_a_fit_compiles_nothing_large_that_was_not_compiled_at_first(document, caplog):
    runs = [_run(document, seed) for seed in (5, 6, 7)]  # a shape that no other test has
    problem = make_problem(build(document), [*runs, *runs], HULL[:3])
    names = "run_filter", "_innovations_along", "_expected_curvature", "_slope"
    large = [f"jit({name})" for name in names]

    def compiled(work) -> list[str]:
        caplog.clear()
        jax.config.update("jax_log_compiles", True)  # in all threads, which a context is not
        try:
            work()
        finally:
            jax.config.update("jax_log_compiles", False)
        return [name for name in large if f"XLA compilation of {name}" in caplog.text]

    assert compiled(lambda: compile_programs(problem)) == large
    assert compiled(lambda: estimate(problem, HULL[:3])) == []


def test_the_filter_runs_once_at_an_estimate_and_anew_at_another(fitted):
    problem, result = fitted
    run = result.filter_run(problem)
    assert result.filter_run(problem) is run
    again = problem.run_filter(result.coordinates, result.noise)
    np.testing.assert_array_equal(run.white, again.white)
    other = dataclasses.replace(result, coordinates=result.coordinates + 0.1)
    assert float(deviance(other.filter_run(problem))) > float(deviance(run)) + 1.0
    copied = dataclasses.replace(problem)
    assert result.filter_run(copied) is not run
