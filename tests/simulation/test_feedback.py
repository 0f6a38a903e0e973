# pyright: reportArgumentType=false
"""Records of actuation that are off: what acted is found again, in replays and in the filter."""

import math

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT

from diffsea import EFFECTS, Trajectory, UserError, replay
from diffsea.identification.problem import make_problem
from diffsea.vessel.files import build


CHANNELS = ("port", "starboard")
ERROR = {"offset": 6.0, "scale": 0.12, "delay": 0.6}
T = np.arange(0.0, 60.0, 0.1)


def thrust(channel, t):
    """A smooth thrust (N), other on each side."""
    return 90.0 + 50.0 * np.sin(0.4 * t + (0.0 if channel == "port" else 1.1))


def run(executed):
    """A run at rest in which something was executed; its orders say nothing."""
    still = {c: np.zeros(len(T)) for c in ("x", "y", "psi", "u", "v", "r")}
    orders = {c: np.zeros(len(T)) for c in CHANNELS}
    valid = np.ones(len(T), bool)
    return Trajectory(T, **still, commanded=orders, executed=executed, extra={}, valid=valid)


TRUE = run({c: thrust(c, T) for c in CHANNELS})
OFF = run({c: (1 + ERROR["scale"]) * thrust(c, T - ERROR["delay"]) + ERROR["offset"]
           for c in CHANNELS})  # fmt: skip


def with_errors(**error):
    return build(DOCUMENT | {"effect": [{"name": "feedback-error", **error}]})


def miss(vessel, recording):
    """How far (m) a replay ends from that of what was truly executed."""
    a, b = replay(build(DOCUMENT), TRUE), replay(vessel, recording)
    clear = T < T[-1] - 2 * ERROR["delay"]  # at the end the record does not say what acted
    return np.hypot(a.x - b.x, a.y - b.y)[clear].max()


def test_a_replay_undoes_every_error_of_a_record():
    assert miss(with_errors(**ERROR), OFF) < 2e-3
    for key in ERROR:
        part = {name: value for name, value in ERROR.items() if name != key}
        assert miss(with_errors(**part), OFF) > 0.05, key


def test_errors_of_some_actuators_leave_the_others():
    one_off = run(TRUE.executed | {"port": TRUE.executed["port"] + 5.0})
    assert miss(with_errors(offset=5.0, actuators=["port"]), one_off) < 1e-9
    assert miss(with_errors(offset=5.0), one_off) > 0.05


def test_the_filter_undoes_the_errors_too():
    names = [f"feedback-error:propulsion-{key}" for key in ERROR]
    effects = tuple(EFFECTS[name] for name in names)

    def innovations(recording, error):
        problem = make_problem(build(DOCUMENT), [recording], ("X_u",), effects)
        at, noise = problem.start()
        for effect in effects:
            (size,) = effect.sizes(problem.base)
            place = problem.layout.indices((effect.name,))
            at[place] = error.get(effect.coordinates[0].key, 0.0) / size
        found = np.asarray(problem.run_filter(at, noise).innovation)
        return found[: len(problem.dataset.rows_of_runs[0]) - 20]

    clean = innovations(TRUE, {})
    size = np.abs(clean).max()
    assert np.abs(innovations(OFF, ERROR) - clean).max() < 2e-3 * size
    assert np.abs(innovations(OFF, {}) - clean).max() > 0.05 * size


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"scale": -1.0}, "leaves nothing"),
        ({"offset": 1.0, "actuators": ["prot"]}, "no actuator 'prot'"),
        ({"off": 1.0}, "off"),
    ],
)
def test_a_wrong_table_is_refused(table, message):
    with pytest.raises(UserError, match=message):
        with_errors(**table)


def test_delays_of_a_record_are_met_between_its_rows():
    late = run({c: thrust(c, T - 0.37) for c in CHANNELS})
    assert miss(with_errors(delay=0.37), late) < 2e-3
    assert math.isfinite(miss(with_errors(delay=0.2), late))
    assert miss(with_errors(delay=0.2), late) > 0.01
