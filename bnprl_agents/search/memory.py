"""What a controller remembers before its actions are learned: a clock and its last observations."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from bnprl_agents.episodes import BoolArray, IntArray
from bnprl_agents.search.tables import DecisionTables, Int32Array, equivalent, reachable


class MemoryShape(NamedTuple):
    """Nodes that stand for the phase of a clock and the last observations of its period.

    A joint policy over such nodes is a memoryless one over what they remember. (1, 1) remembers
    the last observation; (2, 0) counts modulo 2 and sees nothing, as alternation needs; (3, 2)
    acts three times on all that was seen since the period began and then forgets it. (6, 1, 0)
    remembers the last observation and for how long observation 0 was not seen: agents that see
    some event together keep their plans in step by such clocks.

    Attributes:
        period: length of the clock's period, at least 1. With 1 there is no clock and nothing is
            ever forgotten but by the window.
        window: how many of the last observations are remembered.
        mark: of a clock that starts over whenever an observation is seen and else stops at the
            end of its period: the observation's rank among those that the role may see, modulo
            their number; -1 for a clock that goes round. The window is then 1.
    """

    period: int
    window: int
    mark: int = -1

    def nodes(self, n_observations: int) -> int:
        """How many nodes it takes where n observations can be seen."""
        if self.mark >= 0:
            return 2 + (n_observations - 1) * (self.period - 1)
        if self.period == 1:
            return sum(n_observations**k for k in range(self.window + 1))
        return sum(n_observations ** min(phase, self.window) for phase in range(self.period))


def shapes(
    n_observations: int, longest_period: int, widest_window: int, nodes: int
) -> list[MemoryShape]:
    """Every shape within the bounds that takes at most so many nodes, without doubles.

    Clocks with a mark have the longest period only.
    """
    rounds = itertools.product(range(1, longest_period + 1), range(widest_window + 1), (-1,))
    marked = itertools.product((longest_period,), (1,), range(n_observations))
    return [
        shape
        for shape in itertools.starmap(MemoryShape, itertools.chain(rounds, marked))
        if shape.nodes(n_observations) <= nodes
        and (shape.period == 1 or shape.window < shape.period)
    ]


def random_tables(
    shape: MemoryShape,
    roles: IntArray,
    action_sizes: IntArray,
    seen: BoolArray,
    nodes: int,
    rng: np.random.Generator,
) -> DecisionTables:
    """Tables of one candidate with a memory of this shape and uniformly random actions.

    Args:
        shape: of the memory.
        roles: (N,) role of each agent.
        action_sizes: (M,) actions of each role.
        seen: (M, O) which observations a role may see after its first action. The others, and
            the first one, are not remembered.
        nodes: Z, at least what the shape takes.
        rng: source of the actions.
    """
    n_roles, n_observations = seen.shape
    successor = np.zeros((1, n_roles, nodes + 1, n_observations), dtype=np.int32)
    for role in range(n_roles):
        _fill(successor[0, role], shape, np.flatnonzero(seen[role]).tolist())
    action = rng.integers(action_sizes[:, None], size=(n_roles, nodes)).astype(np.int32)
    return DecisionTables(roles, action[None], successor)


def _fill(successor: Int32Array, shape: MemoryShape, seen: list[int]) -> None:
    """Number the memories (phase, window) as they are reached, and link them."""
    numbers: dict[tuple[int, tuple[int, ...]], int] = {(0, ()): 0}
    waiting = list(numbers)
    mark = seen[shape.mark % len(seen)] if shape.mark >= 0 else -1
    for phase, window in waiting:
        for o in seen:
            if mark >= 0:
                later, forgets = (0 if o == mark else min(phase + 1, shape.period - 1)), False
            else:
                later = (phase + 1) % shape.period
                forgets = shape.window == 0 or (later == 0 and shape.period > 1)
            memory = (later, () if forgets else (*window, o)[-shape.window :])
            if memory not in numbers:
                numbers[memory] = len(numbers)
                waiting.append(memory)
            successor[numbers[phase, window], o] = numbers[memory]


def remembering_more(team: DecisionTables) -> DecisionTables:
    """The same decisions of one candidate by nodes that also know the last observation.

    A node splits into one for each observation that leads to it, after nodes that decide alike
    were merged: behaviour does not change, but later moves and responses can tell the copies
    apart. A role for whose copies there are too few nodes stays as it is.
    """
    action, successor = team.action.copy(), team.successor.copy()
    for role in range(action.shape[1]):
        split = _split(team.action[0, role], team.successor[0, role])
        if split is not None:
            action[0, role], successor[0, role] = split
    return DecisionTables(team.roles, action, successor)


def _split(action: Int32Array, successor: Int32Array) -> tuple[Int32Array, Int32Array] | None:
    n_nodes, n_seen = action.size, successor.shape[1]
    block = equivalent(action, successor, reachable(successor))
    split = np.zeros_like(action), np.zeros_like(successor)
    numbers: dict[tuple[int, int], int] = {}
    waiting = [(n_nodes, n_nodes)]
    for old, new in waiting:
        for o in range(n_seen):
            target = int(successor[old, o])
            copy = (int(block[target]), o)
            if copy not in numbers:
                if len(numbers) == n_nodes:
                    return None
                numbers[copy] = len(numbers)
                split[0][numbers[copy]] = action[target]
                waiting.append((target, numbers[copy]))
            split[1][new, o] = numbers[copy]
    return split
