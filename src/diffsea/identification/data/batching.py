# pyright: reportArgumentType=false
# A data set is of NumPy where it is made, of JAX within programs.
"""Runs of a data set side by side, so that a filter takes one step along several of them at once.

Runs share nothing but parameters. One step of a compiled loop costs nearly as much for two runs
as for eight, which a core's vector units take together.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int


# What a step costs against one of a single batch, measured with sixteen directions of
# differentiation: those are what a single batch fills the vector units with.
SEVERAL_COST, EACH_COST = 2.3, 0.1
MOST_BATCHES = 8  # of a core's vector unit in 64-bit numbers
STEP_MULTIPLE = 64  # batches are padded to a multiple of so many steps: programs are shared


class BatchLayout(eqx.Module):
    """Which row of a data set each batch holds at each step, and where each row is found."""

    rows: Int[Array, "step batch"]
    place: Int[Array, "row"]  # in the flattened steps and batches

    @property
    def shape(self) -> tuple[int, int]:
        """Steps and batches."""
        return self.rows.shape[0], self.rows.shape[1]


def batch_layout(
    run: Int[np.ndarray, "row"], rows: int, least: tuple[int, int] = (0, 0)
) -> BatchLayout:
    """Distribute runs over batches, the longest first and each to the shortest batch so far.

    Arguments:
        run: the run of every row that is used; the rows of a run follow one another.
        rows: of the dataset; those beyond the used ones, at least one, are empty.
        least: at least so many steps and batches.
    """
    first, length = np.unique(run, return_index=True, return_counts=True)[1:]

    def cost(count: int) -> float:
        step = 1.0 if count == 1 else SEVERAL_COST + EACH_COST * count
        return _steps_needed(length, _distribute_runs(length, count)) * step

    count = least[1] or min(range(1, min(len(length), MOST_BATCHES) + 1), key=cost)
    batches = _distribute_runs(length, count)
    steps = max(least[0], _steps_needed(length, batches))
    empty = rows - 1
    table = np.full((steps, count), empty)
    # Wherever nothing is, an empty row is found: the last step holds none but those.
    place = np.full(rows, steps * count - 1)
    for number, members in enumerate(batches):
        held = np.concatenate([first[k] + np.arange(length[k]) for k in members] or [[]])
        held = held.astype(int)
        table[: len(held), number] = held
        place[held] = np.arange(len(held)) * count + number
    return BatchLayout(table, place)


def _steps_needed(length: np.ndarray, batches: list[list[int]]) -> int:
    """Steps that the longest batch needs, and at least one more that is empty."""
    longest = max(int(length[members].sum()) for members in batches) + 1
    return longest + -longest % STEP_MULTIPLE


def _distribute_runs(length: np.ndarray, count: int) -> list[list[int]]:
    batches: list[list[int]] = [[] for _ in range(count)]
    filled = np.zeros(count, int)
    for k in np.argsort(-length, kind="stable"):
        shortest = int(filled.argmin())
        batches[shortest].append(int(k))
        filled[shortest] += length[k]
    return batches


def batched_scan(
    body: Callable[[Any, Any], tuple[Any, Any]], start: Any, inputs: Any, batches: BatchLayout
) -> Any:
    """As `jax.lax.scan` along all rows, every batch from `start`; what `body` gives for each row.

    `body` must begin anew where a run starts.
    """
    steps, count = batches.shape
    every = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), start)
    side_by_side = jax.tree.map(lambda leaf: leaf[batches.rows], inputs)
    found = jax.lax.scan(jax.vmap(body), every, side_by_side)[1]
    return jax.tree.map(
        lambda leaf: leaf.reshape(steps * count, *leaf.shape[2:])[batches.place], found
    )
