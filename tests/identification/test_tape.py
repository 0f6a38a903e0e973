# pyright: reportArgumentType=false
"""Recordings on the dataset as they come: gaps, positions alone, and filters that diverge."""

import dataclasses

import numpy as np
import pytest
from tests.oracle.sensors import gust
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

from diffsea import EFFECTS, Trajectory, UserError
from diffsea.identification.descent import filter_at
from diffsea.identification.filter.covariance import GustPropagation
from diffsea.identification.filter.kalman import FilterRun, Gains, deviance
from diffsea.identification.filter.latency import SamplePlacement
from diffsea.identification.filter.noise_fit import RowTimes, take_excerpt
from diffsea.identification.fit import estimate
from diffsea.identification.holdout import split_data
from diffsea.identification.problem import make_problem
from diffsea.identification.residual import innovations_at, linearise
from diffsea.vessel.files import build


pytestmark = pytest.mark.slow


SEEN = ("x", "y", "psi", "u", "v", "r")


@pytest.fixture(scope="module")
def document() -> dict:
    return load(str(ORACLE / "usv.toml"))


@pytest.fixture(scope="module")
def run(document) -> Trajectory:
    """Two minutes of random steps by the oracle, as its sensors show them."""
    return random_steps(document, 4, 120.0, 0.5)


def rows(run: Trajectory, chosen: np.ndarray) -> Trajectory:
    series = {name: getattr(run, name)[chosen] for name in ("t", *SEEN, "valid")}
    commanded = {name: values[chosen] for name, values in run.commanded.items()}
    return dataclasses.replace(run, **series, commanded=commanded)


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_a_gap_is_as_good_as_two_runs(document, run, seconds):
    vessel, free = build(document), ("X_u", "X_uu")
    before, after = run.t < 40, run.t >= 40 + seconds
    pieces = [rows(run, before), rows(run, after)]
    one = make_problem(vessel, [rows(run, before | after)], free)
    two = make_problem(vessel, pieces, free)
    coordinates, noise = one.start()
    values = [float(deviance(problem.run_filter(coordinates, noise))) for problem in (one, two)]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_a_short_hole_is_bridged(document, run):
    vessel = build(document)
    dataset = make_problem(vessel, [rows(run, (run.t < 40) | (run.t >= 41))], ("X_u",)).dataset
    assert np.asarray(dataset.starts).sum() == 1


def test_positions_alone_tell_the_first_heading(document, run):
    vessel = build(document)
    start = np.flatnonzero(np.hypot(run.u, run.v) > 0.5)[0]
    moving = rows(run, run.t >= run.t[start])
    hidden = {name: np.full(moving.t.size, np.nan) for name in ("psi", "u", "v", "r")}
    alone = dataclasses.replace(moving, **hidden)
    turned = dataclasses.replace(alone, x=-alone.x, y=-alone.y)  # the same run, half a turn on
    values = []
    for one in (alone, turned):
        problem = make_problem(vessel, [one], ("X_u",))
        values.append(filter_at(problem, *problem.start()).deviance)
    assert values[0] == pytest.approx(values[1], abs=1.0)


def test_a_filter_that_diverges_has_no_likelihood(document, run):
    vessel = build(document)
    hidden = {name: np.full(run.t.size, np.nan) for name in ("psi", "u", "v", "r")}
    problem = make_problem(vessel, [dataclasses.replace(run, **hidden)], ("X_uu",))
    coordinates, noise = problem.start()
    assert np.isfinite(float(deviance(problem.run_filter(coordinates, noise))))
    away = coordinates + 12.0  # drag 10^5 times as large: no step of the integration is stable
    assert not np.isfinite(float(deviance(problem.run_filter(away, noise))))


@pytest.mark.proof
@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("rate", [0.02, -0.02])
def test_a_clock_that_drifts_far_is_as_good_as_one_that_does_not(document, run, rate, measured):
    """After two minutes the clocks are three times sqrt(L / g) apart."""
    off = {"rate": rate, "offset": 0.3}
    drift = EFFECTS["clock-drift"]

    def white(seen: Trajectory, vessel) -> np.ndarray:
        """Variance of the whitened innovations of each channel."""
        seen = dataclasses.replace(seen, executed=seen.commanded if measured else {})
        problem = make_problem(vessel, [seen], ("X_u",))
        run = problem.run_filter(*problem.start())
        return (np.asarray(run.white) ** 2).sum(0) / np.asarray(run.gains.used).sum(0)

    vessel = build(document)
    late = random_steps(document, 4, 120.0, 0.5, {"clock-drift": off})
    known = drift.apply(vessel, np.array(drift.encode(vessel, off)))
    right = white(run, vessel)
    assert white(late, known) == pytest.approx(right, rel=0.5)
    assert white(late, vessel).max() > 3 * right.max()


@pytest.mark.proof
def test_a_velocity_that_is_late_by_rows_in_gusts_is_told(document):
    """Gusts move the vessel a great deal within the delay, two and a half rows."""
    vessel, delay = build(document), 0.5
    late = {"sensor-latency": {"delay": delay, "channels": ["u", "v"]}}
    blow = gust(np.random.default_rng(9), 0.0, 160.0, std=(0.1, 0.1, 0.05), tau=(2.0, 2.0, 2.0))
    seen = random_steps(document, 1, 160.0, 0.2, late, blow)
    effect = EFFECTS["sensor-latency:velocity"]
    free = ("X_u", "X_uu", "Y_v", "N_r")
    problem = make_problem(vessel, [seen], free, (effect,))
    fitted = estimate(problem, (*free, effect.name))
    found = problem.layout.physical(effect.name, fitted.coordinates).item()
    assert found == pytest.approx(delay, rel=0.1)


def test_too_little_held_out_is_told(document, run):
    vessel = build(document)
    problem_of = lambda runs, least: make_problem(vessel, runs, ("X_u",), least=least)
    with pytest.raises(UserError, match="only 12 rows are held out"):
        split_data(problem_of, [run], [rows(run, run.t < 6)], False)


@pytest.mark.proof
@pytest.mark.parametrize("offset", [0.3, -0.3])
def test_a_clock_that_is_off_has_a_slope_to_either_side(document, run, offset):
    """Where actuators are measured: what a first look promises is a good part of the gain."""
    off = {"clock-drift": {"offset": offset, "rate": 0.0}}
    late = random_steps(document, 4, 120.0, 0.5, off)
    late = dataclasses.replace(late, executed=late.commanded)
    problem = make_problem(build(document), [late], ("X_u",), (EFFECTS["clock-drift"],))
    start, noise = problem.start()
    gains = problem.run_filter(start, noise).gains
    place = problem.layout.indices(("clock-drift",))
    residual, J = linearise(problem, gains, start, place)
    fitted = J @ np.linalg.lstsq(J, residual, rcond=None)[0]
    away = start.copy()
    away[place[1]] = offset / EFFECTS["clock-drift"].sizes(problem.base)[1]
    gain = (residual**2).sum() - (innovations_at(problem, gains, away) ** 2).sum()
    assert (fitted**2).sum() > 0.2 * gain > 20.0


def test_runs_longer_than_their_distance_keep_their_order(document, run):
    slow = dataclasses.replace(run, t=120.0 * run.t)
    dataset = make_problem(build(document), [slow, slow], ("X_u",)).dataset
    assert (np.diff(np.asarray(dataset.t)[: 2 * run.t.size]) > 0).all()


def test_a_run_of_less_than_ten_of_the_vessels_own_steps_is_refused(document, run):
    short = rows(run, run.t < 6.0)
    thin = dataclasses.replace(short, t=short.t / 50)
    with pytest.raises(UserError, match="too short to estimate anything"):
        make_problem(build(document), [thin], ("X_u",))


def excerpt_times(lengths: dict[int, int], rows: int) -> dict[int, set[float]]:
    """Intervals of the excerpt's rows that count, by run; every row has an interval of its own."""
    run = np.concatenate([np.full(length, number) for number, length in lengths.items()])
    dt = np.concatenate([1e5 * number + np.arange(n) for number, n in lengths.items()])
    run, dt = (np.pad(part, (0, rows - len(part)), mode="edge") for part in (run, dt))
    used = np.repeat(np.arange(rows)[:, None] < sum(lengths.values()), 6, axis=1)
    six, three = np.zeros((rows, 6)), np.zeros((rows, 3))
    square, wide = np.zeros((rows, 6, 6)), np.zeros((rows, 6, 9))
    gusts = GustPropagation(three, three)
    placement = SamplePlacement(np.zeros((rows, 6), int), np.zeros(rows, bool))
    gains = Gains(wide.transpose(0, 2, 1), square, used, gusts, placement)
    P = np.zeros((rows, 9, 9))
    filtered = FilterRun(gains, six, six, six, P, six, square, wide, three, three, six)
    part, clock = take_excerpt(filtered, RowTimes(dt, run.astype(int), np.ones(6)))
    counted = np.asarray(part.gains.used).any(-1)
    chosen, found = np.asarray(clock.dt)[counted], np.asarray(clock.run)[counted]
    assert len(np.unique(chosen)) == chosen.size
    return {number: set(chosen[found == number]) for number in lengths}


@pytest.mark.parametrize("lengths", [(600,), (1500, 300), (9000, 3000, 500)])
def test_noise_is_estimated_from_rows_of_every_run_in_any_order(lengths):
    runs = dict(enumerate(lengths, start=1))
    found = excerpt_times(runs, 16384)
    assert all(found.values())
    assert all(max(times) - 1e5 * number < runs[number] for number, times in found.items())
    assert excerpt_times(dict(reversed(runs.items())), 16384) == found
