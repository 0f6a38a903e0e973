# pyright: reportArgumentType=false
"""Standard trials by located events: zig-zag and turning circle with rudder-equivalent angles.

    delta / 35 deg = (T_p - T_s) / (T_p + T_s),  T_p + T_s = total thrust, held constant.

Positive turns to starboard: the port thruster pushes more. Time counts from the first execute;
headings, advance and transfer are relative to the heading and position there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq, fsolve, minimize_scalar

from . import hull as H
from .actuators import order_for_thrust
from .simulator import Simulator


FULL_ANGLE = math.radians(35.0)
SWITCH_ANGLE = math.radians(20.0)


@dataclass
class Trial:
    """Outcome of a trial; angles rad, lengths m, times s."""

    sim: Simulator
    metrics: dict[str, float] = field(default_factory=dict)
    switches: list[float] = field(default_factory=list)  # executes, the first at 0
    overshoots: list[float] = field(default_factory=list)
    peaks: list[float] = field(default_factory=list)  # times of the heading's extremes


def twin(vessel: dict, total: float, delta: float) -> dict[str, float]:
    """Orders of the port (y < 0) and starboard thruster for a total [N] and an angle [rad]."""
    port, starboard = sorted(vessel["thruster"], key=lambda t: t["y"])
    q = delta / FULL_ANGLE
    return {
        port["name"]: order_for_thrust(port, 0.5 * total * (1 + q)),
        starboard["name"]: order_for_thrust(starboard, 0.5 * total * (1 - q)),
    }


def balance(vessel, environment, command, u, v=0.0, r=0.0, psi=0.0):
    """(X, Y, N) with inertial forces at relative (u, v, r), actuators settled at `command`."""
    sim = Simulator(vessel, environment, command=command)
    segments = [a.segment(0.0) for a in sim.model.actuators]
    force = sim.forces(0.0, psi, u, v, r, segments)
    return np.add(force, H.momentum_force(sim.M, u, v, r))


def steady_speed(vessel, total: float, environment=None, high: float = 50.0) -> float:
    """Relative surge speed [m/s] at which X = 0 with v = r = 0, for a total thrust [N]."""
    return speed_under(vessel, twin(vessel, total, 0.0), environment, high)


def speed_under(vessel, command, environment=None, high: float = 50.0) -> float:
    """Relative surge speed [m/s] at which X = 0 with v = r = 0, under an order."""
    found = brentq(lambda u: balance(vessel, environment, command, u)[0], 0.0, high, xtol=1e-14)
    return cast(float, found)


def thrust_for_speed(vessel, speed: float, high: float = 1e5) -> float:
    """Total thrust [N] that holds a speed [m/s] straight ahead in still water."""

    def surge(total):
        return balance(vessel, None, twin(vessel, total, 0.0), speed)[0]

    limit = sum(t.get("max_force", math.inf) for t in vessel["thruster"])
    return cast(float, brentq(surge, 0.0, min(high, limit), xtol=1e-12))


def steady_turn(vessel, total: float, delta: float, guess=None) -> np.ndarray:
    """(u, v, r) of the steady turn in still water, from the force balance alone."""
    start = guess if guess is not None else (steady_speed(vessel, total), 0.0, 0.1 * np.sign(delta))
    command = twin(vessel, total, delta)
    found = fsolve(lambda s: balance(vessel, None, command, *s), start, xtol=1e-13)
    return cast(np.ndarray, found)


def begin(vessel, total, speed, environment, heading0, options) -> Simulator:
    """Straight ahead at `speed` (over ground; default the steady speed in still water)."""
    if speed is None:
        speed = steady_speed(vessel, total)
    state = (0.0, 0.0, heading0, speed, 0.0, 0.0)
    return Simulator(vessel, environment, state, twin(vessel, total, 0.0), **options)


def zigzag(
    vessel,
    total,
    angle=SWITCH_ANGLE,
    heading=SWITCH_ANGLE,
    side="starboard",
    executes=5,
    speed=None,
    environment=None,
    heading0=0.0,
    limit=600.0,
    **options,
):
    """Zig-zag: +angle until the heading has changed by `heading`, then -angle, and so on.

    `executes` counts the angle orders, the first included. overshoots[k] is the excess of the
    heading over `heading` after execute k + 2, at the first zero of the yaw rate after it.
    """
    sim = begin(vessel, total, speed, environment, heading0, options)
    sign = 1.0 if side == "starboard" else -1.0
    trial = Trial(sim, {"approach_speed": float(sim.state[3])})
    sim.order(twin(vessel, total, sign * angle))
    trial.switches.append(0.0)
    for _ in range(executes - 1):
        target = heading0 + sign * heading
        if not sim.run(sim.t + limit, lambda t, s, q=target: s[2] - q, int(sign)):
            break
        trial.switches.append(float(sim.t))
        sign = -sign
        sim.order(twin(vessel, total, sign * angle))
        if not sim.run(sim.t + limit, lambda t, s: s[5], int(sign)):
            break
        trial.peaks.append(float(sim.t))
        trial.overshoots.append(float(-sign * (sim.state[2] - heading0) - heading))
    for k, value in enumerate(trial.overshoots, 1):
        trial.metrics[f"overshoot_{k}"] = value
    finish(trial, heading0)
    return trial


def circle(
    vessel,
    total,
    angle=FULL_ANGLE,
    side="starboard",
    turns=2.0,
    speed=None,
    environment=None,
    heading0=0.0,
    limit=3600.0,
    **options,
):
    """Turning circle until the heading has changed by `turns` revolutions.

    advance, transfer at 90 deg and tactical_diameter at 180 deg are positions of the origin
    along and across the approach course; steady_turning_diameter is 2 hypot(u, v) / |r| at the
    end (still water). switches holds the times of the quarter turns.
    """
    sim = begin(vessel, total, speed, environment, heading0, options)
    sign = 1.0 if side == "starboard" else -1.0
    trial = Trial(sim, {"approach_speed": float(sim.state[3])})
    sim.order(twin(vessel, total, sign * angle))
    for quarter in range(1, int(round(4 * turns)) + 1):
        target = heading0 + sign * quarter * math.pi / 2
        if not sim.run(limit, lambda t, s, q=target: s[2] - q, int(sign)):
            break
        trial.switches.append(float(sim.t))
        ahead, across = along(sim.state, heading0)
        if quarter == 1:
            trial.metrics |= {"advance": ahead, "transfer": sign * across}
        elif quarter == 2:
            trial.metrics["tactical_diameter"] = sign * across
    last = {k: float(v[-1]) for k, v in sim.at([sim.t]).items()}
    trial.metrics["steady_turning_diameter"] = 2 * math.hypot(last["u"], last["v"]) / abs(last["r"])
    finish(trial, heading0)
    return trial


def along(state, heading0: float) -> tuple[float, float]:
    """Distance along and to starboard of the approach course, from the execute."""
    c, s = math.cos(heading0), math.sin(heading0)
    return float(c * state[0] + s * state[1]), float(c * state[1] - s * state[0])


def finish(trial: Trial, heading0: float) -> None:
    """Common metrics: peak_yaw_rate, time and track length to a heading change of 10 deg."""
    trial.metrics["peak_yaw_rate"] = peak_yaw_rate(trial.sim)
    turned = when_turned(trial.sim, heading0, math.radians(10.0))
    if turned is not None:
        trial.metrics["time_to_10_deg"] = turned
        trial.metrics["initial_turning_distance"] = track_length(trial.sim, turned)


def peak_yaw_rate(sim: Simulator) -> float:
    """max |r| [rad/s] over the run: the best sample, refined between its neighbours."""
    grid = np.linspace(sim.t0, sim.t, max(200, int(20 * (sim.t - sim.t0))))
    rates = np.abs(sim.states(grid)[5])
    k = int(np.argmax(rates))
    low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    best = minimize_scalar(
        lambda t: -abs(sim.states(t)[5, 0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(max(rates[k], -best.fun))


def when_turned(sim: Simulator, heading0: float, change: float) -> float | None:
    """First time at which the heading has changed by `change` to either side."""
    grid = np.linspace(sim.t0, sim.t, max(200, int(10 * (sim.t - sim.t0))))
    moved = np.abs(sim.states(grid)[2] - heading0) - change
    k = np.flatnonzero(moved >= 0)
    if not len(k) or k[0] == 0:
        return None
    found = brentq(
        lambda t: abs(sim.states(t)[2, 0] - heading0) - change,
        grid[k[0] - 1],
        grid[k[0]],
        xtol=1e-13,
    )
    return cast(float, found)


def track_length(sim: Simulator, until: float) -> float:
    """Length of the track over ground [m] from the start."""

    def speed(t):
        out = sim.at([t])
        return math.hypot(out["u"][0], out["v"][0])

    return quad(speed, sim.t0, until, epsabs=1e-10, epsrel=1e-10, limit=200)[0]
