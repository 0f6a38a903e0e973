"""One value and a prior width of what several methods estimate.

A derivative that keeps its sign gets the geometric mean of its estimates and the standard deviation
of their logarithms; a coupling, which may have either sign, the mean and the standard deviation.
Methods that rest on the same idea agree more with one another than with boats. So no prior is
narrower than the ratios of estimate to stated value over the vessels that ship: `MEASURED`, which
`experiments/estimate_check` writes and a test compares.
"""

import dataclasses
import math
import statistics
from collections.abc import Mapping


# Root mean square of ln(estimate / stated value) over the vessels that ship, by what is compared;
# of a coupling the root mean square of the difference over the estimate.
MEASURED = {
    "X_udot": 0.45,
    "Y_vdot": 0.62,
    "N_rdot": 0.48,
    "surge drag": 0.71,
    "sway drag": 0.92,
    "yaw damping": 1.55,
    "Y_v at speed": 1.34,
    "Y_r at speed": 0.92,
    "N_v at speed": 0.70,
    "N_r at speed": 0.54,
}
# What each derivative is compared by: damping at rest has a linear and a quadratic part, lift four.
COMPARED_BY = {
    "X_udot": "X_udot",
    "Y_vdot": "Y_vdot",
    "N_rdot": "N_rdot",
    "X_u": "surge drag",
    "X_uu": "surge drag",
    "Y_v": "sway drag",
    "Y_vv": "sway drag",
    "N_r": "yaw damping",
    "N_rr": "yaw damping",
    "Y_uv": "Y_v at speed",
    "Y_ur": "Y_r at speed",
    "N_uv": "N_v at speed",
    "N_ur": "N_r at speed",
}
COUPLINGS = ("Y_uv", "Y_ur", "N_uv", "N_ur")
WIDEST = 1.6  # of a prior: a factor of 5 to either side is one standard deviation


@dataclasses.dataclass(frozen=True)
class DerivativeEstimate:
    """A number of the vessel file, SI units and SNAME signs, with its prior.

    `spread` is relative: of the logarithm where the sign is kept, else of the value.
    """

    name: str
    value: float
    spread: float
    methods: dict[str, float]  # by source
    note: str = ""  # what the width carries besides

    @property
    def std(self) -> float:
        """Prior standard deviation in the number's unit."""
        return self.spread * abs(self.value)


def combined(
    name: str, methods: Mapping[str, float], *further: float, note: str = ""
) -> DerivativeEstimate:
    """One value and a prior width of several estimates.

    Arguments:
        methods: estimates (SI units) by the source of the method.
        further: relative widths of what the methods have in common, added in quadrature.
    """
    values = list(methods.values())
    if name in COUPLINGS:
        value = statistics.fmean(values)
        width = statistics.stdev(values) / abs(value) if len(values) > 1 else 0.0
    else:
        logarithms = [math.log(abs(one)) for one in values]
        value = math.copysign(math.exp(statistics.fmean(logarithms)), values[0])
        width = statistics.stdev(logarithms) if len(values) > 1 else 0.0
    spread = min(math.hypot(max(width, MEASURED[COMPARED_BY[name]]), *further), WIDEST)
    return DerivativeEstimate(name, value, spread, dict(methods), note)
