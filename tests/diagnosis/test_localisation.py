"""Windows, regimes and unnamed forces on two runs, one slow and straight, one fast and turning."""

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, still_run, usv

from diffsea.diagnosis.localisation import (
    Bin,
    inclusion_share,
    motion_quantities,
    regime_within,
    regimes,
    time_windows,
)
from diffsea.diagnosis.score import Projection
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


@pytest.fixture(scope="module")
def problem():
    vessel, t = usv(), np.arange(0.0, 100.0, 0.5)
    screw = {channel: 1.0 + 1e-3 * t for channel in vessel.channels}

    def run(speed: float, yaw_rate: np.ndarray):
        u = speed + 1e-3 * t
        motion = {"x": t, "y": t, "u": u, "v": 0.1 * u, "r": yaw_rate + 1e-4 * t}
        return still_run(vessel, 100.0, commanded=screw, **motion)

    runs = [run(1.0, 0 * t), run(3.0, np.where(t >= 60, 0.3, 0.0))]
    return make_problem(vessel, runs, ("X_u",))


def test_a_window_is_in_the_regime_that_half_of_it_lies_in(problem):
    texts = [one.regime for _, one in regimes(problem).bins]
    speeds = [text for text in texts if text.startswith("speed")]
    turning = [text for text in texts if text.startswith("yaw rate")][-1]
    first = {one.run: one.start for k, one in time_windows(problem).bins if k == 0}

    def within(run: int, start: float, end: float, among: list[str]) -> str | None:
        window = Bin(run, first[run] + start, first[run] + end, "")
        return regime_within(problem, window, among)

    assert within(0, 0.0, 49.0, [turning, speeds[-1], speeds[0]]) == speeds[0]
    assert within(1, 60.0, 99.0, [speeds[0], turning]) == turning
    assert within(0, 0.0, 49.0, [speeds[-1], turning]) is None


def test_pulse_widths_are_summed_from_neutral():
    thrusters = [{**one, "unit": "us"} for one in DOCUMENT["thruster"]]
    vessel = build({**DOCUMENT, "thruster": thrusters})
    t = np.arange(0.0, 20.0, 0.5)
    orders = {"port": 1500.0 + 10 * t, "starboard": 1500.0 - 4 * t}
    problem = make_problem(vessel, [still_run(vessel, commanded=orders)], ("X_u",))
    total = motion_quantities(problem)["total order"]
    assert total.unit == "us"
    recorded = problem.dataset.recorded_rows
    found, times = total.values[recorded], np.asarray(problem.dataset.run_time)[recorded]
    np.testing.assert_allclose(found[:-1], 6 * times[:-1], atol=6 * 0.5)


def test_windows_are_eighths_of_each_run(problem):
    windows = time_windows(problem)
    run, recorded = np.asarray(problem.dataset.run), problem.dataset.recorded_rows
    assert [(k, one.run) for k, one in windows.bins] == [(k, n) for k in range(8) for n in (0, 1)]
    for column, one in windows.bins:
        own = windows.members[:, column] & (run == one.run)
        t = np.asarray(problem.dataset.run_time)[own]
        assert (t.min(), t.max()) == (one.start, one.end)
        assert own.sum() == pytest.approx((run == one.run)[recorded].sum() / 8, abs=1)


def test_an_unnamed_force_is_asked_for_on_halves_of_the_data_alone():
    """Most rows of the data set are spare: halves of all of them would often hold no data."""
    rng, rows, spare = np.random.default_rng(3), 400, 3800
    better, worse = rng.normal(size=(rows, 1)), rng.normal(size=(rows, 1))
    residual = better[:, 0] + 0.3 * rng.normal(size=rows)
    padded = lambda a: np.concatenate([a, np.zeros((spare, *a.shape[1:]))])
    nuisance = np.zeros((rows + spare, 1))
    nuisance[-1] = 1.0  # a row of the prior
    run = np.zeros((rows + spare - 6) // 6, int)
    projection = Projection(padded(residual), nuisance, run, np.zeros((4, 6)))
    assert inclusion_share(projection, [padded(worse), padded(better)], 1) == 1.0
