"""What the paper prints: particulars, approach table, turning circles and zig-zags.

Rezayan (2026), "Traceable virtual sea trials in the Marine Robotics Unity Simulator",
arXiv:2606.12349, tables 1 to 4 and section 5.4. Angles in deg here and nowhere else.
"""

import dataclasses
import math


LENGTH, BEAM, DRAUGHT, MASS = 2.952, 1.468, 1.361, 300.0  # m, m, m, kg; table 1
TARGET_SPEED = 0.8311  # m/s, of SpeedHold
RATING_SHARE = 0.85  # of the largest continuous rating ...
SPEED_85 = 0.9235  # m/s, ... and the steady speed there
TARGET_SHARE = 0.9  # of that speed, about, is the target
STARTS = "121 to 124"  # s, of the trials
LARGEST_ANGLE = 35.0  # deg, rudder-equivalent of all thrust on one side
WINDOW = 10.0  # s, of the approach that is judged
YAW_CORRELATION, YAW_RMS = 0.98, 0.30  # logged against reconstructed; deg/s


@dataclasses.dataclass(frozen=True)
class Run:
    """One trial of the paper with every figure printed of it.

    `numbers` are lengths over L, overshoots in deg and yaw rates in deg/s under the names of
    `metrics.json`.
    """

    name: str
    manoeuvre: str
    angle: float  # deg
    heading: float  # deg, zero for circles
    side: int  # +1 starboard (first), -1 port
    speed: float  # m/s, mean of the approach
    speed_std: float  # m/s
    yaw_rate: float  # deg/s, largest in the last 10 s of the approach
    numbers: dict[str, float]

    @property
    def title(self) -> str:
        """As in the paper's tables."""
        side = "port" if self.side < 0 else "starboard"
        if self.manoeuvre == "turning-circle":
            return f"circle to {side}"
        return f"zig-zag {self.angle:g}/{self.heading:g}, {side} first"


def _circle(name: str, side: int, approach: tuple[float, float, float], lengths: tuple) -> Run:
    names = ("advance", "transfer", "tactical_diameter", "steady_turning_diameter")
    numbers: dict[str, float] = dict(zip(names, lengths, strict=True))
    return Run(name, "turning-circle", LARGEST_ANGLE, 0.0, side, *approach, numbers)


def _zigzag(
    name: str, angle: float, side: int, approach: tuple[float, float, float], read: tuple
) -> Run:
    names = ("overshoot_1", "overshoot_2", "peak_yaw_rate")
    numbers: dict[str, float] = dict(zip(names, read, strict=True))
    return Run(name, "zigzag", angle, angle, side, *approach, numbers)


RUNS = (
    _circle("circle-port", -1, (0.8265, 0.0023, 0.178), (2.403, 1.270, 3.435, 3.530)),
    _circle("circle-starboard", +1, (0.8270, 0.0024, 0.178), (2.497, 1.369, 3.597, 3.686)),
    _zigzag("zigzag-10-port", 10.0, -1, (0.8258, 0.0030, 0.179), (0.38, 0.33, 4.05)),
    _zigzag("zigzag-10-starboard", 10.0, +1, (0.8309, 0.0073, 0.179), (0.51, 0.47, 4.05)),
    _zigzag("zigzag-20-port", 20.0, -1, (0.8260, 0.0023, 0.178), (0.49, 0.54, 5.78)),
    _zigzag("zigzag-20-starboard", 20.0, +1, (0.8291, 0.0071, 0.179), (0.50, 0.38, 5.78)),
)


def unit(number: str) -> str:
    """The unit in which the paper prints a number."""
    if number.startswith("overshoot"):
        return "deg"
    return "deg/s" if number == "peak_yaw_rate" else "L"


def rounding(number: str) -> float:
    """Standard deviation that rounding to the last printed digit leaves, in the printed unit."""
    digit = 1e-3 if unit(number) == "L" else 1e-2
    return digit / math.sqrt(12)


def in_si(number: str) -> float:
    """Factor from the printed unit to SI."""
    return LENGTH if unit(number) == "L" else math.radians(1)
