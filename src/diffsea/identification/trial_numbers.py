"""Parameters straight from trial numbers, by exact derivatives through the trials' switching."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.identification.estimates import Estimate, Progress, made, silent
from diffsea.identification.least_squares import least_squares, with_known_jacobian
from diffsea.identification.trial_sheet import Sheet
from diffsea.parameters import designed, replace
from diffsea.priors import Parameter
from diffsea.simulation import standard
from diffsea.simulation.standard import Plan
from diffsea.vessel.base import Vessel


STEPS = 30  # of Gauss-Newton in one round
ROUNDS = 4
_MISSED = 30.0  # standard deviations that count for a number which a trial does not reach


class TrialNumbers:
    """The objective: whitened differences of simulated and given trial numbers."""

    def __init__(self, vessel: Vessel, parameters: Sequence[Parameter], sheets: Sequence[Sheet]):
        """Set up.

        Raises:
            UserError: a number that a trial does not have, or fewer numbers than one.
        """
        self.parameters = tuple(parameters)
        self.sheets = tuple(sheets)
        self.spreads = np.array([p.spread for p in parameters])
        places = designed(vessel)
        shared = tuple(places.get(p.name, (p.name,)) for p in parameters)
        self._static = _Static((self.parameters, shared, tuple(s.plan for s in self.sheets)))
        self._vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
        self._values = [jnp.asarray(s.values) for s in self.sheets]
        self._stds = [jnp.asarray(s.stds) for s in self.sheets]
        self._names = tuple(s.names for s in self.sheets)

    def numbers(self, coordinates: Float[np.ndarray, "coordinate"]) -> list[dict[str, float]]:
        """The numbers of each trial at an estimate; NaN where the trial does not reach one."""
        found = _evaluated(jnp.asarray(coordinates, float), self._given)[2]
        return [
            dict(zip(names, map(float, row), strict=True))
            for names, row in zip(self._names, found, strict=True)
        ]

    @property
    def _given(self) -> tuple:
        spreads = jnp.asarray(self.spreads)
        return self._vessel, self._values, self._stds, spreads, self._static, _Static(self._names)

    def fit(
        self, free: tuple[str, ...], start: np.ndarray | None = None, progress: Progress = silent
    ) -> Estimate:
        """Fit the free parameters by name, from `start`."""
        coordinates = np.zeros(len(self.parameters)) if start is None else np.array(start, float)
        index = np.array([k for k, p in enumerate(self.parameters) if p.name in free], int)
        chosen = np.zeros(len(self.parameters))
        chosen[index] = 1.0
        cost = self.cost(coordinates)
        path = [cost]
        for number in range(ROUNDS):
            held = np.where(chosen > 0, 0.0, coordinates)
            problem = self._given, jnp.asarray(chosen), jnp.asarray(held)
            coordinates = np.asarray(_improve(jnp.asarray(coordinates), problem))
            last, cost = cost, self.cost(coordinates)
            path.append(cost)
            progress(f"round {number + 1}: misfit {cost:.3f}")
            if last - cost < 1e-3:
                break
        J = np.asarray(_evaluated(jnp.asarray(coordinates, float), self._given)[1])[:, index]
        return made(free, coordinates, cost, index, self.spreads, J.T @ J, path=path)

    def refit(self, fitted: Estimate, free: tuple[str, ...], start: np.ndarray) -> Estimate:
        """Fit again; a sheet's uncertainties are given, so that nothing is kept."""
        return self.fit(free, start)

    def cost(self, coordinates: np.ndarray, fitted: Estimate | None = None) -> float:
        """-2 log posterior without its constant."""
        white = np.asarray(_evaluated(jnp.asarray(coordinates, float), self._given)[0])
        return float(white @ white + np.sum((coordinates / self.spreads) ** 2))

    def explore(
        self, starts: Float[np.ndarray, "start coordinate"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where a few steps lead from several starts at once, and the cost there."""
        chosen, held = jnp.ones(len(self.parameters)), jnp.zeros(len(self.parameters))
        problem = self._given, chosen, held
        ends = np.asarray(_improve_all(jnp.asarray(starts), problem))
        return ends, np.array([self.cost(end) for end in ends])

    def residuals(self, coordinates: np.ndarray) -> list[dict]:
        """One row per number: trial, name, given, std, fitted."""
        rows = []
        for sheet, found in zip(self.sheets, self.numbers(coordinates), strict=True):
            for name, value, std in zip(sheet.names, sheet.values, sheet.stds, strict=True):
                row = {"trial": sheet.title, "number": name, "given": float(value)}
                rows.append(row | {"std": float(std), "fitted": found[name]})
        return rows


class _Static(eqx.Module):
    value: tuple = eqx.field(static=True)


def _numbers(coordinates: Array, given: tuple) -> list[Array]:
    vessel, _, _, _, static, names = given
    parameters, places, plans = static.value
    chosen = {
        place: parameter.decode(coordinates[k])
        for k, (parameter, shared) in enumerate(zip(parameters, places, strict=True))
        for place in shared
    }
    changed = replace(vessel, chosen)
    return [
        _picked(plan, standard.numbers(plan, standard.run(changed, plan)), wanted)
        for plan, wanted in zip(plans, names.value, strict=True)
    ]


def _picked(plan: Plan, found: standard.Numbers, wanted: tuple[str, ...]) -> Array:
    for name in wanted:
        if name not in found:
            raise UserError(
                f"a {plan.manoeuvre} has no number {name!r}{nearest(name, found)}; it has: "
                f"{', '.join(found)}"
            )
    return jnp.stack([found[name] for name in wanted])


def _misfits(coordinates: Array, given: tuple) -> tuple[Array, list[Array]]:
    """Whitened misfits and the numbers; one that is not reached counts as far off."""
    found = _numbers(coordinates, given)
    white = [
        jnp.where(jnp.isfinite(number), (number - value) / std, _MISSED)
        for number, value, std in zip(found, given[1], given[2], strict=True)
    ]
    return jnp.concatenate(white), found


def _with_slopes(coordinates: Array, given: tuple) -> tuple[Array, Array, list[Array]]:
    """Misfits, their exact Jacobian and the numbers."""

    def along(direction: Array) -> tuple:
        return jax.jvp(lambda at: _misfits(at, given), (coordinates,), (direction,))

    (white, found), (slopes, _) = jax.vmap(along, out_axes=(None, -1))(jnp.eye(coordinates.size))
    return white, jnp.where(jnp.isfinite(slopes), slopes, 0.0), found


_evaluated = eqx.filter_jit(_with_slopes)


def _solved(start: Array, problem: tuple) -> Array:
    """Gauss-Newton steps on the coordinates that `chosen` marks; the others stay as held."""

    def residual(at: Array, problem: tuple) -> tuple[Array, Array]:
        given, chosen, held = problem
        white, J, _ = _with_slopes(held + chosen * at, given)
        prior = (held + chosen * at) / given[3]
        unused = (1 - chosen) * at
        return (
            jnp.concatenate([white, prior, unused]),
            jnp.concatenate([J * chosen, jnp.diag(chosen / given[3]), jnp.diag(1 - chosen)]),
        )

    given, chosen, held = problem
    begin = chosen * start
    found = least_squares(with_known_jacobian(residual), begin, problem, STEPS)
    return held + chosen * found


_improve = eqx.filter_jit(_solved)


@eqx.filter_jit
def _improve_all(starts: Array, problem: tuple) -> Array:
    return jax.vmap(lambda at: _solved(at, problem))(starts)
