"""The C reference of the engine, compiled where it is used."""

import ctypes
import os
import subprocess
from pathlib import Path
from typing import NamedTuple

from benchmarks import boats

import numpy as np
from jaxtyping import Float


SOURCE = Path(__file__).resolve().with_name("boat.c")
BUILD = SOURCE.parents[2] / "out" / "benchmarks"
LANES = 16  # boats in a block: faster than 64 on the machine of the table
FLAGS = ("-Ofast", "-march=native", "-fopenmp", "-shared", "-fPIC", f"-DLANES={LANES}")
KINDS = {"double": (np.float64, ctypes.c_double), "float": (np.float32, ctypes.c_float)}
STATES = 8  # x, y, psi, u, v, r, and the thrusts of both sides


class CResult(NamedTuple):
    """Last states, in the order of the source, and times of the switches (s), NaN for none."""

    final: Float[np.ndarray, "state boat"]
    switches: Float[np.ndarray, "boat execute"]


class CBoats:
    """Zig-zags in C.

    Raises:
        OSError: there is no C compiler `cc`.
    """

    def __init__(self, kind: str = "double") -> None:
        """Compile, with numbers of C's `double` or `float`."""
        BUILD.mkdir(parents=True, exist_ok=True)
        library = BUILD / f"boat-{kind}.so"
        command = [os.environ.get("CC", "cc"), *FLAGS, f"-DREAL={kind}", str(SOURCE), "-o"]
        subprocess.run([*command, str(library), "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))
        self.library.multiply_adds.restype = ctypes.c_double
        self.number, self.c_number = KINDS[kind]

    def run(self, rows: boats.Rows, located: bool = True) -> CResult:
        """The zig-zags of boats, whose number is a multiple of `LANES`, by every core.

        A switch is located inside its step, or made at the first sample beyond the check heading.
        """
        numbers = np.ascontiguousarray(rows, dtype=self.number)
        count = numbers.shape[1]
        final = np.zeros((STATES, count), self.number)
        switches = np.full((count, boats.EXECUTES), np.nan, self.number)
        at = lambda array: array.ctypes.data_as(ctypes.c_void_p)
        self.library.zigzags(
            at(numbers), ctypes.c_long(count), ctypes.c_int(located), ctypes.c_long(boats.STEPS),
            *(self.c_number(number) for number in (boats.STEP, boats.ANGLE, boats.CHECK)),
            ctypes.c_long(boats.EXECUTES), at(final), at(switches),
        )  # fmt: skip
        return CResult(final, switches)

    def peak(self, rounds: int = 1_000_000) -> float:
        """Multiplications and additions that one core does, per call of `rounds` rounds."""
        self.library.multiply_adds(ctypes.c_long(rounds))
        return 2.0 * 128 * rounds
