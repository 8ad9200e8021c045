"""Batch nested EM for controllers, chapter 4.2 and section 6.2.1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.learner import ControllerAgent, shifted
from bnprl_agents.controllers.messages import (
    Counts,
    Messages,
    backward,
    forward,
    reward_shares,
)
from bnprl_agents.episodes import EpisodeBatch, FloatArray

MStep = Callable[[int, Counts, Controller], Controller]
"""(agent, its counts, its controller) -> its new controller."""


def maximise(counts: Counts, controller: Controller) -> Controller:
    """M-step (4.8): normalised counts; a row without evidence keeps its old distribution."""

    def rows(count: FloatArray, old: FloatArray) -> FloatArray:
        total = count.sum(axis=-1, keepdims=True)
        seen = total > 0.0
        return np.where(seen, count / np.where(seen, total, 1.0), old)

    return Controller(
        initial=rows(counts.initial, controller.initial),
        action=rows(counts.action, controller.action),
        successor=rows(counts.successor, controller.successor),
    )


def part_way(old: Controller, new: Controller, share: float) -> Controller:
    """(1 - share) old + share new, row by row: EM's bound, concave in the rows, still rises."""
    if share == 1.0:
        return new
    return Controller(
        *(
            (1.0 - share) * p + share * q
            for p, q in zip(vars(old).values(), vars(new).values(), strict=True)
        )
    )


def inner_em(
    episodes: EpisodeBatch,
    controllers: Sequence[Controller],
    messages: Sequence[Messages],
    weights: FloatArray,
    iterations: int,
    m_step: MStep,
) -> tuple[tuple[Controller, ...], tuple[Counts, ...]]:
    """Improve every agent's controller for fixed reward weights (S,): the inner loop of Theorem 5.

    Args:
        episodes: K episodes.
        controllers: one for each agent.
        messages: their forward messages.
        weights: (S,) recomputed rewards, on any scale.
        iterations: inner EM iterations, at least 1.
        m_step: turns counts into a controller.

    Returns:
        The new controllers, and the counts of the last E-step.
    """
    improved, evidence = [], []
    for n, (controller, message) in enumerate(zip(controllers, messages, strict=True)):
        counts = backward(episodes, n, controller, message, weights)
        controller = m_step(n, counts, controller)
        for _ in range(iterations - 1):
            message = forward(episodes, n, controller)
            counts = backward(episodes, n, controller, message, weights)
            controller = m_step(n, counts, controller)
        improved.append(controller)
        evidence.append(counts)
    return tuple(improved), tuple(evidence)


@dataclass(frozen=True)
class BatchEMConfig:
    """Settings of `BatchEM`. The source leaves K and the iteration counts open."""

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

    def __post_init__(self) -> None:
        check_settings(self)


def check_settings(config: Any) -> None:
    """Check what the EM learners' settings have in common.

    Raises:
        ValueError: names the setting, what it was and what is allowed.
    """
    for name in ("nodes", "batch_episodes", "outer_iterations", "inner_iterations"):
        if getattr(config, name) < 1:
            raise ValueError(f"{name}: {getattr(config, name)}, must be at least 1")
    for name in ("successor_concentration", "exploration_prior"):
        if not 0.0 < getattr(config, name) < np.inf:
            raise ValueError(f"{name}: {getattr(config, name)}, must be positive and finite")
    if not np.isfinite(config.reward_shift):
        raise ValueError(f"reward_shift: {config.reward_shift}, must be finite")


class BatchEM(ControllerAgent):
    """Nested EM on batches of on-policy episodes; one controller for each agent.

    Each update collects `batch_episodes` under the current policy with node-wise exploration,
    recomputes the rewards (outer loop) and improves the controllers by EM (inner loop).

    Paper: Li, Liao and Carin, Multi-task reinforcement learning in partially observable stochastic
    environments, JMLR 10, 2009; dissertation, Theorem 5 and section 6.2.1.
    """

    Config = BatchEMConfig
    config: BatchEMConfig

    @property
    def batch_episodes(self) -> int:
        """Episodes that one update wants."""
        return self.config.batch_episodes

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Run nested EM on the batch; returns its value, mean return and exploration.

        A batch of fewer episodes than wanted moves the controllers that part of the way only.
        """
        data = shifted(episodes, self.config.reward_shift, self.discount)
        value, exploring, share = 0.0, 0.0, self.batch_share(data)
        for outer in range(self.config.outer_iterations):
            messages = [forward(data, n, c) for n, c in enumerate(self.controllers)]
            current, nu = reward_shares(data, [m.likelihood for m in messages], self.discount)
            if outer == 0:
                value, exploring = current, self.exploring_share(messages)
            self.controllers, counts = inner_em(
                data,
                self.controllers,
                messages,
                nu,
                self.config.inner_iterations,
                lambda n, count, old: part_way(old, maximise(count, old), share),
            )
        self.set_exploration([count.action.sum(axis=1) for count in counts])
        return {
            "value": value,
            "return_mean": float(episodes.returns(self.discount).mean()),
            "exploring": exploring,
        }
