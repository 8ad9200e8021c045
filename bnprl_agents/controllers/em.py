"""Batch nested EM for controllers, chapter 4.2 and section 6.2.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Messages
from bnprl_agents.controllers.nested_em import NestedEM, NestedEMConfig
from bnprl_agents.episodes import EpisodeBatch


@dataclass(frozen=True)
class BatchEMConfig(NestedEMConfig):
    """Settings of `BatchEM`. The source leaves K and the iteration counts open."""


class BatchEM(NestedEM):
    """Nested EM on batches of on-policy episodes; one controller for each agent.

    Each update collects `batch_episodes` under the current policy with node-wise exploration,
    recomputes the rewards (outer loop) and improves the controllers by EM (inner loop).

    Paper: Li, Liao and Carin, Multi-task reinforcement learning in partially observable stochastic
    environments, JMLR 10, 2009; dissertation, Theorem 5 and section 6.2.1.
    """

    Config = BatchEMConfig
    config: BatchEMConfig

    def improve(self, data: EpisodeBatch, messages: Sequence[Messages]) -> Metrics:
        """Run nested EM on the batch; see `NestedEM.improve`.

        A batch of fewer episodes than wanted moves the controllers that part of the way only.
        """
        before, share = self.controllers, self.batch_share(data)
        metrics = super().improve(data, messages)
        if share < 1.0:
            moved = zip(before, self.controllers, strict=True)
            self.begin_at([part_way(old, new, share) for old, new in moved])
        return metrics


def part_way(old: Controller, new: Controller, share: float) -> Controller:
    """(1 - share) old + share new, row by row: EM's bound, concave in the rows, still rises."""
    return Controller(
        *(
            (1.0 - share) * p + share * q
            for p, q in zip(vars(old).values(), vars(new).values(), strict=True)
        )
    )
