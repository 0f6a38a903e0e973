"""Coordinates of parameters stay inside their bounds; files of priors say what is wrong."""

import math

import numpy as np
import pytest

from diffsea import Parameter, UserError
from diffsea.parameters import hull_prior, parameter_meaning, parameter_unit, read_priors


KINDS = (
    Parameter("free", 3.0, 2.0),
    Parameter("above", 3.0, 3.0, 0.5, lower=1.0),
    Parameter("below", -3.0, 3.0, 0.5, upper=0.0),
    Parameter("between", 3.0, 3.0, 0.5, lower=-1.0, upper=4.0),
)


@pytest.mark.parametrize("parameter", KINDS, ids=lambda p: p.name)
def test_numbers_stay_inside_their_bounds_and_come_back(parameter):
    assert float(parameter.decode(0.0)) == pytest.approx(parameter.value)
    for coordinate in (-6.0, -0.7, 0.2, 6.0):
        value = float(parameter.decode(coordinate))
        assert parameter.lower < value < parameter.upper
        assert parameter.encode(value) == pytest.approx(coordinate)
        step = 1e-6
        ends = (float(parameter.decode(coordinate + s * step)) for s in (1, -1))
        slope = abs(next(ends) - next(ends)) / (2 * step)
        assert parameter.slope(coordinate) == pytest.approx(slope, rel=1e-4, abs=1e-12)


def test_drag_keeps_its_sign_and_couplings_need_not():
    assert float(hull_prior("X_u", -52.0).decode(9.0)) < 0
    assert float(hull_prior("N_rdot", -240.0).decode(9.0)) < 0
    assert float(hull_prior("mass", 180.0).decode(-9.0)) > 0
    for name in ("Y_r", "N_v", "Y_uv", "N_vvr", "x_G", "port.angle", "N_vdot"):
        assert float(hull_prior(name, 10.0).decode(-9.0)) < 0


def test_units_and_meanings():
    assert parameter_unit("N_rr") == "N m / (rad/s) (rad/s)" and parameter_unit("N_rr", True) == "1"
    assert parameter_unit("X_udot", True) == "kg"
    assert parameter_unit("rudder.area") == "m^2" and parameter_unit("port.y") == "m"
    assert (
        parameter_unit("port.time_constant") == "s"
        and parameter_unit("sensors.gyro_bias") == "rad/s"
    )
    assert parameter_unit("rudder.N_d") == "" and parameter_unit("propeller.wake_fraction") == ""
    assert parameter_meaning("N_rr") == "quadratic damping in yaw"
    assert parameter_meaning("propeller.k_T.0") == "propeller, thrust coefficient at rest"
    assert parameter_meaning("Y_vvr") == "sway force from v v r"
    assert parameter_meaning("N_v") == "yaw moment from v"


def priors(tmp_path, text: str) -> dict:
    path = tmp_path / "priors.toml"
    path.write_text(text, encoding="utf-8")
    known = {n: hull_prior(n, v) for n, v in {"X_u": -52.0, "Y_r": 10.0, "x_G": 0.0}.items()}
    return read_priors(path, known)


def test_a_file_of_priors(tmp_path):
    found = priors(
        tmp_path,
        "[X_u]\nvalue = -40.0\nstd = 4.0\n[Y_r]\nlower = -5.0\nupper = 30.0\n[x_G]\nfree = false\n",
    )
    assert found["x_G"] is None
    assert found["X_u"].std == pytest.approx(4.0) and float(found["X_u"].decode(9.0)) < 0
    assert found["X_u"].value == -40.0 and found["X_u"].unit == "N / (m/s)"
    assert -5.0 < float(found["Y_r"].decode(-20.0)) and float(found["Y_r"].decode(20.0)) < 30.0
    # One prior standard deviation, to first order.
    slope = found["X_u"].slope(0.0)
    assert found["X_u"].spread == pytest.approx(4.0 / slope) and math.isclose(slope, 40.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[X_uu]\nvalue = 1.0", "no parameter 'X_uu'; did you mean 'X_u'"),
        ("[X_u]\nwidth = 1.0", "unknown key 'width'"),
        ("[X_u]\nvalue = 'a'", "value = 'a' is not what it should be"),
        ("[X_u]\nvalue = 3.0", "not between the bounds"),
        ("[X_u]\nstd = 0.0", "above zero"),
        ("X_u = 3.0", "must be a table"),
        ("[X_u", "cannot read priors"),
        ("format = 2", "reads format = 1"),
    ],
)
def test_mistakes_in_a_file_of_priors_are_told(tmp_path, text, told):
    with pytest.raises(UserError, match=told.replace("(", r"\(")):
        priors(tmp_path, text)


def test_a_missing_file_of_priors_is_told(tmp_path):
    with pytest.raises(UserError, match="cannot read priors"):
        read_priors(tmp_path / "none.toml", {})


def test_prior_spreads_are_relative_by_default():
    assert hull_prior("X_u", -52.0, 0.3).std == pytest.approx(0.3 * 52.0)
    assert np.isclose(hull_prior("Y_r", 0.0).std, 0.5)
