"""The strong learner: policy gradient through the node filter with a critic on the belief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.additive import AdditiveLogits, factorised, random_logits
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.gradient import (
    Beliefs,
    Surrogate,
    filter_beliefs,
    surrogate_gradient,
)
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.policy_files import Arrays, count, number
from bnprl_agents.proximal.actor import Actor
from bnprl_agents.proximal.adam import like
from bnprl_agents.proximal.advantages import judged, standardised
from bnprl_agents.proximal.config import (
    FIRST_LENGTH,
    ProximalConfig,
    check_counts,
    check_not_negative,
    check_positive,
    check_shares,
)
from bnprl_agents.proximal.critic import Critic, Histories, history_cells


@dataclass(frozen=True)
class ActorCriticConfig(ProximalConfig):
    """Settings of `ActorCritic`, the same for every environment."""

    nodes: int = 32
    """Nodes of every controller."""
    learning_rate: float = 0.02
    """First step size of Adam on the logits."""
    divergence_limit: float = 0.03
    """The passes over a batch end once a minibatch has diverged from the old policy by this."""
    node_entropy: float = 0.05
    """First weight of the entropy of the nodes' occupancy, which keeps nodes from dying out."""
    annealing_steps: float = 1_000_000.0
    """Steps after which step size and entropy weight begin to fall, as 1 over the square root."""
    decay: float = 0.01
    """Share of a logit that a step of size 1 takes away: a Gaussian prior around even rows."""
    critic_ridge: float = 1.0
    """Precision of the prior of a cell's weights around the common ones, in steps."""
    sight_spread: float = 2.0
    """Standard deviation of the first logits by which observations choose nodes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self, "nodes")
        check_positive(
            self,
            "learning_rate",
            "divergence_limit",
            "annealing_steps",
            "critic_ridge",
            "sight_spread",
        )
        check_not_negative(self, "node_entropy")
        check_shares(self, "decay")


LARGEST_RATIO = 2.0
"""Importance ratios are cut here; on-policy they are 1, copies under way at an update differ."""


class ActorCritic(ControllerAgent):
    """Proximal policy optimisation of a finite-state controller, through its node filter.

    The gradient is exact (no node is sampled), its advantages come from a critic that is linear
    in the node belief, the controller's rows share strength by additive logits, and a bonus on the
    entropy of the nodes' occupancy keeps all of them in use. A team learns
    independently: every agent has a controller and a critic of its own histories.

    Rewards of either sign and any size need no shift: advantages are standardised. A batch
    without any reward leaves the policy unchanged and reports `rewardless`.

    Paper: Schulman et al., Proximal policy optimization algorithms, 2017, for the objective;
    Meuleau et al., Learning finite-state controllers for partially observable environments, UAI
    1999, for the gradient of controllers.
    """

    Config = ActorCriticConfig
    config: ActorCriticConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: ActorCriticConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        self.actors: list[Actor[AdditiveLogits]] = []
        self.steps = 0
        self.mean_length = FIRST_LENGTH
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.explore = tuple(np.zeros(c.n_nodes) for c in self.controllers)

    def initial_controllers(self) -> tuple[Controller, ...]:
        """Random controllers whose nodes tell observations apart."""
        for n_actions, n_seen in zip(
            self.spaces.action_sizes, self.spaces.observation_sizes, strict=True
        ):
            logits = random_logits(
                self.config.nodes, n_actions, n_seen, self.config.sight_spread, self.rng
            )
            self.actors.append(Actor.begin(logits, (n_actions + 1) * n_seen, self.config.nodes))
        return tuple(actor.logits.controller() for actor in self.actors)

    @property
    def batch_episodes(self) -> int:
        """Episodes that make up `batch_steps` steps, going by the length of the last ones."""
        return self.config.batch_episodes(self.mean_length)

    def annealing(self) -> float:
        """Factor of step size and entropy weight: (1 + steps / annealing_steps)^-1/2."""
        return float((1.0 + self.steps / self.config.annealing_steps) ** -0.5)

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Fit the critics and climb the clipped objective on one batch of episodes."""
        self.check_episodes(episodes)
        self.steps += episodes.n_steps
        self.mean_length = episodes.n_steps / episodes.n_episodes
        metrics = {"return_mean": float(episodes.returns(self.discount).mean())}
        if not episodes.rewards.any():
            return metrics | {"rewardless": 1.0}
        reports = [self._improve(episodes, n) for n in range(len(self.actors))]
        self.controllers = tuple(actor.logits.controller() for actor in self.actors)
        return metrics | {
            name: float(np.mean([report[name] for report in reports])) for name in reports[0]
        }

    def _improve(self, episodes: EpisodeBatch, agent: int) -> Metrics:
        """Improve one agent's critic and controller."""
        actor, annealing = self.actors[agent], self.annealing()
        beliefs, advantage, weight, critic = self._judge(episodes, agent)
        standard, scale = standardised(advantage, weight, actor.scale)
        occupancy = np.average(beliefs.belief, axis=0, weights=weight)
        surrogate = Surrogate(
            standard,
            np.log(beliefs.likelihood),
            weight,
            self.config.clip,
            self.config.entropy * annealing,
            -self.config.node_entropy * annealing * np.log(np.maximum(occupancy, 1e-9)),
        )
        actor = actor._replace(critic=critic, scale=scale)
        self.actors[agent], report = self._climb(episodes, agent, actor, surrogate)
        return report

    def _judge(
        self, episodes: EpisodeBatch, agent: int
    ) -> tuple[Beliefs, FloatArray, FloatArray, Critic]:
        """Beliefs, advantages (S,), weights (S,) of the steps, and the fitted critic."""
        actor, controller = self.actors[agent], self.controllers[agent]
        beliefs = filter_beliefs(episodes, agent, factorised(actor.logits))
        cells = history_cells(episodes, agent, controller.n_actions, controller.n_observations)
        ratio = beliefs.likelihood / episodes.behaviour[:, agent]
        critic, advantage = judged(
            actor.critic,
            episodes,
            Histories(beliefs.belief, beliefs.final, cells),
            ratio,
            self.config,
            discount=self.discount,
            ridge=self.config.critic_ridge,
        )
        weight = np.minimum(ratio, LARGEST_RATIO)
        return beliefs, advantage, weight / weight.mean(), critic

    def _climb(
        self,
        episodes: EpisodeBatch,
        agent: int,
        actor: Actor[AdditiveLogits],
        surrogate: Surrogate,
    ) -> tuple[Actor[AdditiveLogits], Metrics]:
        """Adam on minibatches of whole episodes until the passes or the trust region end."""
        logits, moments = actor.logits, actor.moments
        rate = self.config.learning_rate * self.annealing()
        report: Metrics = {}
        for chosen in self.config.minibatches(episodes, self.rng):
            ascent = surrogate_gradient(episodes, agent, factorised(logits), surrogate, chosen)
            report = {"divergence": ascent.divergence, "entropy": ascent.entropy}
            if ascent.divergence > self.config.divergence_limit:
                break
            slope = like(logits, (part / ascent.steps for part in ascent.gradient))
            logits, moments = moments.ascend(logits, slope, rate, decay=self.config.decay)
        return actor._replace(logits=logits, moments=moments), report

    def state_arrays(self) -> Arrays:
        """The learner's state, its logits, moments and critics."""
        arrays = super().state_arrays()
        for n, actor in enumerate(self.actors):
            arrays |= actor.arrays(f"_{n}")
        return arrays

    def counters(self) -> dict[str, Any]:
        """Steps and mean length of episodes; each actor's updates and scale."""
        return {
            "steps": self.steps,
            "mean_length": self.mean_length,
            "updates": [actor.moments.updates for actor in self.actors],
            "scales": [actor.scale for actor in self.actors],
        }

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.check_nodes(self.config.nodes)
        self.actors = [
            actor.restored(arrays, updates, scale, f"_{n}")
            for n, (actor, updates, scale) in enumerate(
                zip(self.actors, counters["updates"], counters["scales"], strict=True)
            )
        ]
        self.steps = count("steps", counters["steps"])
        self.mean_length = number("mean_length", counters["mean_length"], least=1.0)
