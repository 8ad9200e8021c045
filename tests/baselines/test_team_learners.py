"""The benchmark of team learners: finished runs are kept, known by their settings."""

import dataclasses
import json
from types import SimpleNamespace

import pytest

from baselines.benchmarks import run_records, team_learners
from baselines.benchmarks.run_records import Records, Score
from baselines.benchmarks.team_learners import PROBLEMS, described, main
from baselines.contenders import contender

TIGER = next(problem for problem in PROBLEMS if "Tiger" in problem.name)


@pytest.fixture
def runs(monkeypatch):
    made = []

    def run(problem, seed):
        made.append((problem.name, seed))
        return [Score(problem.steps, 5.0 + seed, 1.5, nodes=3)]

    monkeypatch.setattr(team_learners, "run", run)
    return made


def test_finished_runs_are_not_run_again(runs, tmp_path, capsys):
    path = tmp_path / "records.jsonl"
    call = ["--problems", TIGER.name, "--seeds", "2", "--out", str(path)]
    assert main(call) == 0
    with path.open("a") as file:
        file.write('{"run": {"agent')  # torn
    assert main(call) == 0
    assert runs == [(TIGER.name, 0), (TIGER.name, 1)]
    assert "mean     5.500, best 6.000, worst 5.000" in capsys.readouterr().out
    kept = [json.loads(line) for line in path.read_text().splitlines()]
    assert kept[1]["scores"] == [{"steps": TIGER.steps, "value": 6.0, "seconds": 1.5, "nodes": 3}]


def test_a_run_of_other_settings_is_another(runs, tmp_path, monkeypatch):
    records = Records(tmp_path / "records.jsonl")
    records.of(described(TIGER, 0))
    settings = dataclasses.replace(contender(team_learners.AGENT).settings, nodes=2)
    monkeypatch.setattr(run_records, "contender", lambda _: SimpleNamespace(settings=settings))
    records.of(described(TIGER, 0))
    records.of(described(TIGER, 0))
    records.of(described(dataclasses.replace(TIGER, steps=10), 0))
    assert len(runs) == 3
