"""Model files: each rule of the grammars by hand, round trips, malformed files, bounds."""

import numpy as np
import pytest

from bnprl_envs.model import TabularModel
from bnprl_envs.model_files import read_model
from tests.envs.model_file_cases import (
    BODY,
    FULLY_OBSERVED,
    JOINT,
    JOINT_BODY,
    PREAMBLE,
    assert_equal,
    failure,
    round_trip,
)


class TestPreamble:
    def test_names_counts_discount(self, read):
        model = read(PREAMBLE.replace("dark light", "3") + BODY)
        assert model.discount == 0.5
        assert model.names.states == ("left", "right")
        assert model.names.actions == (("go", "stay"),)
        assert model.names.observations == (("0", "1", "2"),)
        assert (model.action_sizes, model.observation_sizes) == ((2,), (3,))

    def test_any_order_and_line_breaks(self, read):
        text = """observations:2 actions
        : 1 # the action
        start: 0.25
        0.75 states: s0
        s1 values:cost discount:.9 T:0 identity O:* uniform R:0:s1:*:* 3"""
        model = read(text)
        np.testing.assert_array_equal(model.start, [0.25, 0.75])
        np.testing.assert_array_equal(model.reward, np.reshape([0.0, -3.0], (1, 2, 1, 1)))
        assert model.names.states == ("s0", "s1")

    def test_byte_order_mark_and_carriage_returns(self, tmp_path):
        path = tmp_path / "dos.pomdp"
        path.write_bytes(b"\xef\xbb\xbf" + (PREAMBLE + BODY).replace("\n", "\r\n").encode())
        assert read_model(path).n_states == 2

    @pytest.mark.parametrize(
        ("line", "start"),
        [
            ("", [1 / 3, 1 / 3, 1 / 3]),
            ("start: uniform", [1 / 3, 1 / 3, 1 / 3]),
            ("start: 0.5 0.5 0", [0.5, 0.5, 0]),
            ("start:\n0.25\n0.25 0.5", [0.25, 0.25, 0.5]),
            ("start: c", [0, 0, 1]),
            ("start: 1", [0, 1, 0]),
            ("start include: a c", [0.5, 0, 0.5]),
            ("start include: 1 c", [0, 0.5, 0.5]),
            ("start exclude: 0", [0, 0.5, 0.5]),
        ],
    )
    def test_start(self, read, line, start):
        text = f"discount: 1\nvalues: reward\n{line}\nstates: a b c\nactions: 1\nobservations: 1\n"
        np.testing.assert_array_equal(read(text + BODY).start, start)

    @pytest.mark.parametrize("line", ["", "start: 0", "start: 1", "start: 1.0", "start: only"])
    def test_start_of_one_state(self, read, line):
        text = f"discount: 1\nvalues: reward\nstates: only\nactions: 1\nobservations: 1\n{line}\n"
        np.testing.assert_array_equal(read(text + BODY).start, [1.0])

    def test_keyword_letters_as_names(self, read):
        text = PREAMBLE.replace("go stay", "N E T").replace("left right", "O E") + (
            "T: * identity\nT: E : E : O 1\nT: E : E : E 0\nT: T uniform\nO: * uniform\n"
            "O: E : E\n1 0\n"
        )
        model = read(text)
        np.testing.assert_array_equal(model.transition[1], [[1, 0], [1, 0]])
        np.testing.assert_array_equal(model.transition[2], [[0.5, 0.5], [0.5, 0.5]])
        np.testing.assert_array_equal(model.observation[1], [[0.5, 0.5], [1, 0]])


class TestProbabilities:
    def test_entry_row_matrix(self, read):
        text = """T: go : left : right 1
        T: go : 1
        0.25 0.75
        T: stay
        0.5 0.5
        0.125
        0.875
        O: * : left : 0 1 O: * : right 0.5 0.5"""
        model = read(PREAMBLE + text)
        np.testing.assert_array_equal(
            model.transition, [[[0, 1], [0.25, 0.75]], [[0.5, 0.5], [0.125, 0.875]]]
        )
        np.testing.assert_array_equal(model.observation, [[[1, 0], [0.5, 0.5]]] * 2)

    def test_last_wins_entry_by_entry(self, read):
        text = """O: * : * : dark 1.0
        O: go : right : dark 0.0
        O: go : right : light 1.0
        T: * : * : * 0.0
        T: * : left : left 1
        T: * : right : right 1
        T: go : left : left 0.5
        T: go : left : right 0.5
        T: stay uniform
        T: stay : right : * 0
        T: * : right : left 1
        T: go : right : left 0"""
        model = read(PREAMBLE + text)
        np.testing.assert_array_equal(
            model.transition, [[[0.5, 0.5], [0, 1]], [[0.5, 0.5], [1, 0]]]
        )
        np.testing.assert_array_equal(model.observation, [[[1, 0], [0, 1]], [[1, 0], [1, 0]]])

    def test_row_replaces_row(self, read):
        model = read(
            PREAMBLE + BODY + "T: * : left : right 0.3\nT: go : left\n0.5 0.5\nT: stay : left\n1 0"
        )
        np.testing.assert_array_equal(model.transition[:, 0], [[0.5, 0.5], [1, 0]])

    def test_uniform_row_and_identity(self, read):
        model = read(PREAMBLE + "T: * identity\nT: go : left uniform\nO: * identity\n")
        np.testing.assert_array_equal(model.transition, [[[0.5, 0.5], [0, 1]], np.eye(2)])
        np.testing.assert_array_equal(model.observation, [np.eye(2)] * 2)
        assert not model.fully_observed

    def test_reset(self, read):
        model = read(PREAMBLE + "start: 0.25 0.75\n" + BODY + "T: * : right reset\n")
        np.testing.assert_array_equal(model.transition[1], [[1, 0], [0.25, 0.75]])

    def test_rows_are_normalised_within_the_tolerance(self, read):
        model = read(PREAMBLE + BODY + "T: go : left\n0.333333 0.666666\n")
        np.testing.assert_allclose(model.transition[0, 0], [1 / 3, 2 / 3], rtol=1e-15)


class TestRewards:
    def reward(self, read, text, shape):
        model = read(PREAMBLE + BODY + text)
        assert model.reward.shape == shape
        return model.reward

    def test_none(self, read):
        np.testing.assert_array_equal(self.reward(read, "", (1, 1, 1, 1)).ravel(), [0])

    def test_axes_that_nobody_names_stay_single(self, read):
        reward = self.reward(read, "R: * : * : * : * -1\nR: * : * : right : * 2", (1, 1, 2, 1))
        np.testing.assert_array_equal(reward.ravel(), [-1, 2])
        reward = self.reward(read, "R: go : left : * : * 3", (2, 2, 1, 1))
        np.testing.assert_array_equal(reward[..., 0, 0], [[3, 0], [0, 0]])
        reward = self.reward(read, "R: * : * : right : light 1", (1, 1, 2, 2))
        np.testing.assert_array_equal(reward[0, 0], [[0, 0], [0, 1]])

    def test_newest_pattern_wins(self, read):
        text = """R: go : left : right : * 5
        R: * : * : right : * 7
        R: go : left : * : * 1
        R: stay : right : right : * 9"""
        reward = self.reward(read, text, (2, 2, 2, 1))[..., 0]
        np.testing.assert_array_equal(reward, [[[1, 1], [0, 7]], [[0, 7], [0, 9]]])

    def test_row_over_observations(self, read):
        reward = self.reward(read, "R: * : * : * : * 4\nR: go : left : right\n1 0\n", (2, 2, 2, 2))
        np.testing.assert_array_equal(reward[0, 0], [[4, 4], [1, 0]])
        assert (reward[1] == 4).all()

    def test_matrix_over_end_states_and_observations(self, read):
        reward = self.reward(read, "R: stay : left\n1 2\n3 -4\n", (2, 2, 2, 2))
        np.testing.assert_array_equal(reward[1, 0], [[1, 2], [3, -4]])
        assert not reward[0].any()
        assert not reward[1, 1].any()

    def test_cost(self, read):
        model = read(PREAMBLE.replace("reward", "cost") + BODY + "R: go : * : * : * 2")
        np.testing.assert_array_equal(model.reward.ravel(), [-2, 0])
        assert not np.signbit(model.reward.ravel()[1])


class TestFullyObserved:
    def test_without_observations(self, read):
        model = read(FULLY_OBSERVED + "R: 0 : a : b 2\nR: 0 : b\n3 4\n")
        assert model.fully_observed
        assert model.names.observations == (("a", "b"),)
        np.testing.assert_array_equal(model.reward[0, :, :, 0], [[0, 2], [3, 4]])

    def test_reward_matrix(self, read):
        np.testing.assert_array_equal(
            read(FULLY_OBSERVED + "R: 0\n1 2\n3 4\n").reward[0, :, :, 0], [[1, 2], [3, 4]]
        )

    def test_round_trip(self, read, tmp_path):
        model = read(FULLY_OBSERVED + "R: 0 : a : b 2\n")
        assert_equal(round_trip(model, tmp_path / "out.POMDP"), model)
        assert "observations" not in (tmp_path / "out.POMDP").read_text()

    def test_observation_in_the_reward_becomes_the_end_state(self, tmp_path):
        reward = np.arange(4.0).reshape(1, 1, 2, 2)
        model = TabularModel(np.full((1, 2, 2), 0.5), None, reward, [1, 0], 0.9)
        again = round_trip(model, tmp_path / "out.pomdp")
        np.testing.assert_array_equal(again.reward.ravel(), [0, 3])

    def test_factored_observations_are_written(self, tmp_path):
        model = TabularModel(
            np.full((1, 4, 4), 0.25), None, np.zeros(1), [1, 0, 0, 0], 0.9, None, (1, 1), (2, 2)
        )
        again = round_trip(model, tmp_path / "out.dpomdp")
        assert again.observation_sizes == (2, 2)
        np.testing.assert_array_equal(again.observation, model.observation)


class TestTerminal:
    def test_states_keep_themselves(self, read, tmp_path):
        model = read(PREAMBLE + "E: right\n" + BODY + "R: * : left : * : * 1\n")
        np.testing.assert_array_equal(model.terminal, [False, True])
        assert_equal(round_trip(model, tmp_path / "out.pomdp"), model)

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("T: go : right : left 1\nT: go : right : right 0\n", "has an exit to 'left'"),
            ("R: go : * : * : * 1\n", "it must earn 0"),
        ],
    )
    def test_others_are_refused(self, read, text, reason):
        error = failure(read, PREAMBLE + "E: 1\n" + BODY + text)
        assert error.line == 6
        assert reason in error.reason

    def test_unknown(self, read):
        error = failure(read, PREAMBLE + BODY + "E: left\nrihgt\nR: * : * : * : * 0")
        assert (error.line, "did you mean 'right'" in error.reason) == (9, True)


class TestJoint:
    def test_sizes_and_names(self, read):
        model = read(JOINT + JOINT_BODY)
        assert (model.action_sizes, model.observation_sizes) == ((2, 3), (2, 2))
        assert model.names.actions == (("x", "y"), ("0", "1", "2"))
        assert model.names.agents == ("agent_0", "agent_1")
        assert model.discount == 1
        np.testing.assert_array_equal(model.transition, [np.eye(3)] * 6)

    def test_ids(self, read):
        text = """T: x 2 : a : b : 1.0
T: x 2 : a : a : 0
T: 5 : c :
0.5 0.5 0
T: y * : b :
1 0 0
T: y 0
uniform
"""
        moves = np.array([np.eye(3)] * 6)
        moves[2, 0] = [0, 1, 0]
        moves[5, 2] = [0.5, 0.5, 0]
        moves[3:, 1] = [1, 0, 0]
        moves[3] = 1 / 3
        np.testing.assert_array_equal(read(JOINT + JOINT_BODY + text).transition, moves)

    def test_observations_and_rewards(self, read):
        text = """O: x 0 : a : p 1 : 0.75
O: 0 : a : 0 : 0.25
O: x 0 : a : q * : 0
R: * : * : * : * : -1
R: y 1 : b : * : * : 7
"""
        model = read(JOINT + JOINT_BODY + text)
        np.testing.assert_array_equal(model.observation[0, 0], [0.25, 0.75, 0, 0])
        assert model.reward.shape == (6, 3, 1, 1)
        assert model.reward[4, 1, 0, 0] == 7
        assert model.reward.sum() == 7 - 17

    def test_shape_on_the_same_line_and_agent_names(self, read):
        text = JOINT.replace("agents: 2", "agents: ann, bob")
        model = read(text + "T: * : identity\nO: * : uniform\nT: x 0 : a : uniform\n")
        assert model.names.agents == ("ann", "bob")
        np.testing.assert_array_equal(model.transition[0, 0], [1 / 3] * 3)

    def test_without_observations(self, read, tmp_path):
        model = read(JOINT[: JOINT.index("observations")] + "T: * :\nidentity\nR: * : * : b : 2\n")
        assert model.fully_observed
        np.testing.assert_array_equal(model.reward.ravel(), [0, 2, 0])
        assert_equal(round_trip(model, tmp_path / "m.dpomdp"), model)
