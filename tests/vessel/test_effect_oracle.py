"""Every effect of the catalogue, written in a vessel file, against an independent form of it.

The vessel is built from its document with an `[[effect]]` table and replays given orders; the
reference (`tests/oracle`) integrates hard laws, restarted at every jump, with the same table.
"""

import copy
import functools
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle.sensors import true_channels
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE
from tests.runs import disagreement, state_of, varied

from diffsea import State
from diffsea.simulation.integrate import advance, begin
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import MeasuredDisturbance
from diffsea.vessel.files import build


pytestmark = pytest.mark.compiles


# |r| r has a jump in its second derivative, which costs a step of fixed length its order.
USV = varied(load(ORACLE / "usv.toml"), {"N_rr": None, "N_rrr": -2000.0})
SHIP = load(ORACLE / "ship.toml")
PLAIN = SHIP | {"rudder": [SHIP["rudder"][0] | {"a_H": 0.0, "gamma_R_port": 1.0,
                                               "gamma_R_starboard": 1.0}]}  # fmt: skip
BOAT = load(ORACLE / "boat.toml")  # its thrusters lag, slew, answer late and have a dead band
UNLIMITED = copy.deepcopy(USV)
for thruster in UNLIMITED["thruster"]:
    del thruster["max_force"], thruster["min_force"]
RUDDERLESS = {key: value for key, value in SHIP.items() if key != "rudder"}


class Run:
    """A vessel's document, where it starts, orders from each time (s) on, and the step (s)."""

    def __init__(self, document, start, channels, schedule, seconds, step):
        self.document, self.start, self.step = document, start, step
        self.schedule = [(t, dict(zip(channels, map(float, row), strict=True)))
                         for t, *row in schedule]  # fmt: skip
        self.times = step * np.arange(1, round(seconds / step) + 1)

    def orders(self):
        """One order for each step, by channel."""
        index = np.searchsorted([t for t, _ in self.schedule], self.times - 0.5 * self.step) - 1
        return {c: jnp.array([self.schedule[i][1][c] for i in index]) for c in self.schedule[0][1]}


TWIN = (("port", "starboard"), [
    (0, 110, 90), (1.2, 170, 30), (3.0, 40, 160), (5.4, 40, 160), (6.6, 60, 80), (8.4, 150, 20),
], 10.8, 0.02)  # fmt: skip
FAST = {"psi": 0.4, "u": 1.1, "v": 0.05, "r": 0.02}
HELM = (("propeller", "rudder"), [
    (0, 11, 0.05), (2, 11, 0.35), (9, 11, -0.3), (16, 8, -0.3), (22, 12, 0.1),
], 30.0, 0.05)  # fmt: skip
UNDER_WAY = {"psi": -0.3, "u": 1.05, "v": -0.04, "r": 0.006}
RUNS = {
    "twin": Run(USV, FAST, *TWIN),
    "twin with cross-flow": Run(
        varied(USV, effects=[{"name": "crossflow-drag", "cd": 0.8}]), FAST, *TWIN
    ),
    "boat": Run(
        BOAT,
        {"psi": 0.4, "u": 0.6, "v": 0.02, "r": 0.05},
        ("port", "starboard"),
        [(0, 5, 4), (1.2, 8, 1), (3, -2, 6), (5.4, 3, 7), (8.4, 7, -1)],
        10.8,
        0.01,
    ),
    "twin without limits": Run(UNLIMITED, FAST, *TWIN),
    "ship": Run(SHIP, UNDER_WAY, *HELM),
    "ship without interaction": Run(PLAIN, UNDER_WAY, *HELM),
    "screw alone": Run(
        RUDDERLESS, UNDER_WAY, ("propeller",), [(0, 10), (4, -9), (14, 12)], 20.0, 0.05
    ),
}


def heel(t):
    """A roll of 4 deg, rad."""
    return 0.07 * math.sin(1.9 * t + 0.4)


def mean_heel(t, step):
    """Its mean over a step that begins at t: a step of the library has one heel."""
    a, b = 1.9 * t + 0.4, 1.9 * (t + step) + 0.4
    return 0.07 * (jnp.cos(a) - jnp.cos(b)) / (b - a)


# Run, effect and its parameters; an effect may stand more than once.
CASES = [
    ("twin", "current", {"speed": 0.3, "direction": 1.9}),
    ("twin", "wind", {"speed": 7.0, "direction": 2.4}),
    ("twin", "wave-force", {"bias": 20.0, "amplitude": 35.0, "frequency": 0.2, "phase": 0.6,
                            "direction": 1.0}),
    ("twin with cross-flow", "shallow-water", {"depth": 0.45}),
    ("ship", "shallow-water", {"depth": 0.7}),
    ("twin", "thrust-lag", {"time_constant": 0.9}),
    ("ship", "thrust-lag", {"time_constant": 1.5, "actuators": ["rudder"]}),
    ("twin", "thrust-delay", {"delay": 0.47}),
    ("twin", "thrust-delay", {"delay": 0.47, "actuators": ["port"]}),
    ("twin", "rate-limit", {"rate_limit": 110.0}),
    ("ship", "rate-limit", {"rate_limit": 0.07, "actuators": ["rudder"]}),
    ("twin", "actuator-response", {"delay": 0.47, "time_constant": 0.9}),
    ("ship", "actuator-response", {"delay": 1.3, "rate_limit": 0.07, "actuators": ["rudder"]}),
    ("twin", "deadband", {"width": 18.0}),
    ("twin", "backlash", {"width": 14.0}),
    ("ship", "backlash", {"width": 0.08, "actuators": ["rudder"]}),
    ("twin", "thrust-saturation", {"limit": 120.0}),
    ("ship", "thrust-saturation", {"limit": 0.22, "actuators": ["rudder"]}),
    ("twin without limits", "thrust-saturation", {"limit": 120.0}),
    ("boat", "rate-limit", {"rate_limit": 15.0}),
    ("twin", "actuator-bias", {"bias": 12.0, "actuators": ["port"]}),
    ("ship", "actuator-bias", {"bias": 0.04, "actuators": ["rudder"]}),
    ("twin", "thrust-curve", {"deadband": 12.0, "exponent": 1.3, "astern_ratio": 0.6,
                              "limit": 140.0}),
    ("boat", "thrust-curve", {"deadband": 0.4, "exponent": 0.8, "astern_ratio": 0.5}),
    ("boat", "thrust-curve", {"limit": 5.0}),
    ("twin", "thrust-curve", {"deadband": 12.0, "exponent": 1.3, "gain": 1.6, "slope": 0.2}),
    ("twin", "thrust-curve", {"gain": 0.7, "slope": 0.1, "actuators": ["port"]}),
    ("twin", "thrust-asymmetry", {"ratio": 0.12}),
    ("twin", "thruster-misalignment", {"angle": 0.07}),
    ("twin", "thrust-loss-with-speed", {"slope": 0.08}),
    ("twin", "thrust-loss-in-turns", {"slope": 0.5}),
    ("twin", "thrust-change", {"time": 4.2, "factor": -0.35}),
    ("ship", "thrust-change", {"time": 12.0, "factor": -0.35}),
    ("twin", "thrust-change", {"time": 4.2, "factor": -0.35, "actuators": ["starboard"]}),
    ("screw alone", "propeller-side-force", {"Y_ahead": 0.06, "N_ahead": -0.03, "Y_astern": 0.2,
                                             "N_astern": -0.12}),
    ("ship without interaction", "rudder-interaction", {"a_H": 0.3, "x_H": -3.2, "gamma_R": 0.5}),
    ("ship without interaction", "rudder-interaction", {"a_H": 0.3, "gamma_R": 0.5}),
    ("twin", "quadratic-damping", {"X_uu": -15.0, "Y_vv": -90.0, "N_rr": -300.0}),
    ("twin", "crossflow-drag", {"cd": 1.1}),
    ("twin", "sway-yaw-coupling", {"Y_r": -70.0, "N_v": 45.0}),
    ("twin", "speed-dependent-damping", {"Y_ur": 60.0, "N_ur": -150.0, "Y_uv": -80.0,
                                         "N_uv": 40.0}),
    ("twin", "added-mass-coupling", {"Y_rdot": -40.0, "N_vdot": -25.0, "x_G": 0.15}),
    ("twin", "munk-moment", {"Y_vdot - X_udot": 60.0}),
    ("twin", "mass-change", {"time": 4.2, "mass": 60.0}),
    ("ship", "mass-change", {"time": 12.0, "mass": -900.0}),
    ("twin", "mass-change", {"time": 4.2, "mass": 60.0, "x": -0.9}),
    ("twin with cross-flow", "drag-change", {"time": 4.2, "factor": 0.8}),
    ("twin with cross-flow", "drag-change", {"time": 4.2, "factor": 0.8,
                                             "degrees_of_freedom": ["surge"]}),
    ("twin", "roll-coupling", {"Y_phi": 300.0, "N_phi": 500.0}),
]  # fmt: skip
# The library makes a change at a time a logistic of WIDTH sqrt(L / g) s, to have a derivative by
# that time. So these are compared with a reference that changes as gradually, and with the sudden
# change from CLEAR widths after it on: what then remains is of second order in the width.
SMOOTHED = ("thrust-change", "drag-change", "mass-change")
WIDTH, CLEAR = 0.1, 10.0
# Where the disagreement may exceed 1e-6 of a channel's range, and what limits it.
LIMITS = {
    # |r| itself has a kink where the turn changes side, within a step.
    "thrust-loss-in-turns": 3e-5,
    # Zero and the dead band's edges are kinks, which a lagging thruster crosses within a step.
    "thrust-curve": 3e-5,
    # One heel for each step: of second order in the step.
    "roll-coupling": 3e-5,
    **dict.fromkeys(SMOOTHED, 5e-3),  # against the sudden change
}


@functools.cache
def plain_run(name):
    """The reference without the effect."""
    run = RUNS[name]
    return reference(run, run.document)


def reference(run, document, **options):
    """Motion after each step by the independent simulator."""
    state = begun(run)
    return simulate(document, run.schedule, run.times[-1], state=state, heel=heel, **options).at(
        run.times
    )


def begun(run):
    return tuple(run.start.get(c, 0.0) for c in MOTION_CHANNELS)


def library_run(run, document):
    """States of the library after each step, by channel."""
    vessel, orders = build(document), run.orders()
    first = {c: values[0] for c, values in orders.items()}
    motion = begin(vessel, state_of(**run.start), first, dict.fromkeys(first, 80))

    def one(carry, held):
        motion, t = carry
        environment = vessel.environment
        blown = MeasuredDisturbance(heel=mean_heel(t, run.step))
        environment = replace(environment, disturbance=blown)
        motion = advance(vessel, motion, held, environment, t, run.step)
        return (motion, t + run.step), motion.state

    (_, states) = jax.jit(lambda m: jax.lax.scan(one, (m, jnp.zeros(())), orders))(motion)
    return {channel: np.asarray(getattr(states, channel)) for channel in MOTION_CHANNELS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "name", "parameters"),
    CASES,
    ids=[f"{name}, {where}, {len(parameters)}" for where, name, parameters in CASES],
)
def test_an_effect_in_a_file_is_the_reference_s(where, name, parameters):
    run = RUNS[where]
    document = varied(run.document, effects=[{"name": name, **parameters}])
    plain, sudden, found = plain_run(where), reference(run, document), library_run(run, document)
    if name in SMOOTHED:
        width = WIDTH * math.sqrt(run.document["hull"]["length"] / 9.81)
        assert disagreement(found, reference(run, document, soften=width)) < 1e-6
        clear = np.abs(run.times - parameters["time"]) > CLEAR * width
        plain, sudden, found = (
            {c: table[c][clear] for c in MOTION_CHANNELS} for table in (plain, sudden, found)
        )
    assert disagreement(found, sudden) < LIMITS.get(name, 1e-6)
    assert disagreement(plain, sudden) > 1e-2  # of a size to be seen


CHAIN = {
    "thrust-delay": {"delay": 0.23},
    "actuator-bias": {"bias": 9.0},
    "deadband": {"width": 6.0},
    "thrust-saturation": {"limit": 120.0},
    "backlash": {"width": 8.0},
    "thrust-lag": {"time_constant": 0.4},
    "rate-limit": {"rate_limit": 150.0},
}
LIFT = {"Y_ur": 60.0, "N_ur": -150.0}
SIDE = {"Y_ahead": 0.06, "N_ahead": -0.03, "Y_astern": 0.2, "N_astern": -0.12}
EARLY = -9.0  # s, changes that are over before the run
TOGETHER = {
    "whole chain": ("twin", CHAIN),
    "whole chain, listed backwards": ("twin", dict(reversed(CHAIN.items()))),
    "more of what is there": ("boat", {
        "thrust-delay": {"delay": 0.15}, "thrust-lag": {"time_constant": 0.2},
        "deadband": {"width": 0.3}, "backlash": {"width": 0.4}, "actuator-bias": {"bias": 0.5},
    }),
    "losses": ("twin", {
        "thrust-asymmetry": {"ratio": 0.1}, "thrust-loss-with-speed": {"slope": 0.08},
        "thrust-change": {"time": EARLY, "factor": -0.3},
    }),
    "shallow, with other damping": ("twin with cross-flow", {
        "shallow-water": {"depth": 0.5}, "quadratic-damping": {"X_uu": -15.0, "Y_vv": -90.0},
        "speed-dependent-damping": LIFT,
    }),
    "shallow, with other inertia": ("twin", {
        "added-mass-coupling": {"Y_rdot": -40.0, "N_vdot": -25.0, "x_G": 0.1},
        "shallow-water": {"depth": 0.5}, "munk-moment": {"Y_vdot - X_udot": 60.0},
    }),
    "fouled, with other damping": ("twin with cross-flow", {
        "drag-change": {"time": EARLY, "factor": 0.6}, "speed-dependent-damping": LIFT,
        "munk-moment": {"Y_vdot - X_udot": 60.0},
    }),
    "fouled and shallow": ("twin", {
        "drag-change": {"time": EARLY, "factor": 0.6}, "shallow-water": {"depth": 0.5},
    }),
    "side force of a screw that lost thrust": ("screw alone", {
        "propeller-side-force": SIDE, "thrust-change": {"time": EARLY, "factor": -0.3},
    }),
    "heavy in a current": ("twin", {
        "mass-change": {"time": EARLY, "mass": 50.0}, "current": {"speed": 0.3, "direction": 1.9},
        "thrust-loss-with-speed": {"slope": 0.08},
    }),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", TOGETHER)
def test_effects_together_are_the_reference_s(case):
    where, effects = TOGETHER[case]
    tables = [{"name": name, **parameters} for name, parameters in effects.items()]
    run, document = RUNS[where], varied(RUNS[where].document, effects=tables)
    found, truth = library_run(run, document), reference(run, document)
    assert disagreement(found, truth) < 1e-6
    for left_out in tables:
        rest = varied(run.document, effects=[t for t in tables if t is not left_out])
        assert disagreement(reference(run, rest), truth) > 1e-3, left_out["name"]


def test_a_slew_limit_above_the_actuator_s_own_leaves_that():
    run = RUNS["boat"]
    document = varied(run.document, effects=[{"name": "rate-limit", "rate_limit": 100.0}])
    found = library_run(run, document)
    assert disagreement(found, reference(run, document)) < 1e-6
    assert disagreement(found, library_run(run, run.document)) < 1e-9


def test_loads_add_up_wherever_they_lie():
    run = RUNS["twin"]
    loads = [
        {"name": "mass-change", "time": EARLY, "mass": 40.0},
        {"name": "mass-change", "time": EARLY, "mass": 40.0, "x": 1.1},
        {"name": "mass-change", "time": EARLY - 1.0, "mass": -30.0, "x": -0.7},
    ]
    document = varied(run.document, effects=loads)
    assert disagreement(library_run(run, document), reference(run, document)) < 1e-6


# -- sensors -----------------------------------------------------------------------------


# The library shows a late channel by its Taylor polynomial of second order, so lags are short.
SENSORS = [
    ("heading-offset", {"angle": 0.07}),
    ("heading-offset", {"angle": 0.07, "channels": ["psi", "u", "v"]}),
    ("hard-iron", {"amplitude": 0.1, "phase": 0.8}),
    ("gyro-bias", {"bias": -0.02}),
    ("heading-offset", {"angle": 0.07, "time": 3.0}),
    ("gyro-bias", {"bias": -0.02, "time": 3.0}),
    ("sensor-latency", {"delay": 0.02}),
    ("sensor-latency", {"delay": 0.02, "channels": ["psi", "r", "u", "v"]}),
    ("lever-arm", {"x": 1.3, "y": -0.4}),
    ("lever-arm", {"x": 1.3, "y": -0.4, "channels": ["x", "y", "u", "v"]}),
    ("clock-drift", {"offset": 0.02, "rate": 0.001}),
    ("clock-drift", {"offset": -0.02, "rate": -0.001}),
]
LOOKS = np.array([1.0, 2.3, 3.1, 4.7, 6.2])  # s
STRAIGHT_ON = [(0, {"port": 160.0, "starboard": 60.0})]


def motion_of(reference, times):
    """States, rates and second rates of a reference run, by differences."""
    h = 1e-3
    before, now, after = (
        State(*(jnp.asarray(reference.at(times + k * h)[c]) for c in MOTION_CHANNELS))
        for k in (-1, 0, 1)
    )
    rate = jax.tree.map(lambda a, b: (b - a) / (2 * h), before, after)
    jerk = jax.tree.map(lambda a, m, b: (a - 2 * m + b) / h**2, before, now, after)
    return now, rate, jerk


@pytest.mark.parametrize(("name", "parameters"), SENSORS, ids=lambda value: str(value))
def test_a_sensor_effect_in_a_file_is_the_reference_s(name, parameters):
    document = varied(USV, effects=[{"name": name, **parameters}])
    reference = simulate(document, STRAIGHT_ON, 8.0, state=begun(RUNS["twin"]))
    truth = true_channels(reference, LOOKS)
    sensors, t = build(document).sensors, jnp.asarray(LOOKS)
    shown = jax.vmap(sensors.measure)(*motion_of(reference, LOOKS), t) + sensors.steps(t, 0.1)
    found = dict(zip(MOTION_CHANNELS, np.asarray(shown).T, strict=True))
    assert disagreement(found, truth) < 1e-5
    assert disagreement(reference.at(LOOKS), truth) > 1e-3
