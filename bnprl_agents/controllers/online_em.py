"""Online nested EM for controllers, section 4.3: Algorithms 3 and 4."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.exploration import exploration_suffices
from bnprl_agents.controllers.nested_em import NestedEM, NestedEMConfig
from bnprl_agents.controllers.schedules import check_schedule, robbins_monro
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.policy_files import Arrays, number


@dataclass(frozen=True)
class OnlineEMConfig(NestedEMConfig):
    """Settings of `OnlineEM`. The source leaves the learning rates and u1 open."""

    batch_episodes: int = 100
    """Newest episodes that one update sees and then discards; 1 is Algorithm 3 as printed."""
    rate_exponent: float = 0.6
    """kappa of the learning rate alpha_n = (1 + n / rate_offset)^-kappa, in (0.5, 1]."""
    rate_offset: float = 10.0
    """Updates after which the learning rate begins to fall."""
    behaviour: Literal["exploring", "uniform"] = "exploring"
    """exploring: Algorithm 3, the controller with node-wise exploration. uniform: Algorithm 4 with
    uniformly random actions as the fixed behaviour policy."""
    tolerance: float = 0.0
    """Learning stops when exploring costs less than this in value (Theorem 12); 0 never stops."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_schedule(self.rate_exponent, self.rate_offset)
        if self.behaviour not in ("exploring", "uniform"):
            raise ValueError(f"behaviour: {self.behaviour!r}, must be 'exploring' or 'uniform'")
        if not self.tolerance >= 0.0:
            raise ValueError(f"tolerance: {self.tolerance}, must not be negative")


class OnlineEM(NestedEM):
    """Nested EM whose sufficient statistics are averaged over updates by Robbins-Monro rates.

    Only the newest small batch of episodes is kept: time O(n), memory O(1) in the number n of
    episodes.

    Paper: dissertation, section 4.3.
    """

    Config = OnlineEMConfig
    config: OnlineEMConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: OnlineEMConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.largest_reward, self.stopped = 0.0, False

    def learning_rate(self, episodes: EpisodeBatch) -> float:
        """alpha_n of the update under way; a batch of fewer episodes gets its share of it."""
        return self.batch_share(episodes) * robbins_monro(
            self.updates, self.config.rate_exponent, self.config.rate_offset
        )

    def evidence_episodes(self, episodes: EpisodeBatch) -> int:
        """All episodes so far."""
        return self.episodes

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Blend the batch into the statistics and improve the controllers; Algorithm 3."""
        if self.stopped:
            return {"stopped": 1.0}
        metrics = super().learn(episodes)
        self.largest_reward = max(
            self.largest_reward, float(episodes.rewards.max()) + self.config.reward_shift
        )
        if self.config.behaviour == "exploring":
            self.stopped = self.updates > 1 and exploration_suffices(
                metrics["exploring"], self.discount, self.config.tolerance, self.largest_reward
            )
        return metrics

    def set_exploration(self, occupancies: Sequence[FloatArray]) -> None:
        """Draw the exploration anew, unless the behaviour is fixed."""
        if self.config.behaviour == "exploring":
            super().set_exploration(occupancies)

    def counters(self) -> dict[str, Any]:
        """Everything else that resuming needs."""
        return super().counters() | {
            "largest_reward": self.largest_reward,
            "stopped": self.stopped,
        }

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.largest_reward = number("largest_reward", counters["largest_reward"])
        self.stopped = bool(counters["stopped"])
