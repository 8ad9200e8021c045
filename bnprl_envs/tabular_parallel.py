"""Environments with several agents, simulated from the tables of their model.

A team is stepped as one agent that chooses the joint action and sees the joint observation: the
same scalar and the same compiled code as for one agent, with indices split and joined around it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from operator import mul
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from gymnasium.spaces import MultiDiscrete
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from bnprl_envs.arguments import checked_count
from bnprl_envs.model import Names, TabularModel
from bnprl_envs.rendering.scene import Moment, Scene
from bnprl_envs.tabular import TabularEnv, model_scene, resolved_model, tabular_moment
from bnprl_envs.team import (
    BatchStep,
    IntArray,
    TeamEnv,
    agent_names,
    checked_team_actions,
    cycle_limit,
)


class TabularParallelEnv(TeamEnv):
    """A PettingZoo view of a model: a Dec-POMDP, seen by all its agents at once.

    Agents are named `agent_0`, `agent_1`, ...; observations are np.int64. A partially observed
    model says nothing before the first action, so `reset` gives each agent the null observation,
    the last index of its space, which never comes again. Every agent earns the team's reward.
    Reaching a terminal state terminates; using up `max_episode_steps` truncates, unless the last
    step terminates. Every dict is new, and each agent's spaces are the same objects at every call.

    Args:
        model: the model, or the id of one.
        max_episode_steps: steps before truncation; None: no limit.
        max_cycles: the same by PettingZoo's name; `max_episode_steps` wins.
        render_mode: None, "ansi", "rgb_array" or "human".
        **arguments: with an id, what the benchmark takes (`size=2`).

    Attributes:
        model: the model.
        discount: the model's, in (0, 1].
        max_episode_steps: the limit.
        belief: (S,) of a policy that holds one, to be shown by `render`; None after a reset.

    Raises:
        ValueError: the model may start in a terminal state, or an argument is out of range.
    """

    def __init__(
        self,
        model: TabularModel | str,
        *,
        max_episode_steps: int | None = None,
        max_cycles: int | None = None,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self.model = resolved_model(model, arguments)
        super().__init__(
            self.model.action_sizes,
            space_sizes(self.model),
            discount=self.model.discount,
            render_mode=render_mode,
            name=model if isinstance(model, str) else None,
        )
        self.max_episode_steps = cycle_limit(max_episode_steps, max_cycles)
        self._joint = TabularEnv(team_as_one(self.model), max_episode_steps=self.max_episode_steps)
        self._look = (model, arguments) if isinstance(model, str) else None
        self._strides = strides(self.model.action_sizes).tolist()
        self._parts = [tuple(row) for row in observation_parts(self.model)]

    def state(self) -> np.int64:
        """Return the true state, which the agents do not see.

        Raises:
            ResetNeeded: before the first reset.
        """
        return np.int64(self._joint.state)

    def _begin(self, seed: int | None) -> Sequence[np.int64]:
        return self._parts[self._joint.reset(seed=seed)[0]]

    def _advance(
        self, actions: list[int]
    ) -> tuple[Sequence[np.int64], float, bool, bool, dict[str, Any]]:
        joint = sum(map(mul, actions, self._strides))
        seen, reward, terminated, truncated, info = self._joint.step(joint)
        return self._parts[seen], reward, terminated, truncated, info

    def _make_scene(self) -> Scene:
        return model_scene(self.model, self._look)

    def _moment(self) -> Moment:
        joint = self._joint
        return tabular_moment(self.model, joint.state, joint.elapsed, joint.last, self.belief)


class TabularParallelBatch(VectorEnv[IntArray, IntArray, Any]):
    """Independent copies of a Dec-POMDP as arrays (copies, agents), stepped by one compiled loop.

    The interface is that of a Gymnasium vector environment without autoreset, whose single
    observation and action are one integer an agent: copies that are over wait for
    `reset(options={"reset_mask": mask})`. All copies share one random stream, so a seed fixes the
    whole batch; they agree with `TabularParallelEnv` in law, not draw by draw. Arrays are new at
    each call.

    Args:
        model: the model, or the id of one.
        copies: how many.
        max_episode_steps: steps before truncation; None: no limit.
        render_mode: None.
        **arguments: with an id, what the benchmark takes (`size=2`).

    Attributes:
        model: the model.
        discount: the model's, in (0, 1].
        max_episode_steps: the limit.
        num_envs: the number of copies.
        possible_agents: the agents' names, in the order of the columns.

    Raises:
        ValueError: the model may start in a terminal state, or an argument is out of range.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.DISABLED,
    }

    def __init__(
        self,
        model: TabularModel | str,
        copies: int = 1,
        *,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        from bnprl_envs.tabular_vector import TabularVectorEnv  # numba: only for batches

        checked_count("copies", copies)
        self.model = resolved_model(model, arguments)
        self._joint = TabularVectorEnv(
            team_as_one(self.model),
            copies,
            max_episode_steps=max_episode_steps,
            autoreset_mode=AutoresetMode.DISABLED,
            render_mode=render_mode,
        )
        self.num_envs = copies
        self.possible_agents = agent_names(self.model.n_agents)
        self.discount = self.model.discount
        self.max_episode_steps = max_episode_steps
        self.single_action_space = MultiDiscrete(list(self.model.action_sizes))
        self.single_observation_space = MultiDiscrete(list(space_sizes(self.model)))
        self.action_space = batch_space(self.single_action_space, copies)
        self.observation_space = batch_space(self.single_observation_space, copies)
        self._sizes = np.array(self.model.action_sizes)
        self._strides = strides(self.model.action_sizes)
        self._parts = observation_parts(self.model)

    @property
    def states(self) -> IntArray:
        """The true states (copies,), a copy.

        Raises:
            ResetNeeded: before the first reset.
        """
        return self._joint.states

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
            TypeError: the seed is not an int or None, or the mask no array of booleans.
            ValueError: the mask has another shape or chooses no copy.
            ResetNeeded: a mask leaves out copies that never began.
        """
        seen, info = self._joint.reset(seed=seed, options=options)
        return self._parts[seen], info

    def step(self, actions: IntArray) -> BatchStep:
        """Act once in every copy.

        Args:
            actions: (copies, agents) integers.

        Returns:
            Observations (copies, agents), rewards of the team (copies,), terminated (copies,),
            truncated (copies,) and an empty dict.

        Raises:
            ResetNeeded: before the first reset, or a copy is over.
            ValueError: an action is not one; the message names the copy and the agent.
        """
        shape = (self.num_envs, self.model.n_agents)
        joint = checked_team_actions(actions, shape, self._sizes) @ self._strides
        seen, rewards, terminated, truncated, info = self._joint.step(joint)
        return self._parts[seen], rewards, terminated, truncated, info


_as_one: WeakKeyDictionary[TabularModel, TabularModel] = WeakKeyDictionary()


def team_as_one(model: TabularModel) -> TabularModel:
    """Return the model of one agent that chooses every action and sees every observation."""
    if model not in _as_one:
        names = model.names
        _as_one[model] = model.replace(
            action_sizes=(model.n_actions,),
            observation_sizes=(model.n_observations,),
            names=Names(
                states=names.states,
                actions=(tuple(map(" ".join, itertools.product(*names.actions))),),
                observations=(tuple(map(" ".join, itertools.product(*names.observations))),),
                agents=(" ".join(names.agents),),
            ),
        )
    return _as_one[model]


def space_sizes(model: TabularModel) -> tuple[int, ...]:
    """Return the size of each agent's observation space, the null observation included."""
    null = 0 if model.fully_observed else 1
    return tuple(size + null for size in model.observation_sizes)


def strides(sizes: Sequence[int]) -> IntArray:
    """Return what each agent's index counts in a joint one, the first most significant."""
    return np.array([math.prod(sizes[n + 1 :]) for n in range(len(sizes))], dtype=np.int64)


def observation_parts(model: TabularModel) -> IntArray:
    """Return each agent's part (O, N) of every joint observation, the null one last, if any."""
    parts = np.stack(
        np.unravel_index(np.arange(model.n_observations), model.observation_sizes), axis=1
    )
    if model.fully_observed:
        return parts
    return np.concatenate([parts, [model.observation_sizes]])
