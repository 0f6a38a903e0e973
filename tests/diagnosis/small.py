# pyright: reportArgumentType=false
"""Small real problems and records of hypotheses, for tests of the diagnosis."""

from pathlib import Path

import numpy as np
from tests.oracle import simulator

from diffsea import EFFECTS, Trajectory, Vessel
from diffsea.diagnosis.constancy import Constancy
from diffsea.diagnosis.hypotheses import Hypothesis
from diffsea.diagnosis.score import ScoreTest
from diffsea.diagnosis.screening import Candidate
from diffsea.identification.coordinates import ExpansionPoint
from diffsea.identification.estimates import Estimate, posterior_estimate
from diffsea.identification.holdout import Gain
from diffsea.identification.problem import Problem, make_problem
from diffsea.vessel.files import build


DOCUMENT = simulator.load(Path(simulator.__file__).parent / "usv.toml")
CLEAR_GAIN = Gain(40.0, 9.0)
STEADY, UNSTEADY = Constancy(9.0, 0.5, 0.1), Constancy(90.0, 1e-9, 0.8)


def usv() -> Vessel:
    """A small twin-hull craft with two fixed thrusters."""
    return build(DOCUMENT)


def still_run(vessel: Vessel, seconds: float = 20.0, step: float = 0.5, **channels) -> Trajectory:
    """A recording at rest with zero orders; `channels` replaces what was recorded."""
    t = np.arange(0.0, seconds, step)
    motion = {c: np.zeros(len(t)) for c in ("x", "y", "psi", "u", "v", "r")}
    orders = {channel: np.zeros(len(t)) for channel in vessel.channels}
    given = {"commanded": orders, "executed": {}, "extra": {}, "valid": np.ones(len(t), bool)}
    return Trajectory(t, **(motion | given | channels))


def still_problem(*effects: str, runs: int = 1, **settings) -> Problem:
    """A problem of recordings at rest with some effects of the catalogue; nothing is compiled."""
    vessel = usv()
    catalogue = tuple(EFFECTS[name] for name in effects)
    recordings = [still_run(vessel)] * runs
    return make_problem(vessel, recordings, ("X_u", "N_r"), catalogue, **settings)


def linear_estimate(free: tuple[str, ...] = (), deviance: float = 0.0, size: int = 1) -> Estimate:
    """An estimate of `size` coordinates, all zero and known to one prior size."""
    one = np.ones(size)
    return posterior_estimate(free, np.zeros(size), deviance, np.arange(size), one, np.eye(size))


def candidate(name: str, columns: np.ndarray, expected: float = 0.0, step=(0.0,)) -> Candidate:
    """A candidate with these efficient columns."""
    point = ExpansionPoint(name, (0.0,) * columns.shape[1], tuple(range(columns.shape[1])))
    return Candidate(point, ScoreTest(0.0, 1.0, np.array(step), 1.0), columns, expected)


def hypothesis(
    name: str,
    evidence: float,
    constancy: Constancy | None = None,
    gain: Gain | None = None,
    is_physical: bool = True,
    statistic: float = 0.0,
) -> Hypothesis:
    """A refitted hypothesis of one coordinate whose evidence is the drop of 1000 in deviance."""
    score = ScoreTest(statistic, 1.0, np.zeros(1), 1.0)
    seen = Candidate(ExpansionPoint(name, (0.0,), (0,)), score, np.ones((3, 1)), 0.0)
    fitted = linear_estimate((name,), 1000.0 - evidence)
    bare = linear_estimate((), 1000.0)
    return Hypothesis(name, fitted, bare, evidence, 0.0, gain, seen, is_physical, constancy)


def judged(
    name: str, evidence: float, constancy: Constancy = STEADY, gain: Gain = CLEAR_GAIN
) -> Hypothesis:
    """A hypothesis that was fitted to its end and judged on held-out data."""
    return hypothesis(name, evidence, constancy, gain)
