import copy
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from scipy.stats import chi2

import bnprl_envs
from bnprl_envs import TabularEnv, TabularModel, TabularVectorEnv

IDS = [id for id in bnprl_envs.environment_ids() if bnprl_envs.entry(id).kind == "tabular"]
PARTIALLY_OBSERVED = [id for id in IDS if not bnprl_envs.model(id).fully_observed]


def random_model(seed=0, observed=True):
    """Return S = 4, A = 3, O = 3 with zeros in every table, rewards of all of (a, s, s', o)."""
    rng = np.random.default_rng(seed)
    transition = rng.dirichlet(np.full(4, 0.7), (3, 4))
    transition[:, :, 0] *= rng.random((3, 4)) < 0.5
    observation = rng.dirichlet(np.full(3, 0.7), (3, 4))
    observation[1, :, 1] = 0.0
    return TabularModel(
        transition / transition.sum(axis=2, keepdims=True),
        observation / observation.sum(axis=2, keepdims=True) if observed else None,
        rng.normal(size=(3, 4, 4, 3 if observed else 4)),
        [0.5, 0.2, 0.0, 0.3],
        discount=0.9,
    )


def chain(length=4):
    """Return a certain POMDP: action 1 advances, 0 stays, the end is terminal, o = s % 2."""
    stay, advance = np.eye(length), np.eye(length, k=1)
    advance[-1, -1] = 1.0
    reward = np.zeros((2, length, length, 1))
    reward[1, range(length - 1), range(1, length), 0] = np.arange(1, length)
    return TabularModel(
        np.stack([stay, advance]),
        np.stack([np.eye(2)[np.arange(length) % 2]] * 2),
        reward,
        np.eye(length)[0],
        discount=0.9,
        terminal=np.arange(length) == length - 1,
    )


def p_value(counts, chances):
    """Return the chi-square p of (rows, outcomes) counts; impossible outcomes must not occur."""
    expected = counts.sum(axis=1, keepdims=True) * chances
    assert not counts[chances == 0].any()
    terms = np.where(chances > 0, (counts - expected) ** 2 / np.where(chances > 0, expected, 1), 0)
    freedom = ((chances > 0).sum(axis=1) - 1).sum()
    return chi2.sf(terms.sum(), freedom) if freedom else 1.0


def assert_law(model, action, state, end, observation, reward):
    """Check transitions, flat arrays, against T, O and R."""
    moves, seen = np.zeros(model.transition.shape), np.zeros(model.observation.shape)
    np.add.at(moves, (action, state, end), 1)
    np.add.at(seen, (action, end, observation), 1)
    assert moves.sum(axis=2).min() > 500
    assert p_value(moves.reshape(-1, model.n_states), model.transition_rows.toarray()) > 1e-4
    assert p_value(seen.reshape(-1, seen.shape[2]), model.observation_rows.toarray()) > 1e-4
    np.testing.assert_array_equal(reward, model.reward[action, state, end, observation])


def scalar_episodes(env, seed, episodes=4, limit=60):
    """Return everything that several episodes under fixed actions give."""
    actions = np.random.default_rng(7)
    record = [env.reset(seed=seed)[0]]
    for _ in range(episodes):
        for _ in range(limit):
            result = env.step(int(actions.integers(env.action_space.n)))
            record.append(result[:4])
            if result[2] or result[3]:
                break
        record.append(env.reset()[0])
    return record


# --- the scalar environment -------------------------------------------------------------------


@pytest.mark.parametrize("id", IDS)
def test_gymnasium_checks(id):
    check_env(gym.make(id).unwrapped)
    check_env(TabularEnv(bnprl_envs.model(id)), skip_render_check=True)


@pytest.mark.parametrize("id", IDS)
def test_stable_baselines3_checks(id):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gym.make(id))
        checker.check_env(TabularEnv(random_model(observed=False), max_episode_steps=50))


@pytest.mark.parametrize("id", PARTIALLY_OBSERVED)
def test_spaces_and_the_null_observation(id):
    env = gym.make(id)
    model = env.unwrapped.model
    assert env.action_space == gym.spaces.Discrete(model.n_actions)
    assert env.observation_space == gym.spaces.Discrete(model.n_observations + 1)
    assert env.unwrapped.discount == model.discount
    for _ in range(5):
        observation, info = env.reset(seed=3)
        assert (observation, info) == (model.n_observations, {})
        observation, reward, terminated, truncated, info = env.step(0)
        assert observation < model.n_observations
        assert [type(x) for x in (observation, reward, terminated, truncated, info)] == [
            int,
            float,
            bool,
            bool,
            dict,
        ]


def test_a_fully_observed_model_shows_its_state():
    env = TabularEnv(random_model(observed=False))
    assert env.observation_space == gym.spaces.Discrete(4)
    assert env.reset(seed=0)[0] == env.state
    for action in (0, 1, 2, 1):
        assert env.step(action)[0] == env.state


@pytest.mark.parametrize("id", IDS)
def test_a_seed_fixes_whole_episodes(id):
    one, other = (scalar_episodes(gym.make(id), seed=11) for _ in range(2))
    assert one == other
    env = gym.make(id)
    scalar_episodes(env, seed=5)
    assert scalar_episodes(env, seed=11) == one
    assert scalar_episodes(env, seed=12) != one


@pytest.mark.parametrize("observed", [True, False])
def test_scalar_law(observed):
    model = random_model(observed=observed)
    env = TabularEnv(model)
    env.reset(seed=0)
    actions = np.random.default_rng(1).integers(3, size=60_000)
    rows = []
    for action in actions.tolist():
        state = env.state
        observation, reward, _, _, _ = env.step(action)
        rows.append((action, state, env.state, observation, reward))
    *indices, reward = (np.array(column) for column in zip(*rows, strict=True))
    assert_law(model, *indices, reward)
    starts = []
    for _ in range(5000):
        env.reset()
        starts.append(env.state)
    assert p_value(np.bincount(starts, minlength=4)[None], model.start[None]) > 1e-4


def test_termination_is_not_truncation():
    env = TabularEnv(chain(), max_episode_steps=3)
    env.reset()
    assert [env.step(1)[1:4] for _ in range(3)] == [
        (1.0, False, False),
        (2.0, False, False),
        (3.0, True, False),  # on the last step allowed
    ]
    env.reset()
    assert [env.step(0)[1:4] for _ in range(3)] == [(0.0, False, k == 2) for k in range(3)]
    limited = gym.wrappers.TimeLimit(TabularEnv(chain()), 3)
    limited.reset()
    assert [limited.step(1)[2:4] for _ in range(3)][-1] == (True, True)  # TimeLimit sets both


@pytest.mark.parametrize("action", [-1, 2, 1.0, None, "up", np.array([1, 1])])
def test_an_invalid_action_is_named(action):
    env = TabularEnv(chain())
    env.reset()
    with pytest.raises(ValueError, match=r"^action .* is not an integer in \[0, 1\]$"):
        env.step(action)
    assert env.step(np.int64(1))[1] == 1.0  # and nothing has happened


def test_steps_need_a_running_episode():
    env = TabularEnv(chain(), max_episode_steps=2)
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(ResetNeeded):
        _ = env.state
    env.reset()
    env.step(0)
    env.step(0)
    with pytest.raises(ResetNeeded):
        env.step(0)


def test_copies_go_on_alike():
    env = TabularEnv("bnprl/Hallway-v0")
    env.reset(seed=0)
    env.step(1)
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = [env.step(1) for _ in range(2000) if env._running]
    for other in others:
        assert [other.step(1) for _ in range(len(expected))] == expected


@pytest.mark.parametrize("make", [TabularEnv, TabularVectorEnv])
def test_bad_constructions(make):
    with pytest.raises(ValueError, match="2 agents: use the parallel view"):
        make(
            TabularModel(
                np.ones((4, 1, 1)), np.ones((4, 1, 1)), 0.0, [1.0], 0.9, None, (2, 2), (1, 1)
            )
        )
    with pytest.raises(ValueError, match=r"terminal state '3' has probability 0\.25"):
        make(chain().replace(start=np.full(4, 0.25)))
    with pytest.raises(ValueError, match="max_episode_steps: 0, must be an integer, at least 1"):
        make(chain(), max_episode_steps=0)
    with pytest.raises(ValueError, match="render_mode: 'ascii'"):
        make(chain(), render_mode="ascii")
    with pytest.raises(ValueError, match="did you mean bnprl/Hallway-v0"):
        make("bnprl/Halway-v0")
    with pytest.raises(TypeError, match="resetting"):
        make(chain(), resetting=True)


# --- the batch --------------------------------------------------------------------------------


def assert_same(native, sync):
    """Check observations, rewards, flags and info: values and dtypes."""
    for one, other in zip(native, sync, strict=True):
        assert data_equivalence(one, other, exact=True), (one, other)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("observed", [True, False])
def test_every_autoreset_mode_is_that_of_sync_vector_env(mode, observed):
    model = chain()
    if not observed:
        model = model.replace(observation=None, observation_sizes=None, names=None)
    native = TabularVectorEnv(model, 5, max_episode_steps=6, autoreset_mode=mode)
    sync = SyncVectorEnv([lambda: TabularEnv(model, max_episode_steps=6)] * 5, autoreset_mode=mode)
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] is sync.metadata["autoreset_mode"]
    assert_same(native.reset(seed=0), sync.reset(seed=0))
    rng = np.random.default_rng(2)
    ended = np.zeros(2, dtype=int)
    for _ in range(200):
        actions = rng.integers(2, size=5)
        results = native.step(actions), sync.step(actions)
        assert_same(*results)
        np.testing.assert_array_equal(native.states, sync.get_attr("state"))
        done = results[0][2] | results[0][3]
        ended += results[0][2].sum(), results[0][3].sum()
        if mode is AutoresetMode.DISABLED and done.any():
            assert_same(
                native.reset(options={"reset_mask": done}),
                sync.reset(options={"reset_mask": done}),
            )
    assert ended.min() > 10  # both ways of ending were seen


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_seed_fixes_the_batch(mode):
    envs = gym.make_vec("bnprl/Hallway-v0", num_envs=8, autoreset_mode=mode, max_episode_steps=20)

    def record(seed):
        actions = np.random.default_rng(3)
        results = [envs.reset(seed=seed)[0]]
        for _ in range(100):
            *arrays, _ = envs.step(actions.integers(5, size=8))
            results += arrays
            done = arrays[2] | arrays[3]
            if mode is AutoresetMode.DISABLED and done.any():
                results.append(envs.reset(options={"reset_mask": done})[0])
        return np.concatenate(results)

    one = record(4)
    np.testing.assert_array_equal(record(4), one)
    other = record(5)
    assert other.shape != one.shape or (other != one).any()


@pytest.mark.parametrize("model", [random_model(), random_model(observed=False)])
def test_batch_law(model):
    envs = TabularVectorEnv(model, 1000)
    envs.reset(seed=0)
    assert p_value(np.bincount(envs.states, minlength=4)[None], model.start[None]) > 1e-4
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(60):
        action, state = rng.integers(3, size=1000), envs.states
        observation, reward, _, _, _ = envs.step(action)
        rows.append((action, state, envs.states, observation, reward))
    assert_law(model, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def test_the_batch_earns_the_exact_value_of_random_actions_on_hallway():
    envs = gym.make_vec("bnprl/Hallway-v0", num_envs=20_000, autoreset_mode="Disabled")
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    for t in range(251):
        _, reward, terminated, truncated, _ = envs.step(rng.integers(5, size=envs.num_envs))
        total += running * 0.95**t * reward
        running &= ~terminated
        if (terminated | truncated).any():
            envs.reset(options={"reset_mask": terminated | truncated})
    error = total.std() / np.sqrt(total.size)
    assert abs(total.mean() - 0.042233) < 4 * error < 0.005


def test_make_vec_is_native_and_truncates_itself():
    envs = gym.make_vec("bnprl/Tag-v0", num_envs=3)
    assert type(envs) is TabularVectorEnv
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.discount == 0.95
    envs.reset(seed=0)
    truncated = [envs.step([0, 1, 2])[3] for _ in range(251)]
    assert np.flatnonzero(np.all(truncated, axis=1)).tolist() == [250]
    same = gym.make_vec("bnprl/Tag-v0", num_envs=2, autoreset_mode="SameStep")
    assert same.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert TabularVectorEnv.metadata == {"render_modes": []}


def test_results_are_fresh_arrays():
    envs = TabularVectorEnv(chain(), 4)
    first = envs.reset()[0]
    *arrays, _ = envs.step([1, 1, 0, 0])
    kept = [array.copy() for array in (first, *arrays)]
    for array in (first, *arrays):
        array[:] = 0
    envs.states[:] = 3
    *again, _ = envs.step([0, 0, 0, 0])
    assert [a.dtype for a in again] == [np.int64, np.float64, np.bool_, np.bool_]
    assert kept[0].tolist() == [2, 2, 2, 2]
    assert envs.states.tolist() == [1, 1, 0, 0]


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([0, 1, 2], r"action 2 of copy 2 is not in \[0, 1\]"),
        ([0, -1, 1], r"action -1 of copy 1 is not in \[0, 1\]"),
        ([0, 1], r"actions: shape \(2,\)"),
        ([0.0, 1.0, 1.0], r"actions: shape \(3,\) of float64, must be \(3,\) of integers"),
    ],
)
def test_invalid_actions_are_named(actions, message):
    envs = TabularVectorEnv(chain(), 3)
    envs.reset()
    with pytest.raises(ValueError, match=message):
        envs.step(actions)
    assert envs.states.tolist() == [0, 0, 0]


def test_next_step_ignores_the_action_of_a_reset():
    envs = TabularVectorEnv(chain(2), 2)
    envs.reset()
    envs.step([1, 0])
    observations, rewards, terminated, _, _ = envs.step([99, 1])
    assert observations.tolist() == [2, 1]
    assert rewards.tolist() == [0.0, 1.0]
    assert terminated.tolist() == [False, True]


def test_disabled_names_the_finished_copy():
    envs = TabularVectorEnv(chain(2), 3, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded):
        envs.step([0, 0, 0])
    with pytest.raises(ResetNeeded):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    envs.reset()
    envs.step([0, 0, 1])
    with pytest.raises(ResetNeeded, match="copy 2 has finished"):
        envs.step([0, 0, 0])
    envs.reset(options={"reset_mask": np.array([False, False, True])})
    envs.step([0, 0, 0])


@pytest.mark.parametrize(
    ("mask", "error"),
    [
        ([True, False], TypeError),
        (np.array([1, 0]), TypeError),
        (np.array([True]), ValueError),
        (np.array([False, False]), ValueError),
    ],
)
def test_bad_reset_masks(mask, error):
    envs = TabularVectorEnv(chain(), 2)
    envs.reset()
    with pytest.raises(error, match="reset_mask"):
        envs.reset(options={"reset_mask": mask})


def test_bad_batches():
    with pytest.raises(ValueError, match="num_envs: 0, must be an integer, at least 1"):
        TabularVectorEnv(chain(), 0)
    with pytest.raises(ValueError, match="'NextStep', 'SameStep', 'Disabled'"):
        TabularVectorEnv(chain(), 2, autoreset_mode="never")
    with pytest.raises(TypeError, match="seed"):
        TabularVectorEnv(chain(), 2).reset(seed=[1, 2])
