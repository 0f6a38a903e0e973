"""True vessels whose base physics is drawn, a little outside the tool's class, or beyond it."""

import math

import numpy as np

from .effects_sensors import weight
from .forces import hull_force
from .hulls import Hull
from .model import Model, build, density
from .simulate import Inertia


SPREAD = 0.25  # standard deviation of the logarithm of true over given derivative
MOST_UNSTABLE = 0.1  # growth rate of a deviation from a straight course, speeds per length
SPREAD_INERTIA = 0.08  # of the moment of inertia
_EXACT = ("length", "beam", "draught", "mass", "x_G", "water_density")


def true_model(hull: Hull, rng: np.random.Generator, spread: float = SPREAD) -> Model:
    """The hull's model with derivatives and added masses about 25 % off the file's.

    Mass, geometry, thrusters, propeller and rudder are as in the file: they are the anchor.
    Drawn again while a straight course at speed is more unstable than a real hull's would be.
    """
    for _ in range(100):
        model = _drawn(hull, rng, spread)
        if growth(model, hull) <= MOST_UNSTABLE * hull.speed / model.hull["length"]:
            return model
    raise ValueError(f"{hull.name} is unstable whatever is drawn")


def growth(model: Model, hull: Hull) -> float:
    """Largest real part of the eigenvalues of sway and yaw at the typical speed and 1.5 times
    that, without thrust, 1/s."""
    found = []
    for u in (hull.speed, 1.5 * hull.speed):
        e, f = 1e-4 * u, 1e-4 * u / model.hull["length"]
        by_v = (_acceleration(model, u, e, 0.0) - _acceleration(model, u, -e, 0.0)) / (2.0 * e)
        by_r = (_acceleration(model, u, 0.0, f) - _acceleration(model, u, 0.0, -f)) / (2.0 * f)
        found.append(np.linalg.eigvals(np.column_stack([by_v, by_r])).real.max())
    return float(max(found))


def _acceleration(model: Model, u: float, v: float, r: float) -> np.ndarray:
    """(v_dot, r_dot) of the hull, with a rudder at rest where it has one."""
    i = Inertia(model, 0.0)
    _, Y, N = hull_force(model.hull)(u, v, r)
    N += i.no_munk * u * v
    for a in model.actuators:
        if a.kind == "rudder":
            x = a.data["x"]
            lift = 0.5 * density(model.hull) * a.data["area"] * a.data["lift_slope"] * u
            Y, N = Y - lift * (v + x * r), N - lift * x * (v + x * r)
    p = i.m22 * v + i.m23 * r
    A, B = Y - i.m11 * u * r, N - u * p + v * i.m11 * u
    return np.array([i.m33 * A - i.m23 * B, i.m22 * B - i.m23 * A]) / i.det


def _drawn(hull: Hull, rng: np.random.Generator, spread: float) -> Model:
    model = build(hull.document)
    for name, value in model.hull.items():
        if name in _EXACT or not isinstance(value, float) or value == 0.0:
            continue
        width = min(spread, SPREAD_INERTIA) if name == "I_z" else spread
        model.hull[name] = value * math.exp(width * float(np.clip(rng.standard_normal(), -2, 2)))
    return model


def benign(model: Model, hull: Hull, rng: np.random.Generator) -> dict:
    """A small misfit that has no name: one or two of four, drawn. Returns what was done."""
    h, U, yaw = model.hull, hull.speed, hull.yaw
    L, F = h["length"], weight(hull)
    done: dict = {}
    kinds = ["cubic"] if hull.kind == "ship" else ["cubic", "coupling", "bend"]
    if "X_uu" in h or "X_0" in h:  # what the exponent is of
        kinds = ["power", *kinds]
    for kind in rng.choice(kinds, int(rng.integers(1, 3)), replace=False):
        if kind == "power":
            done[kind] = h["power"] = 1.9
            h["power_speed"] = U
        elif kind == "cubic" and hull.kind == "ship":
            done[kind] = h["N_vvv"] = h.get("N_vvv", 0.0) - 0.02
        elif kind == "cubic":
            share = 0.05 * float(rng.uniform(0.5, 1.0))
            # A twentieth of the yaw damping at twice the typical yaw rate, as fast as hulls turn:
            # a twentieth at the typical rate would be a fifth there, and seen at once.
            top = 2.0 * yaw
            done[kind] = h["N_rrr"] = share * (h["N_r"] + h.get("N_rr", 0.0) * top) / top**2
        elif kind == "coupling":
            share = 0.02 * float(rng.uniform(-1.0, 1.0))
            h["Y_r"] = h.get("Y_r", 0.0) + share * F / yaw
            h["N_v"] = h.get("N_v", 0.0) + share * F * L / (0.2 * U)
            done[kind] = share
        else:
            done[kind] = 0.02
            for a in model.actuators:
                a.bend = 0.02
    return done


def outside(model: Model, hull: Hull, rng: np.random.Generator) -> dict:
    """One effect that the catalogue does not have. Returns what was done."""
    kinds = ["slosh", "one-sided-turn-drag", "air-in-propeller", "tether", "late-log"]
    kind = str(rng.choice(kinds))
    h, seconds = model.hull, hull.rows * hull.step
    F, t = weight(hull), hull.hold
    side = float(rng.choice([-1.0, 1.0]))
    size = float(np.exp(rng.uniform(math.log(0.5), math.log(2.0))))
    if kind == "slosh":
        model.slosh = {"mass": 0.2 * size * h["mass"], "omega": 2.0 * math.pi / (0.8 * t),
                       "damping": 0.05, "x": 0.2 * side * h["length"]}  # fmt: skip
    elif kind == "one-sided-turn-drag":
        k = 0.6 * size * F / (hull.yaw * hull.speed)
        model.extra_forces.append(
            lambda t, x, y, psi, u, v, r: (-k * u * max(side * r, 0.0), 0.0, 0.0)
        )
    elif kind == "air-in-propeller":
        model.thrust_scale = _bursts(rng, seconds, t, 0.35 * size)
    elif kind == "tether":
        k = 0.15 * size * F / h["length"]
        slack = 3.0 * h["length"]
        model.extra_forces.append(_tether(k, slack))
    else:
        late = 0.6 * size * h["length"] / hull.speed
        edges = np.sort(rng.uniform(0.0, seconds, 6))
        windows = [(float(a), float(b), late) for a, b in edges.reshape(3, 2)]
        model.sensing.late_windows = windows
    return {"kind": kind, "size": size}


def _bursts(rng: np.random.Generator, seconds: float, length: float, loss: float):
    """Thrust falls by `loss` in bursts at random times, with edges of a tenth of their length."""
    starts = np.sort(rng.uniform(0.0, seconds, 8))

    def scale(t: float) -> float:
        fall = 0.0
        for s in starts:
            a = (t - s) / length
            if 0.0 < a < 1.0:
                fall = max(fall, min(1.0, 10.0 * a, 10.0 * (1.0 - a)))
        return 1.0 - min(loss, 0.8) * fall

    return scale


def _tether(k: float, slack: float):
    """A line to the origin that pulls amidships once it is taut."""

    def force(t, x, y, psi, u, v, r):
        out = math.hypot(x, y)
        if out <= slack:
            return 0.0, 0.0, 0.0
        pull = -k * (out - slack) / out
        c, s = math.cos(psi), math.sin(psi)
        return pull * (c * x + s * y), pull * (c * y - s * x), 0.0

    return force


def gust_grid(hull: Hull, rng: np.random.Generator, start: float, end: float):
    """Force noise (step, values): Ornstein-Uhlenbeck in each degree of freedom and a wave band.

    The wave band is white noise through an oscillator with 10 % damping, period of waves as long
    as the hull, 40 % of the variance.
    """
    step = hull.step
    n = int((end - start) / step) + 3
    h = hull.document["hull"]
    m, L = h["mass"], h["length"]
    scale = np.array([m, m, m * L * 0.25]) * hull.gust * np.array([1.0, 1.0, 1.0])
    slow = _ornstein(rng, n, step / hull.gust_time)
    omega = math.sqrt(2.0 * math.pi * 9.81 / (2.0 * L))
    fast = _oscillator(rng, n, min(omega * step, 1.0))
    return step, scale * (math.sqrt(0.6) * slow + math.sqrt(0.4) * fast)


def _ornstein(rng: np.random.Generator, n: int, a: float) -> np.ndarray:
    keep = math.exp(-a)
    x = np.zeros((n, 3))
    x[0] = rng.standard_normal(3)
    noise = rng.standard_normal((n, 3)) * math.sqrt(1.0 - keep * keep)
    for k in range(1, n):
        x[k] = keep * x[k - 1] + noise[k]
    return x


def _oscillator(rng: np.random.Generator, n: int, angle: float) -> np.ndarray:
    """Second-order autoregression with poles exp(-0.1 angle +- i angle), unit variance."""
    rho = math.exp(-0.1 * angle)
    p, q = 2.0 * rho * math.cos(angle), -rho * rho
    x = np.zeros((n + 50, 3))
    noise = rng.standard_normal((n + 50, 3))
    for k in range(2, n + 50):
        x[k] = p * x[k - 1] + q * x[k - 2] + noise[k]
    variance = (1.0 - q) / ((1.0 + q) * ((1.0 - q) ** 2 - p * p))
    return x[50:] / math.sqrt(variance)
