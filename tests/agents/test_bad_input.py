"""What does not fit is refused in one line: at the agents' door, and in policy files."""

import functools
import itertools
import json
import tracemalloc

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents.agent import load
from bnprl_agents.belief.predictive_actor_critic import PredictiveActorCritic
from bnprl_agents.controllers.actor_critic import ActorCritic
from bnprl_agents.controllers.em import BatchEM, BatchEMConfig
from bnprl_agents.controllers.infinite import InfiniteRPR
from bnprl_agents.controllers.online_em import OnlineEM
from bnprl_agents.controllers.stick_breaking import StickBreaking
from bnprl_agents.episodes import EpisodeBatch
from bnprl_agents.features import Features
from bnprl_agents.gaussian_process.gp_fitted_q import GPFittedQ, GPFittedQConfig
from bnprl_agents.gaussian_process.gp_q import GPQ, GPQConfig
from bnprl_agents.policy_files import PolicyFileError
from bnprl_agents.q_learning.linear_q import LinearQ, LinearQConfig
from bnprl_agents.q_learning.tabular_q import TabularQ
from bnprl_agents.random_agent import RandomAgent
from bnprl_agents.search.controller_search import ControllerSearch
from tests.agents.cases import rewritten

ONE = gym.spaces.Discrete(3), gym.spaces.Discrete(2)
TEAM = tuple({"ada": space, "bob": space} for space in ONE)
two_kinds = pytest.mark.parametrize("agent_class", [BatchEM, PredictiveActorCritic, TabularQ])


@two_kinds
@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("action", [0, 1, 1]),
        ("action", [0.5, 1.0]),
        ("action", [[0, 1]]),
        ("reward", 1.0),
        ("reward", [[1.0, 0.0]]),
        ("observation", [0]),
        ("observation", [[0, 1], [1, 0]]),
        ("terminated", [False]),
        ("truncated", [False, False, False]),
    ],
)
def test_a_transition_of_other_copies_is_refused_and_changes_nothing(agent_class, part, value):
    agents = [agent_class(*ONE, discount=0.9, seed=0) for _ in range(2)]
    fits = {
        "action": [0, 1],
        "reward": [0.0, 1.0],
        "observation": [1, 2],
        "terminated": [False, False],
        "truncated": [False, False],
    }
    for agent in agents:
        agent.reset([0, 1])
    with pytest.raises(ValueError, match=rf"^{part}: (shape|0.5, must be an integer)"):
        agents[0].observe(**(fits | {part: value}))
    for agent in agents:
        agent.observe(**fits)
    kept, fresh = (agent.state_arrays() for agent in agents)
    assert kept.keys() == fresh.keys()
    for name, array in kept.items():
        np.testing.assert_array_equal(array, fresh[name])


@two_kinds
def test_acting_for_other_copies_than_are_under_way(agent_class):
    agent = agent_class(*ONE, discount=0.9, seed=0)
    agent.reset([0, 1])
    with pytest.raises(ValueError, match=r"^observation: shape"):
        agent.act([0, 1, 2])


def test_a_state_of_other_copies():
    agent = BatchEM(*ONE, discount=0.9, seed=0)
    _, state = agent.predict([0, 1, 2])
    with pytest.raises(ValueError, match=r"^state: shape"):
        agent.predict([0, 1], state)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1, r"shape \(\), must be \(2,\)"),
        ([0, 1, 2], r"shape \(3,\)"),
        ({"ada": 0}, "of agents ada, must be ada, bob"),
        ({"ada": 0, "bob": 1, "eve": 1}, "of agents ada, bob, eve"),
        ({"ada": [0, 1], "bob": [1]}, "shapes differ"),
    ],
)
def test_observations_that_are_no_teams(value, words):
    agent = BatchEM(*TEAM, discount=0.9, seed=0)
    with pytest.raises(ValueError, match=rf"^observation: {words}"):
        agent.reset(value)


@pytest.mark.parametrize("value", [np.zeros((2, 2), int), "a", None, 0.5, [3]])
def test_observations_that_are_no_cells(value):
    with pytest.raises(ValueError, match=r"^observation: "):
        Features(ONE[0])(value)


@pytest.mark.parametrize("value", [0.3, np.zeros(4), np.zeros((2, 3)), np.zeros((1, 2, 2))])
def test_points_of_another_shape(value):
    with pytest.raises(ValueError, match=r"^observation: shape"):
        Features(gym.spaces.Box(0.0, 1.0, (2,)))(value)


@pytest.mark.parametrize(
    ("agent_class", "settings"),
    [
        (BatchEM, {"nodes": 10**5}),
        (OnlineEM, {"nodes": 4000}),
        (StickBreaking, {"nodes": 4000}),
        (InfiniteRPR, {"nodes": 4000, "initial_nodes": 3999}),
        (ActorCritic, {"nodes": 4000}),
        (PredictiveActorCritic, {"states": 10**4}),
        (PredictiveActorCritic, {"memory": 10**4}),
        (GPQ, {"budget": 10**6}),
    ],
)
def test_settings_that_ask_for_too_much_memory(agent_class, settings):
    name = next(iter(settings))
    with pytest.raises(ValueError, match=rf"^{name}: asks for a table of .* entries, more than"):
        agent_class(*ONE, agent_class.Config(**settings), discount=0.9, seed=0)


@pytest.mark.parametrize("agent_class", [RandomAgent, BatchEM, ControllerSearch, TabularQ, GPQ])
def test_spaces_that_ask_for_too_much_memory(agent_class):
    with pytest.raises(ValueError, match=r"asks for a table"):
        agent_class(gym.spaces.Discrete(10**9), ONE[1], discount=0.9, seed=0)


@pytest.mark.parametrize(
    ("agent_class", "given", "wanted"),
    [
        (BatchEM, {"nodes": np.int64(3), "keep": np.bool_(True)}, {"nodes": 3, "keep": True}),
        (PredictiveActorCritic, {"clip": np.float32(0.5)}, {"clip": 0.5}),
        (GPQ, {"amplitude": 1, "low": [], "budget": np.int8(7)}, {"amplitude": 1.0, "low": ()}),
        (GPQ, {"bandwidth": np.array([0.5])}, {"bandwidth": (0.5,)}),
        (GPFittedQ, {"regularization": np.float32(0.5)}, {"regularization": 0.5}),
    ],
)
def test_settings_become_plain_values_and_come_back_equal(agent_class, given, wanted, tmp_path):
    agent = agent_class(*ONE, agent_class.Config(**given), discount=0.9, seed=0)
    for name, value in wanted.items():
        found = getattr(agent.config, name)
        assert (type(found), found) == (type(value), value)
    agent.save(tmp_path / "policy.npz")
    assert load(tmp_path / "policy.npz").config == agent.config


@pytest.mark.parametrize(
    ("config", "settings"),
    [
        (GPQConfig, {"bandwidth": 0.1}),
        (GPQConfig, {"bandwidth": "0.1"}),
        (GPQConfig, {"bandwidth": (0.1, True)}),
        (GPQConfig, {"low": (None,)}),
        (GPFittedQConfig, {"regularization": None}),
        (BatchEMConfig, {"keep": "no"}),
        (BatchEMConfig, {"temperature": np.float64("nan")}),
    ],
)
def test_settings_of_another_kind(config, settings):
    name = next(iter(settings))
    with pytest.raises(ValueError, match=rf"^{name}: .*, must be "):
        config(**settings)


@pytest.mark.parametrize("agent_class", [RandomAgent, BatchEM, TabularQ, LinearQ, GPQ, GPFittedQ])
def test_actions_that_ask_for_too_much_memory(agent_class):
    with pytest.raises(ValueError, match=r"asks for a table"):
        agent_class(ONE[0], gym.spaces.Discrete(10**9), discount=0.9, seed=0)


def test_a_grid_of_many_cells_takes_no_memory_before_it_is_looked_at():
    space = gym.spaces.Discrete(3 * 10**7)
    tracemalloc.start()
    assert Features(space, grid_columns=5)(7).tolist() == [[1.0, 2.0]]
    with pytest.raises(ValueError, match=r"^observation_space: .* more than 1,000,000 bases"):
        LinearQ(space, ONE[1], LinearQConfig(grid_columns=5), discount=0.9, seed=0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**20
    with pytest.raises(ValueError, match=r"^observation_space: asks for a table"):
        Features(gym.spaces.Discrete(4 * 10**7), grid_columns=5).points  # noqa: B018


def test_a_small_file_does_not_take_much_memory(tmp_path):
    path = tmp_path / "policy.npz"
    BatchEM(*ONE, BatchEMConfig(nodes=2), discount=0.9, seed=0).save(path)
    rewritten(path, lambda arrays, meta: meta["config"].update(nodes=20_000))
    tracemalloc.start()
    with pytest.raises(PolicyFileError, match=r"nodes: asks for a table"):
        load(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**24


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_none_in_a_policy_file(tmp_path, value):
    path = tmp_path / "policy.npz"
    PredictiveActorCritic(*ONE, discount=0.9, seed=0).save(path)
    rewritten(path, lambda arrays, meta: arrays["logits_action"].flat.__setitem__(0, value))
    with pytest.raises(PolicyFileError, match=r"logits_action.* holds (nan|inf)"):
        load(path)


PRACTICE = {
    TabularQ: {},
    GPQ: {"select_after": 100, "budget": 5},
    GPFittedQ: {"fit_every": 4},
    BatchEM: {"nodes": 2, "batch_episodes": 2, "keep": True},
    InfiniteRPR: {"nodes": 4, "initial_nodes": 2, "batch_episodes": 2},
    ActorCritic: {"nodes": 2, "batch_steps": 4},
    PredictiveActorCritic: {"states": 2, "memory": 2, "batch_steps": 4},
}
"""Agent -> settings with which a few steps fill everything that it keeps."""


@functools.cache
def practised(agent_class):
    """An agent that has learned something, and has observed something since."""
    agent = agent_class(*ONE, agent_class.Config(**PRACTICE[agent_class]), discount=0.9, seed=0)
    seen = np.array([0, 1])
    agent.reset(seen)
    for t in range(11):
        action, after = agent.act(seen), (seen + 1 + t) % 3
        ended = np.array([t % 3 == 2, False])
        agent.observe(action, [1.0, 0.5], after, ended, [t % 5 == 4, t == 6])
        ended |= [t % 5 == 4, t == 6]
        if t < 7:
            agent.update()
        seen = after
        agent.reset(seen, ended)
    return agent


@pytest.mark.parametrize(
    ("agent_class", "name", "value"),
    [
        (TabularQ, "pending_actions", 4e8),
        (TabularQ, "pending_actions", -1),
        (TabularQ, "pending_actions", 1e300),
        (TabularQ, "pending_points", np.zeros((1, 1))),
        (TabularQ, "pending_rewards", np.zeros((2, 2))),
        (TabularQ, "alive", np.ones(3)),
        (GPQ, "kept_actions", 7),
        (GPFittedQ, "tuple_actions", 2),
        (GPFittedQ, "fitted_actions", -1),
        (BatchEM, "kept_actions", 4e8),
        (BatchEM, "statistics_action_0", np.zeros((1, 2))),
        (InfiniteRPR, "pool_observations", 3),
        (InfiniteRPR, "pool_behaviour", 2.0),
        (InfiniteRPR, "pool_explore_0_0", -5.0),
        (InfiniteRPR, "pool_sizes", 0),
        (InfiniteRPR, "pool_mixed", np.ones(1)),
        (InfiniteRPR, "hierarchy_weights_0", -1.0),
        (ActorCritic, "explore_0", np.array([-5.0, 7.0])),
        (ActorCritic, "explore_0", np.zeros(3)),
        (ActorCritic, "finished_observations", 4e8),
        (ActorCritic, "finished_offsets", np.arange(2) * 4e8),
        (ActorCritic, "recorder_actions", 4e8),
        (ActorCritic, "recorder_behaviour", -1.0),
        (ActorCritic, "recorder_length", 65),
        (ActorCritic, "recorder_length", -1),
        (ActorCritic, "recorder_length", np.zeros(3)),
        (ActorCritic, "recorder_rewards", np.zeros((2, 3))),
        (ActorCritic, "seen", 3),
        (ActorCritic, "belief_0", 3.0),
        (ActorCritic, "belief_0", np.full((1, 2), 0.5)),
        (PredictiveActorCritic, "replay_final_observations", 4e7),
        (PredictiveActorCritic, "replay_sizes", 1000),
    ],
)
def test_what_compiled_code_reads_is_checked_first(agent_class, name, value, tmp_path):
    path = tmp_path / "policy.npz"
    practised(agent_class).save(path)
    load(path)

    def change(arrays, meta):
        arrays[name] = value if np.ndim(value) else np.full(arrays[name].shape, value)

    rewritten(path, change)
    with pytest.raises(PolicyFileError, match="not a bnprl policy file"):
        load(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mean_length", np.nan),
        ("mean_length", np.inf),
        ("mean_length", "nan"),
        ("mean_length", 0.0),
        ("steps", -1),
        ("steps", 1.5),
        ("updates", True),
        ("scale", -1.0),
    ],
)
def test_counters_that_are_none(name, value, tmp_path):
    path = tmp_path / "policy.npz"
    PredictiveActorCritic(*ONE, discount=0.9, seed=0).save(path)
    rewritten(path, lambda arrays, meta: meta["counters"].update({name: value}))
    with pytest.raises(PolicyFileError, match="not a bnprl policy file"):
        load(path)


@pytest.mark.parametrize("older", [False, True])
def test_infinite_ends_of_a_box_survive_saving(older, tmp_path):
    low = np.array([[-np.inf, 0.0], [-1.0, 0.5]])
    space, path = gym.spaces.Box(low, np.inf, dtype=np.float64), tmp_path / "policy.npz"
    RandomAgent(space, ONE[1], discount=0.9, seed=0).save(path)
    with np.load(path) as archive:
        description = archive["meta"].tobytes().decode()
    json.loads(description, parse_constant=pytest.fail)
    if older:  # written as JavaScript has them
        ends = {"low": low.tolist(), "high": np.full((2, 2), np.inf).tolist()}
        rewritten(path, lambda arrays, meta: meta["observation_space"].update(ends))
    assert load(path).observation_space == space


@pytest.mark.parametrize(
    ("agent_class", "part"),
    [
        *itertools.product((BatchEM, ActorCritic), ("observations", "actions")),
        (ActorCritic, "final_observations"),
        (PredictiveActorCritic, "final_observations"),
    ],
)
def test_episodes_outside_the_spaces_are_not_learned_from(agent_class, part):
    agent = agent_class(*ONE, discount=0.9, seed=0)
    fits = {
        "offsets": [0, 2],
        "observations": [[0], [2]],
        "actions": [[0], [1]],
        "rewards": [0.0, 1.0],
        "behaviour": [[0.5], [0.5]],
        "final_observations": [[1]],
        "terminated": [False],
    }
    outside = EpisodeBatch(**(fits | {part: np.full_like(fits[part], 3)}))
    with pytest.raises(ValueError, match=rf"^{part}: found 3 to 3, must lie in 0 to"):
        agent.learn(outside)


def test_points_of_older_tables_are_corners_of_a_simplex(tmp_path):
    agent, path = practised(TabularQ), tmp_path / "policy.npz"
    agent.save(path)

    def age(arrays, meta):
        arrays["table"] = np.concatenate([arrays["table"], np.zeros((1, 2))])
        for name in ("points", "pending_points", "pending_next_points"):
            arrays[name] = np.eye(3)[arrays[name][:, 0].astype(int)]

    kept, aged = agent.state_arrays(), load(rewritten(path, age)).state_arrays()
    assert kept.keys() == aged.keys()
    for name, array in kept.items():
        np.testing.assert_array_equal(array, aged[name])
