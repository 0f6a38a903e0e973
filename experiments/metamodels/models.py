"""The simulation models that are validated, and how far they are from the ship."""

import math

import numpy as np

from diffsea import read_vessel


LINEAR = ("Y_v", "Y_r", "N_v", "N_r")
PMM_ERROR = 0.05  # relative standard deviation of a derivative from a planar motion mechanism


def from_tests(seed: int) -> dict[str, float]:
    """Model 1: the ship's derivatives as planar motion tests would give them, each a little off."""
    hull = read_vessel("mariner").document["hull"]
    draw = np.random.default_rng(seed)
    names = [n for n in hull if n.startswith(("Y_", "N_")) and not n.endswith("dot")]
    return {n: hull[n] * (1 + PMM_ERROR * draw.standard_normal()) for n in names}


def from_dimensions() -> dict[str, float]:
    """Model 2: linear derivatives and added masses by the regression of Clarke et al. (1983).

    It stands for the strip theory with corrections of the paper's second model: all it knows of
    the hull are length, beam, draught and block coefficient. The screw's side force is not known.
    """
    hull = read_vessel("mariner").document["hull"]
    L, B, T = hull["length"], hull["beam"], hull["draught"]
    C_B = hull["mass"] / (hull["water_density"] * L * B * T)
    scale = math.pi * (T / L) ** 2
    prime = {
        "Y_vdot": -scale * (1 + 0.16 * C_B * B / T - 5.1 * (B / L) ** 2),
        "Y_rdot": -scale * (0.67 * B / L - 0.0033 * (B / T) ** 2),
        "N_vdot": -scale * (1.1 * B / L - 0.041 * B / T),
        "N_rdot": -scale * (1 / 12 + 0.017 * C_B * B / T - 0.33 * B / L),
        "Y_v": -scale * (1 + 0.40 * C_B * B / T),
        "Y_r": -scale * (-1 / 2 + 2.2 * B / L - 0.080 * B / T),
        "N_v": -scale * (1 / 2 + 2.4 * T / L),
        "N_r": -scale * (1 / 4 + 0.039 * B / T - 0.56 * B / L),
    }
    half = 0.5 * hull["water_density"]
    power = {"Y_vdot": 3, "Y_rdot": 4, "N_vdot": 4, "N_rdot": 5}
    out = {n: v * half * L ** power[n] if n in power else v for n, v in prime.items()}
    # How they change with speed beyond its square, and the screw's side force, it cannot tell.
    return (
        out
        | dict.fromkeys(("Y_uv", "Y_ur", "N_uv", "N_ur"), 0.0)
        | dict.fromkeys(("Y_0", "Y_u", "Y_uu", "N_0", "N_u", "N_uu"), 0.0)
    )
