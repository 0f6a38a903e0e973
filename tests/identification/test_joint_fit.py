# pyright: reportArgumentType=false
"""Recordings and trial numbers in one fit: nearer to the truth than either, and who told what."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2
from tests.diagnosis.small import still_problem
from tests.oracle import sensors, trials
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE

from diffsea import EFFECTS, Trajectory, Vessel
from diffsea.identification.descent import filter_at
from diffsea.identification.estimates import (
    Estimate,
    FitOutcome,
    parameter_estimates,
    posterior_estimate,
)
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.objectives.joint import NumbersBeside, with_trial_numbers
from diffsea.identification.objectives.output_error import OutputError
from diffsea.identification.objectives.trial_numbers import (
    MeasuredTrial,
    TrialNumbers,
    acts_in_trials,
)
from diffsea.identification.problem import Problem, make_problem
from diffsea.identification.uncertainty.sources import sources
from diffsea.simulation import planning
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


HULL = ("X_u", "X_uu", "Y_v", "N_r", "N_rr", "N_rdot")
SEEDS = (1, 3)
THRUST = 200.0  # N, of the trials
STDS = {
    "advance": 0.1, "tactical_diameter": 0.15, "steady_turning_diameter": 0.15,
    "overshoot_1": math.radians(0.15), "overshoot_2": math.radians(0.15), "peak_yaw_rate": 0.003,
}  # fmt: skip
CIRCLE = ("advance", "tactical_diameter", "steady_turning_diameter", "peak_yaw_rate")
ZIGZAG = ("overshoot_1", "overshoot_2", "peak_yaw_rate")


@pytest.fixture(scope="module")
def document() -> dict:
    return load(str(ORACLE / "usv.toml"))


@pytest.fixture(scope="module")
def vessel(document) -> Vessel:
    """A vessel file that is wrong by a factor, up or down in turn."""
    hull = dict(document["hull"])
    for number, name in enumerate(HULL):
        hull[name] *= 1.5 if number % 2 else 1 / 1.5
    return build(document | {"hull": hull})


@pytest.fixture(scope="module")
def sheet(document, vessel) -> tuple[MeasuredTrial, ...]:
    """A turning circle and a zig-zag, as the independent simulator has them."""
    circle = trials.circle(document, THRUST, turns=1.5).metrics
    zigzag = trials.zigzag(document, THRUST, executes=3).metrics
    turn = planning.plan_trial(
        vessel, "turning-circle", math.radians(35), thrust=THRUST, keep_speed=False
    )
    switch = planning.plan_trial(
        vessel, "zigzag", math.radians(20), math.radians(20), thrust=THRUST, executes=3,
        keep_speed=False,
    )  # fmt: skip
    return tuple(
        MeasuredTrial(
            plan, names, np.array([found[n] for n in names]), np.array([STDS[n] for n in names])
        )
        for plan, names, found in ((turn, CIRCLE, circle), (switch, ZIGZAG, zigzag))
    )


def with_errors(sheet: tuple[MeasuredTrial, ...], seed: int) -> list[MeasuredTrial]:
    """The sheet as it was read off, with its errors."""
    rng = np.random.default_rng(seed)
    off = lambda trial: trial.stds * rng.normal(size=len(trial.stds))
    return [dataclasses.replace(one, values=one.values + off(one)) for one in sheet]


def straight_run(document: dict, seed: int) -> Trajectory:
    """Forty seconds of ahead and astern, hardly turning: it tells of surge alone."""
    rng = np.random.default_rng(seed)
    levels = rng.uniform(20, 210, 10)
    orders = [(4.0 * k, dict.fromkeys(("port", "starboard"), f)) for k, f in enumerate(levels)]
    sim = simulate(document, orders, 40.0)
    t = np.arange(0.0, 40.0, 0.5)
    rec = sensors.record(sim, t, sensors.suite(), rng, wrapped=False)
    return Trajectory(
        t, **{c: np.asarray(rec[c], float) for c in MOTION_CHANNELS},
        commanded={c: np.asarray(rec[f"cmd_{c}"], float) for c in ("port", "starboard")},
        executed={}, extra={}, valid=np.ones(len(t), bool), name=f"straight{seed}.csv",
    )  # fmt: skip


def distance(document: dict, objective: AbstractObjective, fitted: Estimate) -> float:
    """Root mean square of the parameters' errors, relative to the truth."""
    rows = parameter_estimates(objective.parameters, fitted)
    return math.sqrt(np.mean([(row.value / document["hull"][row.name] - 1) ** 2 for row in rows]))


def joint(vessel: Vessel, run: Trajectory, numbers: list[MeasuredTrial]) -> Problem:
    return with_trial_numbers(make_problem(vessel, [run], HULL), numbers)


@pytest.mark.proof
@pytest.mark.parametrize("seed", SEEDS)
def test_both_together_are_nearer_to_the_truth_than_either(document, vessel, sheet, seed):
    """The log tells nothing of turning, and the sheet cannot tell linear from quadratic drag."""
    numbers = with_errors(sheet, seed)
    problem = make_problem(vessel, [straight_run(document, seed)], HULL)
    log, told = Innovations(problem), TrialNumbers(vessel, problem.layout.parameters, numbers)
    both = Innovations(with_trial_numbers(problem, numbers))
    off = [distance(document, one, one.fit(HULL)) for one in (log, told)]
    fitted = both.fit(HULL)
    assert fitted.outcome is FitOutcome.CONVERGED
    assert distance(document, both, fitted) < 0.9 * min(off)
    for row in parameter_estimates(both.parameters, fitted):
        assert abs(row.value - document["hull"][row.name]) < 4 * row.std, row
    found = sources(both, fitted)
    assert found is not None
    by_log, by_numbers = found.recordings.determined, found.trial_numbers.determined
    assert by_log["X_u"] > 0.9 > 0.5 > by_numbers["X_u"]
    assert by_numbers["N_r"] > 0.8 > 0.5 > by_log["N_r"]
    assert found.p_value > 0.001 and found.trial_numbers.values == len(CIRCLE) + len(ZIGZAG)
    assert found.recordings.cost == pytest.approx(found.recordings.values, rel=0.2)


@pytest.mark.proof
def test_free_runs_take_numbers_besides(document, vessel, sheet):
    """The gradient that is assembled by hand is that of the cost, and the fit ends at its least."""
    objective = OutputError(joint(vessel, straight_run(document, 1), with_errors(sheet, 1)))
    index, rng = np.arange(len(HULL)), np.random.default_rng(1)
    state = objective.start(0.1 * rng.normal(size=len(HULL)))
    state = dataclasses.replace(state, joint=0.3 * state.sigma)
    gradient = 2 * objective.normal_equations(state, index).gradient
    direction = rng.normal(size=len(gradient))
    ends = [
        objective.state_cost(objective.state_after(state, index, s * 1e-5 * direction))
        for s in (1, -1)
    ]
    assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(gradient @ direction, rel=1e-5)
    fitted = objective.fit(HULL)
    for row in parameter_estimates(objective.parameters, fitted):
        assert abs(row.value - document["hull"][row.name]) < 4 * row.std, row
    numbers = objective.residuals(fitted.coordinates)
    assert all(abs(one.fitted - one.given) < 4 * one.std for one in numbers)


class Told:
    """Further data whose misfits are linear in the coordinates."""

    def __init__(self, J: np.ndarray, at: np.ndarray):
        self.J, self.at = J, at

    def misfits_and_jacobian(self, coordinates):
        return self.J @ (coordinates - self.at), self.J

    def residuals(self, coordinates):
        return []


def test_further_data_add_their_squares_and_their_information():
    """At rest the recordings say next to nothing: the estimate is that of prior and numbers."""
    plain = still_problem()
    at, J = np.array([0.2, -0.3]), np.array([[80.0, 0.0], [20.0, 100.0], [0.0, 60.0]])
    problem = dataclasses.replace(plain, further=Told(J, at))
    start, noise = problem.start()
    rise = filter_at(problem, start, noise).deviance - filter_at(plain, start, noise).deviance
    assert rise == pytest.approx(float(np.sum((J @ at) ** 2)))
    fitted = Innovations(problem).fit(("X_u", "N_r"))
    precision = J.T @ J + np.diag(1 / plain.layout.spreads() ** 2)
    np.testing.assert_allclose(
        fitted.coordinates, np.linalg.solve(precision, J.T @ J @ at), atol=1e-3
    )
    np.testing.assert_allclose(fitted.covariance, np.linalg.inv(precision), rtol=1e-3)


def test_sources_are_told_apart_by_their_information():
    """Recordings tell of X_u alone, numbers of N_r alone; shares are l / (l + 1 / spread^2)."""
    plain = still_problem()
    problem = dataclasses.replace(plain, further=Told(np.array([[0.0, 6.0]]), np.zeros(2)))
    objective = Innovations(problem)
    names, index = ("X_u", "N_r"), np.arange(2)
    spreads, information = plain.layout.spreads(), np.diag([100.0, 36.0])
    _, noise = problem.start()
    fitted = posterior_estimate(
        names, np.array([0.0, 0.25]), 0.0, index, spreads, information, state=noise
    )
    found = sources(objective, fitted)
    assert found is not None and sources(Innovations(plain), fitted) is None
    share = lambda value, k: value / (value + 1 / spreads[k] ** 2)
    assert found.recordings.determined == pytest.approx({"X_u": share(100, 0), "N_r": 0.0})
    assert found.trial_numbers.determined == pytest.approx({"X_u": 0.0, "N_r": share(36, 1)})
    assert found.together == pytest.approx({"X_u": share(100, 0), "N_r": share(36, 1)})
    assert found.trial_numbers.cost == pytest.approx(36 * 0.25**2) and found.recordings.cost >= 0
    assert found.p_value == pytest.approx(chi2.sf(36 * 0.25**2, 1))
    assert found.prior_cost == pytest.approx((0.25 / spreads[1]) ** 2)
    (direction,) = found.recordings.identifiability.undetermined
    assert direction.weights == {"N_r": 1.0} and direction.determined == 0.0
    told = " | ".join(found.sentences)
    assert "by the recordings alone, not by the trial numbers: X_u" in told
    assert "by the trial numbers alone, not by the recordings: N_r" in told


@pytest.mark.proof
def test_weather_sensors_and_changes_of_recordings_do_not_act_in_the_trials_of_a_sheet(sheet):
    problem = still_problem("current", "heading-offset", "drag-change", "thrust-asymmetry")
    problem = with_trial_numbers(problem, sheet)
    slots = problem.layout.slices
    off = np.zeros(problem.layout.size)
    for name in ("current", "heading-offset", "drag-change"):
        off[slots[name]] = 2.0
        assert not acts_in_trials(EFFECTS[name])
    assert problem.further is not None
    calm, J = problem.further.misfits_and_jacobian(np.zeros(problem.layout.size))
    assert np.array_equal(problem.further.misfits_and_jacobian(off)[0], calm)
    acting = np.flatnonzero(np.abs(J).sum(0))
    assert set(acting) == {0, 1, slots["thrust-asymmetry"].start}


class Overtaken(NumbersBeside):
    """Asked for another place, as by another thread, right after it has kept the first one."""

    place: np.ndarray | None = None

    @property
    def _last(self):
        return self._kept

    @_last.setter
    def _last(self, kept):
        self._kept, place, self.place = kept, self.place, None
        if place is not None:
            self.misfits_and_jacobian(place)


def test_who_asks_while_another_place_is_kept_gets_the_own_one(monkeypatch):
    class Numbers:
        def __init__(self, *given):
            pass

        def misfits_and_jacobian(self, coordinates):
            return coordinates[:1].copy(), np.ones((1, len(coordinates)))

    monkeypatch.setattr("diffsea.identification.objectives.joint.TrialNumbers", Numbers)
    problem = still_problem("gyro-bias")
    numbers = Overtaken(problem, ())
    first, numbers.place = np.full((2, problem.layout.size), [[1.0], [-1.0]])
    assert numbers.misfits_and_jacobian(first)[0] == 1.0
    assert numbers.misfits_and_jacobian(-first)[0] == -1.0
