"""What every fit ends with: an estimate, its covariance, and how much of it is due to the data.

Fits work on coordinates that are zero where an effect is absent. `parameter_estimates` and
`parameter_records` give people and files SI units, standard errors and intervals instead.
"""

import dataclasses
import enum
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import norm

from diffsea.errors import UserError
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.kalman import FilterRun
from diffsea.identification.problem import Coordinates, FreeIndex, Problem
from diffsea.parameters import Parameter, parameter_meaning
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.tables import Table


INTERVAL_LEVEL = 0.9  # probability of the intervals that are reported
BOUND_SHARE = 0.01  # of the prior mean's distance to a bound: a number nearer than this is at it
ONE_SIDED_95 = float(norm.ppf(0.95))  # standard errors that one of twenty draws exceeds

ParameterRecord = dict[str, Any]  # value, std, unit


class FitOutcome(enum.Enum):
    """How the optimiser of a fit ended."""

    CONVERGED = "converged"
    STALLED = "stalled"
    BOUNDED = "bounded"
    STEP_LIMIT = "step limit"
    OUT_OF_TIME = "out of time"

    @property
    def sentence(self) -> str:
        """In words."""
        return _OUTCOMES[self]


_OUTCOMES = {
    FitOutcome.CONVERGED: "the fit converged",
    FitOutcome.STALLED: "the fit stalled: a step that should gain is no better than none",
    FitOutcome.BOUNDED: "the fit converged with a number at a bound of its prior",
    FitOutcome.STEP_LIMIT: "the fit ended at its last step, before it converged",
    FitOutcome.OUT_OF_TIME: "the time was over before the fit had converged",
}


@dataclasses.dataclass(frozen=True)
class ShootingState:
    """What output error estimates beside the coordinates: first states and misfits' scales.

    Units are those of the motion channels: m, rad, m/s, rad/s.
    """

    coordinates: Coordinates
    states: Float[np.ndarray, "window 6"]  # each window's first
    guess: Float[np.ndarray, "window 6"]  # what they were taken for beforehand
    sigma: Float[np.ndarray, "6"]  # standard deviations of the misfits
    joint: Float[np.ndarray, "6"]  # of the distance between windows that join


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Where a fit ended. Coordinates are those of `parameters.Parameter`, then of effects."""

    free: tuple[str, ...]
    coordinates: Coordinates
    deviance: float  # -2 log posterior, the priors of parameters and noise included
    index: FreeIndex  # which coordinates were free
    covariance: Float[np.ndarray, "free free"]
    information: Float[np.ndarray, "free free"]  # of the data alone
    precision: Float[np.ndarray, "free free"]  # of data and prior, misfits taken for white
    shrinkage: Float[np.ndarray, "free"]  # share that the data determine, 0 to 1
    inflation: float  # variance of the scores over the information, at least one
    state: Noise | ShootingState | None = None  # what the objective estimated besides
    path: tuple[float, ...] = ()  # the cost after each round
    outcome: FitOutcome = FitOutcome.CONVERGED
    left_out: Coordinates | None = None  # of the slope by gains held fixed; None: not known
    # Runs of the filter at this estimate, found when asked for; a changed copy has none of them.
    _filter_runs: list[tuple[Problem, FilterRun]] = dataclasses.field(
        init=False, default_factory=list, repr=False, compare=False
    )

    @property
    def stds(self) -> Float[np.ndarray, "free"]:
        """Standard errors of the free coordinates."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def noise(self) -> Noise:
        """Noise of the filter. Raises `UserError` where the objective has no filter."""
        if not isinstance(self.state, Noise):
            raise UserError("only a fit of the innovation likelihood has noise of a filter")
        return self.state

    def of_vessel(self, parameters: Sequence[Parameter]) -> dict[int, Parameter]:
        """The fitted ones of the vessel's parameters, by their position among what was free."""
        return {n: parameters[k] for n, k in enumerate(self.index) if k < len(parameters)}

    def filter_run(self, problem: Problem) -> FilterRun:
        """The filter's run along a problem's data at this estimate, calculated once."""
        for known, run in self._filter_runs:
            if known is problem:
                return run
        return self.keep_filter_run(problem, problem.run_filter(self.coordinates, self.noise))

    def keep_filter_run(self, problem: Problem, run: FilterRun) -> FilterRun:
        """Remember the filter's run at this estimate, which a fit has found on its way."""
        self._filter_runs.append((problem, run))
        return run


def posterior_estimate(
    free: tuple[str, ...],
    coordinates: Coordinates,
    deviance: float,
    index: FreeIndex,
    spreads: Coordinates,
    information: Float[np.ndarray, "free free"],
    score_variance: Float[np.ndarray, "free free"] | None = None,
    state: Noise | ShootingState | None = None,
    path: Sequence[float] = (),
    outcome: FitOutcome = FitOutcome.CONVERGED,
    left_out: Coordinates | None = None,
) -> Estimate:
    """An estimate from the information of the data and the spreads of the priors.

    `score_variance` is that of the score where misfits are not white (the middle of the
    sandwich): each standard error is the larger of the two. What rounding makes of an information
    that is far less in some directions than in others, asymmetric or negative, is not taken over.
    """
    information = _nearest_information(information, spreads[index])
    precision = information + np.diag(1 / spreads[index] ** 2)
    plain = np.linalg.inv(precision)
    plain = (plain + plain.T) / 2
    ratio = np.ones(len(index))
    if score_variance is not None:
        middle = score_variance + np.diag(1 / spreads[index] ** 2)
        ratio = np.maximum(np.diag(plain @ middle @ plain) / np.diag(plain), 1.0)
    widen = np.sqrt(ratio)
    return Estimate(
        free,
        coordinates,
        deviance,
        index,
        covariance=plain * np.outer(widen, widen),
        information=information,
        precision=precision,
        shrinkage=np.clip(1 - np.diag(plain) / spreads[index] ** 2, 0.0, 1.0),
        inflation=float(np.mean(ratio)),
        state=state,
        path=tuple(path),
        outcome=outcome,
        left_out=left_out,
    )


def _nearest_information(
    information: Float[np.ndarray, "free free"], spreads: Float[np.ndarray, "free"]
) -> Float[np.ndarray, "free free"]:
    """The nearest matrix that is an information, in units of the priors' spreads."""
    units = np.outer(spreads, spreads)
    scaled = (information + information.T) / 2 * units
    if not np.isfinite(scaled).all():
        return information
    values, vectors = np.linalg.eigh(scaled)
    if values.min(initial=0.0) >= 0:
        return scaled / units
    return (vectors * np.maximum(values, 0.0)) @ vectors.T / units


def is_at_bound(
    parameters: Sequence[Parameter], coordinates: Coordinates, index: FreeIndex
) -> bool:
    """Whether a free parameter has run into a bound of its prior, which it never quite reaches."""
    for k in index[index < len(parameters)]:
        parameter = parameters[k]
        value = float(parameter.decode(float(coordinates[k])))
        for bound in (parameter.lower, parameter.upper):
            if abs(value - bound) < BOUND_SHARE * abs(parameter.value - bound) < np.inf:
                return True
    return False


def normal_interval(parameter: Parameter, at: float, std: float) -> tuple[float, float]:
    """The central 90 % interval of a number whose coordinate is normal."""
    off = float(norm.ppf(0.5 + INTERVAL_LEVEL / 2)) * std
    low, high = sorted(float(parameter.decode(at + sign * off)) for sign in (-1.0, 1.0))
    return low, high


@dataclasses.dataclass(frozen=True)
class ParameterEstimate:
    """A fitted vessel parameter, in its own unit."""

    name: str
    meaning: str
    unit: str
    start: float  # the prior mean
    value: float
    std: float
    interval: tuple[float, float]  # 90 %
    determined: float  # share of the estimate that is due to the data, 0 to 1

    def as_dict(self) -> dict[str, object]:
        """The record of fit.json and diagnosis.json."""
        record: dict[str, object] = dataclasses.asdict(self)
        return record | {"interval": list(self.interval)}


def parameter_estimates(
    parameters: Sequence[Parameter], fitted: Estimate
) -> list[ParameterEstimate]:
    """The fitted ones among the vessel's parameters, in their order."""
    found = []
    for n, parameter in fitted.of_vessel(parameters).items():
        at, std = float(fitted.coordinates[fitted.index[n]]), float(fitted.stds[n])
        found.append(
            ParameterEstimate(
                parameter.name,
                parameter_meaning(parameter.name),
                parameter.unit,
                start=parameter.value,
                value=float(parameter.decode(at)),
                std=parameter.slope(at) * std,
                interval=normal_interval(parameter, at, std),
                determined=float(fitted.shrinkage[n]),
            )
        )
    return found


def parameter_records(
    problem: Problem, fitted: Estimate, name: str
) -> list[dict[str, ParameterRecord]]:
    """A fitted effect's parameters with standard errors, one dictionary for each instance.

    An instance is the effect itself, or that of one run where each has an environment of its own.
    Every parameter has `value`, `std` and `unit`, as `parameters_with_errors` says.
    """
    layout = problem.layout
    effect = next(e for e in layout.effects if e.name == name)
    sizes = np.array(layout.sizes[layout.effects.index(effect)])
    place = layout.slices[name]
    positions = [list(fitted.index).index(k) for k in range(place.start, place.stop)]
    covariance = fitted.covariance[np.ix_(positions, positions)]
    out = []
    for instance, values in enumerate(layout.physical(name, fitted.coordinates)):
        part = slice(instance * len(sizes), (instance + 1) * len(sizes))
        own = covariance[part, part] * np.outer(sizes, sizes)
        out.append(parameters_with_errors(problem.base, effect, values, own))
    return out


def parameters_with_errors(
    vessel: Vessel,
    effect: Effect,
    values: Float[np.ndarray, "coordinate"],
    covariance: Float[np.ndarray, "coordinate coordinate"],
) -> dict[str, ParameterRecord]:
    """Parameters of an effect from its coordinates and their covariance, in SI units.

    Standard errors by linear propagation. What is endless while the effect is absent (a rate
    limit, a depth) and not told from none has neither value nor error, but the `beyond` that it
    exceeds with a probability of 95 %.
    """
    units = {key: effect.place.unit_on(vessel, unit) for key, unit in effect.units.items()}
    absent = effect.decode(vessel, jnp.zeros(len(values)))
    error = ONE_SIDED_95 * math.sqrt(covariance[0, 0])
    endless = len(values) == 1 and not np.isfinite(list(absent.values())).all()
    if endless and not values[0] > error:
        beyond = effect.decode(vessel, jnp.array([max(values[0], 0.0) + error]))
        return {
            key: {"value": None, "std": None, "unit": unit, "beyond": float(beyond[key])}
            for key, unit in units.items()
        }

    def parameters(at: jax.Array) -> jax.Array:
        return jnp.stack([jnp.asarray(v) for v in effect.decode(vessel, at).values()])

    at = jnp.asarray(values)
    J = np.asarray(jax.jacfwd(parameters)(at))
    std = np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0))
    numbers = zip(units.items(), np.asarray(parameters(at)), std, strict=True)
    return {
        key: {"value": float(value), "std": float(spread), "unit": unit}
        if np.isfinite(value)
        else {"value": None, "std": None, "unit": unit}
        for (key, unit), value, spread in numbers
    }


def is_known(parameters: Mapping[str, ParameterRecord]) -> bool:
    """Whether the numbers of a reported effect are known: not those of one that is not seen."""
    return all(entry["value"] is not None for entry in parameters.values())


def effect_table(vessel: Vessel, name: str, parameters: Mapping[str, ParameterRecord]) -> Table:
    """An `[[effect]]` table for a vessel file: the values, and what the variant acts on.

    Reading it (`vessel.effects.with_effect`) attaches the effect as it was fitted, or, where an
    estimate lies beyond what a vessel can have by as much as it may err, at that end.
    """
    effect = EFFECTS[name]
    values = {key: float(entry["value"]) for key, entry in parameters.items()}
    coordinates = np.array(effect.encode(vessel, values), dtype=float)
    least, most = np.array(effect.bounds(vessel)).T
    possible = np.clip(coordinates, least, most)
    if np.any(possible != coordinates):
        values = {key: float(value) for key, value in effect.decode(vessel, possible).items()}
    return {"name": catalogue_name(name), **values, **effect.place.in_file(vessel)}
