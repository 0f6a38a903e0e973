"""scipy's least squares with two-point differences, over three programs of the same equations.

As scipy comes it differentiates one unknown at a time; `side_by_side` hands it a Jacobian from
the same differences with all of them in one run of NumPy; `compiled` has the equations in C.
"""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiments.fit_benchmark import plain
from experiments.fit_benchmark.data import SIGMA, Data
from experiments.fit_benchmark.outcome import Outcome

import numpy as np
from scipy.optimize import least_squares


STEPS = 200


def one_by_one(data: Data) -> Outcome:
    """NumPy, the six runs side by side, 44 runs for a Jacobian."""
    return _fit(data, lambda z: plain.residual(data, z))


def side_by_side(data: Data) -> Outcome:
    """NumPy, the six runs in all fourteen directions side by side."""
    return _fit(data, lambda z: plain.residual(data, z), lambda z: plain.lanes_jacobian(data, z))


def compiled(data: Data) -> Outcome:
    """C, 44 runs for a Jacobian."""
    return _fit(data, compiled_residual(data))


def compiled_residual(data: Data) -> Callable[[np.ndarray], np.ndarray]:
    """The misfits of plain.py's unknowns, from the program in C."""
    simulate = library()
    force, moment = (np.ascontiguousarray(push.T) for push in plain.pushes(data))

    def residual(z: np.ndarray) -> np.ndarray:
        values, first = plain.unpack(data, z)
        c = np.array(plain.coefficients(data, values))
        out = np.empty((len(force), len(data.t), 6))
        for k, start in enumerate(np.ascontiguousarray(first)):
            simulate(len(data.t), data.dt, force[k], moment[k], c, start, out[k])
        return ((out - data.measured) / SIGMA).ravel()

    return residual


_made: list[Callable] = []


def library() -> Callable:
    """The C program, built when first asked for."""
    if not _made:
        source = Path(__file__).with_name("rk4.c")
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "rk4.so"
            flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
            subprocess.run(["gcc", *flags, source, "-o", target, "-lm"], check=True)
            function = ctypes.CDLL(str(target)).simulate
        array = np.ctypeslib.ndpointer(float, flags="C_CONTIGUOUS")
        function.argtypes = [ctypes.c_int, ctypes.c_double, *[array] * 5]
        function.restype = None
        _made.append(function)
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
