"""One environment with a single agent, simulated from the tables of its model."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from itertools import accumulate, pairwise
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete
from scipy.sparse import csr_array

from bnprl_envs import registry
from bnprl_envs.arguments import checked_action, checked_limit
from bnprl_envs.model import TabularModel
from bnprl_envs.rendering.rendered import Rendered
from bnprl_envs.rendering.scene import Doing, Moment, Scene
from bnprl_envs.tables import FloatArray

_BLOCK = 1024
"""Uniform numbers drawn from the generator at a time."""


class TabularEnv(Rendered, gym.Env[Any, Any]):
    """A Gymnasium view of a model: POMDP or MDP, one agent.

    The observation is an int. A partially observed model says nothing before the first action,
    so `reset` returns the null observation, index O, which never comes again; a fully observed
    one returns the state. Reaching a terminal state terminates; using up `max_episode_steps`
    truncates, unless the last step terminates. (`gymnasium.make` truncates by its TimeLimit
    instead, which sets both on such a last step.)

    Args:
        model: the model, or the id of one.
        max_episode_steps: steps before truncation; None: no limit.
        render_mode: None, "ansi", "rgb_array" or "human".
        **arguments: with an id, what the benchmark takes (`resetting=True`).

    Attributes:
        model: the model.
        discount: the model's, in (0, 1].
        elapsed: steps of the running episode.
        last: action, observation and reward of its last step; None before the first.
        belief: (S,) of a policy that holds one, to be shown by `render`; None after a reset.

    Raises:
        ValueError: the model has several agents or may start in a terminal state, or an
            argument is out of range.
    """

    def __init__(
        self,
        model: TabularModel | str,
        *,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self.model = single_agent_model(model, arguments)
        self.discount = self.model.discount
        self.action_space, self.observation_space = single_agent_spaces(self.model)
        self._set_render_mode(render_mode)
        self._look = (model, arguments) if isinstance(model, str) else None
        self.max_episode_steps = checked_limit(max_episode_steps)
        self._limit = max_episode_steps or math.inf
        self._tables = step_tables(self.model)
        self._uniforms: list[float] = []
        self._state = -1
        self.last: tuple[int, int, float] | None = None
        self.elapsed = 0
        self._running = False

    @property
    def state(self) -> int:
        """The true state, which the agent does not see.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._state < 0:
            raise ResetNeeded("the environment has no state before reset()")
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: begins the random stream anew.
            options: none are known.

        Returns:
            The null observation O (the state, of a fully observed model) and an empty dict.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._uniforms.clear()
        if not self._uniforms:
            self._draw_uniforms()
        start = self._tables.start
        self._state = bisect_right(start, self._uniforms.pop(), 0, len(start) - 1)
        self.last = self.belief = None
        self.elapsed = 0
        self._running = True
        self._show()
        return self._state if self.model.fully_observed else self._tables.n_observations, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """Act once.

        Args:
            action: in {0, ..., A - 1}.

        Returns:
            Observation, reward, terminated, truncated and an empty dict.

        Raises:
            ResetNeeded: no episode is running.
            ValueError: there is no such action.
        """
        if not self._running:
            raise ResetNeeded("step() needs a running episode: call reset() first")
        tables = self._tables
        joint = checked_action(action, tables.n_actions)
        uniforms = self._uniforms
        if len(uniforms) < 2:
            self._draw_uniforms()

        move, see = tables.transition, tables.observation
        row = joint * tables.n_states + self._state
        k = bisect_right(move.cumulative, uniforms.pop(), move.first[row], move.last[row])
        self._state = state = move.outcome[k]
        row = joint * tables.n_states + state
        j = bisect_right(see.cumulative, uniforms.pop(), see.first[row], see.last[row])
        observation = see.outcome[j]
        reward = tables.reward[k * tables.reward_width + observation % tables.reward_width]

        self.elapsed += 1
        terminated = tables.terminal[state]
        truncated = not terminated and self.elapsed >= self._limit
        self._running = not (terminated or truncated)
        self.last = joint, observation, reward
        self._show()
        return observation, reward, terminated, truncated, {}

    def _draw_uniforms(self) -> None:
        self._uniforms[:] = self.np_random.random(_BLOCK).tolist()

    def _make_scene(self) -> Scene:
        return model_scene(self.model, self._look)

    def _moment(self) -> Moment:
        return tabular_moment(self.model, self.state, self.elapsed, self.last, self.belief)


def resolved_model(model: TabularModel | str, arguments: dict[str, Any]) -> TabularModel:
    """Return the model that a view was given, by itself or by id.

    Raises:
        ValueError: the id is unknown, or an argument is out of range.
        TypeError: arguments come with a finished model.
    """
    if isinstance(model, str):
        return registry.model(model, **arguments)
    if arguments:
        raise TypeError(f"unexpected arguments {sorted(arguments)}: they need the id of a model")
    return model


def single_agent_model(model: TabularModel | str, arguments: dict[str, Any]) -> TabularModel:
    """Return the model that a view of one agent was given, by itself or by id.

    Raises:
        ValueError: the model cannot be simulated as one agent's episodes.
        TypeError: arguments come with a finished model.
    """
    model = resolved_model(model, arguments)
    if model.n_agents != 1:
        raise ValueError(f"the model has {model.n_agents} agents: use the parallel view")
    if (model.start[model.terminal] > 0).any():
        state = int(np.argmax(model.terminal & (model.start > 0)))
        raise ValueError(
            f"start: terminal state {model.names.states[state]!r} has probability "
            f"{model.start[state]:g}; an episode cannot begin finished"
        )
    return model


def single_agent_spaces(model: TabularModel) -> tuple[Discrete, Discrete]:
    """Return the action space and the observation space (with the null observation, if any)."""
    null = 0 if model.fully_observed else 1
    return Discrete(model.n_actions), Discrete(model.n_observations + null)


def model_scene(model: TabularModel, look: tuple[str, dict[str, Any]] | None) -> Scene:
    """Return how the states of a model look.

    Args:
        model: the model.
        look: the id and the arguments that it was built from; None where it came without.
    """
    scene = None if look is None else registry.scene(look[0], **look[1])
    if scene is None:
        from bnprl_envs.rendering.card import Card

        return Card(model.names.states)
    return scene


def tabular_moment(
    model: TabularModel,
    state: int,
    step: int,
    last: tuple[int, int, float] | None,
    belief: FloatArray | None,
) -> Moment:
    """Return what there is to show of a model, in its words.

    Args:
        model: of one agent or many.
        state: the true one.
        step: steps since the reset.
        last: joint action, joint observation and reward of the last step; None before it.
        belief: (S,) distribution of the state, or None.

    Raises:
        ValueError: the belief has another shape.
    """
    if belief is not None and np.shape(belief) != (model.n_states,):
        raise ValueError(f"belief: shape {np.shape(belief)}, must be ({model.n_states},)")
    names = model.names
    if last is None:
        first = names.states[state] if model.fully_observed else "nothing yet"
        doings = tuple(Doing(agent, "-", first) for agent in names.agents)
        return Moment(state, step, (), None, doings, belief)
    actions = np.unravel_index(last[0], model.action_sizes)
    seen = np.unravel_index(last[1], model.observation_sizes)
    doings = tuple(
        Doing(names.agents[n], names.actions[n][int(a)], names.observations[n][int(o)])
        for n, (a, o) in enumerate(zip(actions, seen, strict=True))
    )
    return Moment(state, step, tuple(map(int, actions)), last[2], doings, belief)


class Rows(NamedTuple):
    """Sparse rows as Python lists, for `bisect`: entries first[r] to last[r] belong to row r."""

    first: list[int]
    last: list[int]
    cumulative: list[float]
    outcome: list[int]


class StepTables(NamedTuple):
    """What a scalar step reads, as Python objects.

    Attributes:
        n_states: S.
        n_actions: A.
        n_observations: O.
        start: (S,) cumulative.
        transition: rows a * S + s.
        observation: rows a * S + s'.
        reward: of transition entry k and observation o, at k * reward_width + o % reward_width.
        reward_width: O if the observation matters, else 1.
        terminal: (S,).
    """

    n_states: int
    n_actions: int
    n_observations: int
    start: list[float]
    transition: Rows
    observation: Rows
    reward: array[float]
    reward_width: int
    terminal: list[bool]


_step_tables: WeakKeyDictionary[TabularModel, StepTables] = WeakKeyDictionary()


def step_tables(model: TabularModel) -> StepTables:
    """Return the lists of a model; every environment of that model shares them."""
    if model not in _step_tables:
        _step_tables[model] = StepTables(
            n_states=model.n_states,
            n_actions=model.n_actions,
            n_observations=model.n_observations,
            start=list(accumulate(model.start.tolist())),
            transition=_rows(model.transition_rows),
            observation=_rows(model.observation_rows),
            reward=array("d", model.support_reward.tobytes()),
            reward_width=model.support_reward.shape[1],
            terminal=model.terminal.tolist(),
        )
    return _step_tables[model]


def _rows(rows: csr_array) -> Rows:
    bounds, chances = rows.indptr.tolist(), rows.data.tolist()
    return Rows(
        first=bounds[:-1],
        last=[end - 1 for end in bounds[1:]],
        cumulative=[
            total for begin, end in pairwise(bounds) for total in accumulate(chances[begin:end])
        ],
        outcome=rows.indices.tolist(),
    )
