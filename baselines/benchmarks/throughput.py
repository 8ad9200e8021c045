"""Steps per second of our environments against Gymnasium's.

`python -m baselines.benchmarks.throughput` prints the table and exits 1 on a miss.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

import bnprl_envs
from baselines.benchmarks.contest import Contest, run_contests
from bnprl_agents import OnlineEM, rollout
from bnprl_agents.controllers.scoring import simulated_returns
from bnprl_envs import TabularModel

OURS, PEER = "bnprl/Hallway-v0", "FrozenLake-v1"


def scalar_steps(env: gym.Env[Any, Any], steps: int = 2000) -> Callable[[], float]:
    """Return work: some steps of one environment under random actions drawn beforehand."""
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(steps)]
    env.reset(seed=0)

    def work() -> float:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    return work


def batch_steps(envs: gym.vector.VectorEnv[Any, Any, Any], calls: int) -> Callable[[], float]:
    """Return work: some steps of a batch under random actions drawn beforehand."""
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(calls)]
    envs.reset(seed=0)

    def work() -> float:
        for action in actions:
            envs.step(action)
        return calls * envs.num_envs

    return work


def environment_contests() -> list[Contest]:
    """Return the contests of environments, scalar and batched."""
    lakes = gym.make_vec(PEER, num_envs=64, vectorization_mode="sync")
    peer = batch_steps(lakes, calls=5)
    return [
        Contest(
            f"gym.make: {OURS} / {PEER}",
            scalar_steps(gym.make(OURS)),
            scalar_steps(gym.make(PEER)),
            wanted=2.5,
        ),
        Contest(
            f"unwrapped: {OURS} / {PEER}",
            scalar_steps(gym.make(OURS).unwrapped),
            scalar_steps(gym.make(PEER).unwrapped),
            wanted=2.5,
        ),
        *(
            Contest(
                f"{copies:,} copies of {OURS} / SyncVectorEnv of 64 {PEER}",
                batch_steps(gym.make_vec(OURS, num_envs=copies), calls=20),
                peer,
                wanted,
            )
            for copies, wanted in ((1024, 100.0), (16384, 300.0))
        ),
    ]


def scored_steps(agent: OnlineEM, model: TabularModel, episodes: int) -> Callable[[], float]:
    """Return work: returns of some episodes under the agent's controllers, compiled."""
    rng = np.random.default_rng(0)

    def work() -> float:
        _, lengths = simulated_returns(
            model, agent.controllers, episodes=episodes, horizon=251, discount=0.95, rng=rng
        )
        return float(lengths.sum())

    return work


def predicted_steps(
    agent: OnlineEM, envs: gym.vector.VectorEnv[Any, Any, Any], calls: int
) -> Callable[[], float]:
    """Return work: some steps of a batch with actions from `agent.predict`."""
    observation, _ = envs.reset(seed=0)
    state, begun = None, np.ones(envs.num_envs, dtype=np.bool_)

    def work() -> float:
        nonlocal observation, state, begun
        for _ in range(calls):
            action, state = agent.predict(observation, state, begun)
            observation, _, terminated, truncated, _ = envs.step(action)
            begun = terminated | truncated
            if begun.any():
                observation, _ = envs.reset(options={"reset_mask": begun})
        return calls * envs.num_envs

    return work


def rolled_steps(agent: OnlineEM, model: TabularModel, episodes: int) -> Callable[[], float]:
    """Return work: recorded episodes under the agent's behaviour policy, compiled."""
    rng = np.random.default_rng(0)

    def work() -> float:
        batch = rollout(
            model,
            agent.controllers,
            episodes=episodes,
            horizon=251,
            rng=rng,
            explore=agent.explore,
        )
        return batch.n_steps

    return work


def observed_steps(
    agent: OnlineEM, envs: gym.vector.VectorEnv[Any, Any, Any], calls: int
) -> Callable[[], float]:
    """Return work: some steps of a batch, acting and recording through the shared interface."""
    observation, _ = envs.reset(seed=0)
    agent.reset(observation)

    def work() -> float:
        nonlocal observation
        for _ in range(calls):
            action = agent.act(observation)
            observation, reward, terminated, truncated, _ = envs.step(action)
            agent.observe(action, reward, observation, terminated, truncated)
            ended = terminated | truncated
            if ended.any():
                observation, _ = envs.reset(options={"reset_mask": ended})
                agent.reset(observation, ended)
        return calls * envs.num_envs

    return work


def controller_contests() -> list[Contest]:
    """Return the contests of compiled rollouts against the native batch stepped from Python.

    Scoring samples nodes; recording filters them, ours in single precision and one product a step.
    """
    copies = 1024
    envs = gym.make_vec(OURS, num_envs=copies, autoreset_mode="Disabled")
    model = bnprl_envs.model(OURS)
    agent = OnlineEM(envs.single_observation_space, envs.single_action_space, discount=0.95, seed=0)
    return [
        Contest(
            f"controller scored: compiled / {copies:,} copies stepped with predict",
            scored_steps(agent, model, episodes=10_000),
            predicted_steps(agent, envs, calls=10),
            wanted=10.0,
        ),
        Contest(
            f"controller recorded: compiled / {copies:,} copies, act and observe",
            rolled_steps(agent, model, episodes=1000),
            observed_steps(agent, envs, calls=10),
            wanted=10.0,
        ),
    ]


CONTESTS: tuple[Callable[[], list[Contest]], ...] = (environment_contests, controller_contests)
"""Makers of contests, in the order of the table: add one here."""


def main(arguments: list[str] | None = None) -> int:
    """Run every contest; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="for each side of a contest")
    seconds = parser.parse_args(arguments).seconds
    return 0 if run_contests([c for make in CONTESTS for c in make()], seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
