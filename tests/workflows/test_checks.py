"""`diffsea check`: what it says of a log is what the boat that wrote it did."""

import dataclasses
import json
import re

import numpy as np
import pandas as pd
import pytest
from tests import chromium
from tests.recordings import driven_boat
from tests.recordings.driven_boat import FULL, NEUTRAL, drive, noisy

from diffsea.checks import check_run, check_together
from diffsea.checks.answers import Answers, answers_of
from diffsea.checks.lags import FirstOrderLag
from diffsea.checks.open_questions import next_length, open_questions
from diffsea.checks.shares import in_shares, order_scales
from diffsea.checks.spans import IntervalEstimate
from diffsea.cli import main
from diffsea.recordings import Finding, audit, write_recording
from diffsea.recordings.auditing.edits import Affine, Blank, Edit, StepRemoval
from diffsea.report.pages.check import (
    DOUBTFUL,
    check_report,
    headlines,
    quality_plot,
    trial_order,
)
from diffsea.trajectory import Trajectory
from diffsea.workflows.checks import craft_of


DELAY, WEAKER = 0.4, 0.06


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A folder with a log of each kind that can be written."""
    pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
    folder = tmp_path_factory.mktemp("logs")
    boat = noisy(drive(DELAY, WEAKER, upside_down=40.0))
    (folder / "boat.bin").write_bytes(driven_boat.ardupilot_log(boat))
    (folder / "fixes.bin").write_bytes(driven_boat.ardupilot_log(boat, without=("XKF1", "ARM")))
    (folder / "cut.bin").write_bytes(b"\xa3\x95 nothing that is a log")
    driven_boat.telemetry_log(boat, folder / "boat.tlog")
    return folder


@pytest.fixture(scope="module")
def checked(logs, tmp_path_factory):
    """check.json of the dataflash log and the folder with the other files."""
    out = tmp_path_factory.mktemp("checked")
    assert main(["check", str(logs / "boat.bin"), "-o", str(out)]) == 0
    return json.loads((out / "check.json").read_text()), out


def recorded(boat, orders=None, step=0.1):
    """A boat as a recording with orders in us, or in others."""
    slow = boat.every(step)
    motion = {name: getattr(slow, name) for name in ("x", "y", "psi", "u", "v", "r")}
    orders = {"port": slow.port, "starboard": slow.starboard} if orders is None else orders(slow)
    everything = np.ones(slow.t.shape, bool)
    return Trajectory(slow.t, **motion, commanded=orders, executed={}, extra={}, valid=everything)


def answers(boat, **options):
    run = recorded(boat, **options)
    spans = [(float(run.t[0]), float(run.t[-1]))]
    return answers_of([(in_shares(run, order_scales(run)), spans)])


def test_format_craft_channels_and_what_is_used_are_told(checked):
    record, _ = checked
    assert record["format"] == 1 and record["log"] == "ardupilot-bin"
    assert record["craft"] == "boat with two thrusters, port and starboard"
    assert record["channels"]["r"] | {"rate": 0} == {
        "source": "IMU:GyrZ", "unit": "rad/s", "rate": 0
    }  # fmt: skip
    assert record["channels"]["r"]["rate"] == pytest.approx(25, rel=0.01)
    assert record["channels"]["cmd_port"]["unit"] == "us"
    assert record["orders"]["port"]["why"] == "parameters of output 3"
    ((start, end),) = record["used"]
    assert start == pytest.approx(30 + 34, abs=2) and end == pytest.approx(30 + 408, abs=4)
    assert [one["why"] for one in record["idle"]][-1] == "upside down"
    assert record["audit"] == [] and record["missing"] == []


def test_the_picture_of_quality_says_channels_in_words(checked):
    page = (checked[1] / "check.html").read_text()
    for words in ("heading", "yaw rate", "order port", "speed to starboard"):
        assert f'"{words}"' in page
    assert '"psi"' not in page and '"cmd_port"' not in page


def test_faults_are_drawn_at_their_times():
    """A heading that stands still, wild yaw rates, a compass step; a bias is all the time."""
    run = recorded(noisy(drive(DELAY, dock=0.0, after=0.0)))
    first, last = round(float(run.t[0]), 2), round(float(run.t[-1]), 2)

    def fault(kind: str, channel: str, *edits: Edit) -> Finding:
        return Finding(kind, 1.0, 0.1, "1", kind, channels=(channel,), edits=edits)

    findings = [
        fault("stuck", "psi", Blank(("psi",), ((10.0, 12.0),))),
        fault("outliers", "r", Blank(("r",), ((20.0, 20.0), (30.0, 30.0)))),
        fault("heading-offset", "psi", StepRemoval("psi", 0.1, 50.0)),
        fault("scale", "u", Affine(("u",), 1.1)),
        fault("gap", "v"),
    ]
    plot = quality_plot(check_run(run, findings, ("csv", "a table", "vessel"), {}))
    assert plot is not None
    drawing = plot.figure.to_dict()
    axis = drawing["layout"]["yaxis"]
    rows = dict(zip(axis["ticktext"], axis["tickvals"], strict=True))
    drawn = {}
    for trace in drawing["data"]:
        row = next(name for name, place in rows.items() if place == trace["y"][0])
        doubtful = trace["line"]["color"] == DOUBTFUL
        drawn.setdefault((row, doubtful), []).append(list(trace["x"]))
    assert drawn["heading", True] == [[10.0, 12.0, None], [50.0, last, None]]
    assert drawn["yaw rate", True] == [[20.0, 20.0, None, 30.0, 30.0, None]]
    assert drawn["speed ahead", True] == [[first, last, None]]
    assert ("speed to starboard", True) not in drawn
    assert {("heading", False), ("yaw rate", False)} <= set(drawn)


def test_dead_time_and_sides_of_the_log_hold_the_truth(checked):
    shows = checked[0]["shows"]
    low, high = shows["lag"]["turning"]["delay"]["interval"]
    assert low - 0.02 <= DELAY <= high + 0.02 and high - low < 0.3
    assert shows["asymmetry"]["value"] == pytest.approx(-WEAKER / (2 - WEAKER), abs=0.01)
    assert shows["asymmetry"]["interval"][1] < 0
    speeds = {round(point["order"], 1): point["value"] for point in shows["speed_against_order"]}
    for order in (0.3, 0.5, 0.7, 0.9):
        force = 40 * order * (2 - WEAKER)  # of the steady balance with 18 u^2 + 6 u
        steady = (-6 + np.sqrt(36 + 4 * 18 * force)) / 36
        assert speeds[order] == pytest.approx(steady, rel=0.04)


def test_circles_are_found_where_they_were_run(checked):
    circles = [one for one in checked[0]["trials"] if one["kind"] == "turning"]
    long = [one for one in circles if one["end"] - one["onset"] > 40]
    assert [one["side"] for one in long] == ["starboard", "port"]
    for one, start in zip(long, (180, 240), strict=True):
        assert one["onset"] == pytest.approx(30 + 40 + start, abs=0.5)
        assert one["end"] == pytest.approx(30 + 40 + start + 45, abs=2)


def parts_of(scales=(1.0, 1.0)):
    """Two logs of a boat, straight courses and then turning, and the answers of both in one."""
    boat = noisy(drive(DELAY, WEAKER, dock=0.0, after=0.0))
    checks = []
    for number, scale in enumerate(scales):
        share = lambda pulses, scale=scale: scale * (pulses - NEUTRAL) / FULL
        orders = lambda slow, share=share: {
            "port": share(slow.port),
            "starboard": share(slow.starboard),
        }
        run = recorded(boat, orders)
        own = run.rows(run.t < 95 if number == 0 else run.t >= 95)
        checks.append(check_run(own, (), ("csv", "a table", "vessel"), {}))
    return checks, answers(boat)


def test_logs_of_one_boat_tell_together_what_neither_tells_alone():
    checks, whole = parts_of()
    straight, turning = checks
    both = check_together(checks)
    assert both is not None and both.names == (straight.name, turning.name)
    assert straight.answers.lag_of_turning is None
    lag = both.answers.lag_of_turning
    assert lag is not None and lag.delay.low <= DELAY <= lag.delay.high
    orders = [{round(p.order, 1) for p in one.answers.speed} for one in (both, straight, turning)]
    assert orders[0] == orders[1] | orders[2] and orders[1] - orders[2]
    assert both.answers.asymmetry is not None and whole.asymmetry is not None
    assert both.answers.asymmetry.value == pytest.approx(whole.asymmetry.value, abs=0.003)
    open_alone = [{one.what for one in check.cannot_tell} for check in checks]
    open_still = {one.what for one in both.cannot_tell}
    assert open_still == open_alone[0] & open_alone[1]
    assert "how fast it answers an order to turn" in open_alone[0] - open_still


def test_full_order_is_the_largest_one_in_any_log():
    checks, _ = parts_of(scales=(37.0, 37.0))
    first, second = (check.scales["port"].full_ahead for check in checks)
    both = check_together(checks)
    assert both is not None and first != second
    largest = max(first, second)
    assert [one["port"].full_ahead for one in both.scales] == [largest, largest]
    assert max(point.order for point in both.answers.speed) <= 1.0


def test_logs_that_have_not_the_same_orders_are_not_put_together():
    checks, _ = parts_of()
    assert check_together(checks[:1]) is None and check_together([]) is None
    bare = dataclasses.replace(checks[1].run, commanded={})
    silent = check_run(bare, (), ("csv", "a table", "vessel"), {})
    assert check_together([checks[0], silent]) is None
    more = check_together([silent, *checks, silent, silent])
    assert more is not None and len(more.names) == 2


def test_several_logs_are_told_together_first(logs, tmp_path, capsys):
    paths = [str(logs / name) for name in ("boat.bin", "boat.tlog", "cut.bin")]
    assert main(["check", *paths, "-o", str(tmp_path)]) == 0
    assert "boat.bin, boat.tlog together:" in capsys.readouterr().out
    together = json.loads((tmp_path / "check.json").read_text())["together"]
    assert together["logs"] == ["boat.bin", "boat.tlog"]
    low, high = together["shows"]["lag"]["turning"]["delay"]["interval"]
    assert low - 0.05 <= DELAY <= high + 0.05
    page = (tmp_path / "check.html").read_text()
    assert page.index("show together") < page.index("What is in it, and is it sound?")


def test_what_is_not_in_a_log_is_asked_for_within_three_minutes(checked):
    record, _ = checked
    open_now = {one["what"]: one for one in record["cannot_tell"]}
    assert open_now["thrust astern and stopping"]["why"] == "no order astern is in it"
    assert not any(what.startswith("steady turning") for what in open_now)
    assert record["next"]["record"] == ["from half ahead to half astern until it stops"]
    straight = recorded(noisy(drive(dock=0.0, after=0.0).every(0.02)))
    rows = straight.t < 95
    part = check_run(straight.rows(rows), (), ("csv", "a table", "vessel"), {})
    asked = [one.what for one in part.cannot_tell]
    assert "how fast it answers an order to turn" in asked
    assert "steady turning to port, and so drift" in asked
    assert "resistance by speed" not in asked
    assert part.answers.stayed > 8  # for it hardly turned
    assert sum(one.seconds for one in part.next) <= next_length(part.answers) == 180


def test_a_vessel_that_turns_slowly_is_given_longer():
    quick = recorded(noisy(drive(dock=0.0, after=0.0).every(0.02)))
    part = quick.rows((quick.t > 20) & (quick.t < 300))
    longer = 30.0  # times as long for everything, at the same speeds
    stretched = {name: longer * getattr(part, name) for name in ("t", "x", "y")}
    slow = dataclasses.replace(part, r=part.r / longer, **stretched)
    small, ship = (check_run(run, (), ("csv", "a table", "vessel"), {}) for run in (part, slow))
    seconds = {one.what: one.seconds for one in small.cannot_tell}
    assert ship.answers.stayed > 8 * small.answers.stayed
    slowness = ship.answers.stayed / small.answers.stayed
    both = [one for one in ship.cannot_tell if 0 < seconds.get(one.what, 0) < np.inf]
    assert both
    for one in both:
        assert one.seconds == pytest.approx(slowness * seconds[one.what])
    assert next_length(ship.answers) == pytest.approx(180 * slowness)
    courses = open_questions([slow], dataclasses.replace(ship.answers, speed=()), (), (), True)
    [legs] = [one.record for one in courses if one.what == "resistance by speed"]
    [leg] = re.findall(r"(\d+) s each", str(legs))
    assert float(leg) == pytest.approx(20 * slowness, rel=0.05)


@pytest.mark.parametrize("delay", [0.0, 0.8])
def test_the_dead_time_is_the_one_that_was_given(delay):
    found = answers(noisy(drive(delay, dock=0.0, after=0.0))).lag_of_turning
    assert found is not None and not found.opposite
    assert found.delay.low <= delay <= found.delay.high and found.delay.high < delay + 0.2


def test_exchanged_sides_are_said_to_be_exchanged():
    swapped = lambda slow: {"port": slow.starboard, "starboard": slow.port}
    found = answers(noisy(drive(DELAY, WEAKER, dock=0.0, after=0.0)), orders=swapped)
    assert found.lag_of_turning is not None and found.lag_of_turning.opposite


def test_equal_sides_are_not_told_apart_and_no_answer_is_none():
    boat = noisy(drive(DELAY, dock=0.0, after=0.0))
    equal = answers(boat).asymmetry
    assert equal is not None and abs(equal.value) < 0.005 and equal.high - equal.low < 0.05
    rng = np.random.default_rng(3)

    def guess(slow):
        drawn = rng.uniform(-1, 1, (2, slow.t.size // 20 + 1))
        held = NEUTRAL + FULL * np.repeat(drawn, 20, axis=1)[:, : slow.t.size]
        return {"port": held[0], "starboard": held[1]}

    assert answers(boat, orders=guess).lag_of_turning is None


def test_a_certain_bias_of_the_gyro_is_no_difference_of_the_sides():
    """Of equal sides: the answers are those without the bias, and it is said that it is off."""
    boat = noisy(drive(DELAY, dock=0.0, after=0.0))
    found = {}
    for bias in (0.0, 0.1):
        run = recorded(dataclasses.replace(boat, r=boat.r + bias))
        found[bias] = check_run(run, audit(run), ("csv", "a table", "vessel"), {})
    sound, biased = (found[bias].answers for bias in (0.0, 0.1))
    assert sound.asymmetry is not None and biased.asymmetry is not None
    assert biased.asymmetry.value == pytest.approx(sound.asymmetry.value, abs=2e-4)
    for clean, taken_off in zip(sound.turning, biased.turning, strict=True):
        assert taken_off.answer.value == pytest.approx(clean.answer.value, abs=1e-3)
    (note,) = found[0.1].notes
    assert note.startswith("taken off before anything is told") and "0.1 rad/s" in note
    assert [one.kind for one in found[0.1].audit] == ["gyro-bias"] and found[0.0].notes == ()
    np.testing.assert_array_equal(found[0.1].run.r, boat.every(0.1).r + 0.1)


def test_what_a_gyro_is_late_is_no_dead_time_of_the_boat():
    boat = noisy(drive(DELAY, dock=0.0, after=0.0))
    late = dataclasses.replace(boat, r=np.interp(boat.t - 1.0, boat.t, boat.r))
    run = recorded(late)
    check = check_run(run, audit(run), ("csv", "a table", "vessel"), {})
    assert "sensor-latency" in {one.kind for one in check.audit}
    found = check.answers.lag_of_turning
    assert found is not None and found.delay.value == pytest.approx(DELAY, abs=0.15)
    assert any("taken off" in note and "later" in note for note in check.notes)


def test_a_bias_that_is_not_certain_stays_and_is_said():
    boat = noisy(drive(DELAY, dock=0.0, after=0.0))
    run = recorded(dataclasses.replace(boat, r=boat.r + 0.1))
    (finding,) = audit(run)
    doubted = dataclasses.replace(finding, std=0.5 * finding.value)
    check = check_run(run, [doubted], ("csv", "a table", "vessel"), {})
    assert max(point.answer.value for point in check.answers.turning) > 0.5  # of 0.46
    assert check.notes[0].startswith("what is told of the answer to orders rests on r, and that")


@pytest.mark.parametrize(
    "kind, channels, told",
    [
        ("sign", ("exec_rudder",), True),
        ("swapped-actuators", ("cmd_port", "cmd_starboard"), True),
        ("axes", ("y", "psi", "v", "r"), True),  # mirrored as a whole
        ("sign", ("r",), True),
        ("axes", ("u", "v"), False),
        ("sign", ("v",), False),
        ("sensor-latency", ("r",), False),
    ],
)
def test_the_audit_says_whether_orders_turn_the_boat_the_other_way(kind, channels, told):
    check = check_run(recorded(noisy(drive(DELAY))), (), ("csv", "a table", "vessel"), {})
    found = Finding(kind, 1.0, 0.1, "1", "", channels=channels)
    assert dataclasses.replace(check, audit=(found,)).reversed_turning is told


def test_headlines_say_only_what_is_told_from_nothing():
    estimate = lambda value, low, high: IntervalEstimate(value, low, high, "s")
    constant = estimate(1.0, 0.9, 1.1)
    told = headlines(Answers(lag_of_turning=FirstOrderLag(estimate(0, 0, 2), constant, 0.9)), True)
    assert told == []
    seen = FirstOrderLag(estimate(0.4, 0.3, 0.5), constant, 0.9)
    told = headlines(Answers(lag_of_turning=seen, asymmetry=estimate(0.01, -0.2, 0.2)), True)
    assert told == ["It begins to turn 0.40 s after the order (0.30 to 0.50 s)."]
    # A controller turns against the motion: which way orders act, the audit says.
    against = Answers(lag_of_turning=dataclasses.replace(seen, opposite=True))
    assert len(headlines(against, True)) == 1
    assert "turns it to port" in headlines(against, True, reversed_turning=True)[1]
    told = headlines(Answers(asymmetry=estimate(0.001, -0.01, 0.02), paired=True), True)
    assert told == ["Port and starboard differ by less than 4 %."]
    told = headlines(Answers(asymmetry=estimate(0.001, -0.01, 0.02)), True)
    assert told == ["Turns to port and to starboard differ by less than 4 %."]
    told = headlines(Answers(asymmetry=estimate(-0.03, -0.04, -0.02), paired=True), True)
    assert told == ["Starboard does 6 % less than port for the same order."]
    # Told from nothing at 90 %, and not at 99.
    assert headlines(Answers(asymmetry=estimate(-0.02, -0.037, -0.003), paired=True), True) == []


@pytest.mark.parametrize(
    ("actuators", "craft"),
    [
        (("port", "starboard"), "two thrusters, port and starboard"),
        (("rudder", "propeller"), "a propeller and a rudder"),
        (("rudder.port", "rudder.starboard", "propeller"), "a propeller and two rudders"),
        (("pod.angle", "pod.thrust", "bow"), "an azimuth thruster and an actuator (bow)"),
        (("rudder",), "a rudder"),
        (("port.angle", "port.force", "stbd.angle", "stbd.force"), "two azimuth thrusters"),
        (
            ("helm", "port_engine", "starboard_engine"),
            "two thrusters, port and starboard and a rudder",
        ),
    ],
)
def test_a_craft_is_called_what_its_channels_say(actuators, craft):
    assert craft_of(actuators) == f"vessel with {craft}"
    assert craft_of([]) == "vessel whose actuators were not recorded"


def test_a_table_with_native_columns_is_called_what_its_channels_say(tmp_path):
    boat = noisy(drive(DELAY, dock=0.0, after=0.0))
    write_recording(recorded(boat), tmp_path / "run.csv")
    assert main(["check", str(tmp_path / "run.csv"), "-o", str(tmp_path / "out")]) == 0
    craft = json.loads((tmp_path / "out" / "check.json").read_text())["craft"]
    assert craft == "vessel with two thrusters, port and starboard"


@pytest.mark.parametrize(
    ("scaled", "unit"),
    [
        (lambda us: us, "us"),
        (lambda us: (us - NEUTRAL) / FULL, "normalised"),
        (lambda us: (us - NEUTRAL) / FULL * 37.0, "own"),
    ],
)
def test_orders_of_any_unit_are_the_same_shares(scaled, unit):
    boat = drive(dock=0.0, after=0.0)
    orders = lambda slow: {"port": scaled(slow.port), "starboard": scaled(slow.starboard)}
    run = recorded(boat, orders)
    scales = order_scales(run)
    assert {one.unit for one in scales.values()} == {unit}
    share = in_shares(run, scales).commanded["port"]
    truth = (boat.every(0.1).port - NEUTRAL) / FULL
    largest = 1.0 if unit != "own" else np.quantile(np.abs(truth), 0.995)
    np.testing.assert_allclose(share, truth / largest, atol=0.01)


def test_a_pulse_of_no_length_is_no_order():
    boat = drive(dock=0.0, after=10.0)
    silent = lambda slow: {
        side: np.where(slow.t > 362, 0.0, getattr(slow, side)) for side in ("port", "starboard")
    }
    run = recorded(boat, silent)
    assert in_shares(run, order_scales(run)).commanded["port"][-1] == 0


def test_the_page_is_one_file_and_shows_what_the_record_has(checked):
    record, out = checked
    page = (out / "check.html").read_text()
    assert "Check of boat.bin" in page and 'http-equiv="Content-Security-Policy"' in page
    for one in record["cannot_tell"]:
        assert one["what"] in page
    assert "upside down" in page and "IMU:GyrZ" in page and "prefers-color-scheme: dark" in page


def test_a_place_that_is_hidden_is_in_nothing_that_is_written(logs, tmp_path):
    args = ["check", str(logs / "fixes.bin"), "-o"]
    assert main([*args, str(tmp_path / "told")]) == 0
    assert main([*args, str(tmp_path / "hidden"), "--hide-place"]) == 0
    written = lambda folder: "".join(f.read_text() for f in (tmp_path / folder).iterdir())
    place = r"63\.4[34]\d*, 10\.[34]\d*"
    hidden = written("hidden")
    assert re.search(place, written("told")) and not re.search(place, hidden)
    assert "there is no velocity (XKF1)" in hidden


def test_a_table_with_fixes_hides_its_place_too(tmp_path):
    boat = recorded(noisy(drive(DELAY, WEAKER)))
    degrees = {"lat": 63.43 + boat.x / 111_000, "lon": 10.39 + boat.y / 49_800}
    columns = {"time_s": boat.t, **degrees, "heading_deg": np.degrees(boat.psi) % 360}
    columns |= {"yaw_rate": boat.r, "rpm_spare": 0 * boat.t + np.sin(boat.t)}
    table = tmp_path / "boat.csv"
    pd.DataFrame(columns).to_csv(table, index=False)
    written = {}
    for flag in ("--json", "--hide-place"):
        out = tmp_path / flag.strip("-")
        assert main(["check", str(table), flag, "-o", str(out)]) == 0
        written[flag] = "".join(file.read_text() for file in out.iterdir())
    place = r"63\.4[34]\d*, 10\.[34]\d*"
    assert re.search(place, written["--json"]) and "origin = " in written["--json"]
    assert not re.search(place, written["--hide-place"])
    assert "origin = " not in written["--hide-place"] and "latitude = " in written["--hide-place"]


def test_a_log_that_is_broken_is_a_row_and_all_broken_an_error(logs, tmp_path, capsys):
    both = [str(logs / "cut.bin"), str(logs / "boat.tlog")]
    assert main(["check", *both, "--json", "-o", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["logs"]["cut.bin"]["audit"][0]["kind"] == "unreadable"
    assert told["logs"]["boat.tlog"]["log"] == "mavlink-tlog"
    assert "could not be read" in (tmp_path / "check.html").read_text()
    assert main(["check", both[0], "-o", str(tmp_path / "none")]) == 1
    assert "cannot be read" in capsys.readouterr().err and not (tmp_path / "none").exists()


def test_a_log_that_is_not_there_is_told_once(tmp_path, capsys):
    for name in ("boat.bin", "boat.csv"):
        assert main(["check", str(tmp_path / name), "-o", str(tmp_path / "out")]) == 1
        said = capsys.readouterr().err
        assert said.count(name) == 1 and "there is no recording" in said
        assert "native columns" not in said


def test_the_page_fits_a_phone_and_asks_for_nothing(checked, tmp_path):
    if chromium.installed() is None:
        pytest.skip("no Chromium")
    with chromium.opened(checked[1] / "check.html", tmp_path, width=400) as page:
        assert page.run("document.documentElement.scrollWidth") <= 400
        assert page.run("document.querySelectorAll('.plot .main-svg').length") >= 5
        assert page.complaints == []
        assert all(address.startswith(("file:", "blob:", "data:")) for address in page.requests)


def test_only_the_time_asked_for_is_checked(logs, tmp_path):
    args = ["check", str(logs / "boat.tlog"), "--start", "100", "--end", "200"]
    assert main([*args, "-o", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "check.json").read_text())
    assert record["used"][0][0] >= 99.9 and record["used"][-1][1] <= 200.1


def test_a_table_of_others_is_read_through_a_proposal_that_is_written(tmp_path, capsys):
    slow = noisy(drive(DELAY, dock=0.0, after=0.0)).every(0.2)
    columns = {"time_ms": slow.t * 1e3, "Yaw": np.degrees(slow.psi) % 360, "North": slow.x,
               "East": slow.y, "fwd": slow.u, "side": slow.v, "Gyro Z": np.degrees(slow.r),
               "thr_left": slow.port, "thr_right": slow.starboard}  # fmt: skip
    table = np.stack(list(columns.values()), axis=1)
    path = tmp_path / "logger.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")
    assert main(["check", str(path), "-o", str(tmp_path / "out")]) == 0
    record = json.loads((tmp_path / "out" / "check.json").read_text())
    mapping = tmp_path / "out" / "logger.mapping.toml"
    assert record["log"] == "csv" and mapping.exists()
    command = f"diffsea diagnose boat.toml {path} --mapping {mapping}"
    assert command in capsys.readouterr().out
    assert command in (tmp_path / "out" / "check.html").read_text()
    boat = tmp_path / "boat.toml"
    size = ["--length", "1.4", "--beam", "0.9", "--mass", "22", "--thrusters", "0.6"]
    assert main(["new", str(boat), *size]) == 0
    assert main(["diagnose", str(boat), str(path)]) == 1
    assert f"`diffsea check {path}` proposes a mapping" in capsys.readouterr().err
    broken = tmp_path / "broken.csv"
    broken.write_text("t,x\n0,1\n1,fast\n")
    assert main(["diagnose", str(boat), str(broken), str(path)]) == 1
    assert "'fast' is not a number" in capsys.readouterr().err
    assert record["channels"]["psi"] | {"rate": 0} == {"source": "Yaw", "unit": "deg", "rate": 0}


def test_a_ground_course_is_no_heading_and_columns_that_may_be_orders_are_named(tmp_path):
    slow = noisy(drive(DELAY, dock=0.0, after=0.0)).every(0.2)
    course = np.degrees(np.angle(slow.north_east)) % 360
    columns = {"timestamp": slow.t, "yaw": np.degrees(slow.psi) % 360, "groundcourse": course,
               "groundspeed": np.abs(slow.north_east), "north": slow.x, "east": slow.y,
               "ch1out": slow.starboard, "ch3out": slow.port}  # fmt: skip
    table = np.stack(list(columns.values()), axis=1)
    path = tmp_path / "planner.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")
    assert main(["check", str(path), "-o", str(tmp_path / "out")]) == 0
    record = json.loads((tmp_path / "out" / "check.json").read_text())
    assert record["channels"]["psi"]["source"] == "yaw"
    assert "groundcourse" not in [one["source"] for one in record["channels"].values()]
    assert "columns not used" in record["missing"][0] and "ch3out" in record["missing"][0]


def test_the_order_of_a_trial_is_an_angle_or_of_thrusters_a_difference():
    assert trial_order(np.radians(7.0), paired=False) == "7.0 deg"
    assert trial_order(np.radians(7.0), paired=True) == "20 % of the sum"
    assert trial_order(np.nan, paired=True) == ""
    assert trial_order(10.0, paired=True) == "on the spot"


def yawing(to_starboard, slower=1.0):
    """A boat whose rudder turns her by what it is ordered times her speed, with a lag of 1 s.

    One way by a factor, and slower while she is turned that way.
    """
    rng = np.random.default_rng(3)
    t = 0.2 * np.arange(3000)
    order = np.repeat(rng.choice([-0.4, -0.2, 0.0, 0.2, 0.4], 100), 30)
    speed = np.where(order > 0, slower, 1.0)
    wanted = np.where(order > 0, to_starboard, 1.0) * 0.5 * order * speed
    rate = np.zeros(t.size)
    for k in range(1, t.size):
        rate[k] = rate[k - 1] + 0.2 * (wanted[k - 1] - rate[k - 1])
    rate += rng.normal(0.0, 0.002, t.size)
    psi = np.cumsum(0.2 * rate)
    x, y = np.cumsum(0.2 * speed * np.cos(psi)), np.cumsum(0.2 * speed * np.sin(psi))
    return Trajectory(
        t, x, y, psi, speed, 0 * t, rate, extra={}, valid=np.ones(t.shape, bool), executed={},
        commanded={"rudder": order, "propeller": 10 + 0 * t},
    )  # fmt: skip


def test_a_rudder_does_no_less_where_turns_one_way_are_slower():
    check = check_run(yawing(1.0, 0.6), [], ("csv", "a table", "vessel"), {})
    found = check.answers.asymmetry
    assert found is not None and abs(found.value) < 0.015
    assert not any("than to" in one for one in headlines(check.answers, True))


def test_of_a_rudder_nothing_is_told_where_the_speed_is_not_known():
    run = yawing(0.5)
    gone = np.full(run.t.shape, np.nan)
    blind = dataclasses.replace(run, x=gone, y=gone, u=gone, v=gone)
    check = check_run(blind, [], ("csv", "a table", "vessel"), {})
    assert check.answers.lag_of_turning is not None and check.answers.asymmetry is None


WAYS = {0.5: "less to starboard than to port", 2.0: "less to port than to starboard"}


@pytest.mark.parametrize("to_starboard", WAYS)
def test_a_rudder_that_does_less_one_way_is_told_the_right_way(to_starboard):
    """Of a boat with one rudder the sides are its two ways."""
    check = check_run(yawing(to_starboard), [], ("csv", "a table", "vessel"), {})
    sentences = headlines(check.answers, True)
    page = check_report([check], ["as it is"], {})
    assert "angles (deg)" in page and "orders (%)" in page
    told = WAYS[to_starboard]
    assert any(one.startswith("It turns ") and told in one for one in sentences), sentences


def test_speed_that_is_still_lost_from_a_turn_is_none_of_a_straight_course():
    """A boat that does 1 m/s by her propeller and half of it in turns, and needs 5 s for either."""
    t, interval = 0.2 * np.arange(3000), 0.2
    rudder = np.where(t % 60.0 < 20.0, 0.5, 0.0)
    speed = np.ones(t.size)
    for k in range(1, t.size):
        wanted = 0.5 if rudder[k - 1] else 1.0
        speed[k] = speed[k - 1] + interval / 5.0 * (wanted - speed[k - 1])
    rate = 0.6 * rudder
    psi = np.cumsum(interval * rate)
    x, y = (np.cumsum(interval * speed * part) for part in (np.cos(psi), np.sin(psi)))
    orders = {"rudder": rudder, "propeller": 10 + 0 * t}
    run = Trajectory(
        t, x, y, psi, speed, 0 * t, rate, commanded=orders, executed={}, extra={},
        valid=np.ones(t.shape, bool),
    )  # fmt: skip
    (point,) = check_run(run, [], ("csv", "a table", "vessel"), {}).answers.speed
    assert point.answer.value == pytest.approx(1.0, abs=0.02) and point.answer.low > 0.95
