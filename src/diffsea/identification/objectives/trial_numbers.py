"""Parameters straight from trial numbers: advance, diameters and overshoots of a trial.

Numbers as a paper or a sea trial gives them stand in a table of trial numbers:

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

They are fitted by exact derivatives through the trials' switching. Trials of one kind run side by
side, whatever their orders and sides, and one compiled program serves fits, Jacobians and
numbers: compiling is most of the time that it takes.
"""

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.budget import current_budget
from diffsea.errors import UserError, nearest
from diffsea.identification.coordinates import expansion_points
from diffsea.identification.estimates import (
    Estimate,
    FitOutcome,
    ParameterRecord,
    is_at_bound,
    parameters_with_errors,
    posterior_estimate,
)
from diffsea.identification.least_squares import (
    iterate_least_squares,
    solve_least_squares,
    value_and_jacobian,
)
from diffsea.identification.objectives.base import AbstractObjective, Costs, Starts
from diffsea.identification.problem import Coordinates, Names, NumberResidual
from diffsea.metrics.numbers import OVER_LENGTH
from diffsea.outside.documents import read_toml
from diffsea.parameters import Parameter, file_parameters, replace
from diffsea.progress import Progress, no_progress
from diffsea.simulation import planning
from diffsea.simulation.standard import Numbers, TrialPlan
from diffsea.types import as_inputs
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import Effect, spoken_name


RELATIVE_STD = 0.03  # of a number that states none: a guess at the scatter of repeated trials
_ORDERS = ("angle", "heading", "speed", "thrust", "seconds", "step")
_KEYS = (*_ORDERS, "manoeuvre", "side", "executes", "numbers")
_UNITS: dict[str, float] = dict.fromkeys(("m", "s", "rad", "rad/s", "m/s"), 1.0)
_UNITS |= dict.fromkeys(("deg", "deg/s"), math.pi / 180)


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
    """Whether a file is a table of trial numbers rather than a recording."""
    return Path(path).suffix.lower() == ".toml"


def read_trial_table(path: str | Path, vessel: Vessel) -> tuple[MeasuredTrial, ...]:
    """The trials of a table, planned for a vessel.

    Raises:
        UserError: a file that cannot be read, an unknown key, manoeuvre, number or unit.
    """
    document = read_toml(path, "trial numbers from")
    trials = document.get("trial")
    if document.get("format", 1) != 1 or not isinstance(trials, list) or not trials:
        raise UserError(
            f"{path} is no sheet of trial numbers: it needs format = 1 and a [[trial]] with "
            "manoeuvre and [trial.numbers]"
        )
    relative = _finite_number(document.get("relative_std", RELATIVE_STD), f"{path}: relative_std")
    return tuple(
        _read_trial(f"{path}, trial {k + 1}", entry, relative, vessel)
        for k, entry in enumerate(trials)
    )


def _read_trial(where: str, entry: Any, relative: float, vessel: Vessel) -> MeasuredTrial:
    if not isinstance(entry, dict):
        raise UserError(f"{where} is {entry!r} and not a [[trial]]")
    for key in entry:
        if key not in _KEYS:
            raise UserError(f"{where}: unknown key {key!r}{nearest(key, _KEYS)}")
    manoeuvre, numbers = entry.get("manoeuvre"), entry.get("numbers")
    if not isinstance(manoeuvre, str) or not isinstance(numbers, dict) or not numbers:
        raise UserError(
            f"{where} needs a manoeuvre by its name and [trial.numbers] with at least one number"
        )
    side = entry.get("side", "starboard")
    if side not in ("starboard", "port"):
        raise UserError(f"{where}: side = {side!r} is neither starboard nor port")
    given = [key for key in _ORDERS if key in entry]
    orders = {key: _finite_number(entry[key], f"{where}: {key}") for key in given}
    orders |= {key: math.radians(orders[key]) for key in ("angle", "heading") if key in orders}
    # Enough rudder executions for the overshoots that are asked for.
    overshoots = [
        int(n[1]) for name in numbers if (n := re.fullmatch(r"overshoot_(\d{1,3})", name))
    ]
    executes = entry.get("executes", max([2, *(k + 1 for k in overshoots)]))
    if isinstance(executes, bool) or not isinstance(executes, int):
        raise UserError(f"{where}: executes = {executes!r} is no number of rudder executions")
    sign = 1.0 if side == "starboard" else -1.0
    try:
        plan = planning.plan_trial(
            vessel, manoeuvre, side=sign, executes=executes, keep_speed=False, **orders
        )
    except UserError as error:
        raise UserError(f"{where}: {error}") from error
    rows = [
        _read_number(f"{where}, {name}", name, given, relative, float(vessel.rigid_body.length))
        for name, given in numbers.items()
    ]
    names, values, stds = zip(*rows, strict=True)
    return MeasuredTrial(plan, names, np.array(values), np.array(stds))


def _read_number(
    where: str, name: str, given: object, relative: float, length: float
) -> tuple[str, float, float]:
    """Name as simulated, value and standard deviation."""
    entry: dict[str, Any] = given if isinstance(given, dict) else {"value": given}
    for key in entry:
        if key not in ("value", "std", "unit"):
            raise UserError(f"{where}: unknown key {key!r}; give value, std and unit")
    factor = 1.0
    if "unit" in entry:
        if str(entry["unit"]) not in _UNITS:
            raise UserError(f"{where}: unknown unit {entry['unit']!r}; use {', '.join(_UNITS)}")
        factor = _UNITS[str(entry["unit"])]
    if name.endswith(OVER_LENGTH):
        name, factor = name.removesuffix(OVER_LENGTH), length
    value = factor * _finite_number(entry.get("value"), where)
    std = factor * _finite_number(entry["std"], where) if "std" in entry else relative * abs(value)
    if not std > 0:
        raise UserError(f"{where}: the standard deviation must be above zero")
    return name, value, std


def _finite_number(given: object, where: str) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not math.isfinite(given):
        raise UserError(f"{where}: {given!r} is not a number")
    return float(given)


STEP_LIMIT = 60  # of a fit
_EXPLORING_STEPS = 30  # of Gauss-Newton from each of several starts
_TOLERANCE = 1e-6  # of a step, in units of the coordinates, at the end of a fit
_EFFECT_SPREAD = 3.0  # prior of an effect's coordinates, in its own sizes
_MISSED = 30.0  # standard deviations that count for a number which a trial does not reach


def acts_in_trials(effect: Effect) -> bool:
    """Whether an effect is the vessel's own, and so acts in the trials of a sheet too.

    Weather and sensors belong to the recordings, and so does the time of a change: the sheet's
    trials are run in the environment of the vessel file.
    """
    return effect.family in ("actuator", "hull") and effect.scanned is None


class TrialInputs(eqx.Module):
    """What the compiled misfits need. Trials of one kind run side by side."""

    vessel: Vessel
    values: Float[Array, "number"]
    stds: Float[Array, "number"]
    orders: list[dict[str, Float[Array, "_"]]]  # of each kind of trial, one to each
    spreads: Float[Array, "coordinate"]
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    places: tuple[tuple[str, ...], ...] = eqx.field(static=True)  # where each parameter stands
    effects: tuple[tuple[Effect, tuple[float, ...]], ...] = eqx.field(static=True)  # with sizes
    kinds: tuple[tuple[TrialPlan, tuple[int, ...]], ...] = eqx.field(static=True)  # of trials
    names: tuple[tuple[str, ...], ...] = eqx.field(static=True)  # of each trial's numbers

    def misfits(self, coordinates: Float[Array, "coordinate"]) -> Float[Array, "number"]:
        """Whitened misfits of all trials; a number that is not reached counts as far off."""
        found = self.numbers(coordinates)
        return jnp.where(jnp.isfinite(found), (found - self.values) / self.stds, _MISSED)

    def numbers(self, coordinates: Float[Array, "coordinate"]) -> Float[Array, "number"]:
        """The numbers of all trials, one after the other."""
        chosen = {
            place: parameter.decode(coordinates[k])
            for k, (parameter, shared) in enumerate(zip(self.parameters, self.places, strict=True))
            for place in shared
        }
        vessel, first = replace(self.vessel, chosen), len(self.parameters)
        for effect, sizes in self.effects:
            at = coordinates[first : first + len(sizes)] * jnp.asarray(sizes)
            vessel, first = effect.apply(vessel, at), first + len(sizes)
        vessel = vessel.if_possible()
        found: dict[int, Array] = {}
        for (kind, trials), orders in zip(self.kinds, self.orders, strict=True):

            def measure_trial(order: dict[str, Array], kind: TrialPlan = kind) -> Numbers:
                plan = dataclasses.replace(kind, **order)
                return planning.trial_numbers(plan, planning.run_plan(vessel, plan))

            table = jax.vmap(measure_trial)(orders)
            for place, trial in enumerate(trials):
                for name in self.names[trial]:
                    if name not in table:
                        raise UserError(
                            f"a {kind.manoeuvre} has no number {name!r}{nearest(name, table)}; "
                            f"it has: {', '.join(table)}"
                        )
                found[trial] = jnp.stack([table[name][place] for name in self.names[trial]])
        return jnp.concatenate([found[trial] for trial in range(len(self.names))])


class TrialNumbers(AbstractObjective):
    """The objective: whitened differences of simulated and given trial numbers.

    `effects` of the catalogue take part by name like parameters: their coordinates, in their
    sizes, follow those of the parameters, and are zero where they are not free.
    """

    def __init__(
        self,
        vessel: Vessel,
        parameters: Sequence[Parameter],
        trials: Sequence[MeasuredTrial],
        effects: Sequence[Effect] = (),
    ):
        self.base, self.parameters, self.effects = vessel, tuple(parameters), tuple(effects)
        self.problem, self.outliers, self.one_sample_in = None, {}, {}
        self.trials = tuple(trials)
        self.sizes = {effect.name: effect.sizes(vessel) for effect in effects}
        added = [name for name, own in self.sizes.items() for _ in own]
        self.owners = (*(p.name for p in parameters), *added)  # of each coordinate
        self.spreads = np.array([p.spread for p in parameters] + [_EFFECT_SPREAD] * len(added))
        places = file_parameters(vessel)
        varied = [_varied_orders(trial.plan) for trial in trials]
        # What decides the compiled program: everything of a plan but the orders' numbers.
        kinds = [
            dataclasses.replace(trial.plan, nominal_speed=0.0, **dict.fromkeys(own, 0.0))
            for trial, own in zip(trials, varied, strict=True)
        ]
        members = {k: tuple(n for n, one in enumerate(kinds) if one == k) for k in kinds}
        stack = lambda *values: jnp.asarray(values, float)
        orders = [jax.tree.map(stack, *(varied[n] for n in rows)) for rows in members.values()]
        self._inputs = TrialInputs(
            as_inputs(vessel),
            jnp.concatenate([jnp.asarray(one.values, float) for one in trials]),
            jnp.concatenate([jnp.asarray(one.stds, float) for one in trials]),
            orders,
            jnp.asarray(self.spreads),
            parameters=self.parameters,
            places=tuple(places.get(p.name, (p.name,)) for p in parameters),
            effects=tuple((effect, self.sizes[effect.name]) for effect in effects),
            kinds=tuple(members.items()),
            names=tuple(trial.names for trial in trials),
        )

    def numbers(self, coordinates: Coordinates) -> list[dict[str, float]]:
        """The numbers of each trial at an estimate; NaN where the trial does not reach one."""
        white = self.misfits_and_jacobian(coordinates)[0]
        found = np.asarray(self._inputs.values) + np.asarray(self._inputs.stds) * white
        found = iter(np.where(white == _MISSED, np.nan, found))
        return [{name: float(next(found)) for name in trial.names} for trial in self.trials]

    def misfits_and_jacobian(
        self, coordinates: Coordinates
    ) -> tuple[Float[np.ndarray, "number"], Float[np.ndarray, "number coordinate"]]:
        """Whitened misfits of all trials, one after the other, and their Jacobian."""
        white, J = _evaluate(jnp.asarray(coordinates, float), self._inputs)
        return np.asarray(white), np.asarray(J)

    def fit(
        self, free: Names, start: Coordinates | None = None, progress: Progress = no_progress
    ) -> Estimate:
        """Fit the free parameters and effects by name, from `start`."""
        coordinates = np.zeros(len(self.owners)) if start is None else np.array(start, float)
        index = np.array([k for k, name in enumerate(self.owners) if name in free], int)
        given = jnp.asarray(coordinates), index, self._inputs
        held = float(np.sum(np.delete(coordinates / self.spreads, index) ** 2))
        path: list[float] = []
        outcome = FitOutcome.STEP_LIMIT
        begin = jnp.asarray(coordinates[index])
        solution = iterate_least_squares(_free_misfits, begin, given, STEP_LIMIT, _TOLERANCE)
        for number, step in enumerate(solution):
            coordinates[index] = np.asarray(step.at)
            path.append(step.cost + held)
            progress(f"fitting, step {number}: misfit {path[-1]:.3f}")
            if step.converged:
                outcome = FitOutcome.CONVERGED if step.accepted else FitOutcome.STALLED
            elif current_budget().skips("steps of a fit"):
                outcome = FitOutcome.OUT_OF_TIME
                break
        if outcome is FitOutcome.CONVERGED and is_at_bound(self.parameters, coordinates, index):
            outcome = FitOutcome.BOUNDED
        own = self.misfits_and_jacobian(coordinates)[1][:, index]
        return posterior_estimate(
            free, coordinates, path[-1], index, self.spreads, own.T @ own, None, None, path, outcome
        )

    def refit(self, fitted: Estimate, free: Names, start: Coordinates) -> Estimate:
        """Fit again; the numbers' uncertainties are given, so that nothing is kept."""
        return self.fit(free, start)

    def cost(self, coordinates: Coordinates, fitted: Estimate | None = None) -> float:
        """-2 log posterior without its constant."""
        white = self.misfits_and_jacobian(coordinates)[0]
        return float(white @ white + np.sum((coordinates / self.spreads) ** 2))

    def squares(self, fitted: Estimate) -> tuple[float, int]:
        """Sum of squared misfits over their standard deviations, and how many there are."""
        white = self.misfits_and_jacobian(fitted.coordinates)[0]
        return float(white @ white), len(white)

    def explore(self, starts: Starts, free: Names) -> tuple[Starts, Costs]:
        """Where a few steps of all parameters lead from several starts at once, and the cost."""
        ends = np.asarray(_improve_all(jnp.asarray(starts), self._inputs))
        return ends, np.array([self.cost(end) for end in ends])

    def effect_records(self, fitted: Estimate) -> dict[str, list[dict[str, ParameterRecord]]]:
        """Parameters of each effect with standard errors."""
        found = {}
        for effect in self.effects:
            places = self._places(effect)
            rows = [list(fitted.index).index(k) for k in places]
            sizes = np.array(self.sizes[effect.name])
            covariance = fitted.covariance[np.ix_(rows, rows)] * np.outer(sizes, sizes)
            values = sizes * fitted.coordinates[places]
            record = parameters_with_errors(self.base, effect, values, covariance)
            found[effect.name] = [record]
        return found

    def effect_starts(self) -> Starts:
        """Coordinates without any effect, then those with each where it may show itself."""
        rows = [np.zeros(len(self.owners))]
        for effect in self.effects:
            for point in expansion_points(effect, self.base, []):
                if any(point.at):
                    rows.append(np.zeros(len(self.owners)))
                    rows[-1][self._places(effect)] = point.at
        return np.array(rows)

    def log10_odds(self, fitted: Estimate, progress: Progress = no_progress) -> dict[str, float]:
        """Odds of each effect against the fit without it, as decimal logarithms.

        By Laplace's approximation, and by misfits as large as the fit with all effects leaves.
        Those that there is no time for are left out.
        """
        inflation, found, left_out = self.inflation(fitted), {}, current_budget()
        for effect in self.effects:
            if left_out.skips(f"the odds of {effect.name}"):
                continue
            progress(f"fitting without {spoken_name(effect.name)}")
            start = np.array(fitted.coordinates)
            start[self._places(effect)] = 0.0
            left = tuple(name for name in fitted.free if name != effect.name)
            without = self.fit(left, start)
            if left_out.skips(f"the odds of {effect.name}"):
                continue  # its fit was cut short
            evidence = self.evidence(fitted, without, effect, inflation)
            found[effect.name] = evidence / (2 * math.log(10))
        return found

    def inflation(self, fitted: Estimate) -> float:
        """Squared misfits of a fit over the numbers that it leaves free, at least one."""
        square, count = self.squares(fitted)
        free = count - float(np.sum(fitted.shrinkage))
        return max(1.0, square / free) if free > 0 else 1.0

    def evidence(
        self, fitted: Estimate, without: Estimate, effect: Effect, inflation: float = 1.0
    ) -> float:
        """Twice the log of the Bayes factor of a fit against one without an effect (Laplace).

        The fall of the deviance less the price of the effect's room in the prior, both by the
        misfits' `inflation`.
        """
        places = self._places(effect)
        volume = np.linalg.slogdet(fitted.precision)[1] - np.linalg.slogdet(without.precision)[1]
        room = volume + 2 * np.log(self.spreads[places]).sum() - len(places) * np.log(inflation)
        return float((without.deviance - fitted.deviance) / inflation - max(room, 0.0))

    def _places(self, effect: Effect) -> list[int]:
        """Where an effect's coordinates stand."""
        return [k for k, owner in enumerate(self.owners) if owner == effect.name]

    def residuals(self, coordinates: Coordinates) -> list[NumberResidual]:
        """All numbers as they were given and as they are simulated."""
        return [
            NumberResidual(trial.title, name, float(value), float(std), found[name])
            for trial, found in zip(self.trials, self.numbers(coordinates), strict=True)
            for name, value, std in zip(trial.names, trial.values, trial.stds, strict=True)
        ]


def _varied_orders(plan: TrialPlan) -> dict[str, float]:
    """The numbers of a plan that may differ between trials of one kind."""
    names = ("angle", "heading", "side", "seconds", "speed", "throttle")
    return {name: getattr(plan, name) for name in names if getattr(plan, name) is not None}


def _misfits_with_slopes(coordinates: Array, inputs: TrialInputs) -> tuple[Array, Array]:
    """Misfits and their exact Jacobian."""
    white, slopes = value_and_jacobian(inputs.misfits, coordinates)
    return white, jnp.where(jnp.isfinite(slopes), slopes, 0.0)


_evaluate = eqx.filter_jit(_misfits_with_slopes)


def _free_misfits(free: Array, args: tuple[Array, Array, TrialInputs]) -> tuple[Array, Array]:
    """Misfits, then the prior's, and their Jacobian by the coordinates at `index`."""
    coordinates, index, inputs = args
    white, J = _evaluate(coordinates.at[index].set(free), inputs)
    spreads = inputs.spreads[index]
    return (
        jnp.concatenate([white, free / spreads]),
        jnp.concatenate([J[:, index], jnp.diag(1 / spreads)]),
    )


@eqx.filter_jit
def _improve_all(
    starts: Float[Array, "start coordinate"], inputs: TrialInputs
) -> Float[Array, "start coordinate"]:
    """A few Gauss-Newton steps of every coordinate from each start."""

    def residual(at: Array, inputs: TrialInputs) -> tuple[Array, Array]:
        white, J = _misfits_with_slopes(at, inputs)
        spreads = inputs.spreads
        return jnp.concatenate([white, at / spreads]), jnp.concatenate([J, jnp.diag(1 / spreads)])

    improve = lambda at: solve_least_squares(residual, at, inputs, _EXPLORING_STEPS)
    return jax.vmap(improve)(starts)
