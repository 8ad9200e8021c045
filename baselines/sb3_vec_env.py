"""Gymnasium's vector environments as Stable-Baselines3 wants them: one adapter.

Imported by `baselines.sb3` only, because it imports Stable-Baselines3.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

Array = npt.NDArray[Any]


class Encoder:
    """Turns Discrete observations into a stack of the last one-hot vectors; passes a Box on.

    Args:
        space: of one environment's observation.
        frame_stack: k, the number of Discrete observations that a stack holds, newest last;
            those before the episode's start are zeros. A Box is not stacked.

    Attributes:
        space: of what the network sees, (k * O,) float32 for O observations.
        shape: of one observation that the environment gives.

    Raises:
        ValueError: the space is neither Discrete nor Box.
    """

    space: gym.Space[Any]

    def __init__(self, space: gym.Space[Any], frame_stack: int = 1) -> None:
        self.shape = space.shape or ()
        if isinstance(space, Discrete):
            self._size, self._start = int(space.n), int(space.start)
            self.space = Box(0.0, 1.0, (frame_stack * self._size,), np.float32)
        elif isinstance(space, Box):
            self._size, self.space = 0, space
        else:
            raise ValueError(f"observation space {space}, must be Discrete or Box")

    def encode(
        self, observation: Array, stack: Array | None = None, begun: Array | None = None
    ) -> Array:
        """Return the new stacks (n, k * O), of a Box the observations themselves.

        Args:
            observation: (n,) the newest observations.
            stack: what the last call returned; None at the episodes' start.
            begun: (n,) booleans: where true, an episode starts and the old stack is ignored.
        """
        if not self._size:
            return np.asarray(observation)
        new = np.zeros((len(observation), *(self.space.shape or ())), dtype=np.float32)
        if stack is not None:
            new[:, : -self._size] = stack[:, self._size :]
            if begun is not None:
                new[begun] = 0.0
        new[np.arange(len(new)), observation - self._start - self._size] = 1.0
        return new


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment, encoded, behind Stable-Baselines3's interface.

    The environment's own autoreset is off: `step_wait` resets finished copies itself, so the
    last observation of an episode is at hand without a search through infos. An info holds
    "terminal_observation" (the stack), "TimeLimit.truncated" and "episode" (undiscounted return
    "r" and length "l") where an episode ended, and nothing elsewhere.

    Args:
        env: its autoreset mode is DISABLED.
        encoder: of its observations.

    Attributes:
        episodes: finished so far.
        steps: taken so far, over all copies.

    Raises:
        ValueError: autoreset is on.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], encoder: Encoder) -> None:
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError("the environment's autoreset_mode must be DISABLED")
        self.env = env
        self.episodes = 0
        self.steps = 0
        self._encoder = encoder
        self._stack = np.zeros((env.num_envs, 0), dtype=np.float32)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._actions: Array = np.zeros(0, dtype=np.int64)
        super().__init__(env.num_envs, encoder.space, env.single_action_space)

    def reset(self) -> Array:  # noqa: D102 (documented by the base class)
        observation, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._stack = self._encoder.encode(observation)
        return self._stack

    def step_async(self, actions: Array) -> None:  # noqa: D102
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:  # noqa: D102
        observation, reward, terminated, truncated, _ = self.env.step(self._actions)
        self._stack = self._encoder.encode(observation, self._stack)
        self._returns += reward
        self._lengths += 1
        self.steps += self.num_envs
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            for copy in np.flatnonzero(done).tolist():
                infos[copy] = self._final_info(copy, bool(truncated[copy] and not terminated[copy]))
            self._begin(done)
        return self._stack, reward, done, infos

    def _final_info(self, copy: int, truncated: bool) -> dict[str, Any]:
        return {
            "terminal_observation": self._stack[copy].copy(),
            "TimeLimit.truncated": truncated,
            "episode": {"r": float(self._returns[copy]), "l": int(self._lengths[copy])},
        }

    def _begin(self, done: Array) -> None:
        self.episodes += int(done.sum())
        self._returns[done] = 0.0
        self._lengths[done] = 0
        observation, _ = self.env.reset(options={"reset_mask": done})
        self._stack = self._stack.copy()
        self._stack[done] = self._encoder.encode(observation[done])

    def close(self) -> None:  # noqa: D102
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the attribute of the vector environment once for each copy."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: copies of a native vector environment have no attributes of their own."""
        raise NotImplementedError(f"set_attr({attr_name!r}): the copies are not separate objects")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused: copies of a native vector environment have no methods of their own."""
        raise NotImplementedError(f"env_method({method_name!r}): the copies are not separate")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Say yes to Monitor, whose statistics the infos hold, and no to any other."""
        wrapped = issubclass(wrapper_class, Monitor)
        return [wrapped] * len(list(self._get_indices(indices)))
