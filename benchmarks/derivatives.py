"""The Jacobian of eight numbers by thirteen parameters through located switching, both modes."""

from benchmarks import boats
from benchmarks.record import Figure, in_turns

import numpy as np


NUMBERS = 8  # times of switches
MANY = 10  # per sample


def measure() -> list[Figure]:
    """Forward and reverse, beside JAX written for this boat alone; the results are compared."""
    import diffsea

    diffsea.prepare_jax()
    from benchmarks.lanes import zigzags
    from benchmarks.reference import by_hand

    import jax
    import jax.numpy as jnp

    row, run = jnp.asarray(boats.draw(8)[:, 3]), zigzags()
    ours, by_it = (
        lambda r: run(r).switch_times[:NUMBERS],
        lambda r: by_hand.switch_times(r)[:NUMBERS],
    )
    figures = []
    for name, derivative in (
        ("jacobian", jax.jacfwd),
        ("reverse", lambda f: jax.grad(lambda r: f(r)[NUMBERS - 1])),
    ):
        programs = [jax.jit(derivative(function)) for function in (ours, by_it)]
        found = [np.asarray(program(row)) for program in programs]
        np.testing.assert_allclose(*found, rtol=1e-4, atol=1e-7)
        repeated = [
            lambda p=p: [jax.block_until_ready(p(row)) for _ in range(MANY)] for p in programs
        ]
        mine, other = in_turns(repeated[0], repeated[1])
        samples = [s / MANY for s in mine], [s / MANY for s in other]
        figures.append(Figure(name, "s", samples[0], samples[1], "JAX by hand"))
    return figures
