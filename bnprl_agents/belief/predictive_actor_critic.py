"""The strong learner of POMDPs: it learns to predict, and to act on the belief of its model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.belief.filtering import Sequences, run_filter
from bnprl_agents.belief.gradient import Surrogate, likelihood_gradient, policy_gradient
from bnprl_agents.belief.learner import BeliefAgent
from bnprl_agents.belief.policy import random_logits
from bnprl_agents.episodes import EpisodeBatch, IntArray
from bnprl_agents.policy_files import Arrays
from bnprl_agents.proximal.actor import Actor
from bnprl_agents.proximal.adam import like
from bnprl_agents.proximal.advantages import judged, standardised
from bnprl_agents.proximal.config import (
    FIRST_LENGTH,
    ProximalConfig,
    check_counts,
    check_not_negative,
    check_positive,
)
from bnprl_agents.proximal.critic import Cells, Histories, history_cells, single_cell


@dataclass(frozen=True)
class PredictiveActorCriticConfig(ProximalConfig):
    """Settings of `PredictiveActorCritic`, the same for every environment."""

    states: int = 40
    """Hidden states of the model."""
    memory: int = 16
    """Hidden states of the memory."""
    through: float = 1.0
    memory_rate: float = 1.0
    final_entropy: float = .5
    learning_rate: float = 0.03
    """First step size of Adam on the logits."""
    annealing_steps: float = 100_000.0
    """Steps after which step size and entropy weight fall, as 1 over the square root."""
    prediction: float = 1.0
    """Weight of the log-likelihood of observations; 0 leaves the belief to the policy alone."""
    cells: int = 0
    average: float = 0.0
    ridge: float = 1.0
    replay_batches: int = 500
    """Past batches, the latest, from which the prediction goes on learning."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self, "states", "replay_batches")
        check_positive(self, "learning_rate", "annealing_steps")
        check_not_negative(self, "prediction")


CRITIC_RIDGE = 1.0
"""Precision of the prior of the critic's weights, in steps."""
SQUARE_MEMORY, TINY = 0.995, 1e-7
"""Adam's: see `Adam.ascend`."""


class PredictiveActorCritic(BeliefAgent):
    """Proximal policy optimisation on the belief of a hidden Markov model learned on the way.

    Every observation is a training signal: the model's likelihood, on new episodes and on old
    ones alike, shapes the belief, and the policy's gradient passes through the same filter. The
    advantages come from a critic that is linear in the belief.

    Tried on Hallway and worse: the same model fitted by EM alone (from random starts, by splitting
    states, stochastically), because it stops .06 nats a step short of the truth: point-based
    planning on it reaches .21, an actor-critic on its fixed belief .43 after 600,000 steps; on the
    true model these reach .52 and .51. Without `prediction` the filter learns from rewards alone.

    Paper: Schulman et al., Proximal policy optimization algorithms, 2017, for the objective;
    Baum et al., 1970, for the likelihood's gradient.
    """

    Config = PredictiveActorCriticConfig
    config: PredictiveActorCriticConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: PredictiveActorCriticConfig | None = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        n_states = self.config.states
        logits = random_logits(n_states, self.config.memory, self.n_actions, self.n_observations, self.rng)
        nc = {0: 1, 1: self.n_observations, 2: (self.n_actions + 1) * self.n_observations}[self.config.cells]
        self.actor = Actor.begin(logits, n_cells=nc, n_features=self.n_features)
        self.mean_logits = logits
        self.policy = logits.policy()
        self.steps = 0
        self.mean_length = FIRST_LENGTH
        self.replay: list[EpisodeBatch] = []

    @property
    def batch_episodes(self) -> int:
        """Episodes that make up `batch_steps` steps, going by the length of the last ones."""
        return self.config.batch_episodes(self.mean_length)

    def annealing(self) -> float:
        """Factor of step size and entropy weight: min(1, annealing_steps / steps)^1/2."""
        return float(min(1.0, self.config.annealing_steps / self.steps) ** 0.5)

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Fit the critic, then climb likelihood and clipped objective."""
        self.steps += episodes.n_steps
        self.mean_length = episodes.n_steps / episodes.n_episodes
        self.replay = [*self.replay, episodes][-self.config.replay_batches :]
        likelihood = self._climb(episodes, self._judge(episodes))
        self.policy = self.actor.logits.policy()
        self.shown = self.mean_logits.policy() if self.config.average > 0 else self.policy
        return {
            "return_mean": float(episodes.returns(self.discount).mean()),
            "log_likelihood": likelihood,
            "advantage_scale": self.actor.scale,
        }

    def _judge(self, episodes: EpisodeBatch) -> Surrogate:
        """Fit the critic; return the policy's objective on these episodes."""
        actor, on_policy = self.actor, np.ones(episodes.n_steps)
        critic, advantage = judged(
            actor.critic,
            episodes,
            self._histories(episodes),
            on_policy,
            self.config,
            discount=self.discount,
            ridge=self.config.ridge,
        )
        standard, scale = standardised(advantage, on_policy, actor.scale)
        self.actor = actor._replace(critic=critic, scale=scale)
        entropy = self.config.entropy * self.annealing()**(self.config.final_entropy*2)
        return Surrogate(standard, episodes.behaviour[:, 0], self.config.clip, entropy)

    def _histories(self, episodes):
        sequences = Sequences.of(episodes)
        model, memory = (run_filter(sequences, f) for f in self.policy[:2])
        return Histories(np.concatenate([model.before, memory.before], 1), np.concatenate([model.final, memory.final], 1), self._cells(episodes))

    @property
    def n_features(self):
        return self.config.states + self.config.memory

    def _cells(self, episodes):
        if self.config.cells == 0:
            return single_cell(episodes)
        if self.config.cells == 1:
            return Cells(episodes.observations[:, 0], episodes.final_observations[:, 0])
        return history_cells(episodes, 0, self.n_actions, self.n_observations)

    def _climb(self, episodes: EpisodeBatch, surrogate: Surrogate) -> float:
        """Adam on minibatches of new and of old episodes; return the likelihood of the old."""
        logits, moments = self.actor.logits, self.actor.moments
        rate = self.config.learning_rate * self.annealing()
        likelihoods = []
        sequences = Sequences.of(episodes)
        for chosen in self.config.minibatches(episodes, self.rng):
            policy = logits.policy()
            seq, rows = sequences.chosen(chosen)
            slope = policy_gradient(seq, policy, surrogate.at(rows))
            if self.config.through != 1.0:
                slope = like(slope, [g * self.config.through if i < 3 else g for i, g in enumerate(slope)])
            if self.config.prediction > 0.0:
                likelihood, ascent = likelihood_gradient(self._draw_old(), policy, self.config.prediction)
                slope = like(slope, (*(p + q for p, q in zip(slope[:3], ascent, strict=True)), *slope[3:]))
                likelihoods.append(likelihood)
            old = logits
            logits, moments = moments.ascend(
                logits, slope, rate, square_memory=SQUARE_MEMORY, tiny=TINY
            )
            if self.config.memory_rate != 1.0:
                r = self.config.memory_rate
                logits = like(logits, (o + r * (n - o) if 3 <= i < 6 else n for i, (o, n) in enumerate(zip(old, logits))))
            if self.config.average > 0:
                w = (1 + self.config.average) / (moments.updates + self.config.average)
                self.mean_logits = like(logits, (a + w * (b - a) for a, b in zip(self.mean_logits, logits)))
        self.actor = self.actor._replace(logits=logits, moments=moments)
        return float(np.mean(likelihoods)) if likelihoods else float("nan")

    def _draw_old(self) -> Sequences:
        """Some episodes, about `minibatch_steps` steps, of a batch drawn from the replay."""
        batch = self.replay[int(self.rng.integers(len(self.replay)))]
        order = self.rng.permutation(batch.n_episodes)
        lengths = np.diff(batch.offsets)[order].cumsum()
        enough = order[: 1 + int(np.searchsorted(lengths, self.config.minibatch_steps))]
        return Sequences.of(batch).chosen(enough)[0]

    def state_arrays(self) -> Arrays:
        """The learner's state, its logits, moments and critic, and the replay."""
        arrays = super().state_arrays() | self.actor.arrays()
        joined = EpisodeBatch.concatenate(self.replay) if self.replay else None
        for name, value in vars(joined).items() if joined is not None else ():
            arrays[f"replay_{name}"] = np.asarray(value, dtype=np.float64)
        arrays["replay_sizes"] = np.array([b.n_episodes for b in self.replay], dtype=np.float64)
        return arrays

    def counters(self) -> dict[str, Any]:
        """Steps, Adam's updates, the advantages' scale and the episodes' mean length."""
        return {
            "steps": self.steps,
            "updates": self.actor.moments.updates,
            "scale": self.actor.scale,
            "mean_length": self.mean_length,
        }

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.actor = self.actor.restored(arrays, int(counters["updates"]), float(counters["scale"]))
        self.policy = self.actor.logits.policy()
        self.steps = int(counters["steps"])
        self.mean_length = float(counters["mean_length"])
        ends = np.cumsum(arrays["replay_sizes"].astype(np.int64))
        fields = EpisodeBatch.__dataclass_fields__
        joined = EpisodeBatch(*(arrays[f"replay_{f}"] for f in fields)) if ends.size else None
        self.replay = (
            [] if joined is None else [
                joined.between(int(a), int(b)) for a, b in zip([0, *ends[:-1]], ends, strict=True)
            ]
        )  # fmt: skip
