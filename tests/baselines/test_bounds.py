"""The command `bnprl bounds`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from baselines.cli import main

TIGER = """discount: 0.95
values: reward
states: left right
actions: listen open-left open-right
observations: left right
T: listen identity
T: open-left uniform
T: open-right uniform
O: listen
0.85 0.15
0.15 0.85
O: open-left uniform
O: open-right uniform
R: listen : * : * : * -1
R: open-left : left : * : * -100
R: open-left : right : * : * 10
R: open-right : right : * : * -100
R: open-right : left : * : * 10
"""
QUICK = ["--seconds", "0.3", "--no-progress"]


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[str, dict[str, str]]:
    """Run the command; return its first line and, by name, the lines of the table."""
    assert main(["bounds", *arguments]) == 0
    first, _, *rows = capsys.readouterr().out.splitlines()
    return first, {row[:32].split("  ")[0]: row for row in rows}


def value(row: str) -> float:
    return float(row.split("  ")[-1].replace("−", "-"))


def test_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tiger.POMDP"
    path.write_text(TIGER)
    first, rows = shown(capsys, str(path), *QUICK)
    assert first == f"{path}: expected discounted return, discount 0.95"
    wanted = {
        "random": ("policy", -606.66667),
        "best blind action": ("policy", -20.0),
        "MDP": ("upper bound", 200.0),
        "QMDP": ("upper bound", 189.0),
        "FIB": ("upper bound", 87.17949),
        "point-based": ("lower bound", 19.37137),
        "best memoryless, deterministic": ("policy", -20.0),
        "best memoryless, stochastic": ("policy", -20.0),
    }
    assert rows.keys() == wanted.keys()
    for name, (kind, number) in wanted.items():
        assert f"  {kind}  " in rows[name]
        if name == "point-based":  # it may not have had the time to converge
            assert -20 <= value(rows[name]) <= number + 1e-3
        else:
            assert value(rows[name]) == pytest.approx(number, abs=1e-3), name
    _, rows = shown(capsys, str(path), "--discount", "0.75", *QUICK)
    assert value(rows["QMDP"]) == pytest.approx(29)


def test_references_of_an_id(capsys: pytest.CaptureFixture[str]) -> None:
    id = "bnprl/Hallway-v0"
    _, rows = shown(capsys, id, *QUICK)
    assert "0.04223   0.042233  exact" in rows["random"]
    assert rows["best memoryless, stochastic"].endswith("search: bnprl bounds --seconds 100")
    assert "reference" in rows["dissertation"]
    _, rows = shown(capsys, id, "--discount", "0.9", *QUICK)
    assert "dissertation" not in rows


def test_many_agents(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.dpomdp"
    path.write_text(
        "agents: 2\ndiscount: 1.0\nvalues: reward\nstates: 2\nstart:\nuniform\nactions:\n2\n2\n"
        "observations:\n1\n1\nT: * :\nuniform\nO: * :\nuniform\nR: 0 0 : 0 : * : * : 1.0\n"
    )
    assert main(["bounds", str(path), *QUICK]) == 2
    assert "give one with --discount" in capsys.readouterr().err
    _, rows = shown(capsys, str(path), "--discount", "0.9", *QUICK)
    assert value(rows["MMDP"]) == pytest.approx(5.0)
    assert value(rows["best memoryless, deterministic"]) == pytest.approx(5.0)
    assert "lower bound if centralised" in rows["point-based"]
    assert "best memoryless, stochastic" not in rows


def test_an_id_of_many_agents(capsys: pytest.CaptureFixture[str]) -> None:
    _, rows = shown(capsys, "bnprl/RecyclingRobots-v0", *QUICK)
    assert "33.84787" in rows["MMDP"]
    assert "31.92913  31.929134" in rows["best memoryless, deterministic"]


def test_a_fully_observed_model_has_no_bounds(capsys: pytest.CaptureFixture[str]) -> None:
    _, rows = shown(capsys, "bnprl/Gridworld-v0", *QUICK)
    assert "  exact  " in rows["MDP"]
    assert not {"QMDP", "FIB", "point-based"} & rows.keys()


@pytest.mark.parametrize(
    ("id", "policies"),
    [
        ("bnprl/InvertedPendulum-v0", ["random", "balance"]),
        ("bnprl/PuddleWorld-v0", ["random", "go around"]),
        ("bnprl/GridTraffic-v0", ["random", "always horizontal", "longer queue", "alternating"]),
    ],
)
def test_an_id_without_tables_is_simulated(
    id: str, policies: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    _, rows = shown(capsys, id, "--seconds", "0.01", "--no-progress")
    assert list(rows) == policies
    for row in rows.values():
        assert "  policy, simulated  " in row
        mean, error, reference = re.search(
            r"(\S+) ± (\S+) +(\S+)  \S", row.replace("−", "-")
        ).groups()
        assert abs(float(mean) - float(reference)) < 4 * float(error) + 1e-2, row


def test_progress_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bounds", "bnprl/Tiger-v0", "--seconds", "0.3"]) == 0
    assert "point-based" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["bnprl/Halway-v0"], "did you mean bnprl/Hallway-v0"),
        (["CartPole-v1"], "CartPole-v1 has no tables"),
        (["bnprl/PuddleWorld-v0", "--discount", "0.5"], "--discount: 0.5, bnprl/PuddleWorld-v0 is"),
        (["missing.POMDP"], "missing.POMDP: there is no such model file"),
        (["bnprl/Hallway-v0", "--seconds", "0"], "--seconds: 0.0, must be over 0"),
        (["bnprl/Hallway-v0", "--seconds", "inf"], "--seconds: inf"),
        (["bnprl/Hallway-v0", "--seed", "-1"], "--seed: -1"),
        (["bnprl/Hallway-v0", "--discount", "2"], "discount: 2.0"),
        (["bnprl/Hallway-v0", "--discount", "1"], "give one with --discount"),
    ],
)
def test_bad_input(arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bounds", *arguments, "--no-progress"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("bnprl: error: ")
    assert error.count("\n") == 1
    assert reason in error
