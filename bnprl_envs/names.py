"""The words behind the indices of a model, for messages, files and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Names:
    """The words behind the indices.

    Attributes:
        states: one name a state (S).
        actions: for each agent, one name an action.
        observations: for each agent, one name an observation.
        agents: one name an agent (N).
    """

    states: tuple[str, ...]
    actions: tuple[tuple[str, ...], ...]
    observations: tuple[tuple[str, ...], ...]
    agents: tuple[str, ...]


def index_names(
    n_states: int, action_sizes: Sequence[int], observation_sizes: Sequence[int]
) -> Names:
    """Return the indices themselves as words."""

    def count(size: int) -> tuple[str, ...]:
        return tuple(map(str, range(size)))

    return Names(
        states=count(n_states),
        actions=tuple(map(count, action_sizes)),
        observations=tuple(map(count, observation_sizes)),
        agents=tuple(f"agent_{n}" for n in range(len(action_sizes))),
    )
