"""Logs without a mapping: what they hold is recognised, and comes out true."""

import argparse
import dataclasses

import numpy as np
import pytest
from tests.recordings import driven_boat
from tests.recordings.driven_boat import BOOT, PARAMETERS, drive
from tests.recordings.test_logs import (
    bag,  # noqa: F401  a fixture
    text_log,
)

from diffsea import UserError, read_mapping, read_recording
from diffsea.cli import main
from diffsea.cli.options import used_parts
from diffsea.recordings.known import recognise
from diffsea.recordings.logs import contents
from diffsea.workflows.audits import as_used_recordings


@pytest.fixture(scope="module")
def boat():
    return drive()


@pytest.fixture
def log(tmp_path, boat, request):
    """A function that writes the log of a kind and returns its path."""

    def write(kind, **options):
        path = tmp_path / f"boat.{kind}"
        if kind == "bin":
            pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
            path.write_bytes(driven_boat.ardupilot_log(boat, **options))
        elif kind == "log":
            pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
            path.write_bytes(driven_boat.ardupilot_log(boat, write=text_log))
        elif kind == "tlog":
            pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
            driven_boat.telemetry_log(boat, path)
        elif kind == "csv":
            pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot] to write it")
            driven_boat.telemetry_csv(boat, path, **options)
        elif kind == "mcap":
            pytest.importorskip("mcap", reason="needs diffsea[mcap]")
            driven_boat.json_log(boat, path)
        elif kind == "rosjson":
            pytest.importorskip("mcap", reason="needs diffsea[mcap]")
            path = tmp_path / "rosjson.mcap"
            driven_boat.ros_json_log(boat, path, received=0.5)
        elif kind == "ulg":
            pytest.importorskip("pyulog", reason="needs diffsea[px4]")
            path.write_bytes(driven_boat.px4_log(boat))
        else:
            make = request.getfixturevalue("bag")
            path = make(driven_boat.ros_messages(boat, kind), kind)
        return path

    return write


def recognised(path):
    """What a log is recognised as."""
    known = recognise(path)
    assert known is not None
    return known


NAMES = {
    "bin": "ardupilot-bin",
    "log": "ardupilot-log",
    "tlog": "mavlink-tlog",
    "csv": "mavlink-csv",
    "mcap": "mcap-json",
    "rosjson": "mcap-json",
    "ulg": "px4-ulg",
}


@pytest.mark.parametrize("kind", [*NAMES, "ros1", "db3"])
def test_sides_heading_and_motion_of_every_known_log_are_the_truth(log, boat, kind):
    path = log(kind)
    run = read_recording(path)
    assert recognised(path).log == NAMES.get(kind, "ros-bag")
    zero = 0.0 if kind in ("ros1", "db3", "rosjson") else BOOT
    rows = np.interp(run.t - zero, boat.t, np.arange(boat.t.size))
    truth = lambda name: np.interp(rows, np.arange(boat.t.size), getattr(boat, name))
    for name, tolerance in {
        "x": 0.1,
        "y": 0.1,
        "psi": 0.03,
        "u": 0.06,
        "v": 0.06,
        "r": 0.04,
    }.items():
        known = np.isfinite(getattr(run, name))
        assert np.mean(known) > 0.9
        np.testing.assert_allclose(
            getattr(run, name)[known], truth(name)[known], atol=tolerance, err_msg=name
        )
    held = np.searchsorted(boat.t, run.t - zero + 1e-6) - 1
    scale, neutral = (
        (1.0, 0.0) if kind in ("bin", "log", "tlog", "csv", "mcap") else (400.0, 1500.0)
    )
    for side in ("port", "starboard"):
        orders = run.commanded[side] * scale + neutral
        same = np.isclose(orders, getattr(boat, side)[held], atol=0.5)
        assert np.mean(same[5:]) > 0.99  # but for a sample at a change


@pytest.mark.parametrize(
    "options", [{"version": 1}, pytest.param({"comma": True}, marks=pytest.mark.proof)]
)
def test_telemetry_as_csv_is_read_however_it_was_written(log, options):
    """By old versions, whose times are to the second, and where numbers have a comma."""
    binary = read_recording(log("tlog"))
    other = read_recording(log("csv", **options))
    np.testing.assert_allclose(other.t, binary.t, atol=1.1 if "version" in options else 2e-3)
    for name in ("x", "psi", "u", "r"):
        known = np.isfinite(getattr(binary, name))
        np.testing.assert_allclose(
            getattr(other, name)[known], getattr(binary, name)[known], rtol=1e-5, atol=1e-6
        )
    for side in ("port", "starboard"):
        np.testing.assert_array_equal(other.commanded[side], binary.commanded[side])


def test_a_message_without_a_time_is_told_with_its_line(log):
    path = log("csv")
    lines = path.read_text().split("\n")
    lines[20] = "yesterday," + lines[20].partition(",")[2]
    path.write_text("\n".join(lines))
    with pytest.raises(UserError, match="line 21: 'yesterday' is no time such as"):
        read_recording(path)


@pytest.mark.parametrize("ending", ["csv", "log", "tlog"])
def test_a_log_that_is_not_there_is_told(tmp_path, ending):
    with pytest.raises(UserError, match="there is no recording"):
        read_recording(tmp_path / f"missing.{ending}")


def test_a_mapping_that_was_chosen_is_told_written_and_overridden(log, tmp_path, capsys):
    path = log("bin")
    assert main(["audit", str(path), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().err
    assert "read as ArduPilot Rover (ardupilot-bin)" in told and "--mapping FILE overrides" in told
    assert "cmd_starboard from RCOU:C1" in told and "cmd_port from RCOU:C3" in told
    file = tmp_path / "own.toml"
    file.write_text(recognised(path).text)
    assert "port: output 3" in file.read_text()
    chosen, own = read_recording(path), read_recording(path, read_mapping(file))
    np.testing.assert_array_equal(chosen.u, own.u)
    np.testing.assert_array_equal(chosen.commanded["port"], own.commanded["port"])
    assert own.read.recognised == ()
    file.write_text(file.read_text().replace("RCOU:C3", "RCOU:C2"))
    assert np.all(read_recording(path, read_mapping(file)).commanded["port"][5:] == 1500)


@pytest.mark.parametrize(
    ("without", "named"),
    [
        (("RCOU",), "there are no orders (RCOU): set bit 14"),
        (("IMU",), "there is no yaw rate (IMU): set bit 7"),
        (("ATT",), "there is no heading (ATT): set bit 0"),
        (("XKF1",), "there is no velocity (XKF1)"),
    ],
)
def test_what_a_log_lacks_is_named_with_its_setting(log, without, named):
    known = recognised(log("bin", without=without))
    told = list(known.missing.values())
    assert told and all(line.startswith(named) for line in told)


def test_a_course_is_never_taken_for_a_heading(log):
    known = recognised(log("bin", without=("ATT", "XKF1")))
    assert "psi" not in known.mapping.channels and "latitude" in known.mapping.channels
    assert not any("GCrs" in column.column for column in known.mapping.channels.values())


def test_a_log_without_motion_names_all_that_is_to_be_recorded(log):
    with pytest.raises(UserError, match="no motion is in it") as told:
        recognised(log("bin", without=("ATT", "XKF1", "GPS", "IMU")))
    assert "LOG_BITMASK" in str(told.value) and "AHRS_EKF_TYPE" in str(told.value)


def test_outputs_without_a_function_are_not_guessed(log):
    other = {name: value for name, value in PARAMETERS.items() if "FUNCTION" not in name}
    known = recognised(log("bin", parameters=other))
    assert not any(name.startswith("cmd_") for name in known.mapping.channels)
    assert any(
        "SERVOn_FUNCTION must be 73 (port) and 74" in line for line in known.missing.values()
    )


def test_a_rudder_is_an_angle_to_starboard_and_reversal_counts(log):
    steered = PARAMETERS | {"SERVO1_FUNCTION": 26.0, "SERVO3_FUNCTION": 70.0}
    first = read_recording(log("bin")).commanded["starboard"]
    turned = read_recording(log("bin", parameters=steered | {"SERVO1_REVERSED": 1.0}))
    path = log("bin", parameters=steered)
    run = read_recording(path)
    np.testing.assert_allclose(run.commanded["rudder"], np.radians((first - 1500) / 400 * 35))
    np.testing.assert_allclose(turned.commanded["rudder"], -run.commanded["rudder"], atol=1e-12)
    assert recognised(path).craft == "boat with a motor and a rudder"


def test_telemetry_counts_on_the_autopilots_clock_and_leaves_the_station_out(log):
    path = log("tlog")
    run = read_recording(path)
    np.testing.assert_allclose(run.t[:3], BOOT + np.array([0, 0.1, 0.2]), atol=1e-3)
    assert set(np.unique(run.extra["armed"][10:])) == {0.0, 1.0}
    assert "armed" in contents(path)["HEARTBEAT"]


def test_only_the_time_asked_for_is_read(log, tmp_path, capsys):
    path = log("ulg")
    part = read_recording(path, start=60.0, end=80.0)
    assert (part.t[0], part.t[-1]) == pytest.approx((60.0, 80.0), abs=0.11)
    file = tmp_path / "part.toml"
    file.write_text(recognised(path).text.replace("[file]", "[file]\nstart = 60.0\nend = 80"))
    np.testing.assert_array_equal(read_recording(path, file).t, part.t)
    assert read_recording(path, file, end=70.0).t[-1] == pytest.approx(70.0, abs=0.11)
    file.write_text("[file]\nstart = 9\nend = 3\n" + '[columns]\nr = "a:b"\n')
    with pytest.raises(UserError, match="start = 9 s must be before end = 3 s"):
        read_mapping(file)
    assert main(["metrics", str(path), "--start", "1e6", "-o", str(tmp_path / "m")]) == 1
    assert "0 samples" in capsys.readouterr().err


def test_fits_leave_idle_stretches_of_known_logs_out_and_say_so(log, tmp_path, capsys):
    """And keep them where they are told to, or where the mapping is the user's."""
    path = log("bin")
    run = read_recording(path)
    args = argparse.Namespace(keep_idle=False)
    (piece,) = used_parts([run], args)
    told = capsys.readouterr().err
    assert "at rest without orders" in told and "--keep-idle keeps them" in told
    assert piece.t[0] > BOOT + 25 and piece.t[-1] < BOOT + 420
    args.keep_idle = True
    assert used_parts([run], args) == [run]
    file = tmp_path / "own.toml"
    file.write_text(recognised(path).text)
    own = read_recording(path, file)
    args.keep_idle = False
    assert used_parts([own], args) == [own] and capsys.readouterr().err == ""


def test_calls_from_python_leave_idle_stretches_of_files_out_and_say_so(log):
    """As commands do; of a recording that is given as read, all is used."""
    path, said = log("bin"), []
    (piece,) = as_used_recordings(path, progress=said.append)
    assert piece.t[0] > BOOT + 25 and piece.t[-1] < BOOT + 420
    assert "at rest without orders" in said[0] and "keep_idle=True keeps them" in said[0]
    (whole,) = as_used_recordings(path, keep_idle=True)
    assert as_used_recordings(whole) == [whole] and whole.t[-1] > piece.t[-1]


def test_a_fleet_leaves_idle_stretches_of_known_logs_out_and_says_so(log, monkeypatch):
    from diffsea.workflows import boat, fits

    class Found(Exception):
        """What a fit was asked for."""

    def asked(file, train, *other, **more):
        raise Found(train)

    monkeypatch.setattr(fits, "fit", asked)
    usable = "diffsea.simulation.order_units.with_usable_actuation"
    monkeypatch.setattr(usable, lambda vessel, some: list(some))
    monkeypatch.setattr("diffsea.identification.data.dataset.make_dataset", lambda *of: None)
    row = {"name": "monday", "recording": str(log("bin")), "mapping": None, "role": "train"}
    rows, runs = boat._read([row])
    settings = {"until": "fit", "free": None, "per_recording": False}
    with pytest.raises(Found) as raised:
        boat._fitted({"vessel": "otter", "settings": settings}, rows, runs)
    ((piece,),) = raised.value.args
    assert piece.name.startswith("monday [") and piece.t[-1] < BOOT + 420
    assert "at rest without orders" in rows[0]["idle"]


def test_an_mcap_file_is_of_ros_or_of_json_by_its_content(log, bag, boat):  # noqa: F811
    ros = bag(driven_boat.ros_messages(dataclasses.replace(boat), "mcap"), "mcap")
    (file,) = ros.glob("*.mcap")
    assert recognised(file).log == "ros-bag"
    assert recognised(log("mcap")).log == "mcap-json"
