"""Whether a trial is begun as the ITTC asks: near the speed that was wanted, and hardly turning."""

import math
from typing import Any


LEAST_SHARE = 0.9  # of the wanted speed
LARGEST_YAW_RATE = math.radians(0.18)  # rad/s


def approach_verdict(speed: float, yaw_rate: float, wanted: float | None) -> dict[str, Any]:
    """The verdict on an approach by the limits of Rezayan (2026, table 2), after the ITTC.

    Arguments:
        speed: mean resultant speed of the approach (m/s).
        yaw_rate: the largest one in it (rad/s), either way.
        wanted: the speed (m/s) that was to be held, or None where there was none; then the yaw
            rate alone is judged.

    Returns the numbers (m/s, rad/s) with their limits, and `pass` or `fail`; `unknown` where a
    number that is judged is not known.
    """
    least = None if wanted is None else LEAST_SHARE * wanted
    met = [(yaw_rate, yaw_rate <= LARGEST_YAW_RATE)]
    if least is not None:
        met.append((speed, speed >= least))
    known = all(math.isfinite(value) for value, _ in met)
    verdict = "pass" if all(one for _, one in met) else "fail"
    return {
        "speed": speed,
        "least_speed": least,
        "yaw_rate": yaw_rate,
        "largest_yaw_rate": LARGEST_YAW_RATE,
        "verdict": verdict if known else "unknown",
    }
