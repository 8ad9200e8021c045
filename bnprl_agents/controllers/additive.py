"""Controllers whose rows share strength: additive logits.

successor[a, o, i, :] = softmax(move[a, i, :] + sight[o, :]): what an observation says about the
next node is learned from every action and node at once, where free rows (a, o, i) learn alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import FloatArray
from bnprl_agents.settings import check_entries
from bnprl_agents.softmax import softmax


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

    Raises:
        ValueError: the controller would be larger than `bnprl_agents.settings.MOST_ENTRIES`.
    """
    check_entries("nodes", n_actions, n_observations, n_nodes, n_nodes)
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
