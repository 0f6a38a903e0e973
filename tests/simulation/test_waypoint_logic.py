# pyright: reportArgumentType=false
"""The waypoint logic: its cases, its blend, and the closed loop that it makes."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffsea import Outcome, State, UserError, read_vessel, run_controlled
from diffsea.simulation.control.waypoints import waypoint_logic
from diffsea.vessel.files import build


FULL_THRUST, FULL_ANGLE = 20.0, 0.47 * math.pi


@pytest.fixture(scope="module")
def vessel():
    return read_vessel("pytheas").vessel


def still(psi=0.0):
    return State(*(jnp.asarray(value, float) for value in (0.0, 0.0, psi, 0.0, 0.0, 0.0)))


def written_out(error, distance):
    """The cases of the paper's appendix B, one after another."""
    if abs(error) < math.pi / 2:
        return FULL_THRUST, FULL_ANGLE * error / (math.pi / 2)
    side = math.copysign(FULL_ANGLE, error)
    if distance <= 10:
        return FULL_THRUST / 3 * distance / 10, side
    return FULL_THRUST / 2, side


CASES = [(e, d) for e in (-3.1, -1.7, -1.5, -0.2, 0.0, 0.4, 1.56, 1.58, 3.0) for d in (3, 9.9, 15)]


@pytest.mark.parametrize(("error", "distance"), CASES)
def test_the_cases_are_those_of_the_paper(vessel, error, distance):
    demand = np.asarray(waypoint_logic(vessel, [[20.0, 0.0]]).demand(error, distance))
    np.testing.assert_allclose(demand, written_out(error, distance), rtol=2e-6, atol=1e-12)


def test_a_blend_comes_close_to_the_cases_away_from_their_limits(vessel):
    logic = waypoint_logic(vessel, [[20.0, 0.0]], sharpness=60.0)
    for error, distance in CASES:
        if abs(abs(error) - math.pi / 2) < 0.1 or abs(distance - 10) < 1:
            continue
        np.testing.assert_allclose(
            np.asarray(logic.demand(error, distance)),
            written_out(error, distance),
            rtol=0.0,
            atol=0.01 * FULL_THRUST,
        )


def test_a_blend_is_half_way_at_the_limit(vessel):
    thrust, angle = waypoint_logic(vessel, [[20.0, 0.0]], sharpness=60.0).demand(math.pi / 2, 30.0)
    assert float(thrust) == pytest.approx(0.75 * FULL_THRUST, rel=1e-3)
    assert float(angle) == pytest.approx(FULL_ANGLE, rel=1e-6)


def test_the_angle_has_its_slope_at_no_error(vessel):
    logic = waypoint_logic(vessel, [[20.0, 0.0]])
    slope = jax.grad(lambda error: logic.demand(error, 15.0)[1])(0.0)
    assert float(slope) == pytest.approx(FULL_ANGLE / (math.pi / 2), rel=1e-6)


def test_the_shorter_way_round_is_taken(vessel):
    # Heading 3 rad, the waypoint at -3 rad: 0.283 rad to starboard, whatever turns came before.
    logic = waypoint_logic(vessel, [[20 * math.cos(-3.0), 20 * math.sin(-3.0)]])
    for turns in (-1, 0, 2):
        _, orders = logic.step(logic.init(), still(3.0 + 2 * math.pi * turns), 0.0, 0.05)
        expected = FULL_ANGLE * (2 * math.pi - 6.0) / (math.pi / 2)
        assert float(orders["thruster.angle"]) == pytest.approx(expected, rel=1e-5)
        assert float(orders["thruster.force"]) == FULL_THRUST


def run(vessel, waypoints, seconds=60.0, start=None, **fields):
    start = still() if start is None else start
    logic = waypoint_logic(vessel, waypoints, **fields)
    return run_controlled(vessel, logic, start, seconds, 0.05).trajectory


def test_waypoints_are_reached_in_their_order(vessel):
    points = [[12.0, 0.0], [12.0, 12.0], [0.0, 6.0]]
    track = jax.jit(lambda: run(vessel, points, tolerance=1.5))()
    assert int(track.outcome) == Outcome.COMPLETED
    valid = np.asarray(track.valid)
    x, y = np.asarray(track.x)[valid], np.asarray(track.y)[valid]
    first = [int(np.argmax(np.hypot(x - north, y - east) < 1.5)) for north, east in points]
    assert 0 < first[0] < first[1] < first[2]
    assert float(np.asarray(track.commanded["thruster.force"])[valid][:-1].min()) > 0


def test_orders_are_zero_where_the_last_waypoint_is_reached(vessel):
    logic = waypoint_logic(vessel, [[20.0, 0.0]])
    there = State(*(jnp.asarray(value) for value in (18.0, 0.5, 0.3, 1.0, 0.0, 0.0)))
    memory, orders = logic.step(logic.init(), there, 0.0, 0.05)
    assert bool(logic.is_finished(memory))
    assert {channel: float(order) for channel, order in orders.items()} == {
        "thruster.force": 0.0, "thruster.angle": 0.0,
    }  # fmt: skip


def test_a_mirrored_waypoint_gives_the_mirrored_run(vessel):
    both = jax.jit(jax.vmap(lambda point: run(vessel, point[None], 14.0)))(
        jnp.array([[-14.0, 14.0], [-14.0, -14.0]])
    )
    np.testing.assert_allclose(both.x[0], both.x[1], atol=1e-9)
    np.testing.assert_allclose(both.y[0], -both.y[1], atol=1e-9)
    assert float(jnp.abs(both.y[0]).max()) > 10.0


def test_a_thruster_abaft_the_mass_centre_turns_the_other_way(vessel):
    document = read_vessel("pytheas").document
    (table,) = document["azimuth_thruster"]
    aft = build(document | {"azimuth_thruster": [table | {"x": -0.4}]})
    ahead_logic, aft_logic = (waypoint_logic(one, [[0.0, 20.0]]) for one in (vessel, aft))
    _, ahead_orders = ahead_logic.step(ahead_logic.init(), still(0.8), 0.0, 0.05)
    _, aft_orders = aft_logic.step(aft_logic.init(), still(0.8), 0.0, 0.05)
    assert float(ahead_orders["thruster.angle"]) > 0.5
    assert float(aft_orders["thruster.angle"]) == -float(ahead_orders["thruster.angle"])
    track = jax.jit(lambda: run(aft, [[0.0, 20.0]]))()
    assert int(track.outcome) == Outcome.COMPLETED


def test_with_a_sharpness_the_closed_loop_is_differentiated_exactly(vessel):
    # Through a wide turn, its end, and the approach; against central differences.
    def end(values):
        track = run(vessel, [[-14.0, 10.0]], 8.0, full_thrust=values[0], near=values[1],
                    sharpness=15.0)  # fmt: skip
        return jnp.stack([track.x[-1], track.y[-1], track.psi[-1]])

    # Below the thruster's limit of 20 N, where half of a central difference is cut off.
    at, h = np.array([18.0, 10.0]), 1e-4
    exact = np.asarray(jax.jit(jax.jacfwd(end))(at))
    value = jax.jit(end)
    rough = [(value(at + h * e) - value(at - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(exact, np.stack(rough, axis=-1), rtol=1e-6, atol=1e-8)
    assert np.abs(exact[:, 0]).min() > 1e-3


def test_vessels_that_do_not_suit_are_told():
    with pytest.raises(UserError, match="'wamv' has 0 azimuth thrusters"):
        waypoint_logic(read_vessel("wamv").vessel, [[20.0, 0.0]])
    document = read_vessel("pytheas").document
    (table,) = document["azimuth_thruster"]
    without = {key: value for key, value in table.items() if key != "max_angle"}
    with pytest.raises(UserError, match="max_force and max_angle"):
        waypoint_logic(build(document | {"azimuth_thruster": [without]}), [[20.0, 0.0]])
