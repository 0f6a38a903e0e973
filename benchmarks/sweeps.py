"""A sweep of designs through a whole trial, beside the engine alone on the same boats."""

from benchmarks import boats
from benchmarks.boats import BATCH
from benchmarks.engine import batch
from benchmarks.record import Figure


DESIGNS = BATCH
TIMES = 3


def measure() -> list[Figure]:
    """Accepted steps of approach and manoeuvre, over the steps of `engine-float64`."""
    import diffsea

    diffsea.prepare_jax()
    from diffsea.simulation.designs import sample
    from diffsea.simulation.planning import plan_trial
    from diffsea.studies.sweep import sweep
    from diffsea.vessel.files import build

    vessel = build(boats.document())
    plan = plan_trial(vessel, "zigzag", boats.ANGLE, boats.CHECK, 1.0, 1.0)
    around = {name: boats.HULL[name] for name in ("mass", "I_z", "X_u", "Y_v", "N_r")}
    ends = {name: (min(0.9 * v, 1.1 * v), max(0.9 * v, 1.1 * v)) for name, v in around.items()}
    designs = sample(ends, DESIGNS)
    rates = [sweep(vessel, plan, designs).steps_per_second for _ in range(TIMES)]
    engine = batch("engine", "double").samples[:TIMES]
    return [Figure("sweep", "vessel-steps/s", rates, engine, "the engine alone")]
