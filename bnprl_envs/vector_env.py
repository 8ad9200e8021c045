"""What native batches of environments share: episodes that end, and begin again by the mode."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_empty_array

from bnprl_envs.arguments import (
    check_render_mode,
    checked_actions,
    checked_autoreset_mode,
    checked_count,
    checked_limit,
    checked_mask,
)
from bnprl_envs.tables import BoolArray, FloatArray

IntArray = npt.NDArray[np.int64]
Step = tuple[npt.NDArray[Any], FloatArray, BoolArray, BoolArray, dict[str, Any]]

_NO_LIMIT = np.iinfo(np.int64).max


class NativeVectorEnv(VectorEnv[npt.NDArray[Any], IntArray, npt.NDArray[Any]]):
    """`num_envs` independent copies, with the semantics of Gymnasium's SyncVectorEnv.

    A copy that terminates or truncates begins anew by the autoreset mode: at its next step,
    which ignores the action and earns 0 (NEXT_STEP); at once, the last observation moving to
    `info["final_obs"]` (SAME_STEP); or when `reset(options={"reset_mask": mask})` says so
    (DISABLED). A terminating copy never truncates at the same step.

    All copies share one random stream, so a seed fixes the whole batch. Arrays are new at each
    call: (num_envs, ...) observations, (num_envs,) float64 rewards and bool flags.

    A subclass says how episodes begin (`_begin`) and go on (`_advance`).

    Args:
        num_envs: number of copies.
        observation_space: of one copy.
        action_space: of one copy.
        discount: factor of the values, in (0, 1].
        max_episode_steps: steps before truncation; None: no limit.
        autoreset_mode: the mode or its name ("NextStep", "SameStep", "Disabled").
        render_mode: None.

    Attributes:
        discount: in (0, 1].
        max_episode_steps: the limit.
        autoreset_mode: also in `metadata`.

    Raises:
        ValueError: an argument is out of range.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (declared so by Gymnasium)

    def __init__(
        self,
        num_envs: int,
        observation_space: Space[Any],
        action_space: Discrete,
        *,
        discount: float,
        max_episode_steps: int | None,
        autoreset_mode: AutoresetMode | str,
        render_mode: str | None,
    ) -> None:
        checked_count("num_envs", num_envs)
        check_render_mode(render_mode)
        self.num_envs = num_envs
        self.discount = discount
        self.max_episode_steps = checked_limit(max_episode_steps)
        self.autoreset_mode = checked_autoreset_mode(autoreset_mode)
        self.metadata = type(self).metadata | {"autoreset_mode": self.autoreset_mode}
        self.single_action_space = action_space
        self.single_observation_space = observation_space
        self.action_space = batch_space(action_space, num_envs)
        self.observation_space = batch_space(observation_space, num_envs)
        self._n_actions = int(action_space.n)
        self._limit = max_episode_steps or _NO_LIMIT
        self._started = False
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.zeros(num_envs, dtype=np.bool_)
        self._observations: npt.NDArray[Any] = create_empty_array(observation_space, num_envs)  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: begins the one random stream anew.
            options: `{"reset_mask": mask}`, (num_envs,) booleans, begins anew only those copies.

        Returns:
            The observations (num_envs, ...), of untouched copies their last ones, and an empty
            dict.

        Raises:
            TypeError: the seed is not an int or None, or the mask no array of booleans.
            ValueError: the mask has another shape or chooses no copy.
            ResetNeeded: a mask leaves out copies that never began.
        """
        if not isinstance(seed, int | np.integer | None):
            raise TypeError(f"seed: {seed!r}, must be an int or None; all copies share one stream")
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and "reset_mask" in options:
            mask = checked_mask(options["reset_mask"], self.num_envs)
        if not mask.all():
            self._check_started()
        super().reset(seed=None if seed is None else int(seed))
        self._restart(mask)
        self._started = True
        return self._observations.copy(), {}

    def step(self, actions: IntArray) -> Step:
        """Act once in every copy.

        Args:
            actions: (num_envs,) integers in {0, ..., A - 1}; those of copies that this step
                resets are ignored.

        Returns:
            Observations (num_envs, ...), rewards, terminated, truncated, each (num_envs,), and
            the info dict.

        Raises:
            ResetNeeded: before the first reset; in mode DISABLED, a copy is finished.
            ValueError: an action is not one; the message names the copy.
        """
        self._check_started()
        if self.autoreset_mode is AutoresetMode.DISABLED and self._finished.any():
            copy = int(np.argmax(self._finished))
            raise ResetNeeded(f"copy {copy} has finished: reset it with options['reset_mask']")
        checked = checked_actions(actions, self._n_actions, ignored=self._finished)
        rewards = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, dtype=np.bool_)
        truncated = np.zeros(self.num_envs, dtype=np.bool_)
        self._advance(checked, rewards, terminated, truncated)
        info: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._finished.any():
            info = self._final_info()
            self._restart(self._finished)
        return self._observations.copy(), rewards, terminated, truncated, info

    @abstractmethod
    def _begin(self, copies: IntArray) -> None:
        """Draw the start of an episode of some copies and write their observations."""

    @abstractmethod
    def _advance(
        self, actions: IntArray, rewards: FloatArray, terminated: BoolArray, truncated: BoolArray
    ) -> None:
        """Step every copy, but begin those that are finished; the results come as zeros."""

    def _restart(self, mask: BoolArray) -> None:
        copies = np.flatnonzero(mask)
        self._elapsed[copies] = 0
        self._finished[copies] = False
        self._begin(copies)

    def _final_info(self) -> dict[str, Any]:
        """Return what SyncVectorEnv would: the last observations, and infos, which are empty."""
        last = self._observations[self._finished]
        observations = np.full(self.num_envs, None, dtype=object)
        for copy, observation in zip(
            np.flatnonzero(self._finished), last.tolist() if last.ndim == 1 else last, strict=True
        ):
            observations[copy] = observation
        return {
            "final_obs": observations,
            "_final_obs": self._finished.copy(),
            "final_info": {},
            "_final_info": self._finished.copy(),
        }

    def _check_started(self) -> None:
        if not self._started:
            raise ResetNeeded("the environments have no states: call reset() first")
