"""Vessels drawn from above."""

import tomllib
from importlib.resources import files

from diffsea.cli import main
from diffsea.cli.vessels.outline import outline
from diffsea.vessel.files import build, read_vessel, shipped_vessels


def document():
    text = (files("diffsea.vessel.data") / "shioji_maru.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def test_actuators_sit_where_the_file_says():
    lines = outline(build(document())).splitlines()
    middle = next(line for line in lines if "P" in line)
    # 48 characters stand for 54 m; the first is the stern.
    assert {sign: middle.index(sign) for sign in "RP"} == {"R": 0, "P": 2}
    assert [k for k, sign in enumerate(middle) if sign == "T"] == [8, 43]
    assert middle.endswith(">") and len(middle) == 49
    assert lines[0] == "shioji_maru: 54 m long, 11.1 m wide; bow to the right, starboard below"
    assert "  R rudder: 27 m aft of amidships" in lines
    assert "  T bow, tunnel thruster: 21 m forward of amidships" in lines


def test_starboard_is_below_and_the_beam_is_drawn():
    lines = outline(read_vessel("otter").vessel).splitlines()
    drawn = lines[1:-2]
    # A character is twice as tall as wide: 1.08 m of 2 m are 26 characters, or 13 rows.
    assert len(drawn) == 13
    assert [row for row, line in enumerate(drawn) if line[2:3] == ">"] == [1, 11]
    assert [line.strip()[:6] for line in lines[-2:]] == ["> port", "> star"]


def test_what_sits_outside_of_the_hull_is_drawn_there():
    ship = document()
    ship["rudder"][0]["x"], ship["tunnel_thruster"][0]["x"] = -33.0, 40.0
    ship["propeller"][0]["y"] = 9.0
    lines = outline(build(ship)).splitlines()
    middle = next(line for line in lines if line.startswith("R"))
    assert middle.index("|") == 5 and middle.endswith("T") and middle.rindex("T") > 5 + 48
    (below,) = [line for line in lines if line.strip() == "P"]
    assert lines.index(below) > max(k for k, line in enumerate(lines) if "+-" in line)


def test_the_command_draws_all_or_one(tmp_path, capsys):
    assert main(["vessels", "--draw"]) == 0
    told = capsys.readouterr().out
    assert all(f"{name}: " in told for name in shipped_vessels())
    assert "its place is not in the file" in told  # of the Mariner's rudder
    assert main(["vessels", "--draw", "pytheas"]) == 0
    assert capsys.readouterr().out.count("m wide") == 1
    boat = (files("diffsea.vessel.data") / "otter.toml").read_text(encoding="utf-8")
    (tmp_path / "boat.toml").write_text(boat)
    assert main(["vessels", "--draw", str(tmp_path / "boat.toml")]) == 0
    assert capsys.readouterr().out.startswith("otter: 2 m long")
    assert main(["vessels", "--draw", "oter"]) == 1
    assert "no such vessel file" in capsys.readouterr().err
