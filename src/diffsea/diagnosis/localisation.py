"""Where the mismatch is: score tests on unnamed forces in windows of time and regimes.

An unnamed acceleration is added during the rows of a bin, in each degree of freedom, and
tested against the nuisances like any candidate. Bins are windows of each run, and classes
of drift, yaw rate, speed, heading and throttle over all runs.
"""

from typing import NamedTuple

import numpy as np

from diffsea.diagnosis.jacobians import Columns, push_columns
from diffsea.identification.estimates import Estimate
from diffsea.identification.filter.kalman import Gains
from diffsea.identification.problem import Problem


DEGREES = ("surge", "sway", "yaw")
WINDOWS = 8  # of each run
CLASSES = 4  # of each regime


class Bin(NamedTuple):
    """What an unnamed force is tested in."""

    degree: int
    run: int | None  # None: all runs
    start: float  # s, on the run's clock; NaN for a regime
    end: float
    regime: str


class Cell(NamedTuple):
    """One test: an unnamed force in one degree of freedom during one bin."""

    bin: Bin
    force: float  # N or N m, one-step estimate
    std: float
    p_value: float

    @property
    def z(self) -> float:
        """The estimate in standard errors."""
        return self.force / self.std


Label = tuple[int | None, float, float, str]  # run (None: all), start and end (s), regime


class Binning(NamedTuple):
    """Bins of the dataset's rows and what each of them is.

    A bin may have a label for each of several runs: what happens in one run leaves the
    others alone, so that one derivative serves them all.
    """

    members: np.ndarray  # row, bin: whether the row belongs to the bin
    labels: list[list[Label]]


def time_windows(problem: Problem) -> Binning:
    """Windows of equal length in each run."""
    dataset = problem.dataset
    run, t = np.asarray(dataset.run), np.asarray(dataset.run_time)
    real = np.asarray(dataset.known).any(1)
    members = np.zeros((len(run), WINDOWS), bool)
    labels: list[list[Label]] = [[] for _ in range(WINDOWS)]
    for number in range(dataset.runs):
        rows = np.flatnonzero((run == number) & real)
        for k, part in enumerate(np.array_split(rows, WINDOWS)):
            if len(part):
                members[part, k] = True
                labels[k].append((number, float(t[part[0]]), float(t[part[-1]]), ""))
    return Binning(members, labels)


class Classes(NamedTuple):
    """Classes of one quantity of the motion."""

    name: str
    unit: str
    edges: np.ndarray

    @property
    def texts(self) -> list[str]:
        """What each class is, in words."""
        pairs = zip(self.edges[:-1], self.edges[1:], strict=True)
        return [f"{self.name} {low:.3g} to {high:.3g} {self.unit}".strip() for low, high in pairs]

    def members(self, problem: Problem) -> np.ndarray:
        """Whether each row belongs to each class; the outer ones are open."""
        quantity = next(q for q in quantities(problem) if q.name == self.name)
        which = np.searchsorted(self.edges[1:-1], quantity.values, side="right")
        return quantity.rows[:, None] & (which[:, None] == np.arange(len(self.edges) - 1))


class Quantity(NamedTuple):
    """What may make a regime: its values by row, and the rows that have one."""

    name: str
    values: np.ndarray
    unit: str
    rows: np.ndarray


def regime_classes(problem: Problem) -> list[Classes]:
    """Classes of what the vessel was doing, by quartiles of each quantity."""
    out = []
    for quantity in quantities(problem):
        values = quantity.values[quantity.rows]
        if len(values) > 10 * CLASSES and np.ptp(values) > 0:
            edges = np.unique(np.quantile(values, np.linspace(0, 1, CLASSES + 1)))
            out.append(Classes(quantity.name, quantity.unit, edges))
    return out


def regimes(problem: Problem) -> list[Binning]:
    """Bins of all classes over all runs."""
    none = float("nan")
    return [
        Binning(classes.members(problem), [[(None, none, none, text)] for text in classes.texts])
        for classes in regime_classes(problem)
    ]


def regime_within(problem: Problem, window: Bin, among: list[str]) -> str | None:
    """The first of some regimes in which at least half of a time window's rows lie."""
    dataset = problem.dataset
    t, real = np.asarray(dataset.run_time), np.asarray(dataset.known).any(1)
    rows = real & (np.asarray(dataset.run) == window.run) & (window.start <= t) & (t <= window.end)
    share = {
        labels[0][3]: binning.members[rows, k].mean()
        for binning in regimes(problem)
        for k, labels in enumerate(binning.labels)
    }
    return next((regime for regime in among if share[regime] >= 0.5), None)


def quantities(problem: Problem) -> list[Quantity]:
    """Drift angle, yaw rate, speed, heading and the sum of all orders."""
    dataset = problem.dataset
    measured, known = np.asarray(dataset.measured), np.asarray(dataset.known)
    psi, u, v, r = measured[:, 2], measured[:, 3], measured[:, 4], measured[:, 5]
    orders = sum(np.asarray(series) for series in dataset.orders.values())
    drift = np.degrees(np.arctan2(np.abs(v), np.maximum(np.abs(u), 1e-3)))

    def quantity(name: str, values: np.ndarray, unit: str, *needs: int) -> Quantity:
        rows = known.any(1) & np.all(known[:, list(needs)], axis=1)
        return Quantity(name, values, unit, rows)

    return [
        quantity("drift angle", drift, "deg", 3, 4),
        quantity("yaw rate", np.degrees(r), "deg/s", 5),
        quantity("speed", u, "m/s", 3),
        quantity("heading", np.degrees(np.mod(psi, 2 * np.pi)), "deg", 2),
        quantity("total order", orders, ""),
    ]


def bin_columns(problem: Problem, gains: Gains, fitted: Estimate) -> tuple[list[Bin], Columns]:
    """Every bin in every degree of freedom, with its column."""
    binnings = [time_windows(problem), *regimes(problem)]
    members = np.concatenate([binning.members for binning in binnings], axis=1)
    labels = [labels for binning in binnings for labels in binning.labels]
    push = (members.T[:, None, :, None] * np.eye(3)[:, None, :]).reshape(-1, len(members), 3)
    J = push_columns(problem, gains, fitted, push)
    spare = np.full(problem.layout.size, -1)
    run = np.concatenate([np.repeat(np.asarray(problem.dataset.run), 6), spare])
    bins, columns = [], []
    for number, several in enumerate(labels):
        for label in several:
            for degree in range(3):
                column = J[:, 3 * number + degree]
                columns.append(column if label[0] is None else column * (run == label[0]))
                bins.append(Bin(degree, *label))
    return bins, np.stack(columns, axis=1)


def cells(
    problem: Problem, bins: list[Bin], step: np.ndarray, std: np.ndarray, p_value: np.ndarray
) -> tuple[Cell, ...]:
    """Tests of bins in newtons and newton metres, those without information left out."""
    mass = np.diag(np.asarray(problem.base.mass_matrix()))
    return tuple(
        Cell(b, float(a * mass[b.degree]), float(s * mass[b.degree]), float(p))
        for b, a, s, p in zip(bins, step, std, p_value, strict=True)
        if np.isfinite(s)
    )
