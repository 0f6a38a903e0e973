"""Where the mismatch is, and a model of what has no name: unnamed forces in windows and regimes.

An unnamed acceleration is added during the rows of a bin, in each degree of freedom, and
tested against the nuisances like any candidate. Bins are windows of each run, and classes
of drift, yaw rate, speed, heading and throttle over all runs.

What no effect explains becomes a force that depends on one of these quantities, constant in each of
its classes. It is estimated beside the model's parameters, so that these keep their values and
their meaning, and judged on held-out runs like everything else.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from diffsea.diagnosis.score import Columns, LinearisedModel, Projection, linearise_model
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Gain, Split, held_out_coordinates
from diffsea.identification.problem import Problem


DEGREES_OF_FREEDOM = ("surge", "sway", "yaw")
FORCE_UNITS = ("N", "N", "N m")  # of each degree of freedom
WINDOWS = 8  # of each run: a change is located to an eighth of it
CLASSES = 4  # of each quantity, its quartiles: each holds enough rows to test
MAJORITY = 0.5  # share of a window's rows that lie in the regime that the window is said to be
HALVES = 100  # random halves of the data on which the choice is repeated: a share within 5 %
BLOCKS = 40  # of consecutive rows, of which halves are drawn
HALVES_SEED = 11
POINTS_OF_A_RUN = 300  # of its latent force, for plots


class Bin(NamedTuple):
    """A window of one run, or a regime of all runs."""

    run: int | None = None  # None: all runs
    start: float = math.nan  # s, on the run's clock; NaN for a regime
    end: float = math.nan
    regime: str = ""  # in words; empty for a window


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
    bins: list[tuple[int, Bin]]  # each with its column, in the order of these


def time_windows(problem: Problem) -> Binning:
    """Windows of as many recorded rows in each run, the k-th of every run in column k."""
    t = np.asarray(problem.dataset.run_time)
    members, bins = np.zeros((len(t), WINDOWS), bool), list[tuple[int, Bin]]()
    for number, rows in enumerate(problem.dataset.rows_of_runs):
        for k, window in enumerate(np.array_split(rows, WINDOWS)):
            if len(window):
                members[window, k] = True
                bins.append((k, Bin(number, float(t[window[0]]), float(t[window[-1]]))))
    return Binning(members, sorted(bins, key=lambda pair: pair[0]))


class Quantity(NamedTuple):
    """A quantity of the motion that may make a regime."""

    unit: str
    values: Float[np.ndarray, "row"]
    rows: Bool[np.ndarray, "row"]  # that have a value


def motion_quantities(problem: Problem) -> dict[str, Quantity]:
    """Drift angle (deg), yaw rate (deg/s), speed ahead (m/s), heading (deg), sum of all orders.

    That is from neutral, and has a unit where all orders are in one.
    """
    data = problem.dataset
    measured, known, recorded = (
        np.asarray(data.measured),
        np.asarray(data.known),
        data.recorded_rows,
    )
    psi, u, v, r = measured[:, 2:].T
    drift = np.degrees(np.arctan2(np.abs(v), np.maximum(np.abs(u), 1e-3)))
    heading = np.degrees(np.mod(psi, 2 * np.pi))
    servos = problem.base.servos
    orders = sum(
        (np.asarray(one) - float(servos[name].neutral or 0) for name, one in data.orders.items()),
        np.zeros(len(known)),
    )
    units = set(problem.base.units.values())
    return {
        "drift angle": Quantity("deg", drift, recorded & known[:, 3] & known[:, 4]),
        "yaw rate": Quantity("deg/s", np.degrees(r), recorded & known[:, 5]),
        "speed": Quantity("m/s", u, recorded & known[:, 3]),
        "heading": Quantity("deg", heading, recorded & known[:, 2]),
        "total order": Quantity(units.pop() if len(units) == 1 else "", orders, recorded),
    }


class RegimeClasses(NamedTuple):
    """Classes of one quantity of the motion, bounded by edges in its unit."""

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
        quantity = motion_quantities(problem)[self.name]
        which = np.searchsorted(self.edges[1:-1], quantity.values, side="right")
        return quantity.rows[:, None] & (which[:, None] == np.arange(len(self.edges) - 1))


def regime_classes(problem: Problem) -> list[RegimeClasses]:
    """Classes of what the vessel was doing, by quartiles of each quantity that varies."""
    out = []
    for name, quantity in motion_quantities(problem).items():
        values = quantity.values[quantity.rows]
        if len(values) > 10 * CLASSES and np.ptp(values) > 0:
            edges = np.unique(np.quantile(values, np.linspace(0, 1, CLASSES + 1)))
            out.append(RegimeClasses(name, quantity.unit, edges))
    return out


def regimes(problem: Problem) -> Binning:
    """Classes of all quantities over all runs, a column each."""
    classes, none = regime_classes(problem), np.zeros((problem.dataset.run.size, 0), bool)
    members = np.concatenate([none, *(one.members(problem) for one in classes)], axis=1)
    texts = [text for one in classes for text in one.texts]
    return Binning(members, [(k, Bin(regime=text)) for k, text in enumerate(texts)])


def regime_within(problem: Problem, window: Bin, among: list[str]) -> str | None:
    """The first of some regimes in which at least half of a time window's rows lie."""
    t, run = np.asarray(problem.dataset.run_time), np.asarray(problem.dataset.run)
    inside = (run == window.run) & (window.start <= t) & (t <= window.end)
    rows = problem.dataset.recorded_rows & inside
    members, bins = regimes(problem)
    share = {one.regime: members[rows, k].mean() for k, one in bins}
    return next((regime for regime in among if share[regime] >= MAJORITY), None)


def unit_pulses(members: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "column 3 row 3"]:
    """Unit accelerations (m/s^2, m/s^2, rad/s^2) in each degree of freedom during a column's rows.

    The second axis says in which degree of freedom it is; in the others each is zero.
    """
    return members.T[:, None, :, None] * np.eye(3)[:, None]


def locate_forces(
    model: LinearisedModel, projection: Projection
) -> tuple[tuple[Cell, ...], Float[np.ndarray, "value cell"]]:
    """Test an unnamed force in every bin and degree of freedom.

    Forces are accelerations times the mass matrix's diagonal, added mass included.

    **Returns:** the tests in N and N m, those without information left out, and the efficient
    columns of all.
    """
    problem = model.problem
    windows, by_regime = time_windows(problem), regimes(problem)
    members = np.concatenate([windows.members, by_regime.members], axis=1)
    bins = [*windows.bins, *((WINDOWS + k, one) for k, one in by_regime.bins)]
    J = model.by_pulses(unit_pulses(members).reshape(-1, len(members), 3))
    run = np.repeat(np.asarray(problem.dataset.run), 6)
    run = np.concatenate([run, np.full(len(J) - len(run), -1)])
    places: list[tuple[int, Bin]] = []
    columns: list[np.ndarray] = []
    for k, one in bins:
        for degree in range(3):
            column = J[:, 3 * k + degree]
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


# -- what is left without a name


@dataclasses.dataclass(frozen=True)
class UnexplainedForce:
    """An unnamed force in one degree of freedom that depends on one quantity."""

    degree: int  # 0 surge, 1 sway, 2 yaw
    classes: RegimeClasses
    force: Float[np.ndarray, "class"]  # N or N m
    std: Float[np.ndarray, "class"]
    inclusion: float  # share of random halves of the data on which the same one is chosen
    gain: Gain  # on held-out data, parameters unmoved


def model_unexplained_force(data: Split, final: Estimate) -> UnexplainedForce | None:
    """The quantity and degree of freedom that explain most of what is left, and a model of it.

    None where no quantity of the motion varies enough to make classes.
    """
    problem = data.train
    model = linearise_model(problem, final)
    projection = model.projection(final.free)
    options = [(classes, degree) for classes in regime_classes(problem) for degree in range(3)]
    if not options:
        return None
    columns = [
        projection.efficient(model.by_pulses(unit_pulses(classes.members(problem))[:, degree]))
        for classes, degree in options
    ]
    best = int(np.argmax([projection.test(E).statistic for E in columns]))
    classes, degree = options[best]
    E = columns[best]
    ratio = projection.test(E).inflation
    # A ridge of one noise-sized step keeps a class without information at nothing.
    inverse = np.linalg.inv(E.T @ E / ratio + 1e-9 * np.trace(E.T @ E) * np.eye(E.shape[1]))
    size = -inverse @ (E.T @ projection.residual) / ratio
    mass = float(np.asarray(problem.base.mass_matrix())[degree, degree])
    return UnexplainedForce(
        degree=degree,
        classes=classes,
        force=size * mass,
        std=np.sqrt(np.diag(inverse)) * mass,
        inclusion=inclusion_share(projection, columns, best),
        gain=_gain_by_force(data, final, classes, degree, size),
    )


def inclusion_share(
    projection: Projection, columns: list[Float[np.ndarray, "value _"]], best: int
) -> float:
    """Share of random halves of the data on which the same option explains most.

    Stability selection (Meinshausen and Buhlmann 2010).
    """
    residual = projection.residual
    data = (residual != 0) & (np.arange(len(residual)) < projection.data_values)
    block = np.where(data, (np.cumsum(data) - 1) * BLOCKS // max(1, data.sum()), BLOCKS)
    rng = np.random.default_rng(HALVES_SEED)
    same = 0
    for _ in range(HALVES):
        half = np.isin(block, rng.permutation(BLOCKS)[: BLOCKS // 2])
        explained = []
        for E in columns:
            part = E[half]
            fitted = np.linalg.lstsq(part, residual[half], rcond=1e-8)[0]
            explained.append(float(residual[half] @ (part @ fitted)))
        same += int(np.argmax(explained) == best)
    return same / HALVES


def _gain_by_force(
    data: Split, final: Estimate, classes: RegimeClasses, degree: int, size: np.ndarray
) -> Gain:
    """How much better held-out innovations get with the unnamed force, to first order."""
    problem = data.test
    coordinates = held_out_coordinates(data, final)
    model = linearise_model(problem, dataclasses.replace(final, coordinates=coordinates))
    residual, _ = model.by_name(final.free)
    change = model.by_pulses(unit_pulses(classes.members(problem))[:, degree]) @ size
    rows = problem.dataset.recorded_rows
    old, new = (
        (white[: 6 * len(rows)] ** 2).reshape(-1, 6).sum(1)
        for white in (residual, residual + change)
    )
    return Gain.of_rows((old - new)[rows])


def latent_acceleration(problem: Problem, fitted: Estimate) -> Float[np.ndarray, "row 3"]:
    """What the filter finds beside the model: lasting gusts and the rest (m/s^2, rad/s^2)."""
    filtered = fitted.filter_run(problem)
    half = np.asarray(filtered.gains.gusts.half)
    return np.asarray(filtered.gust_impulse) / np.maximum(half, 1e-12)


def latent_force(problem: Problem, final: Estimate) -> list[dict[str, np.ndarray]]:
    """The force that the filter finds beside the model, for each run: t (s), X, Y (N), N (N m).

    It is the lasting gusts' acceleration, a first-order Gauss-Markov process, times the mass:
    weather, and whatever else the model does not hold.
    """
    mass = np.diag(np.asarray(problem.base.mass_matrix()))
    force = latent_acceleration(problem, final) * mass
    t, dt = np.asarray(problem.dataset.run_time), np.asarray(problem.dataset.dt)
    out = []
    for rows in problem.dataset.rows_of_runs:
        own = rows[dt[rows] > 0]
        own = own[:: max(1, len(own) // POINTS_OF_A_RUN)]
        out.append({"t": t[own]} | {axis: force[own, k] for k, axis in enumerate("XYN")})
    return out
