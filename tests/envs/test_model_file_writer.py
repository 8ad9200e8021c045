"""Models written to files come back."""

import math
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.model_files import write_model
from tests.envs.model_file_cases import (
    assert_equal,
    round_trip,
)


class TestWriter:
    MODEL = TabularModel(
        transition=[[[0.5, 0.5], [0, 1]], [[1, 0], [0, 1]]],
        observation=[[[1, 0, 0], [0, 0.25, 0.75]]] * 2,
        reward=np.reshape([1.5, 0, -2, 0], (2, 2, 1, 1)),
        start=[1, 0],
        discount=0.9,
        terminal=[False, True],
        names=Names(("here", "goal"), (("go", "stop"),), (("0", "1", "2"),), ("agent_0",)),
    )

    def test_golden_text(self, tmp_path):
        write_model(self.MODEL, tmp_path / "m.pomdp")
        assert (tmp_path / "m.pomdp").read_text() == (
            "discount: 0.9\nvalues: reward\nstates: here goal\nstart:\n1.0 0.0\nactions: go stop\n"
            "observations: 3\nE: goal\nT: * : * : * 0.0\nT: go : here : here 0.5\n"
            "T: go : here : goal 0.5\nT: go : goal : goal 1.0\nT: stop : here : here 1.0\n"
            "T: stop : goal : goal 1.0\nO: * : * : * 0.0\nO: * : here : 0 1.0\n"
            "O: * : goal : 1 0.25\nO: * : goal : 2 0.75\nR: * : * : * : * 0.0\n"
            "R: go : here : * : * 1.5\nR: stop : here : * : * -2.0\n"
        )

    def test_golden_joint_text(self, tmp_path):
        model = TabularModel(
            np.ones((2, 1, 1)), np.ones((2, 1, 1)), np.full(1, 2.0), [1], 1.0, None, (1, 2), (1, 1)
        )
        write_model(model, tmp_path / "m.dpomdp")
        assert (tmp_path / "m.dpomdp").read_text() == (
            "agents: 2\ndiscount: 1.0\nvalues: reward\nstates: 1\nstart:\n1.0\n"
            "actions:\n1\n2\nobservations:\n1\n1\nT: * : * : * : 0.0\n"
            "T: 0 0 : 0 : 0 : 1.0\nT: 0 1 : 0 : 0 : 1.0\nO: * : * : * : 0.0\n"
            "O: * : 0 : 0 0 : 1.0\nR: * : * : * : * : 0.0\nR: * : * : * : * : 2.0\n"
        )

    @pytest.mark.parametrize("name", ["m.pomdp", "m.POMDP", "m.dpomdp"])
    def test_round_trip(self, tmp_path, name):
        again = round_trip(self.MODEL, tmp_path / name)
        assert_equal(again, self.MODEL)
        assert again.names == self.MODEL.names
        assert os.listdir(tmp_path) == [name]

    def test_illegal_names_become_counts(self, tmp_path):
        names = Names(("a b", "c"), (("go", "T"),), (("x", "y-1.z", "w_"),), ("agent_0",))
        again = round_trip(self.MODEL.replace(names=names), tmp_path / "m.pomdp")
        assert again.names.states == ("0", "1")
        assert again.names.actions == (("0", "1"),)
        assert again.names.observations == (("x", "y-1.z", "w_"),)

    @pytest.mark.parametrize("shape", [(1, 1, 1, 1), (2, 1, 1, 1), (1, 2, 2, 1), (2, 2, 2, 3)])
    def test_empty_rewards_keep_their_axes(self, tmp_path, shape):
        model = self.MODEL.replace(reward=np.zeros(shape))
        assert_equal(round_trip(model, tmp_path / "m.pomdp"), model)

    def test_sparse_reward(self, tmp_path):
        model = self.MODEL.replace(reward=csr_array(([3.0], ([2], [0])), shape=(4, 2)))
        again = round_trip(model, tmp_path / "m.pomdp")
        np.testing.assert_array_equal(again.reward, model.reward)

    def test_suffix(self, tmp_path):
        with pytest.raises(ValueError, match=r"must be \.pomdp or \.dpomdp"):
            write_model(self.MODEL, tmp_path / "m.txt")
        two = TabularModel(np.ones((2, 1, 1)), None, np.zeros(1), [1], 1.0, None, (1, 2))
        with pytest.raises(ValueError, match=r"2 agents need the suffix \.dpomdp"):
            write_model(two, tmp_path / "m.pomdp")
        assert not os.listdir(tmp_path)

    def test_failure_leaves_the_old_file(self, tmp_path, monkeypatch):
        path = tmp_path / "m.pomdp"
        path.write_text("old")
        monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
        with pytest.raises(OSError, match="full"):
            write_model(self.MODEL, path)
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["m.pomdp"]


@st.composite
def models(draw):
    """Random models of one to three agents, some fully observed, rewards over any axes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n_agents = draw(st.integers(1, 3))
    sizes = st.tuples(*[st.integers(1, 3)] * n_agents)
    actions, observations, n_states = draw(sizes), draw(sizes), draw(st.integers(1, 5))
    n_actions, n_observations = math.prod(actions), math.prod(observations)
    plain = draw(st.booleans())

    def rows(*shape):
        table = rng.random(shape) * (rng.random(shape) < 0.6)
        table[..., -1] += 1e-3
        return table / table.sum(axis=-1, keepdims=True)

    seen = n_states if plain else n_observations
    full = (n_actions, n_states, n_states, 1 if plain else seen)
    shape = [size if draw(st.booleans()) else 1 for size in full]
    return TabularModel(
        transition=rows(n_actions, n_states, n_states),
        observation=None if plain else rows(n_actions, n_states, seen),
        reward=rng.normal(size=shape) * (rng.random(shape) < 0.7),
        start=rows(n_states),
        discount=draw(st.floats(0.01, 1.0)),
        action_sizes=actions,
        observation_sizes=(n_states,) if plain else observations,
    )


@given(models())
@settings(max_examples=100, deadline=None)
def test_round_trip_of_random_models(tmp_path_factory, model):
    path = tmp_path_factory.getbasetemp() / "random.dpomdp"
    again = round_trip(model, path)
    assert_equal(again, model)
    np.testing.assert_array_equal(again.transition, model.transition)
    np.testing.assert_array_equal(again.observation, model.observation)
    assert again.names == model.names
    write_model(again, path.with_name("random2.dpomdp"))
    if np.array_equal(again.start, model.start):
        assert path.with_name("random2.dpomdp").read_text() == path.read_text()
