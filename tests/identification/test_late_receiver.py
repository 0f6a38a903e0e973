"""A receiver that is late, whose velocities over ground are turned by a heading that is not."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT
from tests.runs import random_steps, varied

from diffsea import EFFECTS, State, UserError, Vessel
from diffsea.diagnosis.screening import candidate_effects
from diffsea.identification.data.dataset import make_dataset
from diffsea.identification.filter.corrections import as_shown, corrected
from diffsea.identification.fit import estimate_surely
from diffsea.identification.problem import make_problem
from diffsea.missions.record import SensorErrors
from diffsea.missions.surroundings import instrumented
from diffsea.parameters import named
from diffsea.simulation.control.autopilot import AbstractController
from diffsea.simulation.sensed_motion import shown_motion, true_motion
from diffsea.vessel.files import build


RECEIVER, POSITION, VELOCITY = (
    f"sensor-latency:{one}" for one in ("receiver", "position", "velocity")
)
FREE = ("X_u", "X_uu", "N_r", "N_rr")
LATE = 0.35  # s


def received(seed: int, late: float = LATE, noise: float = 1.0):
    """A run as a log has it: fixes and velocities over ground of `late` before, the heading not."""
    rng, run = np.random.default_rng(seed), random_steps(DOCUMENT, seed, 60.0, 0.1, noise=0.0)
    then = lambda series: np.interp(run.t - late, run.t, series)
    shown = lambda series, std: series + noise * std * rng.normal(size=len(run.t))
    ground = (run.u + 1j * run.v) * np.exp(1j * run.psi)
    body = (then(ground.real) + 1j * then(ground.imag)) * np.exp(-1j * run.psi)
    motion = {"x": shown(then(run.x), 0.02), "y": shown(then(run.y), 0.02)}
    motion |= {"u": shown(body.real, 0.02), "v": shown(body.imag, 0.02)}
    motion |= {"psi": shown(run.psi, 0.003), "r": shown(run.r, 0.003)}
    return dataclasses.replace(run, **motion, name=f"run {seed}")


class Fixed(AbstractController):
    """Orders nothing."""

    def init(self):
        return None

    def step(self, memory, state, t, dt):
        return memory, {}

    def is_finished(self, memory):
        return jnp.asarray(False)


def late_vessel(late: float = LATE) -> Vessel:
    table = {"name": "sensor-latency", "delay": late, "channels": ["x", "y", "u", "v"]}
    return build(varied(DOCUMENT, effects=[table | {"turned_by": ["psi"]}]))


@pytest.mark.slow
def test_its_lateness_is_found_where_two_that_know_no_axes_find_neither():
    effects = tuple(EFFECTS[name] for name in (RECEIVER, POSITION, VELOCITY))
    problem = make_problem(build(DOCUMENT), [received(1), received(2)], FREE, effects)
    one = estimate_surely(problem, (*FREE, RECEIVER))
    two = estimate_surely(problem, (*FREE, POSITION, VELOCITY))
    size = problem.layout.sizes[0][0]
    delay = float(problem.layout.physical(RECEIVER, one.coordinates)[0, 0])
    assert abs(delay - LATE) < 2 * one.stds[-1] * size < 0.01
    assert (np.abs(one.coordinates[:4]) < 3 * one.stds[:4]).all()  # the drag of the vessel file
    apart = [float(problem.layout.physical(k, two.coordinates)[0, 0]) for k in (POSITION, VELOCITY)]
    assert max(apart) < 0.5 * LATE and one.deviance < two.deviance - 500


def test_velocities_are_put_back_into_the_axes_of_when_they_are_of():
    """Before any filter they are those in the vessel's axes, of so long before."""
    run, true = received(3, noise=0.0), random_steps(DOCUMENT, 3, 60.0, 0.1, noise=0.0)
    vessel = late_vessel()
    dataset = make_dataset(vessel, [run])
    plain, back = corrected(vessel, dataset)
    assert float(plain.sensors.latency_axes) == 0.0
    assert float(plain.sensors.latency_velocity) == LATE
    known = np.asarray(dataset.known)[:, 3] & (np.asarray(dataset.run_time) > 1.0)
    t = np.asarray(dataset.run_time)[known] - LATE
    for k, series in ((3, true.u), (4, true.v)):
        then, off = np.interp(t, true.t, series), 2e-3
        assert np.abs(np.asarray(back.measured)[known, k] - then).max() < off
        assert np.abs(np.asarray(dataset.measured)[known, k] - then).max() > 5 * off
    again = as_shown(vessel, dataclasses.replace(dataset, measured=back.measured))
    np.testing.assert_allclose(again.measured, dataset.measured, atol=1e-12)


def test_the_motion_behind_a_recording_is_shown_as_it_was_recorded():
    rows = 3  # late: no sample lies between two
    true = random_steps(DOCUMENT, 4, 60.0, 0.1, noise=0.0)
    run, sensors = received(4, 0.1 * rows, noise=0.0), late_vessel(0.1 * rows).sensors
    inner = slice(20, -20)
    motion, _ = true_motion(sensors, run, {})
    for channel in ("x", "y", "psi", "u", "v", "r"):
        off = np.abs(motion[channel] - true.motion[channel])[inner].max()
        assert off < 1e-6, channel
    shown = shown_motion(sensors, run.t, motion, {})
    for channel, series in run.motion.items():
        np.testing.assert_allclose(shown[channel][inner], series[inner], atol=1e-6)


def test_a_controller_is_shown_it_so():
    """On a steady turn: where it was, at its velocities of then in the axes of now."""
    vessel, period, rate = late_vessel(0.4), 0.1, 0.5
    still = instrumented(Fixed(), vessel, SensorErrors(), {}, 50, period, 0)
    memory = still.init()
    for k in range(30):
        state = State(float(k), 0.0, rate * period * k, 1.0 + 0.01 * k, 0.2, rate)
        memory, _ = still.step(memory, state, period * k, period)
    x, _, psi, u, v, _ = np.asarray(memory.shown)
    then = (1.0 + 0.01 * 25 + 0.2j) * np.exp(-1j * rate * 0.4)
    assert x == 25.0 and psi == pytest.approx(rate * period * 29)
    assert u + 1j * v == pytest.approx(then)


def test_a_log_without_velocities_is_not_asked_for_it():
    run = received(5)
    without = dataclasses.replace(run, u=np.full(len(run.t), np.nan), v=np.full(len(run.t), np.nan))
    asked = lambda one: RECEIVER in [e.name for e in candidate_effects(build(DOCUMENT), [one])]
    assert asked(run) and not asked(without)


def test_a_file_says_it_of_positions_and_velocities_together():
    found = {k: float(v) for k, v in named(late_vessel().sensors).items() if v}
    latencies = ("latency_position", "latency_velocity", "latency_axes")
    assert found == dict.fromkeys(latencies, LATE)
    table = {"name": "sensor-latency", "delay": 0.3, "channels": ["u", "v"], "turned_by": ["psi"]}
    with pytest.raises(UserError, match="of a receiver: with channels"):
        build(varied(DOCUMENT, effects=[table]))
