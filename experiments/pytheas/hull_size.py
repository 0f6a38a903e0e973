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
SWELL = 20.0  # N, from any side, on every hull; `DESIGNED` is the least thrust without payload
WAYS = ("deeper", "grown")
LONGEST = 600.0  # s: a heavy boat is slow, not unable


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

    hulls = [(way, payload) for payload in PAYLOADS for way in WAYS if payload or way == "deeper"]

    def cases() -> Iterator[tuple[tuple, Case]]:
        for hull in hulls:
            boat = design(*hull)
            for north in (20.0, -20.0):
                yield (*hull, "calm"), Case(north, thrust=THRUST, **boat)
            for to in directions(every):
                swell = {"bias": SWELL, "direction": to}
                yield (*hull, "swell"), Case(thrust=DESIGNED, **swell, **boat)

    ends, found = by(cases(), LONGEST), []
    for way, payload in hulls:
        boat = design(way, payload)
        length = LENGTH * boat["scale"]
        ahead, astern = ends[way, payload, "calm"].time
        in_swell = ends[way, payload, "swell"].time
        reached = np.isfinite(in_swell)
        found.append(
            {
                "payload": payload, "way": way, "length": length, "mass": boat["mass"],
                "draught": float(draught(boat["mass"], length=length)),
                "top_speed": THRUST / (drag * boat["scale"] ** 2.5),
                "ahead": float(ahead), "astern": float(astern),
                "reached": float(reached.mean()),
                "longest": float(in_swell[reached].max()),
            }
        )  # fmt: skip
    return found


def hull_table(found: list[dict]) -> str:
    """One row per payload and way."""
    head = ("payload, kg", "hull", "length, m", "mass, kg", "draught, m", "top speed at 20 N, m/s",
            "20 m ahead, s", "20 m astern, s",
            f"{DESIGNED:g} N in a swell of {SWELL:g} N: directions reached, longest")  # fmt: skip
    return table(head, [_row(one) for one in found])


def _row(one: dict) -> tuple:
    name = "as published" if one["payload"] == 0 else one["way"]
    shown = [one[key] for key in ("length", "mass", "draught", "top_speed")]
    times = [f"{one[key]:.1f}" if np.isfinite(one[key]) else "never" for key in ("ahead", "astern")]
    swell = f"{100 * one['reached']:.0f} %, {one['longest']:.0f} s"
    return one["payload"], name, *shown, *times, swell
