"""Vessel files that would silently mean something else, and numbers that no file holds."""

import copy
import tomllib

import pytest
from tests.boats import BOAT

from diffsea import UserError, named
from diffsea.vessel.files import build, require_writable, updated_document


HULL = tomllib.loads(BOAT)["hull"]
PULSES = {"unit": "us", "thrust_curve": {"full_thrust": 50.0, "exponent": 1.5}}


def with_parts(**parts):
    return {"format": 1, "name": "boat", "hull": HULL, **parts}


SHIP = with_parts(
    propeller=[{"name": "screw", "diameter": 0.2, "k_T": [0.5, -0.3, -0.1], "max_speed": 20.0}],
    rudder=[
        {"name": "rudder", "propeller": "screw", "area": 0.05, "height": 0.3, "x": -2.0}
        | {"max_angle": 0.6, "rate_limit": 0.3}
    ],
    azimuth_thruster=[
        {"name": "pod", "x": -1.0, "y": 0.0, "max_force": 100.0, "angle_rate_limit": 0.3}
        | {"max_angle": 1.0, "min_angle": -1.0}
    ],
    tunnel_thruster=[{"name": "bow", "x": 1.0, "max_force": 50.0, "fading_speed": 1.0}],
    thruster=[{"x": -1.0, "y": -0.5}, {"x": -1.0, "y": 0.5, "max_force": 90.0}],
)


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("screw.upper", ("propeller", 0, "max_speed")),
        ("screw.k_T.1", ("propeller", 0, "k_T", 1)),
        ("rudder.upper", ("rudder", 0, "max_angle")),
        ("pod.force.upper", ("azimuth_thruster", 0, "max_force")),
        ("pod.angle.lower", ("azimuth_thruster", 0, "min_angle")),
        ("pod.angle.rate_limit", ("azimuth_thruster", 0, "angle_rate_limit")),
        ("bow.fading_speed", ("tunnel_thruster", 0, "fading_speed")),
        ("thruster2.upper", ("thruster", 1, "max_force")),
        ("thruster2.x", ("thruster", 1, "x")),
        ("Y_rdot", ("hull", "Y_rdot")),
    ],
)
def test_a_fitted_number_is_written_where_the_file_has_it(name, places):
    before = float(named(build(SHIP))[name])
    new = updated_document(SHIP, {name: 0.9 * before}, [])
    for place in places:
        new = new[place]
    assert new == 0.9 * before
    require_writable(SHIP, [name])


@pytest.mark.parametrize(
    ("document", "name"),
    [
        (SHIP, "screw.water_density"),
        (SHIP, "rudder.lower"),
        (SHIP, "sensors.gyro_bias"),
        (SHIP, "current_north"),
        (with_parts(thruster=[{"name": "port", "x": -1.0, "y": 0.0} | PULSES]), "port.upper"),
    ],
)
def test_a_number_that_no_key_holds_is_refused_before_it_is_fitted(document, name):
    same = copy.deepcopy(document)
    with pytest.raises(UserError, match=rf"'{name}' cannot be fitted"):
        require_writable(document, [name])
    assert document == same


def test_fits_refuse_such_a_number_at_once(tmp_path):
    from tests.fuzz.seeds import table

    import diffsea

    file = tmp_path / "boat.toml"
    file.write_text(BOAT)
    for job in (diffsea.fit, diffsea.diagnose):
        with pytest.raises(UserError, match="'current_north' cannot be fitted"):
            job(str(file), table(60).assign(cmd_starboard=40.0), free=["current_north"])


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"thruster": [{"name": "damping", "x": -1.0, "y": 0.0}]},
            "is called 'damping', as a force",
        ),
        (
            {"tunnel_thruster": [{"name": "bow", "x": 1.0, "max_force": 5.0, "fading_speed": 0.0}]},
            "fading_speed",
        ),
        ({"hull": HULL | {"Y_uvv": 3.0}}, "Y_vuv is odd"),
        ({"hull": HULL | {"N_uvr": 3.0}}, "N_vur is odd"),
        (
            {"effect": [{"name": "actuator-bias:port", "bias": 1.0}]},
            "a file has its name, 'actuator-bias'",
        ),
        ({"effect": [{"name": "current"}]}, "states no number; its keys are speed, direction"),
        ({"effect": [{"name": "mass-change", "x": 1.0}]}, "mass is missing"),
        (
            {"effect": [{"name": "sensor-latency", "delay": 0.1, "channels": ["x", "z"]}]},
            "channels are among",
        ),
        (
            {"effect": [{"name": "heading-offset", "angle": 0.1, "channels": ["psi", "r"]}]},
            "where velocities are turned with the heading",
        ),
        (
            {"effect": [{"name": "heading-offset", "channels": ["psi", "u", "v"]}]},
            "angle is missing",
        ),
        (
            {
                "effect": [
                    {
                        "name": "heading-offset",
                        "angle": 0.1,
                        "time": 2.0,
                        "channels": ["psi", "u", "v"],
                    }
                ]
            },
            "it is the heading alone",
        ),
        ({"effect": [{"name": "gyro-bias", "time": 2.0}]}, "bias is missing"),
        (
            {"effect": [{"name": "lever-arm", "x": 1.0, "channels": ["u", "v"]}]},
            "of an antenna whose velocities are its own",
        ),
        (
            {"effect": [{"name": "thrust-change", "time": 2.0, "actuators": ["screw"]}]},
            "factor is missing",
        ),
    ],
)
def test_what_would_mean_something_else_is_refused(parts, message):
    with pytest.raises(UserError, match=message):
        build(tomllib.loads(BOAT) | parts)


def test_an_effect_that_recordings_do_not_show_is_not_estimated(tmp_path):
    from tests.fuzz.seeds import table

    import diffsea

    file = tmp_path / "boat.toml"
    file.write_text(BOAT)
    run = table(60).assign(cmd_starboard=40.0)
    offset = next(name for name in diffsea.EFFECTS if name.startswith("feedback-error"))
    for effect, channel in (("roll-coupling", "phi"), (offset, "exec_")):
        with pytest.raises(UserError, match=f"without the channel {channel}"):
            diffsea.fit(str(file), run, free=["X_u"], effects=[effect])
