"""CasADi, solved by IPOPT with the Gauss-Newton Hessian: multiple and single shooting.

In multiple shooting, unknowns are the derivatives and the states at the beginning of every window
of 4 s; windows meet exactly. In one trial each, windows of 12 s took a third longer to solve, and a
window for every row with the exact Hessian took 21 s to build. Single shooting is one window for
each run.
"""

from experiments.fit_benchmark import plain
from experiments.fit_benchmark.data import NAMES, SIGMA, Data
from experiments.fit_benchmark.outcome import Outcome

import casadi as ca
import numpy as np


WINDOW = 20  # rows; they divide the run


def multiple_shooting(data: Data) -> Outcome:
    """Build and solve, CasADi's own virtual machine evaluating."""
    return _solved(data, WINDOW)


def single_shooting(data: Data) -> Outcome:
    """The same with nothing unknown but derivatives and first states."""
    return _solved(data, len(data.t) - 1)


def _solved(data: Data, window: int) -> Outcome:
    solver, nodes = _built(data, window)
    start = np.zeros(solver.sparsity_in("x0").numel())
    start[: len(NAMES)] = 1.0
    found = np.array(solver(x0=start, lbg=0, ubg=0)["x"]).ravel()
    off = found[len(NAMES) :].reshape(len(data.measured), nodes, 6)
    stats = solver.stats()
    if not stats["success"]:
        raise RuntimeError(stats["return_status"])
    return Outcome(
        data.start * found[: len(NAMES)], data.measured[:, 0] + SIGMA * off[:, 0],
        stats["n_call_nlp_f"], stats["n_call_nlp_hess_l"],
    )  # fmt: skip


def rk4_step(data: Data) -> ca.Function:
    """One Runge-Kutta step: state, (force, moment) and derivatives to the next state."""
    x, push, p = ca.SX.sym("x", 6), ca.SX.sym("push", 2), ca.SX.sym("p", len(NAMES))
    mass, I_z = data.hull["mass"], data.hull["I_z"]
    m11, m22, m33 = mass - p[0], mass - p[1], I_z - p[2]
    _, _, psi, u, v, r = ca.vertsplit(x)
    rate = ca.vertcat(
        u * ca.cos(psi) - v * ca.sin(psi),
        u * ca.sin(psi) + v * ca.cos(psi),
        r,
        (push[0] + m22 * v * r + (p[3] + p[4] * ca.fabs(u)) * u) / m11,
        (p[5] * v - m11 * u * r) / m22,
        (push[1] + (m11 - m22) * u * v + (p[6] + p[7] * ca.fabs(r)) * r) / m33,
    )
    f, h = ca.Function("rate", [x, push, p], [rate]), data.dt
    a = f(x, push, p)
    b = f(x + h / 2 * a, push, p)
    c = f(x + h / 2 * b, push, p)
    d = f(x + h * c, push, p)
    return ca.Function("step", [x, push, p], [x + h / 6 * (a + 2 * (b + c) + d)])


def _built(data: Data, window: int) -> tuple[ca.Function, int]:
    """The solver for windows of so many rows, and the unknown states of a run.

    Where windows have to meet, the last row of a run is one, too.
    """
    runs, rows = len(data.measured), len(data.t) - 1
    windows = rows // window
    assert windows * window == rows
    nodes = windows + 1 if windows > 1 else 1
    ratio = ca.MX.sym("ratio", len(NAMES))
    off = ca.MX.sym("off", 6, runs * nodes)  # standard deviations from the measured row
    measured = data.measured[:, ::window][:, :nodes].reshape(-1, 6).T
    states_at = ca.DM(measured) + _scaled(off, multiply=True)
    begin = [k for k in range(runs * nodes) if nodes == 1 or (k + 1) % nodes]
    force, moment = plain.pushes(data)
    push = np.stack([force.T[:, :-1].ravel(), moment.T[:, :-1].ravel()])
    shoot = rk4_step(data).mapaccum("window", window).map(len(begin))
    states = shoot(states_at[:, begin], ca.DM(push), ca.repmat(data.start * ratio, 1, runs * rows))
    gaps = ca.MX(0, 1)
    if nodes > 1:
        meet = [k + 1 for k in begin]
        gaps = ca.vec(_scaled(states[:, window - 1 :: window] - states_at[:, meet]))
    misfit = _scaled(states - ca.DM(data.measured[:, 1:].reshape(-1, 6).T))
    first = off[:, list(range(0, runs * nodes, nodes))]
    misfit = ca.vertcat(ca.vec(misfit), ca.vec(first))
    return _solver(ca.vertcat(ratio, ca.vec(off)), misfit, gaps), nodes


def _scaled(columns: ca.MX, multiply: bool = False) -> ca.MX:
    sigma = ca.repmat(ca.DM(SIGMA), 1, columns.shape[1])
    return columns * sigma if multiply else columns / sigma


def _solver(unknowns: ca.MX, misfit: ca.MX, gaps: ca.MX) -> ca.Function:
    J = ca.jacobian(misfit, unknowns)
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", gaps.shape)
    hessian = ca.Function(
        "nlp_hess_l",
        {
            "x": unknowns,
            "lam_f": weight,
            "lam_g": multipliers,
            "hess_gamma_x_x": weight * ca.triu(J.T @ J),
        },
        ["x", "p", "lam_f", "lam_g"],
        ["hess_gamma_x_x"],
    )
    problem = {"x": unknowns, "f": 0.5 * ca.dot(misfit, misfit), "g": gaps}
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    return ca.nlpsol("fit", "ipopt", problem, {"hess_lag": hessian, **quiet})
