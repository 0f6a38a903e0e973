# pyright: reportArgumentType=false
"""Late sensors in a filter against a Kalman filter of two states, on surge simulated exactly.

The vessel runs straight ahead with linear drag: u' = -c u + F / m + a + white gusts, with lasting
gusts a of a first-order Gauss-Markov process. Only u is seen, some rows late.
"""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm
from tests.oracle.simulator import load
from tests.paths import ORACLE
from tests.runs import varied

from diffsea import EFFECTS, Environment, Trajectory
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import (
    FilterRow,
    deviance,
    expected_measurements,
    measurement_jacobian,
)
from diffsea.identification.problem import Problem, make_problem
from diffsea.vessel.files import build
from diffsea.vessel.servo import Response


MASS, DRAG, LENGTH = 180.0 + 12.0, 52.0, 4.9  # kg with added mass, N s/m, m
C = DRAG / MASS
STEP = 0.2  # s, a row
LATE = EFFECTS["sensor-latency:velocity"]


class Gusty(NamedTuple):
    """Gusts on u and the noise of its sensor."""

    white: float = 0.05  # m/s per square root of a second
    lasting: float = 1e-9  # m/s^2
    memory: float = 3.0  # s
    sensor: float = 0.02  # m/s

    @property
    def noise(self) -> Noise:
        """The library's scales; those of channels that are not seen do not matter."""
        scales = [self.white, 0.1, 0.1, self.lasting, 0.1, 0.1, self.memory, 3.0, 3.0]
        return Noise.of(np.log([*scales, 1.0, 1.0, 1.0, self.sensor, 1.0, 1.0, 1e-9]))


def covariance(gusty: Gusty, damping: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition of (u, a) over a row and what gusts add, by Van Loan's matrix exponential."""
    A = np.array([[-damping, 1.0], [0.0, -1 / gusty.memory]])
    L = np.diag([gusty.white**2, 2 * gusty.lasting**2 / gusty.memory])
    block = expm(np.block([[-A, L], [np.zeros((2, 2)), A.T]]) * dt)
    F = block[2:, 2:].T
    return F, F @ block[:2, 2:]


def thrusts(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Thrust (N) in every row: another one every two seconds."""
    return np.repeat(rng.uniform(30.0, 400.0, rows // 10 + 1), 10)[:rows]


def surge(rng: np.random.Generator, push: np.ndarray, gusty: Gusty) -> np.ndarray:
    """u (m/s) at the start of every row, by exact steps from the steady speed."""
    F, Q = covariance(gusty, C, STEP)
    root = np.linalg.cholesky(Q + 1e-24 * np.eye(2))
    state = np.array([push[0] / DRAG, gusty.lasting * rng.normal()])
    out = np.empty(len(push))
    for k, force in enumerate(push):
        out[k] = state[0]
        pushed = (1 - math.exp(-C * STEP)) * force / DRAG
        state = F @ state + [pushed, 0.0] + root @ rng.normal(size=2)
    return out


def recorded(rng: np.random.Generator, rows: int, gusty: Gusty, late: int) -> tuple:
    """Thrusts and u as it is shown `late` rows late."""
    push = thrusts(rng, rows + late)
    shown = surge(rng, push, gusty)[:rows] + gusty.sensor * rng.normal(size=rows)
    return push[late:], shown


@pytest.fixture(scope="module")
def vessel(request):
    """The oracle's craft with linear drag alone ahead."""
    document = load(str(ORACLE / "usv.toml"))
    return build(varied(document, {"X_uu": None}))


def seen(push: np.ndarray, shown: np.ndarray) -> Trajectory:
    """A run of which nothing is measured but u."""
    t, nothing = STEP * np.arange(len(push)), np.full(len(push), np.nan)
    return Trajectory(
        t, nothing, nothing, nothing, shown, nothing, nothing,
        {"port": push / 2, "starboard": push / 2}, {}, {}, np.ones(len(push), bool),
    )  # fmt: skip


def run_at(problem: Problem, rows: float, gusty: Gusty):
    """The filter's run where u is so many rows late."""
    at = np.zeros(problem.layout.size)
    at[-1] = rows * STEP / problem.layout.sizes[0][0]
    return problem.run_filter(at, gusty.noise)


def kalman(push: np.ndarray, shown: np.ndarray, gusty: Gusty, rows: float) -> tuple:
    """Innovations and their variances by a filter of (u, a) whose sensor is `rows` rows late.

    A state of the past is wrong by what has been found since, less what its rate was wrong by for
    so long; the first speed held before the run. What gusts have added since the past is unknown
    to the sensor: of the variance now, a share P / (P + rows Q) was there then.
    """
    lag, (F, Q) = rows * STEP, covariance(gusty, 0.0, STEP)
    gain_a = F[0, 1] / 2  # half the speed that a gives goes before and half after the motion
    left = math.exp(-C * STEP)
    whole = np.array([[left, (1 + left) * gain_a], [0.0, F[1, 1]]])
    reach = lag + 0.5 * C * lag**2  # a late value as its polynomial: u - reach u', u'' = -c u'
    h = np.array([1 + C * reach, -reach])
    state, P = np.array([shown[0], 0.0]), np.diag([0.25 * 9.81 * LENGTH, gusty.lasting**2])
    states, steps, out = [], [], []
    for k, force in enumerate(push):
        states.append(state[0])
        back, part = int(rows), rows % 1
        past = [found(states, steps, k - b, k) for b in (back, back + 1)]
        nu = shown[k] - ((1 - part) * past[0] + part * past[1])
        since = rows * h @ Q @ h
        now = h @ P @ h
        old = now / (now + since)
        s = now + gusty.sensor**2 / old
        K = P @ h / s
        out.append((nu, s * old))
        P = P - np.outer(K, h @ P) + (1 - old) * np.outer(K, h @ P)
        state = state + K * nu
        states[-1] = state[0]
        steps.append(K * nu)
        u = left * (state[0] + gain_a * state[1]) + (1 - left) * force / DRAG
        state = np.array([u + gain_a * state[1], F[1, 1] * state[1]])
        P = whole @ P @ whole.T + Q
    return tuple(np.array(out).T)


def found(states: list, steps: list, at: int, now: int) -> float:
    """u of an earlier row, or before the run, with all that has been found since."""
    since = range(max(at + 1, 0), now)
    return states[max(at, 0)] + sum(steps[j][0] + (at - j) * STEP * steps[j][1] for j in since)


LASTING = Gusty(white=0.01, lasting=0.1)


@pytest.mark.parametrize("gusty", [Gusty(), LASTING], ids=["white gusts", "lasting gusts"])
@pytest.mark.parametrize("rows", [1.5, 1.999, 2.0, 2.001, 2.5])
def test_a_filter_of_two_states_has_the_same_innovations(vessel, rows, gusty):
    push, shown = recorded(np.random.default_rng(0), 240, gusty, 2)
    run = run_at(problem_of(vessel, push, shown), rows, gusty)
    nu, variance = kalman(push, shown, gusty, rows)
    np.testing.assert_allclose(np.asarray(run.innovation)[:240, 3], nu, atol=1e-6)
    # The last row of a run has no length, and no gusts by which it could count its delay.
    np.testing.assert_allclose(np.asarray(run.variance)[:239, 3], variance[:239], rtol=1e-6)


@pytest.mark.parametrize("gusty", [Gusty(), LASTING], ids=["white gusts", "lasting gusts"])
def test_two_rows_late_are_the_most_likely_where_it_was_two(vessel, gusty):
    push, shown = recorded(np.random.default_rng(3), 240, gusty, 2)
    problem = problem_of(vessel, push, shown)
    grid = np.round(np.arange(1.0, 3.01, 0.2), 1)
    values = [float(deviance(run_at(problem, rows, gusty))) for rows in grid]
    known = [expected_deviance(*kalman(push, shown, gusty, rows)) for rows in grid]
    assert grid[np.argmin(values)] == grid[np.argmin(known)] == 2.0
    np.testing.assert_allclose(np.subtract(values, min(values)), np.subtract(known, min(known)),
                               atol=1.0)  # fmt: skip
    worse = np.diff(values)
    assert (worse[grid[1:] <= 2.0] < -5).all() and (worse[grid[1:] > 2.0] > 5).all()


def expected_deviance(nu: np.ndarray, variance: np.ndarray) -> float:
    return float((nu**2 / variance + np.log(variance)).sum())


def problem_of(vessel, push: np.ndarray, shown: np.ndarray) -> Problem:
    return make_problem(vessel, [seen(push, shown)], ("X_u",), (LATE,))


def portmanteau(white: np.ndarray) -> tuple[float, float]:
    """Autocorrelation at lag one in its standard errors; p-value of Ljung and Box's first ten."""
    n, lags = len(white), np.arange(1, 11)
    rho = np.array([white[k:] @ white[:-k] for k in lags]) / (white @ white)
    statistic = n * (n + 2) * (rho**2 / (n - lags)).sum()
    return rho[0] * math.sqrt(n), float(stats.chi2.sf(statistic, len(lags)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_innovations_of_a_late_channel_are_white_at_the_truth_alone(vessel, seed):
    """2000 rows; a filter that takes them for one row more or less late leaves colour."""
    gusty = Gusty()
    push, shown = recorded(np.random.default_rng(seed), 2000, gusty, 2)
    problem = problem_of(vessel, push, shown)
    white = {r: np.asarray(run_at(problem, r, gusty).white)[5:2000, 3] for r in (1, 2, 3)}
    first, chance = portmanteau(white[2])
    assert abs(first) < 3 and chance > 0.01
    assert np.mean(white[2] ** 2) == pytest.approx(1.0, abs=0.15)
    for wrong in (1, 3):
        first, chance = portmanteau(white[wrong])
        assert first > 6 and chance < 1e-20


@pytest.mark.parametrize(("lag", "off"), [(0.0, 1e-12), (0.2, 0.02)])
def test_what_is_shown_depends_on_the_present_as_its_derivative_says(lag, off):
    boat = build(load(str(ORACLE / "usv.toml")))
    late = {"latency_yaw_rate": lag, "latency_heading": lag, "latency_velocity": lag / 2}
    boat = dataclasses.replace(boat, sensors=dataclasses.replace(boat.sensors, **late))
    z = jnp.array([3.0, 1.0, 0.7, 1.1, -0.2, 0.15, 0.01, -0.02, 0.005])
    response = {c: Response(40.0 * k, *[40.0 * k] * 3) for k, c in enumerate(boat.channels)}
    nothing, never = jnp.zeros(6), jnp.array(False)
    row = FilterRow(
        Environment(),
        jnp.array(0.2),
        jnp.array(0.0),
        nothing,
        jnp.zeros(6, bool),
        never,
        nothing,
        response,
    )
    found = measurement_jacobian(boat, z, row)
    nudge = lambda k, by: np.asarray(expected_measurements(boat, z.at[k].add(by), row))
    step = 1e-5
    slopes = np.stack([(nudge(k, step) - nudge(k, -step)) / (2 * step) for k in range(9)], 1)
    np.testing.assert_allclose(found, slopes, atol=max(off, 1e-9) * np.abs(slopes).max())
