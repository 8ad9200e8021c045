"""Batch nested EM for controllers, chapter 4.2 and section 6.2.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Messages, forward
from bnprl_agents.controllers.nested_em import NestedEM, NestedEMConfig
from bnprl_agents.episodes import EpisodeBatch, restored_episodes
from bnprl_agents.policy_files import Arrays


@dataclass(frozen=True)
class BatchEMConfig(NestedEMConfig):
    """Settings of `BatchEM`. The source leaves K and the iteration counts open."""

    keep: bool = False
    """Learn from all episodes so far by their importance ratios, as the source does, instead of
    the newest alone: the time grows with the square of their number, and so does the ratios'
    variance with the distance to the first policies. Weights by return have no such ratios."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.keep and self.weighting != "reward":
            raise ValueError(
                f"weighting: {self.weighting!r}, must be 'reward' where keep is true: the episodes "
                "kept are of older policies"
            )


class BatchEM(NestedEM):
    """Nested EM on batches of on-policy episodes; one controller for each agent.

    Each update collects `batch_episodes` under the current policy with node-wise exploration,
    recomputes the rewards (outer loop) and improves the controllers by EM (inner loop).

    Paper: Li, Liao and Carin, Multi-task reinforcement learning in partially observable stochastic
    environments, JMLR 10, 2009; dissertation, Theorem 5 and section 6.2.1.
    """

    Config = BatchEMConfig
    config: BatchEMConfig
    kept: EpisodeBatch | None = None

    def evidence_episodes(self, episodes: EpisodeBatch) -> int:
        """The batch, or all episodes so far where they are kept."""
        return self.episodes if self.config.keep else episodes.n_episodes

    def improve(self, data: EpisodeBatch, messages: Sequence[Messages]) -> Metrics:
        """Run nested EM on the batch; see `NestedEM.improve`.

        A batch of fewer episodes than wanted moves the controllers that part of the way only.
        """
        before, share = self.controllers, self.batch_share(data)
        if self.config.keep:
            data = data if self.kept is None else EpisodeBatch.concatenate([self.kept, data])
            messages = [forward(data, n, controller) for n, controller in enumerate(before)]
            self.kept = data
        metrics = super().improve(data, messages)
        if share < 1.0 and "unchanged" not in metrics:
            moved = zip(before, self.controllers, strict=True)
            self.begin_at([part_way(old, new, share) for old, new in moved])
        return metrics

    def state_arrays(self) -> Arrays:
        """The learner's state and the episodes that it keeps."""
        kept = {} if self.kept is None else vars(self.kept)
        return super().state_arrays() | {f"kept_{name}": table for name, table in kept.items()}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        sizes = self.spaces.action_sizes, self.spaces.observation_sizes
        self.kept = restored_episodes(arrays, "kept_", *sizes)


def part_way(old: Controller, new: Controller, share: float) -> Controller:
    """(1 - share) old + share new, row by row: EM's bound, concave in the rows, still rises."""
    return Controller(
        *(
            (1.0 - share) * p + share * q
            for p, q in zip(vars(old).values(), vars(new).values(), strict=True)
        )
    )
