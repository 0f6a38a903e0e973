"""Ideal overshoots from few, disturbed trials: plain averaging against the metamodel.

Averaging has no error of structure, the metamodel none of execution. The corrected average has
neither: every measured overshoot is moved by what the metamodel says its trial differs from the
ideal one.
"""

import functools

from experiments.metamodels.metamodel import ideal_overshoots
from experiments.metamodels.zigzags import GOOD, POOR, RECORDED, Records, ideal, run_trials

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.metamodels.fit import Trials, identify


WINDS = {"calm": (0.0, 2.0), "4 to 6": (4.0, 6.0), "7 to 11": (7.0, 11.0), "12 to 16": (12.0, 16.0)}
CONTROLS = {"good": GOOD, "poor": POOR}
COUNTS = (2, 4, 6, 8, 12, 16)
THINNED = 2  # of the records kept, for these many fits
METHODS = ("average", "average beyond the mark", "metamodel", "corrected average")
FINE = 8  # samples between those of a simulated yaw rate


@functools.partial(jax.jit, static_argnames="together")
def _from_metamodels(sets: dict, dt, together: int):
    """Ideal overshoots by metamodel and by corrected average, each (set, side, overshoot)."""

    def one(chosen: dict):
        fit = identify(Trials(dt, chosen["delta"], chosen["r"], chosen["known"]), steps=15)
        asked = ideal_overshoots(fit.model)
        shown = jax.vmap(as_run, (0, 0, 0, None))(
            fit.predicted, chosen["reversals"], chosen["side"], dt
        )
        port = (chosen["side"] < 0).astype(int)
        corrected = chosen["overshoots"] - shown + asked[port]
        counts = chosen["known"].any(1) & jnp.isfinite(corrected).all(1)
        means = [
            jnp.sum(jnp.where((counts & (port == k))[:, None], corrected, 0.0), 0)
            / jnp.sum(counts & (port == k))
            for k in (0, 1)
        ]
        return asked, jnp.stack(means)

    return jax.lax.map(one, sets, batch_size=together)


def as_run(r, reversals, side, dt):
    """First two overshoots (rad) beyond the reversals of a simulated trial.

    Yaw rates `r` (rad/s) every `dt` s, the two `reversals` in s since the first of them, `side` 1
    where the first execute is to starboard, else -1.
    """
    coarse = dt * jnp.arange(len(r))
    t = dt / FINE * jnp.arange(FINE * (len(r) - 1) + 1)
    rate = jnp.interp(t, coarse, r)
    middle = 0.5 * (rate[1:] + rate[:-1]) * dt / FINE
    psi = jnp.append(0.0, jnp.cumsum(middle))
    ends = jnp.append(reversals[1:], t[-1])
    out = []
    for k in range(2):
        towards = side * (1 - 2 * k) * psi
        within = (t >= reversals[k]) & (t <= ends[k])
        peak = jnp.max(jnp.where(within, towards, -jnp.inf))
        out.append(peak - jnp.interp(reversals[k], t, towards))
    return jnp.stack(out)


def study(seed: int, sets: int, counts=COUNTS, winds=tuple(WINDS)) -> dict:
    """Root-mean-square error (deg) by control, wind, method and number of trials.

    `sets` independent sets of trials each. Bias is the mean error over sets, averaged in
    quadrature over the four overshoots (two of either side).
    """
    truth = np.asarray(ideal().overshoots)
    most = max(counts)
    errors: dict = {}
    for number, control in enumerate(CONTROLS):
        for wind in winds:
            offset = 100 * number + list(WINDS).index(wind)
            batch = run_trials(seed + offset, most * sets, WINDS[wind], CONTROLS[control])
            errors.setdefault(control, {})[wind] = _errors(batch, truth, sets, counts)
    return {"counts": list(counts), "sets": sets, "errors": errors,
            "crossover": _crossovers(errors, counts)}  # fmt: skip


def _errors(batch: Records, truth: np.ndarray, sets: int, counts) -> dict:
    most = max(counts)

    def grouped(values):
        return np.asarray(values).reshape(sets, most, *np.shape(values)[1:])

    estimates = {m: [] for m in METHODS}
    actual, beyond = grouped(batch.overshoots), grouped(batch.deviations)
    for count in counts:
        for name, values in (("average", actual), ("average beyond the mark", beyond)):
            means = [np.nanmean(values[:, side:count:2], axis=1) for side in (0, 1)]
            estimates[name].append(np.stack(means, axis=1))
    table = {
        "delta": grouped(batch.delta)[:, :, ::THINNED], "r": grouped(batch.r)[:, :, ::THINNED],
        "side": grouped(batch.side), "reversals": grouped(batch.reversals), "overshoots": actual,
    }  # fmt: skip
    for count in counts:
        known = np.arange(most)[None, :, None] < count
        table["known"] = np.broadcast_to(known, table["r"].shape)
        found = _from_metamodels(table, RECORDED * THINNED, min(sets, 10))
        for name, values in zip(METHODS[2:], found, strict=True):
            estimates[name].append(np.asarray(values))
    return {name: _scores(values, truth) for name, values in estimates.items()}


def _scores(estimates: list, truth: np.ndarray) -> dict:
    off = np.degrees(np.stack(estimates) - truth)  # count, set, side, overshoot
    return {
        "rms": np.sqrt(np.nanmean(off**2, axis=(1, 2, 3))).tolist(),
        "bias": np.sqrt(np.nanmean(np.nanmean(off, axis=1) ** 2, axis=(1, 2))).tolist(),
        "missing": int(np.isnan(off).sum()),
    }


def _crossovers(errors: dict, counts) -> dict:
    """The largest number of trials at which the metamodel is still the better, by case."""
    out: dict = {}
    for control, winds in errors.items():
        for wind, methods in winds.items():
            better = {
                rival: [n for n, a, m in zip(counts, methods[rival]["rms"],
                                             methods["metamodel"]["rms"], strict=True) if m < a]
                for rival in (*METHODS[:2], METHODS[3])
            }  # fmt: skip
            out[f"{control} control, wind {wind}"] = {
                rival: max(numbers, default=0) for rival, numbers in better.items()
            }
    return out
