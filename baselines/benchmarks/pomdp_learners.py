"""What a learner of controllers reaches on the POMDPs, for the environment steps spent.

`python -m baselines.benchmarks.pomdp_learners` trains several seeds on every environment with the
agent's default settings and prints steps, seconds and exact values against the wanted ones; it
exits 1 where a mean over the seeds falls short. Values are those of the learned controllers,
computed from the models, which the learner never sees.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from baselines.contenders import AgentLearner, build_learner, contender
from baselines.environment import EnvironmentSpec
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.controllers.value import controller_value
from bnprl_envs import model


class Goal(NamedTuple):
    """The mean value that is wanted after so many environment steps."""

    steps: int
    value: float


GOALS = {
    "bnprl/Hallway-v0": (
        Goal(150_000, 0.444),
        Goal(300_000, 0.459),
        Goal(450_000, 0.477),
        Goal(1_500_000, 0.50),
    ),
    "bnprl/Hallway2-v0": (Goal(1_000_000, 0.2061),),
    "bnprl/Tag-v0": (Goal(1_000_000, -12.5), Goal(5_000_000, -8.0)),
    "bnprl/CheeseMaze-v0": (Goal(1_000_000, 0.80),),
    "bnprl/Grid4x4-v0": (Goal(1_000_000, 0.82),),
    "bnprl/NoisyMaze1D-v0": (Goal(1_000_000, 0.71),),
    "bnprl/Shuttle-v0": (Goal(1_000_000, 31.0),),
}
"""Hallway up to 450,000 steps: what a well-set RecurrentPPO reaches; Tag's first: a memoryless PPO
after 400,000; Hallway2: the best memoryless policy; else issue targets between that and the best
known value."""


class Score(NamedTuple):
    """How one seed stands at a goal: environment steps, exact value, processor seconds."""

    steps: int
    value: float
    seconds: float


def run(
    name: str,
    env: str,
    seed: int,
    *,
    settings: Any = None,
    goals: Sequence[Goal] | None = None,
    shown: bool = False,
) -> list[Score]:
    """Train one agent from one seed and score its controllers at every goal.

    Args:
        name: of the agent on the command line.
        env: id of a tabular environment.
        seed: of everything random.
        settings: the agent's; None means its defaults.
        goals: in the order of their steps; None means those of `GOALS`.
        shown: whether to draw a progress bar.

    Raises:
        ValueError: the agent learns no controllers.
    """
    spec = EnvironmentSpec(env)
    learner = build_learner(contender(name), spec, settings, seed)
    if not isinstance(learner, AgentLearner) or not isinstance(learner.agent, ControllerAgent):
        raise ValueError(f"agent: {name!r} learns no controllers, but their values are wanted")
    waiting = list(GOALS[env] if goals is None else goals)
    scores: list[Score] = []
    held, scoring = (0, 0.0, learner.agent.controllers), 0.0

    def score(until: float) -> None:
        """Score the last controllers at every goal that they were learned within."""
        while waiting and waiting[0].steps < until:
            value = controller_value(model(env), held[2], spec.discount)
            scores.append(Score(held[0], value, held[1]))
            waiting.pop(0)

    begin = time.process_time()
    with tqdm(total=waiting[-1].steps, desc=f"{env} {seed}", disable=not shown, delay=2) as bar:
        for now in learner.learn(steps=waiting[-1].steps):
            spent = time.process_time() - begin - scoring
            score(until=now.steps)
            scoring = time.process_time() - begin - spent
            held = (now.steps, spent, learner.agent.controllers)
            bar.update(now.steps - bar.n)
        score(until=np.inf)
    return scores


def report(env: str, runs: Sequence[Sequence[Score]]) -> bool:
    """Print a line for every goal of an environment; return whether all are reached."""
    passed = True
    for goal, scores in zip(GOALS[env], zip(*runs, strict=True), strict=True):
        values = np.array([score.value for score in scores])
        reached = bool(values.mean() >= goal.value)
        passed &= reached
        print(
            f"{env:22}  {np.mean([s.steps for s in scores]):11,.0f}  "
            f"{np.mean([s.seconds for s in scores]):7.1f}  {values.mean():8.4f}  "
            f"{values.min():8.4f}  {values.max():8.4f}  {goal.value:8.4f}  "
            f"{'pass' if reached else 'FAIL'}",
            flush=True,
        )
    return passed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every seed on every environment and print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agent", default="actor-critic", help="name of a learner of controllers")
    parser.add_argument("--seeds", type=int, default=10, help="runs on each environment")
    parser.add_argument("--environments", nargs="+", choices=list(GOALS), default=list(GOALS))
    parser.add_argument("--no-progress", action="store_true", help="draw no progress bars")
    options = parser.parse_args(arguments)
    print(
        f"{'environment':22}  {'steps':>11}  {'cpu s':>7}  {'mean':>8}  {'least':>8}  {'most':>8}  "
        f"{'wanted':>8}   ({options.agent}, {options.seeds} seeds)"
    )
    passed = True
    for env in options.environments:
        runs = [
            run(options.agent, env, seed, shown=not options.no_progress)
            for seed in range(options.seeds)
        ]
        passed &= report(env, runs)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
