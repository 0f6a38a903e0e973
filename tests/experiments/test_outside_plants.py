# pyright: reportArgumentType=false
"""Plants outside the estimators' model class: energy, mirrors, signs, trial sheets, and that
they share nothing with the library."""

import ast
import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.experiment_runs import modules
from tests.paths import EXPERIMENTS


pytestmark = pytest.mark.experiment

DEGREE, KNOT = math.pi / 180, 1852 / 3600


@pytest.fixture(scope="module")
def rolling():
    """The catamaran with roll."""
    return modules("vrx_wamv", "rolling_plant")["rolling_plant"]


@pytest.fixture(scope="module")
def planar():
    """The planar reference plant."""
    return modules("vrx_wamv", "plant")["plant"]


@pytest.fixture(scope="module")
def ships():
    """The harbour ship of another structure."""
    return modules("unberthing", "polynomial_ship")["polynomial_ship"]


@pytest.mark.parametrize("path", ["vrx_wamv/rolling_plant.py", "unberthing/polynomial_ship.py"])
def test_a_plant_imports_neither_the_library_nor_its_experiment(path):
    tree = ast.parse((EXPERIMENTS / path).read_text())
    names = [
        alias.name if isinstance(node, ast.Import) else node.module or ""
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    ]
    allowed = {"dataclasses", "math", "numpy", "jax", "equinox", "jaxtyping"}
    assert {name.split(".")[0] for name in names} <= allowed


# -- the catamaran -----------------------------------------------------------------------------


def zigzag(t):
    """Orders (rev/s) that turn to either side, reverse and stop."""
    pairs = ((28, 28), (28, 12), (10, 29), (25, -20), (-20, 25), (0, 0), (-22, -18), (30, 15))
    return pairs[int(t / 4 + 1e-9) % 8]


def driven(plant, orders, seconds, dt=0.05, start=None):
    state = plant.at_rest if start is None else tuple(start)
    rows = [state]
    for k in range(round(seconds / dt)):
        state = plant.advanced(state, *map(float, orders(k * dt)), dt)
        rows.append(state)
    return np.array(rows)


def test_without_what_is_new_the_catamaran_is_the_planar_plant(rolling, planar):
    plain = dataclasses.replace(
        rolling.WITHOUT["flow loss"], rolls=False, added=(0.0,) * 4, stern_section=0.0, lags=False,
        dead_band=0.0, astern=1.0, surge=(100.0, 150.0), hump=(0.0, 0.45, 0.15),
        sway=(100.0, 100.0), yaw=(800.0, 800.0), half_spacing=0.0, cross_flow=0.0,
        windage=(0.0, 0.0),
    )  # fmt: skip
    rows = driven(plain, zigzag, 32)
    state = planar.NEW.at_rest
    for k, row in enumerate(rows):
        np.testing.assert_allclose(row[:6], state, atol=5e-5)
        state = planar.NEW.advanced(state, *map(float, zigzag(k * 0.05)), 0.05)


def test_mirrored_orders_give_the_mirrored_run(rolling):
    one = driven(rolling.ROLLING, zigzag, 32)
    other = driven(rolling.ROLLING, lambda t: zigzag(t)[::-1], 32)
    flip = np.array((1, -1, -1, 1, -1, -1, -1, -1))
    np.testing.assert_array_equal(one[:, :8] * flip, other[:, :8])


def test_without_thrust_the_catamarans_energy_falls(rolling):
    plant = rolling.ROLLING
    start = np.array((0, 0, 1.0, 1.2, -0.6, 0.5, 0.1, -0.2, 0, 0))
    energies = []
    for row in driven(plant, lambda t: (0, 0), 10, start=start):
        w = np.array((row[4], row[7], row[5]))
        motion = (plant.mass + plant.added[0]) * row[3] ** 2 + w @ np.array(plant.inertia) @ w
        heel = plant.mass * rolling.GRAVITY * plant.GM * (1 - math.cos(row[6]))
        energies.append(0.5 * motion + heel)
    assert np.all(np.diff(energies) < 0) and energies[-1] < 0.05 * energies[0]


@pytest.mark.parametrize("part", ["roll", "added mass", "engine lag", "flow loss"])
def test_each_part_of_the_catamaran_matters(rolling, part):
    whole, less = (driven(p, zigzag, 20) for p in (rolling.ROLLING, rolling.WITHOUT[part]))
    assert np.hypot(*(whole - less)[-1, :2]) > 0.05


# -- the harbour ship --------------------------------------------------------------------------


@eqx.filter_jit
def sailed(step, ship, begun, blades, tide_wind):
    """States at the ends of control periods under orders (periods, 4)."""

    def period(state, order):
        state = step(ship, state, tuple(order), *tide_wind, 0.5)
        return state, state

    return jax.lax.scan(period, begun, blades)[1]


def held(angles, seconds):
    return jnp.tile(jnp.array(angles) * DEGREE, (int(2 * seconds), 1))


def away(ship, **others):
    """The ship with the wall far off, and other changes."""
    changes = {"wall_y": jnp.asarray(1e6)} | {k: jnp.asarray(v) for k, v in others.items()}
    return dataclasses.replace(ship, **changes)


def run(ships, ship, angles, seconds, speed=0.0, tide_wind=(0.0,) * 4):
    begun = ships.at(ship, 0.0, 0.0, 0.0, speed)
    return sailed(ships.advanced, ship, begun, held(angles, seconds), jnp.array(tide_wind))


@pytest.mark.parametrize(("angle", "knots"), [(1.0, 3.0), (6.7, 8.0)])
def test_blade_angles_give_the_speeds_of_the_trial_sheet(ships, angle, knots):
    even = dict.fromkeys(("Y_0", "N_0", "swirl", "walk_churn", "walk_astern"), 0.0)
    path = run(ships, away(ships.drawn(0), **even), (angle, 0, 0, 0), 500, 1.5)
    assert float(path.u[-1]) / KNOT == pytest.approx(knots, rel=0.15)


def test_thrusters_push_to_their_side_and_fade_with_speed(ships):
    ship = away(ships.drawn(0))
    blades = jnp.array((0.0, 0.0, 11.0, 9.0)) * DEGREE

    def force(speed):
        state = ships.at(ship, 0.0, 0.0, 0.0, speed)
        return float(ships.thrusters_side_force(ship, state, blades))

    assert force(0.0) == pytest.approx(60e3, rel=0.02)
    assert 0.5 * force(0.0) < force(2.0) < 0.85 * force(0.0)
    assert float(run(ships, ship, (-1.5, 0, -11, -9), 60).v[-1]) < -0.4


def test_the_wall_turns_the_bow_out_and_ends(ships):
    ship = ships.drawn(0)
    beside, open_water = (run(ships, s, (1, 0, 0, 0), 60, 1.5) for s in (ship, away(ship)))
    assert float(beside.psi[-1]) < float(open_water.psi[-1]) - 2 * DEGREE
    north = dataclasses.replace(ship, wall_end=jnp.asarray(-500.0))
    past = run(ships, north, (1, 0, 0, 0), 60, 1.5)
    assert float(past.psi[-1]) == pytest.approx(float(open_water.psi[-1]), abs=0.01 * DEGREE)


def test_a_ship_at_rest_in_still_water_stays_and_drawn_ships_stay_finite(ships):
    still = away(ships.drawn(0), walk_churn=0.0)
    path = run(ships, still, (float(still.pitch_zero) / DEGREE, 0, 0, 0), 60)
    assert max(float(jnp.abs(part).max()) for part in (path.u, path.v, path.r)) < 1e-9
    fleet = jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(ships.drawn, range(8)))
    begun = jax.vmap(lambda ship: ships.at(ship, 0.0, 0.0, 0.0, 0.0))(fleet)
    blades = jnp.asarray(np.random.default_rng(0).uniform(-0.2, 0.2, (400, 4)))
    weather = jnp.array((0.2, -0.1, -5.0, 5.0))
    paths = jax.vmap(lambda s, b: sailed(ships.advanced, s, b, blades, weather))(fleet, begun)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(paths))
    assert float(jnp.abs(paths.u).max()) < 6 and float(jnp.abs(paths.r).max()) < 0.1


# -- what tells control systems apart ----------------------------------------------------------


def test_a_part_is_told_apart_only_where_its_interval_leaves_out_zero():
    found = modules("unberthing", "unberthing_variants", "unberthing_scores")
    variants, Score = found["unberthing_variants"], found["unberthing_scores"].Score
    rng = np.random.default_rng(0)

    def scores(worst, wrong):
        return [
            Score({2: error}, np.zeros(1), 10.0 * bad, 0.0, 3.0, 0.0, True)
            for error, bad in zip(worst, wrong, strict=True)
        ]

    errors = rng.uniform(3, 10, 100)
    none, many = np.zeros(100, bool), rng.uniform(size=100) < 0.3
    judged = {
        "published": scores(errors, many),
        "published, bias": scores(errors - 1.0, none),
        "slow": scores(errors + 1e-9 * rng.normal(size=100), many),
    }
    rows = {one["part"]: one for one in variants.differences(judged)}
    assert set(rows) == {"a bias in eq. 4", "a tenth of the learning rate"}
    bias, rate = rows["a bias in eq. 4"], rows["a tenth of the learning rate"]
    assert bias["median_error"] == pytest.approx(-1.0)
    assert bias["wrong_way"] == pytest.approx(-many.mean())
    assert bias["wrong_way_interval"][1] < 0 and bias["median_error_interval"][1] < 0
    low, high = rate["p95_error_interval"]
    assert low <= 0 <= high and rate["wrong_way"] == 0
    text = variants.differences_table(list(rows.values()))
    first, second = text.splitlines()[2:]
    assert first.count("**") == 6 and second.count("**") == 0


def test_gradient_descent_with_a_bias_finds_the_push_that_moves_the_ship():
    model = modules("unberthing", "gradient_model")["gradient_model"]
    rng = np.random.default_rng(1)
    rows = 1200
    truth = np.array([[0.98, 0.1, 0.0, 0.03, 0.04, 0.004], [0.001, 0.97, 0.0, 0.004, -0.005, 0.0]])
    inputs, speeds = 0.1 * rng.normal(size=(rows, 3)), np.zeros((rows, 2))
    for n in range(30, rows - 1):
        for k, shift in ((0, 30), (1, 20)):
            x = np.concatenate([speeds[n], inputs[n + 1 - shift], [1.0]])
            speeds[n + 1, k] = truth[k] @ x

    @jax.jit
    def learned(bias):
        before = jnp.concatenate([jnp.zeros((1, 3)), jnp.asarray(inputs)[:-1]])

        def body(carry, row):
            window = model.push(carry[0], row[0], row[1], row[2])
            rates = jnp.array((0.03, 0.001))
            return (
                window,
                model.estimated(carry[1], window, jnp.zeros((), bool), rates, bias),
            ), None

        start = model.empty(), model.Linear(jnp.asarray(truth).at[0, 5].set(0.0))
        given = jnp.asarray(speeds), before, jnp.arange(rows) == 0
        return jax.lax.scan(body, start, given)[0][1].rows[0, 5]

    assert float(learned(1.0)) == pytest.approx(0.004, rel=0.1)
    assert float(learned(0.0)) == 0.0


def test_the_diagnosis_of_the_catamaran_is_not_judged_by_manoeuvres_that_it_saw():
    campaign = modules("vrx_wamv", "campaign")["campaign"]
    seen, judged = campaign.explored(1), campaign.held_out(2)
    assert len(seen) == 4
    for one in seen:
        for other in judged:
            assert np.abs(one.port - other.port).mean() > 2.0 or (
                np.abs(one.starboard - other.starboard).mean() > 2.0
            )
