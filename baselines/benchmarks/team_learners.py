"""What `ControllerSearch` reaches on the decentralised benchmarks, and how fast.

`python -m baselines.benchmarks.team_learners` trains every seed of every problem with the same
settings, prints the exact values of the returned controllers (of grid traffic: the units that pass
in a step, by simulation) and exits 1 where a mean misses its target or a seed takes more than five
minutes of one core.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import bnprl_envs
from bnprl_agents import ControllerSearch, controller_value, train
from bnprl_envs import GridTraffic, GridTrafficBatch, TabularParallelBatch, TabularParallelEnv

SECONDS = 300.0
"""CPU time of one seed that may not be exceeded."""
EPISODES = 1000
"""Episodes by which grid traffic is evaluated."""


@dataclass(frozen=True)
class Problem:
    """A problem with its target.

    Attributes:
        id: of the environment.
        wanted: smallest passing mean over the seeds.
        goal: best known value of the literature; of grid traffic, what is hoped for.
        steps: simulated for one seed, of all agents together.
    """

    id: str
    wanted: float
    goal: float
    steps: int


PROBLEMS = (
    Problem("bnprl/BroadcastChannel-v0", 9.26, 9.271, 500_000_000),
    Problem("bnprl/RecyclingRobots-v0", 31.9, 31.929, 500_000_000),
    Problem("bnprl/MeetingGrid-v0", 5.8, 5.820, 500_000_000),
    Problem("bnprl/BoxPushing-v0", 200.0, 224.43, 500_000_000),
    Problem("bnprl/MarsRovers-v0", 25.0, 26.94, 500_000_000),
    Problem("bnprl/DecTiger-v0", 5.0, 13.448, 500_000_000),
    Problem("bnprl/GridTraffic-v0", 8.5, 9.5, 2_000_000),
)


@dataclass(frozen=True)
class Run:
    """One seed: value, nodes of the largest controller, and seconds of CPU time."""

    value: float
    nodes: int
    seconds: float


def run(problem: Problem, seed: int) -> Run:
    """Train from one seed and evaluate the returned controllers."""
    begin = time.process_time()
    tabular = bnprl_envs.entry(problem.id).kind == "parallel-tabular"
    team = TabularParallelEnv(problem.id) if tabular else GridTraffic()
    batch = (
        TabularParallelBatch(problem.id, max_episode_steps=100) if tabular else GridTrafficBatch(8)
    )
    agent = ControllerSearch(
        team.observation_spaces, team.action_spaces, discount=team.discount, seed=seed
    )
    for _ in train(agent, batch, seed=seed, steps=problem.steps):
        pass
    seconds = time.process_time() - begin
    value = (
        controller_value(batch.model, agent.controllers, team.discount)
        if isinstance(batch, TabularParallelBatch)
        else units_a_step(agent)
    )
    return Run(value, max(c.n_nodes for c in agent.controllers), seconds)


def units_a_step(agent: ControllerSearch) -> float:
    """Mean number of units that pass in a step of 100-step episodes of grid traffic."""
    env = GridTrafficBatch(EPISODES)
    seen, _ = env.reset(seed=0)
    names = [f"agent_{n}" for n in range(env.n_agents)]
    state: Any = None
    passed = 0.0
    for _ in range(env.max_episode_steps or 0):
        action, state = agent.predict(dict(zip(names, seen.T, strict=True)), state)
        seen, reward, *_ = env.step(np.stack([action[name] for name in names], axis=1))
        passed += float(reward.mean())
    return passed / (env.max_episode_steps or 1)


def main(arguments: list[str] | None = None) -> int:
    """Run every seed and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="runs of each problem")
    parser.add_argument("--ids", nargs="+", default=[p.id for p in PROBLEMS], help="problems")
    parser.add_argument("--scale", type=float, default=1.0, help="factor of the simulated steps")
    chosen = parser.parse_args(arguments)
    passed = True
    print("problem                    seed     value  nodes  seconds")
    for problem in PROBLEMS:
        if problem.id not in chosen.ids:
            continue
        scaled = Problem(
            problem.id, problem.wanted, problem.goal, int(problem.steps * chosen.scale)
        )
        runs = []
        for seed in range(chosen.seeds):
            r = run(scaled, seed)
            runs.append(r)
            print(f"{problem.id:25}  {seed:4}  {r.value:8.3f}  {r.nodes:5}  {r.seconds:7.1f}")
            sys.stdout.flush()
        values = [r.value for r in runs]
        mean = float(np.mean(values))
        good = mean >= problem.wanted and max(r.seconds for r in runs) <= SECONDS
        passed &= good
        print(
            f"{problem.id:25}  mean  {mean:8.3f}, best {max(values):.3f}, wanted "
            f"{problem.wanted:.3f}, goal {problem.goal:.3f}: "
            f"{'pass' if good else 'FAIL'}"
        )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
