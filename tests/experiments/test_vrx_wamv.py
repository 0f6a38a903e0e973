"""The WAM-V experiment: its quick run, and its pieces against closed forms and scipy."""

import math
import types

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binom
from tests.experiment_runs import modules, quick_run
from tests.paths import ROOT


pytestmark = pytest.mark.experiment


FOLDER = ROOT / "experiments" / "vrx_wamv"
MODULES = ("plant", "campaign", "procedure", "paths", "intervals", "joint", "outside_draws")


@pytest.fixture(scope="module")
def parts():
    """The experiment's modules."""
    found = modules("vrx_wamv", *MODULES)
    return found


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """results.json of the quick variant."""
    return quick_run("vrx_wamv", tmp_path_factory.mktemp("vrx_wamv"))


# -- the quick run ---------------------------------------------------------------------------


@pytest.mark.proof
def test_results_have_every_published_figure_and_what_goes_beyond(results):
    assert results["experiment"] == "vrx_wamv" and results["quick"]
    rows = results["comparison"]
    assert all({"quantity", "unit", "published", "obtained", "note"} == set(row) for row in rows)
    published = [row["published"] for row in rows]
    for figure in (-0.397956, 0.299914, 145.75, 56.0, 1023.0, 340.0, 1012.0,
                   189.0, 229.0, 333.0, 2.0, 0.37):  # fmt: skip
        assert figure in published
    assert all(row["obtained"] is not None for row in rows)
    for row in rows:
        if row["quantity"].startswith("steady speed at") and row["quantity"].endswith(" N"):
            assert row["published"] is None  # the closed form is no publication's
            assert f"{row['obtained']:.4g}" in row["note"]
    assert {"gains", "verified", "costs"} <= set(results["beyond"])


def test_the_plant_settles_at_the_speeds_of_the_closed_form(results):
    for name, one in results["checks"].items():
        assert one["integrated"] == pytest.approx(one["closed form"], rel=1e-4), name


def test_the_joint_fit_finds_the_plant(results):
    values = results["values"]["joint"]
    for name, true, share in (
        ("mass", 258.0, 0.05), ("I_z", 682.9, 0.06), ("x_G", -0.286, 0.2), ("X_u", -100.0, 0.02),
        ("X_uu", -150.0, 0.03), ("Y_v", -100.0, 0.15), ("Y_vv", -100.0, 0.3), ("N_r", -800.0, 0.1),
        ("N_rr", -800.0, 0.2),
    ):  # fmt: skip
        assert values[name] == pytest.approx(true, rel=share), name
    assert abs(values["c"]) < 0.15  # thrust does not fall with speed


def test_the_joint_fit_predicts_far_better_than_the_procedure(results):
    errors = results["prediction_errors"]
    assert errors["joint"]["position"] < 0.3
    for reading in ("speeds alone", "thrust as ordered"):
        assert errors[reading]["position"] > 10 * errors["joint"]["position"]


def test_the_fitted_model_follows_the_paths_as_the_plant_does(results):
    for path in ("slow circle", "slow zigzag", "fast circle", "fast zigzag"):
        one = results["paths"]["joint"][path]
        assert one["finished"]
        assert one["time"] < 0.01 and one["distance"] < 0.01 and one["position"] < 0.3


def test_tuned_gains_follow_paths_better_on_the_plant(results):
    runs = results["beyond"]["verified"]
    for path in ("circle", "zigzag", "lanes"):
        before, after = runs["by hand"][path], runs["tuned"][path]
        assert after["finished"]
        assert after["rms"] < 0.7 * before["rms"], path
        assert after["seconds"] < 1.15 * before["seconds"], path
    costs = results["beyond"]["costs"]["tuned"]
    assert costs[-1] < 0.3 * costs[0]


# -- the reference plant ---------------------------------------------------------------------


def test_straight_acceleration_is_that_of_the_riccati_equation(parts):
    """m u' = T - a u - b u^2 from rest: u = (k tanh(k t / (2 m) + atanh(a / k)) - a) / (2 b)."""
    plant, n = parts["plant"].NEW, 20.0
    run = parts["plant"].driven(plant, lambda t: (n, n), 12.0, 0.1)
    (a, b), thrust = plant.surge, 2 * plant.thrust(n)
    k = math.sqrt(a * a + 4 * b * thrust)
    exact = (k * np.tanh(k * run["t"] / (2 * plant.mass) + math.atanh(a / k)) - a) / (2 * b)
    np.testing.assert_allclose(run["u"], exact, atol=1e-6)


def test_motion_is_that_of_newtons_equations_at_the_centre_of_gravity(parts):
    """A hard turn, integrated adaptively in the velocities of the centre of gravity."""
    plant = parts["plant"].NEW
    thrust = plant.thrust(28.0), plant.thrust(-10.0)
    inertia = plant.I_zz - plant.mass * plant.x_G**2
    drag = plant.surge, plant.sway, plant.yaw

    def rate(t, s):
        north, east, psi, u, v_G, r = s
        v = v_G - plant.x_G * r
        surge, sway, yaw = (
            -(linear + square * abs(w)) * w
            for (linear, square), w in zip(drag, (u, v, r), strict=True)
        )
        moment = yaw + plant.arm * (thrust[0] - thrust[1]) - plant.x_G * sway
        cos, sin = math.cos(psi), math.sin(psi)
        return [
            u * cos - v * sin, u * sin + v * cos, r,
            (surge + sum(thrust)) / plant.mass + v_G * r, sway / plant.mass - u * r,
            moment / inertia,
        ]  # fmt: skip

    exact = solve_ivp(rate, (0, 30), np.zeros(6), rtol=1e-10, atol=1e-12).y[:, -1]
    run = parts["plant"].driven(plant, lambda t: (28.0, -10.0), 30.0, 0.2)
    found = np.array([run[c][-1] for c in parts["plant"].CHANNELS])
    found[4] += plant.x_G * found[5]
    assert abs(found[5]) > 0.1
    np.testing.assert_allclose(found, exact, atol=2e-5)


def test_thrust_follows_the_square_of_speed_within_its_limits(parts):
    plant, speed_for = parts["plant"].NEW, parts["plant"].speed_for
    assert plant.thrust(speed_for(250.0)) == pytest.approx(250.0)
    assert plant.thrust(speed_for(-400.0)) == pytest.approx(-400.0)
    assert plant.thrust(200.0) == 2353.5 and plant.thrust(-200.0) == -1000.0
    assert speed_for(250.0) == pytest.approx(29.92, abs=0.01)  # the paper: 30 rev/s


# -- the paper's procedure -------------------------------------------------------------------


@pytest.fixture(scope="module")
def linear(parts):
    """Exact recordings of a boat that the paper's model describes."""
    plant = parts["plant"].Plant(
        mass=189.0, x_G=0.0, I_zz=333.0, surge=(200.0, 0.0), sway=(80.0, 0.0), yaw=(900.0, 0.0),
        arm=parts["procedure"].HALF,
    )  # fmt: skip
    return parts["campaign"].campaign(0, plant, noise=0.0)


def test_the_procedure_finds_a_boat_of_its_own_kind(parts, linear):
    found = parts["procedure"].identify(linear, "thrust as ordered")
    for model in (found.first, found.corrected):
        assert model.c == pytest.approx(0.0, abs=1e-4)
        assert model.d == pytest.approx(parts["plant"].THRUST_PER_SPEED, rel=1e-4)
        assert model.X_u == pytest.approx(200.0, rel=0.01)
        assert model.N_r == pytest.approx(900.0, rel=0.01)
        assert model.Y_v == pytest.approx(80.0, rel=0.01)


def test_speeds_alone_leave_one_factor_of_eq_9_open(parts):
    procedure = parts["procedure"]
    n, u = procedure.plateaus(parts["campaign"].campaign(1).straight)
    one = procedure.from_speeds(n, u, (-0.4, 0.3, 150.0))
    other = procedure.from_speeds(n, u, (0.1, 0.1, 50.0))
    assert other[0] / other[2] == pytest.approx(one[0] / one[2], rel=1e-3)
    assert other[1] / other[2] == pytest.approx(one[1] / one[2], rel=1e-3)
    assert abs(math.log(abs(other[2] / one[2]))) > 1.0


def test_masses_of_table_1(parts):
    m11, m22, m33 = parts["procedure"].masses()
    assert m11 == pytest.approx(189.0)
    assert m22 == pytest.approx(180 + 500 * math.pi * 0.089**2 * 3.21)
    assert m33 == pytest.approx(281.19, abs=0.01)


# -- draws of noise --------------------------------------------------------------------------


def test_noise_drawn_again_is_that_of_a_campaign_of_its_own(parts):
    campaign = parts["campaign"]
    again = campaign.measured_again(campaign.campaign(1), 7)
    for one, other in zip(again.runs, campaign.campaign(7).runs, strict=True):
        assert one.name == other.name
        for channel, series in other.measured.items():
            np.testing.assert_array_equal(one.measured[channel], series)


def test_an_interval_of_the_median_has_the_share_that_order_statistics_give(parts):
    """A median of draws drawn again is at most the k-th least where half of them or more are."""
    n = 21
    values = np.random.default_rng(0).permutation(np.arange(1.0, n + 1))
    found = parts["intervals"].over_draws(values)
    below = [binom.sf(n // 2, n, k / n) for k in range(1, n + 1)]
    low, high = (1 + int(np.argmax(np.array(below) >= share)) for share in (0.025, 0.975))
    assert (found.median, found.low, found.high) == (11.0, low, high)
    assert (found.least, found.most) == (1.0, 21.0)
    assert found.leaves_out_zero and not parts["intervals"].over_draws(values - 11).leaves_out_zero


def test_differences_are_of_the_same_draw(parts):
    """Both share noise of a hundred times what sets them apart; not every draw has both."""
    shared = dict(
        zip(range(1, 41), 100 * np.random.default_rng(1).standard_normal(40), strict=True)
    )
    one = {seed: value + 1 + 0.01 * (seed % 3) for seed, value in shared.items()}
    other = {seed: shared[seed] for seed in reversed(range(11, 41))}
    found = parts["intervals"].paired(one, other)
    assert found.median == pytest.approx(1.01)
    assert (found.least, found.most) == (pytest.approx(1.0), pytest.approx(1.02))
    assert found.low >= 0.999 and found.high <= 1.021
    assert parts["intervals"].paired(other, one).median == pytest.approx(-1.01)


def test_what_is_judged_over_draws(parts):
    draws = parts["outside_draws"]
    noise = {1: 5.0, 2: -3.0, 3: 0.0}
    found = {
        model: {seed: dict.fromkeys(draws.CHANNELS, worse + noise[seed]) for seed in seeds}
        for model, worse, seeds in (
            (draws.PROCEDURE, 2.0, (1, 2, 3)), (draws.JOINT, 0.0, (1, 2, 3)),
            (draws.less("roll"), -0.5, (3, 1)),
        )
    }  # fmt: skip
    times = {model: {seed: {"circle": 0.02} for seed in of} for model, of in found.items()}
    times[draws.JOINT][2] = {}  # not done
    told = draws.judged(found, times, {}, ["circle", "zigzag"])
    worse = told.differences[f"{draws.PROCEDURE}, less {draws.JOINT}"]["position"]
    assert (worse.median, worse.low, worse.high) == (2.0, 2.0, 2.0)
    better = told.differences[f"{draws.less('roll')}, less {draws.JOINT}"]["u"]
    assert (better.median, better.most) == (-0.5, -0.5)
    assert told.medians[draws.JOINT]["r"].median == 0.0
    assert told.finished[draws.JOINT] == {"circle": 2, "zigzag": 0}
    assert told.times[draws.JOINT] == {"circle": None, "zigzag": None}
    assert told.times[draws.PROCEDURE]["circle"].median == 0.02
    table = draws.differences_table(told)
    assert "**+2 (+2 to +2)**" in table and "**-0.5 (-0.5 to -0.5)**" in table
    assert "done in 2 of 3" in draws.times_table(told)


def test_of_several_starts_the_fit_of_least_deviance_is_taken(parts, monkeypatch):
    joint, ends = parts["joint"], {"guessed": 3.0, 1.0: 1.0, 2.0: 2.0}

    class Ending:
        """A search that ends at its start, with a deviance that was laid down."""

        parameters = ()

        def __init__(self, problem):
            pass

        def fit(self, free, start):
            at = np.zeros(1) if start is None else start
            deviance = ends["guessed" if start is None else float(start[0])]
            return types.SimpleNamespace(coordinates=at, deviance=deviance, outcome="an end")

    monkeypatch.setattr(joint, "OutputError", Ending)
    monkeypatch.setattr(joint, "parameter_estimates", lambda parameters, fit: [])
    runs = parts["campaign"].campaign(1).straight[:1]
    given = ("guessed", np.array([1.0]), np.array([2.0]))
    for starts in (given, given[::-1]):
        found = joint.fit_whole(runs, starts)
        assert (found.deviance, found.coordinates[0]) == (1.0, 1.0)
    assert joint.fit_whole(runs).deviance == 3.0


# -- paths -----------------------------------------------------------------------------------


def test_distance_from_a_path_is_that_from_its_nearest_leg(parts):
    corner = np.array([[10.0, 0.0], [10.0, 10.0]])
    north = np.array([5.0, 12.0, -3.0, 10.0, 13.0])
    east = np.array([2.0, 5.0, 0.0, 0.0, 14.0])
    found = np.asarray(parts["paths"].off_path(corner, north, east))
    np.testing.assert_allclose(found, [2.0, 2.0, 3.0, 0.0, 5.0], atol=1e-5)


def test_paths_share_a_shape_and_the_circle_closes(parts):
    paths = parts["paths"]
    every = {**paths.PATHS, **paths.KEPT_BACK}
    assert {points.shape for points in every.values()} == {(paths.COUNT, 2)}
    np.testing.assert_allclose(paths.circle()[-1], 0.0, atol=1e-12)
    assert paths.circle()[0][1] > 0  # to starboard
