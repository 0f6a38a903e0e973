"""Sheets of trial numbers: advance, diameters, overshoots as a paper or a sea trial gives them.

format = 1
relative_std = 0.02          # of every number without one of its own

[[trial]]
manoeuvre = "turning-circle" # orders as in `diffsea trial`
angle = 35.0                 # deg
side = "starboard"
speed = 1.179                # m/s; or thrust in N
[trial.numbers]              # names as in metrics.json, SI units, lengths also over L
advance_over_L = 3.1
tactical_diameter = { value = 22.4, std = 0.3 }
[[trial]]
manoeuvre = "zigzag"
angle = 10.0
heading = 10.0
[trial.numbers]
overshoot_1 = { value = 8.2, unit = "deg", std = 0.5 }

Parameters straight from trial numbers, by exact derivatives through the trials' switching.

Trials of one kind run side by side, whatever their orders and sides, and one compiled program
serves fits, Jacobians and numbers: compiling is most of the time that a sheet takes.
"""

import dataclasses
import math
import tomllib
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.identification.estimates import Estimate, Progress, no_progress, posterior_estimate
from diffsea.identification.least_squares import (
    least_squares,
    least_squares_steps,
    value_and_jacobian,
    with_known_jacobian,
)
from diffsea.parameters import Parameter, designed, replace
from diffsea.simulation import planning
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect


RELATIVE_STD = 0.03
_ORDERS = ("angle", "heading", "speed", "thrust", "seconds", "step")
_KEYS = (*_ORDERS, "manoeuvre", "side", "executes", "numbers")
_UNITS = {"m": 1.0, "s": 1.0, "rad": 1.0, "rad/s": 1.0, "m/s": 1.0, "deg": math.pi / 180,
          "deg/s": math.pi / 180}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class MeasuredTrial:
    """One trial and what was read off it, in SI units."""

    plan: TrialPlan
    names: tuple[str, ...]
    values: Float[np.ndarray, "number"]
    stds: Float[np.ndarray, "number"]

    @property
    def title(self) -> str:
        """The trial in a few words."""
        plan, degrees = self.plan, math.degrees(self.plan.angle)
        side = "starboard" if plan.side > 0 else "port"
        heading = f"/{math.degrees(plan.heading):g}" if plan.heading else ""
        return f"{plan.manoeuvre} {degrees:g}{heading} deg to {side}"


def is_trial_table(path: str | Path) -> bool:
    """Whether a file is a sheet of trial numbers rather than a recording."""
    return Path(path).suffix.lower() == ".toml"


def read_trial_table(path: str | Path, vessel: Vessel) -> tuple[MeasuredTrial, ...]:
    """The trials of a sheet, planned for a vessel.

    Raises:
        UserError: a file that cannot be read, an unknown key, manoeuvre, number or unit.
    """
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UserError(f"cannot read trial numbers from {path}: {error}") from error
    trials = document.get("trial")
    if document.get("format", 1) != 1 or not isinstance(trials, list) or not trials:
        raise UserError(
            f"{path} is no sheet of trial numbers: it needs format = 1 and a [[trial]] with "
            "manoeuvre and [trial.numbers]"
        )
    relative = _number(document.get("relative_std", RELATIVE_STD), f"{path}: relative_std")
    return tuple(
        _sheet(f"{path}, trial {k + 1}", entry, relative, vessel) for k, entry in enumerate(trials)
    )


def _sheet(where: str, entry: dict, relative: float, vessel: Vessel) -> MeasuredTrial:
    for key in entry:
        if key not in _KEYS:
            raise UserError(f"{where}: unknown key {key!r}{nearest(key, _KEYS)}")
    if "manoeuvre" not in entry or not entry.get("numbers"):
        raise UserError(f"{where} needs a manoeuvre and [trial.numbers] with at least one number")
    side = entry.get("side", "starboard")
    if side not in ("starboard", "port"):
        raise UserError(f"{where}: side = {side!r} is neither starboard nor port")
    orders = {key: _number(entry[key], f"{where}: {key}") for key in _ORDERS if key in entry}
    for key in ("angle", "heading"):
        orders |= {key: math.radians(orders[key])} if key in orders else {}
    plan = planning.plan_trial(
        vessel, entry["manoeuvre"], side=1.0 if side == "starboard" else -1.0,
        executes=int(entry.get("executes", _executes(entry["numbers"]))), **orders,
    )  # fmt: skip
    rows = [
        _read_number(f"{where}, {name}", name, given, relative, float(vessel.rigid_body.length))
        for name, given in entry["numbers"].items()
    ]
    names, values, stds = zip(*rows, strict=True)
    return MeasuredTrial(plan, names, np.array(values), np.array(stds))


def _executes(numbers: dict) -> int:
    """Enough rudder executions for the overshoots that are asked for."""
    last = [int(n.rsplit("_", 1)[1]) for n in numbers if n.startswith("overshoot_")]
    return max([2, *(k + 1 for k in last)])


def _read_number(
    where: str, name: str, given: object, relative: float, length: float
) -> tuple[str, float, float]:
    """Name as simulated, value and standard deviation."""
    entry = given if isinstance(given, dict) else {"value": given}
    for key in entry:
        if key not in ("value", "std", "unit"):
            raise UserError(f"{where}: unknown key {key!r}; give value, std and unit")
    factor = 1.0
    if "unit" in entry:
        if entry["unit"] not in _UNITS:
            raise UserError(f"{where}: unknown unit {entry['unit']!r}; use {', '.join(_UNITS)}")
        factor = _UNITS[entry["unit"]]
    if name.endswith("_over_L"):
        name, factor = name.removesuffix("_over_L"), length
    value = factor * _number(entry.get("value"), where)
    std = factor * _number(entry["std"], where) if "std" in entry else relative * abs(value)
    if not std > 0:
        raise UserError(f"{where}: the standard deviation must be above zero")
    return name, value, std


def _number(given: object, where: str) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not math.isfinite(given):
        raise UserError(f"{where}: {given!r} is not a number")
    return float(given)


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
        sheets: Sequence[MeasuredTrial],
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
        self,
        free: tuple[str, ...],
        start: np.ndarray | None = None,
        progress: Progress = no_progress,
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
        return posterior_estimate(
            free, coordinates, path[-1], index, self.spreads, own.T @ own, path=path
        )

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


def _kind(plan: TrialPlan) -> TrialPlan:
    """What of a plan decides the compiled program: everything but the orders' numbers."""
    speed, throttle = (None if one is None else 0.0 for one in (plan.speed, plan.throttle))
    return dataclasses.replace(
        plan, angle=0.0, heading=0.0, side=1.0, seconds=0.0, speed=speed, throttle=throttle,
        nominal_speed=0.0,
    )  # fmt: skip


def _orders(plan: TrialPlan) -> dict[str, float]:
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

        def one(order: dict[str, Array], kind: TrialPlan = kind) -> Numbers:
            plan = dataclasses.replace(kind, **order)
            return planning.trial_numbers(plan, planning.run_plan(changed, plan))

        table = jax.vmap(one)(ordered)
        for place, row in enumerate(rows):
            got = {name: column[place] for name, column in table.items()}
            found[row] = _picked(kind, got, names[row])
    return jnp.concatenate([found[row] for row in range(len(names))])


def _picked(plan: TrialPlan, found: Numbers, wanted: tuple[str, ...]) -> Array:
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
