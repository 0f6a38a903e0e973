"""`diffsea new` as a boat's owner meets it."""

import io
import json
import sys
import tomllib

import numpy as np
import pytest
from tests.paths import EXPERIMENTS, ROOT
from tests.recordings import driven_boat
from tests.recordings.driven_boat import drive, noisy
from tests.recordings.test_autopilot_parameters import TWIN, log  # noqa: F401

from diffsea import read_vessel
from diffsea.cli import main
from diffsea.cli.vessels import new
from diffsea.types import State
from diffsea.vessel.estimates import FORMS
from diffsea.vessel.estimates.drives import (
    ASTERN,
    BOAT_RUDDER,
    EXPONENT,
    PROPELLER_SHARE,
    THRUST_UNITS,
)
from diffsea.vessel.estimates.hull import INERTIA_WIDTH
from diffsea.vessel.estimates.outline import GYRATION


AZIMUTH = {"force": "percent", "angle": "rad"}
SIZE = ("--length", "1.4", "--beam", "0.93", "--mass", "22")


@pytest.fixture
def made(tmp_path, monkeypatch, capsys):
    """A function that runs `new boat.toml` with options, and gives the file and what was said."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str, status: int = 0):
        assert main(["new", *map(str, words)]) == status
        return tmp_path / "boat.toml", capsys.readouterr()

    return run


def test_names_written_out_for_the_help_are_the_librarys():
    assert tuple(FORMS) == new.HULLS and new.UNITS == THRUST_UNITS


def test_a_boat_of_length_beam_and_mass_is_a_vessel_with_free_thrust(made):
    path, said = made("boat.toml", *SIZE, "--thrusters", "0.66")
    file = read_vessel(path)
    assert file.vessel.units == {"port": "us", "starboard": "us"}
    assert float(file.vessel.rigid_body.mass) == 22
    assert float(file.vessel.actuators["starboard"].y) == pytest.approx(0.33)
    free = {"X_u", "N_ur", "port.thrust_curve.full_thrust", "port.time_constant"}
    assert free <= set(file.priors)
    assert "draught = 0.0913 m" in said.out and "written: boat.toml" in said.out
    assert said.err == ""


def test_a_file_is_not_written_over_unless_it_is_asked_for(made):
    path, _ = made("boat.toml", *SIZE)
    path.write_text("mine")
    _, said = made("boat.toml", *SIZE, status=1)
    assert "is there already" in said.err and path.read_text() == "mine"
    made("boat.toml", *SIZE, "--force")
    assert read_vessel(path).vessel.name == "boat"
    _, said = made("nowhere/boat.toml", *SIZE, status=1)
    assert "a folder that is there" in said.err
    assert [one.name for one in path.parent.iterdir()] == ["boat.toml"]


def test_every_form_and_drive_makes_a_vessel(made):
    for words, units in (
        (("--hull", "barge", *SIZE), {"port": "us", "starboard": "us"}),
        ((*SIZE, "--rudder"), {"motor": "us", "rudder": "rad"}),
        ((*SIZE, "--unit", "percent"), {"port": "percent", "starboard": "percent"}),
        ((*SIZE, "--unit", "N", "--thrust", "30"), {"port": "N", "starboard": "N"}),
        (("--hull", "monohull", *SIZE, "--rudder", "0.02"), {"motor": "us", "rudder": "rad"}),
        (("--hull", "ship", *SIZE, "--propeller", "0.1"), {"propeller": "rev/s", "rudder": "rad"}),
        (
            (*SIZE, "--azimuth", "fore=0.5", "--azimuth", "aft=-0.6,0.1", "--unit", "percent"),
            {f"{one}.{part}": unit for one in ("fore", "aft") for part, unit in AZIMUTH.items()},
        ),
        (
            (*SIZE, "--unit", "rpm", "--shaft-speed", "40"),
            {"port": "rpm", "starboard": "rpm"},
        ),
    ):
        path, said = made("boat.toml", *words, "--force", "--json")
        assert json.loads(said.out)["channels"] == units == read_vessel(path).vessel.units


def test_azimuth_thrusters_sit_where_they_are_said_to_and_their_lags_are_free(made):
    path, _ = made("boat.toml", *SIZE, "--azimuth", "fore=0.5", "--azimuth", "aft=-0.6,0.1",
                   "--unit", "rpm", "--shaft-speed", "25", "--thrust", "40")  # fmt: skip
    file = read_vessel(path)
    fore, aft = (file.vessel.actuators[name] for name in ("fore", "aft"))
    assert (fore.x, fore.y, aft.x, aft.y) == (0.5, 0.0, -0.6, 0.1)
    assert {"fore.force.time_constant", "aft.angle.time_constant"} <= set(file.priors)
    full = {c: 1500.0 if c.endswith("force") else 0.0 for c in file.vessel.channels}
    pushed = fore.force({c: full[c] for c in fore.servos}, State(*[0.0] * 6), {})
    np.testing.assert_allclose(float(pushed.X), 40.0, rtol=1e-6)
    half = fore.force({c: 0.5 * full[c] for c in fore.servos}, State(*[0.0] * 6), {})
    np.testing.assert_allclose(float(half.X), 10.0, rtol=1e-3)


def test_rudder_propeller_and_centre_of_gravity_are_where_they_are_said_to_be(made):
    words = ("--hull", "ship", *SIZE, "--rudder", "0.02,-0.65", "--propeller", "0.1,-0.6",
             "--centre-of-gravity", "-0.05")  # fmt: skip
    file = read_vessel(made("boat.toml", *words)[0])
    propeller, rudder = (file.vessel.actuators[name] for name in ("propeller", "rudder"))
    assert (rudder.x, rudder.area, propeller.x, propeller.diameter) == (-0.65, 0.02, -0.6, 0.1)
    assert float(file.vessel.rigid_body.x_G) == -0.05
    assert not {"x_G", "propeller.diameter"} & set(file.priors)
    alone = read_vessel(made("boat.toml", *SIZE, "--rudder", "0.02,-0.6", "--force")[0])
    assert alone.vessel.actuators["rudder"].x == -0.6


def test_an_antenna_has_its_own_motion(made):
    file = read_vessel(made("boat.toml", *SIZE, "--antenna", "-0.4,0.1")[0])
    at = State(0.0, 0.0, np.pi / 2, 1.0, 0.0, 0.5)
    x, y, _, u, v, _ = file.vessel.sensors.measure(at, at, at)
    # Heading east: behind is west, starboard south; turning to starboard the stern goes to port.
    np.testing.assert_allclose([x, y, u, v], [-0.1, -0.4, 0.95, -0.2], atol=1e-9)


@pytest.mark.parametrize("words, said", [
    (("--antenna", "here"), "a place is"),
    (("--azimuth", "fore"), "NAME=X"),
    (("--rudder", "0.02,aft"), "is not a number"),
    (("--propeller", "0,-1"), "not above zero"),
    (("--azimuth", "fore=1,2,3"), "a place is"),
    (("--azimuth", "fore=nan"), "a place is"),
    (("--azimuth", "fore=0.5", "--rudder"), "give one of"),
])  # fmt: skip
def test_a_place_that_is_none_is_bad_usage(made, words, said):
    _, told = made("boat.toml", *SIZE, *words, status=2)
    assert said in told.err


@pytest.mark.parametrize("words, said", [
    (("--antenna", "3"), "is not on a boat"),
    (("--azimuth", "fore=2"), "outside a hull"),
    (("--rudder", "0.02,-2"), "rudder at -2 m"),
    (("--hull", "ship", "--propeller", "0.1,-2"), "propeller at -2 m"),
    (("--centre-of-gravity", "-2"), "centre of gravity -2 m"),
    (("--azimuth", "fore=0.5", "--azimuth", "fore=0"), "one name"),
    (("--azimuth", "fore=0.5", "--unit", "rpm"), "--shaft-speed"),
    (("--azimuth", "fore=0.5", "--shaft-speed", "25"), "--unit rpm"),
])  # fmt: skip
def test_an_azimuth_thruster_that_cannot_be_is_refused(made, words, said):
    path, told = made("boat.toml", *SIZE, *words, status=1)
    assert said in told.err and not path.exists()


def test_the_autopilots_parameters_say_what_drives_which_side(made, log):  # noqa: F811
    path, said = made("boat.toml", *SIZE, "--thrusters", "0.66", "--log", log(*TWIN.items()))
    port, starboard = tomllib.loads(path.read_text())["thruster"]
    assert (port["neutral"], port["full_ahead"], port["full_astern"]) == (1490, 1860, 1100)
    assert port["reversed"] and "reversed" not in starboard
    assert starboard["full_ahead"] == 1900
    assert port["thrust_curve"]["astern_ratio"] == pytest.approx(1 / 1.6)
    assert "SERVO3 (RCOU:C3) is throttle left: 1120 to 1880 us, neutral 1490 us" in said.out
    vessel = read_vessel(path).vessel
    full = float(vessel.thrusts_at_rest["port"](1120.0))
    assert full == pytest.approx(port["thrust_curve"]["full_thrust"])
    assert float(vessel.thrusts_at_rest["starboard"](1900.0)) == pytest.approx(full)


def test_one_throttle_and_a_rudder_are_read_from_the_log(made, log):  # noqa: F811
    single = log(("SERVO1_FUNCTION", 26), ("SERVO3_FUNCTION", 70), ("SERVO3_TRIM", 1520))
    path, said = made("boat.toml", *SIZE, "--log", single)
    document = tomllib.loads(path.read_text())
    assert document["thruster"][0]["neutral"] == 1520 and document["rudder"]
    assert "monohull" in said.out and "the rudder is ordered in rad" in said.out
    _, said = made("boat.toml", *SIZE, "--force", "--thrusters", "0.6", "--log", single, status=1)
    assert "one throttle" in said.err
    neither = log(("SERVO1_FUNCTION", 33))
    _, said = made("boat.toml", *SIZE, "--force", "--log", neither, status=1)
    assert "73 and 74" in said.err
    _, said = made("boat.toml", *SIZE, "--force", "--unit", "N", "--log", single, status=1)
    assert "pulse widths" in said.err


def test_a_motor_that_is_wired_the_other_way_is_said_so(made):
    path, _ = made("boat.toml", *SIZE, "--reversed", "port")
    thrust = read_vessel(path).vessel.thrusts_at_rest
    assert float(thrust["port"](1100.0)) == pytest.approx(float(thrust["starboard"](1900.0)))
    _, said = made("boat.toml", *SIZE, "--force", "--reversed", "prot", status=1)
    assert "did you mean 'port'" in said.err


def test_what_is_missing_is_bad_usage_without_a_terminal(made):
    _, said = made("boat.toml", "--length", "1.4", status=2)
    assert "--beam missing" in said.err
    _, said = made("boat.toml", *SIZE, "--thrusters", "0.6", "--rudder", status=2)
    assert "one of --thrusters, --rudder and --azimuth" in said.err
    _, said = made("boat.toml", *SIZE, "--hull", "bargee", status=2)
    assert "did you mean 'barge'" in said.err


# The page


PAGE = ROOT / "docs" / "a-boat-from-its-dimensions.md"


def test_the_page_shows_what_its_first_command_prints(made):
    _, said = made("boat.toml", *SIZE, "--thrusters", "0.66")
    shown = [f"    {line}".rstrip() for line in said.out.splitlines()]
    assert "\n".join(shown) in PAGE.read_text()


def test_the_page_says_what_is_taken_for_each_form():
    text = PAGE.read_text()
    for name, form in FORMS.items():
        taken = (form.hulls, form.block_coefficient, form.service, form.top)
        assert f"| {name} | {' | '.join(map(str, taken))} |" in text
    lines = (
        f"exponent {EXPONENT}, and",
        f"astern {ASTERN} of the thrust",
        f"wider by {100 * INERTIA_WIDTH:.0f} % of it",
        f"mass ({GYRATION} L)^2",
        f"has L T / {BOAT_RUDDER} of area",
        f"has {PROPELLER_SHARE} of the",
    )
    for line in lines:
        assert line in text, line


def test_the_page_says_how_far_estimates_are_off():
    check = EXPERIMENTS / "estimate_check" / "results.json"
    vessels = json.loads(check.read_text())["vessels"].values()
    boats = [one["ratio"] for one in vessels if one["form"] in ("catamaran", "monohull")]
    ranges = []
    for column in ("surge drag", "yaw damping"):
        there = [ratio[column] for ratio in boats if ratio[column] is not None]
        ranges.append(f"{min(there):.2f} to {max(there):.2f}")
    text = " ".join(PAGE.read_text().split())
    assert f"drag ahead is {ranges[0]} of what is stated" in text
    assert f"damping of yaw at rest {ranges[1]}" in text
    ships = [x for one in vessels if one["form"] == "ship" for x in one["ratio"].values() if x]
    assert 0.45 < min(ships) and max(ships) < 2.2  # "within a factor of about two"


def test_the_pages_example_of_priors_is_read(made):
    path, _ = made("boat.toml", *SIZE)
    example = PAGE.read_text().partition("```toml\n")[2].partition("```")[0]
    path.write_text(path.read_text().partition("\n[prior]\n")[0] + "\n" + example)
    priors = read_vessel(path).priors
    assert priors.keys() == tomllib.loads(example)["prior"].keys() and priors["N_rr"] is None


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("answers", "units"),
    [
        ("\n\nlong\n1.4\n0.93\n22\n\n\n0.66\n\n", {"port": "us", "starboard": "us"}),
        ("\nship\n54\n11\n1.1e6\n6\n\n\n\n", {"propeller": "rev/s", "rudder": "rad"}),
        ("\nmonohull\n6\n2\n900\n\nrudder\n0.05\nN\n", {"motor": "N", "rudder": "rad"}),
        ("\n\n1.4\n0.93\n22\n\n\n0.66\nrpm\n40\n", {"port": "rpm", "starboard": "rpm"}),
    ],
)
def test_alone_in_a_terminal_it_asks(made, monkeypatch, answers, units):
    monkeypatch.setattr(sys, "stdin", Terminal(answers))
    path, said = made()
    assert read_vessel(path).vessel.units == units
    assert "length of the waterline, m" in said.err
    assert ("'long' is not a number" in said.err) == ("long" in answers)


def test_where_a_file_is_there_it_asks_for_another_name(made, monkeypatch, tmp_path):
    (tmp_path / "boat.toml").write_text("mine")
    (tmp_path / "ours.toml").write_text("ours")
    answers = "boat.toml\nours.toml\n\n\n1.4\n0.93\n22\n\n\n0.66\n\n"
    monkeypatch.setattr(sys, "stdin", Terminal(answers))
    path, said = made()
    assert said.err.count("is there already; choose another name") == 2
    assert "file to write [boat-2.toml]: " in said.err
    assert "file to write [ours-2.toml]: " in said.err
    assert path.read_text() == "mine" and (tmp_path / "ours.toml").read_text() == "ours"
    assert read_vessel(tmp_path / "ours-2.toml").vessel.units == {"port": "us", "starboard": "us"}


def test_a_name_that_was_given_is_asked_for_anew_in_a_terminal(made, monkeypatch, tmp_path):
    (tmp_path / "boat.toml").write_text("mine")
    monkeypatch.setattr(sys, "stdin", Terminal("\n\n1.4\n0.93\n22\n\n\n0.66\n\n"))
    made("boat.toml")
    assert (tmp_path / "boat-2.toml").exists() and (tmp_path / "boat.toml").read_text() == "mine"


def test_outputs_are_named_as_the_log_has_them(made, tmp_path):
    pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
    pytest.importorskip("mcap", reason="needs diffsea[ros]")
    boat = noisy(drive(dock=0.0, after=0.0))
    (tmp_path / "log.bin").write_bytes(driven_boat.ardupilot_log(boat))
    driven_boat.telemetry_log(boat, tmp_path / "log.tlog")
    driven_boat.json_log(boat, tmp_path / "log.mcap")
    raw = "SERVO1 (SERVO_OUTPUT_RAW:servo1_raw) is throttle right"
    for kind, told in (("bin", "SERVO1 (RCOU:C1)"), ("tlog", raw), ("mcap", raw)):
        words = ("boat.toml", *SIZE, "--thrusters", "0.66", "--force", "--log", f"log.{kind}")
        assert told in made(*words)[1].out, kind


def test_a_log_that_is_not_there_is_told_once(made):
    words = ("boat.toml", *SIZE, "--thrusters", "0.66", "--log", "nowhere/log.bin")
    path, said = made(*words, status=1)
    assert said.err.count("nowhere") == 1 and "there is no log" in said.err and not path.exists()


def test_an_input_that_ends_leaves_nothing(made, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Terminal("\n\n1.4\n"))
    path, said = made(status=1)
    assert "the input ended" in said.err and not path.exists()
