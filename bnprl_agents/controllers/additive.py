"""Controllers whose rows share strength: additive logits, and ascent on them.

successor[a, o, i, :] = softmax(move[a, i, :] + sight[o, :]): what an observation says about the
next node is learned from every action and node at once, where free rows (a, o, i) learn alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import FloatArray


class AdditiveLogits(NamedTuple):
    """Unbounded parameters of a controller.

    Attributes:
        initial: (O, Z) logits of the first node.
        action: (Z, A) logits of each node's actions.
        move: (A, Z, Z) part of the successor's logits that the action and the node give.
        sight: (O, Z) part of them that the observation gives.
    """

    initial: FloatArray
    action: FloatArray
    move: FloatArray
    sight: FloatArray

    def controller(self) -> Controller:
        """The controller that the logits stand for."""
        return Controller(
            initial=softmax(self.initial),
            action=softmax(self.action),
            successor=softmax(self.move[:, None] + self.sight[None, :, None]),
        )


def random_logits(
    n_nodes: int, n_actions: int, n_observations: int, spread: float, rng: np.random.Generator
) -> AdditiveLogits:
    """Draw logits such that every observation moves to nodes of its own and actions are open.

    Args:
        n_nodes: Z.
        n_actions: A.
        n_observations: O.
        spread: standard deviation of `sight`; large values make the nodes tell observations apart.
        rng: source of the draws.
    """
    return AdditiveLogits(
        initial=rng.normal(size=(n_observations, n_nodes)),
        action=0.1 * rng.normal(size=(n_nodes, n_actions)),
        move=rng.normal(size=(n_actions, n_nodes, n_nodes)),
        sight=spread * rng.normal(size=(n_observations, n_nodes)),
    )


class Factors(NamedTuple):
    """A controller in the form that the compiled filter reads.

    Attributes:
        initial: (O, Z) and action: (A, Z), the controller's own tables, action transposed.
        move: (A, Z, Z) and sight: (O, Z), such that
        norm: (A, O, Z): successor[a, o, i, j] = move[a, i, j] sight[o, j] / norm[a, o, i].
    """

    initial: FloatArray
    action: FloatArray
    move: FloatArray
    sight: FloatArray
    norm: FloatArray


def factorised(logits: AdditiveLogits) -> Factors:
    """Exponentiate the logits, A Z^2 + O Z of them, instead of the A O Z^2 of `successor`."""
    move = np.exp(logits.move - logits.move.max(axis=-1, keepdims=True))
    sight = np.exp(logits.sight - logits.sight.max(axis=-1, keepdims=True))
    norm = np.ascontiguousarray(np.swapaxes(move @ sight.T, 1, 2))
    return Factors(
        softmax(logits.initial),
        np.ascontiguousarray(softmax(logits.action).T),
        move,
        sight,
        np.maximum(norm, np.finfo(np.float64).tiny),
    )


class Adam(NamedTuple):
    """Moments of the gradient (Kingma and Ba, Adam, ICLR 2015), with its usual constants.

    Attributes:
        mean: running mean of the gradient.
        square: running mean of its square.
        updates: how many gradients they hold.
    """

    mean: AdditiveLogits
    square: AdditiveLogits
    updates: int

    @staticmethod
    def begin(logits: AdditiveLogits) -> Adam:
        """No gradient seen yet."""
        nothing = AdditiveLogits(*map(np.zeros_like, logits))
        return Adam(nothing, nothing, 0)

    def ascend(
        self, logits: AdditiveLogits, gradient: AdditiveLogits, rate: float, decay: float
    ) -> tuple[AdditiveLogits, Adam]:
        """One step of size `rate` uphill; returns the new logits and moments.

        The logits also shrink by the share `rate` times `decay` (Loshchilov and Hutter, Decoupled
        weight decay regularization, ICLR 2019), which bounds them by about 1 / decay.
        """
        n = self.updates + 1
        mean = _blend(self.mean, gradient, 0.9)
        square = _blend(self.square, AdditiveLogits(*(g * g for g in gradient)), 0.999)
        moved = [
            (1.0 - rate * decay) * x
            + rate * (m / (1.0 - 0.9**n)) / (np.sqrt(s / (1.0 - 0.999**n)) + 1e-8)
            for x, m, s in zip(logits, mean, square, strict=True)
        ]
        return AdditiveLogits(*moved), Adam(mean, square, n)


def softmax(logits: FloatArray) -> FloatArray:
    """Distributions over the last axis."""
    weight = np.exp(logits - logits.max(axis=-1, keepdims=True))
    shares: FloatArray = weight / weight.sum(axis=-1, keepdims=True)
    return shares


def softmax_gradient(rows: FloatArray, gradient: FloatArray) -> FloatArray:
    """Chain rule from the gradient of distributions to that of their logits."""
    pull = rows * gradient
    change: FloatArray = pull - rows * pull.sum(axis=-1, keepdims=True)
    return change


def _blend(old: AdditiveLogits, new: AdditiveLogits, keep: float) -> AdditiveLogits:
    return AdditiveLogits(*(keep * a + (1.0 - keep) * b for a, b in zip(old, new, strict=True)))
