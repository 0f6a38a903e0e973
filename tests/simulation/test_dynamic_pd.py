# pyright: reportArgumentType=false
"""The PD law for pairs of thrusters: its formula, its decisions, its derivatives."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffsea import Outcome, State, UserError, read_vessel, run_controlled
from diffsea.simulation.control.waypoints import DynamicPD, dynamic_pd
from diffsea.vessel.files import build


WAY = np.array([[10.0, 0.0], [10.0, 12.0], [-6.0, 12.0]])
NUMBERS = {
    "K_p": 5.0, "K_d": 2.0, "T_f": 0.4, "base_min": 10.0, "base_max": 26.0, "near": 3.0,
    "far": 9.0, "radius": 1.5, "largest": 28.0,
}  # fmt: skip
PERIOD = 0.2


def law_of(smoothing=0.0, **changes):
    return DynamicPD(jnp.asarray(WAY), **(NUMBERS | changes), smoothing=smoothing)


def state_at(x, y, psi):
    return State(*(jnp.asarray(value, float) for value in (x, y, psi, 0.0, 0.0, 0.0)))


def by_the_formula(motions):
    """Orders of eq. 18 and Algorithm 1 for a series of (x, y, psi), one at a time."""
    n, before, derivative, number = NUMBERS, None, 0.0, 0
    for x, y, psi in motions:
        if math.dist((x, y), WAY[number]) < n["radius"]:
            number += 1
        north, east = WAY[number][0] - x, WAY[number][1] - y
        error = (psi - math.atan2(east, north) + math.pi) % (2 * math.pi) - math.pi
        distance = math.hypot(north, east)
        change = 0.0 if before is None else error - before
        change = (change + math.pi) % (2 * math.pi) - math.pi
        share = n["T_f"] / (n["T_f"] + PERIOD)
        gain = n["K_d"] * math.log(1 + abs(math.degrees(error))) / (n["T_f"] + PERIOD)
        derivative = share * derivative + gain * change
        difference = n["K_p"] * math.log(1 + distance) * error + derivative
        if distance < n["near"] and abs(error) < math.radians(10):
            base = n["base_min"]
        elif distance < n["near"]:
            base = 0.5 * (n["base_min"] + n["base_max"])
        elif distance <= n["far"]:
            slope = (distance - n["near"]) / (n["far"] - n["near"])
            base = n["base_min"] + (n["base_max"] - n["base_min"]) * slope
        else:
            base = n["base_max"]
        before = error
        yield tuple(np.clip([base - difference, base + difference], -28.0, 28.0))


def test_orders_are_those_of_the_formula():
    rng = np.random.default_rng(3)
    corners = np.concatenate([np.zeros((1, 2)), WAY])
    place = np.stack([np.interp(np.linspace(0, 2.8, 60), range(4), axis) for axis in corners.T], -1)
    motions = np.column_stack([place, np.linspace(0, 6, 60)]) + rng.normal(0, 0.3, (60, 3))
    law, memory, found = law_of(), law_of().init(), []
    step = eqx.filter_jit(law.step)
    for motion in motions:
        memory, orders = step(memory, state_at(*motion), 0.0, PERIOD)
        found.append((float(orders["port"]), float(orders["starboard"])))
    expected = np.array(list(by_the_formula(motions)))
    assert int(memory.number) == 2  # two waypoints were passed on the way
    assert np.ptp(expected) > 30
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("distance", "degrees", "order"),
    [(2.0, 5.0, 10.0), (2.0, -5.0, 10.0), (2.0, 20.0, 18.0), (2.0, -20.0, 18.0), (6.0, 90.0, 18.0),
     (7.5, 0.0, 22.0), (30.0, 90.0, 26.0)],
)  # fmt: skip
def test_base_order_is_that_of_algorithm_1_for_errors_to_either_side(distance, degrees, order):
    base = law_of().base(jnp.asarray(distance), jnp.deg2rad(degrees))
    assert float(base) == pytest.approx(order)


@pytest.mark.parametrize("smoothing", [0.0, 0.5])
def test_an_error_to_starboard_turns_to_port(smoothing):
    law = law_of(smoothing)
    _, orders = law.step(law.init(), state_at(0.0, 0.0, 0.3), 0.0, PERIOD)
    assert float(orders["port"]) < float(orders["starboard"])


def test_smooth_decisions_agree_with_steps_away_from_thresholds():
    hard, soft = law_of(), law_of(0.5)
    for place in ((0.0, 0.0, 0.3), (9.0, 14.0, -2.0), (4.0, 3.0, 1.0)):
        _, one = hard.step(hard.init(), state_at(*place), 0.0, PERIOD)
        _, other = soft.step(soft.init(), state_at(*place), 0.0, PERIOD)
        for channel in one:
            assert float(other[channel]) == pytest.approx(float(one[channel]), abs=0.02)


def closed(vessel, law, seconds):
    start = State(*(jnp.zeros(()) for _ in range(6)))
    return run_controlled(vessel, law, start, seconds, PERIOD, PERIOD)


@pytest.fixture(scope="module")
def boat():
    return read_vessel("vrx_wamv").vessel


def test_a_boat_passes_every_waypoint_within_the_radius(boat):
    run = eqx.filter_jit(closed)(boat, law_of(), 120.0)
    rows = run.trajectory
    assert int(rows.outcome) == Outcome.COMPLETED
    kept = np.asarray(rows.valid)
    track = np.stack([rows.x, rows.y], -1)[kept]
    apart = np.linalg.norm(track[:, None] - WAY, axis=-1).min(0)
    assert np.all(apart < NUMBERS["radius"] + 1.6 * PERIOD)
    assert np.abs(np.asarray(rows.commanded["port"])).max() <= NUMBERS["largest"]


def test_derivatives_through_the_smooth_loop_are_those_of_differences(boat):
    """At the last row of a run round a corner, by gain, filter, base order and threshold."""
    names = ("K_p", "K_d", "T_f", "base_min", "far", "radius")

    def end(values):
        run = closed(boat, law_of(0.5, **dict(zip(names, values, strict=True))), 40.0)
        return jnp.stack([run.trajectory.x[-1], run.trajectory.y[-1], run.trajectory.psi[-1]])

    at = jnp.array([NUMBERS[name] for name in names])
    found = np.asarray(jax.jit(jax.jacfwd(end))(at))
    fast = jax.jit(end)
    for k in range(len(names)):
        step = 1e-5 * float(at[k]) * np.eye(len(names))[k]
        difference = (np.asarray(fast(at + step)) - np.asarray(fast(at - step))) / (2 * step[k])
        scale = np.abs(found[:, k]).max()
        assert scale > 1e-4
        np.testing.assert_allclose(found[:, k], difference, atol=2e-3 * scale)


def test_the_pair_is_found_by_the_side_it_is_on(boat):
    law = dynamic_pd(boat, WAY, **NUMBERS)
    assert (law.port, law.starboard) == ("port", "starboard")


def test_a_thruster_that_pushes_across_is_none_of_the_pair(boat):
    document = read_vessel("wamv").document
    stern = {"name": "stern", "x": -1.0, "y": 0.4, "angle": np.pi / 2}
    tug = build(document | {"thruster": [*document["thruster"], stern]})
    assert dynamic_pd(tug, WAY, **NUMBERS).starboard == "starboard"


def test_a_vessel_without_a_pair_is_refused():
    with pytest.raises(UserError, match="0 fixed thrusters to port and 0 to starboard"):
        dynamic_pd(read_vessel("kvlcc2").vessel, WAY, **NUMBERS)
