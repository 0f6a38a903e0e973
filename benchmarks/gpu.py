"""The engine's zig-zags on a GPU, the same program, beside what its memory and arithmetic allow.

    python -m benchmarks.run gpu         # elsewhere than on a GPU: nothing is measured
    python -m benchmarks.gpu double      # one precision, which a process of its own is for

All boats are lanes of one call, for a GPU has no cache to fit blocks into. The reference is the
speed at which the card could move what a step at a time has to, or do its operations, whichever is
the less; both of its peaks are measured in turns with ours.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import boats
from benchmarks.record import UNIT, Figure, in_turns, seconds

import numpy as np


BATCHES = {"1e5": 100_000, "1e6": 1_000_000}
CHECKED = 4096  # boats that are compared with C
KINDS = {"double": "engine-gpu-float64", "float": "engine-gpu-float32"}
AGREEMENTS = {"double": boats.AGREEMENT, "float": 1e-3}
TIMES = 5
# Numbers that a step reads or writes: state and thrusts both ways, parameters and the side once.
MOVED = 2 * 8 + len(boats.PARAMETERS) + 1
# Of one boat in boat.c: four rates of 92, of which 59 are a sine and a cosine; then nodes, means,
# the lag and the orders.
OPERATIONS = 4 * 92 + 94
CHAIN = 1024  # multiplications and additions on each number that is loaded, for the peak


def measure() -> list[Figure]:
    """Both precisions and sizes; none, said on the way, where there is no GPU."""
    found = []
    for kind in KINDS:
        environment = os.environ | {
            "JAX_ENABLE_X64": str(int(kind == "double")), "DIFFSEA_SETUP": "off",
        }  # fmt: skip
        child = subprocess.run(
            [sys.executable, "-m", "benchmarks.gpu", kind],
            env=environment, stdout=subprocess.PIPE, text=True, check=True,
        )  # fmt: skip
        found += json.loads(child.stdout.splitlines()[-1])
    return [Figure(**one) for one in found]


def figures(kind: str) -> list[Figure]:
    """What one precision gives here."""
    import jax

    try:
        card = jax.devices("gpu")[0]
    except RuntimeError:
        print("  not measured: JAX finds no GPU", file=sys.stderr)
        return []
    more = {"device": f"{card.device_kind}, jax {jax.__version__}"}
    check_agreement(kind)
    return [batch(f"{KINDS[kind]}-{size}", count, more) for size, count in BATCHES.items()]


def check_agreement(kind: str) -> None:
    """Raise `AssertionError` where the first boats do not end as C's."""
    from benchmarks.reference.c_boats import CBoats

    rows = boats.draw(CHECKED)
    told = CBoats(kind).run(rows)
    difference = boats.located_difference(at_once(rows)(), (told.final[:6], told.switches))
    boats.agree("C", difference, AGREEMENTS[kind])
    print(f"  {kind}: {CHECKED} boats end as C's to {difference:.2g}", file=sys.stderr)


def at_once(rows: boats.Rows) -> Callable[[], boats.Ends]:
    """What runs all boats in one call, every switch located."""
    from benchmarks.lanes import zigzag_ends

    import jax

    program, inputs = jax.jit(jax.vmap(zigzag_ends())), jax.device_put(rows.T)

    def run() -> boats.Ends:
        last, times = jax.block_until_ready(program(inputs))
        return np.asarray(last).T, np.asarray(times)

    return run


def batch(name: str, count: int, more: dict[str, Any]) -> Figure:
    """So many boats, beside the card's bound on a step at a time."""
    size, bounds = np.dtype(float if "64" in name else np.float32).itemsize, []

    def measure_bounds() -> None:
        bounds.append((bandwidth() / (MOVED * size), arithmetic() / OPERATIONS))

    mine, _ = in_turns(at_once(boats.draw(count)), measure_bounds, TIMES)
    steps, (_, *bounds) = count * boats.STEPS, bounds
    middle = np.median(bounds, axis=0)
    more = more | {"bound_by_memory": middle[0], "bound_by_arithmetic": middle[1]}
    against = f"the card's {('memory', 'arithmetic')[int(middle.argmin())]}, a step at a time"
    least = [min(pair) for pair in bounds]
    return Figure(name, UNIT, [steps / s for s in mine], least, against, more)


def bandwidth() -> float:
    """Bytes per second that a plain addition reads and writes."""
    import jax
    import jax.numpy as jnp

    many = jnp.ones(1 << 27, jnp.float32)
    add = jax.jit(lambda x: x + 1)
    jax.block_until_ready(add(many))
    spent = min(seconds(lambda: jax.block_until_ready(add(many))) for _ in range(5))
    return 2 * many.nbytes / spent


def arithmetic() -> float:
    """Multiplications and additions per second that the card does in this precision."""
    import jax
    import jax.numpy as jnp

    def chain(x: jax.Array) -> jax.Array:
        for _ in range(CHAIN // 2):
            x = x * 0.999 + 0.5
        return x

    many, program = jnp.ones(1 << 24), jax.jit(chain)
    jax.block_until_ready(program(many))
    spent = min(seconds(lambda: jax.block_until_ready(program(many))) for _ in range(5))
    return CHAIN * many.size / spent


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    print(json.dumps([vars(figure) for figure in figures(sys.argv[1])]))
