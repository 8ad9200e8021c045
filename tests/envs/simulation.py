"""Values by simulation, to hold the registry's numbers against."""

import gymnasium as gym
import numpy as np


def simulated_value(id, episodes, policy, **arguments):
    """Return the mean discounted return of a policy, and its standard error.

    Args:
        id: of an environment.
        episodes: how many, one a copy.
        policy: from observations of all copies to actions.
        **arguments: of the environment.
    """
    envs = gym.make_vec(id, num_envs=episodes, autoreset_mode="Disabled", **arguments)
    observations, _ = envs.reset(seed=0)
    total, running, weight = np.zeros(episodes), np.ones(episodes, dtype=np.bool_), 1.0
    while running.any():
        observations, rewards, terminated, truncated, _ = envs.step(policy(observations))
        total += running * weight * rewards
        weight *= envs.discount
        ended = terminated | truncated
        running &= ~ended
        if ended.any():
            observations, _ = envs.reset(options={"reset_mask": ended})
    return total.mean(), total.std(ddof=1) / np.sqrt(episodes)
