# pyright: reportArgumentType=false
"""Free runs and trial numbers recover what the independent simulator was given."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle import sensors, trials
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE

from diffsea import EFFECTS, Trajectory, UserError
from diffsea.identification.estimates import FitOutcome, ShootingState, parameter_estimates
from diffsea.identification.objectives import output_error
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.objectives.output_error import OutputError
from diffsea.identification.objectives.trial_numbers import TrialNumbers, read_trial_table
from diffsea.identification.problem import make_problem
from diffsea.identification.study import FitSettings, identify
from diffsea.simulation import planning
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build, default_priors


pytestmark = [pytest.mark.slow, pytest.mark.compiles]


HULL = ("X_u", "X_uu", "Y_v", "N_r", "N_rdot")
SECONDS, SPIKES = 60.0, (40, 111, 180)


@pytest.fixture(scope="module")
def document() -> dict:
    return load(str(ORACLE / "usv.toml"))


@pytest.fixture(scope="module")
def recordings(document) -> list[Trajectory]:
    """Two runs without gusts; the first has three positions far off."""
    runs = [_run(document, seed) for seed in (5, 6)]
    x = np.array(runs[0].x)
    x[list(SPIKES)] += 8.0
    return [dataclasses.replace(runs[0], x=x), runs[1]]


def _run(document: dict, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    orders = [
        (t, {c: 120 + 100 * rng.uniform(-1, 1) for c in ("port", "starboard")})
        for t in np.arange(0.0, SECONDS, 5.0)
    ]
    sim = simulate(document, orders, SECONDS, rtol=1e-8, atol=1e-10)
    t = np.arange(0.0, SECONDS, 0.25)
    rec = sensors.record(sim, t, sensors.suite(), rng, wrapped=False)
    return Trajectory(
        t, **{c: np.asarray(rec[c], float) for c in MOTION_CHANNELS},
        commanded={c: np.asarray(rec[f"cmd_{c}"], float) for c in ("port", "starboard")},
        executed={}, extra={}, valid=np.ones(len(t), bool), name=f"run{seed}.csv",
    )  # fmt: skip


def _away(document: dict, factor: float) -> dict:
    """The document with what is fitted wrong by a factor, up or down in turn."""
    hull = dict(document["hull"])
    for number, name in enumerate(HULL):
        hull[name] *= factor if number % 2 else 1 / factor
    return document | {"hull": hull}


@pytest.fixture(scope="module")
def problem(document, recordings):
    return make_problem(build(_away(document, 1.6)), recordings, HULL)


def assert_recovered(document: dict, parameters, fitted, widest: float = 0.2) -> None:
    for row in parameter_estimates(parameters, fitted):
        truth = document["hull"][row.name]
        assert abs(row.value - truth) < 4 * row.std, row
        assert abs(row.start - truth) > 0.3 * abs(truth)
        assert row.std < widest * abs(truth)


def test_free_runs_are_fitted_from_far_away_whatever_outliers_there_are(document, problem):
    objective = OutputError(problem)
    told: list[str] = []
    fitted = objective.fit(HULL, progress=told.append)
    assert_recovered(document, objective.parameters, fitted)
    assert isinstance(fitted.state, ShootingState)
    assert objective.windows.count >= 6 and len(told) == len(fitted.path)
    # Three positions 8 m off in 240 would raise the standard deviation of x to 0.9 m.
    assert fitted.state.sigma[0] == pytest.approx(0.05, rel=0.3)
    # At the end the windows are joined: it is one free run.
    gaps = objective.window_gaps(fitted.state, objective.shot(fitted.state))
    assert np.abs(gaps / fitted.state.sigma).max() < 0.1
    assert fitted.outcome is FitOutcome.CONVERGED


def test_gradient_of_multiple_shooting_is_that_of_its_cost(problem):
    """The blocks of the normal equations are assembled by hand; differences know nothing of it."""
    objective = OutputError(problem)
    rng = np.random.default_rng(1)
    states = objective.start().states
    sigma = np.array([0.5, 0.5, 0.1, 0.2, 0.2, 0.1])
    at = 0.1 * rng.normal(size=len(HULL))
    state = ShootingState(at, states, states + 0.1, sigma, 0.3 * sigma)
    index = np.arange(len(HULL))
    gradient = 2 * objective.normal_equations(state, index).gradient
    for _ in range(3):
        direction = rng.normal(size=len(gradient))
        ends = [
            objective.state_cost(objective.state_after(state, index, s * 1e-5 * direction))
            for s in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / 2e-5
        assert slope == pytest.approx(gradient @ direction, rel=1e-5)


def test_lone_outliers_are_left_out_of_the_innovation_likelihood(document, problem):
    objective = Innovations(problem)
    fitted = objective.fit(HULL)
    assert_recovered(document, objective.parameters, fitted)
    assert objective.outliers == {"x": len(SPIKES)}
    left_out = np.asarray(problem.dataset.known & ~objective.problem.dataset.known)
    assert left_out.sum() == len(SPIKES)


def test_soft_weights_fall_with_the_misfit():
    weight = output_error.soft_weight(np.array([0.0, 3.0, 300.0]))
    np.testing.assert_allclose(weight, [1.0, 1 / math.sqrt(2), 0.01], rtol=1e-3)


SHEET = """
format = 1
relative_std = 0.005
[[trial]]
manoeuvre = "zigzag"
angle = 20.0
heading = 20.0
side = "port"
thrust = 200.0
[trial.numbers]
overshoot_1 = {{ value = {first}, unit = "deg", std = 0.05 }}
overshoot_2 = {{ value = {second}, unit = "deg", std = 0.05 }}
approach_speed = {speed}
"""


def test_parameters_come_straight_from_trial_numbers(document, tmp_path):
    found = trials.zigzag(document, 200.0, side="port", executes=3).metrics
    first, second = (math.degrees(found[f"overshoot_{k}"]) for k in (1, 2))
    path = tmp_path / "trial.toml"
    text = SHEET.format(first=first, second=second, speed=found["approach_speed"])
    path.write_text(text, encoding="utf-8")
    hull = document["hull"] | {"N_rdot": -160.0, "X_u": -80.0}
    vessel = build(document | {"hull": hull})
    priors = default_priors(vessel)
    objective = TrialNumbers(
        vessel, [priors["N_rdot"], priors["X_u"]], read_trial_table(path, vessel)
    )
    fitted = objective.fit(("N_rdot", "X_u"))
    for row in parameter_estimates(objective.parameters, fitted):
        assert abs(row.value - document["hull"][row.name]) < 3 * row.std, row
        assert row.determined > 0.9
    for row in objective.residuals(fitted.coordinates):
        assert abs(row.fitted - row.given) < row.std, row


CIRCLE = """
[[trial]]
manoeuvre = "turning-circle"
angle = {angle}
side = "{side}"
speed = {speed}
seconds = 150.0
step = 0.2
[trial.numbers]
advance = {{ value = {advance}, std = 0.01 }}
tactical_diameter = {{ value = {tactical_diameter}, std = 0.01 }}
"""


@pytest.mark.proof
def test_an_effect_comes_out_of_trial_numbers_run_side_by_side(document, tmp_path):
    effect = EFFECTS["thrust-asymmetry"]
    uneven = effect.apply(build(document), jnp.array([0.06]))
    orders = [(35.0, "port", 1.0), (35.0, "starboard", 1.1), (20.0, "starboard", 1.0)]
    texts, expected = ["format = 1"], []
    for angle, side, speed in orders:
        plan = planning.plan_trial(
            uneven, "turning-circle", np.deg2rad(angle), side=1.0 if side == "starboard" else -1.0,
            speed=speed, seconds=150.0, step=0.2,
        )  # fmt: skip
        numbers = planning.run_and_measure(uneven, plan)[1]
        expected.append(numbers)
        texts.append(CIRCLE.format(angle=angle, side=side, speed=speed, **numbers))
    path = tmp_path / "circles.toml"
    path.write_text("".join(texts), encoding="utf-8")
    vessel = build(document)
    prior = default_priors(vessel)["N_r"]
    objective = TrialNumbers(vessel, [prior], read_trial_table(path, vessel), [effect])
    size = effect.sizes(vessel)[0]
    for found, numbers in zip(
        objective.numbers(np.array([0.0, 0.06 / size])), expected, strict=True
    ):
        for name, value in found.items():
            assert value == pytest.approx(float(numbers[name]), rel=1e-9)
    fitted = objective.fit(("N_r", "thrust-asymmetry"), start=np.array([0.3, 0.0]))
    assert fitted.coordinates[1] * size == pytest.approx(0.06, abs=1e-4)
    assert fitted.coordinates[0] == pytest.approx(0.0, abs=1e-3)
    without = objective.fit(("N_r",), start=np.array([0.3, 0.0]))
    assert without.coordinates[1] == 0.0
    assert without.deviance > fitted.deviance + 100


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("zigzag", "zigzagg"), "did you mean 'zigzag'"),
        (('"deg"', '"degree"'), "unknown unit 'degree'"),
        (("side", "sides"), "unknown key 'sides'"),
        (('"port"', '"left"'), "neither starboard nor port"),
        (("std = 0.05", "std = 0"), "above zero"),
        (("format = 1", "format = 2"), "is no sheet"),
        (("approach_speed = 1.0", "approach_speed = true"), "True is not a number"),
    ],
)
def test_mistakes_in_a_sheet_are_told(document, tmp_path, change, told):
    path = tmp_path / "trial.toml"
    text = SHEET.format(first=1.0, second=1.0, speed=1.0).replace(*change)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=told):
        read_trial_table(path, build(document))


def test_a_number_that_a_trial_does_not_have_is_told(document, tmp_path):
    path = tmp_path / "trial.toml"
    path.write_text(
        'format = 1\n[[trial]]\nmanoeuvre = "turning-circle"\nthrust = 200.0\n'
        "[trial.numbers]\novershoot_1 = 0.1\n",
        encoding="utf-8",
    )
    vessel = build(document)
    objective = TrialNumbers(
        vessel, [default_priors(vessel)["N_r"]], read_trial_table(path, vessel)
    )
    with pytest.raises(UserError, match="turning-circle has no number 'overshoot_1'"):
        objective.fit(("N_r",))


def test_objectives_and_data_must_go_together(document, recordings):
    vessel = build(document)
    for settings, told in (
        (FitSettings("trial-numbers"), "fitted to sheets"),
        (FitSettings("free_run"), "no objective 'free_run'"),
        (FitSettings(anchor="length"), "the anchor is one of"),
        (FitSettings(free=()), "nothing is free"),
    ):
        with pytest.raises(UserError, match=told):
            identify(vessel, recordings, settings)
