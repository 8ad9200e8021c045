"""Malformed and oversized model files are refused by line and reason."""

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bnprl_envs.model import TabularModel
from bnprl_envs.model_file_specifications import MAX_ENTRIES, Specifications
from bnprl_envs.model_file_tokens import ModelFileError as TokenError
from bnprl_envs.model_files import ModelFileError, read_model
from tests.envs.model_file_cases import (
    BODY,
    FULLY_OBSERVED,
    JOINT,
    JOINT_BODY,
    PREAMBLE,
    failure,
    round_trip,
)

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
    "O unasked": (FULLY_OBSERVED + "O: * uniform", 6, "needs an 'observations:' line"),
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
    "many agents": (JOINT.replace("agents: 2", "agents: 33"), 1, "agents: 33, the limit is 32"),
    "joint actions": (JOINT.replace("x y\n3", "1000\n1049"), 7, "joint actions, the limit is"),
    "joint observations": (JOINT.replace("p q\n2", "9999\n9999"), 10, "joint observations, the"),
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

    def test_words_on_many_lines_take_linear_time(self, read):
        begin = time.process_time()
        error = failure(read, JOINT.replace("x y\n3\n", "x\n" * 20_000))
        assert "actions: 20000 lines, must be one for each of the 2 agents" in error.reason
        assert time.process_time() - begin < 2

    @pytest.mark.parametrize("statement", ["E: * *\n", "E: *\n", "T: 3 : 0 reset\n"])
    def test_short_statements_about_all_states_take_linear_time(self, read, statement):
        text = self.preamble(100_000) + "start: 0\nT: * identity\nO: * uniform\n"
        begin = time.process_time()
        read(text)
        once = time.process_time() - begin
        read(text + statement * 20_000)
        assert time.process_time() - begin - once < 2 * once + 2

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
