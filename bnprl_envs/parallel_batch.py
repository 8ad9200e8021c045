"""Copies of any PettingZoo environment of a team, as arrays (copies, agents)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Discrete, MultiDiscrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from pettingzoo import ParallelEnv

from bnprl_envs.arguments import checked_mask
from bnprl_envs.horizon import horizon_of
from bnprl_envs.team import BatchStep, IntArray, joint_space


class ParallelBatch(VectorEnv[IntArray, IntArray, Any]):
    """Copies of a parallel environment, stepped one by one: for those without a native batch.

    The interface is that of `TabularParallelBatch`. The agents must be a team: the same ones from
    the first step to the last, with Discrete observations and actions and one reward for all.

    Args:
        make: makes one copy.
        copies: how many, at least 1.

    Attributes:
        num_envs: the number of copies.
        possible_agents: the agents' names, in the order of the columns.
        max_episode_steps: after which an episode is cut; None where a copy does not say.

    Raises:
        ValueError: a space is not Discrete.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.DISABLED,
    }

    def __init__(self, make: Callable[[], ParallelEnv], copies: int = 1) -> None:
        self._envs = [make() for _ in range(copies)]
        self.num_envs = copies
        self.max_episode_steps = horizon_of(self._envs[0])
        self.possible_agents = list(self._envs[0].possible_agents)
        self.single_observation_space = self._joined("observation")
        self.single_action_space = self._joined("action")
        self.observation_space = batch_space(self.single_observation_space, copies)
        self.action_space = batch_space(self.single_action_space, copies)
        self._seen = np.zeros((copies, len(self.possible_agents)), dtype=np.int64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[IntArray, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: of the first copy; the others get the next ones.
            options: `{"reset_mask": mask}`, (copies,) booleans, begins anew only those copies.

        Returns:
            The observations (copies, agents), of untouched copies their last ones, and an empty
            dict.

        Raises:
            ValueError: an agent is missing.
        """
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and "reset_mask" in options:
            mask = checked_mask(options["reset_mask"], self.num_envs)
        for copy in np.flatnonzero(mask).tolist():
            observations, _ = self._envs[copy].reset(seed=None if seed is None else seed + copy)
            self._seen[copy] = self._row(observations, "observation")
        return self._seen.copy(), {}

    def step(self, actions: IntArray) -> BatchStep:
        """Act once in every copy.

        Args:
            actions: (copies, agents) integers.

        Returns:
            Observations (copies, agents), rewards of the team (copies,), terminated (copies,),
            truncated (copies,) and an empty dict.

        Raises:
            ValueError: an agent is missing, ends before the others or earns another reward.
        """
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros((2, self.num_envs), dtype=np.bool_)
        for copy, (env, chosen) in enumerate(zip(self._envs, actions.tolist(), strict=True)):
            observations, reward, ended, cut, _ = env.step(
                dict(zip(self.possible_agents, chosen, strict=True))
            )
            self._seen[copy] = self._row(observations, "observation")
            rewards[copy] = self._shared(reward, "reward", "a team earns one reward")
            over = "agents must all end together"
            terminated[copy] = self._shared(ended, "terminated", over)
            truncated[copy] = self._shared(cut, "truncated", over)
        return self._seen.copy(), rewards, terminated, truncated & ~terminated, {}

    def close_extras(self, **kwargs: Any) -> None:
        """Close every copy."""
        for env in self._envs:
            env.close()

    def _joined(self, kind: str) -> MultiDiscrete[np.int64]:
        """Return all agents' spaces of a kind as one."""
        spaces = [getattr(self._envs[0], f"{kind}_space")(agent) for agent in self.possible_agents]
        for agent, space in zip(self.possible_agents, spaces, strict=True):
            if not isinstance(space, Discrete):
                raise ValueError(f"{kind} space of {agent}: {space}, a team's must be Discrete")
        return joint_space(spaces)

    def _row(self, values: Mapping[str, Any], name: str) -> npt.NDArray[Any]:
        """Return one value an agent (N,)."""
        missing = [agent for agent in self.possible_agents if agent not in values]
        if missing:
            raise ValueError(f"no {name} of {missing[0]}: agents must not come and go")
        return np.array([values[agent] for agent in self.possible_agents])

    def _shared(self, values: Mapping[str, Any], name: str, rule: str) -> Any:
        """Return the value that all agents share."""
        row = self._row(values, name)
        if (row != row[0]).any():
            other = int(np.argmax(row != row[0]))
            first, second = self.possible_agents[0], self.possible_agents[other]
            raise ValueError(f"{name}: {row[0]} of {first}, {row[other]} of {second}, but {rule}")
        return row[0]
