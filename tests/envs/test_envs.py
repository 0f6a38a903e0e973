"""Gymnasium environments: its own checker, and boats that move as diffsea's do."""

import os
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from tests.boats import BOAT
from tests.exports import models

from diffsea.errors import UserError
from diffsea.vessel.files import build, read_vessel


pytest.importorskip("gymnasium", reason="Gymnasium is not installed")

from gymnasium.utils.env_checker import check_env

from diffsea.envs import BoatEnv, BoatVectorEnv, Task


SHORT = Task(interval=0.5, seconds=5.0)


@pytest.fixture(scope="module")
def boat():
    return build(tomllib.loads(BOAT))


@pytest.mark.parametrize("name", ["otter", "pytheas"])
def test_gymnasium_s_checker_finds_no_fault(name):
    check_env(BoatEnv(read_vessel(name).vessel, SHORT), skip_render_check=True)


def test_imported_by_its_own_name_it_sets_jax_up():
    """As the page on Python shows it: 64 bits, and no warning."""
    program = (
        "from diffsea.envs import BoatVectorEnv\n"
        "import diffsea, jax\n"
        "boats = BoatVectorEnv(diffsea.read_vessel('otter').vessel, num_envs=2)\n"
        "boats.reset(seed=0)\n"
        "print(boats._boats.motion.state.x.dtype)\n"
    )
    command = [sys.executable, "-W", "error::UserWarning", "-c", program]
    own = ("JAX_ENABLE_X64", "XLA_FLAGS", "DIFFSEA_SETUP")  # what another test may have set
    clean = {name: value for name, value in os.environ.items() if name not in own}
    done = subprocess.run(command, env=clean, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "float64\n"


def test_a_boat_moves_as_diffsea_s(boat):
    env = BoatEnv(boat, SHORT)
    first, _ = env.reset(seed=3)
    goal = np.hypot(*first[:2]) * 4.0
    bearing = np.arctan2(first[1], first[0])
    rewards = 0.0
    for _ in range(6):
        seen, reward, _, _, _ = env.step(np.array([0.8, -0.3], np.float32))
        rewards += reward
    orders = {"port": 0.8 * 400, "starboard": -0.3 * 300}
    expected = models.run(boat, np.zeros(6), [(-1.0, orders)], 3.0)[0][-1]
    scale = np.sqrt(9.81 * 4.0)
    np.testing.assert_allclose(seen[2:4] * scale, expected[3:5], rtol=1e-4, atol=1e-5)
    assert seen[4] * np.sqrt(9.81 / 4.0) == pytest.approx(expected[5], rel=1e-4)
    np.testing.assert_allclose(seen[5:], [0.8, -0.3], rtol=1e-6)
    # The goal, from where the boat is now, in axes of where it began.
    left = goal * np.array([np.cos(bearing), np.sin(bearing)]) - expected[:2]
    assert np.hypot(*seen[:2]) * 4.0 == pytest.approx(np.hypot(*left), rel=1e-5)
    assert rewards == pytest.approx((goal - np.hypot(*left)) / 4.0, rel=1e-4)


def test_a_thousand_boats_step_at_once_each_as_if_alone(boat):
    many = BoatVectorEnv(boat, 1024, SHORT)
    seen, _ = many.reset(seed=1)
    assert seen.shape == (1024, 7) and many.observation_space.contains(seen)
    assert len(np.unique(seen[:, 0])) == 1024
    rng = np.random.default_rng(0)
    actions = [rng.uniform(-1, 1, (1024, 2)).astype(np.float32) for _ in range(3)]
    for action in actions:
        after, reward, reached, late, _ = many.step(action)
    assert after.shape == (1024, 7) and reward.shape == (1024,)
    alone = BoatVectorEnv(boat, 1, SHORT)
    alone.reset(seed=9)
    for action in actions:
        one, *_ = alone.step(action[700:701])
    np.testing.assert_allclose(one[0, 2:], after[700, 2:], rtol=1e-5, atol=1e-6)


def test_boats_that_are_done_begin_anew_at_the_next_step(boat):
    many = BoatVectorEnv(boat, 5, SHORT)
    many.reset(seed=2)
    ahead = np.ones((5, 2), np.float32)
    for step in range(1, 11):
        _, _, reached, late, _ = many.step(ahead)
        assert late.all() == (step == 10) and not reached.any()
    seen, reward, reached, late, _ = many.step(ahead)
    assert (reward == 0).all() and not (reached | late).any()
    np.testing.assert_array_equal(seen[:, 2:], 0.0)


def test_a_goal_is_reached_within_one_length_and_rewarded(boat):
    near = Task(interval=0.5, seconds=60.0, nearest=1.2, farthest=1.3)
    many = BoatVectorEnv(boat, 64, near)
    many.reset(seed=0)
    found = False
    for _ in range(12):
        seen, reward, reached, _, _ = many.step(np.ones((64, 2), np.float32))
        distance = np.hypot(*seen[:, :2].T)
        if reached.any():
            found = True
            assert (distance[reached] <= 1.0 + 1e-6).all() and (reward[reached] > 1.0).all()
    assert found


def test_a_vessel_without_limits_is_refused():
    with pytest.raises(UserError, match="'port' has no limits"):
        BoatEnv(read_vessel("marus_usv").vessel)
