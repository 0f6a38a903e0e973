"""Mappings proposed for foreign files: disguised clean runs, layouts, names, and real data."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from tests.disguises import Disguise, choose, disguise, judged
from tests.oracle.make_recordings import load, produce
from tests.paths import DATA, EXPERIMENTS, ORACLE

from diffsea import UserError, propose_mapping, read_mapping, read_recording
from diffsea.cli import main
from diffsea.recordings.mapping_proposal import SURE, is_foreign, suggest_labels
from diffsea.recordings.mapping_proposal import proposal as proposal_module
from diffsea.recordings.mapping_proposal.table_layout import sniff_layout


pytestmark = pytest.mark.slow


MOTION = {"t", "x", "y", "psi", "u", "v", "r"}
PLAIN = Disguise(
    style="letters",
    frame="ned",
    earth=False,
    stated=False,
    masked=False,
    heading="deg",
    rate="deg/s",
    speed="m/s",
    time="ms",
    geographic=False,
    layout="csv",
    reversed_rudder=False,
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Noisy runs, as tables, of a vessel that no threshold was chosen on."""
    folder = tmp_path_factory.mktemp("runs")
    names = ["random-fast", "zigzag-fast", "circle-slow"]
    produce(folder, load(ORACLE / "boat.toml"), 11, seconds=70.0, rate=4.0, runs=names)
    return {name: pd.read_csv(folder / f"{name}.csv") for name in names}


def recovered(native, how, folder, seed=0):
    """What a proposal makes of a run in disguise: channels right or wrong, and how sure."""
    path, written = folder / "foreign.csv", folder / "foreign.mapping.toml"
    disguise(native, how, np.random.default_rng(seed), path)
    proposal = propose_mapping(path)
    written.write_text(proposal.text, encoding="utf-8")
    alias = {"latitude": "x", "longitude": "y"}
    sure = {
        alias.get(name, name).removeprefix("cmd_").removeprefix("exec_"): value
        for name, value in proposal.sure.items()
    }
    return judged(native, path, written), sure


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"frame": "port sway"},
        {"frame": "east first", "heading": "deg 360"},
        {"frame": "enu", "style": "ros", "heading": "rad", "rate": "rad/s"},
        {"earth": True, "style": "surveyor"},
        {"style": "surveyor", "geographic": True, "speed": "kn"},
        {"rate": "deg/min", "speed": "kn", "time": "us"},
        {"speed": "km/h", "time": "epoch", "stated": True},
        {"layout": "comma decimals", "style": "german"},
        {"layout": "blanks", "style": "snake"},
        {"layout": "preamble", "style": "words"},
        {"layout": "units below", "stated": True},
        {"layout": "tab", "style": "ros"},
    ],
    ids=str,
)
def test_a_disguised_run_is_recovered(change, runs, tmp_path):
    right, _ = recovered(runs["zigzag-fast"], dataclasses.replace(PLAIN, **change), tmp_path)
    assert {name for name, fine in right.items() if not fine} == set()


def test_columns_without_names_are_found_by_kinematics(runs, tmp_path):
    how = dataclasses.replace(PLAIN, layout="bare", time="s")
    right, sure = recovered(runs["zigzag-fast"], how, tmp_path)
    # Sway of this craft is hardly more than noise: nothing but its name would tell it.
    assert all(right[channel] for channel in MOTION - {"v"})
    assert min(sure[channel] for channel in ("t", "psi", "r")) > 0.5


@pytest.mark.proof
def test_most_random_disguises_are_seen_through(runs, tmp_path):
    """Over 12 random disguises; `sure` must be right nearly always, but not be all there is."""
    whole, claims = [], []
    tables = list(runs.values())
    for seed in range(12):
        rng = np.random.default_rng(5000 + seed)
        right, sure = recovered(tables[seed % 3], choose(rng), tmp_path, seed)
        whole.append(all(right[channel] for channel in MOTION))
        claims += [(value, right.get(name, False)) for name, value in sure.items()]
    called = [fine for value, fine in claims if value >= SURE]
    others = [fine for value, fine in claims if value < SURE]
    print(f"motion right {np.mean(whole):.2f}; sure {np.mean(called):.3f} of {len(called)}")
    assert np.mean(whole) > 0.75
    assert len(called) > 0.5 * len(claims)
    assert np.mean(called) > 0.94
    assert np.mean(others) < np.mean(called)


def test_a_mirrored_record_is_not_called_sure_without_a_witness(runs, tmp_path):
    """Without actuators nothing tells starboard from port, and names of letters do not either."""
    native = runs["zigzag-fast"].drop(columns=["cmd_port", "cmd_starboard"])
    _, sure = recovered(native, dataclasses.replace(PLAIN, heading="rad"), tmp_path)
    assert max(sure[channel] for channel in ("y", "psi", "v", "r")) < SURE
    _, sure = recovered(runs["zigzag-fast"], dataclasses.replace(PLAIN, heading="rad"), tmp_path)
    assert min(sure[channel] for channel in ("psi", "r")) > SURE


def test_contradicting_names_give_way_to_kinematics(runs, tmp_path):
    """Columns labelled the wrong way round: yaw rate as heading, and x as y."""
    native = runs["random-fast"]
    table = native.rename(columns={"x": "y", "y": "x", "psi": "r", "r": "psi", "t": "time"})
    table.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "a.toml").write_text(propose_mapping(tmp_path / "a.csv").text)
    mapping = read_mapping(tmp_path / "a.toml")
    assert mapping.channels["psi"].column == "r" and mapping.channels["r"].column == "psi"
    right = judged(native, tmp_path / "a.csv", mapping)
    assert all(right[channel] for channel in MOTION)


def test_what_is_called_another_quantity_gives_way_to_what_is_called_this_one(runs, tmp_path):
    """Of two columns that heading follows, the better is called the derivative of sway."""
    native, rng = runs["zigzag-fast"], np.random.default_rng(2)
    scale = native["r"].std()
    table = native.rename(columns={"t": "time", "psi": "yaw", "u": "surge", "v": "sway"})
    worse = native["r"].ewm(span=6).mean() + 0.5 * scale * rng.normal(size=len(native))
    table = table.assign(sway_dot=3.67 * native["r"], yaw_rate=worse).drop(columns="r")
    table.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "a.toml").write_text(propose_mapping(tmp_path / "a.csv").text)
    assert read_mapping(tmp_path / "a.toml").channels["r"].column == "yaw_rate"


def test_what_is_improbable_is_written_as_a_comment(runs, tmp_path):
    """Heading follows a column whose numbers are none of a yaw rate; that called one is stuck."""
    native = runs["zigzag-fast"]
    table = native.rename(columns={"t": "time", "psi": "yaw", "u": "surge", "v": "sway"})
    table = table.assign(sway_dot=3.67 * native["r"], yaw_rate=0.0).drop(columns="r")
    table.to_csv(tmp_path / "a.csv", index=False)
    proposal = propose_mapping(tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text(proposal.text)
    assert "r" not in read_mapping(tmp_path / "a.toml").channels and "r" not in proposal.sure
    assert '\n# r = "yaw_rate"\n' in proposal.text
    said = proposal.text.replace("\n# ", " ")
    assert (
        'r is not written: "sway_dot" is it with a probability of 0.00, below 0.1; the name' in said
    )
    assert any(check.startswith("r is not written") for check in proposal.checks)


def test_a_position_is_written_whole_or_not_at_all(runs, tmp_path, monkeypatch):
    table = runs["zigzag-fast"].rename(columns={"t": "time"})
    table.to_csv(tmp_path / "a.csv", index=False)
    sure = propose_mapping(tmp_path / "a.csv").sure
    between = 0.5 * (sure["x"] + sure["y"])
    assert sure["x"] != sure["y"]
    monkeypatch.setattr(proposal_module, "WRITTEN", between)
    (tmp_path / "a.toml").write_text(propose_mapping(tmp_path / "a.csv").text)
    assert not {"x", "y"} & set(read_mapping(tmp_path / "a.toml").channels)


def test_actuation_and_batteries_are_no_velocity_where_none_was_logged(runs, tmp_path):
    """GPS, compass and motors: something always rises as the boat moves ahead."""
    for number, (port, starboard) in enumerate(
        [("pwm_left_us", "pwm_right_us"), ("thr_left", "thr_right"), ("port [%]", "starboard [%]")]
    ):
        native = runs["zigzag-fast"]
        columns = {"time_s": native["t"], "North": native["x"], "East": native["y"]}
        columns |= {"compass_deg": np.degrees(native["psi"]) % 360, "gyro z": native["r"]}
        full = max(native["cmd_port"].abs().max(), native["cmd_starboard"].abs().max())
        scale, offset = (400.0, 1500.0) if "us" in port else (100.0, 0.0)
        columns |= {port: offset + scale * native["cmd_port"] / full}
        columns |= {starboard: offset + scale * native["cmd_starboard"] / full}
        columns["batt_V"] = 12.6 - 0.001 * np.arange(len(native)) - 1e-4 * columns[port]
        path = tmp_path / f"boat{number}.csv"
        pd.DataFrame(columns).to_csv(path, index=False)
        proposal = propose_mapping(path)
        channels = proposal.mapping.channels
        assert {"x", "y", "psi", "r", "cmd_port", "cmd_starboard"} <= channels.keys()
        assert not {"u", "v"} & channels.keys()
        assert [channels[name].column for name in "xy"] == ["North", "East"]
        assert channels["cmd_port"].unit is None


def test_orders_are_told_from_what_was_realised(runs, tmp_path):
    table = runs["random-fast"].rename(columns={"t": "time"})
    smooth = table["cmd_port"].ewm(span=12).mean()
    table = table.rename(columns={"cmd_port": "left_rpm", "cmd_starboard": "right_rpm"})
    table["left_rpm"] = smooth
    table.to_csv(tmp_path / "a.csv", index=False)
    sure = propose_mapping(tmp_path / "a.csv").sure
    assert "exec_port" in sure and "cmd_starboard" in sure


def test_a_rudder_that_turns_to_port_is_given_a_sign(tmp_path):
    native = rudder_run()
    for sign in (1, -1):
        table = native.assign(cmd_rudder=sign * np.degrees(native["cmd_rudder"]))
        table = table.rename(columns={"t": "time", "psi": "heading", "cmd_rudder": "helm"})
        table.to_csv(tmp_path / "a.csv", index=False)
        (tmp_path / "a.toml").write_text(propose_mapping(tmp_path / "a.csv").text)
        rudder = read_mapping(tmp_path / "a.toml").channels["cmd_rudder"]
        assert (rudder.column, rudder.unit, rudder.sign) == ("helm", "deg", sign)


def test_of_columns_without_names_the_rudder_is_what_yaw_follows(tmp_path):
    """A ship rolls as she turns; what she pushes against follows her yaw rate, too."""
    native, rng = rudder_run(), np.random.default_rng(4)
    following = {name: native["r"].ewm(span=span).mean() for name, span in (("a", 3), ("b", 9))}
    noise = rng.normal(size=(2, len(native)))
    roll = -0.5 * following["a"] + 0.002 * noise[0]
    torque = 3 + 0.4 * following["b"].abs() + 0.02 * noise[1]
    table = native.assign(roll=roll, torque=torque, rudder=-np.degrees(native["cmd_rudder"]))
    table = table[["t", "x", "y", "psi", "u", "v", "r", "roll", "rudder", "torque"]]
    path = tmp_path / "a.txt"
    table.to_csv(path, index=False, header=False, sep=" ")
    proposal = propose_mapping(path)
    (tmp_path / "a.toml").write_text(proposal.text)
    found = read_mapping(tmp_path / "a.toml").channels
    rudder = next(column for name, column in found.items() if name.endswith("rudder"))
    assert (rudder.column, rudder.sign) == ("column 9", -1)
    # A sign without a name says nothing of which way is starboard.
    assert proposal.sure["r"] > 0.7


def test_where_no_rudder_was_logged_none_is_proposed(tmp_path):
    """Roll and sway are reversed in a zig-zag, too, but never stand."""
    native, rng = rudder_run(), np.random.default_rng(4)
    roll = -0.5 * native["r"].ewm(span=3).mean() + 0.002 * rng.normal(size=len(native))
    table = native.assign(roll=roll)[["t", "x", "y", "psi", "u", "v", "r", "roll"]]
    table.to_csv(tmp_path / "a.txt", index=False, header=False, sep=" ")
    assert not [name for name in propose_mapping(tmp_path / "a.txt").sure if "rudder" in name]


def rudder_run():
    """A ship of first order in yaw under steps of the rudder, drifting outwards; exact."""
    t = np.arange(0, 120, 0.25)
    order = np.radians(15) * np.sign(np.sin(2 * np.pi * t / 34 + 0.3))
    r = np.zeros_like(t)
    for i in range(t.size - 1):
        r[i + 1] = r[i] + 0.25 * (0.12 * order[i] - r[i]) / 4.0
    psi, u, v = 0.4 + np.cumsum(r) * 0.25, 1.5 + 0 * t - 2 * r**2, -1.2 * r
    flow = (u + 1j * v) * np.exp(1j * psi)
    place = np.cumsum(flow) * 0.25
    columns = {"t": t, "x": place.real, "y": place.imag, "psi": psi, "u": u, "v": v, "r": r}
    return pd.DataFrame(columns | {"cmd_rudder": order})


def test_a_file_without_time_gets_its_step_from_kinematics_or_is_asked(runs, tmp_path):
    native = runs["random-fast"]
    table = native.drop(columns="t").rename(columns={"psi": "yaw", "r": "yaw_rate [rad/s]"})
    table.to_csv(tmp_path / "a.csv", index=False)
    proposal = propose_mapping(tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text(proposal.text)
    assert proposal.timed and "time_step" in proposal.checks[0]
    assert read_mapping(tmp_path / "a.toml").time_step == pytest.approx(0.25, rel=0.06)
    table[["yaw", "cmd_port"]].to_csv(tmp_path / "b.csv", index=False)
    proposal = propose_mapping(tmp_path / "b.csv")
    (tmp_path / "b.toml").write_text(proposal.text)
    assert not proposal.timed and "ASK" in proposal.text and "unknown" in proposal.checks[0]
    assert read_mapping(tmp_path / "b.toml").time_step == 1.0


STAMPS = {
    "dates": "%Y-%m-%dT%H:%M:%S.%fZ",
    "days first": "%d/%m/%Y %H:%M:%S.%f",
    "times of day": "%H:%M:%S.%f",
}


@pytest.mark.parametrize("day", ["2024-05-21", "2024-05-12", "2024-04-30"])
@pytest.mark.parametrize("kind", [*STAMPS, "durations"])
def test_stamps_of_text_are_a_clock(kind, day, runs, tmp_path):
    """Over midnight, with steps that are not all alike."""
    native = runs["random-fast"].drop(index=[7, 8, 30])
    since = pd.to_timedelta(native["t"], unit="s")
    if kind == "durations":
        stamps = since.astype(str)  # 0 days 00:00:00.250000
    else:
        stamps = (pd.Timestamp(f"{day}T23:59:30Z") + since).dt.strftime(STAMPS[kind])
    table = native.drop(columns="t").assign(stamp=stamps)
    table.rename(columns={"psi": "yaw"}).to_csv(tmp_path / "a.csv", index=False)
    proposal = propose_mapping(tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text(proposal.text)
    assert proposal.timed and read_mapping(tmp_path / "a.toml").channels["t"].column == "stamp"
    t = np.asarray(read_recording(tmp_path / "a.csv", tmp_path / "a.toml").t)
    np.testing.assert_allclose(np.diff(t), np.diff(native["t"]), atol=1e-5)


def test_a_cell_that_is_no_stamp_is_told(runs, tmp_path):
    native = runs["random-fast"]
    stamps = pd.Timestamp("2024-05-21") + pd.to_timedelta(native["t"], unit="s")
    table = native.assign(t=stamps.astype(str))
    table.loc[3, "t"] = "noon: or so"
    table.to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(UserError, match="'t'"):
        read_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("names", [("sin_psi", "cos_psi"), ("headingSin", "headingCos")])
def test_a_sine_and_a_cosine_are_an_angle(names, runs, tmp_path):
    native = runs["random-fast"]
    sine, cosine = np.sin(native["psi"]), np.cos(native["psi"])
    table = native.drop(columns="psi").assign(**{names[0]: sine, names[1]: cosine})
    table.rename(columns={"t": "time", "x": "north"}).to_csv(tmp_path / "a.csv", index=False)
    proposal = propose_mapping(tmp_path / "a.csv")
    (tmp_path / "a.toml").write_text(proposal.text)
    column = read_mapping(tmp_path / "a.toml").channels["psi"]
    assert column.names == names and proposal.sure["psi"] > 0.95
    assert f"#   {names[1]}" not in proposal.text
    found = np.asarray(read_recording(tmp_path / "a.csv", tmp_path / "a.toml").psi)
    np.testing.assert_allclose(np.exp(1j * (found - native["psi"])), 1.0, atol=1e-9)


def test_only_of_a_heading_sine_and_cosine_are_taken_together(runs, tmp_path):
    native = runs["random-fast"]
    table = native.assign(sin_roll=np.sin(native["r"]), cos_roll=np.cos(native["r"]))
    table.rename(columns={"t": "time", "psi": "yaw"}).to_csv(tmp_path / "a.csv", index=False)
    text = propose_mapping(tmp_path / "a.csv").text
    assert 'psi = "yaw"' in text and "cosine" not in text and "phi =" not in text


def over_ground(native: pd.DataFrame) -> pd.DataFrame:
    """What a receiver of satellites says beside a compass in a current: course and speed."""
    current = 0.4 + 0.5j
    velocity = (native["u"] + 1j * native["v"]) * np.exp(1j * native["psi"]) + current
    native = native.assign(
        x=native["x"] + current.real * native["t"], y=native["y"] + current.imag * native["t"]
    )
    course = np.degrees(np.angle(velocity)) % 360
    heading = np.degrees(native["psi"]) % 360
    table = native.drop(columns=["u", "v", "psi"])
    return table.assign(heading=heading, cog=course, sog=np.abs(velocity))


def test_course_is_no_heading_where_there_is_one(runs, tmp_path):
    table = over_ground(runs["random-fast"])
    for name, kept in (("a.csv", table), ("b.csv", table.drop(columns="heading"))):
        kept.rename(columns={"x": "north", "y": "east"}).to_csv(tmp_path / name, index=False)
    both, alone = (propose_mapping(tmp_path / name) for name in ("a.csv", "b.csv"))
    assert 'psi = { column = "heading"' in both.text and both.sure["psi"] > 0.95
    assert 'psi = { column = "cog"' in alone.text
    assert alone.sure["psi"] == alone.sure["u"] == 0.5
    assert any(line.startswith("psi (cog): nothing better is there") for line in alone.checks)


def test_speed_and_course_over_ground_are_a_velocity_where_there_is_a_heading(runs, tmp_path):
    native = runs["random-fast"]
    table = over_ground(native).rename(columns={"x": "north", "y": "east"})
    table.to_csv(tmp_path / "a.csv", index=False)
    proposal = propose_mapping(tmp_path / "a.csv")
    written = tmp_path / "a.toml"
    written.write_text(proposal.text)
    mapping = read_mapping(written)
    assert mapping.channels["u"].names == mapping.channels["v"].names == ("sog", "cog")
    assert min(proposal.sure[name] for name in "uv") > 0.95
    run = read_recording(tmp_path / "a.csv", mapping)
    through_water = (run.u + 1j * run.v) * np.exp(1j * run.psi) - (0.4 + 0.5j)
    true = (native["u"] + 1j * native["v"]) * np.exp(1j * native["psi"])
    np.testing.assert_allclose(through_water, true, atol=1e-9)


@pytest.mark.parametrize(
    "speed, course, unit",
    [
        ("navigation.speedOverGround", "navigation.courseOverGroundTrue", "rad"),
        ("speed_mps", "course_deg", "deg"), ("GPS_Spd", "GPS_GCrs", "deg"),
    ],
)  # fmt: skip
def test_a_speed_and_its_course_are_told_by_many_names(speed, course, unit, runs, tmp_path):
    native = runs["random-fast"]
    table = over_ground(native).rename(columns={"x": "north", "y": "east"})
    table["cog"] = np.radians(table["cog"]) if unit == "rad" else table["cog"]
    table.rename(columns={"sog": speed, "cog": course}).to_csv(tmp_path / "a.csv", index=False)
    written = tmp_path / "a.toml"
    written.write_text(propose_mapping(tmp_path / "a.csv").text)
    run = read_recording(tmp_path / "a.csv", read_mapping(written))
    through_water = (run.u + 1j * run.v) * np.exp(1j * run.psi) - (0.4 + 0.5j)
    true = (native["u"] + 1j * native["v"]) * np.exp(1j * native["psi"])
    np.testing.assert_allclose(through_water, true, atol=1e-9)


def test_one_side_alone_is_no_thruster(runs, tmp_path):
    """A rudder's sensor on starboard, say, or the motor of a bow thruster."""
    table = runs["random-fast"].drop(columns="cmd_port")
    table.rename(columns={"t": "time", "cmd_starboard": "right"}).to_csv(
        tmp_path / "a.csv", index=False
    )
    sure = propose_mapping(tmp_path / "a.csv").sure
    assert not {name for name in sure if name.endswith(("port", "starboard"))}


def test_velocities_that_are_there_are_better_than_those_over_ground(runs, tmp_path):
    native = runs["random-fast"]
    table = over_ground(native).assign(surge=native["u"], sway=native["v"])
    table.to_csv(tmp_path / "a.csv", index=False)
    text = propose_mapping(tmp_path / "a.csv").text
    assert 'u = "surge"' in text and 'v = "sway"' in text and "course =" not in text


def test_an_order_is_no_heading(runs, tmp_path):
    """An angle that is ordered, and nothing that is called a heading."""
    native = runs["random-fast"]
    table = native.drop(columns=["psi", "r", "v"]).assign(yaw_cmd=native["psi"])
    table.rename(columns={"t": "time"}).to_csv(tmp_path / "a.csv", index=False)
    assert 'psi = "yaw_cmd"' not in propose_mapping(tmp_path / "a.csv").text


@pytest.mark.parametrize("name", ["sog_kn", "Speed over ground", "groundSpeed", "Course [deg]"])
def test_what_is_over_ground_is_told_by_its_name(name):
    assert suggest_labels(name).is_over_ground
    assert not suggest_labels("u over ground").is_over_ground


def test_names_of_logs_are_understood():
    found = {
        "imu:angular_velocity.z": "r",
        "/odom:twist.linear.x": "vx",
        "imu:angular_velocity_x": "p",
        "angular_velocity_y": "other",
        "azimuth_1:azimuth_deg": "other",
        "T_port": "port",
        "Sway velocity": "v",
        "delta_rudder [rad]": "rudder",
        "surge_dot": "other",
        "heading_setpoint": "other",
        "yaw_rate [deg/s]": "r",
        "ruderwinkel": "rudder",
        "gyro.z [m]": "other",
        "HDT_deg": "psi",
        "/helm/throttle_order:data": "propeller",
        "/helm/cmd:throttle": "propeller",
        "helm_throttle": "propeller",
        "/helm/angle:data": "rudder",
        "/left/throttle:data": "port",
    }
    assert {name: suggest_labels(name).best for name in found} == found
    assert suggest_labels("yaw_rate_deg_s").unit == "deg/s"
    assert [suggest_labels(f"{name}_ms").unit for name in ("windspeed", "boat_speed", "delay")] == [
        "m/s", "m/s", "ms"
    ]  # fmt: skip
    assert suggest_labels("torque [Nm]").unit == "?" and suggest_labels("speed (kn)").unit == "kn"
    assert (
        suggest_labels("Eng RPM").best == suggest_labels("Engine speed [rpm]").best == "propeller"
    )
    assert suggest_labels("rudder_cmd").ordered is True
    assert suggest_labels("rudder_actual").ordered is False


def test_the_command_writes_the_mapping_and_audits_through_it(runs, tmp_path, capsys):
    how = dataclasses.replace(PLAIN, style="snake")
    for name in ("random-fast", "zigzag-fast"):
        disguise(runs[name], how, np.random.default_rng(0), tmp_path / f"{name}.csv")
    files = [str(tmp_path / "random-fast.csv"), str(tmp_path / "zigzag-fast.csv")]
    out = tmp_path / "out"
    assert main(["audit", *files, "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert "how sure" in told and f"--mapping {out / 'random-fast.mapping.toml'}" in told
    assert sorted(path.name for path in out.iterdir()) == [
        "audit.html",
        "audit.json",
        "random-fast.mapping.toml",
    ]
    assert json.loads((out / "audit.json").read_text()) == []
    run = read_recording(files[1], out / "random-fast.mapping.toml")
    np.testing.assert_allclose(run.r, runs["zigzag-fast"]["r"], atol=1e-6)
    again = ["audit", *files, "--mapping", str(out / "random-fast.mapping.toml")]
    assert main([*again, "--json", "-o", str(tmp_path / "again")]) == 0
    assert json.loads(capsys.readouterr().out) == []
    assert not (tmp_path / "again" / "random-fast.mapping.toml").exists()


def test_with_json_the_message_goes_elsewhere(runs, tmp_path, capsys):
    table = runs["random-fast"][["psi", "cmd_port"]].rename(columns={"psi": "yaw"})
    table.to_csv(tmp_path / "a.csv", index=False)
    assert main(["audit", str(tmp_path / "a.csv"), "--json", "-o", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    (finding,) = json.loads(printed.out)
    assert finding["kind"] == "time-step" and "not audited" in finding["message"]
    assert "mapping was proposed" in printed.err


def test_a_matlab_file_of_one_clock_is_a_table(runs, tmp_path):
    """Its vectors as columns; what has another length, and what is no vector, stays out."""
    native = runs["random-fast"]
    columns = {name: native[name].to_numpy() for name in native}
    motion = np.stack([columns["x"], columns["y"]], axis=1)
    nav = {"time": columns["t"], "pos": motion, "surge": columns["u"], "sway": columns["v"]}
    nav |= {"heading": np.degrees(columns["psi"]), "yaw_rate": columns["r"][:, None]}
    orders = {name: columns[name] for name in columns if name.startswith("cmd_")}
    savemat(tmp_path / "run.mat", {"nav": nav, **orders, "short": np.arange(7.0), "place": "lake"})
    assert is_foreign(tmp_path / "run.mat")
    proposal = propose_mapping(tmp_path / "run.mat")
    named = {channel: column.column for channel, column in proposal.mapping.channels.items()}
    told = {"t": "nav:time", "x": "nav:pos.0", "y": "nav:pos.1", "psi": "nav:heading",
            "u": "nav:surge", "v": "nav:sway", "r": "nav:yaw_rate"}  # fmt: skip
    assert told.items() <= named.items() and proposal.mapping.channels["psi"].unit == "deg"
    run = read_recording(tmp_path / "run.mat", proposal.mapping)
    np.testing.assert_allclose(run.u, columns["u"])
    np.testing.assert_allclose(np.sin(run.psi - columns["psi"]), 0.0, atol=1e-9)


def test_a_log_whose_topics_have_clocks_of_their_own_is_no_table(tmp_path):
    quick, slow = np.arange(200) * 0.1, np.arange(40) * 0.5
    savemat(tmp_path / "run.mat", {"t": quick, "yaw": np.sin(quick), "fix": {"t": slow, "x": slow}})
    assert sniff_layout(tmp_path / "run.mat").names == ("t", "yaw")


def test_native_files_need_no_proposal(runs, tmp_path):
    runs["random-fast"].to_csv(tmp_path / "native.csv", index=False)
    assert not is_foreign(tmp_path / "native.csv")
    runs["random-fast"].to_csv(tmp_path / "foreign.csv", index=False, sep=";")
    assert is_foreign(tmp_path / "foreign.csv")
    runs["random-fast"].to_parquet(tmp_path / "native.parquet")
    assert not is_foreign(tmp_path / "native.parquet")


def test_files_of_two_layouts_are_refused(runs, tmp_path):
    disguise(runs["random-fast"], PLAIN, np.random.default_rng(0), tmp_path / "a.csv")
    other = dataclasses.replace(PLAIN, style="snake")
    disguise(runs["random-fast"], other, np.random.default_rng(0), tmp_path / "b.csv")
    with pytest.raises(UserError, match="b.csv has other columns"):
        propose_mapping([tmp_path / "a.csv", tmp_path / "b.csv"])
    (tmp_path / "c.csv").write_text("time,a\n0,1\n1,1\n2,1\n")
    with pytest.raises(UserError, match="too few rows"):
        propose_mapping(tmp_path / "c.csv")


REAL = {
    # Files, the mapping they are compared with (latencies are none of a proposal's business),
    # and channels in which the two differ.
    "esso_osaka": ("esso_osaka/recordings/zigzag*.csv", "mapping.toml", set()),
    "kcs_marin": ("kcs_marin/*.txt", "mapping.toml", set()),
    # The propeller turns at a constant speed in a column without a name.
    "kvlcc2_hsva": ("kvlcc2_hsva/*.dat", "mapping_repaired.toml", {"exec_propeller"}),
    "blueboat": ("blueboat/*.csv", "mapping_repaired.toml", set()),
}


@pytest.mark.proof
@pytest.mark.parametrize("name", REAL)
def test_real_recordings(name, tmp_path):
    pattern, reference, differing = REAL[name]
    files = sorted(DATA.glob(pattern))
    if not files:
        pytest.skip(f"no {DATA / pattern}")
    (tmp_path / "proposed.toml").write_text(propose_mapping(files).text, encoding="utf-8")
    known = read_mapping(EXPERIMENTS / name / reference)
    found = read_mapping(tmp_path / "proposed.toml")
    assert found.velocity_axes == known.velocity_axes
    theirs, ours = described(known), described(found)
    wrong = {c for c in {*theirs, *ours} if theirs.get(c) != ours.get(c)}
    assert wrong == differing
    run = read_recording(files[-1], found)
    assert np.all(np.isfinite(run.psi))


def described(mapping):
    """Column (by place, where the mapping lists them), gain and shift of every channel."""
    places = list(mapping.columns or ())
    return {
        channel: (
            places.index(column.column) if places else column.column,
            pytest.approx(column.gain),
            pytest.approx(column.shift),
        )
        for channel, column in mapping.channels.items()
    }


def test_a_number_too_large_to_calculate_with_is_none(tmp_path):
    t = np.arange(0.0, 40.0, 0.5)
    psi = np.sin(0.2 * t)
    x, y = np.cumsum(np.cos(psi)), np.cumsum(np.sin(psi))
    y[20] = -1e308
    file = tmp_path / "log.csv"
    pd.DataFrame({"time": t, "east": y, "north": x, "yaw": psi}).to_csv(file, index=False)
    assert propose_mapping(file).sure.keys() >= {"x", "y", "psi"}


def hobby_log(folder, neutral=1500.0):
    """A boat with a servo and a speed controller, as a small board writes it: lat, lon, pulses."""
    native = rudder_run()
    native.loc[:30, "cmd_rudder"] = 0.0  # as it stands before anybody steers
    t = native["t"].to_numpy()
    speed = np.hypot(native["u"], native["v"])
    course = np.degrees(np.arctan2(np.gradient(native["y"], t), np.gradient(native["x"], t))) % 360
    pulses = neutral + np.round(native["cmd_rudder"] * 400.0 / np.radians(35))
    table = pd.DataFrame({
        "millis": np.round(1000 * (t - t[0])) + 5000,
        "lat": 54.3 + native["x"] / 111_320, "lon": 10.1 + native["y"] / 65_000,
        "gps_speed": speed, "gps_course": course,
        "compass_deg": np.degrees(native["psi"]) % 360, "gyro_z_dps": np.degrees(native["r"]),
        "esc_us": np.where(t < t.mean(), 1640.0, 1700.0), "servo_us": pulses,
    })  # fmt: skip
    table.to_csv(folder / "log.csv", index=False)
    return native


@pytest.mark.parametrize("neutral", [1500.0, 1472.0])
def test_pulses_of_a_servo_are_angles_and_those_of_a_motor_orders(tmp_path, neutral):
    native = hobby_log(tmp_path, neutral)
    proposal = propose_mapping(tmp_path / "log.csv")
    written = tmp_path / "log.mapping.toml"
    written.write_text(proposal.text, encoding="utf-8")
    run = read_recording(tmp_path / "log.csv", read_mapping(written))
    assert set(run.commanded) == {"rudder", "motor"} and not run.executed
    steps = np.radians(35) / 400
    np.testing.assert_allclose(run.commanded["rudder"], native["cmd_rudder"], atol=0.6 * steps)
    assert set(run.commanded["motor"]) == {1640.0, 1700.0}
    assert "35 deg at 400 us" in proposal.text
    np.testing.assert_allclose(run.u, native["u"], atol=0.05)  # its course is that of chords


@pytest.mark.parametrize("name, full, channel", [
    ("throttle_cmd", 1.0, "motor"), ("throttle", 100.0, "motor"), ("motor_cmd", 1.0, "motor"),
    ("motor_cmd", 300.0, "propeller"), ("propeller_cmd", 1.0, "propeller"),
])  # fmt: skip
def test_a_share_of_full_power_drives_a_motor_and_what_revolves_a_propeller(
    name, full, channel, tmp_path
):
    hobby_log(tmp_path)
    table = pd.read_csv(tmp_path / "log.csv")
    table[name] = full * (table.pop("esc_us") - 1500) / 400
    table.to_csv(tmp_path / "log.csv", index=False)
    proposed = propose_mapping(tmp_path / "log.csv").sure
    assert f"cmd_{channel}" in proposed or f"exec_{channel}" in proposed


def test_a_servo_without_a_pulse_is_no_angle(tmp_path):
    hobby_log(tmp_path)
    table = pd.read_csv(tmp_path / "log.csv")
    table.loc[:5, "servo_us"] = 0.0  # before it is armed
    table.to_csv(tmp_path / "log.csv", index=False)
    assert "cmd_rudder" not in propose_mapping(tmp_path / "log.csv").sure


@pytest.mark.parametrize("names, kind", [
    (("left", "right"), "cmd"), (("thrust_port", "thrust_stbd"), "cmd"),
    (("left_rpm", "right_rpm"), "exec"),
])  # fmt: skip
def test_what_moves_gradually_was_realised_where_a_sensor_could_read_it(
    names, kind, runs, tmp_path
):
    table = runs["random-fast"]
    for name, side in zip(names, ("port", "starboard"), strict=True):
        table = table.rename(columns={f"cmd_{side}": name})
        table[name] = table[name].ewm(span=12).mean()
    table.rename(columns={"t": "time"}).to_csv(tmp_path / "a.csv", index=False)
    sure = propose_mapping(tmp_path / "a.csv").sure
    assert {f"{kind}_port", f"{kind}_starboard"} <= set(sure)
