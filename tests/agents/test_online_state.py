"""What the online forms remember does not grow with the number of episodes."""

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents import InfiniteRPR, OnlineEM, StickBreaking, VariationalBayes
from tests.agents.cases import random_episodes

SPACES = gym.spaces.Discrete(4), gym.spaces.Discrete(2)


@pytest.mark.parametrize(
    ("agent_class", "settings"),
    [
        (OnlineEM, {}),
        (VariationalBayes, {"schedule": "online"}),
        (StickBreaking, {"schedule": "online"}),
        (InfiniteRPR, {"schedule": "online", "initial_nodes": 2}),
    ],
)
def test_the_state_keeps_its_size(agent_class, settings):
    rng = np.random.default_rng(0)
    config = agent_class.Config(nodes=5, batch_episodes=10, **settings)
    agent, sizes = agent_class(*SPACES, config, discount=0.9, seed=0), []
    for _ in range(6):
        agent.learn(random_episodes(rng, (5,) * 10, (2,), (4,)))
        sizes.append(sum(table.nbytes for table in agent.state_arrays().values()))
    assert len(set(sizes)) == 1
    assert agent.episodes == 60
