"""Whether u and v are along the ship or along earth axes, by the ratio of two misfits.

On a nearly straight track both readings explain nearly all of the displacement, and what they leave
is small; but where one leaves hundreds of times what the other does, that tells. Residuals of
displacements over windows are taken for noise whose correlation fades from window to window, so the
log likelihood ratio of the readings is n/2 log(s_ship / s_earth), s being what of the residuals'
variance (1 - rho^2) the window before does not foretell. What one run cannot tell, others may that
were recorded alike.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float

from diffsea.recordings.motion import MeasuredMotion, windows
from diffsea.series import integrate
from diffsea.statistics import noise_scale


_CLEAR = math.log(1e5)  # log odds from which on a run tells its axes
# And the ratio of misfits: what no one model of noise explains may double a misfit.
_TWICE = 2.0
_MOST_CORRELATED = 0.99  # of residuals one window apart
_LARGEST_OFFSET = np.radians(60.0)  # of a heading: beyond, axes are turned
_FEWEST_WINDOWS = 10
_FITTED = 5  # parameters of either reading

_Windowed = Complex[np.ndarray, "window"]  # displacements, north + i east


@dataclasses.dataclass(frozen=True)
class AxesEvidence:
    """How u and v of a run agree with its displacements, along the ship and along earth axes.

    Attributes:
        log_odds: log likelihood ratio of earth axes over the ship's.
        ship: root-mean-square residual (m/s) along the ship's axes.
        earth: the same along earth axes.
        noise: what white noise of all channels makes of either.
    """

    log_odds: float
    ship: float
    earth: float
    noise: float

    @property
    def ratio(self) -> float:
        """The ship's misfit over that of earth axes, less noise; a tenth of it is always left."""
        ship, earth = (one**2 - self.noise**2 for one in (self.ship, self.earth))
        least = (0.1 * self.noise) ** 2 + 1e-300
        return math.sqrt(max(ship, least) / max(earth, least))

    @property
    def leans(self) -> str:
        """`earth` or `ship` where the likelihood decides, by however little, else nothing."""
        return "earth" if self.log_odds > _CLEAR else "ship" if self.log_odds < -_CLEAR else ""

    @property
    def tells(self) -> str:
        """`earth` or `ship` where the run tells clearly, else nothing."""
        return self.leans if not 1 / _TWICE < self.ratio < _TWICE else ""


def told_by(own: AxesEvidence, others: Sequence[AxesEvidence]) -> int:
    """How many other runs tell earth axes to one that does not tell them clearly itself.

    One that leans to earth axes takes any, one that tells nothing only what all tell that do.
    """
    told = [one.tells for one in others]
    if own.tells or own.leans == "ship" or (not own.leans and "ship" in told):
        return 0
    return told.count("earth")


UNTOLD = AxesEvidence(0.0, 0.0, 0.0, 0.0)


def axes_evidence(motion: MeasuredMotion) -> AxesEvidence:
    """What one run tells of the axes of its velocities; nothing where it has too few channels.

    A current, a scale and late velocities are allowed for in both readings, an offset of the
    heading where that counts. Either leaves at least the white noise of all channels:
    displacements of earth velocities lack the noise of the heading.
    """
    channels = ("x", "y", "psi", "u", "v")
    if not motion.has(*channels):
        return UNTOLD
    start, end = windows(motion, channels)
    if start.size < _FEWEST_WINDOWS:
        return UNTOLD
    t, values = motion.t, motion.values
    moved, seconds = motion.place[end] - motion.place[start], t[end] - t[start]
    recorded = values["u"] + 1j * values["v"]
    speed = float(np.sqrt(np.mean(np.abs(recorded) ** 2)))
    rate = (noise_scale(values["u"]) + noise_scale(values["v"])) ** 2
    rate += (speed * noise_scale(values["psi"])) ** 2
    place = (noise_scale(values["x"]) + noise_scale(values["y"])) ** 2
    floor = place + rate * motion.interval * seconds
    rests = []
    for velocity, turned in ((motion.earth_velocity, True), (recorded, False)):
        path = integrate(t, velocity)
        swerve = velocity[end] - velocity[start]
        rests.append(_residual(moved, path[end] - path[start], swerve, seconds, turned))
    ship, earth = (float(np.sum(np.abs(rest) ** 2)) for rest in rests)
    new = (_unforetold(rest / seconds) for rest in rests)
    least = float(np.sum(floor)) + 1e-300
    left = [share * max(power, least) for share, power in zip(new, (ship, earth), strict=True)]
    odds = (moved.size - _FITTED / 2) * math.log(left[0] / left[1])
    sizes = [float(np.sqrt(np.mean(np.abs(rest / seconds) ** 2))) for rest in rests]
    return AxesEvidence(odds, sizes[0], sizes[1], float(np.sqrt(np.mean(floor / seconds**2))))


def _residual(
    moved: _Windowed,
    path: _Windowed,
    swerve: _Windowed,
    seconds: Float[np.ndarray, "window"],
    turned: bool,
) -> _Windowed:
    """What is left of displacements (m) by a velocity's path (m), with the usual nuisances.

    `swerve` (m/s) is how much the velocity changes over a window, by which a late one lags; a path
    that the heading has `turned` may be off by an angle.
    """
    power = float(np.sum(np.abs(path) ** 2)) + 1e-300
    gain = complex(np.sum(np.conj(path) * moved)) / power
    if not turned or abs(math.atan2(gain.imag, gain.real)) > _LARGEST_OFFSET:
        gain = complex(max(gain.real, 0.0))
    rest = moved - gain * path
    # With a free scale beside it, a current would turn the ship's axes into earth axes.
    columns = [seconds.astype(complex), 1j * seconds, gain * swerve]
    matrix = np.stack([np.concatenate([c.real, c.imag]) for c in columns], axis=1)
    target = np.concatenate([rest.real, rest.imag])
    left = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-9)[0]
    return left[: moved.size] + 1j * left[moved.size :]


def _unforetold(rest: _Windowed) -> float:
    """Share 1 - rho^2 of a residual's variance that the window before does not foretell."""
    power = float(np.sum(np.abs(rest) ** 2)) + 1e-300
    rho = float(np.real(np.sum(rest[1:] * np.conj(rest[:-1])))) / power
    return 1 - min(max(rho, 0.0), _MOST_CORRELATED) ** 2
