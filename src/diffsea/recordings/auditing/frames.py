"""Frames, signs and units: which reading of the labels makes the motion consistent?

Wrong labels come as alternatives, not as numbers: body or earth axes, x north or east,
heading clockwise or not, degrees or radians. Every combination of such readings is tried;
where one with few changes explains the displacements far better than the labels do, it is
reported and applied, so that the finer comparisons start from motion that makes sense. Units and
the sign of yaw rate then follow from the ratio of measured to integrated motion.

A complete set of x east, y north, z up (heading from east, velocity to port, yaw rate
to port) is as consistent as north, east, down: only the response to rudder or thrust tells.
"""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Complex, Float

from diffsea.recordings.auditing.axes import AxesEvidence, axes_evidence, told_by
from diffsea.recordings.auditing.edits import Affine, BodyAxes, ChannelEdit, Edit, Swap
from diffsea.recordings.auditing.finding import (
    Finding,
    exchanged_channels,
    in_degrees,
    words_and_names,
    wrong_sign,
    wrong_unit,
)
from diffsea.recordings.motion import MeasuredMotion, windows
from diffsea.series import integrate
from diffsea.trajectory import Samples


_NEAR_UNIT = 0.05  # logarithm: how close a ratio must be to that of two units
_CLEARLY_WRONG = 0.03  # share of squared displacement that the labels leave unexplained
_BETTER = 0.25  # what share of that another reading may leave to be preferred
_AMONG_LEAST = 1.5  # times the least misfit of any reading, up to which one may be the right one
_GOOD = 0.2  # and what it may leave at most
_CHANGE = 1.0  # how much a changed label counts against a reading
_EXCHANGE = 1.2  # an exchange of two columns is a little less usual
_AGAINST_YAW_RATE = 1.1  # and so is a heading that turns against the yaw rate
_CORRELATED = 0.8  # heading and integrated yaw rate, for their ratio to mean anything
_MILLI = 1e-3

_Windowed = Complex[np.ndarray, "window"]  # displacements, north + i east

# displacement per integrated velocity -> channels in another unit, which, and its size in SI
_SPEED_UNITS = {
    1852 / 3600: (("u", "v"), "knots", "kn", 1852 / 3600),
    1 / 3.6: (("u", "v"), "km/h", "km/h", 1 / 3.6),
    0.3048: (("u", "v"), "ft/s", "ft/s", 0.3048),
    1 / 0.3048: (("x", "y"), "feet", "ft", 0.3048),
    100.0: (("x", "y"), "centimetres", "cm", 0.01),
    1e3: (("x", "y"), "millimetres", "mm", 1e-3),
    1e-3: (("x", "y"), "kilometres", "km", 1e3),
    1 / 1852: (("x", "y"), "nautical miles", "nmi", 1852.0),
}
# heading per integrated yaw rate -> the same
_RATE_UNITS = {
    np.pi / 180: (("r",), "deg/s, not in rad/s", "deg/s", np.pi / 180),
    180 / np.pi: (("psi",), "degrees, not in radians", "deg", np.pi / 180),
    _MILLI: (("t",), "milliseconds, not in seconds", "ms", 1e-3),
}


def _other_axes(message: str, repair: str, channels: tuple[str, ...], *edits: Edit) -> Finding:
    return Finding("axes", 0.0, 0.0, "1", message, repair, channels, edits=edits)


# Readings of the labels: none wrong, or one fault. Sizes are filled in once they are known; zero
# stands for how much of the displacement the labels leave unexplained.
_POSITIONS = (
    (),
    (exchanged_channels("x", "y", "the axes of the position are swapped: x is east and y north"),),
    (wrong_sign(("y",), "position east (y) is positive to the west (to port)", kind="axes"),),
    (wrong_sign(("x",), "position north (x) is positive to the south"),),
)
_ANTICLOCKWISE_FROM_EAST = _other_axes(
    "heading is counted counter-clockwise from east (ENU)",
    "psi = { ..., sign = -1, offset = -90 } with unit deg in the mapping",
    ("psi",),
    Affine(("psi",), -1.0, np.pi / 2),
)
_HEADINGS = (
    (),
    (wrong_sign(("psi",), "heading is positive to port (counter-clockwise)", kind="axes"),),
    (_ANTICLOCKWISE_FROM_EAST,),
    (in_degrees("psi", "heading is in degrees, not in radians"),),
)
_BODY_VELOCITIES = (
    (),
    (wrong_sign(("v",), "speed to starboard (v) is positive to port", kind="axes"),),
    (wrong_sign(("u",), "speed ahead (u) is positive astern"),),
    (wrong_sign(("u", "v"), "velocity (u, v) has the wrong sign"),),
    (exchanged_channels("u", "v", "speed ahead and speed to starboard (u, v) are swapped"),),
)
_IN_EARTH_AXES = (
    "velocity (u, v) is that {} (earth axes), not along the ship and to starboard",
    'velocity_axes = "earth" under [file] of the mapping',
)
_EARTH_VELOCITIES = tuple(
    (_other_axes(_IN_EARTH_AXES[0].format(axes), first + _IN_EARTH_AXES[1], ("u", "v"), *edits),)
    for axes, first, edits in (
        ("north and east", "", (BodyAxes(),)),
        ("east and north", "exchange their columns, and ", (Swap("u", "v"), BodyAxes())),
    )
)


@dataclasses.dataclass(frozen=True)
class LabelReading:
    """One reading of all labels, and how well displacements and velocities then agree.

    `misfit` is the share of squared displacement left by the best `scale` (displacement per
    integrated velocity, with its standard `error`); `labelled` is that share for the labels as
    they stand, with its standard error. `changes` counts what is read otherwise, `rivals` tells
    of other readings that explain the motion as well, and `why` what else speaks for this one.
    """

    faults: tuple[Finding, ...]
    misfit: float
    scale: float
    changes: float
    error: float = 0.0
    labelled: float = 0.0
    labelled_error: float = 0.0
    rivals: tuple[str, ...] = ()
    why: str = ""


def read_frames(
    motion: MeasuredMotion, others: Sequence[AxesEvidence] = ()
) -> tuple[MeasuredMotion, list[Finding]]:
    """Motion with its labels put right, and what was wrong with them.

    `others` are what other runs, recorded alike, tell of the axes of their velocities.

    A fault found by displacements has as its size the share of squared displacement that the
    labels leave unexplained, unless it has one of its own.
    """
    found: list[Finding] = []
    if motion.has("x", "y", "psi", "u", "v"):
        reading = _best_reading(motion, others)
        edits = (edit for fault in reading.faults for edit in fault.edits)
        motion = motion.with_channels(**_edited_channels(motion.values, edits))
        left = (
            f"; as labelled, velocity leaves {100 * reading.labelled:.2g} % of the squared "
            f"displacement unexplained, read so {100 * reading.misfit:.2g} %"
        )
        left += f"; {reading.why}" if reading.why else ""
        rivals = [f"as well possible: {rival}" for rival in reading.rivals]
        for fault in reading.faults:
            size = (fault.value, 0.0) if fault.value else (reading.labelled, reading.labelled_error)
            text, doubt = "; ".join([fault.message + left, *rivals]), " or ".join(rivals)
            fault = dataclasses.replace(fault, value=size[0], std=size[1], message=text)
            found.append(dataclasses.replace(fault, doubt=doubt))
        if reading.misfit <= _GOOD:
            motion, wrong = _speed_unit(motion, reading.scale, reading.error)
            found += wrong
    if motion.has("psi", "r"):
        motion, wrong = _yaw_rate_labels(motion)
        found += wrong
    return _clock_unit(motion, found)


def _edited_channels(values: dict[str, Samples], edits: Iterable[Edit]) -> dict[str, Samples]:
    for edit in edits:
        assert isinstance(edit, ChannelEdit)
        values = values | edit.new_series(values)
    return values


def _best_reading(motion: MeasuredMotion, others: Sequence[AxesEvidence]) -> LabelReading:
    """The labels as they are, unless another reading is far better; then the least changed."""
    start, end = windows(motion, ("x", "y", "psi", "u", "v"))
    turning, ratio, _ = _rate_fit(motion) if motion.has("psi", "r") else (0.0, 1.0, 0.0)
    readings = []
    for position, heading in itertools.product(_POSITIONS, _HEADINGS):
        edits = [edit for fault in (*position, *heading) for edit in fault.edits]
        read = motion.with_channels(**_edited_channels(motion.values, edits))
        moved = read.place[end] - read.place[start]
        mirrored = any(
            isinstance(edit, Affine) and edit.gain < 0 for fault in heading for edit in fault.edits
        )
        degrees = any(fault.kind == "unit" for fault in heading)
        against = turning * (-1 if mirrored else 1) < -0.5
        # Heading in degrees must have a yaw rate that is out by the same factor.
        against |= degrees and abs(turning) > 0.5 and ratio < 10
        velocities = _BODY_VELOCITIES if heading else _BODY_VELOCITIES + _EARTH_VELOCITIES
        for velocity in velocities:
            faults = (*position, *heading, *velocity)
            edits = [edit for fault in velocity for edit in fault.edits]
            in_axes = [edit for edit in edits if not isinstance(edit, BodyAxes)]
            seen = _edited_channels(read.values, in_axes)
            turn = 1.0 if len(in_axes) < len(edits) else np.exp(1j * read.values["psi"])
            path = integrate(motion.t, (seen["u"] + 1j * seen["v"]) * turn)
            misfit, scale = _scaled_misfit(moved, path[end] - path[start])
            changes = sum(
                _EXCHANGE if fault.kind == "swapped-channels" else _CHANGE for fault in faults
            )
            changes += _AGAINST_YAW_RATE * against
            readings.append(LabelReading(faults, misfit, scale, changes))
    found = _least_changed(motion, readings, start, end)
    return found if found.faults else _with_axes(motion, readings, found, others)


def _with_axes(
    motion: MeasuredMotion,
    readings: list[LabelReading],
    labelled: LabelReading,
    others: Sequence[AxesEvidence],
) -> LabelReading:
    """The labels as they are, or earth axes where the ratio of misfits, or other runs, say so.

    Earth axes must be among the readings of all labels that leave least of the displacement.
    """
    evidence = axes_evidence(motion)
    earth = next(reading for reading in readings if reading.faults == _EARTH_VELOCITIES[0])
    if earth.misfit > _AMONG_LEAST * min(reading.misfit for reading in readings):
        return labelled
    count = told_by(evidence, others)
    if evidence.tells == "earth":
        why = "displacements agree"
    elif count:
        why = f"this run alone does not tell clearly, but {count} recorded alike do; displacements "
        why += "agree"
    else:
        return labelled
    why += (
        f" to {evidence.earth:.2g} m/s with velocities in earth axes, to {evidence.ship:.2g} m/s "
        "with those along the ship"
    )
    size = _share_left(motion, labelled.scale)
    return dataclasses.replace(earth, labelled=size[0], labelled_error=size[1], why=why)


def _share_left(motion: MeasuredMotion, scale: float) -> tuple[float, float]:
    """Share of squared displacement that the labels leave, times `scale`, and its error."""
    start, end = windows(motion, ("x", "y", "psi", "u", "v"))
    path = integrate(motion.t, motion.earth_velocity)
    moved = motion.place[end] - motion.place[start]
    left = np.abs(moved - scale * (path[end] - path[start])) ** 2
    total = np.abs(moved) ** 2
    share = float(np.sum(left) / np.sum(total))
    return share, float(np.sqrt(np.sum((left - share * total) ** 2)) / np.sum(total))


def _scaled_misfit(moved: _Windowed, predicted: _Windowed) -> tuple[float, float]:
    """Share of squared displacement left by the best positive scale, and that scale."""
    total = np.sum(np.abs(moved) ** 2)
    power = np.sum(np.abs(predicted) ** 2)
    if total <= 0 or power <= 0:
        return 1.0, 1.0
    scale = float(np.real(np.sum(np.conj(predicted) * moved)) / power)
    if scale <= 0:
        return 1.0, 1.0
    return float(np.sum(np.abs(moved - scale * predicted) ** 2) / total), scale


def _least_changed(
    motion: MeasuredMotion, readings: list[LabelReading], start: np.ndarray, end: np.ndarray
) -> LabelReading:
    """The first reading, of the labels as they are, or the least changed of the far better ones.

    Another one must leave at most a quarter of the squared displacement that the labels leave
    even with an offset of heading and a current, and at most a fifth of all. `start` and `end` are
    the rows of the windows in which displacements are compared.
    """
    moved = motion.place[end] - motion.place[start]
    path = integrate(motion.t, motion.earth_velocity)
    predicted, seconds = path[end] - path[start], motion.t[end] - motion.t[start]
    own = _tolerant_misfit(moved, predicted, seconds)
    best = min(readings, key=lambda reading: reading.misfit)
    if own < _CLEARLY_WRONG or best.misfit > min(_GOOD, _BETTER * own):
        return dataclasses.replace(readings[0], error=_scale_error(readings[0], moved.size))
    good = [r for r in readings if r.misfit <= max(2 * best.misfit, best.misfit + 0.01)]
    good.sort(key=lambda reading: (reading.changes, reading.misfit))
    rivals = [
        " and ".join(fault.message for fault in reading.faults)
        for reading in good[1:3]
        if reading.changes < good[0].changes + 0.5
    ]
    share, error = _share_left(motion, readings[0].scale)
    return dataclasses.replace(
        good[0],
        error=_scale_error(good[0], moved.size),
        labelled=share,
        labelled_error=error,
        rivals=tuple(rivals),
    )


def _scale_error(reading: LabelReading, count: int) -> float:
    """Standard error of the scale from what it leaves; windows have two components each."""
    explained = max(1 - reading.misfit, 1e-12)
    return float(reading.scale * np.sqrt(reading.misfit / explained / max(2 * count - 1, 1)))


def _tolerant_misfit(
    moved: _Windowed, predicted: _Windowed, seconds: Float[np.ndarray, "window"]
) -> float:
    """Misfit of the labels when heading may be offset and a current may flow.

    Those are found more finely elsewhere, and must not make another reading look good. An
    offset above 60 degrees or a current of half the speed is not what this forgives.
    """
    total = np.sum(np.abs(moved) ** 2) + 1e-300
    best = _scaled_misfit(moved, predicted)[0]
    for columns in ([predicted], [predicted, seconds.astype(complex)]):
        matrix = np.stack(columns, axis=-1)
        gains = np.linalg.lstsq(matrix, moved, rcond=None)[0]
        speed = np.sqrt(np.mean(np.abs(moved / seconds) ** 2))
        if abs(np.angle(gains[0])) > np.pi / 3 or np.any(np.abs(gains[1:]) > 0.5 * speed):
            continue
        best = min(best, float(np.sum(np.abs(moved - matrix @ gains) ** 2) / total))
    return best


def _nearest_unit(ratio: float, known: Iterable[float]) -> float | None:
    return next((unit for unit in known if abs(np.log(ratio / unit)) < _NEAR_UNIT), None)


def _speed_unit(
    motion: MeasuredMotion, scale: float, error: float
) -> tuple[MeasuredMotion, list[Finding]]:
    """Unit of velocities or positions: displacement is `scale` times the integrated velocity."""
    near = _nearest_unit(scale, _SPEED_UNITS)
    if near is None:
        return motion, []
    channels, name, unit, gain = _SPEED_UNITS[near]
    # Velocities are what is rescaled either way: only the comparison matters from here on.
    motion = motion.with_channels(u=near * motion.values["u"], v=near * motion.values["v"])
    text = (
        f"{words_and_names(*channels)} is in {name}: displacement is {scale:.4g} times the "
        "integrated velocity"
    )
    return motion, [wrong_unit(channels, unit, gain, text, scale, error)]


def _rate_fit(motion: MeasuredMotion) -> tuple[float, float, float]:
    """Correlation of heading increments with integrated yaw rate, their ratio and its error."""
    start, end = windows(motion, ("psi", "r"))
    psi, turned = motion.values["psi"], integrate(motion.t, motion.values["r"])
    left, right = psi[end] - psi[start], turned[end] - turned[start]
    power = np.sqrt(np.sum(left**2) * np.sum(right**2))
    if left.size < 10 or power <= 0:
        return 0.0, 1.0, 0.0
    correlation = float(np.sum(left * right) / power)
    ratio = float(np.sqrt(np.sum(left**2) / np.sum(right**2)))
    return correlation, ratio, ratio * float(np.sqrt(max(1 - correlation**2, 0.0) / left.size))


def _yaw_rate_labels(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Sign and unit of yaw rate against heading, where the two are clearly correlated.

    The size of either finding is heading per integrated yaw rate, negative for a wrong sign.
    """
    correlation, ratio, error = _rate_fit(motion)
    if abs(correlation) < _CORRELATED:
        return motion, []
    found = []
    near = _nearest_unit(ratio, _RATE_UNITS)
    if near is not None:
        channels, name, unit, gain = _RATE_UNITS[near]
        text = (
            f"{words_and_names(*channels)} is in {name}: heading changes {ratio:.4g} times as fast "
            "as the yaw rate says"
        )
        found.append(wrong_unit(channels, unit, gain, text, ratio, error))
        motion = motion.with_channels(r=near * motion.values["r"])
    if correlation < 0:
        text = "yaw rate has the opposite sign of the rate of change of heading"
        found.append(wrong_sign(("r",), text, -ratio, error))
        motion = motion.with_channels(r=-motion.values["r"])
    return motion, found


def _clock_unit(
    motion: MeasuredMotion, found: list[Finding]
) -> tuple[MeasuredMotion, list[Finding]]:
    """Where velocity and yaw rate are off by the same thousand, the clock is.

    Velocity alone will do where a sample would be taken every ten seconds or less often.
    """
    late = [f for f in found if f.kind == "unit" and abs(f.value - _MILLI) < 1e-4]
    by_yaw = any(fault.channels == ("t",) for fault in late)
    if not late or not (by_yaw or motion.interval > 10.0):
        return motion, found
    rescaled = dataclasses.replace(motion, t=_MILLI * motion.t)
    scaled = [("r",)] * by_yaw + [("u", "v")] * any(f.channels == ("x", "y") for f in late)
    values = {name: 1e3 * motion.values[name] for names in scaled for name in names}
    channels, name, unit, gain = _RATE_UNITS[_MILLI]
    fault = wrong_unit(channels, unit, gain, f"time (t) is in {name}", _MILLI, late[0].std)
    return rescaled.with_channels(**values), [f for f in found if f not in late] + [fault]
