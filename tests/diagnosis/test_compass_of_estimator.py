# pyright: reportArgumentType=false
"""A compass that iron or motors deflect, concealed in runs of the oracle: which way it is named.

The deviation is integrated row by row here, by Euler's rule in steps of a hundredth of a second.
"""

import dataclasses
import math

import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import random_steps

import diffsea
from diffsea.vessel.files import build


USV = load(ORACLE / "usv.toml")
PARTS = 20  # of a row of 0.2 s


def deviation(run, amplitude, phase, time_constant, of_motors):
    """Shown less true heading (rad) in every row."""
    psi, e, found = np.asarray(run.psi), 0.0, []
    shares = [np.where(f > 0, f / 250.0, -f / 180.0) for f in run.commanded.values()]
    load = np.mean(shares, axis=0) if of_motors else np.ones(psi.size)
    for _ in range(50):  # it had been as at first for long
        e = load[0] * amplitude * math.sin(psi[0] + e - phase)
    for k, step in enumerate(np.diff(run.t, append=run.t[-1])):
        found.append(e)
        for _ in range(PARTS):
            field = load[k] * amplitude * math.sin(psi[k] + e - phase)
            e += step / PARTS * (field - e) / time_constant
    return np.array(found)


def shown(run, e, turned):
    """The run with its heading, and if `turned` its velocities, off by an angle (rad)."""
    if not turned:
        return dataclasses.replace(run, psi=run.psi + e)
    c, s = np.cos(e), np.sin(e)
    u, v = c * run.u + s * run.v, c * run.v - s * run.u
    return dataclasses.replace(run, psi=run.psi + e, u=u, v=v)


def diagnosed(disturb):
    """The record of a diagnosis of two runs and a third held out, each disturbed."""
    runs = [disturb(random_steps(USV, seed, 150.0, 0.2)) for seed in (71, 72, 73)]
    boat = diffsea.VesselFile(build(USV), USV, None)
    return diffsea.diagnose(boat, runs[:2], runs[2:]).record


def named(record):
    return [one for one in record["effects"] if one["name"] != "unexplained"]


@pytest.mark.proof
@pytest.mark.parametrize("of_motors", [True, False])
def test_a_deviation_behind_an_estimator_is_named_with_its_size(of_motors):
    known = {"amplitude": 0.3, "phase": 0.9, "time_constant": 5.0}
    record = diagnosed(lambda run: shown(run, deviation(run, **known, of_motors=of_motors), True))
    (one,) = named(record)
    assert one["name"] == "hard-iron" and one["channels"] == ["psi", "u", "v"]
    assert ("actuators" in one) == of_motors
    for key, value in known.items():
        found = one["parameters"][key]
        assert abs(found["value"] - value) < max(4 * found["std"], 0.03 * value)
    assert record["verdict"] == "explained"


@pytest.mark.proof
def test_iron_that_turns_the_compass_alone_is_named_as_that():
    record = diagnosed(lambda run: shown(run, 0.12 * np.sin(run.psi - 0.9), False))
    (one,) = named(record)
    assert one["name"] == "hard-iron" and "channels" not in one
    assert one["parameters"]["amplitude"]["value"] == pytest.approx(0.12, abs=0.01)


@pytest.mark.proof
def test_a_sound_compass_is_none_that_is_deflected():
    assert not named(diagnosed(lambda run: run))
