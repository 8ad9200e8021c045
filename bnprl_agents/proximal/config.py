"""The settings of proximal policy optimisation, and its batches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import vectorize

from bnprl_agents.episodes import EpisodeBatch, IntArray
from bnprl_agents.settings import Settings

FIRST_LENGTH = 128.0
"""Steps that an episode is taken to have before any was seen."""


@dataclass(frozen=True)
class ProximalConfig(Settings):
    """Settings that the actor-critics share."""

    batch_steps: int = 1024
    """Environment steps of one batch, about: whole episodes are collected."""
    minibatch_steps: int = 512
    """Steps of one gradient, about: whole episodes too."""
    epochs: int = 5
    """Passes over a batch."""
    clip: float = 0.4
    """A step stops counting once its action's probability has changed by this share."""
    entropy: float = 0.02
    """First weight of the policy's entropy, in standard deviations of the advantage."""
    advantage_decay: float = 0.8
    """lambda of the advantages that the policy climbs; 1 trusts returns, 0 the critic."""
    return_decay: float = 0.95
    """lambda of the returns that the critic is fitted to."""
    critic_memory: float = 0.9
    """Share of the critic's evidence that a batch leaves."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self, "batch_steps", "minibatch_steps", "epochs")
        check_positive(self, "clip")
        check_not_negative(self, "entropy")
        check_shares(self, "advantage_decay", "return_decay", "critic_memory")

    def batch_episodes(self, mean_length: float) -> int:
        """Episodes that make up `batch_steps` steps, if they have this many steps each."""
        return max(1, round(self.batch_steps / mean_length))

    def minibatches(self, episodes: EpisodeBatch, rng: np.random.Generator) -> Iterator[IntArray]:
        """Split every pass over a batch anew into episodes of about `minibatch_steps` steps."""
        pieces = max(1, round(episodes.n_steps / self.minibatch_steps))
        order = np.arange(episodes.n_episodes)
        for _ in range(self.epochs):
            order = rng.permutation(order)
            yield from np.array_split(order, min(pieces, order.size))


@vectorize(["float64(float64, float64, float64)"], cache=True)  # type: ignore[no-untyped-call]
def clipped_pull(ratio, advantage, clip):  # type: ignore[no-untyped-def]
    """Derivative of the clipped surrogate with respect to log p: 0 once the ratio has gone far.

    Of min(r A, clip(r, 1 - clip, 1 + clip) A), Schulman et al., Proximal policy optimization
    algorithms, 2017, (7).
    """
    far = ratio > 1.0 + clip if advantage > 0.0 else ratio < 1.0 - clip
    return 0.0 if far else ratio * advantage


def check_counts(config: Any, *names: str) -> None:
    """Refuse settings below 1 (ValueError)."""
    for name in names:
        if getattr(config, name) < 1:
            raise ValueError(f"{name}: {getattr(config, name)}, must be at least 1")


def check_positive(config: Any, *names: str) -> None:
    """Refuse settings that are not positive and finite (ValueError)."""
    for name in names:
        if not 0.0 < getattr(config, name) < np.inf:
            raise ValueError(f"{name}: {getattr(config, name)}, must be positive and finite")


def check_not_negative(config: Any, *names: str) -> None:
    """Refuse settings that are negative or not finite (ValueError)."""
    for name in names:
        if not 0.0 <= getattr(config, name) < np.inf:
            raise ValueError(f"{name}: {getattr(config, name)}, must be finite, not negative")


def check_shares(config: Any, *names: str) -> None:
    """Refuse settings outside [0, 1] (ValueError)."""
    for name in names:
        if not 0.0 <= getattr(config, name) <= 1.0:
            raise ValueError(f"{name}: {getattr(config, name)}, must lie in [0, 1]")
