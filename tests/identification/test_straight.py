"""Runs of which nothing but the speed is known are taken as straight ahead."""

import copy

import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE

from diffsea import Trajectory
from diffsea.identification.problem import make_problem
from diffsea.report.wording.caveats import straight_sentence
from diffsea.vessel.files import build


def speeds(turning: bool) -> Trajectory:
    """A minute at changing thrust; with a yaw rate of nothing, where that is asked for."""
    t = np.arange(0.0, 60.0, 0.2)
    nothing, push = np.full(t.size, np.nan), 60.0 + 50.0 * np.sin(t / 5)
    r = np.zeros(t.size) if turning else nothing
    return Trajectory(
        t, nothing, nothing, nothing, 0.9 + 0.2 * np.sin(t / 5 - 1), nothing, r,
        {"port": push, "starboard": push}, {}, {}, np.ones(t.size, bool),
    )  # fmt: skip


@pytest.mark.parametrize("turning", [False, True])
def test_what_nothing_measures_does_not_grow(turning):
    """A hull that is unstable ahead, and thrusters that are not quite in balance."""
    document = copy.deepcopy(load(str(ORACLE / "usv.toml")))
    document["hull"] |= {"N_v": 3000.0}
    document["thruster"][0]["y"] = -1.0300001
    problem = make_problem(build(document), [speeds(turning)], ("X_u",))
    run = problem.run_filter(*problem.start())
    lateral = np.asarray(run.state)[:300, [1, 2, 4, 5]]
    assert np.isfinite(np.asarray(run.innovation)).all()
    assert turning or np.abs(lateral).max() < 1e-9
    assert np.abs(np.asarray(run.innovation)[5:300, 3]).max() < 0.2


def test_runs_are_told_apart():
    """Beside a run that shows turning, one of speeds alone is still taken as straight."""
    vessel = build(load(str(ORACLE / "usv.toml")))
    dataset = make_problem(vessel, [speeds(True), speeds(False)], ("X_u",)).dataset
    assert list(np.asarray(dataset.shows_turning)[:2]) == [True, False]
    assert dataset.straight_runs == 1
    assert (
        straight_sentence(1)
        == "Nothing tells of drift and turning in one run, taken as straight ahead."
    )
    assert straight_sentence(0) == ""
