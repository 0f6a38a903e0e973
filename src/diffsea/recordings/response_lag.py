"""Responses of motion to actuation behind a first-order lag, with the certainty of their signs.

Yaw rate (or speed) is regressed on the actuation after a first-order lag, the time constant
being whatever fits best, and the signs must agree with those of a regression of increments on
actuation and on the motion itself: with feedback from the motion to the actuator, the first
alone could be cause and effect exchanged.
"""

import dataclasses

import numpy as np

from diffsea.recordings.motion import MeasuredMotion


_EXPLAINED = 0.3  # share of the response's variance that the actuation must explain
_CERTAIN = 4.0  # standard errors


@dataclasses.dataclass(frozen=True)
class LaggedResponse:
    """Response per unit of each actuation, how well it fits and how certain its sign is."""

    gains: np.ndarray
    errors: np.ndarray  # standard errors of the gains, the memory of the residual allowed for
    explained: float
    certainty: float  # standard errors

    @property
    def sound(self) -> bool:
        """Whether it explains enough, and surely."""
        return self.explained > _EXPLAINED and self.certainty > _CERTAIN


NO_RESPONSE = LaggedResponse(np.zeros(2), np.full(2, np.inf), 0.0, 0.0)


def response_to(
    motion: MeasuredMotion, channel: str, actuation: np.ndarray, signs: bool = True
) -> LaggedResponse:
    """Response of a channel to lagged actuation, with the time constant that fits best.

    `actuation` has the shape (actuators, time). What cannot be believed is `NONE`; without
    `signs` it need not be confirmed by increments.
    """
    known = motion.known[channel]
    response = motion.values[channel]
    dt = motion.interval
    if np.sum(known) < 40 or np.var(response[known]) <= 0 or np.any(np.ptp(actuation, 1) <= 0):
        return NO_RESPONSE
    constants = np.geomspace(2 * dt, motion.t[-1] - motion.t[0], 14)
    fits = [
        _lagged_fit(response, _lagged(actuation, dt / constant), known) for constant in constants
    ]
    best = int(np.argmax([explained for _, explained, _ in fits]))
    gains, explained, rest = fits[best]
    # At the shortest lag the actuator follows the motion rather than the motion the actuator.
    agree = not signs or _increments_agree(motion, channel, actuation, gains)
    if best == 0 or not agree:
        return NO_RESPONSE
    freedom = (motion.t[-1] - motion.t[0]) / (2 * _memory(rest) * dt)
    certainty = np.sqrt(max(explained, 0.0) / max(1 - explained, 1e-6) * freedom)
    errors = _errors(_lagged(actuation, dt / constants[best])[:, known], rest, freedom)
    return LaggedResponse(gains, errors, float(explained), float(certainty))


def largest_explained_share(motion: MeasuredMotion, channel: str, actuation: np.ndarray) -> float:
    """Largest share of a channel's variance that actuation explains behind any lag."""
    known, response, dt = motion.known[channel], motion.values[channel], motion.interval
    constants = np.geomspace(2 * dt, motion.t[-1] - motion.t[0], 14)
    fits = [_lagged_fit(response, _lagged(actuation, dt / value), known) for value in constants]
    return max(explained for _, explained, _ in fits)


def _errors(lagged: np.ndarray, rest: np.ndarray, freedom: float) -> np.ndarray:
    """Standard errors of the gains where only so many samples are independent."""
    centred = lagged - lagged.mean(axis=1, keepdims=True)
    covariance = np.linalg.pinv(centred @ centred.T / rest.size) * np.var(rest) / freedom
    return np.sqrt(np.diag(covariance))


def _lagged(actuation: np.ndarray, ratio: float) -> np.ndarray:
    """First-order lag, by the sampling interval over the time constant."""
    from scipy import signal  # slow to import, and for recordings with actuators alone

    share = 1 - np.exp(-ratio)
    start = actuation[:, :1]
    return start + signal.lfilter([share], [1, share - 1], actuation - start, axis=1)


def _lagged_fit(
    response: np.ndarray, lagged: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    matrix = np.vstack([lagged, np.ones_like(response)]).T[known]
    gains = np.linalg.lstsq(matrix, response[known], rcond=None)[0]
    rest = response[known] - matrix @ gains
    return gains[:-1], float(1 - np.var(rest) / np.var(response[known])), rest


def _memory(rest: np.ndarray) -> float:
    """Correlation time of a residual in samples: the lag at which half of it is forgotten."""
    centred = rest - rest.mean()
    power = np.abs(np.fft.rfft(centred, 2 * rest.size)) ** 2
    correlation = np.fft.irfft(power)[: rest.size]
    below = np.flatnonzero(correlation < 0.5 * correlation[0])
    return float(max(1, below[0] if below.size else rest.size))


def _increments_agree(
    motion: MeasuredMotion, channel: str, actuation: np.ndarray, gains: np.ndarray
) -> bool:
    """Whether increments over most spans confirm the signs, the motion itself allowed for."""
    response, dt = motion.values[channel], motion.interval
    votes = []
    for span in np.geomspace(2 * dt, 0.1 * (motion.t[-1] - motion.t[0]), 6):
        width = max(1, int(round(span / dt)))
        if 8 * width > response.size:
            continue
        sums = np.cumsum(np.vstack([actuation, response, np.ones_like(response)]), axis=1)
        matrix = (sums[:, width:] - sums[:, :-width]).T * dt
        target = response[width:] - response[:-width]
        slopes = np.linalg.lstsq(matrix, target, rcond=None)[0]
        if np.var(target - matrix @ slopes) > 0.95 * np.var(target):
            continue
        votes.append(np.all(np.sign(slopes[: len(gains)]) == np.sign(gains)))
    return len(votes) > 0 and float(np.mean(votes)) >= 0.6
