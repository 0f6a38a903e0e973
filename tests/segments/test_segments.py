# pyright: reportArgumentType=false
"""Trials found in long recordings, traced from order to motion, and cut out.

The logs are made here by a simulator that shares nothing with the library: Nomoto's equation
for yaw, first-order surge, actuators with a lag or a slew rate, and an autopilot. What was run
and when its steering was executed is therefore known to a sample.
"""

import dataclasses
import hashlib
import json
import math

import numpy as np
import pytest
from tests.paths import DATA, ROOT

from diffsea import (
    Trajectory,
    UserError,
    find_segments,
    read_recording,
    read_vessel,
    write_recording,
)
from diffsea.cli import main
from diffsea.cli import segments as command
from diffsea.metrics.orders import alternating_chains, find_plateaus
from diffsea.segments import SEGMENT_KINDS, SegmentSettings, cut_out, group_repeats, traceability
from diffsea.segments.free_motion import quarter_turn_window
from diffsea.segments.signals import signals_of
from diffsea.simulation.actuation import executed_by
from diffsea.vessel.servo import Servo


DEG = math.pi / 180


@dataclasses.dataclass
class Ship:
    """Nomoto's ship with a throttle; the executed angle lags, or slews at a rate."""

    gain: float = 0.4  # 1/s per rad at design speed
    time: float = 4.0  # s
    speed: float = 2.0  # m/s at full throttle
    surge: float = 6.0  # s
    lag: float = 0.0  # s
    slew: float = math.inf  # rad/s
    step: float = 0.1


class Log:
    """A log in the making. `truth` has kind, time of the order and end of everything run."""

    def __init__(self, ship):
        self.ship, self.rows, self.truth = ship, [], []
        self.t = self.psi = self.r = self.delta = self.x = self.y = 0.0
        self.u, self.push = ship.speed, 1.0

    def advance(self, order, push):
        ship, dt = self.ship, self.ship.step
        if ship.lag == 0 and ship.slew == math.inf:
            self.delta = order
        self.rows.append(
            (self.t, self.x, self.y, self.psi, self.u, self.r, order, self.delta, push, self.push)
        )
        share = 1 - math.exp(-dt / ship.lag) if ship.lag else 1.0
        self.delta += float(np.clip(share * (order - self.delta), -ship.slew * dt, ship.slew * dt))
        self.push = push
        self.r += dt / ship.time * (ship.gain * self.u / ship.speed * self.delta - self.r)
        self.u += dt / ship.surge * (ship.speed * push - self.u * (1 + 3 * abs(self.r)))
        self.psi += dt * self.r
        self.x += dt * self.u * math.cos(self.psi)
        self.y += dt * self.u * math.sin(self.psi)
        self.t += dt

    def _run(self, kind, steer, push=1.0, **about):
        start = self.t
        while (order := steer(self.t - start)) is not None:
            self.advance(order, push)
        self.truth.append({"kind": kind, "start": start, "end": self.t, **about})
        return self

    def straight(self, seconds, course=None, kind="straight"):
        heading = self.psi if course is None else course

        def autopilot(since):
            order = np.clip(1.2 * (heading - self.psi) - 3.0 * self.r, -15 * DEG, 15 * DEG)
            return None if since >= seconds else float(order)

        return self._run(kind, autopilot)

    def transit(self, turn, seconds=60):
        return self.straight(seconds, self.psi + turn * DEG, "transit")

    def circle(self, angle, turn=360):
        psi = self.psi
        return self._run(
            "turning",
            lambda since: None if abs(self.psi - psi) >= turn * DEG else angle * DEG,
            angle=angle,
        )

    def zigzag(self, angle, heading=None, executes=4):
        heading, psi = abs(heading or angle) * DEG, self.psi
        state = {"side": math.copysign(1, angle), "left": executes, "times": [self.t]}

        def helm(since):
            if state["side"] * (self.psi - psi) >= heading:
                state["side"] *= -1
                state["left"] -= 1
                state["times"].append(self.t)
            return state["side"] * abs(angle) * DEG if state["left"] else None

        self._run("zigzag", helm, angle=angle)
        self.truth[-1]["switches"] = state["times"][:executes]
        return self

    def coast(self, seconds):
        return self._run("coasting", lambda since: None if since >= seconds else 0.0, push=0.0)

    def drift(self, seconds):
        """Without push until the vessel has long stopped."""
        first = len(self.rows)
        self.coast(seconds)
        moving = [row[0] for row in self.rows[first:] if row[4] > 0.1 * self.ship.speed]
        self.truth[-1]["end"] = moving[-1]
        self.truth.append({"kind": "station", "start": moving[-1], "end": self.t})
        return self

    def run(self, noise=0.0, twin=False, measured=True, ordered=True, seed=0, name="log.csv"):
        """The trajectory; `noise` in parts of what sensors usually have."""
        rng = np.random.default_rng(seed)
        t, x, y, psi, u, r, order, delta, push, pushed = np.array(self.rows).T
        for series, size in ((x, 0.1), (y, 0.1), (psi, 0.3 * DEG), (u, 0.02), (r, 0.1 * DEG)):
            series += noise * size * rng.standard_normal(t.size)
        if twin:
            commanded, executed = _pair(order, push), _pair(delta, pushed)
            scatter = 0.2
        else:
            commanded = {"rudder": order, "propeller": 10 * push}
            executed = {"rudder": delta, "propeller": 10 * pushed}
            scatter = 0.2 * DEG
        executed = {
            name: series + noise * scatter * rng.standard_normal(t.size)
            for name, series in executed.items()
        }
        return Trajectory(
            t=t, x=x, y=y, psi=psi, u=u, v=0 * t, r=r,
            commanded=commanded if ordered else {}, executed=executed if measured else {},
            extra={}, valid=np.ones(t.size, bool), name=name,
        )  # fmt: skip

    def executed_onset(self, start, threshold):
        """When the executed angle is first beyond the threshold, read off without noise."""
        t, delta = np.array(self.rows)[:, 0], np.array(self.rows)[:, 7]
        first = int(np.searchsorted(t, start - 1e-6))
        beyond = np.abs(delta[first:] - (delta[first - 1] if first else 0.0)) > threshold
        return t[first + int(np.argmax(beyond))]


def _pair(angle, push):
    """Thrusts (N) of a rudder-equivalent angle: a share of the angle over 35 deg to each side."""
    return {
        "port": 20 * push * (1 + angle / (35 * DEG)),
        "starboard": 20 * push * (1 - angle / (35 * DEG)),
    }


def campaign(ship):
    """A day of trials with transits, a stop and a repeat."""
    log = Log(ship)
    log.straight(60).zigzag(20, executes=4).straight(60).transit(100, 80)
    log.circle(25, 400).straight(80).zigzag(-10, executes=3).straight(60)
    log.coast(15).straight(80).circle(-25, 400).straight(60).drift(60)
    return log.straight(60).zigzag(20, executes=4).straight(40)


SHIPS = {
    "at once": Ship(),
    "lag": Ship(lag=0.8),
    "slew": Ship(slew=5 * DEG),
    "slow": Ship(gain=0.05, time=30.0, speed=8.0, surge=60.0, slew=2.5 * DEG, step=0.5),
}
SLOW_DAY = Log(SHIPS["slow"])
SLOW_DAY.straight(400).zigzag(20, 10).straight(400).circle(30, 250).straight(500).zigzag(-10)
SLOW_DAY.straight(400)


def trials(found):
    return [s for s in found if s.manoeuvre in ("zigzag", "turning-circle") or s.kind == "coasting"]


def wanted(log):
    return [item for item in log.truth if item["kind"] in ("zigzag", "turning", "coasting")]


@pytest.fixture(scope="module")
def days():
    days = {name: campaign(ship) for name, ship in SHIPS.items() if name != "slow"}
    return days | {"slow": SLOW_DAY}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("actuation", ["both", "no exec", "no cmd"])
@pytest.mark.parametrize("ship", SHIPS)
def test_every_trial_of_a_day_is_found_and_nothing_else(days, ship, actuation, twin, noise):
    log = days[ship]
    run = log.run(noise, twin, measured=actuation != "no exec", ordered=actuation != "no cmd")
    found, truth = trials(find_segments(run)), wanted(log)
    assert [s.kind for s in found] == [item["kind"] for item in truth]
    for segment, item in zip(found, truth, strict=True):
        step = log.ship.step
        assert segment.start <= segment.onset < segment.end
        assert segment.end == pytest.approx(item["end"], abs=0.25 * (item["end"] - item["start"]))
        if segment.kind == "coasting":
            continue
        assert math.degrees(segment.order) == pytest.approx(abs(item["angle"]), abs=1.5)
        assert segment.side == ("starboard" if item["angle"] > 0 else "port")
        onset = item["start"]
        if actuation != "no exec":
            onset = log.executed_onset(item["start"], segment.threshold)
        assert segment.onset == pytest.approx(onset, abs=(2 if noise else 1) * step + 1e-6)
        at = int(np.searchsorted(run.t, segment.onset - 1e-6))
        assert segment.reference_heading == pytest.approx(run.psi[at], abs=1e-9)


def test_switchings_of_a_zigzag_are_those_executed(days):
    log = days["lag"]
    (first, *_) = [s for s in find_segments(log.run()) if s.kind == "zigzag"]
    assert first.switches[0] == first.onset
    later = np.array(first.switches) - np.array(log.truth[1]["switches"])
    assert np.all(later >= 0) and np.all(later <= 3 * log.ship.step)
    assert first.ordered == pytest.approx(log.truth[1]["start"])


def test_segments_do_not_overlap_and_are_in_order(days):
    for log in days.values():
        found = find_segments(log.run(1.0))
        assert all(a.end < b.start for a, b in zip(found[:-1], found[1:], strict=True))
        assert {s.kind for s in found} <= set(SEGMENT_KINDS)


def test_a_transit_turn_is_turning_motion_but_no_trial(days):
    log = days["at once"]
    transit = next(item for item in log.truth if item["kind"] == "transit")
    inside = [
        s
        for s in find_segments(log.run())
        if transit["start"] - 1 <= s.onset < transit["start"] + 10
    ]
    assert [(s.kind, s.manoeuvre) for s in inside] == [("turning", "unknown")]
    assert math.degrees(inside[0].heading_change) == pytest.approx(100, abs=15)


def test_a_straight_run_begins_when_the_turning_is_over(days):
    run = days["lag"].run()
    fastest = np.max(np.abs(run.r))
    found = find_segments(run)
    assert any(s.kind == "straight" for s in found)
    for s in found:
        rows = (run.t >= s.start) & (run.t <= s.end)
        assert s.kind != "straight" or np.max(np.abs(run.r[rows])) < 0.15 * fastest


def test_a_vessel_that_has_stopped_is_on_station(days):
    log = days["at once"]
    stop = next(item for item in log.truth if item["kind"] == "station")
    resting = [s for s in find_segments(log.run(1.0)) if s.kind == "station"]
    assert len(resting) == 1
    assert resting[0].start == pytest.approx(stop["start"], abs=2) and resting[
        0
    ].end == pytest.approx(stop["end"], abs=5)


def test_without_any_actuator_turning_is_found_in_the_yaw_rate(days):
    log = days["at once"]
    run = log.run(1.0, measured=False, ordered=False)
    found = [s for s in find_segments(run) if s.kind == "turning"]
    circles = [item for item in log.truth if item["kind"] == "turning"]
    for item in circles:
        assert any(abs(s.onset - item["start"]) < 3 and s.actuation == "none" for s in found)
    assert all(s.manoeuvre == "unknown" for s in found)


def test_hand_steering_before_the_order_is_no_onset():
    log = Log(Ship())
    rng = np.random.default_rng(3)
    wander = np.cumsum(rng.standard_normal(2000)) * 0.1
    log._run("hand", lambda s: None if s >= 90 else 8 * DEG * math.sin(0.2 * s + 0.1 * wander[0]))
    log.circle(20, 400)
    (circle,) = trials(find_segments(log.run()))
    assert circle.onset == pytest.approx(log.truth[1]["start"], abs=0.11)
    assert not circle.steady and "wanders" in circle.approach.why


def test_the_approach_is_judged():
    calm = Log(Ship()).straight(60).circle(20)
    speeding = Log(Ship(surge=30.0))
    speeding.u = 0.5
    speeding.straight(25).circle(20)
    (steady,), (unsteady,) = (
        trials(find_segments(calm.run())),
        trials(find_segments(speeding.run())),
    )
    assert steady.steady and steady.approach.speed == pytest.approx(2.0, rel=1e-3)
    assert not unsteady.steady and "speed rises" in unsteady.approach.why
    assert unsteady.approach.trend > 0


def test_a_trial_at_the_very_start_has_no_approach_to_judge():
    (circle,) = trials(find_segments(Log(Ship()).circle(20, 500).straight(30).run()))
    assert circle.approach.verdict == "unknown" and math.isnan(circle.approach.speed)


def test_a_rudder_that_turns_to_port_is_told():
    run = Log(Ship()).straight(60).circle(20).run()
    turned = {name: -series for name, series in run.commanded.items() if name == "rudder"}
    run = dataclasses.replace(run, commanded=turned, executed={})
    (circle,) = trials(find_segments(run))
    assert circle.side == "starboard" and "turns to port" in circle.why


def test_a_hole_in_the_recording_ends_a_segment():
    run = Log(Ship()).straight(200).run()
    found = find_segments(without(run, (run.t >= 80) & (run.t <= 120)))
    assert [s.kind for s in found] == ["straight", "straight"]
    assert found[0].end < 80.05 and found[1].start > 119.95


def without(run, lost):
    """The run without some rows."""
    kept = {n: getattr(run, n)[~lost] for n in ("t", "x", "y", "psi", "u", "v", "r", "valid")}
    groups = {
        group: {n: s[~lost] for n, s in getattr(run, group).items()}
        for group in ("commanded", "executed")
    }
    return dataclasses.replace(run, **kept, **groups)


def test_an_approach_does_not_reach_across_a_hole():
    log = Log(Ship()).straight(60).circle(20)
    run = log.run()
    (whole,) = trials(find_segments(run))
    assert whole.start < 55
    (circle,) = trials(find_segments(without(run, (run.t > 50) & (run.t < 58))))
    assert circle.onset == pytest.approx(whole.onset) and circle.start >= 58


def test_a_flicker_of_the_steering_does_not_part_a_trial():
    log = Log(Ship()).straight(60).circle(20, 180)
    for _ in range(4):
        log.advance(0.0, 1.0)
    log.circle(20, 180).straight(30)
    (circle,) = trials(find_segments(log.run()))
    assert circle.onset == pytest.approx(log.truth[1]["start"], abs=0.11)
    assert circle.end == pytest.approx(log.truth[2]["end"], abs=0.3)
    assert len(circle.switches) == 1


def test_steering_that_never_swings_makes_no_chain():
    assert alternating_chains([], np.arange(5.0), 0.1) == []


def test_a_plateau_needs_rows_near_its_median():
    """Steered by hand, the median of some rows lies at none of the angles that they are near."""
    steering = np.repeat([0.018, 0.017, 0.013, -0.006, 0.02, -0.01], 2)
    (plateau,) = find_plateaus(steering, count=5)
    assert (plateau.first, plateau.last, plateau.level) == (0, 7, 0.017)


def test_the_window_is_the_time_of_a_quarter_turn():
    t = np.arange(0, 600, 0.1)
    r = np.where((t > 200) & (t < 300), 3 * DEG, 0.0)
    assert quarter_turn_window(t, r) == pytest.approx(30, rel=0.02)


def test_repeats_share_a_group_and_others_do_not(days):
    found = group_repeats(find_segments(days["at once"].run()))
    labels = {(s.onset, s.kind): s.group for s in trials(found)}
    zigzags = [label for (_, kind), label in sorted(labels.items()) if kind == "zigzag"]
    circles = [label for (_, kind), label in sorted(labels.items()) if kind == "turning"]
    assert zigzags[0] == zigzags[2] != zigzags[1]
    assert circles[0] != circles[1] and "starboard 25 deg" in circles[0]


def test_members_of_a_group_are_all_alike():
    run = Log(Ship()).straight(60).circle(20).run()
    (one,) = trials(find_segments(run))
    speeds = [1.0, 1.1, 1.2, 1.3]
    chain = [
        dataclasses.replace(one, approach=dataclasses.replace(one.approach, speed=s))
        for s in speeds
    ]
    labels = [s.group for s in group_repeats(chain)]
    assert labels[0] == labels[1] and labels[0] != labels[3]
    assert len({label for label in labels}) == 2


def checks(run, segment, vessel=None):
    return {check.name: check for check in traceability(segment, run, vessel)}


def test_executed_steering_is_compared_with_the_order(days):
    log = days["at once"]
    run = log.run(1.0)
    found = checks(run, trials(find_segments(run))[1])
    assert found["actuation"].verdict == "sound"
    assert found["actuation"].numbers["ratio"] == pytest.approx(1.0, abs=0.01)
    weak = dataclasses.replace(
        run, executed=run.executed | {"rudder": 0.7 * run.executed["rudder"]}
    )
    found = checks(weak, trials(find_segments(weak))[1])
    assert found["actuation"].verdict == "doubtful"
    assert found["actuation"].numbers["ratio"] == pytest.approx(0.7, abs=0.02)


def test_a_lag_shows_in_the_scatter_and_the_delay(days):
    run = days["lag"].run()
    found = checks(run, trials(find_segments(run))[0])["actuation"]
    assert found.numbers["ratio_spread"] > 0.1 and found.verdict == "doubtful"
    assert 0 < found.numbers["delay"] < 0.5


def test_what_was_not_measured_is_never_called_sound(days):
    run = days["at once"].run(measured=False)
    found = checks(run, trials(find_segments(run))[0])
    assert found["actuation"].verdict == "not checked"
    assert "not measured" in found["actuation"].why
    silent = days["at once"].run(ordered=False, measured=False)
    assert checks(silent, find_segments(silent)[0])["actuation"].verdict == "not checked"
    blind = dataclasses.replace(run, r=run.r * np.nan)
    assert checks(blind, trials(find_segments(blind))[0])["yaw-rate"].verdict == "not checked"


def test_yaw_rate_is_compared_with_the_heading(days):
    run = days["at once"].run(1.0)
    circle = trials(find_segments(run))[1]
    sound = checks(run, circle)["yaw-rate"]
    assert sound.verdict == "sound" and sound.numbers["correlation"] > 0.98
    wrong = dataclasses.replace(run, r=-run.r)
    assert checks(wrong, circle)["yaw-rate"].verdict == "doubtful"
    biased = checks(dataclasses.replace(run, r=run.r + 2 * DEG), circle)["yaw-rate"]
    assert biased.numbers["bias"] == pytest.approx(2 * DEG, rel=0.05)
    assert biased.verdict == "doubtful"


def test_time_steps_that_are_off_are_told(days):
    run = days["at once"].run()
    circle = trials(find_segments(run))[1]
    assert checks(run, circle)["time-step"].verdict == "sound"
    late = np.where(run.t > circle.onset + 5, run.t + 0.35, run.t)
    doubtful = checks(dataclasses.replace(run, t=late), circle)["time-step"]
    assert doubtful.verdict == "doubtful"
    assert doubtful.numbers["worst"] == pytest.approx(0.45, abs=1e-6)


def test_saturation_is_measured_against_the_vessels_limits():
    log = Log(Ship()).straight(60).circle(20).straight(30)
    vessel = read_vessel("wamv").vessel
    port, starboard = vessel.channels
    run = log.run(twin=True)
    upper = float(vessel.servos[port].upper)
    names = {"port": port, "starboard": starboard}
    scaled = {names[n]: s * upper / np.max(s) for n, s in run.commanded.items()}
    run = dataclasses.replace(run, commanded=scaled, executed=scaled)
    (circle,) = trials(find_segments(run, vessel))
    found = checks(run, circle, vessel)
    assert found[f"duty-cycle of {port}"].numbers["saturated"] > 0.95
    assert found[f"duty-cycle of {port}"].verdict == "doubtful"
    assert found[f"duty-cycle of {starboard}"].numbers["saturated"] == 0
    assert checks(run, circle)[f"duty-cycle of {port}"].verdict == "not checked"


def test_orders_are_answered_by_the_vessels_servos():
    t = np.arange(0, 10, 0.1)
    order = np.where(t >= 2, 1.0, 0.0)
    answer = executed_by(Servo(delay=0.5, time_constant=0.8), t, order)
    closed = np.where(t > 2.5, 1 - np.exp(-(t - 2.5) / 0.8), 0.0)
    np.testing.assert_allclose(answer, closed, atol=1e-9)


def test_a_vessel_makes_the_onset_that_of_its_servos():
    vessel = read_vessel("otter").vessel
    assert all(servo.time_constant is not None for servo in vessel.servos.values())
    log = Log(Ship()).straight(60).circle(20).straight(30)
    run = log.run(twin=True, measured=False)
    renamed = dict(zip(vessel.channels, run.commanded.values(), strict=True))
    speeds = {n: np.sign(s) * np.sqrt(np.abs(s)) for n, s in renamed.items()}
    run = dataclasses.replace(run, commanded=speeds)
    (circle,) = trials(find_segments(run, vessel))
    assert circle.actuation == "reconstructed" and "not measured" in circle.why
    assert log.truth[1]["start"] == circle.ordered < circle.onset
    assert math.degrees(circle.order) == pytest.approx(20, abs=0.5)


def test_an_exported_segment_is_read_again_with_time_from_the_onset(tmp_path, days):
    run = days["lag"].run()
    segment = trials(find_segments(run))[0]
    piece = cut_out(run, segment)
    write_recording(piece, tmp_path / "piece.csv")
    again = read_recording(tmp_path / "piece.csv")
    rows = (run.t >= segment.start) & (run.t <= segment.end)
    np.testing.assert_allclose(again.t, run.t[rows] - segment.onset, atol=1e-12)
    np.testing.assert_array_equal(again.psi, run.psi[rows])
    np.testing.assert_array_equal(again.executed["rudder"], run.executed["rudder"][rows])
    assert any("time counted from the onset" in step for step in piece.provenance)
    coarse = cut_out(run, segment, interval=0.5)
    np.testing.assert_allclose(np.diff(coarse.t), 0.5)
    assert coarse.provenance[-1] == "resampled to 0.5 s"


def test_reconstructed_actuation_is_not_exported(days):
    run = days["lag"].run(measured=False)
    assert not cut_out(run, trials(find_segments(run))[0]).executed


@pytest.fixture
def log_file(tmp_path, days):
    write_recording(days["lag"].run(1.0), tmp_path / "day.csv")
    return tmp_path / "day.csv"


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_the_command_writes_segments_with_provenance(tmp_path, log_file, days, capsys):
    out = tmp_path / "out"
    assert main(["segment", str(log_file), "-o", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    written = json.loads((out / "segments.json").read_text())
    assert printed == written
    (entry,) = written["recordings"]
    assert entry["source"]["sha256"] == hashlib.sha256(log_file.read_bytes()).hexdigest()
    assert entry["actuation"] == "measured" and entry["parameters"]["window"] > 0
    named = [s for s in entry["segments"] if s["manoeuvre"] in ("zigzag", "turning-circle")]
    assert len(named) == len([i for i in days["lag"].truth if "angle" in i])
    for item in entry["segments"]:
        path = out / item["file"]
        assert item["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        again = read_recording(path)
        assert again.t[0] == pytest.approx(item["start"] - item["onset"])
        assert any(entry["source"]["sha256"] in step for step in item["steps"])
        assert item["group"] and item["checks"]
    assert (out / "day.png").read_bytes().startswith(b"\x89PNG")


def test_kinds_interval_and_format_can_be_chosen(tmp_path, log_file, capsys):
    out = tmp_path / "out"
    words = ["--kind", "zigzag", "--interval", "0.5", "--format", "parquet"]
    assert main(["segment", str(log_file), "-o", str(out), *words]) == 0
    assert "3 segments" in capsys.readouterr().out
    files = sorted(out.glob("*.parquet"))
    assert len(files) == 3 and all("zigzag" in path.name for path in files)
    np.testing.assert_allclose(np.diff(read_recording(files[0]).t), 0.5)


def test_a_mapping_stands_in_the_provenance(tmp_path, log_file):
    text = log_file.read_text().replace("cmd_rudder", "delta").replace("exec_", "done_")
    log_file.write_text(text)
    mapping = tmp_path / "boat.toml"
    mapping.write_text('[columns]\nt = "t"\npsi = "psi"\nu = "u"\nr = "r"\ncmd_rudder = "delta"\n')
    out = tmp_path / "out"
    words = ["segment", str(log_file), "--mapping", str(mapping), "-o", str(out)]
    assert main(words) == 0
    (entry,) = json.loads((out / "segments.json").read_text())["recordings"]
    assert entry["source"]["mapping"]["text"] == mapping.read_text()
    assert entry["actuation"] == "commanded"
    assert all("done" not in read_recording(p).executed for p in out.glob("*.csv"))


@pytest.mark.parametrize(
    "words, status, message",
    [
        (["--kind", "zigzags"], 2, "did you mean 'zigzag'"),
        (["--window", "0"], 2, "not above zero"),
        (["--vessel", "nowhere.toml"], 1, "nowhere.toml"),
    ],
)
def test_bad_options_are_told(tmp_path, log_file, capsys, words, status, message):
    out = tmp_path / "out"
    assert main(["segment", str(log_file), *words, "-o", str(out)]) == status
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_two_recordings_of_one_name_are_refused(tmp_path, log_file, capsys):
    other = tmp_path / "elsewhere" / "day.csv"
    other.parent.mkdir()
    other.write_text(log_file.read_text())
    out = tmp_path / "out"
    assert main(["segment", str(log_file), str(other), "-o", str(out)]) == 1
    assert "overwrite" in capsys.readouterr().err and not out.exists()


def test_a_recording_without_yaw_is_refused():
    run = Log(Ship()).straight(30).run()
    with pytest.raises(UserError, match="neither heading"):
        find_segments(dataclasses.replace(run, psi=run.psi * np.nan, r=run.r * np.nan))
    with pytest.raises(UserError, match="rows"):
        find_segments(dataclasses.replace(run, valid=run.t < 1))
    with pytest.raises(UserError, match="window"):
        SegmentSettings(window=-1.0)


def test_the_commands_kinds_are_the_librarys():
    assert command.KINDS == SEGMENT_KINDS


def needs(folder, mapping):
    path = ROOT / "experiments" / mapping
    if not (DATA / folder).is_dir() or not path.is_file():
        pytest.skip(f"the recordings {folder} are not at {DATA}")
    return path


@pytest.mark.parametrize("file", ["turn_14-Sep-2020_13_51_45", "turn_14-Sep-2020_14_16_04"])
def test_a_turn_after_two_minutes_of_hand_steering(file):
    mapping = needs("esso_osaka/recordings", "esso_osaka/mapping.toml")
    run = read_recording(DATA / f"esso_osaka/recordings/{file}.csv", mapping)
    (circle,) = trials(find_segments(run))
    assert circle.manoeuvre == "turning-circle"
    assert circle.onset == pytest.approx(120.0, abs=0.2)
    assert math.degrees(circle.order) == pytest.approx(35, abs=0.5)


@pytest.mark.parametrize("folder", ["kvlcc2_hsva", "kcs_marin"])
def test_a_towing_tanks_zigzags_are_one_trial_each(folder):
    name = "mapping_repaired.toml" if folder == "kvlcc2_hsva" else "mapping.toml"
    mapping = needs(folder, f"{folder}/{name}")
    for path in sorted([*(DATA / folder).glob("*.dat"), *(DATA / folder).glob("*FS.txt")]):
        (zigzag,) = find_segments(read_recording(path, mapping))
        assert zigzag.kind == "zigzag" and zigzag.actuation == "measured"
        assert len(zigzag.switches) >= 3


def test_signals_of_a_pair_of_thrusters_are_rudder_equivalent():
    run = Log(Ship()).straight(20).circle(20, 90).run(twin=True)
    signals = signals_of(run)
    assert signals.steer is not None and signals.drive is not None
    assert np.max(signals.steer) == pytest.approx(20 * DEG)
    np.testing.assert_allclose(signals.drive, 1.0)


def test_channels_are_what_they_are_called_whatever_their_names_hold():
    """A comma in the names of a pair: idle together, they do not steer, and are named in full."""
    run = Log(Ship()).straight(20).circle(20, 90).coast(30).run(twin=True)
    idle = run.commanded["port"] == 0
    assert idle.any()
    turned = {"port, main": run.commanded["port"] + 0.5, "starboard, main": 0.0 * run.t + 0.2}
    turned["starboard, main"] = np.where(idle, 0.2, run.commanded["starboard"])
    run = dataclasses.replace(run, commanded=turned, executed=turned)
    signals = signals_of(run)
    assert signals.steering_channels == ("port, main", "starboard, main")
    assert signals.steer is not None
    assert np.all(signals.steer[idle] == 0) and np.max(signals.steer) > 15 * DEG


def test_a_piece_that_nothing_begins_is_judged_by_itself(days):
    found = find_segments(days["at once"].run())
    straight = next(s for s in found if s.kind == "straight")
    circle = next(s for s in found if s.manoeuvre == "turning-circle")
    assert "s of the piece" in straight.approach.why
    assert "s before the onset" in circle.approach.why


def test_the_row_of_a_new_order_does_not_count_against_its_execution(days):
    """Gear that answers at once still shows the old angle in the row of a reversed order."""
    log = days["at once"]
    run = log.run()
    segment = trials(find_segments(run))[1]
    late = dict(run.executed)
    late["rudder"] = np.concatenate([run.commanded["rudder"][:1], run.commanded["rudder"][:-1]])
    found = checks(dataclasses.replace(run, executed=late), segment)["actuation"]
    assert found.verdict == "sound" and found.numbers["ratio_spread"] < 1e-6
    restless = np.where(np.arange(len(run.t)) % 2, 0.2, -0.2)
    told = checks(
        dataclasses.replace(run, commanded=run.commanded | {"rudder": restless}), segment
    )["actuation"]
    assert told.verdict == "doubtful" and told.numbers["ratio_spread"] > 0.1
    thin = dataclasses.replace(
        run, **{
            name: getattr(run, name)[::40]
            for name in ("t", "x", "y", "psi", "u", "v", "r", "valid")
        },
        commanded={"rudder": run.commanded["rudder"][::40]},
        executed={"rudder": late["rudder"][::40]},
    )  # fmt: skip
    rows = np.flatnonzero(np.abs(np.diff(thin.commanded["rudder"])) > 0.03)
    behind = thin.executed["rudder"].copy()
    behind[rows + 1] = thin.commanded["rudder"][rows]
    slow = checks(dataclasses.replace(thin, executed={"rudder": behind}), segment)["actuation"]
    assert slow.verdict == "doubtful"  # a row of seconds is a delay
