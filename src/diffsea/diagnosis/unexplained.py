"""What is left without a name: the regime where it lives, and a model of it without physics.

The remainder is an unnamed force that depends on one quantity of the motion, constant in each
of its classes. It is estimated beside the model's parameters, so that these keep their values
and their meaning, and judged on held-out runs like everything else.
"""

import dataclasses

import numpy as np

from diffsea.diagnosis.jacobians import columns_at, latent_acceleration, push_columns
from diffsea.diagnosis.localisation import DEGREES, Classes, regime_classes
from diffsea.diagnosis.score import Projection
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Gain, Split, held_out_coordinates
from diffsea.identification.problem import Problem
from diffsea.statistics import block_sums


HALVES = 100  # random halves of the data on which the choice is repeated
BLOCKS = 40
SHOWN = 300  # points of a run's latent force


@dataclasses.dataclass(frozen=True)
class Remainder:
    """An unnamed force in one degree of freedom that depends on one quantity."""

    degree: int
    classes: Classes
    force: np.ndarray  # N or N m, in each class
    std: np.ndarray
    inclusion: float  # share of random halves of the data on which the same one is chosen
    gain: Gain  # on held-out data, parameters unmoved

    def as_dict(self) -> dict:
        """The record of diagnosis.json."""
        return {
            "degree_of_freedom": DEGREES[self.degree],
            "quantity": self.classes.name,
            "unit": "N m" if self.degree == 2 else "N",
            "classes": [
                {"regime": text, "force": float(a), "std": float(s)}
                for text, a, s in zip(self.classes.texts, self.force, self.std, strict=True)
            ],
            "inclusion": self.inclusion,
            "held_out_gain": self.gain.total,
            "held_out_gain_std": self.gain.std,
        }


def remainder(data: Split, final: Estimate) -> Remainder | None:
    """The quantity and degree of freedom that explain most of what is left, and a model of it."""
    problem = data.train
    gains = final.filter_run(problem).gains
    residual, nuisance = columns_at(problem, gains, final, final.free)
    projection = Projection(residual, nuisance, np.asarray(problem.dataset.run))
    groups = regime_classes(problem)
    if not groups:
        return None
    options = [(classes, degree) for classes in groups for degree in range(3)]
    columns = [
        projection.efficient(push_columns(problem, gains, final, _push(problem, *option)))
        for option in options
    ]
    best = int(np.argmax([projection.score(E).statistic for E in columns]))
    classes, degree = options[best]
    E = columns[best]
    ratio = projection.score(E).inflation
    # A ridge of one noise-sized step keeps a class without information at nothing.
    inverse = np.linalg.inv(E.T @ E / ratio + 1e-9 * np.trace(E.T @ E) * np.eye(E.shape[1]))
    size = -inverse @ (E.T @ projection.residual) / ratio
    mass = float(np.asarray(problem.base.mass_matrix())[degree, degree])
    return Remainder(
        degree, classes, size * mass, np.sqrt(np.diag(inverse)) * mass,
        _inclusion(projection, columns, best),
        _gain(data, final, classes, degree, size),
    )  # fmt: skip


def latent_force(problem: Problem, final: Estimate) -> list[dict[str, np.ndarray]]:
    """The force that the filter finds beside the model, for each run: t (s), X, Y (N), N (N m).

    It is the lasting gusts' acceleration, a first-order Gauss-Markov process, times the mass:
    weather, and whatever else the model does not hold.
    """
    mass = np.diag(np.asarray(problem.base.mass_matrix()))
    force = latent_acceleration(problem, final) * mass
    run, t = np.asarray(problem.dataset.run), np.asarray(problem.dataset.run_time)
    rows = np.asarray(problem.dataset.known).any(1) & (np.asarray(problem.dataset.dt) > 0)
    out = []
    for number in range(problem.dataset.runs):
        own = np.flatnonzero(rows & (run == number))
        own = own[:: max(1, len(own) // SHOWN)]
        out.append({"t": t[own]} | {axis: force[own, k] for k, axis in enumerate("XYN")})
    return out


def _push(problem: Problem, classes: Classes, degree: int) -> np.ndarray:
    """Unit accelerations in one degree of freedom during each class."""
    members = classes.members(problem)
    push = np.zeros((members.shape[1], len(members), 3))
    push[:, :, degree] = members.T
    return push


def _inclusion(projection: Projection, columns: list[np.ndarray], best: int) -> float:
    """Share of random halves of the data on which the same option explains most."""
    residual = projection.residual
    data = (residual != 0) & (np.arange(len(residual)) < projection.rows)
    block = np.where(data, (np.cumsum(data) - 1) * BLOCKS // max(1, data.sum()), BLOCKS)
    rng = np.random.default_rng(11)
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


def _gain(data: Split, final: Estimate, classes: Classes, degree: int, size: np.ndarray) -> Gain:
    """How much better held-out innovations get with the unnamed force, to first order."""
    problem = data.test
    at = dataclasses.replace(final, coordinates=held_out_coordinates(data, final))
    gains = at.filter_run(problem).gains
    residual, _ = columns_at(problem, gains, at, final.free)
    change = push_columns(problem, gains, at, _push(problem, classes, degree)) @ size
    rows = np.asarray(problem.dataset.known).any(1)
    values = len(rows) * 6
    old = (residual[:values] ** 2).reshape(-1, 6).sum(1)
    new = ((residual + change)[:values] ** 2).reshape(-1, 6).sum(1)
    difference = (old - new)[rows][:, None]
    sums = block_sums(difference, max(8, len(difference) // 30))[:, 0]
    return Gain(float(sums.sum()), float(np.std(sums, ddof=1) * np.sqrt(len(sums))))
