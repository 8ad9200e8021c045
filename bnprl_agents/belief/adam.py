"""Adam on the logits of a belief policy (Kingma and Ba, ICLR 2015)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bnprl_agents.belief.policy import Logits
from bnprl_agents.episodes import FloatArray

MEAN_DECAY, SQUARE_DECAY, TINY = 0.9, 0.995, 1e-7


class Adam(NamedTuple):
    """Running moments of the gradient.

    Attributes:
        mean: of the gradient.
        square: of its square.
        updates: how many gradients they hold.
    """

    mean: Logits
    square: Logits
    updates: int

    @staticmethod
    def begin(logits: Logits) -> Adam:
        """No gradient yet."""
        zeros = Logits(*(np.zeros_like(table) for table in logits))
        return Adam(zeros, zeros, 0)

    def ascend(self, logits: Logits, gradient: Logits, rate: float) -> tuple[Logits, Adam]:
        """One step uphill; return the new logits and moments."""
        n = self.updates + 1
        mean = Logits(*(_blend(m, g, MEAN_DECAY) for m, g in zip(self.mean, gradient, strict=True)))
        square = Logits(
            *(_blend(s, g**2, SQUARE_DECAY) for s, g in zip(self.square, gradient, strict=True))
        )
        steps = (
            rate * (m / (1.0 - MEAN_DECAY**n)) / (np.sqrt(s / (1.0 - SQUARE_DECAY**n)) + TINY)
            for m, s in zip(mean, square, strict=True)
        )
        moved = Logits(*(table + step for table, step in zip(logits, steps, strict=True)))
        return moved, Adam(mean, square, n)


def _blend(old: FloatArray, new: FloatArray, decay: float) -> FloatArray:
    return decay * old + (1.0 - decay) * new
