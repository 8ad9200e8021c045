"""What `ControllerSearch` reaches on the decentralised benchmarks, and how fast.

`python -m baselines.benchmarks.team_learners --out FILE` trains every seed of every problem with
the same settings, prints the exact values of the returned controllers (of grid traffic: the units
that pass in a step, by simulation) and exits 1 where a mean misses its target or a seed takes more
than five minutes of one core. What FILE holds is not run again. The last problem is a model file
that nothing else uses; its target is the best memoryless policy, which is searched on the model.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import bnprl_envs
from baselines.benchmarks.run_records import Records, Run, Score
from bnprl_agents import ControllerSearch, controller_value, train
from bnprl_envs import GridTrafficBatch, TabularModel, TabularParallelBatch
from bnprl_envs.memoryless import memoryless_joint_policy
from bnprl_envs.team import agent_spaces

AGENT = "controller-search"
SECONDS = 300.0
"""CPU time of one seed that may not be exceeded."""
DISCOUNT = 0.9
EPISODES = 1000
"""Episodes by which grid traffic is evaluated."""


@dataclass(frozen=True)
class Problem:
    """A problem with its target.

    Attributes:
        name: of the environment, or of a file beside this one.
        wanted: smallest passing mean over the seeds; None: the best memoryless value.
        goal: best known value of the literature; of grid traffic, what is hoped for.
        steps: simulated for one seed, of all agents together.
    """

    name: str
    wanted: float | None
    goal: float | None
    steps: int

    def model(self) -> TabularModel | None:
        """The model; None for grid traffic, which has none."""
        if self.name.endswith(".dpomdp"):
            return bnprl_envs.read_model(Path(__file__).parent / self.name)
        tabular = bnprl_envs.entry(self.name).kind == "parallel-tabular"
        return bnprl_envs.model(self.name) if tabular else None


PROBLEMS = (
    Problem("bnprl/BroadcastChannel-v0", 9.26, 9.271, 150_000_000),
    Problem("bnprl/RecyclingRobots-v0", 31.9, 31.929, 50_000_000),
    Problem("bnprl/MeetingGrid-v0", 5.8, 5.820, 100_000_000),
    Problem("bnprl/BoxPushing-v0", 200.0, 224.43, 150_000_000),
    Problem("bnprl/MarsRovers-v0", 25.0, 26.94, 300_000_000),
    Problem("bnprl/DecTiger-v0", 5.0, 13.448, 50_000_000),
    Problem("bnprl/GridTraffic-v0", 8.5, 9.5, 2_000_000),
    Problem("pressure.dpomdp", None, None, 50_000_000),
)


def run(problem: Problem, seed: int) -> list[Score]:
    """Train from one seed and evaluate the returned controllers."""
    begin = time.process_time()
    model = problem.model()
    batch = TabularParallelBatch(model, max_episode_steps=100) if model else GridTrafficBatch(8)
    agent = ControllerSearch(*agent_spaces(batch), discount=DISCOUNT, seed=seed)
    for _ in train(agent, batch, seed=seed, steps=problem.steps):
        pass
    seconds = time.process_time() - begin
    value = controller_value(model, agent.controllers, DISCOUNT) if model else units_a_step(agent)
    return [Score(problem.steps, value, seconds, max(c.n_nodes for c in agent.controllers))]


def described(problem: Problem, seed: int) -> Run:
    """A run of `run`."""
    make = partial(run, problem, seed)
    return Run.of(AGENT, problem.name, seed, make, steps=problem.steps, discount=DISCOUNT)


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


def report(problem: Problem, runs: list[Score]) -> bool:
    """Print the verdict on a problem and return it."""
    values = [r.value for r in runs]
    mean, slowest = float(np.mean(values)), max(r.seconds for r in runs)
    wanted, model = problem.wanted or 0.0, problem.model()
    if problem.wanted is None and model:
        wanted = memoryless_joint_policy(model, discount=DISCOUNT).value
    good = mean >= wanted - 1e-9 and slowest <= SECONDS
    goal = "" if problem.goal is None else f", goal {problem.goal:.3f}"
    print(
        f"{problem.name:25}  mean  {mean:8.3f}, best {max(values):.3f}, worst {min(values):.3f}, "
        f"at most {slowest:.0f} s, wanted {wanted:.3f}{goal}: {'pass' if good else 'FAIL'}",
        flush=True,
    )
    return good


def main(arguments: list[str] | None = None) -> int:
    """Run every seed and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = [p.name for p in PROBLEMS]
    parser.add_argument("--seeds", type=int, default=10, help="runs of each problem")
    parser.add_argument("--problems", nargs="+", choices=names, default=names)
    parser.add_argument("--scale", type=float, default=1.0, help="factor of the simulated steps")
    parser.add_argument("--out", type=Path, help="file of finished runs, which are not run again")
    chosen = parser.parse_args(arguments)
    records, passed = Records(chosen.out), True
    print("problem                    seed     value  nodes  seconds")
    for problem in PROBLEMS:
        if problem.name not in chosen.problems:
            continue
        scaled = dataclasses.replace(problem, steps=int(problem.steps * chosen.scale))
        runs: list[Score] = []
        for seed in range(chosen.seeds):
            runs += records.of(described(scaled, seed))
            r = runs[-1]
            print(f"{problem.name:25}  {seed:4}  {r.value:8.3f}  {r.nodes:5}  {r.seconds:7.1f}")
            sys.stdout.flush()
        passed &= report(scaled, runs)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
