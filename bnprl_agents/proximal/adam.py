"""Adam on a named tuple of arrays (Kingma and Ba, ICLR 2015)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Generic, NamedTuple, TypeVar, cast

import numpy as np

from bnprl_agents.episodes import FloatArray

Tables = TypeVar("Tables", bound=tuple[FloatArray, ...])
"""A NamedTuple whose fields are arrays."""

MEAN_MEMORY = 0.9
"""Share of the gradient's running mean that a step leaves."""


class Adam(NamedTuple, Generic[Tables]):
    """Running moments of the gradient.

    Attributes:
        mean: of the gradient.
        square: of its square.
        updates: how many gradients they hold.
    """

    mean: Tables
    square: Tables
    updates: int

    @staticmethod
    def begin(tables: Tables) -> Adam[Tables]:
        """No gradient seen yet."""
        nothing = like(tables, map(np.zeros_like, tables))
        return Adam(nothing, nothing, 0)

    def ascend(
        self,
        tables: Tables,
        gradient: Tables,
        rate: float,
        *,
        decay: float = 0.0,
        square_memory: float = 0.999,
        tiny: float = 1e-8,
    ) -> tuple[Tables, Adam[Tables]]:
        """One step uphill; return the new tables and moments.

        Args:
            tables: where.
            gradient: there.
            rate: size of the step.
            decay: the tables also shrink by the share `rate` times this (Loshchilov and Hutter,
                Decoupled weight decay regularization, ICLR 2019), which bounds them by about
                1 / decay.
            square_memory: share of the squares' running mean that a step leaves.
            tiny: added to the root of the squares, which it is divided by.
        """
        n = self.updates + 1
        mean = _blend(self.mean, gradient, MEAN_MEMORY)
        square = _blend(self.square, like(gradient, (g * g for g in gradient)), square_memory)
        unbiased, spread = 1.0 - MEAN_MEMORY**n, 1.0 - square_memory**n
        moved = (
            (1.0 - rate * decay) * x + rate * (m / unbiased) / (np.sqrt(s / spread) + tiny)
            for x, m, s in zip(tables, mean, square, strict=True)
        )
        return like(tables, moved), Adam(mean, square, n)


def like(tables: Tables, arrays: Iterable[FloatArray]) -> Tables:
    """A named tuple of the same kind, of other arrays."""
    return cast(Tables, cast(Any, tables)._make(arrays))


def _blend(old: Tables, new: Tables, memory: float) -> Tables:
    return like(old, (memory * a + (1.0 - memory) * b for a, b in zip(old, new, strict=True)))
