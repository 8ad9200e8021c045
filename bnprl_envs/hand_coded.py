"""Policies that a person writes down for the environments without tables, and their returns.

What planning is for the tabular ones: something to hold a learner against.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import VectorEnv

from bnprl_envs.grid_traffic import HORIZONTAL, GridTrafficBatch, longer_queue
from bnprl_envs.registry import entry
from bnprl_envs.tables import FloatArray

IntArray = npt.NDArray[np.int64]
Policy = Callable[[npt.NDArray[Any], int, np.random.Generator], IntArray]
"""Actions from the observations of all copies, the number of steps done, and a generator."""


def balance(observations: FloatArray, t: int, rng: np.random.Generator) -> IntArray:
    """Inverted pendulum: push the cart under the pole, (copies, 2) to (copies,).

    Where the pole will point in 0.15 s tells the side; below 0.04 rad nothing is done.
    """
    lean = observations[:, 0] + 0.15 * observations[:, 1]
    return 1 + (lean > 0.04).astype(np.int64) - (lean < -0.04)


def go_around(observations: FloatArray, t: int, rng: np.random.Generator) -> IntArray:
    """Puddle world: east below the puddles until x = 0.9, then north, (copies, 2) to (copies,)."""
    north, east = 0, 2
    return np.where(observations[:, 0] < 0.9, east, north)


def follow_longer_queue(observations: IntArray, t: int, rng: np.random.Generator) -> IntArray:
    """Grid traffic: each light is with the longer of its two queues, (copies, agents) to same."""
    return longer_queue(observations)


def always_horizontal(observations: IntArray, t: int, rng: np.random.Generator) -> IntArray:
    """Grid traffic: the rows are open for ever."""
    return np.full_like(observations, HORIZONTAL)


def alternate(observations: IntArray, t: int, rng: np.random.Generator) -> IntArray:
    """Grid traffic: the rows are open at even steps, the columns at odd ones."""
    return np.full_like(observations, t % 2)


POLICIES: dict[str, dict[str, Policy]] = {
    "bnprl/InvertedPendulum-v0": {"balance": balance},
    "bnprl/PuddleWorld-v0": {"go around": go_around},
    "bnprl/GridTraffic-v0": {
        "always horizontal": always_horizontal,
        "longer queue": follow_longer_queue,
        "alternating": alternate,
    },
}
"""The policies of each id, the best one last."""


def uniform_policy(envs: VectorEnv[Any, Any, Any]) -> Policy:
    """Return the policy that draws every action uniformly."""
    space = envs.single_action_space
    sizes = space.nvec if isinstance(space, gym.spaces.MultiDiscrete) else space.n  # type: ignore[attr-defined]

    def uniform(observations: npt.NDArray[Any], t: int, rng: np.random.Generator) -> IntArray:
        return rng.integers(sizes, size=envs.action_space.shape)

    return uniform


def make_batch(id: str, copies: int) -> VectorEnv[Any, Any, Any]:
    """Return a native batch of an id without tables, whose copies wait for `reset` when over."""
    if entry(id).kind == "parallel-class":
        return GridTrafficBatch(copies, max_episode_steps=entry(id).horizon)
    return gym.make_vec(id, num_envs=copies, autoreset_mode="Disabled")


def simulated_returns(
    envs: VectorEnv[Any, Any, Any], policy: Policy, rng: np.random.Generator
) -> FloatArray:
    """Return the discounted returns (copies,) of one episode of each copy of a batch.

    Args:
        envs: a native batch with autoreset disabled.
        policy: what acts.
        rng: of the environment's seed and of the policy's draws.
    """
    observations, _ = envs.reset(seed=int(rng.integers(2**31)))
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=np.bool_)
    t = 0
    while running.any():
        observations, rewards, terminated, truncated, _ = envs.step(policy(observations, t, rng))
        total += running * envs.discount**t * rewards  # type: ignore[attr-defined]
        t += 1
        over = terminated | truncated
        running &= ~over
        if over.any():
            observations, _ = envs.reset(options={"reset_mask": over})
    return total
