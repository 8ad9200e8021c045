"""Train a team in a PettingZoo environment, score it exactly, keep it, play and watch an episode.

Run: python examples/team.py
"""

import argparse
import tempfile
from pathlib import Path

import pettingzoo

import bnprl_envs  # registers the environments
from baselines.cli import main as bnprl
from bnprl_agents import ControllerSearch, controller_value, load, train

TIGER = "bnprl/DecTiger-v0"  # two agents listen, and must open the same door without speaking

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000_000)
options = parser.parse_args()

team = pettingzoo.make("parallel", TIGER)
discount = team.unwrapped.discount
agent = ControllerSearch(team.observation_spaces, team.action_spaces, discount=discount, seed=0)
batch = bnprl_envs.TabularParallelBatch(TIGER, max_episode_steps=100)  # what a simulator is made of
for progress in train(agent, batch, seed=1, steps=options.steps):
    print(f"{progress.steps:,} steps: {progress.metrics.get('value', 'spent')}")

print("exact value:", controller_value(batch.model, agent.controllers, discount))

policy = Path(tempfile.mkdtemp()) / "tiger.npz"
agent.save(policy)  # arrays and JSON, never pickle
team_policy = load(policy)

observations, _ = team.reset(seed=2)
state, earned = None, 0.0
while team.agents:
    actions, state = team_policy.predict(observations, state)  # dicts, as PettingZoo has them
    observations, rewards, _, _, _ = team.step(actions)
    earned += rewards["agent_0"]  # all agents earn the same
print("one episode of 100 steps earned", earned)

bnprl(["watch", TIGER, "--policy", str(policy), "--steps", "4"])
