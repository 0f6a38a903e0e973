"""The commands that `diffsea check` ends with: that they fit the boat, and can be run."""

import argparse
import pathlib
import shlex
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diffsea.cli import main
from diffsea.cli.check import _said_once
from diffsea.cli.following import commands_after_diagnosis, following_commands
from diffsea.recordings.mapping_proposal import suggest_labels
from diffsea.vessel.files import read_vessel


NO_SPAN = argparse.Namespace(start=None, end=None)
NUMBERS = {"--length M": "--length 6", "--beam M": "--beam 2", "--mass KG": "--mass 900"}
NUMBERS |= {"--thrusters M": "--thrusters 1", "UNIT": "percent", "=X": "=-1.5"}


def log(orders, unit="us", source="column 8", form="csv") -> Any:
    """As much of a check as the commands are made from."""
    commanded = {name: np.array([0.0, 2.3417, -1.0]) for name in orders}
    scales = {name: SimpleNamespace(unit=unit) for name in orders if name != "rudder"}
    channel = SimpleNamespace(unit="", source=source)
    channels = {f"cmd_{name}": channel for name in orders}
    run = SimpleNamespace(commanded=commanded, executed={})
    return SimpleNamespace(run=run, scales=scales, channels=channels, log=form)


@pytest.mark.parametrize(
    "orders, unit, source",
    [
        (("port", "starboard"), "us", "C1"),
        (("port", "starboard"), "own", "left_force"),
        (("port", "starboard"), "own", "thr_left"),
        (("port", "starboard"), "normalised", "thr_left"),
        (("rudder", "motor"), "us", "C1"),
        (("rudder", "propeller"), "own", "rpm"),
        (("rudder",), "own", "helm"),
        (("fore.force", "fore.angle", "aft.force", "aft.angle"), "own", "rpm"),
        (("pod.force", "pod.angle"), "own", "power"),
    ],
)
def test_the_vessel_that_is_proposed_takes_the_orders_of_the_log(orders, unit, source, tmp_path):
    new, *_, diagnose = following_commands(
        NO_SPAN, [(pathlib.Path("a b.csv"), log(orders, unit, source))], {}
    )
    assert shlex.split(diagnose) == ["diffsea", "diagnose", "boat.toml", "a b.csv"]
    for letters, number in NUMBERS.items():
        new = new.replace(letters, number)
    words = shlex.split(new)
    boat = tmp_path / "boat.toml"
    assert main([words[1], str(boat), *words[3:]]) == 0
    units = read_vessel(boat).vessel.units
    assert set(orders) <= set(units)
    wanted = {"us": "us", "normalised": "normalised", "own": "percent"}[unit]
    wanted = "N" if source == "left_force" else wanted
    wanted = "rpm" if "fore.force" in orders else wanted
    assert {units[name] for name in orders} - {"rad", "rev/s"} <= {wanted}


def test_orders_that_are_called_per_cent_are_ordered_in_it():
    for source, unit in (
        ("thr_pct", "percent"),
        ("/left [%]", "percent"),
        ("throttle_percent", "percent"),
        ("thr_left", "UNIT"),
    ):
        twin = log(("port", "starboard"), "own", source)
        new, _ = following_commands(NO_SPAN, [(pathlib.Path("a.csv"), twin)], {})
        assert new.endswith(f"--thrusters M --unit {unit}")
    assert suggest_labels("throttle_percent").best == "propeller"  # by a share of its power


@pytest.mark.parametrize("full, unit", [(1.0, "UNIT"), (100.0, "percent"), (400.0, "UNIT")])
def test_a_throttle_of_up_to_a_hundred_is_in_per_cent_and_may_be_an_outboard(full, unit):
    boat = log(("rudder", "motor"), "own", "throttle_order")
    boat.run.commanded["motor"] = full * np.array([0.0, 1.0, -0.5])
    new, outboard, _ = following_commands(NO_SPAN, [(pathlib.Path("a.csv"), boat)], {})
    assert new.endswith(f"--rudder --unit {unit}")
    assert "--azimuth outboard=X" in outboard


def test_the_ship_that_is_proposed_takes_the_largest_order(tmp_path):
    new, _ = following_commands(
        NO_SPAN, [(pathlib.Path("a.csv"), log(("rudder", "propeller"), "own"))], {}
    )
    assert new.endswith("--hull ship --shaft-speed 2.35")
    words = shlex.split(new.replace("M ", "60 ", 1).replace("M ", "11 ", 1).replace("KG", "1.1e6"))
    boat = tmp_path / "ship.toml"
    assert main([words[1], str(boat), *words[3:]]) == 0
    assert read_vessel(boat).vessel.servos["propeller"].upper == pytest.approx(2.35)


def test_logs_of_a_boat_whose_shaft_turned_at_other_speeds_are_of_one_boat():
    """The boat that is proposed has a shaft as fast as in any of them."""
    slow, fast = (log(("rudder", "propeller"), "own") for _ in range(2))
    fast.run.commanded["propeller"] = 2.0 * fast.run.commanded["propeller"]
    logs = [(pathlib.Path("a.csv"), slow), (pathlib.Path("b.csv"), fast)]
    mapping = pathlib.Path("ship.mapping.toml")
    new, diagnose = following_commands(NO_SPAN, logs, dict.fromkeys(dict(logs), mapping))
    assert new.endswith("--hull ship --shaft-speed 4.69") and "a.csv b.csv" in diagnose


def test_a_boat_that_no_drive_fits_is_left_alone():
    checked = [(pathlib.Path("a.csv"), log(("thrust", "rudder")))]
    assert following_commands(NO_SPAN, checked, {}) == []


def test_logs_of_one_boat_through_one_mapping_go_into_one_command():
    args = argparse.Namespace(start=None, end=None)
    paths = [pathlib.Path(name) for name in ("a.bin", "b.bin")]
    twin, mapping = log(("port", "starboard"), form="ardupilot-bin"), pathlib.Path("boat.toml")
    checked = [(path, twin) for path in paths]
    _, diagnose = following_commands(args, checked, dict.fromkeys(paths, mapping))
    assert diagnose == "diffsea diagnose boat.toml a.bin b.bin --mapping boat.toml"


def test_span_mapping_and_log_are_passed_on_and_boats_told_apart():
    args = argparse.Namespace(start=5.0, end=100.0)
    paths = [pathlib.Path(name) for name in ("a.bin", "b.csv", "c.csv")]
    twin, ship = log(("port", "starboard"), form="ardupilot-bin"), log(("rudder", "propeller"))
    mapping = pathlib.Path("out/b.mapping.toml")
    checked = list(zip(paths, (twin, ship, ship), strict=True))
    found = following_commands(args, checked, dict.fromkeys(paths[1:], mapping))
    assert found[0].endswith("--thrusters M --log a.bin")
    assert found[1] == "diffsea diagnose boat.toml a.bin --start 5 --end 100"
    assert found[2].startswith("diffsea new boat2.toml ")
    end = "b.csv c.csv --mapping out/b.mapping.toml --start 5 --end 100"
    assert found[3:] == [f"diffsea diagnose boat2.toml {end}"]


def test_what_may_have_changed_in_one_recording_is_asked_of_all_on_one_clock():
    runs = [pathlib.Path("run1.csv"), pathlib.Path("run2.csv")]
    args = argparse.Namespace(recordings=runs, test=[], one_after_another=False)
    there = {"recording": "run2.csv", "in_regime": False}
    nothing = {"effects": [], "audit": [], "verdict": "unexplained"}

    def told(*where, in_order=False, verdict="unexplained", **other):
        given = argparse.Namespace(**vars(args) | other)
        record = nothing | {"where": where, "verdict": verdict}
        return " ".join(commands_after_diagnosis(given, pathlib.Path("out"), record, in_order))

    assert "--one-after-another" in told(there) and "run2.csv" in told(there)
    assert "--one-after-another" in told({"recording": "all", "in_regime": True})
    assert told(there, verdict="consistent") == ""
    assert told(there, in_order=True) == "" and told(there, recordings=runs[:1]) == ""


def test_what_holds_of_every_log_is_said_once_after_them():
    """Not of those that could not be read; what all show together is not said again."""
    logs = [
        ["a.csv: twin", "10 s", "gap: x", "no wind"],
        ["b.csv: twin", "20 s", "no wind", "gap: x"],
    ]
    broken = ["c.csv: not read: empty"]
    own = [["a.csv: twin", "10 s"], ["b.csv: twin", "20 s"], broken]
    together = ["a.csv, b.csv together:", "no wind"]
    assert _said_once([*logs, broken], together) == [*own, [*together, "gap: x"]]
    unlike = [["a.csv: twin", "10 s"], ["b.csv: ship", "20 s"]]
    assert _said_once(unlike, ["a.csv, b.csv, each of them:"]) == [*unlike, []]
