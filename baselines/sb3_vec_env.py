"""Gymnasium's vector environments as Stable-Baselines3 wants them: one adapter.

Imported by `baselines.sb3` only, because it imports Stable-Baselines3.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv

Array = npt.NDArray[Any]

RECENT = 100
"""Episodes whose returns are reported while learning, as Stable-Baselines3 does."""


class Encoder:
    """Turns integer observations into a stack of the last one-hot vectors; passes a Box on.

    Each agent of a team has a row of its own: row c * N + n is agent n in copy c.

    Args:
        space: of one environment's observation; MultiDiscrete (N,) of a team.
        frame_stack: k, the number of integer observations that a stack holds, newest last;
            those before the episode's start are zeros. A Box is not stacked.
        indexed: append which agent it is to the rows of a team, as a one-hot vector (N,).

    Attributes:
        space: of what the network sees, (k * O,) float32 for O observations, in a team the most
            that an agent has, and (k * O + N,) if indexed.
        shape: of one observation that the environment gives.
        rows: of one copy: N of a team, else 1.

    Raises:
        ValueError: the space is neither Discrete, a team's MultiDiscrete nor Box.
    """

    space: gym.Space[Any]

    def __init__(
        self, space: gym.Space[Any], frame_stack: int = 1, *, indexed: bool = False
    ) -> None:
        self.shape = space.shape or ()
        self.rows = 1
        self._index = np.zeros((1, 0), dtype=np.float32)
        if isinstance(space, Box):
            self._size, self.space = 0, space
            return
        if isinstance(space, Discrete):
            self._size, self._start = int(space.n), np.array(space.start)
        elif isinstance(space, MultiDiscrete):
            self._size, self._start = int(space.nvec.max()), space.start
            self.rows = len(space.nvec)
            if indexed:
                self._index = np.eye(self.rows, dtype=np.float32)
        else:
            raise ValueError(f"observation space {space}, must be Discrete or Box")
        self._stacked = frame_stack * self._size
        self.space = Box(0.0, 1.0, (self._stacked + self._index.shape[1],), np.float32)

    def encode(
        self, observation: Array, stack: Array | None = None, begun: Array | None = None
    ) -> Array:
        """Return the new rows (n * rows, k * O + N or 0), of a Box the observations themselves.

        Args:
            observation: (n,) the newest observations, of a team (n, N).
            stack: what the last call returned; None at the episodes' start.
            begun: (n,) booleans: where true, an episode starts and the old stack is ignored.
        """
        if not self._size:
            return np.asarray(observation)
        seen = (np.asarray(observation) - self._start).reshape(-1)
        new = np.zeros((len(seen), *(self.space.shape or ())), dtype=np.float32)
        if stack is not None:
            new[:, : self._stacked - self._size] = stack[:, self._size : self._stacked]
            if begun is not None:
                new[np.repeat(begun, self.rows)] = 0.0
        new[np.arange(len(new)), self._stacked - self._size + seen] = 1.0
        new[:, self._stacked :] = np.tile(self._index, (len(new) // len(self._index), 1))
        return new


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment, encoded, behind Stable-Baselines3's interface.

    The environment's own autoreset is off: `step_wait` resets finished copies itself, so the
    last observation of an episode is at hand without a search through infos. An info holds
    "terminal_observation" (the stack), "TimeLimit.truncated" and "episode" (undiscounted return
    "r" and length "l") where an episode ended, and nothing elsewhere.

    To Stable-Baselines3 each agent of a team is a copy of its own, which earns the team's reward:
    `num_envs` counts the encoder's rows.

    Args:
        env: its autoreset mode is DISABLED.
        encoder: of its observations.
        discount: if given, the rewards that are passed on are divided by the running standard
            deviation of returns with this discount, as `VecNormalize` does.

    Attributes:
        env: the vector environment.
        episodes: finished so far.
        steps: taken so far, over all copies; those of a team count once.
        reward: earned so far, over all copies; that of a team counts once.
        recent: undiscounted return and length of the last episodes.

    Raises:
        ValueError: autoreset is on.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], encoder: Encoder, discount: float | None = None
    ) -> None:
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError("the environment's autoreset_mode must be DISABLED")
        self.env = env
        self.encoder = encoder
        self.episodes = 0
        self.steps = 0
        self.reward = 0.0
        self.recent: deque[tuple[float, int]] = deque(maxlen=RECENT)
        self._stack = np.zeros((env.num_envs * encoder.rows, 0), dtype=np.float32)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._discount = discount
        self._spread = RunningMeanStd(shape=())
        self._discounted = np.zeros(env.num_envs)
        self._actions: Array = np.zeros(0, dtype=np.int64)
        action_space = env.single_action_space
        if isinstance(action_space, MultiDiscrete):
            action_space = Discrete(action_space.nvec.max())
        super().__init__(env.num_envs * encoder.rows, encoder.space, action_space)

    def reset(self) -> Array:  # noqa: D102 (documented by the base class)
        observation, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._discounted[:] = 0.0
        self._stack = self.encoder.encode(observation)
        return self._stack

    def step_async(self, actions: Array) -> None:  # noqa: D102
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:  # noqa: D102
        rows, shape = self.encoder.rows, self.env.single_action_space.shape or ()
        actions = self._actions.reshape(self.env.num_envs, *shape)
        observation, reward, terminated, truncated, _ = self.env.step(actions)
        self._stack = self.encoder.encode(observation, self._stack)
        self._returns += reward
        self.reward += float(reward.sum())
        self._lengths += 1
        self.steps += self.env.num_envs
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            for copy in np.flatnonzero(done).tolist():
                self._report(copy, bool(truncated[copy] and not terminated[copy]), infos)
            self._begin(done)
        return (
            self._stack,
            np.repeat(self._scaled(reward, done), rows),
            np.repeat(done, rows),
            infos,
        )

    def _scaled(self, reward: Array, done: Array) -> Array:
        if self._discount is None:
            return reward
        self._discounted = self._discount * self._discounted + reward
        self._spread.update(self._discounted)
        self._discounted[done] = 0.0
        return np.asarray(reward / np.sqrt(self._spread.var + 1e-8))

    def _report(self, copy: int, truncated: bool, infos: list[dict[str, Any]]) -> None:
        """Fill the infos of a copy whose episode has ended."""
        total, length = float(self._returns[copy]), int(self._lengths[copy])
        self.recent.append((total, length))
        first = copy * self.encoder.rows
        for row in range(first, first + self.encoder.rows):
            infos[row] = {
                "terminal_observation": self._stack[row].copy(),
                "TimeLimit.truncated": truncated,
                "episode": {"r": total, "l": length},
            }

    def _begin(self, done: Array) -> None:
        self.episodes += int(done.sum())
        self._returns[done] = 0.0
        self._lengths[done] = 0
        observation, _ = self.env.reset(options={"reset_mask": done})
        self._stack = self._stack.copy()
        self._stack[np.repeat(done, self.encoder.rows)] = self.encoder.encode(observation[done])

    def close(self) -> None:  # noqa: D102
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the attribute of the vector environment once for each copy."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: copies of a native vector environment have no attributes of their own.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(f"{attr_name}: copies are not separate objects, nothing can be set")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: copies of a native vector environment have no methods of their own.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(f"{method_name}: the copies are not separate objects with methods")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Say yes to Monitor, whose statistics the infos hold, and no to any other."""
        wrapped = issubclass(wrapper_class, Monitor)
        return [wrapped] * len(list(self._get_indices(indices)))
