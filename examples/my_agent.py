"""Compare an agent of your own with Stable-Baselines3: the command line knows it as MODULE:CLASS.

Run: python examples/my_agent.py
"""

import argparse
import tempfile
from dataclasses import dataclass

import numpy as np

from baselines.cli import main as bnprl
from bnprl_agents import Agent


@dataclass(frozen=True)
class SarsaConfig:
    """Settings of `Sarsa`; the command line takes them as `--set Sarsa.rate=0.2`."""

    rate: float = 0.1
    epsilon: float = 0.1


class Sarsa(Agent):
    """Expected Sarsa on the last observation, learning from every step of every copy."""

    Config = SarsaConfig

    def __init__(self, observation_space, action_space, config=None, *, discount, seed):
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.values = np.ones((observation_space.n, action_space.n))  # hopeful
        self._seen = self._action = self._pending = None

    def reset(self, observation, mask=None):
        """Begin episodes."""
        self._seen = np.asarray(observation).copy()

    def act(self, observation):
        """Choose by epsilon-greedy."""
        greedy, _ = self.predict(observation)
        explore = self.rng.random(greedy.shape) < self.config.epsilon
        drawn = self.rng.integers(self.values.shape[1], size=greedy.shape)
        self._action = np.where(explore, drawn, greedy)
        return self._action

    def observe(self, action, reward, observation, terminated, truncated):
        """Learn from one step of every copy, with the expectation over the next action."""
        after = self.values[observation]
        epsilon = self.config.epsilon
        expected = epsilon * after.mean(axis=-1) + (1 - epsilon) * after.max(axis=-1)
        target = reward + self.discount * np.where(terminated, 0.0, expected)
        error = target - self.values[self._seen, action]
        np.add.at(self.values, (self._seen, action), self.config.rate * error)
        self._pending = float(np.abs(error).mean())
        self._seen = np.asarray(observation).copy()

    def update(self):
        """Report what `observe` has learned."""
        error, self._pending = self._pending, None
        return {} if error is None else {"error": error}

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        """Choose greedily."""
        return self.values[np.asarray(observation)].argmax(axis=-1), None

    def state_arrays(self):
        """Return what is learned."""
        return {"values": self.values}

    def restore(self, arrays, counters):
        """Take it over."""
        self.values = arrays["values"]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", default="20000")
    options = parser.parse_args()
    out = tempfile.mkdtemp()
    agents = ["--agents", "examples.my_agent:Sarsa", "ppo", "dqn", "random"]
    budget = ["--steps", options.steps, "--seeds", "2", "--eval-points", "2"]
    bnprl(["compare", "FrozenLake-v1", *agents, *budget, "--eval-episodes", "200", "--out", out])
    bnprl(["evaluate", out, "--episodes", "200", "--agent", "examples.my_agent:Sarsa"])
