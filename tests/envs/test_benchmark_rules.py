"""The rules of the single-agent tabular benchmarks, entry by entry, and bad arguments."""

import gymnasium as gym
import numpy as np
import pytest

import bnprl_envs
from bnprl_envs.benchmarks.baird_star import (
    DASHED,
    SOLID,
    baird_star,
    star_features,
    star_initial_weights,
)
from bnprl_envs.benchmarks.cheese_maze import cheese_maze
from bnprl_envs.benchmarks.grid4x4 import grid4x4
from bnprl_envs.benchmarks.gridworld import gridworld, gridworld_positions
from bnprl_envs.benchmarks.hallway import ACTIONS, EAST, SOUTH, WEST, hallway2
from bnprl_envs.benchmarks.noisy_maze import noisy_maze_1d
from bnprl_envs.benchmarks.shuttle import shuttle
from bnprl_envs.benchmarks.three_nodes import NODE_POSITIONS, three_nodes
from bnprl_envs.benchmarks.tiger import LISTEN, OPEN_LEFT, OPEN_RIGHT, tiger
from bnprl_envs.planning import mdp_value

FORWARD = ACTIONS.index("forward")


def row(table, *index):
    """Return the non-zero entries of a row."""
    values = table[index]
    return {int(k): pytest.approx(values[k], abs=1e-12) for k in np.flatnonzero(values)}


def test_shuttle():
    turn, forward, back = shuttle().transition
    for dock in (0, 7):
        assert [row(move, dock) for move in (turn, forward, back)] == [{1: 1}, {4: 1}, {7: 1}]
    assert [row(turn, s) for s in range(1, 7)] == [{4: 1}, {5: 1}, {6: 1}, {1: 1}, {2: 1}, {3: 1}]
    assert [row(forward, s) for s in (1, 2, 3)] == [{1: 1}, {1: 1}, {2: 1}]
    assert [row(forward, s) for s in (4, 5, 6)] == [{5: 1}, {6: 1}, {6: 1}]
    assert [row(back, s) for s in (1, 2, 3)] == [
        {2: 0.3, 1: 0.4, 4: 0.3},
        {3: 0.8, 2: 0.1, 6: 0.1},
        {0: 0.7, 3: 0.3},
    ]
    assert [row(back, s) for s in (4, 5, 6)] == [
        {7: 0.7, 4: 0.3},
        {4: 0.8, 5: 0.1, 1: 0.1},
        {5: 0.3, 6: 0.4, 3: 0.3},
    ]
    seen = [{4: 1}, {1: 1}, {1: 0.7, 3: 0.3}, {3: 1}, {3: 1}, {0: 0.7, 3: 0.3}, {0: 1}, {2: 1}]
    assert [row(shuttle().observation, 1, s) for s in range(8)] == seen
    earned = {
        tuple(place): shuttle().reward[tuple(place)] for place in np.argwhere(shuttle().reward)
    }
    assert earned == {(1, 1, 1, 0): -3, (1, 6, 6, 0): -3, (2, 3, 0, 0): 10}


def test_cheese_maze():
    model = cheese_maze()
    ends = model.transition.argmax(axis=2)
    assert ends[0].tolist() == [0, 1, 2, 3, 4, 0, 2, 4, 5, 7, 10]
    assert ends[1].tolist() == [5, 1, 6, 3, 7, 8, 10, 9, 8, 9, 10]
    assert ends[2].tolist() == [1, 2, 3, 4, 4, 5, 6, 7, 8, 9, 10]
    assert ends[3].tolist() == [0, 0, 1, 2, 3, 5, 6, 7, 8, 9, 10]
    assert model.observation[2].argmax(axis=1).tolist() == [0, 1, 2, 1, 3, 4, 4, 4, 5, 5, 6]
    names = ("nw", "ns", "n", "ne", "ew", "esw")
    assert model.names.observations == ((*(f"walls-{name}" for name in names), "cheese"),)
    assert row(cheese_maze(resetting=True).transition, 1, 10) == dict.fromkeys(range(10), 0.1)


def test_grid4x4():
    model = grid4x4()
    assert model.transition.argmax(axis=2)[:, 5].tolist() == [1, 9, 6, 4]
    assert model.transition.argmax(axis=2)[:, 3].tolist() == [3, 7, 3, 2]
    assert model.observation[0].argmax(axis=1).tolist() == [0] * 15 + [1]


def test_noisy_maze():
    west, east = noisy_maze_1d(resetting=True).transition
    third = dict.fromkeys(range(3), 1 / 3)
    assert [row(west, s) for s in range(4)] == [
        {0: 0.9, 1: 0.1},
        {0: 0.9, 3: 0.1},
        {3: 0.9, 2: 0.1},
        third,
    ]
    assert [row(east, s) for s in range(4)] == [
        {0: 0.1, 1: 0.9},
        {0: 0.1, 3: 0.9},
        {3: 0.1, 2: 0.9},
        third,
    ]


def test_tiger():
    model = tiger()
    np.testing.assert_array_equal(model.transition[LISTEN], np.eye(2))
    np.testing.assert_allclose(model.observation[LISTEN], [[0.85, 0.15], [0.15, 0.85]])
    for door in (OPEN_LEFT, OPEN_RIGHT):
        np.testing.assert_array_equal(model.transition[door], 0.5)
        np.testing.assert_array_equal(model.observation[door], 0.5)
    assert model.expected_reward.tolist() == [[-1, -1], [-100, 10], [10, -100]]


def test_hallway2():
    model = hallway2()
    assert np.flatnonzero(model.terminal).tolist() == [68, 69, 70, 71]
    # Cell 16, on the eastern side of the ring, facing east: the goal ahead, cell 22 on the right.
    state = 4 * 16 + EAST
    assert row(model.transition, FORWARD, state)[4 * 17 + EAST] == 0.8
    assert row(model.transition, FORWARD, state)[4 * 22 + SOUTH] == 0.05
    # Cell 5, the north-western dead end, facing west: open behind, walls elsewhere.
    seen = model.observation[0, 4 * 5 + WEST]
    assert seen[0b1101] == pytest.approx(0.9**3 * 0.95)
    assert row(model.observation, 3, 70) == {16: 1.0}


def test_gridworld():
    model = gridworld()
    assert model.fully_observed
    assert np.flatnonzero(model.terminal).tolist() == [4]
    assert [row(model.transition, a, 20) for a in range(4)] == [
        {15: 0.9, 20: 0.1},
        {20: 1.0},
        {21: 0.9, 20: 0.1},
        {20: 1.0},
    ]
    entered = np.argwhere(model.reward[..., 0])
    assert entered.tolist() == [[0, 9, 4], [2, 3, 4]]
    # Eight moves, each of which takes effect after a geometric time.
    factor = 0.9 * 0.9 / (1 - 0.9 * 0.1)
    assert model.start @ mdp_value(model) == pytest.approx(factor**8 / 0.9)
    certain = gridworld(slip=0.0)
    assert certain.start @ mdp_value(certain) == pytest.approx(0.9**7)


def test_gridworld_positions():
    positions = gridworld_positions()
    assert positions[20].tolist() == [1, 1]
    assert positions[4].tolist() == [5, 5]
    assert gridworld_positions(2, 3).tolist() == [[1, 2], [2, 2], [3, 2], [1, 1], [2, 1], [3, 1]]


def test_a_large_gridworld_stays_sparse():
    env = gym.make("bnprl/Gridworld-v0", rows=100, columns=100)
    assert env.reset(seed=0)[0] == 9900
    observation = env.step(0)[0]
    assert observation in (9800, 9900)


def test_three_nodes():
    assert NODE_POSITIONS == (-1.0, 0.0, 1.0)
    for node in range(3):
        np.testing.assert_array_equal(three_nodes().transition[node], np.eye(3)[[node] * 3])


def test_baird_star():
    model = baird_star()
    for state in range(7):
        assert row(model.transition, SOLID, state) == {6: 1.0}
        assert row(model.transition, DASHED, state) == dict.fromkeys(range(6), 1 / 6)


def test_the_classical_features_of_the_star():
    features, weights = star_features(), star_initial_weights()
    assert features.shape == (7, 2, 15)
    values = features @ weights
    assert values[:, SOLID].tolist() == [3, 3, 3, 3, 3, 3, 12]
    assert values[:, DASHED].tolist() == [1] * 7
    assert np.linalg.matrix_rank(features.reshape(14, 15)) == 14  # so that all values 0 fit


def test_q_learning_diverges_on_the_classical_features_and_not_on_a_table():
    """Expected semi-gradient updates; the behaviour visits every state alike."""
    model = baird_star()
    behaviour = np.array([1 / 7, 6 / 7]) / 7

    def largest(features, weights, sweeps):
        for _ in range(sweeps):
            values = features @ weights
            target = 0.99 * np.einsum("ast,t->sa", model.transition, values.max(axis=1))
            error = behaviour * (target - values)
            weights = weights + 0.05 * np.einsum("sa,sad->d", error, features)
        return np.abs(weights).max()

    assert largest(star_features(), star_initial_weights(), 4000) > 1e4
    assert largest(np.eye(14).reshape(7, 2, 14), np.full(14, 10.0), 4000) <= 10.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rows": 0}, "rows: 0, must be an integer, at least 1"),
        ({"columns": -3}, "columns: -3, must be an integer, at least 1"),
        ({"rows": 5.0}, "rows: 5.0, must be an integer, at least 1"),
        ({"rows": [5]}, r"rows: \[5\], must be an integer, at least 1"),
        ({"rows": 1, "columns": 1}, "rows, columns: 1, 1, must make at least two cells"),
        ({"slip": 1.0}, r"slip: 1.0, must lie in \[0, 1\)"),
        ({"slip": -0.1}, r"slip: -0.1, must lie in \[0, 1\)"),
        ({"slip": float("nan")}, r"slip: nan, must lie in \[0, 1\)"),
        ({"slip": "0.1"}, r"slip: '0.1', must lie in \[0, 1\)"),
    ],
)
def test_bad_gridworlds(arguments, message):
    for make in (gym.make, gym.make_vec, bnprl_envs.model):
        with pytest.raises(ValueError, match=message):
            make("bnprl/Gridworld-v0", **arguments)


@pytest.mark.parametrize("name", ["CheeseMaze", "Grid4x4", "NoisyMaze1D", "Hallway", "Hallway2"])
@pytest.mark.parametrize("value", ["false", 1, None])
def test_resetting_is_true_or_false(name, value):
    with pytest.raises(ValueError, match=f"resetting: {value!r}, must be True or False"):
        gym.make(f"bnprl/{name}-v0", resetting=value)
