"""Gradients of the policy's objective and of the predictive likelihood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.belief.filtering import Filtered, Sequences, filter_gradient, run_filter
from bnprl_agents.belief.policy import BeliefPolicy, Filter, FilterLogits, Logits
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.proximal.config import clipped_pull

LARGEST_PULL = 10.0
"""Bound of an importance ratio times advantage."""


class Surrogate(NamedTuple):
    """The clipped objective of proximal policy optimisation (Schulman et al. 2017, (7)).

    Attributes:
        advantage: (S,) of the actions taken.
        behaviour: (S,) probability with which each was chosen.
        clip: share by which a probability may change before the step stops counting.
        entropy: weight of the policy's entropy.
        barrier: weight of -KL(uniform || policy), whose gradient is uniform - p: unlike the
            entropy's it does not vanish with p. It is the log barrier of Agarwal et al., On the
            theory of policy gradient methods, 2021.
    """

    advantage: FloatArray
    behaviour: FloatArray
    clip: float
    entropy: float
    barrier: float

    def at(self, rows: IntArray) -> Surrogate:
        """That of some of the steps."""
        return self._replace(advantage=self.advantage[rows], behaviour=self.behaviour[rows])

    def slope(self, p: FloatArray, actions: IntArray) -> FloatArray:
        """Gradient (S, A) by the logits of the probabilities p (S, A), at the actions (S,)."""
        steps = np.arange(len(actions))
        ratio = p[steps, actions] / self.behaviour
        pull = clipped_pull(ratio, self.advantage, self.clip).clip(-LARGEST_PULL, LARGEST_PULL)
        log_p = np.log(np.maximum(p, 1e-300))
        entropy = -(p * log_p).sum(axis=1, keepdims=True)
        slope: FloatArray = -pull[:, None] * p - self.entropy * p * (log_p + entropy)
        slope += self.barrier * (1.0 / p.shape[1] - p)
        slope[steps, actions] += pull
        return slope


def filtered(sequences: Sequences, policy: BeliefPolicy) -> tuple[Filtered, Filtered]:
    """The ways of a policy's model and memory through the same episodes."""
    return run_filter(sequences, policy.model), run_filter(sequences, policy.memory)


def policy_gradient(sequences: Sequences, policy: BeliefPolicy, surrogate: Surrogate) -> Logits:
    """Gradient of the surrogate, a mean over the steps, by every logit."""
    model, memory = filtered(sequences, policy)
    belief = np.concatenate([model.before, memory.before], axis=1)
    p = policy.action_probabilities(belief, sequences.observations)
    slope = surrogate.slope(p, sequences.actions) / len(p)
    action, sight = belief.T @ slope, np.zeros_like(policy.sight)
    np.add.at(sight, sequences.observations, slope)
    states = model.before.shape[1]
    by_belief = slope @ policy.action.T
    return Logits(
        *filter_gradient(sequences, policy.model, model, by_belief[:, :states], 0.0),
        *filter_gradient(sequences, policy.memory, memory, by_belief[:, states:], 0.0),
        action,
        sight,
        np.zeros((len(policy.model.transition), states)),
    )


def prediction_gradient(
    sequences: Sequences, model: Filter, reward: FloatArray, scale: float, weight: float
) -> tuple[float, FilterLogits, FloatArray]:
    """Gradient of how well a model predicts observations, ends and rewards, a mean over the steps.

    The objective is log p(o_{t+1} | h_t, a_t) - (r_t / scale - f_t . reward[a_t])^2 / 2.

    Args:
        sequences: K episodes of S steps.
        model: predicts.
        reward: (A, Z) mean reward of each action in each state, in scales.
        scale: of the rewards.
        weight: of the objective.

    Returns:
        The log-likelihood a step, and the gradient by the model's logits and by `reward`.
    """
    way = run_filter(sequences, model)
    share, means = weight / len(way.likelihood), reward[sequences.actions]
    error = share * (sequences.rewards / scale - (way.before * means).sum(axis=1))[:, None]
    by_reward = np.zeros_like(reward)
    np.add.at(by_reward, sequences.actions, error * way.before)
    gradient = filter_gradient(sequences, model, way, error * means, share)
    return float(np.log(way.likelihood).mean()), gradient, by_reward
