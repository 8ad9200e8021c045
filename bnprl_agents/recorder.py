"""Episodes in the making: transitions of many copies, gathered into ragged batches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bnprl_agents.episodes import (
    BoolArray,
    EpisodeBatch,
    FloatArray,
    IntArray,
    check_episodes,
    restored_episodes,
)
from bnprl_agents.policy_files import Arrays, taken

FIELDS = ("observations", "actions", "rewards", "behaviour")


class EpisodeRecorder:
    """Records n copies of an environment with N agents, a transition at a time.

    An episode is finished when its copy terminates or is truncated; what a copy had recorded when
    it is begun anew without that is dropped.
    """

    def __init__(self, n_agents: int) -> None:
        self.n_agents = n_agents
        self.finished: list[EpisodeBatch] = []
        self._length = np.zeros(0, dtype=np.int64)
        self._rows: dict[str, npt.NDArray[np.float64]] = {}

    @property
    def n_copies(self) -> int:
        """Copies of the environment that are recorded; 0 before the first begin."""
        return self._length.size

    @property
    def n_finished(self) -> int:
        """Finished episodes not yet taken."""
        return sum(batch.n_episodes for batch in self.finished)

    def begin(self, mask: BoolArray) -> None:
        """Begin new episodes in the copies where `mask` (n,) is true; n may change if all are."""
        if self._length.size != mask.size:
            self._length = np.zeros(mask.size, dtype=np.int64)
            self._rows = {name: self._empty(name, 64, mask.size) for name in FIELDS}
        self._length[mask] = 0

    def add(
        self,
        observations: IntArray,
        actions: IntArray,
        rewards: FloatArray,
        behaviour: FloatArray,
        next_observations: IntArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> None:
        """Record a transition of every copy; shapes (n, N), but (n,) for rewards and flags."""
        if self._length.max() == self._rows["rewards"].shape[1]:
            for name, rows in self._rows.items():
                self._rows[name] = np.concatenate([rows, np.zeros_like(rows)], axis=1)
        copies = np.arange(self._length.size)
        for name, values in zip(FIELDS, (observations, actions, rewards, behaviour), strict=True):
            self._rows[name][copies, self._length] = values
        self._length += 1
        for copy in np.flatnonzero(terminated | truncated).tolist():
            self.finished.append(self._episode(copy, next_observations[copy], terminated[copy]))
            self._length[copy] = 0

    def take(self) -> EpisodeBatch:
        """Return all finished episodes and forget them."""
        batch = EpisodeBatch.concatenate(self.finished)
        self.finished = []
        return batch

    def state_arrays(self) -> dict[str, npt.NDArray[np.float64]]:
        """Everything recorded, for saving."""
        arrays = {f"recorder_{name}": rows for name, rows in self._rows.items()}
        arrays["recorder_length"] = self._length.astype(np.float64)
        if self.finished:
            batch = EpisodeBatch.concatenate(self.finished)
            arrays |= {
                f"finished_{name}": np.asarray(value, dtype=np.float64)
                for name, value in vars(batch).items()
            }
        return arrays

    def restore(
        self,
        arrays: Arrays,
        action_sizes: Sequence[int],
        observation_sizes: Sequence[int],
    ) -> None:
        """Take over what `state_arrays` gave, of agents with these numbers of values.

        Raises:
            ValueError: shapes disagree, or an episode does not fit the agents.
        """
        finished = restored_episodes(arrays, "finished_", action_sizes, observation_sizes)
        self.finished = [] if finished is None else [finished]
        copies = len(arrays["recorder_length"])
        self._length = taken(arrays, "recorder_length", (copies,)).astype(np.int64)
        self._rows = {}
        if not copies:
            return
        room = arrays["recorder_rewards"].shape[-1]
        if not 0 <= self._length.min() <= self._length.max() <= room or not room:
            raise ValueError(f"recorder_length: {self._length.tolist()}, there is room for {room}")
        self._rows = {
            name: taken(arrays, f"recorder_{name}", self._empty(name, room, copies).shape)
            for name in FIELDS
        }
        nowhere = np.zeros(self.n_agents, dtype=np.int64)
        for copy in np.flatnonzero(self._length).tolist():
            check_episodes(self._episode(copy, nowhere, False), action_sizes, observation_sizes)

    def _empty(self, name: str, capacity: int, copies: int) -> npt.NDArray[np.float64]:
        shape = (copies, capacity) if name == "rewards" else (copies, capacity, self.n_agents)
        return np.zeros(shape)

    def _episode(self, copy: int, last_seen: IntArray, terminated: bool) -> EpisodeBatch:
        length = int(self._length[copy])
        rows = {name: self._rows[name][copy, :length].copy() for name in FIELDS}
        return EpisodeBatch(
            offsets=np.array([0, length]),
            final_observations=last_seen[None].copy(),
            terminated=np.array([terminated]),
            **rows,  # type: ignore[arg-type]
        )
