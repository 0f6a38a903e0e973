"""A WAM-V catamaran in four degrees of freedom: surge, sway, yaw and roll, with its engines' lag.

Added mass by Kirchhoff's equations, hulls that each meet the water at their own speed and depth,
cross-flow drag by strips, thrust that depends on the inflow. x north, y east (m), psi and r
clockwise, u ahead, v to starboard (m/s), roll phi to starboard and its rate p (rad, rad/s).
"""

import dataclasses
import math

import numpy as np


CHANNELS = ("x", "y", "psi", "u", "v", "r", "phi", "p", "n_port", "n_starboard")
STEP = 0.025  # s, the longest of the Runge-Kutta scheme
STRIPS = 6  # of each hull's length, for cross-flow drag
GRAVITY = 9.81  # m/s^2
DIAMETER = 0.2  # m, propeller, as in the simulator
# Thrust per square of engine speed without inflow, N s^2, as in the simulator: 250 N at 29.9 rev/s.
THRUST_PER_SPEED = 0.004422 * 1000.0 * DIAMETER**4 * (2 * math.pi) ** 2


@dataclasses.dataclass(frozen=True)
class RollingPlant:
    """The boat's numbers, SI units, about the origin; "published" is the planar description's."""

    mass: float = 258.0  # kg, published
    x_G: float = -0.286  # m forward of the origin, published
    height_G: float = 0.6  # m above the waterline: tray and payload stand on arches
    I_zz: float = 704.0  # kg m^2, about the origin, published
    I_xx: float = 150.0  # kg m^2, about the centre of gravity: gyration radius 0.76 m
    rolls: bool = True
    GM: float = 2.4  # m, for a period of 2 s; the waterplane of stiff hulls would give more
    roll_damping: float = 0.15  # of critical
    # Added mass (kg, kg m^2) of u, v, p, r: half-round sections 0.16 m deep, 0.42 m wide, tapered.
    added: tuple[float, ...] = (14.0, 210.0, 380.0, 230.0)
    added_x: float = -0.25  # m, middle of the waterline, nearly under the centre of gravity
    added_depth: float = 0.075  # m, where it acts: about half the draught
    stern_section: float = 35.0  # kg/m, sway's added mass that both transoms shed: lift
    half_spacing: float = 1.005  # m, half of 2.44 m over hulls less one hull of 0.43 m
    draught: float = 0.16  # m
    waterline: float = 4.0  # m of the 4.9 m: the bows rise
    # Drag (N, N m) per speed and its square; published, all in one: 100, 150; 100, 100; 800, 800.
    surge: tuple[float, float] = (85.0, 130.0)  # both hulls
    sway: tuple[float, float] = (60.0, 0.0)
    yaw: tuple[float, float] = (550.0, 0.0)
    hump: tuple[float, ...] = (0.4, 0.45, 0.15)  # rise of surge's square, Froude number, width
    cross_flow: float = 0.45  # drag coefficient: round, shallow, one hull in the other's lee
    drag_depth: float = 0.08  # m below the waterline, half the draught
    arm: float = 1.027  # m, engines off the centreline, pushing along the hull only; published
    full_speed: float = 36.0  # rev/s either way: 362 N ahead, an 80-pound trolling engine
    astern: float = 0.8  # of the thrust ahead at the same speed: blades run backwards
    inflow_loss: tuple[float, float] = (0.75, 0.4)  # per advance ratio, ahead and astern
    inflow_square: float = 0.45  # per square of it: no thrust at 0.88, a pitch of 0.8 or so
    wake: float = 0.1  # part of the boat's speed that the water behind the hulls has taken on
    sag: float = 0.06  # part of engine speed lost with both at full speed: battery, cables
    depth_gain: float = 1.0  # 1/m, thrust gained per depth: less air drawn down
    lags: bool = True
    lag: tuple[float, float] = (0.25, 0.15)  # s, speeding up and slowing down
    ramp: float = 100.0  # rev/s^2, the controller's limit
    dead_band: float = 2.0  # rev/s, orders below it leave the engine stopped
    windage: tuple[float, float] = (0.5, 0.8)  # N s^2/m^2 ahead and abeam: 0.8 and 1.3 m^2
    windage_height: float = 0.6  # m above the waterline
    wind: tuple[float, float] = (0.0, 0.0)  # m/s, velocity of the air towards north and east
    _fixed: tuple = dataclasses.field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Works out what stays: inverse of inertia, roll's stiffness and damping, strips."""
        M, kept = np.array(self.inertia), [0, 1, 2] if self.rolls else [0, 2]
        inverse = np.zeros((3, 3))
        inverse[np.ix_(kept, kept)] = np.linalg.inv(M[np.ix_(kept, kept)])
        stiffness = self.mass * GRAVITY * self.GM  # N m
        damping = 2 * self.roll_damping * math.sqrt(stiffness / np.linalg.inv(M)[1, 1])  # N m s
        places = self.added_x + self.waterline * ((np.arange(STRIPS) + 0.5) / STRIPS - 0.5)
        object.__setattr__(self, "_fixed", (inverse.tolist(), stiffness, damping, places.tolist()))

    @property
    def at_rest(self) -> tuple:
        """The full state lying still at the origin, heading north, engines stopped."""
        return (0.0,) * len(CHANNELS)

    @property
    def inertia(self) -> tuple:
        """Inertia of (sway, roll, yaw) with added mass: kg, kg m, kg m^2."""
        m, x, h, X, d = self.mass, self.x_G, self.height_G, self.added_x, self.added_depth
        _, a, a_p, a_r = self.added
        vp, vr, pr = m * h - a * d, m * x + a * X, m * x * h - a * X * d
        return (m + a, vp, vr), (vp, self.I_xx + m * h * h + a_p, pr), (vr, pr, self.I_zz + a_r)

    def thrust(self, n: float, inflow: float = 0.0) -> float:
        """Thrust (N) of an engine turning at `n` rev/s in water coming at `inflow` m/s."""
        n = min(max(n, -self.full_speed), self.full_speed)
        still, loss = (1.0, self.inflow_loss[0]) if n > 0 else (self.astern, self.inflow_loss[1])
        turn = inflow / DIAMETER  # rev/s, advance ratio times engine speed
        loss = loss * abs(n) + self.inflow_square * abs(turn)
        return THRUST_PER_SPEED * (still * abs(n) * n - loss * turn)

    def thrusts(self, motion: tuple, port: float, starboard: float) -> tuple[float, float]:
        """Thrust (N) of both engines at rev/s on a moving, heeled boat."""
        u, r, phi = motion[3], motion[5], motion[6]
        turn, deeper = self.arm * r, self.depth_gain * self.arm * math.sin(phi)
        left = self.thrust(port, (1.0 - self.wake) * (u + turn))
        right = self.thrust(starboard, (1.0 - self.wake) * (u - turn))
        return left * max(1.0 - deeper, 0.0), right * max(1.0 + deeper, 0.0)

    def hull_drag(self, speed: float, immersion: float) -> float:
        """Drag (N) of one hull along its length at m/s, immersed to a multiple of its draught."""
        (a, b), (rise, crest, width) = self.surge, self.hump
        froude = abs(speed) / math.sqrt(GRAVITY * self.waterline)
        b *= 1.0 + rise * math.exp(-(((froude - crest) / width) ** 2))
        return 0.5 * (a + b * abs(speed)) * speed * max(immersion, 0.0)

    def side_drag(self, u: float, v: float, r: float, p: float) -> tuple[float, float]:
        """Force (N) and moment (N m) against sway and yaw: cross-flow, transoms' lift, the rest."""
        w = v - self.drag_depth * p
        per_strip = 1000.0 * self.cross_flow * self.draught * self.waterline / STRIPS  # two hulls
        stern = self.added_x - 0.5 * self.waterline
        lift = self.stern_section * max(u, 0.0) * (w + stern * r)
        Y = (self.sway[0] + self.sway[1] * abs(w)) * w + lift
        N = (self.yaw[0] + self.yaw[1] * abs(r)) * r + lift * stern
        for x in self._fixed[3]:
            force = per_strip * abs(w + x * r) * (w + x * r)
            Y, N = Y + force, N + force * x
        return Y, N

    def drag(self, motion: tuple) -> tuple[float, float, float, float]:
        """Forces (N, N, N m, N m) of water and air against surge, sway, roll and yaw."""
        _, _, psi, u, v, r, phi, p = motion
        turn, deeper = self.half_spacing * r, self.half_spacing * math.sin(phi) / self.draught
        left, right = self.hull_drag(u + turn, 1.0 - deeper), self.hull_drag(u - turn, 1.0 + deeper)
        Y, N = self.side_drag(u, v, r, p)
        c, s, (north, east) = math.cos(psi), math.sin(psi), self.wind
        ahead = u - (c * north + s * east)  # m/s, against the air
        abeam = v + self.windage_height * p - (c * east - s * north)
        speed = math.hypot(ahead, abeam)
        X_air, Y_air = self.windage[0] * speed * ahead, self.windage[1] * speed * abeam
        K = self._fixed[1] * math.sin(phi) + self._fixed[2] * p
        K += self.windage_height * Y_air - self.drag_depth * Y
        return left + right + X_air, Y + Y_air, K, N + (left - right) * self.half_spacing

    def rate(self, motion: tuple, port: float, starboard: float) -> tuple:
        """Time derivative of (x, y, psi, u, v, r, phi, p) with engines at rev/s."""
        _, _, psi, u, v, r, _, p = motion
        left, right = self.thrusts(motion, port, starboard)
        X, Y, K, N = self.drag(motion)
        (vv, vp, vr), m_u = self.inertia[0], self.mass + self.added[0]
        surge, sway = m_u * u, vv * v + vp * p + vr * r  # momenta, kg m/s
        pitch = (self.added[0] * self.added_depth - self.mass * self.height_G) * u  # kg m^2/s
        X = left + right - X + r * sway
        Y, K = -Y - r * surge, -K + r * pitch
        N = (left - right) * self.arm - N - u * sway + v * surge - p * pitch
        sways, rolls, yaws = (a * Y + b * K + c * N for a, b, c in self._fixed[0])
        c, s = math.cos(psi), math.sin(psi)
        return c * u - s * v, s * u + c * v, r, X / m_u, sways, yaws, p, rolls

    def targets(self, port: float, starboard: float) -> tuple[float, float]:
        """Engine speeds (rev/s) that orders lead to: limits, dead band and the battery's sag."""
        full, orders = self.full_speed, (port, starboard)
        a, b = (0.0 if abs(n) < self.dead_band else min(max(n, -full), full) for n in orders)
        left = 1.0 - 0.5 * self.sag * (abs(a / full) ** 3 + abs(b / full) ** 3)
        return left * a, left * b

    def standstill(self, n: float, target: float) -> float:
        """Time (s) at which an engine stops on its way from `n` to `target` beyond zero, or inf."""
        if not self.lags or n * target >= 0:
            return math.inf
        gap, last = abs(target - n), self.ramp * self.lag[1]
        ratio = min(gap, last) / abs(target)
        lags = math.log(ratio) if ratio > 1 else 1 - 1 / ratio
        return max(gap - last, 0.0) / self.ramp + self.lag[1] * lags

    def shaft(self, n: float, target: float, t: float) -> float:
        """Engine speed (rev/s) after `t` s on the way from `n` to `target`, in closed form."""
        if not self.lags:
            return target
        if t >= (stop := self.standstill(n, target)):
            return self.shaft(0.0, target, t - stop)
        lag = self.lag[0] if n * target >= 0 and abs(target) > abs(n) else self.lag[1]
        gap, last = target - n, self.ramp * lag  # rev/s; nearer than `last` no limit binds
        ramped = max(abs(gap) - last, 0.0) / self.ramp
        if t <= ramped:
            return n + math.copysign(self.ramp * t, gap)
        return target - math.copysign(min(abs(gap), last) * math.exp((ramped - t) / lag), gap)

    def advanced(self, state: tuple, port: float, starboard: float, dt: float) -> tuple:
        """The state `dt` s later under orders (rev/s) that hold; new steps where engines stop."""
        motion, speeds, goals = tuple(state[:8]), tuple(state[8:]), self.targets(port, starboard)
        stops = {self.standstill(n, goal) for n, goal in zip(speeds, goals, strict=True)}
        begin = 0.0
        for end in sorted({dt, *(t for t in stops if t < dt)}):
            parts = max(1, math.ceil((end - begin) / STEP - 1e-9))
            for _ in range(parts):
                motion, speeds = self.stepped(motion, speeds, goals, (end - begin) / parts)
            begin = end
        return motion + speeds

    def stepped(self, motion: tuple, speeds: tuple, goals: tuple, h: float) -> tuple[tuple, tuple]:
        """Motion and engine speeds (rev/s) `h` s later: Runge-Kutta, order 4."""
        pairs = tuple(zip(speeds, goals, strict=True))
        now, half, end = (
            tuple(self.shaft(n, goal, t) for n, goal in pairs) for t in (0.0, 0.5 * h, h)
        )
        k1 = self.rate(motion, *now)
        k2 = self.rate(_moved(motion, k1, 0.5 * h), *half)
        k3 = self.rate(_moved(motion, k2, 0.5 * h), *half)
        k4 = self.rate(_moved(motion, k3, h), *end)
        mean = tuple((a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        return _moved(motion, mean, h), end


def _moved(state: tuple, slope: tuple, h: float) -> tuple:
    return tuple(x + h * d for x, d in zip(state, slope, strict=True))


ROLLING = RollingPlant()
# Each leaves one thing out and keeps all other numbers.
WITHOUT = {
    "roll": dataclasses.replace(ROLLING, rolls=False),
    "added mass": dataclasses.replace(ROLLING, added=(0.0,) * 4, stern_section=0.0),
    "engine lag": dataclasses.replace(ROLLING, lags=False, dead_band=0.0),
    "flow loss": dataclasses.replace(ROLLING, inflow_loss=(0.0, 0.0), inflow_square=0.0, sag=0.0),
}
