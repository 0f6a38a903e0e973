# pyright: reportArgumentType=false
"""What the closed loop asks of thrust, thrust angle, tolerance and the logic's limits.

The paper names these as results and requirements of its framework (abstract, sections I, II.B and
IV.A) and varies none but the thrust. Here each is varied alone about the published boat.
"""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

from experiments.harness.reporting import compared, table
from experiments.pytheas.boat import (
    FULL_ANGLE,
    MASS,
    SWING,
    THRUST,
    TOP_SPEED,
    at_rest,
    boat,
    disturbed,
)
from experiments.pytheas.still_water import THRUSTS

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import Environment
from diffsea.simulation.control.waypoints import waypoint_logic
from diffsea.simulation.integrate import SimulationState, advance, begin
from diffsea.types import Scalar


PERIOD, SECONDS = 0.05, 120.0  # s
LANES = 64
ANGLES = np.pi * np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.47])  # rad
SWELLS = (0.0, 10.0, 20.0, 30.0)  # N
DESIGNED = 24.2  # N: least thrust for 20 N from any side, rounded up
TOLERANCES = (0.25, 0.5, 1.0, 1.5, 2.5, 4.0)  # m
NEARS = (1.0, 2.5, 5.0, 10.0, 15.0, 20.0, 40.0)  # m
STARTS = {"from rest": 0.0, "at full speed": TOP_SPEED}  # m/s
CLOSE = (3.0, 5.0, 8.0, 12.0, 18.0)  # m to waypoints beside and astern


class Case(eqx.Module):
    """One boat, its logic and its task; numbers, or a batch of them."""

    north: Scalar = 20.0  # m
    east: Scalar = 0.0  # m
    thrust: Scalar = THRUST  # N
    full_angle: Scalar = FULL_ANGLE  # rad
    tolerance: Scalar = 2.5  # m
    near: Scalar = 10.0  # m, nearer than which wide turns have less thrust
    bias: Scalar = 0.0  # N
    direction: Scalar = 0.0  # rad, where the swell pushes to
    speed: Scalar = 0.0  # m/s ahead at the start, to the north
    mass: Scalar = MASS  # kg
    scale: Scalar = 1.0  # length over the published one


class End(eqx.Module):
    """How a run ended."""

    time: Float[np.ndarray, "case"]  # s, infinite where the waypoint was not reached
    closest: Float[np.ndarray, "case"]  # m
    missed: Float[np.ndarray, "case"]  # one where the first pass went by, else zero


class _Sailing(eqx.Module):
    motion: SimulationState
    memory: Array
    time: Scalar
    closest: Scalar
    missed: Scalar


def run(cases: Sequence[Case], seconds: float = SECONDS) -> End:
    """Every case for so long at most, in blocks of one size."""
    full = [*cases, *[cases[-1]] * (-len(cases) % LANES)]
    batch = jax.tree.map(lambda *leaves: np.array(leaves, float), *full)
    ends = [
        _block(jax.tree.map(lambda leaf, k=k: leaf[k : k + LANES], batch), jnp.asarray(seconds))
        for k in range(0, len(full), LANES)
    ]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: len(cases)], *ends)


@eqx.filter_jit
def _block(cases: Case, seconds: Scalar) -> End:
    swing = jnp.where(cases.bias > 0, SWING, 0.0)

    def prepared(case: Case, swing: Scalar) -> tuple:
        vessel = boat(case.thrust, mass=case.mass, full_angle=case.full_angle, scale=case.scale)
        vessel = disturbed(vessel, case.bias, case.direction, swing)
        point = jnp.stack([case.north, case.east])[None]
        logic = waypoint_logic(vessel, point, tolerance=case.tolerance, near=case.near)
        state = eqx.tree_at(lambda s: s.u, at_rest(), case.speed)
        _, orders = logic.step(logic.init(), state, jnp.zeros(()), PERIOD)
        motion = begin(vessel, state, orders, dict.fromkeys(vessel.channels, 1))
        away = jnp.hypot(case.north, case.east)
        start = _Sailing(motion, logic.init(), jnp.asarray(jnp.inf), away, jnp.zeros(()))
        return vessel, logic, start

    vessels, logics, sailing = jax.vmap(prepared)(cases, swing)
    step = jax.vmap(_step, in_axes=(0, 0, 0, 0, None))

    def going(carry: tuple) -> Array:
        return (carry[1] * PERIOD < seconds) & jnp.any(jnp.isinf(carry[0].time))

    def body(carry: tuple) -> tuple:
        return step(cases, vessels, logics, *carry), carry[1] + 1

    last, _ = jax.lax.while_loop(going, body, (sailing, jnp.zeros(())))
    return End(last.time, last.closest, last.missed)


def _step(case: Case, vessel, logic, sailing: _Sailing, number: Scalar) -> _Sailing:
    """One period further; a pass is over once the boat is a tolerance further off than it was."""
    t = number * PERIOD
    memory, orders = logic.step(sailing.memory, sailing.motion.state, t, PERIOD)
    motion = advance(vessel, sailing.motion, orders, Environment(), t, PERIOD)
    away = jnp.hypot(case.north - motion.state.x, case.east - motion.state.y)
    under_way = jnp.isinf(sailing.time)
    time = jnp.where(under_way & (away <= case.tolerance), t + PERIOD, sailing.time)
    closest = jnp.where(under_way, jnp.minimum(sailing.closest, away), sailing.closest)
    gone = under_way & (away > closest + case.tolerance)
    return _Sailing(motion, memory, time, closest, jnp.where(gone, 1.0, sailing.missed))


def directions(every: float) -> np.ndarray:
    """Directions of a swell (rad) from following to ahead; the other side mirrors them."""
    return np.deg2rad(np.arange(0.0, 180.1, every))


def beside(radius: float) -> list[tuple[float, float]]:
    """Waypoints (m) from abeam to astern at a distance, every 15 degrees."""
    bearings = np.deg2rad(np.arange(90.0, 180.1, 15.0))
    return [(radius * np.cos(b), radius * np.sin(b)) for b in bearings]


def by(cases: Iterable[tuple[Any, Case]], seconds: float = SECONDS) -> dict[Any, End]:
    """Runs of many cases at once, apart by their keys."""
    keys, listed = zip(*cases, strict=True)
    end = run(listed, seconds)
    rows = {key: np.array([other == key for other in keys]) for key in dict.fromkeys(keys)}
    return {key: jax.tree.map(lambda leaf, r=row: leaf[r], end) for key, row in rows.items()}


# Thrust angle


def angle_range(every: float) -> dict:
    """Share of directions in which the waypoint is reached, by thrust, swell and full angle."""
    grid = itertools.product((THRUST, DESIGNED), SWELLS[1:], ANGLES, directions(every))
    ends = by(
        ((F, B, angle), Case(thrust=F, full_angle=angle, bias=B, direction=way))
        for F, B, angle, way in grid
    )
    calm = by(
        (angle, Case(north, east, full_angle=angle))
        for angle in ANGLES
        for north, east in beside(20.0)
    )
    found = {"angles": ANGLES, "calm": [float(calm[a].time.max()) for a in ANGLES], "swell": []}
    for F, B in itertools.product((THRUST, DESIGNED), SWELLS[1:]):
        shares = [float(np.isfinite(ends[F, B, a].time).mean()) for a in ANGLES]
        found["swell"].append({"thrust": F, "bias": B, "shares": shares,
                               "enough": float(ANGLES[int(np.argmax(shares))])})  # fmt: skip
    return found


def angle_table(found: dict) -> str:
    """Full angles across; still water, then each thrust and swell down."""
    head = ("", *(f"{np.rad2deg(angle):.0f} deg" for angle in found["angles"]))
    calm = [f"{t:.1f} s" if np.isfinite(t) else "never" for t in found["calm"]]
    rows = [("still water: longest to a waypoint abeam to astern", *calm)]
    rows += [
        (f"{one['thrust']:g} N, swell of {one['bias']:.0f} N: directions reached",
         *(f"{100 * share:.0f} %" for share in one["shares"]))
        for one in found["swell"]
    ]  # fmt: skip
    return table(head, rows)


# Tolerance, and less thrust near the waypoint


def tolerances(every: float) -> dict:
    """Runs by tolerance: in still water to waypoints beside and astern, and in each swell."""
    still = [
        ((f"still water, {way}", size), Case(north, east, tolerance=size, speed=speed))
        for size in TOLERANCES for radius in CLOSE[1:] for north, east in beside(radius)
        for way, speed in STARTS.items()
    ]  # fmt: skip
    swell = [
        ((f"swell of {B:.0f} N", size), Case(tolerance=size, bias=B, direction=way))
        for B in SWELLS[1:3] for size in TOLERANCES for way in directions(every)
    ]  # fmt: skip
    ends = by(still + swell)
    return {f"{where}, {size:g} m": _shares(end) for (where, size), end in ends.items()}


def nears(every: float) -> dict:
    """Runs by the distance within which wide turns have less thrust."""
    sides = np.concatenate([directions(every), -directions(every)[1:-1]])
    cases = [
        ((f"{place}, {way}", near), Case(north, east, near=near, bias=B, direction=to, speed=speed))
        for place, B, all_ways in (("still water", 0.0, (0.0,)), ("swell of 10 N", 10.0, sides))
        for way, speed in STARTS.items()
        for near in NEARS for radius in CLOSE for north, east in beside(radius)
        for to in all_ways
    ]  # fmt: skip
    return {f"{place}, {near:g} m": _shares(end) for (place, near), end in by(cases).items()}


def _shares(end: End) -> dict:
    there = np.isfinite(end.time)
    return {
        "runs": len(there),
        "reached": float(there.mean()),
        "at_once": float((there & (end.missed == 0)).mean()),
        "median_time": float(np.median(end.time[there])) if there.any() else None,
        "longest_time": float(end.time[there].max()) if there.any() else None,
    }


def shares_table(first: str, found: dict) -> str:
    """Places across, sizes down: runs that arrive at the first pass, or later, and median time."""
    places = list(dict.fromkeys(name.rpartition(", ")[0] for name in found))
    sizes = list(dict.fromkeys(name.rpartition(", ")[2] for name in found))
    head = (first, *(f"{place} ({found[f'{place}, {sizes[0]}']['runs']} runs)" for place in places))
    rows = [(size, *(_cell(found[f"{place}, {size}"]) for place in places)) for size in sizes]
    return table(head, rows)


def _cell(one: dict) -> str:
    later = one["reached"] - one["at_once"]
    late = f" and {100 * later:.0f} % later" if later > 0.005 else ""
    return f"{100 * one['at_once']:.0f} %{late}, {one['median_time']:.1f} s"


# Thrust as a compromise


def thrusts(widths: dict[float, float]) -> list[dict]:
    """Top speed, room for a half turn, and times to waypoints ahead and astern, by full thrust."""
    ends = by(
        (F, Case(north, thrust=F)) for F in THRUSTS for north in (20.0, -20.0)
    )  # fmt: skip
    return [
        {"thrust": F, "top_speed": F / 14.0, "half_width": widths[F],
         "ahead": float(ends[F].time[0]), "astern": float(ends[F].time[1])}
        for F in THRUSTS
    ]  # fmt: skip


def thrusts_table(found: list[dict]) -> str:
    """One row per thrust."""
    head = ("full thrust, N", "top speed, m/s", "half width of a half turn, m",
            "20 m ahead, s", "20 m astern, s")  # fmt: skip
    return table(head, [tuple(one.values()) for one in found])


def comparison_rows(angles: dict, near: dict, compromise: list[dict]) -> list[dict]:
    """What the paper says in words, beside what comes of it."""
    least = {one["bias"]: np.rad2deg(one["enough"]) for one in angles["swell"]
             if one["thrust"] == DESIGNED}  # fmt: skip
    enough = ", ".join(f"{angle:.0f} deg for {bias:.0f} N" for bias, angle in least.items())
    arrivals = ", ".join(
        f"{100 * share:.0f} % within {distance:g} m"
        for distance in (5.0, 10.0, 20.0)
        for share in [np.mean([near[f"swell of 10 N, {way}, {distance:g} m"]["at_once"]
                               for way in STARTS])]
    )  # fmt: skip
    widths = [one["half_width"] for one in compromise]
    fall = 100 * (1 - min(widths) / max(widths))
    return [
        compared("full angle that reaches as many directions as any", "", "a result of the design",
                 f"at {DESIGNED:g} N: {enough}"),
        compared("distance within which wide turns have less thrust", "", "10 to 20 m",
                 f"arrivals at the first pass, swell of 10 N: {arrivals}"),
        compared("20 N as a compromise of turning and speed", "", "compromise",
                 f"from 5 to 80 N speed grows 16 times, turns get {fall:.0f} % tighter"),
    ]  # fmt: skip
