"""What recordings of a reference period tell of the vessel: the prior of what came after them.

With theta the vessel's coordinates, y0 the recordings of the reference period (ISO 19030-1:2016)
and y those that are asked, theta being the same in both but for what changed,

    p(theta | y0, y) ~ p(y | theta) p(y0 | theta) p(theta),

whose second factor is normal, as the fit to y0 ends with: at its estimate, with the information of
its data. Gusts and sensor noise are each period's own. A model that lacks something fits each
part of a record with other derivatives; errors are therefore as wide as scores that scatter from
part to part make them (Liang and Zeger 1986), where these are wider.
"""

from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Coordinates, NumberResidual, Problem
from diffsea.identification.residual import linearise


PARTS = 8  # of each recording, whose scores are compared


class Reference(eqx.Module):
    """A normal likelihood of the vessel's parameters: `FurtherData` of a later fit."""

    estimate: Float[np.ndarray, "parameter"]  # coordinates
    root: Float[np.ndarray, "parameter parameter"]  # of the information: root' root
    is_before: ClassVar[bool] = True

    def misfits_and_jacobian(
        self, coordinates: Coordinates
    ) -> tuple[Float[np.ndarray, "parameter"], Float[np.ndarray, "parameter coordinate"]]:
        """Distances of the parameters from the reference, as far as it tells them."""
        count = len(self.estimate)
        J = np.zeros((count, len(coordinates)))
        J[:, :count] = self.root
        return self.root @ (np.asarray(coordinates)[:count] - self.estimate), J

    def residuals(self, coordinates: Coordinates) -> list[NumberResidual]:
        """None: it has no numbers of a sheet."""
        return []


def reference_of(problem: Problem, fitted: Estimate) -> Reference:
    """What a fit to the recordings of a reference period tells of the parameters.

    Arguments:
        fitted: with all of the vessel's parameters free, and no effect.
    """
    prior = np.diag(1 / problem.layout.spreads()[fitted.index] ** 2)
    plain = np.linalg.inv(fitted.precision)
    rows = linearise(problem, fitted.filter_run(problem).gains, fitted.coordinates, fitted.index)
    values = 6 * len(problem.dataset.run)
    terms = rows.jacobian[:values] * rows.residual[:values, None]
    by_row = terms.reshape(-1, 6, terms.shape[1]).sum(1)
    scores = np.array([by_row[part].sum(0) for part in problem.dataset.parts_of_runs(PARTS)])
    between = scores.T @ scores * len(scores) / (len(scores) - 1)
    variance = np.maximum(np.diag(fitted.covariance), np.diag(plain @ (between + prior) @ plain))
    wider = np.sqrt(variance / np.diag(plain))
    share, axes = np.linalg.eigh(fitted.information / np.outer(wider, wider))
    root = np.sqrt(np.maximum(share, 0.0))[:, None] * axes.T
    return Reference(np.asarray(fitted.coordinates)[fitted.index], root)
