"""Probability tables as sparse rows: conversion, checks, normalisation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

SUM_TOLERANCE = 1e-5
"""Largest deviation from 1 of a probability row; such rows are normalised (pomdp-solve's rule)."""

DENSE_LIMIT = 2**28
"""Largest number of entries (2 GiB of doubles) that a dense view of a table may have."""


def as_rows(name: str, table: npt.ArrayLike | csr_array, n_states: int) -> csr_array:
    """Return an (A, S, X) array or a sparse (A * S, X) array as canonical sparse rows (a copy).

    Raises:
        ValueError: the shape does not fit S = `n_states`.
    """
    if isinstance(table, csr_array):
        rows = table.astype(np.float64)
        if rows.shape[0] == 0 or rows.shape[0] % n_states:
            raise ValueError(f"{name}: {rows.shape[0]} sparse rows, must be A * {n_states}")
    else:
        dense = np.asarray(table, dtype=np.float64)
        if dense.ndim != 3 or dense.shape[1] != n_states or 0 in dense.shape:
            raise ValueError(f"{name}: shape {dense.shape}, must be (A, {n_states}, ...)")
        rows = csr_array(dense.reshape(-1, dense.shape[2]))
    rows.sum_duplicates()
    rows.eliminate_zeros()
    return rows


def as_reward(
    table: npt.ArrayLike | csr_array, shape: tuple[int, int, int, int]
) -> FloatArray | csr_array:
    """Return a reward table as a four-dimensional array that broadcasts to `shape`, read-only.

    A sparse (A * S, S) array stays sparse.

    Raises:
        ValueError: the table does not broadcast to (A, S, S', O).
    """
    if isinstance(table, csr_array):
        if table.shape != (shape[0] * shape[1], shape[2]):
            raise ValueError(
                f"reward: sparse shape {table.shape}, "
                f"must be (A * S, S) = {(shape[0] * shape[1], shape[2])}"
            )
        rows = table.astype(np.float64)
        rows.sum_duplicates()
        return rows
    dense = np.array(table, dtype=np.float64)
    if dense.ndim > 4 or not _broadcasts(dense.shape, shape):
        raise ValueError(
            f"reward: shape {dense.shape} does not broadcast to (A, S, S', O) = {shape}"
        )
    return frozen(dense.reshape((1,) * (4 - dense.ndim) + dense.shape))


def as_flags(name: str, flags: npt.ArrayLike | None, size: int) -> BoolArray:
    """Return (size,) booleans, all false for None.

    Raises:
        ValueError: the shape differs.
    """
    if flags is None:
        return np.zeros(size, dtype=np.bool_)
    array = np.array(flags, dtype=np.bool_)
    if array.shape != (size,):
        raise ValueError(f"{name}: shape {array.shape}, must be ({size},)")
    return array


def identity_rows(n_actions: int, n_states: int) -> csr_array:
    """Observation rows of a fully observed model: the observation is the end state."""
    size = n_actions * n_states
    return csr_array(
        (np.ones(size), np.tile(np.arange(n_states), n_actions), np.arange(size + 1)),
        shape=(size, n_states),
    )


def check_rows(name: str, rows: csr_array, row_name: Callable[[int], str]) -> None:
    """Check that every row is a distribution.

    Raises:
        ValueError: names the first row that is not finite, has a negative entry or a sum off 1.
    """
    counts = np.diff(rows.indptr)
    for wrong, what in (
        (~np.isfinite(rows.data), "not finite"),
        (rows.data < 0, "negative"),
    ):
        if wrong.any():
            k = int(np.argmax(wrong))
            row = int(np.searchsorted(rows.indptr, k, side="right")) - 1
            raise ValueError(f"{name}{row_name(row)}: probability {rows.data[k]} is {what}")
    sums = np.bincount(
        np.repeat(np.arange(counts.size), counts), weights=rows.data, minlength=counts.size
    )
    off = np.abs(sums - 1.0) > SUM_TOLERANCE
    if off.any():
        row = int(np.argmax(off))
        raise ValueError(
            f"{name}{row_name(row)}: sums to {sums[row]:.9g}, must be 1 within {SUM_TOLERANCE:g}"
        )


def normalise_rows(rows: csr_array) -> None:
    """Divide every row by its sum, in place."""
    counts = np.diff(rows.indptr)
    rows.data /= np.repeat(divisor(np.add.reduceat(rows.data, rows.indptr[:-1]), counts), counts)


def divisor(sums: npt.ArrayLike, counts: npt.ArrayLike) -> FloatArray:
    """What to divide rows with these sums and numbers of entries by.

    A row of n entries whose sum is off 1 by no more than n rounding errors, as that of a divided
    row may be, stays as it is: normalising twice is normalising once, bit for bit.
    """
    rounding = np.asarray(counts) * np.finfo(np.float64).eps
    return np.where(np.abs(np.asarray(sums) - 1.0) <= rounding, 1.0, sums)


def check_sizes(name: str, sizes: Sequence[int], product: int) -> None:
    """Check that the sizes of the agents' spaces multiply to the joint size.

    Raises:
        ValueError: a size is below 1 or the product differs.
    """
    if min(sizes) < 1 or math.prod(sizes) != product:
        raise ValueError(f"{name}: {tuple(sizes)}, must be positive with product {product}")


def frozen(array: FloatArray) -> FloatArray:
    """Return the array, made read-only."""
    array.flags.writeable = False
    return array


def _broadcasts(shape: tuple[int, ...], target: tuple[int, ...]) -> bool:
    return all(
        size in (1, wanted) for size, wanted in zip(reversed(shape), reversed(target), strict=False)
    )
