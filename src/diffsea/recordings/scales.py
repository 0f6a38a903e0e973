"""Units of velocities, positions, yaw rate and time, and the sign of yaw rate, from kinematics."""

import dataclasses

import numpy as np

from diffsea.recordings.edits import Affine
from diffsea.recordings.finding import Finding
from diffsea.recordings.motion import Motion, integral, windows


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


def speed_unit(motion: Motion, scale: float, error: float) -> tuple[Motion, list[Finding]]:
    """Unit of velocities or positions: displacement is `scale` times the integrated velocity."""
    near = _near(scale, _SPEED_UNITS)
    if near is None:
        return motion, []
    channels, name, unit, gain = _SPEED_UNITS[near]
    # Velocities are what is rescaled either way: only the comparison matters from here on.
    values = motion.values
    motion = motion.replaced(u=near * values["u"], v=near * values["v"])
    text = (
        f"{' and '.join(channels)} are in {name}: displacement is {scale:.4g} times the "
        "integrated velocity"
    )
    return motion, [_relabelled(gain, channels, text, unit, scale, error)]


def rate_fit(motion: Motion) -> tuple[float, float, float]:
    """Correlation of heading increments with integrated yaw rate, their ratio and its error."""
    start, end = windows(motion, ("psi", "r"))
    psi, turned = motion.values["psi"], integral(motion.t, motion.values["r"])
    left, right = psi[end] - psi[start], turned[end] - turned[start]
    power = np.sqrt(np.sum(left**2) * np.sum(right**2))
    if left.size < 10 or power <= 0:
        return 0.0, 1.0, 0.0
    correlation = float(np.sum(left * right) / power)
    ratio = float(np.sqrt(np.sum(left**2) / np.sum(right**2)))
    return correlation, ratio, ratio * float(np.sqrt(max(1 - correlation**2, 0.0) / left.size))


def yaw_rate(motion: Motion) -> tuple[Motion, list[Finding]]:
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
        motion = motion.replaced(r=near * motion.values["r"])
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
        motion = motion.replaced(r=-motion.values["r"])
    return motion, faults


def clock_unit(motion: Motion, faults: list[Finding]) -> tuple[Motion, list[Finding]]:
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
    return rescaled.replaced(**values), [f for f in faults if f not in late] + [fault]
