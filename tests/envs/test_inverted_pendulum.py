import itertools
import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.integrate import solve_ivp
from scipy.stats import kstest

import bnprl_envs
from bnprl_envs.inverted_pendulum import (
    InvertedPendulumEnv,
    InvertedPendulumVectorEnv,
    acceleration,
    integrate,
    outcome,
    push,
)
from tests.envs.simulation import simulated_value

ID = "bnprl/InvertedPendulum-v0"
OPTIONS = [{}, {"noise": 0.0}, {"noise": 3.5}, {"max_episode_steps": 40}]


def at(env, *state):
    """Begin an episode and put the pendulum into a state."""
    env.reset(seed=0)
    env._state = state
    return env


def exact(angle, velocity, force):
    """Integrate over 0.1 s by another method, from the equation as it is printed in the paper."""

    def slope(_, state):
        theta, omega = state
        a, m, length = 1 / 10, 2.0, 0.5
        top = 9.8 * math.sin(theta) - a * m * length * omega**2 * math.sin(2 * theta) / 2
        top -= a * math.cos(theta) * force
        return omega, top / (4 * length / 3 - a * m * length * math.cos(theta) ** 2)

    return solve_ivp(slope, (0, 0.1), (angle, velocity), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def reachable_states(cell=0.1):
    """Return states (n, 2) met under extreme forces, thinned to one a cell, with the last ones."""
    advance = np.vectorize(integrate)
    front = np.array(list(itertools.product(np.linspace(-0.2, 0.2, 9), repeat=2)))
    met, seen = [front], set()
    while front.size:
        ends = [advance(front[:, 0], front[:, 1], force) for force in (-60.0, -10.0, 10.0, 60.0)]
        front = np.concatenate([np.stack(end, axis=1) for end in ends])
        met.append(front)
        cells = {tuple(np.floor(state / cell)): state for state in front if abs(state[0]) < 1.5708}
        front = np.array([state for key, state in cells.items() if key not in seen])
        seen |= cells.keys()
    return np.concatenate(met)


# --- the dynamics -----------------------------------------------------------------------------


@pytest.mark.parametrize(("action", "force"), [(0, -50.0), (1, 0.0), (2, 50.0)])
def test_forces(action, force):
    assert push(action) == force


@pytest.mark.parametrize(
    ("angle", "velocity", "force", "expected"),
    [
        (0.0, 0.0, 50.0, -5.0 / (2 / 3 - 0.1)),  # upright: only the force, -8.8235
        (0.0, 3.0, 0.0, 0.0),
        (math.pi / 2, 5.0, 50.0, 9.8 * 1.5),  # lying: the force has no lever
        (math.pi / 4, 2.0, 0.0, (9.8 * math.sqrt(0.5) - 0.2) / (2 / 3 - 0.05)),
        (-math.pi / 4, 2.0, 0.0, -(9.8 * math.sqrt(0.5) - 0.2) / (2 / 3 - 0.05)),
    ],
)
def test_accelerations_by_hand(angle, velocity, force, expected):
    assert acceleration(angle, velocity, force) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("state", "action", "expected"),
    [  # one Runge-Kutta step, computed apart with 30 decimals
        ((0.1, -0.2), 2, (0.043640489212937948, -0.94418753177153972)),
        ((0.0, 0.0), 0, (0.044747251907389525, 0.90734963268456858)),
        ((-0.5, 1.5), 1, (-0.38627366627321698, 0.79984537638309042)),
    ],
)
def test_steps_by_hand(state, action, expected):
    env = at(InvertedPendulumEnv(noise=0.0), *state)
    observation, reward, terminated, truncated, info = env.step(action)
    np.testing.assert_allclose(observation, expected, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(env.state, observation)
    assert reward == pytest.approx(abs(state[0]) - abs(expected[0]), abs=1e-13)
    assert (terminated, truncated, info) == (False, False, {})
    assert [type(x) for x in (reward, terminated, truncated)] == [float, bool, bool]


def test_the_step_agrees_with_an_accurate_integration():
    rng = np.random.default_rng(0)
    states = reachable_states()
    states = states[np.abs(states[:, 0]) < math.pi / 2]
    errors = []
    for angle, velocity in states[rng.choice(len(states), 300, replace=False)]:
        force = rng.uniform(-60, 60)
        errors.append(integrate(angle, velocity, force) - exact(angle, velocity, force))
    worst = np.abs(errors).max(axis=0)
    assert worst[0] < 3e-4  # the bounds that the class states
    assert worst[1] < 5e-3
    assert worst[1] > 1e-4  # a high-order method would be another environment


def test_the_observation_space_holds_every_reachable_state():
    space = InvertedPendulumEnv().observation_space
    states = reachable_states()
    assert np.abs(states[:, 0]).max() > 2.2  # the search does push the pole
    assert np.abs(states[:, 1]).max() > 8.5
    assert all(state in space for state in states)


def test_the_mirror_image_is_the_same_pendulum():
    for angle, velocity, force in np.random.default_rng(1).normal(size=(20, 3)):
        one, other = integrate(angle, velocity, force), integrate(-angle, -velocity, -force)
        np.testing.assert_array_equal(one, np.negative(other))


def test_rewards_and_terminations_at_the_boundary():
    fallen, below = math.pi / 2, math.nextafter(math.pi / 2, 0.0)
    assert outcome(0.1, fallen) == (0.1 - fallen, True)
    assert outcome(-0.1, -fallen) == (0.1 - fallen, True)
    assert outcome(0.1, below) == (0.1 - below, False)
    assert outcome(-0.3, 0.1) == (pytest.approx(0.2), False)


# --- the environment --------------------------------------------------------------------------


@pytest.mark.parametrize("options", OPTIONS)
def test_checkers(options):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(ID, **options).unwrapped)
        check_env(InvertedPendulumEnv(**options), skip_render_check=True)
        checker.check_env(gym.make(ID, **options))
        checker.check_env(InvertedPendulumEnv(**options))


def test_what_is_registered():
    env = gym.make(ID)
    assert type(env.unwrapped) is InvertedPendulumEnv
    assert env.spec.max_episode_steps == 3000
    assert env.unwrapped.discount == 0.95
    assert env.action_space == gym.spaces.Discrete(3)
    envs = gym.make_vec(ID, num_envs=3, noise=2.0, autoreset_mode="SameStep")
    assert type(envs) is InvertedPendulumVectorEnv
    assert (envs.max_episode_steps, envs.discount, envs.noise) == (3000, 0.95, 2.0)
    assert envs.single_observation_space == env.observation_space
    assert envs.observation_space.shape == (3, 2)


@pytest.mark.parametrize("noise", [10.0, 4.0])
def test_noise_and_start_in_law(noise):
    env = InvertedPendulumEnv(noise)
    starts, forces = [], []
    for seed in range(1500):
        start, _ = env.reset(seed=seed)
        end, *_ = env.step(1)
        starts.append(start)
        change, low, high = (
            end[1],
            integrate(*start, -noise)[1],
            integrate(*start, noise)[1],
        )
        forces.append((change - low) / (high - low))  # nearly linear in the force
    angle, velocity = np.transpose(starts)
    for sample in (angle / 0.4 + 0.5, velocity / 0.4 + 0.5, forces):
        assert kstest(sample, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(angle, velocity)[0, 1]) < 0.1
    assert abs(np.corrcoef(angle, forces)[0, 1]) < 0.1


def test_a_fall_on_the_last_step_terminates():
    for limit, expected in ((1, (True, False)), (None, (True, False))):
        env = at(InvertedPendulumEnv(max_episode_steps=limit), 1.5, 3.0)
        assert env.step(1)[2:4] == expected
    assert at(InvertedPendulumEnv(max_episode_steps=1), 0.0, 0.0).step(1)[2:4] == (False, True)
    assert at(gym.make(ID, max_episode_steps=1).unwrapped, 0.0, 0.0).step(1)[2:4] == (False, False)


def test_truncation_at_the_horizon():
    envs = InvertedPendulumVectorEnv(4, max_episode_steps=3000)
    observation, _ = envs.reset(seed=0)
    for t in range(3000):
        lean = observation[:, 0] + 0.3 * observation[:, 1]
        observation, _, terminated, truncated, _ = envs.step(1 + np.sign(lean).astype(int))
        assert not terminated.any()
        assert truncated.tolist() == [t == 2999] * 4


# --- the batch --------------------------------------------------------------------------------


def test_one_copy_draws_what_the_scalar_environment_draws():
    env = InvertedPendulumEnv(max_episode_steps=30)
    envs = InvertedPendulumVectorEnv(1, max_episode_steps=30, autoreset_mode="Disabled")
    np.testing.assert_array_equal(env.reset(seed=5)[0], envs.reset(seed=5)[0][0])
    ends = np.zeros(2, dtype=int)
    for action in np.random.default_rng(0).integers(3, size=600).tolist():
        *one, _ = env.step(action)
        *other, _ = envs.step(np.array([action]))
        np.testing.assert_allclose(other[0][0], one[0], rtol=0, atol=1e-14)
        assert other[1][0] == pytest.approx(one[1], abs=1e-14)
        assert (other[2][0], other[3][0]) == (one[2], one[3])
        ends += one[2], one[3]
        if one[2] or one[3]:
            again, _ = envs.reset(options={"reset_mask": np.array([True])})
            np.testing.assert_array_equal(env.reset()[0], again[0])
    assert ends[0] > 10


def test_the_batch_is_the_scalar_step_of_every_copy():
    envs = InvertedPendulumVectorEnv(500, noise=0.0, autoreset_mode="Disabled")
    states, _ = envs.reset(seed=1)
    actions = np.random.default_rng(1).integers(3, size=500)
    for _ in range(2):
        ends, rewards, terminated, _, _ = envs.step(actions)
        for state, action, end, reward, fell in zip(
            states, actions, ends, rewards, terminated, strict=True
        ):
            np.testing.assert_allclose(end, integrate(*state, push(action)), rtol=0, atol=1e-14)
            assert (reward, fell) == (pytest.approx(abs(state[0]) - abs(end[0]), abs=1e-14), False)
        states = ends


def test_batch_noise_in_law():
    envs = InvertedPendulumVectorEnv(4000)
    start, _ = envs.reset(seed=2)
    end, *_ = envs.step(np.ones(4000, dtype=int))
    low, high = (np.vectorize(integrate)(*start.T, force)[1] for force in (-10.0, 10.0))
    assert kstest((end[:, 1] - low) / (high - low), "uniform").pvalue > 1e-3
    assert kstest(start.ravel() / 0.4 + 0.5, "uniform").pvalue > 1e-3


def test_reference_values():
    def balance(states):
        lean = states[:, 0] + 0.15 * states[:, 1]
        return 1 + (lean > 0.04).astype(int) - (lean < -0.04)

    values = {reference.name: reference.value for reference in bnprl_envs.entry(ID).references}
    rng = np.random.default_rng(0)
    mean, error = simulated_value(ID, 5000, lambda states: rng.integers(3, size=len(states)))
    assert abs(mean - values["random"]) < 4 * error < 0.02
    mean, error = simulated_value(ID, 5000, balance, max_episode_steps=200)  # .95^200 = 4e-5
    assert abs(mean - values["lower"]) < 4 * error < 0.005


@pytest.mark.parametrize("make", [InvertedPendulumEnv, InvertedPendulumVectorEnv])
@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("noise", -1.0, r"noise: -1\.0, must lie in \[0, 10\]"),
        ("noise", 10.5, r"noise: 10\.5, must lie in \[0, 10\]"),
        ("noise", math.nan, "noise: nan"),
        ("noise", "much", "noise: 'much'"),
        ("max_episode_steps", 0, "max_episode_steps: 0, must be an integer, at least 1"),
        ("render_mode", "ascii", "render_mode: 'ascii'"),
    ],
)
def test_bad_arguments(make, argument, value, message):
    with pytest.raises(ValueError, match=message):
        make(**{argument: value})
