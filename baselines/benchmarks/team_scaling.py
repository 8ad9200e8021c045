"""How the cost of learning grows with the number of agents and the length of episodes.

`python -m baselines.benchmarks.team_scaling` times `StickBreaking.learn` on recorded episodes of 2
to 1,000 agents, prints CPU microseconds for each agent and episode, and seconds by T; it exits 1
where the cost for each agent and episode differs by more than half between team sizes, or where
doubling T costs more than 2.5 times as much. Then `ControllerSearch` learns grid traffic of 10,000
agents, and the largest memory of the process is shown.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import gymnasium as gym
import numpy as np

from bnprl_agents import ControllerSearch, ControllerSearchConfig, StickBreaking, train
from bnprl_agents.controllers.stick_breaking import StickBreakingConfig
from bnprl_agents.episodes import EpisodeBatch
from bnprl_envs import GridTrafficBatch
from bnprl_envs.team import agent_names, agent_spaces

ACTIONS, OBSERVATIONS, EPISODES, STEPS = 3, 5, 100, 50
TEAMS = (2, 10, 100, 1000)
SPREAD, DOUBLING = 1.5, 2.5
"""Largest ratio of costs between team sizes, and of a doubling of T."""
SIDE, BUDGET = 100, 150_000
"""Of the large grid: intersections in a row, and simulated steps."""
FEW = ControllerSearchConfig(explore_seeds=16, refine_seeds=32, judge_seeds=64, candidates=4)
"""Fewer seeds than by default, since the return of so many lines varies little."""


def recorded(n_agents: int, steps: int) -> EpisodeBatch:
    """Episodes of uniformly random observations, actions and rewards."""
    rng = np.random.default_rng(0)
    rows = EPISODES * steps
    return EpisodeBatch(
        offsets=np.arange(EPISODES + 1) * steps,
        observations=rng.integers(OBSERVATIONS, size=(rows, n_agents)),
        actions=rng.integers(ACTIONS, size=(rows, n_agents)),
        rewards=rng.random(rows),
        behaviour=np.full((rows, n_agents), 1.0 / ACTIONS),
        final_observations=rng.integers(OBSERVATIONS, size=(EPISODES, n_agents)),
        terminated=np.zeros(EPISODES, dtype=np.bool_),
    )


def seconds(n_agents: int, steps: int, repeats: int) -> float:
    """CPU time of learning from one batch: the best of some repetitions."""
    names = agent_names(n_agents)
    agent = StickBreaking(
        gym.spaces.Dict({name: gym.spaces.Discrete(OBSERVATIONS) for name in names}),
        gym.spaces.Dict({name: gym.spaces.Discrete(ACTIONS) for name in names}),
        StickBreakingConfig(nodes=4, batch_episodes=EPISODES),
        discount=0.9,
        seed=0,
    )
    episodes = recorded(n_agents, steps)
    agent.learn(episodes)
    found = []
    for _ in range(repeats):
        begin = time.process_time()
        agent.learn(episodes)
        found.append(time.process_time() - begin)
    return min(found)


def by_agents() -> bool:
    """Print the cost by the number of agents; return whether it is constant."""
    print("agents  CPU s  microseconds for each agent and episode")
    costs = []
    for n_agents in TEAMS:
        spent = seconds(n_agents, STEPS, repeats=max(2, 40 // n_agents))
        costs.append(1e6 * spent / n_agents / EPISODES)
        print(f"{n_agents:6}  {spent:5.3f}  {costs[-1]:6.1f}", flush=True)
    spread = max(costs) / min(costs)
    print(f"largest by smallest: {spread:.2f}, wanted at most {SPREAD}")
    return spread <= SPREAD


def by_steps() -> bool:
    """Print the cost by the length of episodes; return whether it is linear."""
    print("steps   CPU s of 10 agents")
    spent = []
    for steps in (STEPS, 2 * STEPS, 4 * STEPS):
        spent.append(seconds(10, steps, repeats=4))
        print(f"{steps:5}   {spent[-1]:.3f}", flush=True)
    worst = max(spent[1] / spent[0], spent[2] / spent[1])
    print(f"largest ratio of a doubling: {worst:.2f}, wanted at most {DOUBLING}")
    return worst <= DOUBLING


def large_grid() -> None:
    """Print what `ControllerSearch` reaches with 10,000 agents, in which time and memory."""
    env = GridTrafficBatch(1, rows=SIDE, columns=SIDE)
    agent = ControllerSearch(*agent_spaces(env), FEW, discount=0.9, seed=0)
    begin = time.process_time()
    learned = [p for p in train(agent, env, seed=0, steps=BUDGET) if p.metrics]
    for progress in (learned[0], learned[-1]):
        print(
            f"{SIDE * SIDE} agents, {progress.steps} steps: discounted return "
            f"{progress.metrics['value']:.1f}"
        )
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{time.process_time() - begin:.0f} CPU s, at most {megabytes:.0f} MB")


def main(arguments: list[str] | None = None) -> int:
    """Print all measurements; return the exit status."""
    argparse.ArgumentParser(description=__doc__).parse_args(arguments)
    passed = by_agents()
    passed &= by_steps()
    large_grid()
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
