"""Learning to remember: a T-maze, where the best memoryless policy guesses."""

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents.controllers.online_em import OnlineEM, OnlineEMConfig
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.training import train
from bnprl_envs.model import TabularModel
from bnprl_envs.tabular_vector import TabularVectorEnv

DISCOUNT = 0.95
LENGTH = 3


def t_maze(length: int) -> TabularModel:
    """A corridor whose first place shows a cue, seen for the last time after one step.

    States (cue, place) and the end; actions forward, left, right; at the junction, `length` steps
    on, the turn to the side of the cue earns 1 and either turn ends the episode.
    """
    places = length + 1
    end = 2 * places
    transition = np.zeros((3, end + 1, end + 1))
    observation = np.zeros((3, end + 1, 4))
    reward = np.zeros((3, end + 1, 1, 1))
    for cue in range(2):
        for place in range(places):
            state, junction = cue * places + place, place == length
            sight = 3 if junction else cue if place <= 1 else 2
            observation[:, state, sight] = 1.0
            transition[0, state, state + (not junction)] = 1.0
            transition[1:, state, end if junction else state] = 1.0
            reward[1 + cue, state] = float(junction)
    transition[:, end, end] = 1.0
    observation[:, end, 2] = 1.0
    start = np.zeros(end + 1)
    start[[0, places]] = 0.5
    terminal = np.arange(end + 1) == end
    return TabularModel(transition, observation, reward, start, DISCOUNT, terminal=terminal)


@pytest.mark.parametrize("seed", range(3))
def test_online_em_remembers_the_cue_with_many_nodes(seed):
    model = t_maze(LENGTH)
    env = TabularVectorEnv(model, 1, max_episode_steps=50, autoreset_mode="Disabled")
    spaces = gym.spaces.Discrete(5), gym.spaces.Discrete(3)
    agent = OnlineEM(*spaces, OnlineEMConfig(nodes=20), discount=DISCOUNT, seed=seed)
    for _ in train(agent, env, seed=seed, episodes=10_000):
        pass
    best = DISCOUNT**LENGTH
    assert 0.9 * best < controller_value(model, agent.controllers, DISCOUNT) <= best
