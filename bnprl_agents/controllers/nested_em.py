"""The learner under chapters 4 to 6: one E-step, any prior, any schedule, node-wise exploration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.learner import ControllerAgent, check_shift, shifted
from bnprl_agents.controllers.messages import Counts, Messages, backward, forward
from bnprl_agents.controllers.priors import (
    MaximumLikelihood,
    Posterior,
    Prior,
    blend,
    evidence_arrays,
    restored_evidence,
    scaled,
)
from bnprl_agents.controllers.schedules import (
    blended_value,
    exponential,
    restored_log,
    saved_log,
)
from bnprl_agents.controllers.weighting import Evidence, by_return, by_reward
from bnprl_agents.episodes import EpisodeBatch, FloatArray
from bnprl_agents.policy_files import Arrays, count
from bnprl_agents.settings import Settings

MStep = Callable[[int, Counts, Posterior], Posterior]
"""(agent, its counts, its posterior) -> its new posterior."""


def inner_em(
    episodes: EpisodeBatch,
    posteriors: Sequence[Posterior],
    messages: Sequence[Messages],
    weights: FloatArray,
    iterations: int,
    m_step: MStep,
) -> tuple[tuple[Posterior, ...], tuple[Counts, ...]]:
    """Improve every agent's posterior for fixed reward weights (S,): the inner loop of Theorem 5.

    Args:
        episodes: K episodes.
        posteriors: one for each agent.
        messages: their forward messages.
        weights: (S,) recomputed rewards, on any scale.
        iterations: inner EM iterations, at least 1.
        m_step: turns counts into a posterior.

    Returns:
        The new posteriors, and the counts of the last E-step.
    """
    improved, evidence = [], []
    for n, (posterior, message) in enumerate(zip(posteriors, messages, strict=True)):
        counts = backward(episodes, n, posterior.geometric, message, weights)
        posterior = m_step(n, counts, posterior)
        for _ in range(iterations - 1):
            message = forward(episodes, n, posterior.geometric)
            counts = backward(episodes, n, posterior.geometric, message, weights)
            posterior = m_step(n, counts, posterior)
        improved.append(posterior)
        evidence.append(counts)
    return tuple(improved), tuple(evidence)


@dataclass(frozen=True)
class NestedEMConfig(Settings):
    """Settings that the learners on the shared E-step have in common.

    The source leaves K and the iteration counts open.
    """

    nodes: int = 20
    """Nodes of every controller."""
    successor_concentration: float = 0.5
    """Of the Dirichlet from which the first successor rows are drawn. At 1 (uniform) many nodes
    average the memory of an observation away, and EM may never leave the best memoryless policy."""
    batch_episodes: int = 300
    """Episodes collected under the current policy for one update, then discarded."""
    outer_iterations: int = 1
    """Recomputations of the rewards on one batch; more than one re-uses it off-policy."""
    inner_iterations: int = 1
    """EM iterations for each recomputation of the rewards."""
    exploration_prior: float = 2.0
    """u1 of the Beta distribution from which a node's exploitation is drawn; larger explores."""
    reward_shift: float = 0.0
    """Added to every reward; the sum must not be negative. A terminal state earns it for ever."""
    weighting: Literal["reward", "return", "linear"] = "reward"
    """reward: every reward by its importance ratio, the empirical value (2.45). return: whole
    on-policy episodes by exp(temperature x standardised return), which needs no shift; not in the
    source, for rewards of both signs, where a shift drowns the signal. linear: the same by
    max(0, 1 + temperature x standardised return), slower but not fond of gambles."""
    temperature: float = 1.0
    """Of the weightings by return; larger values look at the best episodes only."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_settings(self)


def check_settings(config: NestedEMConfig) -> None:
    """Check what the learners' settings have in common.

    Raises:
        ValueError: names the setting, what it was and what is allowed.
    """
    for name in ("nodes", "batch_episodes", "outer_iterations", "inner_iterations"):
        if getattr(config, name) < 1:
            raise ValueError(f"{name}: {getattr(config, name)}, must be at least 1")
    for name in ("successor_concentration", "exploration_prior", "temperature"):
        if not 0.0 < getattr(config, name) < np.inf:
            raise ValueError(f"{name}: {getattr(config, name)}, must be positive and finite")
    check_shift(config.reward_shift)
    if config.weighting not in ("reward", "return", "linear"):
        raise ValueError(f"weighting: {config.weighting!r}, must be 'reward', 'return' or 'linear'")
    if config.weighting != "reward" and config.batch_episodes < 2:
        raise ValueError("batch_episodes: 1, must be at least 2 to weigh episodes by their returns")


class NestedEM(ControllerAgent):
    """E-step x prior x schedule x exploration; subclasses choose the prior and the schedule.

    An update weighs the batch's steps (outer loop), and for these weights alternates messages and
    M-steps agent by agent (inner loop). The statistics are running means whose learning rate the
    schedule gives: rate 1 keeps the newest batch only. They are held divided by the running value
    V, so a batch of value V_n enters with the share alpha V_n / ((1 - alpha) V + alpha V_n): the
    same as averaging the unnormalised gamma^t r_t ratio_t, and free of overflow. A batch without
    reward leaves them as they are. Every inner iteration blends with the statistics SAVED before
    the batch, so that no episode counts twice.

    Attributes:
        posteriors: one for each agent; their means are `controllers`.
        statistics: each agent's counts divided by V; those of `initial` sum to 1, or 0 at first.
        log_value: ln V of the running value.
        updates: how many batches were learned from.
        episodes: how many episodes.
    """

    Config = NestedEMConfig
    config: NestedEMConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: Any = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.priors = self.make_priors()
        self.updates, self.episodes = 0, 0
        self.begin_anew(self.controllers)

    def make_priors(self) -> tuple[Prior, ...]:
        """Each agent's M-step; EM's unless a subclass says otherwise."""
        return tuple(MaximumLikelihood() for _ in self.controllers)

    def learning_rate(self, episodes: EpisodeBatch) -> float:
        """alpha_n of the update under way: 1, the batch schedule, unless a subclass differs."""
        return 1.0

    def evidence_episodes(self, episodes: EpisodeBatch) -> int:
        """Episodes that the statistics stand for: the batch, or with smaller rates all so far."""
        return episodes.n_episodes

    def evidence_scale(self, episodes: EpisodeBatch) -> float:
        """Number of episodes as which the statistics weigh against the prior."""
        return 1.0

    @property
    def batch_episodes(self) -> int:
        """Episodes that one update wants."""
        return self.config.batch_episodes

    @property
    def value(self) -> float:
        """The running value V."""
        return exponential(self.log_value)

    def begin_at(self, controllers: Sequence[Controller]) -> None:
        """Take over posteriors around some controllers."""
        self.adopt([p.around(c) for p, c in zip(self.priors, controllers, strict=True)])

    def begin_anew(self, controllers: Sequence[Controller]) -> None:
        """Begin at some controllers without any evidence, exploring always."""
        self.begin_at(controllers)
        self.explore = tuple(np.ones(c.n_nodes) for c in controllers)
        self.statistics = tuple(
            Counts(*(np.zeros_like(table) for table in vars(c).values())) for c in controllers
        )
        self.log_value = -np.inf

    def adopt(self, posteriors: Sequence[Posterior]) -> None:
        """Take over posteriors, and act by their means."""
        self.posteriors = tuple(posteriors)
        self.controllers = tuple(posterior.mean for posterior in self.posteriors)

    def check_reward(self, smallest: float) -> None:
        """Check that the learner can use rewards down to this one; see `ControllerAgent`."""
        if self.config.weighting == "reward":
            super().check_reward(smallest)

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Learn from a batch by nested EM; returns what it saw and the lower bound."""
        data = shifted(episodes, self.config.reward_shift, self.discount)
        self.updates += 1
        self.episodes += data.n_episodes
        messages = [forward(data, n, controller) for n, controller in enumerate(self.controllers)]
        metrics = {
            "return_mean": float(episodes.returns(self.discount).mean()),
            "exploring": self.exploring_share(data, messages),
        }
        if self.config.weighting == "reward":
            metrics["value"] = exponential(self.weigh(data, messages).log_value)
        metrics |= self.improve(data, messages)
        self.set_exploration(self.occupancies(data))
        return metrics

    def occupancies(self, data: EpisodeBatch) -> list[FloatArray]:
        """Return u0 (Z,) of each agent, (2.47): a reward counts for every visit before it.

        Args:
            data: the newest batch, which the statistics hold already.
        """
        scale = self.evidence_episodes(data)
        return [scale * counts.action.sum(axis=1) for counts in self.statistics]

    def improve(self, data: EpisodeBatch, messages: Sequence[Messages]) -> Metrics:
        """Blend a batch into the statistics and improve the posteriors.

        Args:
            data: the batch, its rewards shifted.
            messages: the forward messages of `controllers`.

        Returns:
            The lower bound (6.2), as it stood before the last M-step, times the evidence's scale;
            no bound where it is minus infinity, since an episode that counts holds an action that
            the controllers cannot take; or that the batch changed nothing, since it held no reward.
        """
        saved, rate, scale = (self.statistics, self.learning_rate(data), self.evidence_scale(data))
        for outer in range(self.config.outer_iterations):
            if outer > 0 or any(p.geometric is not p.mean for p in self.posteriors):
                messages = [forward(data, n, p.geometric) for n, p in enumerate(self.posteriors)]
            evidence = self.weigh(data, messages)
            if evidence.log_value == -np.inf:
                self.log_value += np.log1p(-rate) if rate < 1.0 else 0.0
                return {"unchanged": 1.0}
            log_value, share = blended_value(self.log_value, evidence.log_value, rate)
            bound = scale * evidence.fit - sum(p.divergence for p in self.posteriors)
            m_step = self._blending_step(saved, share, scale)
            posteriors, counts = inner_em(
                data,
                self.posteriors,
                messages,
                evidence.shares,
                self.config.inner_iterations,
                m_step,
            )
            self.adopt(posteriors)
        self.statistics = tuple(blend(s, c, share) for s, c in zip(saved, counts, strict=True))
        self.log_value = log_value
        bounded = {"bound": bound} if np.isfinite(bound) else {}
        return bounded | {"learning_rate": rate}

    def _blending_step(self, saved: tuple[Counts, ...], share: float, scale: float) -> MStep:
        """An M-step on the saved statistics with the batch's share blended in."""
        return lambda n, counts, old: self.priors[n].update(
            scaled(blend(saved[n], counts, share), scale), old
        )

    def weigh(self, data: EpisodeBatch, messages: Sequence[Messages]) -> Evidence:
        """Turn the batch's rewards into evidence."""
        likelihoods = [message.likelihood for message in messages]
        if self.config.weighting == "reward":
            return by_reward(data, likelihoods, self.discount)
        return by_return(
            data,
            likelihoods,
            self.discount,
            self.config.temperature,
            linear=self.config.weighting == "linear",
        )

    def state_arrays(self) -> Arrays:
        """The learner's state, its posteriors and its statistics."""
        return super().state_arrays() | evidence_arrays(self.posteriors, self.statistics)

    def counters(self) -> dict[str, Any]:
        """The running value, and the numbers of updates and episodes."""
        return {
            "log_value": saved_log(self.log_value),
            "updates": self.updates,
            "episodes": self.episodes,
        }

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.check_nodes(self.config.nodes)
        posteriors, self.statistics = restored_evidence(arrays, self.priors, self.controllers)
        self.adopt(posteriors)
        self.log_value = restored_log(counters["log_value"])
        self.updates = count("updates", counters["updates"])
        self.episodes = count("episodes", counters["episodes"])
