"""What plain stick-breaking reaches on the five problems of the dissertation's Table 6.2.

`python -m baselines.benchmarks.stick_breaking` prints exact values at each model's discount, beside
the source's, and exits 1 where a mean stays below it. Settings are the learner's defaults, which
weigh episodes by their returns; `--weighting reward` is Algorithm 5 on shifted rewards.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace

import numpy as np

from bnprl_agents.controllers.stick_breaking import StickBreaking, StickBreakingConfig
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.history_agent import smallest_reward
from bnprl_agents.training import train
from bnprl_envs import TabularParallelBatch
from bnprl_envs.team import agent_spaces

SOURCE = {
    "BroadcastChannel": 9.20,
    "RecyclingRobots": 31.26,
    "BoxPushing": 77.65,
    "DecTiger": -19.14,
    "MarsRovers": 20.62,
}
"""Values that the source reports for DEC-SBPR."""
HORIZON = 100


@dataclass(frozen=True)
class Run:
    """One seed: exact value, mean nodes of an agent, steps and CPU seconds."""

    value: float
    nodes: float
    steps: int
    seconds: float


def run(name: str, config: StickBreakingConfig, seed: int, episodes: int) -> Run:
    """Learn one problem from one seed."""
    env = TabularParallelBatch(f"bnprl/{name}-v0", max_episode_steps=HORIZON)
    if config.weighting == "reward":
        config = replace(config, reward_shift=max(0.0, -smallest_reward(env.model)))
    agent = StickBreaking(
        *agent_spaces(env),
        config,
        discount=env.discount,
        seed=seed,
    )
    begin = time.process_time()
    *_, last = train(agent, env, seed=seed, episodes=episodes)
    seconds = time.process_time() - begin
    value = controller_value(env.model, agent.controllers, env.discount)
    return Run(value, last.metrics["nodes"], last.steps, seconds)


def main(arguments: list[str] | None = None) -> int:
    """Run every seed and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="runs of each problem")
    parser.add_argument("--episodes", type=int, default=50_000, help="of each run")
    parser.add_argument("--problems", nargs="+", choices=SOURCE, default=list(SOURCE))
    parser.add_argument("--weighting", choices=("return", "reward"), default="return")
    options = parser.parse_args(arguments)
    config = StickBreakingConfig(weighting=options.weighting)
    passed = True
    print("problem            source    mean     best    worst   nodes  CPU seconds  steps")
    for name in options.problems:
        runs = [run(name, config, seed, options.episodes) for seed in range(options.seeds)]
        values = np.array([r.value for r in runs])
        passed &= bool(values.mean() >= SOURCE[name])
        print(
            f"{name:17} {SOURCE[name]:7.2f} {values.mean():8.2f} {values.max():8.2f} "
            f"{values.min():8.2f} {np.mean([r.nodes for r in runs]):6.1f} "
            f"{np.mean([r.seconds for r in runs]):9.1f}  {runs[0].steps:12,}",
            flush=True,
        )
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
