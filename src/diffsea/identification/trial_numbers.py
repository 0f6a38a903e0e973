"""Parameters straight from trial numbers, by exact derivatives through the trials' switching.

Trials of one kind run side by side, whatever their orders and sides, and one compiled program
serves fits, Jacobians and numbers: compiling is most of the time that a sheet takes.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.identification.estimates import Estimate, Progress, made, silent
from diffsea.identification.least_squares import (
    least_squares,
    least_squares_steps,
    value_and_jacobian,
    with_known_jacobian,
)
from diffsea.identification.trial_sheet import Sheet
from diffsea.parameters import designed, replace
from diffsea.priors import Parameter
from diffsea.simulation import standard
from diffsea.simulation.standard import Plan
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect


STEPS = 60  # at most, of a fit
_EXPLORED = 30  # Gauss-Newton steps from each of several starts
_TOLERANCE = 1e-4  # of a step, in units of the coordinates, from several starts
_SETTLED = 1e-6  # likewise, at the end of a fit
_EFFECT_SPREAD = 3.0  # prior of an effect's coordinates, in its own sizes
_MISSED = 30.0  # standard deviations that count for a number which a trial does not reach


class TrialNumbers:
    """The objective: whitened differences of simulated and given trial numbers.

    `effects` of the catalogue take part by name like parameters: their coordinates, in their
    sizes, follow those of the parameters, and are zero where they are not free.
    """

    def __init__(
        self,
        vessel: Vessel,
        parameters: Sequence[Parameter],
        sheets: Sequence[Sheet],
        effects: Sequence[Effect] = (),
    ):
        self.parameters = tuple(parameters)
        self.effects = tuple(effects)
        self.sheets = tuple(sheets)
        self.sizes = {effect.name: effect.sizes(vessel) for effect in effects}
        owners = [p.name for p in parameters]
        owners += [name for name, sizes in self.sizes.items() for _ in sizes]
        self.owners = tuple(owners)  # of each coordinate
        added = len(owners) - len(self.parameters)
        self.spreads = np.array([*(p.spread for p in parameters), *[_EFFECT_SPREAD] * added])
        places = designed(vessel)
        shared = tuple(places.get(p.name, (p.name,)) for p in parameters)
        kinds = [_kind(sheet.plan) for sheet in sheets]
        members = {k: tuple(n for n, one in enumerate(kinds) if one == k) for k in kinds}
        self._orders = [
            jax.tree.map(lambda *v: jnp.asarray(v, float), *(_orders(sheets[n].plan) for n in rows))
            for rows in members.values()
        ]
        names = tuple(sheet.names for sheet in sheets)
        applied = tuple((effect, self.sizes[effect.name]) for effect in self.effects)
        self._static = _Static((self.parameters, shared, applied, tuple(members.items()), names))
        self._vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
        self._values = jnp.concatenate([jnp.asarray(s.values, float) for s in sheets])
        self._stds = jnp.concatenate([jnp.asarray(s.stds, float) for s in sheets])

    def numbers(self, coordinates: Float[np.ndarray, "coordinate"]) -> list[dict[str, float]]:
        """The numbers of each trial at an estimate; NaN where the trial does not reach one."""
        white = self.evaluated(coordinates)[0]
        found = np.asarray(self._values) + np.asarray(self._stds) * white
        found = iter(np.where(white == _MISSED, np.nan, found))
        return [{name: float(next(found)) for name in sheet.names} for sheet in self.sheets]

    def evaluated(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whitened misfits of all sheets, one after the other, and their Jacobian by coordinate."""
        white, J = _evaluated(jnp.asarray(coordinates, float), self._given)
        return np.asarray(white), np.asarray(J)

    @property
    def _given(self) -> tuple:
        return (
            self._vessel, self._values, self._stds, self._orders, jnp.asarray(self.spreads),
            self._static,
        )  # fmt: skip

    def fit(
        self, free: tuple[str, ...], start: np.ndarray | None = None, progress: Progress = silent
    ) -> Estimate:
        """Fit the free parameters and effects by name, from `start`."""
        coordinates = np.zeros(len(self.owners)) if start is None else np.array(start, float)
        index = np.array([k for k, name in enumerate(self.owners) if name in free], int)
        given = (jnp.asarray(coordinates), index, self._given)
        held = float(np.sum(np.delete(coordinates / self.spreads, index) ** 2))
        path: list[float] = []
        solution = least_squares_steps(
            _free_misfits, jnp.asarray(coordinates[index]), given, STEPS, _SETTLED
        )
        for number, step in enumerate(solution):
            coordinates[index] = np.asarray(step.at)
            path.append(step.cost + held)
            progress(f"step {number}: misfit {path[-1]:.3f}")
        own = self.evaluated(coordinates)[1][:, index]
        return made(free, coordinates, path[-1], index, self.spreads, own.T @ own, path=path)

    def refit(self, fitted: Estimate, free: tuple[str, ...], start: np.ndarray) -> Estimate:
        """Fit again; a sheet's uncertainties are given, so that nothing is kept."""
        return self.fit(free, start)

    def cost(self, coordinates: np.ndarray, fitted: Estimate | None = None) -> float:
        """-2 log posterior without its constant."""
        return self._deviance(self.evaluated(coordinates)[0], coordinates)

    def _deviance(self, white: np.ndarray, coordinates: np.ndarray) -> float:
        return float(white @ white + np.sum((coordinates / self.spreads) ** 2))

    def explore(
        self, starts: Float[np.ndarray, "start coordinate"], free: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where a few steps of all parameters lead from several starts at once, and the cost."""
        ends = np.asarray(_improve_all(jnp.asarray(starts), self._given))
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


def _kind(plan: Plan) -> Plan:
    """What of a plan decides the compiled program: everything but the orders' numbers."""
    speed, throttle = (None if one is None else 0.0 for one in (plan.speed, plan.throttle))
    return dataclasses.replace(
        plan, angle=0.0, heading=0.0, side=1.0, seconds=0.0, speed=speed, throttle=throttle,
        nominal_speed=0.0,
    )  # fmt: skip


def _orders(plan: Plan) -> dict[str, float]:
    """The numbers of a plan that may differ between trials of one kind."""
    names = ("angle", "heading", "side", "seconds", "speed", "throttle")
    return {name: getattr(plan, name) for name in names if getattr(plan, name) is not None}


def _numbers(coordinates: Array, given: tuple) -> Array:
    """The numbers of all sheets, one after the other."""
    vessel, orders, static = given[0], given[3], given[5]
    parameters, places, effects, kinds, names = static.value
    chosen = {
        place: parameter.decode(coordinates[k])
        for k, (parameter, shared) in enumerate(zip(parameters, places, strict=True))
        for place in shared
    }
    changed, first = replace(vessel, chosen), len(parameters)
    for effect, sizes in effects:
        at = coordinates[first : first + len(sizes)] * jnp.asarray(sizes)
        changed, first = effect.apply(changed, at), first + len(sizes)
    changed = changed.if_possible()
    found: dict[int, Array] = {}
    for (kind, rows), ordered in zip(kinds, orders, strict=True):

        def one(order: dict[str, Array], kind: Plan = kind) -> standard.Numbers:
            plan = dataclasses.replace(kind, **order)
            return standard.numbers(plan, standard.run(changed, plan))

        table = jax.vmap(one)(ordered)
        for place, row in enumerate(rows):
            got = {name: column[place] for name, column in table.items()}
            found[row] = _picked(kind, got, names[row])
    return jnp.concatenate([found[row] for row in range(len(names))])


def _picked(plan: Plan, found: standard.Numbers, wanted: tuple[str, ...]) -> Array:
    for name in wanted:
        if name not in found:
            raise UserError(
                f"a {plan.manoeuvre} has no number {name!r}{nearest(name, found)}; it has: "
                f"{', '.join(found)}"
            )
    return jnp.stack([found[name] for name in wanted])


def _misfits(coordinates: Array, given: tuple) -> Array:
    """Whitened misfits; a number that is not reached counts as far off."""
    found = _numbers(coordinates, given)
    return jnp.where(jnp.isfinite(found), (found - given[1]) / given[2], _MISSED)


def _with_slopes(coordinates: Array, given: tuple) -> tuple[Array, Array]:
    """Misfits and their exact Jacobian."""
    white, slopes = value_and_jacobian(lambda at: _misfits(at, given), coordinates)
    return white, jnp.where(jnp.isfinite(slopes), slopes, 0.0)


_evaluated = eqx.filter_jit(_with_slopes)


def _free_misfits(free: Array, args: tuple) -> tuple[Array, Array]:
    """Misfits, then the prior's, and their Jacobian by the coordinates that `index` tells."""
    coordinates, index, given = args
    white, J = _evaluated(coordinates.at[index].set(free), given)
    spreads = given[4][index]
    return (
        jnp.concatenate([white, free / spreads]),
        jnp.concatenate([J[:, index], jnp.diag(1 / spreads)]),
    )


@eqx.filter_jit
def _improve_all(starts: Array, given: tuple) -> Array:
    """A few Gauss-Newton steps of every coordinate from each start."""

    def residual(at: Array, given: tuple) -> tuple[Array, Array]:
        white, J = _with_slopes(at, given)
        return jnp.concatenate([white, at / given[4]]), jnp.concatenate([J, jnp.diag(1 / given[4])])

    known = with_known_jacobian(residual)
    return jax.vmap(lambda at: least_squares(known, at, given, _EXPLORED, _TOLERANCE))(starts)
