"""The tanker KVLCC2 (7 m model) in shipmmg, and the zig-zag that both it and the library run.

The centre of gravity is put amidships: shipmmg takes speed and drift angle at the centre of gravity
and the hull's derivatives amidships, which is the same only there.
"""

import tomllib
from typing import Any

from benchmarks import boats

import numpy as np
from jaxtyping import Float
from shipmmg.mmg_3dof import (
    Mmg3DofBasicParams,
    Mmg3DofManeuveringParams,
    zigzag_test_mmg_3dof,
)

from diffsea import shipped_vessels


SPEED = 1.179  # m/s, design speed
PRIMES = ("X_vv", "X_vr", "X_rr", "X_vvvv", "Y_v", "Y_r", "Y_vvv", "Y_vvr", "Y_vrr", "Y_rrr",
          "N_v", "N_r", "N_vvv", "N_vvr", "N_vrr", "N_rrr")  # fmt: skip


def document() -> dict[str, Any]:
    """The tanker as a vessel file."""
    shipped = tomllib.loads(shipped_vessels()["kvlcc2"].read_text(encoding="utf-8"))
    shipped["hull"]["x_G"] = 0.0
    return shipped


def headings(revolutions: float) -> Float[np.ndarray, "time"]:
    """Heading (rad) at every step of the zig-zag, at a propeller's rev/s.

    The rudder is reversed at the first sample beyond the check heading; tolerances of the
    integrator, which takes steps of its own between samples, cannot be chosen.
    """
    told = document()
    hull, propeller, rudder = told["hull"], told["propeller"][0], told["rudder"][0]
    length = hull["length"]
    basic = Mmg3DofBasicParams(
        L_pp=length, B=hull["beam"], d=hull["draught"], x_G=0.0, m=hull["mass"], I_zG=hull["I_z"],
        m_x=-hull["X_udot"], m_y=-hull["Y_vdot"], J_z=-hull["N_rdot"],
        D_p=propeller["diameter"], t_P=propeller["thrust_deduction"],
        w_P0=propeller["wake_fraction"], x_P=propeller["x"] / length,
        A_R=rudder["area"], η=propeller["diameter"] / rudder["height"], f_α=rudder["lift_slope"],
        ϵ=rudder["epsilon"], κ=rudder["kappa"], t_R=rudder["t_R"], x_R=rudder["x"],
        a_H=rudder["a_H"], x_H=rudder["x_H"], l_R=rudder["l_R"] / length,
        γ_R_minus=rudder["gamma_R_port"], γ_R_plus=rudder["gamma_R_starboard"],
    )  # fmt: skip
    coefficients = Mmg3DofManeuveringParams(
        *propeller["k_T"], R_0_dash=-hull["X_0"], **{f"{name}_dash": hull[name] for name in PRIMES}
    )
    times = boats.STEP * np.arange(boats.STEPS + 1)
    *_, psi = zigzag_test_mmg_3dof(
        basic, coefficients, boats.ANGLE, boats.CHECK, times.tolist(),
        [revolutions] * len(times), δ_rad_rate=rudder["rate_limit"], u0=SPEED,
        ρ=hull["water_density"],
    )  # fmt: skip
    return np.array(psi)
