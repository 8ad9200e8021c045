from __future__ import annotations

from pathlib import Path

import pytest

from baselines.cli import main
from baselines.records import RunFiles, open_log
from baselines.study import open_study
from tests.baselines.fakes import experiment, install, record


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)


def states(text: str) -> dict[str, list[str]]:
    return {cells[0]: cells[1:] for line in text.splitlines() if (cells := line.split())}


def test_every_state_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    open_study(tmp_path, experiment(seeds=5), "command")
    for seed, final in ((0, True), (1, False), (2, False)):
        with open_log(RunFiles(tmp_path, "fake", seed).records) as log:
            log.append(record(seed=seed, episodes=25 if not final else 100, final=final))
    RunFiles(tmp_path, "fake", 2).error.write_text("Traceback\nRuntimeError: the fake fails\n")
    with open_log(RunFiles(tmp_path, "fake", 1).records):
        assert main(["status", str(tmp_path)]) == 1
    shown = capsys.readouterr().out
    found = states(shown)
    assert found["fake/0"] == ["done", "100%", "0.250", "1.5", "–"]
    assert found["fake/1"] == ["running", "25%", "0.250", "1.5", "6"]  # 2 s a quarter
    assert found["fake/2"][0] == "failed"
    assert found["fake/3"] == ["waiting", "–", "–", "–", "–"]
    assert "RuntimeError: the fake fails" in shown
    assert "5 runs of 100 episodes: 1 done, 1 running, 1 failed" in shown

    assert main(["status", str(tmp_path)]) == 1
    assert states(capsys.readouterr().out)["fake/1"][0] == "stopped"


def test_panels_of_a_reproduction_are_told_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        open_study(tmp_path / name, experiment(seeds=1), "command")
        with open_log(RunFiles(tmp_path / name, "fake", 0).records) as log:
            log.append(record(final=True))
    assert main(["status", str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("fake/0") == 2
    assert main(["report", str(tmp_path)]) == 0
    assert (tmp_path / "a" / "report.html").is_file()
    assert (tmp_path / "b" / "report.html").is_file()
    (tmp_path / "a" / "experiment.json").write_text("{")
    capsys.readouterr()
    assert main(["status", str(tmp_path)]) == 2  # and what is whole is told all the same
    shown = capsys.readouterr()
    assert shown.out.count("fake/0") == 1
    assert str(tmp_path / "a") in shown.err


def test_a_folder_without_an_experiment_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", str(tmp_path)]) == 2
    assert "holds no experiment" in capsys.readouterr().err
