# pyright: reportArgumentType=false
"""The unberthing experiment: its quick run, and its pieces against closed forms and scipy."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from tests.experiment_runs import modules, quick_run
from tests.paths import ROOT

from diffsea import Environment, State
from diffsea.simulation.integrate import advance, begin, history_lengths


pytestmark = pytest.mark.experiment


FOLDER = ROOT / "experiments" / "unberthing"
PLACES = (str(FOLDER), str(FOLDER.parent))
MODULES = (
    "harbour_ship", "harbour_route", "gradient_model", "track_lqr", "guarded_model",
    "harbour_estimators", "unberthing_system", "unberthing_loop", "unberthing_scores",
)  # fmt: skip
DEGREE, KNOT = np.pi / 180, 1852 / 3600


@pytest.fixture(scope="module")
def parts():
    """The experiment's modules."""
    found = modules("unberthing", *MODULES)
    return SimpleNamespace(**found)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """results.json of the quick variant."""
    out = tmp_path_factory.mktemp("unberthing")
    found = quick_run("unberthing", out)
    panels = {"exp_1", "exp_2", "exp_3"}
    drawn = {p.stem for p in (out / "figures").glob("*.png")}
    assert drawn == {"route", "unberthing", "leaving", "seeds"} | panels
    return found


def obtained(results, start):
    (row,) = (row for row in results["comparison"] if row["quantity"].startswith(start))
    return row["obtained"]


# -- the quick run ---------------------------------------------------------------------------


@pytest.mark.proof
def test_results_have_every_published_figure(results):
    assert results["experiment"] == "unberthing" and results["quick"]
    rows = results["comparison"]
    assert all({"quantity", "unit", "published", "obtained", "note"} == set(row) for row in rows)
    published = [row["published"] for row in rows]
    for figure in (1.6, 7.1, 520.0, 1.4, -4.1, -3.5, 3.1, -4.0, -3.9):
        assert figure in published
    assert all(row["obtained"] is not None for row in rows)


def test_the_published_failure_appears_and_the_cure_holds_the_line(results):
    assert int(obtained(results, "thrusters turned the wrong way").split()[0]) >= 1
    assert obtained(results, "gamma_vB below zero in Exp. 1") == "in 4 of 4 draws"
    assert 350 < obtained(results, "when that began") < 600
    cured = obtained(results, "same, least squares")
    assert cured < 0.7 * obtained(results, "Exp. 1, Step 2")
    assert cured < 8.0


def test_leaving_is_as_published_and_needs_the_compensation_the_other_way_round(results):
    for name in ("Exp. 2", "Exp. 3"):
        worst = max(abs(obtained(results, f"{name}, Step {k}")) for k in (3, 4, 5))
        without = obtained(results, f"{name}, largest deviation, without")
        printed = obtained(results, f"{name}, largest deviation, eq. 16 as printed")
        assert 1.0 < worst < 7.0
        assert 1.3 * worst < without and 1.3 * without < printed
        assert obtained(results, f"{name}: c_v") < -2e-4
        assert obtained(results, f"{name}: gamma_r_delta") > 1.1


def test_seeds_are_summed_up_with_intervals(results):
    for one in results["beyond"]["systems"].values():
        low, high = one["wrong_way_interval"]
        assert one["runs"] == 4 and low <= one["wrong_way"] <= high
        assert one["finished"] == 1.0
        assert 0.5 < one["median_worst_step_2"] <= one["p95_worst_step_2"] < 200.0


# -- the published estimator -----------------------------------------------------------------


def test_powers_of_the_step_are_a_hundred_steps(parts):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(40, 6)) * [0.2, 0.01, 0.1, 0.1, 0.1, 1.0]
    G, b, theta = x.T @ x / 40, x.T @ rng.normal(size=40) / 40, rng.normal(size=6)
    plain = theta
    for _ in range(100):
        plain = plain - 2 * 0.03 * (G @ plain - b)
    got = parts.gradient_model.descended(jnp.array(theta), jnp.array(G), jnp.array(b), 0.03)
    np.testing.assert_allclose(got, plain, rtol=1e-10)


def test_normal_equations_line_up_speeds_and_delayed_inputs(parts):
    model = parts.gradient_model
    rng = np.random.default_rng(1)
    rows, start = 400, 30
    inputs = 0.1 * rng.normal(size=(rows, 3))
    truth = np.array([[0.98, 0.4, 0.0, 0.03, 0.04, 0.0], [0.001, 0.97, 0.0, 0.004, -0.005, 0.0]])
    speeds = np.zeros((rows, 2))
    for n in range(start, rows - 1):
        for k, shift in ((0, 30), (1, 20)):  # 15 s and 10 s at 2 Hz
            delayed = inputs[n + 1 - shift]
            speeds[n + 1, k] = truth[k] @ np.concatenate([speeds[n], delayed, [1.0]])

    @jax.jit
    def filled(speeds, inputs):
        before = jnp.concatenate([jnp.zeros((1, 3)), inputs[:-1]])

        def body(window, row):
            return model.push(window, row[0], row[1], row[2]), None

        fresh = jnp.arange(rows) == 0
        return jax.lax.scan(body, model.empty(), (speeds, before, fresh))[0]

    window = filled(jnp.array(speeds), jnp.array(inputs))
    for k, terms in enumerate(model.UNBERTHING):
        kept = np.flatnonzero(terms)
        G, b = model.normal_equations(window, k, jnp.array(terms, float))
        found = np.linalg.solve(np.asarray(G)[np.ix_(kept, kept)], np.asarray(b)[kept])
        np.testing.assert_allclose(found, truth[k][kept], rtol=1e-6, atol=1e-9)


def test_a_phase_counts_only_its_own_rows(parts):
    model = parts.gradient_model
    window, one = model.empty(), jnp.ones
    for fresh in (True, False, False, True, False):
        window = model.push(window, one(2), one(3), jnp.asarray(fresh))
    assert np.asarray(window.counted).tolist()[-5:] == [False, False, False, False, True]


def test_the_series_is_the_matrix_exponential(parts):
    rng = np.random.default_rng(2)
    A, B = 0.04 * rng.normal(size=(3, 3)), rng.normal(size=(3, 4))
    whole = expm(0.5 * np.block([[A, B], [np.zeros((4, 7))]]))
    phi, gamma = parts.gradient_model.discrete(jnp.array(A), jnp.array(B))
    np.testing.assert_allclose(phi, whole[:3, :3], atol=2e-7)
    np.testing.assert_allclose(gamma, whole[:3, 3:], atol=2e-7)


def test_the_linear_model_has_the_ships_signs(parts):
    linear = parts.gradient_model.nominal_linear(parts.harbour_ship.nominal(), jnp.asarray(0.5))
    (rudder, bow, stern), (turn_r, turn_b, turn_s) = np.asarray(linear.inputs)
    assert bow > 0 and stern > 0 and rudder < 0  # a rudder to starboard pushes the stern to port
    assert turn_r > 0 and turn_b > 0 and turn_s < 0
    # At rest, half a second of the bow thruster's force over the masses in sway and in yaw.
    push = 0.5 * parts.harbour_ship.BOW_FORCE / (1 + (0.5 / 1.8) ** 2)
    assert bow == pytest.approx(push / 2.164e6, rel=0.01)
    assert turn_b == pytest.approx(21.0 * push / 3.363e8, rel=0.01)


# -- tracking, route and limits --------------------------------------------------------------


@pytest.mark.parametrize("leaving", [False, True])
def test_gains_are_those_of_scipys_riccati_equation(parts, leaving):
    lqr, ship = parts.track_lqr, parts.harbour_ship
    linear = parts.gradient_model.nominal_linear(ship.nominal(), jnp.asarray(1.5))
    got = np.asarray(lqr.lateral_gain(linear, 1.5, jnp.asarray(leaving), lqr.bryson()))
    phi, gamma = np.asarray(linear.transition), np.asarray(linear.inputs)
    used = [0] if leaving else [1, 2]
    A = np.eye(4)
    A[:2, :2], A[2, 0], A[3, 1], A[2, 3] = phi, 0.5, 0.5, 0.5 * 1.5 * leaving
    B = np.vstack([gamma[:, used], np.zeros((2, len(used)))])
    Q = np.diag(np.array(lqr.WORST) ** -2.0)
    R = np.diag(np.array(lqr.WORST_BLADES)[used] ** -2.0)
    P = solve_discrete_are(A, B, Q, R)
    expected = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(got[used], expected, rtol=1e-5, atol=1e-8)
    np.testing.assert_array_equal(np.delete(got, used, axis=0), 0.0)


@pytest.mark.parametrize(
    ("knots", "rudder"),
    [(2.0, 35), (3.9, 35), (4.1, 30), (5.5, 25), (6.5, 20), (7.5, 15), (8.5, 10)],
)
def test_limits_are_table_1s(parts, knots, rudder):
    wanted, still = jnp.full(4, 9.0), jnp.zeros(4)
    made = parts.track_lqr.limited(wanted, still, knots * KNOT, jnp.asarray(True)) / DEGREE
    np.testing.assert_allclose(made, [0.125, rudder, 0.0, 0.0], atol=1e-9)
    high = 8.7 if knots >= 4 else 6.0
    slow = parts.track_lqr.limited(wanted, wanted, knots * KNOT, jnp.asarray(False)) / DEGREE
    assert float(slow[0]) == pytest.approx(9.0 / DEGREE - 0.125)  # out of range, it comes back
    near = jnp.array([high, 0.0, 11.0, 9.0]) * DEGREE
    kept = parts.track_lqr.limited(wanted, near, knots * KNOT, jnp.asarray(False)) / DEGREE
    np.testing.assert_allclose(kept, [high, 0.0, 11.0, 9.0], atol=1e-9)


def test_a_push_to_port_is_met_with_starboard_rudder(parts):
    gain = jnp.zeros((3, 4)).at[0, 3].set(2.0)
    assert float(parts.track_lqr.compensation(gain, -1e-3)) == pytest.approx(2.0 * 16 * 1e-3)


def test_the_route_has_no_jumps_and_counts_starboard_positive(parts):
    route = parts.harbour_route

    def at(step, x, y, psi):
        state = parts.unberthing_loop.started(1.0, x, y)
        state = type(state)(state.x, state.y, jnp.asarray(psi), state.u, state.v, state.r)
        return route.place(jnp.asarray(float(step)), state)

    turn, radius = float(route.TURN), route.RADIUS
    end = 600 + radius * np.sin(turn), -40 + radius * (1 - np.cos(turn))
    corners = ((2, 300.0, -40.0, 0.0), (3, 600.0, -40.0, 0.0), (4, *end, turn))
    for step, x, y, psi in corners:
        before, after = at(step, x, y, psi), at(step + 1, x, y, psi)
        assert [float(p.cross) for p in (before, after)] == pytest.approx([0, 0], abs=1e-9)
        assert [float(p.psi_d) for p in (before, after)] == pytest.approx([0, 0], abs=1e-9)
        assert float(after.along) == pytest.approx(0.0, abs=1e-9)
        starboard = at(step + 1, x - 3 * np.sin(psi), y + 3 * np.cos(psi), psi + 0.1)
        assert float(starboard.cross) == pytest.approx(3.0, abs=0.01)
        assert float(starboard.psi_d) == pytest.approx(0.1, abs=0.01)
        for metres, number in ((-1.0, step), (1.0, step + 1)):
            there = at(step, x + metres * np.cos(psi), y + metres * np.sin(psi), psi)
            assert float(route.next_step(jnp.asarray(float(step)), there, 0.0)) == number


@pytest.mark.parametrize("step", [1, 2, 3, 4, 5])
def test_the_route_as_drawn_is_the_one_that_is_kept(parts, step):
    """On its line a ship is off neither track nor course, and at its end the next step begins."""
    route, line = parts.harbour_route, parts.harbour_route.line(step)
    course = 0.0 if step == 1 else np.arctan2(*(line[1] - line[0])[::-1])
    at = jax.vmap(lambda x, y: route.place(jnp.asarray(float(step)), State(x, y, course, 0, 0, 0)))
    along = at(*line.T)
    np.testing.assert_allclose(along.cross, 0.0, atol=1e-3)
    bend = step == 4
    np.testing.assert_allclose(along.psi_d[0], 0.0, atol=0.02 if bend else 1e-6)
    assert np.all(np.diff(along.along) > 0)
    begins = np.asarray(jax.vmap(lambda one: route.next_step(float(step), one, 0.0))(along))
    assert begins[len(line) // 2] == step
    past = at(*(line[-1] + 1e-3 * (line[-1] - line[-2]))[:, None])
    assert float(route.next_step(float(step), jax.tree.map(lambda leaf: leaf[0], past), 0.0)) > step
    if step > 1:
        np.testing.assert_allclose(line[0], route.line(step - 1)[-1], atol=1e-9)


# -- scores ----------------------------------------------------------------------------------


def a_log(parts, off, force, step=2.0):
    rows = len(off)
    return SimpleNamespace(
        step=np.full(rows, step), Y_d=np.asarray(off), side_force=np.full(rows, force)
    )


def test_wrong_way_needs_time_distance_and_a_push_outwards(parts):
    wrong = parts.unberthing_scores.wrong_way
    t = 0.5 * np.arange(60)
    leaving_line, coming_back = 3.0 + 0.1 * t, 8.0 - 0.1 * t
    assert wrong(a_log(parts, leaving_line, 5e3)).all()
    assert not wrong(a_log(parts, leaving_line, -5e3)).any()
    assert not wrong(a_log(parts, leaving_line, 1e3)).any()
    assert not wrong(a_log(parts, coming_back, 5e3)).any()
    assert not wrong(a_log(parts, leaving_line - 2.9, 5e3))[:30].any()
    assert not wrong(a_log(parts, leaving_line, 5e3, step=3.0)).any()
    assert wrong(a_log(parts, -leaving_line, -5e3)).all()


def test_short_flags_do_not_last(parts):
    flags = np.array([1, 1, 0, 1, 1, 1, 0, 0, 1, 1, 1, 1], bool)
    kept = parts.unberthing_scores.lasting(flags, 3)
    assert kept.astype(int).tolist() == [0, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 1]


def test_wilsons_interval(parts):
    # Brown, Cai and DasGupta (2001): none of n gives z^2 / (n + z^2) as the upper end.
    low, high = parts.unberthing_scores.wilson(0, 100)
    assert (low, high) == pytest.approx((0.0, 3.8415 / 103.8415), abs=1e-5)
    low, high = parts.unberthing_scores.wilson(50, 100)
    assert (low + high) / 2 == pytest.approx(0.5) and high - low == pytest.approx(0.1923, abs=1e-3)


# -- the ship --------------------------------------------------------------------------------


def test_a_seeds_ship_differs_and_seed_zero_is_the_catalogues(parts):
    ship = parts.harbour_ship
    nominal, same, other = ship.nominal(), ship.ship(0), ship.ship(7)
    read = lambda v: float(v.actuators["bow"].effectiveness)  # noqa: E731
    assert read(same) == read(nominal) == 1.0 and read(other) != 1.0
    one, again = (ship.drawn(7) for _ in range(2))
    assert one == again and one != ship.drawn(8)


def test_the_tide_runs_as_the_conditions_say(parts):
    ship = parts.harbour_ship
    air = ship.weather(ship.Conditions(0.2, np.pi / 2, 0.5, 440.0, 880.0, 0.0, 0.0), 1, 1000)
    east, t = np.asarray(air.current_east), 0.5 * np.arange(1000)
    assert t[east.argmax()] == 440.0 and east.max() == pytest.approx(0.2)
    assert east[0] == pytest.approx(0.1) and np.abs(air.current_north).max() < 1e-12
    assert np.abs(air.wind_north).max() == 0.0


def test_thrusters_push_the_resting_ship_sideways_by_force_over_mass(parts):
    ship = parts.harbour_ship
    vessel, still = ship.nominal(), parts.unberthing_loop.started(0.0)
    angles = jnp.array([0.0, 0.0, -11.0, -9.0]) * DEGREE
    u_dot, v_dot, r_dot = vessel.acceleration(still, ship.orders(angles), vessel.environment, 0.0)
    assert float(u_dot) == pytest.approx(0.0, abs=1e-6)
    assert float(v_dot) == pytest.approx(-60e3 / 2.164e6, rel=1e-3)
    assert float(r_dot) == pytest.approx(-30e3 * (21 - 18) / 3.363e8, rel=1e-3)


def test_a_control_period_is_a_fine_enough_step(parts):
    ship, loop = parts.harbour_ship, parts.unberthing_loop
    vessel = ship.ship(7)
    lengths = history_lengths(vessel, 0.125, longest=8.0)
    still = {c: jnp.zeros(()) for c in vessel.channels}
    air = Environment(0.1, 0.1, -4.0, 3.0)

    @jax.jit
    def end(parts_of_a_period):
        dt = 0.5 / parts_of_a_period

        def body(motion, k):
            t = k * dt
            thrusters = jnp.where(t < 40.0, 1.0, -0.5) * jnp.array([0.0, 0.0, 8.0, -5.0])
            rudder = jnp.where(t >= 60.0, jnp.array([5.0, 10.0, 0.0, 0.0]), 0.0)
            ordered = ship.orders((thrusters + rudder) * DEGREE)
            moved = advance(vessel, motion, ordered, air, t, dt)
            over = t >= 100.0 - 1e-9
            return jax.tree.map(lambda a, b: jnp.where(over, a, b), motion, moved), None

        begun = begin(vessel, loop.started(0.5), still, lengths)
        return jax.lax.scan(body, begun, jnp.arange(800.0))[0].state

    coarse, fine = end(1.0), end(4.0)
    assert float(jnp.hypot(coarse.x - fine.x, coarse.y - fine.y)) < 2e-3
    assert float(jnp.abs(coarse.psi - fine.psi)) < 1e-4
    assert float(fine.x) > 30.0 and abs(float(fine.psi)) > 0.05
