"""Online nested EM for controllers, section 4.3: Algorithms 3 and 4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.em import check_settings, inner_em, maximise
from bnprl_agents.controllers.exploration import exploration_suffices
from bnprl_agents.controllers.learner import ControllerAgent, shifted
from bnprl_agents.controllers.messages import Counts, forward, reward_weights
from bnprl_agents.episodes import EpisodeBatch
from bnprl_agents.policy_files import Arrays


@dataclass(frozen=True)
class OnlineEMConfig:
    """Settings of `OnlineEM`. The source leaves the learning rates and u1 open."""

    nodes: int = 20
    """Nodes of every controller."""
    successor_concentration: float = 0.5
    """Of the Dirichlet from which the first successor rows are drawn. At 1 (uniform) many nodes
    average the memory of an observation away, and EM may never leave the best memoryless policy."""
    batch_episodes: int = 100
    """Newest episodes that one update sees and then discards; 1 is Algorithm 3 as printed."""
    outer_iterations: int = 1
    """Recomputations of the rewards within an update."""
    inner_iterations: int = 1
    """EM iterations for each recomputation of the rewards."""
    rate_exponent: float = 0.6
    """kappa of the learning rate alpha_n = (1 + n / rate_offset)^-kappa, in (0.5, 1]."""
    rate_offset: float = 10.0
    """Updates after which the learning rate begins to fall."""
    behaviour: Literal["exploring", "uniform"] = "exploring"
    """exploring: Algorithm 3, the controller with node-wise exploration. uniform: Algorithm 4 with
    uniformly random actions as the fixed behaviour policy."""
    exploration_prior: float = 2.0
    """u1 of the Beta distribution from which a node's exploitation is drawn; larger explores."""
    tolerance: float = 0.0
    """Learning stops when exploring costs less than this in value (Theorem 12); 0 never stops."""
    reward_shift: float = 0.0
    """Added to every reward; the sum must not be negative. A terminal state earns it for ever."""

    def __post_init__(self) -> None:
        check_settings(self)
        if not 0.5 < self.rate_exponent <= 1.0:
            raise ValueError(f"rate_exponent: {self.rate_exponent}, must lie in (0.5, 1]")
        if not self.rate_offset > 0.0:
            raise ValueError(f"rate_offset: {self.rate_offset}, must be positive")
        if self.behaviour not in ("exploring", "uniform"):
            raise ValueError(f"behaviour: {self.behaviour!r}, must be 'exploring' or 'uniform'")
        if not self.tolerance >= 0.0:
            raise ValueError(f"tolerance: {self.tolerance}, must not be negative")


COUNTERS = {
    "value": float,
    "updates": int,
    "episodes": int,
    "largest_reward": float,
    "stopped": bool,
}
"""What a policy file holds beside the arrays."""


def blend(old: Counts, new: Counts, rate: float) -> Counts:
    """S <- (1 - alpha) s + alpha s_n; (4.15)."""
    return Counts(*((1.0 - rate) * s + rate * n for s, n in zip(old, new, strict=True)))


class OnlineEM(ControllerAgent):
    """Nested EM whose sufficient statistics are averaged over updates by Robbins-Monro rates.

    Only the newest small batch of episodes is kept: time O(n), memory O(1) in the number n of
    episodes. The statistics use the unnormalised weights gamma^t r_t ratio_t, because the value
    over all data is not at hand; (4.8) is free of scale, and the value's own running mean divides
    where a scale matters (exploration). Every inner iteration blends with the statistics SAVED
    before the batch, so that no episode counts twice.

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
        self.statistics = tuple(
            Counts(*(np.zeros_like(table) for table in vars(c).values())) for c in self.controllers
        )
        self.value = 0.0
        self.updates = 0
        self.episodes = 0
        self.largest_reward = 0.0
        self.stopped = False

    @property
    def batch_episodes(self) -> int:
        """Episodes that one update wants."""
        return self.config.batch_episodes

    def learning_rate(self) -> float:
        """alpha_n of the update under way."""
        return float((1.0 + self.updates / self.config.rate_offset) ** -self.config.rate_exponent)

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Blend the batch into the statistics and improve the controllers; Algorithm 3."""
        if self.stopped:
            return {"stopped": 1.0}
        data = shifted(episodes, self.config.reward_shift, self.discount)
        self.updates += 1
        self.episodes += data.n_episodes
        self.largest_reward = max(self.largest_reward, float(data.rewards.max()))
        value, exploring = self._improve(data)
        if self.config.behaviour == "exploring":
            self._explore()
            self.stopped = self.updates > 1 and exploration_suffices(
                exploring, self.discount, self.config.tolerance, self.largest_reward
            )
        return {
            "value": value,
            "return_mean": float(episodes.returns(self.discount).mean()),
            "exploring": exploring,
            "learning_rate": self.learning_rate(),
        }

    def _improve(self, data: EpisodeBatch) -> tuple[float, float]:
        """Blend the batch into the statistics; return its value and how much was explored.

        The rate counts a whole batch; one of fewer episodes gets its share of it.
        """
        saved, rate = self.statistics, self.learning_rate() * self.batch_share(data)

        def m_step(n: int, counts: Counts, controller: Controller) -> Controller:
            return maximise(blend(saved[n], counts, rate), controller)

        values, exploring = [], 0.0
        for outer in range(self.config.outer_iterations):
            messages = [forward(data, n, c) for n, c in enumerate(self.controllers)]
            if outer == 0:
                exploring = self.exploring_share(messages)
            weights, log_scale = reward_weights(
                data, [m.likelihood for m in messages], self.discount
            )
            weights *= np.exp(log_scale) / data.n_episodes
            if not np.isfinite(weights).all():
                raise ArithmeticError(
                    "importance ratios overflow: behaviour and learned policy are too far apart"
                )
            values.append(float(weights.sum()))
            self.controllers, counts = inner_em(
                data, self.controllers, messages, weights, self.config.inner_iterations, m_step
            )
        self.statistics = tuple(
            blend(old, new, rate) for old, new in zip(saved, counts, strict=True)
        )
        self.value = (1.0 - rate) * self.value + rate * values[-1]
        return values[0], exploring

    def _explore(self) -> None:
        scale = self.episodes / self.value if self.value > 0.0 else 0.0
        self.set_exploration([s.action.sum(axis=1) * scale for s in self.statistics])

    def state_arrays(self) -> Arrays:
        """The learner's state and its statistics."""
        arrays = super().state_arrays()
        for n, statistics in enumerate(self.statistics):
            arrays |= {f"statistics_{name}_{n}": s for name, s in statistics._asdict().items()}
        return arrays

    def counters(self) -> dict[str, Any]:
        """The running value, the numbers of updates and episodes, and whether it stopped."""
        return {name: getattr(self, name) for name in COUNTERS}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.statistics = tuple(
            Counts(*(arrays[f"statistics_{name}_{n}"] for name in Counts._fields))
            for n in range(len(self.controllers))
        )
        for name, kind in COUNTERS.items():
            setattr(self, name, kind(counters[name]))
