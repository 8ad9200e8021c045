"""Whatever a file holds, reading it ends soon, in little memory, with a model or one clear line."""

import os
import time
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bnprl_envs
from bnprl_envs import TabularModel
from bnprl_envs.model_files import ModelFileError, read_model, write_model

LARGEST_PEAK = 2**28
"""Bytes that reading a small file may take, whatever it says."""
LONGEST = 10.0
"""Processor seconds that it may take."""
REFERENCE = os.environ.get("BNPRL_REFERENCE_MODELS")


def read_anything(path):
    """Read a file that may hold anything; check how that ends."""
    begin, complaint = time.process_time(), None
    tracemalloc.start()
    try:
        model = read_model(path)
    except ModelFileError as error:
        complaint = error
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    if complaint is None:
        assert isinstance(model, TabularModel)
    else:
        assert str(complaint).startswith(f"{path}:{complaint.line}: ")
        assert len(str(complaint).splitlines()) == 1
        assert len(str(complaint)) < 1000
    assert peak < LARGEST_PEAK + 40 * path.stat().st_size
    assert time.process_time() - begin < LONGEST


def lines(*strategies):
    """A text of one line from each strategy."""
    return st.tuples(*strategies).map("\n".join)


SIZE = st.sampled_from(["1", "2", "3", "2 ", "17", "300", "10000", "10" * 20, "-1", "0"])
NUMBER = st.sampled_from(["0", "1", "0.5", "1e-9", "1e308", "-1", "nan", "inf", "1e999", "0x1", ""])
NAMES = st.lists(st.sampled_from(["a", "b", "c", "a", "T", "*", "x-1", "é"]), max_size=4).map(
    " ".join
)
LABELS = SIZE | NAMES
PLACE = st.sampled_from(["*", "0", "1", "2", "a", "b", "9", "* *", "0 1", ""])
ROWS = st.one_of(
    st.sampled_from(["uniform", "identity", "reset"]),
    st.lists(NUMBER, max_size=9).map(" ".join),
)
FIELD = st.sampled_from(["discount", "values", "states", "actions", "observations", "agents"])
HEADER = lines(
    NUMBER.map("discount: {}".format),
    st.sampled_from(["reward", "cost", "both"]).map("values: {}".format),
    LABELS.map("states: {}".format),
    LABELS.map("actions: {}".format),
    LABELS.map("observations: {}".format),
)
JOINT_HEADER = lines(
    SIZE.map("agents: {}".format),
    NUMBER.map("discount: {}".format),
    st.just("values: reward"),
    LABELS.map("states: {}".format),
    st.sampled_from(["start:\nuniform", "start: 0", "start:\n1.0 0.0"]),
    st.lists(LABELS, max_size=3).map(lambda each: "\n".join(["actions:", *each])),
    st.lists(LABELS, max_size=3).map(lambda each: "\n".join(["observations:", *each])),
)
STATEMENT = st.one_of(
    st.builds(
        lambda table, places, rows: f"{table}: {' : '.join(places)}\n{rows}",
        st.sampled_from("TOR"),
        st.lists(PLACE, min_size=1, max_size=4),
        ROWS,
    ),
    st.builds(
        lambda table, places, number: f"{table}: {' : '.join(places)} : {number}",
        st.sampled_from("TOR"),
        st.lists(PLACE, min_size=1, max_size=5),
        NUMBER,
    ),
    st.builds("{}: {}".format, FIELD, LABELS),
    st.sampled_from(["start: uniform", "start include: 0", "start exclude: a", "E: 1", "# note"]),
)
VALID = "discount: 0.9\nvalues: reward\nstates: 3\nactions: 2\nobservations: 2"
BODY = ["T: * uniform", "O: * uniform"]
FILES = st.builds(
    lambda header, body, statements: "\n".join([header, *body, *statements, ""]),
    st.one_of(HEADER, JOINT_HEADER, st.just(VALID), SIZE.map(lambda n: VALID.replace("3", n))),
    st.sampled_from([[], BODY]),
    st.lists(STATEMENT, max_size=8),
)


@given(FILES)
@settings(max_examples=300, deadline=None)
def test_files_by_the_grammar(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "grammar.pomdp"
    path.write_text(text)
    read_anything(path)


def real_files(folder):
    """Model files as the suite writes them, and the reference ones where they are."""
    paths = []
    for name in ("Shuttle", "CheeseMaze", "DecTiger", "RecyclingRobots"):
        model = bnprl_envs.model(f"bnprl/{name}-v0")
        paths.append(folder / f"{name}.{'dpomdp' if len(model.action_sizes) > 1 else 'pomdp'}")
        write_model(model, paths[-1])
    return paths + sorted(Path(REFERENCE or folder / "none").glob("*.*pomdp"))


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    found = (path.read_bytes() for path in real_files(tmp_path_factory.mktemp("real")))
    return [content for content in found if len(content) < 20_000]


@st.composite
def mutations(draw):
    """A change of bytes: some are cut out, repeated elsewhere or written over."""
    where, length, there = (draw(st.floats(0, 1)) for _ in range(3))
    fresh = draw(
        st.one_of(
            st.binary(max_size=8),
            st.sampled_from([b"*", b":", b"9" * 30, b"1e308", b"\n", b"T:", b"uniform", b"\xff"]),
        )
    )

    def change(content):
        a = int(where * len(content))
        b = min(len(content), a + int(200 * length**4))
        piece = content[a:b]
        kind = draw(st.sampled_from(["cut", "repeat", "overwrite", "end"]))
        if kind == "end":
            return content[:a]
        if kind == "repeat":
            c = int(there * len(content))
            return content[:c] + piece + content[c:]
        return content[:a] + (fresh if kind == "overwrite" else b"") + content[b:]

    return change


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_mutated_real_files(tmp_path_factory, contents, data):
    content = data.draw(st.sampled_from(contents))
    for change in data.draw(st.lists(mutations(), min_size=1, max_size=4)):
        content = change(content)
    path = tmp_path_factory.getbasetemp() / "mutated.pomdp"
    path.write_bytes(content)
    read_anything(path)
