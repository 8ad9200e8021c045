import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.stats import kstest

import bnprl_envs
from bnprl_envs.puddle_world import (
    PuddleWorldEnv,
    PuddleWorldVectorEnv,
    depth,
    moved,
    outcome,
    starts,
)
from tests.envs.simulation import simulated_value

ID = "bnprl/PuddleWorld-v0"
OPTIONS = [{}, {"uniform_start": True}, {"noise": 0.0}, {"noise": 0.1, "max_episode_steps": 40}]


def at(env, *state):
    """Begin an episode and put the agent somewhere."""
    env.reset(seed=0)
    env._state = state
    return env


# --- the rules --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        (0.3, 0.75, 0.1),  # on the axis of the first puddle
        (0.3, 0.81, 0.04),
        (0.3, 0.69, 0.04),
        (0.3, 0.86, 0.0),
        (0.04, 0.67, 0.0),  # by its western end: 0.06 and 0.08 away make 0.1
        (0.07, 0.71, 0.05),  # 0.03 and 0.04 make 0.05
        (0.45, 0.5, 0.1),  # on the axis of the second
        (0.52, 0.5, 0.03),
        (0.42, 0.36, 0.05),  # below its southern end
        (0.45, 0.31, 0.01),
        (0.48, 0.84, 0.05),  # above its northern end; the first puddle is 0.0949 away
        (0.35, 0.7, 0.05),  # the first; the second one's edge
        (0.4, 0.72, 0.07),  # in both: 0.03 and 0.05 from the axes
        (0.45, 0.75, 0.1),  # on both
        (0.05, 0.05, 0.0),
        (0.9, 0.9, 0.0),
    ],
)
def test_depths_by_hand(x, y, expected):
    assert depth(x, y) == pytest.approx(expected, abs=1e-12)
    assert depth(x, y) >= 0.0


def test_depth_against_a_search_along_the_axes():
    points = np.random.default_rng(0).random((300, 2))
    along = np.linspace(0, 1, 4001)[:, None]
    axes = [(0.1, 0.75) + along * (0.35, 0.0), (0.45, 0.4) + along * (0.0, 0.4)]
    nearest = [min(np.linalg.norm(axis - point, axis=1).min() for axis in axes) for point in points]
    expected = np.maximum(0.1 - np.array(nearest), 0.0)
    assert (expected > 0).sum() > 30
    np.testing.assert_allclose([depth(x, y) for x, y in points], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("state", "action", "expected", "reward"),
    [
        ((0.05, 0.05), 0, (0.05, 0.1), -1.0),
        ((0.05, 0.05), 1, (0.05, 0.0), -1.0),
        ((0.05, 0.05), 2, (0.1, 0.05), -1.0),
        ((0.05, 0.05), 3, (0.0, 0.05), -1.0),
        ((0.02, 0.99), 3, (0.0, 0.99), -1.0),  # the border stops
        ((0.02, 0.99), 0, (0.02, 1.0), -1.0),
        ((0.3, 0.6), 0, (0.3, 0.65), -1.0),  # the edge of a puddle
        ((0.3, 0.63), 0, (0.3, 0.68), -13.0),  # into it: 0.03 deep
        ((0.3, 0.7), 0, (0.3, 0.75), -41.0),  # to the bottom
        ((0.3, 0.82), 0, (0.3, 0.87), -1.0),  # out of it: the end counts
        ((0.93, 0.93), 0, (0.93, 0.98), 0.0),
    ],
)
def test_steps_by_hand(state, action, expected, reward):
    env = at(PuddleWorldEnv(noise=0.0), *state)
    observation, earned, terminated, truncated, info = env.step(action)
    np.testing.assert_allclose(observation, expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(env.state, observation)
    assert earned == pytest.approx(reward, abs=1e-10)
    assert (terminated, truncated, info) == (reward == 0.0, False, {})
    assert [type(x) for x in (earned, terminated, truncated)] == [float, bool, bool]


def test_noise_is_added_before_the_border_stops():
    assert moved(0.5, 0.5, 2, 0.01, -0.02) == pytest.approx((0.56, 0.48))
    assert moved(0.97, 0.01, 2, -0.03, -0.02) == pytest.approx((0.99, 0.0))


def test_rewards_and_terminations_at_the_boundary():
    assert outcome(0.9, 1.0) == (0.0, True)
    assert outcome(1.0, 1.0) == (0.0, True)
    assert outcome(0.9, math.nextafter(1.0, 0.0) - 1e-12) == (-1.0, False)


# --- the environment --------------------------------------------------------------------------


@pytest.mark.parametrize("options", OPTIONS)
def test_checkers(options):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(ID, **options).unwrapped)
        check_env(PuddleWorldEnv(**options), skip_render_check=True)
        checker.check_env(gym.make(ID, **options))
        checker.check_env(PuddleWorldEnv(**options))


def test_what_is_registered():
    env = gym.make(ID)
    assert type(env.unwrapped) is PuddleWorldEnv
    assert env.spec.max_episode_steps == 1000
    assert env.unwrapped.discount == 0.99
    assert env.action_space == gym.spaces.Discrete(4)
    assert env.observation_space == gym.spaces.Box(0.0, 1.0, (2,), np.float64)
    envs = gym.make_vec(ID, num_envs=3, uniform_start=True, autoreset_mode="SameStep")
    assert type(envs) is PuddleWorldVectorEnv
    assert (envs.max_episode_steps, envs.discount, envs.uniform_start) == (1000, 0.99, True)
    assert envs.single_observation_space == env.observation_space


def test_starts():
    assert PuddleWorldEnv().reset(seed=0)[0].tolist() == [0.05, 0.05]
    assert PuddleWorldVectorEnv(2).reset(seed=0)[0].tolist() == [[0.05, 0.05]] * 2
    env, envs = PuddleWorldEnv(uniform_start=True), PuddleWorldVectorEnv(3, uniform_start=True)
    assert len({tuple(env.reset(seed=seed)[0].tolist()) for seed in range(5)}) == 5
    assert len(np.unique(envs.reset(seed=0)[0])) == 6
    points = starts(200_000, True, np.random.default_rng(0))
    assert points.sum(axis=1).max() < 1.9
    density = np.histogram2d(*points.T, bins=4, range=[(0, 1)] * 2)[0] / 200_000
    expected = np.full((4, 4), 1 / 16)
    expected[3, 3] -= 0.005  # the goal
    assert np.abs(density - expected / 0.995).max() < 5 * math.sqrt(1 / 16 / 200_000)


@pytest.mark.parametrize("noise", [0.01, 0.003])
def test_noise_in_law(noise):
    env, envs = PuddleWorldEnv(noise=noise), PuddleWorldVectorEnv(2500, noise=noise)
    env.reset(seed=0)
    envs.reset(seed=0)
    steps = []
    for _ in range(2500):
        env._state = (0.5, 0.5)
        steps.append(env.step(2)[0] - (0.55, 0.5))
    envs._observations[:] = 0.5
    for sample in (np.array(steps), envs.step(np.full(2500, 2))[0] - (0.55, 0.5)):
        for coordinate in sample.T:
            assert kstest(coordinate / noise, "norm").pvalue > 1e-3
        assert abs(np.corrcoef(*sample.T)[0, 1]) < 0.1


def test_the_goal_on_the_last_step_terminates():
    for limit in (1, None):
        env = at(PuddleWorldEnv(max_episode_steps=limit), 0.95, 0.95)
        assert env.step(0)[1:4] == (0.0, True, False)
    assert at(PuddleWorldEnv(max_episode_steps=1), 0.5, 0.1).step(0)[1:4] == (-1.0, False, True)


def test_truncation_at_the_horizon():
    env = gym.make(ID)
    env.reset(seed=0)
    flags = [env.step(3)[2:4] for _ in range(1000)]
    assert flags == [(False, t == 999) for t in range(1000)]
    envs = gym.make_vec(ID, num_envs=2)
    envs.reset(seed=0)
    truncated = [envs.step([3, 1])[3].tolist() for _ in range(1000)]
    assert truncated == [[t == 999] * 2 for t in range(1000)]


# --- the batch --------------------------------------------------------------------------------


@pytest.mark.parametrize(("uniform_start", "limit"), [(False, 60), (True, 25)])
def test_one_copy_draws_what_the_scalar_environment_draws(uniform_start, limit):
    arguments = {"uniform_start": uniform_start, "max_episode_steps": limit}
    env = PuddleWorldEnv(**arguments)
    envs = PuddleWorldVectorEnv(1, **arguments, autoreset_mode="Disabled")
    np.testing.assert_array_equal(env.reset(seed=5)[0], envs.reset(seed=5)[0][0])
    ends = np.zeros(2, dtype=int)
    for action in np.random.default_rng(0).choice(4, p=(0.4, 0.1, 0.4, 0.1), size=2000).tolist():
        *one, _ = env.step(action)
        *other, _ = envs.step(np.array([action]))
        np.testing.assert_allclose(other[0][0], one[0], rtol=0, atol=1e-15)
        assert other[1][0] == pytest.approx(one[1], abs=1e-12)
        assert (other[2][0], other[3][0]) == (one[2], one[3])
        ends += one[2], one[3]
        if one[2] or one[3]:
            again, _ = envs.reset(options={"reset_mask": np.array([True])})
            np.testing.assert_array_equal(env.reset()[0], again[0])
    assert ends.min() > 5


def test_the_batch_is_the_scalar_step_of_every_copy():
    envs = PuddleWorldVectorEnv(500, uniform_start=True, noise=0.0, autoreset_mode="Disabled")
    states, _ = envs.reset(seed=1)
    actions = np.random.default_rng(1).integers(4, size=500)
    ends, rewards, terminated, _, _ = envs.step(actions)
    for k, (state, action) in enumerate(zip(states, actions, strict=True)):
        end = moved(*state, action, 0.0, 0.0)
        assert ends[k] == pytest.approx(end, abs=1e-15)
        assert (rewards[k], terminated[k]) == pytest.approx(outcome(*end), abs=1e-12)
    assert rewards.min() < -20.0


def test_reference_values():
    values = {reference.name: reference.value for reference in bnprl_envs.entry(ID).references}
    rng = np.random.default_rng(0)
    mean, error = simulated_value(ID, 1000, lambda states: rng.integers(4, size=len(states)))
    assert abs(mean - values["random"]) < 4 * error < 25.0
    mean, error = simulated_value(ID, 5000, lambda states: np.where(states[:, 0] < 0.9, 2, 0))
    assert abs(mean - values["lower"]) < 4 * error < 0.1


@pytest.mark.parametrize("make", [PuddleWorldEnv, PuddleWorldVectorEnv])
@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("noise", -0.1, r"noise: -0\.1, must lie in \[0, 1\]"),
        ("noise", math.inf, "noise: inf"),
        ("noise", None, "noise: None"),
        ("max_episode_steps", -5, "max_episode_steps: -5, must be an integer, at least 1"),
        ("render_mode", "ascii", "render_mode: 'ascii'"),
    ],
)
def test_bad_arguments(make, argument, value, message):
    with pytest.raises(ValueError, match=message):
        make(**{argument: value})
