"""The strong learner of POMDPs: it learns to predict, and to act on the belief of its model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.belief.division import divided
from bnprl_agents.belief.filtering import Sequences, run_filter
from bnprl_agents.belief.gradient import (
    Surrogate,
    filtered,
    policy_gradient,
    prediction_gradient,
)
from bnprl_agents.belief.learner import BeliefAgent
from bnprl_agents.belief.policy import random_logits
from bnprl_agents.episodes import EpisodeBatch, restored_episodes
from bnprl_agents.policy_files import Arrays, count, number
from bnprl_agents.proximal.actor import Actor
from bnprl_agents.proximal.advantages import judged, standardised
from bnprl_agents.proximal.config import (
    FIRST_LENGTH,
    ProximalConfig,
    check_counts,
    check_not_negative,
    check_positive,
)
from bnprl_agents.proximal.critic import Cells, Histories


@dataclass(frozen=True)
class PredictiveActorCriticConfig(ProximalConfig):
    """Settings of `PredictiveActorCritic`, the same for every environment."""

    states: int = 60
    """Hidden states of the model, which learns to predict."""
    memory: int = 12
    """Hidden states of the memory, which learns from rewards alone."""
    learning_rate: float = 0.03
    """First step size of Adam on the logits."""
    entropy: float = 0.05
    """First weight of the policy's entropy, in standard deviations of the advantage."""
    barrier: float = 0.005
    """First weight of -KL(uniform || policy), in the same unit: its pull does not fade where an
    action has become rare, so that none that failed at first is ruled out for good."""
    annealing_steps: float = 100_000.0
    """Steps after which both weights and the step size fall as 1 / steps."""
    prediction: float = 1.0
    """Weight of the model's predictions; 0 leaves the model to the policy's gradient, too."""
    replay_batches: int = 500
    """Past batches, the latest, from which the prediction goes on learning."""
    division_steps: int = 5_000
    """Steps after which the model's most used state is divided, if another is hardly used."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self, "states", "memory", "replay_batches", "division_steps")
        check_positive(self, "learning_rate", "annealing_steps")
        check_not_negative(self, "prediction", "barrier")


CRITIC_RIDGE = 1.0
"""Precision of the prior of the critic's weights, in steps."""
SQUARE_MEMORY, TINY = 0.995, 1e-7
"""Adam's: see `Adam.ascend`."""


class PredictiveActorCritic(BeliefAgent):
    """Proximal policy optimisation on the beliefs of two filters learned on the way.

    The first is a hidden Markov model: every observation, end and reward is a training signal, and
    how well they are predicted, on new episodes and on old ones alike, shapes the belief beside the
    policy's gradient; states that are hardly used are replaced by halves of the most used one. The
    second, a memory of the same form, is shaped by the policy's gradient alone and keeps what helps
    to act but not to predict. The policy is log-linear in both beliefs and the last observation;
    the advantages come from a critic that is linear in the beliefs, with weights of its own for
    every last observation.

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
        sizes = self.config.states, self.config.memory
        logits = random_logits(*sizes, self.n_actions, self.n_observations, self.rng)
        self.actor = Actor.begin(logits, self.n_observations, sum(sizes))
        self.policy = logits.policy()
        self.steps = 0
        self.square_rewards = 0.0
        self.mean_length = FIRST_LENGTH
        self.replay: list[EpisodeBatch] = []

    @property
    def batch_episodes(self) -> int:
        """Episodes that make up `batch_steps` steps, going by the length of the last ones."""
        return self.config.batch_episodes(self.mean_length)

    def annealing(self) -> float:
        """Factor of the weights of entropy and barrier and of the step size."""
        return min(1.0, self.config.annealing_steps / self.steps)

    def reward_scale(self) -> float:
        """Root of the mean square of all rewards so far; 1 if there was none."""
        return float((self.square_rewards / self.steps) ** 0.5) if self.square_rewards else 1.0

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Fit the critic, then climb likelihood and clipped objective."""
        self.check_episodes(episodes)
        before, self.steps = self.steps, self.steps + episodes.n_steps
        self.square_rewards += float((episodes.rewards**2).sum())
        self.mean_length = episodes.n_steps / episodes.n_episodes
        self.replay = [*self.replay, episodes][-self.config.replay_batches :]
        likelihood = self._climb(episodes, self._judge(episodes))
        if self.steps // self.config.division_steps > before // self.config.division_steps:
            use = run_filter(Sequences.of(episodes), self.policy.model).before.mean(axis=0)
            self.actor = divided(self.actor, use, self.rng)
        self.policy = self.actor.logits.policy()
        metrics = {
            "return_mean": float(episodes.returns(self.discount).mean()),
            "advantage_scale": self.actor.scale,
        }
        return metrics if likelihood is None else metrics | {"log_likelihood": likelihood}

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
            ridge=CRITIC_RIDGE,
        )
        standard, scale = standardised(advantage, on_policy, actor.scale)
        self.actor = actor._replace(critic=critic, scale=scale)
        annealing = self.annealing()
        return Surrogate(
            standard,
            episodes.behaviour[:, 0],
            self.config.clip,
            annealing * self.config.entropy,
            annealing * self.config.barrier,
        )

    def _histories(self, episodes: EpisodeBatch) -> Histories:
        """Both beliefs along the episodes; the last observation is the critic's cell."""
        model, memory = filtered(Sequences.of(episodes), self.policy)
        return Histories(
            np.concatenate([model.before, memory.before], axis=1),
            np.concatenate([model.final, memory.final], axis=1),
            Cells(episodes.observations[:, 0], episodes.final_observations[:, 0]),
        )

    def _climb(self, episodes: EpisodeBatch, surrogate: Surrogate) -> float | None:
        """Adam on minibatches of new and of old episodes; return the likelihood of the old.

        None where the model does not learn to predict.
        """
        logits, moments = self.actor.logits, self.actor.moments
        rate = self.config.learning_rate * self.annealing()
        sequences, likelihoods = Sequences.of(episodes), []
        for chosen in self.config.minibatches(episodes, self.rng):
            policy = logits.policy()
            some, rows = sequences.chosen(chosen)
            slope = policy_gradient(some, policy, surrogate.at(rows))
            if self.config.prediction > 0.0:
                likelihood, by_model, by_reward = prediction_gradient(
                    self._draw_old(),
                    policy.model,
                    logits.reward,
                    self.reward_scale(),
                    self.config.prediction,
                )
                slope = slope.plus(by_model, by_reward)
                likelihoods.append(likelihood)
            logits, moments = moments.ascend(
                logits, slope, rate, square_memory=SQUARE_MEMORY, tiny=TINY
            )
        self.actor = self.actor._replace(logits=logits, moments=moments)
        return float(np.mean(likelihoods)) if likelihoods else None

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
            "square_rewards": self.square_rewards,
            "updates": self.actor.moments.updates,
            "scale": self.actor.scale,
            "mean_length": self.mean_length,
        }

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.actor = self.actor.restored(arrays, counters["updates"], counters["scale"])
        self.policy = self.actor.logits.policy()
        self.steps = count("steps", counters["steps"])
        self.square_rewards = number("square_rewards", counters["square_rewards"], least=0.0)
        self.mean_length = number("mean_length", counters["mean_length"], least=1.0)
        self.replay = self._restored_replay(arrays)

    def _restored_replay(self, arrays: Arrays) -> list[EpisodeBatch]:
        sizes = self.spaces.action_sizes, self.spaces.observation_sizes
        joined = restored_episodes(arrays, "replay_", *sizes)
        ends = np.cumsum(arrays["replay_sizes"].astype(np.int64)).tolist()
        begins = [0, *ends[:-1]] if ends else []
        held = 0 if joined is None else joined.n_episodes
        if (arrays["replay_sizes"] < 1).any() or held != sum(ends[-1:]):
            raise ValueError(f"replay_sizes: must be positive and sum to {held}")
        return [joined.between(a, b) for a, b in zip(begins, ends, strict=True) if joined]
