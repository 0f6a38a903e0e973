"""How far the published figures bear the derivatives: misfit, trials foretold, yaw inertia."""

from collections.abc import Callable, Mapping

from experiments.harness.reporting import table
from experiments.virtual_sea_trials import marus_fit, marus_vessel
from experiments.virtual_sea_trials import marus_published as published

import jax
import numpy as np

from diffsea.identification.estimates import Estimate
from diffsea.identification.objectives.trial_numbers import TrialNumbers


BLURS = (5.0, 1.5, 1.0)  # factors on the misfits, in turn
# Trials that are kept out together: each alone, and both sides of a kind.
KEPT_OUT: Mapping[str, tuple[str, ...]] = {
    **{run.title: (run.name,) for run in published.RUNS},
    "both circles": ("circle-port", "circle-starboard"),
    "both zig-zags 10/10": ("zigzag-10-port", "zigzag-10-starboard"),
    "both zig-zags 20/20": ("zigzag-20-port", "zigzag-20-starboard"),
}
# What the yaw inertia could hang on: the thrusters' arm, m, and the numbers held.
READINGS: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "as fitted: thrusters 0.5 m off the middle": (0.5, ()),
    "thrusters at half the beam": (published.BEAM / 2, ()),
    "thrusters 1.8 m off the middle": (1.8, ()),
    "yaw inertia of a bar held": (0.5, ("I_z",)),
}


def misfits_by_trial(objective: TrialNumbers, fits: Mapping[str, Estimate]) -> dict[str, dict]:
    """Squared misfits of each trial and of all, in squares of the assigned standard deviations."""
    found = {}
    for name, fitted in fits.items():
        white = objective.misfits_and_jacobian(fitted.coordinates)[0]
        edges = np.cumsum([len(trial.names) for trial in objective.trials])[:-1]
        parts = np.split(np.asarray(white) ** 2, edges)
        by_trial = {run.title: float(part.sum())
                    for run, part in zip(published.RUNS, parts, strict=True)}  # fmt: skip
        found[name] = {
            "trials": by_trial, "all": float(np.sum(white**2)), "numbers": len(white),
            "per_free_number": objective.inflation(fitted),
        }  # fmt: skip
    return found


def foretold(misfit: dict[str, float], uneven: str, say: Callable[[str], None]) -> dict[str, dict]:
    """Fits that have not seen some trials, and what they say of these.

    `uneven` is the effect that tells port from starboard, by name.
    """
    sharp = marus_fit.objective_of(misfit)
    stds = np.concatenate([trial.stds for trial in sharp.trials])
    owners = [run.name for run in published.RUNS for _ in run.numbers]
    names = [name for run in published.RUNS for name in run.numbers]
    given = np.concatenate([trial.values for trial in sharp.trials])
    found = {}
    for title, kept_out in KEPT_OUT.items():
        fitted = _fitted(misfit, (*marus_vessel.FREE, uneven), kept_out)
        told = [
            value for numbers in sharp.numbers(fitted.coordinates) for value in numbers.values()
        ]
        rows = [k for k, owner in enumerate(owners) if owner in kept_out]
        off = np.array(told)[rows] - given[rows]
        found[title] = {
            "rms": float(np.sqrt(np.mean((off / stds[rows]) ** 2))),
            **{
                kind: _largest(off, given[rows], [names[k] for k in rows], kind)
                for kind in marus_fit.CLASSES
            },
        }
        say(f"without {title}: {found[title]['rms']:.1f} standard deviations off")
    return found


def _largest(off: np.ndarray, given: np.ndarray, names: list[str], kind: str) -> float | None:
    """Largest error of one kind of number: deg of overshoots, else shares of the number."""
    rows = [k for k, name in enumerate(names) if published.unit(name) == kind]
    if not rows:
        return None
    if kind == "deg":
        return float(np.degrees(np.abs(off[rows]).max()))
    return float(np.abs(off[rows] / given[rows]).max())


def inertias(misfit: dict[str, float], uneven: str, say: Callable[[str], None]) -> dict[str, dict]:
    """The yaw inertia under each of `READINGS`, and how well the figures are met then."""
    found = {}
    for title, (arm, held) in READINGS.items():
        objective = marus_fit.objective_of(misfit, arm=arm)
        free = tuple(name for name in (*marus_vessel.FREE, uneven) if name not in held)
        fitted = _fitted(misfit, free, (), arm)
        place = [p.name for p in objective.parameters].index("I_z")
        inertia = float(objective.parameters[place].decode(fitted.coordinates[place]))
        square, count = objective.squares(fitted)
        found[title] = {"arm": arm, "I_z": inertia, "misfit": square, "numbers": count,
                        "ratio": inertia / arm}  # fmt: skip
        say(f"{title}: I_z {inertia:.0f} kg m^2, squared misfit {square:.1f}")
    return found


def _fitted(
    misfit: dict[str, float],
    free: tuple[str, ...],
    kept_out: tuple[str, ...],
    arm: float = marus_vessel.ARM,
) -> Estimate:
    """A fit from the rules of thumb, through ever sharper figures."""
    at = None
    for blur in BLURS:
        blurred = {kind: blur * one for kind, one in misfit.items()}
        fitted = marus_fit.objective_of(blurred, kept_out, arm).fit(free, at)
        at = fitted.coordinates
    jax.clear_caches()
    return fitted


def misfit_table(found: dict[str, dict]) -> str:
    """Squared misfits: a row for each trial, then all."""
    names = list(found)
    rows = [(title, *(found[name]["trials"][title] for name in names))
            for title in found[names[0]]["trials"]]  # fmt: skip
    count = found[names[0]]["numbers"]
    rows.append((f"all {count} numbers", *(found[name]["all"] for name in names)))
    rows.append(("for each number left free", *(found[name]["per_free_number"] for name in names)))
    return table(("squared misfit", *names), rows)


def foretold_table(found: dict[str, dict]) -> str:
    """One row for what was kept out."""
    rows = [
        (title, one["rms"], *(None if one[kind] is None else f"{100 * one[kind]:.1f} %"
                              for kind in ("L", "deg/s")),
         None if one["deg"] is None else f"{one['deg']:.2f} deg")
        for title, one in found.items()
    ]  # fmt: skip
    head = ("kept out", "rms in standard deviations", "largest error: lengths", "yaw rate",
            "overshoot")  # fmt: skip
    return table(head, rows)


def inertia_table(found: dict[str, dict]) -> str:
    """One row for each reading."""
    rows = [(title, one["I_z"], one["ratio"], one["misfit"]) for title, one in found.items()]
    return table(("", "I_z, kg m^2", "I_z over arm, kg m", "squared misfit"), rows)
