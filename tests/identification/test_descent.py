# pyright: reportArgumentType=false
# Points made up have no run of a filter.
"""One step of a fit downhill, against exact derivatives of the filter and deviances made up."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea.identification import descent, fit
from diffsea.identification.descent import (
    Correction,
    FilteredPoint,
    descend,
    filter_at,
    gradient_by_differences,
)
from diffsea.identification.filter import kalman
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.noise_fit import RefinedNoise, refine_noise
from diffsea.identification.problem import make_problem
from diffsea.identification.residual import Linearisation, linearise
from diffsea.vessel.files import build


FREE = ("X_u", "Y_v", "N_r")
NO_RUN = SimpleNamespace(gains=SimpleNamespace(placement=None))  # of points made up


@pytest.fixture(scope="module")
def problem(late_orders):
    return late_orders


@pytest.fixture(scope="module")
def found(late_orders_fitted):
    return late_orders_fitted


@pytest.fixture(scope="module")
def away(problem, found):
    """Two standard errors from the fit's end, along no principal axis."""
    coordinates = found.coordinates.copy()
    coordinates[found.index] += 2 * found.stds * np.array([1.0, -1.0, 1.0])
    return filter_at(problem, coordinates, found.noise)


def test_differences_give_the_gradient_of_the_filters_own_deviance(problem, found, away):
    index = found.index

    @jax.jit
    def exact(free: jax.Array) -> jax.Array:
        def deviance(free: jax.Array) -> jax.Array:
            at = jnp.asarray(away.coordinates).at[index].set(free)
            known = problem.base, problem.layout, problem.dataset
            placement = away.run.gains.placement
            run = kalman.run_filter(*known, found.noise, at, placement)
            strains = problem.layout.strains(at, problem.layout.spreads())
            return kalman.deviance(run) + jnp.sum(strains**2)

        return jax.jacfwd(deviance)(free)

    true = np.asarray(exact(jnp.asarray(away.coordinates[index])))
    held = linearise(problem, away.run.gains, away.coordinates, index)
    got = gradient_by_differences(problem, away, index, held)
    errors = [np.abs((one - true) * found.stds).max() for one in (held.gradient, got)]
    assert errors[1] < 2e-3
    assert errors[0] > 0.1  # what held gains leave out


def test_an_axis_whose_curvature_is_rounding_spoils_no_other(problem, found, away):
    index = found.index
    held = linearise(problem, away.run.gains, away.coordinates, index)
    expected = gradient_by_differences(problem, away, index, held)
    values, axes = np.linalg.eigh(held.curvature)
    values[0] = -1e-16 * values[-1]
    flat = SimpleNamespace(curvature=axes @ np.diag(values) @ axes.T, gradient=held.gradient)
    got = gradient_by_differences(problem, away, index, flat)
    assert np.isfinite(got).all()
    np.testing.assert_allclose(axes.T[1:] @ got, axes.T[1:] @ expected, rtol=0.02, atol=1e-3)


def test_a_slope_that_misleads_is_found_anew_and_leads_to_where_a_fit_ends(
    problem, found, away, monkeypatch
):
    """Held gains that say uphill where it is downhill."""

    def reversed_slope(*given):
        model = linearise(*given)
        return model._replace(residual=-model.residual)

    assert away.deviance - found.deviance > 4
    monkeypatch.setattr(descent, "linearise", reversed_slope)
    alone = descend(problem, away, found.index, np.zeros(3), Correction.NEVER)
    assert alone.refused and alone.point is away and not alone.is_last
    step = descend(problem, away, found.index, np.zeros(3), Correction.WHERE_REFUSED)
    assert step.corrected and step.point.deviance - found.deviance < 0.1


def test_at_the_end_no_step_is_taken(problem, found):
    here = filter_at(problem, found.coordinates, found.noise)
    step = descend(problem, here, found.index, np.zeros(3), Correction.WHERE_REFUSED)
    assert step.promised < 0.5
    assert here.deviance - step.point.deviance < 0.05


def test_a_fit_ends_only_where_the_filters_own_deviance_has_no_slope():
    """Though the slope by held gains is another: thrusters lag by two seconds, the model's do not.

    What held gains leave out is kept beside the estimate, so that other fits may begin there.
    """
    document = load(str(ORACLE / "usv.toml"))
    lag = {"thrust-lag": {"time_constant": 2.0, "actuators": ["port", "starboard"]}}
    runs = [random_steps(document, seed, 60.0, 0.25, lag) for seed in (4, 5)]
    problem = make_problem(build(document), runs, FREE)
    found = fit.estimate(problem, FREE)
    index = np.array(problem.layout.indices(FREE))
    here = filter_at(problem, found.coordinates, found.noise)
    held = linearise(problem, here.run.gains, here.coordinates, index)
    slope = gradient_by_differences(problem, here, index, held)
    in_errors = lambda gradient: np.abs(np.linalg.solve(held.curvature, gradient) / found.stds)
    assert found.outcome is fit.FitOutcome.CONVERGED
    assert in_errors(held.gradient).max() > 0.3
    assert in_errors(slope).max() < 0.02
    assert in_errors(held.gradient + found.left_out[index]).max() < 0.02


def of_a_valley(problem, monkeypatch, deviance) -> FilteredPoint:
    """A deviance of one coordinate in place of the filter's, at zero; its residual is straight."""
    noise, residual = problem.start()[1], np.zeros(1)

    def made(problem, coordinates, noise, placement=None) -> FilteredPoint:
        value = deviance(float(coordinates[0]))
        return FilteredPoint(coordinates, noise, NO_RUN, residual, value)

    monkeypatch.setattr(descent, "filter_at", made)
    return made(problem, np.zeros(1), noise)


def along(problem, now, gradient):
    """The step by a model whose deviance bends as x^2, and what it promised."""
    model = Linearisation(np.zeros(1), np.eye(1))
    return descent._along_parabola(problem, now, np.array([0]), model, np.array([gradient]))


@pytest.mark.parametrize(
    ("bend", "share"), [(1.0, 1.0), (3.0, 1 / 2), (100.0, 1 / 64), (500.0, 1 / 256)]
)
def test_a_step_is_shortened_until_it_keeps_what_it_promised(problem, monkeypatch, bend, share):
    """The model takes the deviance (1 - x)^2 - 1 for flatter than it is by a factor of `bend`."""
    now = of_a_valley(problem, monkeypatch, lambda x: bend * x**2 - 2 * x)
    point, promised = along(problem, now, -2.0)
    assert promised == pytest.approx(1.0)
    assert point.coordinates[0] == pytest.approx(share, rel=1e-6)


def test_nothing_is_tried_where_little_is_promised(problem, monkeypatch):
    now = of_a_valley(problem, monkeypatch, lambda x: -1e3 * x)
    point, promised = along(problem, now, -0.02)
    assert point is now and promised == pytest.approx(1e-4)


@pytest.mark.parametrize("bottom, taken", [(1.0, True), (0.2, False)])
def test_what_promises_less_than_counts_is_tried_straight_and_whole(
    problem, monkeypatch, bottom, taken
):
    tried = []

    def deviance(x: float) -> float:
        tried.append(x)
        return (x - bottom) ** 2

    now = of_a_valley(problem, monkeypatch, deviance)
    tried.clear()
    model = Linearisation(np.zeros(1), np.ones((1, 1)))
    point, promised = descent._along_parabola(
        problem, now, np.array([0]), model, np.array([-2.0]), least=1.1
    )
    assert promised == pytest.approx(1.0) and tried == [1.0]
    assert point.coordinates[0] == (1.0 if taken else 0.0)


def test_a_step_out_of_where_the_filter_diverges_is_taken(problem, monkeypatch):
    now = of_a_valley(problem, monkeypatch, lambda x: 1.0 if 0 < x < 0.6 else np.nan)
    point, _ = along(problem, now, -2.0)
    assert point.coordinates[0] == pytest.approx(0.5)


class BentValley:
    """Rosenbrock's: y = x^2 but for a thousandth, the bottom at (1, 1); begun at zero."""

    slope = 1e3

    def __init__(self, problem, monkeypatch, disturbance=lambda x: 0.0):
        self.problem, self.disturbance = problem, disturbance
        monkeypatch.setattr(descent, "filter_at", self.at)
        self.start = self.at(problem, np.zeros(2), problem.start()[1])

    def at(self, problem, coordinates, noise, placement=None) -> FilteredPoint:
        x, y = coordinates
        residual = np.array([1.0 - x, self.slope * (y - x**2) + self.disturbance(x)])
        return FilteredPoint(coordinates, noise, NO_RUN, residual, float(residual @ residual))

    def step(self):
        model = Linearisation(self.start.residual, np.diag([-1.0, self.slope]))
        given = self.problem, self.start, np.arange(2), model, model.gradient
        return descent._along_parabola(*given)


def test_one_step_follows_a_valley_that_is_bent(problem, monkeypatch):
    """Along its tangent at zero the first good step is a 256th of the way."""
    valley = BentValley(problem, monkeypatch)
    point, promised = valley.step()
    assert promised == pytest.approx(1.0)
    assert point.coordinates == pytest.approx([1.0, 1.0], abs=1e-6)
    assert point.deviance < 1e-6
    along = [valley.at(None, np.array([share, 0.0]), None) for share in descent.STEP_SHARES]
    assert [one.better_than(valley.start) for one in along] == [False] * 5 + [True]


def test_half_a_step_has_a_quarter_of_the_bow(problem, monkeypatch):
    valley = BentValley(problem, monkeypatch, lambda x: 1e3 * max(x - 0.6, 0.0))
    point, _ = valley.step()
    assert point.coordinates == pytest.approx([0.5, 0.25], abs=1e-6)


class Bent:
    """Further data that bend with the first coordinate, as trial numbers do: `FurtherData`."""

    def misfits_and_jacobian(self, coordinates):
        slopes = np.zeros((1, len(coordinates)))
        slopes[0, 0] = 6.0 * coordinates[0]
        return np.array([3.0 * coordinates[0] ** 2 - 1.0]), slopes

    def residuals(self, coordinates):
        raise NotImplementedError


def test_the_bow_is_that_of_further_data_too(problem, found):
    """Their rows stand last in the residual, with their squares in the deviance."""
    alone = filter_at(problem, found.coordinates, found.noise)
    joint = dataclasses.replace(problem, further=Bent())
    beside = filter_at(joint, found.coordinates, found.noise)
    misfit = 3.0 * found.coordinates[0] ** 2 - 1.0
    np.testing.assert_allclose(beside.residual, [*alone.residual, misfit])
    assert beside.deviance - alone.deviance == pytest.approx(misfit**2, rel=1e-6)
    model = linearise(joint, beside.run.gains, beside.coordinates, found.index)
    assert model.residual == pytest.approx(beside.residual, abs=1e-6)


@pytest.mark.parametrize("behind", [np.nan, 1e6])
def test_what_lies_behind_does_not_keep_a_step_from_being_taken(problem, monkeypatch, behind):
    """A filter that diverges, or nearly, on the far side of where it stands."""

    def made(problem, coordinates, noise, placement=None) -> FilteredPoint:
        x = coordinates[0]
        residual = np.array([1.0 - x + (behind if x < 0 else 0.0)])
        return FilteredPoint(coordinates, noise, NO_RUN, residual, float(residual @ residual))

    monkeypatch.setattr(descent, "filter_at", made)
    now = made(problem, np.zeros(1), problem.start()[1])
    model = Linearisation(np.ones(1), -np.eye(1))
    point, _ = descent._along_parabola(problem, now, np.array([0]), model, model.gradient)
    assert point.coordinates[0] == pytest.approx(1.0)


def test_a_fit_ends_at_a_jump_with_all_that_does_not_jump_at_its_best(monkeypatch):
    """(1 - x)^2 + (2 - y)^2, and 10 more where x > 0, with samples in other rows there."""

    def placed(coordinates) -> SimpleNamespace:
        return SimpleNamespace(source=np.array([int(coordinates[0] > 0)]))

    def made(problem, coordinates, noise, placement=None) -> FilteredPoint:
        residual = np.array([1.0, 2.0]) - coordinates
        jump = 10.0 if (placement or placed(coordinates)).source[0] else 0.0
        run = SimpleNamespace(gains=SimpleNamespace(placement=placed(coordinates)))
        return FilteredPoint(coordinates, noise, run, residual, float(residual @ residual) + jump)

    monkeypatch.setattr(descent, "filter_at", made)
    slopes = lambda problem, gains, at, index: Linearisation(np.array([1.0, 2.0]) - at, -np.eye(2))
    monkeypatch.setattr(descent, "linearise", slopes)
    problem = SimpleNamespace(placement=placed)
    first, second = (
        descend(problem, made(problem, np.array(at), None), np.arange(2), np.zeros(2), corrects)
        for at, corrects in (((0.0, 0.0), Correction.NEVER), ((0.0, 2.0), Correction.AT_ONCE))
    )
    assert first.point.coordinates == pytest.approx([0.0, 2.0]) and not first.refused
    assert second.is_last and second.promised < 1e-6
    assert second.left_out == pytest.approx([0.0, 0.0], abs=1e-9)


def test_residuals_of_the_filter_bend_less_along_the_parabola(problem, found, away, monkeypatch):
    """Second differences over the whole way, as far as the model's slopes can tell."""
    visited = []

    def remember(*given) -> FilteredPoint:
        visited.append(filter_at(*given))
        return visited[-1]

    model = linearise(problem, away.run.gains, away.coordinates, found.index)
    assert model.residual == pytest.approx(away.residual, abs=1e-6)
    step = -np.linalg.solve(model.curvature, model.gradient)
    monkeypatch.setattr(descent, "filter_at", remember)
    descent._along_parabola(problem, away, found.index, model, model.gradient)
    taken = visited[2]  # after the two sides
    half = away.coordinates.copy()
    bow = (taken.coordinates - away.coordinates)[found.index] - step
    half[found.index] += 0.5 * step + 0.25 * bow
    straight = [away.coordinates.copy() for _ in range(2)]
    straight[0][found.index] += 0.5 * step
    straight[1][found.index] += step
    bends = []
    for middle, end in ((half, taken.coordinates), straight):
        there, far = (filter_at(problem, at, away.noise).residual for at in (middle, end))
        second = far - 2 * there + away.residual
        bends.append(np.linalg.norm(np.linalg.solve(model.curvature, model.jacobian.T @ second)))
    assert bends[0] < 0.25 * bends[1]


def test_noise_that_the_filter_refuses_is_tried_again_in_the_next_round(problem, monkeypatch):
    asked = []

    def refused(run, times, noise, prior, steps, curvature):
        asked.append(steps)
        return RefinedNoise(Noise.of(np.asarray(noise.scales) + 5.0), curvature)  # far worse

    monkeypatch.setattr(fit, "refine_noise", refused)
    fit.estimate(problem, FREE, fit.Start(*problem.start()), rounds=2)
    assert len(asked) == 2


def test_a_round_that_may_be_the_last_borrows_no_curvature(problem, monkeypatch):
    asked = []

    def refine(run, times, noise, prior, steps, curvature):
        asked.append((steps, curvature is not None))
        return refine_noise(run, times, noise, prior, steps, curvature)

    monkeypatch.setattr(fit, "refine_noise", refine)
    found = fit.estimate(problem, FREE, fit.Start(*problem.start()))
    assert found.outcome is fit.FitOutcome.CONVERGED
    borrowed = {steps: {one for count, one in asked if count == steps} for steps, _ in asked}
    assert borrowed.pop(fit.FIRST_NOISE_STEPS) == {False}
    assert any(True in rounds for rounds in borrowed.values())
