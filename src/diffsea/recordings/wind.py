"""True wind of the apparent one that an anemometer aboard measures."""

import dataclasses

import numpy as np

from diffsea.recordings.motion import motion_of
from diffsea.trajectory import Trajectory


APPARENT = ("apparent_wind_speed", "apparent_wind_angle")
TRUE = ("wind_speed", "wind_direction")


def with_true_wind(run: Trajectory) -> Trajectory:
    """The recording with the true wind, where only an apparent one was measured.

    Air moves over ground as it moves past the vessel, turned by her heading, and as she does
    herself (Fossen 2021, eq. 10.20 to 10.22). It takes a heading and a velocity; a sway that
    was not measured is none. Without them the provenance says so.
    """
    if not set(APPARENT) <= run.extra.keys() or set(TRUE) & run.extra.keys():
        return run
    motion = motion_of(run)
    if not motion.has("psi", "u"):
        note = "the apparent wind is not used: a heading and u are needed to tell the true one"
        return dataclasses.replace(run, provenance=(*run.provenance, note))
    speed, angle = (run.extra[channel] for channel in APPARENT)
    past_the_vessel = -speed * np.exp(1j * angle)  # ahead + i to starboard
    velocity = motion.values["u"] + 1j * np.where(motion.known["v"], motion.values["v"], 0.0)
    over_ground = (past_the_vessel + velocity) * np.exp(1j * motion.values["psi"])
    known = motion.known["psi"] & motion.known["u"]
    comes_from = np.where(known, -over_ground, np.nan)
    wind = np.abs(comes_from), np.mod(np.angle(comes_from), 2 * np.pi)
    note = "true wind from the apparent one, by heading and velocity over ground"
    return dataclasses.replace(
        run,
        extra=run.extra | dict(zip(TRUE, wind, strict=True)),
        provenance=(*run.provenance, note),
    )
