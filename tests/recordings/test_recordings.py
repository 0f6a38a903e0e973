"""Reading, writing and conditioning of recordings; messages for what cannot be read."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from tests.paths import DATA, ROOT

from diffsea import (
    Trajectory,
    UserError,
    cut,
    read_mapping,
    read_recording,
    resample,
    write_recording,
)
from diffsea.recordings import to_frame
from diffsea.recordings.auditing.mapping_rows import mapping_text
from diffsea.recordings.tables import read_table


OVER_GROUND = """[file]
velocity_axes = 'earth'
[columns]
t = 't'
psi = 'p'
u = { column = 's', course = 'c' }
v = { column = 's', course = 'c' }
"""


MAPPED = [
    ("blueboat", "fixed_00000224.csv"),
    ("esso_osaka", "recordings/zigzag_31-Jul-2020_13_04_24.csv"),
    ("kvlcc2_hsva", "HSVA_CPMC_KVLCC2_Z_20_05.dat"),
    ("kcs_marin", "SIMMAN2020_container_KCS_MARIN_zigzag_port_20_FS.txt"),
]

NATIVE = "t,x,psi,r,cmd_rudder\n0,1.5,3.1,0.1,0.2\n0.5,2.5,-3.1,0.1,0.2\n1.0,3.5,-3.0,0.1,-0.2\n"
MAPPING = """
format = 1
[columns]
t = { column = "time", unit = "ms" }
psi = { column = "yaw", unit = "deg" }
"""


@pytest.fixture
def place(tmp_path):
    """A function that writes a file and returns its path."""

    def write(text, name="run.csv"):
        path = tmp_path / name
        path.write_bytes(text) if isinstance(text, bytes) else path.write_text(text)
        return path

    return write


def some_run(**channels):
    time = np.arange(6) * 0.5
    blank = np.full(6, np.nan)
    motion = {name: channels.get(name, blank) for name in ("x", "y", "psi", "u", "v", "r")}
    return Trajectory(
        t=channels.get("t", time),
        **motion,
        commanded={"rudder": np.array([0.1, 0.2, 0.2, -0.3, -0.3, 1 / 3])},
        executed={"rudder": np.linspace(0, 0.3, 6)},
        extra={"wind_speed": np.full(6, 4.0), "wind_direction": np.array([6.2, 0.1] * 3)},
        valid=np.ones(6, dtype=bool),
    )


def test_a_pulse_width_is_not_turned_into_seconds(tmp_path):
    file = tmp_path / "m.toml"
    file.write_text('[columns]\nu = "u"\ncmd_port = { column = "c1", unit = "us" }\n')
    with pytest.raises(UserError, match="would turn pulse widths into seconds"):
        read_mapping(file)


def test_native_file_is_read_with_heading_unwrapped(place):
    run = read_recording(place(NATIVE))
    assert run.name == "run.csv"
    np.testing.assert_array_equal(run.t, [0, 0.5, 1.0])
    np.testing.assert_allclose(run.psi, [3.1, 2 * np.pi - 3.1, 2 * np.pi - 3.0])
    np.testing.assert_array_equal(run.commanded["rudder"], [0.2, 0.2, -0.2])
    assert run.has("x") and not run.has("y") and not run.executed
    assert "sha256" in run.provenance[0]


def test_heading_unwraps_through_missing_samples(place):
    run = read_recording(place("t,psi\n0,3.1\n1,\n2,-3.1\n3,-3.0\n"))
    np.testing.assert_allclose(run.psi, [3.1, np.nan, 2 * np.pi - 3.1, 2 * np.pi - 3.0])


def test_heading_in_degrees_is_not_garbled_by_unwrapping(place):
    run = read_recording(
        place("t,psi\n" + "".join(f"{i},{(350 + 4 * i) % 360}\n" for i in range(9)))
    )
    np.testing.assert_allclose(np.diff(run.psi), 4.0)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_writing_and_reading_again_loses_nothing(tmp_path, suffix):
    run = some_run(x=np.array([1 / 3, np.nan, 1e-17, 2.0, 3.0, 4.0]), psi=np.linspace(0, 9, 6))
    path = tmp_path / "new folder" / f"run{suffix}"
    write_recording(run, path)
    again = read_recording(path)
    for name in ("t", "x", "psi"):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))
    np.testing.assert_array_equal(again.commanded["rudder"], run.commanded["rudder"])
    np.testing.assert_array_equal(again.executed["rudder"], run.executed["rudder"])
    np.testing.assert_array_equal(again.extra["wind_direction"], run.extra["wind_direction"])
    assert not again.has("u")
    assert [item.name for item in path.parent.iterdir()] == [path.name]


def test_rows_that_do_not_count_are_not_written(tmp_path):
    valid = np.array([True, True, True, False, True, False])
    run = dataclasses.replace(some_run(x=np.arange(6.0)), valid=valid)
    write_recording(run, tmp_path / "run.csv")
    np.testing.assert_array_equal(read_recording(tmp_path / "run.csv").x, [0, 1, 2, 4])


def test_mapping_converts_units_signs_and_offsets(place):
    mapping = place(
        """
        [columns]
        t = { column = "time", unit = "ms" }
        psi = { column = "yaw", unit = "deg", sign = -1, offset = -90 }
        u = { column = "speed", unit = "kn" }
        x = { column = "north", unit = "ft" }
        cmd_propeller = { column = "rpm", unit = "rpm" }
        cmd_port = { column = "pwm", scale = 0.5, offset = -750, unit = "kN" }
        """,
        "map.toml",
    )
    text = "time,yaw,speed,north,rpm,pwm,note\n1000,30,10,10,120,1502,7\n2000,40,10,10,120,1502,7\n"
    run = read_recording(place(text), mapping)
    np.testing.assert_allclose(run.t, [1, 2])
    np.testing.assert_allclose(run.psi, np.radians([60, 50]))  # ENU heading to NED heading
    np.testing.assert_allclose(run.u, 10 * 1852 / 3600)
    np.testing.assert_allclose(run.x, 3.048)
    np.testing.assert_allclose(run.commanded["propeller"], 2.0)
    np.testing.assert_allclose(run.commanded["port"], 1000.0)
    assert "through mapping map.toml" in run.provenance
    assert "columns not used: note" in run.provenance


def test_whitespace_columns_below_a_header_without_names(place):
    mapping = place(
        """
        [file]
        delimiter = "whitespace"
        header_lines = 2
        encoding = "cp1252"
        columns = ["time", "x", "empty", "empty2"]
        [columns]
        t = "time"
        x = "x"
        """,
        "map.toml",
    )
    text = "Z10\xb0\nmore\n   .0   1.0  9 9\n   .5  -2.0  9 9\n".encode("cp1252")
    np.testing.assert_array_equal(read_recording(place(text, "a.dat"), mapping).x, [1, -2])


def test_names_are_found_above_a_line_of_units(place):
    mapping = place(
        '[file]\ndelimiter = "whitespace"\nheader_lines = 2\n[columns]\nt = "time"\nx = "x0G"\n',
        "map.toml",
    )
    run = read_recording(place("time  x0G\n(s)  (m)\n0 1\n1 2\n"), mapping)
    np.testing.assert_array_equal(run.x, [1, 2])


def test_time_step_stands_in_for_a_time_column(place):
    mapping = place("[file]\ntime_step = 0.2\n[columns]\nx = 'x'\n", "map.toml")
    np.testing.assert_allclose(read_recording(place("x\n1\n2\n3\n"), mapping).t, [0, 0.2, 0.4])


def test_decimal_commas_and_trailing_delimiters(place):
    mapping = place(
        '[file]\ndelimiter = ";"\ndecimal = ","\n[columns]\nt = "t"\nx = "x"\n', "map.toml"
    )
    run = read_recording(place("t;x\n0,5;1,25;\n1,0;2,5;\n"), mapping)
    np.testing.assert_array_equal(run.x, [1.25, 2.5])


def test_a_delimiter_within_quotes_parts_no_names(place):
    """Every column after `Supply, V` would be read as its neighbour."""
    table = place('t,"Supply, V", "x" ,y,"rudder (deg, + port)"\n0,12.1,1,2,3\n1,12.2,4,5,6\n')
    run = read_recording(table)
    np.testing.assert_array_equal(run.x, [1, 4])
    np.testing.assert_array_equal(run.y, [2, 5])
    mapping = '[columns]\nt = "t"\nx = "y"\ncmd_rudder = { column = "rudder (deg, + port)" }\n'
    mapped = read_recording(table, place(mapping, "map.toml"))
    np.testing.assert_array_equal(mapped.x, [2, 5])
    np.testing.assert_array_equal(mapped.commanded["rudder"], [3, 6])
    with pytest.raises(UserError, match="line that begins 't,\"xx.* cannot be read"):
        read_recording(place(f't,"{"x" * 200_000}",x\n0,1,2\n'))


def test_commands_hold_through_empty_cells_and_are_unknown_before_the_first(place):
    run = read_recording(place("t,x,cmd_a,cmd_b\n0,1,,\n1,1,2,\n2,1,,\n3,1,5,\n"))
    np.testing.assert_array_equal(run.commanded["a"], [np.nan, 2, 2, 5])
    assert set(run.commanded) == {"a"}
    assert "cmd_a is unknown before t = 1 s" in run.provenance
    assert "cmd_a: 1 empty cells hold the value before" in run.provenance
    assert "cmd_b has no value and is left out" in run.provenance


def test_a_clock_with_an_epoch_counts_from_the_start_of_the_run(place):
    run = read_recording(place("t,x\n1700000000.25,1\n1700000000.5,2\n1700000001.25,3\n"))
    np.testing.assert_allclose(run.t, [0.25, 0.5, 1.25], atol=1e-6)
    assert any("1700000000 s" in note for note in run.provenance)
    long = read_recording(place("t,x\n86400.25,1\n86400.5,2\n86401.25,3\n"))
    assert long.t[0] == 86400.25


def test_rows_of_one_time_stamp_become_one(place):
    """Sensors that write rows of their own, and an order that changes at an instant."""
    run = read_recording(
        place("t,x,psi,cmd_a\n0,1,,5\n0,,0.2,\n1,2,,5\n1,2,,7\n1,,0.3,\n2,3,0.4,\n")
    )
    np.testing.assert_array_equal(run.t, [0, 1, 2])
    np.testing.assert_array_equal(run.x, [1, 2, 3])
    np.testing.assert_allclose(run.psi, [0.2, 0.3, 0.4])
    np.testing.assert_array_equal(run.commanded["a"], [5, 7, 7])


def test_empty_rows_and_repeated_stamps_are_dropped_and_noted(place):
    run = read_recording(place("t,x\n0,1\n,\n1,2\n1,3\n2,4\n"))
    np.testing.assert_array_equal(run.t, [0, 1, 2])
    np.testing.assert_array_equal(run.x, [1, 3, 4])
    assert any("dropped empty rows: 1, first in line 3" in note for note in run.provenance)
    assert any("repeats the row before: 1 of 4" in note for note in run.provenance)


def test_what_was_dropped_is_known_whatever_the_notes_say(place, monkeypatch):
    monkeypatch.setattr("diffsea.recordings.readers.EMPTY_ROWS", "nothing stood in")
    monkeypatch.setattr("diffsea.recordings.readers.REPEATED_TIMES", "the clock stood still for")
    read = read_recording(place("t,x\n0,1\n,\n1,2\n1,3\n1,4\n2,4\n")).read
    assert read.empty_rows is not None and read.empty_rows.note is not None
    assert read.empty_rows.count == 1 and "first in line 3" in read.empty_rows.note
    assert [merged.count for merged in read.repeated_times] == [2]
    clean = read_recording(place("t,x\n0,1\n1,2\n")).read
    assert clean.empty_rows is None and clean.repeated_times == ()


def test_a_data_frame_is_read_as_a_file_would_be(place):
    path = place(NATIVE)
    run, table = read_recording(path), pd.read_csv(path)
    for frame in (table, table.set_index("t")):
        again = read_recording(frame)
        assert again.name == "<DataFrame>" and "<DataFrame>" in again.provenance[0]
        pd.testing.assert_frame_equal(to_frame(again), to_frame(run))
    foreign = pd.DataFrame({"time": [0, 500, 1000], "yaw": [10.0, 20.0, 30.0]})
    run = read_recording(foreign, place(MAPPING, "map.toml"))
    np.testing.assert_allclose(run.t, [0, 0.5, 1])
    np.testing.assert_allclose(run.psi, np.radians([10, 20, 30]))


def test_a_recording_is_a_data_frame_of_the_rows_that_count():
    valid = np.array([True, True, True, False, True, False])
    frame = to_frame(dataclasses.replace(some_run(x=np.arange(6.0)), valid=valid))
    names = "t x cmd_rudder exec_rudder wind_speed wind_direction"
    assert list(frame.columns) == names.split()
    np.testing.assert_array_equal(frame["x"], [0, 1, 2, 4])


@pytest.mark.parametrize(
    "columns, message",
    [
        ({"time": [0, 1], "x": [1, 2]}, "<DataFrame> has no column 't'.*it has time, x"),
        ({"t": [0, 1], "x": [1, "abc"]}, "<DataFrame>, line 2, column 'x': 'abc' is not"),
        ({"t": [0, 2, 1], "x": [1, 2, 3]}, "<DataFrame>, line 3: time runs backwards"),
        ({"t": [0, 1], "x": [None, None]}, "<DataFrame> has no finite value"),
    ],
)
def test_a_data_frame_that_is_no_recording_is_refused(columns, message):
    with pytest.raises(UserError, match=message):
        read_recording(pd.DataFrame(columns))


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "is empty"),
        ("t,x\n", "0 usable row"),
        ("t,x\n0,1\n", "1 usable row"),
        (b"\x00\x01\x02PK", "is not text"),
        ("t,x\n0,1\xe4\n".encode("cp1252"), "not utf-8 text.*encoding.*cp1252"),
        ("time,x\n0,1\n1,2\n", "no column 't'.*it has time, x.*mapping"),
        ("t,lat\n0,1\n1,2\n", "no motion channel.*it has t, lat"),
        ("t,x\n0,\n1,\n", "no finite value"),
        ("t,x\n0,1\n1,abc\n", "line 3, column 'x': 'abc' is not a number"),
        ("t,x\n0,1\n1,inf\n", "line 3, column 'x': the value is infinite"),
        ("t,x\n0,1\n2,1\n1,1\n", "line 4: time runs backwards, from 2 s to 1 s"),
        ("t,x\n0,1\n,2\n2,3\n", "line 3: the time is missing.*time_step"),
        ("t,x,x\n0,1,2\n1,2,3\n", "the column 'x' appears twice"),
        ("t,x\n0,1\n1,2,3,4\n", "cannot be read as a table.*line 3"),
        ("t,x,psi\n0,1,2,3\n1,2,3,4\n", "line 2: 4 values, and 3 names above"),
    ],
)
def test_unreadable_files_are_refused_with_place_and_repair(place, text, message):
    with pytest.raises(UserError, match=message):
        read_recording(place(text))


def test_a_delimiter_at_the_end_of_every_row_is_no_value(place):
    run = read_recording(place("t,x,psi\n0,1,2,\n1,2,3,\n2,3,3,\n"))
    np.testing.assert_array_equal(run.psi, [2.0, 3.0, 3.0])


def test_missing_files_and_folders_are_named(tmp_path, place):
    place(NATIVE, "zigzag.csv")
    with pytest.raises(UserError, match="no recording.*did you mean 'zigzag.csv'"):
        read_recording(tmp_path / "zigzg.csv")
    with pytest.raises(UserError, match="is a folder"):
        read_recording(tmp_path)
    with pytest.raises(UserError, match="cannot be read as Parquet"):
        read_recording(place("no parquet", "a.parquet"))
    with pytest.raises(UserError, match="must end in .csv or .parquet"):
        write_recording(some_run(), tmp_path / "a.txt")


@pytest.mark.parametrize(
    "text, message",
    [
        ("x = ", "not valid TOML"),
        ("format = 2\n", "format = 2 is unknown"),
        ("[colums]\nt = 't'\n", "unknown key 'colums'.*did you mean 'columns'"),
        ("[file]\ndelimeter = ','\n", r"\[file\] unknown key.*did you mean 'delimiter'"),
        ("[columns]\nx = 'x'\n", "no channel t.*time_step"),
        ("[columns]\nt = 't'\nphsi = 'yaw'\n", "phsi is no channel.*did you mean"),
        ("[columns]\nt = 't'\npsi = { column = 'y', unit = 'degg' }\n", "'degg'.*mean 'deg'"),
        ("[columns]\nt = 't'\npsi = { column = 'y', unit = 'm' }\n", "not a unit of angle.*deg"),
        ("[columns]\nt = 't'\nx = { column = 'y', sign = 2 }\n", "sign must be 1 or -1"),
        ("[columns]\nt = 't'\nx = { column = 'y', scale = 'a' }\n", "scale must be a finite"),
        ("[columns]\nt = 't'\nx = { colum = 'y' }\n", "must be a column's name or a table"),
        ("[columns]\nt = 't'\nx = { column = 'y', unt = 'm' }\n", "unknown key 'unt'"),
        ("[file]\ntime_step = 0\n[columns]\nx = 'x'\n", "time_step must be above zero"),
        ("[file]\ntime_step = 1\n[columns]\nt = 't'\n", "either time_step or a column for t"),
        ("[file]\ncolumns = ['a', 'a']\n[columns]\nt = 'a'\n", "the name 'a' twice"),
        ("[file]\nheader_lines = -1\n[columns]\nt = 'a'\n", "header_lines must be a whole"),
        ("columns = 3\n", "columns must be a table"),
        ("[columns]\nt = { column = 't', delay = 1 }\n", "time itself cannot be delayed"),
        (
            "[columns]\nt = 't'\npsi = { column = 's', cosine = 'c', unit = 'deg' }\n",
            "cosine is the name of a column.*in rad",
        ),
        (
            "[columns]\nt = 't'\nx = { column = 's', cosine = 'c' }\n",
            "cosine is the name of a column.*of an angle",
        ),
        (
            "[columns]\nt = 't'\nx = { column = 's', course = 'c' }\n",
            "course is the name of a column in deg.*for u and v",
        ),
        (
            OVER_GROUND.replace("v = { column = 's', course = 'c' }", "v = 's'"),
            "the same column, unit and course",
        ),
        (
            OVER_GROUND.replace("v = { column = 's',", "v = { column = 's', unit = 'kn',"),
            "the same column, unit and course",
        ),
        (
            OVER_GROUND.replace("course = 'c'", "course = 'c', course_unit = 'kn'"),
            'course_unit is that of a course, "deg" or "rad"',
        ),
        ("[columns]\nt = 't'\nu = { column = 's', course_unit = 'deg' }\n", "that of a course"),
        (OVER_GROUND.replace("'earth'", "'body'"), 'velocity_axes = "earth"'),
        (OVER_GROUND.replace("[col", "frame = 'ENU'\n[col"), "a course is clockwise from north"),
        ("[columns]\nt = 't'\nu = { constant = 1 }\n", "u: only orders, actuation, wind"),
        ("[columns]\nt = 't'\ncmd_a = { constant = 'fast' }\n", "constant must be a finite"),
        ("[columns]\nt = 't'\ncmd_a = { constant = 1, sign = 1 }\n", "unknown key 'sign'"),
        (
            "[columns]\nt = 't'\nwind_speed = { constant = 1, unit = 'deg' }\n",
            "not a unit of speed",
        ),
        (
            "[file]\nframe = 'ENU'\n[columns]\nt = 't'\nwind_direction = { constant = 1 }\n",
            "counts from north",
        ),
        ("[file]\nvelocity_axes = 'enu'\n[columns]\nt = 't'\n", '"body" or "earth", got'),
        ("[file]\nvelocity_axes = 'earth'\n[columns]\nt = 't'\n", "need the channels psi, u"),
    ],
)
def test_wrong_mappings_are_refused_with_the_key(place, text, message):
    with pytest.raises(UserError, match=message):
        read_mapping(place(text, "map.toml"))


def test_what_never_changed_is_said_by_the_mapping(place):
    """An engine's order that nobody logged, and a wind from the notebook."""
    rows = "[columns]\nt = 'time'\nx = 'x'\ncmd_propeller = { constant = 600, unit = 'rpm' }\n"
    rows += "wind_direction = { constant = 90, unit = 'deg' }\n"
    mapping = read_mapping(place(rows, "map.toml"))
    run = read_recording(place("time,x\n0,1\n1,2\n2,4\n"), mapping, start=0.5)
    assert list(run.t) == [1, 2]
    assert list(run.commanded["propeller"]) == pytest.approx([10, 10])
    assert list(run.extra["wind_direction"]) == pytest.approx([np.pi / 2] * 2)
    assert "cmd_propeller is 10 throughout, as map.toml says" in run.provenance
    assert read_mapping(place(mapping_text(mapping), "map.toml")) == mapping


def test_mapping_that_does_not_fit_the_file(place):
    with pytest.raises(UserError, match="no column 'yaw'.*maps to psi.*did you mean 'yaw_'"):
        read_recording(place("time,yaw_\n1,2\n3,4\n"), place(MAPPING, "map.toml"))
    odd = place('[file]\nencoding = "klingon"\n[columns]\nt = "t"\n', "odd.toml")
    with pytest.raises(UserError, match="'klingon' is not known"):
        read_recording(place(NATIVE), odd)


def test_dates_of_a_parquet_file_are_a_clock_in_seconds(place, tmp_path):
    stamps = pd.Timestamp("2024-05-12T23:59:59") + pd.to_timedelta([0.0, 0.5, 1.5], unit="s")
    pd.DataFrame({"when": stamps, "x": [1.0, 2.0, 3.0]}).to_parquet(tmp_path / "a.parquet")
    plain = place('[columns]\nt = "when"\nx = "x"\n', "plain.toml")
    t = np.asarray(read_recording(tmp_path / "a.parquet", plain).t)
    np.testing.assert_allclose(t - t[0], [0.0, 0.5, 1.5], atol=1e-6)
    in_ns = place('[columns]\nt = { column = "when", unit = "ns" }\nx = "x"\n', "ns.toml")
    with pytest.raises(UserError, match="'when' has stamps.*leave unit = 'ns' out"):
        read_recording(tmp_path / "a.parquet", in_ns)


def test_an_angle_is_read_from_its_sine_and_cosine(place):
    mapping = place(
        '[columns]\nt = "t"\npsi = { column = "s", cosine = "c", sign = -1, offset = 0.5 }\n',
        "map.toml",
    )
    table = place("t,s,c\n0,0.0,2.0\n1,1.0,0.0\n2,0.0,-1.0\n")
    psi = read_recording(table, mapping).psi
    np.testing.assert_allclose(psi, -(np.array([0.0, 0.5, 1.0]) * np.pi + 0.5))
    with pytest.raises(UserError, match="no column 'c'.*maps to psi"):
        read_recording(place("t,s\n0,0.0\n1,1.0\n"), mapping)


def test_a_velocity_is_read_from_its_speed_and_course(place):
    mapping = place(OVER_GROUND.replace("'c'", "'c', unit = 'kn'"), "map.toml")
    run = read_recording(place("t,p,s,c\n0,0.0,2.0,0\n1,0.5,2.0,90\n2,0.0,3.0,225\n"), mapping)
    north = np.array([2.0, 0.0, -3.0 / np.sqrt(2)]) * 1852 / 3600
    east = np.array([0.0, 2.0, -3.0 / np.sqrt(2)]) * 1852 / 3600
    turned = (north + 1j * east) * np.exp(-1j * np.array([0.0, 0.5, 0.0]))
    np.testing.assert_allclose(run.u + 1j * run.v, turned, atol=1e-12)


@pytest.fixture
def held() -> pd.DataFrame:
    """A receiver of 2 Hz in rows of 10 Hz, on its way north: what is held would turn in between."""
    rng = np.random.default_rng(0)
    t, fixes = 0.1 * np.arange(600), np.repeat(np.arange(120), 5)
    speed, course = 1.5 + 0.1 * rng.standard_normal(120), 20 * np.sin(0.1 * np.arange(120)) + 40
    east = np.where(np.arange(120) < 60, 3.0, 3.0 + 0.01 * rng.standard_normal(120))
    return pd.DataFrame({
        "t": t, "p": 0.3 * np.sin(0.3 * t), "s": speed[fixes], "c": course[fixes],
        "x": np.cumsum(speed)[fixes], "y": east[fixes],
    })  # fmt: skip


def test_what_a_slower_sensor_holds_counts_where_it_is_new(place, held):
    mapping = OVER_GROUND + "x = 'x'\ny = 'y'\n"
    run = read_recording(place(held.to_csv(index=False)), place(mapping, "map.toml"))
    for channel in ("x", "y", "u", "v"):
        known = np.isfinite(getattr(run, channel))
        assert np.flatnonzero(known).tolist() == list(range(0, 600, 5)), channel
    assert np.isfinite(run.psi).all()
    told = [note for note in run.provenance if "held between samples" in note]
    assert told == [
        f"{names} held between samples: new in 120 of 600 rows, empty in the others"
        for names in ("x, y", "u, v")
    ]


def test_what_is_coarse_or_stands_is_not_held(held):
    """Rounded to a tenth, a value stays for some rows; and a vessel may lie still."""
    t = held["t"].to_numpy()
    coarse = np.round(2.0 * np.sin(0.05 * t), 1)
    still = np.where(t < 30.0, 0.0, 0.01 * np.sin(t))
    run = read_recording(held.assign(u=coarse, v=0.0, psi=still)[["t", "u", "v", "psi"]])
    assert np.isfinite([run.u, run.v, run.psi]).all()


def test_mapping_repairs_late_channels_and_earth_axes(place):
    mapping = place(
        """
        [file]
        velocity_axes = "earth"
        [columns]
        t = "t"
        x = { column = "x", delay = 1.5 }
        psi = "psi"
        u = "vn"
        v = "ve"
        cmd_a = { column = "a", delay = -1 }
        """,
        "map.toml",
    )
    rows = "".join(f"{i},{i * i},1.5,0.3,-0.7,{i}\n" for i in range(5))
    run = read_recording(place("t,x,psi,vn,ve,a\n" + rows), mapping)
    np.testing.assert_allclose(run.x, [2.5, 6.5, 12.5, np.nan, np.nan])
    np.testing.assert_array_equal(run.commanded["a"], [np.nan, 0, 1, 2, 3])
    np.testing.assert_allclose(run.u, 0.3 * np.cos(1.5) - 0.7 * np.sin(1.5))
    np.testing.assert_allclose(run.v, -0.7 * np.cos(1.5) - 0.3 * np.sin(1.5))
    assert "x shifted by -1.5 s" in run.provenance


def test_lists_and_structures_of_a_parquet_file_are_no_columns(tmp_path, place):
    path, t = tmp_path / "nested.parquet", np.arange(5.0)
    nested = {"list": [[1.0, 2.0]] * 5, "structure": [{"a": 1.0}] * 5, "text": ["a"] * 5}
    pd.DataFrame({"t": t, "x": t, "y": t} | nested).to_parquet(path)
    run = read_recording(path)
    np.testing.assert_array_equal(run.x, t)
    assert list(read_table(path, None).table.columns) == ["t", "x", "y", "text"]
    with pytest.raises(UserError, match="'list'"):
        read_recording(path, place('[columns]\nt = "t"\nx = "list"', "map.toml"))


def test_parquet_goes_through_mappings_too(tmp_path, place):
    path = tmp_path / "run.parquet"
    pd.DataFrame({"time": [0.0, 500.0], "yaw": [10.0, 20.0]}).to_parquet(path)
    run = read_recording(path, place(MAPPING, "map.toml"))
    np.testing.assert_allclose(run.t, [0, 0.5])
    np.testing.assert_allclose(run.psi, np.radians([10, 20]))


@pytest.mark.parametrize("folder, name", MAPPED)
def test_published_recordings_are_read_through_their_mappings(tmp_path, folder, name):
    if not (DATA / folder / name).exists():
        pytest.skip(f"{DATA / folder} is absent: the published recordings stay outside")
    run = read_recording(DATA / folder / name, ROOT / "experiments" / folder / "mapping.toml")
    assert all(run.has(channel) for channel in ("x", "y", "psi", "u", "v", "r"))
    assert np.all(np.diff(run.t) > 0) and run.t.size > 400
    assert np.max(np.abs(np.diff(run.psi))) < 0.5
    write_recording(run, tmp_path / "run.parquet")
    np.testing.assert_array_equal(read_recording(tmp_path / "run.parquet").v, run.v)


def test_recordings_are_read_and_audited_without_what_takes_long_to_start(place, tmp_path):
    """A subprocess, for this one has imported all of it."""
    rows = "".join(f"{k / 4},{k / 2},0,0,2,0,0\n" for k in range(80))
    path = place("t,x,y,psi,u,v,r\n" + rows)
    code = f"""if True:
        import sys, diffsea.recordings
        slow = {{"jax", "equinox", "matplotlib", "scipy.stats", "scipy.signal", "scipy.io"}}
        read = sorted(slow & set(sys.modules))
        import diffsea
        diffsea.audit({str(path)!r})
        print(read, sorted({{"jax", "equinox", "matplotlib"}} & set(sys.modules)))
    """
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[] []"


def test_cutting_keeps_time_and_says_so():
    run = some_run(x=np.arange(6.0))
    piece = cut(run, 0.5, 1.6)
    np.testing.assert_array_equal(piece.t, [0.5, 1.0, 1.5])
    np.testing.assert_array_equal(piece.commanded["rudder"], [0.2, 0.2, -0.3])
    assert "cut to t = 0.5 s ... 1.6 s" in piece.provenance
    with pytest.raises(UserError, match="has 0 samples from 7 s to 8 s; it runs from 0 s to 2.5"):
        cut(run, 7, 8)


def test_resampling_straight_lines_is_exact_and_commands_hold():
    time = np.array([0.0, 0.4, 1.1, 1.5, 2.0, 2.7])
    run = some_run(t=time, x=3 + 2 * time)
    new = resample(run, 0.25)
    np.testing.assert_allclose(new.t, np.arange(11) * 0.25)
    np.testing.assert_allclose(new.x, 3 + 2 * new.t)
    old = run.commanded["rudder"]
    np.testing.assert_array_equal(new.commanded["rudder"], old[[0, 0, 1, 1, 1, 2, 3, 3, 4, 4, 4]])
    assert not new.has("y") and "resampled to 0.25 s" in new.provenance


def test_resampling_leaves_gaps_and_never_extrapolates():
    x = np.array([np.nan, 1.0, 2.0, np.nan, np.nan, 5.0])
    new = resample(some_run(x=x), 0.25, max_gap=0.5)
    expected = np.full(11, np.nan)
    expected[[2, 3, 4, 10]] = [1.0, 1.5, 2.0, 5.0]
    np.testing.assert_allclose(new.x, expected)


def test_coarsening_averages_noise_away():
    rng = np.random.default_rng(1)
    time = 1.7e9 + np.arange(4001) * 0.01
    blank = np.full(time.size, np.nan)
    noisy = 0.3 * (time - time[0]) + rng.standard_normal(time.size)
    run = dataclasses.replace(
        some_run(),
        t=time,
        x=noisy,
        y=blank,
        psi=blank,
        u=blank,
        v=blank,
        r=blank,
        commanded={},
        executed={},
        extra={},
        valid=np.ones(time.size, dtype=bool),
    )
    new = resample(run, 1.0)
    rest = new.x - 0.3 * (new.t - time[0])
    # The two at the ends are one-sided fits: a line through half as many samples.
    assert np.std(rest[1:-1]) == pytest.approx(1 / np.sqrt(101), rel=0.4)
    assert np.all(np.abs(rest) < 0.5)


@pytest.mark.parametrize("channel", ["wind_direction", "apparent_wind_angle"])
def test_the_angle_of_a_wind_is_averaged_on_the_circle(channel):
    run = some_run(x=np.arange(6.0))
    run = dataclasses.replace(run, extra={channel: run.extra["wind_direction"]})
    new = resample(run, 1.0)
    assert np.all((new.extra[channel] < 0.3) | (new.extra[channel] > 6.0))


def test_resampling_refuses_senseless_intervals():
    with pytest.raises(UserError, match="above zero seconds"):
        resample(some_run(), 0.0)
    with pytest.raises(UserError, match="too short for an interval of 10 s"):
        resample(some_run(), 10.0)


def test_numbers_that_no_quantity_has_are_missing_samples(tmp_path):
    path = tmp_path / "sentinels.csv"
    path.write_text("t,x,u,cmd_rudder\n0,0,1,0\n1,1e308,1,-1.7e308\n2,2,1e99,1\n3,3,1,1\n")
    run = read_recording(path)
    assert np.flatnonzero(np.isnan(run.x)).tolist() == [1] and run.u[2] == 1e99
    assert run.commanded["rudder"].tolist() == [0, 0, 1, 1]
    assert "x: 1 values beyond 1e+100 are missing samples" in run.provenance


def test_names_of_columns_are_cut_in_messages(tmp_path):
    path = tmp_path / "wide.csv"
    names = ["a" * 5000, "", *(f"c{k}" for k in range(98))]
    path.write_text(",".join(names) + "\n" + ",".join("0" for _ in names) + "\n")
    with pytest.raises(UserError) as raised:
        read_recording(path)
    told = str(raised.value)
    assert f"it has {'a' * 40}..., (no name), c0, " in told
    assert " and 60 more" in told and len(told) < 600
