"""Orders against response: does every actuator push the way its label says, or at all?

A rudder to starboard and more thrust to port than to starboard turn the vessel to starboard;
thrust ahead speeds it up. Yaw rate (or speed) is regressed on the actuation after a
first-order lag, the time constant being whatever fits best, and the sign must agree with
that of a regression of increments on actuation and on the motion itself: with feedback from
the motion to the actuator, the first alone could be cause and effect exchanged.

Where no response shows, a rudder that is reversed each time the heading has come round to a
limit is a zig-zag, and then it must go against the heading; an actuator that is moved a great
deal and explains nothing is dead.
"""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from diffsea.channels import is_rudder, side_of
from diffsea.pulses import are_pulses
from diffsea.recordings.auditing.edits import Affine, Swap
from diffsea.recordings.auditing.finding import Finding, finding_of, words_and_names, wrong_sign
from diffsea.recordings.auditing.thrust_axes import thrust_axes_findings
from diffsea.recordings.motion import MeasuredMotion
from diffsea.trajectory import Samples, Trajectory


_PROPELLERS = ("propeller", "prop", "engine")
_ANGLES = ("angle", "azimuth")

_EXPLAINED = 0.3  # share of the response's variance that the actuation must explain
_CERTAIN = 4.0  # standard errors
_SPREAD_OF_REVERSALS = 0.35  # relative, of the headings at which a zig-zag's rudder is reversed
_DEAD_RUDDER = 0.02  # share of the yaw rate's variance below which a rudder does nothing
_DEAD_THRUSTER = 0.3  # effect of a thruster, relative to its partner's, below which it is dead
_SMALLEST_ANGLE = np.radians(4.0)  # range of a rudder whose response is looked for
_BUSY_RUDDER = np.radians(16.0)  # range of a rudder that would turn the vessel if it moved
_ALONG = 0.9  # mean of +1 where a vessel goes the way its propeller turns, and -1 where it does not
_NOTABLE_SHARE = 0.2  # of thrust: less may be no more than an error of a thrust table

_MIRRORED = (
    "; or the whole record has its axes mirrored (x east, y north, heading counter-clockwise)"
)
_TURNS = "positive {channel} turns the vessel to {side}"
_SLOWS = "positive {channel} slows the vessel down"
_PUSHES_ASTERN = "positive {channel} pushes astern"
_UNITS = {"yaw": "rad/s per unit of actuation", "surge": "m/s per unit of actuation"}

_Actuation = Float[np.ndarray, "actuator time"]


@dataclasses.dataclass(frozen=True)
class LaggedResponse:
    """Response per unit of each actuation, how well it fits and how certain its sign is.

    `explained` is the share of the response's variance that the actuation explains; `errors` are
    the standard errors of the `gains`, the memory of the residual allowed for; `certainty` is in
    standard errors.
    """

    gains: Float[np.ndarray, "actuator"]
    errors: Float[np.ndarray, "actuator"]
    explained: float
    certainty: float

    @property
    def freedom(self) -> float:
        """Number of independent samples."""
        return self.certainty**2 * (1 - self.explained) / max(self.explained, 1e-6)

    @property
    def sound(self) -> bool:
        """Whether it explains enough, and surely."""
        return self.explained > _EXPLAINED and self.certainty > _CERTAIN


NO_RESPONSE = LaggedResponse(np.zeros(2), np.full(2, np.inf), 0.0, 0.0)


def response_to(
    motion: MeasuredMotion, channel: str, actuation: _Actuation, signs: bool = True
) -> LaggedResponse:
    """Response of a channel to lagged actuation, with the time constant that fits best.

    What cannot be believed is `NO_RESPONSE`; without `signs` it need not be confirmed by
    increments. As many samples count as independent as the run has correlation times of the
    residual, which is the lag at which half of it is forgotten.
    """
    known, response = motion.known[channel], motion.values[channel]
    if np.sum(known) < 40 or np.var(response[known]) <= 0 or np.any(np.ptp(actuation, 1) <= 0):
        return NO_RESPONSE
    fits = _lagged_fits(motion, channel, actuation)
    best = int(np.argmax([explained for _, explained, _, _ in fits]))
    gains, explained, rest, lagged = fits[best]
    # At the shortest lag the actuator follows the motion rather than the motion the actuator.
    if best == 0 or (signs and not _increments_agree(motion, channel, actuation, gains)):
        return NO_RESPONSE
    centred = rest - rest.mean()
    correlation = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * rest.size)) ** 2)[: rest.size]
    below = np.flatnonzero(correlation < 0.5 * correlation[0])
    memory = float(max(1, below[0] if below.size else rest.size))
    freedom = motion.duration / (2 * memory * motion.interval)
    certainty = np.sqrt(max(explained, 0.0) / max(1 - explained, 1e-6) * freedom)
    regressors = lagged[:, known]
    regressors = regressors - regressors.mean(axis=1, keepdims=True)
    covariance = np.linalg.pinv(regressors @ regressors.T / rest.size) * np.var(rest) / freedom
    return LaggedResponse(gains, np.sqrt(np.diag(covariance)), float(explained), float(certainty))


def _lagged_fits(
    motion: MeasuredMotion, channel: str, actuation: _Actuation
) -> list[tuple[np.ndarray, float, np.ndarray, _Actuation]]:
    """Gains, share explained, residual and lagged actuation, each for one time constant.

    Time constants go from two sampling intervals to the whole run.
    """
    from scipy import signal  # slow to import, and for recordings with actuators alone

    known, response, dt = motion.known[channel], motion.values[channel], motion.interval
    start, fits = actuation[:, :1], []
    for constant in np.geomspace(2 * dt, motion.duration, 14):
        share = 1 - np.exp(-(dt / constant))
        lagged = start + signal.lfilter([share], [1, share - 1], actuation - start, axis=1)
        matrix = np.vstack([lagged, np.ones_like(response)]).T[known]
        gains = np.linalg.lstsq(matrix, response[known], rcond=None)[0]
        rest = response[known] - matrix @ gains
        explained = float(1 - np.var(rest) / np.var(response[known]))
        fits.append((gains[:-1], explained, rest, lagged))
    return fits


def _increments_agree(
    motion: MeasuredMotion, channel: str, actuation: _Actuation, gains: np.ndarray
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


def with_yaw_rate(motion: MeasuredMotion) -> MeasuredMotion:
    """The motion, its heading differentiated where yaw rate was not measured."""
    if motion.has("r") or not motion.has("psi"):
        return motion
    rate = np.gradient(motion.values["psi"], motion.t)
    known = motion.known | {"r": motion.known["psi"]}
    return dataclasses.replace(motion.with_channels(r=rate), known=known)


def response_findings(trajectory: Trajectory, motion: MeasuredMotion) -> list[Finding]:
    """Actuators that push the wrong way or not at all, and port exchanged with starboard.

    `motion` is the trajectory's motion with its own faults already put right.
    """
    motion, found = with_yaw_rate(motion), []
    for prefix, group in (("cmd_", trajectory.commanded), ("exec_", trajectory.executed)):
        series = {
            prefix + name: on_motion_clock(trajectory, motion, s) for name, s in group.items()
        }
        found += _blame_mirrored_axes(_group_findings(motion, series))
        if not any(one.kind == "axes" for one in found):
            found += thrust_axes_findings(motion, series)
    return found


def on_motion_clock(
    trajectory: Trajectory, motion: MeasuredMotion, series: Float[Any, "row"]
) -> Samples:
    """The actuation at the motion's instants, held; what came before the first is the first."""
    counted = np.asarray(trajectory.valid, dtype=bool)
    values = np.asarray(series, dtype=float)
    rows = np.flatnonzero(counted & np.isfinite(values))
    if not rows.size:
        return np.zeros(motion.t.size)
    share = np.arange(motion.t.size) * (np.sum(counted) / motion.t.size)
    place = np.searchsorted(rows, np.round(share), side="right") - 1
    return values[rows][np.clip(place, 0, rows.size - 1)]


def _group_findings(motion: MeasuredMotion, series: dict[str, Samples]) -> list[Finding]:
    """Findings on either the commanded or the executed actuators, by their channels.

    A tunnel thruster pushes to starboard: at the bow that turns the vessel to starboard, at the
    stern to port.
    """
    found = []
    port, starboard = ([n for n in series if side_of(n) == side] for side in ("port", "starboard"))
    for name, values in series.items():
        stern = _has(name, ("stern",))
        if is_rudder(name):
            found += _rudder(motion, name, values, alone=not port)
        elif _has(name, _ANGLES):
            continue
        elif _has(name, ("bow",)) or (stern and _has(name, ("tunnel", "thruster"))):
            response = _response_of_one(motion, "r", values)
            if response.sound and response.gains[0] * (-1 if stern else 1) <= 0:
                side = "starboard" if stern else "port"
                text = _TURNS.format(channel=words_and_names(name), side=side)
                found.append(_reversed_actuator(name, response, "yaw", text))
        elif _has(name, _PROPELLERS):
            if np.ptp(values) < _NOTABLE_SHARE * np.max(np.abs(values)) or _drives(motion, values):
                continue
            response = _response_of_one(motion, "u", values)
            if response.sound and response.gains[0] <= 0:
                text = _SLOWS.format(channel=words_and_names(name))
                found.append(_reversed_actuator(name, response, "surge", text))
    if len(port) == len(starboard) == 1:
        names = (port[0], starboard[0])
        found += _thruster_pair(motion, names, series[port[0]], series[starboard[0]])
    return found


def _drives(motion: MeasuredMotion, values: Samples) -> bool:
    """Whether a vessel goes, nearly always, the way that a propeller turns.

    Then it pushes that way, whatever a regression makes of turns, in which speed falls and the
    shaft's does not.
    """
    if are_pulses(values) or not motion.has("u"):
        return False
    same = np.sign(values) * np.sign(motion.values["u"])
    return float(np.mean(same[motion.known["u"]])) > _ALONG


def _has(channel: str, words: tuple[str, ...]) -> bool:
    name = channel.removeprefix("cmd_").removeprefix("exec_").lower()
    return any(word in name for word in words)


def _response_of_one(motion: MeasuredMotion, channel: str, series: Samples) -> LaggedResponse:
    """Response to one actuator; none where the motion was not measured."""
    return response_to(motion, channel, series[None]) if motion.has(channel) else NO_RESPONSE


def _blame_mirrored_axes(found: list[Finding]) -> list[Finding]:
    """Where rudder and thrust both turn the vessel the wrong way, the motion is mirrored."""
    turning = [finding for finding in found if finding.axis == "yaw"]
    if {finding.kind for finding in turning} != {"sign", "swapped-actuators"}:
        return found
    first, channels = turning[0], ("y", "psi", "v", "r")
    size, edit = (first.value, first.std), Affine(channels, -1.0)
    mirrored = finding_of("mirrored-axes", channels, *size, {"unit": first.unit}, edit)
    return [finding for finding in found if finding not in turning] + [mirrored]


def _reversed_actuator(channel: str, response: LaggedResponse, axis: str, message: str) -> Finding:
    """An actuator that drives yaw or surge the wrong way; `value` is its gain."""
    gain = float(response.gains[0])
    std = abs(gain) / response.certainty
    return wrong_sign((channel,), message, gain, std, _UNITS[axis], axis=axis)


def _share_text(response: LaggedResponse) -> str:
    return f" (it explains {100 * response.explained:.0f} % of the yaw rate's variance)"


def _rudder(motion: MeasuredMotion, channel: str, angle: Samples, alone: bool) -> list[Finding]:
    """A rudder that turns the vessel the wrong way or, where nothing else steers, not at all."""
    if not motion.has("r") or np.ptp(angle) < _SMALLEST_ANGLE:
        return []
    response = response_to(motion, "r", angle[None])
    if response.sound and response.gains[0] < 0:
        turns = _TURNS.format(channel=words_and_names(channel), side="port")
        text = turns + _share_text(response) + _MIRRORED
        return [_reversed_actuator(channel, response, "yaw", text)]
    if response.sound:
        return []
    return zigzag_findings(motion, channel, angle) or (
        _dead_rudder(motion, channel, angle) if alone else []
    )


def _thruster_pair(
    motion: MeasuredMotion, names: tuple[str, str], port: Samples, starboard: Samples
) -> list[Finding]:
    """Exchanged, reversed or dead thrusters either side of the centreline."""
    if not motion.has("r"):
        return []
    half, mean = 0.5 * (port - starboard), 0.5 * (port + starboard)
    yaw = surge = NO_RESPONSE
    if np.ptp(half) > _NOTABLE_SHARE * np.ptp(mean):
        yaw = _response_of_one(motion, "r", half)
    if np.ptp(mean) > _NOTABLE_SHARE * np.ptp(half):
        surge = _response_of_one(motion, "u", mean)
    both = np.stack([port, starboard])
    one = _one_reversed_thruster(motion, names, both, yaw) or _dead_thruster(motion, names, both)
    if one:
        return one
    found = []
    if surge.sound and surge.gains[0] < 0:
        found = [
            _reversed_actuator(name, surge, "surge", _SLOWS.format(channel=words_and_names(name)))
            for name in names
        ]
    # Thrusters that are both reversed turn the vessel the wrong way as well.
    if yaw.sound and (yaw.gains[0] >= 0 if found else yaw.gains[0] < 0):
        gain = float(yaw.gains[0])
        size = gain, abs(gain) / yaw.certainty
        words = {"port": names[:1], "starboard": names[1:], "unit": _UNITS["yaw"]}
        words |= {"share": _share_text(yaw), "mirrored": _MIRRORED}
        fault = "swapped-actuators"
        found.append(finding_of(fault, names, *size, words, Swap(*names), axis="yaw"))
    return found


def _one_reversed_thruster(
    motion: MeasuredMotion, names: tuple[str, str], both: _Actuation, yaw: LaggedResponse
) -> list[Finding]:
    """One of two thrusters reversed: the sum then turns and the difference speeds up.

    Both are regressed at once, which needs thrusts that are not nearly proportional, and must
    explain a fifth more of the yaw rate's variance than their difference alone, `yaw`.
    """
    still = np.min(np.ptp(both, axis=1)) <= 0 or not motion.has("u")
    if still or abs(np.corrcoef(both)[0, 1]) > 0.9:
        return []
    turn, surge = response_to(motion, "r", both), response_to(motion, "u", both)
    signs = tuple(np.sign(turn.gains)), tuple(np.sign(surge.gains))
    wrong = {((-1, -1), (-1, 1)): 0, ((1, 1), (1, -1)): 1}.get(signs)
    sound = turn.sound and surge.sound and turn.explained >= yaw.explained + 0.2
    if not sound or wrong is None:
        return []
    text = _PUSHES_ASTERN.format(channel=words_and_names(names[wrong]))
    return [_reversed_actuator(names[wrong], surge, "surge", text)]


def zigzag_findings(motion: MeasuredMotion, channel: str, angle: Samples) -> list[Finding]:
    """A zig-zag whose rudder angle (rad) goes with the heading instead of against it.

    In a zig-zag the rudder is reversed at heading deviations of one size; the
    size of the finding is their mean (rad).
    """
    at = _reversals(angle)
    at = at[motion.known["psi"][at]]
    if not motion.has("psi") or at.size < 4:
        return []
    # An odd one out would shift the middle to its own side.
    middle = np.mean(motion.values["psi"][at[: at.size - at.size % 2]])
    reached = (motion.values["psi"][at] - middle) * np.sign(angle[at])  # negative where against
    error = float(np.std(reached) / np.sqrt(at.size))
    alike = np.std(reached) < _SPREAD_OF_REVERSALS * np.mean(reached)
    if not alike or np.mean(reached) < _CERTAIN * error or np.min(reached) <= 0:
        return []
    size = float(np.mean(reached))
    text = (
        f"the {at.size} reversals of {words_and_names(channel)} are those of a zig-zag of "
        f"{np.degrees(size):.3g} deg, but go with the heading, not against it{_MIRRORED}"
    )
    return [wrong_sign((channel,), text, size, error, "rad")]


def _reversals(angle: Samples) -> Int[np.ndarray, "reversal"]:
    """Rows in which a rudder goes over to the other side, from amplitude to amplitude."""
    side = np.where(np.abs(angle) > 0.5 * np.max(np.abs(angle)), np.sign(angle), 0.0)
    held = side[np.maximum.accumulate(np.where(side != 0, np.arange(side.size), 0))]
    return np.flatnonzero(held[1:] * held[:-1] < 0) + 1


def _dead_rudder(motion: MeasuredMotion, channel: str, angle: Samples) -> list[Finding]:
    """A rudder that is put over again and again under way and explains nothing.

    The size is the share of the yaw rate's variance that it explains behind any first-order lag.
    """
    if not motion.has("u") or np.ptp(angle) < _BUSY_RUDDER or _reversals(angle).size < 4:
        return []
    speed = np.abs(motion.values["u"])
    if np.median(speed) < 0.3 * np.max(speed):
        return []
    share = max(explained for _, explained, _, _ in _lagged_fits(motion, "r", angle[None]))
    if share > _DEAD_RUDDER:
        return []
    std = float(np.sqrt(share / motion.t.size))
    words = {"travel": np.degrees(np.ptp(angle)), "percent": 100 * share}
    return [finding_of("dead-rudder", (channel,), share, std, words)]


def _dead_thruster(
    motion: MeasuredMotion, names: tuple[str, str], both: _Actuation
) -> list[Finding]:
    """One of two thrusters without effect, while the other turns the vessel."""
    spans = np.ptp(both, axis=1)
    if not np.min(spans) > 0.3 * np.max(spans) or abs(np.corrcoef(both)[0, 1]) > 0.7:
        return []
    response = response_to(motion, "r", both, signs=False)
    if not response.sound:
        return []
    strong = int(np.argmax(np.abs(response.gains)))
    weak = 1 - strong
    # To port they turn the vessel one way, to starboard the other.
    share = -float(response.gains[weak] / response.gains[strong])
    error = float(response.errors[weak] / abs(response.gains[strong]))
    if abs(share) > 3 * error or abs(share) + 3 * error > _DEAD_THRUSTER:
        return []
    words = {"partner": (names[strong],)}
    return [finding_of("dead-thruster", (names[weak],), share, error, words)]
