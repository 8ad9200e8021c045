from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, permutation_test

from baselines import head_to_head
from baselines.cli import main
from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.head_to_head import (
    holm,
    interquartile_mean,
    pairs,
    performance_profile,
    probability_of_improvement,
)
from baselines.records import RunFiles, open_log
from baselines.study import open_study
from bnprl_envs import registry
from tests.baselines.fakes import install, record


def test_the_probability_of_improvement_is_mann_and_whitneys() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, 5, 7).astype(float), rng.integers(0, 5, 9).astype(float)
    wanted = mannwhitneyu(x, y).statistic / (7 * 9)
    assert probability_of_improvement(x, y) == pytest.approx(wanted)


def test_the_permutation_test_of_one_environment_is_scipys() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=6), rng.normal(0.8, size=6)
    exact = permutation_test((x, y), lambda a, b: a.mean() - b.mean(), vectorized=False)
    assert head_to_head.permutation_test([x], [y]) == pytest.approx(exact.pvalue, abs=0.015)


def test_labels_move_within_environments_only() -> None:
    """Between two environments of very different scale a consistent small gain still counts."""
    rng = np.random.default_rng(2)
    low, high = rng.normal(0, 0.01, (2, 6)), rng.normal(50, 0.01, (2, 6))
    p = head_to_head.permutation_test(
        [low[0] + 0.05, high[0] + 0.05], list(map(np.array, (low[1], high[1])))
    )
    assert p is not None
    assert p < 0.001


def test_equal_samples_are_not_told_apart() -> None:
    same = [np.array([1.0, 2.0, 3.0])]
    (pair,) = pairs({"a": same, "b": same})
    assert (pair.difference, pair.improvement, pair.p_value) == (0.0, 0.5, 1.0)
    (single,) = pairs({"a": [np.array([1.0])], "b": same})
    assert single.first == "b"
    assert single.p_value is None


def test_holm_as_worked_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def test_the_interquartile_mean_leaves_out_the_ends() -> None:
    found = interquartile_mean([np.array([0.0, 1.0]), np.array([2.0, 100.0])])
    assert found.mean == 1.5
    assert interquartile_mean([np.array([0.3])]).low is None


def test_a_profile_is_one_minus_the_distribution() -> None:
    scores = [np.array([0.1, 0.9]), np.array([0.5])]
    found = performance_profile(scores, np.array([0.0, 0.2, 0.6, 1.0]))
    assert found.tolist() == [1.0, 0.75, 0.25, 0.0]


def write(folder: Path, id: str, values: dict[str, list[float]]) -> None:
    folder.mkdir(parents=True)
    entries = tuple(Entry(name, "fake", {}) for name in values)
    experiment = Experiment(EnvironmentSpec(id), entries, episodes=100, seeds=3, eval_points=1)
    open_study(folder, experiment, "command")
    for name, found in values.items():
        for seed, value in enumerate(found):
            with open_log(RunFiles(folder, name, seed).records) as log:
                log.append(record(contender=name, seed=seed, return_mean=value))


def test_comparisons_are_joined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch)
    ends = {
        id: {r.name: r.value for r in registry.entry(id).references}
        for id in ("bnprl/Hallway-v0", "bnprl/Tag-v0")
    }
    for index, (id, known) in enumerate(ends.items()):
        low, high = known["random"], known["lower"]
        best, worst = [high] * 3, [low, (low + high) / 2, low]
        write(tmp_path / str(index), id, {"strong": best, "weak": worst, f"only{index}": best})
    folders = [str(tmp_path / "0"), str(tmp_path / "1")]
    out = tmp_path / "out"
    assert main(["aggregate", *folders, "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_bytes())
    assert [row["agent"] for row in summary["rows"]] == ["strong", "weak"]
    assert summary["rows"][0]["iqm"] == pytest.approx(1.0)
    assert summary["rows"][1]["mean"] == pytest.approx(1 / 6)
    (pair,) = summary["pairs"]
    assert pair["improvement"] == 1.0
    assert (out / "profiles.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "report.html").read_text()
    assert all(words in page for words in ("strong", "bnprl/Tag-v0", 'id="pairs"', "1.000"))
    assert "strong" in capsys.readouterr().out

    assert main(["aggregate", "--out", str(out)]) == 2
    assert "give the folders" in capsys.readouterr().err
    assert main(["aggregate", folders[0], folders[0], "--out", str(out)]) == 2
    assert "is there twice" in capsys.readouterr().err
    write(tmp_path / "alone", "bnprl/Tag-v0", {"strong": [-6.0] * 3})
    assert main(["aggregate", str(tmp_path / "alone"), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "Who beats whom takes two agents that have finished runs in every folder" in shown
    assert "P(better)" not in shown
    write(tmp_path / "foreign", "FrozenLake-v1", {"strong": [1.0]})
    assert main(["aggregate", str(tmp_path / "foreign"), "--out", str(out)]) == 2
    assert "are not known" in capsys.readouterr().err
