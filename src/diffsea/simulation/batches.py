"""Many rows through one compiled program, side by side in batches.

One on every processor core; on a GPU larger ones, of which one is read while the next runs.
"""

import concurrent.futures
import os
import time
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from diffsea.progress import PartialProgress, Progress


Rows = Float[np.ndarray, "design name"]
Tree = TypeVar("Tree")

AT_ONCE = 64  # that run side by side; more of them leave the processor's cache
AT_ONCE_ON_GPU = 4096  # fewer leave it idle
_GPU_MEMORY = 2**31  # bytes, for the steps of a batch; two batches are there at a time
_STEP_BYTES = 256  # of one vessel's step, its numbers and those on the way to them
_PROGRESS_INTERVAL = 2.0  # s between messages of progress


class Batched(NamedTuple, Generic[Tree]):
    """What all rows gave, leaves with the rows first, and how long it took."""

    results: Tree
    timed: slice  # rows that were not run while compiling, unless those are all
    seconds: float  # that the timed rows took


def batch_size(rows: int, steps: int) -> int:
    """How many of so many rows run side by side, each of them of so many steps."""
    most = AT_ONCE
    if not _on_processors():
        fitting = 1 << (_GPU_MEMORY // (_STEP_BYTES * steps)).bit_length() >> 1
        most = min(max(AT_ONCE, fitting), AT_ONCE_ON_GPU)
    return min(most, 1 << (rows - 1).bit_length())


def _on_processors() -> bool:
    return jax.default_backend() == "cpu"


def in_batches(
    run: Callable[[Rows], Tree],
    rows: Rows,
    size: int,
    progress: Progress,
    steps: Callable[[Tree], int],
    threads: int | None = None,
) -> Batched[Tree]:
    """Run a compiled function of `size` rows over all rows; the last batch is filled up.

    Arguments:
        steps: how many vessel-steps a batch was, for its speed.
        threads: batches that run at the same time; one on every core by default. More than one
            must not call LAPACK: jaxlib 0.10's calls then wait for one another for ever.
    """
    batches = [rows[k : k + size] for k in range(0, len(rows), size)]

    def run_batch(batch: Rows) -> tuple[Tree, float]:
        padded = np.pad(batch, ((0, size - len(batch)), (0, 0)), mode="edge")
        began = time.perf_counter()
        found = jax.tree.map(lambda leaf: np.asarray(leaf)[: len(batch)], run(padded))
        return found, time.perf_counter() - began

    first, compiling = run_batch(batches[0])
    results, done, began = [first], 0, time.perf_counter()
    reported = began
    workers = threads or (os.cpu_count() if _on_processors() else 2)
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        for found, _ in pool.map(run_batch, batches[1:]):
            results.append(found)
            done += steps(found)
            if time.perf_counter() - reported > _PROGRESS_INTERVAL:
                reported = time.perf_counter()
                ended = min(len(rows), len(results) * size)
                rate = done / (reported - began)
                message = f"{ended} of {len(rows)} designs, {rate:.2g} vessel-steps/s"
                progress(PartialProgress(message, ended / len(rows)))
    seconds = time.perf_counter() - began
    whole = jax.tree.map(lambda *parts: np.concatenate(parts), *results)
    if len(batches) == 1:
        return Batched(whole, slice(0, len(rows)), compiling)
    return Batched(whole, slice(size, len(rows)), seconds)
