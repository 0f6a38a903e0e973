"""Measured levels, what other channels make of their increments, and the causes that may part them.

Heading is the integral of yaw rate, position that of velocity. Differentiating the noisy
left side would drown everything in noise, so both sides are integrated: between two
neighbouring knots (instants one window apart) the measured increment should be the
predicted one. What remains is explained by *causes* (a bias, a delay, a current ...), each
a few parameters that are zero in a sound recording.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from diffsea.recordings.auditing.kinematics.noise import Levels, NoiseKinds, Whitener
from diffsea.statistics import is_significant, robust_regression


Parameters = dict[str, float]

_POINTS, _WHITENERS = 512, 8  # remembered of a comparison


@dataclasses.dataclass(frozen=True)
class Cause:
    """A way in which two sets of channels may disagree.

    The norm of its parameters is compared with `negligible`; parameters named in `beside`
    are fitted with them and not judged. A `gain` multiplies the prediction: noise in the
    prediction biases it towards zero, so it is believed only if the reverse regression
    agrees. `likely` is the sign that physics gives the parameter, if it does: the other is
    believed where nothing else will do. A cause is not added to complete any set in
    `excludes`. `starts` are values of its first parameter from which to begin besides zero: a
    latency of half a turn is not seen from there.
    """

    name: str
    parameters: tuple[str, ...]
    negligible: float
    gain: bool = False
    likely: int = 0
    beside: tuple[str, ...] = ()
    excludes: tuple[frozenset[str], ...] = ()
    starts: tuple[float, ...] = ()


@dataclasses.dataclass(frozen=True)
class KinematicComparison:
    """Measured levels, their prediction, and the causes that may part them.

    `times` (s) are the knots. `linked[i]` says whether the increment from knot i to i + 1 can be
    used. `ranges` are, by parameter, the increment with which derivatives are taken and the largest
    magnitude. `doubt` is the standard deviation that the gain is allowed in every
    test of another cause: noise in the prediction shrinks it a little, and that must not pass
    for, say, a bias in a steady turn. A cause whose whole effect on the levels is below `floor`
    (root mean square) is not named. `walk` (levels squared per second) is the random walk that
    noise of the predicting channels makes of their integral. A delay that grows is counted from
    `middle` (s). `level` is how improbable by chance a cause must be to be believed.
    """

    times: Float[np.ndarray, "knot"]
    measured: Levels
    predict: Callable[[Parameters], Levels]
    linked: Bool[np.ndarray, "window"]
    causes: tuple[Cause, ...]
    ranges: dict[str, tuple[float, float]]
    doubt: float
    floor: float
    walk: float
    middle: float
    level: float

    @functools.cached_property
    def noise_kinds(self) -> NoiseKinds:
        """The kinds of noise at the knots."""
        return NoiseKinds(self.times, self.linked)

    @functools.cached_property
    def _levels_at(self) -> Callable[[frozenset[tuple[str, float]]], Levels]:
        return functools.lru_cache(_POINTS)(lambda point: self.predict(dict(point)))

    @functools.cached_property
    def _whitener_at(self) -> Callable[[frozenset[tuple[str, float]]], Whitener]:
        return functools.lru_cache(_WHITENERS)(lambda point: self._estimated_noise(dict(point)))

    def predicted(self, theta: Parameters) -> Levels:
        """The levels as `predict` has them; causes are tried in turn from the same points."""
        return self._levels_at(frozenset(theta.items()))

    def residual(self, theta: Parameters) -> Float[np.ndarray, "series window"]:
        """Measured less predicted increments."""
        return np.diff(self.measured - self.predicted(theta), axis=-1)

    def jacobian(
        self, theta: Parameters, names: Sequence[str]
    ) -> Float[np.ndarray, "parameter series window"]:
        """d(predicted increments) / d(parameter), by central differences."""
        columns = []
        for name in names:
            step, _ = self.ranges[name]
            ahead = self.predicted(theta | {name: theta[name] + step})
            behind = self.predicted(theta | {name: theta[name] - step})
            columns.append(np.diff(ahead - behind, axis=-1) / (2 * step))
        return np.array(columns)

    def whitener(self, theta: Parameters) -> Whitener:
        """By the noise that is left when every cause is allowed for at once.

        From the residual of the present model it would swallow what has not been found yet. A
        gain that is not established stays out: it would take the noise of the prediction away.
        """
        return self._whitener_at(frozenset(theta.items()))

    def _estimated_noise(self, theta: Parameters) -> Whitener:
        allowed = [c for c in self.causes if not c.gain or theta[c.parameters[0]] != 0]
        names = parameter_names(allowed)
        levels = self.measured - self.predicted(theta)
        known = (self.noise_kinds, 0.3 * self.floor, self.walk)
        jacobian = self.jacobian(theta, names)
        for _ in range(2):
            white = Whitener(levels, *known)
            estimate, _ = robust_regression(white(jacobian), white(np.diff(levels, axis=-1)))
            fitted = np.tensordot(estimate, jacobian, 1)
            rest = np.cumsum(np.diff(levels, axis=-1) - fitted, axis=-1)
            levels = np.concatenate([np.zeros((len(rest), 1)), rest], axis=-1)
        return Whitener(levels, *known)

    def significant(self, estimate: Float[np.ndarray, "p"], cov: Float[np.ndarray, "p p"]) -> bool:
        """Whether it is beyond chance; no more than one window per two seconds is independent."""
        windows = int(np.sum(self.linked))
        duration = self.times[-1] - self.times[0]
        freedom = max(min(windows, 0.5 * duration) - 8.0, 4.0)
        return is_significant(estimate, cov, freedom, self.level)


def parameter_names(causes: Sequence[Cause]) -> list[str]:
    """Parameters of these causes and of what is fitted beside them, each once."""
    names = [name for cause in causes for name in (*cause.beside, *cause.parameters)]
    return list(dict.fromkeys(names))
