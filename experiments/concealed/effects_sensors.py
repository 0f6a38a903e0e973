"""Sensors, clocks and surroundings."""

import math

from .effect import Effect, sided, turned
from .hulls import Hull
from .model import Model


def effects(hull: Hull) -> list[Effect]:
    """The sensor and environment entries for this hull."""
    L, U = hull.document["hull"]["length"], hull.speed
    found = [
        Effect("heading-offset", "", ("angle",), (), 0.01, 0.5, heading, sided),
        Effect("hard-iron", "", ("amplitude",), (), 0.01, 0.5, iron, turned, ("phase",)),
        Effect("gyro-bias", "", ("bias",), (), 0.001, 0.3, gyro, sided),
        Effect("lever-arm", "", ("x", "y"), (), 0.02 * L, 0.6 * L, lever, turned),
        Effect("clock-drift", "", ("rate",), (), 0.001, 0.05, clock, sided),
        Effect("current", "", ("speed",), ("surge", "sway"), 0.02 * U, 0.6 * U, current, turned,
               ("direction",)),
        Effect("wind", "", ("speed",), ("surge", "sway", "yaw"), 2.0, 18.0, wind, _blown,
               ("direction",)),
        Effect("wave-force", "", ("amplitude",), ("surge", "sway"), 0.01 * weight(hull),
               0.5 * weight(hull), wave, _wave_draw(hull), ("direction",)),
        Effect("shallow-water", "", ("depth",), ("surge", "sway", "yaw"), 0.1, 0.85, shallow),
    ]  # fmt: skip
    for variant, channels in (
        ("position", ["x", "y"]),
        ("velocity", ["u", "v"]),
        ("compass", ["psi"]),
        ("gyro", ["r"]),
    ):
        put = lambda m, h, size, extra, c=tuple(channels): late(m, size, c)
        found.append(Effect("sensor-latency", variant, ("delay",), (), 0.05, 10.0 * hull.step, put))
    return found


def weight(hull: Hull) -> float:
    """A force to compare with: mass times a tenth of g Froude-wise, i.e. m U^2 / L, N."""
    h = hull.document["hull"]
    return h["mass"] * hull.speed**2 / h["length"]


def heading(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    model.sensing.heading_offset = size * extra["side"]
    return {"angle": model.sensing.heading_offset}


def iron(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    model.sensing.iron_amplitude, model.sensing.iron_phase = size, extra["direction"]
    return {"amplitude": size, "phase": extra["direction"]}


def gyro(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    model.sensing.gyro_bias = size * extra["side"]
    return {"bias": model.sensing.gyro_bias}


def lever(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    a = extra["direction"]
    model.sensing.lever = (size * math.cos(a), size * math.sin(a))
    return {"x": model.sensing.lever[0], "y": model.sensing.lever[1]}


def clock(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    model.sensing.clock_rate = size * extra["side"]
    return {"rate": model.sensing.clock_rate, "offset": 0.0}


def late(model: Model, size: float, channels: tuple[str, ...]) -> dict:
    model.sensing.latency.update({c: size for c in channels})
    return {"delay": size, "channels": list(channels)}


def current(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    a = extra["direction"]
    model.current = (size * math.cos(a), size * math.sin(a))
    return {"speed": size, "direction": a}


def _blown(rng, hull) -> dict:
    """Nobody measured the superstructure: its coefficients differ from the usual ones."""
    C_X, C_Y = (usual * math.exp(0.5 * rng.normal()) for usual in (0.7, 0.85))
    C_N = float(rng.normal(0.05, 0.1))
    return turned(rng, hull) | {"superstructure": (C_X, C_Y, C_N)}


def wind(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """`direction` is where it comes from."""
    a = extra["direction"]
    model.superstructure = tuple(extra.get("superstructure", model.superstructure))
    model.wind = (-size * math.cos(a), -size * math.sin(a))
    return {"speed": size, "direction": a}


def _wave_draw(hull: Hull):
    period = 4.0 * math.sqrt(hull.document["hull"]["length"])

    def draw(rng, _):
        return {
            "direction": round(float(rng.uniform(0.0, 2.0 * math.pi)), 4),
            "phase": round(float(rng.uniform(0.0, 2.0 * math.pi)), 4),
            "frequency": round(float(rng.uniform(0.6, 1.6)) / period, 5),
            "share": round(float(rng.uniform(0.2, 0.8)), 3),
        }

    return draw


def wave(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """Mean `share` of the amplitude."""
    model.wave = {
        "bias": size * extra["share"], "amplitude": size, "frequency": extra["frequency"],
        "phase": extra["phase"], "direction": extra["direction"],
    }  # fmt: skip
    return dict(model.wave)


def shallow(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """`size` is draught over depth."""
    model.ratio_of_depth = size
    return {"depth": hull.document["hull"]["draught"] / size}
