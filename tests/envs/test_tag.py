import os
from pathlib import Path

import numpy as np
import pytest

import bnprl_envs
from bnprl_envs.benchmarks.tag import CATCH, EAST, NORTH, SOUTH, WEST, tag
from bnprl_envs.planning import mdp_value, random_value

REFERENCE = Path(os.environ.get("BNPRL_REFERENCE_MODELS", "")) / "TagAvoid.pomdp"
ANOMALIES = ((19, 19), (25, 23), (27, 24), (27, 27))
"""(robot, opponent) where the reference file departs from the rule, under each of four moves."""


def state(robot, opponent):
    return 30 * robot + opponent


def opponents(model, action, robot, opponent):
    """Return the robot's end cell and the opponent's distribution."""
    values = model.transition[action, state(robot, opponent)].reshape(29, 30)
    (end,) = np.flatnonzero(values.sum(axis=1))
    return int(end), {int(k): pytest.approx(values[end, k]) for k in np.flatnonzero(values[end])}


@pytest.mark.parametrize(("resetting", "random"), [(False, -53.760587), (True, -54.225602)])
def test_golden_values(resetting, random):
    model = tag(resetting)
    assert random_value(model) == pytest.approx(random, abs=1e-6)
    assert model.start @ mdp_value(model) == pytest.approx(2.154262, abs=1e-6)


def test_sizes_start_and_terminal_states():
    model = tag()
    assert (model.n_states, model.n_actions, model.n_observations) == (870, 5, 30)
    assert model.terminal.sum() == 29
    assert model.terminal[29::30].all()
    np.testing.assert_allclose(model.start[~model.terminal], 1 / 841)
    assert not tag(resetting=True).terminal.any()


def test_the_opponent_flees_from_the_cell_that_the_robot_leaves():
    model = tag()
    # Robot (0, 0), opponent (6, 1): away is east and north.
    assert opponents(model, EAST, 0, 16) == (1, {16: 0.2, 17: 0.4, 21: 0.4})
    # Level in y: north and south share, and south is a wall.
    assert opponents(model, WEST, 3, 5) == (2, {5: 0.4, 6: 0.4, 15: 0.2})
    # The same cell: all four ways alike, wherever the robot goes.
    assert opponents(model, NORTH, 16, 16) == (21, dict.fromkeys((6, 15, 16, 17, 21), 0.2))
    # A corner: both ways away are blocked.
    assert opponents(model, SOUTH, 1, 0) == (1, {0: 0.2 + 0.4 + 0.2, 10: 0.2})


def test_catching():
    model = tag()
    assert opponents(model, CATCH, 7, 7) == (7, {29: 1.0})
    assert opponents(model, CATCH, 7, 8) == (7, {8: 1.0})  # the opponent holds still
    assert opponents(model, NORTH, 7, 29) == (7, {29: 1.0})


@pytest.mark.parametrize("resetting", [False, True])
def test_rewards(resetting):
    reward = tag(resetting).expected_reward
    assert reward[NORTH, state(3, 4)] == -1
    assert reward[CATCH, state(3, 4)] == -10
    assert reward[CATCH, state(3, 3)] == 10
    assert reward[CATCH, state(3, 29)] == 0
    assert reward[EAST, state(3, 29)] == (-1 if resetting else 0)


def test_observations():
    observation = tag().observation
    assert observation[NORTH, state(4, 4), 29] == 1
    assert observation[NORTH, state(4, 5), 4] == 1
    assert observation[CATCH, state(4, 4), 4] == 1
    assert observation[SOUTH, state(4, 29), 4] == 1


@pytest.mark.skipif(not REFERENCE.is_file(), reason="BNPRL_REFERENCE_MODELS has no TagAvoid.pomdp")
def test_equals_the_reference_file_but_for_its_errors():
    file, model = bnprl_envs.read_model(REFERENCE), tag(resetting=True)
    differs = np.abs(model.transition - file.transition).max(axis=2) > 1e-6
    found = {(int(action), divmod(int(s), 30)) for action, s in np.argwhere(differs)}
    assert found == {(action, pair) for action in range(4) for pair in ANOMALIES}
    for table in ("observation", "start", "expected_reward"):
        np.testing.assert_allclose(
            getattr(model, table), getattr(file, table), rtol=0, atol=1e-6, err_msg=table
        )
    assert file.discount == model.discount
