"""Motion by momentum: the impulse of hull and water in earth-fixed axes, integrated adaptively.

State: north, east, heading, impulse (P_N, P_E) in axes fixed in the earth (of motion through the
water), impulse of turning h about amidships; roll angle and rate; a sloshing mass. With the
kinetic energy T = 1/2 (m11 u^2 + m22 v^2 + 2 m23 v r + m33 r^2), body impulses are dT/du, dT/dv
and dT/dr, and Newton's laws for the system of hull and water (Kirchhoff) read

    dP/dt = R(psi) (X, Y),    dh/dt = N - (u p_y - v p_x)

so that no Coriolis matrix appears. LSODA, restarted at each order, kink of an actuator and jump
of a parameter; relative tolerance 1e-8.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import odeint

from . import forces as F
from .actuation import Servo
from .model import HEEL, Model


TOLERANCE = 1e-8
CHANNELS = ("x", "y", "psi", "u", "v", "r", "phi")


@dataclass
class Track:
    """A simulated run: `states` (n, 7) of CHANNELS at `t`, finer than the rows, from before 0.

    Past the last row where a clock gains. u, v over ground; `orders` (rows, channels) as logged,
    held from their row on.
    """

    t: np.ndarray
    states: np.ndarray
    orders: np.ndarray
    labels: list[str]
    impulses: np.ndarray  # the integrator's own state, at `t`


class Inertia:
    """Masses of the momentum form at one stage of the run."""

    def __init__(self, model: Model, extra_mass: float):
        h, q = model.hull, model.ratio_of_depth
        self.grow = grow = (1.0 - q) ** -0.5  # of added masses, in shallow water
        mass = h["mass"] + extra_mass
        x_G = h.get("x_G", 0.0)
        cross = 0.5 * (h.get("Y_rdot", 0.0) + h.get("N_vdot", 0.0)) * grow
        self.m11 = mass - h["X_udot"] * grow
        self.m22 = mass - h["Y_vdot"] * grow
        self.m23 = h["mass"] * x_G - cross
        self.m33 = h["I_z"] + h["mass"] * x_G**2 - h["N_rdot"] * grow
        self.det = self.m22 * self.m33 - self.m23**2
        # Where Y_rdot and N_vdot differ, the inertia matrix keeps both and the impulse takes
        # their mean (as Fossen's C does); the difference enters as a force of acceleration.
        self.no_munk = 0.0
        if h.get("added_mass_coriolis") == "no-munk":
            self.no_munk = (h["X_udot"] - h["Y_vdot"]) * grow

    def velocities(self, c: float, s: float, P_N: float, P_E: float, h: float):
        """(u, v, r, p_x, p_y) through the water."""
        px, py = c * P_N + s * P_E, c * P_E - s * P_N
        v = (self.m33 * py - self.m23 * h) / self.det
        r = (self.m22 * h - self.m23 * py) / self.det
        return px / self.m11, v, r, px, py

    def impulse(self, psi: float, u: float, v: float, r: float) -> list[float]:
        """[P_N, P_E, h]."""
        px, py = self.m11 * u, self.m22 * v + self.m23 * r
        c, s = math.cos(psi), math.sin(psi)
        return [c * px - s * py, s * px + c * py, self.m23 * v + self.m33 * r]


class Gusts:
    """Force noise on a grid of times, linear between: (n, 3) N, N, N m; zero where absent."""

    def __init__(self, start: float, step: float, values: np.ndarray):
        self.start, self.step = start, step
        self.values = [tuple(row) for row in values]
        self.last = len(self.values) - 2

    def __call__(self, t: float) -> tuple[float, float, float]:
        a = (t - self.start) / self.step
        k = min(max(int(a), 0), self.last)
        a -= k
        p, q = self.values[k], self.values[k + 1]
        return p[0] + a * (q[0] - p[0]), p[1] + a * (q[1] - p[1]), p[2] + a * (q[2] - p[2])


def derivative(model: Model, servos: dict[str, Servo], gusts: Gusts | None, middle: float):
    """(inertia, right-hand side f(state, t)) that holds in the segment around time `middle`."""
    happened = [(kind, size) for time, kind, size in model.steps if time <= middle]
    inertia = Inertia(model, sum(s for k, s in happened if k == "mass"))
    drag = math.prod(1.0 + s for k, s in happened if k == "drag")
    push = math.prod(1.0 + s for k, s in happened if k == "thrust")
    hull, strips = F.hull_force(model.hull), None
    if model.strip_cd:
        strips = F.strip_force(model.hull, model.strip_cd)
    q = model.ratio_of_depth
    drag_x, drag_y = drag * (1.0 - q) ** -0.25, drag / (1.0 - q)
    actuators = actuator_force(model, servos, push)
    wind = F.wind_force(model.hull, model.wind, model.superstructure) if any(model.wind) else None
    V_N, V_E = model.current
    roll, wave, munk = model.roll, model.wave, model.munk + inertia.no_munk
    extra, slosh = model.extra_forces, model.slosh
    unequal = 0.5 * (model.hull.get("N_vdot", 0.0) - model.hull.get("Y_rdot", 0.0))
    unequal *= inertia.grow

    def f(z, t):
        N_, E_, psi, P_N, P_E, h, phi, phi_dot, s_y, s_v = z.tolist()
        if not math.isfinite(psi):
            raise ArithmeticError("the run diverges")
        c, s = math.cos(psi), math.sin(psi)
        u, v, r, px, py = inertia.velocities(c, s, P_N, P_E, h)
        X, Y, N = hull(u, v, r)
        if strips:
            y, n = strips(v, r)
            Y, N = Y + y, N + n
        X, Y, N = X * drag_x, Y * drag_y, N * drag_y
        x, y, n = actuators(t, u, v, r)
        X, Y, N = X + x, Y + y, N + n + munk * u * v
        u_g, v_g = u + c * V_N + s * V_E, v + c * V_E - s * V_N
        if gusts:
            x, y, n = gusts(t)
            X, Y, N = X + x, Y + y, N + n
        if wind:
            x, y, n = wind(psi, u_g, v_g)
            X, Y, N = X + x, Y + y, N + n
        if wave:
            a = 2.0 * math.pi * wave["frequency"] * t + wave["phase"]
            force = wave["bias"] + wave["amplitude"] * math.sin(a)
            X += force * math.cos(wave["direction"] - psi)
            Y += force * math.sin(wave["direction"] - psi)
        if roll:
            Y += roll.get("Y_phi", 0.0) * phi
            N += roll.get("N_phi", 0.0) * phi
        for e in extra:
            x, y, n = e(t, N_, E_, psi, u, v, r)
            X, Y, N = X + x, Y + y, N + n
        s_a = 0.0
        if slosh:  # a mass on a spring across the hull, driven by the hull's sway acceleration
            w = slosh["omega"]
            pull = w * w * s_y + 2.0 * slosh["damping"] * w * s_v
            s_a = -pull - Y / inertia.m22 - u * r * (1.0 - inertia.m11 / inertia.m22)
            Y += slosh["mass"] * pull
            N += slosh["mass"] * slosh["x"] * pull
        if unequal:  # torque and force of the part of the added mass that is not symmetric
            Y, N = _unequal(inertia, unequal, u, v, r, px, py, X, Y, N)
        w = ROLL["omega"](model)
        phi_a = -w * w * (phi + ROLL["heel"] * u_g * r / 9.81) - 2 * ROLL["damping"] * w * phi_dot
        return (
            c * u - s * v + V_N, s * u + c * v + V_E, r,
            c * X - s * Y, s * X + c * Y, N - (u * py - v * px),
            phi_dot, phi_a, s_v, s_a,
        )  # fmt: skip

    return inertia, f


# Roll is there to be recorded and, where the effect is on, to push: outward heel in a turn.
ROLL = {
    "omega": lambda model: 2.0 * math.pi / (2.2 * math.sqrt(model.hull["beam"] / 2.0)),
    "heel": HEEL,
    "damping": 0.12,
}


def _unequal(i: Inertia, d: float, u, v, r, px, py, X, Y, N):
    """Sway force and yaw moment with M23 - d and M32 + d in place of the mean m23.

    M23 = m x_G - Y_rdot = m23 + d, M32 = m x_G - N_vdot = m23 - d with d = (N_vdot - Y_rdot)/2.
    """
    A, B = Y - r * px, N - (u * py - v * px)  # m22 v' + M23 r' = A, M32 v' + m33 r' = B
    M23, M32 = i.m23 + d, i.m23 - d
    det = i.m22 * i.m33 - M23 * M32
    v_dot, r_dot = (i.m33 * A - M23 * B) / det, (i.m22 * B - M32 * A) / det
    return Y - d * r_dot, N + d * v_dot


def actuator_force(model: Model, servos: dict[str, Servo], push: float) -> Callable:
    """(X, Y, N) of all actuators as a function of (t, u, v, r); `push` scales thrust."""
    parts = []
    rho = F.density(model.hull)
    screws = [a for a in model.actuators if a.kind == "propeller"]
    side, scale, L = model.side, model.thrust_scale, model.hull["length"]
    for a in model.actuators:
        mine = {role: servos[f"{a.name}.{role}" if role else a.name] for role in a.channels}
        law = F.rudder_force(model, a) if a.kind == "rudder" else None
        parts.append((a, mine, law, a.data.get("x", 0.0), a.data.get("y", 0.0)))
    race = servos[screws[0].name] if screws else None

    def force(t: float, u: float, v: float, r: float) -> tuple[float, float, float]:
        X = Y = N = 0.0
        all_thrust = push * (scale(t) if scale else 1.0)
        for a, mine, law, x_a, y_a in parts:
            if law:
                x, y, n = law(mine[""].value(t), u, v, r, race.value(t) if race else 0.0)
                X, Y, N = X + x, Y + y, N + n
                continue
            weak = a.gain * all_thrust * (1.0 - a.loss_speed * u) * (1.0 - a.loss_turn * abs(r))
            if a.kind == "propeller":
                n = mine[""].value(t)
                T = weak * F.propeller_thrust(a.data, rho, n, u, v, r)
                T *= 1.0 - a.data.get("thrust_deduction", 0.0)
                X += T
                N -= y_a * T
                if side:
                    way = "ahead" if T > 0 else "astern"
                    Y += side[f"Y_{way}"] * abs(T)
                    N += side[f"N_{way}"] * L * abs(T)
                continue
            if a.kind == "azimuth":
                angle = mine["angle"].value(t)
                T = weak * F.thrust(a, mine["force"].value(t), u, r)
            else:
                angle = a.data.get("angle", 0.0)
                T = weak * F.thrust(a, mine[""].value(t), u, r)
            x, y = T * math.cos(angle), T * math.sin(angle)
            X, Y, N = X + x, Y + y, N + x_a * y - y_a * x
        return X, Y, N

    return force


def simulate(
    model: Model,
    policy: Callable,
    rows: int,
    step: float,
    lead: int,
    start: tuple[float, float, float, float],
    gusts: Gusts | None = None,
    fine: int = 2,
) -> Track:
    """One run of `rows` rows of `step` s, after `lead` rows that are not recorded.

    `policy(k, look)` gives the orders from row k on (k < 0 in the lead) as a list in the order
    of `model.labels()`, and the row at which it wants to be asked again; `look()` is the state
    (CHANNELS) now. `start` is (x, y, psi, u) when the lead begins. `fine` states per row. For a
    clock that gains the last orders are held as long as its readings run ahead.
    """
    labels = model.labels()
    k, end = -lead, rows - 1
    orders = np.zeros((rows, len(labels)))
    last: dict[str, np.ndarray] = {}

    def look() -> np.ndarray:
        return _motion(model, inertia, last["z"][None, :])[0]

    x, y, psi, u = start
    inertia, _ = derivative(model, _servos(model, labels, [0.0] * len(labels)), None, -1e9)
    last["z"] = np.array([x, y, psi, *inertia.impulse(psi, u, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0])
    servos: dict[str, Servo] = {}
    times, states, impulses = [], [], []
    while k < end:
        values, again = policy(k, look)
        again = min(max(again, k + 1), end)
        servos = servos or _servos(model, labels, values)
        for label, value in zip(labels, values, strict=True):
            servos[label].order(k * step, value)
        orders[max(k, 0) : max(again, 0) + (again == end)] = values
        # Two rows more than a clock reads, so that the spline is as good there as elsewhere.
        ahead = model.sensing.ahead(end * step) if again == end else 0.0
        last_row = again + (math.ceil(ahead / step) + 2 if ahead > 0.0 else 0)
        grid = np.arange(k * fine, last_row * fine + 1) * (step / fine)
        for t, z, inertia in _stretch(model, servos, gusts, last, grid):
            times.append(t)
            states.append(_motion(model, inertia, z))
            impulses.append(z)
        k = again
    t = np.concatenate(times)
    kept = np.concatenate([[True], np.diff(t) > 0.25 * step / fine])
    return Track(
        t[kept], np.concatenate(states)[kept], orders, labels, np.concatenate(impulses)[kept]
    )


def _servos(model: Model, labels: list[str], first: list[float]) -> dict[str, Servo]:
    return {n: Servo(model.channel(n), v) for n, v in zip(labels, first, strict=True)}


def _stretch(model: Model, servos: dict, gusts, last: dict, grid: np.ndarray):
    """Integrate over the grid, restarting at kinks and jumps; pieces (t, impulses, inertia)."""
    breaks = {b for s in servos.values() for b in s.kinks(grid[0], grid[-1])}
    breaks |= {t for t, _, _ in model.steps if grid[0] < t < grid[-1]}
    edges = [grid[0], *sorted(breaks), grid[-1]]
    mass = max(model.hull["mass"], 1.0)
    atol = TOLERANCE * np.array([1, 1, 1, mass, mass, mass, 1, 1, 1, 1])
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        inertia, f = derivative(model, servos, gusts, 0.5 * (a + b))
        if any(t == a for t, _, _ in model.steps) or last.get("inertia") is None:
            last["z"] = _same_velocity(last.get("inertia") or inertia, inertia, last["z"])
        inside = grid[(grid > a + 1e-9) & (grid < b - 1e-9)]
        t = np.concatenate([[a], inside, [b]])
        hmax = gusts.step if gusts else 0.0
        z = odeint(f, last["z"], t, rtol=TOLERANCE, atol=atol, hmax=hmax, mxstep=20000)
        last["z"], last["inertia"] = z[-1], inertia
        on = np.isin(t, grid)
        yield t[on], z[on], inertia


def _same_velocity(before: Inertia, after: Inertia, z: np.ndarray) -> np.ndarray:
    """The impulses that keep the velocities when a mass jumps."""
    u, v, r, _, _ = before.velocities(math.cos(z[2]), math.sin(z[2]), *z[3:6])
    return np.array([*z[:3], *after.impulse(z[2], u, v, r), *z[6:]])


def _motion(model: Model, inertia: Inertia, z: np.ndarray) -> np.ndarray:
    """States (n, 7) of CHANNELS from impulses (n, 10); u, v over ground."""
    c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
    px, py, h = c * z[:, 3] + s * z[:, 4], c * z[:, 4] - s * z[:, 3], z[:, 5]
    u = px / inertia.m11 + c * model.current[0] + s * model.current[1]
    v = (inertia.m33 * py - inertia.m23 * h) / inertia.det
    v = v + c * model.current[1] - s * model.current[0]
    r = (inertia.m22 * h - inertia.m23 * py) / inertia.det
    return np.column_stack([z[:, 0], z[:, 1], z[:, 2], u, v, r, z[:, 6]])
