"""What does not fit is refused in one line: at the agents' door, and in policy files."""

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
from bnprl_agents.features import Features
from bnprl_agents.gaussian_process.gp_fitted_q import GPFittedQ, GPFittedQConfig
from bnprl_agents.gaussian_process.gp_q import GPQ, GPQConfig
from bnprl_agents.policy_files import PolicyFileError
from bnprl_agents.q_learning.linear_q import LinearQ, LinearQConfig
from bnprl_agents.q_learning.tabular_q import TabularQ
from bnprl_agents.random_agent import RandomAgent
from bnprl_agents.search.controller_search import ControllerSearch

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


def changed(path, change):
    """Rewrite a policy file with its arrays and description changed."""
    with np.load(path) as archive:
        arrays = dict(archive)
    meta = json.loads(arrays["meta"].tobytes())
    change(arrays, meta)
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    np.savez(path, **arrays)
    return path


def test_a_small_file_does_not_take_much_memory(tmp_path):
    path = tmp_path / "policy.npz"
    BatchEM(*ONE, BatchEMConfig(nodes=2), discount=0.9, seed=0).save(path)
    changed(path, lambda arrays, meta: meta["config"].update(nodes=20_000))
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
    changed(path, lambda arrays, meta: arrays["logits_action"].flat.__setitem__(0, value))
    with pytest.raises(PolicyFileError, match=r"logits_action.* holds (nan|inf)"):
        load(path)
