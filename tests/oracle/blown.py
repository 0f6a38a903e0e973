"""A run in a wind that changes from one sample to the next, as an anemometer would record it."""

import numpy as np

from . import sensors
from .environment import wind_force
from .simulator import Simulator


def blown_run(document, superstructure, orders, wind, step, state=(0.0,) * 6):
    """Channels of a run, as exact sensors show them, its wind beside them.

    Between two samples the air moves at the mean of both. `orders` are (time in s, thrusts by
    name), at times of samples; `wind` has north and east components (m/s) of the air's motion, a
    row for each sample, `step` s apart.
    """
    sim, t = Simulator(document, state=state), step * np.arange(len(wind))
    due = dict(orders)
    north, east = (0.5 * (wind[:-1] + wind[1:])).T
    for row, until in enumerate(t[1:]):
        if row * step in due:
            sim.order(due[row * step])
        blows = {
            "speed": np.hypot(north[row], east[row]),
            "direction": np.arctan2(-east[row], -north[row]),
        }
        sim.model.forces[:] = [wind_force(sim.model.hull, superstructure | blows)]
        sim.run(until)
    recorded = sensors.record(sim, t, wrapped=False)
    recorded["wind_speed"] = np.hypot(*wind.T)
    recorded["wind_direction"] = np.arctan2(-wind[:, 1], -wind[:, 0]) % (2 * np.pi)
    return recorded


def gusty(rng, rows, mean, spread, rows_kept):
    """Components of a wind about its mean (m/s); gusts fall by e in so many rows."""
    wind, keep = np.zeros((rows, 2)), np.exp(-1.0 / rows_kept)
    for k in range(1, rows):
        wind[k] = keep * wind[k - 1] + np.sqrt(1 - keep**2) * spread * rng.standard_normal(2)
    return np.asarray(mean) + wind
