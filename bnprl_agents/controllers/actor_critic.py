"""The strong learner: policy gradient through the node filter with a critic on the belief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.additive import Adam, AdditiveLogits, factorised, random_logits
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.critic import Critic, advantages, history_cells
from bnprl_agents.controllers.gradient import (
    Beliefs,
    Surrogate,
    filter_beliefs,
    surrogate_gradient,
)
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.policy_files import Arrays


@dataclass(frozen=True)
class ActorCriticConfig:
    """Settings of `ActorCritic`, the same for every environment."""

    nodes: int = 32
    """Nodes of every controller."""
    batch_steps: int = 1024
    """Environment steps of one batch, about: whole episodes are collected, then discarded."""
    minibatch_steps: int = 512
    """Steps of one gradient, about: whole episodes too."""
    epochs: int = 5
    """Passes over a batch."""
    learning_rate: float = 0.02
    """First step size of Adam on the logits."""
    clip: float = 0.4
    """A step stops counting once its action's probability has changed by this share."""
    divergence_limit: float = 0.03
    """The passes over a batch end once a minibatch has diverged from the old policy by this."""
    entropy: float = 0.02
    """First weight of the policy's entropy, in standard deviations of the advantage."""
    node_entropy: float = 0.05
    """First weight of the entropy of the nodes' occupancy, which keeps nodes from dying out."""
    annealing_steps: float = 1_000_000.0
    """Steps after which step size and entropy weight begin to fall, as 1 over the square root."""
    decay: float = 0.01
    """Share of a logit that a step of size 1 takes away: a Gaussian prior around even rows."""
    advantage_decay: float = 0.8
    """lambda of the advantages that the policy climbs; 1 trusts returns, 0 the critic."""
    return_decay: float = 0.95
    """lambda of the returns that the critic is fitted to."""
    critic_memory: float = 0.9
    """Share of the critic's evidence that a batch leaves."""
    critic_ridge: float = 1.0
    """Precision of the prior of a cell's weights around the common ones, in steps."""
    sight_spread: float = 2.0
    """Standard deviation of the first logits by which observations choose nodes."""

    def __post_init__(self) -> None:
        for name in ("nodes", "batch_steps", "minibatch_steps", "epochs"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: {getattr(self, name)}, must be at least 1")
        for name in (
            "learning_rate",
            "clip",
            "divergence_limit",
            "annealing_steps",
            "critic_ridge",
            "sight_spread",
        ):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name}: {getattr(self, name)}, must be positive and finite")
        for name in ("entropy", "node_entropy"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name}: {getattr(self, name)}, must be finite, not negative")
        for name in ("decay", "advantage_decay", "return_decay", "critic_memory"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: {getattr(self, name)}, must lie in [0, 1]")


LARGEST_RATIO = 2.0
"""Importance ratios are cut here; on-policy they are 1, copies under way at an update differ."""
SWEEPS = 2
"""Fits of the critic to its own bootstrapped returns, a batch."""
SCALE_MEMORY = 0.9
"""Share of the running scale of the advantages that a batch leaves."""


class Actor(NamedTuple):
    """What is learned of one agent of the team.

    Attributes:
        logits: of its controller.
        moments: of their gradient.
        critic: of its histories.
        scale: running standard deviation of its advantages; 0 before the first batch.
    """

    logits: AdditiveLogits
    moments: Adam
    critic: Critic
    scale: float


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
        self.actors: list[Actor] = []
        self.steps = 0
        self.mean_length = 128.0
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
            critic = Critic.begin((n_actions + 1) * n_seen, self.config.nodes)
            self.actors.append(Actor(logits, Adam.begin(logits), critic, 0.0))
        return tuple(actor.logits.controller() for actor in self.actors)

    @property
    def batch_episodes(self) -> int:
        """Episodes that make up `batch_steps` steps, going by the length of the last ones."""
        return max(1, round(self.config.batch_steps / self.mean_length))

    def annealing(self) -> float:
        """Factor of step size and entropy weight: (1 + steps / annealing_steps)^-1/2."""
        return float((1.0 + self.steps / self.config.annealing_steps) ** -0.5)

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Fit the critics and climb the clipped objective on one batch of episodes."""
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
        actor = self.actors[agent]
        beliefs, advantage, weight, critic = self._judge(episodes, agent)
        occupancy = np.average(beliefs.belief, axis=0, weights=weight)
        spread = float(np.sqrt(np.average(advantage**2, weights=weight)))
        scale = spread
        if actor.scale > 0.0:
            scale = SCALE_MEMORY * actor.scale + (1.0 - SCALE_MEMORY) * spread
        actor = actor._replace(critic=critic, scale=scale)
        surrogate = Surrogate(
            advantage / max(scale, np.finfo(np.float64).tiny),
            np.log(beliefs.likelihood),
            weight,
            self.config.clip,
            self.config.entropy * self.annealing(),
            -self.config.node_entropy * self.annealing() * np.log(np.maximum(occupancy, 1e-9)),
        )
        self.actors[agent], report = self._climb(episodes, agent, actor, surrogate)
        return report

    def _judge(
        self, episodes: EpisodeBatch, agent: int
    ) -> tuple[Beliefs, FloatArray, FloatArray, Critic]:
        """Beliefs, centred advantages (S,), weights (S,) of the steps, and the fitted critic."""
        config, controller = self.config, self.controllers[agent]
        beliefs = filter_beliefs(episodes, agent, factorised(self.actors[agent].logits))
        cells = history_cells(episodes, agent, controller.n_actions, controller.n_observations)
        ratio = beliefs.likelihood / episodes.behaviour[:, agent]
        old = critic = self.actors[agent].critic
        for _ in range(SWEEPS):
            values = critic.values(beliefs, cells)
            targets = values[0] + advantages(
                episodes, values, self.discount, config.return_decay, ratio
            )
            critic = old.fitted(
                beliefs.belief, cells.before, targets, config.critic_memory, config.critic_ridge
            )
        advantage = advantages(
            episodes,
            critic.values(beliefs, cells),
            self.discount,
            config.advantage_decay,
            ratio,
        )
        weight = np.minimum(ratio, LARGEST_RATIO)
        advantage -= np.average(advantage, weights=weight)
        return beliefs, advantage, weight / weight.mean(), critic

    def _climb(
        self, episodes: EpisodeBatch, agent: int, actor: Actor, surrogate: Surrogate
    ) -> tuple[Actor, Metrics]:
        """Adam on minibatches of whole episodes until the passes or the trust region end."""
        logits, moments = actor.logits, actor.moments
        pieces = max(1, round(episodes.n_steps / self.config.minibatch_steps))
        rate = self.config.learning_rate * self.annealing()
        order = np.arange(episodes.n_episodes)
        report: Metrics = {}
        for _ in range(self.config.epochs):
            self.rng.shuffle(order)
            for chosen in np.array_split(order, min(pieces, order.size)):
                ascent = surrogate_gradient(episodes, agent, factorised(logits), surrogate, chosen)
                report = {"divergence": ascent.divergence, "entropy": ascent.entropy}
                if ascent.divergence > self.config.divergence_limit:
                    return actor._replace(logits=logits, moments=moments), report
                slope = AdditiveLogits(*(g / ascent.steps for g in ascent.gradient))
                logits, moments = moments.ascend(logits, slope, rate, self.config.decay)
        return actor._replace(logits=logits, moments=moments), report

    def state_arrays(self) -> Arrays:
        """The learner's state, its logits, moments and critics."""
        return super().state_arrays() | self._learned_arrays()

    def _learned_arrays(self) -> Arrays:
        arrays: Arrays = {}
        for n, actor in enumerate(self.actors):
            for part, tables in (
                ("logits", actor.logits),
                ("mean", actor.moments.mean),
                ("square", actor.moments.square),
                ("critic", actor.critic),
            ):
                arrays |= {f"{part}_{name}_{n}": t for name, t in tables._asdict().items()}
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
        for name, table in self._learned_arrays().items():
            if arrays[name].shape != table.shape:
                raise ValueError(f"{name}: shape {arrays[name].shape}, must be {table.shape}")

        def logits(part: str, n: int) -> AdditiveLogits:
            return AdditiveLogits(*(arrays[f"{part}_{f}_{n}"] for f in AdditiveLogits._fields))

        self.actors = [
            Actor(
                logits("logits", n),
                Adam(logits("mean", n), logits("square", n), int(updates)),
                Critic(*(arrays[f"critic_{f}_{n}"] for f in Critic._fields)),
                float(scale),
            )
            for n, (updates, scale) in enumerate(
                zip(counters["updates"], counters["scales"], strict=True)
            )
        ]
        self.steps = int(counters["steps"])
        self.mean_length = float(counters["mean_length"])
