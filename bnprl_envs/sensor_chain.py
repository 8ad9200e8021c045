"""The Markov chain that memoryless policies make of a model.

What a memoryless policy does next depends on the last observation, which depends on the last
action and on where it led. A *node* is a state with one distribution of observations: (a, s')
and (a', s') are the same node where O(a, s', .) = O(a', s', .), so that most models have one
node a state. With q(a | y) = sum_o O(o | y) pi(a | o), the value of the nodes solves

    h(y) = sum_a q(a | y) u(a, s_y),    u(a, s) = r(a, s) + discount sum_y' M(a, s, y') h(y').
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu

from bnprl_envs.model import TabularModel
from bnprl_envs.tables import FloatArray

IntArray = npt.NDArray[np.int64]


class SensorChain(NamedTuple):
    """A model seen through its Y nodes.

    Attributes:
        state: (Y,) state of each node.
        sensor: (Y, O) sparse, distribution of the joint observation at each node.
        moves: (A * S, Y) sparse, distribution of the next node; row a * S + s.
        reward: (A, S) expected rewards.
        start: (S,) distribution of the first state, where the null observation is seen.
    """

    state: IntArray
    sensor: csr_array
    moves: csr_array
    reward: FloatArray
    start: FloatArray


class Solution(NamedTuple):
    """The exact value of a memoryless policy, with what its gradient needs.

    Attributes:
        value: at the start.
        action_values: (A, S), u.
        visits: (Y,) expected discounted number of visits to each node.
    """

    value: float
    action_values: FloatArray
    visits: FloatArray


def sensor_chain(model: TabularModel) -> SensorChain:
    """Return the nodes of a model.

    Raises:
        ValueError: the model is fully observed, so that its first observation is the state.
    """
    if model.fully_observed:
        raise ValueError("model: fully observed, where mdp_value is exact; must be a POMDP")
    action, _, end = model.support
    seen = model.observation_rows
    pairs, pair_of_entry = np.unique(action * model.n_states + end, return_inverse=True)
    known: dict[tuple[int, bytes, bytes], int] = {}
    node_of_pair = np.empty(pairs.size, dtype=np.int64)
    first_pair: list[int] = []
    for k, pair in enumerate(pairs.tolist()):
        row = slice(seen.indptr[pair], seen.indptr[pair + 1])
        key = (pair % model.n_states, seen.indices[row].tobytes(), seen.data[row].tobytes())
        node_of_pair[k] = known.setdefault(key, len(known))
        if node_of_pair[k] == len(first_pair):
            first_pair.append(pair)
    moves = csr_array(
        (model.transition_rows.data, node_of_pair[pair_of_entry], model.transition_rows.indptr),
        shape=(model.n_actions * model.n_states, len(known)),
    )
    nodes = np.array(first_pair, dtype=np.int64)
    return SensorChain(
        nodes % model.n_states, csr_array(seen[nodes]), moves, model.expected_reward, model.start
    )


def solve_chain(chain: SensorChain, policy: FloatArray, discount: float) -> Solution:
    """Solve the linear systems of a stochastic joint policy.

    Args:
        chain: the nodes.
        policy: (O + 1, A), pi(a | o); the last row is for the null observation.
        discount: in [0, 1).
    """
    n_actions, n_states = chain.reward.shape
    n_nodes = chain.state.size
    acts = chain.sensor @ policy[:-1]
    rows = np.arange(n_actions) * n_states + chain.state[:, None]
    weights = csr_array(
        (acts.ravel(), rows.ravel(), np.arange(n_nodes + 1) * n_actions),
        shape=(n_nodes, n_actions * n_states),
    )
    weights.eliminate_zeros()
    system: Any = splu(csc_array(eye_array(n_nodes) - discount * (weights @ chain.moves)))
    value = system.solve(weights @ chain.reward.ravel())
    action_values = chain.reward + discount * (chain.moves @ value).reshape(chain.reward.shape)
    first = np.multiply.outer(policy[-1], chain.start)
    return Solution(
        float(np.sum(first * action_values)),
        action_values,
        system.solve(discount * (first.ravel() @ chain.moves), trans="T"),
    )
