"""Frames that only forces can tell: a heading by which velocities were turned as well."""

import dataclasses

from experiments.concealed_real import sets

import numpy as np
import pandas as pd
import pytest

import diffsea
from diffsea.recordings.auditing.edits import Reheading
from diffsea.recordings.mappings import Column, Mapping


DT, SECONDS = 0.2, 300.0
READINGS = {"mirrored": (-1.0, np.pi / 2), "quarter": (1.0, np.pi / 2), "astern": (1.0, np.pi)}


def ferry(seed: int, gain: float = 0.02, widest: float = np.pi) -> diffsea.Trajectory:
    """A body with drag and an azimuth thruster that pushes at random; stepped by Euler's rule."""
    rng = np.random.default_rng(seed)
    rows = int(SECONDS / DT)
    hold = lambda least, most: np.repeat(rng.uniform(least, most, rows // 25 + 1), 25)[:rows]
    force, angle, turning = hold(0.0, 10.0), hold(-widest, widest), hold(-0.1, 0.1)
    psi = np.cumsum(turning) * DT
    push = gain * force * np.exp(1j * angle)
    gusts = 0.02 * rng.standard_normal((2, rows)) / np.sqrt(DT)
    earth, place = np.zeros(rows, complex), np.zeros(rows, complex)
    for k in range(rows - 1):
        body = earth[k] * np.exp(-1j * psi[k])
        pull = push[k] - 0.1 * np.real(body) - 0.3j * np.imag(body) + gusts[0, k] + 1j * gusts[1, k]
        earth[k + 1] = earth[k] + DT * pull * np.exp(1j * psi[k])
        place[k + 1] = place[k] + DT * 0.5 * (earth[k] + earth[k + 1])
    body = earth * np.exp(-1j * psi)
    noise = 0.01 * rng.standard_normal((2, rows))
    table = {
        "t": DT * np.arange(rows), "x": np.real(place), "y": np.imag(place), "psi": psi,
        "u": np.real(body) + noise[0], "v": np.imag(body) + noise[1], "r": turning,
        "cmd_pod.force": force, "cmd_pod.angle": angle,
    }  # fmt: skip
    return diffsea.read_recording(pd.DataFrame(table))


def disguised(run: diffsea.Trajectory, sense: float, offset: float) -> diffsea.Trajectory:
    """The run with its heading, yaw rate and body axes read otherwise."""
    psi = sense * np.asarray(run.psi) + offset
    body = (run.u + 1j * np.asarray(run.v)) * np.exp(1j * (run.psi - psi))
    return dataclasses.replace(run, psi=psi, u=body.real, v=body.imag, r=sense * np.asarray(run.r))


def axes_findings(run: diffsea.Trajectory) -> list:
    return [finding for finding in diffsea.audit(run) if finding.kind == "axes"]


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
def test_thrust_tells_a_heading_that_kinematics_cannot(reading):
    run = ferry(1)
    [finding] = axes_findings(disguised(run, *reading))
    assert set(finding.channels) == {"psi", "u", "v"}
    [edit] = finding.edits
    repaired = edit.apply(disguised(run, *reading))
    turns = (np.asarray(repaired.psi) - run.psi) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-9)
    np.testing.assert_allclose(repaired.u, run.u, atol=1e-9)
    np.testing.assert_allclose(repaired.v, run.v, atol=1e-9)
    np.testing.assert_allclose(repaired.r, run.r, atol=1e-9)
    assert axes_findings(repaired) == []


@pytest.mark.parametrize("seed", range(4))
def test_a_right_heading_is_left_alone(seed):
    assert axes_findings(ferry(seed)) == []


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
def test_a_thruster_that_is_hardly_turned_tells_nothing(reading):
    """As an outboard of which the legs are straight."""
    assert axes_findings(disguised(ferry(1, widest=0.3), *reading)) == []


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
def test_thrust_that_does_little_tells_nothing(reading):
    assert axes_findings(disguised(ferry(2, gain=2.3e-3), *reading)) == []


@pytest.mark.skipif(not sets.available(), reason="the recordings of real vessels are absent")
@pytest.mark.parametrize(
    "reading",
    [
        READINGS["mirrored"],
        *(
            pytest.param(other, marks=pytest.mark.proof)
            for other in (READINGS["quarter"], READINGS["astern"], (-1.0, 0.0))
        ),
    ],
)
def test_a_ferrys_thrust_tells_its_heading(reading):
    """Of three runs one moves and turns enough to tell; as they are, none is accused."""
    told = []
    for table in sets.milliampere().values():
        run = diffsea.read_recording(table)
        run = dataclasses.replace(run, r=np.full(run.t.size, np.nan))
        assert axes_findings(run) == []
        told.append(axes_findings(disguised(run, *reading)))
    assert [len(found) for found in told] == [1, 0, 0]
    [edit] = told[0][0].edits
    assert isinstance(edit, Reheading) and edit.sense == reading[0]
    back = edit.sense * reading[1] + edit.offset
    assert abs(np.exp(1j * back) - 1.0) < 1e-9


def test_a_mapping_with_velocities_in_earth_axes_says_it():
    columns = {name: Column(name) for name in ("t", "psi", "u", "v", "r")}
    edit = Reheading(-1.0, np.pi / 2)
    turned = Mapping(columns, velocity_axes="earth")
    amended = edit.amend_mapping(turned)
    assert amended is not None
    assert amended.velocity_axes == "earth"
    assert amended.channels["psi"].gain == amended.channels["r"].gain == -1.0
    assert amended.channels["psi"].shift == pytest.approx(np.pi / 2)
    body = dataclasses.replace(turned, velocity_axes="body")
    assert edit.amend_mapping(body) is None
