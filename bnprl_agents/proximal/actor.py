"""What an actor-critic has learned of one agent."""

from __future__ import annotations

from typing import Any, Generic, NamedTuple

from bnprl_agents.policy_files import Arrays, count, number, taken
from bnprl_agents.proximal.adam import Adam, Tables, like
from bnprl_agents.proximal.critic import Critic


class Actor(NamedTuple, Generic[Tables]):
    """What is learned of one agent.

    Attributes:
        logits: of its policy.
        moments: of their gradient.
        critic: of its histories.
        scale: running standard deviation of its advantages; 0 before the first batch.
    """

    logits: Tables
    moments: Adam[Tables]
    critic: Critic
    scale: float

    @staticmethod
    def begin(logits: Tables, n_cells: int, n_features: int) -> Actor[Tables]:
        """Nothing learned, of a critic that is linear in so many features."""
        return Actor(logits, Adam.begin(logits), Critic.begin(n_cells, n_features), 0.0)

    def arrays(self, suffix: str = "") -> Arrays:
        """Everything but the scale and the number of updates, each name with a suffix."""
        parts: tuple[tuple[str, Any], ...] = (
            ("logits", self.logits),
            ("mean", self.moments.mean),
            ("square", self.moments.square),
            ("critic", self.critic),
        )
        return {
            f"{part}_{name}{suffix}": table
            for part, tables in parts
            for name, table in tables._asdict().items()
        }

    def restored(self, arrays: Arrays, updates: Any, scale: Any, suffix: str = "") -> Actor[Tables]:
        """The actor that `arrays` was called on, from a policy file.

        Raises:
            ValueError: an array has another shape than this actor's, or a number is out of range.
        """
        tables = [taken(arrays, name, t.shape) for name, t in self.arrays(suffix).items()]
        size = len(self.logits)
        logits, mean, square = (
            like(self.logits, tables[n * size : (n + 1) * size]) for n in range(3)
        )
        moments = Adam(mean, square, count("updates", updates))
        return Actor(logits, moments, Critic(*tables[3 * size :]), number("scale", scale, 0.0))
