# pyright: reportArgumentType=false
"""Damping by a power of speed, and the Pytheas boat that is published with it."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad

from diffsea import Environment, State, UserError, named, read_vessel, replace
from diffsea.vessel.files import build, updated_document
from diffsea.vessel.hull import Damping, signed_power


def moving(u, v=0.0, r=0.0):
    return State(*(np.asarray(value, float) for value in (0.0, 0.0, 0.0, u, v, r)))


def with_exponents(**exponents):
    document = read_vessel("pytheas").document
    return document | {"hull": document["hull"] | {"exponents": exponents}}


def damping(vessel, u, v, r):
    return np.asarray(vessel.forces["damping"](moving(u, v, r), Environment(), 0.0).stacked)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.7, 2.0, 3.0])
@pytest.mark.parametrize("x", [-2.0, -0.3, 0.01, 1.4])
def test_a_signed_power_is_what_it_says(x, exponent):
    assert float(signed_power(x, exponent)) == pytest.approx(
        np.sign(x) * abs(x) ** exponent, rel=1e-7
    )


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.7, 3.0])
def test_a_signed_power_has_derivatives_at_zero(exponent):
    for mode in (jax.jacfwd, jax.jacrev):
        by_x, by_exponent = mode(signed_power, argnums=(0, 1))(0.0, exponent)
        assert np.isfinite(float(by_x))
        assert float(by_exponent) == 0.0
        assert float(mode(signed_power)(0.0, 1.0)) == 1.0
        far = [float(d) for d in mode(signed_power, argnums=(0, 1))(-0.3, exponent)]
        closed = exponent * 0.3 ** (exponent - 1), -np.log(0.3) * 0.3**exponent
        np.testing.assert_allclose(far, closed, rtol=1e-6)


def test_each_axis_has_its_own_exponent():
    vessel = build(with_exponents(X_u=1.5, Y_v=2.0, N_r=0.8))
    made = damping(vessel, -1.2, 0.4, -0.9)
    expected = [14.0 * 1.2**1.5, -80.0 * 0.4**2, 5.0 * 0.9**0.8]
    np.testing.assert_allclose(made, expected, rtol=1e-7)
    # Without an exponent a derivative is what it was, beside those that have one.
    half = build(with_exponents(Y_v=2.0))
    np.testing.assert_allclose(damping(half, -1.2, 0.4, -0.9), [16.8, -12.8, 4.5], rtol=1e-7)


def test_an_exponent_of_two_is_the_quadratic_derivative():
    power = Damping({"X_u": -7.0}, {"X_u": 2.0})(moving(-0.8), Environment(), 0.0)
    square = Damping({"X_uu": -7.0})(moving(-0.8), Environment(), 0.0)
    assert float(power.X) == pytest.approx(float(square.X), rel=1e-9)


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.6])
def test_a_free_run_slows_down_as_the_closed_form_says(exponent):
    # m du / dt = -d u^a: the time from 1 to 0.5 m/s by quadrature of dt = -m du / (d u^a).
    vessel = build(with_exponents(X_u=exponent))
    expected = quad(lambda u: 7.21 / (14.0 * u**exponent), 0.5, 1.0)[0]
    idle = dict.fromkeys(vessel.channels, 0.0)
    slowing = lambda u: float(vessel.acceleration(moving(u), idle, Environment(), 0.0)[0])
    found = quad(lambda u: -1 / slowing(u), 0.5, 1.0)[0]
    assert found == pytest.approx(expected, rel=1e-9)


def test_exponents_are_parameters_with_a_place_in_the_file():
    file = read_vessel("pytheas")
    assert named(file.vessel)["exponents.X_u"] == 1.0
    changed = replace(file.vessel, {"exponents.X_u": 1.4})
    assert damping(changed, 0.5, 0.0, 0.0)[0] == pytest.approx(-14 * 0.5**1.4, rel=1e-7)
    written = updated_document(file.document, {"exponents.X_u": 1.4}, [])
    assert written["hull"]["exponents"]["X_u"] == 1.4
    assert file.document["hull"]["exponents"]["X_u"] == 1.0
    assert named(build(written))["exponents.X_u"] == 1.4


@pytest.mark.parametrize(
    ("exponents", "message"),
    [
        ({"X_uu": 1.0}, "unknown key 'X_uu'"),
        ({"X_u": 0.0}, "must be positive"),
        ({"X_u": "high"}, "is not a finite number"),
    ],
)
def test_what_is_wrong_with_an_exponent_is_said(exponents, message):
    with pytest.raises(UserError, match=message):
        build(with_exponents(**exponents))


def test_an_exponent_needs_its_derivative_and_si_units():
    document = with_exponents(X_u=1.5)
    del document["hull"]["X_u"]
    with pytest.raises(UserError, match="no power law without X_u"):
        build(document)
    document = with_exponents(X_u=1.5)
    document["hull"]["nondimensional"] = "mmg"
    with pytest.raises(UserError, match="SI units"):
        build(document)


def test_pytheas_has_the_formulas_it_names():
    hull = read_vessel("pytheas").document["hull"]
    m, L, W, rho = hull["mass"], hull["length"], hull["beam"], 1000.0
    D = (m / (rho * np.pi * L)) ** 0.5
    expected = {
        "draught": D,
        "I_z": m * (W**2 + L**2) / 12,
        "X_udot": -0.03 * m,
        "Y_vdot": -rho * np.pi * D**2 * L / 2,
        "N_rdot": -(0.1 * m * W**2 + rho * np.pi * D**2 * L**3) / 24,
    }
    assert {name: hull[name] for name in expected} == pytest.approx(expected, rel=1e-3)
