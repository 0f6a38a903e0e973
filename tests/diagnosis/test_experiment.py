"""The manoeuvre that tells two explanations apart: what it orders, and the evidence expected of it.

Evidence is compared with that of surge with linear drag alone, of which u is seen without gusts:
long after the start a filter follows its model, and each innovation is what u is off by.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import expit
from tests.diagnosis.small import DOCUMENT, hypothesis, judged, linear_estimate
from tests.runs import varied

from diffsea import EFFECTS, Trajectory
from diffsea.diagnosis.decision import AcceptedEffect, ShortList
from diffsea.diagnosis.experiment import (
    DECISIVE,
    LONGEST,
    Experiment,
    choose_manoeuvre,
    commands,
    expected_evidence,
    next_experiment,
)
from diffsea.identification.estimates import posterior_estimate
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.problem import make_problem
from diffsea.identification.uncertainty import design
from diffsea.identification.uncertainty.design import (
    LIBRARY,
    SECONDS,
    NoThrottleError,
    simulate_manoeuvre,
)
from diffsea.scales import time_scale
from diffsea.vessel.files import build


MASS, DRAG = 180.0 + 12.0, 52.0  # kg with added mass, N s/m
SENSOR = 0.01  # m/s
RATE, UPPER, LOWER = 25.0, 250.0, -60.0  # N/s, N, N: astern saturates in every reversal
FREE = ("N_r",)  # of which surge says nothing
PRIOR = 3.0  # prior sizes that an effect's coordinate may be


@pytest.fixture(scope="module")
def document() -> dict:
    return DOCUMENT


@pytest.fixture(scope="module")
def slow(document):
    """Thrusters that take ten seconds to full thrust, and are weak astern."""
    thrusters = [t | {"rate_limit": RATE, "min_force": LOWER} for t in document["thruster"]]
    return build(document | {"thruster": thrusters})


def trained(vessel, effects: tuple[str, ...] = ()):
    """The problem of a run of which only u was recorded."""
    t, nothing = 0.2 * np.arange(50), np.full(50, np.nan)
    orders = dict.fromkeys(vessel.channels, np.zeros(50))
    run = Trajectory(
        t,
        nothing,
        nothing,
        nothing,
        np.zeros(50),
        nothing,
        nothing,
        orders,
        {},
        {},
        np.ones(50, bool),
    )
    catalogue = tuple(EFFECTS[name] for name in effects)
    return make_problem(vessel, [run], FREE, catalogue)


@pytest.mark.parametrize("name", LIBRARY)
def test_no_order_is_beyond_what_the_actuators_can_do(slow, name):
    train = trained(slow)
    final = linear_estimate(size=train.layout.size)
    for seconds in (30.0, 90.0):
        sequence = commands(train, final, Experiment(name, "", seconds, {}))
        t = sequence["t"]
        assert (t[0], t[-1]) == pytest.approx((0.0, seconds)) and (np.diff(t) > 0).all()
        for channel in slow.channels:
            series = sequence[f"cmd_{channel}"]
            assert np.isfinite(series).all()
            assert series.min() >= LOWER and series.max() <= UPPER


def test_a_vessel_that_its_model_leaves_without_thrust_gets_no_manoeuvre(document, monkeypatch):
    """A drag that no thrust overcomes, of a vessel whose thrusters state no limit."""
    thrusters = [
        {key: value for key, value in thruster.items() if key not in ("max_force", "min_force")}
        for thruster in document["thruster"]
    ]
    endless = build(document | {"thruster": thrusters})
    monkeypatch.setattr(design, "throttle_for", lambda *_: np.nan)
    with pytest.raises(NoThrottleError, match="no limit to its throttle"):
        simulate_manoeuvre(endless, LIBRARY["zigzag"])
    train = trained(endless, ("current", "wind"))
    wind, current = (
        dataclasses.replace(judged(name, 60.0), estimate=linear_estimate(size=train.layout.size))
        for name in ("wind", "current")
    )
    accepted = AcceptedEffect(wind, ShortList((wind, current), 10.0))
    assert accepted.rivals == ("current",)
    found = SimpleNamespace(split=SimpleNamespace(train=train), effects=[accepted])
    assert next_experiment(found) is None  # pyright: ignore[reportArgumentType]


def test_rivals_that_act_alike_get_no_manoeuvre(slow):
    time = time_scale(float(slow.rigid_body.length))
    enough = DECISIVE * SECONDS / LONGEST  # of a run of SECONDS sqrt(L / g)
    rivals = ("thrust-delay:propulsion", "clock-drift")
    for level, exists in ((2 * enough, True), (0.5 * enough, False), (0.0, False)):
        evidence = dict.fromkeys(LIBRARY, 0.5 * level) | {"zigzag": level}
        found = choose_manoeuvre(slow, *rivals, evidence)
        assert found.exists == exists
        record = found.as_dict()
        assert record["evidence"] == evidence
        if exists:
            assert record["manoeuvre"] == "zigzag"
            assert record["seconds"] == pytest.approx(LONGEST * time / 2)
            assert record["why"] == "separates thrust-delay from clock-drift"
        else:
            assert (record["manoeuvre"], record["seconds"]) == ("none", None)
            assert "thrust-delay and clock-drift act alike" in record["why"]


@pytest.mark.parametrize("name", LIBRARY)
def test_what_is_expected_of_a_manoeuvre_follows_its_orders_as_fast_as_actuators_slew(slow, name):
    run = simulate_manoeuvre(slow, LIBRARY[name])
    step, steepest = np.diff(run.t), 0.0
    for channel in slow.channels:
        orders, executed = run.commanded[channel], run.executed[channel]
        here = orders[0]
        for k, order in enumerate(orders):
            assert executed[k] == pytest.approx(here, abs=1e-6), (channel, k)
            if k < len(step):
                here += np.clip(order - here, -RATE * step[k], RATE * step[k])
        steepest = max(steepest, np.abs(np.diff(executed) / step).max())
    assert steepest <= RATE * (1 + 1e-6)
    assert name == "turning-circle" or steepest > 0.9 * RATE


def surge(t, thrust, drag_at: float, drag: float, thrust_at: float) -> np.ndarray:
    """u that drag * 100 % more drag from `drag_at` on makes, and its slopes by a share of drag
    from then on and by a share of thrust from `thrust_at` on.
    """
    soft = 0.1 * np.sqrt(4.9 / 9.81)

    def rate(now, state, force):
        u, by_drag, by_thrust = state
        fouled, boosted = expit((now - drag_at) / soft), expit((now - thrust_at) / soft)
        c = DRAG * (1 + drag * fouled)
        return np.array([
            force - c * u, -DRAG * fouled * u - c * by_drag, boosted * force - c * by_thrust
        ]) / MASS  # fmt: skip

    out = np.zeros((len(t), 3))
    for k in range(len(t) - 1):
        step = solve_ivp(rate, t[k : k + 2], out[k], args=(thrust[k],), rtol=1e-9, atol=1e-11)
        out[k + 1] = step.y[:, -1]
    return out.T


@pytest.mark.slow
@pytest.mark.parametrize("thrust_at", [52.0, 60.0, 75.0])
def test_a_change_amid_the_run_is_told_from_another_by_what_the_other_cannot_do(
    document, thrust_at
):
    """More drag from half of the run on, against more thrust from some other time on."""
    vessel = build(varied(document, {"X_uu": None}))
    drag_at, factor = 60.0, 0.3
    drag, thrust = EFFECTS["drag-change"], EFFECTS["thrust-change"]
    train = trained(vessel, (drag.name, thrust.name, "gyro-bias"))
    fouled = estimated(train, drag, (factor, drag_at))
    boosted = estimated(train, thrust, (-factor, thrust_at))
    true, bias, rival = (
        dataclasses.replace(hypothesis(name, 0.0), estimate=estimate)
        for name, estimate in ((drag.name, fouled), ("gyro-bias", fouled), (thrust.name, boosted))
    )
    schedule = LIBRARY["speed steps"]
    run = simulate_manoeuvre(vessel, schedule)
    push = sum(run.commanded[channel] for channel in vessel.channels)
    u, by_drag, by_thrust = surge(run.t, push, drag_at, factor, thrust_at)
    left = np.append(factor * by_drag / SENSOR, 0.0)
    column = np.append(thrust.sizes(vessel)[0] * by_thrust / SENSOR, 1 / PRIOR)
    kept = left - column * (column @ left) / (column @ column)
    alone = expected_evidence(train, true, bias, schedule)
    assert alone == pytest.approx(left @ left, rel=1e-3)
    told = expected_evidence(train, true, rival, schedule)
    assert told == pytest.approx(kept @ kept, rel=1e-3)
    assert told < 0.9 * alone


def estimated(train, effect, physical: tuple[float, ...]):
    """An estimate with one effect of a known size, and no gusts."""
    coordinates = np.zeros(train.layout.size)
    place = train.layout.indices((effect.name,))
    coordinates[place] = np.array(physical) / effect.sizes(train.base)
    noise = Noise.of(np.log([*[1e-6] * 3, *[1e-6] * 3, *[1.0] * 3, *[SENSOR] * 6, 1e-9]))
    index = np.array([0, *place])
    free = (*FREE, effect.name)
    fitted = posterior_estimate(
        free, coordinates, 0.0, index, train.layout.spreads(), np.zeros((len(index),) * 2)
    )
    return dataclasses.replace(fitted, state=noise)
