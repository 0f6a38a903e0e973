"""The hulls: what the tool is given of them, and how they are driven and measured.

Numbers are plausible for craft of the kind, not measured on any vessel. Hulls of the `develop`
set serve while the tool is worked on; those of the `scored` set differ in size, in the terms that
their file has, and in their actuators.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from .sensors import Instrument


G = 9.81


@dataclass(frozen=True)
class Hull:
    """One hull with its manoeuvres, gusts and instruments."""

    name: str
    kind: str  # twin | azimuth | ship
    set: str  # develop | scored
    document: dict  # the vessel file
    rows: int
    step: float  # s
    hold: float  # s, between random orders
    speed: float  # m/s, typical
    yaw: float  # rad/s, typical
    gust: float  # m/s^2, standard deviation of the sway gusts
    gust_time: float  # s, correlation time
    instruments: dict[str, Instrument]
    mix: Callable[[float, float], list[float]]
    control: float = 1.0  # s, between looks of a controller
    gain: float = 0.8
    lead_time: float = 1.0  # s, of the autopilot's yaw-rate term
    astern: float = 0.5
    lead: float = 15.0  # s, run before the first row
    water: str = "sea"


def twin_mix(top: float, low: float, order: Callable[[float], float] = lambda T: T):
    """Throttle and turn to two thrusters, N each (or `order` of it)."""

    def mix(a: float, b: float) -> list[float]:
        def one(side: float) -> float:
            c = min(max(a + side * b * 0.8, -1.0), 1.0)
            return round(order(c * top if c > 0 else -c * low), 3)

        return [one(1.0), one(-1.0)]

    return mix


def azimuth_mix(count: int, top: float, low: float, widest: float):
    """Force and angle of each; turning to starboard pushes the stern to port (negative angle)."""

    def mix(a: float, b: float) -> list[float]:
        force = round(a * top if a > 0 else -a * low, 2)
        return [force, round(-b * widest, 4)] * count

    return mix


def ship_mix(top: float, widest: float):
    """Revolutions and rudder angle."""
    return lambda a, b: [round(a * top, 3), round(b * widest, 4)]


def gnss(every, position, velocity, compass, gyro, roll=None) -> dict[str, Instrument]:
    """A navigation set: standard deviations of each, resolutions about a third of them."""
    found = {
        "position": Instrument(every, position, 0.01),
        "velocity": Instrument(1, velocity, 0.005 if velocity > 0.01 else 0.001),
        "compass": Instrument(1, compass, math.radians(0.1)),
        "gyro": Instrument(1, gyro, 1e-4),
    }
    if roll:
        found["roll"] = Instrument(1, roll, 1e-4)
    return found


def _file(name: str, source: str, hull: dict, **parts: list[dict]) -> dict:
    return {"format": 1, "name": name, "source": source, "hull": hull, **parts}


_SOURCE = "round numbers for a craft of this kind; not measured on any vessel"


def _pair(x: float, y: float, **more) -> list[dict]:
    return [
        {"name": "port", "x": x, "y": -y, **more},
        {"name": "starboard", "x": x, "y": y, **more},
    ]


def _usv() -> Hull:
    hull = {"length": 4.9, "beam": 2.4, "draught": 0.2, "mass": 180.0, "I_z": 446.0, "x_G": 0.0,
            "X_udot": -12.0, "Y_vdot": -120.0, "N_rdot": -240.0, "X_u": -52.0, "X_uu": -72.0,
            "Y_v": -260.0, "N_r": -900.0, "N_rr": -600.0}  # fmt: skip
    thrusters = _pair(-2.3, 1.03, angle=0.0, max_force=250.0, min_force=-180.0)
    return Hull(
        "usv", "twin", "develop", _file("usv", _SOURCE, hull, thruster=thrusters),
        501, 0.2, 4.0, 1.5, 0.15, 0.02, 2.0,
        gnss(2, 0.15, 0.04, math.radians(0.6), math.radians(0.3)), twin_mix(250.0, -180.0),
    )  # fmt: skip


def _craft() -> Hull:
    hull = {"length": 1.2, "beam": 0.93, "draught": 0.08, "mass": 15.0, "I_z": 1.7, "x_G": 0.05,
            "X_udot": -1.5, "Y_vdot": -20.0, "N_rdot": -2.5, "X_u": -5.0, "X_uu": -10.0,
            "Y_v": -35.0, "N_r": -12.0, "N_rr": -14.0,
            "Y_uv": -10.0, "N_uv": 13.0}  # fmt: skip
    thrusters = _pair(-0.5, 0.285, max_force=50.0, min_force=-27.0)
    return Hull(
        "craft", "twin", "develop", _file("craft", _SOURCE, hull, thruster=thrusters),
        501, 0.16, 2.5, 1.3, 0.4, 0.05, 1.0,
        gnss(2, 0.10, 0.03, math.radians(0.8), math.radians(0.4)), twin_mix(50.0, -27.0),
        control=0.64, lead_time=0.6, lead=8.0,
    )  # fmt: skip


def _tender() -> Hull:
    hull = {"length": 7.2, "beam": 2.4, "draught": 0.55, "mass": 2900.0, "I_z": 9500.0,
            "x_G": 0.1, "X_udot": -150.0, "Y_vdot": -1500.0, "N_rdot": -5200.0,
            "X_u": -160.0, "X_uu": -170.0, "Y_v": -900.0, "Y_vv": -1200.0, "N_r": -6000.0,
            "Y_uv": -450.0, "N_uv": 1400.0, "N_ur": -4500.0}  # fmt: skip
    stern = [{"name": "stern", "x": -3.2, "y": 0.0, "max_force": 2600.0, "min_force": -1500.0}]
    return Hull(
        "tender", "azimuth", "develop", _file("tender", _SOURCE, hull, azimuth_thruster=stern),
        501, 0.24, 5.0, 2.5, 0.2, 0.03, 3.0,
        gnss(2, 0.2, 0.04, math.radians(0.5), math.radians(0.25), math.radians(0.2)),
        azimuth_mix(1, 2600.0, -1500.0, 0.6), lead_time=1.5, astern=0.4, lead=20.0,
    )  # fmt: skip


def _primes(**changes: float) -> dict:
    """Hull derivatives of a full ship, after the manner of the MMG standard method."""
    base = {"X_0": -0.022, "X_vv": -0.04, "X_rr": 0.01, "Y_v": -0.3, "Y_r": 0.07,
            "Y_vvv": -1.5, "Y_vvr": 0.35, "Y_vrr": -0.4, "N_v": -0.12, "N_r": -0.05,
            "N_vvr": -0.28, "N_rrr": -0.015}  # fmt: skip
    return {**base, **changes}


def _ship(name: str, of: str, L: float, ratio_B: float, ratio_d: float, block: float,
          speed: float, revs: float, primes: dict) -> Hull:  # fmt: skip
    """A single-screw ship model; masses from block coefficient, added masses by primes."""
    B, d, rho = L * ratio_B, L * ratio_d, 1000.0
    mass = block * rho * L * B * d
    k = 0.5 * rho * L * L * d
    hull = {"nondimensional": "mmg", "added_mass_coriolis": "no-munk", "water_density": rho,
            "length": L, "beam": round(B, 4), "draught": round(d, 4), "mass": round(mass, 2),
            "x_G": round(0.02 * L, 4), "I_z": round(mass * (0.25 * L) ** 2, 2),
            "X_udot": round(-0.022 * k, 3), "Y_vdot": round(-0.22 * k, 3),
            "N_rdot": round(-0.011 * k * L * L, 3), **primes}  # fmt: skip
    D = round(0.6 * d, 4)
    screw = {"name": "propeller", "x": round(-0.48 * L, 4), "diameter": D,
             "k_T": [0.29, -0.28, -0.13], "wake_fraction": 0.38, "thrust_deduction": 0.2,
             "max_speed": revs, "min_speed": -revs}  # fmt: skip
    height = round(0.75 * d, 4)
    rudder = {"name": "rudder", "propeller": "propeller", "area": round(height * height / 1.6, 6),
              "height": height, "x": round(-0.5 * L, 4), "max_angle": 0.6109, "lift_slope": 2.6,
              "t_R": 0.35, "l_R": round(-0.5 * L, 4), "epsilon": 1.05, "kappa": 0.5}  # fmt: skip
    t = math.sqrt(L / G)
    return Hull(
        name, "ship", of, _file(name, _SOURCE, hull, propeller=[screw], rudder=[rudder]),
        601, round(0.6 * t, 2), 14.0 * t, speed, 0.5 * speed / L, 0.0008, 6.0 * t,
        gnss(1, 0.03, 0.008, math.radians(0.3), math.radians(0.12), math.radians(0.15)),
        ship_mix(revs, 0.6), control=2.4 * t, gain=1.5, lead_time=4.0 * t, astern=0.0,
        lead=40.0 * t, water="fresh",
    )  # fmt: skip


def _catamaran() -> Hull:
    hull = {"length": 6.4, "beam": 2.9, "draught": 0.27, "mass": 420.0, "I_z": 1750.0, "x_G": -0.12,
            "X_udot": -25.0, "Y_vdot": -270.0, "N_rdot": -1000.0, "X_u": -60.0, "X_uu": -95.0,
            "Y_v": -450.0, "Y_vv": -500.0, "N_r": -2900.0}  # fmt: skip
    thrusters = _pair(-2.9, 1.25, angle=0.0, max_force=420.0, min_force=-260.0)
    return Hull(
        "catamaran", "twin", "scored", _file("catamaran", _SOURCE, hull, thruster=thrusters),
        501, 0.2, 5.0, 1.6, 0.15, 0.02, 2.5,
        gnss(2, 0.12, 0.035, math.radians(0.5), math.radians(0.3)), twin_mix(420.0, -260.0),
        lead_time=1.2,
    )  # fmt: skip


def _skiff() -> Hull:
    hull = {"length": 1.9, "beam": 0.75, "draught": 0.14, "mass": 62.0, "I_z": 16.0, "x_G": 0.0,
            "X_udot": -4.0, "Y_vdot": -22.0, "N_rdot": -9.0, "X_u": -24.0, "Y_v": -95.0,
            "Y_vv": -130.0, "N_r": -28.0, "N_rr": -35.0,
            "N_uv": 14.0}  # fmt: skip
    curve = {"c": -0.03, "d": 0.035}  # rev/s: 44 N at 40 rev/s, 35 rev/s of it astern
    thrusters = _pair(-0.85, 0.22, max_force=56.0, min_force=-43.0, curve=curve)
    order = lambda T: math.copysign(math.sqrt(abs(T) / 0.035), T)
    return Hull(
        "skiff", "twin", "scored", _file("skiff", _SOURCE, hull, thruster=thrusters),
        501, 0.16, 3.0, 1.6, 0.4, 0.04, 1.3,
        gnss(2, 0.08, 0.03, math.radians(0.7), math.radians(0.35)), twin_mix(50.0, -36.0, order),
        control=0.64, lead_time=0.7, lead=10.0,
    )  # fmt: skip


def _launch() -> Hull:
    hull = {"length": 10.4, "beam": 3.3, "draught": 0.7, "mass": 7800.0, "I_z": 52000.0,
            "x_G": 0.1, "X_udot": -400.0, "Y_vdot": -3600.0, "N_rdot": -28000.0,
            "X_u": -260.0, "X_uu": -330.0, "Y_v": -4200.0, "Y_r": 1500.0, "N_v": 4500.0,
            "N_uv": 2400.0, "N_r": -52000.0, "N_rr": -45000.0}  # fmt: skip
    both = _pair(-4.6, 0.9, max_force=3200.0, min_force=-1800.0)
    return Hull(
        "launch", "azimuth", "scored", _file("launch", _SOURCE, hull, azimuth_thruster=both),
        501, 0.24, 6.0, 3.2, 0.2, 0.02, 3.5,
        gnss(2, 0.2, 0.04, math.radians(0.4), math.radians(0.2), math.radians(0.2)),
        azimuth_mix(2, 3200.0, -1800.0, 0.5), lead_time=1.5, astern=0.4, lead=25.0,
    )  # fmt: skip


HULLS = {
    h.name: h
    for h in (
        _usv(), _craft(), _tender(),
        _ship("tanker", "develop", 3.2, 0.17, 0.066, 0.81, 0.55, 14.0, _primes()),
        _catamaran(), _skiff(), _launch(),
        _ship("freighter", "scored", 5.6, 0.145, 0.05, 0.68, 0.9, 14.0,
              _primes(X_0=-0.017, Y_v=-0.26, Y_r=0.055, N_v=-0.1, N_r=-0.042, Y_vvv=-1.2)),
    )
}  # fmt: skip
