"""What a contestant hands back."""

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Outcome:
    """An estimate, and what it took."""

    values: np.ndarray  # derivatives, in the order of data.NAMES
    first: np.ndarray | None  # first states (run, 6); None where the method has none
    runs: int  # simulations of all the data, derivatives not counted
    jacobians: int
    away: np.ndarray | None = None  # estimates less the truth, in the method's standard errors
