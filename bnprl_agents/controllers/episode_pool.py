"""All episodes so far, weighed against the mixture of all policies that collected them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from bnprl_agents.controllers.controller import Controller, restored_team
from bnprl_agents.controllers.filtering import filter_node
from bnprl_agents.controllers.messages import running_sum
from bnprl_agents.episodes import EpisodeBatch, FloatArray, restored_episodes
from bnprl_agents.policy_files import Arrays, taken

TOLERANCE = 1e-2
"""Of log-probabilities: rollouts filter in single precision."""


class Behaviour(NamedTuple):
    """What collected some episodes.

    Attributes:
        controllers: one for each agent.
        explore: for each agent (Z,), the probability of exploring in each node.
        episodes: how many it collected.
    """

    controllers: tuple[Controller, ...]
    explore: tuple[FloatArray, ...]
    episodes: int


class EpisodePool:
    """Episodes of many policies, as if each had been collected by their mixture.

    An importance ratio against an episode's own behaviour grows without bound as the learned policy
    moves away from it; against the mixture b_t = sum_m (K_m / K) p_m(a_{0:t} | o_{1:t}) it is at
    most K / K_m under policy m. Either is unbiased: the balance heuristic.

    Paper: Veach and Guibas, Optimally combining sampling techniques for Monte Carlo rendering,
    SIGGRAPH 1995; for policies, Peshkin and Shelton, Learning from scarce experience, ICML 2002.

    Episodes whose recorded probabilities are not those of the behaviour that is said to have
    collected them keep what was recorded: a given data set, or episodes of stepped copies that
    were under way when the policy changed.

    Attributes:
        episodes: K of them, with the mixture's conditional probabilities as their behaviour, in
            a team's first column alone; None before the first.
        behaviours: what collected them, oldest first.
    """

    def __init__(self) -> None:
        self.episodes: EpisodeBatch | None = None
        self.behaviours: list[Behaviour] = []
        self._log_mixture = np.zeros(0)  # sum over m of K_m p_m, a foreign step's b
        self._mixed = np.zeros(0, dtype=np.bool_)

    def add(self, fresh: EpisodeBatch, behaviour: Behaviour) -> EpisodeBatch:
        """Take in new episodes and what collected them; return all."""
        old = self.episodes
        joined = fresh if old is None else EpisodeBatch.concatenate([old, fresh])
        log_fresh = running_sum(fresh.offsets, np.log(fresh.behaviour).sum(axis=1))
        off = np.abs(log_fresh - log_probability(fresh, behaviour))
        own = np.maximum.reduceat(off, fresh.offsets[:-1]) < TOLERANCE
        mixed = np.repeat(own, fresh.lengths)
        if own.any():
            behaviour = behaviour._replace(episodes=int(own.sum()))
            if old is not None:
                seen = np.log(behaviour.episodes) + log_probability(old, behaviour)
                mixture = np.logaddexp(self._log_mixture, seen)
                self._log_mixture = np.where(self._mixed, mixture, self._log_mixture)
            self.behaviours.append(behaviour)
            every = [np.log(b.episodes) + log_probability(fresh, b) for b in self.behaviours]
            log_fresh = np.where(mixed, np.logaddexp.reduce(every), log_fresh)
        self._log_mixture = np.append(self._log_mixture, log_fresh)
        self._mixed = np.append(self._mixed, mixed)
        first = joined.offsets[:-1]
        log_b = np.diff(self._log_mixture, prepend=0.0)
        log_total = np.log(max(1, sum(b.episodes for b in self.behaviours)))
        log_b[first] = self._log_mixture[first] - np.where(self._mixed[first], log_total, 0.0)
        probability = np.ones_like(joined.behaviour)
        probability[:, 0] = np.exp(np.minimum(log_b, 0.0))
        self.episodes = EpisodeBatch(**(vars(joined) | {"behaviour": probability}))
        return self.episodes

    def state_arrays(self) -> Arrays:
        """Everything that a pool holds."""
        if self.episodes is None:
            return {}
        arrays = {f"pool_{name}": table for name, table in vars(self.episodes).items()}
        arrays["pool_sizes"] = np.array([b.episodes for b in self.behaviours])
        arrays |= {"pool_log_mixture": self._log_mixture, "pool_mixed": self._mixed}
        for m, b in enumerate(self.behaviours):
            for n, (controller, explore) in enumerate(zip(b.controllers, b.explore, strict=True)):
                arrays[f"pool_explore_{m}_{n}"] = explore
                arrays |= {f"pool_{k}_{m}_{n}": table for k, table in vars(controller).items()}
        return arrays

    @classmethod
    def restored(
        cls, arrays: Arrays, action_sizes: Sequence[int], observation_sizes: Sequence[int]
    ) -> EpisodePool:
        """Build a saved pool again, of agents with these numbers of values.

        Raises:
            ValueError: the arrays do not fit each other or the agents.
        """
        pool = cls()
        pool.episodes = restored_episodes(arrays, "pool_", action_sizes, observation_sizes)
        if pool.episodes is None:
            return pool
        shape = (pool.episodes.n_steps,)
        pool._log_mixture = taken(arrays, "pool_log_mixture", shape)
        pool._mixed = taken(arrays, "pool_mixed", shape).astype(np.bool_)
        for m, size in enumerate(arrays["pool_sizes"].tolist()):
            if size < 1:
                raise ValueError(f"pool_sizes: {size}, must be at least 1")
            team = restored_team(arrays, f"pool_{{}}_{m}_", action_sizes, observation_sizes)
            pool.behaviours.append(Behaviour(*team, size))
        return pool


def log_probability(episodes: EpisodeBatch, behaviour: Behaviour) -> FloatArray:
    """Log of p(a_{0:t} | o_{1:t}) (S,) of a team that explores, (2.46), summed over agents."""
    agents: Sequence[FloatArray] = [
        _log_probability(
            episodes.offsets,
            episodes.observations[:, n],
            episodes.actions[:, n],
            controller.initial,
            controller.action,
            controller.successor,
            explore,
        )
        for n, (controller, explore) in enumerate(
            zip(behaviour.controllers, behaviour.explore, strict=True)
        )
    ]
    summed: FloatArray = np.sum(agents, axis=0)
    return summed


@njit(cache=True)
def _log_probability(offsets, observations, actions, initial, action, successor, explore):  # type: ignore[no-untyped-def]
    n_nodes, n_actions = action.shape
    found = np.empty(observations.size)
    node, work = np.empty(n_nodes), np.empty(n_nodes)
    for k in range(offsets.size - 1):
        so_far = 0.0
        node[:] = initial[observations[offsets[k]]]
        for t in range(offsets[k], offsets[k + 1]):
            if t > offsets[k]:
                move = successor[actions[t - 1], observations[t]]
                filter_node(node, action[:, actions[t - 1]], move, work)
            exploring = (node * explore).sum()
            exploit = (node * action[:, actions[t]]).sum()
            so_far += np.log((1.0 - exploring) * exploit + exploring / n_actions)
            found[t] = so_far
    return found
