"""Parts of the diagnosis against closed forms: null, evidence, looks and detection limits."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from tests.paths import ORACLE

from diffsea.diagnosis import decision, jacobians, localisation, refit, search, unexplained
from diffsea.diagnosis.constancy import Constancy
from diffsea.diagnosis.decision import Accepted, footholds, nameless, outdone, rivals
from diffsea.diagnosis.localisation import Bin
from diffsea.diagnosis.record import detection_limits
from diffsea.diagnosis.refit import (
    Fitted,
    beside,
    first_guess,
    near_the_best,
    ranked,
    refitted,
)
from diffsea.diagnosis.score import Score, joint_null
from diffsea.diagnosis.screening import (
    Screening,
    Seen,
    _expected,
    candidates,
    mimicry,
    nearby,
    shape_spacings,
    short_list,
)
from diffsea.diagnosis.search import stalled
from diffsea.identification.coordinates import CoordinateLayout
from diffsea.identification.estimates import posterior_estimate
from diffsea.identification.expansion_points import ExpansionPoint, expansion_points, merge_spans
from diffsea.identification.holdout import Gain
from diffsea.vessel.effects import EFFECTS
from diffsea.vessel.files import read_vessel


def test_independent_tests_are_corrected_as_sidak_does():
    tests = [slice(k, k + 1) for k in range(40)]
    null = joint_null(np.eye(40), tests, draws=20000)
    for p in (1e-3, 1e-2, 1e-6):
        assert null.family_wise(p) == pytest.approx(-np.expm1(40 * np.log1p(-p)), rel=0.15)
    assert null.family_wise(null.level) == pytest.approx(0.01, rel=0.2)


def test_tests_that_say_the_same_count_once():
    null = joint_null(np.ones((40, 40)), [slice(k, k + 1) for k in range(40)], draws=20000)
    for p in (0.05, 1e-4):
        assert null.family_wise(p) == pytest.approx(p, rel=0.15)


def test_a_block_of_columns_is_one_test_of_its_own_degrees_of_freedom():
    mixed = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    null = joint_null(mixed, [slice(0, 2), slice(2, 3)], draws=40000)
    assert null.family_wise(0.03) == pytest.approx(1 - 0.97**2, rel=0.1)


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
    seen = Seen(ExpansionPoint("current", (0.0, 0.0), (0, 1)), None, None, 0.0)
    occam = float(volume + 2 * np.log(spreads[2:]).sum())
    one = Fitted("current", more, less.deviance - more.deviance, occam, None, seen, True)
    assert one.evidence(1.0) == pytest.approx(exact, abs=1e-6)
    assert one.evidence(2.0) < one.evidence(1.0)


@pytest.fixture(scope="module")
def boat():
    return read_vessel(ORACLE / "usv.toml").vessel


class _Run:
    def __init__(self, first, last, extra=None):
        self.t, self.extra = np.array([first, last]), extra or {}


def test_a_change_is_looked_for_within_the_recordings_and_then_more_closely(boat):
    effect = EFFECTS["drag-change"]
    tried = expansion_points(effect, boat, merge_spans([(120.0, 220.0), (100.0, 160.0)]))
    size = effect.sizes(boat)[1]
    times = np.array([look.at[1] for look in tried]) * size
    assert np.all((times > 100.0) & (times < 220.0)) and np.ptp(times) == pytest.approx(100.0)
    assert all(look.at[0] == 0 and look.directions == (0,) for look in tried)
    spacing = shape_spacings((effect, EFFECTS["gyro-bias"]), boat, tried, 0.01)
    assert spacing["drag-change"] * size == pytest.approx(10.0)
    assert spacing["gyro-bias"] == 0
    closer = nearby(effect, tried[4], spacing["drag-change"] / 4)
    around = np.array([look.at[1] for look in closer]) * size - times[4]
    assert np.sort(np.abs(around)) == pytest.approx([2.5, 2.5, 5.0, 5.0, 7.5, 7.5])


def test_a_wind_is_looked_for_with_several_superstructures(boat):
    effect = EFFECTS["wind:coefficients"]
    tried = expansion_points(effect, boat, [(0.0, 100.0)])
    assert [look.directions for look in tried] == [(0, 1)] * 3
    added = [look.at[2] * effect.sizes(boat)[2] for look in tried]
    assert added == pytest.approx([0.0, -0.1, -0.2])
    sizes = (effect.sizes(boat),)
    layout = CoordinateLayout((), (effect,), sizes, 1, False)
    assert layout.spreads() == pytest.approx([3.0, 3.0, 1.0, 1.0, 1.0])
    strains = np.asarray(layout.strains(np.array([0, 0, 4.0, -5.0, 6.0]), layout.spreads()))
    assert strains == pytest.approx([0, 0, 4.0, -5.0, 6.0])  # no heavy tail


def test_a_superstructure_is_not_asked_for_where_each_run_has_a_wind_of_its_own(boat):
    names = lambda per_run: {e.name for e in candidates(boat, [_Run(0, 1)], per_run)}
    assert names(False) - names(True) == {"wind:coefficients"}


def test_heel_is_a_candidate_only_where_it_was_recorded(boat):
    heel = {"phi": np.array([0.0, 0.1])}
    without = {effect.name for effect in candidates(boat, [_Run(0, 1, heel), _Run(0, 1)])}
    everywhere = {effect.name for effect in candidates(boat, [_Run(0, 1, heel)])}
    assert "roll-coupling" not in without
    assert everywhere - without == {"roll-coupling", "roll-coupling:Y_phi", "roll-coupling:N_phi"}


def _seen(name, columns, expected=0.0, step=(0.0,)):
    moved = tuple(range(columns.shape[1]))
    look = ExpansionPoint(name, (0.0,) * columns.shape[1], moved)
    return Seen(look, Score(0.0, 1.0, np.array(step), 1.0), columns, expected)


def test_a_first_guess_keeps_to_the_physical_side():
    lag = EFFECTS["thrust-lag:propulsion"]
    assert first_guess(lag, _seen(lag.name, np.ones((3, 1)), step=(-2.0,))) == pytest.approx([0.1])
    bias = EFFECTS["gyro-bias"]
    assert first_guess(bias, _seen(bias.name, np.ones((3, 1)), step=(-9.0,))) == pytest.approx([-3])


def _refitted(name, evidence, possible=True):
    return Fitted(name, None, evidence, 0.0, None, _seen(name, np.ones((3, 1))), possible)


def test_what_is_not_physical_hides_only_what_it_may_be_confused_with():
    early = _refitted("sensor-latency:position", 160.0, possible=False)
    drag, lever = _refitted("crossflow-drag", 60.0), _refitted("lever-arm", 70.0)
    assert near_the_best(drag, [early, drag])
    assert not near_the_best(lever, [early, lever])
    late = dataclasses.replace(early, possible=True)
    assert not near_the_best(drag, [late, drag])


def test_what_held_out_runs_contradict_is_no_sign_of_something_unnamed():
    problem = SimpleNamespace(layout=SimpleNamespace(effects=[EFFECTS["wind"], EFFECTS["current"]]))
    fitted = SimpleNamespace(inflation=1.0)
    strong = dataclasses.replace(_refitted("wind", 60.0), estimate=fitted)
    borne_out, denied = (
        dataclasses.replace(strong, gain=SimpleNamespace(total=total)) for total in (2.0, -80.0)
    )
    assert nameless(problem, (strong,)) and nameless(problem, (borne_out,))
    assert not nameless(problem, (denied,))


def test_a_name_is_doubtful_where_what_is_left_stands_out_more():
    fitted = _refitted("wind", 60.0)
    score = fitted.seen.score._replace(statistic=25.0)
    seen = dataclasses.replace(fitted.seen, score=score)
    named = Accepted("wind", dataclasses.replace(fitted, seen=seen), ())
    left = lambda z: SimpleNamespace(cells=[SimpleNamespace(z=0.5), SimpleNamespace(z=-z)])
    assert outdone(named, left(5.1))
    assert not outdone(named, left(4.9))
    assert not outdone(named, SimpleNamespace(cells=[]))


_CLEAR = Gain(40.0, 9.0)
_STEADY, _UNSTEADY = Constancy(9.0, 0.5, 0.1), Constancy(90.0, 1e-9, 0.8)


def _judged(name, evidence, constancy, gain=_CLEAR):
    fitted = dataclasses.replace(_refitted(name, evidence), gain=gain, constancy=constancy)
    return dataclasses.replace(fitted, estimate=SimpleNamespace(deviance=1000.0 - evidence))


def _data():
    layout = SimpleNamespace(effects=[EFFECTS["wind"], EFFECTS["current"]])
    return SimpleNamespace(train=SimpleNamespace(layout=layout), recordings=[], head=None)


def test_another_effect_is_sought_beside_steady_ones_first_where_the_best_is_not_steady():
    best, second = _judged("wind", 160.0, _UNSTEADY), _judged("current", 130.0, _STEADY)
    weak = _judged("lever-arm", 3.0, _STEADY)
    doubtful = _judged("gyro-bias", 120.0, _STEADY, Gain(8.0, 9.0))
    assert footholds(_data(), [best, second, weak, doubtful]) == [second, best]
    assert footholds(_data(), [doubtful, best, second]) == []
    assert footholds(_data(), []) == []


def test_what_is_asked_of_the_best_alone_does_not_distance_its_rivals(monkeypatch):
    best = _judged("wind", 60.0, _STEADY, Gain(12.0, 7.0))
    near = _judged("current", 57.0, _STEADY, Gain(12.0, 7.0))
    monkeypatch.setattr(decision, "exchanged_gain", lambda *_: Gain(30.0, 7.0))
    found = decision.decide(_data(), SimpleNamespace(), [best, near], lambda text: None)
    assert found.effect == "wind" and found.borne_out.total == 42.0
    assert rivals(found, [best, near]) == ("current",)
    assert Accepted("wind", found, (), (best, near)).ahead == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("left", "again", "gained", "found"),
    [
        (0.5, _STEADY, 100.0, ["current", "lever-arm"]),
        (1e-4, _STEADY, 100.0, []),  # something is left
        (0.5, _UNSTEADY, 100.0, []),  # the first has not one size beside the second either
        (0.5, _STEADY, 5.0, []),  # the best alone explains more
    ],
)
def test_two_effects_at_once_must_leave_nothing(monkeypatch, left, again, gained, found):
    best, one = _judged("wind", 160.0, _UNSTEADY), _judged("current", 130.0, _STEADY)
    other = _judged("lever-arm", 130.0 + gained, _STEADY)
    monkeypatch.setattr(search, "footholds", lambda data, tried: [one])
    monkeypatch.setattr(search, "screen", lambda *_: SimpleNamespace(remainder=None))
    monkeypatch.setattr(search, "_tried", lambda *_: [other])
    monkeypatch.setattr(search, "decide", lambda *_: other)
    monkeypatch.setattr(search, "without", lambda *_: None)
    monkeypatch.setattr(search, "completed", lambda *_: dataclasses.replace(one, constancy=again))
    other.estimate.coordinates = None
    drawn = SimpleNamespace(of_located=lambda remainder: left)
    both = search.together(_data(), SimpleNamespace(), [best, one], drawn, lambda text: None)
    assert [accepted.name for accepted in both] == found


@pytest.mark.parametrize(
    ("promised", "without", "found"),
    [(30.0, 910.0, True), (60.0, 910.0, False), (30.0, 990.0, False)],
)
def test_a_name_is_not_had_for_the_progress_of_a_fit(monkeypatch, promised, without, found):
    # The fit with the effect gains 100 over 1000; without it again, from there, `without` is left.
    again = SimpleNamespace(deviance=without)
    monkeypatch.setattr(search, "without", lambda problem, start, names: again)
    fitted = _refitted("wind", 100.0)
    score = fitted.seen.score._replace(statistic=promised, inflation=1.0)
    best = dataclasses.replace(fitted, seen=dataclasses.replace(fitted.seen, score=score))
    better = stalled(SimpleNamespace(), SimpleNamespace(deviance=1000.0), best)
    assert (better is again) if found else better is None


def test_what_has_no_room_beside_later_effects_is_not_asked_again(monkeypatch):
    sizes = {"wind": 2, "current": 2, "wide": 3, "lever-arm": 2}
    indices = lambda names: [k for name in names for k in range(sizes.get(name, 1))]
    layout = SimpleNamespace(indices=indices, kinds=lambda: (np.arange(9), None))
    problem = SimpleNamespace(layout=layout, width=5, directions=5)
    gain = Gain(30.0, 3.0)
    tried = [
        dataclasses.replace(_refitted(name, 100.0), gain=gain)
        for name in ("wind", "wide", "lever-arm")
    ]
    accepted = [Accepted("wind", tried[0], (), tuple(tried)), Accepted("current", None, ())]
    asked, now_constant = [], Constancy(9.0, 0.3, 0.1, degrees=7)
    bare = SimpleNamespace(free=("X_u", "current"))

    def completed(data, bare, one, start):
        asked.append(one.effect)
        return dataclasses.replace(one, constancy=now_constant)

    monkeypatch.setattr(search, "without", lambda *_: bare)
    monkeypatch.setattr(search, "completed", completed)
    monkeypatch.setattr(search, "ranked", lambda found: found)
    monkeypatch.setattr(search, "decide", lambda data, bare, again, progress: again[0])
    monkeypatch.setattr(search, "rivals", lambda best, again: ())
    now = SimpleNamespace(coordinates=None)
    data = SimpleNamespace(train=problem)
    kept = search.revised(data, accepted, accepted[:-1], now, lambda text: None)
    assert asked == ["wind", "lever-arm"]
    # Its size is as constant as it is beside the others, not as it was alone.
    assert not kept.changed and kept.effects[0].fitted.constancy is now_constant


def test_what_was_found_beside_a_withdrawn_name_is_asked_for_without_it(monkeypatch):
    """Wind stands out less than what is left; the current was found beside it."""
    accepted = tuple(
        Accepted(name, dataclasses.replace(_refitted(name, 100.0), gain=Gain(30.0, 3.0)), ())
        for name in ("wind", "current")
    )
    asked = []

    def revised(data, effects, again, current, progress):
        asked.append([one.name for one in again])
        kept = tuple(effects) if current == "both" else ()
        return search.Revision(kept, current, ("current",) if current == "bare" else (), False)

    monkeypatch.setattr(search, "revised", revised)
    monkeypatch.setattr(search, "screen", lambda problem, current: SimpleNamespace(remainder=1e-9))
    monkeypatch.setattr(search, "outdone", lambda one, screening: one.name == "wind")
    monkeypatch.setattr(search, "without", lambda problem, current, names: "bare")
    monkeypatch.setattr(search, "nameless", lambda problem, shown: False)
    monkeypatch.setattr(search, "remainder", lambda data, current: None)
    drawn = SimpleNamespace(of_located=lambda remainder: unexplained)
    screening = SimpleNamespace(remainder=1e-9)
    found = search.Forward(None, screening, "both", screening, accepted, ())
    told = search.concluded(_data(), found, drawn, lambda text: None)
    assert asked == [["wind"], ["current"]]
    assert (told.verdict, told.effects, told.final) == ("unexplained", (), "bare")
    assert told.dropped == ("current", "wind")


def test_doubles_of_the_strongest_are_refitted_too():
    rng = np.random.default_rng(1)
    base = rng.normal(size=(200, 1))
    names = [f"weak {k}" for k in range(8)]
    seen = {"strong": _seen("strong", base, 100.0)}
    seen |= {name: _seen(name, rng.normal(size=(200, 1)), 60.0 - k) for k, name in enumerate(names)}
    seen["double"] = _seen("double", base + 0.1 * rng.normal(size=(200, 1)), 30.0)
    seen["other"] = _seen("other", rng.normal(size=(200, 1)), 30.0)
    assert mimicry(base, seen["double"].columns) > 0.9
    chosen = short_list(Screening(seen, (), None), {"strong": ()})
    assert "double" in chosen and "other" not in chosen
    assert "other" in short_list(Screening(seen, (), None), {"strong": ("other",)})
    faint = {name: dataclasses.replace(one, expected=-1.0) for name, one in seen.items()}
    assert len(short_list(Screening(faint, (), None), {})) == 3


def _limits(boat, columns: dict[str, np.ndarray]) -> dict[str, dict]:
    """Detection limits by name from columns with a row for each coordinate's prior at the end."""
    seen = {}
    for name, data in columns.items():
        seen[name] = _seen(name, np.concatenate([data, np.eye(data.shape[1]) / 3]))

    class Problem:
        base = boat
        layout = type("Layout", (), {"effects": tuple(EFFECTS[name] for name in columns)})
        dataset = type("Dataset", (), {"measured": np.zeros(50)})

    assert not detection_limits(Problem, Screening(seen, (), None), tuple(columns))
    rows = detection_limits(Problem, Screening(seen, (), None), ())
    return dict(zip(columns, rows, strict=True))


def test_a_detection_limit_is_three_standard_errors_of_the_data(boat):
    strong, weak = np.zeros((50, 2)), np.zeros((50, 1))
    strong[0, 0], strong[1, 1], weak[0, 0] = 8.0, 4.0, 0.05
    found = _limits(boat, {"current": strong, "gyro-bias": weak})
    # 3 standard errors of 1/4 prior size, and a prior size of 0.3 m/s.
    assert found["current"]["limit"] == pytest.approx(3 / 4 * 0.3, rel=1e-6)
    assert found["gyro-bias"]["limit"] is None


def test_a_detection_limit_is_of_the_parameter_that_it_names(boat):
    drift, lag = np.zeros((50, 2)), np.zeros((50, 1))
    drift[0, 0], drift[1, 1] = 10.0, 0.5  # rate known well, offset hardly
    drift[2] = 3.0, 0.1
    V = drift.T @ drift
    found = _limits(boat, {"clock-drift": drift, "thrust-lag:propulsion": lag})
    rate = 3 * np.sqrt(np.linalg.inv(V)[0, 0]) * EFFECTS["clock-drift"].sizes(boat)[0]
    assert found["clock-drift"]["limit"] == pytest.approx(rate, rel=1e-6)
    # Nothing in the data: its prior alone is no limit.
    assert found["thrust-lag:propulsion"]["limit"] is None


def test_a_change_late_in_a_long_record_has_room_in_its_prior(boat):
    effect = EFFECTS["thrust-change"]
    size = effect.sizes(boat)[1]
    layout = CoordinateLayout((), (effect,), (effect.sizes(boat),), 1, False, latest=100 * size)
    assert layout.spreads().tolist() == [3.0, 100.0]
    assert dataclasses.replace(layout, latest=0.0).spreads().tolist() == [3.0, 3.0]


def test_onsets_are_looked_at_where_something_was_recorded(boat):
    spans = merge_spans((start, start + 50.0) for start in (0.0, 3000.0, 3040.0))
    assert spans == [(0.0, 50.0), (3000.0, 3090.0)]
    effect = EFFECTS["thrust-change"]
    tried = expansion_points(effect, boat, spans)
    at = np.array([look.at[1] for look in tried]) * effect.sizes(boat)[1]
    assert len(at) == 11
    assert (((at > 0) & (at < 50)) | ((at > 3000) & (at < 3090))).all()
    assert (at < 50).sum() == pytest.approx(11 * 50 / 140, abs=1)
    spacing = shape_spacings((effect,), boat, tried, 0.1)[effect.name] * effect.sizes(boat)[1]
    assert spacing == pytest.approx(140 / 12)


def test_what_answers_late_is_looked_at_from_afar_too(boat):
    seen = lambda name: expansion_points(EFFECTS[f"{name}:propulsion"], boat, [(0.0, 9.0)])
    for name in ("thrust-lag", "thrust-delay", "rate-limit", "backlash"):
        tried = seen(name)
        assert [look.secant for look in tried] == [False, True, True, True], name
    assert all(
        look.secant
        for look in expansion_points(EFFECTS["thrust-saturation:propulsion"], boat, [(0.0, 9.0)])
    )


def test_a_refit_starts_without_what_is_not_in_the_model_any_more():
    index = {"X_u": [0], "deadband": [1], "rate-limit": [2], "wind": [3]}
    layout = SimpleNamespace(indices=lambda names: [k for name in names for k in index[name]])
    problem = SimpleNamespace(layout=layout)
    bare = SimpleNamespace(free=("X_u", "wind"), coordinates=np.array([1.0, 0, 0, 4]), deviance=9.0)
    then = ("X_u", "deadband", "rate-limit")
    old = SimpleNamespace(free=then, coordinates=np.array([7.0, 8, 2, 0]), deviance=0.0)
    one = SimpleNamespace(effect="rate-limit", estimate=old)
    assert beside(problem, bare, one).tolist() == [1.0, 0, 2, 4]
    both = SimpleNamespace(**vars(bare) | {"free": ("X_u", "deadband")})
    assert beside(problem, both, one).tolist() == [7.0, 8, 2, 0]


def _copied(amounts, stds, recorded):
    """A fit of a shallowness for each run, of which some were recorded."""
    count = len(amounts)
    every = lambda _: list(range(count))
    layout = SimpleNamespace(instances=lambda effect: count, indices=every)
    run, known = np.arange(count), np.zeros((count, 6), bool)
    known[recorded] = True
    dataset = SimpleNamespace(run=run, known=known)
    problem = SimpleNamespace(layout=layout, dataset=dataset, base=None)
    fitted = SimpleNamespace(
        coordinates=np.array(amounts), precision=np.diag(1 / np.array(stds) ** 2),
        covariance=np.diag(4.0 * np.array(stds) ** 2), index=np.arange(count),
    )  # fmt: skip
    return problem, EFFECTS["shallow-water"], fitted


def _possible(amounts, stds, recorded):
    return refit.possible(*_copied(amounts, stds, recorded), None)


def test_what_cannot_be_negative_may_be_absent_in_some_runs():
    assert _possible([2.3, -0.03, 0.0], [0.1, 0.1, 3.0], [0, 1])
    assert not _possible([2.3, -0.5, 0.0], [0.1, 0.1, 3.0], [0, 1])
    assert not _possible([-0.03, -0.1], [0.1, 0.1], [0, 1])
    assert not _possible([-0.03], [0.1], [0])
    assert _possible([0.03], [0.1], [0])


def test_sizes_that_no_vessel_has_are_impossible_as_far_as_errors_tell(boat):
    effect, std = EFFECTS["thrust-asymmetry"], 0.2
    ratio = effect.sizes(boat)[0]

    def with_ratio(value):
        problem, _, fitted = _copied([value / ratio], [std], [0])
        problem.base = boat
        return refit.possible(problem, effect, fitted, None)

    assert with_ratio(0.9) and with_ratio(-0.9)
    assert with_ratio(1.0 + 1.9 * std * ratio)
    assert not with_ratio(1.0 + 2.1 * std * ratio)
    assert not with_ratio(-1.5)


def test_an_effect_is_weighed_by_the_dependence_of_its_own_scores():
    assert refit._own_inflation(*_copied([1.0, 1.0], [0.1, 0.2], [0, 1])) == pytest.approx(4.0)


def test_waves_beside_an_environment_for_each_run_have_no_room(boat):
    effects = (EFFECTS["wave-force"], EFFECTS["current"])
    layout = CoordinateLayout((), effects, tuple(e.sizes(boat) for e in effects), 3, True)
    room = SimpleNamespace(layout=layout, width=8 * 3, directions=8)
    current = SimpleNamespace(free=("wave-force",))
    assert not refit.has_room(room, current, "current")  # 7 + 2 kinds for 8 directions
    assert refit.has_room(
        SimpleNamespace(layout=layout, width=9 * 3, directions=9), current, "current"
    )


def test_a_look_at_what_data_do_not_know_promises_nothing():
    prior = np.eye(2) / 3  # of a prior three sizes wide
    score = Score(0.0, 1.0, np.zeros(2), 1.0)
    assert _expected(score, np.concatenate([np.zeros((9, 2)), prior])) == pytest.approx(0.0)
    known = np.concatenate([np.diag([4.0, 2.0]), prior])
    room = np.log(1 + 9 * 16) + np.log(1 + 9 * 4)
    assert _expected(score._replace(statistic=20.0), known) == pytest.approx(20 - room)


def test_a_held_out_run_that_diverges_disturbs_the_order_of_nobody_else():
    weak, strong = _judged("wind", 100.0, _STEADY), _judged("current", 300.0, _STEADY)
    lost = _judged("gyro-bias", 200.0, _STEADY, Gain(float("nan"), float("nan")))
    inflation = SimpleNamespace(deviance=0.0, inflation=1.0)
    tried = [dataclasses.replace(one, estimate=inflation) for one in (weak, lost, strong)]
    assert [one.effect for one in ranked(tried)] == ["current", "wind", "gyro-bias"]


def test_every_hypothesis_as_good_as_the_best_is_judged_on_held_out_data(monkeypatch):
    level = [f"quadratic-damping:{name}" for name in ("X_uu", "Y_vv", "N_rr")]
    strong = {name: 300.0 - k for k, name in enumerate([*level, "wind", "current"])}
    tried = strong | {"gyro-bias": 250.0}
    monkeypatch.setattr(refit, "_first", lambda p, c, seen: _refitted(seen, tried[seen]))
    monkeypatch.setattr(
        refit, "completed",
        lambda data, current, one: dataclasses.replace(
            one, gain=_CLEAR, estimate=SimpleNamespace(inflation=1.0)
        ),
    )  # fmt: skip
    found = refitted(_data(), None, {name: name for name in tried}, list(tried), lambda text: None)
    assert {one.effect for one in found if one.gain is not None} == set(strong)


@pytest.mark.parametrize("apart", [0.0, 1e5])
def test_a_wave_is_found_whether_clocks_begin_together_or_days_apart(monkeypatch, apart):
    rng, dt, rows = np.random.default_rng(5), 0.5, 600
    t = np.concatenate([dt * np.arange(rows), apart + dt * np.arange(rows)])
    push = rng.normal(size=(2 * rows, 3)) + 0.8 * np.cos(2 * np.pi * 0.11 * t)[:, None]
    dataset = SimpleNamespace(
        run_time=t, dt=np.full(2 * rows, dt), known=np.ones((2 * rows, 6), bool),
        run=np.repeat([0, 1], rows),
    )  # fmt: skip
    still = SimpleNamespace(state=np.zeros((2 * rows, 6)))
    problem = SimpleNamespace(dataset=dataset, run_filter=lambda *_: still)
    monkeypatch.setattr(jacobians, "latent_acceleration", lambda *_: push)
    found, resolution = jacobians.peaks(problem, SimpleNamespace(coordinates=None, noise=None))
    assert resolution == pytest.approx(0.5 / (dt * rows), rel=0.01)
    assert found[0] == pytest.approx(0.11, abs=2 * resolution)


def test_the_chance_that_is_stated_is_the_one_that_decided(monkeypatch):
    screening = SimpleNamespace(remainder=0.4, p_value=1e-5)
    kept = SimpleNamespace(effects=(), estimate=None, changed=False, dropped=())
    data = SimpleNamespace(train=None, recordings=())
    found = search.Forward(None, None, None, screening, (), ())
    monkeypatch.setattr(search, "revised", lambda *_: kept)
    monkeypatch.setattr(search, "remainder", lambda *_: None)
    for something, left, verdict in ((True, 1e-5, "unexplained"), (False, 0.4, "consistent")):
        monkeypatch.setattr(search, "nameless", lambda *_, said=something: said)
        diagnosis = search.concluded(data, found, search.NONE, lambda text: None)
        assert (diagnosis.left, diagnosis.verdict) == (left, verdict)


def test_an_unnamed_force_is_asked_for_on_halves_of_the_data_alone(monkeypatch):
    rng, rows, spare = np.random.default_rng(3), 400, 3600
    better, worse = rng.normal(size=(rows, 1)), rng.normal(size=(rows, 1))
    residual = better[:, 0] + 0.3 * rng.normal(size=rows)
    padded = lambda a: np.concatenate([a, np.zeros((spare, *a.shape[1:]))])
    told, solve = [], np.linalg.lstsq

    def counted(A, b, rcond):
        told.append(len(A))
        return solve(A, b, rcond)

    monkeypatch.setattr(np.linalg, "lstsq", counted)
    projection = SimpleNamespace(residual=padded(residual), rows=rows + spare - 10)
    assert unexplained._inclusion(projection, [padded(worse), padded(better)], 1) == 1.0
    assert set(told) == {rows // 2}


def test_a_window_is_in_the_regime_that_half_of_it_lies_in():
    """Two runs of 100 rows at 1 Hz: slow and straight, then fast and turning."""
    run = np.repeat([0, 1], 100)
    t = np.tile(np.arange(100.0), 2)
    u = np.where(run == 0, 1.0, 3.0) + 1e-3 * t
    r = np.where((run == 1) & (t >= 60), 0.3, 0.0) + 1e-4 * t
    measured = np.stack([t, t, 0 * t, u, 0.1 * u, r], axis=1)
    dataset = SimpleNamespace(
        measured=measured, known=np.ones((200, 6), bool), orders={"screw": u}, run=run,
        run_time=t, runs=2,
    )  # fmt: skip
    problem = SimpleNamespace(dataset=dataset)
    texts = [labels[0][3] for binning in localisation.regimes(problem) for labels in binning.labels]
    speeds = [text for text in texts if text.startswith("speed")]
    turning = [text for text in texts if text.startswith("yaw rate")][-1]
    within = lambda number, start, end, among: localisation.regime_within(
        problem, Bin(0, number, start, end, ""), among
    )
    assert within(0, 0.0, 49.0, [turning, speeds[-1], speeds[0]]) == speeds[0]
    assert within(1, 60.0, 99.0, [speeds[0], turning]) == turning
    assert within(0, 0.0, 49.0, [speeds[-1], turning]) is None


@pytest.mark.parametrize(
    ("time", "possible"), [(-2.0, False), (0.0, False), (30.0, True), (99.5, False), (100.0, False)]
)
def test_a_change_happens_while_something_is_recorded(boat, time, possible):
    effect = EFFECTS["drag-change"]
    layout = CoordinateLayout((), (effect,), (effect.sizes(boat),), 1, False, 100.0)
    known = np.zeros((101, 6), bool)
    known[:100] = True  # the last row has no value
    dataset = SimpleNamespace(run_time=np.arange(101.0), known=known)
    problem = SimpleNamespace(layout=layout, dataset=dataset, base=boat)
    at = (1.0, time / effect.sizes(boat)[1])
    fitted = SimpleNamespace(coordinates=np.array(at), index=np.arange(2), precision=np.eye(2))
    point = ExpansionPoint(effect.name, (0.0, at[1]), (0,))
    seen = Seen(point, None, None, 0.0, reach=1.0)
    assert refit.possible(problem, effect, fitted, seen) == possible
