"""Grid traffic: a hundred traffic lights, and up to ten thousand, that must agree unspoken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from bnprl_envs.grid_traffic_batch import HORIZONTAL, VERTICAL, GridTrafficBatch
from bnprl_envs.rendering.scene import Doing, Moment
from bnprl_envs.rendering.traffic import Traffic
from bnprl_envs.team import IntArray, TeamEnv, cycle_limit

__all__ = ["HORIZONTAL", "VERTICAL", "GridTraffic", "GridTrafficBatch", "longer_queue"]


class GridTraffic(TeamEnv):
    """Traffic lights on a grid; traffic passes along a line only if all its lights are with it.

    ## Description
    An intersection stands at each crossing of `rows` and `columns`, an agent at each
    intersection: agent `i * columns + j` in row i and column j. One queue waits at each row and
    each column. A line is open if every agent along it is aligned with it; then `discharge` units
    pass, or as many as wait. Then a unit arrives at each queue with probability `arrival_rate`;
    at a queue that is full, with `capacity` units, it is lost. As an open row shuts all columns,
    the agents must agree on a direction with no channel but the queues they see. Ten by ten has
    10^20 joint states; cost per agent and step does not grow with the grid. The published
    description leaves the dynamics open; these are declared here.

    ## Action Space
    `Discrete(2)` each: 0 align horizontally, 1 vertically.

    ## Observation Space
    `Discrete((capacity + 1) ** 2)` each: `row queue * (capacity + 1) + column queue` of the
    agent's two lines. It is informative at `reset` too: there is no null observation.

    ## Rewards
    The number of units that passed in this step, the same for every agent.

    ## Starting State
    All queues are empty.

    ## Episode End
    Never terminates; truncation after 100 steps.

    ## Arguments
    `rows=10`, `columns=10`, `capacity=9`, `arrival_rate=0.5` (per queue and step),
    `discharge=1`, `discount=0.9`. Each agent's info holds `lost`, the number of arrivals lost in
    this step in all queues. `state()` gives the queues, rows first.

    ## References
    Liu, Efficient Bayesian Nonparametric Methods for Model-Free Reinforcement Learning in
    Centralized and Decentralized Sequential Environments (Duke University), chapter 6.

    ## Version History
    v0: initial version.

    Args:
        rows: at least 1.
        columns: at least 1.
        capacity: largest number of units in a queue, at least 1.
        arrival_rate: probability in [0, 1].
        discharge: units that leave an open queue in a step, at least 1.
        discount: factor of the values, in (0, 1].
        max_episode_steps: steps before truncation; None: `max_cycles`.
        max_cycles: the same by PettingZoo's name; None for both: no limit.
        render_mode: None, "ansi", "rgb_array" or "human".

    Attributes:
        discount: in (0, 1].
        max_episode_steps: the limit.

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        *,
        rows: int = 10,
        columns: int = 10,
        capacity: int = 9,
        arrival_rate: float = 0.5,
        discharge: int = 1,
        discount: float = 0.9,
        max_episode_steps: int | None = None,
        max_cycles: int | None = 100,
        render_mode: str | None = None,
    ) -> None:
        self.max_episode_steps = cycle_limit(max_episode_steps, max_cycles)
        self._batch = GridTrafficBatch(
            1,
            rows=rows,
            columns=columns,
            capacity=capacity,
            arrival_rate=arrival_rate,
            discharge=discharge,
            discount=discount,
            max_episode_steps=self.max_episode_steps,
        )
        super().__init__(
            (2,) * self._batch.n_agents,
            ((capacity + 1) ** 2,) * self._batch.n_agents,
            discount=discount,
            render_mode=render_mode,
        )
        self._last: tuple[list[int], float, int] | None = None
        self._elapsed = 0

    def state(self) -> IntArray:
        """Return the units waiting (rows + columns,), of the rows first.

        Raises:
            ResetNeeded: before the first reset.
        """
        queues: IntArray = self._batch.queues[0]
        return queues

    def _begin(self, seed: int | None) -> Sequence[np.int64]:
        self._last, self._elapsed = None, 0
        return list(self._batch.reset(seed=seed)[0][0])

    def _advance(
        self, actions: list[int]
    ) -> tuple[Sequence[np.int64], float, bool, bool, dict[str, Any]]:
        seen, reward, _, truncated, info = self._batch.step(np.array([actions]))
        lost = int(info["lost"][0])
        self._last, self._elapsed = (actions, float(reward[0]), lost), self._elapsed + 1
        return list(seen[0]), float(reward[0]), False, bool(truncated[0]), {"lost": lost}

    def _make_scene(self) -> Traffic:
        batch = self._batch
        return Traffic(batch.rows, batch.columns, batch.capacity, vertical=VERTICAL)

    def _moment(self) -> Moment:
        queues = self.state()
        who, waiting = f"{len(self.possible_agents)} agents", f"{queues.sum()} waiting"
        if self._last is None:
            return Moment(queues, self._elapsed, (), None, (Doing(who, "-", waiting),))
        actions, reward, lost = self._last
        upright = actions.count(VERTICAL)
        did = f"{len(actions) - upright} across, {upright} down"
        doings = (Doing(who, did, f"{waiting}, {lost} lost"),)
        return Moment(queues, self._elapsed, tuple(actions), reward, doings)


def longer_queue(observation: npt.ArrayLike, capacity: int = 9) -> IntArray:
    """Return the action of the literature's heuristic: align with the longer queue.

    Args:
        observation: of agents of `GridTraffic`, any shape.
        capacity: of the environment.

    Returns:
        Actions of the same shape, horizontal where both queues are alike.
    """
    row, column = np.divmod(observation, capacity + 1)
    return np.where(column > row, VERTICAL, HORIZONTAL)
