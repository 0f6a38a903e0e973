# pyright: reportArgumentType=false
"""Effects: absent at zero, with derivatives there, and the textbook's at finite size."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from tests.oracle import sensors as oracle_sensors
from tests.oracle.actuators import Thruster
from tests.oracle.simulator import load, simulate
from tests.paths import ORACLE
from tests.runs import disagreement, replay, state_of, varied

from diffsea import EFFECTS, Sensors, State, named
from diffsea.kinematics import to_body
from diffsea.simulation.actuation import thrust_shares
from diffsea.simulation.integrate import begin
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.types import MeasuredDisturbance
from diffsea.vessel.effects.coordinates import ScannedCoordinate
from diffsea.vessel.files import build
from diffsea.vessel.sensors import Step
from diffsea.vessel.servo import LARGEST_RATIO, OrderHistory, Servo


pytestmark = pytest.mark.compiles

ROUNDING = 1e-15  # of a slope that is none


USV = load(ORACLE / "usv.toml")
# Without yaw drag of its own, so that it could have every effect; smooth, see test_simulation.
DOCUMENT = varied(USV, {"N_rr": None, "N_rrr": -2000.0})
VESSEL = build(DOCUMENT)
# What is wrong with a record of actuation does not show in runs of orders.
POSSIBLE = [name for name, e in EFFECTS.items() if e.possible(VESSEL) and not e.needs_feedback]
START = {"psi": 0.4, "u": 1.1, "v": 0.05, "r": 0.02}
# Port and starboard thrust (N) from each time (s) on; to both sides, and a step of both.
SCHEDULE = [
    (0, 110, 90), (1.2, 170, 30), (3.0, 40, 160), (5.4, 40, 160), (6.6, 60, 80), (8.4, 150, -20),
]  # fmt: skip
SECONDS, STEP = 10.8, 0.1


def orders_at(step, seconds=SECONDS):
    """The schedule as one order for each step."""
    t = step * np.arange(round(seconds / step)) + 1e-9
    row = np.searchsorted([entry[0] for entry in SCHEDULE], t, side="right") - 1
    table = np.array(SCHEDULE, float)[row]
    return {"port": jnp.array(table[:, 1]), "starboard": jnp.array(table[:, 2])}


def settled(vessel, memory=40, start=START):
    orders = {"port": jnp.asarray(110.0), "starboard": jnp.asarray(90.0)}
    return begin(vessel, state_of(**start), orders, dict.fromkeys(orders, memory))


def at_zero(name):
    return jnp.zeros(len(EFFECTS[name].sizes(VESSEL)))


@pytest.mark.parametrize("name", ["mass-change", "mass-change:placed"])
def test_a_vessel_that_takes_on_a_load_is_not_asked_for_another(name):
    effect = EFFECTS[name]
    laden = effect.apply(VESSEL, jnp.asarray(effect.sizes(VESSEL)))
    assert effect.possible(VESSEL) and not effect.possible(laden)


@pytest.mark.parametrize("end, weak", [("fore", "bow"), ("aft", "stern")])
def test_a_change_at_one_end_is_of_the_thrusters_there(end, weak):
    pods = [{"name": name, "x": x, "y": 0.3} for name, x in (("bow", 1.5), ("stern", -1.5))]
    vessel = build({**DOCUMENT, "thruster": [], "azimuth_thruster": pods})
    effect = EFFECTS[f"thrust-change:{end}"]
    assert effect.possible(vessel) and not effect.possible(VESSEL)
    assert effect.place.in_file(vessel) == {"actuators": [f"{weak}.force"]}
    changed = effect.apply(vessel, jnp.array([-0.5, 10.0]))
    ahead = {f"{name}.{part}": 80.0 * (part == "force") for name in ("bow", "stern")
             for part in ("force", "angle")}  # fmt: skip
    still = State(*[0.0] * 6)
    for t, share in ((0.0, 1.0), (20.0, 0.75)):
        whole, less = (one.breakdown(still, ahead, one.environment, t) for one in (vessel, changed))
        total = [sum(float(force.X) for force in forces.values()) for forces in (whole, less)]
        np.testing.assert_allclose(total[1], share * total[0], rtol=1e-6)


@pytest.mark.parametrize("name", POSSIBLE)
def test_a_vessel_without_an_effect_and_with_a_noticeable_one_is_within_its_bounds(name):
    effect = EFFECTS[name]
    least, most = np.array(effect.bounds(VESSEL)).T
    sizes = np.array(effect.sizes(VESSEL))
    assert len(least) == len(sizes)
    assert (least <= 0).all() and (most >= 0).all()
    noticeable = np.where(most > 0, sizes, -sizes)
    assert ((least <= noticeable) & (noticeable <= most)).all()


# -- absent at zero ------------------------------------------------------------------------


@functools.cache
def first_states(name):
    """States of a short run without compilation, where rounding does not depend on the rest."""
    vessel = VESSEL if name is None else EFFECTS[name].apply(VESSEL, at_zero(name))
    with jax.disable_jit():
        states = replay(vessel, settled(vessel), orders_at(0.8, 2.4), vessel.environment, 0.8)
    return np.stack([getattr(states, channel) for channel in MOTION_CHANNELS])


@pytest.mark.slow
@pytest.mark.parametrize("name", POSSIBLE)
def test_an_effect_of_zero_size_leaves_the_motion_unchanged(name):
    # A servo that lags by nothing rounds once more than one that answers at once.
    stages = ("thrust-lag", "thrust-delay", "rate-limit", "actuator-response")
    tolerance = 1e-13 if name.startswith(stages) else 0.0
    np.testing.assert_allclose(first_states(name), first_states(None), rtol=tolerance, atol=0)


# -- derivatives -------------------------------------------------------------------------


PLACES = [(name, k) for name in POSSIBLE for k in range(at_zero(name).size)]
# Coordinates that do nothing while the effect is absent, and amounts without a tangent there.
FLAT = [(n, k) for n, k in PLACES if not EFFECTS[n].amounts[k] or not EFFECTS[n].leading.tangent]
SIZES = np.array([EFFECTS[name].sizes(VESSEL)[k] for name, k in PLACES])


def measured(coordinates):
    """What the sensors show with all the effects applied, by time and channel."""
    vessel = VESSEL
    for name in POSSIBLE:
        part = [coordinates[i] for i, place in enumerate(PLACES) if place[0] == name]
        vessel = EFFECTS[name].apply(vessel, jnp.stack(part))
    blown = MeasuredDisturbance(heel=0.1, wind_north=-3.0, wind_east=4.0)
    environment = dataclasses.replace(vessel.environment, disturbance=blown)
    orders = orders_at(STEP)
    states = replay(vessel, settled(vessel), orders, environment, STEP)

    def shown(state, held, t):
        def rate(at):
            return vessel.rate(at, held, environment, 0.0)

        motion, change = jax.jvp(rate, (state,), (rate(state),))
        return vessel.sensors.measure(state, motion, change, t) + vessel.sensors.steps(t, STEP)

    rows = jax.vmap(shown)(states, orders, STEP * np.arange(1, len(orders["port"]) + 1))
    return with_deviation(vessel, rows, thrust_shares(vessel, orders))


def with_deviation(vessel, rows, shares):
    """Shown rows, their heading and velocities turned as by an estimator of the heading."""
    x, y, psi, u, v, r = jnp.moveaxis(rows, 1, 0)
    turned, intervals = jnp.zeros_like(psi), jnp.full(psi.size, STEP)
    for _ in range(3):
        turned = vessel.sensors.deviation(psi + turned, shares, intervals, jnp.arange(psi.size) < 1)
    return jnp.stack([x, y, psi + turned, *to_body(u, v, turned), r], axis=1)


JACOBIAN = jax.jit(jax.jacfwd(measured))
SHOWN = jax.jit(measured)


@pytest.mark.slow
def test_every_effect_has_a_derivative_at_zero():
    zero = jnp.zeros(len(PLACES))
    slopes = np.asarray(JACOBIAN(zero))
    assert np.all(np.isfinite(slopes))
    here = np.asarray(SHOWN(zero))
    for i, place in enumerate(PLACES):
        assert (np.max(np.abs(slopes[..., i])) > ROUNDING) == (place not in FLAT), place
        if place in FLAT:
            continue
        # To one side: a lag, a delay or a drag is never negative.
        h = 1e-4 * SIZES[i]
        difference = (np.asarray(SHOWN(zero.at[i].set(h))) - here) / h
        error = np.max(np.abs(difference - slopes[..., i]), axis=0)
        np.testing.assert_array_less(error, 3e-3 * np.max(np.abs(slopes[..., i])), str(place))


@pytest.mark.slow
def test_derivatives_away_from_zero_are_finite_differences():
    # Slower than the lag, so that the slew rate acts; a limit below the orders.
    larger = [
        0.3 if isinstance(EFFECTS[name].coordinates[k], ScannedCoordinate)
        else {"rate-limit": 20.0, "thrust-saturation": 10.0}.get(name.split(":")[0], 1.0)
        for name, k in PLACES
    ]  # fmt: skip
    at = jnp.asarray(SIZES * np.linspace(0.3, 0.5, len(SIZES)) * larger)
    slopes = np.asarray(JACOBIAN(at))
    for i, place in enumerate(PLACES):
        h = 1e-5 * SIZES[i]
        up, down = (np.asarray(SHOWN(at.at[i].add(d))) for d in (h, -h))
        error = np.max(np.abs((up - down) / (2 * h) - slopes[..., i]))
        assert error < 1e-6 * np.max(np.abs(slopes[..., i])), place


# -- at finite size ----------------------------------------------------------------------


FINITE = {
    "current": {"speed": 0.3, "direction": 1.9},
    "wind": {"speed": 7.0, "direction": 2.4},
    "crossflow-drag": {"cd": 1.1},
    "sway-yaw-coupling": {"Y_r": -70.0, "N_v": 45.0},
    "thrust-lag": {"time_constant": 0.9},
    "thrust-delay": {"delay": 0.47},
    "thrust-asymmetry": {"ratio": 0.12},
    "thruster-misalignment": {"angle": 0.07},
    "wave-force": {
        "bias": 20.0, "amplitude": 35.0, "frequency": 0.2, "phase": 0.6, "direction": 1.0,
    },
    "thrust-loss-with-speed": {"slope": 0.08},
    "thrust-loss-in-turns": {"slope": 0.5},
    "quadratic-damping": {"X_uu": -15.0, "Y_vv": -90.0, "N_rr": -300.0},
}  # fmt: skip
# What limits the agreement at a step of 0.02 s: the fourth order of the step; with a delay,
# jumps inside steps (third order); |v| v and |r| r, whose second derivative jumps; and |r| itself,
# whose first does.
LIMITS = {
    "thrust-delay": 5e-7, "crossflow-drag": 1e-7, "quadratic-damping": 1e-7,
    "thrust-loss-in-turns": 3e-5,
}  # fmt: skip


@pytest.mark.parametrize("name", FINITE)
def test_an_effect_is_the_textbooks(name):
    document = varied(DOCUMENT, effects=[{"name": name, **FINITE[name]}])
    start = (0.0, 0.0, *START.values())
    schedule = [(t, {"port": p, "starboard": s}) for t, p, s in SCHEDULE]
    reference = simulate(document, schedule, SECONDS, state=start)
    plain = simulate(DOCUMENT, schedule, SECONDS, state=start)
    vessel, step = build(document), 0.02
    states = jax.jit(
        lambda motion: replay(vessel, motion, orders_at(step), vessel.environment, step)
    )(settled(vessel, 70))
    found = {channel: np.asarray(getattr(states, channel)) for channel in MOTION_CHANNELS}
    truth = reference.at(step * np.arange(1, len(found["x"]) + 1))
    assert disagreement(found, truth) < LIMITS.get(name, 1e-8)
    assert disagreement(plain.at(truth["t"]), truth) > 1e-2


# -- actuators in one step -----------------------------------------------------------------


STAGES = {
    "lag": {"time_constant": 0.6},
    "rate limit": {"rate_limit": 2.5},
    "lag and rate limit": {"time_constant": 0.6, "rate_limit": 0.7},
    "delay": {"delay": 0.31},
    "all": {"delay": 0.31, "time_constant": 0.6, "rate_limit": 1.5, "deadband": 0.1},
}
ORDERS = [(-1.0, 0.2), (0.0, 1.4), (0.4, -0.8), (0.55, 0.9)]  # s, unit of the channel


def moments(response):
    """Integrals of s^k over the unit step of the quadratic through a response's nodes."""
    a, b, c = (float(node) for node in (response.start, response.middle, response.end))
    return np.array([(a + 4 * b + c) / 6, (2 * b + c) / 6, -a / 60 + b / 5 + 3 * c / 20])


@pytest.mark.parametrize("stages", STAGES)
def test_a_step_of_a_servo_has_the_moments_of_its_response(stages):
    # Fractions of the lag from far below to far above, through orders and their kinks.
    thruster = Thruster({"name": "", **STAGES[stages]})
    for order in ORDERS:
        thruster.order(*order)
    servo = Servo(**STAGES[stages])
    history = OrderHistory(*(jnp.array(column) for column in zip(*ORDERS, strict=True)))
    for t in (0.55, 0.7, 0.863, 1.3):
        executed = thruster.segment(t)(t)
        for dt in (1e-11, 1e-7, 1e-4, 0.1, 0.149, 0.5, 4.0):
            response = servo.respond(jnp.asarray(executed), history, t, dt)
            kinks = [b for x in thruster.segments for b in x.breakpoints() if t < b < t + dt]
            kinks = sorted((b - t) / dt for b in kinks)
            exact = [
                quad(lambda s, k=k: s**k * thruster.segment(t + s * dt)(t + s * dt), 0, 1,  # noqa: B023
                     points=kinks or None, epsabs=1e-13, epsrel=1e-13, limit=200)[0]
                for k in range(3)
            ]  # fmt: skip
            end = thruster.segment(t + dt)(t + dt)
            if (
                stages == "lag" and dt < LARGEST_RATIO * 0.6
            ):  # short: the response itself at the nodes
                nodes = response.start, response.middle, response.end
                there = [thruster.segment(t + s * dt)(t + s * dt) for s in (0.0, 0.5, 1.0)]
                np.testing.assert_allclose(np.stack(nodes), there, rtol=1e-14, atol=1e-14)
            else:
                np.testing.assert_allclose(moments(response), exact, rtol=1e-10, atol=1e-10)
            assert float(response.final) == pytest.approx(end, abs=1e-11)


def test_a_lag_answers_as_it_does_beside_a_quicker_one():
    """In a batch, too: of a lane's step nothing depends on the lag of another lane."""
    history = OrderHistory(jnp.zeros(1), jnp.ones(1))

    def answer(tau):
        return Servo(time_constant=tau).respond(jnp.asarray(0.2), history, 1.0, 0.05)

    def slope(tau):
        return jax.grad(lambda at: answer(at).end)(tau)

    taus = jnp.array([0.3, 0.21, 0.1, 0.0])
    for one in (answer, slope):
        together = jax.vmap(one)(taus)
        alone = [one(tau) for tau in taus]
        jax.tree.map(
            lambda all_, *each: np.testing.assert_allclose(all_, each, rtol=1e-15, atol=1e-16),
            together, *alone,
        )  # fmt: skip


@pytest.mark.parametrize("early", [0.0, 1e-13, -1e-13])
@pytest.mark.parametrize("stage", ["time_constant", "delay", "backlash", "slowness"])
def test_an_order_at_the_end_of_a_step_is_the_next_ones(stage, early):
    # Its stamp meets the sum of steps to rounding.
    history = OrderHistory(jnp.array([-5.0, 3.2 - early]), jnp.array([0.0, 1.0]))
    step = 0.16

    def mean(size, t):
        servo = Servo(**({"delay": jnp.zeros(())} | {stage: size}))
        breaks, values = servo.order_segments(history, jnp.asarray(t), jnp.asarray(step))
        response = servo.respond_to(jnp.zeros(()), breaks, values, jnp.asarray(step))
        return (response.start + 4 * response.middle + response.end) / 6

    slope = lambda t: float(jax.jacfwd(lambda size: mean(size, t))(jnp.zeros(())))
    before, after = slope(3.2 - step), slope(3.2)
    lost = {"time_constant": 1 / step, "delay": 1 / step, "backlash": 1.0, "slowness": 0.5 / step}
    assert before == 0.0
    if early <= 0 or stage != "delay":
        assert after == pytest.approx(-lost[stage], rel=1e-6)


def test_a_lag_keeps_its_accuracy_in_single_precision():
    # 20 s against a step of 0.05 s.
    history = OrderHistory(jnp.zeros(1, jnp.float32), jnp.ones(1, jnp.float32))
    with jax.numpy_dtype_promotion("standard"):  # the session's own constants have 64 bits
        response = Servo(time_constant=jnp.float32(20)).respond(
            jnp.float32(0.2), history, jnp.float32(1), jnp.float32(0.05)
        )
    exact = 1 - 0.8 * np.exp(-np.array([0, 0.025, 0.05]) / 20)
    found = [float(node) for node in (response.start, response.middle, response.end)]
    np.testing.assert_allclose(found, exact, atol=2e-6)


def test_a_settled_servo_passes_on_a_change_of_order_as_it_lags():
    servo = Servo(time_constant=0.6, rate_limit=1.5)

    def final(order, executed):
        history = OrderHistory(jnp.zeros(1), order[None])
        return servo.respond(executed, history, 1.0, 0.2).final

    left = np.exp(-0.2 / 0.6)
    slopes = jax.grad(final, argnums=(0, 1))(jnp.asarray(0.7), jnp.asarray(0.7))
    np.testing.assert_allclose(slopes, (1 - left, left), rtol=1e-12)


# -- sensors -----------------------------------------------------------------------------


def motion_of(reference, times):
    """States, rates and second rates of an independent run at times, by differences."""
    h = 1e-3
    around = [reference.at(times + k * h) for k in (-1, 0, 1)]
    states = [State(*(jnp.asarray(at[c]) for c in MOTION_CHANNELS)) for at in around]
    before, now, after = states
    rate = jax.tree.map(lambda a, b: (b - a) / (2 * h), before, after)
    jerk = jax.tree.map(lambda a, m, b: (a - 2 * m + b) / h**2, before, now, after)
    return now, rate, jerk


@functools.cache
def turning():
    """A run with constant orders: smooth, so that a Taylor series of its motion converges."""
    start = (0.0, 0.0, *START.values())
    return simulate(DOCUMENT, [(0, {"port": 160.0, "starboard": 60.0})], 8.0, state=start)


TIMES = np.array([1.0, 2.3, 3.1, 4.7, 6.2])


def shown_by(sensors):
    measured = jax.vmap(sensors.measure)(*motion_of(turning(), TIMES))
    return dict(zip(MOTION_CHANNELS, np.asarray(measured).T, strict=True))


@pytest.mark.parametrize(
    ("sensors", "effect"),
    [
        (Sensors(heading_offset=0.07), {"name": "heading-offset", "angle": 0.07}),
        (Sensors(gyro_bias=-0.02), {"name": "gyro-bias", "bias": -0.02}),
        (Sensors(lever_x=1.3, lever_y=-0.4), {"name": "lever-arm", "x": 1.3, "y": -0.4}),
        (
            Sensors(hard_iron_sin=0.1 * np.cos(0.8), hard_iron_cos=-0.1 * np.sin(0.8)),
            {"name": "hard-iron", "amplitude": 0.1, "phase": 0.8},
        ),
    ],
    ids=lambda value: value.get("name") if isinstance(value, dict) else "",
)
def test_a_sensor_effect_is_its_definition(sensors, effect):
    reference = turning()
    reference.model.sensors[:] = [effect]
    truth = oracle_sensors.true_channels(reference, TIMES)
    reference.model.sensors[:] = []
    found = shown_by(sensors)
    for channel in MOTION_CHANNELS:
        np.testing.assert_allclose(found[channel], truth[channel], rtol=1e-12, atol=1e-12)


def test_a_latency_is_its_taylor_series_to_second_order():
    errors = []
    for delay in (0.2, 0.1):
        late = dict.fromkeys(
            ("latency_position", "latency_heading", "latency_velocity", "latency_yaw_rate"), delay
        )
        found, truth = shown_by(Sensors(**late)), turning().at(TIMES - delay)
        errors.append([np.max(np.abs(found[c] - truth[c])) for c in MOTION_CHANNELS])
    errors = np.array(errors)
    assert np.all(errors[1] < 1e-4)
    np.testing.assert_array_less(7.0, errors[0] / errors[1])  # 8 of a third-order remainder


def test_a_late_receiver_shows_velocities_of_then_in_the_axes_of_now():
    errors = []
    for delay in (0.2, 0.1):
        late = dict.fromkeys(("latency_position", "latency_velocity", "latency_axes"), delay)
        found, run = shown_by(Sensors(**late)), turning()
        then, now = run.at(TIMES - delay), run.at(TIMES)
        turned = (then["u"] + 1j * then["v"]) * np.exp(1j * (then["psi"] - now["psi"]))
        truth = {**now, "x": then["x"], "y": then["y"], "u": turned.real, "v": turned.imag}
        errors.append([np.max(np.abs(found[c] - truth[c])) for c in ("x", "y", "u", "v")])
        assert all(np.array_equal(found[c], now[c]) for c in ("psi", "r"))
    errors = np.array(errors)
    assert np.all(errors[1] < 1e-4)
    np.testing.assert_array_less(7.0, errors[0] / errors[1])  # 8 of a third-order remainder


def test_a_reading_is_a_mean_over_the_time_since_the_last_one():
    """A step of 0.3 rad a quarter of an interval before the reading at 2 s shows a quarter."""
    sensors = Sensors(heading_steps=(Step(0.3, 1.95),), gyro_steps=(Step(0.01, 0.0),) * 2)
    shown = np.asarray(sensors.steps(np.array([1.8, 2.0, 2.2]), 0.2))
    assert shown[:, 2] == pytest.approx([0.0, 0.3 / 4, 0.3])
    assert shown[:, 5] == pytest.approx(0.02)
    assert not shown[:, [0, 1, 3, 4]].any()


def test_effects_in_a_file_reach_the_sensors():
    effects = [
        {"name": "heading-offset", "angle": 0.07},
        {"name": "gyro-bias", "bias": -0.02},
        {"name": "sensor-latency", "delay": 0.3, "channels": ["x", "y", "psi"]},
    ]
    read = named(build(varied(DOCUMENT, effects=effects)).sensors)
    expected = {"heading_offset": 0.07, "gyro_bias": -0.02}
    expected |= {"latency_position": 0.3, "latency_heading": 0.3}
    assert {name: float(value) for name, value in read.items() if value} == expected


@pytest.mark.parametrize("order", [0.0, 0.3, -0.3])
def test_a_bias_has_its_derivative_beside_a_dead_band_of_no_width(order):
    def executed(bias, width):
        return Servo(bias=bias, deadband=width).target(jnp.asarray(order))

    # Whatever the order, zero among them: every candidate is attached while effects are sought.
    assert float(jax.grad(executed)(0.0, 0.0)) == 1.0
    assert float(jax.grad(executed, argnums=1)(0.0, 0.0)) == -np.sign(order)
    assert float(executed(0.0, 0.0)) == order
    assert float(executed(0.0, 0.2)) == pytest.approx(order - 0.2 * np.sign(order))
