"""Parameters in an ArduPilot log: outputs by function, their ends and sense."""

import sys

import pytest
from tests.recordings.test_logs import bin_log

from diffsea import UserError
from diffsea.recordings.known.autopilot_parameters import (
    GROUND_STEERING,
    THROTTLE,
    THROTTLE_LEFT,
    THROTTLE_RIGHT,
    read_parameters,
)


FORMAT = {"PARM": ("QNf", "TimeUS,Name,Value"), "RCOU": ("QHH", "TimeUS,C1,C3")}
TWIN = {
    "SERVO1_FUNCTION": 74, "SERVO1_MIN": 1100, "SERVO1_MAX": 1900, "SERVO1_TRIM": 1500,
    "SERVO1_REVERSED": 0, "SERVO2_FUNCTION": 0, "SERVO3_FUNCTION": 73, "SERVO3_MIN": 1120,
    "SERVO3_MAX": 1880, "SERVO3_TRIM": 1490, "SERVO3_REVERSED": 1, "MOT_THST_ASYM": 1.6,
    "RC1_MIN": 1000,
}  # fmt: skip


@pytest.fixture
def log(tmp_path):
    """A function that writes a log with parameters, in the order given."""
    pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")

    def write(*parameters):
        rows = [("RCOU", (1000, 1500, 1500))]
        for number, (name, value) in enumerate(parameters):
            rows.append(("PARM", (2000 + number, name.encode(), value)))
        path = tmp_path / "boat.bin"
        path.write_bytes(bin_log(FORMAT, rows))
        return path

    return write


def test_outputs_are_told_by_their_function(log):
    found = read_parameters(log(*TWIN.items()))
    left, right = found.output(THROTTLE_LEFT), found.output(THROTTLE_RIGHT)
    assert left is not None and right is not None
    assert (left.channel, right.channel) == (3, 1)
    assert (left.minimum, left.trim, left.maximum) == (1120, 1490, 1880)
    assert left.is_reversed and not right.is_reversed
    assert found.thrust_asymmetry == pytest.approx(1.6) and found.changed == ()
    assert found.output(THROTTLE) is None
    # Reversed, the shortest pulse is full ahead: 370 us from neutral, 390 us astern.
    assert (left.full_ahead, left.full_astern) == (1490 + 370, 1490 - 390)
    assert (right.full_ahead, right.full_astern) == (1900, 1100)


def test_what_a_log_does_not_say_is_the_autopilots_default_and_the_last_value_counts(log):
    found = read_parameters(
        log(("SERVO1_FUNCTION", 26), ("SERVO3_FUNCTION", 70), ("SERVO3_TRIM", 1500),
            ("SERVO3_TRIM", 1520), ("RC3_TRIM", 1), ("RC3_TRIM", 2))
    )  # fmt: skip
    steering, throttle = found.output(GROUND_STEERING), found.output(THROTTLE)
    assert steering is not None and throttle is not None
    assert (steering.minimum, steering.trim, steering.maximum) == (1100, 1500, 1900)
    assert throttle.trim == 1520 and found.changed == ("SERVO3_TRIM",)
    assert found.thrust_asymmetry == 1.0


def test_a_log_that_tells_none_has_none_and_one_that_is_damaged_is_refused(log, tmp_path):
    found = read_parameters(log())
    assert not found.values and found.outputs == ()
    other = tmp_path / "other.bin"
    other.write_bytes(b"no log at all")
    with pytest.raises(UserError, match="other.bin"):
        read_parameters(other)


def test_a_motor_with_its_neutral_at_an_end_is_refused(log):
    (output,) = read_parameters(log(("SERVO1_FUNCTION", 73), ("SERVO1_TRIM", 1100))).outputs
    with pytest.raises(UserError, match="boat.bin: SERVO1_TRIM = 1100 us is not between"):
        output.check_ends("boat.bin")


def test_without_the_package_its_extra_is_named(tmp_path, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "pymavlink"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    boat = tmp_path / "boat.bin"
    boat.write_bytes(b"\xa3\x95")
    with pytest.raises(UserError, match=r"needs the package pymavlink: pip install 'diffsea\[ard"):
        read_parameters(boat)
