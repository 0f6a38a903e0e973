"""What is put into a recording is taken out again, and nothing else is touched.

Faults are injected here by other means than the library's edits: the runs, their truth and
their faults come from the kinematic generator of the audit's tests.
"""

import dataclasses
import json
import tomllib

import numpy as np
import pandas as pd
import pytest
from test_audit import earth_axes, edited, motion, recording, sampled

import diffsea
from diffsea import Mapping, read_mapping, read_recording, repair, write_recording
from diffsea.cli import main
from diffsea.recordings import audit
from diffsea.recordings.auditing.edits import Affine, ExecutedToCommanded
from diffsea.recordings.auditing.mapping_rows import mapping_text
from diffsea.recordings.mappings import Column


pytestmark = pytest.mark.slow


CHANNELS = ("x", "y", "psi", "u", "v", "r")


def through_water(true):
    nu = true["u"] + 1j * true["v"] - 0.25 * np.exp(1j * (0.9 - true["psi"]))
    return {"u": nu.real, "v": nu.imag}


def knocked(true):
    late = np.arange(true["psi"].size) > 0.5 * true["psi"].size
    return {"psi": true["psi"] + 0.3 * late}


def on_a_lever(true):
    c, s = np.cos(true["psi"]), np.sin(true["psi"])
    return {"x": true["x"] + 1.2 * c + 0.5 * s, "y": true["y"] + 1.2 * s - 0.5 * c}


def scaled(factor, *names):
    return lambda true: {name: factor * true[name] for name in names}


# What is done to the truth, the kind it is found as, whether a mapping can take it back, and how
# far (m, rad, m/s) a channel may be from the truth's own recording afterwards.
FAULTS = {
    "heading offset": (lambda true: {"psi": true["psi"] + 0.2}, "heading-offset", True, 0.01),
    "gyro bias": (lambda true: {"r": true["r"] + 0.02}, "gyro-bias", True, 0.002),
    "hard iron": (
        lambda true: {"psi": true["psi"] + 0.12 * np.cos(true["psi"] - 0.7)},
        "hard-iron",
        False,
        0.02,
    ),
    "knocked compass": (knocked, "heading-offset", False, 0.01),
    "lever arm": (on_a_lever, "lever-arm", False, 0.15),
    "through the water": (through_water, "through-water", False, 0.02),
    "scale of velocity": (scaled(1.15, "u", "v"), "scale", True, 0.03),
    "scale of yaw rate": (scaled(0.85, "r"), "scale", True, 0.01),
    "u astern": (scaled(-1.0, "u"), "sign", True, 0.04),
    "yaw rate to port": (scaled(-1.0, "r"), "sign", True, 0.007),
    "y to the west": (scaled(-1.0, "y"), "axes", True, 0.12),
    "yaw rate in deg/s": (scaled(180 / np.pi, "r"), "unit", True, 0.3),
    "velocity in knots": (scaled(3600 / 1852, "u", "v"), "unit", True, 0.03),
    "earth axes": (earth_axes, "axes", True, 0.05),
    "x and y": (lambda true: {"x": true["y"], "y": true["x"]}, "swapped-channels", True, 0.12),
    "u and v": (lambda true: {"u": true["v"], "v": true["u"]}, "swapped-channels", True, 0.1),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_was_injected_is_taken_out(name):
    change, kind, by_mapping, near = FAULTS[name]
    shape = "circle" if kind == "hard-iron" else "random"
    options = {"noise": 0.5, "commanded": {}}
    sound = recording(shape, 1, **options)
    done = repair(recording(shape, 1, change, **options))
    assert [step.finding.kind for step in done.applied] == [kind]
    assert done.applied[0].in_mapping is by_mapping
    assert done.left == ()
    for channel in CHANNELS:
        rest = getattr(done.run, channel) - getattr(sound, channel)
        # The noise came after the fault, so it is what the other channel's or sign's was.
        assert np.sqrt(np.nanmean(rest**2)) < near, channel
    assert any(note.startswith(f"repaired {kind}") for note in done.run.provenance)


@pytest.mark.parametrize("channels, delay", [(("x", "y"), 0.8), (("u", "v"), 1.0), (("r",), 0.5)])
def test_late_channels_go_back_to_where_they_belong(channels, delay):
    sound = recording("random", 1, noise=0.2)
    late = recording("random", 1, noise=0.2, late=dict.fromkeys(channels, delay))
    done = repair(late)
    assert [step.finding.kind for step in done.applied] == ["sensor-latency"]
    assert done.left == ()
    assert all(done.mapping.channels[c].delay == pytest.approx(delay, abs=0.06) for c in channels)
    t, true, _ = motion("random", 1)
    for channel in channels:
        truth = np.interp(sound.t, t, true[channel])
        wrong = np.sqrt(np.nanmean((getattr(late, channel) - truth) ** 2))
        rest = np.sqrt(np.nanmean((getattr(done.run, channel) - truth) ** 2))
        own = np.sqrt(np.nanmean((getattr(sound, channel) - truth) ** 2))
        assert rest < 1.3 * own + 0.1 * wrong


def test_a_clock_that_drifts_is_rescaled():
    late = dict.fromkeys(("x", "y"), lambda time: 0.012 * time)
    done = repair(recording("random", 1, noise=0.3, dt=0.1, late=late))
    assert "clock-drift" in [step.finding.kind for step in done.applied]
    assert not any(step.in_mapping for step in done.applied if step.finding.kind == "clock-drift")
    assert {finding.kind for finding in done.left} <= {"gap"}  # what lies beyond the end is unknown
    t, true, _ = motion("random", 1)
    assert np.nanmax(np.abs(done.run.x - np.interp(done.run.t, t, true["x"]))) < 0.5


def test_wild_and_frozen_samples_are_emptied():
    run = recording("random", 6)
    wild, frozen = run.x.copy(), run.psi.copy()
    wild[[50, 51, 200, 333, 410]] += 4000
    frozen[250:310] = frozen[250]
    done = repair(edited(run, x=wild, psi=frozen))
    assert {step.finding.kind for step in done.applied} == {"outliers", "stuck"}
    assert {finding.kind for finding in done.left} == {"gap"}
    assert np.all(np.isnan(done.run.x[[50, 51, 200, 333, 410]]))
    kept = np.isfinite(done.run.x)
    assert np.sum(~kept) == 5 and np.array_equal(done.run.x[kept], run.x[kept])
    assert np.all(np.isnan(done.run.psi[251:309])) and np.isfinite(done.run.psi[249])


def test_actuators_are_put_right():
    run = recording("zigzag", 1)
    ordered = run.commanded
    faulty = {
        "rudder": ordered["rudder"],
        "port": ordered["starboard"],
        "starboard": ordered["port"],
    }
    done = repair(edited(run, commanded=faulty))
    assert [step.finding.kind for step in done.applied] == ["swapped-actuators"]
    assert np.array_equal(done.run.commanded["port"], ordered["port"])
    done = repair(edited(run, commanded={"rudder": -ordered["rudder"]}))
    assert [step.finding.kind for step in done.applied] == ["sign"]
    assert np.array_equal(done.run.commanded["rudder"], ordered["rudder"])
    assert done.mapping.channels["cmd_rudder"].gain == -1
    jumping = {"rudder": ordered["rudder"]}
    done = repair(edited(run, commanded={}, executed=jumping))
    assert [step.finding.kind for step in done.applied] == ["order-not-motion"]
    assert done.run.executed == {} and set(done.run.commanded) == {"rudder"}
    assert "cmd_rudder" in done.mapping.channels and "exec_rudder" not in done.mapping.channels


def test_a_record_in_mirrored_axes_is_turned_back():
    run = recording("zigzag", 1)
    mirrored = {name: -getattr(run, name) for name in ("y", "psi", "v", "r")}
    done = repair(edited(run, **mirrored))
    assert [step.finding.kind for step in done.applied] == ["axes"]
    assert done.left == ()
    assert np.allclose(done.run.psi, run.psi) and np.allclose(done.run.y, run.y)


def test_rounded_time_stamps_become_even():
    t, true, orders = motion("zigzag", 1)
    run = sampled(t, true, orders, 1, dt=0.26)
    stamps = np.round(run.t, 1)
    assert np.ptp(np.diff(stamps)) > 0.05
    done = repair(edited(run, t=stamps))
    assert [step.finding.kind for step in done.applied] == ["time-step"]
    assert np.max(np.abs(done.run.t - run.t)) < 0.05
    assert done.mapping.time_step == pytest.approx(0.26, abs=1e-4)


def test_repeated_stamps_lose_their_repetitions():
    run = recording("zigzag", 1)
    time = run.t.copy()
    time[[100, 200, 300]] = time[[99, 199, 299]]
    done = repair(edited(run, t=time))
    assert [step.finding.kind for step in done.applied] == ["duplicate"]
    assert done.run.t.size == run.t.size - 3 and np.all(np.diff(done.run.t) > 0)
    assert done.run.x[99] == run.x[100]


def test_several_faults_are_put_right_in_turn():
    def change(true):
        return {"psi": -true["psi"] - 0.2, "r": np.degrees(true["r"] + 0.02)}

    run = recording("random", 1, change, noise=0.3, late={"x": 0.8, "y": 0.8}, commanded={})
    done = repair(run)
    assert done.left == ()
    kinds = [step.finding.kind for step in done.applied]
    assert {"unit", "sensor-latency", "heading-offset", "gyro-bias"} <= set(kinds)
    assert kinds.index("unit") < kinds.index("sensor-latency") < kinds.index("heading-offset")
    sound = recording("random", 1, noise=0.3, commanded={})
    assert np.sqrt(np.nanmean((done.run.psi - sound.psi) ** 2)) < 0.01


def test_a_repair_is_said_in_the_units_and_signs_of_the_mapping(tmp_path):
    """The row that the audit prints, put into the mapping, leaves nothing to find."""
    run = recording("random", 1, lambda true: {"r": true["r"] + 0.02, "psi": true["psi"] + 0.2})
    table = pd.DataFrame({name: getattr(run, name) for name in ("t", *CHANNELS)})
    table["psi"], table["r"] = np.degrees(table["psi"]), -60 * np.degrees(table["r"])
    table.to_csv(tmp_path / "run.csv", index=False)
    rows = {name: f'{name} = "{name}"' for name in ("t", *CHANNELS)}
    rows["psi"] = 'psi = { column = "psi", unit = "deg", offset = 3.0 }'
    rows["r"] = 'r = { column = "r", unit = "deg/min", sign = -1 }'
    mapping = tmp_path / "boat.toml"
    mapping.write_text("\n".join(["[columns]", *rows.values()]))
    for _ in range(2):
        for finding in diffsea.audit(tmp_path / "run.csv", mapping):
            row = finding.repair.removesuffix(" in the mapping")
            rows[row.partition(" = ")[0]] = row
        mapping.write_text("\n".join(["[columns]", *rows.values()]))
    assert 'unit = "deg", offset = ' in rows["psi"]
    assert 'unit = "deg/min", sign = -1.0, offset = ' in rows["r"]
    assert list(diffsea.audit(tmp_path / "run.csv", mapping)) == []


def test_sound_recordings_stay_as_they_are():
    run = recording("random", 3)
    done = repair(run)
    assert done.steps == () and done.run is run


def test_which_of_two_is_late_is_left_open():
    """Everything but the positions is late, or the positions are stamped early."""
    late = dict.fromkeys(("u", "v", "psi", "r"), 0.8)
    run = recording("random", 1, late=late, noise=0.3)
    done = repair(run)
    assert done.run is run and done.applied == ()
    (step,) = done.steps
    assert step.outcome == "left" and step.finding.kind == "sensor-latency"
    assert "position may be stamped too early" in step.reason


def test_what_has_no_repair_is_left_and_said():
    run = recording("zigzag", 1, dt=0.1, noise=0.2)
    done = repair(edited(run, psi=0.05 * np.round(run.psi / 0.05)))
    assert [(step.outcome, step.finding.kind) for step in done.steps] == [("left", "quantised")]


MISLED = {
    "the wrong way": lambda edit: dataclasses.replace(edit, offset=-edit.offset),
    "the wrong channel": lambda edit: Affine(("r",), -1.0),
}


@pytest.mark.parametrize("name", MISLED)
def test_a_repair_that_does_not_help_is_undone(name, monkeypatch):
    """A larger offset, or a coarser fault in place of the offset."""

    def misled(run):
        return [
            dataclasses.replace(f, edits=tuple(map(MISLED[name], f.edits)))
            if f.kind == "heading-offset"
            else dataclasses.replace(f, edits=())
            for f in audit(run)
        ]

    monkeypatch.setattr("diffsea.recordings.auditing.repair.audit", misled)
    run = recording("random", 1, lambda true: {"psi": true["psi"] + 0.2})
    done = repair(run)
    assert done.run is run
    assert [step.outcome for step in done.steps] == ["undone"]
    assert "no better" in done.steps[0].reason


@pytest.mark.parametrize("name", ["heading offset", "hard iron", "through the water", "earth axes"])
def test_repairing_twice_changes_nothing(name, tmp_path):
    change, kind, *_ = FAULTS[name]
    shape = "circle" if kind == "hard-iron" else "random"
    first = repair(recording(shape, 1, change, noise=0.5))
    write_recording(first.run, tmp_path / "a.csv")
    again = repair(read_recording(tmp_path / "a.csv"))
    assert again.applied == ()
    for channel in CHANNELS:
        assert np.array_equal(getattr(again.run, channel), getattr(first.run, channel), True)


def test_the_repaired_mapping_reads_what_was_repaired(tmp_path):
    """A foreign file with a wrong label, offset and delay, read again through the new mapping."""
    late = {"x": 0.8, "y": 0.8}
    run = recording("random", 1, lambda true: {"psi": true["psi"] + 0.2}, noise=0.3, late=late)
    table = [run.t, run.x, run.y, np.degrees(run.psi), run.u, run.v, -np.degrees(run.r)]
    header = "time,north,east,yaw,surge,sway,rate"
    np.savetxt(tmp_path / "a.csv", np.column_stack(table), delimiter=",", header=header,
               comments="", fmt="%.17g")  # fmt: skip
    labels = {"t": "time", "x": "north", "y": "east", "u": "surge", "v": "sway"}
    columns = {channel: Column(name) for channel, name in labels.items()}
    columns |= {"psi": Column("yaw", unit="deg"), "r": Column("rate", unit="deg/s")}
    mapping = Mapping(columns)
    done = repair(read_recording(tmp_path / "a.csv", mapping), mapping)
    kinds = {step.finding.kind for step in done.applied}
    assert kinds == {"sign", "sensor-latency", "heading-offset"} and done.left == ()
    (tmp_path / "m.toml").write_text(mapping_text(done.mapping, ["a note"]))
    again = read_recording(tmp_path / "a.csv", read_mapping(tmp_path / "m.toml"))
    for channel in CHANNELS:
        difference = getattr(again, channel) - getattr(done.run, channel)
        turns = 2 * np.pi * np.round(np.nanmean(difference) / (2 * np.pi))
        assert np.nanmax(np.abs(difference - turns)) < 1e-9, channel


def test_an_enu_mapping_is_said_in_ned():
    columns = {name: Column(name) for name in ("t", "x", "y", "psi")}
    run = recording("random", 1)
    done = repair(run, Mapping(columns, frame="ENU", origin=(1.0, 0.1), delimiter=";"))
    text = tomllib.loads(mapping_text(done.mapping))
    assert text["columns"]["x"]["column"] == "y" and "frame" not in text["file"]
    assert text["file"]["origin"] == pytest.approx(np.degrees([1.0, 0.1]).tolist())
    assert text["file"]["delimiter"] == ";"


def test_the_command_writes_recording_mapping_and_account(tmp_path, capsys):
    run = recording("random", 1, lambda true: {"psi": true["psi"] + 0.2}, noise=0.5)
    source, out = tmp_path / "a.csv", tmp_path / "out"
    write_recording(run, source)
    before = source.read_bytes()
    assert main(["audit", str(source), "--repair", "-o", str(out), "--json"]) == 0
    assert [item["kind"] for item in json.loads(capsys.readouterr().out)] == ["heading-offset"]
    assert source.read_bytes() == before
    (account,) = json.loads((out / "repairs.json").read_text())
    assert account["repaired"] == "a.repaired.csv" and account["left"] == []
    assert account["steps"][0]["outcome"] == "applied" and account["steps"][0]["in_mapping"]
    repaired = read_recording(out / "a.repaired.csv")
    mapped = read_recording(source, out / "repaired_mapping.toml")
    assert np.allclose(repaired.psi, mapped.psi)
    assert audit(repaired) == []
    assert main(["audit", str(out / "a.repaired.csv"), "--repair", "-o", str(tmp_path / "b")]) == 0
    twice = (tmp_path / "b" / "a.repaired.repaired.csv").read_bytes()
    assert twice == (out / "a.repaired.csv").read_bytes()


def test_the_command_never_writes_over_a_recording(tmp_path, capsys):
    run = recording("random", 1)
    for name in ("a.csv", "a.repaired.csv"):
        write_recording(run, tmp_path / name)
    paths = [str(tmp_path / "a.csv"), str(tmp_path / "a.repaired.csv")]
    assert main(["audit", *paths, "--repair", "-o", str(tmp_path)]) == 1
    assert "written over a recording" in capsys.readouterr().err
    assert not (tmp_path / "repairs.json").exists()


def test_an_order_that_a_mapping_holds_constant_stays_so():
    """Where a file has the order already, what is called executed is left out; a mapping, too."""
    columns = {name: Column(name) for name in ("t", "x", "exec_rudder")}
    mapping = Mapping(columns, constants={"cmd_rudder": 0.1})
    amended = ExecutedToCommanded("rudder").amend_mapping(mapping)
    assert amended is not None
    text = tomllib.loads(mapping_text(amended))
    assert text["columns"]["cmd_rudder"] == {"constant": 0.1}
    assert "exec_rudder" not in text["columns"]
