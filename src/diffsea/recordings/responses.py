"""Orders against response: does every actuator push the way its label says?

A rudder to starboard and more thrust to port than to starboard turn the vessel to starboard;
thrust ahead speeds it up. Yaw rate (or speed) is regressed on the actuation after a
first-order lag, the time constant being whatever fits best, and the sign must agree with
that of a regression of increments on actuation and on the motion itself: with feedback from
the motion to the actuator, the first alone could be cause and effect exchanged.
"""

import dataclasses

import numpy as np
from scipy import signal

from diffsea.recordings.edits import Affine, Swap
from diffsea.recordings.finding import Finding
from diffsea.recordings.motion import Motion
from diffsea.types import Series, Trajectory


_PORT = ("port", "left")
_STARBOARD = ("starboard", "stbd", "right")
_RUDDERS = ("rudder", "helm")
_PROPELLERS = ("propeller", "prop")
_EXPLAINED = 0.3  # share of the response's variance that the actuation must explain
_CERTAIN = 4.0  # standard errors


@dataclasses.dataclass(frozen=True)
class _Effect:
    """Response per unit of each actuation, how well it fits and how certain its sign is."""

    gains: np.ndarray
    explained: float
    certainty: float  # standard errors

    @property
    def sound(self) -> bool:
        return self.explained > _EXPLAINED and self.certainty > _CERTAIN


_NONE = _Effect(np.zeros(2), 0.0, 0.0)


def response_findings(trajectory: Trajectory, motion: Motion) -> list[Finding]:
    """Actuators that push the wrong way, and port exchanged with starboard.

    `motion` is the trajectory's motion with its own faults already put right.
    """
    findings = []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        series = {name: _on_clock(trajectory, motion, values) for name, values in group.items()}
        for name, values in series.items():
            findings += _rudder(motion, prefix + name, values) if _is(name, _RUDDERS) else []
            findings += _propeller(motion, prefix + name, values) if _is(name, _PROPELLERS) else []
        port = [name for name in series if _is(name, _PORT) and not _is(name, _RUDDERS)]
        starboard = [name for name in series if _is(name, _STARBOARD) and not _is(name, _RUDDERS)]
        if len(port) == len(starboard) == 1:
            names = (prefix + port[0], prefix + starboard[0])
            findings += _pair(motion, names, series[port[0]], series[starboard[0]])
    return findings


def _is(name: str, words: tuple[str, ...]) -> bool:
    return any(word in name.lower() for word in words)


def _on_clock(trajectory: Trajectory, motion: Motion, series: Series) -> np.ndarray:
    """The actuation at the motion's instants, held; what came before the first is the first."""
    valid = np.asarray(trajectory.valid, dtype=bool) & np.isfinite(np.asarray(series, dtype=float))
    count = np.asarray(trajectory.t)[np.asarray(trajectory.valid, dtype=bool)].size
    if not np.any(valid):
        return np.zeros(motion.t.size)
    values = np.asarray(series, dtype=float)[valid]
    share = np.arange(motion.t.size) * (count / motion.t.size)
    rows = np.flatnonzero(valid)
    place = np.searchsorted(rows, np.round(share), side="right") - 1
    return values[np.clip(place, 0, values.size - 1)]


def _rudder(motion: Motion, channel: str, angle: np.ndarray) -> list[Finding]:
    if not motion.has("r") or np.ptp(angle) < np.radians(4.0):
        return []
    effect = _effect(motion, "r", angle[None])
    if not effect.sound or effect.gains[0] > 0:
        return []
    return [
        _sign(
            channel,
            effect,
            f"positive {channel} turns the vessel to port ({_share(effect)} of the yaw rate's "
            "variance); or the whole record has its axes mirrored (x east, y north, heading "
            "counter-clockwise)",
        )
    ]


def _propeller(motion: Motion, channel: str, speed: np.ndarray) -> list[Finding]:
    if not motion.has("u") or np.ptp(speed) < 0.2 * np.max(np.abs(speed)):
        return []
    effect = _effect(motion, "u", speed[None])
    if not effect.sound or effect.gains[0] > 0:
        return []
    return [_sign(channel, effect, f"positive {channel} slows the vessel down")]


def _sign(channel: str, effect: _Effect, message: str) -> Finding:
    gain = float(effect.gains[0])
    return Finding(
        "sign",
        gain,
        abs(gain) / effect.certainty,
        "response per unit of actuation",
        message,
        f"{channel} = {{ ..., sign = -1 }} in the mapping",
        (channel,),
        edits=(Affine((channel,), -1.0),),
    )


def _pair(
    motion: Motion, names: tuple[str, str], port: np.ndarray, starboard: np.ndarray
) -> list[Finding]:
    """Exchanged or reversed thrusters either side of the centreline."""
    if not motion.has("r"):
        return []
    half, mean = 0.5 * (port - starboard), 0.5 * (port + starboard)
    # What is small beside the other may be no more than an error of a thrust table.
    yaw = _effect(motion, "r", half[None]) if np.ptp(half) > 0.2 * np.ptp(mean) else _NONE
    surge = _NONE
    if motion.has("u") and np.ptp(mean) > 0.2 * np.ptp(half):
        surge = _effect(motion, "u", mean[None])
    reversed_one = _reversed_one(motion, names, port, starboard, yaw)
    if reversed_one:
        return reversed_one
    if surge.sound and surge.gains[0] < 0:
        findings = [_sign(name, surge, f"positive {name} slows the vessel down") for name in names]
        return findings if yaw.gains[0] < 0 or not yaw.sound else findings + _swapped(names, yaw)
    return _swapped(names, yaw) if yaw.sound and yaw.gains[0] < 0 else []


def _swapped(names: tuple[str, str], yaw: _Effect) -> list[Finding]:
    gain = float(yaw.gains[0])
    return [
        Finding(
            "swapped-actuators",
            gain,
            abs(gain) / yaw.certainty,
            "rad/s per unit of half the difference",
            f"more {names[0]} than {names[1]} turns the vessel to port ({_share(yaw)} of the "
            "yaw rate's variance): the two are exchanged, or the whole record has its axes "
            "mirrored (x east, y north, heading counter-clockwise)",
            f"exchange the columns of {names[0]} and {names[1]} in the mapping",
            names,
            edits=(Swap(*names),),
        )
    ]


def _reversed_one(
    motion: Motion,
    names: tuple[str, str],
    port: np.ndarray,
    starboard: np.ndarray,
    yaw: _Effect,
) -> list[Finding]:
    """One of two thrusters reversed: the sum then turns and the difference speeds up."""
    both = np.stack([port, starboard])
    if np.min(np.ptp(both, axis=1)) <= 0 or not motion.has("u"):
        return []
    if abs(np.corrcoef(both)[0, 1]) > 0.9:
        return []
    turn, surge = _effect(motion, "r", both), _effect(motion, "u", both)
    if not (turn.sound and surge.sound) or turn.explained < yaw.explained + 0.2:
        return []
    signs = tuple(np.sign(turn.gains)), tuple(np.sign(surge.gains))
    wrong = {((-1, -1), (-1, 1)): 0, ((1, 1), (1, -1)): 1}.get(signs)
    if wrong is None:
        return []
    return [_sign(names[wrong], surge, f"positive {names[wrong]} pushes astern")]


def _share(effect: _Effect) -> str:
    return f"it explains {100 * effect.explained:.0f} %"


def _effect(motion: Motion, channel: str, actuation: np.ndarray) -> _Effect:
    """Response of a channel to lagged actuation, with the time constant that fits best."""
    known = motion.known[channel]
    response = motion.values[channel]
    dt = motion.interval
    if np.sum(known) < 40 or np.var(response[known]) <= 0 or np.any(np.ptp(actuation, 1) <= 0):
        return _NONE
    constants = np.geomspace(2 * dt, motion.t[-1] - motion.t[0], 14)
    fits = [
        _lagged_fit(response, _lagged(actuation, dt / constant), known) for constant in constants
    ]
    best = int(np.argmax([explained for _, explained, _ in fits]))
    gains, explained, rest = fits[best]
    # At the shortest lag the actuator follows the motion rather than the motion the actuator.
    if best == 0 or not _increments_agree(motion, channel, actuation, gains):
        return _NONE
    freedom = (motion.t[-1] - motion.t[0]) / (2 * _memory(rest) * dt)
    certainty = np.sqrt(max(explained, 0.0) / max(1 - explained, 1e-6) * freedom)
    return _Effect(gains, float(explained), float(certainty))


def _lagged(actuation: np.ndarray, ratio: float) -> np.ndarray:
    """First-order lag, by the sampling interval over the time constant."""
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
    motion: Motion, channel: str, actuation: np.ndarray, gains: np.ndarray
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
