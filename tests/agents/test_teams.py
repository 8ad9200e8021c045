"""Teams: trained compiled and step by step, acting on local histories only."""

import numpy as np
import pytest

from bnprl_agents import StickBreaking, VariationalBayes, train
from bnprl_agents.discrete import DiscreteSpaces
from bnprl_envs import TabularParallelBatch
from bnprl_envs.model import TabularModel
from bnprl_envs.team import agent_spaces

HORIZON = 10


def meeting():
    """Two agents, of 2 and 3 actions, earn 1 where the second's action is the first's."""
    reward = np.zeros((6, 1, 1, 1))
    reward[[0, 4]] = 1.0
    return TabularModel(
        np.ones((6, 1, 1)),
        np.full((6, 1, 4), 0.25),
        reward,
        [1.0],
        0.9,
        action_sizes=(2, 3),
        observation_sizes=(2, 2),
    )


def team_agent(agent_class, env, **settings):
    config = agent_class.Config(**({"nodes": 3, "batch_episodes": 50} | settings))
    return agent_class(
        *agent_spaces(env),
        config,
        discount=env.discount,
        seed=0,
    )


@pytest.mark.parametrize("agent_class", [VariationalBayes, StickBreaking])
@pytest.mark.parametrize("compiled", [True, False])
def test_a_batch_of_teams_is_learned_in(agent_class, compiled):
    env = TabularParallelBatch(meeting(), 25, max_episode_steps=HORIZON)
    if not compiled:
        env.max_episode_steps = None  # as a batch without a model
    agent = team_agent(agent_class, env, schedule="batch", weighting="return", temperature=2.0)
    returns = [
        progress.metrics["return_mean"]
        for progress in train(agent, env, seed=0, episodes=1500)
        if progress.metrics
    ]
    best = (1.0 - 0.9**HORIZON) / 0.1
    assert returns[0] < 0.5 * best < 0.8 * best < returns[-1]


def test_an_agent_acts_on_its_own_history_only():
    env = TabularParallelBatch(meeting(), 4, max_episode_steps=HORIZON)
    first, second = team_agent(StickBreaking, env), team_agent(StickBreaking, env)
    rng = np.random.default_rng(0)
    for agent in (first, second):
        agent.explore = tuple(np.linspace(0.1, 0.9, 3) for _ in range(2))
        agent.reset(np.full((4, 2), 2))
    no = np.zeros(4, dtype=bool)
    for _ in range(8):
        mine = rng.integers(2, size=(4, 1))
        others = rng.integers(2, size=(2, 4, 1))
        action, theirs = rng.integers(2, size=(4, 1)), rng.integers(3, size=(2, 4, 1))
        rewards = rng.random((2, 4))
        for agent, seen, done, reward in zip((first, second), others, theirs, rewards, strict=True):
            agent.observe(np.hstack([action, done]), reward, np.hstack([mine, seen]), no, no)
        probabilities = [agent.behaviour_probabilities() for agent in (first, second)]
        np.testing.assert_array_equal(probabilities[0][0], probabilities[1][0])
    assert np.abs(probabilities[0][1] - probabilities[1][1]).max() > 1e-3


def test_arrays_of_teams_are_translated_like_dicts():
    env = TabularParallelBatch(meeting(), 2, max_episode_steps=HORIZON)
    spaces = DiscreteSpaces(*agent_spaces(env))
    rows = np.array([[0, 2], [1, 1]])
    as_dict = {"agent_0": rows[:, 0], "agent_1": rows[:, 1]}
    np.testing.assert_array_equal(spaces.observations(rows), spaces.observations(as_dict))
    np.testing.assert_array_equal(spaces.external_actions(rows, rows), rows)
