# pyright: reportArgumentType=false
"""Recordings of a vessel unlike its file: other derivatives, gusts, concealed effects.

    python -m tests.oracle.make_recordings OUTDIR --vessel V.toml --seed N
        [--effect name key=value ...] [--truth FILE] [--seconds 150] [--rate 5]
        [--perturb 0.15 0.25] [--gust 1] [--noise 1] [--position-every 1]
        [--executed] [--runs NAME ...]

Hull, gusts, noise and manoeuvres are drawn from separate streams of the seed: the same seed
with another effect keeps hull, gusts, noise and open-loop orders.
The vessel has two thrusters, or propellers and rudders: half the sum of the two levels of thrust
then orders revolutions, their difference the rudder's share of its largest angle.
With roll-coupling the vessel rolls (a narrow band about its period, 3 deg) and `phi` is recorded.
The truth is written only to --truth.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import zlib
from pathlib import Path

import numpy as np

from . import hull as H
from .actuators import order_for_thrust
from .effects import listed
from .sensors import ROLL, Sensor, gust, record, roll, suite, write_csv
from .simulator import Simulator, load
from .trials import balance, speed_under


GUST = dict(rtol=1e-8, atol=1e-10, max_step=0.5)
STRAIGHT = 2.0  # s before the manoeuvre, under the first order
MASSES = ("mass", "I_z", "X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")


def stream(seed: int, *names) -> np.random.Generator:
    """An independent generator per purpose."""
    return np.random.default_rng([seed, *(zlib.crc32(str(n).encode()) for n in names)])


def perturbed(vessel: dict, rng, low=0.15, high=0.25) -> dict:
    """Derivatives times 1 +- [low, high] (either sign), masses a quarter of that."""
    true = copy.deepcopy(vessel)
    for key, value in vessel["hull"].items():
        change = rng.uniform(low, high) * rng.choice([-1.0, 1.0])
        if H.DERIVATIVE.match(key):
            true["hull"][key] = value * (1 + change)
        elif key in MASSES:
            true["hull"][key] = value * (1 + 0.25 * change)
    return true


def orders(vessel: dict, port: float, starboard: float) -> dict[str, float]:
    """Orders for levels of full thrust in [-1, 1], ahead by max_force, astern by min_force."""
    if not vessel.get("thruster"):
        return screw_orders(vessel, 0.5 * (port + starboard), port - starboard)
    out = {}
    pair = sorted(vessel["thruster"], key=lambda t: t["y"])
    for thruster, level in zip(pair, (port, starboard), strict=True):
        full = thruster["max_force"] if level >= 0 else -thruster["min_force"]
        out[thruster["name"]] = round(order_for_thrust(thruster, level * full), 4)
    return out


def screw_orders(vessel: dict, level: float, turn: float) -> dict[str, float]:
    """Orders for a level of full thrust and a share of the rudder, both in [-1, 1]."""
    out = {}
    for p in vessel["propeller"]:
        full = p["max_speed"] if level >= 0 else -p["min_speed"]
        out[p["name"]] = round(math.copysign(full * math.sqrt(abs(level)), level), 4)
    for r in vessel.get("rudder", []):
        out[r["name"]] = round(r["max_angle"] * min(max(turn, -1.0), 1.0), 4)
    return out


class Deck:
    """Levels of thrust in [-1, 1], port first, ordered on the row clock."""

    def __init__(self, vessel, sim, dt, end):
        self.vessel, self.sim, self.dt, self.end = vessel, sim, dt, end

    def order(self, port: float, starboard: float) -> None:
        self.sim.order(orders(self.vessel, port, starboard))

    def hold(self, seconds: float) -> bool:
        """Run on to the next row at or after `seconds` from now; False at the end."""
        rows = max(1, math.ceil((self.sim.t + seconds) / self.dt - 1e-6))
        self.sim.run(min(rows * self.dt, self.end))
        return self.sim.t < self.end - 1e-9

    def until_heading(self, target: float, direction: float) -> bool:
        """Run on to the first row at which the heading has passed the target."""
        self.sim.run(self.end, lambda t, s: s[2] - target, int(direction))
        return self.sim.t < self.end - 1e-9 and self.hold(0.0)


def random_steps(deck, rng, mean, spread, low=2.0, high=9.0):
    """Independent levels around a mean, held for random times."""
    while True:
        deck.order(*np.clip(mean + spread * rng.uniform(-1, 1, 2), -0.9, 0.95))
        if not deck.hold(rng.uniform(low, high)):
            return


def zigzag(deck, rng, mean, difference, heading):
    """Zig-zag in heading at the level mean +- difference."""
    start, sign = deck.sim.state[2], rng.choice([-1.0, 1.0])
    deck.order(mean, mean)
    alive = deck.hold(5.0)
    while alive:
        deck.order(mean + sign * difference, mean - sign * difference)
        alive = deck.until_heading(start + sign * heading, sign)
        sign = -sign


def circles(deck, rng, mean, difference):
    """A steady turn to one side, then to the other."""
    sign = rng.choice([-1.0, 1.0])
    for share in (0.55, 1.0):
        deck.order(mean + sign * difference, mean - sign * difference)
        deck.hold(share * deck.end - deck.sim.t)
        sign = -sign


def speed_steps(deck, rng, levels):
    """Equal thrust on both sides in steps, with coasting (0) and braking (< 0)."""
    hold = deck.end / len(levels)
    for level in levels:
        turn = 0.04 * rng.choice([-1.0, 1.0])
        deck.order(level + turn * (level != 0), level - turn * (level != 0))
        if not deck.hold(hold * rng.uniform(0.9, 1.1)):
            return
    deck.hold(deck.end)


def spin(deck, rng):
    """Turning on the spot both ways, with pauses and a burst ahead."""
    turns = (
        (0, 0),
        (0.4, -0.5),
        (0, 0),
        (-0.5, 0.4),
        (0.3, 0.3),
        (0.6, -0.75),
        (-0.2, -0.2),
        (0, 0),
    )
    for a, b in turns:
        deck.order(a, b)
        if not deck.hold(deck.end / 8 * rng.uniform(0.9, 1.1)):
            return
    deck.hold(deck.end)


MANOEUVRES = {  # level at the start, what is done
    "random-slow": (0.15, lambda d, g: random_steps(d, g, 0.15, 0.35)),
    "random-fast": (0.5, lambda d, g: random_steps(d, g, 0.5, 0.4)),
    "random-steps": (0.0, lambda d, g: random_steps(d, g, 0.2, 0.75, 2.0, 5.0)),
    "zigzag-slow": (0.2, lambda d, g: zigzag(d, g, 0.2, 0.12, math.radians(20))),
    "zigzag-fast": (0.6, lambda d, g: zigzag(d, g, 0.6, 0.3, math.radians(20))),
    "circle-slow": (0.2, lambda d, g: circles(d, g, 0.2, 0.12)),
    "circle-fast": (0.6, lambda d, g: circles(d, g, 0.6, 0.35)),
    "speed-steps": (
        0.1,
        lambda d, g: speed_steps(d, g, [0.1, 0.5, 0.9, 0.3, 0.0, 0.7, -0.4, 0.2]),
    ),
    "coast": (0.8, lambda d, g: speed_steps(d, g, [0.8, 0.0, 0.8, 0.0, -0.5, 0.5])),
    "spin": (0.0, spin),
}


def start_state(vessel, rng, level, current):
    """Anywhere, any heading, steadily ahead through the water at the level's speed."""
    plain = {key: value for key, value in vessel.items() if key != "effect"}
    u = speed_under(plain, orders(vessel, level, level)) if level > 0 else 0.0
    x, y, psi = *rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi)
    c, s = math.cos(psi), math.sin(psi)
    return (
        x,
        y,
        psi,
        u + c * current[0] + s * current[1],
        c * current[1] - s * current[0],
        0.0,
    )


def perform(vessel, name, seed, environment=None, seconds=150.0, rate=5.0, gusts=1.0):
    """Simulate one manoeuvre of the true vessel; returns the Simulator at `seconds`."""
    level, manoeuvre = MANOEUVRES[name]
    rng = stream(seed, name, "orders")
    std, blow = gusts * gust_scale(vessel), None
    if gusts:
        blow = gust(stream(seed, name, "gust"), 0.0, seconds, std)
    current, heel = Simulator(vessel, environment).model.current, None
    if any(effect["name"] == "roll-coupling" for effect in listed(vessel, environment)):
        heel = roll(stream(seed, name, "roll"), 0.0, seconds, roll_period(vessel))
    state = start_state(vessel, rng, level, current)
    first, options = orders(vessel, level, level), GUST if gusts else {}
    sim = Simulator(vessel, environment, state, first, gust=blow, heel=heel, **options)
    deck = Deck(vessel, sim, 1.0 / rate, seconds)
    if deck.hold(STRAIGHT):
        manoeuvre(deck, rng)
    sim.run(seconds)
    return sim


def gust_scale(vessel) -> np.ndarray:
    """Standard deviations of the gusts: 1 % of full thrust and of its yaw moment.

    A vessel without thrusters: of the bollard pull, with a quarter of its length as the arm.
    """
    M = H.inertia(vessel["hull"])
    if vessel.get("thruster"):
        full = sum(t["max_force"] for t in vessel["thruster"])
        arm = max(abs(t["y"]) for t in vessel["thruster"])
    else:
        full = balance(vessel, None, screw_orders(vessel, 1.0, 0.0), 0.0)[0]
        arm = 0.25 * vessel["hull"]["length"]
    return 0.01 * full * np.array([1 / M[0][0], 1 / M[1][1], arm / M[2][2]])


def roll_period(vessel) -> float:
    """Natural period [s], 2 pi k / sqrt(g GM) with k = 0.4 beam and GM = 0.1 beam."""
    return 2.0 * math.pi * 0.4 * math.sqrt(vessel["hull"]["beam"] / (9.81 * 0.1))


def produce(
    out,
    vessel,
    seed,
    environment=None,
    truth=None,
    seconds=150.0,
    rate=5.0,
    perturb=(0.15, 0.25),
    gusts=1.0,
    noise=1.0,
    position_every=1,
    executed=False,
    runs=None,
):
    """Write one CSV per manoeuvre to `out` and, if asked for, the truth to another file."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    true = perturbed(vessel, stream(seed, "hull"), *perturb)
    names, starts = list(runs or MANOEUVRES), {}
    times = np.arange(int(round(seconds * rate)) + 1) / rate
    for name in names:
        sim = perform(true, name, seed, environment, seconds, rate, gusts)
        rng, sensors = stream(seed, name, "noise"), suite(noise, position_every)
        if sim.model.heel is not None:
            sensors[ROLL] = Sensor(math.radians(0.1) * noise, 1e-4)
        write_csv(out / f"{name}.csv", record(sim, times, sensors, rng, executed=executed))
        starts[name] = {k: float(v[0]) for k, v in sim.at([0.0]).items()}
    if truth:
        content = {
            "seed": seed,
            "vessel": true,
            "effects": environment or {},
            "recordings": starts,
        }
        content |= {"gusts": gusts, "noise": noise, "seconds": seconds, "rate": rate}
        Path(truth).write_text(json.dumps(content, indent=1))


def parse_effects(entries) -> dict[str, dict]:
    """[["current", "speed=0.3", ...], ...] as {name: parameters}; lists are comma-separated."""
    out = {}
    for name, *pairs in entries or []:
        values = {}
        for key, text in (pair.split("=", 1) for pair in pairs):
            try:
                values[key] = float(text)
            except ValueError:
                values[key] = text.split(",")
        out[name] = values
    return out


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("out")
    parser.add_argument("--vessel", required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--effect", nargs="+", action="append")
    parser.add_argument("--truth")
    parser.add_argument("--seconds", type=float, default=150.0)
    parser.add_argument("--rate", type=float, default=5.0)
    parser.add_argument("--perturb", type=float, nargs=2, default=(0.15, 0.25))
    parser.add_argument("--gust", type=float, default=1.0)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--position-every", type=int, default=1)
    parser.add_argument("--executed", action="store_true")
    parser.add_argument("--runs", nargs="+", choices=list(MANOEUVRES))
    a = parser.parse_args(arguments)
    produce(
        a.out,
        load(a.vessel),
        a.seed,
        parse_effects(a.effect),
        a.truth,
        a.seconds,
        a.rate,
        a.perturb,
        a.gust,
        a.noise,
        a.position_every,
        a.executed,
        a.runs,
    )


if __name__ == "__main__":
    main()
