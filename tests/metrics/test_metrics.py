# pyright: reportArgumentType=false, reportCallIssue=false
"""Numbers of the trials against closed forms, another integrator and hand counts."""

import dataclasses
import functools
import json
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.paths import DATA

from diffsea import Trajectory, UserError, recording_metrics
from diffsea.metrics import (
    RECORDED_TRIALS,
    curve,
    find_orders,
    first_crossing,
    highest,
    imo_verdicts,
    prepare_recording,
    recognise_trial,
    slopes,
    stopping_metrics,
    turning_metrics,
    value_at,
    zigzag_metrics,
)
from diffsea.metrics.crossings import value_or_nan
from diffsea.metrics.orders import as_thrust, steering_angle
from diffsea.runtime import SELDOM_RUN


ORDER = math.radians(20)
compiled = functools.partial(jax.jit, compiler_options=SELDOM_RUN)
TURNING, ZIGZAG, STOPPING = (
    functools.partial(eqx.filter_jit, compiler_options=SELDOM_RUN)(metrics)
    for metrics in (turning_metrics, zigzag_metrics, stopping_metrics)
)


def trajectory(t, x, y, psi, u, v, r, valid=None, **channels):
    """A record of these channels, by default all of it valid."""
    valid = np.ones(len(t), bool) if valid is None else valid
    empty = {"commanded": {}, "executed": {}, "extra": {}}
    return Trajectory(t, x, y, psi, u, v, r, valid=valid, **{**empty, **channels})


def replaced(run, **changes):
    """The run with other channels."""
    return dataclasses.replace(run, **changes)


def turning(t, radius=50.0, rate=0.05, drift=0.1, psi0=0.3, side=1, execute=7.3):
    """Straight ahead, then at once on a circle; `drift` is the angle of the bow inwards."""
    tau = jnp.maximum(t - execute, 0.0)
    on = t >= execute
    speed = radius * rate
    course = psi0 + side * rate * tau
    x = jnp.where(on, 0.0, speed * jnp.cos(psi0) * (t - execute))
    y = jnp.where(on, 0.0, speed * jnp.sin(psi0) * (t - execute))
    x = x + side * radius * (jnp.sin(course) - jnp.sin(psi0))
    y = y - side * radius * (jnp.cos(course) - jnp.cos(psi0))
    psi = jnp.where(on, course + side * drift, psi0 + side * drift)
    u = jnp.full_like(t, speed * math.cos(drift))
    v = jnp.full_like(t, -side * speed * math.sin(drift))
    return trajectory(t, x, y, psi, u, v, jnp.where(on, side * rate, 0.0))


def crossing_time(c, level, direction=0, **bounds):
    """When the curve first passes a level (s), NaN where it does not."""
    return value_or_nan(*first_crossing(c, level, direction, **bounds))


def with_event(t, time):
    """The times with an event's two equal stamps put in."""
    return np.sort(np.concatenate([t, [time, time]]))


@pytest.mark.slow
def test_crossings_of_a_sine_are_fourth_order_accurate():
    errors = []
    for step in (0.2, 0.1):
        t = np.arange(0, 10, step)
        c = curve(t, np.sin(t + 0.1), np.cos(t + 0.1), np.ones(len(t), bool))
        up, down = crossing_time(c, 0.5, 1), crossing_time(c, 0.5, -1)
        again = crossing_time(c, 0.5, 1, after=3.0)
        either = crossing_time(c, 0.5, 0, after=1.0)
        exact = [math.pi / 6, 5 * math.pi / 6, math.pi / 6 + 2 * math.pi, 5 * math.pi / 6]
        found = [float(up), float(down), float(again), float(either)]
        errors.append(np.max(np.abs(np.array(found) - (np.array(exact) - 0.1))))
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] > 11  # 16 to come, more or less by the phase of the samples


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
def test_crossing_time_has_the_implicit_derivative(jacobian):
    t = jnp.arange(0, 10, 0.05)
    valid = jnp.ones(len(t), bool)

    def time(p):
        amplitude, rate, level = p
        c = curve(t, amplitude * jnp.sin(rate * t), amplitude * rate * jnp.cos(rate * t), valid)
        return crossing_time(c, level, 1, after=3.0)

    amplitude, rate, level = p = jnp.array([1.3, 0.9, 0.6])
    exact = (jnp.arcsin(level / amplitude) + 2 * jnp.pi) / rate
    slope = jnp.sqrt(amplitude**2 - level**2) * rate
    expected = [-level / amplitude / slope, -exact / rate, 1 / slope]
    np.testing.assert_allclose(time(p), exact, rtol=1e-7)
    np.testing.assert_allclose(compiled(jacobian(time))(p), expected, rtol=1e-5)


def test_crossing_on_a_sample_at_an_event_or_in_the_window_only():
    t = np.array([0.0, 1.0, 1.0, 2.0, 3.0, 4.0])
    value = np.array([-1.0, 0.0, 0.0, 1.0, 0.0, -1.0])
    c = curve(t, value, np.array([1.0, 1, 1, 0, -1, -1]), np.ones(6, bool))
    assert float(crossing_time(c, 0.0, 1)) == 1.0
    assert float(crossing_time(c, 0.0, -1)) == pytest.approx(3.0)
    assert math.isnan(crossing_time(c, 0.0, 1, after=1.0))
    assert not first_crossing(c, 0.0, -1, before=2.9).found
    assert float(value_at(c, 0.5)) == pytest.approx(-0.5)
    assert float(value_at(c, 9.0)) == -1.0


def test_a_crossing_moves_with_the_times_of_its_samples():
    """A window that begins within the crossed interval has no derivative of its own."""
    value = jnp.array([-1.0, -0.4, -0.1, 0.6, 1.0])

    def crossing(stretch):
        t, rate = stretch * jnp.arange(5.0), jnp.gradient(value) / stretch
        return crossing_time(curve(t, value, rate, jnp.ones(5, bool)), 0.0, 1, after=2.1)

    found = float(crossing(1.0))
    assert 2.1 < found < 3.0
    for derivative in (jax.jacfwd(crossing), jax.grad(crossing)):
        assert float(derivative(1.0)) == pytest.approx(found, rel=1e-12)


def test_rows_that_do_not_count_are_never_read():
    t = np.linspace(0, 6, 61)
    clean = curve(t, np.sin(t), np.cos(t), np.ones(61, bool))
    spoiled, valid = np.full((3, 80), np.nan), np.zeros(80, bool)
    rows = np.sort(np.random.default_rng(0).choice(80, 61, replace=False))
    spoiled[:, rows], valid[rows] = (t, np.sin(t), np.cos(t)), True
    dirty = curve(*(jnp.asarray(s) for s in spoiled), valid=jnp.asarray(valid))
    for level in (0.3, -0.9):
        assert crossing_time(clean, level, -1) == crossing_time(dirty, level, -1)
    assert highest(clean, 1.0).value == highest(dirty, 1.0).value

    def time(value):
        return crossing_time(curve(spoiled[0], value, spoiled[2], jnp.asarray(valid)), 0.3, -1)

    assert np.all(np.isfinite(jax.grad(time)(jnp.asarray(spoiled[1]))))


def test_without_a_crossing_the_time_is_nan_and_the_derivative_zero():
    t = jnp.array([0.0, 1.0, 1.0, 2.0])

    def time(value):
        return crossing_time(curve(t, value, jnp.ones(4), jnp.ones(4, bool)), 5.0)

    assert math.isnan(time(t))
    np.testing.assert_array_equal(jax.jacfwd(time)(t), np.zeros(4))
    np.testing.assert_array_equal(jax.jacrev(time)(t), np.zeros(4))


def test_extremum_of_a_cubic_is_exact_with_its_derivatives():
    t = jnp.array([0.0, 0.7, 1.5, 2.2])

    def peak(p):
        value, rate = p[0] * t - p[1] * t**3, p[0] - 3 * p[1] * t**2
        found = highest(curve(t, value, rate, jnp.ones(4, bool)), 1.0)
        return jnp.stack([found.time, found.value])

    a, b = p = jnp.array([2.0, 0.4])
    time = jnp.sqrt(a / (3 * b))
    np.testing.assert_allclose(peak(p), [time, 2 / 3 * a * time], rtol=1e-13)
    expected = [[time / (2 * a), -time / (2 * b)], [time, -(time**3)]]
    np.testing.assert_allclose(jax.jacfwd(peak)(p), expected, rtol=1e-12)
    np.testing.assert_allclose(jax.jacrev(peak)(p), expected, rtol=1e-12)


def test_a_curve_that_still_rises_at_the_end_has_not_turned_back():
    t = np.linspace(0, 8, 81)
    wave = t + 1.2 * np.sin(t)
    c = curve(t, wave, 1 + 1.2 * np.cos(t), np.ones(81, bool))
    assert not highest(c, 1.0).found
    assert highest(c, 1.0, before=3.0).found
    assert not highest(c, -1.0, after=0.1, before=2.0).found


def test_slopes_are_exact_for_a_parabola_on_either_side_of_an_event():
    t = np.array([0.0, 0.3, 0.5, 0.9, 0.9, 1.0, 1.4, 1.5])
    after = np.arange(8) >= 4
    value = np.where(after, 0.81 + 2 * (t - 0.9) ** 2 - 3 * (t - 0.9), t**2)
    rate = np.where(after, 4 * (t - 0.9) - 3, 2 * t)
    np.testing.assert_allclose(slopes(jnp.array(t), jnp.array(value)), rate, atol=1e-12)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("drift", [0.0, 0.15])
def test_turning_on_a_circle(side, drift):
    radius, rate, execute = 50.0, 0.05, 7.3
    t = with_event(np.arange(0, 200, 0.5), execute)
    run = turning(jnp.array(t), radius, rate, drift, side=side, execute=execute)
    got = TURNING(run, execute, jnp.array(float(side)))
    # The axes are those of the heading, turned inwards from the course by the drift angle.
    inwards = np.exp(1j * drift)

    def position(angle):
        return radius * (1j - 1j * np.exp(1j * angle)) / inwards

    assert got["advance"] == pytest.approx(position(np.pi / 2).real, rel=1e-6)
    assert got["transfer"] == pytest.approx(position(np.pi / 2).imag, rel=1e-6)
    assert got["tactical_diameter"] == pytest.approx(position(np.pi).imag, rel=1e-6)
    lap = position(np.linspace(0, 2 * np.pi, 200001))
    assert got["max_advance"] == pytest.approx(lap.real.max(), rel=1e-6)
    assert got["max_transfer"] == pytest.approx(lap.imag.max(), rel=1e-6)
    assert got["time_to_90"] == pytest.approx(np.pi / 2 / rate, rel=1e-9)
    assert got["time_to_180"] == pytest.approx(np.pi / rate, rel=1e-9)
    assert got["steady_turning_diameter"] == pytest.approx(2 * radius, rel=1e-9)
    assert got["steady_yaw_rate"] == pytest.approx(rate, rel=1e-9)
    assert got["peak_yaw_rate"] == pytest.approx(rate, rel=1e-9)
    assert got["approach_speed"] == pytest.approx(radius * rate, rel=1e-9)
    assert got["final_speed"] == pytest.approx(radius * rate, rel=1e-9)
    assert got["speed_loss"] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.proof
def test_turning_derivatives_are_those_of_the_closed_form():
    t = jnp.array(with_event(np.arange(0, 200, 0.25), 7.3))

    def metrics(p):
        return turning_metrics(turning(t, p[0], p[1], 0.0), 7.3, 1)

    radius, rate = p = jnp.array([50.0, 0.05])
    for jacobian in (jax.jacfwd, jax.jacrev):
        got = compiled(jacobian(metrics))(p)
        for name, expected in {
            "advance": (1, 0),
            "transfer": (1, 0),
            "tactical_diameter": (2, 0),
            "time_to_90": (0, -np.pi / 2 / rate**2),
            "steady_turning_diameter": (2, 0),
            "peak_yaw_rate": (0, 1),
            "approach_speed": (rate, radius),
            "final_speed": (rate, radius),
        }.items():
            np.testing.assert_allclose(got[name], expected, rtol=1e-6, atol=1e-4, err_msg=name)


@pytest.mark.slow
def test_a_short_turn_gives_only_the_numbers_it_contains():
    t = jnp.arange(0, 120, 0.1)
    named = ["advance", "tactical_diameter", "steady_turning_diameter"]

    def numbers(radius, valid):
        got = turning_metrics(replaced(turning(t, radius, drift=0.0), valid=valid), 7.3, 1)
        return jnp.stack([got[name] for name in named])

    jitted = [compiled(f) for f in (numbers, jax.jacfwd(numbers), jax.jacrev(numbers))]
    for turned, there in ((80, 0), (100, 1), (200, 2), (280, 3)):
        valid = t < 7.3 + math.radians(turned) / 0.05
        value, *derivatives = (f(50.0, valid) for f in jitted)
        assert np.isfinite(value).tolist() == [k < there for k in range(3)]
        expected = np.where(np.isfinite(value), [1, 2, 2], 0)
        for derivative in derivatives:
            np.testing.assert_allclose(derivative, expected, atol=1e-4)


def nomoto_zigzag(gain, lag, order=ORDER, heading=ORDER, reversals=4):
    """T dr/dt + r = K delta with exact switching, by another integrator's dense output.

    Returns the arrays t, psi, r with both stamps of every event, and the switch times.
    """
    start, state, sense, pieces, times = 5.0, [0.0, 0.0], 1, [], [5.0]
    for _ in range(reversals + 1):

        def motion(t, z, sense=sense):
            return [z[1], (gain * sense * order - z[1]) / lag]

        def reached(t, z, sense=sense):
            return sense * z[0] - heading

        reached.terminal, reached.direction = True, 1
        run = solve_ivp(
            motion,
            (start, 200),
            state,
            "DOP853",
            events=reached,
            rtol=1e-12,
            atol=1e-14,
            dense_output=True,
        )
        t = np.append(np.arange(start, run.t[-1], 0.25), run.t[-1])
        pieces.append(np.vstack([t, run.sol(t)]))
        start, state, sense = run.t[-1], run.y[:, -1], -sense
        times.append(start)
    before = np.vstack([np.arange(0, 5.01, 0.25), np.zeros((2, 21))])
    t, psi, r = np.hstack([before, *pieces])
    return t, psi, r, np.array(times[:-1])


def nomoto_overshoot(gain, lag, order, rate):
    """Heading gained after the reversal at this yaw rate until it is zero, in closed form."""
    turn = gain * order
    return lag * (rate - turn * math.log(1 + rate / turn))


def straight_ahead(t, psi, r, speed=2.0):
    """Position without drift, only for what is read off along the track."""
    north, east = speed * np.cos(psi), speed * np.sin(psi)
    x, y = (np.append(0, np.cumsum(np.diff(t) * (p[1:] + p[:-1]) / 2)) for p in (north, east))
    return trajectory(t, x, y, psi, np.full_like(t, speed), np.zeros_like(t), r)


@pytest.mark.parametrize("side", [1, -1])
def test_zigzag_of_a_nomoto_ship(side):
    gain, lag, order = 0.25, 4.0, math.radians(20)
    t, psi, r, times = nomoto_zigzag(gain, lag)
    run = straight_ahead(t, side * psi + 0.4, side * r)
    got = ZIGZAG(run, np.append(times, np.nan), side=jnp.array(float(side)))
    rates = np.interp(times, t, r)
    for k in range(1, len(times)):
        expected = nomoto_overshoot(gain, lag, order, abs(rates[k]))
        assert got[f"overshoot_{k}"] == pytest.approx(expected, rel=1e-6)
        check = lag * math.log(1 + abs(rates[k]) / (gain * order))
        assert got[f"time_to_check_yaw_{k}"] == pytest.approx(check, rel=1e-4)
    assert math.isnan(got[f"overshoot_{len(times)}"])
    assert got["period"] == pytest.approx(times[3] - times[1], rel=1e-12)
    assert got["peak_yaw_rate"] == pytest.approx(np.max(np.abs(r)), rel=1e-9)
    assert got["approach_speed"] == pytest.approx(2.0, rel=1e-9)
    # psi = K delta (t - T + T exp(-t/T)) reaches 10 deg here:
    tau = np.linspace(0, 10, 1000001)
    turned = gain * order * (tau - lag + lag * np.exp(-tau / lag))
    quick = tau <= tau[np.argmax(turned >= math.radians(10))]
    assert got["initial_turning_time"] == pytest.approx(tau[quick][-1], abs=2e-5)
    made_good = np.trapezoid(2 * np.cos(turned[quick]), tau[quick])
    assert got["initial_turning_distance"] == pytest.approx(made_good, rel=2e-4)
    dense = (t >= times[1]) & (psi <= 0)
    assert got["reach_time"] == pytest.approx(t[dense][0] - times[0], abs=0.25)


@pytest.mark.parametrize("offset", [1e-7, 0.004, 0.05, 0.0999])
def test_the_peak_yaw_rate_is_the_corner_at_the_reversal_wherever_samples_lie(offset):
    """One sample at the reversal, as in simulated trials; the next comes `offset` s later."""
    gain, lag, order, reversal = 0.25, 4.0, math.radians(20), 2.5
    turn = gain * order
    out, back = np.linspace(0, reversal, 26), np.append(0.0, offset + 0.1 * np.arange(12))
    rate = turn * (1 - np.exp(-out / lag))
    psi = turn * (out - lag + lag * np.exp(-out / lag))
    after = (rate[-1] + turn) * np.exp(-back / lag) - turn
    psi_after = psi[-1] + lag * (rate[-1] + turn) * (1 - np.exp(-back / lag)) - turn * back
    t = np.append(out, reversal + back[1:])
    run = straight_ahead(t, np.append(psi, psi_after[1:]), np.append(rate, after[1:]))
    got = ZIGZAG(run, np.array([0.0, reversal, np.nan]), side=jnp.array(1.0))
    assert got["peak_yaw_rate"] == pytest.approx(rate[-1], rel=1e-9)


@pytest.mark.slow
def test_zigzag_overshoot_has_the_derivative_of_the_closed_form():
    """The first leg and the return in closed form, so everything depends on (K, T)."""
    order = heading = math.radians(20)
    grid = jnp.linspace(0.0, 1.0, 400)

    def leg(gain, lag, tau):
        turn = gain * order
        decay = jnp.exp(-tau / lag)
        return turn * (tau - lag + lag * decay), turn * (1 - decay)

    def switch(gain, lag):
        tau = grid * 20
        c = curve(tau, *leg(gain, lag, tau), jnp.ones(400, bool))
        return crossing_time(c, heading, 1)

    def metrics(p):
        gain, lag = p
        reversal = switch(gain, lag)
        out = reversal * grid
        back = 8.0 * grid
        psi1, rate1 = leg(gain, lag, jnp.array(1.0) * reversal)
        turn = gain * order
        rate = (rate1 + turn) * jnp.exp(-back / lag) - turn
        psi = psi1 + lag * (rate1 + turn) * (1 - jnp.exp(-back / lag)) - turn * back
        first = leg(gain, lag, out)
        t = jnp.concatenate([out, reversal + back])
        zero = jnp.zeros_like(t)
        run = trajectory(
            t,
            t,
            zero,
            jnp.concatenate([first[0], psi]),
            zero + 1,
            zero,
            jnp.concatenate([first[1], rate]),
            valid=jnp.ones(800, bool),
        )
        got = zigzag_metrics(run, jnp.stack([0.0 * reversal, reversal]))
        return jnp.stack([got["overshoot_1"], got["time_to_check_yaw_1"], reversal])

    def oracle(p):
        gain, lag = p
        turn = gain * order
        tau = 0.0
        for _ in range(200):  # psi(tau) = heading by Newton, in plain numpy
            decay = math.exp(-tau / lag) if tau else 1.0
            if tau == 0.0:
                tau = heading / turn + lag
                continue
            tau -= (turn * (tau - lag + lag * decay) - heading) / (turn * (1 - decay))
        rate = turn * (1 - math.exp(-tau / lag))
        return np.array(
            [nomoto_overshoot(gain, lag, order, rate), lag * math.log(1 + rate / turn), tau]
        )

    p = np.array([0.25, 4.0])
    np.testing.assert_allclose(compiled(metrics)(jnp.array(p)), oracle(p), rtol=1e-7)
    expected = np.stack([(oracle(p + d) - oracle(p - d)) / 2e-5 for d in 1e-5 * np.eye(2)], 1)
    for jacobian in (jax.jacfwd, jax.jacrev):
        got = compiled(jacobian(metrics))(jnp.array(p))
        np.testing.assert_allclose(got, expected, rtol=1e-6)


def braking(t, speed=5.0, decay=0.1, psi0=0.7, execute=4.0):
    """Straight on, then slowing down at a constant rate to zero and astern."""
    tau = jnp.maximum(t - execute, 0.0)
    along = speed * (t - execute) - decay * tau**2 / 2
    zero = jnp.zeros_like(t)
    return trajectory(
        t,
        along * jnp.cos(psi0),
        along * jnp.sin(psi0),
        zero + psi0,
        speed - decay * tau,
        zero,
        zero,
    )


def test_stopping_at_a_constant_rate():
    t = jnp.array(with_event(np.arange(0.1, 80, 0.5), 4.0))
    got = compiled(lambda: stopping_metrics(braking(t), 4.0))()
    assert got["track_reach"] == pytest.approx(5.0**2 / (2 * 0.1), rel=1e-9)
    assert got["head_reach"] == pytest.approx(5.0**2 / (2 * 0.1), rel=1e-9)
    assert got["lateral_deviation"] == pytest.approx(0, abs=1e-9)
    assert got["stopping_time"] == pytest.approx(50.0, rel=1e-9)
    assert got["approach_speed"] == pytest.approx(5.0, rel=1e-9)
    gradient = compiled(jax.jacrev(lambda p: stopping_metrics(braking(t, *p), 4.0)))
    np.testing.assert_allclose(
        gradient(jnp.array([5.0, 0.1]))["track_reach"], [5 / 0.1, -(5**2) / 2 / 0.1**2], rtol=1e-8
    )


def test_numbers_of_a_stop_keep_the_precision_of_its_rows():
    t = jnp.arange(0.1, 80, 0.5, dtype=jnp.float32)
    run = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), braking(t))
    run = replaced(run, valid=jnp.ones(t.shape, bool), outcome=jnp.asarray(0))
    found = compiled(lambda: stopping_metrics(run, 4.0))()
    assert {value.dtype for value in found.values()} == {jnp.dtype("float32")}
    assert found["stopping_time"] == pytest.approx(50.0, rel=1e-5)


def test_metrics_of_a_batch_are_those_of_its_members():
    t = jnp.arange(0, 160, 0.5)
    radii = jnp.array([30.0, 50.0])
    one = compiled(lambda radius: turning_metrics(turning(t, radius), 7.3, 1))
    batch = compiled(jax.vmap(lambda radius: turning_metrics(turning(t, radius), 7.3, 1)))(radii)
    for i, radius in enumerate(radii):
        for name, value in one(radius).items():
            assert batch[name][i] == pytest.approx(float(value), rel=1e-12), name


def turning_recording(noise=0.0, side=1, seed=1):
    """A measured turn: 60 s of approach, a stepped rudder, 0.1 s samples, white noise."""
    t = np.arange(0, 260, 0.1)
    run = turning(jnp.array(t), 50.0, 0.05, 0.1, 0.3, side, execute=60.0)
    rng = np.random.default_rng(seed)
    sizes = {"x": 1.0, "y": 1.0, "psi": 0.02, "u": 0.1, "v": 0.1, "r": 0.003}
    noisy = {
        name: np.asarray(getattr(run, name)) + noise * size * rng.standard_normal(len(t))
        for name, size in sizes.items()
    }
    rudder = np.where(t >= 60.0, side * math.radians(35), 0.0)
    return replaced(run, **noisy, commanded={"rudder": rudder})


def zigzag_recording(kind="commanded", channels=None, rate=None, noise=0.0):
    """A measured Nomoto zig-zag at 10 Hz; `rate` (rad/s) makes the steering slow."""
    t0, psi0, r0, times = nomoto_zigzag(0.25, 4.0)
    t = np.arange(0, t0[-1], 0.1)
    rng = np.random.default_rng(3)
    psi = np.interp(t, t0, psi0) + noise * rng.standard_normal(len(t))
    signs = np.append(0, (-1.0) ** np.arange(len(times)))
    angle = ORDER * signs[np.searchsorted(times, t, side="right")]
    if rate is not None:
        for i in range(1, len(t)):
            step = np.clip(angle[i] - angle[i - 1], -rate * 0.1, rate * 0.1)
            angle[i] = angle[i - 1] + step
    channels = channels or (lambda angle: {"rudder": angle})
    run = straight_ahead(t, psi, np.interp(t, t0, r0))
    return replaced(run, **{kind: channels(angle)}), times


def twin(angle):
    """Two thrusts (N) of 80 N in all with this equivalent angle."""
    half = 40.0 * angle / math.radians(35)
    return {"port": 40 + half, "starboard": 40 - half}


@pytest.mark.parametrize(
    "kind, channels, rate",
    [
        ("commanded", None, None),
        ("executed", None, math.radians(15)),
        ("executed", None, math.radians(5)),
        ("commanded", twin, None),
        ("commanded", lambda angle: {"Helm": angle, "port_engine": 9 + 0 * angle}, None),
        ("executed", lambda angle: {"thruster_left": 3 + angle, "thruster_right": 3 - angle}, None),
        ("commanded", lambda angle: {"pod.force": 0 * angle + 9, "pod.angle": angle}, None),
    ],
)
def test_orders_of_a_zigzag_are_found_where_they_were_given(kind, channels, rate):
    run, times = zigzag_recording(kind, channels, rate)
    orders = find_orders(run)
    np.testing.assert_allclose(orders.times, times, atol=0.11)
    assert recognise_trial(run, orders).name == "zigzag"
    assert orders.source.group == kind
    np.testing.assert_array_equal(np.sign(orders.angles), [1, -1, 1, -1, 1])


def test_commands_come_before_executed_values_and_gaps_hold():
    run, times = zigzag_recording()
    rudder = run.commanded["rudder"].copy()
    lag = np.roll(rudder, 30)
    rudder[np.r_[0, 1:20, 200:230]] = np.nan
    orders = find_orders(replaced(run, commanded={"rudder": rudder}, executed={"rudder": lag}))
    np.testing.assert_allclose(orders.times, times, atol=0.11)


def test_hand_steering_before_the_execute_is_no_order():
    run = turning_recording()
    t, rudder = run.t, run.commanded["rudder"].copy()
    rudder[t < 55] = math.radians(20) * np.sin(t[t < 55] / 3)
    rudder[(t > 20) & (t < 21)] = math.radians(35)
    rudder[(t > 57) & (t < 58)] = -math.radians(35)
    steered = replaced(run, commanded={"rudder": rudder})
    got = recording_metrics(steered)
    assert got["manoeuvre"] == "turning-circle"
    assert got["execute_time"] == pytest.approx(60.0)


def test_runs_without_a_trial_are_not_called_one():
    t = np.arange(0, 100, 0.1)
    zero = np.zeros_like(t)
    ahead = straight_ahead(t, 0.001 * np.sin(t), 0.001 * np.cos(t))
    assert recording_metrics(ahead)["manoeuvre"] == "straight"
    rng = np.random.default_rng(5)
    rudder = np.repeat(rng.uniform(-0.6, 0.6, 50), 20)
    psi = np.cumsum(rudder) * 0.01
    wild = replaced(straight_ahead(t, psi, 0.1 * rudder), commanded={"rudder": rudder})
    assert recording_metrics(wild)["manoeuvre"] == "unknown"
    speed = 0.01 + 0.03 * np.clip(t - 30, 0, 10)
    spin = trajectory(t, zero, zero, 0.2 * t, speed, zero, zero + 0.2)
    thrusts = {"port": np.where(t > 30, 50.0, 0), "starboard": np.where(t > 30, -50.0, 0)}
    assert recording_metrics(replaced(spin, commanded=thrusts))["manoeuvre"] == "unknown"


def test_stopping_is_recognised_by_its_propulsion():
    t = np.arange(0, 80, 0.1)
    run = braking(jnp.array(t))
    run = replaced(run, commanded={"propeller": np.where(t < 4, 10.0, -8.0)})
    got = recording_metrics(run, length=10.0)
    assert got["manoeuvre"] == "stopping"
    assert got["execute_time"] == pytest.approx(4.0)
    assert got["track_reach"] == pytest.approx(125.0, rel=1e-3)
    assert got["imo"]["track_reach"]["verdict"] == "pass"


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("side", [1, -1])
def test_a_recorded_turn(noise, side):
    got = recording_metrics(turning_recording(noise, side), length=20.0)
    inwards = np.exp(0.1j)
    advance, tactical = 50 * (1 + 1j) / inwards, 100j / inwards
    near = {"abs": 1.5} if noise else {"rel": 1e-4}  # 1 m of noise at two instants, smoothed
    assert got["manoeuvre"] == "turning-circle"
    assert got["side"] == ("starboard" if side > 0 else "port")
    assert got["advance"] == pytest.approx(advance.real, **near)
    assert got["transfer"] == pytest.approx(advance.imag, **near)
    assert got["tactical_diameter"] == pytest.approx(tactical.imag, **near)
    assert got["steady_turning_diameter"] == pytest.approx(100.0, rel=0.002)
    assert got["approach_speed"] == pytest.approx(2.5, rel=0.01)
    assert 0.05 <= got["peak_yaw_rate"] < 0.058  # the rate jumps between two samples
    assert got["advance_over_L"] == pytest.approx(got["advance"] / 20)
    assert got["imo"]["advance"]["value"] == pytest.approx(got["advance"] / 20)
    assert bool(noise) == any("smoothed" in note for note in got["notes"])
    json.dumps(got, allow_nan=False)


@pytest.mark.parametrize("noise", [0.0, math.radians(0.5)])
def test_a_recorded_zigzag(noise):
    run, times = zigzag_recording(noise=noise)
    got = recording_metrics(run)
    t, psi, r, _ = nomoto_zigzag(0.25, 4.0)
    for k, rate in enumerate(np.interp(times[1:], t, r), start=1):
        expected = nomoto_overshoot(0.25, 4.0, ORDER, abs(rate))
        # The order is known to a sample: 0.1 s of yaw rate, and half the noise.
        margin = 0.1 * abs(rate) + noise / 2
        assert got[f"overshoot_{k}"] == pytest.approx(expected, abs=margin)
    assert "overshoot_5" not in got
    assert got["switching_heading"] == pytest.approx(ORDER, abs=0.01)
    json.dumps(got, allow_nan=False)


def test_what_was_not_recorded_is_derived_or_left_out_and_told():
    run = turning_recording()
    gone = np.full_like(run.t, np.nan)
    full = recording_metrics(run)

    def same(other, names, rel):
        for name in names:
            assert other[name] == pytest.approx(full[name], rel=rel), name

    numbers = ("advance", "transfer", "tactical_diameter", "time_to_90", "approach_speed")
    bare = recording_metrics(replaced(run, u=gone, v=gone, r=gone))
    same(bare, numbers, 1e-3)
    assert any("yaw rate was not recorded" in note for note in bare["notes"])
    assert any("u and v not recorded" in note for note in bare["notes"])
    same(recording_metrics(replaced(run, psi=gone)), numbers, 2e-3)
    nowhere = recording_metrics(replaced(run, x=gone, y=gone))
    same(nowhere, ("time_to_90", "approach_speed", "peak_yaw_rate"), 1e-6)
    assert "advance" not in nowhere
    assert any("positions were not recorded" in note for note in nowhere["notes"])
    holes = {name: np.asarray(getattr(run, name)).copy() for name in ("x", "psi", "u", "r")}
    for i, series in enumerate(holes.values()):
        series[i::7] = np.nan
    wrapped = (holes.pop("psi") + np.pi) % (2 * np.pi) - np.pi
    same(recording_metrics(replaced(run, psi=wrapped, **holes)), numbers, 1e-3)


def test_preparation_keeps_what_is_clean():
    run, _ = zigzag_recording()
    same, notes = prepare_recording(run)
    assert notes == []
    np.testing.assert_array_equal(same.psi, run.psi)
    np.testing.assert_array_equal(same.commanded["rudder"], run.commanded["rudder"])


def test_velocities_are_derived_from_samples_and_not_from_lines_between_them():
    """Noisy fixes in every fourth row: what lies between two predicts itself, noise and all."""
    t, rng = np.arange(0.0, 60.0, 0.05), np.random.default_rng(4)
    psi = 0.6 * np.sin(0.2 * t)
    u, v = 1.2 + 0.2 * np.cos(0.15 * t), 0.1 * np.sin(0.2 * t)
    velocity = (u + 1j * v) * np.exp(1j * psi)
    place = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t))])
    fix = place + 0.03 * (rng.normal(size=t.size) + 1j * rng.normal(size=t.size))
    fix[np.arange(t.size) % 4 != 1] = np.nan * (1 + 1j)
    gone = np.full_like(t, np.nan)
    prepared, _ = prepare_recording(trajectory(t, fix.real, fix.imag, psi, gone, gone, gone))
    assert np.sqrt(np.mean((prepared.u - u) ** 2)) < 0.05
    assert np.sqrt(np.mean((prepared.v - v) ** 2)) < 0.05


def test_impossible_requests_are_told_as_such():
    run = turning_recording()
    gone = np.full_like(run.t, np.nan)
    with pytest.raises(UserError, match="neither heading"):
        recording_metrics(replaced(run, psi=gone, r=gone))
    with pytest.raises(UserError, match="no manoeuvre 'loop'.*zigzag"):
        recording_metrics(run, manoeuvre="loop")
    with pytest.raises(UserError, match="length must be a positive number"):
        recording_metrics(run, length=0.0)
    with pytest.raises(UserError, match="no order was found"):
        recording_metrics(replaced(run, commanded={}), manoeuvre="zigzag")
    with pytest.raises(UserError, match="fewer than four rows"):
        recording_metrics(replaced(run, valid=run.t < 0.2))
    assert "no steering channel" in recording_metrics(replaced(run, commanded={}))["notes"][0]


def degrees(value):
    return pytest.approx(math.radians(value), rel=1e-12)


@pytest.mark.parametrize(
    "ratio, first, second", [(9.9, 10, 25), (11, 10.5, 25.75), (20, 15, 32.5), (30, 20, 40)]
)
def test_imo_limits_of_the_10_10_zigzag(ratio, first, second):
    metrics = {"overshoot_1": math.radians(14), "overshoot_2": math.radians(32)}
    ten = math.radians(10)
    got = imo_verdicts(metrics, ratio, 1.0, RECORDED_TRIALS["zigzag"].criteria, ten, ten)
    assert got["overshoot_1"]["limit"] == degrees(first)
    assert got["overshoot_2"]["limit"] == degrees(second)
    assert got["overshoot_1"]["verdict"] == ("pass" if first >= 14 else "fail")
    assert got["overshoot_2"]["verdict"] == ("pass" if second >= 32 else "fail")
    assert got["overshoot_1"]["unit"] == "rad"


def test_imo_criteria_apply_to_their_own_trial_only():
    metrics = dict.fromkeys(
        ("advance", "tactical_diameter", "initial_turning_distance", "track_reach"), 460.0
    ) | {"overshoot_1": math.radians(26), "overshoot_2": 0.1}

    def verdicts(manoeuvre, *angles):
        criteria = RECORDED_TRIALS[manoeuvre].criteria
        got = imo_verdicts(metrics, 100.0, 8.0, criteria, *(math.radians(a) for a in angles))
        return {name: entry["verdict"] for name, entry in got.items()}

    assert verdicts("turning-circle", 35) == {"advance": "fail", "tactical_diameter": "pass"}
    assert verdicts("turning-circle", -35) == verdicts("turning-circle", 35)
    assert verdicts("turning-circle", 20) == {}
    assert verdicts("zigzag", 20, 20) == {"overshoot_1": "fail"}
    assert verdicts("zigzag", 10, 5) == {"initial_turning_distance": "fail"}
    assert verdicts("stopping") == {"track_reach": "pass"}
    assert verdicts("unknown") == {}
    metrics["advance"] = math.nan
    assert verdicts("turning-circle", 35) == {"tactical_diameter": "pass"}


def test_the_scale_of_a_model_counts_in_its_verdict():
    run, _ = zigzag_recording()
    tens = {"angle": 0.5, "psi": 0.5}
    small = replaced(
        run,
        psi=run.psi * tens["psi"],
        r=run.r * tens["psi"],
        commanded={"rudder": run.commanded["rudder"] * tens["angle"]},
    )
    model = recording_metrics(small, length=7.0)
    ship = recording_metrics(small, length=7.0, scale=49.0)
    assert model["imo"]["overshoot_1"]["limit"] == degrees(10)
    assert ship["imo"]["overshoot_1"]["limit"] == degrees(5 + 0.5 * 7 * 3.5)
    assert ship["overshoot_1"] == model["overshoot_1"]
    assert any("scale of a model" in note for note in model["notes"])


def real(folder, names):
    """Files of a real data set, skipping where it is absent."""
    files = sorted((DATA / folder).glob(names))
    if not files:
        pytest.skip(f"the recordings of {folder} are not here")
    return files


def test_kvlcc2_zigzags_by_hand_count():
    for file in real("kvlcc2_hsva", "*.dat"):
        a = np.loadtxt(file, skiprows=4, encoding="cp1252")
        t, psi, rudder = a[:, 0], a[:, 3], a[:, 8]
        run = trajectory(
            t, a[:, 1], a[:, 2], np.radians(psi), a[:, 4], a[:, 5], np.radians(a[:, 6]),
            executed={"rudder": np.radians(rudder)},
        )  # fmt: skip
        got = recording_metrics(run, length=7.0)
        assert got["manoeuvre"] == "zigzag"
        assert got["side"] == ("port" if file.stem.endswith("_P") else "starboard")
        nominal, heading = (int(part) for part in file.stem.split("_Z_")[1].split("_")[:2])
        assert math.degrees(got["order_angle"]) == pytest.approx(nominal, abs=0.2)
        # By hand: the rudder passes zero soon after each reversal; between two such times
        # the heading has its peak, of which the overshoot is what lies beyond the reversal.
        zero = np.flatnonzero(np.diff(np.sign(np.where(np.abs(rudder) < 0.1, 0.1, rudder))))
        zero = [i for i in zero if t[i] > got["switch_times"][1]]
        for k, (a0, a1) in enumerate(zip(zero[:-1], zero[1:], strict=True), start=1):
            peak = np.max(np.abs(psi[a0:a1]))
            at = abs(np.interp(got["switch_times"][k], t, psi))
            assert heading - 0.3 < at < heading + 1.3, (file.stem, k)
            assert math.degrees(got[f"overshoot_{k}"]) == pytest.approx(peak - at, abs=0.02)


def test_esso_osaka_turns_by_hand_count():
    for file in real("esso_osaka/recordings", "turn*.csv"):
        a = np.loadtxt(file, skiprows=1, delimiter=",")
        t, x, u, y, v, psi, r, n, rudder = a.T
        run = trajectory(t, x, y, psi, u, v, r, commanded={"rudder": rudder, "propeller": n})
        got = recording_metrics(run, length=3.0)
        assert got["manoeuvre"] == "turning-circle"
        start = np.flatnonzero(np.abs(np.diff(rudder)) > 0.15)
        start = start[np.abs(t[start + 1] - got["execute_time"]) < 0.05]
        assert start.size == 1, "the execute is at a step of the rudder"
        heading = np.unwrap(psi) - np.mean(np.unwrap(psi)[start[0] - 30 : start[0]])
        for angle, name in ((90, "time_to_90"), (180, "time_to_180")):
            first = t[np.argmax(np.abs(heading) > math.radians(angle))]
            assert got[name] == pytest.approx(first - got["execute_time"], abs=1.5)
        assert 2 < got["tactical_diameter"] / 3 < 5
        assert got["steady_turning_diameter"] < 1.1 * got["tactical_diameter"]
        assert 0.2 < got["speed_loss"] < 0.8


def test_esso_osaka_zigzags_by_hand_count():
    for file in real("esso_osaka/recordings", "zigzag*.csv"):
        a = np.loadtxt(file, skiprows=1, delimiter=",")
        t, x, u, y, v, psi, r, n, rudder = a.T
        run = trajectory(t, x, y, psi, u, v, r, commanded={"rudder": rudder, "propeller": n})
        got = recording_metrics(run, length=3.0)
        assert got["manoeuvre"] == "zigzag"
        flips = t[1:][np.abs(np.diff(rudder)) > 1.8 * got["order_angle"]]
        held = [np.ptp(rudder[(t >= flip) & (t < flip + 1)]) < 0.01 for flip in flips]
        flips = flips[held]
        np.testing.assert_allclose(got["switch_times"][1:], flips, atol=1e-9)
        for k, (a0, a1) in enumerate(zip(flips[:-1], flips[1:], strict=True), start=1):
            leg = psi[(t >= a0) & (t < a1)]
            peak = np.max(np.sign(leg[0]) * (leg - leg[0]))
            assert got[f"overshoot_{k}"] == pytest.approx(peak, abs=math.radians(0.3))


def test_random_esso_osaka_runs_are_no_trial():
    for file in real("esso_osaka/recordings", "random*.csv"):
        t, x, u, y, v, psi, r, n, rudder = np.loadtxt(file, skiprows=1, delimiter=",").T
        run = trajectory(t, x, y, psi, u, v, r, commanded={"rudder": rudder, "propeller": n})
        assert recording_metrics(run)["manoeuvre"] == "unknown"


def test_a_crossing_with_slope_zero_spoils_no_derivative():
    t = jnp.array([0.0, 1.0, 1.0, 2.0])

    def time(value):
        return crossing_time(curve(t, value, jnp.zeros(4), jnp.ones(4, bool)), 0.0, 1)

    value = jnp.array([-1.0, -0.1, 0.1, 1.0])  # a jump at an event
    assert time(value) == 1.0
    assert np.all(np.isfinite(jax.grad(time)(value)))


def test_approach_speed_is_the_mean_over_the_last_seconds_before_the_order():
    t = jnp.arange(0, 40, 0.7)
    zero, speed = jnp.zeros_like(t), 1 + 0.002 * t**2
    run = trajectory(t, t + 0.002 / 3 * t**3, zero, zero, speed, zero, zero)
    for order, begin in ((30.0, 20.0), (4.0, 0.0)):
        mean = 1 + 0.002 / 3 * (order**3 - begin**3) / (order - begin)
        got = STOPPING(run, jnp.array(order))["approach_speed"]
        assert got == pytest.approx(mean, rel=2e-5)


def test_the_distance_of_uneven_samples_is_that_of_their_speed():
    """A parabola of speed at uneven times, rows repeated: a fifth of what trapezoids are off by."""
    gaps = np.random.default_rng(3).uniform(0.05, 0.15, 400)
    gaps[[50, 51, 200]] = 0.0
    t = jnp.asarray(np.cumsum(gaps))
    zero, speed = jnp.zeros_like(t), 1 + 0.01 * t**2
    run = trajectory(t, t + 0.01 / 3 * t**3, zero, zero, speed, zero, zero)
    mean = 1 + 0.01 / 3 * (30.0**3 - 20.0**3) / 10.0
    trapezoids = 0.01 / 6 * float(np.mean(gaps**2))  # that much too fast without a correction
    got = STOPPING(run, jnp.array(30.0))["approach_speed"]
    assert got == pytest.approx(mean, abs=0.2 * trapezoids)


def test_a_turning_point_is_found_beside_a_repeated_row():
    """After a corner where the curve is highest, and before one."""
    for corner in (1.53, 1.62):
        t = np.sort(np.concatenate([np.arange(0.0, 3.0, 0.125), 4 * [corner]]))
        c = curve(t, np.sin(t), np.cos(t), np.ones(len(t), bool))
        found = highest(c, 1.0)
        assert found.found
        assert float(found.time) == pytest.approx(math.pi / 2, abs=1e-5)


def test_the_original_heading_is_the_mean_of_the_approach():
    run = turning_recording()
    wave = math.radians(1) * np.cos(2 * np.pi * (run.t - 60.0) / 5)  # at its crest at the order
    swinging = replaced(run, psi=run.psi + np.where(run.t < 60.05, wave, 0.0))
    got, steady = recording_metrics(swinging), recording_metrics(run)
    for name in ("advance", "transfer", "tactical_diameter"):
        assert got[name] == pytest.approx(steady[name], abs=0.1), name


def test_shaft_speeds_steer_by_what_they_push():
    t = np.arange(5.0)
    still, ordered = np.zeros((6, 5)), {"port": np.full(5, 3.0), "starboard": np.ones(5)}
    run = trajectory(t, *still, commanded=ordered)
    in_rev = steering_angle(
        as_thrust(run, dict.fromkeys(("port", "starboard"), lambda n: 0.2 * n * np.abs(n)))
    )
    assert in_rev is not None and np.degrees(in_rev[0]) == pytest.approx(35 * (9 - 1) / (9 + 1))
    in_newton = steering_angle(as_thrust(run, {}))
    assert in_newton is not None and np.degrees(in_newton[0]) == pytest.approx(
        35 * (3 - 1) / (3 + 1)
    )
