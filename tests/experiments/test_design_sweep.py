"""The design sweep: its quick run, and its pieces against closed forms."""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from tests.experiment_runs import modules, quick_run
from tests.paths import EXPERIMENTS

from diffsea import read_vessel


pytestmark = pytest.mark.experiment


HOME = EXPERIMENTS / "design_sweep"
PARTS = ("loading", "sweeping", "independent", "plain_loops", "neighbours", "wanted")


@pytest.fixture(scope="module")
def parts():
    """The experiment's modules."""
    found = modules("design_sweep", *PARTS)
    return SimpleNamespace(**found)


@pytest.fixture(scope="module")
def otter():
    return read_vessel("otter").vessel


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """results.json of the quick variant: 64 designs through the turning circle."""
    folder = tmp_path_factory.mktemp("sweep")
    found = quick_run("design_sweep", folder)
    assert (folder / "figures" / "maps.png").stat().st_size < 100_000
    return found


# -- the quick run -----------------------------------------------------------------------------


@pytest.mark.proof
def test_every_design_completes_and_has_its_verdict(quick):
    assert quick["experiment"] == "design_sweep" and quick["quick"]
    found = quick["beyond"]["sweep"]
    assert found["designs"] == 64 and found["trials"] == {"circle": {"completed": 64}}
    rows = {row["quantity"]: row for row in quick["comparison"]}
    assert rows["tactical diameter"]["limit"] == "at most 5"
    assert rows["advance"]["limit"] == "at most 4.5"
    least, most = map(float, rows["tactical diameter"]["obtained"].split(" to "))
    assert 4 < least < 5 < most < 8
    assert 0 < found["share_that_pass_everything"] < 0.5
    assert quick["beyond"]["memory_gib"] < 2


def test_designs_are_those_of_another_simulator(quick):
    checks = quick["beyond"]["independent"]
    assert len({(c["thrust"], c["mass"]) for c in checks}) == 2
    for check in checks:
        tolerance = 1e-4 if check["number"] == "peak_yaw_rate" else 1e-5
        assert abs(check["relative_difference"]) < tolerance, check


def test_plain_loops_were_timed(quick):
    speed = quick["beyond"]["speed"]
    assert speed["python"] > 1e2 and speed["numpy"] > speed["python"]
    assert speed["over_python"] == pytest.approx(speed["sweep"] / speed["python"])


# -- the pieces --------------------------------------------------------------------------------


def test_a_design_is_loaded_by_its_mass(parts, otter):
    found = {name: float(value) for name, value in parts.loading.loaded(otter, 160.0).items()}
    assert found == pytest.approx(
        {"mass": 160.0, "I_z": 30.2, "draught": 0.39, "X_udot": -11.0, "Y_vdot": -330.0,
         "N_rdot": -102.68}
    )  # fmt: skip
    names, values = parts.loading.designs(otter, np.array([90.0]), np.array([80.0]))
    same = dict(zip(names, values[0], strict=True))
    assert same == pytest.approx(
        {"thrust": 90.0, "mass": 80.0, "I_z": 15.1, "draught": 0.195, "X_udot": -5.5,
         "Y_vdot": -82.5, "N_rdot": -25.67}
    )  # fmt: skip


def test_the_other_simulator_is_loaded_alike(parts, otter):
    hull = parts.independent.document(130.0)["hull"]
    for name, value in parts.loading.loaded(otter, 130.0).items():
        assert hull[name] == pytest.approx(float(value)), name


def test_thrusters_saturate_where_all_thrust_is_on_one_side(parts, otter):
    """At 35 deg the outer one carries it all: 0.4374 N s^2 times (16.54 rev/s)^2."""
    assert parts.loading.saturation(otter, 35.0) == pytest.approx(0.4374 * 16.54**2)
    assert parts.loading.saturation(otter, 0.0) == pytest.approx(2 * 0.4374 * 16.54**2)


def test_the_plain_loop_tends_to_the_other_simulator(parts):
    """Orders reversed at the sample are late by half a step on average: first order."""
    constants = parts.plain_loops.Constants(parts.independent.document(100.0))
    zigzag = parts.loading.KINDS[2]
    right = parts.independent.trial(zigzag, 90.0, 100.0)["overshoot_1"]
    angle = math.radians(20)
    found = parts.plain_loops.one(constants, 90.0, 0.002, angle, 3, 100.0)[0]
    assert found == pytest.approx(right, abs=math.radians(0.02))
    together = parts.plain_loops.together(constants, np.array([90.0, 150.0]), 0.1, angle, 300)
    for thrust, value in zip((90.0, 150.0), together, strict=True):
        alone = parts.plain_loops.one(constants, thrust, 0.1, angle, 3, 100.0)[0]
        assert value == pytest.approx(alone, rel=1e-9)


def quadratic(x):
    """Diameter, advance, overshoot and speed that are quadratic in (ln thrust, ln mass)."""
    t, m = x[..., 0], x[..., 1]
    return np.stack([t**2, m + t, 3 + t * m, t], axis=-1)


@pytest.fixture
def swept(parts):
    """A sweep whose numbers are `quadratic`; lengths are of a vessel of 2 m."""
    thrust, mass = parts.loading.axes(41, 31)
    x = np.log(np.stack(np.meshgrid(thrust, mass), axis=-1)).reshape(-1, 2)
    value = quadratic(x)
    circle = pd.DataFrame(
        {"tactical_diameter": 2 * value[:, 0], "advance": 2 * value[:, 1],
         "approach_speed": value[:, 3], "imo_advance": "pass"}
    )  # fmt: skip
    circle["imo_tactical_diameter"] = np.where(value[:, 0] <= 25, "pass", "fail")
    zigzag = pd.DataFrame({"overshoot_1": np.radians(value[:, 2])})
    tables = {"circle": circle, "zigzag 20/20": zigzag}
    return parts.sweeping.Swept(thrust, mass, tables, {}, {})


def test_first_order_predictions_miss_the_second_order(parts, otter, swept):
    rows, columns = parts.neighbours.bases(swept, 3)
    assert rows.tolist() == [0, 0, 0, 15, 15, 15, 30, 30, 30] and columns[1] == 20
    x = np.stack([np.log(swept.thrust[columns]), np.log(swept.mass[rows])], axis=-1)
    t, m = x.T
    one, zero = np.ones_like(t), np.zeros_like(t)
    slope = np.stack(
        [np.stack(pair, axis=-1) for pair in ((2 * t, zero), (one, one), (m, t), (one, zero))],
        axis=1,
    )
    found = parts.neighbours.predictions(
        swept, otter, (rows, columns), quadratic(x), slope, [(0, 2)]
    )
    inside = columns + 2 < 41
    here, there = swept.thrust[columns[inside]], swept.thrust[columns[inside] + 2]
    change = np.log(there / here)
    np.testing.assert_allclose(found.step, change)
    np.testing.assert_allclose(found.error[:, 0], -(change**2) / np.log(there) ** 2, rtol=1e-9)
    np.testing.assert_allclose(found.error[:, 1:], 0.0, atol=1e-12)
    kink = parts.loading.saturation(otter, 35.0)
    assert found.crosses[:, 0].tolist() == ((here <= kink) & (kink <= there)).tolist()


def test_errors_of_second_order_grow_with_the_square(parts):
    step = np.array([0.01, 0.02, 0.05, 0.1])
    assert parts.neighbours.power(step, 3 * step**2) == pytest.approx(2.0)


def test_criteria_count_the_designs_that_pass(parts, swept):
    rows = {row["criterion"]: row for row in parts.sweeping.criteria(swept, 8.0)}
    found = rows["tactical diameter"]
    assert found["least"] == pytest.approx(math.log(60) ** 2 / 4)
    assert 0 < found["share_pass"] == np.mean(np.log(swept.thrust) ** 2 / 4 <= 5.0)
    least = 3 + math.log(60) ** 2  # deg, at 60 N and 60 kg
    assert rows["first overshoot, 20/20"]["least"] == pytest.approx(least)
    assert parts.sweeping.compliant(swept).mean() == np.mean(np.log(swept.thrust) ** 2 <= 25)


def test_newtons_steps_are_halved_where_they_go_too_far(parts):
    """From 0.1 beside the root of arctan(50 x) a whole step, even the longest, is worse."""

    def evaluate(x):
        far = 50 * (x[:, 0] - 3.0)
        value = np.stack([np.arctan(far), *3 * [np.zeros_like(far)]], axis=-1)
        slope = np.zeros((len(x), 4, 2))
        slope[:, 0, 0] = 50 / (1 + far**2)
        return value, slope

    wish = parts.wanted.at_mass("tactical diameter", 0.0, 70.0)
    found = parts.wanted.search(evaluate, [wish], np.array([[3.1, np.log(70.0)]]))
    assert found.solved.all() and found.steps[0] < 20
    np.testing.assert_allclose(np.log(found.thrust), 3.0, rtol=1e-9)


def test_wishes_are_found_by_newtons_method(parts):
    """t^2 and 3 + t m are wanted; at a mass, only the first."""
    wanted = parts.wanted

    def evaluate(x):
        t, m = x.T
        one, zero = np.ones_like(t), np.zeros_like(t)
        rows = ((2 * t, zero), (one, one), (m, t), (one, zero))
        return quadratic(x), np.stack([np.stack(pair, axis=-1) for pair in rows], axis=1)

    found = wanted.search(
        evaluate,
        [
            wanted.both(20.0, 3 + 4.5 * math.sqrt(20.0)),
            wanted.at_mass("tactical diameter", 25.0, 70.0),
            wanted.at_mass("tactical diameter", -1.0, 70.0),  # no square is below zero
        ],
        np.log([[10.0, 1.0], wanted.START]),
    )
    assert found.solved.tolist() == [True, True, False]
    np.testing.assert_allclose(np.log(found.thrust[:2]), [math.sqrt(20.0), 5.0], rtol=1e-9)
    np.testing.assert_allclose(found.mass[:2], [math.exp(4.5), 70.0], rtol=1e-8)
    assert found.residual[2] >= 1.0 and found.steps[0] < 12
