"""Numbers of missions tuned by derivatives: exact ones, a known optimum, paths that judge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffsea
from diffsea.missions import mission_of, run, scores
from diffsea.missions.numbers import settled, with_numbers
from diffsea.missions.performance import cost_residuals
from diffsea.missions.running import assemble, closed_loop, timing
from diffsea.missions.studies.sweep import closed_loop_sweep, quicker
from diffsea.missions.studies.tuning import mirrored, tune, turned
from diffsea.simulation.designs import Grid


def course(**changes):
    """The Otter on two courses, by calm water."""
    return mission_of(
        {
            "vessel": {"name": "otter"},
            "controller": {"kind": "course"},
            "step": [
                {"time": 0.0, "heading": 0.3, "speed": 1.0},
                {"time": 8.0, "heading": 1.2, "speed": 1.0},
            ],
            "seconds": 25.0,
            "time_step": 0.05,
            "period": 0.1,
        }
        | changes
    )


def path(**changes):
    """A zig-zag of legs for the Otter in calm water."""
    return mission_of(
        {
            "vessel": {"name": "otter"},
            "controller": {"kind": "line-of-sight", "speed": 1.2, "radius": 3.0},
            "waypoint": [{"x": 0.0, "y": 5.0}, {"x": 20.0, "y": 5.0}, {"x": 30.0, "y": 20.0}],
            "time_step": 0.05,
            "period": 0.25,
        }
        | changes
    )


def test_derivatives_through_the_closed_loop_are_those_of_differences():
    names = ("controller.heading.gain", "controller.heading.rate_gain", "model.X_u")
    mission = settled(course(), names)
    at = jnp.array([1.5, 2.0, -70.0])

    def cost(values):
        changed = with_numbers(mission, dict(zip(names, values, strict=True)))
        loop = closed_loop(assemble(changed, timing(mission)))
        return jnp.sum(cost_residuals(changed, loop, 1.0) ** 2)

    exact = np.asarray(jax.jit(jax.jacfwd(cost))(at))
    compiled = jax.jit(cost)
    for k, name in enumerate(names):
        step = 1e-4 * float(abs(at[k]))
        ends = [float(compiled(at.at[k].add(side * step))) for side in (1, -1)]
        ahead = [float(compiled(at.at[k].add(side * 2 * step))) for side in (1, -1)]
        central = (8 * (ends[0] - ends[1]) - (ahead[0] - ahead[1])) / (12 * step)
        assert exact[k] == pytest.approx(central, rel=1e-5), name


@pytest.mark.proof
def test_tuning_finds_the_least_cost_of_a_grid_from_afar():
    mission = course()
    ranges = {"heading.gain": (0.2, 4.0)}
    found = tune(mission, ranges, starts=2, effort=0.05)
    assert found.after["controller.heading.gain"] != found.before["controller.heading.gain"]
    best = min(found.starts, key=lambda one: one.cost)
    assert found.after == best.found
    assert best.cost < min(one.cost_before for one in found.starts)
    # The cost of a grid, by the runs alone: mean squares of errors and of changes of orders.
    grid = closed_loop_sweep(mission, Grid({"heading.gain": (0.2, 4.0, 20)})).table
    costs = (
        (grid["heading_rms"] / np.radians(10)) ** 2
        + (grid["speed_rms"] / 0.1) ** 2
        + 0.05 * grid["effort"] ** 2
    )
    least = grid["controller.heading.gain"][costs.idxmin()]
    assert found.after["controller.heading.gain"] == pytest.approx(least, abs=0.2)
    assert best.cost <= costs.min() * 1.001
    judge = [one for one in found.paths if not one.tuned_on]
    assert len(judge) == 1 and judge[0].after["cost"] < judge[0].before["cost"]


@pytest.mark.proof
def test_a_mission_that_judges_is_not_tuned_on():
    other = course(name="other", step=[{"time": 0.0, "heading": -1.0, "speed": 0.8}])
    found = tune(course(), {"heading.gain": (0.5, 3.0)}, [other], starts=1)
    assert [(one.name, one.tuned_on) for one in found.paths][-1] == ("other", False)
    alone = scores(run(with_numbers(settled(other, []), found.after)))
    assert found.paths[-1].after["heading_rms"] == pytest.approx(alone["heading_error"]["rms"])


@pytest.mark.parametrize("make", [course, path], ids=["course", "path"])
def test_a_mirrored_mission_is_run_as_its_picture(make):
    one = make()
    first, second = run(one).true, run(mirrored(one)).true
    axis = 0.3 if make is course else 0.0
    cos, sin = np.cos(axis), np.sin(axis)

    def about_axis(motion):
        north, east = motion.x - motion.x[0], motion.y - motion.y[0]
        return cos * north + sin * east, cos * east - sin * north

    (along, across), (along_2, across_2) = about_axis(first), about_axis(second)
    np.testing.assert_allclose(along_2, along, atol=1e-6)
    np.testing.assert_allclose(across_2, -across, atol=1e-6)
    assert np.abs(across).max() > 1.0


def test_a_turned_mission_is_the_same_in_calm_water():
    one = path()
    first, second = scores(run(one)), scores(run(turned(one)))
    assert second["path_error"]["rms"] == pytest.approx(first["path_error"]["rms"], rel=1e-6)
    points = turned(one).waypoints
    assert (points[0].x, points[0].y) == (0.0, 5.0)
    assert np.hypot(points[1].x, points[1].y - 5.0) == pytest.approx(20.0)
    assert points[1].y - 5.0 == pytest.approx(20.0 * np.sin(2 * np.pi / 3))


def test_what_cannot_be_tuned_is_refused():
    with pytest.raises(diffsea.UserError, match="give the lower number first"):
        tune(course(), {"heading.gain": (2.0, 1.0)})
    orders = {"time": 0.0, "orders": {"port": 5.0, "starboard": 5.0}}
    timed = mission_of(
        {
            "vessel": {"name": "otter"},
            "controller": {"kind": "orders"},
            "step": [orders],
            "seconds": 10.0,
        }
    )
    with pytest.raises(diffsea.UserError, match="no error to tune by"):
        tune(timed, {"vessel.mass": (60.0, 90.0)})


def test_lanes_run_half_as_long_again_as_the_mission():
    mission = settled(path(), [])
    times = timing(mission)
    stands = run(mission)
    took = float(stands.true.t[-1])
    assert quicker(times, stands).seconds == pytest.approx(1.5 * took, abs=0.3)
    assert quicker(times, None) == times
    timed = timing(course())
    assert quicker(timed, run(course())) == timed


def test_gains_that_diverge_cost_more_than_any_that_do_not():
    wild = with_numbers(course(), {"vessel.mass": -50.0})
    names = ("controller.heading.gain",)
    mission = settled(wild, names)

    def cost(gain):
        changed = with_numbers(mission, {names[0]: gain})
        return jnp.sum(cost_residuals(changed, closed_loop(assemble(changed, times)), 1.0) ** 2)

    times = timing(mission)
    assert bool(jnp.isnan(jax.jit(cost)(2.0)))
    with pytest.raises(diffsea.UserError, match="no start could be run"):
        tune(wild, {"heading.gain": (1.0, 3.0)}, starts=1)
    found = closed_loop_sweep(wild, Grid({"heading.gain": (1.0, 3.0, 2)}))
    assert found.as_it_stands is None and found.table["outcome"].tolist() == ["diverged"] * 2


def test_a_mission_that_judges_has_the_numbers_that_are_tuned():
    other = path(controller={"kind": "pursuit", "speed": 1.2})
    with pytest.raises(diffsea.UserError, match="no number 'controller.lookahead'"):
        tune(path(), {"lookahead": (3.0, 9.0)}, [other])
