# pyright: reportArgumentType=false
"""One run as the paper draws it: motion, errors and actuators, weather, estimated parameters."""

from experiments.harness.reporting import panels
from experiments.unberthing.harbour_ship import DEGREE, KNOT, Weather
from experiments.unberthing.unberthing_loop import Log

import matplotlib.axes
import numpy as np
from matplotlib.figure import Figure


BLUE, ORANGE, GREY = "#1f5fa8", "#d1720f", "#8a8a8a"
MARKS = 60.0  # s between ship-shaped marks on the track, published
HULL = 54.0, 11.1  # m, length and beam of the marks
UNBERTHING = (
    ("phi_vv", 0, 0), ("phi_rv", 1, 0), ("gamma_vB", 0, 3), ("gamma_rB", 1, 3),
    ("phi_vr", 0, 1), ("phi_rr", 1, 1), ("gamma_vS", 0, 4), ("gamma_rS", 1, 4),
)  # fmt: skip
LEAVING = (
    ("phi_vv", 0, 0), ("phi_rv", 1, 0), ("gamma_v_delta", 0, 2), ("c_v", 0, 5),
    ("phi_vr", 0, 1), ("phi_rr", 1, 1), ("gamma_r_delta", 1, 2),
)  # fmt: skip


def run_panels(log: Log, air: Weather, name: str) -> Figure:
    """Figures 7 to 9 of the paper for one run: the phase that it is of, whole.

    Headings and positions are from where the run begins.
    """
    unberthing = int(log.step[0]) == 1
    rows = np.asarray(log.step) <= (2 if unberthing else 5)
    t = np.asarray(log.t)[rows]
    figure, axes = panels(5, 5, 16.0, 10.0) if unberthing else panels(4, 5, 16.0, 8.0)
    state = {key: np.asarray(getattr(log.state, key))[rows] for key in ("x", "y", "psi", "u", "v",
                                                                       "r")}  # fmt: skip
    _track(axes[0, 0], state, t)
    motion = (
        ("u, m/s", state["u"]), ("v, m/s", state["v"]), ("r, deg/s", state["r"] / DEGREE),
    )  # fmt: skip
    blades = np.asarray(log.blades)[rows] / DEGREE
    orders = (
        ("cross-track error, m", np.asarray(log.cross)[rows]),
        ("heading, deg", (state["psi"] - state["psi"][0]) / DEGREE),
        ("propeller blades, deg", blades[:, 0]),
        *((("bow blades, deg", blades[:, 2]), ("stern blades, deg", blades[:, 3]))
          if unberthing else (("rudder, deg", blades[:, 1]),)),
    )  # fmt: skip
    weather = _weather(air, rows)
    model = np.asarray(log.model)[rows]
    told = [
        (label, model[:, row, at]) for label, row, at in (UNBERTHING if unberthing else LEAVING)
    ]
    columns = (
        (axes[1:, 0], motion, BLUE), (axes[:, 1], orders, BLUE), (axes[:, 2], weather, GREY),
        (axes[:, 3], told[:4], ORANGE), (axes[:, 4], told[4:], ORANGE),
    )  # fmt: skip
    for places, series, colour in columns:
        for axis, (label, values) in zip(places, series, strict=False):
            axis.plot(t, values, color=colour, lw=1)
            axis.set_title(label, fontsize=9, loc="left")
            axis.grid(linewidth=0.3)
            axis.tick_params(labelsize=7)
            axis.ticklabel_format(useOffset=False)
        for axis in places[len(series) :]:
            axis.set_axis_off()
        places[len(series) - 1].set_xlabel("time, s", fontsize=8)
    figure.suptitle(name, fontsize=10)
    return figure


def _weather(air: Weather, rows: np.ndarray) -> tuple[tuple[str, np.ndarray], ...]:
    """Where wind comes from and tide flows to, and how fast."""
    count = len(rows)
    wind, tide = (
        [np.asarray(part)[:count][rows] for part in parts]
        for parts in ((air.wind_north, air.wind_east), (air.current_north, air.current_east))
    )
    return (
        ("wind, m/s", np.hypot(*wind)),
        ("wind from, deg", np.degrees(np.arctan2(-wind[1], -wind[0])) % 360),
        ("tide, kn", np.hypot(*tide) / KNOT),
        ("tide towards, deg", np.degrees(np.arctan2(tide[1], tide[0])) % 360),
    )


def _track(axis: matplotlib.axes.Axes, state: dict[str, np.ndarray], t: np.ndarray) -> None:
    """The track from where it begins, with a ship drawn every minute."""
    north, east = state["x"] - state["x"][0], state["y"] - state["y"][0]
    axis.plot(east, north, color=BLUE, lw=1)
    length, beam = HULL
    shape = np.array([(-0.5, -0.5), (0.25, -0.5), (0.5, 0.0), (0.25, 0.5), (-0.5, 0.5)])
    ahead, abeam = (shape * (length, beam)).T
    for row in np.searchsorted(t, np.arange(t[0], t[-1], MARKS)):
        cos, sin = np.cos(state["psi"][row]), np.sin(state["psi"][row])
        axis.fill(east[row] + ahead * sin + abeam * cos, north[row] + ahead * cos - abeam * sin,
                  fill=False, color=GREY, lw=0.7)  # fmt: skip
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_title("north over east, m", fontsize=9, loc="left")
    axis.tick_params(labelsize=7)
