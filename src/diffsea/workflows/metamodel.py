"""Norrbin metamodels from logs of service: identified, cross-validated, asked for the ideal."""

import dataclasses
import math
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.metamodels.fit import COMMON_MOMENT, OWN_MOMENTS, NorrbinFit, Trials, identify
from diffsea.metamodels.ideal_zigzag import Zigzag, overshoots_with_std
from diffsea.metamodels.norrbin import in_degrees
from diffsea.metamodels.validation import (
    TrialPrediction,
    VesselComparison,
    compare_vessel,
    leave_one_out,
    overshoots_beyond,
    predict_trials,
)
from diffsea.metrics.repeats import mean_and_half_width
from diffsea.progress import Progress, counted, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.recordings.conditioning import cut
from diffsea.report.pages.metamodel import metamodel_report
from diffsea.series import integrate
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import VesselFile
from diffsea.workflows.audits import Recording, Tabulated, as_recordings
from diffsea.workflows.service_trials import (
    ServiceSearch,
    ServiceTrial,
    least_side_wind,
    search_logs,
)
from diffsea.workflows.trials import as_vessel


MOST = 12  # trials of a metamodel, as published
FEWEST = 4  # trials of a group, so that each is predicted by three others
BENCHMARK = 80.0  # per cent, above which a metamodel may serve as a benchmark
SIDES = {"starboard": 1.0, "port": -1.0}
ANGLE = math.radians(10.0)  # of the ideal zig-zag that turns are asked for, rudder and heading
STEPS = 2400  # of an ideal zig-zag
IDEAL_WINDOWS = 12.0  # that it may last
UNITS = {"a0": "rad/s^2", "a1": "1/s", "a2": "1/rad", "a3": "s/rad^2", "b": "1/s^2"}

_identify = eqx.filter_jit(identify)
_overshoots = eqx.filter_jit(overshoots_with_std)


class CorrectedAverage(NamedTuple):
    """Overshoots of repeated zig-zags (rad), as run and as the ideal trial would have shown.

    Each is a mean and the half-width of its 95 % interval by Student's t.
    """

    side: str
    number: int  # of the overshoot, from one
    trials: int
    measured: tuple[float, float]
    corrected: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Metamodel:
    """A metamodel of one group of trials.

    Attributes:
        used: what it was identified from; `others` of the group were not.
        crossed: each trial used, as predicted by the metamodel of all the others used.
        percent_of_others: fit to every trial of the group that was not used.
        asked: the ideal zig-zags, by side.
        ideal: their overshoots and standard errors (rad), by side.
        averages: none without zig-zags.
        dropped: of the others, those that were left out because they were followed worst.
        against: a vessel under the orders of the trials used; None where none is judged.
    """

    group: str
    used: list[ServiceTrial]
    others: list[ServiceTrial]
    trials: Trials
    fit: NorrbinFit
    crossed: TrialPrediction
    percent_of_others: np.ndarray
    asked: dict[str, Zigzag]
    ideal: dict[str, tuple[np.ndarray, np.ndarray]]
    averages: list[CorrectedAverage]
    dropped: list[ServiceTrial] = dataclasses.field(default_factory=list)
    against: VesselComparison | None = None

    @property
    def cross_validation(self) -> float:
        """Median fit of a trial by the metamodel of the others, per cent."""
        return float(np.median(self.crossed.percent))

    @property
    def std(self) -> np.ndarray:
        """Standard errors of a_0, a_1, a_2, a_3, b, from the scatter between trials."""
        return np.sqrt(np.diag(np.asarray(self.fit.clustered)))

    def as_dict(self) -> dict[str, Any]:
        """The metamodel as it stands in metamodel.json."""
        model, std, degrees = self.fit.model, self.std, in_degrees(self.fit.model)
        values = np.asarray(model.coefficients)
        rows = zip(UNITS.items(), values, std, strict=True)
        others = self.percent_of_others
        return {
            "group": self.group,
            "trials": len(self.used) + len(self.others),
            "used": [_trial_record(one) for one in self.used],
            "converged": bool(self.fit.converged),
            "coefficients": {
                name: {"value": float(value), "std": float(error), "unit": unit}
                for (name, unit), value, error in rows
            },
            "coefficients_in_degrees": {name: float(value) for name, value in degrees.items()},
            "gain": float(model.gain),
            "time_constant": float(model.time_constant),
            "neutral": float(model.neutral),
            "cross_validation": {
                "each": np.asarray(self.crossed.percent).tolist(),
                "median": self.cross_validation,
                "others": {
                    "trials": len(others),
                    "median": float(np.median(others)) if len(others) else None,
                },
            },
            "dropped": [_trial_record(one) for one in self.dropped],
            "against": None if self.against is None else _against_record(self.against),
            "ideal": {
                side: {
                    "angle": self.asked[side].angle,
                    "heading": self.asked[side].heading,
                    "overshoots": values.tolist(),
                    "std": errors.tolist(),
                }
                for side, (values, errors) in self.ideal.items()
            },
            "corrected_averages": [
                {
                    "side": one.side,
                    "overshoot": one.number,
                    "trials": one.trials,
                    "measured": {"mean": one.measured[0], "half_width": one.measured[1]},
                    "corrected": {"mean": one.corrected[0], "half_width": one.corrected[1]},
                }
                for one in self.averages
            ],
        }


def _against_record(found: VesselComparison) -> dict[str, Any]:
    told = {"metamodel": found.of_metamodel, "measured": found.of_measured}
    return {
        key: {"each": values.tolist(), "median": float(np.median(values))}
        for key, values in told.items()
    }


def _trial_record(trial: ServiceTrial) -> dict[str, Any]:
    return {
        "log": trial.log,
        "start": trial.start,
        "end": trial.end,
        "side_wind": trial.side_wind,
    }


@dataclasses.dataclass(frozen=True, repr=False)
class MetamodelResult(Tabulated):
    """Metamodels of the groups of trials that logs of service have.

    `search` has the groups, and what was left out; `settings` what was asked for.
    """

    search: ServiceSearch
    models: list[Metamodel]
    logs: list[Trajectory]
    settings: dict[str, Any]

    def headline(self) -> str:
        count = sum(map(len, self.search.groups.values()))
        return (
            f"{counted(len(self.models), 'metamodel')} from {counted(count, 'trial')} in "
            f"{len(self.logs) - len(self.search.excluded)} of {counted(len(self.logs), 'log')}"
        )

    def rows(self) -> list[dict[str, Any]]:
        rows = []
        for one in self.models:
            others = one.percent_of_others
            rows.append(
                {
                    "group": one.group,
                    "trials": len(one.used) + len(one.others),
                    "used": len(one.used),
                    "T (s)": float(one.fit.model.time_constant),
                    "K (1/s)": float(one.fit.model.gain),
                    "neutral (deg)": math.degrees(float(one.fit.model.neutral)),
                    "cross-validation (%)": one.cross_validation,
                    "not used (%)": float(np.median(others)) if len(others) else math.nan,
                }
            )
            if one.against is not None:
                rows[-1] |= {
                    "vessel by metamodel (%)": float(np.median(one.against.of_metamodel)),
                    "vessel by trials (%)": float(np.median(one.against.of_measured)),
                }
        return rows

    def notes(self) -> list[str]:
        told = [f"left out: {name}: {why}" for name, why in self.search.excluded.items()]
        least = FEWEST + self.settings["drop"]
        few = [name for name, trials in self.search.groups.items() if len(trials) < least]
        told += [f"fewer than {least} trials: {', '.join(few)}"] if few else []
        for one in self.models:
            if float(one.fit.model.b) < 0:
                told.append(
                    f"{one.group}: a positive angle turns to port; give the steering channel "
                    "`sign = -1` in the mapping"
                )
            if one.cross_validation < BENCHMARK:
                told.append(
                    f"{one.group}: {one.cross_validation:.0f} % in cross-validation is below "
                    f"{BENCHMARK:.0f} %: no benchmark for a simulation model"
                )
            if one.against is not None:
                told.append(self._judgement(one, one.against))
        return [*told, *self.search.notes]

    def _judgement(self, one: Metamodel, found: VesselComparison) -> str:
        """How well a vessel follows, beside how well the metamodel itself does."""
        follows = [np.median(percent) for percent in (found.of_metamodel, found.of_measured)]
        if not np.isfinite(follows).all():
            return f"{one.group}: {self.settings['against']} diverges under these orders"
        neutral = math.degrees(float(one.fit.model.neutral))
        return (
            f"{one.group}: {self.settings['against']} follows the metamodel to {follows[0]:.0f} % "
            f"and the trials to {follows[1]:.0f} %, which the metamodel of the others follows to "
            f"{one.cross_validation:.0f} %; it has the rudder as recorded, neutral at "
            f"{neutral:.2g} deg"
        )

    def record(self) -> dict[str, Any]:
        """The content of metamodel.json."""
        found = self.search
        counts = {run.name: 0 for run in self.logs}
        for trials in found.groups.values():
            for one in trials:
                counts[one.log] += 1
        return {
            "format": 1,
            "settings": self.settings,
            "window": found.window,
            "interval": found.interval,
            "logs": [
                {"log": name, "trials": count, "excluded": found.excluded.get(name)}
                for name, count in counts.items()
            ],
            "groups": {name: len(trials) for name, trials in found.groups.items()},
            "metamodels": [one.as_dict() for one in self.models],
            "notes": self.notes(),
        }

    def html(self) -> str:
        """The page."""
        return metamodel_report(self.record(), self.headline(), self.models, self.logs)


def metamodel(
    logs: Recording | Iterable[Recording],
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    vessel: Vessel | VesselFile | str | pathlib.Path | None = None,
    window: float | None = None,
    most: int = MOST,
    own_moments: bool = False,
    zigzag: Zigzag | None = None,
    progress: Progress = no_progress,
    drop: int = 0,
    against: Vessel | VesselFile | str | pathlib.Path | None = None,
) -> MetamodelResult:
    """Norrbin metamodels from logs of service, as `diffsea metamodel` makes them.

    Arguments:
        vessel: says which actuators steer, where their names do not, and how orders are answered.
        window: s in which the vessel turns by 90 deg at its fastest; as the logs show if None.
        most: trials of a metamodel, those with the least wind abeam.
        own_moments: whether each trial has a steady moment of its own, as of wind or trim.
        zigzag: the ideal trial to ask for, to either side; by default what was ordered, or 10/10
            of turns.
        drop: so many of these trials, those that the metamodel of all of them follows worst, are
            left out and count among those not used.
        against: a vessel that is judged by the metamodels under the orders of their trials.

    Raises:
        UserError: logs that cannot be read, no group with enough trials, or no orders for an
            actuator of the vessel that is judged.
    """
    if drop < 0:
        raise UserError(f"{drop} trials cannot be dropped")
    if most - drop < FEWEST:
        less = f" less {drop} dropped" if drop else ""
        raise UserError(f"a metamodel needs {FEWEST} trials or more, not {most}{less}")
    judged = None if against is None else as_vessel(against)
    runs = _named_apart(as_recordings(logs, mapping))
    progress(f"looking for trials in {counted(len(runs), 'log')}")
    boat = None if vessel is None else as_vessel(vessel)
    found = search_logs(runs, boat, window)
    least = FEWEST + drop
    enough = {name: trials for name, trials in found.groups.items() if len(trials) >= least}
    if not enough:
        counts = ", ".join(f"{len(trials)} {name}" for name, trials in found.groups.items())
        needed = f"the {FEWEST} trials that a metamodel needs"
        needed += f" and {drop} to drop" if drop else ""
        raise UserError(
            f"no group has {needed}: found {counts}; give more "
            "logs, or set --window to the time of a quarter turn"
        )
    models = []
    for name, trials in enough.items():
        progress(f"identifying {name}: {min(most, len(trials))} of {len(trials)} trials")
        models.append(_metamodel(name, trials, found, most, own_moments, zigzag, drop))
    if judged is not None:
        progress(f"simulating {judged.name} under the orders of the trials")
        by_name = {run.name: run for run in runs}
        models = [_judging(one, judged, by_name) for one in models]
    settings = {
        "most": most,
        "drop": drop,
        "own_moments": own_moments,
        "vessel": None if boat is None else boat.name,
        "against": None if judged is None else judged.name,
    }
    return MetamodelResult(found, models, runs, settings)


def _metamodel(
    group: str,
    members: Sequence[ServiceTrial],
    found: ServiceSearch,
    most: int,
    own_moments: bool,
    zigzag: Zigzag | None,
    drop: int,
) -> Metamodel:
    """Identified from the calmest trials of a group, judged by each other and by the rest."""
    used, others = least_side_wind(members, most)
    tie = jnp.asarray(OWN_MOMENTS if own_moments else COMMON_MOMENT)
    trials = _padded(used, found.interval)
    fit, dropped = _identify(trials, tie), list[ServiceTrial]()
    if drop:
        followed = np.asarray(predict_trials(fit.model, trials).percent)
        worst = set(np.argsort(followed, kind="stable")[:drop].tolist())
        dropped = [one for k, one in enumerate(used) if k in worst]
        used = [one for k, one in enumerate(used) if k not in worst]
        others, trials = [*others, *dropped], _padded(used, found.interval)
        fit = _identify(trials, tie)
    percent = np.zeros(0)
    if others:
        percent = np.asarray(predict_trials(fit.model, _padded(others, found.interval)).percent)
    asked = {side: _asked(members, found.window, sign, zigzag) for side, sign in SIDES.items()}
    ideal = {}
    for side, wanted in asked.items():
        values, errors = _overshoots(fit.model, fit.clustered, wanted)
        ideal[side] = np.asarray(values), np.asarray(errors)
    crossed = leave_one_out(trials, tie)
    averages = _corrected_averages(used, fit, ideal)
    return Metamodel(
        group, used, others, trials, fit, crossed, percent, asked, ideal, averages, dropped
    )


def _named_apart(runs: Sequence[Trajectory]) -> list[Trajectory]:
    """The logs, those of one name numbered: trials say by its name which log they are of."""
    names = [run.name for run in runs]
    number = lambda k: f" ({names[: k + 1].count(names[k])})" if names.count(names[k]) > 1 else ""
    return [dataclasses.replace(run, name=f"{run.name}{number(k)}") for k, run in enumerate(runs)]


def _judging(one: Metamodel, vessel: Vessel, logs: dict[str, Trajectory]) -> Metamodel:
    """The metamodel with what it says of a vessel."""
    runs = [cut(logs[trial.log], trial.start, trial.end) for trial in one.used]
    starts = [trial.start for trial in one.used]
    found = compare_vessel(vessel, one.fit.model, one.trials, runs, starts)
    return dataclasses.replace(one, against=found)


def _padded(members: Sequence[ServiceTrial], interval: float) -> Trials:
    """The trials in one table; one shorter than the others is not known at its end."""
    most = max(len(one.t) for one in members)
    fill = lambda series, mode: np.pad(series, (0, most - len(series)), mode)
    delta = np.stack([fill(one.steer, "edge") for one in members])
    r = np.stack([fill(one.r, "constant") for one in members])
    known = np.stack([np.arange(most) < len(one.t) for one in members])
    return Trials(*(jnp.asarray(part) for part in (interval, delta, r, known)))


def _asked(
    members: Sequence[ServiceTrial], window: float, sign: float, zigzag: Zigzag | None
) -> Zigzag:
    """The ideal zig-zag to one side: as asked for, or what was ordered to whole degrees."""
    seconds = IDEAL_WINDOWS * window
    if zigzag is not None:
        return dataclasses.replace(zigzag, side=sign, seconds=seconds, step=seconds / STEPS)
    ordered = [one for one in members if one.zigzag is not None]
    angle = heading = ANGLE
    whole = lambda angles: math.radians(max(1.0, round(math.degrees(float(np.mean(angles))))))
    if ordered:
        angle = whole([one.zigzag.order for one in ordered if one.zigzag])
        heading = whole([_mark(one) for one in ordered])
    return Zigzag(angle, heading, sign, seconds=seconds, step=seconds / STEPS)


def _reversals(trial: ServiceTrial) -> tuple[tuple[float, ...], float, float]:
    """Times (s) of the first two reversals and of what ends the second, on the trial's clock;
    and the first side."""
    segment = trial.zigzag
    assert segment is not None
    times = [time - trial.start for time in segment.switches]
    end = times[3] if len(times) > 3 else segment.end - trial.start
    return tuple(times[1:3]), end, SIDES[segment.side or "starboard"]


def _mark(trial: ServiceTrial) -> float:
    """Heading (rad) off that of the onset at which the rudder was reversed, on average."""
    assert trial.zigzag is not None
    times, _, _ = _reversals(trial)
    psi = np.interp(times, trial.t, trial.psi)
    return float(np.mean(np.abs(psi - trial.zigzag.reference_heading)))


def _corrected_averages(
    used: Sequence[ServiceTrial], fit: NorrbinFit, ideal: dict[str, tuple[np.ndarray, np.ndarray]]
) -> list[CorrectedAverage]:
    """Measured overshoots, each moved by what its trial differs from the ideal by the metamodel."""
    measured: dict[str, list[np.ndarray]] = {side: [] for side in SIDES}
    shown: dict[str, list[np.ndarray]] = {side: [] for side in SIDES}
    for one, r in zip(used, np.asarray(fit.predicted), strict=True):
        if one.zigzag is None or one.zigzag.side is None:
            continue
        times, end, sign = _reversals(one)
        predicted = integrate(one.t, r[: len(one.t)])
        measured[one.zigzag.side].append(overshoots_beyond(one.t, one.psi, times, sign, end))
        shown[one.zigzag.side].append(overshoots_beyond(one.t, predicted, times, sign, end))
    out = []
    for side, rows in measured.items():
        if len(rows) < 2:
            continue
        table = np.array(rows)
        moved = table - np.array(shown[side]) + ideal[side][0]
        for k in range(table.shape[1]):
            means = mean_and_half_width(table[:, k]), _mean_of_known(moved[:, k])
            out.append(CorrectedAverage(side, k + 1, len(rows), *means))
    return out


def _mean_of_known(values: np.ndarray) -> tuple[float, float]:
    """Mean and half-width; not numbers where the ideal trial did not get as far."""
    if np.isfinite(values).sum() < 2:
        return math.nan, math.nan
    return mean_and_half_width(values)
