"""Zig-zags of many boats, and of one, beside C and beside JAX written for that boat alone.

python -m benchmarks.engine            # a part of `python -m benchmarks.run engine`
python -m benchmarks.engine float      # in 32 bits, which a process of its own is for
"""

import concurrent.futures
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable

from benchmarks import boats
from benchmarks.record import Figure, in_turns, seconds
from benchmarks.reference.c_boats import CBoats

import numpy as np


BATCH, LANES = 4096, 64
AGREEMENT = 1e-5  # rad and s between library and C, which takes a lag's exponential at the nodes
UNIT = "vessel-steps/s"


def measure() -> list[Figure]:
    """Both precisions, one vessel, and compiling."""
    import diffsea

    diffsea.prepare_jax()
    narrow = subprocess.run(
        [sys.executable, "-m", "benchmarks.engine", "float"],
        env=os.environ | {"JAX_ENABLE_X64": "0", "DIFFSEA_SETUP": "off", **_flags()},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    figures = [Figure(**one) for one in json.loads(narrow.stdout.splitlines()[-1])]
    return [batch("engine-float64", "double"), *figures, *one_vessel(), core_peak()]


def core_peak() -> Figure:
    """Multiplications and additions that one core does at most, in a loop without waits."""
    reference = CBoats()
    spent = [(reference.peak(), seconds(reference.peak)) for _ in range(5)]
    return Figure("core-peak", "operations/s", [done / time for done, time in spent])


def _flags() -> dict[str, str]:
    from diffsea.runtime import XLA_FLAGS

    return {"XLA_FLAGS": XLA_FLAGS}


def batch(name: str, kind: str) -> Figure:
    """A batch in blocks of lanes by every core; checked against C.

    Raises:
        AssertionError: library and C do not agree.
    """
    from benchmarks.lanes import zigzags

    import jax
    import jax.numpy as jnp

    rows, reference = boats.draw(BATCH), CBoats(kind)
    run = zigzags()

    def end(row: jax.Array) -> tuple:
        carry = run(row)
        return carry.motion.state, carry.switch_times

    program = jax.jit(jax.vmap(end))
    blocks = jnp.split(jnp.asarray(rows.T), BATCH // LANES)

    def ours() -> list:
        with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(pool.map(lambda block: jax.block_until_ready(program(block)), blocks))

    found, told = ours(), reference.run(rows)
    psi = np.concatenate([np.asarray(state.psi) for state, _ in found])
    off = np.abs(psi - told.final[2]).max()
    if kind == "double":
        switches = np.concatenate([np.asarray(times) for _, times in found])
        assert np.array_equal(np.isfinite(switches), np.isfinite(told.switches))
        off = max(off, np.nanmax(np.abs(switches - told.switches)))
    assert off < (AGREEMENT if kind == "double" else 0.05), f"library and C differ by {off:g}"
    mine, c = in_turns(ours, lambda: reference.run(rows))
    steps = BATCH * boats.STEPS
    return Figure(
        name, UNIT, [steps / s for s in mine], [steps / s for s in c], f"C, {kind}, every core"
    )


def one_vessel() -> list[Figure]:
    """One boat's zig-zag, and compiling it."""
    from benchmarks.lanes import zigzags
    from benchmarks.reference import by_hand

    import jax
    import jax.numpy as jnp

    row, run = jnp.asarray(boats.draw(8)[:, 3]), zigzags()
    jax.config.update("jax_enable_compilation_cache", False)

    def compiled(function: Callable) -> tuple[Callable, float]:
        began = time.perf_counter()
        program = jax.jit(lambda r: function(r)).lower(row).compile()  # traced anew
        return program, time.perf_counter() - began

    mine, other = lambda r: run(r).switch_times, by_hand.switch_times
    times = [(compiled(mine)[1], compiled(other)[1]) for _ in range(3)]
    ours, by_it = ([pair[side] for pair in times] for side in (0, 1))
    compiling = Figure("compile-trial", "s", ours, by_it, "JAX by hand")
    programs = [compiled(one)[0] for one in (mine, other)]
    a, b = (np.asarray(program(row)) for program in programs)
    assert np.nanmax(np.abs(a - b)) < AGREEMENT
    many = 20
    repeated = [lambda p=p: [jax.block_until_ready(p(row)) for _ in range(many)] for p in programs]
    ours, by_it = in_turns(repeated[0], repeated[1])
    steps = many * boats.STEPS
    speed = Figure(
        "one-vessel", UNIT, [steps / s for s in ours], [steps / s for s in by_it], "JAX by hand"
    )
    return [speed, compiling]


if __name__ == "__main__":
    if sys.argv[1:] == ["float"]:
        print(json.dumps([vars(batch("engine-float32", "float"))]))
    else:
        from benchmarks.record import keep

        keep(measure())
