"""Designs from wanted numbers: Newton's method on exact derivatives, all wishes side by side."""

from collections.abc import Callable
from typing import NamedTuple

from experiments.design_sweep.neighbours import QUANTITIES, with_slopes

import numpy as np
from jaxtyping import Float

from diffsea import Vessel


START = (100.0, 100.0)  # N, kg: where a search begins without known designs
_MOST_STEPS = 40
_LONGEST = 0.3  # of ln thrust and ln mass in one step
_SMALL = 1e-8  # ship lengths or degrees: found

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class Wish(NamedTuple):
    """Two equations `rows @ (QUANTITIES, ln thrust, ln mass) = level`."""

    rows: np.ndarray  # (2, quantities + 2)
    level: np.ndarray  # (2,)


class Found(NamedTuple):
    """Answers to wishes."""

    thrust: Float[np.ndarray, "wish"]  # N
    mass: Float[np.ndarray, "wish"]  # kg
    residual: Float[np.ndarray, "wish"]  # in the unit of the worse equation
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


def solve(vessel: Vessel, wishes: list[Wish], known: np.ndarray | None = None) -> Found:
    """The thrust and mass of each wish, from the nearest of some `known` designs (ln N, ln kg)."""
    if known is None:
        known = np.log([START])
    return search(lambda x: with_slopes(vessel, x), wishes, known)


def search(evaluate: Evaluate, wishes: list[Wish], known: Float[np.ndarray, "design 2"]) -> Found:
    """Roots of all wishes by Newton's method with halved steps; `evaluate` as `with_slopes`."""
    value = np.concatenate([evaluate(known)[0], known], axis=-1)
    starts = [np.argmin(size(value @ wish.rows.T - wish.level)) for wish in wishes]
    rows = np.stack([wish.rows for wish in wishes])
    level = np.stack([wish.level for wish in wishes])
    x = known[starts]
    missing, slope = equations(evaluate, x, rows, level)
    steps, share = np.zeros(len(wishes), int), np.ones(len(wishes))
    for _ in range(_MOST_STEPS):
        open_ = size(missing) > _SMALL
        if not open_.any():
            break
        newton = -np.einsum("wij,wj->wi", np.linalg.pinv(slope), missing)
        reach = np.maximum(1.0, np.abs(newton).max(axis=-1, keepdims=True) / _LONGEST)
        trial = np.where(open_[:, None], x + share[:, None] * newton / reach, x)
        after, there = missing.copy(), slope.copy()
        after[open_], there[open_] = equations(evaluate, trial[open_], rows[open_], level[open_])
        better = open_ & (size(after) < size(missing))
        x = np.where(better[:, None], trial, x)
        missing = np.where(better[:, None], after, missing)
        slope = np.where(better[:, None, None], there, slope)
        share = np.where(better, 1.0, 0.5 * share)
        steps += open_
    residual = size(missing)
    return Found(np.exp(x[:, 0]), np.exp(x[:, 1]), residual, steps, residual <= _SMALL)


def equations(
    evaluate: Evaluate, x: np.ndarray, rows: np.ndarray, level: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What is missing to each wish, and its derivatives by x."""
    value, slope = evaluate(x)
    whole = np.concatenate([value, x], axis=-1)
    slopes = np.concatenate([slope, np.tile(np.eye(2), (len(x), 1, 1))], axis=1)
    missing = np.einsum("wij,wj->wi", rows, whole) - level
    return missing, np.einsum("wij,wjk->wik", rows, slopes)


def size(missing: Float[np.ndarray, "wish 2"]) -> Float[np.ndarray, "wish"]:
    """The larger of the two misses; infinite where a trial does not have the number."""
    return np.nan_to_num(np.abs(missing).max(axis=-1), nan=np.inf)
