"""Gymnasium's boats that are to reach a point: a thousand at once, and one alone."""

from typing import Any

from benchmarks import boats
from benchmarks.record import Figure, in_turns

import numpy as np


NUMBER = 1024
STEPS = 200  # of all boats, between two looks at the clock: two episodes, starts included
UNIT = "boat-steps/s"


def measure() -> list[Figure]:
    """Steps of `BoatVectorEnv` with actions drawn at random, beside those of `BoatEnv`.

    Raises:
        AssertionError: numbers have not 64 bits.
    """
    from diffsea.envs import BoatEnv, BoatVectorEnv
    from diffsea.vessel.files import build

    vessel = build(boats.document())
    many, one = BoatVectorEnv(vessel, NUMBER), BoatEnv(vessel)
    many.reset(seed=0)
    one.reset(seed=0)
    assert np.asarray(many._boats.motion.state.x).dtype == np.float64
    ours, alone = in_turns(lambda: _steps(many), lambda: _steps(one))
    rates = [NUMBER * STEPS / seconds for seconds in ours]
    reference = [STEPS / seconds for seconds in alone]
    task = {"seconds_per_step": many._boats.interval, "integration_steps": many._boats.steps}
    return [Figure(f"env-{NUMBER}", UNIT, rates, reference, "one boat, BoatEnv", task)]


def _steps(env: Any) -> None:
    """So many steps with actions drawn at random; a single boat that is done begins anew."""
    rng = np.random.default_rng(0)
    single = getattr(env, "num_envs", None) is None
    for _ in range(STEPS):
        actions = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        _, _, reached, late, _ = env.step(actions)
        if single and (reached or late):
            env.reset()
