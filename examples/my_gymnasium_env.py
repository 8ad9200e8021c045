"""Bring a Gymnasium environment of your own: the command line knows it as MODULE:ID.

Run: python examples/my_gymnasium_env.py
"""

import argparse
import tempfile

import gymnasium as gym
from gymnasium.spaces import Discrete

from baselines.cli import main as bnprl


class Corridor(gym.Env):
    """A light at the start tells at which end of a corridor the reward is; it must be remembered.

    Observations: 0 nothing, 1 light on the left, 2 light on the right. Actions: 0 left, 1 right,
    2 stay.
    """

    observation_space = Discrete(3)
    action_space = Discrete(3)
    length = 2

    def reset(self, *, seed=None, options=None):
        """Stand in the middle and see the light."""
        super().reset(seed=seed)
        self.goal = self.length * (1 if self.np_random.random() < 0.5 else -1)
        self.place = 0
        return (2 if self.goal > 0 else 1), {}

    def step(self, action):
        """Move; the ends are terminal."""
        self.place += (-1, 1, 0)[int(action)]
        ended = abs(self.place) == self.length
        return 0, float(self.place == self.goal), ended, False, {}


if "Corridor-v0" not in gym.registry:
    gym.register("Corridor-v0", entry_point=Corridor, max_episode_steps=20)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", default="60000")
    options = parser.parse_args()
    out = tempfile.mkdtemp()
    learn = ["--agents", "actor-critic", "ppo", "random", "--steps", options.steps, "--seeds", "2"]
    evaluate = ["--eval-points", "2", "--eval-episodes", "200", "--out", out]
    bnprl(["compare", "examples.my_gymnasium_env:Corridor-v0", *learn, *evaluate])
