"""Compiled sampling from sparse rows by the alias method (Walker 1977; Vose 1991).

A draw costs one uniform number and O(1) time whatever the row's length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.sparse import csr_array

from bnprl_envs.model import TabularModel
from bnprl_envs.tables import BoolArray, FloatArray

Int32Array = npt.NDArray[np.int32]
IntArray = npt.NDArray[np.int64]


class AliasTable(NamedTuple):
    """Rows of distributions ready for O(1) draws; entry k of row r is at `first[r] + k`.

    Attributes:
        first: (rows + 1,) offset of each row.
        threshold: (nnz,) chance of keeping the entry that was hit.
        alias: (nnz,) entry taken otherwise (an offset into the same arrays).
        outcome: (nnz,) what the entry stands for: a state or an observation.
    """

    first: IntArray
    threshold: FloatArray
    alias: Int32Array
    outcome: Int32Array


class ModelSampler(NamedTuple):
    """Everything that a compiled simulation of a `TabularModel` reads.

    Attributes:
        n_states: S.
        n_observations: O, which is also the null observation.
        start: one row.
        transition: rows a * S + s.
        observation: rows a * S + s'.
        reward: (nnz of transition, 1 or O), aligned with the transition's entries.
        terminal: (S,).
        informative_start: the first observation is the state (else the null observation, O).
    """

    n_states: int
    n_observations: int
    start: AliasTable
    transition: AliasTable
    observation: AliasTable
    reward: FloatArray
    terminal: BoolArray
    informative_start: bool


def model_sampler(model: TabularModel) -> ModelSampler:
    """Build the alias tables of a model."""
    return ModelSampler(
        n_states=model.n_states,
        n_observations=model.n_observations,
        start=alias_table(csr_array(model.start[None])),
        transition=alias_table(model.transition_rows),
        observation=alias_table(model.observation_rows),
        reward=model.support_reward,
        terminal=model.terminal,
        informative_start=model.fully_observed,
    )


def alias_table(rows: csr_array) -> AliasTable:
    """Build the alias table of sparse rows that each sum to 1."""
    first = rows.indptr.astype(np.int64)
    threshold, alias = _vose(first, rows.data)
    return AliasTable(first, threshold, alias, rows.indices.astype(np.int32))


@njit(cache=True)
def _vose(first, probability):  # type: ignore[no-untyped-def]
    threshold = np.ones(probability.size)
    alias = np.empty(probability.size, dtype=np.int32)
    stack = np.empty(probability.size, dtype=np.int64)
    for row in range(first.size - 1):
        begin, end = first[row], first[row + 1]
        small, large = begin, end  # two stacks that grow towards each other
        for k in range(begin, end):
            threshold[k] = probability[k] * (end - begin)
            alias[k] = k
            if threshold[k] < 1.0:
                stack[small] = k
                small += 1
            else:
                large -= 1
                stack[large] = k
        while small > begin and large < end:
            small -= 1
            poor, rich = stack[small], stack[large]
            alias[poor] = rich
            threshold[rich] -= 1.0 - threshold[poor]
            if threshold[rich] < 1.0:
                large += 1
                stack[small] = rich
                small += 1
        while small > begin:  # rounding left these short of 1
            small -= 1
            threshold[stack[small]] = 1.0
        while large < end:  # and these over it
            threshold[stack[large]] = 1.0
            large += 1
    return threshold, alias


@njit(cache=True, inline="always")
def draw(table, row, uniform):  # type: ignore[no-untyped-def]
    """Return the entry (an offset into `table.outcome`) that a uniform number in [0, 1) hits.

    Unsigned offsets spare the test for negative ones, and loading the alias before it is needed
    spares a branch: together they more than double the speed of a loop over draws.
    """
    begin = table.first[np.uint32(row)]
    size = table.first[np.uint32(row) + np.uint32(1)] - begin
    scaled = uniform * size
    k = min(int(scaled), size - 1)
    hit = np.uint32(begin + k)
    alias = np.uint32(table.alias[hit])
    return hit if scaled - k < table.threshold[hit] else alias
