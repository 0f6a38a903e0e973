"""Least thrust and the thruster's place that reach the waypoint in every direction of a swell.

The run's closest approach has an exact derivative through the closed loop, by forward mode. With
one margin per direction this is a small problem with many constraints, solved by linear programs
(scipy's HiGHS) inside a trust region, with the directions refined where a finer check finds worse.
"""

import functools
import time
from typing import NamedTuple, cast

from experiments.pytheas.approach import RANGE, TOLERANCE, approach
from experiments.pytheas.boat import FREQUENCY, MASS, SURGE_SHARE, SWING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq, linprog

from diffsea.types import Scalar


SECONDS = 60.0  # s, in which the first attempt must succeed
INSIDE = 1.5  # m; nearer than this counts as this: there the distance says nothing of the design
SHARPNESS = 40.0  # of the logic while designing; the check uses the published one
WORTH = 1.0  # N of thrust for a metre of lever: any small number chooses the shortest lever
SCALE = np.array([20.0, 0.4])  # N and m
LOW, HIGH = 0.02, 0.5  # m, of the lever
PENALTY = 100.0  # N for a metre that is missed by


class Design(NamedTuple):
    """What was found for one disturbance and one side of the mass centre."""

    bias: float  # N
    thrust: float  # N
    lever: float  # m, negative abaft the mass centre
    margin: float  # m, least over the checked directions, with the published logic
    active: list[float]  # deg, directions that decide
    rounds: int
    runs: int  # runs of 60 s, those for derivatives counted once
    seconds: float


@functools.partial(jax.jit, static_argnames="sharpness")
def margins(
    design: Float[Array, "2"],
    bias: Scalar,
    directions: Float[Array, "direction"],
    sharpness: float | None = SHARPNESS,
) -> Float[Array, "direction"]:
    """How much nearer than needed (m) the first attempt comes, in each direction (rad).

    `design` is thrust (N) and lever (m).
    """

    def one(direction: Scalar) -> Scalar:
        return approach(design[0], design[1], bias, direction, SECONDS, sharpness).closest

    return TOLERANCE - jnp.maximum(jax.vmap(one)(directions), INSIDE)


slopes = jax.jit(jax.jacfwd(margins))


def gradient_check(bias: float, directions: Float[np.ndarray, "direction"]) -> dict:
    """The exact derivative beside central differences, where a design just fails."""
    at, steps = np.array([bias + 3.5, 0.17]), (1e-5, 1e-7)
    exact = np.asarray(slopes(jnp.asarray(at), bias, directions))
    columns = []
    for k, h in enumerate(steps):
        shift = h * np.eye(2)[k]
        upper, lower = (np.asarray(margins(at + s * shift, bias, directions)) for s in (1, -1))
        columns.append((upper - lower) / (2 * h))
    rough = np.stack(columns, axis=-1)
    off = np.abs(exact - rough).max(axis=0) / np.abs(exact).max(axis=0)
    return {"largest_relative_difference": off, "largest_slope": np.abs(exact).max(axis=0)}


def solve(
    bias: float, side: int, directions: Float[np.ndarray, "direction"], most: int = 60
) -> tuple[np.ndarray, np.ndarray, int]:
    """Thrust and lever for given directions; the margins there, and how many rounds it took.

    `side` is 1 ahead of the mass centre, -1 abaft it.
    """
    cost = np.array([1.0, side * WORTH])
    bounds = np.array([[1.0, 200.0], sorted((side * LOW, side * HIGH))])
    at, radius = np.array([bias + 10.0, side * 0.4]), 0.25

    def merit(at: np.ndarray, found: np.ndarray) -> float:
        return float(cost @ at + PENALTY * max(0.0, -found.min()))

    found = np.asarray(margins(at, bias, directions))
    count = 0
    while radius > 1e-5 and count < most:
        count += 1
        slope = np.asarray(slopes(jnp.asarray(at), bias, directions))
        step = _program(cost, found, slope, np.clip(bounds - at[:, None], *_box(radius)))
        if np.abs(step / SCALE).max() < 1e-5:
            break
        tried = np.asarray(margins(at + step, bias, directions))
        if merit(at + step, tried) < merit(at, found) - 1e-9:
            at, found, radius = at + step, tried, min(2 * radius, 0.25)
        else:
            radius = radius / 4
    return at, found, count


def _box(radius: float) -> tuple[np.ndarray, np.ndarray]:
    size = radius * SCALE[:, None]
    return -size, size


def _program(cost: np.ndarray, found: np.ndarray, slope: np.ndarray, box: np.ndarray) -> np.ndarray:
    """The step that is best to first order, within a box; margins that stay negative cost."""
    slack = -np.ones((len(found), 1))
    limits = [*map(tuple, box), (0.0, None)]
    solved = linprog(
        np.append(cost, PENALTY), A_ub=np.hstack([-slope, slack]), b_ub=found, bounds=limits
    )
    if solved.x is None:
        raise RuntimeError(f"no step: {solved.message}")
    return solved.x[:2]


def least(bias: float, side: int, coarse: int, fine: int, most: int = 60) -> Design:
    """Solve, check every direction on a fine grid with the published logic, and refine.

    `coarse` and `fine` are numbers of directions from 0 to 180 degrees; the other half mirrors.
    """
    began = time.perf_counter()
    directions = np.linspace(0.0, np.pi, coarse)
    check = np.linspace(0.0, np.pi, fine)
    rounds = runs = 0
    for _ in range(4):
        at, found, count = solve(bias, side, directions, most)
        hard = np.asarray(margins(at, bias, check, None))
        rounds, runs = rounds + count, runs + (2 * count + 1) * coarse + fine
        if hard.min() > -0.1:
            break
        # The direction that matters least gives way to the one that was overlooked.
        directions[int(np.argmax(found))] = check[int(np.argmin(hard))]
    active = sorted(float(np.rad2deg(directions[k])) for k in np.flatnonzero(found < 0.02))
    return Design(
        bias, float(at[0]), float(at[1]), float(hard.min()), active, rounds, runs,
        time.perf_counter() - began,
    )  # fmt: skip


def verified(bias: float, thrust: float, lever: float, fine: int) -> float:
    """Least margin (m) of a design over a fine grid of directions, with the published logic."""
    check = np.linspace(0.0, np.pi, fine)
    return float(np.asarray(margins(np.array([thrust, lever]), bias, check, None)).min())


def landscape(
    bias: float, thrusts: np.ndarray, levers: np.ndarray, coarse: int
) -> Float[np.ndarray, "thrust lever"]:
    """Least margin (m) over the directions, with the published logic, on a grid of designs."""
    directions = np.linspace(0.0, np.pi, coarse)
    rows = [
        [np.asarray(margins(np.array([f, x]), bias, directions, None)).min() for x in levers]
        for f in thrusts
    ]
    return np.array(rows)


def shortest_levers(
    bias: float, thrust: float, readings: dict[str, float], coarse: int
) -> dict[str, dict[str, float]]:
    """Lever (m, to a centimetre) from which on every direction is reached, by D and by side."""
    directions = np.linspace(0.0, np.pi, coarse)
    levers = np.linspace(0.01, HIGH, round(100 * HIGH))

    @jax.jit
    def least(lever: Scalar, D: Scalar) -> Scalar:
        def one(direction: Scalar) -> Scalar:
            return approach(thrust, lever, bias, direction, SECONDS, None, D).closest

        return TOLERANCE - jnp.max(jax.vmap(one)(directions))

    found: dict[str, dict[str, float]] = {}
    for name, D in readings.items():
        found[name] = {}
        for side, place in ((1, "ahead"), (-1, "aft")):
            margin = np.array([float(least(side * lever, D)) for lever in levers])
            failing = np.flatnonzero(margin < 0)
            first = 0 if failing.size == 0 else failing[-1] + 1
            found[name][place] = float(levers[first]) if first < len(levers) else np.nan
    return found


def rounded(design: Design, fine: int) -> dict:
    """The design rounded up to 0.1 N and 0.01 m, and what becomes of it with less of either."""
    thrust = np.ceil(10 * design.thrust) / 10
    side = np.sign(design.lever)
    lever = np.ceil(100 * abs(design.lever)) / 100
    for _ in range(5):
        if verified(design.bias, thrust, side * lever, fine) >= 0:
            break
        lever += 0.01
    return {
        "thrust": thrust,
        "lever": side * lever,
        "margin": verified(design.bias, thrust, side * lever, fine),
        "margin_with_2_percent_less_thrust": verified(
            design.bias, 0.98 * thrust, side * lever, fine
        ),
        "margin_with_lever_shorter_by_0.03": verified(
            design.bias, thrust, side * max(lever - 0.03, 0.0), fine
        ),
    }


def head_sea_thrust(bias: float) -> float:
    """Least thrust (N) straight into the swell, from the closed form of the surge equation.

    Linear in time's functions: `m_x u' = F - B - A sin(w t) - d u` from rest, and the largest x
    within the time must be what is missing to the waypoint.
    """
    t = np.linspace(0.0, SECONDS, 60_001)
    lag, w, d = (1 + SURGE_SHARE) * MASS / 14.0, 2 * np.pi * FREQUENCY, 14.0
    settled = t - lag * (1 - np.exp(-t / lag))
    swing = (1 - np.cos(w * t)) / w - lag * np.sin(w * t) + w * lag**2 * (1 - np.exp(-t / lag))

    def missing(thrust: float) -> float:
        x = (thrust - bias) / d * settled - SWING / d / (1 + (w * lag) ** 2) * swing
        return x.max() - (RANGE - TOLERANCE)

    return cast(float, brentq(missing, bias, bias + 100.0))


HEAD = ("swell, N", "thruster", "least thrust, N", "closed form head on, N", "shortest lever, m",
        "directions that decide, deg", "built as", "margin, m", "with 2 % less thrust, m",
        "with 0.03 m less lever, m")  # fmt: skip


def row(best: Design, safe: dict, closed: float) -> tuple:
    """A line of the table of designs."""
    short = safe["margin_with_lever_shorter_by_0.03"]
    return (
        best.bias, "ahead" if best.lever > 0 else "aft", f"{best.thrust:.3f}", f"{closed:.3f}",
        f"{abs(best.lever):.3f}", ", ".join(f"{angle:.0f}" for angle in best.active),
        f"{safe['thrust']:.1f} N, {abs(safe['lever']):.2f} m", f"{safe['margin']:.2f}",
        f"{safe['margin_with_2_percent_less_thrust']:.2f}", f"{short:.2f}",
    )  # fmt: skip
