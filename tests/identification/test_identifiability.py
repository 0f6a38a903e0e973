"""Profiles, several starts, and what data determine: closed forms, and the next manoeuvre."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2
from tests.oracle.simulator import load
from tests.paths import ORACLE

from diffsea import Parameter
from diffsea.identification.estimates import (
    Estimate,
    normal_interval,
    parameter_estimates,
    posterior_estimate,
)
from diffsea.identification.multistart import multistart
from diffsea.identification.objectives.base import AbstractObjective
from diffsea.identification.problem import make_problem
from diffsea.identification.uncertainty.design import (
    LIBRARY,
    manoeuvre_information,
    next_manoeuvre,
    simulate_manoeuvre,
)
from diffsea.identification.uncertainty.identifiability import (
    asymmetric_parameters,
    identifiability,
    profile_interval,
)
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


A, B = Parameter("A", 2.0, spread=1.0), Parameter("B", -3.0, spread=0.5, upper=0.0)


class Cost(AbstractObjective):
    """An objective in closed form; refitting is a search over a fine grid of the others."""

    parameters, problem, outliers, one_sample_in = (A, B), None, {}, {}
    reach = np.linspace(-4, 4, 801)

    def __init__(self, cost):
        self.function = cost

    def cost(self, coordinates, fitted):
        return float(self.function(*coordinates))

    def squares(self, fitted):
        return self.cost(fitted.coordinates, fitted), 1

    def refit(self, fitted, free, start):
        other = [p.name for p in self.parameters].index(free[0])
        tried = np.tile(start, (len(self.reach), 1))
        tried[:, other] = self.reach
        costs = self.function(*tried.T)
        best = int(np.argmin(costs))
        return dataclasses.replace(fitted, coordinates=tried[best], deviance=float(costs[best]))

    def fit(self, free, start=None, progress=None):
        """Descend by halving steps."""
        at, step = np.zeros(2) if start is None else np.array(start, float), 0.5
        while step > 1e-4:
            around = [at + step * np.array(d) for d in ((1, 0), (-1, 0), (0, 1), (0, -1))]
            better = min(around, key=lambda point: self.function(*point))
            if self.function(*better) < self.function(*at):
                at = better
            else:
                step *= 0.5
        return estimate(at, np.diag([100.0, 100.0]), float(self.function(*at)))

    def explore(self, starts, free):
        ends = np.array([self.fit((), start).coordinates for start in starts])
        return ends, np.array([self.function(*end) for end in ends])


def estimate(at, information, deviance=0.0, parameters=(A, B), coloured=None) -> Estimate:
    spreads = np.array([p.spread for p in parameters])
    names = tuple(p.name for p in parameters)
    index = np.arange(len(parameters))
    return posterior_estimate(names, np.array(at), deviance, index, spreads, information, coloured)


def test_what_rounding_makes_of_an_information_is_not_taken_over():
    """One direction is known a million million times better, and the two halves do not agree."""
    direction = np.array([1.0, 1.0]) / math.sqrt(2)
    best, noise = 1e12 * np.outer(direction, direction), np.array([[-3.0, 2.0], [-2.0, -3.0]])
    fitted = estimate((0.0, 0.0), best + noise)
    np.linalg.cholesky(fitted.covariance)
    assert np.array_equal(fitted.covariance, fitted.covariance.T)
    across = np.array([1.0, -1.0]) / math.sqrt(2)
    prior = 1 / (across**2 @ np.array([1 / A.spread**2, 1 / B.spread**2]))
    assert across @ fitted.covariance @ across == pytest.approx(prior, rel=0.01)
    exact = estimate((0.0, 0.0), best)
    np.testing.assert_allclose(fitted.covariance, exact.covariance, rtol=1e-2)


def test_the_profile_of_a_parabola_is_the_interval_of_its_standard_error():
    H = np.array([[40.0, 12.0], [12.0, 30.0]])
    prior = np.diag([1 / A.spread**2, 1 / B.spread**2])
    objective = Cost(lambda a, b: H[0, 0] * a**2 + 2 * H[0, 1] * a * b + H[1, 1] * b**2)
    fitted = estimate((0.0, 0.0), H - prior)
    assert asymmetric_parameters(objective, fitted) == ()
    std = math.sqrt(np.linalg.inv(H)[0, 0])
    found = profile_interval(objective, fitted, "A")
    rise = math.sqrt(chi2.ppf(0.9, 1))
    assert found == pytest.approx((2 - rise * std, 2 + rise * std), abs=0.02)
    assert normal_interval(A, 0.0, std) == pytest.approx((2 - rise * std, 2 + rise * std), abs=1e-3)


def test_an_asymmetric_likelihood_is_seen_and_its_interval_follows_it():
    def cost(a, b):  # exponential in a: closed form of both ends
        return 4 * (np.exp(2 * a) - 1 - 2 * a) + 50 * b**2

    objective = Cost(cost)
    curvature = np.diag([8.0, 50.0])
    fitted = estimate((0.0, 0.0), curvature - np.diag([1.0, 4.0]))
    assert asymmetric_parameters(objective, fitted) == ("A",)
    low, high = profile_interval(objective, fitted, "A")
    rise = chi2.ppf(0.9, 1)
    for end in (low, high):
        assert cost(end - 2.0, 0.0) == pytest.approx(rise, rel=0.06)
    assert high - 2.0 < 0.75 * (2.0 - low)


def test_an_interval_that_the_data_leave_open_is_infinite():
    objective = Cost(lambda a, b: 2 * (1 - np.exp(-np.maximum(a, 0.0))) + 20 * np.minimum(a, 0) ** 2
                     + b**2)  # fmt: skip
    fitted = estimate((0.0, 0.0), np.diag([4.0, 4.0]))
    low, high = profile_interval(objective, fitted, "A")
    assert math.isinf(high) and 1.0 < low < 2.0


def test_colour_widens_profiles_as_it_widens_standard_errors():
    H = np.diag([40.0, 30.0])
    objective = Cost(lambda a, b: H[0, 0] * a**2 + H[1, 1] * b**2)
    information = H - np.diag([1.0, 4.0])
    fitted = estimate((0.0, 0.0), information, coloured=4 * information)
    low, high = profile_interval(objective, fitted, "A")
    rise = math.sqrt(chi2.ppf(0.9, 1)) * fitted.stds[0]
    assert fitted.stds[0] == pytest.approx(2 / math.sqrt(40), rel=0.02)
    assert (low, high) == pytest.approx((2 - rise, 2 + rise), abs=0.02)


def test_several_starts_find_the_better_of_two_optima_and_tell_of_the_other():
    def cost(a, b):  # minima near a = -1 (cost 3) and a = 1.5 (cost 0)
        return np.minimum(100 * (a + 1) ** 2 + 3, 100 * (a - 1.5) ** 2) + 100 * b**2

    best, agreement = multistart(Cost(cost), ("A", "B"), 12, seed=3)
    assert best.coordinates == pytest.approx([1.5, 0.0], abs=1e-3)
    assert agreement is not None
    assert agreement.rival == pytest.approx(3.0, abs=1e-3)
    assert 0 < agreement.agreeing < 12
    assert f"{agreement.agreeing} of 12 starts" in agreement.sentence


def test_what_the_data_leave_to_the_prior_is_told_as_directions():
    # Coordinates in prior units: one direction well known, the one across it not at all.
    across = np.array([[1.0, -1.0], [-1.0, 1.0]]) / 2
    spreads = np.diag([1 / A.spread, 1 / B.spread])
    information = spreads @ (400 * (np.eye(2) - across) + 0.25 * across) @ spreads
    found = identifiability((A, B), estimate((0.0, 0.0), information))
    (direction,) = found.undetermined
    assert direction.determined == pytest.approx(0.25 / 1.25)
    assert abs(direction.weights["A"]) == pytest.approx(math.sqrt(0.5))
    assert direction.weights["A"] == pytest.approx(-direction.weights["B"])
    assert found.groups == (("A", "B"),)
    assert any("determine 20 %" in told for told in found.sentences)
    known = identifiability((A, B), estimate((0.0, 0.0), 400 * np.eye(2)))
    assert known.undetermined == () and known.groups == () and known.sentences == []


def test_a_table_has_intervals_inside_the_bounds():
    rows = parameter_estimates((A, B), estimate((0.1, 0.0), np.diag([10.0, 0.01])))
    assert rows[0].value == pytest.approx(2.1) and rows[1].interval[1] < 0
    assert rows[1].determined < 0.01 < 0.9 < rows[0].determined


@pytest.fixture(scope="module")
def straight():
    """A problem that has seen speed change and nothing else, and an estimate of it."""
    document = load(str(ORACLE / "usv.toml"))
    vessel = build(document)
    free = ("X_u", "N_r", "Y_v")
    problem = make_problem(vessel, [simulate_manoeuvre(vessel, LIBRARY["speed steps"])], free)
    start, noise = problem.start()
    spreads = np.array([p.spread for p in problem.layout.parameters])
    empty = posterior_estimate(
        free, start, 0.0, np.arange(3), spreads, np.zeros((3, 3)), state=noise
    )
    run = simulate_manoeuvre(vessel, LIBRARY["speed steps"])
    J = manoeuvre_information(problem, run, empty, free)
    return problem, posterior_estimate(free, start, 0.0, np.arange(3), spreads, J, state=noise)


def test_straight_runs_say_nothing_of_turning_and_the_next_manoeuvre_does(straight):
    problem, fitted = straight
    told = identifiability(problem.layout.parameters, fitted)
    unknown = {name for direction in told.undetermined for name in direction.weights}
    assert unknown == {"N_r", "Y_v"}
    proposed = next_manoeuvre(problem, fitted)
    assert proposed is not None
    assert proposed.manoeuvre == max(proposed.gains, key=lambda name: proposed.gains[name])
    assert proposed.gains["speed steps"] < 0.5 < proposed.gains["zigzag"]
    assert proposed.stds["N_r"] < 0.1 and proposed.stds["Y_v"] < 0.2
    assert proposed.manoeuvre in proposed.sentence
