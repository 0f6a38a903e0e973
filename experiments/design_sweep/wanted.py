"""Designs from wanted numbers: roots found by Optimistix on exact derivatives."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float
from neighbours import QUANTITIES, plans, quantities

from diffsea.simulation.standard import Plan
from diffsea.vessel.base import Vessel


LANES = 32
START = (100.0, 100.0)  # N, kg: every search begins here
_MOST_STEPS = 40


class Wish(NamedTuple):
    """Two equations `rows @ (QUANTITIES, ln thrust, ln mass) = level`."""

    rows: np.ndarray  # (2, quantities + 2)
    level: np.ndarray  # (2,)


class Found(NamedTuple):
    """Answers to wishes."""

    thrust: Float[np.ndarray, "wish"]  # N
    mass: Float[np.ndarray, "wish"]  # kg
    residual: Float[np.ndarray, "wish"]  # largest, in the units of the equations
    steps: np.ndarray
    solved: np.ndarray


def both(diameter: float, overshoot: float) -> Wish:
    """A tactical diameter in lengths and a first overshoot of the 20/20 in degrees."""
    return Wish(_rows("tactical diameter", "overshoot 20/20"), np.array([diameter, overshoot]))


def at_mass(name: str, value: float, mass: float) -> Wish:
    """One of `QUANTITIES` at a given mass (kg)."""
    rows = _rows(name, name)
    rows[1] = 0
    rows[1, -1] = 1
    return Wish(rows, np.array([value, np.log(mass)]))


def _rows(*names: str) -> np.ndarray:
    rows = np.zeros((len(names), len(QUANTITIES) + 2))
    for k, name in enumerate(names):
        rows[k, QUANTITIES.index(name)] = 1
    return rows


def solve(vessel: Vessel, wishes: list[Wish]) -> Found:
    """The thrust and mass of each wish, all searched side by side."""
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    parts = []
    for k in range(0, len(wishes), LANES):
        block = wishes[k : k + LANES]
        padded = block + [block[-1]] * (LANES - len(block))
        rows = jnp.asarray(np.stack([w.rows for w in padded]))
        level = jnp.asarray(np.stack([w.level for w in padded]))
        answer = _solved(arrays, rows, level, plans(vessel))
        parts.append([np.asarray(part)[: len(block)] for part in answer])
    x, residual, steps, solved = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Found(np.exp(x[:, 0]), np.exp(x[:, 1]), residual, steps, solved)


@eqx.filter_jit
def _solved(
    vessel: Vessel,
    rows: Float[Array, "lane 2 row"],
    level: Float[Array, "lane 2"],
    trials: tuple[Plan, Plan],
) -> tuple:
    def missing(x: Float[Array, "2"], wish: tuple) -> Float[Array, "2"]:
        return wish[0] @ jnp.concatenate([quantities(vessel, trials, x), x]) - wish[1]

    return jax.vmap(lambda r, b: search(missing, jnp.log(jnp.asarray(START)), (r, b)))(rows, level)


def search(missing, start: Float[Array, "2"], wish: tuple) -> tuple:
    """Root, largest residual there, steps taken and whether it was found."""
    solver = optimistix.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    found = optimistix.root_find(
        missing, solver, start, wish, options={"jac": "fwd"}, max_steps=_MOST_STEPS, throw=False
    )
    residual = jnp.max(jnp.abs(missing(found.value, wish)))
    return found.value, residual, found.stats["num_steps"], residual < 1e-6
