"""A fit of eight derivatives to six recordings, warm and cold, beside CasADi, scipy, optimistix.

All have the same data, start and common cost (experiments/fit_benchmark) and have to end at the
same optimum. Values are the library's.
"""

import os
import tempfile
from pathlib import Path

from benchmarks.record import Figure
from experiments.fit_benchmark.data import make
from experiments.fit_benchmark.run import asked


FREE, INNOVATIONS = "diffsea free run", "diffsea innovations"
COMPILED, IPOPT = "casadi compiled", "casadi ipopt"
BESIDE = {
    "fit-casadi-ipopt": IPOPT,
    "fit-casadi-single": "casadi ipopt, single shooting",
    "fit-scipy": "scipy compiled, in lanes",
    "fit-optimistix": "optimistix",
}
WARM = {FREE: 3, COMPILED: 3, IPOPT: 3, "scipy compiled, in lanes": 3}  # fits after the first; 1
PROCESSES = 2
# How far above the least cost found: peers minimise it itself. The library's objectives are others,
# so their derivatives are judged with the first states that suit them best; the innovations,
# which allow for gusts, have an optimum of their own nearby.
SAME, SAME_REFINED = 1e-6, {FREE: 1e-4, INNOVATIONS: 1e-2}


def measure() -> list[Figure]:
    """Processor seconds; cold is a new process without a cache of compiled programs.

    Warm is the second fit of a process: what was built, CasADi's C too, is there; what is set up
    for a fit is set up anew.

    Raises:
        AssertionError: a contestant fails or ends elsewhere.
    """
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    contestants = [FREE, INNOVATIONS, COMPILED, *BESIDE.values()]
    told: dict[str, list[dict]] = {name: [] for name in contestants}
    with tempfile.TemporaryDirectory() as folder:
        recordings = Path(folder) / "still.npz"
        make(recordings, 1)
        for _ in range(PROCESSES):
            for name in contestants:
                one = asked(name, recordings, warm=WARM.get(name, 1))
                assert one is not None, f"{name} failed"
                told[name].append(one)
    check_optimum(told)

    def beside(name: str, kind: str, peer: str, ours: str = FREE) -> Figure:
        mine, theirs = ([one[kind] for one in told[who]] for who in (ours, peer))
        return Figure(name, "s", mine, theirs, peer + (", built" if peer == COMPILED else ""))

    return [
        beside("fit-warm", "warm", COMPILED),
        beside("fit-cold", "cold", IPOPT),
        *(beside(name, "warm", peer) for name, peer in BESIDE.items()),
        beside("innovations-warm", "warm", COMPILED, INNOVATIONS),
        beside("innovations-cold", "cold", IPOPT, INNOVATIONS),
    ]


def check_optimum(told: dict[str, list[dict]]) -> None:
    """Raise `AssertionError` where a contestant ended elsewhere than at the common optimum."""
    least = min(one["cost"] for every in told.values() for one in every)
    for name, every in told.items():
        key, tolerance = ("refined", SAME_REFINED[name]) if name in SAME_REFINED else ("cost", SAME)
        over = max(one[key] for one in every) / least - 1
        assert over < tolerance, f"{name} ends {over:.2g} above the least cost"
