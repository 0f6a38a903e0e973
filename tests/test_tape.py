"""Recordings on the tape as they come: gaps, positions alone, and filters that diverge."""

import dataclasses

import numpy as np
import pytest
from tests.oracle.simulator import load, simulate

from diffsea.identification.fit import estimate, posterior
from diffsea.identification.likelihood import deviance
from diffsea.identification.problem import make_problem
from diffsea.types import Trajectory
from diffsea.vessel.catalogue import build


SEEN = ("x", "y", "psi", "u", "v", "r")
NOISE = (0.3, 0.3, 0.01, 0.02, 0.02, 0.003)


@pytest.fixture(scope="module")
def document(request) -> dict:
    return load(str(request.path.parent / "oracle" / "usv.toml"))


@pytest.fixture(scope="module")
def run(document) -> Trajectory:
    """Two minutes of random steps by the oracle, with sensors' noise."""
    rng = np.random.default_rng(4)
    steps = [(t, 120 + 90 * rng.uniform(-1, 1, 2)) for t in np.arange(0.0, 120.0, 5.0)]
    orders = [(t, {"port": float(p), "starboard": float(s)}) for t, (p, s) in steps]
    sim = simulate(document, orders, 120.0, rtol=1e-8, atol=1e-10)
    t = np.arange(0.0, 120.0, 0.5)
    states = sim.at(t)
    motion = {
        name: states[name] + std * rng.standard_normal(t.size)
        for name, std in zip(SEEN, NOISE, strict=True)
    }
    held = np.searchsorted([time for time, _ in steps], t + 1e-9) - 1
    thrust = np.array([pair for _, pair in steps])[held]
    commanded = {"port": thrust[:, 0], "starboard": thrust[:, 1]}
    return Trajectory(t, **motion, commanded=commanded, executed={}, extra={},
                      valid=np.ones(t.size, bool))  # fmt: skip


def rows(run: Trajectory, chosen: np.ndarray) -> Trajectory:
    series = {name: getattr(run, name)[chosen] for name in ("t", *SEEN, "valid")}
    commanded = {name: values[chosen] for name, values in run.commanded.items()}
    return dataclasses.replace(run, **series, commanded=commanded)


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_a_gap_is_as_good_as_two_runs(document, run, seconds):
    vessel, free = build(document), ("X_u", "X_uu")
    before, after = run.t < 40, run.t >= 40 + seconds
    pieces = [rows(run, before), rows(run, after)]
    start = np.array([0.5, 0.0])
    one = estimate(make_problem(vessel, [rows(run, before | after)], free), free, start)
    two = estimate(make_problem(vessel, pieces, free), free, start)
    assert one.deviance == pytest.approx(two.deviance, abs=1.0)
    assert one.stds == pytest.approx(two.stds, rel=0.02)


def test_a_short_hole_is_bridged(document, run):
    vessel = build(document)
    tape = make_problem(vessel, [rows(run, (run.t < 40) | (run.t >= 41))], ("X_u",)).tape
    assert np.asarray(tape.starts).sum() == 1


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
        values.append(posterior(problem, *problem.start()))
    assert values[0] == pytest.approx(values[1], abs=1.0)


def test_a_filter_that_diverges_has_no_likelihood(document, run):
    vessel = build(document)
    hidden = {name: np.full(run.t.size, np.nan) for name in ("psi", "u", "v", "r")}
    problem = make_problem(vessel, [dataclasses.replace(run, **hidden)], ("X_uu",))
    coordinates, noise = problem.start()
    assert np.isfinite(float(deviance(problem.tuned(coordinates, noise))))
    away = coordinates + 12.0  # drag 10^5 times as large: no step of the integration is stable
    assert not np.isfinite(float(deviance(problem.tuned(away, noise))))
