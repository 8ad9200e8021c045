"""Ragged episodes in flat arrays.

Glossary: K episodes, T steps of one episode, S steps of all episodes, N agents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]


def check_range(name: str, indices: IntArray, size: int) -> None:
    """Check that indices lie between 0 and a size, which they do not reach.

    Raises:
        ValueError: names the smallest and the largest, and what is allowed.
    """
    if indices.size and not 0 <= indices.min() <= indices.max() < size:
        raise ValueError(
            f"{name}: found {indices.min()} to {indices.max()}, must lie in 0 to {size - 1}"
        )


@dataclass(frozen=True, eq=False)
class EpisodeBatch:
    """K complete episodes; the steps of episode k are rows `offsets[k]:offsets[k + 1]`.

    Attributes:
        offsets: (K + 1,) row at which each episode begins; the last entry is S.
        observations: (S, N) observation of each agent before its action.
        actions: (S, N) action of each agent.
        rewards: (S,) team reward that followed.
        behaviour: (S, N) probability with which each agent chose its action, in (0, 1].
        final_observations: (K, N) observation after the last action.
        terminated: (K,) whether the episode ended in a terminal state (else it was truncated).

    Raises:
        ValueError: shapes disagree, an episode is empty, a probability lies outside (0, 1] or a
            reward is not finite.
    """

    offsets: IntArray
    observations: IntArray
    actions: IntArray
    rewards: FloatArray
    behaviour: FloatArray
    final_observations: IntArray
    terminated: BoolArray

    def __post_init__(self) -> None:
        for name, kind in (
            ("offsets", np.int64),
            ("observations", np.int64),
            ("actions", np.int64),
            ("rewards", np.float64),
            ("behaviour", np.float64),
            ("final_observations", np.int64),
            ("terminated", np.bool_),
        ):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=kind))
        if self.offsets.ndim != 1 or self.offsets.size < 1 or self.offsets[0] != 0:
            raise ValueError("offsets: must be (K + 1,) and begin with 0")
        if (np.diff(self.offsets) < 1).any():
            episode = int(np.argmax(np.diff(self.offsets) < 1))
            raise ValueError(f"offsets: episode {episode} has no step")
        if self.observations.ndim != 2:
            raise ValueError(f"observations: shape {self.observations.shape}, must be (S, N)")
        steps, agents = int(self.offsets[-1]), self.observations.shape[1]
        for name, shape in (
            ("observations", (steps, agents)),
            ("actions", (steps, agents)),
            ("rewards", (steps,)),
            ("behaviour", (steps, agents)),
            ("final_observations", (self.offsets.size - 1, agents)),
            ("terminated", (self.offsets.size - 1,)),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name}: shape {getattr(self, name).shape}, must be {shape}")
        self._check_values()

    def _check_values(self) -> None:
        allowed = (self.behaviour > 0.0) & (self.behaviour <= 1.0 + 1e-9)
        if not allowed.all():
            step, agent = np.argwhere(~allowed)[0]
            raise ValueError(
                f"behaviour: {self.behaviour[step, agent]} at step {step} of agent {agent}, "
                "must lie in (0, 1]"
            )
        if not np.isfinite(self.rewards).all():
            step = int(np.argmin(np.isfinite(self.rewards)))
            raise ValueError(f"rewards: {self.rewards[step]} at step {step}, must be finite")

    @property
    def n_episodes(self) -> int:
        """K."""
        return self.offsets.size - 1

    @property
    def n_steps(self) -> int:
        """S, the steps of all episodes."""
        return int(self.offsets[-1])

    @property
    def n_agents(self) -> int:
        """N."""
        return int(self.observations.shape[1])

    @property
    def lengths(self) -> IntArray:
        """(K,) steps of each episode."""
        return np.diff(self.offsets)

    def steps_into_episode(self) -> IntArray:
        """(S,) time t of each row within its episode."""
        return np.arange(self.n_steps) - np.repeat(self.offsets[:-1], self.lengths)

    def returns(self, discount: float) -> FloatArray:
        """(K,) discounted return of each episode, sum over t of discount**t r_t."""
        if self.n_episodes == 0:
            return np.zeros(0)
        return np.add.reduceat(
            self.rewards * discount ** self.steps_into_episode(), self.offsets[:-1]
        )

    def first(self, episodes: int) -> EpisodeBatch:
        """Return the first `episodes` episodes, at most K."""
        return self.between(0, episodes)

    def between(self, begin: int, end: int) -> EpisodeBatch:
        """Return the episodes from `begin` up to `end`, which is not one of them; at most K."""
        steps = slice(self.offsets[begin], self.offsets[end])
        return EpisodeBatch(
            offsets=self.offsets[begin : end + 1] - self.offsets[begin],
            observations=self.observations[steps],
            actions=self.actions[steps],
            rewards=self.rewards[steps],
            behaviour=self.behaviour[steps],
            final_observations=self.final_observations[begin:end],
            terminated=self.terminated[begin:end],
        )

    @staticmethod
    def concatenate(batches: Sequence[EpisodeBatch]) -> EpisodeBatch:
        """Join batches of the same number of agents, in order.

        Raises:
            ValueError: there is no batch, or their numbers of agents differ.
        """
        if not batches:
            raise ValueError("concatenate: no batch given")
        lengths = np.concatenate([batch.lengths for batch in batches])
        return EpisodeBatch(
            offsets=np.concatenate([[0], np.cumsum(lengths)]),
            observations=np.concatenate([batch.observations for batch in batches]),
            actions=np.concatenate([batch.actions for batch in batches]),
            rewards=np.concatenate([batch.rewards for batch in batches]),
            behaviour=np.concatenate([batch.behaviour for batch in batches]),
            final_observations=np.concatenate([batch.final_observations for batch in batches]),
            terminated=np.concatenate([batch.terminated for batch in batches]),
        )


def check_episodes(
    episodes: EpisodeBatch, action_sizes: Sequence[int], observation_sizes: Sequence[int]
) -> None:
    """Check that what agents did and saw is in their spaces: compiled code counts on it.

    Args:
        episodes: of N agents.
        action_sizes: (N,) actions of each.
        observation_sizes: (N,) observations of each.

    Raises:
        ValueError: it is not, or there are other agents.
    """
    if episodes.n_agents != len(action_sizes):
        raise ValueError(f"episodes: of {episodes.n_agents} agents, must be {len(action_sizes)}")
    for n, (n_actions, n_seen) in enumerate(zip(action_sizes, observation_sizes, strict=True)):
        check_range("actions", episodes.actions[:, n], n_actions)
        check_range("observations", episodes.observations[:, n], n_seen)
        check_range("final_observations", episodes.final_observations[:, n], n_seen)


def restored_episodes(
    arrays: Mapping[str, npt.NDArray[Any]],
    prefix: str,
    action_sizes: Sequence[int],
    observation_sizes: Sequence[int],
) -> EpisodeBatch | None:
    """Return the episodes of a policy file whose arrays' names begin with a prefix, None if none.

    Raises:
        ValueError: as `EpisodeBatch` and `check_episodes`.
    """
    if f"{prefix}offsets" not in arrays:
        return None
    fields = EpisodeBatch.__dataclass_fields__
    batch = EpisodeBatch(**{name: arrays[f"{prefix}{name}"] for name in fields})
    check_episodes(batch, action_sizes, observation_sizes)
    return batch
