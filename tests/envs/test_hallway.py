import os
from pathlib import Path

import numpy as np
import pytest

import bnprl_envs
from bnprl_envs.benchmarks.hallway import EAST, NORTH, SOUTH, WEST, hallway
from bnprl_envs.planning import mdp_value, random_value

REFERENCE = Path(os.environ.get("BNPRL_REFERENCE_MODELS", "")) / "Hallway.pomdp"
STAY, FORWARD, RIGHT, AROUND, LEFT = range(5)


def row(table, index):
    """Return the non-zero entries of a row."""
    values = table[index]
    return {int(k): pytest.approx(values[k], abs=1e-12) for k in np.flatnonzero(values)}


@pytest.mark.parametrize(
    ("resetting", "random", "mdp"),
    [(False, 0.042233, 0.643651), (True, 0.043907, 1.535781)],
)
def test_golden_values(resetting, random, mdp):
    model = hallway(resetting)
    assert random_value(model) == pytest.approx(random, abs=2e-5)
    assert model.start @ mdp_value(model) == pytest.approx(mdp, abs=2e-5)


def test_sizes_start_and_terminal_states():
    model = hallway()
    assert (model.n_states, model.n_actions, model.n_observations) == (60, 5, 21)
    assert model.discount == 0.95
    np.testing.assert_allclose(model.start, [1 / 56] * 56 + [0] * 4)
    assert np.flatnonzero(model.terminal).tolist() == [56, 57, 58, 59]
    assert not hallway(resetting=True).terminal.any()


def test_forward_in_the_open_and_against_walls():
    forward = hallway().transition[FORWARD]
    # Cell 2 facing east: 3 ahead, a room (11) on the right, a wall on the left, 1 behind.
    state = 4 * 2 + EAST
    assert row(forward, state) == {
        4 * 3 + EAST: 0.8,
        4 * 11 + SOUTH: 0.05,
        4 * 1 + WEST: 0.025,
        4 * 1 + EAST: 0.025,
        state: 0.05 + 0.05,
    }
    # Cell 0 facing north: only its right, cell 1, is open.
    assert row(forward, NORTH) == {4 * 1 + EAST: 0.05, NORTH: 0.95}


def test_turns():
    transition = hallway().transition
    assert row(transition, (STAY, 0)) == {NORTH: 1.0}
    assert row(transition, (RIGHT, 0)) == {NORTH: 0.1, EAST: 0.7, SOUTH: 0.1, WEST: 0.1}
    assert row(transition, (AROUND, 0)) == {NORTH: 0.1, EAST: 0.15, SOUTH: 0.6, WEST: 0.15}
    assert row(transition, (LEFT, 0)) == {NORTH: 0.1, EAST: 0.1, SOUTH: 0.1, WEST: 0.7}


def test_observations():
    observation = hallway().observation
    # Cell 1 facing east: open ahead and behind, walls right and left.
    seen = observation[0, 4 * 1 + EAST]
    assert seen[0b0101] == pytest.approx(0.95 * 0.9 * 0.95 * 0.9)
    assert seen[0b1111] == pytest.approx(0.05 * 0.9 * 0.05 * 0.9)
    assert seen[16:].sum() == 0
    for cell, landmark in zip((2, 4, 6, 8), range(16, 20), strict=True):
        assert row(observation, (3, 4 * cell + SOUTH)) == {landmark: 1.0}
    assert row(observation, (FORWARD, 57)) == {20: 1.0}


def test_unreachable_goal_states():
    model = hallway(resetting=True)
    reached = model.transition.sum(axis=(0, 1)) > 0
    reached |= model.start > 0
    assert np.flatnonzero(~reached).tolist() == [57, 59]


def test_reward_on_entry_only():
    for resetting in (False, True):
        model = hallway(resetting)
        entering = model.transition[:, :, 56:].sum(axis=2)
        entering[:, 56:] = 0
        np.testing.assert_allclose(model.expected_reward, entering, atol=1e-12)


@pytest.mark.skipif(not REFERENCE.is_file(), reason="BNPRL_REFERENCE_MODELS has no Hallway.pomdp")
def test_equals_the_reference_file():
    file, model = bnprl_envs.read_model(REFERENCE), hallway(resetting=True)
    for table in ("transition", "observation", "start", "expected_reward"):
        np.testing.assert_allclose(
            getattr(model, table), getattr(file, table), rtol=0, atol=2e-5, err_msg=table
        )
    np.testing.assert_array_equal(model.support_reward, file.support_reward)
    assert file.discount == model.discount
