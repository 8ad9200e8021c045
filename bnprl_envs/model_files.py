"""Model files: Cassandra's `.POMDP` and MADP's `.dpomdp`, read and written.

Sources: the grammar of pomdp-solve (A. R. Cassandra, `src/mdp/parser.y`) and MADP's
`example.dpomdp` (M. T. J. Spaan and F. A. Oliehoek). The last statement about an entry wins,
unspecified entries are 0, and probability rows may be off 1 by `SUM_TOLERANCE`; they are then
normalised. zmdp's line `E: <states>` names terminal states.

A file without an `observations:` line is a fully observed model (Cassandra's MDP form, rewards
`R: a : s : s' v`), whose observations are named as its states. A file that has the line is not,
even where its observation matrix is the identity.

Files may come from anywhere: counts, fills by wildcards and tables are bounded (`MAX_SIZE`,
`MAX_ROWS`, `MAX_ENTRIES`), and memory grows with the file and with the non-zero entries, never
with S * S.
"""

from __future__ import annotations

import math
import os

import numpy as np
from scipy.sparse import csr_array

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.model_file_body import Table, read_body
from bnprl_envs.model_file_preamble import Header, Item, read_preamble
from bnprl_envs.model_file_specifications import MAX_ENTRIES
from bnprl_envs.model_file_tokens import ModelFileError, Tokens
from bnprl_envs.model_file_writer import write_model
from bnprl_envs.tables import SUM_TOLERANCE, BoolArray, FloatArray

MAX_DENSE_REWARDS = 2**22
"""Largest table of rewards over (A, S, S') that is kept dense."""

__all__ = ["ModelFileError", "read_model", "write_model"]


def read_model(path: str | os.PathLike[str]) -> TabularModel:
    """Read a `.POMDP` or `.dpomdp` file; an `agents:` line, not the suffix, tells which.

    Rewards keep a single entry along the axes that no statement names. Where a table over
    (A, S, S') would exceed `MAX_DENSE_REWARDS`, they are kept for the possible transitions only.

    Args:
        path: the file.

    Returns:
        The model, its rows normalised.

    Raises:
        ModelFileError: the file is malformed or too large; says where and why.
        OSError: the file cannot be opened.
    """
    with open(path, encoding="utf-8-sig") as file:
        tokens = Tokens(path, file)
        header, terminal, following = read_preamble(tokens)
        tables, more_terminal = read_body(tokens, header, following)
    return _model(tokens, header, tables, [*terminal, *more_terminal])


def _model(
    tokens: Tokens, header: Header, tables: dict[str, Table], terminal: list[Item]
) -> TabularModel:
    transition = _rows(tokens, tables["T"])
    observation = _rows(tokens, tables["O"]) if "O" in tables else None
    reward = _reward(tokens, header, tables["R"], transition)
    seen = header.observations or (header.states,)
    names = Names(
        states=header.states.names,
        actions=tuple(labels.names for labels in header.actions),
        observations=tuple(labels.names for labels in seen),
        agents=header.agents,
    )
    try:
        return TabularModel(
            transition=transition,
            observation=observation,
            reward=reward,
            start=header.start,
            discount=header.discount,
            terminal=_terminal(tokens, header, terminal),
            action_sizes=tuple(map(len, names.actions)),
            observation_sizes=tuple(map(len, names.observations)),
            names=names,
        )
    except ModelFileError:
        raise
    except ValueError as error:  # what is left to go wrong are the rules of terminal states
        line = terminal[0].line if terminal else tokens.line
        raise tokens.error(str(error), line) from None


def _rows(tokens: Tokens, table: Table) -> csr_array:
    """Return T or O as sparse rows, (A * S, S) or (A * S, O).

    Raises:
        ModelFileError: a row does not sum to 1.
    """
    columns = table.slots[-1].size
    n_rows = math.prod(slot.size for slot in table.slots[:-1])
    cells, values = table.specifications.nonzero(
        len(table.specifications.sizes) - len(table.slots[-1].labels)
    )
    row = cells // columns
    sums = np.bincount(row, weights=values, minlength=n_rows)
    off = np.abs(sums - 1) > SUM_TOLERANCE
    if off.any():
        raise _row_error(tokens, table, int(np.argmax(off)), sums[np.argmax(off)])
    starts = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n_rows))])
    return csr_array((values, cells % columns, starts), shape=(n_rows, columns))


def _row_error(tokens: Tokens, table: Table, row: int, total: float) -> ModelFileError:
    """Return the error of a row that does not sum to 1, at the last line that has a say in it."""
    columns = table.slots[-1].size
    line = table.specifications.line(row * columns + np.arange(columns))
    place = np.unravel_index(row, [size for slot in table.slots[:-1] for size in slot.sizes])
    labels = [labels for slot in table.slots[:-1] for labels in slot.labels]
    words = [each.names[int(index)] for each, index in zip(labels, place, strict=True)]
    name = f"row of action {' '.join(words[:-1])!r}, state {words[-1]!r}"
    if line is None:
        return tokens.error(f"{table.keyword}: the {name} is not specified")
    return tokens.error(
        f"{table.keyword}: the {name} sums to {total:.9g}, must be 1 within {SUM_TOLERANCE:g}",
        line,
    )


def _reward(
    tokens: Tokens, header: Header, table: Table, transition: csr_array
) -> FloatArray | csr_array:
    """Return the rewards: dense over the named axes, else sparse (A * S, S) on the support.

    Raises:
        ModelFileError: too many, and the observation matters.
    """
    specifications = table.specifications
    sizes = [slot.size for slot in table.slots]
    axes = _slot_axes(table)
    named = [bool(specifications.named_axes() & those) for those in axes]
    shape = [size if name else 1 for size, name in zip(sizes, named, strict=True)]
    n_observations = math.prod(sizes[3:])
    observed = math.prod(shape[3:]) > 1
    if math.prod(shape) <= (MAX_ENTRIES if observed else MAX_DENSE_REWARDS):
        cells = np.zeros(1, dtype=np.int64)
        for k, size in enumerate(shape):
            steps = np.arange(size) * math.prod(sizes[k + 1 :])
            cells = (cells[:, None] + steps).ravel()
        values = specifications.values(cells)
        return (header.sign * values + 0.0).reshape(shape + [1] * (4 - len(shape)))
    if observed:
        raise tokens.error(
            f"R: {math.prod(shape):,} rewards over observations, the limit is {MAX_ENTRIES:,}",
            specifications.line_naming(axes[3]),
        )
    counts = np.diff(transition.indptr)
    row = np.repeat(np.arange(counts.size, dtype=np.int64), counts)
    cells = (row * transition.shape[1] + transition.indices) * n_observations
    values = header.sign * specifications.values(cells)
    rewards = transition.copy()
    rewards.data = values
    rewards.eliminate_zeros()
    return rewards


def _slot_axes(table: Table) -> list[set[int]]:
    """Return the axes that belong to each slot."""
    axes, first = [], 0
    for slot in table.slots:
        axes.append(set(range(first, first + len(slot.labels))))
        first += len(slot.labels)
    return axes


def _terminal(tokens: Tokens, header: Header, items: list[Item]) -> BoolArray:
    """Return (S,) flags of the states on the `E:` lines."""
    words = [each for item in items for each in item.words]
    flags = np.full(len(header.states.names), any(word == "*" for _, word in words))
    for line, word in words:
        try:
            if word != "*":
                flags[header.states.find(word)] = True
        except ValueError as error:
            raise tokens.error(f"E: {error}", line) from None
    return flags
