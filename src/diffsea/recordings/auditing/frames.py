"""Units of velocities, positions, yaw rate and time, and the sign of yaw rate, from kinematics.

Frames, signs and units: which reading of the labels makes the motion consistent?

Wrong labels come as alternatives, not as numbers: body or earth axes, x north or east,
heading clockwise or not, degrees or radians. Every combination of such readings is tried;
where one with few changes explains the displacements far better than the labels do, it is
reported and applied, so that the finer comparisons start from motion that makes sense.

A complete set of x east, y north, z up (heading from east, velocity to port, yaw rate
to port) is as consistent as north, east, down: only the response to rudder or thrust tells.
"""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from diffsea.recordings.auditing.edits import Affine, BodyAxes, Edit, Swap
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.motion import MeasuredMotion, windows
from diffsea.series import integrate


_NEAR_UNIT = 0.05  # how close a ratio must be to that of two units


def _relabelled(
    gain: float, channels: tuple[str, ...], message: str, unit: str, value: float, std: float
) -> Finding:
    """A wrong unit: the channels are in another, `gain` times SI; `value` is what was measured."""
    return Finding(
        "unit",
        value,
        std,
        "1",
        message,
        f'unit = "{unit}" for {" and ".join(channels)} in the mapping',
        channels,
        edits=(Affine(channels, gain, unit=unit),),
    )


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
    1e-3: (("t",), "milliseconds, not in seconds", "ms", 1e-3),
}


def _near(ratio: float, known: dict[float, tuple]) -> float | None:
    close = [unit for unit in known if abs(np.log(ratio / unit)) < _NEAR_UNIT]
    return close[0] if close else None


def speed_unit(
    motion: MeasuredMotion, scale: float, error: float
) -> tuple[MeasuredMotion, list[Finding]]:
    """Unit of velocities or positions: displacement is `scale` times the integrated velocity."""
    near = _near(scale, _SPEED_UNITS)
    if near is None:
        return motion, []
    channels, name, unit, gain = _SPEED_UNITS[near]
    # Velocities are what is rescaled either way: only the comparison matters from here on.
    values = motion.values
    motion = motion.with_channels(u=near * values["u"], v=near * values["v"])
    text = (
        f"{' and '.join(channels)} are in {name}: displacement is {scale:.4g} times the "
        "integrated velocity"
    )
    return motion, [_relabelled(gain, channels, text, unit, scale, error)]


def rate_fit(motion: MeasuredMotion) -> tuple[float, float, float]:
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


def yaw_rate(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Sign and unit of yaw rate against heading."""
    correlation, ratio, error = rate_fit(motion)
    if abs(correlation) < 0.8:
        return motion, []
    faults = []
    near = _near(ratio, _RATE_UNITS)
    if near is not None:
        channels, name, unit, gain = _RATE_UNITS[near]
        text = (
            f"{channels[0]} is in {name}: heading changes {ratio:.4g} times as fast as the yaw "
            "rate says"
        )
        faults.append(_relabelled(gain, channels, text, unit, ratio, error))
        motion = motion.with_channels(r=near * motion.values["r"])
    if correlation < 0:
        finding = Finding(
            "sign",
            -ratio,
            error,
            "1",
            "yaw rate has the opposite sign of the rate of change of heading",
            "r = { ..., sign = -1 } in the mapping",
            ("r",),
            edits=(Affine(("r",), -1.0),),
        )
        faults.append(finding)
        motion = motion.with_channels(r=-motion.values["r"])
    return motion, faults


def clock_unit(
    motion: MeasuredMotion, faults: list[Finding]
) -> tuple[MeasuredMotion, list[Finding]]:
    """Where velocity and yaw rate are off by the same thousand, the clock is.

    Velocity alone will do where a sample would be taken every ten seconds or less often.
    """
    late = [fault for fault in faults if fault.kind == "unit" and abs(fault.value - 1e-3) < 1e-4]
    by_yaw = any(fault.channels == ("t",) for fault in late)
    if not late or not (by_yaw or motion.interval > 10.0):
        return motion, faults
    rescaled = dataclasses.replace(motion, t=1e-3 * motion.t)
    scaled = [("r",)] * by_yaw + [("u", "v")] * any(f.channels == ("x", "y") for f in late)
    values = {name: 1e3 * motion.values[name] for names in scaled for name in names}
    channels, name, unit, gain = _RATE_UNITS[1e-3]
    fault = _relabelled(gain, channels, f"t is in {name}", unit, 1e-3, late[0].std)
    return rescaled.with_channels(**values), [f for f in faults if f not in late] + [fault]


_CLEARLY_WRONG = 0.03  # share of squared displacement that the labels leave unexplained
_BETTER = 0.25  # what share of that another reading may leave to be preferred
_GOOD = 0.2  # and what it may leave at most
# How much a change counts against a reading: none, or a little more where it is less usual.
_WEIGHT = {"": 0.0, "swapped-channels": 1.2}


@dataclasses.dataclass(frozen=True)
class Reading:
    """One way to read channels: how to transform them, and what that says of the file."""

    kind: str = ""  # of the finding; empty where the label is right
    channels: tuple[str, ...] = ()
    message: str = ""
    repair: str = ""
    transform: Callable[..., tuple] = lambda *values: values
    mirrored: bool = False  # heading turns the other way
    value: float = 0.0  # size of the fault; zero: how much the labels leave unexplained
    edits: tuple[Edit, ...] = ()


_POSITIONS = (
    Reading(),
    Reading(
        "swapped-channels",
        ("x", "y"),
        "x and y are swapped: x is east and y is north",
        "exchange the columns of x and y in the mapping",
        lambda x, y: (y, x),
        edits=(Swap("x", "y"),),
    ),
    Reading(
        "axes",
        ("y",),
        "y is positive to the west (to port), not to the east",
        "y = { ..., sign = -1 } in the mapping",
        lambda x, y: (x, -y),
        edits=(Affine(("y",), -1.0),),
    ),
    Reading(
        "sign",
        ("x",),
        "x is positive to the south",
        "x = { ..., sign = -1 } in the mapping",
        lambda x, y: (-x, y),
        edits=(Affine(("x",), -1.0),),
    ),
)
_HEADINGS = (
    Reading(),
    Reading(
        "axes",
        ("psi",),
        "heading is positive to port (counter-clockwise)",
        "psi = { ..., sign = -1 } in the mapping",
        lambda psi: (-psi,),
        mirrored=True,
        edits=(Affine(("psi",), -1.0),),
    ),
    Reading(
        "axes",
        ("psi",),
        "heading is counted counter-clockwise from east (ENU)",
        "psi = { ..., sign = -1, offset = -90 } with unit deg in the mapping",
        lambda psi: (np.pi / 2 - psi,),
        mirrored=True,
        edits=(Affine(("psi",), -1.0, np.pi / 2),),
    ),
    Reading(
        "unit",
        ("psi",),
        "heading is in degrees, not in radians",
        'psi = { ..., unit = "deg" } in the mapping',
        lambda psi: (np.radians(psi),),
        value=180 / np.pi,
        edits=(Affine(("psi",), np.pi / 180, unit="deg"),),
    ),
)


def _body(first: str, second: str, signs: tuple[int, int]) -> Callable[..., tuple]:
    def transform(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        source = {"u": u, "v": v}
        return signs[0] * source[first], signs[1] * source[second]

    return transform


_VELOCITIES = (
    Reading(),
    Reading(
        "axes",
        ("v",),
        "v is positive to port, not to starboard",
        "v = { ..., sign = -1 } in the mapping",
        _body("u", "v", (1, -1)),
        edits=(Affine(("v",), -1.0),),
    ),
    Reading(
        "sign",
        ("u",),
        "u is positive astern",
        "u = { ..., sign = -1 } in the mapping",
        _body("u", "v", (-1, 1)),
        edits=(Affine(("u",), -1.0),),
    ),
    Reading(
        "sign",
        ("u", "v"),
        "u and v have the wrong sign",
        "u and v = { ..., sign = -1 } in the mapping",
        _body("u", "v", (-1, -1)),
        edits=(Affine(("u", "v"), -1.0),),
    ),
    Reading(
        "swapped-channels",
        ("u", "v"),
        "u and v are swapped",
        "exchange the columns of u and v in the mapping",
        _body("v", "u", (1, 1)),
        edits=(Swap("u", "v"),),
    ),
)
_EARTH = (
    Reading(
        "axes",
        ("u", "v"),
        "u and v are velocities north and east (earth axes), not along the ship and to starboard",
        'velocity_axes = "earth" under [file] of the mapping',
        edits=(BodyAxes(),),
    ),
    Reading(
        "axes",
        ("u", "v"),
        "u and v are velocities east and north (earth axes), not along the ship and to starboard",
        'exchange their columns, and velocity_axes = "earth" under [file] of the mapping',
        _body("v", "u", (1, 1)),
        edits=(Swap("u", "v"), BodyAxes()),
    ),
)


@dataclasses.dataclass(frozen=True)
class _Choice:
    position: Reading
    heading: Reading
    velocity: Reading
    earth: bool
    misfit: float
    scale: float  # displacement per integrated velocity
    rivals: tuple[str, ...]  # other readings that explain the motion as well
    changes: float  # how many, the less usual ones counting a little more
    error: float = 0.0  # standard error of the scale
    labelled: float = 0.0  # misfit of the labels as they stand, and its standard error
    labelled_error: float = 0.0

    @property
    def readings(self) -> tuple[Reading, ...]:
        return tuple(r for r in (self.position, self.heading, self.velocity) if r.kind)


def read_frames(motion: MeasuredMotion) -> tuple[MeasuredMotion, list[Finding]]:
    """Motion with its labels put right, and what was wrong with them."""
    faults: list[Finding] = []
    if motion.has("x", "y", "psi", "u", "v"):
        choice = _choose(motion)
        motion = _applied(motion, choice)
        faults += [_fault(choice, reading) for reading in choice.readings]
        if choice.misfit <= _GOOD:
            motion, more = speed_unit(motion, choice.scale, choice.error)
            faults += more
    if motion.has("psi", "r"):
        motion, more = yaw_rate(motion)
        faults += more
    return clock_unit(motion, faults)


def _choose(motion: MeasuredMotion) -> _Choice:
    start, end = windows(motion, ("x", "y", "psi", "u", "v"))
    turning, ratio, _ = rate_fit(motion) if motion.has("psi", "r") else (0.0, 1.0, 0.0)
    values = motion.values
    choices = []
    for position, heading in itertools.product(_POSITIONS, _HEADINGS):
        x, y = position.transform(values["x"], values["y"])
        moved = (x[end] - x[start]) + 1j * (y[end] - y[start])
        (psi,) = heading.transform(values["psi"])
        against = turning * (-1 if heading.mirrored else 1) < -0.5
        # Heading in degrees must have a yaw rate that is out by the same factor.
        if heading.kind == "unit" and abs(turning) > 0.5 and ratio < 10:
            against = True
        for velocity, earth in [(v, False) for v in _VELOCITIES] + [(v, True) for v in _EARTH]:
            if earth and heading.kind:
                continue
            flow = _earth_velocity(velocity, earth, psi, values["u"], values["v"])
            path = integrate(motion.t, flow)
            misfit, scale = _misfit(moved, path[end] - path[start])
            changes = sum(_WEIGHT.get(r.kind, 1.0) for r in (position, heading, velocity))
            changes += 1.1 * against
            choices.append(_Choice(position, heading, velocity, earth, misfit, scale, (), changes))
    return _simplest(motion, choices, start, end)


def _earth_velocity(
    reading: Reading, earth: bool, psi: np.ndarray, u: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Velocity north + i east."""
    first, second = reading.transform(u, v)
    return (first + 1j * second) * (1.0 if earth else np.exp(1j * psi))


def _misfit(moved: np.ndarray, predicted: np.ndarray) -> tuple[float, float]:
    """Share of squared displacement left by the best positive scale, and that scale."""
    total = np.sum(np.abs(moved) ** 2)
    power = np.sum(np.abs(predicted) ** 2)
    if total <= 0 or power <= 0:
        return 1.0, 1.0
    scale = float(np.real(np.sum(np.conj(predicted) * moved)) / power)
    if scale <= 0:
        return 1.0, 1.0
    return float(np.sum(np.abs(moved - scale * predicted) ** 2) / total), scale


def _simplest(
    motion: MeasuredMotion, choices: list[_Choice], start: np.ndarray, end: np.ndarray
) -> _Choice:
    """The labels as they are, unless another reading is far better; then the least changed."""
    values = motion.values
    moved = (values["x"][end] - values["x"][start]) + 1j * (values["y"][end] - values["y"][start])
    flow = (values["u"] + 1j * values["v"]) * np.exp(1j * values["psi"])
    path = integrate(motion.t, flow)
    predicted, seconds = path[end] - path[start], motion.t[end] - motion.t[start]
    labelled = dataclasses.replace(choices[0], error=_scale_error(choices[0], moved.size))
    own = _tolerant_misfit(moved, predicted, seconds)
    best = min(choices, key=lambda choice: choice.misfit)
    if own < _CLEARLY_WRONG or best.misfit > min(_GOOD, _BETTER * own):
        return labelled
    good = [c for c in choices if c.misfit <= max(2 * best.misfit, best.misfit + 0.01)]
    good.sort(key=lambda choice: (choice.changes, choice.misfit))
    rivals = [
        " and ".join(reading.message for reading in choice.readings)
        for choice in good[1:3]
        if choice.changes < good[0].changes + 0.5
    ]
    share, error = _share_left(moved, labelled.scale * predicted)
    return dataclasses.replace(
        good[0],
        rivals=tuple(rivals),
        error=_scale_error(good[0], moved.size),
        labelled=share,
        labelled_error=error,
    )


def _scale_error(choice: _Choice, count: int) -> float:
    """Standard error of the scale from what it leaves; windows have two components each."""
    explained = max(1 - choice.misfit, 1e-12)
    return float(choice.scale * np.sqrt(choice.misfit / explained / max(2 * count - 1, 1)))


def _share_left(moved: np.ndarray, predicted: np.ndarray) -> tuple[float, float]:
    """Share of squared displacement that a prediction leaves, and its standard error."""
    left, total = np.abs(moved - predicted) ** 2, np.abs(moved) ** 2
    share = float(np.sum(left) / np.sum(total))
    return share, float(np.sqrt(np.sum((left - share * total) ** 2)) / np.sum(total))


def _tolerant_misfit(moved: np.ndarray, predicted: np.ndarray, seconds: np.ndarray) -> float:
    """Misfit of the labels when heading may be offset and a current may flow.

    Those are found more finely elsewhere, and must not make another reading look good. An
    offset above 60 degrees or a current of half the speed is not what this forgives.
    """
    total = np.sum(np.abs(moved) ** 2) + 1e-300
    best = _misfit(moved, predicted)[0]
    for columns in ([predicted], [predicted, seconds.astype(complex)]):
        matrix = np.stack(columns, axis=-1)
        gains = np.linalg.lstsq(matrix, moved, rcond=None)[0]
        speed = np.sqrt(np.mean(np.abs(moved / seconds) ** 2))
        if abs(np.angle(gains[0])) > np.pi / 3 or np.any(np.abs(gains[1:]) > 0.5 * speed):
            continue
        best = min(best, float(np.sum(np.abs(moved - matrix @ gains) ** 2) / total))
    return best


def _applied(motion: MeasuredMotion, choice: _Choice) -> MeasuredMotion:
    values = motion.values
    x, y = choice.position.transform(values["x"], values["y"])
    (psi,) = choice.heading.transform(values["psi"])
    u, v = choice.velocity.transform(values["u"], values["v"])
    if choice.earth:
        body = (u + 1j * v) * np.exp(-1j * psi)
        u, v = body.real, body.imag
    return motion.with_channels(x=x, y=y, psi=psi, u=u, v=v)


def _fault(choice: _Choice, reading: Reading) -> Finding:
    left = (
        f"; as labelled, velocity leaves {100 * choice.labelled:.2g} % of the squared displacement "
        f"unexplained, read so {100 * choice.misfit:.2g} %"
    )
    rivals = "".join(f"; as well possible: {rival}" for rival in choice.rivals)
    return Finding(
        reading.kind,
        reading.value or choice.labelled,
        0.0 if reading.value else choice.labelled_error,
        "1",
        reading.message + left + rivals,
        reading.repair,
        reading.channels,
        edits=reading.edits,
        doubt=" or ".join(f"as well possible: {rival}" for rival in choice.rivals),
    )
