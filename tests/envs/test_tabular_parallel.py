import copy
import pickle

import numpy as np
import pettingzoo
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from pettingzoo.test import parallel_api_test

import bnprl_envs
from bnprl_envs import TabularModel, TabularParallelBatch, TabularParallelEnv
from tests.envs.test_tabular import assert_law, chain, p_value

IDS = [id for id in bnprl_envs.environment_ids() if bnprl_envs.entry(id).kind == "parallel-tabular"]
VARIANTS = [*((id, {}) for id in IDS), ("bnprl/MeetingGrid-v0", {"size": 2})]
LIMIT = 30


def team_model(seed=0, observed=True):
    """Return S = 3, A = 2 x 3, O = 3 x 2, rewards of all of (a, s, s', o)."""
    rng = np.random.default_rng(seed)
    return TabularModel(
        rng.dirichlet(np.ones(3), (6, 3)),
        rng.dirichlet(np.ones(6), (6, 3)) if observed else None,
        rng.normal(size=(6, 3, 3, 6 if observed else 3)),
        [0.5, 0.2, 0.3],
        discount=0.8,
        action_sizes=(2, 3),
        observation_sizes=(3, 2) if observed else (3, 1),
    )


def team_chain(length=4):
    """Return the certain chain for two agents: it advances if both choose 1; each sees s % 2."""
    one = chain(length)
    joint = [0, 0, 0, 1]
    return TabularModel(
        one.transition[joint],
        np.stack([np.eye(4)[3 * (np.arange(length) % 2)]] * 4),
        one.reward[joint],
        one.start,
        discount=0.9,
        terminal=one.terminal,
        action_sizes=(2, 2),
        observation_sizes=(2, 2),
    )


def both(action):
    return {"agent_0": action, "agent_1": action}


def episodes(env, seed, count=3):
    """Return everything that whole episodes under fixed actions give."""
    actions = np.random.default_rng(7)
    record = [env.reset(seed=seed)]
    for _ in range(count):
        while env.agents:
            chosen = {a: int(actions.integers(env.action_space(a).n)) for a in env.agents}
            record.append((env.step(chosen), env.state()))
        record.append(env.reset())
    return record


# --- one environment --------------------------------------------------------------------------


@pytest.mark.parametrize(("id", "arguments"), VARIANTS)
def test_pettingzoo_checks(id, arguments):
    parallel_api_test(pettingzoo.make("parallel", id, **arguments), num_cycles=300)
    parallel_api_test(TabularParallelEnv(id, **arguments), num_cycles=300)
    parallel_api_test(TabularParallelEnv(bnprl_envs.model(id, **arguments), max_cycles=7))


def test_pettingzoo_checks_models_of_other_shapes():
    for model in (team_model(), team_model(observed=False), team_chain(), chain()):
        parallel_api_test(TabularParallelEnv(model, max_episode_steps=20))


@pytest.mark.parametrize("id", IDS)
def test_pettingzoo_makes_every_id(id):
    env, entry = pettingzoo.make("parallel", id), bnprl_envs.entry(id)
    assert type(env) is TabularParallelEnv
    assert str(env) == id
    assert pettingzoo.spec("parallel", id).max_cycles == entry.horizon == 100
    assert env.model is bnprl_envs.model(id)
    assert env.discount == env.model.discount == entry.discount
    env.reset(seed=0)
    actions = dict.fromkeys(env.agents, 0)
    truncated = [set(env.step(actions)[3].values()) for _ in range(100)]
    assert truncated == [{False}] * 99 + [{True}]
    assert env.agents == []


def test_registering_again_changes_nothing():
    known = dict(pettingzoo.parallel_registry)
    bnprl_envs.registry.register_environments()
    assert pettingzoo.parallel_registry == known


def test_both_names_of_the_limit():
    id = "bnprl/DecTiger-v0"
    assert pettingzoo.make("parallel", id, max_cycles=7).max_episode_steps == 7
    assert pettingzoo.make("parallel", id, max_episode_steps=8).max_episode_steps == 8
    assert pettingzoo.make("parallel", id, max_cycles=-1).max_episode_steps is None
    assert TabularParallelEnv(id).max_episode_steps is None
    assert TabularParallelEnv(id, max_cycles=3).max_episode_steps == 3


@pytest.mark.parametrize(("id", "arguments"), VARIANTS)
def test_spaces_agents_and_the_null_observation(id, arguments):
    env = TabularParallelEnv(id, **arguments)
    model = env.model
    assert env.possible_agents == ["agent_0", "agent_1"]
    assert env.agents == []
    for n, agent in enumerate(env.possible_agents):
        assert env.action_space(agent) is env.action_space(agent)
        assert env.observation_space(agent) is env.observation_space(agent)
        assert env.action_space(agent).n == model.action_sizes[n]
        assert env.observation_space(agent).n == model.observation_sizes[n] + 1
    observations, infos = env.reset(seed=3)
    null = dict(zip(env.agents, model.observation_sizes, strict=True))
    assert (observations, infos) == (null, both({}))
    for _ in range(5):
        observations, rewards, *flags, infos = env.step(both(0))
        assert all(type(o) is np.int64 and o < null[a] for a, o in observations.items())
        assert [type(r) for r in rewards.values()] == [float, float]
        assert len(set(rewards.values())) == 1
        assert flags == [both(False), both(False)]
        assert infos == both({})
        assert infos["agent_0"] is not infos["agent_1"]
        assert 0 <= env.state() < model.n_states


def test_a_fully_observed_team_sees_the_state_at_once():
    env = TabularParallelEnv(team_model(observed=False))
    assert env.observation_space("agent_0").n == 3
    for seed in range(5):
        observations, _ = env.reset(seed=seed)
        assert observations == {"agent_0": env.state(), "agent_1": 0}
        assert env.step(both(1))[0]["agent_0"] == env.state()


@pytest.mark.parametrize(("id", "arguments"), VARIANTS)
def test_a_seed_fixes_whole_episodes(id, arguments):
    def make():
        return TabularParallelEnv(id, max_episode_steps=LIMIT, **arguments)

    one = episodes(make(), seed=11)
    assert len(one) == 1 + 3 * (LIMIT + 1)
    assert episodes(make(), seed=11) == one
    env = make()
    episodes(env, seed=5)
    assert episodes(env, seed=11) == one
    assert episodes(env, seed=12) != one


def test_joint_indices_and_the_law():
    model = team_model()
    env = TabularParallelEnv(model)
    env.reset(seed=0)
    rows = []
    for action in np.random.default_rng(1).integers(6, size=20_000).tolist():
        state = env.state()
        seen, rewards, *_ = env.step({"agent_0": action // 3, "agent_1": action % 3})
        joint = seen["agent_0"] * 2 + seen["agent_1"]
        rows.append((action, state, env.state(), joint, rewards["agent_1"]))
    *indices, reward = (np.array(column) for column in zip(*rows, strict=True))
    assert_law(model, *indices, reward)


def test_termination_is_not_truncation():
    env = TabularParallelEnv(team_chain(), max_episode_steps=3)
    env.reset()
    last = [env.step(both(1)) for _ in range(3)][-1]
    assert last[1:4] == (both(3.0), both(True), both(False))  # on the last step allowed
    assert env.agents == []
    env.reset()
    assert env.agents == ["agent_0", "agent_1"]
    last = [env.step({"agent_0": 0, "agent_1": 1}) for _ in range(3)][-1]
    assert last[1:4] == (both(0.0), both(False), both(True))


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"agent_0": 1}, "agent_1 is missing"),
        ({}, "agent_0 is missing"),
        ({"agent_0": 1, "agent_1": 1, "agent_2": 1}, "no agent 'agent_2', only agent_0 to agent_1"),
        ({"agent_0": 1, "agent_1": 2}, r"action 2 of agent_1 is not an integer in \[0, 1\]"),
        ({"agent_0": -1, "agent_1": 1}, r"action -1 of agent_0 is not an integer in \[0, 1\]"),
        ({"agent_0": 1.0, "agent_1": 1}, r"action 1\.0 of agent_0 is not an integer in \[0, 1\]"),
        ({"agent_0": 1, "agent_1": None}, "action None of agent_1"),
        ([1, 1], "actions: list, must be a dict from agent to action"),
        (None, "actions: NoneType, must be a dict"),
    ],
)
def test_invalid_actions_are_named(actions, message):
    env = TabularParallelEnv(team_chain())
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert env.state() == 0  # and nothing has happened
    assert env.step({a: np.int64(1) for a in env.agents})[1] == both(1.0)


def test_steps_need_a_running_episode():
    env = TabularParallelEnv(team_chain(), max_episode_steps=2)
    with pytest.raises(ResetNeeded):
        env.step(both(0))
    with pytest.raises(ResetNeeded):
        env.state()
    env.reset()
    env.step(both(0))
    env.step(both(0))
    with pytest.raises(ResetNeeded):
        env.step(both(0))
    with pytest.raises(ResetNeeded):
        env.step({})


def test_results_are_new_objects():
    env = TabularParallelEnv(team_chain())
    first = env.reset()
    second = env.step(both(0))
    third = env.step(both(0))
    for result in (first, second):
        for part in result:
            part.clear()
    assert all(len(part) == 2 for part in third)
    env.agents.clear()
    assert env.possible_agents == ["agent_0", "agent_1"]


def test_copies_go_on_alike():
    env = TabularParallelEnv("bnprl/MarsRovers-v0")
    env.reset(seed=0)
    env.step(both(1))
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    expected = [env.step(both(k % 6)) for k in range(1000)]
    for other in others:
        assert [other.step(both(k % 6)) for k in range(1000)] == expected


@pytest.mark.parametrize("make", [TabularParallelEnv, TabularParallelBatch])
def test_bad_constructions(make):
    with pytest.raises(ValueError, match=r"terminal state '3' has probability 0\.25"):
        make(team_chain().replace(start=np.full(4, 0.25)))
    with pytest.raises(ValueError, match="max_episode_steps: 0, must be an integer, at least 1"):
        make(team_chain(), max_episode_steps=0)
    with pytest.raises(ValueError, match="render_mode: 'ascii'"):
        make(team_chain(), render_mode="ascii")
    with pytest.raises(ValueError, match="did you mean bnprl/DecTiger-v0"):
        make("bnprl/DecTigger-v0")
    with pytest.raises(ValueError, match="bnprl/GridTraffic-v0 has no tables"):
        make("bnprl/GridTraffic-v0")
    with pytest.raises(TypeError, match="size"):
        make(team_chain(), size=2)


def test_bad_limits_and_copies():
    with pytest.raises(ValueError, match="max_cycles: 0, must be an integer, at least 1"):
        TabularParallelEnv(team_chain(), max_cycles=0)
    with pytest.raises(ValueError, match="copies: 0, must be an integer, at least 1"):
        TabularParallelBatch(team_chain(), 0)


# --- the batch --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [team_model(), team_model(observed=False)])
def test_batch_law(model):
    batch = TabularParallelBatch(model, 1000)
    seen, info = batch.reset(seed=0)
    assert info == {}
    assert p_value(np.bincount(batch.states, minlength=3)[None], model.start[None]) > 1e-4
    if model.fully_observed:
        np.testing.assert_array_equal(seen[:, 0], batch.states)
    else:
        np.testing.assert_array_equal(seen, [[3, 2]] * 1000)
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(40):
        actions, state = rng.integers([2, 3], size=(1000, 2)), batch.states
        seen, reward, _, _, _ = batch.step(actions)
        joint = seen @ [model.observation_sizes[1], 1]
        rows.append((actions @ [3, 1], state, batch.states, joint, reward))
    assert_law(model, *(np.concatenate(column) for column in zip(*rows, strict=True)))


@pytest.mark.parametrize(("id", "arguments"), VARIANTS)
def test_a_batch_of_an_id(id, arguments):
    batch = TabularParallelBatch(id, 64, max_episode_steps=5, **arguments)
    assert batch.single_action_space.nvec.tolist() == list(batch.model.action_sizes)
    assert batch.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert (batch.num_envs, batch.discount) == (64, 0.9)
    batch.action_space.seed(0)
    actions = [batch.action_space.sample() for _ in range(5)]

    def record(seed):
        parts = [batch.reset(seed=seed)[0]]
        for chosen in actions:
            *arrays, info = batch.step(chosen)
            assert batch.observation_space.contains(arrays[0])
            assert [a.dtype for a in arrays] == [np.int64, np.float64, np.bool_, np.bool_]
            assert [a.shape for a in arrays] == [(64, 2), (64,), (64,), (64,)]
            assert info == {}
            parts += arrays
        assert arrays[3].all()
        return parts

    one, again, other = record(4), record(4), record(5)
    assert all(map(np.array_equal, one, again))
    assert not all(map(np.array_equal, one, other))


def test_the_batch_is_the_environment_where_all_is_certain():
    env = TabularParallelEnv(team_chain(), max_episode_steps=6)
    batch = TabularParallelBatch(team_chain(), 5, max_episode_steps=6)
    rng = np.random.default_rng(2)
    ended = np.zeros(2, dtype=int)
    for _ in range(20):
        seen, _ = env.reset()
        many, _ = batch.reset()
        np.testing.assert_array_equal(many, [list(seen.values())] * 5)
        while env.agents:
            actions = rng.integers(2, size=2) | rng.integers(2)
            one = env.step(dict(zip(env.agents, actions.tolist(), strict=True)))
            many = batch.step(np.tile(actions, (5, 1)))
            np.testing.assert_array_equal(many[0], [list(one[0].values())] * 5)
            for arrays, parts in zip(many[1:4], one[1:4], strict=True):
                np.testing.assert_array_equal(arrays, [parts["agent_0"]] * 5)
            np.testing.assert_array_equal(batch.states, [env.state()] * 5)
        ended += many[2][0], many[3][0]
    assert ended.min() > 2  # both ways of ending were seen


def test_finished_copies_wait_for_the_mask():
    batch = TabularParallelBatch(team_chain(2), 3)
    with pytest.raises(ResetNeeded):
        batch.step(np.zeros((3, 2), dtype=int))
    with pytest.raises(ResetNeeded):
        batch.reset(options={"reset_mask": np.array([True, False, False])})
    batch.reset()
    terminated = batch.step(np.array([[1, 1], [0, 1], [1, 1]]))[2]
    assert terminated.tolist() == [True, False, True]
    with pytest.raises(ResetNeeded, match="copy 0 has finished"):
        batch.step(np.zeros((3, 2), dtype=int))
    seen, _ = batch.reset(options={"reset_mask": terminated})
    assert seen.tolist() == [[2, 2], [0, 0], [2, 2]]
    assert batch.states.tolist() == [0, 0, 0]
    with pytest.raises(ValueError, match="reset_mask"):
        batch.reset(options={"reset_mask": np.zeros(3, dtype=bool)})
    with pytest.raises(TypeError, match="seed"):
        batch.reset(seed=[1, 2, 3])


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([[0, 1], [1, 2]], r"action 2 of agent_1 in copy 1 is not in \[0, 1\]"),
        ([[-1, 1], [1, 2]], r"action -1 of agent_0 in copy 0 is not in \[0, 1\]"),
        ([[0, 1]], r"actions: shape \(1, 2\)"),
        ([0, 1], r"actions: shape \(2,\)"),
        ([[0.0, 1.0]] * 2, r"of float64, must be \(2, 2\) of integers"),
    ],
)
def test_invalid_batch_actions_are_named(actions, message):
    batch = TabularParallelBatch(team_chain(), 2)
    batch.reset()
    with pytest.raises(ValueError, match=message):
        batch.step(actions)
    assert batch.states.tolist() == [0, 0]


def test_batch_results_are_fresh_arrays():
    batch = TabularParallelBatch(team_chain(), 2)
    first = batch.reset()[0]
    arrays = batch.step([[0, 0], [1, 1]])[:4]
    for array in (first, *arrays):
        array[:] = 0
    batch.states[:] = 3
    assert batch.step([[0, 0], [0, 0]])[0].tolist() == [[0, 0], [1, 1]]
    assert batch.reset()[0].tolist() == [[2, 2], [2, 2]]
