"""Agents and environments of the user's own modules, and that records alone import nothing."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import pytest
from gymnasium.spaces import Discrete

from baselines.cli import main
from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.records import RunFiles, open_log
from baselines.study import open_study
from bnprl_agents import RandomAgent, load
from examples.my_agent import Sarsa, SarsaConfig
from tests.baselines.fakes import record

OWN = "examples.my_agent:Sarsa"
SMALL = ["--steps", "500", "--eval-points", "1", "--eval-episodes", "5", "--no-progress"]


def test_an_own_agent_is_trained_set_evaluated_and_loaded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path)
    compare = ["compare", "bnprl/CheeseMaze-v0", "--agents", OWN, "random", "--seeds", "1"]
    setting = ["--set", "Sarsa.rate=0.5", "--jobs", "1"]
    assert main([*compare, *SMALL, *setting, "--out", out]) == 0
    policy = RunFiles(tmp_path, "Sarsa", 0).policy(".npz")
    agent = load(policy, Sarsa)
    assert isinstance(agent, Sarsa)
    assert agent.config.rate == 0.5
    with pytest.raises(ValueError, match="unknown agent 'Sarsa'"):
        load(policy)
    capsys.readouterr()
    evaluate = ["evaluate", out, "--episodes", "5", "--no-progress"]
    assert main([*evaluate, "--agent", OWN]) == 0
    assert main(evaluate) == 1
    assert "unknown agent 'Sarsa'" in capsys.readouterr().err
    for command in (["watch", "bnprl/CheeseMaze-v0", "--policy"], ["plot"]):
        assert main([*command, str(policy)]) == 2
        assert "unknown agent 'Sarsa'" in capsys.readouterr().err
    watch = ["watch", "bnprl/CheeseMaze-v0", "--steps", "1", "--agent", OWN]
    assert main([*watch, "--policy", str(policy)]) == 0
    assert main(watch) == 2
    assert "give --policy FILE too" in capsys.readouterr().err
    assert main(["plot", str(policy), "--agent", OWN]) == 2
    assert "holds neither action values nor controllers" in capsys.readouterr().err
    train = ["train", "bnprl/CheeseMaze-v0", "--agent", OWN, "--rate", "0.5", *SMALL]
    assert main([*train, "--out", str(tmp_path / "one")]) == 0


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("no_such_module:Sarsa", "cannot import no_such_module"),
        ("examples.my_agent:Nothing", "examples.my_agent has no Nothing"),
        ("pathlib:Path", "Path is no subclass of bnprl_agents.Agent"),
        ("bnprl_agents.history_agent:HistoryAgent", "HistoryAgent lacks "),
    ],
)
def test_what_is_no_agent_is_named(
    name: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    compare = ["compare", "bnprl/CheeseMaze-v0", "--agents", name, *SMALL]
    assert main([*compare, "--out", str(tmp_path / "out")]) == 2
    assert reason in capsys.readouterr().err


@dataclass(frozen=True)
class SeededConfig(SarsaConfig):
    """`train` has a seed of its own."""

    seed: int = 1


@dataclass(frozen=True)
class NeedyConfig:
    """Has no default."""

    need: int


Seeded = type("Seeded", (Sarsa,), {"Config": SeededConfig})
Needy = type("Needy", (Sarsa,), {"Config": NeedyConfig})
Plain = type("Plain", (Sarsa,), {"Config": dict})


@pytest.mark.parametrize(
    ("agent", "reason"),
    [
        ("Seeded", "its setting seed has the name of an option of train; rename it"),
        ("Needy", "its Config needs a default of need"),
        ("Plain", "its Config must be a dataclass"),
    ],
)
def test_settings_that_cannot_be_flags_are_named(
    agent: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"{__name__}:{agent}"
    train = ["train", "bnprl/CheeseMaze-v0", "--agent", name, *SMALL, "--out", str(tmp_path)]
    assert main(train) == 2
    shown = capsys.readouterr().err
    assert f"{name}: {reason}" in shown
    assert shown.count("\n") == 1


@dataclass
class ThawedConfig:
    """Not frozen."""

    rate: float = 0.1
    epsilon: float = 0.1


Thawed = type("Thawed", (Sarsa,), {"Config": ThawedConfig})


def test_settings_need_not_be_frozen(tmp_path: Path) -> None:
    train = ["train", "bnprl/CheeseMaze-v0", "--agent", f"{__name__}:Thawed", "--rate", "0.5"]
    assert main([*train, *SMALL, "--out", str(tmp_path)]) == 0


class Spaceless(gym.Env[int, int]):
    """What every environment must have is missing."""


def test_an_environment_that_cannot_be_made_is_refused_in_one_line() -> None:
    gym.register("Spaceless-v0", entry_point=Spaceless)
    try:
        with pytest.raises(ValueError, match=r"^Spaceless-v0: cannot be made: Attr.*\)$"):
            EnvironmentSpec("Spaceless-v0").make_vec(1)
    finally:
        del gym.registry["Spaceless-v0"]


def test_a_strangers_records_import_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "trap.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    folder = tmp_path / "study"
    folder.mkdir()
    entry = Entry("x", "trap:Agent", {"rate": 1.0})
    experiment = Experiment(EnvironmentSpec("trap:Maze-v0"), (entry,), steps=500, eval_points=1)
    open_study(folder, experiment, "command")
    with open_log(RunFiles(folder, "x", 0).records) as log:
        log.append(record(contender="x"))
    RunFiles(folder, "x", 0).policy(".npz").write_bytes(b"")
    assert main(["status", str(folder)]) == 0
    assert main(["report", str(folder)]) == 0
    assert main(["evaluate", str(folder), "--no-progress"]) == 2
    assert "allow it with --env trap:Maze-v0" in capsys.readouterr().err
    policy = RunFiles(folder, "x", 0).policy(".npz")
    RandomAgent(Discrete(3), Discrete(2), discount=0.9, seed=0).save(policy)
    assert main(["plot", str(policy)]) == 2
    assert "allow it with --env trap:Maze-v0" in capsys.readouterr().err
    known = Experiment(EnvironmentSpec("bnprl/CheeseMaze-v0"), (entry,), steps=500, eval_points=1)
    other = tmp_path / "other"
    other.mkdir()
    open_study(other, known, "command")
    compare = ["compare", "bnprl/CheeseMaze-v0", "--agents", "random", "--steps", "500"]
    assert main([*compare, "--seeds", "1", "--eval-points", "1", "--out", str(other)]) == 2
    assert "has runs of trap:Agent; name that too" in capsys.readouterr().err
    assert "trap" not in sys.modules
