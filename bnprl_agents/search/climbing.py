"""Local search with common random numbers: candidates race on the same seeds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.search.moves import apply_moves, list_moves
from bnprl_agents.search.simulator import TeamSimulator, UInt64Array
from bnprl_agents.search.tables import DecisionTables

BATCH = 32
"""Moves that race against each other."""
FIRST = 16
"""Seeds of the first heat; each later one has as many as all before it."""
DOUBT = 1.5
"""Standard errors that a candidate may lie behind and still race on."""


class Climber(NamedTuple):
    """What a climb works with.

    Attributes:
        simulator: scores the candidates.
        action_sizes: (M,) actions of each role.
        kinds: of the moves that are tried.
        patience: moves in a row that may fail before the climb ends.
        limit: `simulator.steps` at which the climb ends.
    """

    simulator: TeamSimulator
    action_sizes: IntArray
    kinds: tuple[int, ...]
    patience: int
    limit: int

    def climb(
        self, team: DecisionTables, seeds: UInt64Array, rng: np.random.Generator
    ) -> DecisionTables:
        """Improve a team until no move that was tried does.

        Moves are tried in random order, those at entries that are visited often first. The best
        of a batch is made if it is better by more than its standard error.
        """
        base = self.simulator.returns(team, seeds)[0]
        while True:
            visits = self.simulator.visits(team, seeds[: 4 * FIRST])
            moves, weight = list_moves(team, visits, self.action_sizes, self.kinds)
            keys = rng.exponential(size=len(moves)) / np.sqrt(weight)
            order = np.argsort(keys)[: self.patience]
            for begin in range(0, order.size, BATCH):
                if self.simulator.steps >= self.limit:
                    return team
                candidates = apply_moves(team, moves[order[begin : begin + BATCH]])
                winner = race(self.simulator, candidates, base, seeds)
                if winner is not None:
                    best, base = winner
                    team = candidates.candidate(best)
                    break
            else:
                return team


def race(
    simulator: TeamSimulator, candidates: DecisionTables, base: FloatArray, seeds: UInt64Array
) -> tuple[int, FloatArray] | None:
    """Successive halving of candidates by their gains over the incumbent on the same seeds.

    Args:
        simulator: scores the candidates.
        candidates: B of them.
        base: (E,) returns of the incumbent.
        seeds: (E,).

    Returns:
        The best candidate's index and returns (E,); None if none is better than the incumbent by
        more than the standard error of the gain.
    """
    racing = np.arange(len(candidates.action))
    returns = np.zeros((racing.size, 0))
    while racing.size:
        done = returns.shape[1]
        heat = seeds[done : max(FIRST, 2 * done)]
        new = simulator.returns(candidates.candidates(racing), heat)
        returns = np.concatenate([returns, new], axis=1)
        gain = returns - base[: returns.shape[1]]
        mean, error = gain.mean(axis=1), gain.std(axis=1) / np.sqrt(gain.shape[1])
        if returns.shape[1] == seeds.size:
            best = int(mean.argmax())
            better = mean[best] > max(error[best], 1e-9 * np.abs(base).max())
            return (int(racing[best]), returns[best]) if better else None
        hope = mean + DOUBT * error
        half = max(1, racing.size // 2)
        kept = (hope > 0.0) & (hope >= np.partition(hope, -half)[-half])
        racing, returns = racing[kept], returns[kept]
    return None
