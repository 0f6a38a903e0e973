"""A wind that was measured is asked for first, beside a current that is concealed."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from tests.diagnosis.small import DOCUMENT, usv
from tests.oracle.blown import blown_run, gusty
from tests.paths import ORACLE
from tests.runs import varied

from diffsea import EFFECTS, read_recording
from diffsea.diagnosis.first_hypotheses import certain_effects
from diffsea.diagnosis.screening import candidate_effects, screen
from diffsea.diagnosis.verdict import judge_all_first, verdict_on
from diffsea.identification.fit import estimate
from diffsea.identification.holdout import split_data
from diffsea.identification.problem import make_problem
from diffsea.identification.sufficiency import unmodelled_disturbances
from diffsea.progress import no_progress
from diffsea.vessel.files import build, dump
from diffsea.workflows import fits, online


pytestmark = pytest.mark.slow

NAME = "wind:measured"
FREE = ("X_u", "N_r")
STEP, ROWS = 0.5, 121
SUPERSTRUCTURE = {"C_X": 0.9, "C_Y": 0.6, "C_N": 0.05, "C_NY": -0.08}
NOISE = {"x": 0.05, "y": 0.05, "psi": 0.005, "u": 0.02, "v": 0.02, "r": 0.003}


def recorded(seed, superstructure):
    """A run of random thrusts in gusts, recorded with the wind and noise."""
    rng = np.random.default_rng(seed)
    wind = gusty(rng, ROWS, rng.uniform(-5, 5, 2), 3.0, rows_kept=20)
    thrust = lambda: dict(zip(("port", "starboard"), rng.uniform(30, 210, 2), strict=True))
    orders = [(t, thrust()) for t in np.arange(0.0, STEP * (ROWS - 1), 4.0)]
    table = blown_run(DOCUMENT, superstructure, orders, wind, STEP)
    noisy = {c: table[c] + std * rng.standard_normal(ROWS) for c, std in NOISE.items()}
    return {**table, **noisy}


def trajectory(table, name):
    run = read_recording(pd.DataFrame(table))
    return dataclasses.replace(run, name=name)


def judged(superstructure):
    """What is believed first of one run and one held out."""
    runs = [trajectory(recorded(seed, superstructure), f"{seed}") for seed in (7, 8)]
    effects = (EFFECTS[NAME], EFFECTS["gyro-bias"])

    def problem_of(recordings, least):
        return make_problem(usv(), recordings, FREE, effects, least=least)

    data = split_data(problem_of, runs[:1], runs[1:], False)
    nominal = estimate(data.train, FREE)
    first = certain_effects(data.train.layout)
    assert [one.effect for one in first] == [NAME]
    return data, judge_all_first(data, nominal, screen(data.train, nominal), first, no_progress)


def test_a_measured_wind_is_found_first_with_what_it_acts_on():
    data, now = judged(SUPERSTRUCTURE)
    assert [one.name for one in now.effects] == [NAME]
    assert now.audited == () and not now.searched
    assert verdict_on(now.effects, 1.0) == "explained"
    (found,) = data.train.layout.physical(NAME, now.final.coordinates)
    values = {key: float(value) for key, value in EFFECTS[NAME].decode(usv(), found).items()}
    assert values == pytest.approx(SUPERSTRUCTURE, rel=0.25)


def test_a_measured_wind_that_moves_nothing_is_not_believed():
    _, now = judged({"C_X": 0.0, "C_Y": 0.0, "C_N": 0.0})
    assert now.effects == ()


def test_it_is_asked_where_every_recording_has_a_wind_and_the_file_no_superstructure():
    table = recorded(3, SUPERSTRUCTURE)
    with_wind = trajectory(table, "a")
    without = trajectory({c: x for c, x in table.items() if "wind" not in c}, "b")
    directed = trajectory({c: x for c, x in table.items() if c != "wind_speed"}, "c")
    stated = build(varied(DOCUMENT, effects=[{"name": "wind", "speed": 0.0, "direction": 0.0}]))
    for vessel, runs, found in (
        (usv(), [with_wind], (NAME,)),
        (usv(), [with_wind, without], ()),
        (usv(), [directed], ()),
        (stated, [with_wind], ()),
    ):
        assert unmodelled_disturbances(vessel, runs) == found
        assert (NAME in {one.name for one in candidate_effects(vessel, runs)}) == bool(found)


def test_a_fit_that_leaves_the_measured_wind_out_says_how_to_have_it(monkeypatch):
    class Begun(Exception):
        """All was said that is said before a fit."""

    def begin(*given):
        raise Begun

    monkeypatch.setattr(fits, "identify", begin)
    table = pd.DataFrame(recorded(3, SUPERSTRUCTURE))
    for effects, told in (((), True), ((NAME,), False)):
        lines: list[str] = []
        with pytest.raises(Begun):
            fits.fit(ORACLE / "usv.toml", [table], effects=effects, progress=lines.append)
        assert any(line.endswith(f"left out: --effects {NAME}") for line in lines) == told


def test_an_estimate_online_says_that_its_air_is_still(monkeypatch, tmp_path):
    class Begun(Exception):
        """All was said that is said before an estimate."""

    def begin(*given):
        raise Begun

    monkeypatch.setattr(online, "_estimator_along", begin)
    windy = varied(DOCUMENT, effects=[{"name": "wind", "C_Y": 0.9}])
    for document, told in ((windy, True), (DOCUMENT, False)):
        path, lines = tmp_path / "boat.toml", []
        path.write_text(dump(document))
        with pytest.raises(Begun):
            online.online(path, trajectory(recorded(3, SUPERSTRUCTURE), "a"), progress=lines.append)
        assert any("in still air" in line for line in lines) == told
