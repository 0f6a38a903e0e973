"""Overshoot sensitivities: the quick run, and its pieces against closed forms and the oracle."""

import math
import tomllib
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest
from tests.experiment_runs import modules, quick_run
from tests.oracle import trials as oracle
from tests.paths import EXPERIMENTS

from diffsea import named, read_vessel


pytestmark = pytest.mark.experiment


HOME = EXPERIMENTS / "overshoot_sensitivity"
PARTS = ("factors", "trial_lanes", "differences", "at_the_sample", "global_analysis")
DRAG = 77.55  # N, the Otter's at 1 m/s


@pytest.fixture(scope="module")
def parts():
    """The experiment's modules."""
    found = modules("overshoot_sensitivity", *PARTS)
    return SimpleNamespace(**found)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """results.json of the quick variant."""
    folder = tmp_path_factory.mktemp("overshoot")
    found = quick_run("overshoot_sensitivity", folder)
    figures = list((folder / "figures").glob("*.png"))
    assert len(figures) == 4 and all(path.stat().st_size < 100_000 for path in figures)
    return found


@pytest.fixture(scope="module")
def otter(quick):
    return quick["beyond"]["otter"]


# -- the quick run -----------------------------------------------------------------------------


@pytest.mark.proof
def test_results_have_the_limits_and_what_goes_beyond(quick, otter):
    assert quick["experiment"] == "overshoot_sensitivity" and quick["quick"]
    rows = quick["comparison"]
    assert [row["limit"] for row in rows] == ["at most 10", "at most 25", "at most 25"]
    assert set(otter) == {"exact", "differences", "global", "at_the_sample"}
    names = set(otter["exact"]["zigzag 20/20 overshoot_1"]["elasticity"])
    assert {"mass", "N_r", "Y_vdot", "thrusters.y", "crossflow-drag.cd"} <= names


def overshoot(change: str = "", factor: float = 1.0) -> float:
    """First overshoot (deg) of the Otter's 20/20 at 1 m/s by the adaptive integrator."""
    text = resources.files("diffsea.vessel").joinpath("data/otter.toml").read_text()
    vessel = tomllib.loads(text)
    if change.startswith("thrusters."):
        for thruster in vessel["thruster"]:
            thruster[change.removeprefix("thrusters.")] *= factor
    elif change:
        vessel["hull"][change] *= factor
    hull = vessel["hull"]
    vessel["effect"].append(
        {"name": "munk-moment", "Y_vdot - X_udot": hull["X_udot"] - hull["Y_vdot"]}
    )
    angle = math.radians(20)
    trial = oracle.zigzag(vessel, DRAG, angle, angle, executes=3)
    return math.degrees(trial.overshoots[0])


def test_the_overshoot_is_that_of_another_simulator(otter):
    found = math.degrees(otter["exact"]["zigzag 20/20 overshoot_1"]["value"])
    assert found == pytest.approx(overshoot(), rel=2e-6)


@pytest.mark.parametrize("name", ["mass", "N_rdot", "thrusters.time_constant"])
def test_a_derivative_is_the_difference_of_another_simulators_runs(otter, name):
    """The naive scheme has the sign of the last two wrong."""
    h = 1e-3
    slope = (overshoot(name, math.exp(h)) - overshoot(name, math.exp(-h))) / (2 * h)
    row = otter["exact"]["zigzag 20/20 overshoot_1"]
    found = row["elasticity"][name] * math.degrees(row["value"])
    assert found == pytest.approx(slope, rel=2e-4)
    assert row["derivative"][name] * values()[name] == pytest.approx(math.radians(found))


def values() -> dict[str, float]:
    vessel = named(read_vessel("otter").vessel)
    lag = vessel["starboard.time_constant"]
    return {k: float(v) for k, v in (vessel | {"thrusters.time_constant": lag}).items()}


def test_what_cannot_matter_does_not(otter):
    """A thrust straight ahead does not depend on where along the hull it acts, nor, at a held
    speed, the share of the thrust on its curve."""
    row = otter["exact"]["zigzag 10/10 overshoot_1"]["elasticity"]
    for name in ("thrusters.x", "thrusters.curve.1"):
        assert abs(row[name]) < 1e-9
    # Density, draught and drag coefficient enter as one product.
    assert row["draught"] == pytest.approx(row["crossflow-drag.cd"], rel=1e-9)


def test_differences_have_their_valley(otter):
    entry = otter["differences"]["zigzag 10/10 overshoot_1"]
    errors = dict(zip(np.round(np.log10(entry["steps"])), entry["median_error"], strict=True))
    assert entry["order"] == pytest.approx(2.0, abs=0.2)
    assert errors[-5] < 1e-8 and errors[-1] > 1e-5 and errors[-9] > 10 * errors[-5]


def test_the_naive_scheme_has_signs_wrong(otter):
    found = otter["at_the_sample"]
    assert "thrusters.time_constant" in found["0.2 s"]["wrong_sign"]
    assert abs(found["0.2 s"]["overshoot_deg"] - found["overshoot_deg"]) > 0.3


# -- the pieces --------------------------------------------------------------------------------


class Polynomial:
    """Stands in for a bench: numbers a x + b x^3 and the product of two factors."""

    def __init__(self, parts, slopes):
        self.slopes = np.asarray(slopes, float)
        names = [f"p{k}" for k in range(len(slopes))]
        self.factors = tuple(parts.factors.Factor(name, (name,), 1.0) for name in names)
        self.case = SimpleNamespace(numbers=("cubic", "product"))

    def run(self, points, directions, trial):
        cubic = points @ self.slopes + (points**3).sum(axis=1)
        value = np.stack([cubic, (1 + points[:, 0]) * (1 + points[:, 1])], axis=1)
        return SimpleNamespace(value=value, completed=np.ones(len(points), bool))


def test_central_differences_err_by_the_third_derivative(parts):
    bench = Polynomial(parts, [2.0, -1.0])
    found = parts.differences.central(bench, 0, [1, 0], np.array([0.1, 0.01]))
    np.testing.assert_allclose(found[:, :, 0], [[-0.99, 2.01], [-0.9999, 2.0001]], rtol=1e-9)
    exact = np.array([[-1.0, 1.0], [2.0, 1.0]])
    error = parts.differences.errors(found, exact)
    np.testing.assert_allclose(error[0, :, 0], 0.01 / 2.0, rtol=1e-9)


def test_sobol_indices_of_a_sum_are_the_shares_of_its_derivatives(parts):
    analysis, bench = parts.global_analysis, Polynomial(parts, [3.0, 4.0, 0.0])
    points = analysis.sampled(bench, 0.1, 512)
    assert points.shape == (512 * 5, 3) and np.abs(points).max() <= 0.1
    found = analysis.indices(bench, 0.1, points, 0)["cubic"]
    shares = analysis.local_shares(bench.slopes)
    np.testing.assert_allclose(shares, [0.36, 0.64, 0.0])
    np.testing.assert_allclose(found["ST"], shares, atol=0.01)
    assert analysis.disagreements(["a", "b", "c"], shares, found, least=0.02) == []
    assert analysis.ranks(found["ST"]).tolist() == [2, 1, 3]


def test_sobol_indices_see_an_interaction(parts):
    """(1 + x) (1 + y) on +-w: the interaction holds V / (2 + V), V = w^2 / 3."""
    analysis, width = parts.global_analysis, 0.9
    bench = Polynomial(parts, [0.0, 0.0])
    points = analysis.sampled(bench, width, 1024)
    found = analysis.indices(bench, width, points, 0)["product"]
    variance = width**2 / 3
    assert 1 - found["S1"].sum() == pytest.approx(variance / (2 + variance), abs=0.02)
    assert found["ST"] == pytest.approx(2 * [(1 + variance) / (2 + variance)], abs=0.02)


def test_twins_are_one_factor_and_zeros_none(parts):
    vessel = read_vessel("otter").vessel
    found = {factor.label: factor for factor in parts.factors.factors(vessel)}
    assert found["thrusters.y"].places == ("port.y", "starboard.y")
    assert "Y_rdot" not in found and "port.upper" not in found and "beam" not in found
    chosen = tuple(found.values())
    x = np.zeros(len(chosen))
    x[list(found).index("thrusters.y")] = math.log(2)
    changed = named(parts.factors.scaled(vessel, chosen, x))
    assert float(changed["port.y"]) == pytest.approx(-0.79)
    assert float(changed["starboard.y"]) == pytest.approx(0.79)
    assert float(changed["mass"]) == 80.0


def test_signs_count_only_where_the_derivative_does(parts):
    exact = np.array([1.0, -0.5, 0.001, 0.0])
    wrong = np.array([0.2, 0.5, -1.0, 1.0])
    assert parts.at_the_sample.signs_that_differ(wrong, exact).tolist() == [1]
