"""A native batch of environments of one model, stepped by one compiled loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba import njit

from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import draw
from bnprl_envs.tables import BoolArray, FloatArray
from bnprl_envs.tabular import (
    check_render_mode,
    checked_limit,
    single_agent_model,
    single_agent_spaces,
)

IntArray = npt.NDArray[np.int64]
Step = tuple[IntArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]

_NO_LIMIT = np.iinfo(np.int64).max


class TabularVectorEnv(VectorEnv[IntArray, IntArray, npt.NDArray[Any]]):
    """`num_envs` independent copies of one model, with the semantics of Gymnasium's SyncVectorEnv.

    A copy that terminates or truncates begins anew by the autoreset mode: at its next step,
    which ignores the action and earns 0 (NEXT_STEP); at once, the last observation moving to
    `info["final_obs"]` (SAME_STEP); or when `reset(options={"reset_mask": mask})` says so
    (DISABLED). A terminating copy never truncates at the same step.

    All copies share one random stream, so a seed fixes the whole batch; they agree with
    `TabularEnv` in law, not draw by draw. Arrays are new at each call: (num_envs,) int64
    observations, float64 rewards, bool flags.

    Args:
        model: the model, or the id of one.
        num_envs: number of copies.
        max_episode_steps: steps before truncation; None: no limit.
        autoreset_mode: the mode or its name ("NextStep", "SameStep", "Disabled").
        render_mode: None.
        **arguments: with an id, what the benchmark takes (`resetting=True`).

    Attributes:
        model: the model.
        discount: the model's, in (0, 1].
        autoreset_mode: also in `metadata`.

    Raises:
        ValueError: the model has several agents or may start in a terminal state, or an
            argument is out of range.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (declared so by Gymnasium)

    def __init__(
        self,
        model: TabularModel | str,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs: {num_envs}, must be at least 1")
        self.model = single_agent_model(model, arguments)
        self.discount = self.model.discount
        self.num_envs = num_envs
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = type(self).metadata | {"autoreset_mode": self.autoreset_mode}
        check_render_mode(render_mode)
        self.single_action_space, self.single_observation_space = single_agent_spaces(self.model)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.max_episode_steps = checked_limit(max_episode_steps)
        self._limit = max_episode_steps or _NO_LIMIT
        self._sampler = self.model.sampler
        self._states = np.full(num_envs, -1, dtype=np.int64)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._observations = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.zeros(num_envs, dtype=np.bool_)
        self._uniforms = np.empty((2, num_envs))

    @property
    def states(self) -> IntArray:
        """The true states (num_envs,), a copy.

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started()
        return self._states.copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[IntArray, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: begins the one random stream anew.
            options: `{"reset_mask": mask}`, (num_envs,) booleans, begins anew only those copies.

        Returns:
            The observations (num_envs,), of untouched copies their last ones, and an empty dict.

        Raises:
            TypeError: the seed is not an int or None, or the mask no array of booleans.
            ValueError: the mask has another shape or chooses no copy.
            ResetNeeded: a mask leaves out copies that never began.
        """
        if not isinstance(seed, int | np.integer | None):
            raise TypeError(f"seed: {seed!r}, must be an int or None; all copies share one stream")
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and "reset_mask" in options:
            mask = self._checked_mask(options["reset_mask"])
        if not mask.all():
            self._check_started()
        super().reset(seed=None if seed is None else int(seed))
        self._begin(mask)
        return self._observations.copy(), {}

    def step(self, actions: IntArray) -> Step:
        """Act once in every copy.

        Args:
            actions: (num_envs,) integers in {0, ..., A - 1}; those of copies that this step
                resets are ignored.

        Returns:
            Observations, rewards, terminated, truncated, each (num_envs,), and the info dict.

        Raises:
            ResetNeeded: before the first reset; in mode DISABLED, a copy is finished.
            ValueError: an action is not one; the message names the copy.
        """
        self._check_started()
        if self.autoreset_mode is AutoresetMode.DISABLED and self._finished.any():
            copy = int(np.argmax(self._finished))
            raise ResetNeeded(f"copy {copy} has finished: reset it with options['reset_mask']")
        joint = self._checked_actions(actions)
        rewards = np.empty(self.num_envs)
        terminated = np.empty(self.num_envs, dtype=np.bool_)
        truncated = np.empty(self.num_envs, dtype=np.bool_)
        _step(
            self._sampler,
            joint,
            self.np_random.random(out=self._uniforms),
            self._limit,
            self._states,
            self._elapsed,
            self._finished,
            self._observations,
            rewards,
            terminated,
            truncated,
        )
        info: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._finished.any():
            info = self._final_info()
            self._begin(self._finished.copy())
        return self._observations.copy(), rewards, terminated, truncated, info

    def _begin(self, mask: BoolArray) -> None:
        chosen = np.flatnonzero(mask)
        _reset(
            self._sampler,
            chosen,
            self.np_random.random(chosen.size),
            self._states,
            self._elapsed,
            self._finished,
            self._observations,
        )

    def _final_info(self) -> dict[str, Any]:
        """Return what SyncVectorEnv would: the last observations, and infos, which are empty."""
        observations = np.full(self.num_envs, None, dtype=object)
        observations[self._finished] = self._observations[self._finished]
        return {
            "final_obs": observations,
            "_final_obs": self._finished.copy(),
            "final_info": {},
            "_final_info": self._finished.copy(),
        }

    def _check_started(self) -> None:
        if self._states[0] < 0:
            raise ResetNeeded("the environments have no states: call reset() first")

    def _checked_actions(self, actions: npt.ArrayLike) -> IntArray:
        joint = np.asarray(actions)
        if joint.shape != (self.num_envs,) or joint.dtype.kind not in "iu":
            raise ValueError(
                f"actions: shape {joint.shape} of {joint.dtype}, "
                f"must be ({self.num_envs},) of integers"
            )
        joint = np.ascontiguousarray(joint, dtype=np.int64)
        wrong = joint.view(np.uint64) >= self.model.n_actions  # negative ones are huge
        if wrong.any():
            wrong &= ~self._finished  # those are about to be reset
            if wrong.any():
                copy = int(np.argmax(wrong))
                raise ValueError(
                    f"action {joint[copy]} of copy {copy} is not in [0, {self.model.n_actions - 1}]"
                )
        return joint

    def _checked_mask(self, mask: Any) -> BoolArray:
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            kind = mask.dtype if isinstance(mask, np.ndarray) else type(mask).__name__
            raise TypeError(f"options['reset_mask'] must be an array of bool, got {kind}")
        if mask.shape != (self.num_envs,):
            raise ValueError(
                f"options['reset_mask']: shape {mask.shape}, must be ({self.num_envs},)"
            )
        if not mask.any():
            raise ValueError("options['reset_mask'] chooses no copy; at least one must be True")
        return mask


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        allowed = ", ".join(repr(known.value) for known in AutoresetMode)
        raise ValueError(f"autoreset_mode: {mode!r}, must be one of {allowed}") from None


@njit(cache=True)
def _start(sampler, i, uniform, states, elapsed, finished, observations):  # type: ignore[no-untyped-def]
    state = sampler.start.outcome[draw(sampler.start, 0, uniform)]
    states[i] = state
    elapsed[i] = 0
    finished[i] = False
    observations[i] = state if sampler.informative_start else sampler.n_observations


@njit(cache=True)
def _reset(sampler, chosen, uniforms, states, elapsed, finished, observations):  # type: ignore[no-untyped-def]
    for j in range(chosen.size):
        _start(sampler, chosen[j], uniforms[j], states, elapsed, finished, observations)


@njit(cache=True)
def _step(  # type: ignore[no-untyped-def]
    sampler,
    actions,
    uniforms,
    limit,
    states,
    elapsed,
    finished,
    observations,
    rewards,
    terminated,
    truncated,
):
    width = sampler.reward.shape[1]
    for i in range(states.size):
        if finished[i]:
            _start(sampler, i, uniforms[0, i], states, elapsed, finished, observations)
            rewards[i] = 0.0
            terminated[i] = truncated[i] = False
            continue
        row = actions[i] * sampler.n_states
        k = draw(sampler.transition, row + states[i], uniforms[0, i])
        state = sampler.transition.outcome[k]
        seen = sampler.observation.outcome[draw(sampler.observation, row + state, uniforms[1, i])]
        states[i] = state
        elapsed[i] += 1
        observations[i] = seen
        rewards[i] = sampler.reward[k, seen if width > 1 else 0]
        terminated[i] = sampler.terminal[state]
        truncated[i] = not terminated[i] and elapsed[i] >= limit
        finished[i] = terminated[i] or truncated[i]
