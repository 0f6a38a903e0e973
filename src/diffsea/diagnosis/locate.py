"""Where the mismatch is: score tests on unnamed forces in windows of time and regimes.

An unnamed acceleration is added during the rows of a bin, in each degree of freedom, and
tested against the nuisances like any candidate. Bins are windows of each run, and classes
of drift, yaw rate, speed, heading and throttle over all runs.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from diffsea.diagnosis.score import Projection
from diffsea.identification import likelihood
from diffsea.identification.problem import Inputs, Problem, Static


DEGREES = ("surge", "sway", "yaw")
WINDOWS = 8  # of each run
CLASSES = 4  # of each regime
ROOM = 8  # bins the compiled program has room for


class Cell(NamedTuple):
    """One test: an unnamed force in one degree of freedom during one bin."""

    degree: int
    run: int | None  # None: all runs
    start: float  # s, on the run's clock; NaN for a regime
    end: float
    regime: str
    force: float  # N or N m, one-step estimate
    std: float
    p_value: float


Label = tuple[int | None, float, float, str]  # run (None: all), start and end (s), regime


class Binning(NamedTuple):
    """Bins of the tape's rows and what each of them is.

    A bin may have a label for each of several runs: what happens in one run leaves the
    others alone, so that one derivative serves them all.
    """

    members: np.ndarray  # row, bin: whether the row belongs to the bin
    labels: list[list[Label]]


def time_windows(problem: Problem) -> Binning:
    """Windows of equal length in each run."""
    tape = problem.tape
    run, t = np.asarray(tape.run), np.asarray(tape.run_time)
    real = np.asarray(tape.known).any(1)
    members = np.zeros((len(run), WINDOWS), bool)
    labels: list[list[Label]] = [[] for _ in range(WINDOWS)]
    for number in range(tape.runs):
        rows = np.flatnonzero((run == number) & real)
        for k, part in enumerate(np.array_split(rows, WINDOWS)):
            if len(part):
                members[part, k] = True
                labels[k].append((number, float(t[part[0]]), float(t[part[-1]]), ""))
    return Binning(members, labels)


def regimes(problem: Problem) -> list[Binning]:
    """Classes of what the vessel was doing, by quartiles of each quantity."""
    tape = problem.tape
    measured, known = np.asarray(tape.measured), np.asarray(tape.known)
    psi, u, v, r = measured[:, 2], measured[:, 3], measured[:, 4], measured[:, 5]
    orders = sum(np.asarray(series) for series in tape.orders.values())
    degrees = np.degrees
    quantities = [
        ("drift angle", degrees(np.arctan2(np.abs(v), np.maximum(np.abs(u), 1e-3))), "deg", (3, 4)),
        ("yaw rate", degrees(r), "deg/s", (5,)),
        ("speed", u, "m/s", (3,)),
        ("heading", degrees(np.mod(psi, 2 * np.pi)), "deg", (2,)),
        ("total order", orders, "", ()),
    ]
    out = []
    for name, values, unit, needs in quantities:
        rows = known.any(1) & np.all(known[:, list(needs)], axis=1)
        if rows.sum() > 10 * CLASSES and np.ptp(values[rows]) > 0:
            out.append(_classes(name, values, unit, rows))
    return out


def _classes(name: str, values: np.ndarray, unit: str, rows: np.ndarray) -> Binning:
    edges = np.unique(np.quantile(values[rows], np.linspace(0, 1, CLASSES + 1)))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))
    members = rows[:, None] & (which[:, None] == np.arange(len(edges) - 1))
    labels: list[list[Label]] = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        text = f"{name} {low:.3g} to {high:.3g} {unit}".strip()
        labels.append([(None, float("nan"), float("nan"), text)])
    return Binning(members, labels)


@eqx.filter_jit
def _push_jacobian(problem: Inputs, layout: Static, members: Array) -> Array:
    """Derivative of the whitened innovations by the unnamed accelerations."""

    def residual(push: Array) -> Array:
        return likelihood.innovations(
            problem.base, layout.value, problem.tape, problem.gains, problem.fixed, members @ push
        ).ravel()

    return jax.jacfwd(residual)(jnp.zeros((ROOM, 3)))


def locate(
    problem: Problem,
    inputs: Inputs,
    layout: Static,
    projection: Projection,
    binnings: list[Binning],
) -> list[Cell]:
    """Test every bin of every binning in every degree of freedom."""
    members = np.concatenate([binning.members for binning in binnings], axis=1)
    labels = [labels for binning in binnings for labels in binning.labels]
    run = np.repeat(np.asarray(problem.tape.run), 6)[:, None]
    mass = np.diag(np.asarray(problem.base.mass_matrix()))
    cells = []
    for first in range(0, len(labels), ROOM):
        part = members[:, first : first + ROOM]
        spare = np.zeros((len(part), ROOM - part.shape[1]))
        J = _push_jacobian(inputs, layout, jnp.asarray(np.concatenate([part, spare], axis=1)))
        J = np.asarray(J)
        columns, named = [], []
        for k, several in enumerate(labels[first : first + ROOM]):
            for label in several:
                columns.append(J[:, k] if label[0] is None else J[:, k] * (run == label[0]))
                named.append(label)
        cells += _cells(projection, np.concatenate(columns, axis=1), named, mass)
    return cells


def _cells(
    projection: Projection, J: np.ndarray, labels: list[Label], mass: np.ndarray
) -> list[Cell]:
    columns = np.concatenate([J, np.zeros((projection.prior_rows, J.shape[1]))])
    step, std, p_value = (a.reshape(len(labels), 3) for a in projection.singles(columns))
    return [
        Cell(
            degree, *label, float(step[number, degree] * mass[degree]),
            float(std[number, degree] * mass[degree]), float(p_value[number, degree]),
        )
        for number, label in enumerate(labels)
        for degree in range(3)
        if np.isfinite(std[number, degree])
    ]  # fmt: skip
