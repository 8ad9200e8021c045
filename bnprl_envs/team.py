"""What environments of many agents share: PettingZoo's dicts, and arrays (copies, agents)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from operator import ge, index
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Discrete, MultiDiscrete
from gymnasium.vector import VectorEnv
from pettingzoo import ParallelEnv

from bnprl_envs.arguments import checked_limit
from bnprl_envs.rendering.rendered import Rendered
from bnprl_envs.tables import BoolArray, FloatArray

IntArray = npt.NDArray[np.int64]
Observations = dict[str, np.int64]
Infos = dict[str, dict[str, Any]]
BatchStep = tuple[IntArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class TeamEnv(Rendered, ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """A team in PettingZoo's parallel interface: all act at once and earn the same reward.

    Agents are named `agent_0`, `agent_1`, ... Every dict that `reset` and `step` return is new.
    A subclass says how episodes begin (`_begin`) and go on (`_advance`), and what it looks like.

    Args:
        action_sizes: actions of each agent.
        observation_sizes: observations of each agent.
        discount: factor of the values, in (0, 1].
        render_mode: None, "ansi", "rgb_array" or "human".
        name: shown by `str(env)`; None: the class's name.

    Attributes:
        discount: in (0, 1].

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        action_sizes: Sequence[int],
        observation_sizes: Sequence[int],
        *,
        discount: float,
        render_mode: str | None,
        name: str | None = None,
    ) -> None:
        self._set_render_mode(render_mode)
        self.metadata = type(self).metadata | {"name": name or type(self).__name__}
        self.discount = discount
        self.possible_agents = agent_names(len(action_sizes))
        self.agents: list[str] = []
        self.action_spaces = {
            agent: Discrete(size)
            for agent, size in zip(self.possible_agents, action_sizes, strict=True)
        }
        self.observation_spaces = {
            agent: Discrete(size)
            for agent, size in zip(self.possible_agents, observation_sizes, strict=True)
        }
        self._action_sizes = tuple(action_sizes)

    def action_space(self, agent: str) -> Discrete:
        """Return the agent's action space, the same object at every call."""
        return self.action_spaces[agent]

    def observation_space(self, agent: str) -> Discrete:
        """Return the agent's observation space, the same object at every call."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin an episode.

        Args:
            seed: begins the random stream anew.
            options: none are known.

        Returns:
            Observations and empty infos of all agents.
        """
        observations = self._begin(seed)
        self.agents = self.possible_agents.copy()
        self.belief = None
        self._show()
        return (
            dict(zip(self.agents, observations, strict=True)),
            {agent: {} for agent in self.agents},
        )

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Act once, all agents together.

        Args:
            actions: one of each agent.

        Returns:
            Observations, rewards (the team's, for each agent), terminations, truncations, infos.

        Raises:
            ResetNeeded: no episode is running.
            ValueError: an agent is missing or unknown, or has no such action.
        """
        agents = self.agents
        if not agents:
            raise ResetNeeded("step() needs a running episode: call reset() first")
        seen, reward, terminated, truncated, info = self._advance(self._chosen(actions))
        if terminated or truncated:
            self.agents = []
        self._show()
        return (
            dict(zip(agents, seen, strict=True)),
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            {agent: info.copy() for agent in agents},
        )

    @abstractmethod
    def _begin(self, seed: int | None) -> Sequence[np.int64]:
        """Begin an episode; return one observation an agent."""

    @abstractmethod
    def _advance(
        self, actions: list[int]
    ) -> tuple[Sequence[np.int64], float, bool, bool, dict[str, Any]]:
        """Step; return one observation an agent, reward, terminated, truncated and info."""

    def _chosen(self, actions: Mapping[str, int]) -> list[int]:
        """Return the actions in the order of the agents."""
        try:
            chosen = list(map(index, map(actions.__getitem__, self.agents)))
            fits = len(actions) == len(chosen)
        except (AttributeError, KeyError, TypeError):
            fits = False
        if not fits or min(chosen) < 0 or any(map(ge, chosen, self._action_sizes)):
            raise ValueError(self._fault(actions))
        return chosen

    def _fault(self, actions: Any) -> str:
        """Say what is wrong with some actions."""
        if not isinstance(actions, Mapping):
            return f"actions: {type(actions).__name__}, must be a dict from agent to action"
        for agent in self.agents:
            if agent not in actions:
                return f"actions: {agent} is missing, every agent must act"
        for agent in actions:
            if agent not in self.action_spaces:
                return f"actions: there is no agent {agent!r}, only agent_0 to {self.agents[-1]}"
        agent, size = next(
            (agent, size)
            for agent, size in zip(self.agents, self._action_sizes, strict=True)
            if not _is_action(actions[agent], size)
        )
        return f"action {actions[agent]!r} of {agent} is not an integer in [0, {size - 1}]"


def cycle_limit(max_episode_steps: int | None, max_cycles: int | None) -> int | None:
    """Return the limit given by two names, of which the first wins.

    Raises:
        ValueError: one of them is below 1.
    """
    cycles, steps = checked_limit(max_cycles, "max_cycles"), checked_limit(max_episode_steps)
    return cycles if steps is None else steps


def agent_names(n_agents: int) -> list[str]:
    """Return "agent_0", "agent_1", ..."""
    return [f"agent_{n}" for n in range(n_agents)]


def agent_spaces(env: VectorEnv[Any, Any, Any]) -> tuple[Any, Any]:
    """Return the observation and action spaces that an agent is made for.

    Args:
        env: a batch of one agent, or of a team: it has `possible_agents` and exchanges arrays
            (copies, agents) of MultiDiscrete spaces.

    Returns:
        The single observation and action spaces; of a team, dicts of them by agent.
    """
    agents = getattr(env, "possible_agents", None)
    if agents is None:
        return env.single_observation_space, env.single_action_space
    spaces: list[Any] = [env.single_observation_space, env.single_action_space]
    observation, action = (
        {
            agent: Discrete(size, start=start)
            for agent, size, start in zip(
                agents, space.nvec.tolist(), space.start.tolist(), strict=True
            )
        }
        for space in spaces
    )
    return observation, action


def joint_space(spaces: Iterable[Discrete]) -> MultiDiscrete[np.int64]:
    """Return all agents' spaces as that of one array (N,)."""
    parts = list(spaces)
    return MultiDiscrete(
        [int(space.n) for space in parts], start=[int(space.start) for space in parts]
    )


def checked_team_actions(
    actions: npt.ArrayLike, shape: tuple[int, int], sizes: IntArray
) -> IntArray:
    """Return the actions of a batch of teams as an int64 array.

    Args:
        actions: (copies, agents) integers.
        shape: (copies, agents).
        sizes: (agents,) actions of each agent.

    Raises:
        ValueError: another shape or type, or an action is not one; the message names the copy and
            the agent.
    """
    array = np.asarray(actions)
    if array.shape != shape or array.dtype.kind not in "iu":
        raise ValueError(
            f"actions: shape {array.shape} of {array.dtype}, must be {shape} of integers"
        )
    array = np.ascontiguousarray(array, dtype=np.int64)
    wrong = array.view(np.uint64) >= sizes.view(np.uint64)  # negative ones are huge
    if wrong.any():
        copy, agent = np.unravel_index(int(np.argmax(wrong)), shape)
        raise ValueError(
            f"action {array[copy, agent]} of agent_{agent} in copy {copy} "
            f"is not in [0, {sizes[agent] - 1}]"
        )
    return array


def _is_action(action: Any, size: int) -> bool:
    try:
        return 0 <= index(action) < size
    except TypeError:
        return False
