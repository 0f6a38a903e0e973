"""Payload to hull size: a load in the published hull, deeper, and in a hull that is grown for it.

The paper's first step of a design (section IV.A) is to determine the payload "and therefore the
buoyancy and hull size required"; it takes none. Here the boat's own mass grows with the hull's
surface, as a skin of the same thickness does, and what it displaces at the published draught over
length with the volume. What is left between both is payload.
"""

from collections.abc import Iterator

from experiments.harness.reporting import table
from experiments.pytheas.boat import LENGTH, MASS, THRUST, draught
from experiments.pytheas.requirements import DESIGNED, Case, by, directions

import numpy as np

from diffsea import named, read_vessel


PAYLOADS = (0.0, 2.0, 5.0, 10.0, 20.0)  # kg
SWELL = 20.0  # N, from any side: what `DESIGNED` is the least thrust for, without payload
WAYS = ("deeper", "grown")


def grown(payload: float) -> float:
    """The scale at which a hull carries a payload (kg) at the published draught over length."""
    roots = np.roots([MASS, -MASS, 0.0, -payload])
    return float(roots[np.isreal(roots)].real.max())


def design(way: str, payload: float) -> dict[str, float]:
    """Scale and mass (kg) of the boat with its payload."""
    if way == "deeper":
        return {"scale": 1.0, "mass": MASS + payload}
    scale = grown(payload)
    return {"scale": scale, "mass": MASS * scale**3}


def loaded(every: float) -> list[dict]:
    """Sizes of both, and what they do with the published thrust and with that for the swell."""
    drag = -named(read_vessel("pytheas").vessel)["X_u"]

    def cases() -> Iterator[tuple[tuple, Case]]:
        for payload in PAYLOADS:
            for way in WAYS:
                boat = design(way, payload)
                for north in (20.0, -20.0):
                    yield (way, payload, "calm"), Case(north, thrust=THRUST, **boat)
                for to in directions(every):
                    swell = {"bias": SWELL, "direction": to}
                    yield (way, payload, "swell"), Case(thrust=DESIGNED, **swell, **boat)

    ends, found = by(cases()), []
    for payload in PAYLOADS:
        for way in WAYS if payload else WAYS[:1]:
            boat = design(way, payload)
            length = LENGTH * boat["scale"]
            ahead, astern = ends[way, payload, "calm"].time
            found.append(
                {
                    "payload": payload, "way": way, "length": length, "mass": boat["mass"],
                    "draught": float(draught(boat["mass"], length=length)),
                    "top_speed": THRUST / (drag * boat["scale"] ** 2.5),
                    "ahead": float(ahead), "astern": float(astern),
                    "reached": float(np.isfinite(ends[way, payload, "swell"].time).mean()),
                }
            )  # fmt: skip
    return found


def hull_table(found: list[dict]) -> str:
    """One row per payload and way."""
    head = ("payload, kg", "hull", "length, m", "mass, kg", "draught, m", "top speed at 20 N, m/s",
            "20 m ahead, s", "20 m astern, s",
            f"{DESIGNED:g} N in a swell of {SWELL:g} N: directions reached")  # fmt: skip
    return table(head, [_row(one) for one in found])


def _row(one: dict) -> tuple:
    name = "as published" if one["payload"] == 0 else one["way"]
    shown = [one[key] for key in ("length", "mass", "draught", "top_speed")]
    times = [f"{one[key]:.1f}" if np.isfinite(one[key]) else "never" for key in ("ahead", "astern")]
    return one["payload"], name, *shown, *times, f"{100 * one['reached']:.0f} %"
