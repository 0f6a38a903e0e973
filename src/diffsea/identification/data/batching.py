"""Runs of a dataset side by side, so that a filter takes one step along several of them at once.

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


# What a step costs against one of a single lane, measured with sixteen directions of
# differentiation: those are what a single lane fills the vector units with.
SEVERAL, EACH = 2.3, 0.1
MOST = 8
STEPS = 64  # lanes are padded to a multiple of so many steps, so that programs are shared


class BatchLayout(eqx.Module):
    """Which row of a dataset each lane holds at each step, and where each row is found."""

    rows: Int[Array, "step lane"]
    place: Int[Array, "row"]  # in the flattened steps and lanes

    @property
    def shape(self) -> tuple[int, int]:
        """Steps and lanes."""
        return self.rows.shape[0], self.rows.shape[1]


def batch_layout(
    run: Int[np.ndarray, "row"], rows: int, least: tuple[int, int] = (0, 0)
) -> BatchLayout:
    """Distribute runs over lanes, the longest first and each to the shortest lane so far.

    Arguments:
        run: the run of every row that is used; the rows of a run follow one another.
        rows: of the dataset; those beyond the used ones, at least one, are empty.
        least: at least so many steps and lanes.
    """
    first, length = np.unique(run, return_index=True, return_counts=True)[1:]
    count = least[1] or _best_count(length)
    lanes = _distributed(length, count)
    steps = max(least[0], _steps(length, lanes))
    empty = rows - 1
    table = np.full((steps, count), empty)
    # Wherever nothing is, an empty row is found: the last step holds none but those.
    place = np.full(rows, steps * count - 1)
    for number, members in enumerate(lanes):
        held = np.concatenate([first[k] + np.arange(length[k]) for k in members] or [[]])
        held = held.astype(int)
        table[: len(held), number] = held
        place[held] = np.arange(len(held)) * count + number
    return BatchLayout(table, place)


def _best_count(length: np.ndarray) -> int:
    """How many lanes cost least."""

    def cost(count: int) -> float:
        step = 1.0 if count == 1 else SEVERAL + EACH * count
        return _steps(length, _distributed(length, count)) * step

    return min(range(1, min(len(length), MOST) + 1), key=cost)


def _steps(length: np.ndarray, lanes: list[list[int]]) -> int:
    """Steps that the longest lane needs, and at least one more that is empty."""
    longest = max(int(length[members].sum()) for members in lanes) + 1
    return longest + -longest % STEPS


def _distributed(length: np.ndarray, count: int) -> list[list[int]]:
    lanes: list[list[int]] = [[] for _ in range(count)]
    filled = np.zeros(count, int)
    for k in np.argsort(-length, kind="stable"):
        shortest = int(filled.argmin())
        lanes[shortest].append(int(k))
        filled[shortest] += length[k]
    return lanes


def batched_scan(
    body: Callable[[Any, Any], tuple[Any, Any]], start: Any, inputs: Any, lanes: BatchLayout
) -> Any:
    """As `jax.lax.scan` along all rows, every lane from `start`; what `body` gives for each row.

    `body` must begin anew where a run starts.
    """
    steps, count = lanes.shape
    every = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), start)
    side_by_side = jax.tree.map(lambda leaf: leaf[lanes.rows], inputs)
    found = jax.lax.scan(jax.vmap(body), every, side_by_side)[1]
    return jax.tree.map(
        lambda leaf: leaf.reshape(steps * count, *leaf.shape[2:])[lanes.place], found
    )
