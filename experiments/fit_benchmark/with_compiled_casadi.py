"""CasADi's own C, compiled, under a Levenberg-Marquardt of this module.

One function serves every run: of eight derivatives and six first states it gives the cost and its
normal equations, from the Jacobian of the misfits that CasADi finds forwards. It is generated and
compiled where it is first asked for.
"""

import os
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from experiments.fit_benchmark import plain
from experiments.fit_benchmark.data import NAMES, SIGMA, Data
from experiments.fit_benchmark.outcome import Outcome
from experiments.fit_benchmark.with_casadi import rk4_step

import casadi as ca
import numpy as np


STEPS = 100
SMALL_DROP = 1e-9  # of the cost, in one accepted step: the end
ENOUGH, GOOD = 0.25, 0.75  # of the drop that the linear model promises: accepted, damped less
FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")


class Normal(NamedTuple):
    """Cost, and the normal equations of the unknowns of `plain.unpack`."""

    cost: float
    gradient: np.ndarray
    matrix: np.ndarray


class Program(NamedTuple):
    """The compiled functions of one run."""

    cost: ca.Function
    normal: ca.Function


_made: dict[str, Program] = {}


def program(data: Data) -> Program:
    """Both functions, generated and compiled when first asked for."""
    if "run" not in _made:
        rows = len(data.t) - 1
        z = ca.MX.sym("z", len(NAMES) + 6)
        first, push = ca.MX.sym("first", 6), ca.MX.sym("push", 2, rows)
        measured = ca.MX.sym("measured", 6, rows)
        off, values = z[len(NAMES) :], data.start * z[: len(NAMES)]
        shoot = rk4_step(data).mapaccum("shoot", rows)
        states = shoot(first + SIGMA * off, push, ca.repmat(values, 1, rows))
        scaled = (states - measured) / ca.repmat(ca.DM(SIGMA), 1, rows)
        misfit = ca.vertcat(off, ca.vec(scaled))
        given = [z, first, push, measured]
        J = ca.densify(ca.jacobian(misfit, z))
        functions = (
            ca.Function("cost", given, [ca.sumsqr(misfit)]),
            ca.Function("normal", given, [ca.sumsqr(misfit), J.T @ misfit, J.T @ J]),
        )
        _made["run"] = Program(*_compiled(functions))
    return _made["run"]


def _compiled(functions: tuple[ca.Function, ...]) -> list[ca.Function]:
    generator = ca.CodeGenerator("fit.c")
    for function in functions:
        generator.add(function)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(folder + os.sep)
        source, target = Path(folder) / "fit.c", Path(folder) / "fit.so"
        subprocess.run(["cc", *FLAGS, source, "-o", target, "-lm"], check=True)
        return [ca.external(function.name(), str(target)) for function in functions]


def levenberg_marquardt(data: Data) -> Outcome:
    """The common cost from the common start.

    Unknowns are scaled by the longest columns so far (More 1978), damped by tens.
    """
    run, given, z = program(data), _given(data), plain.begin(data)
    at, scale, damping, jacobians, runs = _normal(run, given, z), np.zeros(len(z)), 1e-3, 1, 0
    for _ in range(STEPS):
        scale = np.maximum(scale, np.diag(at.matrix))
        move = -np.linalg.solve(at.matrix + damping * np.diag(scale), at.gradient)
        promised = -move @ (2 * at.gradient + at.matrix @ move)
        drop, runs = at.cost - _cost(run, given, z + move), runs + 1
        if not drop > ENOUGH * promised:
            damping *= 10
            continue
        z, damping = z + move, damping / (10 if drop > GOOD * promised else 1)
        if drop < SMALL_DROP * at.cost:
            break
        at, jacobians = _normal(run, given, z), jacobians + 1
    values, first = plain.unpack(data, z)
    return Outcome(values, first, runs, jacobians)


def _given(data: Data) -> list[tuple]:
    """First row, pushes and measured rows of every run, as CasADi's functions take them."""
    force, moment = plain.pushes(data)
    pushes = np.stack([force.T, moment.T], 1)[..., :-1]  # run, 2, row
    return [
        (ca.DM(rows[0]), ca.DM(push), ca.DM(rows[1:].T))
        for rows, push in zip(data.measured, pushes, strict=True)
    ]


def _unknowns(z: np.ndarray, run: int) -> np.ndarray:
    """Which unknowns a run has: the derivatives and its own first state."""
    n = len(NAMES)
    return np.concatenate([np.arange(n), np.arange(n + 6 * run, n + 6 * run + 6)])


def _cost(run: Program, given: list[tuple], z: np.ndarray) -> float:
    return sum(float(run.cost(z[_unknowns(z, k)], *own)) for k, own in enumerate(given))


def _normal(run: Program, given: list[tuple], z: np.ndarray) -> Normal:
    cost, gradient, matrix = 0.0, np.zeros(len(z)), np.zeros((len(z), len(z)))
    for k, own in enumerate(given):
        at = _unknowns(z, k)
        own_cost, own_gradient, own_matrix = run.normal(z[at], *own)
        cost += float(own_cost)
        gradient[at] += np.asarray(own_gradient).ravel()
        matrix[np.ix_(at, at)] += np.asarray(own_matrix)
    return Normal(cost, gradient, matrix)
