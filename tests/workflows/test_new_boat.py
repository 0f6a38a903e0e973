# pyright: reportArgumentType=false
"""A boat of which only dimensions and mass are known, its motors ordered by pulse width.

The true boat is drawn from the file's own priors and sailed by the simulator under `tests/oracle`,
which knows nothing of pulse widths: the test turns them into newtons by the true thrust curve.
"""

import copy
import math
import tomllib

import numpy as np
import pytest
from scipy.stats import binomtest, norm
from tests.oracle import sensors
from tests.oracle.simulator import simulate

from diffsea import Trajectory
from diffsea.simulation.replay import prediction_misses
from diffsea.vessel.estimates import Known, Thrusters, hull_estimates, outline_of
from diffsea.vessel.estimates.vessel_text import vessel_text
from diffsea.vessel.files import VesselFile, build
from diffsea.workflows.fits import fit


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]

SEED = 5
SECONDS, STEP = 120.0, 0.2
AHEAD = 10.0  # s of a free prediction; starts lie as far apart, so that no two share a sample
CHANCE = 0.001


@pytest.fixture(scope="module")
def estimated():
    outline = outline_of(Known("catamaran", 1.4, 0.93, 22.0))
    hull = hull_estimates(outline)
    parts = Thrusters(spacing=0.66).parts(outline, hull, False)
    document = tomllib.loads(vessel_text("boat", outline, hull, parts))
    return VesselFile(build(document), document, "boat.toml")


@pytest.fixture(scope="module")
def true(estimated):
    """Values by name within one prior width of the file's, both motors the same."""
    rng, values = np.random.default_rng(SEED), {}
    for name, prior in estimated.priors.items():
        if not name.startswith("starboard"):
            values[name] = float(prior.decode(prior.spread * rng.uniform(-1, 1)))
    own = {n.removeprefix("port."): x for n, x in values.items() if n.startswith("port.")}
    return values | {f"starboard.{name}": value for name, value in own.items()}


def recorded(estimated: VesselFile, true: dict, seed: int) -> Trajectory:
    """A run with an order of both motors every 5 s, as its sensors show it."""
    rng = np.random.default_rng(seed)
    document = copy.deepcopy(estimated.document)
    document["hull"] |= {name: x for name, x in true.items() if name in document["hull"]}
    document["thruster"] = [
        {key: one[key] for key in ("name", "x", "y")} for one in document["thruster"]
    ]
    del document["prior"]
    times = np.arange(0.0, SECONDS, 5.0)
    middle, half = rng.uniform(1500, 1850, times.size), rng.uniform(-250, 250, times.size)
    pulses = {"port": np.clip(middle + half, 1150, 1900)}
    pulses["starboard"] = np.clip(middle - half, 1150, 1900)

    def newtons(name: str, pulse: float) -> float:
        share = (pulse - 1500) / 400
        thrust = true[f"{name}.thrust_curve.full_thrust"]
        thrust *= abs(share) ** true[f"{name}.thrust_curve.exponent"]
        return thrust if share > 0 else -thrust * true[f"{name}.thrust_curve.astern_ratio"]

    orders = [
        (at, {name: newtons(name, series[k]) for name, series in pulses.items()})
        for k, at in enumerate(times)
    ]
    t = np.arange(0.0, SECONDS, STEP)
    sailed = sensors.record(simulate(document, orders, SECONDS, []), t, sensors.suite(), rng)
    motion = {c: np.asarray(sailed[c], float) for c in sensors.CHANNELS}
    held = np.searchsorted(times, t + 1e-9, side="right") - 1
    commanded = {name: series[held] for name, series in pulses.items()}
    seen = np.ones(t.size, bool)
    return Trajectory(
        t, **motion, commanded=commanded, executed={}, extra={}, valid=seen, name=f"run {seed}"
    )


@pytest.fixture(scope="module")
def found(estimated, true):
    runs = [recorded(estimated, true, seed) for seed in (11, 12, 13, 14)]
    return fit(estimated, runs[:2], runs[2:], profiles=())


def distances(vessel, run: Trajectory) -> np.ndarray:
    """How far free predictions are off in position (m), started apart."""
    misses = prediction_misses(vessel, run, (AHEAD,), AHEAD)[AHEAD]
    return np.hypot(misses["x"], misses["y"])


def test_a_fit_from_dimensions_alone_predicts_runs_that_it_did_not_see(estimated, found):
    """Where it did not help, it would predict better in half of the starts: a sign test."""
    before, after = (
        np.concatenate([distances(one.vessel, run) for run in found.data.test])
        for one in (estimated, found.fitted)
    )
    better = int(np.sum(after < before))
    assert binomtest(better, before.size, 0.5, alternative="greater").pvalue < 0.01
    # Half the distance in most starts, by the same test.
    halved = int(np.sum(after < before / 2))
    assert binomtest(halved, before.size, 0.5, alternative="greater").pvalue < 0.01
    assert not found.missing and found.misfit["test"] == pytest.approx(1.0, abs=0.1)


def test_drag_and_thrust_come_out_true_though_neither_was_known(found, true):
    """The mass fixes the scale of forces. Largest of so many standard scores, by Bonferroni."""
    rows = {row["name"]: row for row in found.study.rows if row["determined"] > 0.9}
    assert {"X_u", "X_uu", "N_ur", "Y_uv", "port.thrust_curve.full_thrust"} <= set(rows)
    scores = [(row["value"] - true[name]) / row["std"] for name, row in rows.items()]
    limit = norm.isf(CHANCE / 2 / len(scores))
    assert np.abs(scores).max() < limit
    ahead = rows["port.thrust_curve.full_thrust"]
    assert ahead["unit"] == "N" and not math.isclose(ahead["start"], ahead["value"], rel_tol=0.05)


def test_the_fitted_file_keeps_its_priors_and_can_be_fitted_again(found, estimated):
    again = found.fitted.priors
    assert again.keys() == estimated.priors.keys()
    for name, prior in estimated.priors.items():
        kept = again[name]
        assert (kept.value, kept.std) == (pytest.approx(prior.value), pytest.approx(prior.std))
