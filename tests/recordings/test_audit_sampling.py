"""What was made up between samples, or never measured: found where it is, not where it is not."""

import numpy as np
import pytest
from tests.recordings.test_audit import (
    NOISE,
    SHAPES,
    edited,
    kinds,
    motion,
    only,
    recording,
    sampled,
)

from diffsea.recordings import audit
from diffsea.recordings.auditing.repair import repair
from diffsea.series import unwrap


pytestmark = pytest.mark.slow


def resampled_through_the_wrap(run, lowest, every):
    """The heading logged wrapped every so many rows and interpolated as any other number."""
    wrapped = np.mod(run.psi - lowest, 2 * np.pi) + lowest
    rows = np.arange(run.t.size)
    return unwrap(np.interp(rows, rows[::every], wrapped[::every])), wrapped


@pytest.mark.parametrize("lowest", [0.0, -np.pi])
@pytest.mark.parametrize("every", [2, 3, 4])
@pytest.mark.parametrize("seed", range(3))
def test_headings_interpolated_through_the_wrap(seed, every, lowest):
    run = recording("circle", seed, noise=0.3)
    resampled, wrapped = resampled_through_the_wrap(run, lowest, every)
    found = {f.unit: f for f in audit(edited(run, psi=resampled))}
    assert {f.kind for f in found.values()} == {"interpolated"}  # through wraps, between samples
    finding = found["1"]
    assert finding.channels == ("psi",) and "360/0" in finding.message
    crossings = np.sum(np.abs(np.diff(wrapped[::every])) > 5.0)
    assert 1 <= finding.value <= crossings * (every - 1)
    done = repair(edited(run, psi=resampled))
    error = done.run.psi - run.psi
    error = np.mod(error[np.isfinite(error)] + np.pi, 2 * np.pi) - np.pi
    assert np.max(np.abs(error)) < 0.12  # 3 usual steps of this noise and turn
    assert np.max(np.abs(np.diff(done.run.psi[np.isfinite(done.run.psi)]))) < 0.3


@pytest.mark.parametrize("every", [5, 10])
@pytest.mark.parametrize("channels", [("x", "y"), ("u", "v"), ("x", "y", "u", "v")])
@pytest.mark.parametrize("digits", [12, 3])
def test_channels_drawn_straight_between_fixes(channels, every, digits):
    run = recording("random", 1, dt=0.1)
    fixes = run.t[::every]
    drawn = {n: np.interp(run.t, fixes, getattr(run, n)[::every]) for n in channels}
    drawn = {name: np.round(series, digits) for name, series in drawn.items()}
    found = [f for f in audit(edited(run, **drawn)) if f.kind == "interpolated"]
    assert sorted(name for f in found for name in f.channels) == sorted(channels)
    for finding in found:
        assert finding.value == pytest.approx(0.1 * every, rel=0.05) and finding.unit == "s"
    done = repair(edited(run, **drawn))
    assert any(step.finding.kind == "interpolated" for step in done.applied)
    assert np.sum(np.isfinite(getattr(done.run, channels[0]))) <= fixes.size + 1


@pytest.mark.parametrize("shape", ["straight", "speeds", *SHAPES])
@pytest.mark.parametrize("seed", range(12))
def test_noise_and_rounding_are_no_interpolation(shape, seed):
    """Sound runs, some rounded so coarsely that every second bend vanishes."""
    run = recording(
        shape, seed, seconds=60.0, dt=(0.1, 0.5)[seed % 2], noise=(0.0, 0.1, 1.0)[seed % 3]
    )
    digits = (1, 2, 3, 6)[seed % 4]
    rounded = {name: np.round(getattr(run, name), digits) for name in NOISE}
    assert not {"interpolated", "constant"} & set(kinds(edited(run, **rounded)))


@pytest.mark.parametrize("channel", ["x", "psi", "u", "v", "r"])
@pytest.mark.parametrize("value", [0.0, 0.7])
@pytest.mark.parametrize("shape", ["straight", "random"])
def test_a_channel_that_never_changes(shape, value, channel):
    run = recording(shape, 2)
    finding = only(edited(run, **{channel: np.full(run.t.size, value)}), "constant")
    assert finding.channels == (channel,) and finding.value == value
    assert f"is {value:g} in all" in finding.message


def test_what_kinematics_allow_to_be_constant_is_sound():
    t, true, orders = motion("straight", 3)
    run = sampled(t, true, orders, 0, noise=0.0)
    assert np.ptp(run.r) == np.ptp(run.psi) == 0.0
    assert kinds(run) == []
    blank = np.full(run.t.size, np.nan)
    assert kinds(edited(run, r=blank, psi=blank)) == []


def test_a_constant_channel_is_emptied():
    run = recording("random", 2)
    done = repair(edited(run, v=np.zeros(run.t.size)))
    assert [step.finding.kind for step in done.applied] == ["constant"]
    assert not done.run.has("v") and not done.left


def receivers_noise(rng, count, seconds, size):
    """Noise that forgets itself, as filtering receivers have it, at 5 Hz."""
    memory = np.exp(-0.2 * np.arange(int(50 * seconds)) / seconds)
    memory = size * memory / np.linalg.norm(memory)
    return np.convolve(rng.standard_normal(count + memory.size), memory, "full")[memory.size :][
        :count
    ]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(4))
def test_bursts_of_a_receiver(shape, seed):
    """Three spans of 4 s in which the antenna is thrown about by metres."""
    run, rng = recording(shape, seed), np.random.default_rng(seed)
    thrown = {name: getattr(run, name).copy() for name in ("x", "y")}
    starts = (100, 250, 420)
    for start in starts:
        for series in thrown.values():
            series[start : start + 20] += 3 + np.cumsum(rng.standard_normal(20))
    finding = only(edited(run, **thrown), "bursts")
    assert finding.channels == ("x", "y") and finding.unit == "m"
    error = np.hypot(thrown["x"] - run.x, thrown["y"] - run.y)
    assert finding.value == pytest.approx(np.max(error), abs=1.0)


def test_bursts_are_emptied():
    run = recording("zigzag", 1)
    rows = np.arange(250, 270)
    thrown = {name: getattr(run, name).copy() for name in ("x", "y")}
    for series in thrown.values():
        series[rows] += 3 + np.sin(rows)
    emptied = np.isnan(repair(edited(run, **thrown)).run.x)
    assert np.all(emptied[rows]) and np.sum(emptied) < 1.4 * rows.size


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seconds", [1.0, 5.0, 30.0])
@pytest.mark.parametrize("seed", range(4))
def test_noise_with_memory_is_no_burst(seed, seconds, shape):
    run, rng = recording(shape, seed), np.random.default_rng(seed)
    noise = {
        n: getattr(run, n) + receivers_noise(rng, run.t.size, seconds, 0.5) for n in ("x", "y")
    }
    assert "bursts" not in kinds(edited(run, **noise))


def servo(seed, offset=0.0, early=0.0, constant=0.4, noise=0.003):
    """Orders that stand for 6 s, and a rudder that lags behind them; the motion is left out."""
    rng = np.random.default_rng(seed)
    fine = 0.02 * np.arange(6000)
    orders = rng.uniform(-0.4, 0.4, 20)[(fine / 6).astype(int)]
    answer, state = np.zeros(fine.size), 0.0
    for i, order in enumerate(orders):
        state += 0.02 / constant * (order - state)
        answer[i] = state
    t = fine[::10]
    run = recording("zigzag", 1)
    blank = {name: np.full(t.size, np.nan) for name in NOISE}
    blank["u"] = run.u[: t.size]
    executed = np.interp(t + early, fine, answer) + offset + noise * rng.standard_normal(t.size)
    return edited(
        run, t=t, **blank, valid=np.ones(t.size, bool), commanded={"rudder": orders[::10]},
        executed={"rudder": executed},
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("constant", [0.25, 0.4, 1.2])
def test_a_servo_is_no_fault_of_its_feedback(seed, constant):
    assert kinds(servo(seed, constant=constant)) == []
    assert kinds(servo(seed, constant=constant, early=-0.5)) == []  # a dead time


@pytest.mark.parametrize("seed", range(5))
def test_feedback_that_is_offset_or_ahead_of_its_orders(seed):
    finding = only(servo(seed, offset=0.03), "feedback-error")
    assert finding.channels == ("cmd_rudder", "exec_rudder")
    assert finding.parameters["offset"] == pytest.approx(0.03, abs=4 * finding.std + 0.001)
    assert "neutral point" in finding.doubt
    assert finding.unit == "rad" and " deg) more than" in finding.message
    finding = only(servo(seed, early=0.8), "feedback-error")
    assert finding.parameters["delay"] == pytest.approx(-0.8, abs=0.25) and finding.unit == "s"
