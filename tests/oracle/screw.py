"""A propeller and a rudder behind it, by the MMG standard method.

Yasukawa and Yoshimura (2015), Introduction of MMG standard method for ship maneuvering
predictions, J. Mar. Sci. Technol. 20, 37-52. U = hypot(u, v), drift angle beta = atan(-v / |u|).

    propeller     beta_P = beta - x_P r / U,  w = w_0 exp(-wake_decay beta_P^2),  u_P = (1 - w) u
                  V = u_P / D,  K_T n^2 = k_0 n |n| + k_1 |n| V + k_2 V |V|
                  (K_T(J) = k_0 + k_1 J + k_2 J^2 times n^2 ahead; astern k_0 astern_factor)
                  X = (1 - t) rho D^4 K_T n^2
    side force    Y = Y_a |X|, N = N_a L |X|; `ahead` where X > 0, `astern` where X < 0
    rudder        beta_R = beta - l_R r / U,  v_R = U gamma_R beta_R,  eta = D / H
                  u_R = epsilon sqrt(eta (u_P + kappa (u_oo - u_P))^2 + (1 - eta) u_P^2)
                  u_oo = sqrt(u_P^2 + 8 K_T n^2 D^2 / pi)
                  F_N = 1/2 rho A f_alpha (u_R^2 + v_R^2) sin(delta - atan(v_R / u_R))
                  X = -(1 - t_R) F_N sin(delta),  Y = -(1 + a_H) F_N cos(delta),
                  N = -(x_R + a_H x_H) F_N cos(delta)
    gamma_R       gamma_R_port where beta_R < 0, gamma_R_starboard where beta_R > 0

`thrust-change` scales the propeller's forces; the slipstream over the rudder keeps the
unchanged K_T n^2, as the effect is defined on forces.
"""

from __future__ import annotations

import math

from .channel import Channel


def drift(u: float, v: float) -> float:
    """beta = atan(-v / |u|) [rad]."""
    return math.atan2(-v, abs(u))


class Propeller(Channel):
    """One propeller, ordered in rev/s."""

    def __init__(self, data: dict, hull: dict):
        super().__init__(data, data.get("min_speed", -math.inf), data.get("max_speed", math.inf))
        self.x, self.D, self.k = data.get("x", 0.0), data["diameter"], data["k_T"]
        self.w0, self.decay = data.get("wake_fraction", 0.0), data.get("wake_decay", 0.0)
        self.t, self.astern = data.get("thrust_deduction", 0.0), data.get("astern_factor", 1.0)
        self.rho, self.L = hull.get("water_density", 1025.0), hull["length"]
        self.side = {sign: data.get(f"side_{sign}", (0.0, 0.0)) for sign in ("ahead", "astern")}

    def inflow(self, u: float, v: float, r: float) -> float:
        """u_P [m/s]."""
        U = math.hypot(u, v)
        beta = drift(u, v) - (self.x * r / U if U else 0.0)
        return (1.0 - self.w0 * math.exp(-self.decay * beta * beta)) * u

    def coefficient(self, n: float, u_p: float) -> float:
        """K_T n^2 [1/s^2]."""
        V, k = u_p / self.D, self.k
        first = k[0] * (self.astern if n < 0 else 1.0)
        return first * n * abs(n) + k[1] * abs(n) * V + k[2] * V * abs(V)

    def push(self, n: float, u: float, r: float, v: float = 0.0, others=None):
        """(X, Y, N) about amidships."""
        T = self.rho * self.D**4 * self.coefficient(n, self.inflow(u, v, r))
        X = (1.0 - self.t) * T
        y, moment = self.side["ahead" if X > 0 else "astern"]
        return X, y * abs(X), moment * self.L * abs(X)

    def kinks(self, n: float, u: float, r: float, v: float) -> list[float]:
        """Functions whose sign changes are kinks of the force."""
        return [n, self.push(n, u, r, v)[0]]


class Rudder(Channel):
    """One rudder behind a propeller, ordered in rad, positive to turn to starboard."""

    def __init__(self, data: dict, hull: dict, propellers: list[Propeller]):
        limit = data.get("max_angle", math.inf)
        super().__init__(data, -limit, limit)
        self.propeller = next(p for p in propellers if p.name == data["propeller"])
        self.data, self.rho = data, hull.get("water_density", 1025.0)

    def straightening(self, u: float, r: float, v: float) -> float:
        """U beta_R [m/s], the cross-flow before gamma_R."""
        return math.hypot(u, v) * drift(u, v) - self.data["l_R"] * r

    def normal_force(self, delta, u, r, v, n) -> float:
        """F_N [N] with the propeller at n rev/s."""
        d, propeller = self.data, self.propeller
        u_p = propeller.inflow(u, v, r)
        jet = u_p * u_p + 8.0 * propeller.coefficient(n, u_p) * propeller.D**2 / math.pi
        behind = u_p + d["kappa"] * (math.sqrt(max(jet, 0.0)) - u_p)
        eta = propeller.D / d["height"]
        u_r = d["epsilon"] * math.sqrt(eta * behind**2 + (1.0 - eta) * u_p**2)
        cross = self.straightening(u, r, v)
        v_r = cross * d["gamma_R_port" if cross < 0 else "gamma_R_starboard"]
        angle = delta - math.atan2(v_r, u_r)
        return 0.5 * self.rho * d["area"] * d["lift_slope"] * (u_r**2 + v_r**2) * math.sin(angle)

    def push(self, delta: float, u: float, r: float, v: float = 0.0, others=None):
        """(X, Y, N) about amidships; `others` has the propeller's revolutions."""
        d = self.data
        assert others is not None
        F = self.normal_force(delta, u, r, v, others[self.propeller.name])
        sine, across = F * math.sin(delta), F * math.cos(delta)
        return (
            -(1.0 - d["t_R"]) * sine,
            -(1.0 + d["a_H"]) * across,
            -(d["x"] + d["a_H"] * d["x_H"]) * across,
        )

    def kinks(self, delta: float, u: float, r: float, v: float) -> list[float]:
        """Functions whose sign changes are kinks of the force."""
        return [self.straightening(u, r, v)]
