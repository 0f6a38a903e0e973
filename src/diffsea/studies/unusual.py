"""What is unusual of a vessel: its numbers, free of size, beside those of the vessels that ship.

The numbers of these stand in `shipped_figures.json`, which `python -m diffsea.studies.unusual`
makes from their files.
"""

import functools
import importlib.resources
import json
import math
from pathlib import Path

from diffsea.scales import froude_speed, time_scale
from diffsea.studies.handling import Handling, handling
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import read_vessel, shipped_vessels


# What each number is called in a sentence.
FIGURES = {
    "displacement": "mass over that of the block L B T of water",
    "gyration": "radius of gyration over length",
    "slenderness": "length over beam",
    "depth": "draught over beam",
    "top_speed": "Froude number of the top speed",
    "surge_time": "time constant of its speed in sqrt(L / g)",
    "course_rate": "rate at which deviations from a straight course fall, times sqrt(L / g)",
    "other_course_rate": "faster rate at which sway and turning fall, times sqrt(L / g)",
    "turning": "tactical diameter over length",
}
_FILE = importlib.resources.files("diffsea.studies") / "shipped_figures.json"
_ROUNDING = 0.01  # of a limit, within which a number is not outside


def size_free_figures(vessel: Vessel, found: Handling) -> dict[str, float]:
    """The numbers of `FIGURES` that the vessel has, finite ones alone."""
    body = vessel.rigid_body
    length, beam, draught, mass = map(float, (body.length, body.beam, body.draught, body.mass))
    second = time_scale(length)
    numbers = {
        "displacement": mass / (float(body.water_density) * length * beam * draught),
        "gyration": math.sqrt(float(body.I_z) / mass) / length,
        "slenderness": length / beam,
        "depth": draught / beam,
        "top_speed": found.top_speed / froude_speed(length),
        "surge_time": found.surge_time / second,
        "course_rate": second / found.course_times[0],
        "other_course_rate": second / found.course_times[1],
        "turning": math.nan if found.turning_diameter is None else found.turning_diameter / length,
    }
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


@functools.cache
def shipped_figures() -> dict[str, dict[str, float]]:
    """The numbers of the vessels that ship, by number and vessel."""
    return json.loads(_FILE.read_text(encoding="utf-8"))


def compute_shipped_figures() -> dict[str, dict[str, float]]:
    """The numbers of the vessels that ship, from their files, to four digits."""
    each = {}
    for name in shipped_vessels():
        vessel = read_vessel(name).vessel
        each[name] = size_free_figures(vessel, handling(vessel))
    return {
        figure: {name: float(f"{own[figure]:.4g}") for name, own in each.items() if figure in own}
        for figure in FIGURES
    }


def unusual_figures(vessel: Vessel, found: Handling) -> list[str]:
    """What lies outside of the range of the vessels that ship and by how much, a line each."""
    lines = []
    for figure, value in size_free_figures(vessel, found).items():
        known = shipped_figures()[figure]
        for best, word, beyond in ((min, "least", -1), (max, "most", 1)):
            name = best(known, key=lambda vessel: known[vessel])
            limit = known[name]
            if beyond * (value - limit) > _ROUNDING * abs(limit):
                lines.append(f"{FIGURES[figure]}: {_compared(value, limit, word)} ({name})")
    return lines


def _compared(value: float, limit: float, word: str) -> str:
    """A number beside the limit that it passes, with their ratio where that means something."""
    text = f"{value:.3g}"
    if value * limit > 0 and abs(value) > 0.01 * abs(limit):
        ratio = value / limit
        times = f"{ratio:.2g}" if abs(ratio - 1) >= 0.05 else f"{ratio:.3g}"
        return f"{text}, {times} times the {word} of the vessels that ship, {limit:.3g}"
    return f"{text}, where the {word} of the vessels that ship is {limit:.3g}"


def main() -> None:
    """Write the file of the numbers of the vessels that ship."""
    text = json.dumps(compute_shipped_figures(), indent=1) + "\n"
    Path(str(_FILE)).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    from diffsea.runtime import prepare_jax

    prepare_jax()
    main()
