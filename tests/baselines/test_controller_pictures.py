"""Controllers as graphs: what their nodes did, and the command that draws them."""

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from baselines import cli
from baselines.controller_pictures import draw_controllers, usage
from baselines.q_pictures import draw_values
from bnprl_agents import LinearQ
from bnprl_agents.controllers.controller import Controller
from bnprl_envs.model import Names
from tests.agents.cases import copying_model
from tests.baselines.fakes import record

PNG = b"\x89PNG"


def copying_controller():
    """Two nodes, each doing what was seen last; the null observation begins in node 0."""
    successor = np.zeros((2, 3, 2, 2))
    successor[:, 0, :, 0] = successor[:, 1, :, 1] = successor[:, 2, :, 0] = 1.0
    return Controller(np.tile([1.0, 0.0], (3, 1)), np.eye(2), successor)


def test_usage_is_of_the_episodes_that_the_policy_acts():
    (used,) = usage(copying_model(), [copying_controller()])
    np.testing.assert_allclose(used.nodes, [0.5, 0.5], atol=0.01)
    assert used.moves.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(used.moves[0], [[0.25, 0.0], [0.25, 0.0]], atol=0.01)
    np.testing.assert_allclose(used.moves[1], [[0.0, 0.25], [0.0, 0.25]], atol=0.01)
    assert used.moves[2].sum() == 0.0


def test_a_picture_with_curves_where_there_are_records():
    model, controllers = copying_model(), [copying_controller()]
    bare = draw_controllers(model, controllers, (), "bare")
    runs = [record(steps=s, metrics={"nodes": 2.0, "exploring": 1.0 / s}) for s in (10, 20)]
    with_curves = draw_controllers(model, controllers, runs, "with curves")
    assert bare.startswith(PNG)
    assert with_curves.startswith(PNG)
    assert len(with_curves) > len(bare)


def test_names_from_outside_are_drawn_as_they_are():
    hostile = "$_$"
    names = Names(("0", "1"), ((hostile, "1"),), ((hostile, "1"),), ("agent_0",))
    model = copying_model().replace(names=names)
    assert draw_controllers(model, [copying_controller()], (), hostile).startswith(PNG)
    agent = LinearQ(Box(0.0, 1.0, (2,)), Discrete(2), discount=0.9, seed=0)
    twice = (hostile, hostile)
    picture = draw_values(agent, axes=twice, actions=twice, compass=False, title=hostile)
    assert picture.startswith(PNG)


def test_the_command_draws_controllers_of_agents_and_teams(tmp_path, capsys):
    for id, agent in (("CheeseMaze", "batch-em"), ("DecTiger", "mcem")):
        out = tmp_path / id
        sizes = ["--steps", "2000", "--eval-points", "1", "--eval-episodes", "5", "--no-progress"]
        shift = ["--reward-shift", "101"] if id == "DecTiger" else []
        train = ["train", f"bnprl/{id}-v0", "--agent", agent, "--out", str(out), *shift, *sizes]
        assert cli.main(train) == 0
        policy = out / "runs" / agent / "0.policy.npz"
        assert cli.main(["plot", str(policy)]) == 0
        assert policy.with_suffix(".png").read_bytes().startswith(PNG)
    alone = tmp_path / "alone.npz"
    alone.write_bytes(policy.read_bytes())
    capsys.readouterr()
    assert cli.main(["plot", str(alone)]) == 2
    assert "takes a known model of what they act in: give --env ID" in capsys.readouterr().err
