"""Bursts of position: spans in which a receiver jumps about, against the velocity.

Position less integrated velocity wanders slowly where velocities have noise. A receiver that loses
satellites, or sees them by their echoes, throws positions off for some seconds and back. Such spans
stand out in the differences of that misfit, which elsewhere are those of noise.
"""

import math

import numpy as np
from jaxtyping import Bool, Complex, Float

from diffsea.recordings.auditing.edits import Blank
from diffsea.recordings.auditing.finding import Finding, finding_of
from diffsea.recordings.motion import MeasuredMotion
from diffsea.series import integrate, stretches
from diffsea.statistics import robust_scale
from diffsea.trajectory import Samples


_CHANNELS = ("x", "y", "psi", "u", "v")
_LAGS = (0.5, 1.5, 4.0)  # s over which jumps are looked for: a receiver recovers within seconds
_BY_CHANCE = 1e-5  # probability that noise alone makes one such jump anywhere in the run
# A tail heavier than normal: noise whose scale goes up and down by this factor is no burst.
_UNEVEN = 1.5
# Of the distance travelled: a velocity or a heading (rad) that is off by no more makes no burst.
_VELOCITY_ERROR = 0.15
_LEVER = 0.3  # m: twice the smallest lever arm that is named, which half a turn swings so far
_FEWEST_SAMPLES = 100
_FEWEST_IN_BURST = 3  # samples: fewer are single wild values
_MOST_OF_RUN = 0.3  # what is more usual than that is how the receiver is


def drop_bursts(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Motion without the spans in which positions jump about, and a finding if there are any.

    A span counts in which the misfit changes within 0.5, 1.5 or 4 s by more than noise of the
    usual scale ever would in a run of that length, and by more than a lever arm, and an error of
    velocity or heading over the distance travelled, would.
    """
    if not motion.has(*_CHANNELS) or motion.t.size < _FEWEST_SAMPLES:
        return motion, []
    known = np.all([motion.known[name] for name in _CHANNELS], axis=0)
    inside, scale = _jumping(motion, known)
    if not np.any(inside) or np.mean(inside) > _MOST_OF_RUN:
        return motion, []
    misfit = motion.path_misfit
    off = np.abs(misfit - _bridged(motion.t, misfit, inside))
    # Off by more than noise, and not only on the way to where it stays, as at a late start.
    beyond = _limit(motion.t.size) / _UNEVEN * scale
    spans = [s for s in stretches(inside) if s.stop - s.start >= _FEWEST_IN_BURST]
    spans = [span for span in spans if np.max(off[span]) > beyond]
    if not spans:
        return motion, []
    inside = np.zeros(inside.shape, dtype=bool)
    for span in spans:
        inside[span] = True
    largest = float(np.max(off[inside]))
    seconds = [float(motion.t[s.stop - 1] - motion.t[s.start]) for s in spans]
    times = tuple((float(motion.t[s.start]), float(motion.t[s.stop - 1])) for s in spans)
    words = {"count": len(spans), "seconds": sum(seconds), "start": times[0][0]}
    words |= {"longest": max(seconds), "usual": scale}
    edit = Blank(("x", "y"), times)
    found = finding_of("bursts", ("x", "y"), largest, scale, words, edit)
    lost = {name: motion.known[name] & ~inside for name in ("x", "y")}
    place = _bridged(motion.t, motion.place, inside)
    values = motion.values | {"x": np.real(place), "y": np.imag(place)}
    return MeasuredMotion(motion.t, values, motion.known | lost), [found]


def _bridged(
    t: Samples, series: Complex[np.ndarray, "time"], inside: Bool[np.ndarray, "time"]
) -> Complex[np.ndarray, "time"]:
    """The series on straight lines across what is inside."""
    return np.interp(t, t[~inside], series[~inside])


def _jumping(
    motion: MeasuredMotion, known: Bool[np.ndarray, "time"]
) -> tuple[Bool[np.ndarray, "time"], float]:
    """Which samples lie in a burst, and the usual change (m) of the misfit over the first lag.

    What a late sensor and a lever arm explain of the changes is taken off first.
    """
    misfit, t = motion.path_misfit, motion.t
    travelled = integrate(t, np.abs(motion.earth_velocity))
    turn, inside, usual = np.exp(1j * motion.values["psi"]), np.zeros(t.shape, dtype=bool), 0.0
    for lag in _LAGS:
        rows = max(1, int(round(lag / motion.interval)))
        if 8 * rows > t.size:
            break
        causes = np.stack([motion.earth_velocity, turn, 1j * turn], axis=-1)
        causes, change = causes[rows:] - causes[:-rows], misfit[rows:] - misfit[:-rows]
        both = known[rows:] & known[:-rows]
        if np.sum(both) < _FEWEST_SAMPLES:
            break
        change = change - causes @ _real_gains(causes[both], change[both])
        parts = np.real(change[both]), np.imag(change[both])
        scale = math.hypot(*(robust_scale(part - np.median(part)) for part in parts)) / math.sqrt(2)
        usual = usual or scale
        room = _LEVER + _VELOCITY_ERROR * (travelled[rows:] - travelled[:-rows])
        far = np.abs(change - np.median(change[both])) - room > _limit(t.size) * scale
        for at in np.flatnonzero(far & both):
            inside[at : at + rows + 1] = True
    return _trimmed(misfit, inside, usual), usual


def _real_gains(
    causes: Complex[np.ndarray, "row cause"], change: Complex[np.ndarray, "row"]
) -> Float[np.ndarray, "cause"]:
    """Real gains with which the causes explain the change best."""
    matrix = np.concatenate([np.real(causes), np.imag(causes)])
    return np.linalg.lstsq(matrix, np.concatenate([np.real(change), np.imag(change)]), rcond=1e-9)[
        0
    ]


def _limit(count: int) -> float:
    """Standard deviations of a component that the length of two passes by chance in `count`."""
    return _UNEVEN * math.sqrt(-2 * math.log(_BY_CHANCE / (len(_LAGS) * count)))


def _trimmed(
    misfit: Complex[np.ndarray, "time"], inside: Bool[np.ndarray, "time"], usual: float
) -> Bool[np.ndarray, "time"]:
    """The stretches less their ends, where the misfit is still, or again, what it is outside."""
    kept = inside.copy()
    for span in stretches(inside):
        before, after = misfit[max(span.start - 1, 0)], misfit[min(span.stop, misfit.size - 1)]
        part = misfit[span]
        off = np.minimum(np.abs(part - before), np.abs(part - after)) > 3 * max(usual, 1e-12)
        rows = np.flatnonzero(off)
        if rows.size:
            kept[span.start : span.start + rows[0]] = False
            kept[span.start + rows[-1] + 1 : span.stop] = False
    return kept
