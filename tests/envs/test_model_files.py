"""Model files: each rule of the grammars by hand, round trips, malformed files, bounds."""

import math
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.model_file_specifications import MAX_ENTRIES, Specifications
from bnprl_envs.model_file_tokens import ModelFileError as TokenError
from bnprl_envs.model_files import ModelFileError, read_model, write_model

PREAMBLE = """discount: 0.5
values: reward
states: left right
actions: go stay
observations: dark light
"""
BODY = "T: * identity\nO: * uniform\n"
JOINT = """agents: 2
discount: 1
values: reward
states: a b c
start:
uniform
actions:
x y
3
observations:
p q
2
"""
JOINT_BODY = "T: * :\nidentity\nO: * :\nuniform\n"


@pytest.fixture
def read(tmp_path):
    def read_text(text, name="model.pomdp"):
        path = tmp_path / name
        path.write_text(text)
        return read_model(path)

    return read_text


def failure(read, text):
    with pytest.raises(ModelFileError) as caught:
        read(text)
    return caught.value


def assert_equal(first, second):
    """Equal bit for bit; the constructor is run on both (`replace`), as it divides by sums."""
    second = second.replace()
    for name in ("transition", "observation", "start", "terminal"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), strict=True)
    np.testing.assert_array_equal(first.reward, second.reward, strict=True)
    assert first.discount == second.discount
    assert first.action_sizes == second.action_sizes
    assert first.observation_sizes == second.observation_sizes
    assert first.fully_observed == second.fully_observed


def round_trip(model, path):
    write_model(model, path)
    return read_model(path)


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
    TEXT = "discount: 0.9\nvalues: reward\nstates: a b\nactions: 1\nT: 0 uniform\n"

    def test_without_observations(self, read):
        model = read(self.TEXT + "R: 0 : a : b 2\nR: 0 : b\n3 4\n")
        assert model.fully_observed
        assert model.names.observations == (("a", "b"),)
        np.testing.assert_array_equal(model.reward[0, :, :, 0], [[0, 2], [3, 4]])

    def test_reward_matrix(self, read):
        np.testing.assert_array_equal(
            read(self.TEXT + "R: 0\n1 2\n3 4\n").reward[0, :, :, 0], [[1, 2], [3, 4]]
        )

    def test_round_trip(self, read, tmp_path):
        model = read(self.TEXT + "R: 0 : a : b 2\n")
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


MALFORMED = {
    "empty": ("", 1, "no 'discount:'"),
    "text first": ("hello\n" + PREAMBLE, 1, "before the first keyword"),
    "no states": ("discount: 1\nvalues: reward\nactions: 2\nT: * uniform", 4, "no 'states:'"),
    "no values": ("discount: 1\nstates: 2\nactions: 2\nT: * uniform", 4, "no 'values:'"),
    "misspelt": ("discount: 1\nstate: 2\n", 2, "unknown keyword 'state'; did you mean 'states'"),
    "twice": ("discount: 1\ndiscount: 1\n", 2, "given twice"),
    "discount": (PREAMBLE.replace("0.5", "1.5") + BODY, 1, "must lie in (0, 1]"),
    "discount word": (PREAMBLE.replace("0.5", "half") + BODY, 1, "finite number, found 'half'"),
    "values word": (PREAMBLE.replace("reward", "rewards") + BODY, 2, "'reward' or 'cost'"),
    "negative count": (PREAMBLE.replace("left right", "-3") + BODY, 3, "whole number above 0"),
    "zero count": (PREAMBLE.replace("left right", "0") + BODY, 3, "whole number above 0"),
    "part count": (PREAMBLE.replace("left right", "2.5") + BODY, 3, "whole number above 0"),
    "huge count": (PREAMBLE.replace("left right", "9" * 12) + BODY, 3, "above the limit"),
    "huge number": (PREAMBLE.replace("left right", "9" * 5000) + BODY, 3, "above the limit"),
    "many rows": (PREAMBLE.replace("left right", "1000000").replace("go stay", "8"), 3, "limit"),
    "no count": (PREAMBLE.replace("go stay", "") + BODY, 4, "are missing"),
    "same name": (PREAMBLE.replace("go stay", "go go") + BODY, 4, "'go' is named twice"),
    "star": (PREAMBLE.replace("go stay", "go *") + BODY, 4, "'*' cannot be a name"),
    "start sum": (PREAMBLE + "start: 0.5 0.4\n" + BODY, 6, "sums to 0.9"),
    "start sign": (PREAMBLE + "start: 1.5 -0.5\n" + BODY, 6, "-0.5, must lie in [0, 1]"),
    "start size": (PREAMBLE + "start: 1 0 0\n" + BODY, 6, "3 words, must be 2"),
    "start name": (PREAMBLE + "start: lefft\n" + BODY, 6, "did you mean 'left'"),
    "start empty": (PREAMBLE + "start exclude: 0 1\n" + BODY, 6, "no state is left"),
    "start late": (PREAMBLE + BODY + "start: left\n", 8, "before the first T, O or R"),
    "include late": (PREAMBLE + BODY + "start include: left\n", 8, "before the first T, O or R"),
    "action": (PREAMBLE + BODY + "T: sty : left : left 1\n", 8, "unknown action 'sty'; did you"),
    "state": (PREAMBLE + BODY + "T: go : lfet\n1 0\n", 8, "unknown state 'lfet'; did you mean"),
    "observation": (PREAMBLE + BODY + "O: * : left : lihgt 1\n", 8, "did you mean 'light'"),
    "index": (PREAMBLE + BODY + "T: go : 2 : 0 1\n", 8, "unknown state '2', must lie in 0..1"),
    "word for number": (PREAMBLE + BODY + "T: go : 0 : 0 one\n", 8, "finite number, found 'one'"),
    "nan": (PREAMBLE + BODY + "T: go : 0 : 0 nan\n", 8, "finite number, found 'nan'"),
    "nan in a row": (PREAMBLE + BODY + "T: go : 0\n0.5\nnan\n", 10, "found 'nan'"),
    "infinite": (PREAMBLE + BODY + "R: * : * : * : * -inf\n", 8, "finite number, found '-inf'"),
    "overflow": (PREAMBLE + BODY + "R: * : * : * : * 1e999\n", 8, "finite number"),
    "underscore": (PREAMBLE + BODY + "T: go : 0\n0_1 0\n", 9, "finite number, found '0_1'"),
    "negative": (PREAMBLE + BODY + "T: go : 0 : 0 -0.5\n", 8, "-0.5 must lie in [0, 1]"),
    "above one": (PREAMBLE + BODY + "O: *\n1 0\n0 1.5\n", 10, "1.5 must lie in [0, 1]"),
    "row sum": (PREAMBLE + BODY + "T: go : left : right 0.5\n", 8, "sums to 1.5"),
    "row sum of a matrix": (PREAMBLE + BODY + "O: go\n1 0\n0.5 0.4\n", 10, "sums to 0.9"),
    "cleared row": (
        PREAMBLE + BODY + "T: go : 1 : * 0\n",
        8,
        "action 'go', state 'right' sums to 0",
    ),
    "no row": (PREAMBLE + "T: * identity\nO: go uniform\n", 7, "'stay', state 'left' is not spec"),
    "no O": (PREAMBLE + "T: * identity\n", 6, "O: the row of action 'go', state 'left' is not"),
    "truncated": (PREAMBLE + "T: go\n1 0\n0", 8, "ends after 1 of 2 numbers"),
    "truncated id": (PREAMBLE + "T: go : left :", 6, "ends in the middle"),
    "short row": (PREAMBLE + "T: go : left\n1\nT: stay uniform\n", 8, "found 'T', among 2 numbers"),
    "long row": (PREAMBLE + BODY + "T: go : left\n1 0 0\n", 9, "too many numbers: '0'"),
    "no colon": (PREAMBLE + "T go identity\n", 5, "'identity' cannot be a name"),
    "garbage": (PREAMBLE + BODY + "Q: go\n", 8, "expected T, O or R, found 'Q'"),
    "O unasked": (TestFullyObserved.TEXT + "O: * uniform", 6, "needs an 'observations:' line"),
    "reset of O": (PREAMBLE + BODY + "O: go : left reset\n", 8, "may only be a row of T"),
    "reset of all": (PREAMBLE + BODY + "T: go reset\n", 8, "may only be a row of T"),
    "identity row": (PREAMBLE + BODY + "T: go : left identity\n", 8, "square matrix"),
    "R action": (PREAMBLE + BODY + "R: go\n1\n", 8, "at least an action and a state"),
    "R uniform": (PREAMBLE + BODY + "R: go : left : left uniform\n", 8, "found 'uniform'"),
    "NUL": (PREAMBLE + "\0\0\n", 6, "not a text file"),
    "joint lines": (JOINT.replace("x y\n", "") + JOINT_BODY, 7, "one for each of the 2 agents"),
    "joint words": (JOINT + JOINT_BODY + "T: x x x : a : b : 1\n", 17, "one word for each of 2"),
    "joint name": (JOINT + JOINT_BODY + "T: x z : a : b : 1\n", 17, "unknown action 'z'"),
    "joint index": (JOINT + JOINT_BODY + "T: 6 : a : b : 1\n", 17, "joint index in 0..5"),
    "joint colon": (JOINT + JOINT_BODY + "T: x 0 : a : b 1\n", 17, "then a colon"),
    "joint action": (JOINT + JOINT_BODY + "T:\nx 0 : a : b : 1\n", 17, "on the same line"),
    "agents": (JOINT.replace("agents: 2", "agents: 99999999") + JOINT_BODY, 1, "above the limit"),
}


class TestErrors:
    @pytest.mark.parametrize("case", MALFORMED)
    def test_line_and_reason(self, read, tmp_path, case):
        text, line, reason = MALFORMED[case]
        error = failure(read, text)
        assert reason in error.reason
        assert error.line == line
        assert error.path == str(tmp_path / "model.pomdp")
        assert str(error) == f"{error.path}:{line}: {error.reason}"
        assert "\n" not in str(error)

    def test_binary(self, tmp_path):
        path = tmp_path / "model.pomdp"
        path.write_bytes(b"discount: 1\n\xff\xfe\x80\n")
        with pytest.raises(ModelFileError, match="not a text file"):
            read_model(path)

    def test_missing_file(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            read_model(tmp_path / "none.pomdp")

    @given(st.data())
    @settings(max_examples=100, deadline=None)
    def test_a_damaged_file_reads_or_says_why(self, tmp_path_factory, data):
        text = JOINT + JOINT_BODY if data.draw(st.booleans()) else PREAMBLE + BODY
        words = text.replace("\n", " \n ").split(" ")
        pieces = st.sampled_from([*words, "", "*", ":", "-1", "1e9", "E", "start", "reset", "R"])
        for _ in range(data.draw(st.integers(1, 3))):
            words[data.draw(st.integers(0, len(words) - 1))] = data.draw(pieces)
        path = tmp_path_factory.getbasetemp() / "damaged.pomdp"
        path.write_text(" ".join(words))
        line = 1
        try:
            assert isinstance(read_model(path), TabularModel)
        except ModelFileError as error:
            line = error.line
        assert 1 <= line <= len(words)


class TestBounds:
    def preamble(self, n_states, n_observations=2):
        return (
            f"discount: 0.9\nvalues: reward\nstates: {n_states}\nactions: 4\n"
            f"observations: {n_observations}\n"
        )

    def test_wildcard_fill_of_a_big_model(self, read):
        error = failure(read, self.preamble(10_000) + "T: * : * : * 0.0001\nO: * uniform\n")
        assert error.line == 6
        assert f"400,000,000 non-zero entries, the limit is {MAX_ENTRIES:,}" in error.reason

    def test_a_fill_that_is_overridden_costs_nothing(self, read):
        model = read(
            self.preamble(10_000) + "T: * uniform\nT: * : * : * 0\nT: * identity\nO: * uniform\n"
        )
        assert model.transition_rows.nnz == 40_000
        overridden = "".join(f"T: {a} identity\n" for a in range(4))
        model = read(self.preamble(10_000) + "T: * uniform\n" + overridden + "O: * uniform\n")
        assert model.transition_rows.nnz == 40_000

    def test_rewards_over_observations_too_large(self, read):
        text = self.preamble(3_000) + BODY + "R: 1 : 2 : 3 : 1 1\nR: * : * : * : * 0\n"
        error = failure(read, text)
        assert error.line == 8
        assert "72,000,000 rewards over observations" in error.reason

    def test_big_sparse_model(self, tmp_path):
        """2,000 states with 10 successors and every kind of reward stay far below dense tables."""
        n_states, path = 2_000, tmp_path / "big.pomdp"
        with path.open("w") as file:
            file.write(self.preamble(n_states))
            for s in range(4 * n_states):
                for k in range(10):
                    end = (s + 7 * k) % n_states
                    file.write(f"T: {s // n_states} : {s % n_states} : {end} 0.1\n")
            file.write("O: * uniform\nR: * : * : * : * -1\n")
            for s in range(n_states):
                file.write(f"R: 0 : {s} : * : * {s}\nR: * : * : {s} : * {-s}\n" * (s % 9 == 0))
                file.write(f"R: 1 : {s} : {(s + 7) % n_states} : * 0.5\n" * (s % 5 == 0))
        tracemalloc.start()
        model = read_model(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 40e6
        assert model.transition_rows.nnz == 80_000
        action, state, end = model.support
        wanted = np.full(action.size, -1.0)
        wanted[end % 9 == 0] = -end[end % 9 == 0]
        own = (action == 0) & (state % 9 == 0) & ~((end % 9 == 0) & (end >= state))
        wanted[own] = state[own]
        late = (action == 1) & (state % 5 == 0) & (end == (state + 7) % n_states)
        newer = ~((end % 9 == 0) & (end > state))
        wanted[late & newer] = 0.5
        np.testing.assert_array_equal(model.support_reward[:, 0], wanted)
        again = round_trip(model, tmp_path / "again.pomdp")
        np.testing.assert_array_equal(again.support_reward, model.support_reward)
        assert (again.transition_rows != model.transition_rows).nnz == 0


def random_specifications():
    index = st.tuples(*(st.one_of(st.none(), st.integers(0, n - 1)) for n in (2, 3, 2)))
    return st.lists(st.tuples(index, st.integers(0, 2)), max_size=20)


@given(random_specifications())
@settings(max_examples=200, deadline=None)
def test_specifications_equal_writing_into_a_dense_table(statements):
    table = np.zeros((2, 3, 2))
    specifications = Specifications((2, 3, 2), lambda reason, line: TokenError("x", line, reason))
    for line, (place, value) in enumerate(statements):
        table[tuple(slice(None) if index is None else index for index in place)] = value
        specifications.set_block(place, value, line)
    np.testing.assert_array_equal(specifications.values(np.arange(12)), table.ravel())
    for first_column_axis in (1, 2):
        cells, values = specifications.nonzero(first_column_axis)
        np.testing.assert_array_equal(cells, np.flatnonzero(table))
        np.testing.assert_array_equal(values, table.ravel()[cells])


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


REFERENCE = os.environ.get("BNPRL_REFERENCE_MODELS")
SIZES = {
    "shuttle.95.POMDP": (8, (3,), (5,), 0.95, "ase"),
    "cheese.95.POMDP": (11, (4,), (7,), 0.95, "e"),
    "4x4.95.POMDP": (16, (4,), (2,), 0.95, "e"),
    "1d.noisy.POMDP": (4, (2,), (2,), 0.75, "eo"),
    "tiger.95.POMDP": (2, (3,), (2,), 0.95, "as"),
    "Hallway.pomdp": (60, (5,), (21,), 0.95, "e"),
    "TagAvoid.pomdp": (870, (5,), (30,), 0.95, "as"),
    "dectiger.dpomdp": (2, (3, 3), (2, 2), 1.0, "as"),
    "broadcastChannel.dpomdp": (4, (2, 2), (2, 2), 1.0, "as"),
    "recycling.dpomdp": (4, (3, 3), (2, 2), 0.9, "as"),
    "boxPushingUAI07.dpomdp": (100, (4, 4), (5, 5), 1.0, "as"),
    "Mars.dpomdp": (256, (6, 6), (8, 8), 1.0, "as"),
}


@pytest.mark.skipif(not REFERENCE, reason="BNPRL_REFERENCE_MODELS does not name a folder")
@pytest.mark.parametrize("name", SIZES)
def test_reference_file(tmp_path, name):
    path = Path(REFERENCE) / name
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    model = read_model(path)
    n_states, actions, observations, discount, axes = SIZES[name]
    assert (model.n_states, model.action_sizes) == (n_states, actions)
    assert (model.observation_sizes, model.discount) == (observations, discount)
    assert "".join(a for a, n in zip("aseo", model.reward.shape, strict=True) if n > 1) == axes
    again = round_trip(model, tmp_path / f"again{path.suffix}")
    assert_equal(again, model)
    assert again.names == model.names


@pytest.mark.skipif(not REFERENCE, reason="BNPRL_REFERENCE_MODELS does not name a folder")
@pytest.mark.parametrize(
    ("name", "table"), [("TagAvoid.pomdp", "T"), ("TagAvoid.pomdp", "O"), ("Hallway.pomdp", "T")]
)
def test_reference_entries_by_a_naive_parser(name, table):
    """Tables given by single entries, written one after the other into a dense array."""
    path = Path(REFERENCE) / name
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    model = read_model(path)
    last = model.names.states if table == "T" else model.names.observations[0]
    words = (model.names.actions[0], model.names.states, last)
    dense = np.zeros([len(names) for names in words])
    for line in path.read_text().splitlines():
        parts = line.split("#")[0].replace(":", " ").split()
        if parts and parts[0] == table and len(parts) == 5:
            pairs = zip(words, parts[1:4], strict=True)
            place = [slice(None) if word == "*" else names.index(word) for names, word in pairs]
            dense[tuple(place)] = float(parts[4])
    read = model.transition if table == "T" else model.observation
    given_by_entries = dense.any(axis=2)
    assert given_by_entries.mean() > 0.9
    np.testing.assert_allclose(read[given_by_entries], dense[given_by_entries], atol=2e-6)
