"""Where the mismatch is: score tests on unnamed forces in windows of time and regimes.

An unnamed acceleration is added during the rows of a bin, in each degree of freedom, and
tested against the nuisances like any candidate. Bins are windows of each run, and classes
of drift, yaw rate, speed, heading and throttle over all runs.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from diffsea.diagnosis.jacobians import Columns, LinearisedModel
from diffsea.diagnosis.score import Projection
from diffsea.identification.problem import Problem


DEGREES_OF_FREEDOM = ("surge", "sway", "yaw")
FORCE_UNITS = ("N", "N", "N m")  # of each degree of freedom
WINDOWS = 8  # of each run: a change is located to an eighth of it
CLASSES = 4  # of each quantity, its quartiles: each holds enough rows to test
MAJORITY = 0.5  # share of a window's rows that lie in the regime that the window is said to be


class Bin(NamedTuple):
    """A window of one run, or a regime of all runs."""

    run: int | None  # None: all runs
    start: float  # s, on the run's clock; NaN for a regime
    end: float
    regime: str  # in words; empty for a window


class Cell(NamedTuple):
    """The test of an unnamed force in one degree of freedom during one bin."""

    degree: int  # 0 surge, 1 sway, 2 yaw
    bin: Bin
    force: float  # N or N m, one-step estimate
    std: float
    p_value: float

    @property
    def z(self) -> float:
        """The estimate in standard errors."""
        return self.force / self.std


class Binning(NamedTuple):
    """Bins of the rows of a data set.

    A column may hold a bin of each of several runs: what happens in one run leaves the others
    alone, so that one derivative serves them all.
    """

    members: Bool[np.ndarray, "row column"]  # whether the row belongs to the bins of the column
    bins: list[list[Bin]]


def time_windows(problem: Problem) -> Binning:
    """Windows of as many rows in each run."""
    run, t = np.asarray(problem.dataset.run), np.asarray(problem.dataset.run_time)
    recorded = problem.dataset.recorded_rows
    members = np.zeros((len(run), WINDOWS), bool)
    bins: list[list[Bin]] = [[] for _ in range(WINDOWS)]
    for number in range(problem.dataset.runs):
        rows = np.flatnonzero((run == number) & recorded)
        for k, window in enumerate(np.array_split(rows, WINDOWS)):
            if len(window):
                members[window, k] = True
                bins[k].append(Bin(number, float(t[window[0]]), float(t[window[-1]]), ""))
    return Binning(members, bins)


class Quantity(NamedTuple):
    """A quantity of the motion that may make a regime."""

    name: str
    values: Float[np.ndarray, "row"]
    unit: str
    rows: Bool[np.ndarray, "row"]  # that have a value


def motion_quantities(problem: Problem) -> list[Quantity]:
    """Drift angle, yaw rate, speed, heading and the sum of all orders."""
    data = problem.dataset
    measured, known = np.asarray(data.measured), np.asarray(data.known)
    psi, u, v, r = measured[:, 2], measured[:, 3], measured[:, 4], measured[:, 5]
    orders = sum((np.asarray(series) for series in data.orders.values()), np.zeros(len(known)))
    drift = np.degrees(np.arctan2(np.abs(v), np.maximum(np.abs(u), 1e-3)))

    def quantity(name: str, values: np.ndarray, unit: str, *channels: int) -> Quantity:
        return Quantity(name, values, unit, data.recorded_rows & known[:, list(channels)].all(1))

    return [
        quantity("drift angle", drift, "deg", 3, 4),
        quantity("yaw rate", np.degrees(r), "deg/s", 5),
        quantity("speed", u, "m/s", 3),
        quantity("heading", np.degrees(np.mod(psi, 2 * np.pi)), "deg", 2),
        quantity("total order", orders, ""),
    ]


class RegimeClasses(NamedTuple):
    """Classes of one quantity of the motion."""

    name: str
    unit: str
    edges: Float[np.ndarray, "edge"]

    @property
    def texts(self) -> list[str]:
        """What each class is, in words."""
        pairs = zip(self.edges[:-1], self.edges[1:], strict=True)
        return [f"{self.name} {low:.3g} to {high:.3g} {self.unit}".strip() for low, high in pairs]

    def members(self, problem: Problem) -> Bool[np.ndarray, "row class"]:
        """Whether each row belongs to each class; the outer ones are open."""
        quantity = next(q for q in motion_quantities(problem) if q.name == self.name)
        which = np.searchsorted(self.edges[1:-1], quantity.values, side="right")
        return quantity.rows[:, None] & (which[:, None] == np.arange(len(self.edges) - 1))


def regime_classes(problem: Problem) -> list[RegimeClasses]:
    """Classes of what the vessel was doing, by quartiles of each quantity."""
    out = []
    for quantity in motion_quantities(problem):
        values = quantity.values[quantity.rows]
        if len(values) > 10 * CLASSES and np.ptp(values) > 0:
            edges = np.unique(np.quantile(values, np.linspace(0, 1, CLASSES + 1)))
            out.append(RegimeClasses(quantity.name, quantity.unit, edges))
    return out


def regimes(problem: Problem) -> list[Binning]:
    """Bins of all classes over all runs."""
    none = float("nan")
    return [
        Binning(classes.members(problem), [[Bin(None, none, none, text)] for text in classes.texts])
        for classes in regime_classes(problem)
    ]


def regime_within(problem: Problem, window: Bin, among: list[str]) -> str | None:
    """The first of some regimes in which at least half of a time window's rows lie."""
    t, run = np.asarray(problem.dataset.run_time), np.asarray(problem.dataset.run)
    rows = (
        problem.dataset.recorded_rows
        & (run == window.run)
        & (window.start <= t)
        & (t <= window.end)
    )
    share = {
        bins[0].regime: binning.members[rows, k].mean()
        for binning in regimes(problem)
        for k, bins in enumerate(binning.bins)
    }
    return next((regime for regime in among if share[regime] >= MAJORITY), None)


def unit_pulses(
    members: Bool[np.ndarray, "row column"], degree: int
) -> Float[np.ndarray, "column row 3"]:
    """Unit accelerations in one degree of freedom during the rows of each bin."""
    pulses = np.zeros((members.shape[1], len(members), 3))
    pulses[:, :, degree] = members.T
    return pulses


def locate_forces(
    model: LinearisedModel, projection: Projection
) -> tuple[tuple[Cell, ...], Float[np.ndarray, "value cell"]]:
    """Test an unnamed force in every bin and degree of freedom.

    Returns the tests in newtons and newton metres, those without information left out, and the
    efficient columns of all.
    """
    problem = model.problem
    binnings = [time_windows(problem), *regimes(problem)]
    members = np.concatenate([binning.members for binning in binnings], axis=1)
    pulses = np.stack([unit_pulses(members, degree) for degree in range(3)], axis=1)
    J = model.by_pulses(pulses.reshape(-1, len(members), 3))
    run = np.concatenate(
        [np.repeat(np.asarray(problem.dataset.run), 6), np.full(problem.layout.size, -1)]
    )
    places: list[tuple[int, Bin]] = []
    columns: list[np.ndarray] = []
    for number, bins in enumerate(bins for binning in binnings for bins in binning.bins):
        for one in bins:
            for degree in range(3):
                column = J[:, 3 * number + degree]
                columns.append(column if one.run is None else column * (run == one.run))
                places.append((degree, one))
    efficient: Columns = projection.efficient(np.stack(columns, axis=1))
    mass = np.diag(np.asarray(problem.base.mass_matrix()))
    cells = tuple(
        Cell(degree, one, float(a * mass[degree]), float(s * mass[degree]), float(p))
        for (degree, one), a, s, p in zip(places, *projection.test_each(efficient), strict=True)
        if np.isfinite(s)
    )
    return cells, efficient
