"""The boats of the engine's benchmarks: one twin-thruster hull, its numbers ten per cent apart."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float


# The 4.9 m twin-hull craft of the demo with a thrust lag, by the names that the C reference takes.
HULL = {
    "mass": 180.0, "I_z": 446.0, "X_udot": -12.0, "Y_vdot": -120.0, "N_rdot": -240.0,
    "X_u": -52.0, "X_uu": -72.0, "Y_v": -260.0, "N_r": -900.0, "N_rr": -600.0,
}  # fmt: skip
LENGTH, ARM, MOST, LEAST = 4.9, 1.03, 250.0, -180.0
THRUST, LAG = 120.0, 0.3  # N of each thruster, s
SPREAD = 0.1  # of every number, to both sides at most
ANGLE = CHECK = math.radians(20)  # of the zig-zag
SECONDS, STEP, STEPS = 60.0, 0.05, 1200
HARD_OVER = math.radians(35)  # rudder-equivalent angle at which one side gives all
EXECUTES = 12  # more than any boat has in a minute
PARAMETERS = (*HULL, "thrust", "time_constant", "speed")

BATCH = 4096
STRAY = 1e-3  # share of boats that may flip at another sample: a heading lies next to its limit
AGREEMENT = 1e-9  # m, rad, m/s, rad/s and s, in 64 bits
OF_ANOTHER_LAG = 1e-5  # the same of a method that integrates the lag with the motion

Rows = Float[np.ndarray, "parameter boat"]
# Last x, y, psi, u, v and r; s, of switches, NaN for none.
Ends = tuple[Float[np.ndarray, "6 boat"], Float[np.ndarray, "boat execute"]]


def document() -> dict[str, Any]:
    """The craft as a vessel file."""
    thruster = {
        "x": -2.3, "max_force": MOST, "min_force": LEAST, "time_constant": LAG,
    }  # fmt: skip
    sides = (("port", -ARM), ("starboard", ARM))
    return {
        "format": 1,
        "name": "twin-thruster boat",
        "source": "round numbers",
        "hull": {"length": LENGTH, "beam": 2.4, "draught": 0.2, "x_G": 0.0, **HULL},
        "thruster": [{"name": name, "y": y, **thruster} for name, y in sides],
    }


def ferry() -> dict[str, Any]:
    """The same hull with an azimuth thruster at each end, which turn all the way round."""
    thruster = {
        "max_force": MOST, "min_force": 0.0, "time_constant": LAG, "angle_time_constant": LAG,
    }  # fmt: skip
    ends = (("bow", 2.0), ("stern", -2.0))
    craft = {key: value for key, value in document().items() if key != "thruster"}
    thrusters = [{"name": name, "x": x, **thruster} for name, x in ends]
    return craft | {"name": "ferry", "azimuth_thruster": thrusters}


def draw(count: int, seed: int = 0) -> Rows:
    """Numbers of so many boats, in the order of `PARAMETERS`.

    Each runs at the speed at which its drag is its thrust.
    """
    rng = np.random.default_rng(seed)
    middle = np.array([*HULL.values(), THRUST, LAG])
    rows = middle[:, None] * (1 + SPREAD * rng.uniform(-1, 1, (len(middle), count)))
    named = dict(zip(PARAMETERS, rows, strict=False))
    linear, square = -named["X_u"], -named["X_uu"]
    speed = (np.sqrt(linear**2 + 8 * square * named["thrust"]) - linear) / (2 * square)
    return np.vstack([rows, speed])


def located_difference(ours: Ends, theirs: Ends) -> float:
    """The largest difference of last states (m, rad, m/s, rad/s) and of times of switches (s).

    Raises:
        AssertionError: a boat has not as many switches in both.
    """
    assert np.array_equal(np.isfinite(ours[1]), np.isfinite(theirs[1])), "other switches"
    return max(np.abs(ours[0] - theirs[0]).max(), np.nanmax(np.abs(ours[1] - theirs[1])))


def sampled_difference(ours: Ends, theirs: Ends) -> float:
    """The largest difference of last states (SI units) where boats flip at the same samples.

    Raises:
        AssertionError: more than one boat in a thousand flips at others.
    """
    same = np.isclose(ours[1], theirs[1], rtol=0, atol=0.1 * STEP, equal_nan=True).all(1)
    assert same.mean() >= 1 - STRAY, f"{(~same).sum()} boats flip at other samples"
    return np.abs(ours[0] - theirs[0])[:, same].max()


def agree(peer: str, off: float, tolerance: float = AGREEMENT) -> None:
    """Raise `AssertionError` where library and peer differ by more than the tolerance."""
    assert off < tolerance, f"library and {peer} differ by {off:g}"
