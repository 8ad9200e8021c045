"""Any environment as a simulator: its own `reset` and `step`, one seed after the other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from bnprl_agents.discrete import DiscreteSpaces
from bnprl_agents.episodes import BoolArray, FloatArray, IntArray
from bnprl_agents.search.simulator import CUT, OVER, UInt64Array, effective_horizon
from bnprl_agents.search.tables import DecisionTables


class Copies(Protocol):
    """Copies of an environment in arrays: observations and actions (copies, N)."""

    action_sizes: tuple[int, ...]
    observation_sizes: tuple[int, ...]

    def reset(self, seed: int) -> IntArray:
        """Begin an episode in every copy; return the first observations."""

    def step(self, actions: IntArray) -> tuple[IntArray, FloatArray, BoolArray]:
        """Act; return observations, team rewards (copies,) and which episodes are over."""


class StepwiseSimulator:
    """Steps an environment under decision tables; see `TeamSimulator`.

    A seed begins one episode in each copy; its return is their mean. Candidates meet the same
    chance as far as the environment draws the same numbers whatever the team does.

    Args:
        env: a vector environment without autoreset, or a PettingZoo parallel environment.
        discount: factor in (0, 1].
        max_episode_steps: horizon of an episode, at least 1.

    Raises:
        ValueError: the environment is neither, or its spaces are not discrete.
    """

    def __init__(self, env: Any, *, discount: float, max_episode_steps: int) -> None:
        self._copies: Copies = _Vector(env) if isinstance(env, VectorEnv) else _Parallel(env)
        self.action_sizes = self._copies.action_sizes
        self.observation_sizes = self._copies.observation_sizes
        self.discount = discount
        self.horizon = effective_horizon(discount, max_episode_steps)
        self.copies = env.num_envs if isinstance(env, VectorEnv) else 1
        self.episodes = 0
        self.steps = 0

    def returns(self, teams: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """Discounted return (B, E) of every candidate's episodes of every seed."""
        returns = np.zeros((len(teams.action), len(seeds)))
        for b in range(len(returns)):
            team = _Team(teams.roles, teams.action[b], teams.successor[b])
            for e, seed in enumerate(seeds.tolist()):
                factor = 1.0
                for step in self._episode(team, seed):
                    returns[b, e] += factor * np.where(step.alive, step.reward, 0.0).mean()
                    factor *= self.discount
        return returns

    def visits(self, team: DecisionTables, seeds: UInt64Array) -> FloatArray:
        """Mean discounted number of times (M, Z + 1, O) that a node's successor was looked up."""
        counts = np.zeros(team.successor.shape[1:])
        only = _Team(team.roles, team.action[0], team.successor[0])
        for seed in seeds.tolist():
            factor = 1.0
            for step in self._episode(only, seed):
                role = np.broadcast_to(team.roles, step.node.shape)
                where = (role[step.alive], step.before[step.alive], step.seen[step.alive])
                np.add.at(counts, where, factor / len(step.alive))
                factor *= self.discount
        return counts / len(seeds)

    def experience(
        self, team: DecisionTables, agent: int, exploration: float, seeds: UInt64Array
    ) -> tuple[IntArray, FloatArray]:
        """Explore as one agent; see `TeamSimulator.experience`."""
        shape = (team.start, self.action_sizes[agent], team.successor.shape[3] + 2)
        followed, earned = np.zeros(shape, dtype=np.int64), np.zeros(shape[:2])
        only = _Team(team.roles, team.action[0], team.successor[0])
        for seed in seeds.tolist():
            for t, step in enumerate(self._episode(only, seed, agent, exploration)):
                what = np.where(step.over, OVER, step.after[:, agent])
                if t == self.horizon - 1:
                    what[:] = CUT
                where = (step.node[step.alive, agent], step.action[step.alive, agent])
                np.add.at(followed, (*where, what[step.alive]), 1)
                np.add.at(earned, where, step.reward[step.alive])
        return followed, earned

    def _episode(
        self, team: _Team, seed: int, explorer: int = -1, exploration: float = 0.0
    ) -> Iterator[_Step]:
        """Run the seed's episode in every copy, until all are over."""
        rng = np.random.default_rng(seed)
        seen = self._copies.reset(seed % 2**32)
        node = np.full(seen.shape, team.action.shape[1])
        alive = np.ones(len(seen), dtype=np.bool_)
        self.episodes += len(seen)
        for _ in range(self.horizon):
            before, node = node, team.successor[team.roles, node, seen]
            action = team.action[team.roles, node]
            if explorer >= 0:
                random = rng.integers(self.action_sizes[explorer], size=len(seen))
                exploring = rng.random(len(seen)) < exploration
                action[:, explorer] = np.where(exploring, random, action[:, explorer])
            after, reward, ended = self._copies.step(action)
            self.steps += int(alive.sum())
            yield _Step(alive, before, seen, node, action, reward, after, ended)
            seen, alive = after, alive & ~ended
            if not alive.any():
                return


class _Step(NamedTuple):
    """One step of all copies: (copies,) alive, reward and over, (copies, N) the others.

    Attributes:
        alive: whose episode was running.
        before: nodes before the observation.
        seen: observations.
        node: nodes after them.
        action: what was done.
        reward: what it earned the team.
        after: observations after it.
        over: whose episode ended with it.
    """

    alive: BoolArray
    before: IntArray
    seen: IntArray
    node: IntArray
    action: IntArray
    reward: FloatArray
    after: IntArray
    over: BoolArray


class _Team(NamedTuple):
    """One candidate: roles (N,), action (M, Z), successor (M, Z + 1, O)."""

    roles: IntArray
    action: Any
    successor: Any


class _Vector:
    """A vector environment; a copy that is over begins anew and is ignored by the caller."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if env.metadata.get("autoreset_mode") is not AutoresetMode.DISABLED:
            raise ValueError("autoreset_mode: must be AutoresetMode.DISABLED")
        self._env = env
        self._single = isinstance(env.single_action_space, gym.spaces.Discrete)
        self.action_sizes = _sizes("action space", env.single_action_space)
        self.observation_sizes = _sizes("observation space", env.single_observation_space)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(self, seed: int) -> IntArray:
        self._over[:] = False
        return self._columns(self._env.reset(seed=seed)[0])

    def step(self, actions: IntArray) -> tuple[IntArray, FloatArray, BoolArray]:
        if self._over.any():
            self._env.reset(options={"reset_mask": self._over})
        sent = actions[:, 0] if self._single else actions
        seen, reward, terminated, truncated, _ = self._env.step(sent)
        self._over = terminated | truncated
        return self._columns(seen), reward, self._over.copy()

    def _columns(self, seen: Any) -> IntArray:
        return np.asarray(seen, dtype=np.int64).reshape(self._env.num_envs, -1)


def _sizes(name: str, space: gym.Space[Any]) -> tuple[int, ...]:
    if isinstance(space, gym.spaces.Discrete) and space.start == 0:
        return (int(space.n),)
    if isinstance(space, gym.spaces.MultiDiscrete) and not space.start.any():
        return tuple(space.nvec.tolist())
    raise ValueError(f"{name}: {space}, must be Discrete or MultiDiscrete from 0")


class _Parallel:
    """A PettingZoo parallel environment, a single copy."""

    def __init__(self, env: Any) -> None:
        self._env = env
        self._names = list(env.possible_agents)
        self._spaces = DiscreteSpaces(
            {name: env.observation_space(name) for name in self._names},
            {name: env.action_space(name) for name in self._names},
        )
        self.action_sizes = self._spaces.action_sizes
        self.observation_sizes = self._spaces.observation_sizes

    def reset(self, seed: int) -> IntArray:
        self._seen = self._env.reset(seed=seed)[0]
        self._check_present(self._seen)
        return self._spaces.observations(self._seen)

    def step(self, actions: IntArray) -> tuple[IntArray, FloatArray, BoolArray]:
        sent = self._spaces.external_actions(actions, self._seen)
        self._seen, reward, terminated, truncated, _ = self._env.step(sent)
        self._check_present(self._seen)
        over = self._spaces.flag("terminated", terminated) | self._spaces.flag(
            "truncated", truncated
        )
        return self._spaces.observations(self._seen), self._spaces.reward(reward), over

    def _check_present(self, seen: Any) -> None:
        if set(seen) != set(self._names):
            missing = sorted(set(self._names) ^ set(seen))
            raise ValueError(f"agents: {missing} come and go, but a team must stay together")
