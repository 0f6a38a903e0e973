# pyright: reportArgumentType=false
"""Refits and the evidence for them: closed forms, and problems so small that none is fitted."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest
from scipy import stats
from tests.diagnosis.small import (
    CLEAR_GAIN,
    STEADY,
    candidate,
    hypothesis,
    judged,
    linear_estimate,
    still_problem,
    usv,
)

from diffsea import EFFECTS
from diffsea.diagnosis import refits
from diffsea.diagnosis.decision import rank_hypotheses
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.refits import (
    Refit,
    is_physical,
    make_hypothesis,
    near_the_best,
    refit_without,
    without_needless_wholes,
)
from diffsea.diagnosis.starts import (
    first_guess,
    start_as_part,
    start_beside,
    start_with_effects_of,
)
from diffsea.identification import fit
from diffsea.identification.coordinates import CoordinateLayout
from diffsea.identification.estimates import Estimate, FitOutcome, posterior_estimate
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.fit import Start
from diffsea.identification.holdout import Gain
from diffsea.identification.problem import Problem


def _linear(rng, columns, spreads, truth):
    """An exact linear model: the estimate, and the log evidence by the marginal density."""
    y = columns @ truth + rng.normal(size=len(columns))
    information = columns.T @ columns
    precision = information + np.diag(1 / spreads**2)
    at = np.linalg.solve(precision, columns.T @ y)
    deviance = ((y - columns @ at) ** 2).sum() + ((at / spreads) ** 2).sum()
    index = np.arange(len(spreads))
    fitted = posterior_estimate(("a",), at, deviance, index, spreads, information)
    covariance = np.eye(len(y)) + columns @ np.diag(spreads**2) @ columns.T
    return y, fitted, covariance


def test_the_evidence_of_a_linear_model_is_its_marginal_likelihood():
    rng = np.random.default_rng(8)
    X, spreads = rng.normal(size=(80, 4)), np.array([1.0, 0.5, 3.0, 3.0])
    truth = np.array([0.4, -0.3, 0.5, 0.0])
    y, more, wide = _linear(rng, X, spreads, truth)
    plain = X[:, :2]
    at = np.linalg.solve(plain.T @ plain + np.diag(1 / spreads[:2] ** 2), plain.T @ y)
    deviance = ((y - plain @ at) ** 2).sum() + ((at / spreads[:2]) ** 2).sum()
    less = posterior_estimate(("a",), at, deviance, np.arange(2), spreads[:2], plain.T @ plain)
    narrow = np.eye(80) + plain @ np.diag(spreads[:2] ** 2) @ plain.T
    exact = 2 * (
        stats.multivariate_normal(cov=wide).logpdf(y)
        - stats.multivariate_normal(cov=narrow).logpdf(y)
    )
    volume = np.linalg.slogdet(more.precision)[1] - np.linalg.slogdet(less.precision)[1]
    occam = float(volume + 2 * np.log(spreads[2:]).sum())
    seen = candidate("current", np.ones((3, 2)))
    one = Hypothesis("current", more, less, less.deviance - more.deviance, occam, None, seen, True)
    assert one.evidence(1.0) == pytest.approx(exact, abs=1e-6)
    assert one.evidence(2.0) < one.evidence(1.0)


def test_a_first_guess_keeps_to_the_physical_side():
    lag = EFFECTS["thrust-lag:propulsion"]
    seen = candidate(lag.name, np.ones((3, 1)), step=(-2.0,))
    assert first_guess(seen) == pytest.approx([0.1])
    bias = EFFECTS["gyro-bias"]
    seen = candidate(bias.name, np.ones((3, 1)), step=(-9.0,))
    assert first_guess(seen) == pytest.approx([-3])


def test_a_first_guess_is_of_the_size_at_which_it_was_seen():
    lag = EFFECTS["thrust-lag:propulsion"]
    seen = candidate(lag.name, np.ones((3, 1)), step=(-2.0,))
    point = dataclasses.replace(seen.point, at=(2.5,), secant=True)
    assert first_guess(dataclasses.replace(seen, point=point)) == pytest.approx([2.5])


def test_what_is_not_physical_hides_only_what_it_may_be_confused_with():
    early = hypothesis("sensor-latency:position", 160.0, is_physical=False)
    drag, lever = hypothesis("crossflow-drag", 60.0), hypothesis("lever-arm", 70.0)
    assert near_the_best([early, drag]) == ([early, drag], [])
    assert near_the_best([early, lever]) == ([early], [lever])
    late = dataclasses.replace(early, is_physical=True)
    assert near_the_best([late, drag]) == ([late], [drag])


def test_what_came_out_with_the_wrong_sign_brings_its_mirror_with_it():
    early = hypothesis("sensor-latency:but_position", 1000.0, is_physical=False)
    late = hypothesis("sensor-latency:position", 140.0)
    assert near_the_best([early, late]) == ([early, late], [])
    possible = dataclasses.replace(early, is_physical=True)
    assert near_the_best([possible, late]) == ([possible], [late])


@pytest.mark.parametrize(
    "more, fitted_on", [(0.1, False), (-0.1, False), (2.0, True), (-2.0, True)]
)
def test_an_effect_whose_fit_is_that_of_a_part_is_fitted_no_further(more, fitted_on):
    part = hypothesis("thrust-delay:port", 140.0)
    whole = hypothesis("actuator-response:port", 140.0 + more)
    elsewhere = hypothesis("actuator-response:starboard", 140.0)
    near, needless = without_needless_wholes([whole, part, elsewhere])
    assert near == ([whole] if fitted_on else []) + [part, elsewhere]
    assert needless == ([] if fitted_on else [whole])
    assert without_needless_wholes([whole]) == ([whole], [])


def test_every_hypothesis_as_good_as_the_best_is_judged_on_held_out_data():
    level = [f"quadratic-damping:{name}" for name in ("X_uu", "Y_vv", "N_rr")]
    strong = {name: 300.0 - k for k, name in enumerate([*level, "wind", "current"])}
    tried = [hypothesis(name, size) for name, size in (strong | {"gyro-bias": 250.0}).items()]
    near, rest = near_the_best(tried[::-1])
    assert [one.effect for one in near] == list(strong)
    assert [one.effect for one in rest] == ["gyro-bias"]
    diverged = hypothesis("lever-arm", float("nan"))
    assert near_the_best([*tried, diverged]) == (near, rest)


def test_a_held_out_run_that_diverges_disturbs_the_order_of_nobody_else():
    weak, strong = judged("wind", 100.0), judged("current", 300.0)
    lost = judged("gyro-bias", 200.0, STEADY, Gain(float("nan"), float("nan")))
    first = hypothesis("lever-arm", 400.0)
    order = [one.effect for one in rank_hypotheses([first, weak, lost, strong])]
    assert order == ["current", "wind", "gyro-bias", "lever-arm"]


def test_the_order_allows_for_the_dependence_of_the_best():
    """Held-out gain and evidence of dependent values count for less, room in the prior does not."""
    best = dataclasses.replace(judged("wind", 300.0), occam=30.0, inflation=10.0)
    lean = judged("current", 260.0)
    assert [one.effect for one in rank_hypotheses([best, lean])] == ["current", "wind"]
    even = dataclasses.replace(best, inflation=1.0, occam=20.0)
    assert [one.effect for one in rank_hypotheses([even, lean])] == ["wind", "current"]


def test_a_refit_starts_without_what_is_not_in_the_model_any_more():
    problem = still_problem("deadband:propulsion", "rate-limit:propulsion", "wind")
    layout = problem.layout

    def estimate(free: tuple[str, ...], deviance: float, **values: float) -> Estimate:
        out = np.zeros(layout.size)
        for name, value in values.items():
            effect = next(key for key in (*free, "wind") if key.replace("-", "_").startswith(name))
            out[layout.indices((effect,))] = value
        return dataclasses.replace(linear_estimate(free, deviance), coordinates=out)

    limit = "rate-limit:propulsion"
    then = ("X_u", "deadband:propulsion", limit)
    one = hypothesis(limit, 9.0)
    one = dataclasses.replace(one, estimate=estimate(then, 0.0, X_u=7, deadband=8, rate_limit=2))
    bare = estimate(("X_u", "wind"), 9.0, X_u=1, wind=4)
    here = estimate(("X_u", "wind", limit), 0.0, X_u=1, wind=4, rate_limit=2).coordinates
    np.testing.assert_array_equal(start_beside(problem, bare, one), here)
    same = dataclasses.replace(bare, free=("X_u", "deadband:propulsion"))
    np.testing.assert_array_equal(start_beside(problem, same, one), one.estimate.coordinates)
    better = dataclasses.replace(same, deviance=-1.0)
    np.testing.assert_array_equal(start_beside(problem, better, one), bare.coordinates)


NOISE, OTHER_NOISE = (Noise.of(np.full(16, level)) for level in (-3.0, -2.0))


def fitted_at(problem: Problem, noise: Noise, **values: float) -> Estimate:
    """An estimate of `X_u`, `N_r` and effects by name (hyphens and colons as underscores)."""
    known = {name: name.replace("-", "_").replace(":", "_") for name in problem.layout.slices}
    chosen = {name: values[key] for name, key in known.items() if key in values}
    free, out = ("X_u", "N_r", *chosen), np.zeros(problem.layout.size)
    for name, value in (chosen | {"X_u": values["X_u"]}).items():
        out[problem.layout.indices((name,))] = value
    bare = linear_estimate(free, 0.0, problem.layout.size)
    return dataclasses.replace(bare, coordinates=out, state=noise)


def test_another_fit_is_a_start_with_the_effects_that_it_lacks_and_no_others():
    problem = still_problem("wind", "deadband:propulsion", "rate-limit:propulsion")
    known = fitted_at(problem, NOISE, X_u=1.0, deadband_propulsion=5.0)
    other = fitted_at(problem, OTHER_NOISE, X_u=2.0, wind=4.0, rate_limit_propulsion=3.0)
    free = ("X_u", "N_r", "wind")
    start = start_with_effects_of(problem, known, other, free)
    expected = fitted_at(problem, NOISE, X_u=1.0, wind=4.0).coordinates
    np.testing.assert_array_equal(start.coordinates, expected)
    assert start.noise is NOISE


@pytest.mark.parametrize("other", ["other noise", "the other fit"])
@pytest.mark.parametrize("better", [0, 1])
def test_a_model_without_an_effect_is_the_better_of_two_fits(monkeypatch, other, better):
    """From where it was, and from the likeliest start by the noise of another fit without it."""
    problem = still_problem("wind", "deadband:propulsion")
    current = fitted_at(problem, NOISE, X_u=2.0, wind=4.0, deadband_propulsion=5.0)
    known = fitted_at(problem, OTHER_NOISE, X_u=1.0)
    bare = fitted_at(problem, NOISE, X_u=2.0, wind=4.0).coordinates
    there = fitted_at(problem, NOISE, X_u=1.0, wind=4.0).coordinates
    likeliest = bare if other == "other noise" else there
    ends = [dataclasses.replace(known, deviance=-1.0 * (place == better)) for place in (0, 1)]
    asked = []

    def deviance(_, coordinates, scales) -> SimpleNamespace:
        assert scales is OTHER_NOISE
        return SimpleNamespace(deviance=-9.0 if np.array_equal(coordinates, likeliest) else np.nan)

    def estimated(_, free, start) -> Estimate:
        assert free == ("X_u", "N_r", "wind")
        asked.append((start.coordinates, start.noise))
        return ends[len(asked) - 1]

    monkeypatch.setattr(fit, "filter_at", deviance)
    monkeypatch.setattr(refits, "estimate_surely", estimated)
    monkeypatch.setattr(refits, "on_every_core", lambda function, items: list(map(function, items)))
    found = refit_without(problem, current, ["deadband:propulsion"], known)
    assert found is ends[better]
    for (start, scales), at, noise in zip(
        asked, (bare, likeliest), (NOISE, OTHER_NOISE), strict=True
    ):
        np.testing.assert_array_equal(start, at)
        assert scales is noise


def test_where_a_part_ended_is_a_start_of_the_whole():
    names = ("thrust-delay:propulsion", "rate-limit:propulsion")
    wholes = ("actuator-response:propulsion", "actuator-response:propulsion-slew")
    problem = still_problem(*names, *wholes)
    late = fitted_at(problem, NOISE, X_u=1.0, thrust_delay_propulsion=2.0)
    for whole in wholes:
        start = start_as_part(problem, late, names[0], whole)
        at = start.coordinates[problem.layout.indices((whole,))]
        np.testing.assert_allclose(at, [2.0, 0.0], atol=1e-12)
        assert not start.coordinates[problem.layout.indices((names[0],))].any()
        assert start.coordinates[0] == 1.0 and start.noise is NOISE


@pytest.mark.parametrize("outcome", [FitOutcome.CONVERGED, FitOutcome.STALLED])
def test_a_part_that_converged_is_a_start_for_the_whole_and_for_nothing_else(monkeypatch, outcome):
    part, whole = "thrust-delay:propulsion", "actuator-response:propulsion"
    problem = still_problem(part, whole, "wind")
    current = fitted_at(problem, NOISE, X_u=1.0)
    late = fitted_at(problem, NOISE, X_u=1.0, thrust_delay_propulsion=2.0)
    late = dataclasses.replace(late, outcome=outcome)
    ends, given = {part: late, whole: current, "wind": current}, {}

    def settle(problem, fitted, plainer):
        given[len(given)] = [start.coordinates for start in plainer]
        return fitted

    monkeypatch.setattr(refits, "estimate", lambda _, free, start: ends[free[-1]])
    monkeypatch.setattr(refits, "settled", settle)
    monkeypatch.setattr(refits, "judge_fitted", lambda data, current, fitted, seen: seen)
    monkeypatch.setattr(refits, "on_every_core", lambda function, items: list(map(function, items)))
    asked = [Refit(candidate(name, np.ones((3, 1))), [Start.at(current)]) for name in ends]
    refits.refit_fully(SimpleNamespace(train=problem), current, asked)
    parts = [0, outcome is FitOutcome.CONVERGED, 0]
    assert [len(starts) for starts in given.values()] == [1 + number for number in parts]
    for first, *_ in given.values():  # the model without any of them
        assert first is current.coordinates
    for start in given[1][1:]:
        expected = fitted_at(problem, NOISE, X_u=1.0).coordinates
        expected[problem.layout.indices((whole,))[0]] = 2.0
        np.testing.assert_allclose(start, expected)


def _shallow(amounts, stds, recorded: int) -> tuple[Problem, Estimate]:
    """A fit of a shallowness for each run, of which the first ones were recorded."""
    count = len(amounts)
    least = still_problem(runs=count).dataset.shape
    problem = still_problem("shallow-water", runs=recorded, per_run=count > 1, least=least)
    index = np.array(problem.layout.indices(("shallow-water",)))
    coordinates = np.zeros(problem.layout.size)
    coordinates[index] = amounts
    fitted = dataclasses.replace(
        linear_estimate(("shallow-water",), size=count),
        coordinates=coordinates,
        index=index,
        precision=np.diag(1 / np.array(stds) ** 2),
        covariance=np.diag(4.0 * np.array(stds) ** 2),
    )
    return problem, fitted


@pytest.mark.parametrize(
    ("amounts", "stds", "recorded", "physical"),
    [
        ([2.3, -0.03, 0.0], [0.1, 0.1, 3.0], 2, True),  # what is absent in one run may be
        ([2.3, -0.5, 0.0], [0.1, 0.1, 3.0], 2, False),
        ([2.3, -0.03, -9.0], [0.1, 0.1, 3.0], 2, True),  # of a run that is not there
        ([-0.03, -0.1], [0.1, 0.1], 2, False),
        ([-0.03], [0.1], 1, False),
        ([0.03], [0.1], 1, True),
    ],
)
def test_what_cannot_be_negative_may_be_absent_in_some_runs(amounts, stds, recorded, physical):
    problem, fitted = _shallow(amounts, stds, recorded)
    effect = EFFECTS["shallow-water"]
    seen = candidate(effect.name, np.ones((3, 1)))
    assert is_physical(problem, fitted, seen) == physical


def test_an_effect_is_weighed_by_the_dependence_of_its_own_scores():
    problem, fitted = _shallow([1.0, 1.0], [0.1, 0.2], 2)
    seen = candidate("shallow-water", np.ones((3, 1)))
    one = make_hypothesis(problem, linear_estimate(), fitted, seen)
    assert one.inflation == pytest.approx(4.0)
    assert (one.instances, one.size) == (2, 2)


def _one_size(effect: str, value: float, std: float) -> Estimate:
    """A fit of one number of an effect's, in SI units."""
    size = EFFECTS[effect].sizes(usv())[0]
    problem = still_problem(effect)
    index = np.array(problem.layout.indices((effect,)))
    coordinates = np.zeros(problem.layout.size)
    coordinates[index] = value / size
    fitted = dataclasses.replace(linear_estimate((effect,)), coordinates=coordinates, index=index)
    return dataclasses.replace(fitted, precision=np.array([[(size / std) ** 2]]))


def test_sizes_that_no_vessel_has_are_impossible_as_far_as_errors_tell():
    name, std = "thrust-asymmetry", 0.03
    problem = still_problem(name)
    seen = candidate(name, np.ones((3, 1)))

    def possible(ratio: float) -> bool:
        return is_physical(problem, _one_size(name, ratio, std), seen)

    assert possible(0.9) and possible(-0.9)
    assert possible(1.0 + 1.9 * std)
    assert not possible(1.0 + 2.1 * std)
    assert not possible(-1.5)


@pytest.mark.parametrize(
    ("sizes", "possible"),
    [((1.0, 0.4, 0.5), True), ((-1.0, -0.4, 0.5), True), ((1.0, -0.4, 0.5), False),
     ((-0.2, 0.1, 0.0), False), ((0.0, 1.0, -1.0), True)],
)  # fmt: skip
def test_added_masses_of_opposite_signs_are_no_vessels(sizes, possible):
    name = "added-mass-coupling"
    problem = still_problem(name)
    index = np.array(problem.layout.indices((name,)))
    coordinates = np.zeros(problem.layout.size)
    coordinates[index] = sizes
    fitted = dataclasses.replace(
        linear_estimate((name,), size=3), coordinates=coordinates, index=index
    )
    assert is_physical(problem, fitted, candidate(name, np.ones((3, 3)))) == possible


@pytest.mark.parametrize(("lever", "possible"), [(0.2, True), (-0.24, True), (0.26, False)])
def test_the_middle_of_the_added_mass_lies_in_the_hull(lever, possible):
    """`lever` is in lengths off amidships: half a hull that had all of it would have L / 4."""
    name, vessel = "added-mass-coupling:N_vdot", usv()
    coupling = lever * vessel.rigid_body.length * float(vessel.added_mass.Y_vdot)
    problem = still_problem(name)
    index = np.array(problem.layout.indices((name,)))
    coordinates = np.zeros(problem.layout.size)
    coordinates[index] = coupling / EFFECTS[name].sizes(vessel)[0]
    fitted = dataclasses.replace(linear_estimate((name,)), coordinates=coordinates, index=index)
    assert is_physical(problem, fitted, candidate(name, np.ones((3, 1)))) == possible


@pytest.mark.parametrize(("x_G", "possible"), [(0.1, True), (-0.24, True), (-0.249, False)])
def test_a_centre_of_gravity_is_not_held_by_its_bound(x_G, possible):
    """`x_G` is in lengths: its bound is a quarter."""
    name, vessel = "added-mass-coupling:x_G", usv()
    problem = still_problem(name)
    index = np.array(problem.layout.indices((name,)))
    coordinates = np.zeros(problem.layout.size)
    coordinates[index] = x_G * vessel.rigid_body.length / EFFECTS[name].sizes(vessel)[0]
    fitted = dataclasses.replace(linear_estimate((name,)), coordinates=coordinates, index=index)
    assert is_physical(problem, fitted, candidate(name, np.ones((3, 1)))) == possible


@pytest.mark.parametrize(
    ("time", "possible"), [(-2.0, False), (0.0, False), (6.0, True), (19.2, False), (19.5, False)]
)
def test_a_change_happens_while_something_is_recorded(time, possible):
    """The data set counts the time of its first run from `first`; the last row has no value."""
    name = "drag-change"
    problem, size = still_problem(name), EFFECTS[name].sizes(usv())[1]
    rows = np.flatnonzero(np.asarray(problem.dataset.known).any(1))
    known = problem.dataset.known.at[rows[-1]].set(False)
    problem = dataclasses.replace(
        problem, dataset=eqx.tree_at(lambda data: data.known, problem.dataset, known)
    )
    first = float(problem.dataset.run_time[rows[0]])
    index = np.array(problem.layout.indices((name,)))
    coordinates = np.zeros(problem.layout.size)
    coordinates[index] = 1.0, (first + time) / size
    fitted = dataclasses.replace(
        linear_estimate((name,), size=2), coordinates=coordinates, index=index
    )
    seen = candidate(name, np.ones((3, 2)))
    point = dataclasses.replace(seen.point, at=(0.0, coordinates[index[1]] + 0.5))
    near = dataclasses.replace(seen, point=point, reach=1.0)
    assert is_physical(problem, fitted, near) == possible
    far = dataclasses.replace(near, reach=0.4)
    assert not is_physical(problem, fitted, far)


def test_a_change_late_in_a_long_record_has_room_in_its_prior():
    effect = EFFECTS["thrust-change"]
    sizes = effect.sizes(usv())
    layout = CoordinateLayout((), (effect,), (sizes,), 1, False, latest=100 * sizes[1])
    assert layout.spreads().tolist() == [3.0, 100.0]
    assert dataclasses.replace(layout, latest=0.0).spreads().tolist() == [3.0, 3.0]


def test_gains_of_exchanged_data_are_pooled():
    one = judged("wind", 60.0, STEADY, CLEAR_GAIN)
    assert one.pooled_gain == CLEAR_GAIN
    both = dataclasses.replace(one, exchanged=Gain(10.0, 12.0)).pooled_gain
    assert both == pytest.approx((50.0, 15.0))
