"""Derivatives of trials against differences of the command line's own results."""

import json
import tomllib

import jax
import numpy as np
import pytest
import tomli_w
from tests.boats import BOAT, CROSS_FLOW

from diffsea import UserError, read_vessel
from diffsea.cli import main
from diffsea.parameters import file_parameters, spread_over_places
from diffsea.simulation import planning
from diffsea.studies.sensitivity import TrialSensitivities, parameter_names
from diffsea.vessel.files import build


pytestmark = [pytest.mark.slow, pytest.mark.compiles]


ORDERED = ["--manoeuvre", "zigzag", "--speed", "1.3", "--angle", "15", "--heading", "10"]
DOCUMENT = tomllib.loads(BOAT + CROSS_FLOW)


def changed(name, by):
    """The document with a number changed by a relative amount, or from zero by the amount."""
    document = tomllib.loads(tomli_w.dumps(DOCUMENT))
    table, key = document["hull"], name
    if "." in name:
        part, key = name.split(".")
        parts = {t["name"]: t for t in (*document["thruster"], *document["effect"])}
        table = parts[part]
    value = table.get(key, 0.0)
    step = by * abs(value) if value else by
    table[key] = value + step
    return document, step


@pytest.fixture(scope="module")
def derivatives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensitivity")
    patch = pytest.MonkeyPatch()
    patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    before = jax.config.values["jax_compilation_cache_dir"]
    (folder / "boat.toml").write_text(BOAT + CROSS_FLOW)
    words = ["sensitivity", str(folder / "boat.toml"), *ORDERED, "-o", str(folder / "out")]
    assert main(words) == 0
    patch.undo()
    jax.config.update("jax_compilation_cache_dir", before)
    assert (folder / "out" / "tornado.png").exists()
    return json.loads((folder / "out" / "sensitivity.json").read_text())


@pytest.fixture(scope="module")
def numbers():
    """The numbers of the same trial of a document, by the code of `diffsea trial`."""
    plan = planning.plan_trial(build(DOCUMENT), "zigzag", np.radians(15), np.radians(10), speed=1.3)

    def measured(document):
        found = planning.run_and_measure(build(document), plan)[1]
        return {name: float(value) for name, value in found.items()}

    return measured


CHOSEN = ("mass", "I_z", "x_G", "length", "draught", "X_uu", "Y_v", "N_r", "N_rdot", "Y_rdot",
          "port.y", "starboard.angle", "crossflow-drag.cd")  # fmt: skip


# A settled zig-zag of a boat whose sides are alike peaks alike to port and starboard: the larger
# of the two has a kink against what makes the sides differ.
KINKED = {("port.y", "peak_yaw_rate"), ("starboard.angle", "peak_yaw_rate")}


@pytest.mark.parametrize("name", CHOSEN)
def test_derivatives_are_those_of_the_trials_own_numbers(name, derivatives, numbers):
    """Fourth-order central differences, whose own error is far below the tolerance."""
    # A thruster turned further than this makes the approach last longer.
    by = {"Y_rdot": 0.2, "starboard.angle": 1e-5}.get(name, 1e-3)
    runs = {k: numbers(changed(name, k * by)[0]) for k in (-2, -1, 1, 2)}
    step = changed(name, by)[1]
    nominal = numbers(DOCUMENT)
    assert derivatives.keys() == {n for n, value in nominal.items() if np.isfinite(value)}
    for number, row in derivatives.items():
        if (name, number) in KINKED:
            continue
        outer, inner = (runs[k][number] - runs[-k][number] for k in (2, 1))
        slope = (8 * inner - outer) / (12 * step)
        # What is left of an approach that lasts a step longer is a billionth of the number.
        tolerance = 1e-4 * abs(slope) + 1e-9 * abs(nominal[number]) / step
        assert abs(row[name] - slope) < tolerance, (number, row[name], slope)


def test_something_depends_on_every_chosen_parameter(derivatives):
    for name in CHOSEN:
        assert any(abs(row[name]) > 0 for row in derivatives.values())


def test_every_number_of_the_vessel_is_there(derivatives):
    names = set(file_parameters(build(DOCUMENT)))
    assert all(set(row) == names for row in derivatives.values())


def test_the_held_approach_speed_does_not_depend_on_the_hull(derivatives):
    for name in ("mass", "X_uu", "N_r", "length"):
        assert abs(derivatives["approach_speed"][name]) < 1e-6
    assert abs(derivatives["overshoot_1"]["N_r"]) > 1e-5


def test_copies_of_a_main_dimension_are_one_parameter():
    vessel = read_vessel("kvlcc2").vessel
    places = file_parameters(vessel)
    assert places["length"] == ("length", "scaling.length")
    assert set(places["water_density"]) == {
        "water_density", "scaling.water_density", "propeller.water_density", "rudder.water_density"
    }  # fmt: skip
    assert places["rudder.x"] == ("rudder.x",) and "scaling.length" not in places
    assert spread_over_places(places, {"length": 8.0}) == {"length": 8.0, "scaling.length": 8.0}


def test_unknown_parameters_are_told_with_the_nearest():
    vessel = build(DOCUMENT)
    assert parameter_names(vessel, ["mass", "X_u", "mass"]) == ("mass", "X_u")
    with pytest.raises(UserError, match="no parameter 'maas'; did you mean 'mass'"):
        parameter_names(vessel, ["maas"])


def test_elasticities_are_relative():
    numbers, parameters = {"period": 10.0, "heading_change": 0.0}, {"mass": 200.0, "X_u": -4.0}
    slopes = {"period": {"mass": 0.1, "X_u": 0.0}, "heading_change": {"mass": 1.0}}
    relative = TrialSensitivities(numbers, parameters, slopes).elasticities
    assert relative == {"period": {"mass": pytest.approx(0.1 * 200 / 10)}}
