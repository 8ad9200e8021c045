"""First controllers: from good episodes, section 6.5, or of last observations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import EpisodeBatch

SMOOTHING = 0.1
"""Part of the old row that every new row keeps, so that nothing is ruled out for ever."""
FORGETTING = 0.02
"""The same where nodes begin as last observations: larger parts blur them."""

Step = tuple[int, int, float]
"""Action, observation after it, reward."""


@dataclass
class History:
    """A node of one agent's tree of histories.

    Attributes:
        next: (action, observation) -> the reward that came with it, and the longer history.
        actions: action -> how many episodes took it here.
    """

    next: dict[tuple[int, int], tuple[float, History]] = field(default_factory=dict)
    actions: dict[int, int] = field(default_factory=dict)


def controllers_from_episodes(
    episodes: EpisodeBatch, controllers: Sequence[Controller], discount: float, keep: int
) -> tuple[Controller, ...]:
    """Seed controllers with what the best episodes did.

    For each agent the kept episodes make a tree of histories, cut at the largest depth whose
    graph fits the controller. What comes after the cut, an episode's end or an unseen step goes
    back to the root, and histories that lead to the same nodes after the same action, observation
    and reward are one node. Every first observation begins at the root.

    Args:
        episodes: K episodes, of random behaviour in the source.
        controllers: one for each agent, that give the sizes and the rows mixed in.
        discount: of the returns, in (0, 1].
        keep: how many of the best episodes to use, at least 1.
    """
    best = np.argsort(-episodes.returns(discount), kind="stable")[:keep].tolist()
    return tuple(
        _seeded(controller, [list(_steps(episodes, k, n)) for k in best])
        for n, controller in enumerate(controllers)
    )


def controllers_of_observations(controllers: Sequence[Controller]) -> tuple[Controller, ...]:
    """Let every node begin as a last observation: o leads to node o modulo Z, whatever was before.

    Controllers with random rows average the memory of an observation away, and a team must agree
    on what to remember before memory pays; the last observation is what most policies want.

    Args:
        controllers: one for each agent, whose actions are kept and whose rows are mixed in.
    """
    return tuple(_of_observations(controller) for controller in controllers)


def _of_observations(controller: Controller) -> Controller:
    node = np.arange(controller.n_observations) % controller.n_nodes
    chosen = np.eye(controller.n_nodes)[node]  # (O, Z)
    return Controller(
        (1.0 - FORGETTING) * chosen + FORGETTING * controller.initial,
        controller.action,
        (1.0 - FORGETTING) * chosen[:, None, :] + FORGETTING * controller.successor,
    )


def _steps(episodes: EpisodeBatch, episode: int, agent: int) -> Iterator[Step]:
    begin, end = episodes.offsets[episode : episode + 2].tolist()
    seen = np.append(
        episodes.observations[begin + 1 : end, agent],
        episodes.final_observations[episode, agent],
    )
    actions, rewards = episodes.actions[begin:end, agent], episodes.rewards[begin:end]
    return zip(actions.tolist(), seen.tolist(), rewards.tolist(), strict=True)


def history_tree(runs: Sequence[Sequence[Step]], depth: int) -> History:
    """The tree of the first `depth` steps of some episodes."""
    root = History()
    for run in runs:
        node = root
        for action, seen, reward in run[:depth]:
            node.actions[action] = node.actions.get(action, 0) + 1
            _, node = node.next.setdefault((action, seen), (reward, History()))
    return root


class Graph:
    """The merged tree.

    Attributes:
        nodes: histories that stand for a node each; the first is the root, to which leaves lead.
    """

    def __init__(self, root: History) -> None:
        self.nodes = [root]
        self._known: dict[tuple[tuple[int, int, float, int], ...], int] = {}
        self._index: dict[int, int] = {id(root): 0}
        for history in root.next.values():
            self._add(history[1])

    def index(self, history: History) -> int:
        """The node of a history of the tree."""
        return self._index[id(history)]

    def _add(self, history: History) -> int:
        """Add a history after the longer ones, and return its node."""
        if not history.next:
            self._index[id(history)] = 0
            return 0
        leads = tuple(
            sorted(
                (action, seen, reward, self._add(after))
                for (action, seen), (reward, after) in history.next.items()
            )
        )
        if leads not in self._known:
            self._known[leads] = len(self.nodes)
            self.nodes.append(history)
        self._index[id(history)] = self._known[leads]
        return self._known[leads]


def _seeded(controller: Controller, runs: Sequence[Sequence[Step]]) -> Controller:
    graph = Graph(history_tree(runs, 1))
    for depth in range(2, max(map(len, runs)) + 1):
        deeper = Graph(history_tree(runs, depth))
        if len(deeper.nodes) > controller.n_nodes:
            break
        graph = deeper
    size = len(graph.nodes)
    initial, action, successor = (np.zeros_like(table) for table in vars(controller).values())
    initial[:, 0] = 1.0
    successor[:, :, :size, 0] = 1.0
    for i, history in enumerate(graph.nodes):
        for a, times in history.actions.items():
            action[i, a] = times / sum(history.actions.values())
        for (a, seen), (_, after) in history.next.items():
            successor[a, seen, i] = 0.0
            successor[a, seen, i, graph.index(after)] = 1.0
    action[size:], successor[:, :, size:] = (
        controller.action[size:],
        controller.successor[:, :, size:],
    )
    return Controller(
        *(
            (1.0 - SMOOTHING) * new + SMOOTHING * old
            for new, old in zip(
                (initial, action, successor), vars(controller).values(), strict=True
            )
        )
    )
