"""A vessel's planar motion from a table of numbers, in plain Python.

This file goes as it is into functional mock-up units, where neither diffsea nor any other package
may be needed: it imports the standard library alone. The table is that of
`exports.equations.Equations.as_dict`. Axes are NED and forward, starboard, down; SI units, rad.
"""

import bisect
import itertools
import math


STATES = ("x", "y", "psi", "u", "v", "r")
LONGEST_STEP = 0.05  # s of the integrator's own, far below any vessel's time constants
_SMALL = 1e-12  # m^2/s^2, keeps square roots and angles defined at rest
_SMALLEST_SHARE = 1e-6  # of full order: power laws are linear below


class PlanarVessel:
    """A vessel that is integrated in steps: servos in closed form, motion by Runge-Kutta."""

    def __init__(self, equations, state=(0.0,) * 6, orders=None):
        """
        Arguments:
            equations: the table of numbers.
            state: x, y (m), psi (rad), u, v (m/s over ground), r (rad/s).
            orders: by channel, to which the actuators have long settled; neutral where not given.
        """
        self.equations = equations
        self.channels = equations["channels"]
        neutral = {c["name"]: c["neutral"] for c in self.channels}
        orders = {**neutral, **(orders or {})}
        self.state = list(state)
        self.executed = {c["name"]: target(c, orders[c["name"]]) for c in self.channels}
        self._times, self._given = [-math.inf], [orders]

    def advance(self, t, span, orders, current=(0.0, 0.0)):
        """Move on by `span` s from `t` s, with `orders` from now on and a current (m/s N, E)."""
        self._times.append(t)
        self._given.append({**self._given[-1], **orders})
        end = t + span
        delays = {c["delay"] or 0.0 for c in self.channels}
        takes_effect = (given + delay for given in self._times[1:] for delay in delays)
        breaks = [t, *sorted(at for at in takes_effect if t < at < end), end]
        for begin, until in itertools.pairwise(breaks):
            steps = max(1, math.ceil((until - begin) / LONGEST_STEP))
            for _ in range(steps):
                self._step(begin, (until - begin) / steps, current)
        oldest = end - max(delays, default=0.0)
        first = max(0, bisect.bisect_right(self._times, oldest) - 1)
        del self._times[:first], self._given[:first]

    def _step(self, begin, h, current):
        """One Runge-Kutta step; no order takes effect within it."""
        targets = {c["name"]: self._target_at(c, begin) for c in self.channels}

        def acting(after):
            return {
                c["name"]: response(c, self.executed[c["name"]], targets[c["name"]], after)
                for c in self.channels
            }

        nodes = acting(0.0), acting(0.5 * h), acting(h)
        start = self.state
        k1 = self.rate(start, nodes[0], current)
        k2 = self.rate(_moved(start, k1, 0.5 * h), nodes[1], current)
        k3 = self.rate(_moved(start, k2, 0.5 * h), nodes[1], current)
        k4 = self.rate(_moved(start, k3, h), nodes[2], current)
        slopes = [(a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        self.state, self.executed = _moved(start, slopes, h), nodes[2]

    def _target_at(self, channel, t):
        """What a channel is on its way to at `t` s."""
        at = t - (channel["delay"] or 0.0)
        order = self._given[bisect.bisect_right(self._times, at + 1e-9) - 1][channel["name"]]
        return target(channel, order)

    def rate(self, state, executed, current=(0.0, 0.0)):
        """Time derivatives of x, y, psi, u, v, r (over ground) at executed values by channel."""
        _, _, psi, u, v, r = state
        sine, cosine = math.sin(psi), math.cos(psi)
        flow = (cosine * current[0] + sine * current[1], cosine * current[1] - sine * current[0])
        X, Y, N = self.force(u - flow[0], v - flow[1], r, executed)
        m11, m22, m23, m32, m33 = self.equations["mass_matrix"]
        determinant = m22 * m33 - m23 * m32
        return [
            cosine * u - sine * v,
            sine * u + cosine * v,
            r,
            X / m11 + r * flow[1],
            (m33 * Y - m23 * N) / determinant - r * flow[0],
            (m22 * N - m32 * Y) / determinant,
        ]

    def force(self, u, v, r, executed):
        """Surge and sway force (N) and yaw moment (N m), at velocities through the water."""
        table = self.equations
        parts = [polynomial(p, u, v, r) for p in table["polynomials"]]
        if table["crossflow"]:
            parts.append(crossflow(table["crossflow"], v, r))
        jets = {
            a["name"]: jet(a, executed[a["channel"]], u, v, r)
            for a in table["actuators"]
            if a["kind"] == "propeller"
        }
        for part in table["actuators"]:
            parts.append(_ACTUATORS[part["kind"]](part, executed, u, v, r, jets))
        return tuple(map(sum, zip(*parts, strict=True)))


def _moved(state, slope, by):
    return [value + by * change for value, change in zip(state, slope, strict=True)]


# Channels


def target(channel, order):
    """What a channel settles to: bias, dead band about neutral, limits."""
    above = order + channel["bias"] - channel["neutral"]
    above = math.copysign(max(abs(above) - channel["deadband"], 0.0), above)
    value = above + channel["neutral"]
    if channel["lower"] is not None:
        value = max(value, channel["lower"])
    return value if channel["upper"] is None else min(value, channel["upper"])


def response(channel, value, goal, after):
    """Executed value `after` s of a constant goal: at the slew rate, then by a lag."""
    lag, slowness = channel["time_constant"] or 0.0, channel["slowness"] or 0.0
    if channel["endless"]:
        goal = goal - 2 * math.pi * round((goal - value) / (2 * math.pi))
    error = value - goal
    if slowness and abs(error) * slowness > lag:
        slewing = min(abs(error) * slowness - lag, after)
        error = math.copysign(abs(error) - slewing / slowness, error)
        after = after - slewing
    if lag:
        return goal + error * math.exp(-after / lag)
    return goal + error if slowness and after <= 0 else goal


# Hull


def polynomial(table, u, v, r, d=0.0):
    """A sum of terms (N, N, N m), of a prime set in its scaling; d is a rudder's angle, rad."""
    scaling, unit, arm = table["scaling"], 1.0, 1.0
    if scaling:
        speed = math.sqrt(u * u + v * v + _SMALL)
        arm = scaling["length"]
        unit = 0.5 * scaling["water_density"] * arm * scaling["width"] * speed**2
        u, v, r = (u - scaling["reference_speed"]) / speed, v / speed, r * arm / speed
    values, sums = {"u": u, "v": v, "r": r, "d": d}, {"X": 0.0, "Y": 0.0, "N": 0.0}
    for term in table["terms"]:
        product = term["coefficient"]
        for place, letter in enumerate(term["letters"]):
            value = values[letter]
            product *= abs(value) if place == 0 and term["modulus"] else value
        if term["exponent"] != 1.0:
            value = values[term["letters"]]
            product *= (value * value + _SMALL) ** (0.5 * (term["exponent"] - 1))
        sums[term["axis"]] += product
    return unit * sums["X"], unit * sums["Y"], unit * arm * sums["N"]


def crossflow(table, v, r):
    """Strip theory: `-1/2 rho C_d T int (1, x) |v + x r| (v + x r) dx`, in closed form."""
    half = 0.5 * table["length"]
    unit = -0.5 * table["water_density"] * table["draught"] * table["cd"]
    if abs(v) >= abs(r) * half:
        sense = math.copysign(1.0, v)
        sway = sense * (2 * half * v * v + 2 / 3 * r * r * half**3)
        return 0.0, unit * sway, unit * sense * 4 / 3 * v * r * half**3
    aft, fore = v - r * half, v + r * half
    cubes = (abs(fore) ** 3 - abs(aft) ** 3) / 3
    fourths = (abs(fore) ** 3 * fore - abs(aft) ** 3 * aft) / 4
    return 0.0, unit * cubes / r, unit * (fourths - v * cubes) / r**2


# Actuators: force of executed values


def _factor(losses, u, r):
    """What is left of a thrust."""
    speed, turn = 1 - losses["with_speed"] * u, 1 - losses["in_turns"] * abs(r)
    return (1 + losses["asymmetry"]) * speed * turn


def _pushed(thrust, x, y, angle):
    X, Y = thrust * math.cos(angle), thrust * math.sin(angle)
    return X, Y, x * Y - y * X


def _thruster(part, executed, u, v, r, jets):
    angle = executed[part["angle_channel"]] if "angle_channel" in part else part["angle"]
    order = executed[part["channel"]] - part["neutral"]
    order = -order if part["reversed"] else order
    if part["thrust_curve"]:
        thrust = _curve_thrust(part["thrust_curve"], order, part["neutral"])
    elif part["curve"]:
        along, across = u - part["y"] * r, v + part["x"] * r
        advance = along * math.cos(angle) + across * math.sin(angle)
        (c, d), n = part["curve"], order / part["per_revolution"]
        thrust = c * advance * n + d * abs(n) * n
    else:
        thrust = order
    return _pushed(thrust * _factor(part["losses"], u, r), part["x"], part["y"], angle)


def _curve_thrust(curve, order, neutral):
    """Thrust (N) of a thrust curve at an order above neutral."""
    full = neutral - curve["full_astern"] if order < 0 else curve["full_ahead"] - neutral
    share = min(max(order / full, -1.0), 1.0)
    acting = max(abs(share) - curve["deadband"], 0.0) / (1 - curve["deadband"])
    power = acting * max(acting, _SMALLEST_SHARE) ** (curve["exponent"] - 1)
    return (-curve["astern_ratio"] if share < 0 else 1.0) * curve["full_thrust"] * power


def _tunnel(part, executed, u, v, r, jets):
    thrust = part["effectiveness"] * executed[part["channel"]]
    if part["fading_speed"]:
        thrust /= 1 + (u / part["fading_speed"]) ** 2
    return 0.0, thrust, part["x"] * thrust


def _drift_speed(u, v):
    """Drift angle times speed, m/s."""
    ahead = math.sqrt(u * u + _SMALL)
    return math.sqrt(ahead**2 + v * v) * math.atan2(-v, ahead)


def _advance(part, u, v, r):
    """Speed of the water into the disc, m/s."""
    drift = _drift_speed(u, v) - part["x"] * r
    decay = math.exp(-part["wake_decay"] * drift**2 / (u * u + v * v + _SMALL))
    return (1 - part["wake_fraction"] * decay) * u


def _square(part, n, advance):
    """K_T n^2, 1/s^2."""
    k0, k1, k2 = part["k_T"]
    V = advance / part["diameter"]
    bollard = k0 * (part["astern_factor"] if n < 0 else 1.0)
    return bollard * n * abs(n) + k1 * abs(n) * V + k2 * V * abs(V)


def _propeller(part, executed, u, v, r, jets):
    square = _square(part, executed[part["channel"]], _advance(part, u, v, r))
    thrust = part["water_density"] * part["diameter"] ** 4 * square
    thrust *= (1 - part["thrust_deduction"]) * _factor(part["losses"], u, r)
    return _pushed(thrust, part["x"], part["y"], 0.0)


def jet(part, n, u, v, r):
    """Inflow (m/s), loading 8 K_T n^2 D^2 / pi (m^2/s^2) and diameter (m) of a propeller."""
    advance = _advance(part, u, v, r)
    square = _square(part, n, advance) if n > 0 else 0.0
    loading = 8 * max(square, 0.0) * part["diameter"] ** 2 / math.pi
    return advance, loading, part["diameter"]


def _rudder(part, executed, u, v, r, jets):
    delta = executed[part["channel"]]
    crossing = _drift_speed(u, v) - part["l_R"] * r
    gamma = part["gamma_R_port"] if crossing < 0 else part["gamma_R_starboard"]
    if part["propeller"] is None:
        axial = (1 - part["wake_fraction"]) * u
    else:
        inflow, loading, diameter = jets[part["propeller"]]
        eta = min(diameter / part["height"], 1.0)
        race = math.sqrt(inflow**2 + loading + _SMALL) - inflow
        mixed = eta * (inflow + part["kappa"] * race) ** 2 + (1 - eta) * inflow**2
        axial = part["epsilon"] * math.sqrt(mixed + _SMALL)
    axial = 1e-9 if abs(axial) < 1e-9 else axial
    across = gamma * crossing
    alpha = delta - math.atan2(across, axial)
    square = axial**2 + across**2
    normal = 0.5 * part["water_density"] * part["area"] * part["lift_slope"] * square
    normal *= math.sin(alpha)
    side, X = -normal * math.cos(delta), -(1 - part["t_R"]) * normal * math.sin(delta)
    lever = part["x"] + part["a_H"] * part["x_H"] + part["hull_lever"]
    return X, (1 + part["a_H"]) * side, lever * side - part["y"] * X


def _derivatives(part, executed, u, v, r, jets):
    return polynomial(part, u, v, r, executed[part["channel"]])


_ACTUATORS = {
    "thruster": _thruster,
    "tunnel": _tunnel,
    "propeller": _propeller,
    "rudder": _rudder,
    "derivatives": _derivatives,
}
