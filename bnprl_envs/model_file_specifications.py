"""What a model file says about one table, kept as it is said: the newest statement wins.

A statement gives one number to a cell or, through wildcards, to a whole block of cells. Blocks are
never written out while a file is read. They are grouped by the axes that they name (a pattern),
and the value of a cell is that of the newest statement among the patterns, at most 16 for one
agent. Nothing here grows with a wildcard, so `T: * : * : * 0` costs as much as one entry.
"""

from __future__ import annotations

import math
import operator
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from bnprl_envs.model_file_tokens import ModelFileError
from bnprl_envs.tables import FloatArray

IntArray = npt.NDArray[np.int64]

MAX_ENTRIES = 2**24
"""Largest number of non-zero entries of a table that a file may give (1.5 GiB while it is read)."""

MAX_LOOKUPS = 2**30
"""Largest number of lookups (cells times patterns) that evaluating a table may take."""

CHUNK = 2**20
"""Cells evaluated at a time, to bound memory."""


@dataclass
class _Pattern:
    """Statements that name the same axes: flat index over those axes, value and age of each."""

    keys: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    orders: array[int] = field(default_factory=lambda: array("q"))


@dataclass(frozen=True, eq=False)
class _Layer:
    """A pattern at the end of the file: its newest statement for each key, sorted by key."""

    named: tuple[int, ...]
    keys: IntArray
    values: FloatArray
    orders: IntArray


class Specifications:
    """The statements about one table.

    Args:
        sizes: length of each axis of the table; a cell's flat index is row-major over them. Their
            product must fit 63 bits.
        error: makes the error of a reason and a line.
    """

    def __init__(self, sizes: Sequence[int], error: Callable[[str, int], ModelFileError]) -> None:
        self.sizes = tuple(sizes)
        strides = accumulate(reversed(self.sizes[1:]), operator.mul, initial=1)
        self._strides = tuple(strides)[::-1]
        self._error = error
        self._patterns: dict[tuple[int, ...], _Pattern] = {}
        self._line_of_order = array("q")
        self._n_entries = 0

    def set_block(self, prefix: Sequence[int | None], value: float, line: int) -> None:
        """Give one value to every cell whose first indices are `prefix`; None stands for all."""
        named, key = self._locate(prefix)
        pattern = self._patterns.get(named) or self._patterns.setdefault(named, _Pattern())
        pattern.keys.append(key)
        pattern.values.append(value)
        pattern.orders.append(len(self._line_of_order))
        self._line_of_order.append(line)

    def set_entries(
        self, prefix: Sequence[int | None], offsets: IntArray, values: FloatArray, line: int
    ) -> None:
        """Give values to some cells of the block of `prefix`.

        Args:
            prefix: first indices; None stands for all.
            offsets: (n,) distinct flat indices over the remaining axes.
            values: (n,) values.
            line: line of the statement.

        Raises:
            ModelFileError: more than `MAX_ENTRIES` entries are given.
        """
        if not offsets.size:
            return
        named, key = self._locate(prefix)
        named += tuple(range(len(prefix), len(self.sizes)))
        pattern = self._patterns.setdefault(named, _Pattern())
        self._n_entries += offsets.size
        if self._n_entries > MAX_ENTRIES:
            raise self._too_many(self._n_entries, line)
        block = math.prod(self.sizes[len(prefix) :])
        pattern.keys.frombytes((key * block + offsets).astype(np.int64).tobytes())
        pattern.values.frombytes(values.astype(np.float64).tobytes())
        order = len(self._line_of_order)
        pattern.orders.frombytes(np.full(offsets.size, order, dtype=np.int64).tobytes())
        self._line_of_order.append(line)

    def values(self, cells: IntArray) -> FloatArray:
        """Return the values of cells given by flat index; 0 where nothing is said."""
        return self._newest(cells, self._layers)[0]

    def line(self, cells: IntArray) -> int | None:
        """Return the line of the newest statement in force at any of the cells, None if none."""
        order = int(self._newest(cells, self._layers)[1].max())
        return None if order < 0 else self._line_of_order[order]

    def named_axes(self) -> set[int]:
        """Return the axes that some statement names."""
        return {axis for layer in self._layers for axis in layer.named}

    def line_naming(self, axes: set[int]) -> int:
        """Return the line of the newest statement that names one of the axes."""
        layers = [layer for layer in self._layers if axes & set(layer.named)]
        return self._line_of_order[max(int(layer.orders.max()) for layer in layers)]

    def nonzero(self, first_column_axis: int) -> tuple[IntArray, FloatArray]:
        """Return the flat indices, ascending, and the values of all non-zero cells.

        Args:
            first_column_axis: axes from this one on are the columns; rows filled whole by a
                wildcard and then cleared whole cost nothing.

        Raises:
            ModelFileError: wildcards fill more than `MAX_ENTRIES` cells.
        """
        whole: list[_Layer] = []
        parted: list[_Layer] = []
        for layer in self._layers:
            in_rows = max(layer.named, default=-1) < first_column_axis
            (whole if in_rows else parted).append(layer)
        columns = math.prod(self.sizes[first_column_axis:])
        rows = np.arange(math.prod(self.sizes[:first_column_axis])) * columns
        fill, order = self._newest(rows, whole)
        counts = [(int(np.count_nonzero(fill)) * columns, int(order.max()))]
        for layer in parted:
            size = int(np.count_nonzero(layer.values)) * self._block_size(layer)
            counts.append((size, int(layer.orders.max())))
        total = sum(count for count, _ in counts)
        if total > MAX_ENTRIES:
            raise self._too_many(total, self._line_of_order[max(counts)[1]])
        parts = [(rows[fill != 0, None] + np.arange(columns)).ravel()]
        parts += [self._cells(layer) for layer in parted]
        cells = np.sort(np.concatenate(parts))
        cells = cells[np.diff(cells, prepend=-1) > 0]
        values = self.values(cells)
        return cells[values != 0], values[values != 0]

    def _locate(self, prefix: Sequence[int | None]) -> tuple[tuple[int, ...], int]:
        """Return the axes that `prefix` names and the flat index over them."""
        named: tuple[int, ...] = ()
        key = 0
        for axis, index in enumerate(prefix):
            if index is not None:
                named += (axis,)
                key = key * self.sizes[axis] + index
        return named, key

    @cached_property
    def _layers(self) -> list[_Layer]:
        return [_settle(named, pattern) for named, pattern in self._patterns.items()]

    def _newest(self, cells: IntArray, layers: list[_Layer]) -> tuple[FloatArray, IntArray]:
        """Return value and age of the newest statement at each cell; 0 and -1 where none."""
        if cells.size * len(layers) > MAX_LOOKUPS:
            raise self._error(
                f"{len(layers)} patterns of wildcards over {cells.size:,} cells are too many", 1
            )
        values = np.zeros(cells.size)
        orders = np.full(cells.size, -1, dtype=np.int64)
        for start in range(0, cells.size, CHUNK):
            part = slice(start, start + CHUNK)
            for layer in layers:
                key = self._keys(layer.named, cells[part])
                place = np.minimum(np.searchsorted(layer.keys, key), layer.keys.size - 1)
                order = np.where(layer.keys[place] == key, layer.orders[place], -1)
                newer = order > orders[part]
                values[part][newer] = layer.values[place[newer]]
                orders[part][newer] = order[newer]
        return values, orders

    def _keys(self, named: tuple[int, ...], cells: IntArray) -> IntArray:
        """Return the flat indices over the named axes of cells given over all axes."""
        key: IntArray = np.zeros_like(cells)
        for first, last in _runs(named):
            size = math.prod(self.sizes[first : last + 1])
            key = key * size + cells // self._strides[last] % size
        return key

    def _cells(self, layer: _Layer) -> IntArray:
        """Return the flat indices of all cells that the layer makes non-zero."""
        key = layer.keys[layer.values != 0]
        cells: IntArray = np.zeros_like(key)
        for axis in reversed(layer.named):
            key, index = np.divmod(key, self.sizes[axis])
            cells += index * self._strides[axis]
        for axis in self._unnamed(layer):
            steps = np.arange(self.sizes[axis]) * self._strides[axis]
            cells = (cells[:, None] + steps).ravel()
        return cells

    def _unnamed(self, layer: _Layer) -> Iterator[int]:
        return (axis for axis in range(len(self.sizes)) if axis not in layer.named)

    def _block_size(self, layer: _Layer) -> int:
        return math.prod(self.sizes[axis] for axis in self._unnamed(layer))

    def _too_many(self, count: int, line: int) -> ModelFileError:
        return self._error(f"{count:,} non-zero entries, the limit is {MAX_ENTRIES:,}", line)


def _settle(named: tuple[int, ...], pattern: _Pattern) -> _Layer:
    """Sort a pattern by key and keep the newest statement of each key."""
    keys = np.frombuffer(pattern.keys, dtype=np.int64)
    ranked = np.argsort(keys, kind="stable")
    last = np.append(np.diff(keys[ranked]) != 0, True)
    kept = ranked[last]
    return _Layer(
        named,
        keys[kept],
        np.frombuffer(pattern.values, dtype=np.float64)[kept],
        np.frombuffer(pattern.orders, dtype=np.int64)[kept],
    )


def _runs(axes: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the first and last axis of each run of neighbours: (0, 1, 3) gives (0, 1), (3, 3)."""
    runs: list[tuple[int, int]] = []
    for axis in axes:
        if runs and runs[-1][1] == axis - 1:
            runs[-1] = (runs[-1][0], axis)
        else:
            runs.append((axis, axis))
    return runs
