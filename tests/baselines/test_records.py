from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from baselines.files import FolderInUseError, check_name, folder_lock, parse_json, write_atomic
from baselines.records import LINE_LIMIT, RecordError, RunFiles, open_log, read_records
from tests.baselines.fakes import record


def test_records_come_back_as_they_were_appended(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "fake" / "0.jsonl"
    first, last = record(final=False, exact_value=0.1 + 0.2), record(return_mean=1 / 3)
    with open_log(path) as log:
        log.append(first)
        assert not read_records(path).finished
        log.append(last)
    found = read_records(path)
    assert found.lines == (first, last)
    assert found.finished
    assert not found.torn
    assert found.size == path.stat().st_size
    with open_log(path) as log:
        log.restart()
        log.append(last)
    assert read_records(path).lines == (last,)


@pytest.mark.parametrize("text", ["NaN", "-Infinity", "1e400", "[-1e400]", "{", "1" * 5000])
def test_what_is_no_finite_json_is_none(text: str) -> None:
    assert parse_json(text.encode()) is None
    assert parse_json(b"[1e300, 2]") == [1e300, 2]


@pytest.mark.parametrize("tail", [b'{"contender": "fa', b"\0\0\0", b'{"a": NaN}', b"{}"])
def test_a_torn_last_line_is_dropped(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "0.jsonl"
    good = record(final=False).line()
    path.write_bytes(good + tail)
    found = read_records(path)
    assert found.torn
    assert found.lines == (record(final=False),)
    assert found.size == len(good)


def test_every_cut_of_a_line_is_torn_or_whole(tmp_path: Path) -> None:
    path = tmp_path / "0.jsonl"
    line = record().line()
    for length in range(1, len(line)):
        path.write_bytes(line[:length])
        assert read_records(path).torn
        assert read_records(path).lines == ()


def damaged(key: str, value: Any) -> bytes:
    values = json.loads(record().line())
    if value is None and key != "metrics":
        del values[key]
    else:
        values[key] = value
    return json.dumps(values).encode() + b"\n"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"not json\n", "not a record"),
        (b"[1]\n", "not a record"),
        (b"\0\0\0\n", "not a record"),
        (b"[" * 100_000 + b"\n", "not a record"),
        (b'"' + b"x" * LINE_LIMIT + b'"\n', "longer than"),
        (damaged("steps", None), "key 'steps' is missing"),
        (damaged("extra", 1), "key 'extra' is unknown"),
        (damaged("steps", -1), "steps must be a count"),
        (damaged("steps", 1.5), "steps must be a count"),
        (damaged("seed", True), "seed must be a count"),
        (damaged("final", 1), "final must be true or false"),
        (damaged("return_mean", "high"), "return_mean must be a finite number"),
        (record().line().replace(b"0.25", b"1e999"), "not a record"),
        (record().line().replace(b"0.25", b"9" * 400), "return_mean must be a finite number"),
        (record().line().replace(b"0.25", b"NaN"), "not a record"),
        (damaged("metrics", {"a": "b"}), "metrics must be an object of finite numbers"),
    ],
)
def test_a_damaged_line_is_named_wherever_it_is(tmp_path: Path, line: bytes, reason: str) -> None:
    path = tmp_path / "0.jsonl"
    for after in (record().line(), b""):
        path.write_bytes(record(final=False).line() + line + after)
        with pytest.raises(RecordError) as caught:
            read_records(path)
        assert str(caught.value).startswith(f"{path}:2: ")
        assert reason in str(caught.value)


def test_a_record_of_another_run_is_refused(tmp_path: Path) -> None:
    files = RunFiles(tmp_path, "fake", 1)
    assert files.read().lines == ()
    with open_log(files.records) as log:
        log.append(record(seed=0))
    with pytest.raises(RecordError, match=r"1\.jsonl:1: belongs to fake/0"):
        files.read()


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_atomic(path, "first")
    with pytest.raises(UnicodeEncodeError):
        write_atomic(path, "\ud800")
    assert path.read_text() == "first"
    assert [found.name for found in tmp_path.iterdir()] == ["summary.json"]


def test_one_command_at_a_time_holds_a_folder(tmp_path: Path) -> None:
    with (
        folder_lock(tmp_path / "out"),
        pytest.raises(FolderInUseError, match="another bnprl command"),
        folder_lock(tmp_path / "out"),
    ):
        pass
    with folder_lock(tmp_path / "out"):
        pass


@pytest.mark.parametrize(
    "name", ["", "..", "a/b", "-x", "a\n", "x" * 101, ".hidden", "nul", "Con.x", "a."]
)
def test_names_that_are_no_folders_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="name"):
        check_name(name)
    assert check_name("online-em_2.0+x") == "online-em_2.0+x"
