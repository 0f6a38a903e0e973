# pyright: reportArgumentType=false
"""Real zig-zags: a tanker model in a basin, and one on a windy pond at several speeds.

Every trial is predicted by a metamodel of the others, whatever their angles are. The few that
repeat one another are compared with averaging in `repeated`.
"""

import dataclasses
from pathlib import Path

from experiments.check_data import absent, data_folder
from experiments.harness.reporting import ROOT
from experiments.metamodels.metamodel import cross_validated, identified, told

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from diffsea import Trajectory, read_mapping, read_recording
from diffsea.metamodels.fit import Trials
from diffsea.metamodels.ideal_zigzag import IdealRun, Zigzag, ideal_zigzag
from diffsea.metamodels.norrbin import Norrbin
from diffsea.metrics.repeats import fit_percent


DATA = data_folder()
RAD = np.pi / 180
# Rate (rad/s) of a rudder of which orders were recorded: the metamodel, identified under orders,
# answers for the steering gear as well.
AT_ONCE = 1e3


@dataclasses.dataclass(frozen=True)
class Real:
    """One real trial from its first execute, on a clock scaled to the reference speed."""

    name: str
    dt: float  # s, at the reference speed
    delta: np.ndarray  # rad
    r: np.ndarray  # rad/s, at the reference speed
    psi: np.ndarray  # rad, off the course of the approach
    executes: np.ndarray  # s, of the orders since the first row, at the reference speed
    angle: float  # rad, of the rudder
    marks: np.ndarray  # rad, headings (towards the first side) at the first two reversals
    overshoots: np.ndarray  # rad, beyond those headings
    side: float
    wind: float | None = None  # m/s
    speed: float = 1.0  # m/s


def _trial(run: Trajectory, channel: str, dt: float, reference: float | None, wind=None) -> Real:
    t, psi = np.asarray(run.t, float), np.unwrap(np.asarray(run.psi, float))
    delta = np.asarray(getattr(run, channel)["rudder"], float)
    size = float(np.quantile(np.abs(delta), 0.9))
    held = np.where(delta > 0.9 * size, 1, np.where(delta < -0.9 * size, -1, 0))
    count = max(3, round(2.0 / float(np.median(np.diff(t)))))
    steady = [
        k for k in range(len(held) - count) if np.all(held[k : k + count] == held[k]) and held[k]
    ]
    first = steady[0]
    side = float(held[first])
    still = np.flatnonzero(side * np.diff(delta[: first + 1]) <= 0)
    changes = _departures(delta, held, steady, size)
    reversals = np.array(changes[:3])
    begin = max(first - round(3.0 / float(np.median(np.diff(t)))), 0)
    # What follows the last order is no trial any more.
    end = changes[3] if len(changes) > 3 else min(steady[-1] + count, len(t) - 1)
    marks = side * (psi[reversals] - psi[begin])
    senses = np.array([1.0, -1.0, 1.0])
    ends = np.append(reversals[1:], end)
    peaks = [
        np.max(s * side * (psi[a : b + 1] - psi[begin]))
        for s, a, b in zip(senses, reversals, ends, strict=False)
    ]
    speed = float(np.nanmean(np.asarray(run.u, float)[begin : end + 1]))
    ratio = 1.0 if reference is None else speed / reference
    clock = np.arange(t[begin], t[end], dt / ratio)
    marks = senses[: len(marks)] * marks
    rates = np.interp(clock, t, np.asarray(run.r, float)) / ratio
    given = np.array([still[-1] + 1 if len(still) else 0, *changes[:3]])
    return Real(
        Path(run.name).stem, dt, np.interp(clock, t, delta), rates,
        np.interp(clock, t, psi - psi[begin]), (t[given] - t[begin]) * ratio, size, marks[:2],
        (np.array(peaks) - marks)[:2], side, wind, speed,
    )  # fmt: skip


def _departures(delta, held, steady, size: float) -> list[int]:
    """Rows in which the rudder leaves for the other side: the last ones near the old angle."""
    out, before = [], steady[0]
    for k in steady:
        if held[k] != held[before]:
            near = np.flatnonzero(held[before] * delta[:k] > 0.9 * size)
            out.append(int(near[-1]))
        before = k
    return out


def kvlcc2() -> list[Real]:
    """The trials of the 7 m tanker model in the basin, no wind."""
    files = sorted((DATA / "kvlcc2_hsva").glob("*.dat"))
    if not files:
        return []
    mapping = read_mapping(ROOT / "experiments" / "kvlcc2_hsva" / "mapping_repaired.toml")
    return [_trial(read_recording(f, mapping), "executed", 0.5, None) for f in files]


def esso_osaka() -> list[Real]:
    """The trials of the 3 m tanker model on the pond, in the wind that was measured there."""
    files = sorted((DATA / "esso_osaka" / "recordings").glob("zigzag*.csv"))
    if not files:
        return []
    mapping = read_mapping(ROOT / "experiments" / "esso_osaka" / "mapping_repaired.toml")
    return [_trial(read_recording(f, mapping), "commanded", 0.5, 0.25, _wind(f)) for f in files]


def _wind(file: Path) -> float:
    table = pd.read_csv(file.parents[1] / "measured_wind" / file.name)
    return float(table["wind_velo_true [m/s]"].mean())


def table_of(trials: list[Real]) -> Trials:
    most = max(len(t.r) for t in trials)
    known = np.array([np.arange(most) < len(t.r) for t in trials])
    delta = np.stack([np.pad(t.delta, (0, most - len(t.delta)), "edge") for t in trials])
    r = np.stack([np.pad(t.r, (0, most - len(t.r))) for t in trials])
    return Trials(*(jnp.asarray(a) for a in (trials[0].dt, delta, r, known)))


def read(say) -> dict[str, tuple[list[Real], float]]:
    """Trials of each set, and how fast the rudder that was recorded turns (rad/s).

    A message for a set that is not there.
    """
    out = {}
    for name, found, rate in (("kvlcc2", kvlcc2, 15.8 * RAD), ("esso_osaka", esso_osaka, AT_ONCE)):
        if trials := found():
            out[name] = trials, rate
        else:
            say(f"{absent(name)}; left out")
    return out


def left_out(trials: list[Real], rate_limit: float) -> dict:
    """Every trial from a metamodel of the others: fit, and overshoots as the trial was ordered."""
    table = table_of(trials)
    rows = {}
    series = {}
    for k, trial in enumerate(trials):
        others = dataclasses.replace(
            table, known=table.known & (np.arange(len(trials)) != k)[:, None]
        )
        fit = identified(others)
        alone = Trials(table.dt, *(a[k][None] for a in (table.delta, table.r, table.known)))
        percent, predicted = cross_validated(fit.model, alone)
        rows[trial.name] = {
            "percent": float(percent[0]),
            "rudder_deg": trial.angle / RAD,
            "measured_deg": (trial.overshoots / RAD).tolist(),
            "predicted_deg": (_asked(fit.model, trial, rate_limit) / RAD).tolist(),
            "wind": trial.wind,
            "speed": trial.speed,
            "a1": float(fit.model.a1),
            "alone": _alone(table, k),
        }
        series[trial.name] = (trial, np.asarray(predicted[0])[: len(trial.r)])
    every = identified(table)
    return {"trials": rows, "metamodel": told(every), "series": series}


def _alone(table: Trials, k: int) -> dict:
    """What a metamodel of one trial alone makes of that trial: as near as the model can come."""
    only = dataclasses.replace(table, known=table.known & (np.arange(len(table.r)) == k)[:, None])
    fit = identified(only)
    return {
        "percent": float(fit_percent(table.r[k], fit.predicted[k], table.known[k])),
        "neutral_deg": float(fit.model.neutral) / RAD,
    }


def _asked(model, trial: Real, rate_limit: float) -> np.ndarray:
    """Overshoots (rad) of a zig-zag like one that was run."""
    return np.asarray(like(model, trial, rate_limit).overshoots)[:2]


def like(model: Norrbin, trial: Real, rate_limit: float) -> IdealRun:
    """The ideal zig-zag with the angle and side of one that was run, and its mean reversal."""
    heading = float(np.mean(np.abs(trial.marks)))
    return _zigzag(model, trial.angle, heading, trial.side, rate_limit)


@jax.jit
def _zigzag(model, angle, heading, side, rate_limit):
    wanted = Zigzag(angle, heading, side, rate_limit, seconds=250.0, step=0.1, executes=5)
    return ideal_zigzag(model, wanted)


def study(sets: dict[str, tuple[list[Real], float]]) -> dict:
    """Every trial of every set from the others of its set."""
    return {name: left_out(trials, rate) for name, (trials, rate) in sets.items()}
