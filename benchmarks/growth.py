"""How time grows with designs of a sweep, runs, duration and rate of a fit, effects of a screening.

Each is made eight times larger or more in steps of two, everything else staying as it is; the
slope of the logarithm of time over that of size is the figure. Programs are compiled before.
Times are processor seconds of all threads: growth of work, whatever else the machine has to do.
Linear algebra has one thread, as in the library's commands: more of them wait in loops.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from benchmarks import boats
from benchmarks.record import HERE, Figure

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits


PICTURE = HERE / "growth.png"
ROUNDS = 5
DESIGNS = (512, 1024, 2048, 4096, 8192)
RUNS, SECONDS, RATES = (2, 4, 8, 16), (60.0, 120.0, 240.0, 480.0), (2.5, 5.0, 10.0, 20.0)
EFFECTS = (4, 8, 16, 32)
MIDDLE = 4, 120.0, 5.0  # runs, s and Hz of a fit where they are not what grows
SCREENED = 1, 120.0, 5.0
MANOEUVRES = ("random-fast", "random-slow")


class Ladder(NamedTuple):
    """One thing that grows, and the work at each of its sizes."""

    name: str
    unit: str
    sizes: tuple[float, ...]
    works: list[Callable[[], object]]


def measure() -> list[Figure]:
    """Exponents, samples of which are those of single rounds, with 95 % intervals; the picture."""
    import diffsea

    diffsea.prepare_jax()
    with threadpool_limits(1, user_api="blas"):
        figures = [figure_of(ladder) for ladder in ladders()]
    draw(figures)
    return figures


def figure_of(ladder: Ladder) -> Figure:
    """The exponent of the medians over the rounds; its interval is that of the straight line."""
    for work in ladder.works:
        work()
    times = [[processor_seconds(work) for work in ladder.works] for _ in range(ROUNDS)]
    middle = [statistics.median(column) for column in zip(*times, strict=True)]
    line, covariance = np.polyfit(np.log(ladder.sizes), np.log(middle), 1, cov=True)
    slope = float(line[0])
    reach = float(stats.t.ppf(0.975, len(middle) - 2) * np.sqrt(covariance[0, 0]))
    singly = [float(np.polyfit(np.log(ladder.sizes), np.log(row), 1)[0]) for row in times]
    return Figure(
        f"growth-{ladder.name}", "exponent", sorted(singly),
        more={
            "value": slope,
            "interval": [slope - reach, slope + reach],
            "points": [[size, s] for size, s in zip(ladder.sizes, middle, strict=True)],
            "points_unit": f"{ladder.unit}, s",
        },
    )  # fmt: skip


def processor_seconds(work: Callable[[], object]) -> float:
    """Of all threads."""
    began = time.process_time()
    work()
    return time.process_time() - began


def ladders() -> Iterator[Ladder]:
    """All of them, each set up when its turn comes."""
    yield Ladder("designs", "designs", DESIGNS, sweeps())
    runs, seconds, rate = MIDDLE
    yield Ladder("runs", "runs", RUNS, [fit(n, seconds, rate) for n in RUNS])
    yield Ladder("duration", "s", SECONDS, [fit(runs, s, rate) for s in SECONDS])
    yield Ladder("rate", "Hz", RATES, [fit(runs, seconds, hz) for hz in RATES])
    yield Ladder("effects", "effects", EFFECTS, screenings())


def sweeps() -> list[Callable[[], object]]:
    """The sweep of the part `sweep`, of more and more designs."""
    from diffsea.simulation.designs import sample
    from diffsea.simulation.planning import plan_trial
    from diffsea.studies.sweep import sweep
    from diffsea.vessel.files import build

    vessel = build(boats.document())
    plan = plan_trial(vessel, "zigzag", boats.ANGLE, boats.CHECK, 1.0, 1.0)
    around = {name: boats.HULL[name] for name in ("mass", "I_z", "X_u", "Y_v", "N_r")}
    ends = {name: (min(0.9 * v, 1.1 * v), max(0.9 * v, 1.1 * v)) for name, v in around.items()}
    every = [sample(ends, count) for count in DESIGNS]
    return [lambda designs=designs: sweep(vessel, plan, designs) for designs in every]


def recordings(runs: int, seconds: float, rate: float) -> list:
    """Runs in random steps of the craft of the part `fit`, with its noise, no gusts."""
    from experiments.fit_benchmark.data import CHANNELS, VESSEL

    from tests.oracle import sensors
    from tests.oracle.make_recordings import perform, perturbed, stream
    from tests.oracle.simulator import load

    from diffsea import Trajectory

    craft, t = perturbed(load(VESSEL), stream(1, "hull")), np.arange(seconds * rate + 1) / rate
    made = []
    for seed in range(runs):
        name = MANOEUVRES[seed % 2]
        sim = perform(craft, name, seed, None, seconds, rate, gusts=0.0)
        seen = sensors.record(sim, t, sensors.suite(), stream(seed, "noise"), wrapped=False)
        x, y, psi, u, v, r = (np.asarray(seen[channel], float) for channel in CHANNELS)
        orders = {side: np.asarray(seen[f"cmd_{side}"], float) for side in ("port", "starboard")}
        run = Trajectory(
            t, x, y, psi, u, v, r,
            commanded=orders, executed={}, extra={}, valid=np.ones(len(t), bool),
        )  # fmt: skip
        made.append(run)
    return made


def fit(runs: int, seconds: float, rate: float) -> Callable[[], object]:
    """The free-run fit of the part `fit`."""
    from experiments.fit_benchmark.data import NAMES, VESSEL

    from diffsea import read_vessel
    from diffsea.identification.objectives.output_error import OutputError
    from diffsea.identification.problem import make_problem

    made = recordings(runs, seconds, rate)
    vessel = read_vessel(VESSEL).vessel
    return lambda: OutputError(make_problem(vessel, made, NAMES)).fit(NAMES)


def screenings() -> list[Callable[[], object]]:
    """The screening of one run by more and more of the catalogue, drawn without returning any."""
    from experiments.fit_benchmark.data import NAMES, VESSEL

    from diffsea import read_vessel
    from diffsea.diagnosis.screening import candidate_effects, screen
    from diffsea.identification.fit import estimate
    from diffsea.identification.problem import make_problem

    made, vessel = recordings(*SCREENED), read_vessel(VESSEL).vessel
    possible = candidate_effects(vessel, made)
    drawn = [possible[k] for k in np.random.default_rng(0).permutation(len(possible))]
    works = []
    for count in EFFECTS:
        effects = tuple(drawn[:count])
        assert len(effects) == count, f"the vessel could have {len(drawn)} effects only"
        problem = make_problem(vessel, made, NAMES, effects)
        fitted = estimate(problem, NAMES)
        works.append(lambda problem=problem, fitted=fitted: screen(problem, fitted))
    return works


def draw(figures: list[Figure]) -> None:
    """Time against size, each in multiples of its smallest, both axes logarithmic."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullLocator

    plt.switch_backend("Agg")
    picture, axes = plt.subplots(figsize=(7.5, 5.5), layout="constrained")
    for figure, mark in zip(figures, "os^Dv", strict=True):
        sizes, times = np.array(figure.more["points"]).T
        low, high = figure.more["interval"]
        unit = figure.more["points_unit"].removesuffix(", s")
        label = (
            f"{figure.name.removeprefix('growth-')}, {sizes[0]:g} to {sizes[-1]:g} {unit}: "
            f"{figure.more['value']:.2f} ({low:.2f} to {high:.2f})"
        )
        axes.loglog(sizes / sizes[0], times / times[0], marker=mark, label=label)
    ticks = [1, 2, 4, 8, 16]
    axes.loglog(ticks, ticks, "k--", linewidth=1, label="in proportion")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_ticks(ticks, [str(tick) for tick in ticks])
        axis.set_minor_locator(NullLocator())
    axes.set(xlabel="size, of the smallest", ylabel="processor time, of the smallest")
    axes.grid(alpha=0.3)
    axes.legend(title="exponent and 95 % interval", fontsize="small")
    picture.savefig(PICTURE, dpi=120)
    plt.close(picture)


if __name__ == "__main__":
    from benchmarks.record import keep

    keep(measure())
