"""The online forms: what they remember does not grow, and one pass does what a batch does."""

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents import BatchEM, InfiniteRPR, OnlineEM, StickBreaking, VariationalBayes
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.value import controller_value
from tests.agents.cases import copying_model, random_episodes

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


ONE_PASS = {"batch_episodes": 50, "successor_concentration": 0.1}


@pytest.mark.parametrize(
    ("online", "batch", "settings"),
    [
        (OnlineEM, BatchEM, {"nodes": 4}),
        (VariationalBayes, VariationalBayes, {"nodes": 4}),
        (StickBreaking, StickBreaking, {"nodes": 4, "weighting": "reward"}),
        (InfiniteRPR, InfiniteRPR, {"nodes": 8, "initial_nodes": 4}),
    ],
)
def test_one_pass_online_comes_close_to_batch_on_the_same_episodes(online, batch, settings):
    model, rng = copying_model(), np.random.default_rng(1)
    spaces = gym.spaces.Discrete(3), gym.spaces.Discrete(2)
    both = online is batch
    one = online(
        *spaces,
        online.Config(**ONE_PASS, **settings, **({"schedule": "online"} if both else {})),
        discount=0.9,
        seed=0,
    )
    episodes = rollout(
        model, one.controllers, episodes=6000, horizon=4, rng=rng, explore=one.explore
    )
    for first in range(0, 6000, 50):
        one.learn(part(episodes, first, first + 50))
    whole = {"batch_episodes": 6000, "outer_iterations": 60, "successor_concentration": 0.1}
    other = batch(
        *spaces,
        batch.Config(**whole, **settings, **({"schedule": "batch"} if both else {})),
        discount=0.9,
        seed=0,
    )
    other.learn(episodes)
    values = [controller_value(model, agent.controllers, 0.9) for agent in (one, other)]
    assert values[1] > 6.0  # one node earns 5, memory up to 9.5
    assert values[0] > 0.9 * values[1]


def part(episodes, first, last):
    """Episodes first to last - 1."""
    begin, end = episodes.offsets[first], episodes.offsets[last]
    per_episode = {"final_observations", "terminated"}
    tables = {
        name: table[first:last] if name in per_episode else table[begin:end]
        for name, table in vars(episodes).items()
        if name != "offsets"
    }
    return type(episodes)(offsets=episodes.offsets[first : last + 1] - begin, **tables)
