"""Actuators: lags, delays, play, losses, and the single screw and its rudder."""

import math

from .effect import Effect, sided, timed
from .hulls import Hull
from .model import Actuator, Channel, Model, build


# The channel of each kind of actuator that dead band, play, slew limits and bias act on.
_WORKING = {"thruster": "", "azimuth": "force", "propeller": "", "rudder": ""}


def effects(hull: Hull) -> list[Effect]:
    """The entries for this hull's actuators."""
    t = hull.hold
    ship = hull.kind == "ship"
    turning = ("yaw",) if ship else ("surge", "yaw")
    found = [
        Effect("thrust-lag", "", ("time_constant",), turning, 0.05 * t, 1.5 * t, lag),
        Effect("thrust-delay", "", ("delay",), turning, 0.05 * t, 1.0 * t, delay),
        Effect("rate-limit", "", ("rate_limit",), turning, 0.2 * t, 5.0 * t, rate),
        Effect("backlash", "", ("width",), turning, 0.02, 0.3, backlash),
        Effect("deadband", "", ("width",), turning, 0.02, 0.4, deadband),
        Effect("thrust-saturation", "", ("limit",), turning, 0.1, 0.75, saturation),
        Effect("actuator-bias", "", ("bias",), turning, 0.01, 0.3, bias, _one),
        Effect("thrust-loss-in-turns", "", ("slope",), ("surge", "yaw"), 0.05 / hull.yaw,
               0.4 / hull.yaw, loss_turn),
        Effect("thrust-change", "", ("factor",), ("surge", "yaw"), 0.05, 0.7, change, timed,
               onset=True),
    ]  # fmt: skip
    kinds = {a.kind for a in build(hull.document).actuators}
    # The thrust of a propeller, or of a curve of rev/s and speed, falls with speed of itself.
    if any("curve" not in d for p in ("thruster", "azimuth_thruster")
           for d in hull.document.get(p, [])):  # fmt: skip
        found.append(Effect("thrust-loss-with-speed", "", ("slope",), ("surge", "yaw"),
                            0.05 / hull.speed, 0.4 / hull.speed, loss_speed))  # fmt: skip
    if any(d.get("y") for p in ("thruster", "azimuth_thruster") for d in hull.document.get(p, [])):
        found.append(
            Effect("thrust-asymmetry", "", ("ratio",), ("yaw",), 0.02, 0.5, asymmetry, sided)
        )
    if "thruster" in kinds:
        found.append(Effect("thruster-misalignment", "", ("angle",), ("sway", "yaw"), 0.02, 0.4,
                            misalign, sided))  # fmt: skip
    if ship:
        found += [
            Effect("propeller-side-force", "", ("Y_ahead",), ("sway", "yaw"), 0.01, 0.4,
                   side_force, sided),
            Effect("rudder-interaction", "a_H", ("a_H",), ("sway", "yaw"), 0.05, 0.6, hull_force),
            Effect("rudder-interaction", "gamma_R", ("gamma_R",), ("yaw",), 0.05, 0.7, straighten),
        ]  # fmt: skip
    return found


def _one(rng, hull: Hull) -> dict:
    """One actuator and a side."""
    names = [a.name for a in _affected(build(hull.document), "bias")]
    return {"actuator": str(rng.choice(names)), "side": float(rng.choice([-1.0, 1.0]))}


def _affected(model: Model, what: str) -> list[Actuator]:
    """The actuators that an effect acts on: of a ship, the rudder, for all but losses of thrust."""
    rudders = [a for a in model.actuators if a.kind == "rudder"]
    if what in ("loss", "limit") or not rudders:
        return [a for a in model.actuators if a.kind != "rudder"]
    return rudders


def _channels(model: Model, what: str) -> list[tuple[Channel, float]]:
    """Working channels of the affected actuators, each with its largest order."""
    found = []
    for a in _affected(model, what):
        c = a.channels[_WORKING[a.kind]]
        found.append((c, c.high if math.isfinite(c.high) else 1.0))
    return found


def _named(model: Model, what: str, values: dict) -> dict:
    return {**values, "actuators": [a.name for a in _affected(model, what)]}


def working_labels(hull: Hull, actuators: list[str]) -> list[str]:
    """Labels of the orders of some actuators that the effects above act on."""
    mine = [a for a in build(hull.document).actuators if a.name in actuators]
    return [f"{a.name}.{role}" if (role := _WORKING[a.kind]) else a.name for a in mine]


def lag(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    for a in _affected(model, "lag"):
        a.channels[_WORKING[a.kind]].lag += size
    return _named(model, "lag", {"time_constant": size})


def delay(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    for c, _ in _channels(model, "delay"):
        c.delay += size
    return _named(model, "delay", {"delay": size})


def rate(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """`size` is the time from no thrust (or midships) to full, s."""
    for c, top in _channels(model, "rate"):
        c.rate = min(c.rate, top / size)
        value = top / size
    return _named(model, "rate", {"rate_limit": value})


def backlash(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """`size` as a share of the largest order, as for the next two."""
    for c, top in _channels(model, "backlash"):
        c.backlash = value = size * top
    return _named(model, "backlash", {"width": value})


def deadband(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    for c, top in _channels(model, "deadband"):
        c.deadband = value = size * top
    return _named(model, "deadband", {"width": value})


def bias(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """On one actuator only."""
    a = next(a for a in model.actuators if a.name == extra["actuator"])
    c = a.channels[_WORKING[a.kind]]
    c.bias = size * c.high * extra["side"]
    return {"bias": c.bias, "actuators": [a.name]}


def saturation(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """`size` is the share of full order that is cut off."""
    for c, top in _channels(model, "limit"):
        value = (1.0 - size) * top
        c.low, c.high = max(c.low, -value), min(c.high, value)
    return _named(model, "limit", {"limit": value})


def loss_speed(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    for a in _affected(model, "loss"):
        a.loss_speed = size
    return {"slope": size}


def loss_turn(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    for a in _affected(model, "loss"):
        a.loss_turn = size
    return {"slope": size}


def change(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """Mostly a loss."""
    value = size if extra["side"] > 0 and size < 0.3 else -size
    model.steps.append((extra["time"], "thrust", value))
    return {"time": extra["time"], "factor": value}


def asymmetry(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    ratio = size * extra["side"]
    for a in model.actuators:
        a.gain *= 1.0 + math.copysign(ratio, a.data["y"] * ratio)
    return {"ratio": ratio}


def misalign(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    for a in model.actuators:
        if a.kind == "thruster":
            a.data["angle"] = a.data.get("angle", 0.0) + size * extra["side"]
    return {"angle": size * extra["side"]}


def side_force(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """At the screw, so that the moment is the force times half a length; greater astern."""
    s = size * extra["side"]
    model.side = {"Y_ahead": s, "N_ahead": -0.48 * s, "Y_astern": -2.0 * s, "N_astern": 0.96 * s}
    return dict(model.side)


def hull_force(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    rudder = next(a for a in model.actuators if a.kind == "rudder")
    x_H = -0.45 * hull.document["hull"]["length"]
    rudder.data.update(a_H=size, x_H=x_H)
    return {"a_H": size, "x_H": x_H, "gamma_R": 1.0}


def straighten(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    rudder = next(a for a in model.actuators if a.kind == "rudder")
    rudder.data.update(gamma_R=1.0 - size)
    return {"a_H": 0.0, "x_H": 0.0, "gamma_R": 1.0 - size}
