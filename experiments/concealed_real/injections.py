"""Everything that is injected: how, where it is possible, what its size is, what it may be called.

A *setting* says one injection completely and is what a case keeps. `features` are what is known of
a set without its recordings: its columns, kinds and sides of its actuators.
Imports nothing of the tool.
"""

import copy
import dataclasses
import math
from collections.abc import Callable
from typing import Any

from experiments.concealed_real import order_injections as order
from experiments.concealed_real import sensor_injections as sensor
from experiments.concealed_real.features import Features
from experiments.concealed_real.material import Document, Material, Run, Settings

import numpy as np


Change = Callable[[Run, Settings], Run]
Places = Callable[[Features], list[Settings]]
Extra = Callable[[np.random.Generator, Features], Settings]
Numbers = Callable[[Settings], dict[str, float]]


def _nothing(rng: np.random.Generator, features: Features) -> Settings:
    """No setting beyond the size."""
    return {}


def _either_side(rng: np.random.Generator, features: Features) -> Settings:
    """A sign."""
    return {"side": float(rng.choice([-1.0, 1.0]))}


def _any_angle(rng: np.random.Generator, features: Features) -> Settings:
    """A direction or a phase, rad."""
    return {"angle": float(rng.uniform(-math.pi, math.pi))}


def _seeded(rng: np.random.Generator, features: Features) -> Settings:
    """A seed, a correlation time of 3 to 20 s."""
    return {"seed": int(rng.integers(2**31)), "time": float(rng.uniform(3.0, 20.0))}


def _period(rng: np.random.Generator, features: Features) -> Settings:
    """A period of a tenth to a third of the shortest run, s."""
    return {"time": float(rng.uniform(0.1, 0.33) * features["shortest"])}


def _onset(rng: np.random.Generator, features: Features) -> Settings:
    """A sign, and a time between 30 and 70 % of the shortest run, s on its clock."""
    time = float(rng.uniform(0.3, 0.7) * features["shortest"])
    return _either_side(rng, features) | {"time": time}


def _few_rows(rng: np.random.Generator, features: Features) -> Settings:
    """A number of rows."""
    return {"rows": int(rng.choice([2, 3, 5]))}


def _odd_rows(rng: np.random.Generator, features: Features) -> Settings:
    """An odd number of rows."""
    return {"rows": int(rng.choice([3, 5, 9, 15]))}


def has(*columns: str, **setting: Any) -> Places:
    """Possible once, with a setting, where a set has the columns."""
    return lambda features: [setting] if set(columns) <= set(features["columns"]) else []


def _columns(features: Features, *kinds: str, prefix: str = "cmd_") -> list[str]:
    """Columns of actuation of some kinds: thruster, propeller, azimuth, rudder, angle.

    Without orders whose execution was measured: those are not what moved the vessel.
    """
    of, there = features["kinds"], set(features["columns"])
    hidden = {f"cmd_{c.removeprefix('exec_')}" for c in there if c.startswith("exec_")}
    return [c for c in sorted(there - hidden) if c.startswith(prefix) and of.get(c) in kinds]


def groups(*kinds: str, only: str = "columns", needs: str = "t") -> Places:
    """Possible for all columns that push, and for all that steer, of the kinds.

    Arguments:
        only: the feature that must list all of them, such as `moving`.
        needs: a channel that must be measured besides.
    """
    pushing = [k for k in kinds if k not in ("rudder", "angle")]
    steering = [k for k in kinds if k in ("rudder", "angle")]

    def places(features: Features) -> list[Settings]:
        if needs not in features["columns"]:
            return []
        found = [_columns(features, *some) for some in (pushing, steering)]
        return [{"columns": c} for c in found if c and set(c) <= set(features[only])]

    return places


def each(*kinds: str, prefix: str = "cmd_", only: str = "columns") -> Places:
    """Possible for every column of the kinds alone that a feature lists."""
    return lambda features: [
        {"columns": [c]} for c in _columns(features, *kinds, prefix=prefix) if c in features[only]
    ]


def twins(features: Features) -> list[Settings]:
    """Possible where two thrusters stand on the two sides, and turning is measured."""
    sides = {c: features["sides"][c] for c in _columns(features, "thruster")}
    two = sorted(sides.values()) == [-1.0, 1.0]
    turning = {"psi", "r"} & set(features["columns"])
    return [{"columns": sorted(sides), "sides": sides}] if two and turning else []


def full_thrust(features: Features) -> list[Settings]:
    """Possible for all thrusters; `full` is their largest order, N."""
    columns = _columns(features, "thruster")
    if not columns:
        return []
    return [{"columns": columns, "full": max(features["largest"][c] for c in columns)}]


@dataclasses.dataclass(frozen=True)
class Injection:
    """One kind of injection.

    Arguments:
        names: what it may be called; none where it must stay without a name.
        scales: (effect, parameter) whose detection limit its size is a multiple of, the first that
            is stated; (`scatter`, column) for multiples of a column's scatter from row to row.
        numbers: the parameters of the effect that it is, from its settings.
        undo: the inverse where there is one, on the rows that keep a value.
        audit: kinds of audit findings that are right, too.
        may_be_silent: no name is right as well.
        most: the largest size that is possible, from the features and the settings.
    """

    names: tuple[str, ...]
    apply: Change
    undo: Change | None
    scales: tuple[tuple[str, str], ...]
    places: Places
    numbers: Numbers
    extra: Extra = _nothing
    audit: tuple[str, ...] = ()
    may_be_silent: bool = False
    most: Callable[[Features, Settings], float] = lambda features, settings: math.inf
    in_rows: bool = False  # its size is a time that is rounded to whole rows


def signed_as(parameter: str) -> Numbers:
    """The size with its sign, as a parameter."""
    return lambda settings: {parameter: sensor.signed(settings)}


def _as(parameter: str) -> Numbers:
    return lambda settings: {parameter: settings["size"]}


def _flow(settings: Settings) -> dict[str, float]:
    return {"speed": settings["size"], "direction": settings["angle"]}


def _arm(settings: Settings) -> dict[str, float]:
    angle = settings["angle"]
    return {"x": settings["size"] * math.cos(angle), "y": settings["size"] * math.sin(angle)}


def _changed(settings: Settings) -> dict[str, float]:
    return {"factor": sensor.signed(settings), "time": settings["time"]}


def _none(settings: Settings) -> dict[str, float]:
    return {}


def _late(*columns: str) -> Injection:
    channels = list(columns)
    return Injection(
        ("sensor-latency",), sensor.late_channels, sensor.early_channels,
        (("sensor-latency", "delay"),), has(*columns, columns=channels, channels=channels),
        _as("delay"), audit=("sensor-latency",),
    )  # fmt: skip


def _half_of_full(features: Features, settings: Settings) -> float:
    return 0.5 * min(features["largest"][c] for c in settings["columns"])


def _half_lost(column: str) -> Callable[[Features, Settings], float]:
    return lambda features, settings: 0.5 / features["largest"][column]


_BIAS = (("actuator-bias", "bias"),)
_SILENT = {"names": (), "numbers": _none}
_PUSHING = ("thruster", "azimuth")  # orders in N
_ALL = ("thruster", "azimuth", "propeller", "rudder", "angle")

INJECTIONS: dict[str, Injection] = {
    # the environment, sensors and clocks
    "current": Injection(("current",), sensor.current, sensor.without_current,
        (("current", "speed"),), has("x", "y", "psi"), _flow, _any_angle),
    "heading-offset": Injection(("heading-offset",), sensor.heading_offset,
        sensor.without_heading_offset, (("heading-offset", "angle"),), has("psi"),
        signed_as("angle"), _either_side, ("heading-offset",), most=lambda f, s: 1.0),
    "hard-iron": Injection(("hard-iron",), sensor.hard_iron, sensor.without_hard_iron,
        (("hard-iron", "amplitude"),), has("psi"), _as("amplitude"), _any_angle, ("hard-iron",),
        most=lambda f, s: 0.7),
    "gyro-bias": Injection(("gyro-bias",), sensor.gyro_bias, sensor.without_gyro_bias,
        (("gyro-bias", "bias"),), has("r"), signed_as("bias"), _either_side, ("gyro-bias",)),
    "late-positions": _late("x", "y"),
    "late-heading": _late("psi"),
    "late-velocities": _late("u", "v"),
    "late-yaw-rate": _late("r"),
    "lever-arm": Injection(("lever-arm",), sensor.lever_arm, sensor.without_lever_arm,
        (("lever-arm", "x"),), has("x", "y", "psi"), _arm, _any_angle, ("lever-arm",)),
    "clock-drift": Injection(("clock-drift",), sensor.clock_drift, sensor.without_clock_drift,
        (("clock-drift", "rate"),), has("u"), signed_as("rate"), _either_side, ("clock-drift",),
        most=lambda f, s: 0.2),
    # actuators: the order replaced by its preimage
    "late-orders": Injection(("thrust-delay", "actuator-response"), order.late_orders,
        order.prompt_orders, (("thrust-delay", "delay"), ("actuator-response", "delay")),
        groups(*_ALL, only="moving"), _as("delay"), in_rows=True),
    "lagging-orders": Injection(("thrust-lag", "actuator-response"), order.lagging_orders,
        order.followed_orders, (("thrust-lag", "time_constant"),
        ("actuator-response", "time_constant")), groups(*_ALL, only="smooth"),
        _as("time_constant")),
    "dead-band": Injection(("deadband", "thrust-curve"), order.dead_band, order.shortened,
        (("deadband", "width"), ("thrust-curve", "deadband")), groups(*_PUSHING, "rudder"),
        _as("width"), most=_half_of_full),
    "play": Injection(("backlash",), order.play, order.played, (("backlash", "width"),),
        groups(*_PUSHING, "propeller", "rudder", only="moving"), _as("width"),
        most=_half_of_full),
    "order-bias": Injection(("actuator-bias",), order.order_bias, order.without_order_bias,
        _BIAS, each(*_ALL), signed_as("bias"), _either_side, most=_half_of_full),
    "asymmetry": Injection(("thrust-asymmetry",), order.asymmetry, order.without_asymmetry,
        (("thrust-asymmetry", "ratio"),), twins, signed_as("ratio"), _either_side,
        most=lambda f, s: 0.8),
    "exchange": Injection((), order.exchanged, order.exchanged, (), twins, _none,
        audit=("swapped-actuators",), may_be_silent=True),
    "power-law": Injection(("thrust-curve",), order.power_law, order.without_power_law,
        (("thrust-curve", "exponent"), ("deadband", "width")), full_thrust,
        lambda s: {"exponent": 1 + s["size"]}, most=lambda f, s: 1.5),
    "loss-with-speed": Injection(("thrust-loss-with-speed",),
        order.scaled_by(order.gain_of_speed), order.scaled_by(order.gain_of_speed, 1.0),
        (("thrust-loss-with-speed", "slope"),), groups(*_PUSHING, needs="u"), _as("slope"),
        most=_half_lost("u")),
    "loss-in-turns": Injection(("thrust-loss-in-turns",),
        order.scaled_by(order.gain_of_turning), order.scaled_by(order.gain_of_turning, 1.0),
        (("thrust-loss-in-turns", "slope"),), groups(*_PUSHING, needs="r"), _as("slope"),
        most=_half_lost("r")),
    # steps in mid-run
    "thrust-step": Injection(("thrust-change",), order.scaled_by(order.gain_of_change),
        order.scaled_by(order.gain_of_change, 1.0), (("thrust-change", "factor"),),
        groups(*_PUSHING), _changed, _onset, most=lambda f, s: 0.7),
    "heading-step": Injection(("heading-offset",), sensor.heading_offset,
        sensor.without_heading_offset, (("heading-offset", "angle"),), has("psi"), _none, _onset,
        ("heading-offset",), True, most=lambda f, s: 1.0),
    "gyro-step": Injection(("gyro-bias",), sensor.gyro_bias, sensor.without_gyro_bias,
        (("gyro-bias", "bias"),), has("r"), _none, _onset, ("gyro-bias",), True),
    # measured actuation that is recorded wrongly
    "feedback-offset": Injection(("feedback-error", "actuator-bias"), order.feedback_offset,
        order.without_feedback_offset, (("feedback-error", "offset"), *_BIAS),
        each(*_ALL, prefix="exec_"), signed_as("offset"), _either_side, ("feedback-error",),
        most=_half_of_full),
    "feedback-scale": Injection(("feedback-error",), order.feedback_scale,
        order.without_feedback_scale, (("feedback-error", "scale"), *_BIAS),
        each(*_ALL, prefix="exec_"), signed_as("scale"), _either_side,
        ("feedback-error",), most=lambda f, s: 0.5),
    "late-feedback": Injection(("feedback-error",), order.late_feedback, order.late_orders,
        (("feedback-error", "delay"), ("thrust-delay", "delay")),
        each(*_ALL, prefix="exec_", only="moving"), _as("delay"), audit=("feedback-error",),
        in_rows=True),
    # what no entry describes
    "swinging-compass": Injection(apply=sensor.swinging_compass, undo=sensor.steady_compass,
        scales=(("heading-offset", "angle"),), places=has("psi"), extra=_period,
        most=lambda f, s: 0.5, **_SILENT),
    "restless-order": Injection(apply=order.restless_order, undo=order.calm_order, scales=_BIAS,
        places=each(*_ALL), extra=_period, most=_half_of_full, **_SILENT),
    # what sensors do without being wrong
    "thinned": Injection(apply=sensor.thinned, undo=None, scales=(), places=has("t"),
        extra=_few_rows, **_SILENT),
    "dropouts": Injection(apply=sensor.dropouts, undo=None, scales=(("row", "t"),),
        places=has("x", "y"), extra=_seeded, audit=("gap",), **_SILENT),
    "quantised": Injection(apply=sensor.quantised, undo=None, scales=(("scatter", "psi"),),
        places=has("psi", columns=["psi"]), audit=("quantised",), **_SILENT),
    "coloured-noise": Injection(apply=sensor.coloured_noise, undo=sensor.without_coloured_noise,
        scales=(("scatter", "x"),), places=has("x", "y"), extra=_seeded, audit=("bursts",),
        **_SILENT),
    "smoothed": Injection(apply=sensor.smoothed, undo=None, scales=(), places=has("u", "v"),
        extra=_odd_rows, audit=("interpolated",), **_SILENT),
}  # fmt: skip


# Hull terms: left out of the vessel file that fits best, in which the recording has them


@dataclasses.dataclass(frozen=True)
class Dropped:
    """Terms that are taken out of a vessel file, and what they may be called when missed."""

    names: tuple[str, ...]
    terms: tuple[str, ...] = ()  # of the hull
    rudder: tuple[tuple[str, float], ...] = ()  # numbers of the rudder, and what they become


_LATERAL = ("Y_vvv", "Y_vvr", "Y_vrr", "Y_rrr", "N_vvv", "N_vvr", "N_vrr", "N_rrr")
DROPPED = {
    "without-X_uu": Dropped(("quadratic-damping",), ("X_uu",)),
    "without-Y_vv": Dropped(("quadratic-damping", "crossflow-drag"), ("Y_vv",)),
    "without-N_rr": Dropped(("quadratic-damping", "crossflow-drag"), ("N_rr",)),
    "without-lift": Dropped(("speed-dependent-damping",), ("Y_uv", "Y_ur", "N_uv", "N_ur")),
    "without-lateral": Dropped(("crossflow-drag", "quadratic-damping"), _LATERAL),
    "without-coupling": Dropped(("sway-yaw-coupling",), ("Y_r", "N_v")),
    "without-interaction": Dropped(("rudder-interaction",), (),
        (("a_H", 0.0), ("gamma_R_port", 1.0), ("gamma_R_starboard", 1.0))),
}  # fmt: skip


def without_terms(document: Document, key: str) -> Document:
    """A vessel's document without what `DROPPED[key]` says."""
    dropped, new = DROPPED[key], copy.deepcopy(document)
    new["hull"] = {k: v for k, v in new["hull"].items() if k not in dropped.terms}
    for rudder in new.get("rudder", []):
        rudder.update({k: v for k, v in dropped.rudder if k in rudder})
    return new


def injected(material: Material, key: str, settings: Settings) -> Material:
    """What the diagnosis is given in a case: an injection in every run, or a hull without terms."""
    if key in DROPPED:
        return dataclasses.replace(material, document=without_terms(material.document, key))
    injection = INJECTIONS[key]
    return material.with_runs(lambda run: injection.apply(run, settings))


def undone(material: Material, key: str, settings: Settings) -> Material:
    """The recordings as they were; raises KeyError for what cannot be undone."""
    undo = INJECTIONS[key].undo
    if undo is None:
        raise KeyError(f"{key} cannot be undone")
    return material.with_runs(lambda run: undo(run, settings))
