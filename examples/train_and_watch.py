"""Train an agent on Hallway, score it exactly, keep it, and watch an episode of it.

Run: python examples/train_and_watch.py
"""

import argparse
import tempfile
from pathlib import Path

import gymnasium as gym

import bnprl_envs  # registers the environments
from baselines.cli import main as bnprl
from bnprl_agents import OnlineEM, OnlineEMConfig, controller_value, load, train

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--episodes", type=int, default=20_000)
options = parser.parse_args()

envs = gym.make_vec("bnprl/Hallway-v0", num_envs=64, autoreset_mode="Disabled")
agent = OnlineEM(
    envs.single_observation_space,
    envs.single_action_space,
    OnlineEMConfig(nodes=20),
    discount=envs.discount,
    seed=0,
)
for progress in train(agent, envs, seed=1, episodes=options.episodes):
    if progress.episodes % 5_000 == 0:
        print(progress.episodes, "episodes:", progress.metrics)

model = bnprl_envs.model("bnprl/Hallway-v0")
print("exact value:", controller_value(model, agent.controllers, model.discount))

policy = Path(tempfile.mkdtemp()) / "hallway.npz"
agent.save(policy)  # arrays and JSON; load(policy) goes on bit for bit
assert load(policy).config == agent.config
bnprl(["watch", "bnprl/Hallway-v0", "--policy", str(policy), "--steps", "5"])
