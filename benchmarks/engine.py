"""Zig-zags of many boats, and of one, beside C and beside JAX written for that boat alone.

python -m benchmarks.engine            # a part of `python -m benchmarks.run engine`
python -m benchmarks.engine float      # in 32 bits, which a process of its own is for
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable

from benchmarks import boats, peers
from benchmarks.boats import AGREEMENT, BATCH, agree
from benchmarks.record import UNIT, Figure, in_turns, seconds
from benchmarks.reference.c_boats import CBoats

import numpy as np


AGREEMENTS = {"double": AGREEMENT, "float": 1e-3}  # of library and C


def measure() -> list[Figure]:
    """Both precisions and ways of switching, peers, one vessel, and compiling."""
    import diffsea

    diffsea.prepare_jax()
    narrow = subprocess.run(
        [sys.executable, "-m", "benchmarks.engine", "float"],
        env=os.environ | {"JAX_ENABLE_X64": "0", "DIFFSEA_SETUP": "off", **_flags()},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    figures = [Figure(**one) for one in json.loads(narrow.stdout.splitlines()[-1])]
    wide = [batch(*one) for one in batches("double")]
    return [*wide, *figures, *peers.measure(), *one_vessel(), core_peak()]


def batches(kind: str) -> list[tuple[str, str, bool]]:
    """Name, kind of number and way of switching of the figures in one precision."""
    name = {"double": "engine-float64", "float": "engine-float32"}[kind]
    return [(name, kind, True), (f"{name}-flip", kind, False)]


def core_peak() -> Figure:
    """Multiplications and additions that one core does at most, in a loop without waits."""
    reference = CBoats()
    spent = [(reference.peak(), seconds(reference.peak)) for _ in range(5)]
    return Figure("core-peak", "operations/s", [done / time for done, time in spent])


def _flags() -> dict[str, str]:
    from diffsea.runtime import XLA_FLAGS

    return {"XLA_FLAGS": XLA_FLAGS}


def batch(name: str, kind: str, located: bool = True) -> Figure:
    """A batch in blocks of lanes by every core, in numbers of C's `double` or `float`.

    Raises:
        AssertionError: library and C do not agree.
    """
    from benchmarks.lanes import in_blocks, sampled_zigzag_ends, zigzag_ends

    rows, reference = boats.draw(BATCH), CBoats(kind)
    ours = in_blocks(zigzag_ends() if located else sampled_zigzag_ends(), rows)
    told = reference.run(rows, located)
    ends = told.final[:6], told.switches
    difference = boats.located_difference if located else boats.sampled_difference
    agree("C", difference(ours(), ends), AGREEMENTS[kind])
    mine, c = in_turns(ours, lambda: reference.run(rows, located))
    steps = BATCH * boats.STEPS
    against = f"C, {kind}, every core" + ("" if located else ", flip at the sample")
    return Figure(name, UNIT, [steps / s for s in mine], [steps / s for s in c], against)


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
    agree("JAX by hand", float(np.nanmax(np.abs(a - b))))
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
        print(json.dumps([vars(batch(*one)) for one in batches("float")]))
    else:
        from benchmarks.record import keep

        keep(measure())
