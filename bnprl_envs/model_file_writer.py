"""Model files, written: the shortest statements that give the same arrays bit for bit."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from bnprl_envs.model import TabularModel
from bnprl_envs.model_file_labels import SHAPES
from bnprl_envs.model_file_preamble import PREAMBLE, TABLES
from bnprl_envs.model_file_specifications import MAX_ENTRIES
from bnprl_envs.tables import FloatArray

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_.\-]*")
_RESERVED = {*PREAMBLE, *TABLES, *SHAPES, "include", "exclude", "reward", "cost"}


def write_model(model: TabularModel, path: str | os.PathLike[str]) -> None:
    """Write a model as `.pomdp` (one agent) or `.dpomdp` (any number of agents).

    Reading the file gives equal arrays bit for bit. Names are written where all names of a list
    are identifiers (a letter, then letters, digits and `_-.`) and no keywords of the format;
    counts otherwise. A `.pomdp` file has no place for the agent's name. A fully observed model
    whose observation is the state is written without `observations:`; rewards over observations
    too large for one table are refused. The file appears complete or not at all.

    Args:
        model: what to write.
        path: the file; its suffix chooses the format.

    Raises:
        ValueError: the suffix is unknown, or the format cannot hold the model.
        OSError: the file cannot be written.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in (".pomdp", ".dpomdp"):
        raise ValueError(f"{target}: suffix {target.suffix!r}, must be .pomdp or .dpomdp")
    if suffix == ".pomdp" and model.n_agents > 1:
        raise ValueError(f"{target}: {model.n_agents} agents need the suffix .dpomdp")
    sheet = _Sheet.of(model, joint=suffix == ".dpomdp")
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "w", encoding="ascii", newline="\n") as file:
            file.writelines(f"{line}\n" for line in sheet.lines())
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


@dataclass(frozen=True)
class _Sheet:
    """A model with the words that its file uses."""

    model: TabularModel
    joint: bool
    """Whether the grammar is MADP's."""
    states: Sequence[str]
    actions: Sequence[str]
    """Words of the joint actions."""
    observations: Sequence[str] | None
    """Words of the joint observations; None for a model that observes its state."""
    reward: FloatArray | csr_array

    @classmethod
    def of(cls, model: TabularModel, joint: bool) -> _Sheet:
        names = model.names
        plain = model.fully_observed and model.observation_sizes == (model.n_states,)
        return cls(
            model=model,
            joint=joint,
            states=_words(names.states),
            actions=_joint_words(names.actions),
            observations=None if plain else _joint_words(names.observations),
            reward=_reward(model, plain),
        )

    def lines(self) -> Iterator[str]:
        yield from self._preamble()
        yield from self._transitions()
        if self.observations is not None:
            yield from self._observations()
        yield from self._rewards()

    def _preamble(self) -> Iterator[str]:
        model, names = self.model, self.model.names
        if self.joint:
            default = tuple(f"agent_{n}" for n in range(model.n_agents))
            yield f"agents: {model.n_agents if names.agents == default else _listed(names.agents)}"
        yield f"discount: {model.discount!r}"
        yield "values: reward"
        yield f"states: {_listed(names.states)}"
        yield from ("start:", " ".join(map(repr, model.start.tolist())))
        lists = {"actions": names.actions}
        if self.observations is not None:
            lists["observations"] = names.observations
        for keyword, per_agent in lists.items():
            if self.joint:
                yield from (f"{keyword}:", *map(_listed, per_agent))
            else:
                yield f"{keyword}: {_listed(per_agent[0])}"
        if model.terminal.any():
            yield "E: " + " ".join(self.states[s] for s in np.flatnonzero(model.terminal).tolist())

    def _entry(self, keyword: str, places: Sequence[str], value: float) -> str:
        return f"{keyword}: {' : '.join(places)} {': ' if self.joint else ''}{value!r}"

    def _transitions(self) -> Iterator[str]:
        yield self._entry("T", "***", 0.0)
        for row, end, chance in _entries(self.model.transition_rows):
            action, state = divmod(row, self.model.n_states)
            yield self._entry(
                "T", (self.actions[action], self.states[state], self.states[end]), chance
            )

    def _observations(self) -> Iterator[str]:
        assert self.observations is not None
        rows, n_states = self.model.observation_rows, self.model.n_states
        every_action = _repeats(rows, n_states)
        yield self._entry("O", "***", 0.0)
        for row, seen, chance in _entries(rows[:n_states] if every_action else rows):
            action, state = divmod(row, n_states)
            word = "*" if every_action else self.actions[action]
            yield self._entry("O", (word, self.states[state], self.observations[seen]), chance)

    def _rewards(self) -> Iterator[str]:
        """Yield the non-zero rewards, and the first one: it names the axes of an empty table."""
        words = [self.actions, self.states, self.states, self.observations or ["*"]]
        depth = 3 if self.observations is None else 4
        yield self._entry("R", "****"[:depth], 0.0)
        if isinstance(self.reward, csr_array):
            for row, end, value in _entries(self.reward):
                action, state = divmod(row, self.model.n_states)
                places = [self.actions[action], self.states[state], self.states[end], "*"]
                yield self._entry("R", places[:depth], value)
            return
        table = self.reward
        kept = table != 0
        kept.flat[0] |= not kept.any()
        spoken = [
            word if size > 1 else ["*"] for word, size in zip(words, table.shape, strict=True)
        ]
        for place, value in zip(
            np.argwhere(kept).tolist(), (table[kept] + 0.0).tolist(), strict=True
        ):
            places = [word[index] for word, index in zip(spoken, place, strict=True)]
            yield self._entry("R", places[:depth], value)


def _reward(model: TabularModel, plain: bool) -> FloatArray | csr_array:
    """Return the rewards to write; where the state is observed, o is s' and leaves the table."""
    reward = model._reward
    if isinstance(reward, csr_array):
        return reward
    if plain and reward.shape[3] > 1:
        end = np.arange(model.n_states)
        return reward[:, :, end % reward.shape[2], end][..., None]
    if reward.shape[3] > 1 and reward.size > MAX_ENTRIES:
        raise ValueError(f"{reward.size:,} rewards over observations, the limit is {MAX_ENTRIES:,}")
    return reward


def _entries(rows: csr_array) -> Iterator[tuple[int, int, float]]:
    """Yield row, column and value of every non-zero entry."""
    counts = np.diff(rows.indptr)
    row = np.repeat(np.arange(counts.size), counts)
    kept = rows.data != 0
    yield from zip(
        row[kept].tolist(), rows.indices[kept].tolist(), rows.data[kept].tolist(), strict=True
    )


def _repeats(rows: csr_array, n_states: int) -> bool:
    """Whether the rows of every action are those of the first."""
    first = rows[:n_states]
    starts = range(0, rows.shape[0], n_states)
    return all(
        np.array_equal(getattr(part, name), getattr(first, name))
        for part in (rows[start : start + n_states] for start in starts)
        for name in ("indptr", "indices", "data")
    )


def _legal(names: Sequence[str]) -> bool:
    """Whether the format can hold the names."""
    return len(set(names)) == len(names) and all(
        _IDENTIFIER.fullmatch(name) and name not in _RESERVED for name in names
    )


def _listed(names: Sequence[str]) -> str:
    """Return the names, or their count."""
    return " ".join(names) if _legal(names) else str(len(names))


def _words(names: Sequence[str]) -> Sequence[str]:
    """Return the word of each index: its name, or the index in digits."""
    return names if _legal(names) else [str(k) for k in range(len(names))]


def _joint_words(names: Sequence[Sequence[str]]) -> Sequence[str]:
    """Return the words of each joint index, row-major, the first agent's first."""
    joint: Sequence[str] = [""]
    for words in map(_words, names):
        joint = [f"{before} {word}".strip() for before in joint for word in words]
    return joint
