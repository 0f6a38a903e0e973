"""A force without a name: the regime where it lives, and a model of it without physics.

The unexplained force depends on one quantity of the motion, constant in each of its classes. It is
estimated beside the model's parameters, so that these keep their values and their meaning, and
judged on held-out runs like everything else.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.jacobians import Columns, linearise_model
from diffsea.diagnosis.localisation import RegimeClasses, regime_classes, unit_pulses
from diffsea.diagnosis.score import Projection
from diffsea.diagnosis.screening import latent_acceleration
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Gain, Split, held_out_coordinates
from diffsea.identification.problem import Problem
from diffsea.statistics import block_sums


HALVES = 100  # random halves of the data on which the choice is repeated: a share within 5 %
BLOCKS = 40  # of consecutive rows, of which halves are drawn
HALVES_SEED = 11
POINTS_OF_A_RUN = 300  # of its latent force, for plots


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
    """The quantity and degree of freedom that explain most of what is left, and a model of it."""
    problem = data.train
    model = linearise_model(problem, final)
    projection = model.projection(final.free)
    options = [(classes, degree) for classes in regime_classes(problem) for degree in range(3)]
    if not options:
        return None
    columns = [
        projection.efficient(model.by_pulses(unit_pulses(classes.members(problem), degree)))
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
        gain=_held_out_gain(data, final, classes, degree, size),
    )


def inclusion_share(projection: Projection, columns: list[Columns], best: int) -> float:
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


def _held_out_gain(
    data: Split, final: Estimate, classes: RegimeClasses, degree: int, size: np.ndarray
) -> Gain:
    """How much better held-out innovations get with the unnamed force, to first order."""
    problem = data.test
    coordinates = held_out_coordinates(data, final)
    model = linearise_model(problem, dataclasses.replace(final, coordinates=coordinates))
    residual, _ = model.by_name(final.free)
    change = model.by_pulses(unit_pulses(classes.members(problem), degree)) @ size
    rows = problem.dataset.recorded_rows
    values = len(rows) * 6
    old = (residual[:values] ** 2).reshape(-1, 6).sum(1)
    new = ((residual + change)[:values] ** 2).reshape(-1, 6).sum(1)
    difference = (old - new)[rows][:, None]
    sums = block_sums(difference, max(8, len(difference) // 30))[:, 0]
    return Gain(float(sums.sum()), float(np.std(sums, ddof=1) * np.sqrt(len(sums))))


def latent_force(problem: Problem, final: Estimate) -> list[dict[str, np.ndarray]]:
    """The force that the filter finds beside the model, for each run: t (s), X, Y (N), N (N m).

    It is the lasting gusts' acceleration, a first-order Gauss-Markov process, times the mass:
    weather, and whatever else the model does not hold.
    """
    mass = np.diag(np.asarray(problem.base.mass_matrix()))
    force = latent_acceleration(problem, final) * mass
    run, t = np.asarray(problem.dataset.run), np.asarray(problem.dataset.run_time)
    rows = problem.dataset.recorded_rows & (np.asarray(problem.dataset.dt) > 0)
    out = []
    for number in range(problem.dataset.runs):
        own = np.flatnonzero(rows & (run == number))
        own = own[:: max(1, len(own) // POINTS_OF_A_RUN)]
        out.append({"t": t[own]} | {axis: force[own, k] for k, axis in enumerate("XYN")})
    return out
