"""The library's zig-zags beside those of numba, diffrax and shipmmg: a part of `engine`.

Values are the library's, with switches located in their steps; references are the peers'.
"""

from collections.abc import Callable

from benchmarks import boats
from benchmarks.boats import BATCH, agree
from benchmarks.record import UNIT, Figure, in_turns

import numpy as np


OF_SHIPMMG = 0.1  # rad: its zig-zag integrates to a thousandth in each step of its own choice
TIMES = 5


def measure() -> list[Figure]:
    """Each peer once it agrees with the library.

    Raises:
        AssertionError: a peer does not agree.
    """
    return [beside_numba(), beside_diffrax(), beside_shipmmg()]


def beside_numba() -> Figure:
    """The batch in numba by every core, which has to locate the same switches."""
    from benchmarks.lanes import in_blocks, zigzag_ends
    from benchmarks.reference import numba_boats

    rows = boats.draw(BATCH)
    ours = in_blocks(zigzag_ends(), rows)
    final, switches = numba_boats.run(rows)
    agree("numba", boats.located_difference(ours(), (final, switches)))
    return batch_figure("engine-numba", ours, lambda: numba_boats.run(rows), "numba, every core")


def beside_diffrax() -> Figure:
    """The batch in diffrax, in the library's blocks and threads; it flips at the sample.

    It has to agree with the library's step where that flips at the sample, too.
    """
    from benchmarks.lanes import in_blocks, sampled_zigzag_ends, zigzag_ends
    from benchmarks.reference import diffrax_boats

    rows = boats.draw(BATCH)
    ours, sampled, theirs = (
        in_blocks(run, rows) for run in (zigzag_ends(), sampled_zigzag_ends(), diffrax_boats.zigzag)
    )
    off = boats.sampled_difference(sampled(), theirs())
    agree("diffrax", off, boats.OF_ANOTHER_LAG)
    against = "diffrax, vmapped, every core, flip at the sample"
    return batch_figure("engine-diffrax", ours, theirs, against)


def beside_shipmmg() -> Figure:
    """One KVLCC2, which is not the boat of the other figures, at the same samples."""
    from benchmarks.reference import shipmmg_tanker

    import jax
    import jax.numpy as jnp

    from diffsea.simulation.control import throttle_for
    from diffsea.simulation.integrate import begin, history_lengths
    from diffsea.simulation.manoeuvres import zigzag
    from diffsea.simulation.switching import run_stages
    from diffsea.types import State, as_inputs
    from diffsea.vessel.files import build

    vessel = build(shipmmg_tanker.document())
    speed, zero = jnp.asarray(shipmmg_tanker.SPEED), jnp.zeros(())
    revolutions = throttle_for(vessel, speed)
    lengths, arrays = history_lengths(vessel, boats.STEP), as_inputs(vessel)

    @jax.jit
    def run(vessel):
        still = State(zero, zero, zero, speed, zero, zero)
        motion = begin(vessel, still, {"propeller": revolutions, "rudder": zero}, lengths)
        stages = zigzag(boats.ANGLE, boats.CHECK, boats.EXECUTES)
        _, rows = run_stages(
            vessel, stages, motion, revolutions, vessel.environment, 0.0, boats.STEP, boats.SECONDS
        )
        return rows.t, rows.state.psi, rows.accepted

    times, psi, accepted = (np.asarray(found) for found in run(arrays))
    ours = lambda: jax.block_until_ready(run(arrays))
    theirs = lambda: shipmmg_tanker.headings(float(revolutions))
    samples = boats.STEP * np.arange(boats.STEPS + 1)
    at_samples = np.interp(samples, np.append(0, times[accepted]), np.append(0, psi[accepted]))
    agree("shipmmg", np.abs(at_samples - theirs()).max(), OF_SHIPMMG)
    mine, other = in_turns(ours, theirs, TIMES)
    speeds = [boats.STEPS / s for s in mine], [boats.STEPS / s for s in other]
    return Figure("engine-shipmmg", UNIT, *speeds, against="shipmmg, one KVLCC2")


def batch_figure(name: str, ours: Callable, theirs: Callable, against: str) -> Figure:
    """Speeds of a batch, taken in turns."""
    mine, other = in_turns(ours, theirs, TIMES)
    steps = BATCH * boats.STEPS
    return Figure(name, UNIT, [steps / s for s in mine], [steps / s for s in other], against)
