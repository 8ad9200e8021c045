"""What environments share whose state, a point of a box, is observed: one copy, and a batch."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete

from bnprl_envs.arguments import checked_action, checked_limit
from bnprl_envs.rendering.rendered import Rendered
from bnprl_envs.rendering.scene import Doing, Moment
from bnprl_envs.tables import BoolArray, FloatArray
from bnprl_envs.vector_env import IntArray, NativeVectorEnv


class ContinuousEnv(Rendered, gym.Env[Any, Any]):
    """One copy; a subclass says how an episode begins, what a step does, and how that looks.

    Reaching a terminal state terminates; using up `max_episode_steps` truncates, unless the last
    step terminates. (`gymnasium.make` truncates by its TimeLimit instead, which sets both on such
    a last step.)

    Args:
        observation_space: (D,) float64, holds every reachable state.
        n_actions: A.
        max_episode_steps: steps before truncation; None: no limit.
        render_mode: None, "ansi", "rgb_array" or "human".

    Raises:
        ValueError: an argument is out of range.
    """

    metadata: dict[str, Any] = Rendered.metadata | {"render_fps": 10}
    discount: float
    action_names: tuple[str, ...]
    state_names: tuple[str, ...]

    def __init__(
        self,
        observation_space: Box,
        n_actions: int,
        *,
        max_episode_steps: int | None,
        render_mode: str | None,
    ) -> None:
        self._set_render_mode(render_mode)
        self.max_episode_steps = checked_limit(max_episode_steps)
        self.observation_space = observation_space
        self.action_space = Discrete(n_actions)
        self._n_actions = n_actions
        self._limit = max_episode_steps or math.inf
        self._state: tuple[float, ...] = ()
        self._last: tuple[int, float] | None = None
        self._trail: list[tuple[float, ...]] = []
        self._elapsed = 0
        self._running = False

    @property
    def state(self) -> FloatArray:
        """The true state (D,), which is also the observation.

        Raises:
            ResetNeeded: before the first reset.
        """
        if not self._state:
            raise ResetNeeded("the environment has no state before reset()")
        return np.array(self._state)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: begins the random stream anew.
            options: none are known.

        Returns:
            The state (D,) and an empty dict.
        """
        super().reset(seed=seed)
        self._state = self._start()
        self._last, self._trail = None, [self._state]
        self._elapsed = 0
        self._running = True
        self._show()
        return np.array(self._state), {}

    def step(self, action: int) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Act once.

        Args:
            action: in {0, ..., A - 1}.

        Returns:
            The next state (D,), reward, terminated, truncated and an empty dict.

        Raises:
            ResetNeeded: no episode is running.
            ValueError: there is no such action.
        """
        if not self._running:
            raise ResetNeeded("step() needs a running episode: call reset() first")
        chosen = checked_action(action, self._n_actions)
        self._state, reward, terminated = self._move(chosen)
        self._elapsed += 1
        truncated = not terminated and self._elapsed >= self._limit
        self._running = not (terminated or truncated)
        self._last = chosen, reward
        if self.render_mode is not None:
            self._trail.append(self._state)
            self._show()
        return np.array(self._state), reward, terminated, truncated, {}

    def _moment(self) -> Moment:
        state = self.state
        seen = ", ".join(
            f"{name} {value:.2f}" for name, value in zip(self.state_names, state, strict=True)
        )
        actions, reward = ((), None) if self._last is None else ((self._last[0],), self._last[1])
        word = self.action_names[actions[0]] if actions else "-"
        doings = (Doing("agent", word, seen),)
        return Moment(state, self._elapsed, actions, reward, doings, trail=tuple(self._trail))

    @abstractmethod
    def _start(self) -> tuple[float, ...]:
        """Return a state to begin in."""

    @abstractmethod
    def _move(self, action: int) -> tuple[tuple[float, ...], float, bool]:
        """Return the state after an action, the reward, and whether the state is terminal."""


class ContinuousVectorEnv(NativeVectorEnv):
    """A batch; a subclass draws starts (`_starts`) and moves the copies (`_move`)."""

    _observations: FloatArray

    @property
    def states(self) -> FloatArray:
        """The true states (num_envs, D), which are also the observations; a copy.

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started()
        return self._observations.copy()

    def _begin(self, copies: IntArray) -> None:
        self._observations[copies] = self._starts(copies.size)

    def _advance(
        self, actions: IntArray, rewards: FloatArray, terminated: BoolArray, truncated: BoolArray
    ) -> None:
        over = self._finished.copy()
        self._move(actions, self._observations, rewards, terminated)
        self._elapsed += 1
        np.greater_equal(self._elapsed, self._limit, out=truncated)
        truncated &= ~(terminated | over)
        np.logical_or(terminated, truncated, out=self._finished)
        if over.any():
            self._restart(over)

    @abstractmethod
    def _starts(self, n: int) -> FloatArray:
        """Return n states to begin in, (n, D)."""

    @abstractmethod
    def _move(
        self, actions: IntArray, states: FloatArray, rewards: FloatArray, terminated: BoolArray
    ) -> None:
        """Step every copy that is not finished, in place; leave the others alone."""
