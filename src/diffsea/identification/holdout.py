"""Judging a model on runs that it did not see."""

import dataclasses
import enum
import functools
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.stats import t

from diffsea.budget import on_every_core
from diffsea.errors import UserError
from diffsea.identification.data.dataset import ANY_SHAPE, DatasetShape
from diffsea.identification.estimates import Estimate, ParameterRecord, parameter_records
from diffsea.identification.filter.correlated_errors import thin_channels
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.fit import Start, estimate, noise_at
from diffsea.identification.problem import (
    Coordinates,
    FurtherData,
    Problem,
    make_problem,
    vessel_in_environment,
)
from diffsea.recordings.conditioning import cut
from diffsea.statistics import block_sums
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS


TRAIN_SHARE = 0.7  # of each recording, where no test recordings are given
HEAD_SHARE = 0.4  # of a held-out recording, from which its own environment is estimated
ERROR_DEGREES = 10.0  # of freedom of one-step errors: more robust than normal ones, and no further
LEAST_BLOCK = 8  # rows whose gains count as one: two blocks tell how much they scatter


Value = TypeVar("Value")


class Gain(NamedTuple):
    """Predictive gain of one model over another on held-out data."""

    total: float  # difference of -2 log likelihood, positive where the second is better
    std: float  # from block sums

    @property
    def clear(self) -> bool:
        """Whether the gain is beyond two standard errors."""
        return self.total > 2 * self.std

    @property
    def open(self) -> bool:
        """Whether it may be a gain as well as a loss."""
        return abs(self.total) <= 2 * self.std

    @property
    def sure(self) -> float:
        """What of the gain or loss is beyond two standard errors; zero where it is open."""
        return float(np.sign(self.total) * max(abs(self.total) - 2 * self.std, 0.0))

    @classmethod
    def of_rows(cls, gains: Float[np.ndarray, "row"]) -> "Gain":
        """The gain from those of single rows; its error by the scatter between blocks of them."""
        sums = block_sums(gains[:, None], max(LEAST_BLOCK, len(gains) // 30))[:, 0]
        return cls(float(sums.sum()), float(np.std(sums, ddof=1) * np.sqrt(len(sums))))

    def pooled(self, other: "Gain") -> "Gain":
        """Both together, of data that share nothing."""
        return Gain(self.total + other.total, float(np.hypot(self.std, other.std)))


class HeldOut(enum.StrEnum):
    """What a split keeps back as a test."""

    RECORDINGS = "recordings"  # whole ones
    LAST_PARTS = "last parts"  # the end of every recording
    AFTER_HEAD = "after a first part"  # recordings but their `head`, which shows their environment


def thinned(problem: Problem, every: Mapping[str, int]) -> Problem:
    """The problem with one of so many samples of some channels used."""
    return dataclasses.replace(problem, dataset=thin_channels(problem.dataset, every))


class _Known(Generic[Value]):
    """What was calculated of models, once for each, whichever thread asks first."""

    def __init__(self):
        self._values: list[tuple[Estimate, Future[Value]]] = []
        self._lock = threading.Lock()

    def of(self, model: Estimate, make: Callable[[], Value]) -> Value:
        """What is known of a model, made and kept where nothing is."""
        with self._lock:
            found = next((value for other, value in self._values if other is model), None)
            value = Future[Value]() if found is None else found
            if found is None:
                self._values.append((model, value))
        if found is None:
            try:
                value.set_result(make())
            except BaseException as error:
                value.set_exception(error)
        return value.result()


@dataclasses.dataclass(frozen=True)
class Split:
    """Training and held-out data as problems of one kind.

    Where each recording has an environment of its own, that of a held-out recording is
    estimated on its `head`, and only the rest is held out.
    """

    train: Problem
    test: Problem
    head: Problem | None
    recordings: tuple[Trajectory, ...]
    held_out: tuple[Trajectory, ...]
    kind: HeldOut = HeldOut.RECORDINGS
    one_sample_in: Mapping[str, int] = dataclasses.field(default_factory=dict)  # used, by channel
    _deviances: "_Known[Float[np.ndarray, 'row']]" = dataclasses.field(
        init=False, default_factory=_Known, repr=False, compare=False
    )
    _exchanged_fits: "_Known[Estimate]" = dataclasses.field(
        init=False, default_factory=_Known, repr=False, compare=False
    )

    @functools.cached_property
    def exchanged(self) -> "Split":
        """The split with training and held-out data exchanged."""
        return dataclasses.replace(
            self, train=self.test, test=self.train, head=None, recordings=self.held_out,
            held_out=self.recordings,
        )  # fmt: skip

    def thinned(self, every: Mapping[str, int]) -> "Split":
        """The split with one of so many samples of some channels used, in all its parts."""

        return dataclasses.replace(
            self,
            train=thinned(self.train, every),
            test=thinned(self.test, every),
            head=None if self.head is None else thinned(self.head, every),
            one_sample_in=every,
        )

    def beside(self, further: FurtherData) -> "Split":
        """The split with the same further data beside each of its parts."""
        train, test, head = (
            None if one is None else dataclasses.replace(one, further=further)
            for one in (self.train, self.test, self.head)
        )
        assert train is not None and test is not None
        return dataclasses.replace(self, train=train, test=test, head=head)


def split_data(
    problem_of: Callable[[list[Trajectory], DatasetShape], Problem],
    recordings: list[Trajectory],
    test: list[Trajectory],
    per_run: bool,
) -> Split:
    """Hold out `test`, or the end of each recording where there is none.

    `problem_of` makes a problem from recordings on a dataset of at least some shape: all of
    one shape share their compiled programs. `per_run` says whether each recording has an
    environment of its own.

    Raises:
        UserError: too little is held out to judge anything on.
    """
    train, held_out, heads, kind = recordings, test, None, HeldOut.RECORDINGS
    if not test:
        (train, held_out), kind = cut_recordings(recordings, TRAIN_SHARE), HeldOut.LAST_PARTS
    elif per_run:
        (heads, held_out), kind = cut_recordings(test, HEAD_SHARE), HeldOut.AFTER_HEAD
    shape = ANY_SHAPE
    for _ in range(2):  # the number of batches, then that of their steps
        least = shape._replace(steps=0)
        shapes = [problem_of(runs, least).dataset.shape for runs in (train, held_out)]
        shape = shapes[0].both(shapes[1])
    train_problem, test_problem = (problem_of(runs, shape) for runs in (train, held_out))
    rows = int(test_problem.dataset.recorded_rows.sum())
    if rows < 2 * LEAST_BLOCK:
        raise UserError(
            f"only {rows} rows are held out to judge models on, at least {2 * LEAST_BLOCK} are "
            "needed: use longer recordings, or name whole ones with --test"
        )
    head = None if heads is None else problem_of(heads, shape)
    return Split(train_problem, test_problem, head, tuple(train), tuple(held_out), kind)


def cut_recordings(
    recordings: Sequence[Trajectory], share: float
) -> tuple[list[Trajectory], list[Trajectory]]:
    """Every recording in two at a share of its duration."""
    heads, tails = [], []
    for recording in recordings:
        times = np.asarray(recording.t)
        at = float(times[0] + share * (times[-1] - times[0]))
        heads.append(cut(recording, float(times[0]), at))
        tails.append(cut(recording, at, float(times[-1])))
    return heads, tails


def held_out_coordinates(split: Split, fitted: Estimate) -> Coordinates:
    """The fitted coordinates as coordinates of the held-out problem.

    An environment of its own is that of the same recording's earlier part: as fitted, or
    estimated on the head of a held-out recording with everything else fixed.
    """
    if split.head is None:
        return fitted.coordinates
    train, test = split.train.layout, split.test.layout
    out = np.zeros(test.size)
    out[: len(test.parameters)] = fitted.coordinates[: len(train.parameters)]
    own = []
    for effect in train.effects:
        if not effect.per_run:
            place = test.slices[effect.name]
            out[place] = fitted.coordinates[train.slices[effect.name]]
        elif effect.name in fitted.free:
            own.append(effect.name)
    if not own:
        return out
    start = Start(out, fitted.noise)
    return estimate(split.head, tuple(own), start, rounds=4, fixed_noise=True).coordinates


def row_deviance(
    problem: Problem, coordinates: Coordinates, noise: Noise
) -> Float[np.ndarray, "row"]:
    """-2 log likelihood of each row; NaN where the filter diverged.

    Innovations have Student's t of `ERROR_DEGREES` degrees of freedom and the variance that the
    filter states. By a normal density a few rows that miss by many standard deviations, a wave or
    an angle that turns the long way, would be nearly all that a comparison says; by the tails of
    the errors themselves the rows in which a manoeuvre shows what is missing would say nothing.
    """
    run = problem.run_filter(coordinates, noise)
    scale = np.sqrt(1 - 2 / ERROR_DEGREES)  # of unit variance
    density = t.logpdf(np.asarray(run.white), ERROR_DEGREES, scale=scale)
    values = np.log(np.asarray(run.variance)) - 2 * density
    return np.where(np.asarray(run.gains.used), values, 0.0).sum(1)


def held_out_deviance(split: Split, fitted: Estimate) -> Float[np.ndarray, "row"]:
    """-2 log likelihood of each held-out row by a model, calculated once.

    Gusts and noise are those of the held-out runs, estimated there: they are of a day, and no
    property of the vessel. By those of the runs that it was fitted to, the better a model explains
    these, the less it would allow to others, which are worse explained by any.
    """

    def there() -> Float[np.ndarray, "row"]:
        coordinates = held_out_coordinates(split, fitted)
        return row_deviance(
            split.test, coordinates, noise_at(split.test, coordinates, fitted.noise)
        )

    return split._deviances.of(fitted, there)


def held_out_gain(split: Split, nominal: Estimate, fitted: Estimate) -> Gain:
    """How much better `fitted` predicts the held-out runs than `nominal`: -2 log likelihood."""
    old, new = on_every_core(lambda model: held_out_deviance(split, model), (nominal, fitted))
    return Gain.of_rows((old - new)[split.test.dataset.recorded_rows])


def exchanged_fit(split: Split, model: Estimate) -> Estimate:
    """The model fitted anew to the held-out data, the training data of `split.exchanged`; once.

    Raises:
        ValueError: it has an environment of each recording's own, which runs that become held-out
            ones would lack.
    """
    if has_own_environment(split, model):
        raise ValueError("runs with environments of their own cannot change places")
    fit = lambda: estimate(split.exchanged.train, model.free, Start.of_other_data(model))
    return split._exchanged_fits.of(model, fit)


def has_own_environment(split: Split, fitted: Estimate) -> bool:
    """Whether a model has an environment of each recording's own."""
    return any(one.per_run and one.name in fitted.free for one in split.train.layout.effects)


def environment_from(
    vessel: Vessel, recording: Trajectory, seconds: float
) -> tuple[Vessel, Trajectory, dict[str, dict[str, ParameterRecord]]]:
    """The vessel in the environment of a run's first part, the rest of the run, and what it is.

    A current is estimated, and wind where the vessel has a superstructure for it, with all else
    of the vessel held fixed. Parameters by effect have value, standard error and unit.

    Raises:
        UserError: the run is not longer than that part, or the part has too few samples.
    """
    t = np.asarray(recording.t, float)
    split = float(t[0]) + seconds
    if not t[0] < split < t[-1]:
        raise UserError(
            f"{recording.name} lasts {t[-1] - t[0]:.4g} s: the environment cannot be estimated "
            f"from its first {seconds:g} s and the rest predicted; give fewer seconds"
        )
    names = ("current", "wind") if "wind" in vessel.forces else ("current",)
    effects = tuple(EFFECTS[name] for name in names)
    first, rest = cut(recording, float(t[0]), split), cut(recording, split, float(t[-1]))
    problem = make_problem(vessel, [first], (), effects)
    found = estimate(problem, names)
    there = vessel_in_environment(problem, found.coordinates)
    return there, rest, {name: parameter_records(problem, found, name)[0] for name in names}
