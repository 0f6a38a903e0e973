"""Heading against thrust: frames that only forces can tell.

Velocities that were turned into body axes by a wrong heading agree with it and with the positions,
whatever it is. Thrust does not: it accelerates the vessel along axes that are fixed in the hull.
Every reading of the heading, by quarter turns and mirrored, is a hypothesis; what tells is how much
of the changes of earth-fixed velocity thrust then explains, beside damping and a steady force.

Thrusters that turn tell it. Fixed ones, and those that are hardly turned, push along one line, and
what a turning vessel does without thrust is too easily taken for their work under another heading.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Complex, Float

from diffsea.recordings.auditing.edits import Reheading
from diffsea.recordings.auditing.finding import Finding, finding_of
from diffsea.recordings.motion import MeasuredMotion
from diffsea.trajectory import Samples


_EXPLAINED = 0.1  # share of the changes' variance that thrust must explain, beside all else
_TURNED = 0.1  # share of the thrust's mean square that must be across the line it mostly acts along
_CLEAR = float(np.log(1e5))  # log likelihood ratio of two readings of the heading
_SPANS = 6  # lengths of time over which changes of velocity are taken
_LONGEST_SPAN = 0.1  # of the run
_FEWEST_WINDOWS = 30  # that share nothing
_DIRECTIONS = 4  # quarter turns: that many readings of either sense of rotation

Thrust = Complex[np.ndarray, "time"]  # forward + i to starboard, in whatever unit


@dataclasses.dataclass(frozen=True)
class HeadingReading:
    """A heading that was meant to be `sense` times the recorded one plus `offset` (rad)."""

    sense: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        """As a formula."""
        degrees = np.degrees(self.offset)
        return f"psi {degrees:+.0f} deg" if self.sense > 0 else f"{degrees:.0f} deg - psi"


AS_RECORDED = HeadingReading()
READINGS = tuple(
    HeadingReading(sense, 2 * np.pi * k / _DIRECTIONS)
    for sense in (1.0, -1.0)
    for k in range(1 - _DIRECTIONS // 2, _DIRECTIONS // 2 + 1)
)


def thrust_axes_findings(motion: MeasuredMotion, series: Mapping[str, Samples]) -> list[Finding]:
    """A heading that thrust contradicts, where another reading of it explains far more.

    Arguments:
        motion: on the clock of the `series`, its own faults put right.
        series: actuation by channel; `<name>.force` goes with `<name>.angle` (rad).
    """
    thrust = _azimuth_thrust(series)
    if thrust is None or not motion.has("psi", "u", "v") or _share_across(thrust) < _TURNED:
        return []
    fits = {reading: _fit_thrust(motion, thrust, reading) for reading in READINGS}
    best = max(fits, key=lambda reading: fits[reading].log_likelihood)
    gained = fits[best].log_likelihood - fits[AS_RECORDED].log_likelihood
    if best == AS_RECORDED or fits[best].explained < _EXPLAINED or not gained > _CLEAR:
        return []
    words = {
        "reading": best,
        "percent": 100 * fits[best].explained,
        "now": 100 * fits[AS_RECORDED].explained,
    }
    edit = Reheading(best.sense, best.offset)
    return [finding_of("heading-against-thrust", ("psi", "u", "v"), gained, 0.0, words, edit)]


def _azimuth_thrust(series: Mapping[str, Samples]) -> Thrust | None:
    """Thrust of all azimuth thrusters together; None where there are none."""
    names = [name.removesuffix(".force") for name in series if name.endswith(".force")]
    pushing = [
        series[f"{name}.force"] * np.exp(1j * series[f"{name}.angle"])
        for name in names
        if f"{name}.angle" in series
    ]
    return np.sum(pushing, axis=0) if pushing else None


def _share_across(thrust: Thrust) -> float:
    """Share of the thrust's mean square that is across its main line."""
    known = thrust[np.isfinite(thrust)]
    total, doubled = np.sum(np.abs(known) ** 2), np.abs(np.sum(known**2))
    return float(0.5 * (1 - doubled / total)) if total > 0 else 0.0


@dataclasses.dataclass(frozen=True)
class ThrustFit:
    """How well thrust explains changes of velocity under one reading of the heading.

    The log likelihood is over that of no force at all; `explained` is the share of what damping and
    a steady force leave. Thrust that would push backwards explains nothing.
    """

    log_likelihood: float
    explained: float


NO_FIT = ThrustFit(-np.inf, 0.0)


def _fit_thrust(motion: MeasuredMotion, thrust: Thrust, reading: HeadingReading) -> ThrustFit:
    """The fit over the span of time at which thrust explains most."""
    psi = motion.values["psi"]
    ahead = np.exp(1j * (reading.sense * psi + reading.offset))
    known = motion.known["psi"] & motion.known["u"] & motion.known["v"]
    dt, fits = motion.interval, []
    for span in np.geomspace(4 * dt, _LONGEST_SPAN * motion.duration, _SPANS):
        width = max(2, int(round(span / dt)))
        if psi.size >= _FEWEST_WINDOWS * width:
            fits.append(_fit_over(motion.earth_velocity, thrust, ahead, known, width))
    return max(fits, key=lambda fit: fit.log_likelihood, default=NO_FIT)


def _fit_over(
    velocity: Complex[np.ndarray, "time"],
    thrust: Thrust,
    ahead: Complex[np.ndarray, "time"],
    known: Bool[np.ndarray, "time"],
    width: int,
) -> ThrustFit:
    """Changes of earth-fixed velocity over `width` samples, regressed on what may make them."""
    body = velocity * np.conj(ahead)
    along, across = ahead, 1j * ahead
    steady = [np.ones_like(ahead), 1j * np.ones_like(ahead)]
    others = [along * np.real(body), across * np.imag(body), *steady]
    pushes = [along * np.real(thrust), across * np.imag(thrust)]
    sums = np.cumsum(np.array([*pushes, *others]), axis=1)
    regressors = (sums[:, width:] - sums[:, :-width]) / width
    changes = velocity[width:] - velocity[:-width]
    inside = np.cumsum(np.concatenate([[0], ~known]))
    whole = inside[width + 1 :] == inside[: -width - 1]
    X = np.concatenate([np.real(regressors), np.imag(regressors)], axis=1)[:, np.tile(whole, 2)].T
    y = np.concatenate([np.real(changes), np.imag(changes)])[np.tile(whole, 2)]
    moving = X.std(axis=0) > 0
    pushing = moving & (np.arange(X.shape[1]) < len(pushes))
    bare = _residual_variance(X[:, moving & ~pushing], y)
    slopes = np.linalg.lstsq(X[:, moving], y, rcond=None)[0]
    rest = float(np.mean((y - X[:, moving] @ slopes) ** 2))
    if not np.all(slopes[: int(pushing.sum())] > 0):
        rest = bare
    if not rest > 0:
        return NO_FIT
    independent = y.size / width  # numbers, two in every window
    return ThrustFit(-0.5 * independent * np.log(rest / np.mean(y**2)), 1 - rest / bare)


def _residual_variance(
    X: Float[np.ndarray, "value column"], y: Float[np.ndarray, "value"]
) -> float:
    return float(np.mean((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2))
