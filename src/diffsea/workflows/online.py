"""Estimates of a vessel as it ran, how far they could be trusted, and what a gate passed."""

import dataclasses
import functools
import json
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from diffsea.errors import UserError
from diffsea.identification.data.dataset import make_dataset
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.noise_fit import noise_prior
from diffsea.identification.filter.noise_record import noise_of_record
from diffsea.identification.online.closed_spans import ClosedSpan, closed_spans
from diffsea.identification.online.estimator import (
    DRIFT,
    ESTIMATORS,
    usual_parameters,
    without_bounds,
)
from diffsea.identification.online.guarded import (
    OnlineRun,
    calibrate_limits,
    run_least_squares,
    run_online,
)
from diffsea.parameters import Parameter, named, parameter_meaning, parameter_unit
from diffsea.progress import Progress, Remark, counted, no_progress
from diffsea.recordings import Mapping as ColumnMapping
from diffsea.report.pages.online import online_report
from diffsea.simulation.order_units import with_usable_actuation
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import VesselFile
from diffsea.vessel.forces import moves_in_measured_wind
from diffsea.workflows.audits import Recording, Tabulated, as_recording, as_recordings
from diffsea.workflows.inputs import as_vessel_file, provenance


KEPT_DIGITS = 7  # of every number of online.json but the times


@dataclasses.dataclass(frozen=True, repr=False)
class OnlineResult(Tabulated):
    """An online estimator along a recording.

    `run` has estimates, standard errors, trust and what the gate passed, one value per row of the
    recording; `closed` are the times in which the gate was closed, with the reasons.
    """

    file: VesselFile
    recording: Trajectory
    run: OnlineRun
    settings: dict[str, Any]
    closed: list[ClosedSpan]

    def headline(self) -> str:
        share = float(self.run.open.mean())
        return (
            f"online estimates of {self.file.vessel.name} along {self.recording.name}: the gate "
            f"was open for {100 * share:.0f} % of {self.run.t[-1] - self.run.t[0]:.0f} s and is "
            f"{'open' if self.run.open[-1] else 'closed'} at the end"
        )

    def rows(self) -> list[dict[str, Any]]:
        nominal = named(self.file.vessel)
        return [
            {
                "symbol": name,
                "name": parameter_meaning(name),
                "unit": parameter_unit(name),
                "vessel file": float(nominal[name]),
                "last estimate": float(estimate[-1]),
                "+-": float(self.run.std[name][-1]),
                "passed by the gate": float(self.run.handed[name][-1]),
            }
            for name, estimate in self.run.estimate.items()
        ]

    def notes(self) -> list[str]:
        return [f"trust at the end: {self.run.trust[-1]:.2f}", *map(str, self.closed)]

    def record(self, interval: float = 0.0) -> dict[str, Any]:
        """The content of online.json.

        Arguments:
            interval: least time between the rows that are kept, s; the last is always among them.
        """
        kept = _rows_apart(self.run.t, interval)
        trust = _short(self.run.trust[kept])
        return {
            "format": 1,
            "vessel": self.file.vessel.name,
            "recording": self.recording.name,
            "settings": self.settings,
            "t": self.run.t[kept].tolist(),
            "trust": trust,
            "open": self.run.open[kept].tolist(),
            "estimates": {
                name: {
                    "unit": parameter_unit(name),
                    "nominal": float(named(self.file.vessel)[name]),
                    "value": _short(estimate[kept]),
                    "std": _short(self.run.std[name][kept]),
                    "trust": trust,
                    "passed": _short(self.run.handed[name][kept]),
                }
                for name, estimate in self.run.estimate.items()
            },
            "innovation_squared": _short(self.run.nis[kept]),
            "innovation_degrees": self.run.degrees[kept].tolist(),
            "closed": [dataclasses.asdict(span) for span in self.closed],
            "source": self.source(),
        }

    def source(self) -> dict[str, Any]:
        """What was run on what, with which settings."""
        return provenance(self.file, [self.recording], []) | {"settings": self.settings}

    def html(self) -> str:
        """The page."""
        return online_report(
            self.file.vessel, self.recording, self.run, self.rows(), self.closed, self.source()
        )


def online(
    vessel: VesselFile | str | pathlib.Path,
    recording: Recording,
    free: Sequence[str] | None = None,
    mapping: ColumnMapping | str | pathlib.Path | None = None,
    estimator: str = "kalman",
    drift: float | None = None,
    memory: float | None = None,
    noise: Noise | str | pathlib.Path | None = None,
    sound: Recording | Iterable[Recording] = (),
    progress: Progress = no_progress,
) -> OnlineResult:
    """Estimate a vessel's parameters along a recording, as `diffsea online` does.

    Nothing later than a row is used for its estimate, save for the size of the sensors' noise where
    it is neither given nor told by sound recordings: then it is read off the whole recording.

    Arguments:
        free: parameters to estimate; the hull's derivatives if None. The filter takes
            `current_north` and `current_east` too.
        estimator: `kalman`, or `least-squares` on the equations of motion.
        drift: random walk of the filter's parameters, as share of each one's prior mean per
            sqrt(s); `DRIFT` if None.
        memory: time constant with which least squares forget, s; they do not if None.
        noise: gust and sensor noise of the filter, or a fit.json that has them; guessed from
            recordings and the vessel's size if None.
        sound: recordings known to be sound, which tell the sensors' noise and by which the limits
            of the trust are widened.

    Raises:
        UserError: an unknown parameter or estimator, a setting of the other estimator, a file
            without noise, or recordings that cannot be read or do not suit the vessel.
    """
    file = as_vessel_file(vessel)
    given = as_recording(recording, mapping)
    known = as_recordings(sound, mapping)
    given, *known = with_usable_actuation(file.vessel, [given, *known])
    if moves_in_measured_wind(file.vessel.forces):
        progress(Remark("online no wind is measured: the vessel is estimated as in still air"))
    follow, settings = _estimator_along(file, free, estimator, drift, memory)
    if estimator == "kalman":
        guess = Noise.of(noise_prior(file.vessel, make_dataset(file.vessel, known or [given])).mean)
        told = isinstance(noise, str | pathlib.Path)
        follow.keywords["noise"] = noise_of_fit(noise, guess) if told else noise or guess
        settings["noise"] = str(noise) if told else "guessed" if noise is None else "given"
    elif noise is not None:
        raise UserError("noise does not belong to the estimator 'least-squares'; leave it out")
    limits = None
    if known:
        progress(f"calibrating trust by {counted(len(known), 'sound recording')}")
        limits = calibrate_limits([follow(one) for one in known])
    progress(f"estimating along {len(given.t)} rows")
    run = follow(given, limits=limits)
    if known:
        settings["calibrated_by"] = [one.name for one in known]
    return OnlineResult(file, given, run, settings, closed_spans(run))


def _estimator_along(
    file: VesselFile,
    free: Sequence[str] | None,
    estimator: str,
    drift: float | None,
    memory: float | None,
) -> tuple[functools.partial[OnlineRun], dict[str, Any]]:
    """What follows a recording, and the settings as they stand in online.json."""
    choice = _choice(file.vessel, free, file.priors)
    names = [one if isinstance(one, str) else one.name for one in choice]
    settings: dict[str, Any] = {"estimator": estimator, "free": names}
    other = {"kalman": ("memory", memory), "least-squares": ("drift", drift)}
    if estimator not in other:
        raise UserError(
            f"there is no estimator {estimator!r}; choose one of {', '.join(ESTIMATORS)}"
        )
    name, value = other[estimator]
    if value is not None:
        raise UserError(f"{name} does not belong to the estimator {estimator!r}; leave it out")
    if estimator == "kalman":
        settings["drift"] = DRIFT if drift is None else drift
        follow = functools.partial(run_online, file.vessel, free=choice, drift=settings["drift"])
    else:
        settings["memory"] = math.inf if memory is None else memory
        memory = settings["memory"]
        follow = functools.partial(run_least_squares, file.vessel, free=choice, memory=memory)
    return follow, settings


def noise_of_fit(path: str | pathlib.Path, guess: Noise) -> Noise:
    """Gust and sensor noise as `diffsea fit` wrote them.

    Arguments:
        guess: stands where the fit had no such sensor, or no positions that may wander.

    Raises:
        UserError: the file cannot be read, or has no noise.
    """
    try:
        record = json.loads(pathlib.Path(path).read_text(encoding="utf-8"))["noise"]
        return noise_of_record(record, guess)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise UserError(
            f"{path} has no noise as fit.json has it; fit by the objective innovation, or leave "
            "the noise out"
        ) from None


def _choice(
    vessel: Vessel, free: Sequence[str] | None, priors: Mapping[str, Parameter | None]
) -> list[str | Parameter]:
    """The parameters to estimate, with the vessel file's own priors where it has some.

    A prior keeps mean and standard deviation and loses its bounds, see `parameters_with_priors`.
    """
    if free is None:
        fixed = [name for name, prior in priors.items() if prior is None]
        free = [name for name in usual_parameters(vessel) if name not in fixed]
    own = ((name, priors.get(name)) for name in free)
    return [name if prior is None else without_bounds(prior) for name, prior in own]


def _rows_apart(t: np.ndarray, interval: float) -> np.ndarray:
    """Rows at least so many seconds after the one kept before, and the last row."""
    bins = np.floor((t - t[0]) / interval + 1e-9) if interval > 0 else np.arange(len(t))
    return np.union1d(np.flatnonzero(np.diff(bins, prepend=-1.0)), len(t) - 1)


def _short(values: np.ndarray) -> list[float]:
    return [float(f"{value:.{KEPT_DIGITS}g}") for value in values]
