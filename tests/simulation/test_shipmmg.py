# pyright: reportArgumentType=false
"""KVLCC2 side by side with shipmmg, an independent MMG simulator with scipy's integrator.

The centre of gravity is put amidships: shipmmg takes speed and drift angle at the centre of
gravity and the hull's derivatives amidships, which is the same only there.
"""

import math
import tomllib

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from shipmmg.mmg_3dof import (
    Mmg3DofBasicParams,
    Mmg3DofManeuveringParams,
    simulate_mmg_3dof,
)
from tests.runs import CALM, run, staged_turn, state_of, trajectory

from diffsea import shipped_vessels
from diffsea.metrics import turning_metrics, zigzag_metrics
from diffsea.simulation.control import throttle_for
from diffsea.simulation.manoeuvres import zigzag
from diffsea.vessel.files import build


DOCUMENT = tomllib.loads(shipped_vessels()["kvlcc2"].read_text())
DOCUMENT["hull"]["x_G"] = 0.0
HULL, PROPELLER, RUDDER = DOCUMENT["hull"], DOCUMENT["propeller"][0], DOCUMENT["rudder"][0]
LENGTH, SPEED = HULL["length"], 1.179  # m, m/s
VESSEL = build(DOCUMENT)
REVOLUTIONS = float(throttle_for(VESSEL, SPEED))  # rev/s

BASIC = Mmg3DofBasicParams(
    L_pp=LENGTH, B=HULL["beam"], d=HULL["draught"], x_G=0.0, m=HULL["mass"], I_zG=HULL["I_z"],
    m_x=-HULL["X_udot"], m_y=-HULL["Y_vdot"], J_z=-HULL["N_rdot"],
    D_p=PROPELLER["diameter"], t_P=PROPELLER["thrust_deduction"],
    w_P0=PROPELLER["wake_fraction"], x_P=PROPELLER["x"] / LENGTH,
    A_R=RUDDER["area"], η=PROPELLER["diameter"] / RUDDER["height"], f_α=RUDDER["lift_slope"],
    ϵ=RUDDER["epsilon"], κ=RUDDER["kappa"], t_R=RUDDER["t_R"], x_R=RUDDER["x"],
    a_H=RUDDER["a_H"], x_H=RUDDER["x_H"], l_R=RUDDER["l_R"] / LENGTH,
    γ_R_minus=RUDDER["gamma_R_port"], γ_R_plus=RUDDER["gamma_R_starboard"],
)  # fmt: skip
PRIMES = ("X_vv", "X_vr", "X_rr", "X_vvvv", "Y_v", "Y_r", "Y_vvv", "Y_vvr", "Y_vrr", "Y_rrr",
          "N_v", "N_r", "N_vvv", "N_vvr", "N_vrr", "N_rrr")  # fmt: skip
COEFFICIENTS = Mmg3DofManeuveringParams(
    *PROPELLER["k_T"], R_0_dash=-HULL["X_0"], **{f"{name}_dash": HULL[name] for name in PRIMES}
)


def under_order(state, t, rudder, order, seconds, until=None):
    """One order from (u, v, r, x, y, psi): shipmmg's solution, to a heading if one is given.

    The rudder moves at its rate limit; on this grid the spline that shipmmg lays through it
    rounds the two corners off by a hundredth of a second.
    """
    grid = t + np.arange(0.0, seconds, 0.02)
    swing = RUDDER["rate_limit"] * (grid - t)
    rudders = rudder + np.clip(order - rudder, -swing, swing)

    def passed(_, s):
        return s[5] - until

    passed.terminal = True
    return simulate_mmg_3dof(
        BASIC, COEFFICIENTS, grid, rudders, np.full(len(grid), REVOLUTIONS), *state,
        ρ=HULL["water_density"], rtol=1e-9, atol=1e-10, events=None if until is None else passed,
    )  # fmt: skip


START = (SPEED, 0.0, 0.0, 0.0, 0.0, 0.0)


def run_to(stages):
    """Carry and rows of the library's run."""
    return run(VESSEL, stages, state_of(u=SPEED), REVOLUTIONS, CALM, 0.1, 140.0)


def test_both_hold_the_same_speed():
    solution = under_order(START, 0.0, 0.0, 0.0, 60.0)
    np.testing.assert_allclose(solution.y[0], SPEED, rtol=1e-9)


@pytest.mark.proof
@pytest.mark.parametrize("side", [1, -1])
def test_the_turning_circle_is_shipmmgs(side):
    angle = side * math.radians(35)
    theirs = under_order(START, 0.0, 0.0, angle, 140.0).sol

    def reached(heading):
        return brentq(lambda t: side * theirs(t)[5] - heading, 1.0, 139.0, xtol=1e-10)

    quarter, half = reached(math.pi / 2), reached(math.pi)
    expected = {
        "advance": theirs(quarter)[3],
        "transfer": side * theirs(quarter)[4],
        "tactical_diameter": side * theirs(half)[4],
        "time_to_90": quarter,
        "time_to_180": half,
    }
    _, rows = run_to(staged_turn(angle))
    ours = turning_metrics(trajectory(rows), 0.0, side, 0.0)
    for name, value in expected.items():
        assert float(ours[name]) == pytest.approx(value, rel=1e-5), name
    last = np.flatnonzero(np.asarray(rows.accepted))[-1]
    motion = [float(getattr(rows.state, c)[last]) for c in ("u", "v", "r")]
    np.testing.assert_allclose(motion, theirs(float(rows.t[last]))[:3], rtol=1e-5)


@pytest.mark.parametrize(
    ("degrees", "side"),
    [
        (10, 1),
        (20, -1),
        *(pytest.param(*other, marks=pytest.mark.proof) for other in ((10, -1), (20, 1))),
    ],
)
def test_the_zigzag_is_shipmmgs(degrees, side):
    angle, sign = math.radians(degrees), side
    state, t, rudder = START, 0.0, 0.0
    times, overshoots = [], []
    for _ in range(3):
        leg = under_order(state, t, rudder, sign * angle, 80.0, until=sign * angle)
        if times:
            peak = minimize_scalar(
                lambda at, leg=leg, sign=sign: sign * leg.sol(at)[5],
                bounds=(t, leg.t[-1]), method="bounded", options={"xatol": 1e-9},
            )  # fmt: skip
            overshoots.append(-peak.fun - angle)
        t, state, rudder, sign = leg.t[-1], tuple(leg.y[:6, -1]), leg.y[6, -1], -sign
        times.append(t)
    carry, rows = run_to(zigzag(side * angle, angle, 3))
    executes = jnp.concatenate([jnp.zeros(1), carry.switch_times])
    ours = zigzag_metrics(trajectory(rows), executes, 0.0, side)
    np.testing.assert_allclose(carry.switch_times, times, rtol=1e-5)
    found = [float(ours["overshoot_1"]), float(ours["overshoot_2"])]
    np.testing.assert_allclose(found, overshoots, rtol=2e-5)
