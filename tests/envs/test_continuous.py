"""What the two environments with a continuous state share: episodes, batches, bad input."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from bnprl_envs import inverted_pendulum, puddle_world
from bnprl_envs.inverted_pendulum import InvertedPendulumEnv, InvertedPendulumVectorEnv
from bnprl_envs.puddle_world import PuddleWorldEnv, PuddleWorldVectorEnv

IDS = ["bnprl/InvertedPendulum-v0", "bnprl/PuddleWorld-v0"]
SCALAR = [InvertedPendulumEnv, PuddleWorldEnv]
VECTOR = [InvertedPendulumVectorEnv, PuddleWorldVectorEnv]
PAIRS = list(zip(SCALAR, VECTOR, strict=True))


@pytest.fixture
def certain_starts(monkeypatch):
    """Begin all episodes alike, the puddle world's near the goal."""
    monkeypatch.setattr(inverted_pendulum, "START", 0.0)
    monkeypatch.setattr(puddle_world, "START", (0.85, 0.85))


def scalar_record(env, seed, steps=400):
    """Return the numbers of several episodes under fixed actions, as one array."""
    actions = np.random.default_rng(7)
    record = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        observation, *rest, _ = env.step(int(actions.integers(env.action_space.n)))
        record += [observation, rest]
        if rest[1] or rest[2]:
            record.append(env.reset()[0])
    return np.concatenate(record)


@pytest.mark.parametrize("id", IDS)
def test_a_seed_fixes_whole_episodes(id):
    one, other = (scalar_record(gym.make(id, max_episode_steps=60), seed=11) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    env = gym.make(id, max_episode_steps=60)
    scalar_record(env, seed=5)
    np.testing.assert_array_equal(scalar_record(env, seed=11), one)
    other = scalar_record(env, seed=12)
    assert other.shape != one.shape or (other != one).any()


@pytest.mark.parametrize("make", SCALAR)
def test_copies_go_on_alike(make):
    env = make(max_episode_steps=50)
    env.reset(seed=0)
    env.step(1)
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = [env.step(1)[0] for _ in range(5)]
    for other in others:
        np.testing.assert_array_equal([other.step(1)[0] for _ in range(5)], expected)


@pytest.mark.parametrize("make", SCALAR)
def test_steps_need_a_running_episode(make):
    env = make(max_episode_steps=2)
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(ResetNeeded):
        _ = env.state
    env.reset(seed=0)
    env.step(0)
    env.step(1)
    with pytest.raises(ResetNeeded):
        env.step(0)


@pytest.mark.parametrize("make", SCALAR)
@pytest.mark.parametrize("action", [-1, 4, 1.0, None, "up", np.array([1, 1])])
def test_an_invalid_action_is_named(make, action):
    env = make()
    state, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"^action .* is not an integer in \[0, [23]\]$"):
        env.step(action)
    np.testing.assert_array_equal(env.state, state)  # and nothing has happened
    env.step(np.int64(1))


@pytest.mark.parametrize("make", SCALAR)
def test_states_are_fresh_arrays(make):
    env = make()
    first, _ = env.reset(seed=0)
    for array in (env.state, first):
        kept = array.copy()
        array[:] = 7.0
        np.testing.assert_array_equal(env.state, kept)


# --- the batch --------------------------------------------------------------------------------


@pytest.mark.usefixtures("certain_starts")
@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(("scalar", "vector"), PAIRS)
def test_every_autoreset_mode_is_that_of_sync_vector_env(scalar, vector, mode):
    arguments = {"noise": 0.0, "max_episode_steps": 9}
    native = vector(5, **arguments, autoreset_mode=mode)
    sync = SyncVectorEnv([lambda: scalar(**arguments)] * 5, autoreset_mode=mode)
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] is sync.metadata["autoreset_mode"]
    assert_same(native.reset(seed=0), sync.reset(seed=0))
    rng, ended = np.random.default_rng(2), np.zeros(2, dtype=int)
    for _ in range(200):
        actions = rng.integers(native.single_action_space.n, size=5)
        results = native.step(actions), sync.step(actions)
        assert_same(*results)
        np.testing.assert_array_equal(native.states, sync.get_attr("state"))
        done = results[0][2] | results[0][3]
        ended += results[0][2].sum(), results[0][3].sum()
        if mode is AutoresetMode.DISABLED and done.any():
            assert_same(*(e.reset(options={"reset_mask": done}) for e in (native, sync)))
    assert ended.min() > 5  # both ways of ending were seen


def assert_same(native, sync):
    """Check observations, rewards, flags and info: values to 1e-14, and dtypes."""
    for one, other in zip(native[:-1], sync[:-1], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
    one, other = native[-1], sync[-1]
    assert one.keys() == other.keys()
    for a, b in zip(one.pop("final_obs", ()), other.pop("final_obs", ()), strict=True):
        assert (a is None) == (b is None)
        if a is not None:
            assert (a.dtype, a.shape) == (b.dtype, b.shape)
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)
    assert data_equivalence(one, other, exact=True)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("id", IDS)
def test_a_seed_fixes_the_batch(id, mode):
    envs = gym.make_vec(id, num_envs=8, autoreset_mode=mode, max_episode_steps=20)

    def record(seed):
        actions = np.random.default_rng(3)
        results = [envs.reset(seed=seed)[0].ravel()]
        for _ in range(100):
            *arrays, _ = envs.step(actions.integers(envs.single_action_space.n, size=8))
            results += [array.ravel() for array in arrays]
            done = arrays[2] | arrays[3]
            if mode is AutoresetMode.DISABLED and done.any():
                results.append(envs.reset(options={"reset_mask": done})[0].ravel())
        return np.concatenate(results)

    one = record(4)
    np.testing.assert_array_equal(record(4), one)
    other = record(5)
    assert other.shape != one.shape or (other != one).any()


@pytest.mark.parametrize("make", VECTOR)
def test_a_mask_leaves_the_others_alone(make):
    envs = make(3, autoreset_mode="Disabled", max_episode_steps=3)
    with pytest.raises(ResetNeeded):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(ResetNeeded):
        envs.step([0, 0, 0])
    envs.reset(seed=0)
    before = envs.step([1, 1, 1])[0]
    after, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    assert (after[1] != before[1]).any()
    envs.step([1, 1, 1])
    assert envs.step([1, 1, 1])[3].tolist() == [True, False, True]  # steps are counted apart
    with pytest.raises(ResetNeeded, match="copy 0 has finished"):
        envs.step([1, 1, 1])


@pytest.mark.parametrize("make", VECTOR)
def test_next_step_ignores_the_action_of_a_reset(make):
    envs = make(2, max_episode_steps=1)
    envs.reset(seed=0)
    envs.step([0, 0])
    _, rewards, terminated, truncated, info = envs.step([99, -7])
    assert rewards.tolist() == [0.0, 0.0]
    assert not (terminated | truncated).any()
    assert info == {}
    assert envs.step([0, 0])[3].all()


@pytest.mark.parametrize("make", VECTOR)
def test_results_are_fresh_arrays(make):
    envs = make(4, autoreset_mode="SameStep", max_episode_steps=2)
    first, _ = envs.reset(seed=0)
    *arrays, _ = envs.step([1, 1, 0, 0])
    states = envs.states
    for array in (first, *arrays, envs.states):
        array[:] = 1
    np.testing.assert_array_equal(envs.states, states)
    *again, info = envs.step([0, 0, 0, 0])
    assert [a.dtype for a in again] == [np.float64, np.float64, np.bool_, np.bool_]
    final = [row.copy() for row in info["final_obs"]]
    envs.step([1, 1, 1, 1])
    np.testing.assert_array_equal(np.stack(info["final_obs"]), final)


@pytest.mark.parametrize("make", VECTOR)
@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([0, 1, 4], r"action 4 of copy 2 is not in \[0, [23]\]"),
        ([0, -1, 1], r"action -1 of copy 1 is not in"),
        ([0, 1], r"actions: shape \(2,\)"),
        ([0.0, 1.0, 1.0], r"actions: shape \(3,\) of float64, must be \(3,\) of integers"),
    ],
)
def test_invalid_actions_are_named(make, actions, message):
    envs = make(3)
    states, _ = envs.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        envs.step(actions)
    np.testing.assert_array_equal(envs.states, states)


@pytest.mark.parametrize("make", VECTOR)
def test_bad_batches(make):
    with pytest.raises(ValueError, match="num_envs: 0, must be an integer, at least 1"):
        make(0)
    with pytest.raises(ValueError, match="'NextStep', 'SameStep', 'Disabled'"):
        make(2, autoreset_mode="never")
    with pytest.raises(TypeError, match="seed"):
        make(2).reset(seed=[1, 2])
    with pytest.raises(ResetNeeded):
        _ = make(2).states
    envs = make(2)
    envs.reset()
    with pytest.raises(TypeError, match="reset_mask"):
        envs.reset(options={"reset_mask": [True, False]})
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.zeros(2, dtype=np.bool_)})
