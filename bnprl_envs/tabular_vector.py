"""A native batch of environments of one model, stepped by one compiled loop."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numba import njit

from bnprl_envs.model import TabularModel
from bnprl_envs.sampling import draw
from bnprl_envs.tables import BoolArray, FloatArray
from bnprl_envs.tabular import single_agent_model, single_agent_spaces
from bnprl_envs.vector_env import IntArray, NativeVectorEnv


class TabularVectorEnv(NativeVectorEnv):
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
        self.model = single_agent_model(model, arguments)
        action_space, observation_space = single_agent_spaces(self.model)
        super().__init__(
            num_envs,
            observation_space,
            action_space,
            discount=self.model.discount,
            max_episode_steps=max_episode_steps,
            autoreset_mode=autoreset_mode,
            render_mode=render_mode,
        )
        self._sampler = self.model.sampler
        self._states = np.zeros(num_envs, dtype=np.int64)
        self._uniforms = np.empty((2, num_envs))

    @property
    def states(self) -> IntArray:
        """The true states (num_envs,), a copy.

        Raises:
            ResetNeeded: before the first reset.
        """
        self._check_started()
        return self._states.copy()

    def _begin(self, copies: IntArray) -> None:
        uniforms = self.np_random.random(copies.size)
        _begin(self._sampler, copies, uniforms, self._states, self._observations)

    def _advance(
        self, actions: IntArray, rewards: FloatArray, terminated: BoolArray, truncated: BoolArray
    ) -> None:
        _advance(
            self._sampler,
            actions,
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


@njit(cache=True)
def _start(sampler, i, uniform, states, observations):  # type: ignore[no-untyped-def]
    state = sampler.start.outcome[draw(sampler.start, 0, uniform)]
    states[i] = state
    observations[i] = state if sampler.informative_start else sampler.n_observations


@njit(cache=True)
def _begin(sampler, copies, uniforms, states, observations):  # type: ignore[no-untyped-def]
    for j in range(copies.size):
        _start(sampler, copies[j], uniforms[j], states, observations)


@njit(cache=True)
def _advance(  # type: ignore[no-untyped-def]
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
            _start(sampler, i, uniforms[0, i], states, observations)
            elapsed[i] = 0
            finished[i] = False
            continue
        row = actions[i] * sampler.n_states
        k = draw(sampler.transition, row + states[i], uniforms[0, i])
        state = sampler.transition.outcome[k]
        seen = sampler.observation.outcome[draw(sampler.observation, row + state, uniforms[1, i])]
        states[i] = state
        observations[i] = seen
        rewards[i] = sampler.reward[k, seen if width > 1 else 0]
        terminated[i] = sampler.terminal[state]
        elapsed[i] += 1
        truncated[i] = not terminated[i] and elapsed[i] >= limit
        finished[i] = terminated[i] or truncated[i]
