# pyright: reportArgumentType=false
"""Screening against closed forms: candidates, expansion points, short list, spectrum, detection."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import candidate, still_problem, still_run, usv

from diffsea import EFFECTS, read_vessel
from diffsea.diagnosis.first_hypotheses import names_found
from diffsea.diagnosis.score import NullDistribution, ScoreTest
from diffsea.diagnosis.screening import (
    Screening,
    candidate_effects,
    detection_limits,
    expected_evidence,
    mimicry,
    nearby_points,
    one_sided,
    scan_spacings,
    short_list,
    spectral_peaks,
)
from diffsea.identification.coordinates import (
    CoordinateLayout,
    ExpansionPoint,
    expansion_points,
)
from diffsea.identification.data.dataset import merge_spans
from diffsea.recordings import Finding


NULL = NullDistribution(np.linspace(0.0, 1.0, 100))


@pytest.fixture(scope="module")
def boat():
    return usv()


def test_a_change_is_looked_for_within_the_recordings_and_then_more_closely(boat):
    effect = EFFECTS["drag-change"]
    points = expansion_points(effect, boat, merge_spans([(120.0, 220.0), (100.0, 160.0)]))
    size = effect.sizes(boat)[1]
    times = np.array([point.at[1] for point in points]) * size
    assert np.all((times > 100.0) & (times < 220.0)) and np.ptp(times) == pytest.approx(100.0)
    assert all(point.at[0] == 0 and point.directions == (0,) for point in points)
    spacing = scan_spacings((effect, EFFECTS["gyro-bias"]), boat, points, 0.01)
    assert spacing["drag-change"] * size == pytest.approx(10.0)
    assert spacing["gyro-bias"] == 0
    closer = nearby_points(points[4], spacing["drag-change"] / 4)
    around = np.array([point.at[1] for point in closer]) * size - times[4]
    assert np.sort(np.abs(around)) == pytest.approx([2.5, 2.5, 5.0, 5.0, 7.5, 7.5])


def test_a_wind_is_looked_for_with_several_superstructures(boat):
    effect = EFFECTS["wind:coefficients"]
    points = expansion_points(effect, boat, [(0.0, 100.0)])
    assert [point.directions for point in points] == [(0, 1)] * 3
    added = [point.at[2] * effect.sizes(boat)[2] for point in points]
    assert added == pytest.approx([0.0, -0.1, -0.2])
    layout = CoordinateLayout((), (effect,), (effect.sizes(boat),), 1, False)
    assert layout.spreads() == pytest.approx([3.0, 3.0, 1.0, 1.0, 1.0])
    strains = np.asarray(layout.strains(np.array([0, 0, 4.0, -5.0, 6.0]), layout.spreads()))
    assert strains == pytest.approx([0, 0, 4.0, -5.0, 6.0])  # no heavy tail


def test_onsets_are_looked_at_where_something_was_recorded(boat):
    spans = merge_spans((start, start + 50.0) for start in (0.0, 3000.0, 3040.0))
    assert spans == [(0.0, 50.0), (3000.0, 3090.0)]
    effect = EFFECTS["thrust-change"]
    points = expansion_points(effect, boat, spans)
    at = np.array([point.at[1] for point in points]) * effect.sizes(boat)[1]
    assert len(at) == 11
    assert (((at > 0) & (at < 50)) | ((at > 3000) & (at < 3090))).all()
    assert (at < 50).sum() == pytest.approx(11 * 50 / 140, abs=1)
    spacing = scan_spacings((effect,), boat, points, 0.1)[effect.name] * effect.sizes(boat)[1]
    assert spacing == pytest.approx(140 / 12)


def test_what_answers_late_is_looked_at_from_afar_too(boat):
    points = lambda name: expansion_points(EFFECTS[f"{name}:propulsion"], boat, [(0.0, 9.0)])
    for name in ("thrust-lag", "thrust-delay", "rate-limit", "backlash"):
        assert [point.secant for point in points(name)] == [False, True, True, True], name
    assert all(point.secant for point in points("thrust-saturation"))


def test_the_reverse_of_a_secant_counts_where_there_is_one_only():
    """A lag is never negative, an exponent may lie on either side of its own."""
    for_it, against = (ScoreTest(50.0, 1e-11, np.array([step]), 1.2) for step in (0.8, -0.8))
    lag = ExpansionPoint("thrust-lag:propulsion", (1.0,), (0,), secant=True)
    assert one_sided(lag, for_it) is for_it
    assert one_sided(lag, against)._replace(step=0) == ScoreTest(0.0, 1.0, 0, 1.2)
    assert not one_sided(lag, against).step.any()
    exponent = ExpansionPoint("thrust-curve", (0.0, 2.5, 0.0, 0.0), (1,), secant=True)
    assert one_sided(exponent, against) is against
    tangent = dataclasses.replace(lag, at=(0.0,), secant=False)
    assert one_sided(tangent, against) is against


def test_a_superstructure_is_not_asked_for_where_each_run_has_a_wind_of_its_own(boat):
    names = lambda per_run: {e.name for e in candidate_effects(boat, [still_run(boat)], per_run)}
    assert names(False) - names(True) == {"wind:coefficients"}


def test_what_seldom_is_is_asked_where_an_audit_found_it():
    """A heading turns velocities with it on a ship, too, where a receiver's were turned by it."""
    ship = read_vessel("mariner").vessel
    iron = {"amplitude": 0.15, "phase": 0.5, "time_constant": 0.0}
    finding = Finding("hard-iron", 0.15, 0.004, "rad", "", "", ("psi", "u", "v"), iron, "a.csv")
    names = lambda found: {e.name for e in candidate_effects(ship, [still_run(ship)], found=found)}
    assert names_found([finding]) == {"hard-iron:estimated"}
    assert names(names_found([finding])) - names(()) == {"hard-iron:estimated"}
    doubtful = dataclasses.replace(finding, doubt="wind does the same")
    alone = dataclasses.replace(finding, channels=("psi",))
    assert names_found([doubtful, alone]) == set()


def test_heel_is_a_candidate_only_where_it_was_recorded(boat):
    heeled = still_run(boat, extra={"phi": np.linspace(0.0, 0.1, 40)})
    without = {effect.name for effect in candidate_effects(boat, [heeled, still_run(boat)])}
    everywhere = {effect.name for effect in candidate_effects(boat, [heeled])}
    assert "roll-coupling" not in without
    assert everywhere - without == {"roll-coupling", "roll-coupling:Y_phi", "roll-coupling:N_phi"}


def test_doubles_of_the_strongest_are_refitted_too():
    rng = np.random.default_rng(1)
    base = rng.normal(size=(200, 1))
    names = [f"weak {k}" for k in range(8)]
    seen = {"strong": candidate("strong", base, 100.0)}
    for k, name in enumerate(names):
        seen[name] = candidate(name, rng.normal(size=(200, 1)), 60.0 - k)
    seen["double"] = candidate("double", base + 0.1 * rng.normal(size=(200, 1)), 30.0)
    seen["other"] = candidate("other", rng.normal(size=(200, 1)), 30.0)
    assert mimicry(base, seen["double"].columns) > 0.9
    chosen = short_list(Screening(seen, (), NULL), {"strong": ()})
    assert "double" in chosen and "other" not in chosen
    assert "other" in short_list(Screening(seen, (), NULL), {"strong": ("other",)})
    faint = {name: dataclasses.replace(one, expected=-1.0) for name, one in seen.items()}
    assert len(short_list(Screening(faint, (), NULL), {})) == 3


def test_a_point_that_data_do_not_know_promises_nothing():
    prior = np.eye(2) / 3  # of a prior three sizes wide
    score = ScoreTest(0.0, 1.0, np.zeros(2), 1.0)
    nothing = np.concatenate([np.zeros((9, 2)), prior])
    assert expected_evidence(score, nothing) == pytest.approx(0.0)
    known = np.concatenate([np.diag([4.0, 2.0]), prior])
    room = np.log(1 + 9 * 16) + np.log(1 + 9 * 4)
    score = score._replace(statistic=20.0)
    assert expected_evidence(score, known) == pytest.approx(20 - room)


@pytest.mark.parametrize("apart", [0.0, 1e5])
def test_a_wave_is_found_whether_clocks_begin_together_or_days_apart(apart):
    rng, dt, rows = np.random.default_rng(5), 0.5, 600
    t = np.concatenate([dt * np.arange(rows), apart + dt * np.arange(rows)])
    noise = rng.normal(size=2 * rows) + 1j * rng.normal(size=2 * rows)
    phase = np.repeat([0.0, np.pi if apart else 0.0], rows)
    force = noise + 0.8 * (1 + 1j) * np.cos(2 * np.pi * 0.11 * t + phase)
    run = np.repeat([0, 1], rows)
    peaks, resolution = spectral_peaks(force, t, np.full(2 * rows, dt), run)
    assert resolution == pytest.approx(0.5 / (dt * rows), rel=0.01)
    assert peaks[0] == pytest.approx(0.11, abs=2 * resolution)


def _limits(columns: dict[str, np.ndarray], scatter: float = 1.0):
    """Detection limits by name from columns with a row for each coordinate's prior at the end."""
    problem = still_problem(*columns)
    values = problem.dataset.measured.size
    seen = {}
    for name, data in columns.items():
        data = np.concatenate([data, np.zeros((values - len(data), data.shape[1]))])
        one = candidate(name, np.concatenate([data, np.eye(data.shape[1]) / 3]))
        seen[name] = dataclasses.replace(one, scatter=scatter)
    screening = Screening(seen, (), NULL)
    assert not detection_limits(problem, screening, tuple(columns))
    limits = detection_limits(problem, screening, ())
    assert list(limits) == list(columns)
    return limits


def test_a_detection_limit_is_three_standard_errors_of_the_data():
    strong, weak = np.zeros((50, 2)), np.zeros((50, 1))
    strong[0, 0], strong[1, 1], weak[0, 0] = 8.0, 4.0, 0.05
    found = _limits({"current": strong, "gyro-bias": weak})
    # 3 standard errors of 1/4 prior size, and a prior size of 0.3 m/s.
    assert found["current"] == pytest.approx(3 / 4 * 0.3, rel=1e-6)
    assert found["gyro-bias"] is None


def test_a_detection_limit_counts_how_sizes_scatter_between_parts_of_the_data():
    strong = np.zeros((50, 2))
    strong[0, 0], strong[1, 1] = 8.0, 4.0
    usual, wide = _limits({"current": strong}), _limits({"current": strong}, scatter=9.0)
    assert usual["current"] and wide["current"] == pytest.approx(3 * usual["current"])


def test_a_detection_limit_is_of_the_parameter_that_it_names(boat):
    drift, lag = np.zeros((50, 2)), np.zeros((50, 1))
    drift[0, 0], drift[1, 1] = 10.0, 0.5  # rate known well, offset hardly
    drift[2] = 3.0, 0.1
    V = drift.T @ drift
    found = _limits({"clock-drift": drift, "thrust-lag:propulsion": lag})
    rate = 3 * np.sqrt(np.linalg.inv(V)[0, 0]) * EFFECTS["clock-drift"].sizes(boat)[0]
    assert found["clock-drift"] == pytest.approx(rate, rel=1e-6)
    # Nothing in the data: its prior alone is no limit.
    assert found["thrust-lag:propulsion"] is None
