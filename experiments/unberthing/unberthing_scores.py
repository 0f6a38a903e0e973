"""What a run is judged by: cross-track errors step by step, and thrusters turned the wrong way."""

import dataclasses

from experiments.unberthing.harbour_ship import PERIOD
from experiments.unberthing.unberthing_loop import Log

import numpy as np


STEPS = (1, 2, 3, 4, 5)
OFF = 2.0  # m from the line from which a push away from it counts
PUSH = 1.5e3  # N, a twentieth of one thruster's 30 kN
LASTING = 5.0  # s in a row


@dataclasses.dataclass(frozen=True)
class Score:
    """One run."""

    worst: dict[int, float]  # largest cross-track error of each step, m, with its sign
    error: np.ndarray  # cross-track error of every period of Step 2 on, m
    wrong_way: float  # s in which the thrusters pushed away from the line, in Steps 1 and 2
    first_wrong: float  # s, when that began; NaN where it never did
    farthest_wrong: float  # m off the line at most while it lasted; NaN where it never did
    wrong_sign: float  # s in which a thruster's coefficient had the wrong sign, in Steps 1 and 2
    finished: bool


def score(log: Log) -> Score:
    """Judge one run (leaves without a batch axis)."""
    step = np.asarray(log.step)
    cross, t = np.asarray(log.cross), np.asarray(log.t)
    worst = {}
    for k in STEPS:
        rows = np.flatnonzero(step == k)
        if len(rows):
            worst[k] = float(cross[rows[np.abs(cross[rows]).argmax()]])
    wrong = wrong_way(log)
    off = float(np.abs(np.asarray(log.Y_d)[wrong]).max()) if wrong.any() else np.nan
    return Score(
        worst, cross[(step >= 2) & (step <= 5)], PERIOD * wrong.sum(),
        float(t[wrong.argmax()]) if wrong.any() else np.nan,
        off, PERIOD * wrong_sign(log).sum(),
        bool(step[-1] > max(STEPS)),
    )  # fmt: skip


def wrong_way(log: Log) -> np.ndarray:
    """Periods in which the thrusters push the ship off the line for at least `LASTING` in a row.

    Away from the line by `OFF` and not closing, and the side force of their orders, both thrusters
    together and at their true effect, points away from the line.
    """
    step, off, force = (np.asarray(x) for x in (log.step, log.Y_d, log.side_force))
    going = np.gradient(off, PERIOD)
    away = (np.abs(off) > OFF) & (off * going > 0) & (off * force > 0) & (np.abs(force) > PUSH)
    return lasting(away & (step <= 2), round(LASTING / PERIOD))


def wrong_sign(log: Log) -> np.ndarray:
    """Periods of Steps 1 and 2 in which the model has a thruster push or turn the other way."""
    rows = np.asarray(log.model)
    bow, stern = rows[:, :, 3], rows[:, :, 4]
    wrong = (bow[:, 0] < 0) | (stern[:, 0] < 0) | (bow[:, 1] < 0) | (stern[:, 1] > 0)
    return wrong & (np.asarray(log.step) <= 2)


def lasting(flags: np.ndarray, least: int) -> np.ndarray:
    """The flags without the runs of them that are shorter than `least`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    kept = np.zeros(len(flags), bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        kept[begin:end] = end - begin >= least
    return kept


def wilson(hits: int, runs: int, z: float = 1.959964) -> tuple[float, float]:
    """Interval of 95 % for a share (Wilson 1927)."""
    p, n = hits / runs, runs
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def bootstrap(values: np.ndarray, share: float = 95.0, draws: int = 2000) -> tuple[float, float]:
    """Interval of 95 % for a percentile over runs, by drawing runs again."""
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(0, len(values), (draws, len(values)))]
    low, high = np.percentile(np.percentile(drawn, share, axis=1), [2.5, 97.5])
    return float(low), float(high)


def pooled(errors: list[np.ndarray], share: float = 95.0, draws: int = 300) -> tuple[float, float]:
    """Interval of 95 % for a percentile of all runs' samples together, by drawing runs again."""
    rng = np.random.default_rng(0)
    thin = [one[::10] for one in errors]  # neighbouring samples say the same
    found = [
        np.percentile(
            np.concatenate([thin[k] for k in rng.integers(0, len(thin), len(thin))]), share
        )
        for _ in range(draws)
    ]
    low, high = np.percentile(found, [2.5, 97.5])
    return float(low), float(high)
