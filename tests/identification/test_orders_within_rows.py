"""Recordings that are sampled fast are thinned; a servo still meets every order at its time."""

import copy

import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE

from diffsea import Trajectory
from diffsea.identification.coordinates import vessel_at
from diffsea.identification.filter.kalman import filter_rows
from diffsea.identification.filter.latency import SamplePlacement
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


STEP = 0.02  # s
LAG = 0.4  # s


def recording(orders: dict[str, np.ndarray], step: float = STEP) -> Trajectory:
    """At rest, whatever is ordered."""
    t = step * np.arange(len(next(iter(orders.values()))))
    rest = np.zeros(t.size)
    return Trajectory(
        t=t, x=rest, y=rest, psi=rest, u=rest, v=rest, r=rest,
        commanded=orders, executed={}, extra={}, valid=np.ones(t.size, bool),
    )  # fmt: skip


def executed(orders: np.ndarray, delay: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) of the rows that a data set has, and what the port thruster has reached there."""
    document = copy.deepcopy(load(str(ORACLE / "usv.toml")))
    for thruster in document["thruster"]:
        thruster["time_constant"] = LAG
        if delay:
            thruster["delay"] = delay
    run = recording({"port": orders, "starboard": np.zeros(orders.size)})
    problem = make_problem(build(document), [run], ("X_u",))
    vessel, flows = vessel_at(problem.base, problem.layout, jnp.zeros(problem.layout.size))
    found = filter_rows(vessel, flows, problem.dataset, SamplePlacement.as_stamped(problem.dataset))
    rows = np.asarray(problem.dataset.recorded_rows)
    ends = np.asarray(found.run_time + found.dt)[rows]
    return ends[:-1], np.asarray(found.response["port"].final)[rows][:-1]


def test_a_lead_in_is_at_its_own_first_order_and_not_at_the_last_of_the_run_before():
    """A slow lag would have kept half of it."""
    document = copy.deepcopy(load(str(ORACLE / "usv.toml")))
    for thruster in document["thruster"]:
        thruster["time_constant"] = 3.0
    runs = [
        recording({"port": np.full(500, one), "starboard": np.zeros(500)}) for one in (90.0, 20.0)
    ]
    problem = make_problem(build(document), runs, ("X_u",))
    vessel, flows = vessel_at(problem.base, problem.layout, jnp.zeros(problem.layout.size))
    data = problem.dataset
    found = filter_rows(vessel, flows, data, SamplePlacement.as_stamped(data))
    for number, order in enumerate((90.0, 20.0)):
        rows = data.lead_in & (np.asarray(data.run) == number)
        assert rows.sum() > 3
        np.testing.assert_allclose(np.asarray(found.response["port"].middle)[rows], order)


def lagged(orders: np.ndarray) -> np.ndarray:
    """What a lag makes of orders, by its exact solution from sample to sample."""
    out, reached = [], orders[0]
    for order in orders:
        out.append(reached)
        reached = order + (reached - order) * np.exp(-STEP / LAG)
    return np.array(out)


@pytest.mark.parametrize("late", range(1, 8))
def test_a_step_between_rows_acts_from_its_own_time_on(late):
    orders = np.where(np.arange(400) < 100 + late, 0.0, 50.0)
    t, reached = executed(orders)
    assert len(t) < 100  # thinned
    np.testing.assert_allclose(reached, lagged(orders)[np.rint(t / STEP).astype(int)], atol=1e-9)


@pytest.mark.parametrize("delay", [1, 3, 8, 31])
def test_delayed_orders_do_too(delay):
    """Orders that change at random instants, three in two rows at most."""
    rng = np.random.default_rng(delay)
    orders = np.repeat(rng.normal(20.0, 10.0, 100), rng.integers(6, 20, 100))
    t, reached = executed(orders, delay * STEP)
    late = np.concatenate([np.full(delay, orders[0]), orders])
    np.testing.assert_allclose(reached, lagged(late)[np.rint(t / STEP).astype(int)], atol=1e-9)


def test_two_steps_in_one_row_are_both_met():
    orders = np.zeros(400)
    orders[203:205] = 50.0
    t, reached = executed(orders)
    np.testing.assert_allclose(reached, lagged(orders)[np.rint(t / STEP).astype(int)], atol=1e-9)


def test_of_orders_that_never_rest_the_means_are_met():
    """Thirds of a row, a few hundredths of a second, against a lag of 0.4 s."""
    orders = np.random.default_rng(3).normal(20.0, 10.0, 400)
    orders[:20] = 20.0
    t, reached = executed(orders)
    exact = lagged(orders)[np.rint(t / STEP).astype(int)]
    assert np.abs(reached - exact).max() < 1.0
    assert np.abs(reached - exact).mean() < 0.1 * np.std(exact)


@pytest.mark.parametrize(
    ("of_time", "rows"), [(0.16, 2), (0.18, 2), (0.21, 2), (0.23, 1), (0.3, 1), (0.5, 1), (0.06, 5)]
)
def test_thinning_comes_as_near_to_the_pace_of_the_vessel_as_rows_allow(of_time, rows):
    """Both neighbours of 0.3 sqrt(L / g) are as far from it by their ratio at sqrt(1 / 2)."""
    document = load(str(ORACLE / "usv.toml"))
    step = of_time * np.sqrt(build(document).rigid_body.length / 9.81)
    run = recording({name: np.zeros(300) for name in ("port", "starboard")}, step)
    problem = make_problem(build(document), [run], ("X_u",))
    assert int(problem.dataset.recorded_rows.sum()) == -(-300 // rows)
    assert problem.dataset.substeps == (2 if of_time > 0.45 else 1)
