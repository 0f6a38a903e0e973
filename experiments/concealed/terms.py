"""Inverse dynamics of a case and candidate terms by catalogue names, for the baselines.

From recordings and vessel file alone: readings interpolated and smoothed, accelerations by
differences, residuals of six equations (kinematics of x, y, psi; force X, Y, N), and what each
effect would add to them to first order. No likelihood, no filter.
"""

import csv
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import medfilt

from . import forces as F
from .model import Model, build
from .simulate import Inertia, actuator_force


WINDOW = 15  # rows of the smoothing kernel
EQUATIONS = 6
STEPS = (0.35, 0.5, 0.65)  # of a run: onsets tried for what changes during it


@dataclass
class Regression:
    """Residual y (n,), nuisance columns (n, p) and candidates {name: (n, k)} of all runs.

    Rows are six equations times samples, each equation scaled to unit residual.
    """

    y: np.ndarray
    base: np.ndarray
    candidates: dict[str, np.ndarray]
    rows: list[int]  # rows of one equation of one run, in order


class _Held:
    """A servo that holds what it is given."""

    n = 0.0

    def value(self, t: float) -> float:
        return self.n


def read(path: Path) -> dict[str, np.ndarray]:
    """Columns of a recording, empty cells interpolated, outliers replaced by a running median."""
    with path.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    table = np.array([[float(c) if c else math.nan for c in r] for r in rows[1:]])
    out = dict(zip(rows[0], table.T, strict=True))
    t = out["t"]
    for name, z in out.items():
        there = np.isfinite(z)
        if name == "psi":
            z = np.where(there, z, 0.0)
            z[there] = np.unwrap(z[there])
        z = np.interp(t, t[there], z[there])
        if name in ("x", "y", "psi", "u", "v", "r", "phi"):
            off = z - medfilt(z, 5)
            wild = np.abs(off) > 6.0 * (np.median(np.abs(off)) + 1e-9)
            z = np.where(wild, z - off, z)
        out[name] = z
    return out


def regression(case: Path, paths: list[Path]) -> Regression:
    """The stacked problem of a case's recordings."""
    document = tomllib.loads((case / "vessel.toml").read_text(encoding="utf-8"))
    model = build(document)
    parts = [_run(model, read(p)) for p in paths]
    names = list(parts[0][2])
    y = np.concatenate([p[0].ravel() for p in parts])
    base = np.concatenate([p[1].reshape(-1, p[1].shape[2]) for p in parts])
    found = {
        k: np.concatenate([p[2][k].reshape(-1, p[2][k].shape[2]) for p in parts]) for k in names
    }
    rows = [p[0].shape[1] for p in parts for _ in range(EQUATIONS)]
    scale = _scales(y, base, rows)
    return Regression(
        y / scale, base / scale[:, None], {k: c / scale[:, None] for k, c in found.items()}, rows
    )


def _scales(y: np.ndarray, base: np.ndarray, rows: list[int]) -> np.ndarray:
    """For each row the robust size of its equation's residual after the nuisances."""
    size = np.maximum(np.sqrt((base**2).mean(axis=0)), 1e-12)
    kind = np.concatenate([np.full(n, i % EQUATIONS) for i, n in enumerate(rows)])
    out = np.ones(len(y))
    left = y - base @ (np.linalg.lstsq(base / size, y, rcond=1e-8)[0] / size)
    for k in range(EQUATIONS):
        mine = kind == k
        middle = float(np.median(left[mine]))
        out[mine] = max(1.4826 * float(np.median(np.abs(left[mine] - middle))), 1e-9)
    return out


def _run(model: Model, d: dict[str, np.ndarray]):
    """(residual (6, n), nuisances (6, n, p), candidates) of one run."""
    t = d["t"]
    dt = float(t[1] - t[0])
    # One kernel for everything, so that a step is as wide on both sides of an equation.
    kernel = np.hanning(WINDOW + 2)[1:-1]
    smooth = lambda z: np.convolve(np.pad(z, WINDOW // 2, "edge"), kernel / kernel.sum(), "valid")
    slope = lambda z: np.gradient(smooth(z), dt)
    x_dot, y_dot, psi_dot = slope(d["x"]), slope(d["y"]), slope(d["psi"])
    psi, u, v, r = (smooth(d[c]) for c in ("psi", "u", "v", "r"))
    acc = np.array([slope(d[c]) for c in ("u", "v", "r")])
    c, s = np.cos(psi), np.sin(psi)
    n = len(t)
    i = Inertia(model, 0.0)
    inertial = np.array([
        i.m11 * acc[0] - r * (i.m22 * v + i.m23 * r),
        i.m22 * acc[1] + i.m23 * acc[2] + r * i.m11 * u,
        i.m23 * acc[1] + i.m33 * acc[2] + u * (i.m22 * v + i.m23 * r) - v * i.m11 * u
        - i.no_munk * u * v,
    ])  # fmt: skip
    push = thrusts(model, d, u, v, r)
    # Orders are held from their row on; a central difference sees the mean of two.
    push = 0.5 * (push + np.concatenate([push[:, :1], push[:, :-1]], axis=1))
    push = np.array([smooth(z) for z in push])
    hull = _hull(model.hull, u, v, r)
    forces = inertial - hull - push
    kinematic = np.array([x_dot - c * u + s * v, y_dot - s * u - c * v, psi_dot - r])
    wide = lambda a: np.concatenate([np.zeros((3, *np.shape(a)[1:])), a])
    columns = [wide(_hull({**_zero(model.hull), k: model.hull[k]}, u, v, r))
               for k in _damping_names(model.hull)]  # fmt: skip
    columns += [wide(a) for a in _added_masses(model.hull, acc, u, v, r)]
    base = np.stack(columns, axis=-1)
    found = _candidates(model, d, t, dt, psi, u, v, r, acc, push, hull, inertial)
    y = np.concatenate([kinematic, forces])
    edge = WINDOW  # the smoother's ends are poor
    keep = slice(edge, n - edge)
    return y[:, keep], base[:, keep], {k: z[:, keep] for k, z in found.items()}


def thrusts(model: Model, d: dict, u, v, r) -> np.ndarray:
    """(3, n) force of all actuators at the logged orders."""
    servos: dict[str, Any] = {label: _Held() for label in model.labels()}
    force = actuator_force(model, servos, 1.0)
    out = np.zeros((3, len(u)))
    for k in range(len(u)):
        for label, servo in servos.items():
            servo.n = float(d[f"cmd_{label}"][k])
        out[:, k] = force(0.0, float(u[k]), float(v[k]), float(r[k]))
    return out


def _hull(hull: dict, u, v, r) -> np.ndarray:
    """(3, n) damping."""
    force = F.hull_force(hull)
    return np.array([force(a, b, e) for a, b, e in zip(u, v, r, strict=True)]).T


def _damping_names(hull: dict) -> list[str]:
    known = ("X_udot", "Y_vdot", "N_rdot", "Y_rdot", "N_vdot")
    return [k for k in hull if k[:2] in ("X_", "Y_", "N_") and k not in known]


def _zero(hull: dict) -> dict:
    """The hull without its damping."""
    gone = set(_damping_names(hull))
    return {k: v for k, v in hull.items() if k not in gone}


def _added_masses(hull: dict, acc, u, v, r) -> list[np.ndarray]:
    """What a relative change of X_udot, Y_vdot and N_rdot adds."""
    zero = np.zeros_like(u)
    munk = 0.0 if hull.get("added_mass_coriolis") == "no-munk" else 1.0
    a, b, e = hull["X_udot"], hull["Y_vdot"], hull["N_rdot"]
    return [
        np.array([a * acc[0], a * r * u, -munk * a * u * v]),
        np.array([-b * v * r, b * acc[1], munk * b * u * v]),
        np.array([zero, zero, e * acc[2]]),
    ]


def _candidates(model, d, t, dt, psi, u, v, r, acc, push, hull, inertial) -> dict[str, np.ndarray]:
    """First-order terms of the catalogue's effects, each (6, n, k)."""
    zero, one, c, s = np.zeros_like(u), np.ones_like(u), np.cos(psi), np.sin(psi)
    kin = lambda a, b, e: np.array([a, b, e, zero, zero, zero])
    frc = lambda a, b, e: np.array([zero, zero, zero, a, b, e])
    stack = lambda *columns: np.stack(columns, axis=-1)
    L = model.hull["length"]
    e = 0.05
    drag_u = (_hull(model.hull, u + e, v, r) - _hull(model.hull, u - e, v, r)) / (2 * e)
    drag_v = (_hull(model.hull, u, v + e, r) - _hull(model.hull, u, v - e, r)) / (2 * e)
    side = model.hull["beam"] / model.hull["length"]
    X, Y, N = push
    push_dot = np.gradient(push, dt, axis=1)
    ground = lambda a, b: (c * a - s * b, s * a + c * b)
    after = [t >= share * t[-1] for share in STEPS]
    full = np.abs(push).max(axis=1, keepdims=True) + 1e-9
    cut = np.maximum(np.abs(push) - 0.7 * full, 0.0) * np.sign(push)
    sway, drift = acc[1] + r * u, acc[0] - r * v  # accelerations in space
    found = {
        "heading-offset": stack(kin(*ground(-v, u), zero)),
        "hard-iron": stack(kin(*ground(-v * s, u * s), -c * r), kin(*ground(-v * c, u * c), s * r)),
        "gyro-bias": stack(kin(zero, zero, one)),
        "lever-arm": stack(kin(-s * r, c * r, zero), kin(-c * r, -s * r, zero)),
        "sensor-latency": stack(
            kin(*ground(-acc[0] + r * v, -acc[1] - r * u), zero),
            kin(*ground(acc[0], acc[1]), zero),
            kin(zero, zero, acc[2]),
        ),
        "clock-drift": stack(frc(*(t * a for a in push_dot))),
        "current": stack(frc(*(-c * drag_u + s * drag_v)), frc(*(-s * drag_u - c * drag_v))),
        "wind": stack(frc(side * c, -s, -0.1 * L * s * c), frc(side * s, c, 0.1 * L * s * c)),
        "wave-force": stack(frc(c, -s, zero), frc(s, c, zero)),
        "shallow-water": stack(frc(*(hull * np.array([[0.25], [1.0], [1.0]])))),
        "thrust-lag": stack(frc(*(-_smoothed(push_dot, 8)))),
        "thrust-delay": stack(frc(*(-push_dot))),
        "rate-limit": stack(frc(*(-push_dot * np.abs(push_dot)))),
        "deadband": stack(frc(*(-np.sign(push) * (push != 0)))),
        "backlash": stack(frc(*(-_last_sign(push_dot)))),
        "thrust-saturation": stack(frc(*-cut)),
        "actuator-bias": stack(frc(zero, zero, one), frc(one, zero, zero)),
        "thrust-loss-with-speed": stack(frc(*(-push * u))),
        "thrust-loss-in-turns": stack(frc(*(-push * np.abs(r)))),
        "thrust-change": stack(*(frc(*(push * a)) for a in after)),
        "drag-change": stack(*(frc(*(hull * a)) for a in after)),
        "mass-change": stack(*(frc(-drift * a, -sway * a, zero) for a in after)),
        "crossflow-drag": stack(frc(zero, *_strips(model, v, r))),
        "sway-yaw-coupling": stack(frc(zero, r, zero), frc(zero, zero, v)),
        "speed-dependent-damping": stack(
            frc(zero, u * r, zero), frc(zero, zero, u * r), frc(zero, u * v, zero)
        ),
        "added-mass-coupling": stack(frc(zero, acc[2], acc[1] + u * r), frc(zero, -(r**2), zero)),
        "munk-moment": stack(frc(zero, zero, u * v)),
    }  # fmt: skip
    quadratic = [("X_uu", frc(np.abs(u) * u, zero, zero)), ("Y_vv", frc(zero, np.abs(v) * v, zero)),
                 ("N_rr", frc(zero, zero, np.abs(r) * r))]  # fmt: skip
    if missing := [z for k, z in quadratic if k not in model.hull]:
        found["quadratic-damping"] = stack(*missing)
    if any(a.data.get("y") for a in model.actuators):
        found["thrust-asymmetry"] = stack(frc(zero, zero, _asymmetry(model, d, u, r)))
    if all(a.kind == "thruster" for a in model.actuators):
        x = float(np.mean([a.data["x"] for a in model.actuators]))
        found["thruster-misalignment"] = stack(frc(zero, X, x * X))
    if any(a.kind == "rudder" for a in model.actuators):
        found["propeller-side-force"] = stack(frc(zero, one, zero), frc(zero, zero, one))
        found["rudder-interaction"] = stack(frc(zero, Y, N))
    if "phi" in d:
        found["roll-coupling"] = stack(frc(zero, d["phi"], zero), frc(zero, zero, d["phi"]))
    return found


def _smoothed(z: np.ndarray, rows: int) -> np.ndarray:
    """Each column's mean over the last `rows`: what a lag leaves of a jump."""
    kernel = np.ones(rows) / rows
    return np.array([np.convolve(a, kernel)[: len(a)] for a in z])


def _last_sign(z: np.ndarray) -> np.ndarray:
    """Sign of the last change."""
    out = np.zeros_like(z)
    for k in range(1, z.shape[1]):
        out[:, k] = np.where(z[:, k] != 0, np.sign(z[:, k]), out[:, k - 1])
    return out


def _strips(model: Model, v, r) -> tuple[np.ndarray, np.ndarray]:
    force = F.strip_force(model.hull, 1.0)
    y, n = np.array([force(a, b) for a, b in zip(v, r, strict=True)]).T
    return y, n


def _asymmetry(model: Model, d: dict, u, r) -> np.ndarray:
    """Moment of the starboard less the port thrusters' strengthening."""
    out = np.zeros_like(u)
    for a in model.actuators:
        order = d[f"cmd_{a.name}.force" if a.kind == "azimuth" else f"cmd_{a.name}"]
        T = np.array([F.thrust(a, n, w, q) for n, w, q in zip(order, u, r, strict=True)])
        out -= abs(a.data["y"]) * T
    return out
