"""Grid traffic as arrays (copies, agents): the dynamics, for one copy or thousands."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import MultiDiscrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from bnprl_envs.arguments import (
    check_render_mode,
    checked_count,
    checked_discount,
    checked_limit,
    checked_mask,
    checked_probability,
)
from bnprl_envs.tables import BoolArray
from bnprl_envs.team import BatchStep, IntArray, agent_names, checked_team_actions

HORIZONTAL, VERTICAL = range(2)


class GridTrafficBatch(VectorEnv[IntArray, IntArray, Any]):
    """Independent copies of `GridTraffic` as arrays (copies, agents).

    The interface is that of a Gymnasium vector environment without autoreset, whose single
    observation and action are one integer an agent: copies that are over wait for
    `reset(options={"reset_mask": mask})`. All copies share one random stream, so a seed fixes the
    whole batch. Arrays are new at each call.

    Args:
        copies: how many.
        rows: as for `GridTraffic`.
        columns: as for `GridTraffic`.
        capacity: as for `GridTraffic`.
        arrival_rate: as for `GridTraffic`.
        discharge: as for `GridTraffic`.
        discount: as for `GridTraffic`.
        max_episode_steps: steps before truncation; None: no limit.
        render_mode: None.

    Attributes:
        discount: in (0, 1].
        max_episode_steps: the limit.
        num_envs: the number of copies.
        n_agents: rows times columns.
        possible_agents: the agents' names, in the order of the columns.

    Raises:
        ValueError: an argument is out of range.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.DISABLED,
    }

    def __init__(
        self,
        copies: int = 1,
        *,
        rows: int = 10,
        columns: int = 10,
        capacity: int = 9,
        arrival_rate: float = 0.5,
        discharge: int = 1,
        discount: float = 0.9,
        max_episode_steps: int | None = 100,
        render_mode: str | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self.num_envs = checked_count("copies", copies)
        self.rows = checked_count("rows", rows)
        self.columns = checked_count("columns", columns)
        self.capacity = checked_count("capacity", capacity)
        self.discharge = checked_count("discharge", discharge)
        self.arrival_rate = checked_probability("arrival_rate", arrival_rate)
        self.discount = checked_discount(discount)
        self.max_episode_steps = checked_limit(max_episode_steps)
        self.n_agents = rows * columns
        self.possible_agents = agent_names(self.n_agents)
        self._sizes = np.full(self.n_agents, 2)
        self.single_action_space = MultiDiscrete(self._sizes)
        self.single_observation_space = MultiDiscrete(np.full(self.n_agents, (capacity + 1) ** 2))
        self._queues = np.zeros((copies, rows + columns), dtype=np.int64)
        self._elapsed = np.zeros(copies, dtype=np.int64)
        self._finished = np.zeros(copies, dtype=np.bool_)
        self._started = False

    @cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """MultiDiscrete (copies, agents), made on request: it may be large."""
        return batch_space(self.single_action_space, self.num_envs)

    @cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """MultiDiscrete (copies, agents), made on request: it may be large."""
        return batch_space(self.single_observation_space, self.num_envs)

    @property
    def queues(self) -> IntArray:
        """Units waiting (copies, rows + columns), of the rows first; a copy.

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started()
        return self._queues.copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[IntArray, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: begins the one random stream anew.
            options: `{"reset_mask": mask}`, (copies,) booleans, begins anew only those copies.

        Returns:
            The observations (copies, agents), of untouched copies their last ones, and an empty
            dict.

        Raises:
            TypeError: the mask is no array of booleans.
            ValueError: the mask has another shape or chooses no copy.
            ResetNeeded: a mask leaves out copies that never began.
        """
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and "reset_mask" in options:
            mask = checked_mask(options["reset_mask"], self.num_envs)
        if not mask.all():
            self._check_started()
        super().reset(seed=seed)
        self._started = True
        self._queues[mask] = 0
        self._elapsed[mask] = 0
        self._finished[mask] = False
        return self._observations(), {}

    def step(self, actions: IntArray) -> BatchStep:
        """Act once in every copy.

        Args:
            actions: (copies, agents), 0 horizontal or 1 vertical.

        Returns:
            Observations (copies, agents), rewards (copies,), terminated (copies,), truncated
            (copies,), and an info dict with `lost`, the arrivals lost (copies,).

        Raises:
            ResetNeeded: before the first reset, or a copy is over.
            ValueError: an action is not one; the message names the copy and the agent.
        """
        self._check_started()
        if self._finished.any():
            copy = int(np.argmax(self._finished))
            raise ResetNeeded(f"copy {copy} has finished: reset it with options['reset_mask']")
        shape = (self.num_envs, self.n_agents)
        chosen = checked_team_actions(actions, shape, self._sizes)
        passed = self._discharge(self._open(chosen == VERTICAL))
        lost = self._arrive()
        self._elapsed += 1
        if self.max_episode_steps is not None:
            self._finished = self._elapsed >= self.max_episode_steps
        terminated = np.zeros(self.num_envs, dtype=np.bool_)
        rewards = passed.astype(np.float64)
        return self._observations(), rewards, terminated, self._finished.copy(), {"lost": lost}

    def _open(self, vertical: BoolArray) -> BoolArray:
        """Return which lines (copies, rows + columns) all their agents are aligned with."""
        lights = vertical.reshape(-1, self.rows, self.columns)
        return np.concatenate([~lights.any(axis=2), lights.all(axis=1)], axis=1)

    def _discharge(self, lines: BoolArray) -> IntArray:
        """Let traffic pass on open lines; return the units that passed (copies,)."""
        passed = np.minimum(self._queues, self.discharge) * lines
        self._queues -= passed
        return np.asarray(passed.sum(axis=1))

    def _arrive(self) -> IntArray:
        """Let units arrive; return those lost at full queues (copies,)."""
        arriving = self.np_random.random(self._queues.shape) < self.arrival_rate
        full = self._queues == self.capacity
        self._queues += arriving & ~full
        return np.asarray(np.count_nonzero(arriving & full, axis=1))

    def _observations(self) -> IntArray:
        """Return (copies, agents): the levels of each agent's two queues."""
        row, column = self._queues[:, : self.rows], self._queues[:, self.rows :]
        levels = row[:, :, None] * (self.capacity + 1) + column[:, None, :]
        return np.asarray(levels.reshape(self.num_envs, self.n_agents))

    def _check_started(self) -> None:
        if not self._started:
            raise ResetNeeded("the environments have no states: call reset() first")
