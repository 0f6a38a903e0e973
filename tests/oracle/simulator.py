# pyright: reportArgumentType=false
"""Reference simulation of a vessel file: DOP853 to 1e-11, restarted at every jump and kink.

State (N, E, psi, u_r, v_r, r), velocities through the water:

    N_dot = u_r cos psi - v_r sin psi + V_cN,  E_dot = u_r sin psi + v_r cos psi + V_cE
    psi_dot = r
    M nu_r_dot = -C(nu_r) nu_r + D(nu_r) + tau + ...

(hull.py; channel.py, actuators.py, screw.py; effects.py, environment.py)

Outputs u, v are over ground in body axes, (u, v) = (u_r, v_r) + R(psi)' V_c.
Orders are held (piecewise constant); actuators are solved in closed form.
"""

from __future__ import annotations

import bisect
import math
import tomllib
from pathlib import Path

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq
from scipy.special import expit

from . import hull as H
from .effects import build, hull_drag
from .environment import to_body
from .screw import Rudder


RTOL, ATOL = 1e-11, 1e-12
MARGIN = 1e-9  # s; kinks closer than this to a restart are that restart
VISIBLE = 1e-9  # a switching function that stays smaller than this does not switch


def load(path) -> dict:
    """A vessel file as a dict."""
    return tomllib.loads(Path(path).read_text())


class Simulator:
    """A run in progress: `order` sets the commands from now on, `run` integrates."""

    def __init__(
        self,
        vessel,
        environment=None,
        state=(0.0,) * 6,
        command=0.0,
        t0=0.0,
        gust=None,
        heel=None,
        soften=0.0,
        rtol=RTOL,
        atol=ATOL,
        max_step=1.0,
    ):
        """state = (N, E, psi, u, v, r), u, v over ground; gust(t): accelerations added.

        heel(t): roll angle phi [rad], for roll-coupling; smooth between the restarts.
        soften: s; a change at a time t_c follows 1 / (1 + exp((t_c - t) / soften)), 0 jumps.
        """
        self.model = build(vessel, environment)
        self.model.heel = heel
        self.soften = soften
        self.M = H.inertia(self.model.hull)  # before any mass-change
        self.terms = H.damping_terms(self.model.hull)
        self.gust, self.tolerances = gust, dict(rtol=rtol, atol=atol, max_step=max_step)
        self.t = self.t0 = float(t0)
        s = np.array(state, float)
        s[3:5] -= to_body(*self.model.current, s[2])
        self.state = s
        self.times, self.pieces = [], []  # start of each step and its dense output
        self.orders: list[tuple[float, dict]] = []
        self.order(command)

    # orders

    def order(self, command) -> None:
        """Command from now on: a number for all actuators, a sequence, or {name: value}."""
        names = [a.name for a in self.model.actuators]
        if isinstance(command, dict):
            held = self.orders[-1][1] if self.orders else dict.fromkeys(names, 0.0)
            values = {n: float(command.get(n, held[n])) for n in names}
        else:
            values = dict(
                zip(names, np.broadcast_to(command, len(names)).astype(float), strict=True)
            )
        self.orders.append((self.t, values))
        for actuator in self.model.actuators:
            actuator.order(self.t, values[actuator.name])

    # forces

    def forces(self, t, psi, u, v, r, segments, drag=1.0, thrust=None, late=()):
        """(X, Y, N) of everything but inertia; u, v relative to the water."""
        X, Y, N = (drag * f for f in hull_drag(self.model, self.terms, u, v, r))
        actuators = list(zip(self.model.actuators, segments, strict=True))
        realised = {actuator.name: segment(t) for actuator, segment in actuators}
        for actuator, _ in actuators:
            a, b, c = actuator.push(realised[actuator.name], u, r, v, realised)
            k = (thrust or {}).get(actuator.name, 1.0)
            X, Y, N = X + k * a, Y + k * b, N + k * c
        acting = [(1.0, force) for force in self.model.forces]
        acting += [(k, force) for k, (_, force) in zip(late, self.model.late_forces, strict=False)]
        cu, cv = to_body(*self.model.current, psi)
        for share, force in acting:
            a, b, c = force(t, psi, u + cu, v + cv, u, v, r)
            X, Y, N = X + share * a, Y + share * b, N + share * c
        return X, Y, N

    def rate(self, t, s, segments, drag=1.0, thrust=None, M=None, late=()):
        """Time derivative of the state."""
        M = M or self.M
        _, _, psi, u, v, r = (float(q) for q in s)
        X, Y, N = self.forces(t, psi, u, v, r, segments, drag, thrust, late)
        a, b, c = H.momentum_force(M, u, v, r)
        du, dv, dr = H.solve_inertia(M, X + a, Y + b, N + c)
        if self.gust is not None:
            g = self.gust(t)
            du, dv, dr = du + g[0], dv + g[1], dr + g[2]
        cos, sin = math.cos(psi), math.sin(psi)
        north, east = self.model.current
        return [u * cos - v * sin + north, u * sin + v * cos + east, r, du, dv, dr]

    def kinks(self, t, s, segments):
        """Functions whose sign changes are kinks of the right-hand side."""
        u, v, r = s[3], s[4], s[5]
        values = [u, v, r]
        if self.model.crossflow:
            half = 0.5 * self.model.hull["length"]
            values += [v + half * r, v - half * r]
        for actuator, segment in zip(self.model.actuators, segments, strict=True):
            values += actuator.kinks(segment(t), u, r, v)
        return np.nan_to_num(np.array(values, float), posinf=1.0, neginf=-1.0)

    # integration

    def next_break(self, until: float) -> float:
        """End of the smooth piece that starts now."""
        model = self.model
        times = [a.next_break(self.t, MARGIN) for a in model.actuators]
        steps = model.drag_steps + model.thrust_steps + model.mass_steps + model.late_forces
        times += [step[0] for step in steps if step[0] > self.t + MARGIN]
        return min([until, *times])

    def piece(self, end: float):
        """Right-hand side and kinks from now to `end`, fixed by what holds in between."""
        middle, model = 0.5 * (self.t + end), self.model
        segments = [a.segment(middle) for a in model.actuators]
        held = self.changed(middle)

        def rate(t, s):
            return self.rate(t, s, segments, *(self.changed(t) if self.soften else held))

        return rate, lambda t, s: self.kinks(t, s, segments)

    def changed(self, t):
        """Factor of drag, those of thrusts, inertia, shares of late forces, as they are at t."""
        model = self.model

        def factor(steps):
            return math.prod(1.0 + (f - 1.0) * self.share(t, when) for when, f in steps)

        aboard = [(m * self.share(t, when), x) for when, m, x in model.mass_steps]
        late = [self.share(t, when) for when, _ in model.late_forces]
        thrust = {
            a.name: factor(
                (w, f) for w, f, names in model.thrust_steps if a.name in (names or [a.name])
            )
            for a in model.actuators
            if not isinstance(a, Rudder)
        }
        return factor(model.drag_steps), thrust, H.loaded(self.M, aboard), late

    def share(self, t, when):
        """How much of a change at `when` there is at t, from 0 to 1."""
        return float(expit((t - when) / self.soften)) if self.soften else float(t > when)

    def run(self, until: float, stop=None, direction: int = 0) -> bool:
        """Integrate to `until`, or to the first sign change of stop(t, state), then True.

        direction 1: only upwards through zero, -1: only downwards. Newton steps on
        re-integrated states polish the time: the event is as accurate as the solution.
        """
        while self.t < until - 1e-13:
            end = self.next_break(until)
            rhs, kinks = self.piece(end)
            solver = DOP853(rhs, self.t, self.state, end, **self.tolerances)
            restart = False
            while solver.status == "running" and not restart:
                solver.step()
                if solver.status == "failed":
                    raise RuntimeError(f"integration failed at {solver.t} s")
                dense, t0, t1 = solver.dense_output(), solver.t_old, solver.t
                s0, s1 = self.state, solver.y
                kink = first_kink(kinks, dense, t0, t1, s0, s1)
                if stop is not None:
                    when = crossing(stop, dense, t0, t1, s0, direction)
                    if when is not None and (kink is None or when <= kink + MARGIN):
                        self.close(rhs, stop, when)
                        return True
                if kink is not None:
                    self.reach(rhs, kink)
                    restart = True
                else:
                    self.record(dense, t1, s1)
        return False

    def record(self, dense, t, s) -> None:
        self.times.append(self.t)
        self.pieces.append(dense)
        self.t, self.state = t, np.array(s)

    def reach(self, rhs, t: float) -> None:
        """Integrate exactly to t inside the present piece."""
        solver = DOP853(rhs, self.t, self.state, t, first_step=t - self.t, **self.tolerances)
        while solver.status == "running":
            solver.step()
            self.record(solver.dense_output(), solver.t, solver.y)

    def close(self, rhs, stop, when: float) -> None:
        """Land on the zero of `stop` near `when`."""
        start, s0, kept = self.t, self.state, len(self.times)
        for _ in range(4):
            del self.times[kept:], self.pieces[kept:]
            self.t, self.state = start, s0
            if when - start > 1e-13:
                self.reach(rhs, when)
            h = 1e-6
            ahead = self.state + h * np.array(rhs(when, self.state))
            behind = self.state - h * np.array(rhs(when, self.state))
            slope = (stop(when + h, ahead) - stop(when - h, behind)) / (2 * h)
            correction = stop(when, self.state) / slope if slope else 0.0
            if abs(correction) < 1e-13 * max(1.0, abs(when)) or abs(correction) > 1e-4:
                return
            when = max(when - correction, start)

    # output

    def at(self, t) -> dict[str, np.ndarray]:
        """x, y, psi, u, v, r (over ground), u_r, v_r, cmd_*, exec_* at the times t.

        And phi where the heel is given.
        """
        t = np.asarray(t, float)
        s = self.states(t)
        body = np.array([to_body(*self.model.current, p) for p in s[2]]).reshape(-1, 2).T
        out = {
            "t": t,
            "x": s[0],
            "y": s[1],
            "psi": s[2],
            "u": s[3] + body[0],
            "v": s[4] + body[1],
        }
        out |= {"r": s[5], "u_r": s[3], "v_r": s[4]}
        # An order given on a row belongs to that row, whatever rounding made of its time.
        starts = [o[0] - 1e-9 for o in self.orders]
        held = [self.orders[max(bisect.bisect_right(starts, q) - 1, 0)][1] for q in t]
        for actuator in self.model.actuators:
            out[f"cmd_{actuator.name}"] = np.array([h[actuator.name] for h in held])
            out[f"exec_{actuator.name}"] = np.array([actuator.segment(q)(q) for q in t])
        if self.model.heel is not None:
            out["phi"] = np.array([float(self.model.heel(q)) for q in t])
        return out

    def states(self, t) -> np.ndarray:
        """The 6 states at the times t, one column each."""
        t = np.atleast_1d(t)
        if len(t) and (t.min() < self.t0 - 1e-9 or t.max() > self.t + 1e-9):
            raise ValueError("time outside the run")
        if not self.pieces:
            return np.repeat(self.state[:, None], len(t), axis=1)
        index = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, None)
        return np.array([self.pieces[i](q) for i, q in zip(index, t, strict=True)]).reshape(-1, 6).T


def crossing(g, dense, t0, t1, s0, direction=0):
    """First sign change of g(t, s) on [t0, t1], sought on eight subintervals; or None."""
    grid = np.linspace(t0, t1, 9)
    values = [g(t0, s0)] + [g(t, dense(t)) for t in grid[1:]]
    for a, b, ga, gb in zip(grid, grid[1:], values, values[1:], strict=False):
        if ga * gb < 0 or (gb == 0 and ga != 0):
            if direction == 0 or direction * (gb - ga) > 0:
                return brentq(lambda q: g(q, dense(q)), a, b, xtol=1e-14, rtol=1e-15)
    return None


def first_kink(kinks, dense, t0, t1, s0, s1):
    """Earliest sign change of a switching function inside the step, not at its ends."""
    a, b = kinks(t0, s0), kinks(t1, s1)
    found = []
    for i in np.flatnonzero((a * b < 0) & (np.maximum(abs(a), abs(b)) > VISIBLE)):
        when = brentq(lambda q, i=i: kinks(q, dense(q))[i] if q > t0 else a[i], t0, t1, xtol=1e-13)
        if t0 + MARGIN < when < t1 - MARGIN:
            found.append(when)
    return min(found, default=None)


def simulate(vessel, schedule, duration, environment=None, state=(0.0,) * 6, t0=0.0, **options):
    """Run held commands [(time, command), ...], in order of time; returns the Simulator.

    The first command holds from the start (and before it, for delays and lags).
    """
    first, *rest = schedule
    sim = Simulator(vessel, environment, state, first[1], t0, **options)
    end = t0 + duration
    for time, command in rest:
        if time >= end:
            break
        sim.run(time)
        sim.order(command)
    sim.run(end)
    return sim
