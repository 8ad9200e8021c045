"""Monte-Carlo EM for decentralised controllers: the literature's model-free comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.learner import ControllerAgent, check_shift, shifted
from bnprl_agents.controllers.messages import forward
from bnprl_agents.controllers.paths import path_counts, sample_paths
from bnprl_agents.controllers.priors import maximise
from bnprl_agents.episodes import EpisodeBatch, FloatArray, IntArray
from bnprl_agents.policy_files import Arrays, taken
from bnprl_agents.settings import Settings


@dataclass(frozen=True)
class MonteCarloEMConfig(Settings):
    """Settings of `MonteCarloEM`.

    The original explores by an upper confidence bound whose constant is not published; here a node
    explores with the width of that bound, min(1, c sqrt(ln n / n_z)), n visits in all and n_z of
    the node.
    """

    nodes: int = 5
    """Nodes of every controller."""
    successor_concentration: float = 0.5
    """Of the Dirichlet from which the first successor rows are drawn; 1 is uniform."""
    batch_episodes: int = 300
    """Episodes sampled for one EM iteration, then discarded."""
    confidence: float = 1.0
    """c of the upper confidence bound; larger explores longer."""
    reward_shift: float = 0.0
    """Added to every reward; the sum must not be negative. A terminal state earns it for ever."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("nodes", "batch_episodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: {getattr(self, name)}, must be at least 1")
        if not 0.0 < self.successor_concentration < np.inf:
            raise ValueError(
                f"successor_concentration: {self.successor_concentration}, must be positive"
            )
        if not 0.0 <= self.confidence < np.inf:
            raise ValueError(f"confidence: {self.confidence}, must not be negative")
        check_shift(self.reward_shift)


class MonteCarloEM(ControllerAgent):
    """EM whose E-step counts sampled nodes, each visit weighted by the reward that followed it.

    One iteration samples episodes from the simulator, draws each agent's nodes along them, and
    normalises the counts of initial nodes, actions and moves, weighted by the discounted rewards
    from that step on. There are no messages and no importance ratios.

    Paper: Wu, Zilberstein and Jennings, Monte-Carlo expectation maximization for decentralized
    POMDPs, IJCAI 2013.

    Attributes:
        visits: for each agent (Z,) how often its nodes were drawn.
    """

    Config = MonteCarloEMConfig
    config: MonteCarloEMConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: MonteCarloEMConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.visits = tuple(np.zeros(c.n_nodes) for c in self.controllers)

    @property
    def batch_episodes(self) -> int:
        """Episodes that one iteration wants."""
        return self.config.batch_episodes

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Run one iteration of Monte-Carlo EM.

        Raises:
            NegativeRewardError: a shifted reward is negative.
        """
        self.check_reward(float(episodes.rewards.min()))
        data = shifted(episodes, self.config.reward_shift, self.discount)
        weights = rewards_from(data, self.discount)
        messages = [forward(data, n, controller) for n, controller in enumerate(self.controllers)]
        exploring = self.exploring_share(data, messages)
        improved, visits = [], []
        for n, (controller, message) in enumerate(zip(self.controllers, messages, strict=True)):
            last = last_possible(data, message.likelihood)
            nodes = sample_paths(data, n, controller, message, last, self.rng)
            counts = path_counts(data, n, controller, nodes, weights)
            improved.append(maximise(counts, controller))
            drawn = np.bincount(nodes[nodes >= 0], minlength=controller.n_nodes)
            visits.append(self.visits[n] + drawn)
        self.controllers, self.visits = tuple(improved), tuple(visits)
        self.explore = tuple(confidence_width(v, self.config.confidence) for v in visits)
        return {
            "return_mean": float(episodes.returns(self.discount).mean()),
            "exploring": exploring,
        }

    def state_arrays(self) -> Arrays:
        """The learner's state and its visits."""
        arrays = super().state_arrays()
        return arrays | {f"visits_{n}": visits for n, visits in enumerate(self.visits)}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.check_nodes(self.config.nodes)
        shape = (self.config.nodes,)
        self.visits = tuple(
            taken(arrays, f"visits_{n}", shape) for n in range(len(self.controllers))
        )


def rewards_from(episodes: EpisodeBatch, discount: float) -> FloatArray:
    """sum_{t' >= t} gamma^t' r_t', (S,): what a visit at t counts; rewards are not negative."""
    earned = episodes.rewards * discount ** episodes.steps_into_episode()
    ahead = np.cumsum(earned)
    whole = np.repeat(ahead[episodes.offsets[1:] - 1], episodes.lengths)
    following: FloatArray = np.maximum(whole - ahead + earned, 0.0)  # rounding may fall below 0
    return following


def last_possible(episodes: EpisodeBatch, likelihood: FloatArray) -> IntArray:
    """(K,) row of each episode's last step before one that the controller cannot take.

    From that one on the likelihood is 0.
    """
    possible = np.add.reduceat(likelihood > 0.0, episodes.offsets[:-1], dtype=np.int64)
    rows: IntArray = episodes.offsets[:-1] + possible - 1
    return rows


def confidence_width(visits: FloatArray, confidence: float) -> FloatArray:
    """min(1, c sqrt(ln n / n_z)); 1 for a node that was never visited."""
    visited = visits > 0.0
    width = confidence * np.sqrt(np.log(max(visits.sum(), 1.0)) / np.where(visited, visits, 1.0))
    return np.where(visited, np.minimum(1.0, width), 1.0)
