# pyright: reportArgumentType=false
"""Real zig-zags: a tanker model in a basin, and one on a windy pond at several speeds.

Every trial is predicted by a metamodel of the others. No two are alike, so that averaging their
overshoots means nothing; a metamodel asks each what it says of any zig-zag.
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
from diffsea.metamodels.ideal_zigzag import Zigzag, overshoots


DATA = data_folder()
RAD = np.pi / 180


@dataclasses.dataclass(frozen=True)
class Real:
    """One real trial from its first execute, on a clock scaled to the reference speed."""

    name: str
    dt: float  # s, at the reference speed
    delta: np.ndarray  # rad
    r: np.ndarray  # rad/s, at the reference speed
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
    return Real(
        Path(run.name).stem, dt, np.interp(clock, t, delta), rates, size, marks[:2],
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


def _table(trials: list[Real]) -> Trials:
    most = max(len(t.r) for t in trials)
    known = np.array([np.arange(most) < len(t.r) for t in trials])
    delta = np.stack([np.pad(t.delta, (0, most - len(t.delta)), "edge") for t in trials])
    r = np.stack([np.pad(t.r, (0, most - len(t.r))) for t in trials])
    return Trials(*(jnp.asarray(a) for a in (trials[0].dt, delta, r, known)))


def left_out(trials: list[Real], rate_limit: float) -> dict:
    """Every trial from a metamodel of the others: fit, and overshoots as the trial was ordered."""
    table = _table(trials)
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
        }
        series[trial.name] = (trial, np.asarray(predicted[0])[: len(trial.r)])
    every = identified(table)
    return {"trials": rows, "metamodel": told(every), "series": series}


def _asked(model, trial: Real, rate_limit: float) -> np.ndarray:
    """Overshoots of a zig-zag like one that was run: its angle, its side, its marks on average."""
    out = _zigzag(model, trial.angle, float(np.mean(np.abs(trial.marks))), trial.side, rate_limit)
    return np.asarray(out)


@jax.jit
def _zigzag(model, angle, heading, side, rate_limit):
    wanted = Zigzag(angle, heading, side, rate_limit, seconds=250.0, step=0.1)
    return overshoots(model, wanted)


def study(say) -> dict:
    """What is there of both sets; a message for what is not."""
    out = {}
    for name, read, rate in (("kvlcc2", kvlcc2, 15.8 * RAD), ("esso_osaka", esso_osaka, 20 * RAD)):
        trials = read()
        if trials:
            out[name] = left_out(trials, rate)
        else:
            say(f"{absent(name)}; left out")
    return out
