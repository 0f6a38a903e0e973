"""scipy's least squares with two-point differences, over four programs of the same equations.

As scipy comes it differentiates one unknown at a time; `side_by_side` hands it a Jacobian from
the same differences with all of them in one run of NumPy; `compiled` has the equations in C, and
`compiled_in_lanes` all directions side by side there, too.
"""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.fit_benchmark import plain
from experiments.fit_benchmark.data import NAMES, SIGMA, Data
from experiments.fit_benchmark.outcome import Outcome

import numpy as np
from scipy.optimize import least_squares


STEPS = 200
LANES = 16  # of rk4.c


def one_by_one(data: Data) -> Outcome:
    """NumPy, the six runs side by side, 44 runs for a Jacobian."""
    return _fit(data, lambda z: plain.residual(data, z))


def side_by_side(data: Data) -> Outcome:
    """NumPy, the six runs in all fourteen directions side by side."""
    return _fit(data, lambda z: plain.residual(data, z), lambda z: plain.lanes_jacobian(data, z))


def compiled(data: Data) -> Outcome:
    """C, 44 runs for a Jacobian."""
    return _fit(data, compiled_residual(data))


def compiled_in_lanes(data: Data) -> Outcome:
    """C, a Jacobian by one run in lanes of vector instructions."""
    return _fit(data, compiled_residual(data), compiled_jacobian(data))


def compiled_jacobian(data: Data) -> Callable[[np.ndarray], np.ndarray]:
    """Two-point differences in C: the unknowns as they are and fourteen moved ones side by side."""
    simulate = library().simulate_lanes
    force, moment = (np.ascontiguousarray(push.T) for push in plain.pushes(data))
    runs, n, directions = len(force), len(NAMES), len(NAMES) + 6

    def jacobian(z: np.ndarray) -> np.ndarray:
        lanes = np.repeat(z[None], LANES, 0)
        moves = np.append(plain.STEP * np.maximum(np.abs(z[:n]), 1.0), np.full(6, plain.STEP))
        for k in range(n):
            lanes[k, k] += moves[k]
        for k in range(6):
            lanes[n + k, n + k :: 6] += plain.STEP  # a first state moves its own run only
        values, firsts = zip(*(plain.unpack(data, lane) for lane in lanes), strict=True)
        c = np.empty((8, LANES))
        c[:] = plain.coefficients(data, np.array(values).T)
        first = np.ascontiguousarray(np.moveaxis(np.array(firsts), 0, -1))  # run, 6, lane
        J, out = np.zeros((runs, len(data.t), 6, len(z))), np.empty((len(data.t), 6, LANES))
        for k in range(runs):
            simulate(len(data.t), data.dt, force[k], moment[k], c, first[k], out)
            moved = out[..., :directions] - out[..., directions:][..., :1]
            slope = moved / (moves * SIGMA[:, None])
            J[k, ..., :n] = slope[..., :n]
            J[k, ..., n + 6 * k : n + 6 * k + 6] = slope[..., n:]
        return J.reshape(-1, len(z))

    return jacobian


def compiled_residual(data: Data) -> Callable[[np.ndarray], np.ndarray]:
    """The misfits of plain.py's unknowns, from the program in C."""
    simulate = library().simulate
    force, moment = (np.ascontiguousarray(push.T) for push in plain.pushes(data))

    def residual(z: np.ndarray) -> np.ndarray:
        values, first = plain.unpack(data, z)
        c = np.array(plain.coefficients(data, values))
        out = np.empty((len(force), len(data.t), 6))
        for k, start in enumerate(np.ascontiguousarray(first)):
            simulate(len(data.t), data.dt, force[k], moment[k], c, start, out[k])
        return ((out - data.measured) / SIGMA).ravel()

    return residual


_made: list[ctypes.CDLL] = []


def library() -> ctypes.CDLL:
    """The C program, built when first asked for."""
    if not _made:
        source = Path(__file__).with_name("rk4.c")
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "rk4.so"
            flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-shared", "-fPIC"]
            subprocess.run(["gcc", *flags, source, "-o", target, "-lm"], check=True)
            made = ctypes.CDLL(str(target))
        array = np.ctypeslib.ndpointer(float, flags="C_CONTIGUOUS")
        for function in (made.simulate, made.simulate_lanes):
            function.argtypes = [ctypes.c_int, ctypes.c_double, *[array] * 5]
            function.restype = None
        _made.append(made)
    return _made[0]


def _fit(data: Data, residual: Callable, jacobian: Callable | None = None) -> Outcome:
    count = {"runs": 0, "jacobians": 0}

    def counted(z: np.ndarray) -> np.ndarray:
        count["runs"] += 1
        return residual(z)

    given: Any = "2-point" if jacobian is None else jacobian
    found = least_squares(counted, plain.begin(data), given, max_nfev=STEPS)
    values, first = plain.unpack(data, found.x)
    return Outcome(values, first, count["runs"], found.njev)
